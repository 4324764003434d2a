"""One centre of pressure for both feet: the total wrench stays, the lines of both forces become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.montecarlo.case import nominal_case
from gaitcal.montecarlo.leg_torques import TORQUES
from gaitcal.montecarlo.settings import ReactionFrame
from gaitcal.reproduction.claims import Verdict
from gaitcal.reproduction.pressure_centre import (
    OWN,
    SHARED,
    VERTICAL,
    PressureCentres,
    pressure_centre_claims,
    pressure_centre_rows,
    pressure_centres,
    with_shared_centre,
)


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


def _centres(own: tuple[float, float, float], shared: tuple[float, float, float]) -> PressureCentres:
    def errors(figures: tuple[float, float, float]) -> np.ndarray:
        out = np.full(len(TORQUES), 0.3)
        out[[TORQUES.index(t) for t in ("hip_flexion", "hip_adduction", "knee_angle")]] = figures
        return out

    return PressureCentres({c: dict.fromkeys(ReactionFrame, errors(f)) for c, f in ((OWN, own), (SHARED, shared))}, 9)


def test_claims_follow_the_figures() -> None:
    printed, far, as_far = (
        (4.14, 1.06, 0.92),
        (1.4, 4.2, 0.9),
        (4.14 / 1.4 * 4.14, 1.06 / 4.2 * 1.06, 0.92 / 0.9 * 0.92),
    )
    assert {c.verdict for c in pressure_centre_claims(_centres(printed, far))} == {Verdict.HOLDS}
    assert {c.verdict for c in pressure_centre_claims(_centres(far, printed))} == {Verdict.FAILS}
    assert "factor of 1.00 off (2.29)" in pressure_centre_claims(_centres(printed, far))[0].ours
    assert "hip adduction changes most: 1.06 (4.20)" in pressure_centre_claims(_centres(printed, far))[0].ours
    assert "factor of 2.29 off (2.29)" in pressure_centre_claims(_centres(as_far, far))[0].ours
    assert [c.verdict for c in pressure_centre_claims(None)] == [Verdict.NOT_RUN] * 2


def test_draws_are_those_of_the_study() -> None:
    found = pressure_centres(0, 2, jobs=1)
    again = pressure_centres(0, 2, jobs=1)
    for centre in (OWN, SHARED):
        for frame in ReactionFrame:
            np.testing.assert_array_equal(found.errors[centre][frame], again.errors[centre][frame])
            assert (found.errors[centre][frame] > 0).all()
    rows = pressure_centre_rows(found)
    assert len({(r.row, r.column) for r in rows}) == len(rows) == 2 * 2 * 7
    knee = next(r for r in rows if r.column == "knee flexion" and OWN in r.row and "carried" in r.row)
    expected = found.errors[OWN][ReactionFrame.FOOT][TORQUES.index("knee_angle")]
    assert (knee.published, knee.ours) == (0.92, pytest.approx(expected))
