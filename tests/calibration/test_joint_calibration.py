"""Joint parameters: exact recovery, the reduced problem against a dense reference, bounds, priors, nested sets."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from gaitcal.calibration.approach import approach
from gaitcal.calibration.influence import influence_of
from gaitcal.calibration.joint_calibration import JointFit, JointSettings, calibrate_joints
from gaitcal.calibration.reduced_problem import ReducedProblem
from gaitcal.model.joint_parameters import JP_INDEX, gait_parameters, isolated_parameters
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters, published_subject
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import TrackSettings
from gaitcal.motion.trial_data import NodeRule, trial_problem
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.recording import Recording
from gaitcal.study.synthetic_data import synthetic_markers
from gaitcal.study.synthetic_motion import gait_motion
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_trial

KNEE = isolated_parameters("knee_r")
PART = ("thigh_r", "shank_r")


def knee_trial(seed: int, noise: float = 0.0, frames: int = 60) -> tuple[TrialProblem, Parameters]:
    """A trial of thigh and shank with true parameters of its own, and those."""
    rng = np.random.default_rng(seed)
    truth = perturbed_parameters(rng)
    problem, _ = random_trial(rng, truth, frames=frames, nodes=8, root="thigh_r", segments=PART, per_segment=5)
    measured = problem.data.measured + rng.normal(0, noise, problem.data.measured.shape)
    return replace(problem, data=replace(problem.data, measured=measured)), truth


def fit(problem: TrialProblem, start: Parameters, free: tuple[str, ...], **settings: float) -> JointFit:
    nodes = starting_nodes(problem.chain, problem.constants(start), problem.data, problem.basis)
    return calibrate_joints([problem], start, free, [nodes], JointSettings(**settings))


def values(parameters: Parameters, names: tuple[str, ...]) -> Array:
    return parameters.joint[[JP_INDEX[name] for name in names]]


def test_noise_free_parameters_are_recovered_exactly() -> None:
    problem, truth = knee_trial(1)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    found = fit(problem, start, KNEE)
    assert found.converged
    np.testing.assert_allclose(found.values, values(truth, found.free), atol=1e-11)


def test_from_absolute_zero_gait_is_found() -> None:
    """Every node and the 17 parameters of a leg at zero, the published subject's walk."""
    model, motion, free = published_model(), gait_motion(), gait_parameters("l")
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    recording = Recording("gait", motion.basis.time, model.markers.labels, markers)
    problem = trial_problem("gait", model, recording, NodeRule(fixed=20))
    zero = model.parameters.with_joint(free, np.zeros(17))
    near = approach([problem], zero, free, [np.zeros_like(motion.nodes)], np.zeros(17))
    found = calibrate_joints([problem], zero.with_joint(free, near.p), free, near.nodes)
    np.testing.assert_allclose(found.values, values(model.parameters, free), atol=1e-11)


def test_reduced_problem_has_the_cost_gradient_and_minimum_of_the_whole() -> None:
    """Nodes and parameters in one dense least-squares problem, by SciPy."""
    problem, truth = knee_trial(3, noise=0.004, frames=40)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    found = fit(problem, start, KNEE, tolerance=1e-13)
    nodes = found.nodes[0]

    def residual(x: Array) -> Array:
        moved = truth.with_joint(KNEE, x[nodes.size :])
        gap = problem.positions(x[: nodes.size].reshape(nodes.shape), problem.constants(moved))
        return (gap - problem.data.measured).ravel()

    start_x = np.concatenate([nodes.ravel(), found.values]) + 1e-3
    dense = least_squares(residual, start_x, method="lm", xtol=1e-14, ftol=1e-14)
    assert found.state.cost == pytest.approx(2 * dense.cost, rel=1e-8)
    np.testing.assert_allclose(found.values, dense.x[nodes.size :], atol=2e-5)

    reduced = ReducedProblem([problem], start, KNEE, [nodes], TrackSettings(tolerance=1e-14))
    p = values(start, KNEE)
    f, jacobian = reduced.residual(p), reduced.jacobian(p)
    assert f @ f == pytest.approx(reduced.at(p).cost, rel=1e-12)
    assert_derivative(
        2 * (jacobian.T @ f)[None],
        lambda x: np.array([reduced.at(x).cost]),
        p,
        relative=1e-5,
    )


def test_a_free_parameter_more_never_raises_the_cost() -> None:
    problem, truth = knee_trial(4, noise=0.004)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    costs = []
    for count in range(1, len(KNEE) + 1):
        found = fit(problem, start, KNEE[:count])
        costs.append(found.state.cost)
    assert all(b <= a * (1 + 1e-9) for a, b in pairwise(costs))


def test_bounds_hold_and_are_told() -> None:
    problem, truth = knee_trial(5)
    start = truth.with_joint(("knee_r.thigh.sup",), np.array([-0.35]))
    found = fit(problem, start, ("knee_r.thigh.sup",), position_bound=0.01, orientation_bound=0.1)
    assert abs(found.values[0] + 0.35) <= 0.01 + 1e-12
    assert found.at_bound == ("knee_r.thigh.sup",)


def test_a_strong_prior_keeps_parameters_where_they_are() -> None:
    problem, truth = knee_trial(6, noise=0.004)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    weak = fit(problem, start, KNEE, prior_position=10.0, prior_orientation=10.0)
    strong = fit(problem, start, KNEE, prior_position=1e-7, prior_orientation=1e-7)
    assert np.abs(strong.values - values(start, KNEE)).max() < 1e-4
    assert np.abs(weak.values - values(start, KNEE)).max() > 1e-2


def test_standard_errors_are_those_of_repeated_white_noise() -> None:
    """The scatter of the estimates over many draws against the mean standard error."""
    problem, truth = knee_trial(7, frames=60)
    rng = np.random.default_rng(8)
    draws, errors = [], []
    for _ in range(60):
        noisy = problem.data.measured + rng.normal(0, 0.003, problem.data.measured.shape)
        trial = replace(problem, data=replace(problem.data, measured=noisy))
        found = fit(trial, truth, KNEE)
        draws.append(found.values)
        errors.append(np.sqrt(np.diag(influence_of([trial], found).covariance)))
    ratio = np.mean(errors, axis=0) / np.std(draws, axis=0)
    # 60 draws know a standard deviation to 9 %; the leverage correction is cautious where noise is white
    assert ratio.min() > 0.7
    assert ratio.max() < 2.0
