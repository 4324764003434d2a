"""Random numbers: bounded as published, and a function of seed, set, level and number alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from gaitcal.model.parameters import JP_NAMES, gait_parameters, leg_parameters
from gaitcal.published.case import nominal_case
from gaitcal.published.draw import Disturbance, MonteCarloContext, disturb
from gaitcal.published.protocol import MonteCarloSettings, ParameterChoice, Varied


@cache
def context_of(settings: MonteCarloSettings) -> MonteCarloContext:
    return MonteCarloContext(nominal_case(), settings)


def sample(varied: Varied, level: int, number: int, settings: MonteCarloSettings | None = None) -> Disturbance:
    return disturb(context_of(settings or MonteCarloSettings()), varied, level, number)


def test_each_set_disturbs_what_it_names() -> None:
    found = {v: sample(v, 100, 0) for v in Varied}
    told = {v: (d.joint is not None, d.inertial is not None, d.noise is not None) for v, d in found.items()}
    assert told == {
        Varied.JP: (True, False, False),
        Varied.IP: (False, True, False),
        Varied.BOTH: (True, True, False),
        Varied.NOISE: (False, False, True),
    }


@pytest.mark.parametrize("level", [25, 100])
def test_uniform_within_the_bounds_of_the_level(level: int) -> None:
    settings = MonteCarloSettings()
    relative = np.array([sample(Varied.JP, level, k).joint for k in range(400)]) / settings.joint_bounds
    assert np.abs(relative).max() <= level / 100
    assert np.abs(relative).max() > 0.999 * level / 100
    # the SD of a uniform variable of half width b is b / sqrt(3); 400 samples of each parameter tell it to about 1 %
    assert relative.std() == pytest.approx(level / 100 / np.sqrt(3), rel=0.02)
    assert abs(relative.mean()) < 0.02 * level / 100
    assert np.abs(np.corrcoef(relative.T) - np.eye(relative.shape[1])).max() < 0.25


def test_bounds_are_published_and_configurable() -> None:
    bounds = MonteCarloSettings().joint_bounds
    assert sorted(set(bounds.tolist())) == pytest.approx([0.010, np.deg2rad(10.0)])
    doubled = MonteCarloSettings(position_mm=20.0, orientation_deg=20.0)
    np.testing.assert_allclose(doubled.joint_bounds, 2 * bounds)
    fifty = sample(Varied.IP, 100, 3, MonteCarloSettings(inertial_percent=50.0)).inertial
    ten = sample(Varied.IP, 100, 3).inertial
    assert fifty is not None and ten is not None
    np.testing.assert_allclose(fifty, 5 * ten)


def test_noise_is_the_published_sinusoid() -> None:
    waves = [sample(Varied.NOISE, 50, k).noise for k in range(20)]
    noise = np.stack([w for w in waves if w is not None])
    assert noise.shape == (20, 41, 3, 208)
    assert np.abs(noise).max() <= 0.005
    assert np.abs(noise).max() > 0.0045


def test_parameter_choices() -> None:
    assert ParameterChoice.LEG.names == (*leg_parameters("r"), *leg_parameters("l"))
    assert ParameterChoice.GAIT.names == (*gait_parameters("r"), *gait_parameters("l"))
    assert ParameterChoice.ALL.names == JP_NAMES


def test_a_stream_depends_on_seed_set_level_and_number() -> None:
    first = sample(Varied.JP, 100, 7).joint
    again = sample(Varied.JP, 100, 7).joint
    assert first is not None and again is not None
    np.testing.assert_array_equal(first, again)
    others = [
        sample(Varied.JP, 100, 8),
        sample(Varied.BOTH, 100, 7),
        sample(Varied.JP, 100, 7, MonteCarloSettings(seed=1)),
    ]
    for other in others:
        assert other.joint is not None
        assert not np.isclose(first, other.joint).any()
    half = sample(Varied.JP, 50, 7).joint
    assert half is not None
    assert not np.isclose(first, 2 * half).any()


def test_the_stream_is_the_one_that_stores_were_made_with() -> None:
    """Other numbers would need another `store.FORMAT`."""
    joint = sample(Varied.JP, 100, 0).joint
    assert joint is not None
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(0, 100, 0)))
    np.testing.assert_array_equal(joint, MonteCarloSettings().joint_bounds * rng.uniform(-1.0, 1.0, len(joint)))
