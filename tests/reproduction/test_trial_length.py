"""Isolated trials of another length: the same movement and the same noise, more slowly."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.reproduction.claims import Verdict
from gaitcal.reproduction.joint_recovery import synthetic_problem, true_motion
from gaitcal.reproduction.noise_seed import SeedResult
from gaitcal.reproduction.published import PROBLEMS
from gaitcal.reproduction.trial_length import (
    CAMERAS_HZ,
    PARAMETER_ROWS,
    LengthDraws,
    trial_length_claims,
    trial_length_rows,
    trial_lengths,
)
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
    assert len(rows) == 2 * (4 + 7 + 1)
    assert not {(r.row, r.column) for r in rows if r.row.count("6 s")} & {
        (r.row, r.column) for r in rows if "20 s" in r.row
    }
    assert [c.verdict for c in trial_length_claims(lengths)] == [Verdict.NOT_RUN] * 2  # two draws tell nothing
    many = [LengthDraws(length.rate, length.problems * 15) for length in lengths]
    assert all(c.verdict is not Verdict.NOT_RUN for c in trial_length_claims(many))
    assert [c.claim for c in trial_length_claims(None)] == [c.claim for c in trial_length_claims(many)]
