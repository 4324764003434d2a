"""Re-fits that are stopped: claims follow the figures; every number of iterations stands beside what is printed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitcal.published.claims import Verdict
from gaitcal.published.draw_sensitivity import (
    CONVERGED,
    Iteration,
    StoppedRefits,
    iteration_frame,
    refit_claims,
    refit_rows,
    stopped_refits,
)
from gaitcal.published.protocol import ReactionFrame, Varied
from tests.published.test_disturbance_claims import AS_PUBLISHED, disturbed_table

KEYS = [(iteration, count) for iteration in Iteration for count in iteration.counts]
SOME = [(i, count) for i, count in KEYS if count == 2 or (i is Iteration.GAUSS_NEWTON and count in (0, 1, CONVERGED))]
TWICE = {torque: 2 * value for torque, value in AS_PUBLISHED.items()}


def _stopped(like_printed: tuple[Iteration, int] | None, markers: tuple[Iteration, int] | None) -> StoppedRefits:
    """Torques as printed after one number of iterations, and marker errors as printed after one."""
    tables = {
        key: disturbed_table(AS_PUBLISHED if key == like_printed else TWICE, jp_mm=28.0 if key == markers else 12.0)
        for key in SOME
    }
    return StoppedRefits(tables, 40)


def test_both_at_once() -> None:
    second = (Iteration.GAUSS_NEWTON, 2)
    for claim in refit_claims(_stopped(second, second)):
        assert claim.verdict is Verdict.HOLDS
        assert "both at once: Gauss-Newton 2." in claim.ours


def test_one_after_the_other_is_not_at_once() -> None:
    for claim in refit_claims(_stopped((Iteration.GAUSS_NEWTON, 2), (Iteration.STEEPEST_DESCENT, 2))):
        assert claim.verdict is Verdict.FAILS
        assert "marker errors: steepest descent 2; printed torque errors: Gauss-Newton 2; both" in claim.ours
        assert "both at once: at none of those tried." in claim.ours
        assert "(0, 1, 2, 3, 5, 10 of Gauss-Newton; 0, 1, 2, 3, 5, 10, 30 of steepest descent; the end)" in claim.claim
        assert "; steepest descent 2: 6.0 mm" not in claim.ours
        assert "; steepest descent 2: 14.0 mm" in claim.ours
    assert {c.verdict for c in refit_claims(None)} == {Verdict.NOT_RUN}
    assert [c.claim for c in refit_claims(None)] == [c.claim for c in refit_claims(_stopped(None, None))]


@pytest.fixture(scope="module")
def stopped() -> StoppedRefits:
    return stopped_refits(0, 1, jobs=1)


def test_files_and_rows(stopped: StoppedRefits) -> None:
    frame = iteration_frame(stopped)
    ours = frame[frame["iteration"] != "printed"]
    assert len(ours) == len(KEYS) * 2 * 4
    assert len(frame) == len(ours) + 3
    at = frame.set_index(["set", "level", "iteration", "iterations"])
    table = stopped.tables[Iteration.GAUSS_NEWTON, 1]
    rows = table[(table["set"] == "jp") & (table["level"] == 75) & (table["measure"] == "rms")]
    for column, quantity, grf in (("markers_mm", "markers_l", ""), ("knee_angle.foot", "knee_angle_l", "foot")):
        wanted = rows[(rows["quantity"] == quantity) & (rows["grf"] == grf)]["average"]
        assert at.loc[("jp", 75, "Gauss-Newton", "1"), column] == pytest.approx(wanted.item(), abs=1e-5)
    printed = {(r.row, r.column): r for r in refit_rows(stopped)}
    assert len(printed) == (len(KEYS) - 1) * (2 + 3 * len(ReactionFrame))
    first = printed["Monte Carlo, JP 50 %: Gauss-Newton, 0 iterations", "marker distance RMS"]
    assert first.published == 14.0
    assert first.ours == pytest.approx(at.loc[("jp", 50, "Gauss-Newton", "0"), "markers_mm"], abs=1e-5)
    end = printed["Monte Carlo, JP 100 %: re-fit to the end", "hip flexion, carried with the foot"]
    assert end.published == 4.14
    assert end.ours == pytest.approx(at.loc[("jp", 100, "Gauss-Newton", "converged"), "hip_flexion.foot"], abs=1e-5)


def test_nothing_of_the_torques_moves_with_noise_before_the_first_step(stopped: StoppedRefits) -> None:
    table = stopped.tables[Iteration.GAUSS_NEWTON, 0]
    noise = table[(table["set"] == Varied.NOISE.value) & (table["grf"] != "")]
    np.testing.assert_allclose(noise["average"], 0.0, atol=1e-9)
    end = stopped.tables[Iteration.GAUSS_NEWTON, CONVERGED]
    pd.testing.assert_frame_equal(end, stopped.tables[Iteration.STEEPEST_DESCENT, CONVERGED])
