"""From a start far away: motions and joint parameters stepped together.

Variable projection solves each motion fully for the joint parameters of the moment; where those are absurd (all zero,
as in the published protocol) that motion folds up and leads into a valley of its own. Levenberg-Marquardt steps in
nodes and joint parameters together do not: damped, they move both a little, and converge from absolute zero. Each step
solves the arrow of `motion/arrow.py` over all trials at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.parameters import Parameters
from gaitcal.motion.arrow import ArrowEquations
from gaitcal.motion.descent import DescentSettings, Ending, descend
from gaitcal.motion.minimised import Evaluation
from gaitcal.motion.track import NOTHING_LEFT_M
from gaitcal.motion.trial_problem import TrialProblem

DAMPED = DescentSettings(first_damping=1e-3, keep_within=0.0, most_steps=60)
"""Every step on its own matrix: far away none serves twice."""


@dataclass(frozen=True, kw_only=True)
class FarStart:
    """Where the steps ended."""

    p: Array
    """(np,) m, rad."""
    nodes: tuple[Array, ...]
    cost: float
    """m^2."""
    steps: int
    ending: Ending

    @property
    def converged(self) -> bool:
        """Whether it reached its tolerance."""
        return self.ending.converged


def step_together(
    problems: Sequence[TrialProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    p: Array,
    settings: DescentSettings = DAMPED,
) -> FarStart:
    """Bring motions and joint parameters `free` down together, from nodes `starts` (each (nn, nq)) and `p` (np,)."""
    shared = SharedTrials(problems, parameters, free)
    end = descend(shared, shared.joined(p, starts), settings)
    values, nodes = shared.parted(end.x)
    return FarStart(p=values, nodes=tuple(nodes), cost=end.cost, steps=end.steps, ending=end.ending)


class SharedTrials:
    """Markers of several trials by x = (joint parameters, nodes of each trial), as a problem for `descend`."""

    has_curvature = False

    def __init__(self, problems: Sequence[TrialProblem], parameters: Parameters, free: tuple[str, ...]) -> None:
        self.parameters, self.free, self.size = parameters, free, len(free)
        self.open = [problem.with_free(free) for problem in problems]
        self.columns = [problem.places_in(free) for problem in self.open]
        self.nothing_left = NOTHING_LEFT_M**2 * sum(float(problem.data.weight.sum()) for problem in self.open)

    def joined(self, p: Array, nodes: Sequence[Array]) -> Array:
        """The vector x."""
        return np.concatenate([p, *(of_trial.ravel() for of_trial in nodes)])

    def parted(self, x: Array) -> tuple[Array, list[Array]]:
        """The shared parameters (np,) and the nodes (nn, nq) of each trial."""
        sizes = [self.size, *(problem.basis.nodes * len(problem.chain.coordinates) for problem in self.open)]
        p, *nodes = np.split(x, np.cumsum(sizes)[:-1])
        return p, [flat.reshape(problem.basis.nodes, -1) for flat, problem in zip(nodes, self.open, strict=True)]

    def evaluate(self, x: Array) -> Evaluation:
        """Cost (m^2) and half gradient."""
        return self.linearise(x, curved=False).evaluation

    def linearise(self, x: Array, *, curved: bool) -> ArrowEquations:
        """The same with the arrow."""
        p, nodes = self.parted(x)
        moved = self.parameters.with_joint(self.free, p)
        trials = [problem.equations(n, problem.constants(moved)) for problem, n in zip(self.open, nodes, strict=True)]
        return ArrowEquations(trials, self.columns, self.size)
