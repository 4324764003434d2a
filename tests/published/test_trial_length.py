"""Isolated trials of another length: the same movement and the same noise, more slowly."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.inertial_recovery import SeedResult
from gaitcal.published.joint_recovery import synthetic_problem, true_motion
from gaitcal.published.noise_sensitivity import (
    CAMERAS_HZ,
    PARAMETER_ROWS,
    PRINTED,
    LengthDraws,
    trial_length_claims,
    trial_length_rows,
    trial_lengths,
)
from gaitcal.published.protocol import PROBLEMS, table_one
from gaitcal.synthetic.motion import RATE


@pytest.fixture(scope="module")
def lengths() -> list[LengthDraws]:
    return trial_lengths(0, 2, jobs=1)


def test_the_movement_is_the_same() -> None:
    for problem in PROBLEMS[:3]:
        usual, slow = true_motion(problem), true_motion(problem, CAMERAS_HZ)
        assert slow.basis.time[-1] == pytest.approx(1199 / 60)
        np.testing.assert_allclose(slow.q, usual.q, atol=1e-12)
    assert true_motion("full leg", CAMERAS_HZ).basis.time[-1] == true_motion("full leg").basis.time[-1]


def test_the_noise_is_as_fast_as_ever() -> None:
    noises = []
    for rate in (RATE, CAMERAS_HZ):
        exact, noisy = (synthetic_problem("hip", g, rate) for g in (None, np.random.default_rng(1)))
        noises.append((exact.basis.time, noisy.data.measured - exact.data.measured))
    (short, fast), (long, slow) = noises
    common = np.isclose(np.mod(long * RATE, 1.0), 0.0, atol=1e-9) & (long <= short[-1])
    places = np.rint(long[common] * RATE).astype(int)
    assert len(places) > 100
    np.testing.assert_allclose(slow[..., common], fast[..., places], atol=1e-9)


@pytest.mark.slow
def test_at_the_usual_rate_they_are_the_draws_of_the_tables(
    lengths: list[LengthDraws], draws: list[SeedResult]
) -> None:
    usual, slow = lengths
    assert (usual.rate, slow.rate, usual.seconds, slow.seconds) == (RATE, CAMERAS_HZ, 6.0, 20.0)
    assert len(PARAMETER_ROWS) == 7
    for problem in PROBLEMS:
        for ours, one in zip(usual.problems, draws, strict=True):
            np.testing.assert_array_equal(ours[problem].errors, one.joints[problem].errors)
    assert (slow.values("hip", "position_mm") != usual.values("hip", "position_mm")).all()


def test_rows_and_claims(lengths: list[LengthDraws]) -> None:
    rows = trial_length_rows(lengths)
    assert len(rows) == 2 * (4 + 7 + 2)
    assert not {(r.row, r.column) for r in rows if r.row.count("6 s")} & {
        (r.row, r.column) for r in rows if "20 s" in r.row
    }
    (few,) = trial_length_claims(lengths)
    assert few.verdict is Verdict.NOT_RUN  # two draws tell nothing
    (not_run,) = trial_length_claims(None)
    assert (not_run.verdict, not_run.claim) == (Verdict.NOT_RUN, few.claim)


class _Fixed(LengthDraws):
    """Draws of the seven figures, without the searches behind them."""

    def values(self, problem: str, key: str) -> np.ndarray:
        rng = np.random.default_rng([PROBLEMS.index(problem), len(key)])
        return (self.rate / CAMERAS_HZ) * (table_one(PRINTED, key)[problem] or 0.0) * rng.lognormal(size=200)


def test_the_claim_follows_the_rank_sum_and_tells_both_p_with_errors() -> None:
    def claim(first: float, last: float) -> Claim:
        return trial_length_claims([_Fixed(CAMERAS_HZ * first, [{}] * 200), _Fixed(CAMERAS_HZ * last, [{}] * 200)])[0]

    assert claim(3.0, 1.0).verdict is Verdict.HOLDS
    assert claim(1.0, 1.0).verdict is Verdict.FAILS
    assert claim(3.0, 3.0).verdict is Verdict.FAILS
    told = claim(3.0, 1.0).ours
    assert told.count("low rank sum p = ") == told.count("distance p = ") == 2
    assert told.count(" +- ") == 4
    assert "ordinary" not in told + claim(3.0, 1.0).claim
    low = _Fixed(3 * CAMERAS_HZ, [{}] * 200)
    assert low.low.p < 0.02 < low.joint.p  # low in every row, and not far in any
