"""Files of strides, how further trials join them, and figures of `summary.json` that stand beside
each other.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from gaitcal.analysis.result import Calibration
from gaitcal.cli.calibrate_command import _format_residuals
from gaitcal.errors import Severity
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS
from gaitcal.gait.events import combine_events
from gaitcal.io.labels import FootEvent
from gaitcal.io.result_folder import compute_sha256
from gaitcal.model.coordinates import LEG_COORDINATES
from gaitcal.report.page.page_data import build_calibration_page_data
from gaitcal.results.cycle_tables import CYCLES
from gaitcal.results.stride_files import (
    ENSEMBLE,
    SPATIOTEMPORAL,
    STRIDE_FILES,
    read_earlier_strides,
    write_stride_files,
)
from gaitcal.results.stride_tables import (
    SPATIOTEMPORAL_COLUMNS,
    build_stride_tables,
    spatiotemporal,
)
from gaitcal.results.summary import summarise_calibration, summarise_trial
from gaitcal.study.study_trial import Role
from tests.fake_result import ERROR_SHARES, fake_calibration
from tests.report.page.walked_blocks import page_words, rows_of, walked


def hashes(folder: Path) -> dict[str, str]:
    return {name: str(compute_sha256(folder / name)) for name in STRIDE_FILES}


def test_every_measure_of_every_stride_stands_in_the_table_with_its_unit(
    whole: Calibration,
) -> None:
    table = spatiotemporal(whole)
    assert tuple(table.columns) == SPATIOTEMPORAL_COLUMNS
    strides = whole.trial("walk").strides
    assert len(table) == sum(len(s.measures) for s in strides) and strides
    row = table[
        (table["side"] == "l") & (table["stride"] == 1) & (table["variable"] == "cadence")
    ].iloc[0]
    assert (
        row["unit"] == "steps/min"
        and row["value"] == pytest.approx(120.0, abs=2.5)
        and row["source"] == "plates"
    )
    assert row["stop"] - row["start"] == pytest.approx(120.0 / row["value"], abs=1e-5)
    assert table["stride"].isna().any()  # of parts of strides


def test_summary_and_report_have_the_means(whole: Calibration) -> None:
    content = summarise_calibration(whole)
    means = content["spatiotemporal"]
    assert isinstance(means, dict)
    table = spatiotemporal(whole)
    for side in "rl":
        own = table[(table["side"] == side) & (table["variable"] == "stance")]["value"]
        entry = means["stance"][side]
        assert entry["mean"] == pytest.approx(own.mean(), abs=1e-5) and entry["strides"] == len(own)
    assert content["trials"]["walk"]["spatiotemporal"] == means
    assert any(trial["measures"] for trial in build_calibration_page_data(whole)["trials"])
    without = replace(whole, trials=tuple(replace(t, strides=()) for t in whole.trials))
    assert not any(trial["measures"] for trial in build_calibration_page_data(without)["trials"])
    assert "spatiotemporal" not in summarise_calibration(without)


def test_refused_legs_are_marked_and_are_in_no_mean(whole: Calibration) -> None:
    walk = whole.trial("walk")
    right = replace(
        whole, trials=tuple(t.exclude_legs(("r",)) if t is walk else t for t in whole.trials)
    )
    table = spatiotemporal(right)
    assert (
        not table[table["side"] == "r"]["valid"].any()
        and table[table["side"] == "l"]["valid"].any()
    )
    assert not table[table["variable"].str.startswith(("step", "double"))]["valid"].any(), (
        "both feet belong to these"
    )
    means = summarise_calibration(right)["spatiotemporal"]
    assert isinstance(means, dict) and "stance" in means and "step_time" not in means
    assert all("r" not in entry for entry in means.values() if isinstance(entry, dict))
    all_refused = replace(whole, trials=tuple(t.exclude_legs() for t in whole.trials))
    assert "spatiotemporal" not in summarise_calibration(all_refused)
    (told,) = (
        trial["measures"]
        for trial in build_calibration_page_data(right)["trials"]
        if trial["name"] == "walk"
    )
    assert all((stride["side"] == "l") >= bool(stride["values"]) for stride in told), (
        "and in none of the page"
    )


def test_turning_strides_are_named_above_the_mean_curves(
    whole: Calibration, tmp_path: Path
) -> None:
    walk = whole.trial("walk")
    turning = replace(
        walk, strides=tuple(replace(s, turn=-70.0 if s.number == 1 else 2.0) for s in walk.strides)
    )
    write_stride_files(tmp_path, build_stride_tables(whole.model, [turning]))
    assert (tmp_path / ENSEMBLE).read_text(encoding="utf-8").splitlines()[0] == (
        "# left out, strides that turn by more than 15 deg (trial, side, stride): walk r 1, walk l "
        "1"
    )


def test_further_trials_join_those_that_are_there(whole: Calibration, tmp_path: Path) -> None:
    """Mean curves are then over all of them; a trial that is run again stands once."""
    walk = whole.trial("walk")
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir(), second.mkdir()
    write_stride_files(first, build_stride_tables(whole.model, [walk.exclude_legs(("r",))]))
    earlier = read_earlier_strides(first, hashes(first), ["walk"])
    later = build_stride_tables(whole.model, [replace(walk, name="later")])
    write_stride_files(second, later, earlier)
    for file in STRIDE_FILES:
        text = (second / file).read_text(encoding="utf-8")
        assert text.startswith("# walk: verdict: the right leg is refused")
        assert set(pd.read_csv(second / file, comment="#")["trial"]) == {"walk", "later"}
    mean = pd.read_csv(second / ENSEMBLE, comment="#", keep_default_na=False, na_values=[""])
    assert tuple(mean.columns) == ENSEMBLE_COLUMNS
    trials = mean[mean["variable"] == "hip_flexion"].groupby("side")["trials"].max()
    assert trials.to_dict() == {"r": 1, "l": 2}  # the refused leg's strides do not count
    steps = pd.read_csv(second / SPATIOTEMPORAL, comment="#")
    one, other = (steps[steps["trial"] == name]["value"].to_numpy() for name in ("walk", "later"))
    np.testing.assert_array_equal(one, other)


def test_of_a_damaged_table_no_row_is_kept(whole: Calibration, tmp_path: Path) -> None:
    write_stride_files(tmp_path, build_stride_tables(whole.model, whole.trials))
    as_written = hashes(tmp_path)
    (tmp_path / CYCLES).write_text("damaged", encoding="utf-8")
    found = read_earlier_strides(tmp_path, as_written, ["walk"])
    assert (
        found["cycles.csv"][0] is None
        and found["spatiotemporal.csv"][0] is not None
        and len(found["spatiotemporal.csv"][0])
    )


def test_a_result_without_walks_has_tables_without_rows(tmp_path: Path) -> None:
    still = fake_calibration(gait=False)
    write_stride_files(tmp_path, build_stride_tables(still.model, still.trials))
    for file in (*STRIDE_FILES, ENSEMBLE):
        assert pd.read_csv(tmp_path / file, comment="#").empty


def test_a_trial_and_its_segments_have_both_floors_and_ratios(whole: Calibration) -> None:
    trial = whole.trials[0]
    out = summarise_trial(trial, whole.verdict)
    for rms in (out["rms_mm"], out["pelvis_and_legs_mm"], out["segments"]["thigh_r"]["rms_mm"]):
        assert rms["joint_floor"] == pytest.approx(1.1 * rms["rigid_floor"])
        assert rms["calibrated_to_joint_floor"] == pytest.approx(
            rms["calibrated"] / rms["joint_floor"]
        )
        assert rms["calibrated_to_floor"] == pytest.approx(rms["calibrated"] / rms["rigid_floor"])
    assert out["joint_floor_mm"] == {"hip_r": 5.3, "knee_r": 5.4, "ankle_r": 5.5}
    assert "joint_floor" not in out["segments"]["thigh_l"]["rms_mm"], "in no joint: absent, never 0"
    without = replace(trial, joint_floor=None)
    out = summarise_trial(without, whole.verdict)
    assert "joint_floor_mm" not in out and not [
        key for key in out["rms_mm"] if "joint_floor" in key
    ]
    assert "Joint floor" in page_words(replace(whole, trials=(without,)))


def test_the_parts_of_every_torque_s_error_bar_sum_to_one(whole: Calibration) -> None:
    trial = whole.trials[0]
    sources = summarise_trial(trial, whole.verdict)["torque_error_sources"]
    assert {"hip_flexion_r", "knee_adduction_l", "lumbar_bending"} <= set(sources)
    assert not [name for name in sources if name.startswith("pelvis")]
    for parts in sources.values():
        assert sum(parts.values()) == pytest.approx(1.0, abs=1e-3)
        assert parts == pytest.approx({source.key: share for source, share in ERROR_SHARES.items()})
    without = replace(trial, loads=replace(trial.loads, errors=None))
    assert "torque_error_sources" not in summarise_trial(without, whole.verdict)


def test_a_phase_tells_the_noise_of_each_of_its_trials_and_one_without_none(
    whole: Calibration,
) -> None:
    first, *others = whole.phases
    own = replace(first, noise={"knee": 0.00123456, "walk, hip_r alone": 0.01})
    told = cast(Any, summarise_calibration(replace(whole, phases=(own, *others))))["phases"]
    assert told[0]["noise_mm"] == {"knee": 1.2346, "walk, hip_r alone": 10.0}
    assert "noise_mm" not in told[1]


def test_the_page_tells_what_makes_each_error_bar() -> None:
    words = "Expected error of the peak knee adduction moment"
    blocks = build_calibration_page_data(fake_calibration())["trials"][0]["sections"]["trust"]
    found = [
        b for b in walked(blocks) if b["kind"] == "table" and "error alone, N·m/kg" in b["head"]
    ]
    assert len(found) == 2 * len(LEG_COORDINATES), "all torques of both legs"
    told = {source.label: f"{100 * share:.0f}" for source, share in ERROR_SHARES.items()}
    for table in found:
        rows = rows_of(table)
        assert rows.pop("all together")[1] == "100"
        rest = rows.pop("all others", ["", "0"])
        parts = {name: percent for name, (_, percent) in rows.items()}
        assert list(map(int, parts.values())) == sorted(map(int, parts.values()), reverse=True), (
            "the largest first"
        )
        assert parts == {name: told[name] for name in parts} and len(parts) >= 4
        assert sum(int(percent) for percent in parts.values()) + int(rest[1]) == pytest.approx(
            100, abs=2
        )
    assert words in page_words(fake_calibration()) and words not in page_words(
        fake_calibration(errors=False)
    )


def test_the_rms_of_a_residual_has_one_definition_in_every_place(whole: Calibration) -> None:
    trial = whole.trial("walk")
    told = summarise_trial(trial, whole.verdict)["pelvis_residual"]
    valid = trial.loads.reactions.valid
    for (stage, moments), size in zip(
        trial.loads.moments.items(), trial.loads.residuals, strict=True
    ):
        by_hand = float(np.sqrt((moments.residual_force[valid] ** 2).mean()))
        assert told[stage.key]["force_N"] == size.rms_force == moments.residual_rms(valid)[0]
        assert size.rms_force == pytest.approx(by_hand)
        assert told[stage.key]["torque_Nm"] == size.rms_moment
    line = _format_residuals("walk", trial.loads)
    last = trial.loads.residuals[-1]
    assert f"{last.rms_force:.1f} N, {last.rms_moment:.1f} N·m" in line


def test_events_are_told_with_side_time_and_source(whole: Calibration) -> None:
    """The fake's plates are loaded from 0.2 (right) and 0.7 s (left), for 0.6 of every second."""
    told = {trial.name: summarise_trial(trial, whole.verdict) for trial in whole.trials}
    events = told["walk"]["events"]
    assert events[:3] == [
        {"side": "r", "event": "foot strike", "time": 0.2, "source": "plates"},
        {"side": "l", "event": "foot off", "time": 0.29, "source": "plates"},
        {"side": "l", "event": "foot strike", "time": 0.7, "source": "plates"},
    ]
    assert "events" not in told["knee"], "an isolated trial has none"


def test_what_is_wrong_with_a_files_events_is_said_of_its_trial(whole: Calibration) -> None:
    walk = whole.trial("walk")
    late = [FootEvent(e.moment, e.side, e.time + 0.3) for e in walk.events.events]
    wrong = replace(walk, events=combine_events(walk.body.time, late, walk.events.events, ()))
    said = [f for f in wrong.findings if f.topic == "events"]
    assert [(f.where, f.severity) for f in said] == [
        ("walk", Severity.WARNING)
    ] and "0.30 s too late" in said[0].cause
    assert not [f for f in walk.findings if f.topic == "events"]


def test_a_squat_that_is_called_gait_is_no_walk(whole: Calibration) -> None:
    called = replace(whole.trials[0], name="gait")
    assert (called.activity, replace(called, role=Role.MOTION).activity) == (
        "gait",
        "gait (motion)",
    )
    assert replace(called, role=Role.MOTION, name="squat").activity == "squat"
