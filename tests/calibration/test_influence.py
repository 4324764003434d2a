"""ErrorSources functions against solving again: every source of error moved by itself, and the fit repeated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.error_sources import LEVERAGE_CAP, ErrorSources, marker_moves
from gaitcal.calibration.identifiability import LARGEST_ORIENTATION, LARGEST_POSITION, unseen_parameters
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.marker_residual import MarkerData, marker_positions
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior
from tests.calibration.test_joint_calibration import KNEE, knee_trial, values
from tests.derivatives import Array, central_differences, perturbed_parameters, random_trial

NOISE = 1e-5
"""m, so small that what Gauss-Newton leaves out does not show."""
LINEAR = 2e-3
"""Relative to the largest change: what is left of that, and of the solvers' tolerances."""
EXACT = JointSettings(tolerance=1e-15, tracking=DescentSettings(gain=1e-15))
FREE, KEPT = KNEE[:4], KNEE[4:]
STRONG = JointPrior(names=FREE, mean=np.zeros(4), covariance=1e-10 * np.eye(4))
"""As strong as the markers, so that it shows beside them."""


def noisy_trial() -> tuple[TrialProblem, Parameters]:
    problem, truth = knee_trial(21, noise=NOISE, frames=40)
    weight = np.random.default_rng(22).uniform(0.3, 1.0, problem.data.weight.shape[0])
    return problem.with_weight(np.repeat(weight[:, None], problem.data.weight.shape[1], axis=1)), truth


def solved(
    problem: TrialProblem, parameters: Parameters, known: ErrorSources | None = None
) -> tuple[JointEstimate, ErrorSources]:
    return estimate_joints({"knee_r": (problem,)}, parameters, FREE, prior=STRONG, settings=EXACT, known=known)


def leverages(problem: TrialProblem, parameters: Parameters, nodes: Array) -> Array:
    """(nm, 3, nf) of each marker coordinate in its frame's own least-squares problem; Jacobian by differences."""
    q, constants, data = problem.basis.evaluate(nodes), problem.constants(parameters), problem.data
    out = np.empty(data.measured.shape)
    for f in range(len(q)):
        one = data.frames(slice(f, f + 1))

        def placed(x: Array, one: MarkerData = one) -> Array:
            return marker_positions(problem.chain, constants, one.placed, x[None])

        slope = np.sqrt(np.repeat(one.weight[:, 0], 3))[:, None] * central_differences(placed, q[f])
        out[:, :, f] = np.diag(slope @ np.linalg.pinv(slope)).reshape(-1, 3)
    return out


def test_errors_of_what_was_known_before_move_the_solution_as_they_say() -> None:
    """Of the priors' centres, and of joint parameters that the fit kept fixed; rows it leaves alone stay."""
    problem, truth = noisy_trial()
    size = 1e-5
    known = ErrorSources(KNEE, size * np.eye(len(KNEE)), tuple(f"nominal/{name}" for name in KNEE))
    fit, influence = solved(problem, truth, known)
    assert influence.free == (*FREE, *KEPT)
    for name in KNEE:
        other, _ = solved(problem, truth.with_joint((name,), truth.joint[[JP_INDEX[name]]] + size))
        column = influence.clusters.index(f"nominal/{name}")
        moved = np.concatenate([other.values, values(other.parameters, KEPT)])
        moved -= np.concatenate([fit.values, values(fit.parameters, KEPT)])
        np.testing.assert_allclose(influence.parameters[:, column], moved, rtol=0, atol=LINEAR * size)


def test_standard_errors_are_those_of_repeated_white_noise() -> None:
    """The scatter of the estimates over many draws against the mean standard error, nothing being expected."""
    problem, truth = knee_trial(7, frames=60)
    rng = np.random.default_rng(8)
    draws, errors = [], []
    for _ in range(60):
        trial = problem.with_measured(problem.data.measured + rng.normal(0, 0.003, problem.data.measured.shape))
        found, influence = estimate_joints({"knee_r": (trial,)}, truth, KNEE, prior=None, settings=JointSettings())
        draws.append(found.values)
        errors.append(np.sqrt(np.diag(influence.covariance)))
    ratio = np.mean(errors, axis=0) / np.std(draws, axis=0)
    # 60 draws know a standard deviation to 9 %; few frames, whose autocorrelation counts as if it were more
    assert ratio.min() > 0.7
    assert ratio.max() < 2.0


def test_the_motion_moves_with_a_marker_coordinate_and_with_the_joint_parameters() -> None:
    """`marker_moves` of a whole body with its joint parameters known: the motion tracked again."""
    rng = np.random.default_rng(23)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters, frames=30, nodes=7)
    measured = problem.data.measured + rng.normal(0, NOISE, problem.data.measured.shape)
    problem = replace(problem, data=replace(problem.data, measured=measured))
    source = ErrorSources(FREE, 1e-6 * rng.normal(size=(len(FREE), 1)), ("nominal/all",))

    def motion(problem: TrialProblem, parameters: Parameters) -> Array:
        constants = problem.constants(parameters)
        start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
        return track_nodes(problem, constants, start, DescentSettings(gain=1e-15)).nodes

    nodes = motion(problem, parameters)
    moves = marker_moves(problem, nodes, parameters, source)
    residual = problem.positions(nodes, problem.constants(parameters)) - problem.data.measured
    inflated = residual / (1.0 - np.clip(leverages(problem, parameters, nodes), 0.0, LEVERAGE_CAP))
    for m, axis in ((0, 1), (17, 2)):
        measured = problem.data.measured.copy()
        measured[m, axis] -= inflated[m, axis]
        moved = motion(replace(problem, data=replace(problem.data, measured=measured)), parameters) - nodes
        np.testing.assert_allclose(
            moves.nodes[:, 3 * m + axis], moved.ravel(), rtol=0, atol=LINEAR * float(np.abs(moved).max())
        )
    shifted = parameters.with_joint(FREE, values(parameters, FREE) + source.parameters[:, 0])
    moved = motion(problem, shifted) - nodes
    change = -moves.sensitivity @ moves.shift[:, -1]
    sign = np.sign(change @ moved.ravel())  # only the square of what a source does is kept
    np.testing.assert_allclose(sign * change, moved.ravel(), rtol=0, atol=LINEAR * float(np.abs(moved).max()))


@pytest.mark.parametrize("together", [0.0, 0.999])
def test_of_two_that_only_their_sum_shows_one_is_kept_at_its_nominal_value(together: float) -> None:
    """Both have a standard error too large; given the one, the other is determined if they go together."""
    names = ("hip_r.pelvis.ant", "hip_r.thigh.ant", "knee_r.shank.front")
    allowed = np.array([LARGEST_POSITION, LARGEST_POSITION, LARGEST_ORIENTATION])
    errors = np.array([1.5, 2.0, 0.1]) * allowed
    covariance = np.outer(errors, errors) * np.array([[1.0, together, 0.0], [together, 1.0, 0.0], [0.0, 0.0, 1.0]])
    expected = ("hip_r.thigh.ant",) if together else ("hip_r.thigh.ant", "hip_r.pelvis.ant")
    assert unseen_parameters(names, covariance, np.eye(3)) == expected
    seen = np.array([0.8, 0.6, 0.0])
    blind = np.outer(seen, seen) + np.diag([0.0, 0.0, 1.0])
    assert unseen_parameters(names, np.zeros((3, 3)), blind) == ("hip_r.thigh.ant",)
