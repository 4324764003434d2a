"""Iterated weights: the loss functions, their scale, and tracking that outliers do not move."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gaitcal.model.nominal import published_model
from gaitcal.synthetic.synthetic_motion import simulate_isolated_trial
from gaitcal.tracking.motion import (
    MIN_SCALE_M,
    Loss,
    estimate_residual_scale,
    track_coefficients,
    track_robustly,
)
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.derivatives import Array, started
from tests.synthetic_studies import made_recording

NOISE_M = 0.001
SPIKE_M = 0.1


@pytest.fixture(scope="module")
def clean() -> MotionProblem:
    """A knee trial with 1 mm of noise, every fourth frame."""
    recording = made_recording(simulate_isolated_trial("knee_r"))
    rng = np.random.default_rng(0)
    markers = recording.markers + rng.normal(0, NOISE_M, recording.markers.shape)
    recording = replace(recording, time=recording.time[::4], markers=markers[::4])
    segments = ("thigh_r", "shank_r")
    return build_trial_problem(
        "knee_r",
        published_model(),
        recording,
        ControlPointRule(8.0),
        root="thigh_r",
        segments=segments,
    )


def spiked(problem: MotionProblem, share: float = 0.02) -> tuple[MotionProblem, NDArray[np.bool_]]:
    rng = np.random.default_rng(1)
    struck = rng.random(problem.data.weight.shape) < share
    direction = rng.normal(size=problem.data.measured.shape)
    direction *= SPIKE_M / np.linalg.norm(direction, axis=1, keepdims=True)
    return problem.with_measured(problem.data.measured + struck[:, None] * direction), struck


def plain(problem: MotionProblem) -> Array:
    return problem.basis.evaluate(
        track_coefficients(problem, *started(problem, published_model().parameters)).x
    )


@pytest.mark.parametrize("loss", Loss)
def test_factor_falls_from_one(loss: Loss) -> None:
    u = np.linspace(0, 50, 200)
    factor = loss.compute_factor(u)
    assert factor[0] == 1.0
    assert np.all(np.diff(factor) <= 0) and np.all(factor > 0)
    influence = u * factor
    if loss is Loss.HUBER:
        assert np.all(np.diff(influence) >= -1e-12)  # never lets go
    else:
        assert influence[-1] < 0.5 * influence.max()  # lets go


@pytest.mark.parametrize("loss", Loss)
def test_efficiency_on_gaussian_residuals(loss: Loss) -> None:
    """(E[div psi] / 3)^2 / (E|psi|^2 / 3) for psi = f(|x|) x in three dimensions: 95 %, as the
    constants say.
    """
    x = np.random.default_rng(2).normal(size=(200_000, 3))
    u = np.linalg.norm(x, axis=1)
    step = 1e-5
    slope = (loss.compute_factor(u + step) - loss.compute_factor(u - step)) / (2 * step)
    f = loss.compute_factor(u)
    efficiency = (np.mean(3 * f + u * slope) / 3) ** 2 / (np.mean((f * u) ** 2) / 3)
    assert 0.945 < efficiency < 0.965


def test_scale_ignores_a_third_of_outliers() -> None:
    rng = np.random.default_rng(3)
    r = rng.normal(0, 0.004, (3000, 3))
    r[:600] += 0.1
    assert estimate_residual_scale(r) == pytest.approx(0.004, rel=0.35)
    assert estimate_residual_scale(np.zeros((10, 3))) == MIN_SCALE_M


@pytest.mark.parametrize("loss", Loss)
def test_spikes_move_nothing(clean: MotionProblem, loss: Loss) -> None:
    spoilt, struck = spiked(clean)
    parameters = published_model().parameters
    angle = clean.chain.coordinates.index("knee_angle_r")
    true = plain(clean)[:, angle]
    found = track_robustly(spoilt, parameters, loss)
    robust = spoilt.basis.evaluate(found.tracked.x)[:, angle]
    assert np.rad2deg(np.sqrt(np.mean((robust - true) ** 2))) < 0.2
    assert np.sqrt(np.mean((plain(spoilt)[:, angle] - true) ** 2)) > 4 * np.sqrt(
        np.mean((robust - true) ** 2)
    )
    assert found.outliers[struck].mean() > 0.99 and found.outliers[~struck].mean() < 0.01


def test_weight_zero_stays_zero(clean: MotionProblem) -> None:
    weight = clean.data.weight.copy()
    weight[0, :100] = 0.0
    found = track_robustly(clean.with_weight(weight), published_model().parameters, Loss.CAUCHY)
    assert (found.problem.data.weight[0, :100] == 0).all()
    assert (found.factor[0, :100] == 1).all()
