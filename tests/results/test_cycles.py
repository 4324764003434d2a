"""`cycles.csv`: every stride over 0 to 100 % with the validity of its leg; read from elsewhere;
relative angles.
"""

import base64
import csv
import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.analysis.result import Calibration
from gaitcal.dynamics.measurement_errors import ErrorSource
from gaitcal.errors import Code
from gaitcal.gait.cycles import (
    CYCLE_COLUMNS,
    GROUND_REACTION,
    POINTS,
    get_unit,
    validate_stride_table,
)
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, ensemble
from gaitcal.gait.strides import AXES, list_strides
from gaitcal.io.opensim_files import read_table
from gaitcal.io.result_folder import compute_sha256
from gaitcal.model.linkage import COORDINATES, PELVIS_ANGLES
from gaitcal.pipeline.write_results import write_trial
from gaitcal.report.page.plain_data import LARGEST
from gaitcal.report.page.trial_data import build_trial_page_data
from gaitcal.results.cycle_tables import (
    CYCLE_HEADER,
    CYCLES,
    build_cycle_table,
    cycles,
    cycles_to_xarray,
    read_cycles,
)
from gaitcal.results.saved_result import _read_static_angles
from gaitcal.results.stride_files import (
    NO_STRIDES,
    SPATIOTEMPORAL,
    STRIDE_FILES,
    read_earlier_strides,
    write_stride_files,
)
from gaitcal.results.stride_tables import build_stride_tables
from gaitcal.results.summary import STATIC_ANGLES, summarise_calibration
from gaitcal.results.table_files import read_csv, write_csv
from tests.fake_result import ANGLE_ERROR, ERROR_SHARES, OWN_ANGLE_ERROR, fake_calibration
from tests.messages import check_text, refuses

ROUNDED = 1e-6


def one(table: pd.DataFrame, side: str, variable: str) -> pd.DataFrame:
    rows: pd.DataFrame = table[
        (table["side"] == side) & (table["variable"] == variable) & (table["stride"] == 1)
    ]
    return rows


def test_every_stride_has_every_variable_from_0_to_100_percent(whole: Calibration) -> None:
    table = build_cycle_table(whole.model, whole.trials)
    assert tuple(table.columns) == CYCLE_COLUMNS
    trial = whole.trial("walk")
    strides = list_strides(trial.events)
    for side, found in strides.items():
        own = table[(table["trial"] == "walk") & (table["side"] == side)]
        assert sorted(own["stride"].unique()) == list(range(1, len(found) + 1))
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
    """The left leg is not valid in the middle of its stride; the right leg knows nothing
    of that.
    """
    trial = whole.trial("walk")
    reactions = trial.loads.reactions
    stride = {side: cycles[0] for side, cycles in list_strides(trial.events).items()}
    time, left = trial.body.time, np.ones(len(trial.body.time), dtype=bool)
    middle = 0.5 * (stride["l"].start + stride["l"].stop)
    left[np.abs(time - middle) < 0.05] = False
    legs = np.stack([np.ones_like(left), left], axis=1)
    changed = replace(
        trial, loads=replace(trial.loads, reactions=replace(reactions, valid=left, valid_legs=legs))
    )
    table = build_cycle_table(whole.model, [changed])
    assert one(table, "r", "hip_flexion_moment")["valid"].all()
    of_left = one(table, "l", "hip_flexion_moment")
    assert not of_left["valid"].iloc[50] and of_left["valid"].iloc[[0, 30, 70, 100]].all()
    assert not one(table, "r", "lumbar_extension_moment")["valid"].all(), "the trunk needs both"
    at = stride["l"].start + (stride["l"].stop - stride["l"].start) * np.arange(POINTS) / 100
    k = trial.body.coordinates.index("hip_flexion_l")
    expected = np.interp(at, time, np.degrees(trial.body.q[:, k]))
    np.testing.assert_allclose(one(table, "l", "hip_flexion")["value"], expected, atol=ROUNDED)
    np.testing.assert_allclose(
        of_left["value"], np.interp(at, time, trial.loads.final.tau[:, k]), atol=ROUNDED
    )
    np.testing.assert_allclose(
        of_left["se_stride"], np.sqrt(ERROR_SHARES[ErrorSource.MOTION]) * of_left["se"], rtol=1e-5
    )
    angle = one(table, "l", "hip_flexion")
    np.testing.assert_allclose(angle["se_stride"], np.degrees(OWN_ANGLE_ERROR), atol=ROUNDED)
    np.testing.assert_allclose(angle["se"], np.degrees(ANGLE_ERROR), atol=ROUNDED)
    upward = one(table, "l", GROUND_REACTION)
    np.testing.assert_allclose(
        upward["value"], np.interp(at, time, reactions.wrench[:, 1, 1]), atol=ROUNDED
    )
    assert upward["valid"].tolist() == of_left["valid"].tolist() and upward["se"].isna().all()
    assert of_left["se"].notna().all()


def test_what_was_written_is_read_back_also_by_pandas_alone(
    whole: Calibration, tmp_path: Path
) -> None:
    """A person called `001` stays one, in whatever folder; another file is told in a line."""
    model = replace(whole.model, subject=replace(whole.model.subject, name="001"))
    write_stride_files(tmp_path, build_stride_tables(model, whole.trials))
    found, table = read_cycles(tmp_path), build_cycle_table(model, whole.trials)
    pd.testing.assert_frame_equal(
        found.astype({"person": str}), table.astype({"person": str}), check_dtype=False
    )
    assert set(found["person"]) == {"001"} and set(found["session"]) == {""}
    plain = pd.read_csv(tmp_path / "cycles.csv", comment="#")
    np.testing.assert_allclose(plain["value"], table["value"])
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    for wrong, code in (("other.csv", Code.STRIDE_TABLE), ("none.csv", Code.DAMAGED_RESULT)):
        with refuses(code, wrong):
            read_cycles(tmp_path / wrong)


def test_xarray_has_the_same_numbers_under_named_dimensions(whole: Calibration) -> None:
    pytest.importorskip("xarray", reason="no xarray here; it comes with the extra `test`")
    table = cycles(whole)
    dataset = cycles_to_xarray(table)
    assert dict(dataset.sizes) == {"trial": 1, "side": 2, "stride": 2, "percent": POINTS}
    assert dataset["hip_flexion"].attrs["units"] == "deg" and dataset.attrs["person"] == "S07"
    assert (
        dataset["hip_flexion_moment_se"].attrs["units"] == "N m"
        and dataset["hip_flexion_valid"].attrs["units"] == "1"
    )
    for side in "rl":
        curve = dataset["knee_angle_moment"].sel(trial="walk", side=side, stride=1)
        np.testing.assert_array_equal(curve, one(table, side, "knee_angle_moment")["value"])
    several = cycles_to_xarray(pd.concat([table, table.assign(session="second")]))
    assert several.sizes["session"] == 2 and "session" not in several.attrs
    assert not cycles_to_xarray(table.iloc[:0]).data_vars
    with refuses(Code.STRIDE_TABLE, 1, field="strides"):
        cycles_to_xarray(pd.concat([table, table]))


def test_without_xarray_a_line_says_what_to_install(
    whole: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with refuses(Code.INSTALLATION):
        cycles_to_xarray(cycles(whole))


def test_relative_angles_are_those_of_the_static_posture_less(whole: Calibration) -> None:
    off = {"hip_flexion_l": np.radians(4.0), "pelvis_tilt": np.radians(9.0)}
    plain, relative = (
        build_cycle_table(whole.model, whole.trials, static) for static in (None, off)
    )
    for variable, less in (("hip_flexion", 4.0), ("pelvis_tilt", 0.0), ("hip_flexion_moment", 0.0)):
        gap = (
            one(plain, "l", variable)["value"].to_numpy()
            - one(relative, "l", variable)["value"].to_numpy()
        )
        np.testing.assert_allclose(gap, less, atol=ROUNDED)


def test_nothing_of_a_refused_leg_counts_nor_of_pelvis_and_trunk(whole: Calibration) -> None:
    for legs in (("r",), ("r", "l")):
        table = build_cycle_table(whole.model, [whole.trial("walk").exclude_legs(legs)])
        counting = set(table.loc[table["valid"] == 1, "side"])
        assert counting == {"r", "l"} - set(legs)
        assert not table.loc[table["variable"].str.startswith(("pelvis", "lumbar")), "valid"].any()


def test_pelvis_angles_are_along_each_stride_and_those_of_a_turn_do_not_count(
    whole: Calibration,
) -> None:
    """The same motion in a room that is turned to the left by 60 deg has the same table; a turn is
    in no mean curve.
    """
    trial = whole.trial("walk")
    columns = [trial.body.coordinates.index(name) for name in PELVIS_ANGLES]
    wave = np.sin(2 * np.pi * trial.body.time)
    angles = np.radians(np.stack([-12.0 + 2 * wave, 5.0 * wave, 8.0 * wave], axis=1))
    by = np.radians(60.0)
    in_room = (Rotation.from_euler("y", by) * Rotation.from_euler(AXES, angles)).as_euler(AXES)
    evaluation = trial.body.basis.evaluate(np.eye(len(trial.body.coefficients)))
    tables = []
    for line, pelvis in ((0.0, angles), (by, in_room)):
        coefficients = trial.body.coefficients.copy()
        coefficients[:, columns] = np.linalg.lstsq(evaluation, pelvis, rcond=None)[0]
        body = replace(trial.body, coefficients=coefficients)
        strides = tuple(
            replace(s, line=line, turn=40.0 if s.side == "l" else 1.0) for s in trial.strides
        )
        tables.append(build_cycle_table(whole.model, [replace(trial, body=body, strides=strides)]))
    plain, turned = tables
    for name in PELVIS_ANGLES:
        np.testing.assert_allclose(
            one(plain, "r", name)["value"], one(turned, "r", name)["value"], atol=0.02
        )
        assert one(turned, "r", name)["valid"].all() and not one(turned, "l", name)["valid"].any()
    assert one(turned, "l", "hip_flexion")["valid"].any() and set(
        one(turned, "l", "hip_flexion")["turn"]
    ) == {40.0}
    mean = ensemble(turned)
    assert set(mean[mean["n"] > 0]["side"]) == {"r"}


def test_an_angle_counts_only_where_markers_show_its_segments(whole: Calibration) -> None:
    """No marker of the left shank in the middle of the stride: its knee and ankle are guessed
    there, not its hip.
    """
    trial = whole.trial("walk")
    stride, errors = list_strides(trial.events)["l"][0], trial.body.errors
    middle = np.abs(trial.body.time - 0.5 * (stride.start + stride.stop)) < 0.05
    distance, shank = errors.distance.copy(), np.array(errors.segments) == "shank_l"
    distance[np.ix_(middle, shank)] = np.nan
    body = replace(trial.body, errors=replace(errors, distance=distance))
    table = build_cycle_table(whole.model, [replace(trial, body=body)])
    for variable in ("knee_angle", "ankle_angle"):
        own = one(table, "l", variable)["valid"]
        assert not own.iloc[50] and own.iloc[[0, 30, 70, 100]].all()
        assert one(table, "r", variable)["valid"].all()
    assert one(table, "l", "hip_flexion")["valid"].all() and shank.any()


def test_the_file_says_first_which_trials_are_refused_and_keeps_what_was_there(
    whole: Calibration, tmp_path: Path
) -> None:
    walk = whole.trial("walk")
    refused = [walk.exclude_legs(("r",))]
    tables = build_stride_tables(whole.model, refused, {"hip_flexion_r": 0.1})
    write_stride_files(tmp_path, tables)
    rows, lines = read_csv(tmp_path / CYCLES)
    check_text(lines[0])
    check_text(lines[-2])
    later = [replace(walk, name="later")]
    earlier = {**NO_STRIDES, CYCLES: (rows, lines[:1])}
    write_stride_files(tmp_path, build_stride_tables(whole.model, later), earlier)
    both, comments = read_csv(tmp_path / CYCLES)
    assert comments == (lines[0], *CYCLE_HEADER)
    pd.testing.assert_frame_equal(both[both["trial"] == "walk"], rows)
    assert (both["trial"] == "later").sum() == len(build_cycle_table(whole.model, later))


def test_pelvis_angles_of_the_page_are_against_the_line_of_each_stride(whole: Calibration) -> None:
    """As in the table; the walk is turned, so that the room's axis, or the trial's mean line, would
    tell others.
    """
    trial = next(t for t in whole.trials if t.joint is None and t.strides)
    lines = [replace(stride, line=0.2 * k - 0.5) for k, stride in enumerate(trial.strides)]
    turned = replace(trial, strides=tuple(lines))
    table, sheet = (
        build_cycle_table(whole.model, [turned]),
        build_trial_page_data(
            whole.model, turned, build_stride_tables(whole.model, [turned]), verdict=None
        ),
    )
    compared = 0
    for stride in sheet["strides"]:
        of = table[(table["side"] == stride["side"]) & (table["stride"] == stride["number"])]
        for name in PELVIS_ANGLES:
            packed = stride["pelvis"][name]["value"]
            steps = (
                np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").astype(float) + LARGEST
            )
            value = of[of["variable"] == name]["value"].to_numpy()
            assert packed["low"] + packed["step"] * steps == pytest.approx(
                value, abs=packed["step"]
            )
            compared += 1
    assert compared >= 3


@pytest.fixture
def folder(whole: Calibration, tmp_path: Path) -> Path:
    write_stride_files(tmp_path, build_stride_tables(whole.model, whole.trials))
    return tmp_path


def test_what_pandas_reads_by_itself_gives_the_same_ensemble(
    whole: Calibration, folder: Path
) -> None:
    """A session without a name is an empty cell, which pandas takes for NaN."""
    plain = pd.read_csv(folder / CYCLES, comment="#")
    assert plain["session"].isna().all()
    pd.testing.assert_frame_equal(
        ensemble(plain), ensemble(cycles(whole)), check_dtype=False, atol=1e-5
    )


@pytest.mark.parametrize("person", ["Subject #3", "# x", '5" #2, left', "#", "007", "NA"])
def test_no_name_of_a_person_costs_numbers(whole: Calibration, tmp_path: Path, person: str) -> None:
    model = replace(
        whole.model, subject=replace(whole.model.subject, name=person, session="day #2")
    )
    write_stride_files(tmp_path, build_stride_tables(model, whole.trials))
    expected = cycles(replace(whole, model=model))
    pd.testing.assert_frame_equal(
        read_cycles(tmp_path).astype({"person": object}),
        expected.astype({"person": object}),
        check_dtype=False,
    )
    plain = pd.read_csv(
        tmp_path / CYCLES, comment="#", dtype={"person": str}, keep_default_na=False, na_values=[""]
    )
    assert set(plain["person"]) == {person} and set(plain["session"]) == {"day #2"}
    np.testing.assert_array_equal(plain["value"], expected["value"])


def test_cells_are_those_of_pandas_but_for_the_quotation_marks(tmp_path: Path) -> None:
    numbers = np.random.default_rng(1).normal(size=40) * 10.0 ** np.arange(-20, 20)
    table = pd.DataFrame(
        {
            "number": np.where(np.arange(40) % 5, numbers, np.nan),
            "whole": np.arange(40),
            "maybe": pd.array([1, None] * 20, dtype="Int64"),
            "text": ["x", "a,b", 'q"r', "ü\n"] * 10,
            "mixed": [None, 1.5, "7", np.nan] * 10,
        }
    )
    table.loc[3, "number"] = np.inf
    by_pandas = io.StringIO()
    table.to_csv(by_pandas, index=False, lineterminator="\n")
    write_csv(table, tmp_path / "t.csv", ["said"])
    comment, *rows = csv.reader(
        io.StringIO((tmp_path / "t.csv").read_text(encoding="utf-8"), newline="")
    )
    expected = list(csv.reader(io.StringIO(by_pandas.getvalue(), newline="")))
    assert comment == ["# said"] and [row[1:] for row in rows] == [row[1:] for row in expected]
    assert [row[0] and float(row[0]) for row in rows[1:]] == [
        row[0] and float(row[0]) for row in expected[1:]
    ]


def test_a_trial_called_as_a_word_of_the_head_does_not_double_it(
    whole: Calibration, tmp_path: Path
) -> None:
    model, walk = whole.model, replace(whole.trial("walk"), name="se")
    write_stride_files(tmp_path, build_stride_tables(model, [walk.exclude_legs(("r",))]))
    hashes = {name: str(compute_sha256(tmp_path / name)) for name in STRIDE_FILES}
    found = read_earlier_strides(tmp_path, hashes, ["se", "valid", "variable"])
    assert [len(found["cycles.csv"][1]), len(found["spatiotemporal.csv"][1])] == [1, 1]
    check_text(found["cycles.csv"][1][0])


def in_other_units(table: pd.DataFrame) -> pd.DataFrame:
    told = table["variable"].map(get_unit).replace("N m", "N m/kg")
    return table.assign(unit=told, positive="flexion")


def test_units_are_those_of_the_table_and_two_conventions_are_refused(
    whole: Calibration, folder: Path
) -> None:
    table = cycles(whole)
    other = in_other_units(table)
    other.to_csv(folder / CYCLES, index=False)
    read = read_cycles(folder)
    mean = ensemble(read)
    assert set(mean.loc[mean["variable"] == "knee_angle_moment", "unit"]) == {"N m/kg"}
    assert tuple(mean.columns) == (*ENSEMBLE_COLUMNS, "unit", "positive")
    mixed = pd.concat([table, other.assign(trial="second")])
    with refuses(Code.STRIDE_TABLE, "pelvis_tilt", field="strides"):
        ensemble(mixed)
    pytest.importorskip("xarray", reason="no xarray here; it comes with the extra `test`")
    dataset = cycles_to_xarray(read)
    assert dataset["knee_angle_moment"].attrs == {"units": "N m/kg", "positive": "flexion"}
    assert dataset["knee_angle_moment_se"].attrs == {"units": "N m/kg"}
    assert dataset["knee_angle_moment_valid"].attrs == {"units": "1"}
    with refuses(Code.STRIDE_TABLE, field="strides"):
        cycles_to_xarray(mixed)


def test_what_is_no_table_of_strides_is_one_clear_line(folder: Path) -> None:
    text = (folder / CYCLES).read_text(encoding="utf-8")
    (folder / "semicolons.csv").write_text(text.replace(",", ";"), encoding="utf-8")
    (folder / "letters.csv").write_text(
        text.replace("hip_flexion,", "hip_flexion,x", 1), encoding="utf-8"
    )
    for file, field in (("semicolons.csv", ""), (SPATIOTEMPORAL, ""), ("letters.csv", "value")):
        with refuses(Code.STRIDE_TABLE, file, field=field):
            read_cycles(folder / file)


def test_rows_that_were_cut_at_a_sign_in_a_name_are_refused(whole: Calibration) -> None:
    cut = cycles(whole).assign(percent=np.nan, value=np.nan, valid=np.nan)
    with refuses(Code.STRIDE_TABLE, field="percent"):
        validate_stride_table(cut)


WRITTEN_DEG = 1e-4
"""What rounding to four places leaves."""


def test_tables_are_relative_and_the_mot_is_not(tmp_path: Path) -> None:
    calibration = fake_calibration(plates=False)
    trial = next(t for t in calibration.trials if t.joint is None)
    write_trial(trial, calibration.model, tmp_path, {"hip_flexion_r": np.deg2rad(11.0)})
    text = (tmp_path / "motion" / f"{trial.name}.csv").read_text(encoding="utf-8")
    assert "# static trial, deg: hip_flexion_r 11.00\n" in text
    table = pd.read_csv(tmp_path / "motion" / f"{trial.name}.csv", comment="#")
    anatomical = np.rad2deg(trial.body.q[:, COORDINATES.index("hip_flexion_r")])
    np.testing.assert_allclose(table["hip_flexion_r"], anatomical - 11.0, atol=WRITTEN_DEG)
    mot = read_table(tmp_path / "motion" / f"{trial.name}.mot")
    np.testing.assert_allclose(mot.get_column("hip_flexion_r"), anatomical, atol=WRITTEN_DEG)


def test_static_angles_come_back_from_the_summary(tmp_path: Path) -> None:
    angles = {"pelvis_tx": 0.1, "hip_flexion_r": 0.2, "ankle_angle_l": -0.05}
    entries = summarise_calibration(replace(fake_calibration(), static_angles=angles))
    back = _read_static_angles(entries, tmp_path)
    assert back == pytest.approx(
        {n: v for n, v in angles.items() if n != "pelvis_tx"}, abs=np.deg2rad(WRITTEN_DEG)
    )
    with refuses(Code.NO_RESULT, source="summary.json"):
        _read_static_angles({k: v for k, v in entries.items() if k != STATIC_ANGLES}, tmp_path)
