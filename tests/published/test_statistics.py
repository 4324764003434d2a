"""Distributions, the published criterion of convergence, expectation from marker distances, conclusions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitcal.model.coordinates import LEG_COORDINATES
from gaitcal.published.disturbance_claims import PUBLISHED, beside, conclusions
from gaitcal.published.draw import COLUMNS, LEG_TORQUES, TORQUES
from gaitcal.published.protocol import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.statistics import (
    FEWEST,
    TOLERANCE_PERCENT,
    expect,
    left_out,
    levels_of,
    settling,
    statistics,
    unconverged,
)

SCALE = {"jp": 1.0, "ip": 0.1, "both": np.hypot(1.0, 0.1), "noise": 0.1}


def made_up(
    draws: int = 400, levels: tuple[int, ...] = (25, 50, 100), sets: tuple[str, ...] = tuple(SCALE)
) -> pd.DataFrame:
    """Errors that grow with the level: RMS 0.01 x scale x level (foot twice that), markers 0.12 mm a per cent."""
    rng = np.random.default_rng(8)
    parts = []
    for name in sets:
        for level in levels:
            spread = rng.uniform(0.8, 1.2, (draws, 1))
            values = {}
            for column in COLUMNS:
                base = 0.01 * SCALE[name] * level * (2.0 if ".foot." in column else 1.0)
                if column.startswith("markers"):
                    base = 0.0 if name == "ip" else 0.12 * level * (0.5 if name == "noise" else 1.0)
                sign = rng.choice([-1.0, 1.0], draws) if column.endswith(".mean") and "markers" not in column else 1.0
                values[column] = base * spread[:, 0] * sign
            keys = {"set": name, "level": level, "draw": np.arange(draws), "evaluations": 5, "failure": ""}
            parts.append(pd.DataFrame({**keys, **values}))
    return pd.concat(parts, ignore_index=True)


def test_distributions() -> None:
    draws = made_up()
    draws.loc[(draws["set"] == "jp") & (draws["draw"] < 3), "failure"] = "did not settle"
    draws.loc[draws["failure"] != "", list(COLUMNS)] = 1e6  # must not enter the distribution
    table = statistics(draws)
    row = levels_of(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT).iloc[-1]
    good = draws[(draws["set"] == "jp") & (draws["level"] == 100) & (draws["failure"] == "")]
    values = good["knee_angle_l.foot.rms"].to_numpy()
    assert row["level"] == 100
    assert (row["draws"], row["failed"]) == (397, 3)
    assert row["average"] == pytest.approx(values.mean())
    assert [row[f"p{p}"] for p in (10, 25, 50, 75, 90)] == pytest.approx(
        np.percentile(values, [10, 25, 50, 75, 90]).tolist()
    )
    signed = levels_of(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT, "mean").iloc[-1]
    sizes = levels_of(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT, "abs_mean").iloc[-1]
    assert abs(signed["average"]) < 0.2 * sizes["average"]
    assert sizes["average"] == pytest.approx(good["knee_angle_l.foot.mean"].abs().mean())
    assert len(table) == 4 * 3 * (2 * len(LEG_TORQUES) * 3 + 4)


def test_settling_is_the_published_criterion() -> None:
    rng = np.random.default_rng(9)
    values = rng.uniform(0.5, 1.5, 1000)
    found = settling(values)
    runs = [np.array([f(values[:n]) for n in range(900, 1001)]) for f in (np.mean, lambda v: np.std(v) / np.mean(v))]
    expected = [100 * np.abs(run / run[-1] - 1).max() for run in runs]
    assert found == pytest.approx(tuple(expected))
    assert max(found) <= TOLERANCE_PERCENT
    drifting = np.concatenate([values, 3.0 + values[:100]])
    assert max(settling(drifting)) > TOLERANCE_PERCENT
    assert np.isnan(settling(values[:10])).all()
    assert settling(np.zeros(100)) == (0.0, 0.0)


def test_unconverged_looks_at_every_torque() -> None:
    draws = made_up(1000)
    assert unconverged(statistics(draws)).empty
    late = (draws["set"] == "both") & (draws["level"] == 50) & (draws["draw"] > 950)
    draws.loc[late, "ankle_angle_r.foot.rms"] *= 4
    found = unconverged(statistics(draws))
    assert found[["set", "level", "quantity", "grf"]].to_numpy().tolist() == [["both", 50, "ankle_angle_r", "foot"]]


def test_expectation_from_a_marker_distance() -> None:
    table = statistics(made_up())
    jp, noise = expect(table, 4.5)
    assert (jp.varied, noise.varied) == (Varied.JP, Varied.NOISE)
    assert jp.level == pytest.approx(4.5 / 0.12, rel=0.02)
    assert noise.level == pytest.approx(4.5 / 0.06, rel=0.02)
    assert not jp.beyond
    knee = jp.torques[(jp.torques["torque"] == "knee_angle_l") & (jp.torques["grf"] == "lab")].iloc[0]
    assert knee["average"] == pytest.approx(0.01 * jp.level, rel=0.02)
    assert knee["p10"] < knee["p50"] < knee["p90"]
    far_jp, far_noise = expect(table, 9.0)
    assert (far_jp.beyond, far_noise.beyond, far_noise.level) == (False, True, 100.0)
    assert expect(table, 0.0)[0].level == 0.0
    (below, _), first = expect(table, 1.5), levels_of(table, Varied.JP, "knee_angle_l", ReactionFrame.LAB).iloc[0]
    knee = below.torques[(below.torques["torque"] == "knee_angle_l") & (below.torques["grf"] == "lab")].iloc[0]
    assert below.level < first["level"]
    assert knee["average"] == pytest.approx(first["average"] * below.level / first["level"])  # a line from nothing
    assert expect(statistics(made_up(sets=("ip",))), 4.0) == ()


def test_conclusions_hold_where_they_do_and_fail_where_they_do_not() -> None:
    table = statistics(made_up())
    found = conclusions(table)
    assert len(found) == 8
    assert {c.verdict for c in found} == {"holds"}
    assert "10.0" in next(c.numbers for c in found if c.claim == "joint parameters dominate")
    assert "limit 0.25" in next(c.numbers for c in found if c.claim == "marker noise matters little")
    worse = table.copy()
    worse.loc[worse["set"] == "ip", ["average"]] *= 20
    assert {c.claim for c in conclusions(worse) if not c.holds} == {
        "joint parameters dominate",
        "inertial parameters matter little",
        "no interaction",
    }
    noisy = table.copy()
    noisy.loc[(noisy["set"] == "noise") & (noisy["quantity"] == "hip_flexion_l"), "average"] *= 3
    assert {c.claim for c in conclusions(noisy) if not c.holds} == {"marker noise matters little"}
    assert (noisy[noisy["set"] == "noise"]["average"].max()) < table[table["set"] == "jp"]["average"].max()
    smaller = table.copy()  # noise is far below the IP's limit, but joint parameters are smaller still
    smaller.loc[smaller["set"].isin(("jp", "both")), "average"] *= 0.05
    assert "marker noise matters little" in {c.claim for c in conclusions(smaller) if not c.holds}
    mingled = table.copy()
    mingled.loc[mingled["set"] == "both", "average"] *= 1.17
    assert {c.claim for c in conclusions(mingled) if not c.holds} == {"no interaction"}
    assert conclusions(statistics(made_up(sets=("noise",)))) == ()


def test_few_draws_are_not_judged() -> None:
    few = conclusions(statistics(made_up(FEWEST - 1)))
    assert {(c.holds, c.verdict) for c in few} == {(None, f"not judged: {FEWEST - 1} draws")}
    assert all(c.numbers for c in few)
    assert {c.verdict for c in conclusions(statistics(made_up(FEWEST)))} == {"holds"}
    draws = made_up(FEWEST)
    draws.loc[(draws["set"] == "noise") & (draws["draw"] == 0), "failure"] = "did not settle"
    told = {c.claim: c.verdict for c in conclusions(statistics(draws))}
    assert told["marker noise matters little"] == f"not judged: {FEWEST - 1} draws"
    assert told["no interaction"] == "holds"


def test_an_interaction_that_chance_could_make_is_not_judged() -> None:
    """Far more scatter than in `made_up`, so that three standard errors are wider than the limit."""
    table = statistics(made_up(FEWEST))
    table.loc[table["set"] == "both", "sd"] = 0.5 * table["average"]
    told = {c.claim: c.verdict for c in conclusions(table)}
    assert told["no interaction"] == f"not judged: {FEWEST} draws"
    assert told["joint parameters dominate"] == "holds"


def test_draws_left_out_are_counted_by_cell() -> None:
    draws = made_up(10)
    assert left_out(statistics(draws)).empty
    draws.loc[(draws["set"] == "jp") & (draws["level"] == 50) & (draws["draw"] < 3), "failure"] = "did not settle"
    assert left_out(statistics(draws)).to_dict("records") == [{"set": "jp", "level": 50, "draws": 7, "failed": 3}]


def test_published_figures_stand_beside_ours_only_where_they_mean_the_same() -> None:
    table = statistics(made_up())
    flexion, inertial = PUBLISHED[0], PUBLISHED[-1]
    ours = beside(table, flexion, MonteCarloSettings())
    assert ours[ReactionFrame.LAB] == pytest.approx(1.0, rel=0.02)
    assert ours[ReactionFrame.FOOT] == pytest.approx(2.0, rel=0.02)
    assert beside(table, inertial, MonteCarloSettings()) == {}
    assert set(beside(table, inertial, MonteCarloSettings(inertial_percent=50.0))) == set(ReactionFrame)
    assert beside(statistics(made_up(levels=(25, 50))), flexion, MonteCarloSettings()) == {}
    assert TORQUES == LEG_COORDINATES
