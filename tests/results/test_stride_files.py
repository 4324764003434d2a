"""The files of strides: what a calibration writes, and how further trials join those that are there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS
from gaitcal.io.result_folder import sha256_of
from gaitcal.page.page_data import calibration_page_data
from gaitcal.results.cycles import CYCLES
from gaitcal.results.stride_files import (
    ENSEMBLE,
    SPATIOTEMPORAL,
    SPATIOTEMPORAL_COLUMNS,
    STRIDE_FILES,
    earlier_strides,
    spatiotemporal,
    write_stride_files,
)
from gaitcal.results.summary import summary
from gaitcal.session.result import Calibration
from tests.fake_result import fake_calibration


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


def hashes(folder: Path) -> dict[str, str]:
    return {name: str(sha256_of(folder / name)) for name in STRIDE_FILES}


def test_every_measure_of_every_stride_stands_in_the_table_with_its_unit(whole: Calibration) -> None:
    table = spatiotemporal(whole)
    assert tuple(table.columns) == SPATIOTEMPORAL_COLUMNS
    strides = whole.trial("walk").strides
    assert len(table) == sum(len(s.measures) for s in strides) and strides
    row = table[(table["side"] == "l") & (table["stride"] == 1) & (table["variable"] == "cadence")].iloc[0]
    assert row["unit"] == "steps/min" and row["value"] == pytest.approx(120.0, abs=2.5) and row["source"] == "plates"
    assert row["stop"] - row["start"] == pytest.approx(120.0 / row["value"], abs=1e-5)
    assert table["stride"].isna().any()  # of parts of strides


def test_summary_and_report_have_the_means(whole: Calibration) -> None:
    content = summary(whole)
    means = content["spatiotemporal"]
    assert isinstance(means, dict)
    table = spatiotemporal(whole)
    for side in "rl":
        own = table[(table["side"] == side) & (table["variable"] == "stance")]["value"]
        entry = means["stance"][side]  # type: ignore[index,call-overload]
        assert entry["mean"] == pytest.approx(own.mean(), abs=1e-5) and entry["strides"] == len(own)  # type: ignore[index,call-overload]
    assert content["trials"]["walk"]["spatiotemporal"] == means  # type: ignore[index,call-overload]
    assert any(trial["measures"] for trial in calibration_page_data(whole)["trials"])
    without = replace(whole, trials=tuple(replace(t, strides=()) for t in whole.trials))
    assert not any(trial["measures"] for trial in calibration_page_data(without)["trials"])
    assert "spatiotemporal" not in summary(without)


def test_refused_legs_are_marked_and_are_in_no_mean(whole: Calibration) -> None:
    walk = whole.trial("walk")
    right = replace(whole, trials=tuple(t.refused(("r",)) if t is walk else t for t in whole.trials))
    table = spatiotemporal(right)
    assert not table[table["side"] == "r"]["valid"].any() and table[table["side"] == "l"]["valid"].any()
    assert not table[table["variable"].str.startswith(("step", "double"))]["valid"].any(), "both feet belong to these"
    means = summary(right)["spatiotemporal"]
    assert isinstance(means, dict) and "stance" in means and "step_time" not in means
    assert all("r" not in entry for entry in means.values() if isinstance(entry, dict))
    all_refused = replace(whole, trials=tuple(t.refused() for t in whole.trials))
    assert "spatiotemporal" not in summary(all_refused)
    (told,) = (trial["measures"] for trial in calibration_page_data(right)["trials"] if trial["name"] == "walk")
    assert all((stride["side"] == "l") >= bool(stride["values"]) for stride in told), "and in none of the page"


def test_turning_strides_are_named_above_the_mean_curves(whole: Calibration, tmp_path: Path) -> None:
    walk = whole.trial("walk")
    turning = replace(walk, strides=tuple(replace(s, turn=-70.0 if s.number == 1 else 2.0) for s in walk.strides))
    write_stride_files(tmp_path, whole.model, [turning])
    assert (tmp_path / ENSEMBLE).read_text(encoding="utf-8").splitlines()[0] == (
        "# left out, strides that turn by more than 15 deg (trial, side, stride): walk r 1, walk l 1"
    )


def test_further_trials_join_those_that_are_there(whole: Calibration, tmp_path: Path) -> None:
    """Mean curves are then over all of them; a trial that is run again stands once."""
    walk = whole.trial("walk")
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir(), second.mkdir()
    write_stride_files(first, whole.model, [walk.refused(("r",))])
    earlier = earlier_strides(first, hashes(first), ["walk"])
    write_stride_files(second, whole.model, [replace(walk, name="later")], None, earlier)
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
    write_stride_files(tmp_path, whole.model, whole.trials)
    as_written = hashes(tmp_path)
    (tmp_path / CYCLES).write_text("damaged", encoding="utf-8")
    found = earlier_strides(tmp_path, as_written, ["walk"])
    assert found.cycles is None and found.spatiotemporal is not None and len(found.spatiotemporal)


def test_a_result_without_walks_has_tables_without_rows(tmp_path: Path) -> None:
    still = fake_calibration(gait=False)
    write_stride_files(tmp_path, still.model, still.trials)
    for file in (*STRIDE_FILES, ENSEMBLE):
        assert pd.read_csv(tmp_path / file, comment="#").empty
