"""One centre of pressure for both feet: the total wrench stays, the lines of both forces become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gaitcal.published.case import nominal_case
from gaitcal.published.claims import Verdict
from gaitcal.published.draw import TORQUES
from gaitcal.published.draw_sensitivity import (
    OWN,
    SHARED,
    VERTICAL,
    PressureCentres,
    pressure_centre_claims,
    pressure_centre_rows,
    pressure_centres,
    with_shared_centre,
)
from gaitcal.published.protocol import ReactionFrame


def test_the_sum_stays_and_the_centres_meet() -> None:
    case = nominal_case()
    wrench = case.wrench.copy()
    # Whatever the built-in person's are: forces of the feet that do not lie on one line.
    apart = np.array([0.0, 0.0, 0.0, 12.0, -3.0, 20.0])
    wrench[:, 0] += apart
    wrench[:, 1] -= apart
    wrench[:, 0, 0] += 30.0
    wrench[:, 1, 0] -= 30.0
    shared = with_shared_centre(replace(case, wrench=wrench)).wrench
    np.testing.assert_allclose(shared.sum(axis=1), wrench.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(shared[:, :, VERTICAL], wrench[:, :, VERTICAL], atol=1e-9)
    both = (shared[:, :, VERTICAL] > 20.0).all(axis=1)
    assert both.sum() > 10
    per_newton = shared[both] / shared[both][:, :, [VERTICAL]]
    np.testing.assert_allclose(per_newton[:, 0], per_newton[:, 1], atol=1e-9)
    again = with_shared_centre(replace(case, wrench=shared)).wrench
    np.testing.assert_allclose(again, shared, atol=1e-9)


def test_a_frame_without_ground_is_divided_evenly() -> None:
    case = nominal_case()
    wrench = case.wrench.copy()
    wrench[5] = 0.0
    assert not with_shared_centre(replace(case, wrench=wrench)).wrench[5].any()


def _centres(change: float, scatter: float = 0.0) -> PressureCentres:
    """Errors of 20 draws; with one centre the printed ones are so much larger, and the subtalar one twice as large."""
    rng = np.random.default_rng(0)
    own = rng.lognormal(size=(20, len(TORQUES)))
    shared = own * (1.0 + change + scatter * rng.normal(size=own.shape))
    shared[:, TORQUES.index("subtalar_angle")] = 2.0 * own[:, TORQUES.index("subtalar_angle")]
    return PressureCentres({c: dict.fromkeys(ReactionFrame, e) for c, e in ((OWN, own), (SHARED, shared))})


def test_claims_follow_the_size_of_the_difference_and_not_its_sign() -> None:
    for sign in (1, -1):
        assert {c.verdict for c in pressure_centre_claims(_centres(0.01 * sign))} == {Verdict.HOLDS}
        assert {c.verdict for c in pressure_centre_claims(_centres(0.2 * sign))} == {Verdict.FAILS}
    assert {c.verdict for c in pressure_centre_claims(_centres(0.04, scatter=0.2))} == {Verdict.UNDECIDED}
    claim, _ = pressure_centre_claims(_centres(0.01, scatter=0.05))
    assert claim.claim.startswith("it makes no difference")
    assert claim.ours.count(" +- ") == 3
    assert "subtalar" in claim.ours.split("changes most")[0].rsplit("torques", 1)[1]
    assert claim.ours.endswith("-50 %")
    assert [c.verdict for c in pressure_centre_claims(None)] == [Verdict.NOT_RUN] * 2


def test_the_error_is_that_of_pairs() -> None:
    centres = _centres(0.0, scatter=0.01)
    apart = centres.drawn[OWN][ReactionFrame.LAB] - centres.drawn[SHARED][ReactionFrame.LAB]
    change, error = centres.difference(ReactionFrame.LAB)
    np.testing.assert_allclose(change, apart.mean(axis=0))
    np.testing.assert_allclose(error, stats.sem(apart, axis=0))


def test_draws_are_those_of_the_study() -> None:
    found = pressure_centres(0, 2, jobs=1)
    again = pressure_centres(0, 2, jobs=1)
    for centre in (OWN, SHARED):
        for frame in ReactionFrame:
            np.testing.assert_array_equal(found.drawn[centre][frame], again.drawn[centre][frame])
            assert (found.drawn[centre][frame] > 0).all()
    rows = pressure_centre_rows(found)
    assert len({(r.row, r.column) for r in rows}) == len(rows) == 2 * 2 * 7
    knee = next(r for r in rows if r.column == "knee flexion" and OWN in r.row and "carried" in r.row)
    expected = found.errors(OWN, ReactionFrame.FOOT)[TORQUES.index("knee_angle")]
    assert (knee.published, knee.ours) == (0.92, pytest.approx(expected))
