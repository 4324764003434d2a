"""Independent noise: white noise is what it is, noise that repeats itself counts more, none leaves priors no say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.influence import LEAST_NOISE, MarkerEvidence, independent_noise, marker_evidence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_phases import JointCalibration, JointTrial, calibrate_sequentially
from gaitcal.model.parameters import Parameters, published_subject
from gaitcal.motion.trial_problem import TrialProblem
from tests.calibration.test_joint_calibration import KNEE, PART, fit, knee_trial, values
from tests.derivatives import Array, perturbed_parameters, random_trial

WEAK = JointSettings(prior_position=0.020, prior_orientation=np.deg2rad(10.0), cumulative=True)
FRAMES = 120


def white(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    return rng.normal(0.0, 1.0, shape)


def slow(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """One slow wave a marker coordinate, as large as white noise."""
    phase = np.linspace(0.0, 1.0, shape[-1])
    turns, start = rng.uniform(0.5, 2.0, (*shape[:-1], 1)), rng.uniform(0.0, 1.0, (*shape[:-1], 1))
    return np.sqrt(2.0) * np.sin(2 * np.pi * (turns * phase + start))


def noise_found(kind, size: float, seed: int) -> float:
    problem, truth = knee_trial(seed, frames=FRAMES)
    added = size * kind(np.random.default_rng(seed), problem.data.measured.shape)
    problem = replace(problem, data=replace(problem.data, measured=problem.data.measured + added))
    found = fit(problem, truth, KNEE)
    kept = np.arange(len(found.free))
    evidence = marker_evidence([problem], found)
    return independent_noise(found.state.hessian, evidence, kept, WEAK.prior_deviation(found.free))


def weakly_calibrated(problem: TrialProblem, nominal: Parameters) -> JointCalibration:
    return calibrate_sequentially([JointTrial(problem, problem, "knee_r")], nominal, WEAK, {"r": ()})


def test_white_noise_is_itself_and_repeated_noise_is_more() -> None:
    whites = [noise_found(white, 0.002, seed) for seed in range(6)]
    slows = [noise_found(slow, 0.002, seed) for seed in range(6)]
    assert 0.7 * 0.002 < np.median(whites) < 2.0 * 0.002
    assert np.median(slows) > 2.5 * np.median(whites)


def test_what_the_fitted_parameters_take_up_is_made_good() -> None:
    """A linear fit of n parameters to G independent samples, each of which has the same say: the mean square of what
    is found over many draws is that of the noise; without the factor G / (G - n) it would be a third less.
    """
    samples, size, noise, draws = 12, 4, 0.003, 2000
    turn = 2 * np.pi * np.arange(samples) / samples
    design = np.stack([np.cos(turn), np.sin(turn), np.cos(2 * turn), np.sin(2 * turn)], axis=1)
    hessian = design.T @ design
    inverse = np.linalg.inv(hessian)
    rng = np.random.default_rng(13)
    found = []
    for _ in range(draws):
        measured = rng.normal(0.0, noise, samples)
        residual = measured - design @ (inverse @ (design.T @ measured))
        errors = inverse @ (design.T * residual)  # one column a sample, as of `influence_of`
        evidence = MarkerEvidence(covariance=errors @ errors.T, unseen=np.zeros((size, 0)), coordinates=samples)
        found.append(independent_noise(hessian, evidence, np.arange(size), np.ones(size)))
    assert np.mean(np.square(found)) == pytest.approx(noise**2, rel=0.05)  # 2000 draws know it to 1 %


def test_markers_without_noise_overrule_any_prior() -> None:
    problem, truth = knee_trial(1)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    done = weakly_calibrated(problem, start)
    assert done.phases[0].marker_noise == LEAST_NOISE
    np.testing.assert_allclose(values(done.parameters, done.free), values(truth, done.free), atol=1e-8)


def test_what_an_earlier_phase_knows_counts_by_the_noise_of_both() -> None:
    """In units of its own noise each: a sharp isolated trial has more say in a blurred walk's cost than in its own."""
    rng = np.random.default_rng(31)
    truth = perturbed_parameters(rng)
    trials = []
    for noise in (0.001, 0.004):
        problem, _ = random_trial(rng, truth, frames=60, nodes=8, root="thigh_r", segments=PART, per_segment=5)
        measured = problem.data.measured + noise * slow(rng, problem.data.measured.shape)
        trials.append(replace(problem, data=replace(problem.data, measured=measured)))
    isolated, walk = (JointTrial(t, t, joint) for t, joint in zip(trials, ("knee_r", None), strict=True))
    first, second = calibrate_sequentially([isolated, walk], truth, WEAK, {"r": KNEE}).fits
    assert second.marker_noise > 2.0 * first.marker_noise
    assert len(second.free) > 3 and set(second.free) <= set(first.free)
    same = [first.free.index(name) for name in second.free]
    own = np.diag((second.marker_noise / WEAK.prior_deviation(second.free)) ** 2)
    earlier = (second.marker_noise / first.marker_noise) ** 2 * first.state.hessian[np.ix_(same, same)]
    np.testing.assert_allclose(second.prior.T @ second.prior, own + earlier, atol=1e-9 * np.abs(earlier).max())
