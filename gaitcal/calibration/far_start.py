"""From a start far away: motions and joint parameters stepped together.

Variable projection solves each motion fully for the joint parameters of the moment; where those are absurd (all zero,
as in the published protocol) that motion folds up and leads into a valley of its own. Levenberg-Marquardt steps in
nodes and joint parameters together do not: damped, they move both a little, and converge from absolute zero. One step
solves the arrow-shaped system of `motion/banded.py` by its Schur complement, over all trials at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import BandFactor, NormalEquations
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Approached:
    """Where the approach ended."""

    p: Array
    """(np,) m, rad."""
    nodes: tuple[Array, ...]
    cost: float
    """m^2."""
    steps: int
    converged: bool


def approach(
    problems: Sequence[TrialProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    p: Array,
    *,
    tolerance: float = 1e-6,
    most_steps: int = 60,
) -> Approached:
    """Levenberg-Marquardt on nodes and joint parameters together, until the cost falls by less than `tolerance`."""
    opened = [problem.with_free(free) for problem in problems]
    place = {name: k for k, name in enumerate(free)}
    columns = [np.array([place[name] for name in problem.chain.free], dtype=np.intp) for problem in opened]
    nodes = list(starts)

    def equations(p: Array, nodes: Sequence[Array]) -> list[NormalEquations]:
        values = parameters.with_joint(free, p)
        return [problem.equations(n, problem.constants(values)) for problem, n in zip(opened, nodes, strict=True)]

    current, damping = equations(p, nodes), 1e-3
    cost = sum(e.cost for e in current)
    small = 1e-28 * sum(float(problem.data.weight.sum()) for problem in opened)
    for step in range(1, most_steps + 1):
        dp, dn = _arrow_step(current, columns, len(free), damping)
        next_p = p + dp
        next_nodes = [n + d.reshape(n.shape) for n, d in zip(nodes, dn, strict=True)]
        trial = equations(next_p, next_nodes)
        next_cost = sum(e.cost for e in trial)
        if next_cost <= cost:
            done = cost - next_cost <= tolerance * cost and damping < 1e-3
            p, nodes, current, cost = next_p, next_nodes, trial, next_cost
            damping = damping / 30 if damping > 1e-12 else 0.0
            if done or cost <= small:
                return Approached(p, tuple(nodes), cost, step, True)
        else:
            damping = max(10 * damping, 1e-9)
            if damping > 1e12:
                break
    return Approached(p, tuple(nodes), cost, most_steps, False)


def _arrow_step(
    equations: Sequence[NormalEquations], columns: Sequence[NDArray[np.intp]], size: int, damping: float
) -> tuple[Array, list[Array]]:
    schur, right = np.zeros((size, size)), np.zeros(size)
    solved = []
    for e, at in zip(equations, columns, strict=True):
        stacked = np.column_stack([e.mixed, e.node_gradient.ravel()])
        x = BandFactor(e.band, damping).solve(stacked)
        solved.append(x)
        schur[np.ix_(at, at)] += e.parameters + damping * np.diag(np.diag(e.parameters)) - e.mixed.T @ x[:, :-1]
        right[at] += e.parameter_gradient - e.mixed.T @ x[:, -1]
    schur += 1e-14 * np.trace(schur) * np.eye(size)
    dp = np.asarray(-np.linalg.solve(schur, right), dtype=np.float64)
    return dp, [-(x[:, -1] + x[:, :-1] @ dp[at]) for x, at in zip(solved, columns, strict=True)]
