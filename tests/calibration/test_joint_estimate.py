"""One estimate of joint parameters, skin and motions: against a dense solution, the truth, and many draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints, free_of, skin_prior
from gaitcal.calibration.joint_prior import ORIENTATION, POSITION, prior_deviations
from gaitcal.calibration.skin_movement import skin_columns
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES, isolated_parameters
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import Array, central_differences, perturbed_parameters, random_trial

HIP = isolated_parameters("hip_r")
SEGMENTS = ("pelvis", "thigh_r")
EXACT_M = 2e-5
"""m: what a prior of 20 mm leaves of a nominal joint 10 mm off, against the noise that cameras have at least."""


def hip_trial(seed: int, frames: int = 300, nodes: int = 12) -> tuple[TrialProblem, Array]:
    """A trial of the published hip, and its true joint parameters."""
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng, 0.0, 0.0)
    problem, _ = random_trial(rng, parameters, segments=SEGMENTS, frames=frames, nodes=nodes)
    return problem, parameters.joint[[JP_INDEX[n] for n in HIP]]


def test_without_noise_the_truth_is_found_and_without_markers_the_prior_stays() -> None:
    problem, truth = hip_trial(1)
    wrong = perturbed_parameters(np.random.default_rng(2))
    estimate, errors = estimate_joints([problem], wrong, HIP)
    assert estimate.converged
    np.testing.assert_allclose(estimate.values, truth, atol=EXACT_M)
    still = problem.with_measured(np.repeat(problem.data.measured[:, :, :1], 300, axis=2))
    kept, spread = estimate_joints([still], wrong, HIP)
    # a joint that does not move tells where its two sides meet, not where along with each: half of the directions
    assert 2.0 < kept.served < 3.5
    assert spread.standard_errors[HIP[0]] > 0.5 * POSITION
    assert errors.standard_errors[HIP[0]] < 0.02 * POSITION


def test_errors_by_source_sum_to_the_inverse_hessian_and_the_end_is_the_dense_minimum() -> None:
    rng = np.random.default_rng(4)
    problem, _ = hip_trial(3, frames=40, nodes=7)
    problem = problem.with_measured(problem.data.measured + rng.normal(0, 0.004, problem.data.measured.shape))
    angles = {name: 0.3 * rng.normal(size=40) for name in ("hip_flexion_r",)}
    sizes = {(segment, "hip_flexion_r"): 0.3 for segment in SEGMENTS}
    problem = replace(problem, tissue=skin_columns(problem, angles))
    prior = skin_prior([problem], sizes)
    wrong = perturbed_parameters(np.random.default_rng(5), 0.005, 0.0)
    estimate, errors = estimate_joints([problem], wrong, HIP, skin=prior)
    centre = wrong.joint[[JP_INDEX[n] for n in HIP]]
    whiten = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def residual(x: Array) -> Array:
        p, z, n = np.split(x, [len(HIP), len(HIP) + len(prior.keys)])
        at = problem.displaced(z)
        nodes = n.reshape(estimate.nodes[0].shape)
        gap = at.positions(nodes, at.constants(wrong.with_joint(HIP, p))) - at.data.measured
        return np.concatenate([gap.ravel() / estimate.noise[0], (p - centre) / prior_deviations(HIP), whiten @ z])

    x = np.concatenate([estimate.values, estimate.nodes[0].ravel()])
    slope, r = central_differences(residual, x, 1e-6), residual(x)
    step = np.linalg.solve(slope.T @ slope, slope.T @ r)
    count = len(estimate.values)
    dense = np.linalg.inv(slope.T @ slope)[:count, :count]
    assert np.abs(step[: len(HIP)] / np.sqrt(np.diag(dense))[: len(HIP)]).max() < 1e-3
    scale = np.sqrt(np.outer(np.diag(dense), np.diag(dense)))
    # the matrix of the motions takes markers in their places, not where the skin moved them
    np.testing.assert_allclose(errors.covariance / scale, dense / scale, atol=0.02)
    assert {c.split("/")[0] for c in errors.clusters} == {"markers", "nominal", "skin"}


def test_a_joint_is_free_where_both_its_segments_show_markers() -> None:
    rng = np.random.default_rng(6)
    problem, _ = random_trial(rng, perturbed_parameters(rng), segments=LOWER_BODY)
    assert len(free_of([problem], JP_NAMES)) == 54
    weight = problem.data.weight.copy()
    weight[[problem.chain.segments[s] == "foot_l" for s in problem.data.segment]] = 0.0
    free = free_of([problem.with_weight(weight)], JP_NAMES)
    assert not any(name.startswith(("talocrural_l", "subtalar_l")) for name in free) and len(free) == 42


def test_intervals_cover_the_truth_under_slow_noise() -> None:
    """Nominal joints drawn from the prior, noise that keeps 0.95 of itself from frame to frame, over 60 draws."""
    inside = []
    for seed in range(60):
        problem, truth = hip_trial(seed, frames=240, nodes=10)
        rng = np.random.default_rng([seed, 1])
        noise = rng.normal(0, 0.003, problem.data.measured.shape)
        for f in range(1, noise.shape[2]):
            noise[:, :, f] = 0.95 * noise[:, :, f - 1] + np.sqrt(1 - 0.95**2) * noise[:, :, f]
        wrong = perturbed_parameters(rng, 0.0, 0.0).with_joint(HIP, truth + rng.normal(0, POSITION, len(HIP)))
        estimate, errors = estimate_joints([problem.with_measured(problem.data.measured + noise)], wrong, HIP)
        se = np.array([errors.standard_errors[n] for n in HIP])
        inside.append(np.abs(estimate.values - truth) < 1.96 * se)
    assert 0.88 < float(np.mean(inside)) <= 0.995


def test_priors_are_by_kind() -> None:
    np.testing.assert_array_equal(prior_deviations(("hip_r.pelvis.ant", "knee_l.shank.front")), [POSITION, ORIENTATION])


def test_a_noisy_trial_weighs_little_beside_a_quiet_one() -> None:
    quiet, _ = hip_trial(8)
    rng = np.random.default_rng(9)
    loud = quiet.with_measured(quiet.data.measured + rng.normal(0, 0.02, quiet.data.measured.shape))
    loud = replace(loud, name="loud")
    wrong = perturbed_parameters(np.random.default_rng(10), 0.01, 0.0)
    alone: JointEstimate = estimate_joints([quiet], wrong, HIP)[0]
    both = estimate_joints([quiet, loud], wrong, HIP)[0]
    assert both.noise[1] > 20 * both.noise[0]
    np.testing.assert_allclose(both.values, alone.values, atol=1e-4)
