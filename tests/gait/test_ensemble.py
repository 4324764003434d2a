"""Means and spreads of strides: against plain loops, against variances that we put in, and sample by sample."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import InputError
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, ensemble, spread

WITHIN, BETWEEN, OWN, SHARED = 2.0, 3.0, 1.5, 4.0
EXACT = 1e-10


def table(values: dict[tuple[str, str, int], np.ndarray], valid: np.ndarray | None = None) -> pd.DataFrame:
    """Strides of one variable: (trial, side, stride) -> (m,) values."""
    rows = []
    for (trial, side, stride), curve in values.items():
        for percent, value in enumerate(curve):
            rows.append(
                {
                    "person": "p", "session": "", "trial": trial, "side": side, "stride": stride, "percent": percent,
                    "variable": "knee_angle", "value": value, "se": np.hypot(OWN, SHARED), "valid": 1,
                    "se_stride": OWN,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_statistics_are_those_of_plain_loops_over_what_is_valid(sizes: list[int], seed: int) -> None:
    """Whatever the numbers of strides in trials, with samples missing anywhere."""
    rng = np.random.default_rng(seed)
    trials = np.repeat(np.arange(len(sizes)), sizes)
    values = rng.normal(size=(len(trials), 6))
    values[rng.uniform(size=values.shape) < 0.3] = np.nan
    found = spread(values, trials)
    for point in range(6):
        there = np.isfinite(values[:, point])
        y, of = values[there, point], trials[there]
        groups = [y[of == t] for t in sorted(set(of.tolist()))]
        n, k = len(y), len(groups)
        assert (found.n[point], found.trials[point]) == (n, k)
        if not n:
            assert np.isnan([found.mean[point], found.sd[point]]).all()
            continue
        assert found.mean[point] == pytest.approx(y.mean(), abs=EXACT)
        assert found.sd[point] == pytest.approx(np.std(y, ddof=1) if n > 1 else np.nan, nan_ok=True)
        if n == k:
            assert np.isnan(found.sd_within[point]) and np.isnan(found.sd_between[point])
            continue
        within = sum(((g - g.mean()) ** 2).sum() for g in groups) / (n - k)
        assert found.sd_within[point] == pytest.approx(np.sqrt(within), abs=1e-7)
        if k == 1:
            assert np.isnan(found.sd_between[point])
        else:
            size = (n - sum(len(g) ** 2 for g in groups) / n) / (k - 1)
            apart = sum(len(g) * (g.mean() - y.mean()) ** 2 for g in groups) / (k - 1)
            assert found.sd_between[point] == pytest.approx(np.sqrt(max((apart - within) / size, 0.0)), abs=1e-6)


def test_variances_that_were_put_in_come_out() -> None:
    """Many trials of three strides, with an error that all share: it moves the mean, and is in no spread."""
    rng = np.random.default_rng(1)
    trials, strides, points = 40, 3, 400
    shape = (trials, strides, points)
    values = BETWEEN * rng.normal(size=(trials, 1, points)) + WITHIN * rng.normal(size=shape)
    values = values + OWN * rng.normal(size=shape) + SHARED * rng.normal(size=points)
    labels = np.repeat(np.arange(trials), strides)
    own, total = np.full((len(labels), points), OWN), np.full((len(labels), points), np.hypot(OWN, SHARED))
    found = spread(values.reshape(-1, points), labels, own, total)
    rms = {name: float(np.sqrt(np.mean(getattr(found, name) ** 2))) for name in ("sd_within", "sd_between", "sd_error")}
    assert rms["sd_within"] == pytest.approx(np.hypot(WITHIN, OWN), rel=0.02)
    assert rms["sd_between"] == pytest.approx(BETWEEN, rel=0.03)
    assert rms["sd_error"] == pytest.approx(OWN)
    # The mean misses 0 by what all share and by little more: its standard error says so.
    assert float(np.sqrt(np.mean(found.mean**2))) == pytest.approx(SHARED, rel=0.1)
    assert found.se == pytest.approx(np.sqrt(SHARED**2 + found.sd**2 / len(labels)))


def test_one_stride_has_its_own_standard_error_and_no_spread() -> None:
    found = ensemble(table({("a", "r", 1): np.arange(4.0)}))
    assert tuple(found.columns) == ENSEMBLE_COLUMNS
    assert found["mean"].tolist() == [0.0, 1.0, 2.0, 3.0] and found["sd"].isna().all()
    np.testing.assert_allclose(found["se"], np.hypot(OWN, SHARED))
    assert (found["n"] == 1).all()


def test_samples_that_are_not_valid_are_left_out_percent_by_percent_and_sides_stay_apart() -> None:
    strides = table({("a", "r", 1): np.full(3, 1.0), ("b", "r", 1): np.full(3, 3.0), ("a", "l", 1): np.full(3, 9.0)})
    strides.loc[(strides["trial"] == "b") & (strides["percent"] == 1), "valid"] = 0
    found = ensemble(strides)
    right = found[found["side"] == "r"]
    assert right["n"].tolist() == [2, 1, 2] and right["mean"].tolist() == [2.0, 1.0, 2.0]
    assert right["trials"].tolist() == [2, 1, 2]
    assert found[found["side"] == "l"]["mean"].tolist() == [9.0] * 3


def test_the_order_of_rows_is_no_matter() -> None:
    rng = np.random.default_rng(3)
    strides = table({(t, s, k): rng.normal(size=5) for t, s, k in itertools.product("ab", "rl", (1, 2))})
    mixed = strides.sample(frac=1.0, random_state=4)
    keys = ["side", "percent"]
    one, other = (ensemble(t).sort_values(keys, ignore_index=True) for t in (strides, mixed))
    pd.testing.assert_frame_equal(one, other)


def test_people_and_sessions_are_apart_and_a_stride_twice_is_refused() -> None:
    strides = table({("a", "r", 1): np.zeros(3)})
    later = strides.assign(session="second", value=5.0)
    found = ensemble(pd.concat([strides, later], ignore_index=True))
    assert found.groupby("session")["mean"].mean().to_dict() == {"": 0.0, "second": 5.0}
    with pytest.raises(
        InputError, match="found stride 1 of a, side r, twice; allowed: once for each person and session"
    ):
        ensemble(pd.concat([strides, strides], ignore_index=True))


def test_without_standard_errors_there_is_no_error_and_without_strides_no_row() -> None:
    found = ensemble(table({("a", "r", 1): np.zeros(3), ("a", "r", 2): np.ones(3)}).drop(columns=["se", "se_stride"]))
    assert found["sd_error"].isna().all() and found["se"].isna().all() and found["sd_within"].notna().all()
    assert ensemble(table({}).reindex(columns=[*ENSEMBLE_COLUMNS])).empty
