"""What recordings of one person say by themselves, against the plain Bayesian estimate that it is taken out of."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration.error_sources import ErrorSources, nominal_errors
from gaitcal.calibration.joint_prior import prior_of, prior_of_study, prior_root
from gaitcal.cohort.person_evidence import PARTS, parts_of
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import ParameterPriorTable

CLOSE = 1e-6
"""Relative: of matrices of 1e-4 to 1e4 in m, rad that are inverted twice."""
LEGS = PARTS["legs"]
UNSEEN = 10
OTHER = prior_of_study(
    {
        "hip.pelvis.ant": ParameterPriorTable(mean=-7.0, deviation=6.0),
        "hip_l.thigh.ant": ParameterPriorTable(deviation=5.0),
        "knee.thigh.trans": ParameterPriorTable(mean=2.0),
    }
)


def fitted(names: tuple[str, ...], prior: JointPrior | None) -> tuple[ErrorSources, np.ndarray, np.ndarray, np.ndarray]:
    """Errors and deviations (98,) of a fit, all other parameters nominal; and S, S m of its markers."""
    rng, (mean, covariance) = np.random.default_rng(4), prior_of(names, prior)
    half = np.linalg.inv(prior_root(names, None)).T @ rng.normal(0.0, 2.0, (len(names), len(names) - UNSEEN))
    information, at = half @ half.T, rng.normal(0.0, 0.01, len(names))
    precision = information + np.linalg.inv(covariance)
    found = np.linalg.solve(precision, information @ at + np.linalg.solve(covariance, mean))
    others = tuple(name for name in JP_NAMES if name not in names)
    left = nominal_errors(others, prior)
    errors = np.zeros((len(JP_NAMES),) * 2)
    errors[: len(names), : len(names)] = np.linalg.cholesky(np.linalg.inv(precision))
    errors[len(names) :, len(names) :] = left.parameters
    influence = ErrorSources(
        (*names, *others), errors, (*(f"markers/walk/{k}" for k in range(len(names))), *left.clusters)
    )
    deviation = np.zeros(len(JP_NAMES))
    deviation[[JP_INDEX[name] for name in names]] = found
    return influence, deviation, information, information @ at


@pytest.mark.parametrize("prior", [None, OTHER], ids=["anatomy", "study"])
@pytest.mark.parametrize("names", [LEGS, tuple(n for n in LEGS if "_r." in n)], ids=["both legs", "one"])
def test_the_prior_of_the_fit_is_taken_out_and_what_no_trial_moved_tells_nothing(
    names: tuple[str, ...], prior: JointPrior | None
) -> None:
    influence, deviation, information, right = fitted(names, prior)
    parts = parts_of(influence, deviation, JP_NAMES, prior)
    assert parts is not None
    unit, origin = prior_root(LEGS, None)[[LEGS.index(name) for name in names]], prior_of(names, None)[0]
    wanted, pulled = unit.T @ information @ unit, unit.T @ (right - information @ origin)
    np.testing.assert_allclose(parts["legs"].information, wanted, atol=CLOSE * np.abs(wanted).max())
    np.testing.assert_allclose(parts["legs"].right, pulled, atol=CLOSE * np.abs(pulled).max())
    assert not parts["trunk and arms"].information.any() and not parts["trunk and arms"].right.any()


def test_exact_errors_are_no_evidence() -> None:
    influence, deviation, *_ = fitted(LEGS, None)
    exact = ErrorSources(
        influence.free, influence.parameters * (np.arange(len(JP_NAMES)) != len(LEGS) - 1), influence.clusters
    )
    assert parts_of(exact, deviation, JP_NAMES, None) is None
