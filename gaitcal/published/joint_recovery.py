"""Phase 1 on synthetic data: the four published problems, everything starting at absolute zero.

Three isolated trials, each with the whole linkage (27 coordinates of 20 nodes) and the parameters of its joint; then
gait with 17 parameters of the leg, the other 10 where the isolated trials left them. One weight, no prior, no bounds.
Variable projection solves each motion fully for the joint parameters of the moment; where those are absurd (all zero)
that motion folds up and leads into a valley of its own. From zero, nodes and joint parameters therefore step together
(`step_together`): damped, they move both a little. Variable projection, as in any calibration, finishes.

Errors are summed up as in the published Table I: sqrt(mean e^2) over the joint's parameters, positions (mm) and
orientations (deg) apart. That definition gives the printed figures of Table I from those of Table II.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_calibration import JointSearch
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_TO_SI,
    Kind,
    Parameters,
    gait_parameters,
    isolated_parameters,
    leg_parameters,
)
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.banded import ArrowFactor
from gaitcal.motion.descent import Descent, DescentSettings, Evaluation, descend
from gaitcal.motion.motion import SharedMotions, motion_of, track_nodes
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.trial_problem import MotionProblem, trial_problem
from gaitcal.published.protocol import SIDE
from gaitcal.synthetic.motion import (
    NODES,
    RATE,
    TrueMotion,
    gait_motion,
    isolated_motion,
    marker_noise,
    synthetic_markers,
)

LEG = leg_parameters(SIDE)
DAMPED = DescentSettings(first_damping=1e-3, keep_within=0.0, most_steps=60)
"""Every step on its own matrix: far away none serves twice."""


def rms(values: Array | Sequence[float]) -> float | None:
    """Root mean square; None of nothing."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(array**2))) if array.size else None


def joint_errors(estimate: Parameters, truth: Parameters, names: Sequence[str]) -> Array:
    """(n,) estimate - true, mm and deg."""
    index = _index(names)
    out: Array = (estimate.joint[index] - truth.joint[index]) / JP_TO_SI[index]
    return out


def joint_rms(errors: Array, names: Sequence[str]) -> tuple[float | None, float | None]:
    """RMS of position errors (mm) and of orientation errors (deg); None where a joint has none."""
    position = np.array([JOINT_PARAMETERS[k].kind is Kind.POSITION for k in _index(names)], dtype=bool)
    return rms(errors[position]), rms(errors[~position])


def _index(names: Sequence[str]) -> list[int]:
    return [JP_INDEX[name] for name in names]


@dataclass(frozen=True, kw_only=True)
class JointRecovery:
    """One of the four problems, solved."""

    names: tuple[str, ...]
    """The joint parameters whose errors count: the joint's, or the leg's 27."""
    errors: Array
    """(n,) found - true, mm and deg."""
    marker_mm: float
    """RMS distance of markers, mm."""
    largest_mm: float
    """Largest distance of any marker in any frame, mm."""
    cost: float
    """m^2."""
    steps: int
    """From zero: steps of the far start and evaluations of the end game."""
    seconds: float
    """Of the processor, as the published times."""
    converged: bool
    parameters: Parameters
    """All of the linkage, with what was found."""
    coefficients: Array
    """(20, 27) m, rad."""
    cost_at_truth: float = np.nan
    """m^2: with the true joint parameters, the motion fitted; NaN where it was not asked for."""
    cost_from_truth: float = np.nan
    """m^2: of the minimum found when the search starts at the true values of the free parameters."""

    @property
    def position_mm(self) -> float:
        """RMS position error, mm."""
        return joint_rms(self.errors, self.names)[0] or 0.0

    @property
    def orientation_deg(self) -> float | None:
        """RMS orientation error, deg; None for the hip, which has none."""
        return joint_rms(self.errors, self.names)[1]


@cache
def true_model() -> SubjectModel:
    """The truth: the published nominal subject with its 41 tracking markers."""
    return published_model()


@cache
def true_motion(problem: str, isolated_hz: float = RATE) -> TrueMotion:
    """The true motion of one of `PROBLEMS`; isolated trials have 1200 frames, `isolated_hz` of them a second.

    The nodes are the same at every rate.
    """
    return gait_motion() if problem == "full leg" else isolated_motion(f"{problem}_{SIDE}", rate=isolated_hz)


def free_parameters(problem: str) -> tuple[str, ...]:
    """What one of `PROBLEMS` solves for."""
    return gait_parameters(SIDE) if problem == "full leg" else isolated_parameters(f"{problem}_{SIDE}")


def synthetic_problem(problem: str, noise: np.random.Generator | None, isolated_hz: float = RATE) -> MotionProblem:
    """One of `PROBLEMS` as markers on the whole linkage, with noise or without."""
    model, motion = true_model(), true_motion(problem, isolated_hz)
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    if noise is not None:
        markers = markers + marker_noise(motion.basis.time, len(model.markers.labels), noise)
    recording = Recording(source=problem, time=motion.basis.time, labels=model.markers.labels, markers=markers)
    # as published: markers alone, no prior on any coordinate
    return replace(trial_problem(problem, model, recording, NodeRule(fixed=NODES)), priors=())


def recover_joints(problems: Mapping[str, MotionProblem], *, compare: bool = True) -> dict[str, JointRecovery]:
    """Solve all; gait starts from what the isolated trials found for the parameters that it leaves alone.

    `compare`: also from the truth, for the costs there.
    """
    out: dict[str, JointRecovery] = {}
    for problem, markers in problems.items():
        held = true_model().parameters
        for found in out.values() if problem == "full leg" else ():
            held = held.with_joint(found.names, found.parameters.joint[_index(found.names)])
        out[problem] = solve(problem, markers, held, compare=compare)
    return out


def solve(problem: str, markers: MotionProblem, held: Parameters, *, compare: bool = True) -> JointRecovery:
    """One problem from absolute zero; `held` gives the joint parameters that are not free."""
    free, truth = free_parameters(problem), true_model().parameters
    began = time.process_time()
    zero = np.zeros((markers.basis.nodes, len(markers.chain.coordinates)))
    p, coefficients, near = step_together([markers], held, free, [zero], np.zeros(len(free)))
    fit = JointSearch([markers], held.with_joint(free, p), free, coefficients).run()
    seconds = time.process_time() - began
    names = LEG if problem == "full leg" else free
    distance = motion_of(markers, fit.parameters, fit.coefficients[0]).errors.distance
    found = JointRecovery(
        names=names,
        errors=joint_errors(fit.parameters, truth, names),
        marker_mm=1e3 * float(np.sqrt(np.mean(distance**2))),
        largest_mm=1e3 * float(distance.max()),
        cost=fit.state.cost,
        steps=near.steps + fit.iterations,
        seconds=seconds,
        converged=near.converged and fit.converged,
        parameters=fit.parameters,
        coefficients=fit.coefficients[0],
    )
    if not compare:
        return found
    at_truth = track_nodes(markers, markers.constants(truth), true_motion(problem).coefficients)
    from_truth = JointSearch([markers], held, free, [at_truth.x]).run(truth.joint[_index(free)])
    return replace(found, cost_at_truth=at_truth.cost, cost_from_truth=from_truth.state.cost)


def step_together(
    problems: Sequence[MotionProblem], parameters: Parameters, free: tuple[str, ...], starts: Sequence[Array], p: Array
) -> tuple[Array, list[Array], Descent[Evaluation, ArrowFactor]]:
    """Bring motions and joint parameters `free` down together, from nodes `starts` (each (nn, nq)) and `p` (np,):
    where both end, and how.
    """
    shared = SharedMotions(problems, parameters, free)
    end = descend(shared, shared.joined(p, starts), DAMPED)
    return *shared.parted(end.x), end
