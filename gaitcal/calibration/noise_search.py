"""Joint parameters and the noise of trials, found in turn: a search that goes on where it is while trials weigh anew.

Without skin: motions are eliminated (`reduced_problem.py`), trials count by 1 / nu^2, and nu is what a fit leaves
(`joint_noise.py`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_calibration import JointSearch, JointSettings
from gaitcal.calibration.joint_noise import least_noise, seen_noise, trial_noises
from gaitcal.calibration.joint_prior import ORIENTATION, POSITION, prior_deviations, prior_of
from gaitcal.calibration.reduced_problem import ReducedState
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES
from gaitcal.model.parameters import Parameters
from gaitcal.motion.roughness import frame_rate
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass
from gaitcal.study.joint_prior import JointPrior

PLAIN = JointSettings(prior_position=POSITION, prior_orientation=ORIENTATION, marker_noise=1.0, tolerance=1e-9)
"""Costs are in units of the noise already."""
FIRST_NOISE, MEMORY_S = 0.010, 0.1
"""m, s: noise before any is known, and how long it lasts."""
ROUNDS = 3
"""Fits after which the noise of every trial is found anew."""
NEAR = 1e-4
"""Relative tolerance of those: the nu of a walk's legs, trunk and single joints are then within 2 % of where searches
to the end have them, and a noise that is taken from a hundred samples is itself known to 7 %."""


def expected_joints(nominal: Parameters, free: tuple[str, ...], learnt: JointPrior | None) -> tuple[Array, Array]:
    """(np,) expected values and (np, np) precision of joint parameters before any trial."""
    middle = nominal.joint[[JP_INDEX[n] for n in free]]
    if learnt is None:
        return middle, np.diag(1.0 / prior_deviations(free) ** 2)
    mean, covariance = prior_of(free, learnt)
    precision = np.asarray(np.linalg.inv(covariance), float)
    return middle + mean, precision


@dataclass(frozen=True, kw_only=True)
class NearJoints:
    """Joint parameters and motions alone, not far from where a fit ends, and the noise that they leave."""

    search: JointSearch
    """Goes on from there, every trial weighed by its noise."""
    state: ReducedState
    noise: tuple[float, ...]
    """m, nu of every trial."""
    evaluations: int
    seconds: float


def near_joints(
    problems: Sequence[TrialProblem], nominal: Parameters, free: tuple[str, ...], learnt: JointPrior | None = None
) -> NearJoints:
    """Fit from nominal values as far as noise is known."""
    began = time.perf_counter()
    noise = [_first_noise(p) for p in problems]
    starts = [starting_nodes(p.chain, p.constants(nominal), p.data, p.basis) for p in problems]
    values: Array | None = nominal.joint[[JP_INDEX[name] for name in free]]
    least = [least_noise(p.basis) for p in problems]
    _, precision = expected_joints(nominal, free, learnt)
    search = _search(problems, nominal, free, starts, learnt)
    for _ in range(ROUNDS):
        search.weigh([1.0 / nu**2 for nu in noise])
        state, values = search.approach(NEAR, values), None
        served = float(np.trace(np.linalg.solve(state.hessian + precision, state.hessian)))
        moved = nominal.with_joint(free, state.p)
        seen = [seen_noise(p, moved, trial.nodes) for p, trial in zip(problems, state.trials, strict=True)]
        noise = trial_noises(seen, least, served)
    search.weigh([1.0 / nu**2 for nu in noise])
    return NearJoints(
        search=search,
        state=state,
        noise=tuple(noise),
        evaluations=search.problem.evaluations,
        seconds=time.perf_counter() - began,
    )


def _search(
    problems: Sequence[TrialProblem],
    nominal: Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    learnt: JointPrior | None,
) -> JointSearch:
    """The fit of joint parameters under the prior."""
    if learnt is None:
        return JointSearch(problems, nominal, free, starts, PLAIN)
    expected, precision = expected_joints(nominal, free, learnt)
    index = [JP_INDEX[n] for n in free]
    information = np.zeros((len(JP_NAMES),) * 2)  # all of the prior is information about its own centre
    information[np.ix_(index, index)] = precision
    settings = replace(PLAIN, prior_position=np.inf, prior_orientation=np.inf)
    return JointSearch(problems, nominal.with_joint(free, expected), free, starts, settings, information=information)


def _first_noise(problem: TrialProblem) -> float:
    """m, nu of a trial of which nothing is known."""
    return FIRST_NOISE * float(np.sqrt(max(frame_rate(problem.basis) * MEMORY_S, 1.0)))
