"""Joint parameters from two sessions: against the plain Bayesian estimate, and what new markers leave apart."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from gaitcal.calibration.joint_prior import prior_of, prior_of_study, prior_root
from gaitcal.compare.shared_model import JointKnowledge, joined, shared_joints
from gaitcal.compare.stride_sets import Common
from gaitcal.errors import InputError
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import ParameterPriorTable
from tests.compare.made_sessions import NAMES, made_session, placed_anew

CLOSE = 1e-5
"""Relative: what is the same in both sessions is it but for 1e-9 of its variance."""
COUNT = len(NAMES)
SAID = prior_of_study({name: ParameterPriorTable(mean=4.0, deviation=9.0) for name in NAMES[:2]})


def made_knowledge(seed: int, prior: JointPrior | None = None) -> tuple[JointKnowledge, np.ndarray, np.ndarray]:
    """With the information S of its markers, and where these alone would have the deviations."""
    rng, (mean, covariance) = np.random.default_rng(seed), prior_of(NAMES, prior)
    half = np.linalg.inv(prior_root(NAMES, None)).T @ rng.normal(0.0, 1.0, (COUNT, COUNT))
    information, at = half @ half.T, rng.normal(0.0, 0.01, COUNT)
    precision = information + np.linalg.inv(covariance)
    deviation = np.linalg.solve(precision, information @ at + np.linalg.solve(covariance, mean))
    nominal = rng.normal(0.0, 1.0, COUNT)
    known = JointKnowledge(nominal=nominal, fitted=nominal + deviation, covariance=np.linalg.inv(precision))
    return known, information, at


@pytest.mark.parametrize("prior", [None, SAID], ids=["anatomy", "study"])
@pytest.mark.parametrize("anew", [False, True], ids=["one static trial", "two"])
def test_both_sessions_together_are_the_dense_normal_distribution(anew: bool, prior: JointPrior | None) -> None:
    """[d_A, d_B] ~ N([m0, m0], [P0, P0 - Q; P0 - Q, P0]), of which the markers see m = d + noise of S^-1."""
    (a, of_a, at_a), (b, of_b, at_b) = made_knowledge(0, prior), made_knowledge(1, prior)
    found = joined(NAMES, a, b, placed_anew=anew, prior=prior)
    mean, own = prior_of(NAMES, prior)
    same = own - (placed_anew() if anew else 0.0)
    whole = np.block([[own, same], [same, own]])
    gain = whole @ np.linalg.inv(whole + block_diag(np.linalg.inv(of_a), np.linalg.inv(of_b)))
    expected = np.tile(mean, 2) + gain @ (np.concatenate([at_a, at_b]) - np.tile(mean, 2))
    errors = np.sqrt(np.diag(whole - gain @ whole))
    assert np.concatenate([found.a - a.nominal, found.b - b.nominal]) == pytest.approx(expected, rel=CLOSE)
    assert np.concatenate(found.errors) == pytest.approx(errors, rel=CLOSE)
    if not anew:
        precision = of_a + of_b + np.linalg.inv(own)
        assert errors == pytest.approx(np.tile(np.sqrt(np.diag(np.linalg.inv(precision))), 2), rel=CLOSE)


def test_markers_put_on_anew_leave_joints_apart_and_bars_no_wider_than_alone() -> None:
    (a, *_), (b, *_) = made_knowledge(0), made_knowledge(1)
    found = joined(NAMES, a, b, placed_anew=True)
    assert np.abs((found.a - a.nominal) - (found.b - b.nominal)).max() > 1e-4
    for errors, alone, other in zip(found.errors, (a, b), (b, a), strict=True):
        assert (errors <= np.sqrt(np.diag(alone.covariance)) * (1.0 + CLOSE)).all()
        assert (errors < np.sqrt(np.diag(alone.covariance))).any(), other


def test_error_bars_hold_what_is_drawn_from_the_priors() -> None:
    """Many people: deviations that go together but for where markers were put, and noise of the markers."""
    rng, (mean, covariance) = np.random.default_rng(3), prior_of(NAMES, None)
    (_, of_a, _), (_, of_b, _) = made_knowledge(0), made_knowledge(1)
    anew, z = placed_anew(), []
    for _ in range(2000):
        person = rng.multivariate_normal(mean, covariance - anew)
        sessions = []
        for information in (of_a, of_b):
            true = person + rng.multivariate_normal(np.zeros(COUNT), anew)
            at = rng.multivariate_normal(true, np.linalg.inv(information))
            errors = np.linalg.inv(information + np.linalg.inv(covariance))
            fitted = errors @ (information @ at + np.linalg.solve(covariance, mean))
            sessions.append((true, JointKnowledge(nominal=np.zeros(COUNT), fitted=fitted, covariance=errors)))
        found = joined(NAMES, sessions[0][1], sessions[1][1], placed_anew=True)
        z.append([(found.a - sessions[0][0]) / found.errors[0], (found.b - sessions[1][0]) / found.errors[1]])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.03)  # 16000 draws, which go together in fours


def test_a_refused_session_has_no_say() -> None:
    with pytest.raises(InputError, match="b: is refused"):
        shared_joints(made_session("a"), made_session("b", verdict="refused"), Common.STATIC)
    with pytest.raises(InputError, match="not calibrated"):
        shared_joints(made_session("a", influence=None), made_session("b"), Common.STATIC)
    with pytest.raises(InputError, match="their studies expect other joints"):
        shared_joints(made_session("a"), made_session("b", prior=SAID), Common.STATIC)
