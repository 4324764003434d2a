"""How much of a trial's errors its joints can see, and how many of its frames are independent."""

import numpy as np
import pytest

from gaitcal.calibration.joint_prior import (
    ForbiddenNoise,
    forbidden_noise,
    frames_per_sample,
    least_noise,
    trial_noises,
)
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.spline import spline_basis
from tests.derivatives import Array, perturbed_parameters, random_trial

WHITE = 0.002
"""m."""


def autoregressive(rng: np.random.Generator, frames: int, columns: int, kept: float) -> Array:
    """(frames, columns) of variance 1: each keeps `kept` of the one before; (1 + kept) / (1 - kept) frames a sample."""
    out = np.empty((frames, columns))
    out[0] = rng.normal(size=columns)
    for f in range(1, frames):
        out[f] = kept * out[f - 1] + np.sqrt(1 - kept**2) * rng.normal(size=columns)
    return out


@pytest.mark.parametrize(("kept", "expected"), [(0.0, 1.0), (0.5, 3.0), (0.9, 19.0)])
def test_frames_for_one_that_is_independent(kept: float, expected: float) -> None:
    errors = autoregressive(np.random.default_rng(1), 4000, 12, kept)
    # the sum ends where the correlation falls below 0.05: at most that tail, and its sampling, are lost
    assert frames_per_sample(errors) == pytest.approx(expected, rel=0.12)


def test_no_error_counts_every_frame() -> None:
    assert frames_per_sample(np.zeros((50, 3))) == 1.0


def test_white_noise_is_found_as_it_is_and_clusters_that_move_together_count_more() -> None:
    rng = np.random.default_rng(2)
    parameters = perturbed_parameters(rng)
    problem, coefficients = random_trial(
        rng, parameters, segments=("pelvis", "thigh_r"), frames=2000, nodes=60, per_segment=4
    )
    shape = problem.data.measured.shape
    constants = problem.constants(parameters)
    found = []
    for noise in (
        rng.normal(0, WHITE, shape),
        np.repeat(rng.normal(0, WHITE, (2, 3, shape[2])), 4, axis=0),  # each cluster as a whole
    ):
        noisy = problem.with_measured(problem.data.measured + noise)
        found.append(forbidden_noise(noisy, parameters, track_nodes(noisy, constants, coefficients).x))
    assert np.sqrt(found[0].variance) == pytest.approx(WHITE, rel=0.15)
    # four markers alike: their mean has four times the variance that independent ones would give it
    assert np.sqrt(found[1].variance) == pytest.approx(2.0 * WHITE, rel=0.25)


def test_parameters_use_samples_up_and_cameras_never_err_by_nothing() -> None:
    seen = [ForbiddenNoise(1e-6, 30.0), ForbiddenNoise(4e-6, 10.0)]
    plain = trial_noises(seen, [0.0, 0.0], -2.0)
    np.testing.assert_allclose(plain, [1e-3, 2e-3])
    of_fitted = trial_noises(seen, [0.0, 0.0], 18.0)
    np.testing.assert_allclose(of_fitted, np.sqrt(2.0) * np.array(plain))
    assert trial_noises([ForbiddenNoise(0.0, 10.0)], [3e-4], 1.0) == [3e-4]
    time = np.arange(100) / 100.0
    assert least_noise(spline_basis(time, 8)) < least_noise(spline_basis(time / 4.0, 8))
