"""Joint parameters from two sessions: against the plain Bayesian estimate, and what new markers leave apart."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.compare.parameter_differences import placement
from gaitcal.compare.session import Common
from gaitcal.compare.shared_model import JointKnowledge, joined, shared_joints
from gaitcal.errors import InputError
from tests.compare.made_sessions import NAMES, made_session

CLOSE = 1e-6
"""Relative: r = 1 - 1e-9 stands for 1."""


def made_knowledge(seed: int) -> tuple[JointKnowledge, np.ndarray, np.ndarray]:
    """With the information S of its markers, and where these alone would have the parameters."""
    rng, sigma = np.random.default_rng(seed), prior_deviations(NAMES)
    half = rng.normal(0.0, 1.0, (2, 2)) / sigma[:, None]
    information, at = half @ half.T, rng.normal(0.0, 1.0, 2) * sigma
    precision = information + np.diag(sigma**-2.0)
    deviation = np.linalg.solve(precision, information @ at)
    nominal = rng.normal(0.0, 1.0, 2)
    known = JointKnowledge(nominal=nominal, fitted=nominal + deviation, covariance=np.linalg.inv(precision))
    return known, information, at


def test_on_one_static_trial_information_adds() -> None:
    (a, of_a, at_a), (b, of_b, at_b) = made_knowledge(0), made_knowledge(1)
    found = joined(NAMES, a, b, placed_anew=False)
    precision = of_a + of_b + np.diag(prior_deviations(NAMES) ** -2.0)
    expected = np.linalg.solve(precision, of_a @ at_a + of_b @ at_b)
    assert found.a - a.nominal == pytest.approx(expected, rel=CLOSE)
    assert found.b - b.nominal == pytest.approx(expected, rel=CLOSE)
    for errors in found.errors:
        assert errors == pytest.approx(np.sqrt(np.diag(np.linalg.inv(precision))), rel=CLOSE)


def test_markers_put_on_anew_leave_joints_apart_and_bars_no_wider_than_alone() -> None:
    (a, *_), (b, *_) = made_knowledge(0), made_knowledge(1)
    found = joined(NAMES, a, b, placed_anew=True)
    assert np.abs((found.a - a.nominal) - (found.b - b.nominal)).max() > 1e-4
    for errors, alone, other in zip(found.errors, (a, b), (b, a), strict=True):
        assert (errors <= np.sqrt(np.diag(alone.covariance)) * (1.0 + CLOSE)).all()
        assert (errors < np.sqrt(np.diag(alone.covariance))).any(), other


def test_error_bars_hold_what_is_drawn_from_the_priors() -> None:
    """Many people: deviations that go together but for where markers were put, and noise of the markers."""
    rng, sigma = np.random.default_rng(3), prior_deviations(NAMES)
    own = placement(NAMES)
    (_, of_a, _), (_, of_b, _) = made_knowledge(0), made_knowledge(1)
    z = []
    for _ in range(2000):
        person = rng.normal(0.0, 1.0, 2) * np.sqrt(sigma**2 - own**2)
        sessions = []
        for information in (of_a, of_b):
            true = person + rng.normal(0.0, 1.0, 2) * own
            at = true + np.linalg.cholesky(np.linalg.inv(information)) @ rng.normal(0.0, 1.0, 2)
            covariance = np.linalg.inv(information + np.diag(sigma**-2.0))
            sessions.append(
                (true, JointKnowledge(nominal=np.zeros(2), fitted=covariance @ information @ at, covariance=covariance))
            )
        found = joined(NAMES, sessions[0][1], sessions[1][1], placed_anew=True)
        z.append([(found.a - sessions[0][0]) / found.errors[0], (found.b - sessions[1][0]) / found.errors[1]])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.03)  # 8000 draws: 0.01 of a standard deviation


def test_a_refused_session_has_no_say() -> None:
    with pytest.raises(InputError, match="b: is refused"):
        shared_joints(made_session("a"), made_session("b", verdict="refused"), Common.STATIC)
    with pytest.raises(InputError, match="not calibrated"):
        shared_joints(made_session("a", influence=None), made_session("b"), Common.STATIC)
