"""`cycles.csv`: every stride of every walk over 0 to 100 %, with the validity of its leg."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.gait.cycles import POINTS
from gaitcal.gait.strides import strides_of
from gaitcal.person.result import Calibration
from gaitcal.results.cycles import CYCLE_COLUMNS, CYCLE_HEADER, cycle_table, write_cycles
from gaitcal.results.table_file import read_csv
from tests.fake_result import fake_calibration

ROUNDED = 1e-6


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


def one(table: pd.DataFrame, side: str, variable: str) -> pd.DataFrame:
    rows: pd.DataFrame = table[(table["side"] == side) & (table["variable"] == variable) & (table["stride"] == 1)]
    return rows


def test_every_stride_has_every_variable_from_0_to_100_percent(whole: Calibration) -> None:
    table = cycle_table(whole.model, whole.trials)
    assert tuple(table.columns) == CYCLE_COLUMNS
    trial = whole.trial("walk")
    assert trial.loads is not None
    strides = strides_of(trial.events)
    for side, cycles in strides.items():
        own = table[(table["trial"] == "walk") & (table["side"] == side)]
        assert sorted(own["stride"].unique()) == list(range(1, len(cycles) + 1))
        for _, rows in own.groupby(["stride", "variable"]):
            assert rows["percent"].tolist() == list(range(POINTS))
    names = set(table["variable"])
    assert {
        "hip_flexion",
        "hip_flexion_moment",
        "knee_adduction_moment",
        "pelvis_tilt",
        "lumbar_bending_moment",
    } <= names
    assert not any(name.endswith(("_r", "_l", "_r_moment", "_tx")) for name in names)


def test_values_errors_and_validity_are_those_of_the_leg(whole: Calibration) -> None:
    """The left leg is not valid in the middle of its stride; the right leg knows nothing of that."""
    trial = whole.trial("walk")
    assert trial.loads is not None
    reactions = trial.loads.reactions
    stride = {side: cycles[0] for side, cycles in strides_of(trial.events).items()}
    time, left = trial.body.time, np.ones(len(trial.body.time), dtype=bool)
    middle = 0.5 * (stride["l"].start + stride["l"].stop)
    left[np.abs(time - middle) < 0.05] = False
    legs = np.stack([np.ones_like(left), left], axis=1)
    changed = replace(trial, loads=replace(trial.loads, reactions=replace(reactions, valid=left, valid_legs=legs)))
    table = cycle_table(whole.model, [changed])
    assert one(table, "r", "hip_flexion_moment")["valid"].all()
    of_left = one(table, "l", "hip_flexion_moment")
    assert not of_left["valid"].iloc[50] and of_left["valid"].iloc[[0, 30, 70, 100]].all()
    assert not one(table, "r", "lumbar_extension_moment")["valid"].all(), "the trunk needs both"
    at = stride["l"].start + (stride["l"].stop - stride["l"].start) * np.arange(POINTS) / 100
    k = trial.body.coordinates.index("hip_flexion_l")
    expected = np.interp(at, time, np.degrees(trial.body.q[:, k]))
    np.testing.assert_allclose(one(table, "l", "hip_flexion")["value"], expected, atol=ROUNDED)
    np.testing.assert_allclose(of_left["value"], np.interp(at, time, trial.loads.final.tau[:, k]), atol=ROUNDED)
    assert of_left["se"].notna().all()


def test_a_trial_without_strides_has_no_rows(whole: Calibration) -> None:
    table = cycle_table(whole.model, [t for t in whole.trials if t.joint])
    assert tuple(table.columns) == CYCLE_COLUMNS and table.empty


def test_relative_angles_are_those_of_the_static_posture_less(whole: Calibration) -> None:
    off = {"hip_flexion_l": np.radians(4.0), "pelvis_tilt": np.radians(9.0)}
    plain, relative = (cycle_table(whole.model, whole.trials, static) for static in (None, off))
    for variable, less in (("hip_flexion", 4.0), ("pelvis_tilt", 0.0), ("hip_flexion_moment", 0.0)):
        gap = one(plain, "l", variable)["value"].to_numpy() - one(relative, "l", variable)["value"].to_numpy()
        np.testing.assert_allclose(gap, less, atol=ROUNDED)


def test_nothing_of_a_refused_leg_counts_nor_of_pelvis_and_trunk(whole: Calibration) -> None:
    for legs in (("r",), ("r", "l")):
        table = cycle_table(whole.model, [whole.trial("walk").refused(legs)])
        counting = set(table.loc[table["valid"] == 1, "side"])
        assert counting == {"r", "l"} - set(legs)
        assert not table.loc[table["variable"].str.startswith(("pelvis", "lumbar")), "valid"].any()


def test_an_angle_counts_only_where_markers_show_its_segments(whole: Calibration) -> None:
    """No marker of the left shank in the middle of the stride: its knee and ankle are guessed there, not its hip."""
    trial = whole.trial("walk")
    stride, errors = strides_of(trial.events)["l"][0], trial.body.errors
    middle = np.abs(trial.body.time - 0.5 * (stride.start + stride.stop)) < 0.05
    distance, shank = errors.distance.copy(), np.array(errors.segments) == "shank_l"
    distance[np.ix_(middle, shank)] = np.nan
    body = replace(trial.body, errors=replace(errors, distance=distance))
    table = cycle_table(whole.model, [replace(trial, body=body)])
    for variable in ("knee_angle", "ankle_angle"):
        own = one(table, "l", variable)["valid"]
        assert not own.iloc[50] and own.iloc[[0, 30, 70, 100]].all()
        assert one(table, "r", variable)["valid"].all()
    assert one(table, "l", "hip_flexion")["valid"].all() and shank.any()


def test_the_file_says_first_which_trials_are_refused_and_keeps_what_was_there(
    whole: Calibration, tmp_path: Path
) -> None:
    walk = whole.trial("walk")
    write_cycles(tmp_path / "first.csv", whole.model, [walk.refused(("r",))], {"hip_flexion_r": 0.1})
    rows, lines = read_csv(tmp_path / "first.csv")
    assert lines[0].startswith("walk: verdict: the right leg is refused") and "joint angles are relative" in lines[-2]
    later = [replace(walk, name="later")]
    write_cycles(tmp_path / "both.csv", whole.model, later, None, rows, lines[:1])
    both, comments = read_csv(tmp_path / "both.csv")
    assert comments == (lines[0], *CYCLE_HEADER)
    pd.testing.assert_frame_equal(both[both["trial"] == "walk"], rows)
    assert (both["trial"] == "later").sum() == len(cycle_table(whole.model, later))
