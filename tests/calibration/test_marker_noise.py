"""Independent noise: white noise is what it is, noise that repeats itself counts more, none leaves priors no say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.influence import LEAST_NOISE, independent_noise, marker_evidence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_phases import JointCalibration, JointTrial, calibrate_sequentially
from gaitcal.model.joint_parameters import isolated_parameters
from gaitcal.model.parameters import Parameters, published_subject
from gaitcal.motion.trial_problem import TrialProblem
from tests.calibration.test_joint_calibration import KNEE, fit, knee_trial, values
from tests.derivatives import Array

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


def test_it_grows_with_the_noise() -> None:
    assert noise_found(slow, 0.002, 3) == pytest.approx(2.0 * noise_found(slow, 0.001, 3), rel=0.05)


def test_markers_without_noise_overrule_any_prior() -> None:
    problem, truth = knee_trial(1)
    start = truth.with_joint(KNEE, values(published_subject(), KNEE))
    done = weakly_calibrated(problem, start)
    assert done.phases[0].marker_noise == LEAST_NOISE
    np.testing.assert_allclose(values(done.parameters, done.free), values(truth, done.free), atol=1e-8)


def test_a_prior_brings_noisy_trials_nearer_to_the_truth() -> None:
    """Slow noise of 5 mm, nominal knees wrong by 10 mm and 5 deg (standard deviations)."""
    errors: dict[str, list[float]] = {"nominal": [], "prior": [], "none": []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        problem, truth = knee_trial(seed, frames=FRAMES)
        noise = 0.005 * slow(rng, problem.data.measured.shape)
        problem = replace(problem, data=replace(problem.data, measured=problem.data.measured + noise))
        free = isolated_parameters("knee_r")
        unit = WEAK.prior_deviation(free)
        nominal = truth.with_joint(free, values(truth, free) + 0.5 * unit * rng.normal(size=len(free)))
        with_prior = weakly_calibrated(problem, nominal).parameters
        without = fit(problem, nominal, free).parameters
        for name, found in (("nominal", nominal), ("prior", with_prior), ("none", without)):
            errors[name].append(float(np.sum(((values(found, free) - values(truth, free)) / unit) ** 2)))
    total = {name: np.sqrt(np.mean(each)) for name, each in errors.items()}
    assert total["prior"] < total["none"]
    assert total["prior"] < total["nominal"]
