"""Tables of strides from elsewhere: read by pandas alone, in other conventions, or none at all."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.errors import InputError
from gaitcal.gait.cycles import typed, unit_of
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, ensemble
from gaitcal.io.result_folder import sha256_of
from gaitcal.results.cycles import CYCLES, cycles, cycles_to_xarray, read_cycles, write_cycles
from gaitcal.results.stride_files import SPATIOTEMPORAL, STRIDE_FILES, earlier_strides, write_stride_files
from gaitcal.results.table_file import write_csv
from gaitcal.session.result import Calibration
from tests.fake_result import fake_calibration


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


@pytest.fixture
def folder(whole: Calibration, tmp_path: Path) -> Path:
    write_stride_files(tmp_path, whole.model, whole.trials)
    return tmp_path


def test_what_pandas_reads_by_itself_gives_the_same_ensemble(whole: Calibration, folder: Path) -> None:
    """A session without a name is an empty cell, which pandas takes for NaN."""
    plain = pd.read_csv(folder / CYCLES, comment="#")
    assert plain["session"].isna().all()
    pd.testing.assert_frame_equal(ensemble(plain), ensemble(cycles(whole)), check_dtype=False, atol=1e-5)


@pytest.mark.parametrize("person", ["Subject #3", "# x", '5" #2, left', "#", "007", "NA"])
def test_no_name_of_a_person_costs_numbers(whole: Calibration, tmp_path: Path, person: str) -> None:
    model = replace(whole.model, subject=replace(whole.model.subject, name=person, session="day #2"))
    write_cycles(tmp_path / CYCLES, model, whole.trials)
    expected = cycles(replace(whole, model=model))
    pd.testing.assert_frame_equal(
        read_cycles(tmp_path).astype({"person": object}), expected.astype({"person": object}), check_dtype=False
    )
    plain = pd.read_csv(tmp_path / CYCLES, comment="#", dtype={"person": str}, keep_default_na=False, na_values=[""])
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
    assert (tmp_path / "t.csv").read_text(encoding="utf-8") == f"# said\n{by_pandas.getvalue()}"


def test_a_trial_called_as_a_word_of_the_head_does_not_double_it(whole: Calibration, tmp_path: Path) -> None:
    model, walk = whole.model, replace(whole.trial("walk"), name="se")
    write_stride_files(tmp_path, model, [walk.refused(("r",))])
    hashes = {name: str(sha256_of(tmp_path / name)) for name in STRIDE_FILES}
    found = earlier_strides(tmp_path, hashes, ["se", "valid", "variable"])
    assert [len(found["cycles.csv"][1]), len(found["spatiotemporal.csv"][1])] == [1, 1]
    assert found["cycles.csv"][1][0].startswith("se: verdict: the right leg")


def in_other_units(table: pd.DataFrame) -> pd.DataFrame:
    told = table["variable"].map(unit_of).replace("N m", "N m/kg")
    return table.assign(unit=told, positive="flexion")


def test_units_are_those_of_the_table_and_two_conventions_are_refused(whole: Calibration, folder: Path) -> None:
    table = cycles(whole)
    other = in_other_units(table)
    other.to_csv(folder / CYCLES, index=False)
    read = read_cycles(folder)
    mean = ensemble(read)
    assert set(mean.loc[mean["variable"] == "knee_angle_moment", "unit"]) == {"N m/kg"}
    assert tuple(mean.columns) == (*ENSEMBLE_COLUMNS, "unit", "positive")
    mixed = pd.concat([table, other.assign(trial="second")])
    with pytest.raises(InputError, match=r"found pelvis_tilt as \[deg\] and as \[deg\] flexion; allowed: one conv"):
        ensemble(mixed)
    pytest.importorskip("xarray", reason="no xarray here; it comes with the extra `test`")
    dataset = cycles_to_xarray(read)
    assert dataset["knee_angle_moment"].attrs == {"units": "N m/kg", "positive": "flexion"}
    assert dataset["knee_angle_moment_se"].attrs == {"units": "N m/kg"}
    assert dataset["knee_angle_moment_valid"].attrs == {"units": "1"}
    with pytest.raises(InputError, match="allowed: one convention"):
        cycles_to_xarray(mixed)


def test_what_is_no_table_of_strides_is_one_clear_line(folder: Path) -> None:
    text = (folder / CYCLES).read_text(encoding="utf-8")
    (folder / "semicolons.csv").write_text(text.replace(",", ";"), encoding="utf-8")
    (folder / "letters.csv").write_text(text.replace("hip_flexion,", "hip_flexion,x", 1), encoding="utf-8")
    for file, said in (
        ("semicolons.csv", "found the columns person;session;trial.*, without trial, .*with commas between them"),
        (SPATIOTEMPORAL, "is no table of strides: .*without percent"),
        ("letters.csv", "value: found 'x.*' in row [0-9]+; allowed: a number"),
    ):
        with pytest.raises(InputError, match=said) as caught:
            read_cycles(folder / file)
        assert "\n" not in str(caught.value) and file in str(caught.value)


def test_rows_that_were_cut_at_a_sign_in_a_name_are_refused(whole: Calibration) -> None:
    cut = cycles(whole).assign(percent=np.nan, value=np.nan, valid=np.nan)
    with pytest.raises(InputError, match="percent: found nothing in row 1|found nothing in row 1.*read_cycles"):
        typed(cut)
