"""Normal bands of a user: units and signs as in `cycles.csv`, and one line for whatever is wrong with the file."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.gait.cycles import known_variables
from gaitcal.gait.normal_bands import BAND_SIGNS, SHIPPED, bands_file, read_normal_bands
from gaitcal.model.subject_model import Subject

PERSON = Subject("x", 60.0, 1.7, "female")
HEADER = "# source: Somebody 2020, 50 adults\n# signs: {signs}\nvariable,unit,percent,mean,sd\n"


def written(folder: Path, rows: str, signs: str = "gaitcal", header: str = HEADER) -> Path:
    path = folder / "normal.csv"
    path.write_text(header.replace("{signs}", signs) + rows, encoding="utf-8")
    return path


def test_values_lie_on_straight_lines_between_percents_and_nowhere_else(tmp_path: Path) -> None:
    bands = read_normal_bands(written(tmp_path, "hip_flexion,deg,10,30,5\nhip_flexion,deg,20,40,7\n"))
    band = bands["hip_flexion"]
    assert (band.source, band.signs, list(bands)) == (
        "Somebody 2020, 50 adults",
        BAND_SIGNS["gaitcal"],
        ["hip_flexion"],
    )
    mean, sd = band.for_person(PERSON)
    assert mean[[10, 15, 20]].tolist() == [30.0, 35.0, 40.0] and sd[15] == 6.0
    assert np.isnan(mean[[0, 9, 21, 100]]).all()


@pytest.mark.parametrize(
    "variable, unit, one",
    [
        ("knee_angle", "deg", 1.0),
        ("knee_angle", "rad", 57.29577951308232),
        ("knee_angle_moment", "N m/kg", 60.0),
        ("knee_angle_moment", "N·m/kg", 60.0),
        ("knee_angle_moment", "Nmm/kg", 0.06),
        ("knee_angle_moment", "%BW*H", 0.01 * 60.0 * 9.80665 * 1.7),
        ("knee_angle_moment", "Nm", 1.0),
        ("hip_power", "W/kg", 60.0),
        ("ground_reaction_vertical", "BW", 60.0 * 9.80665),
        ("ground_reaction_vertical", "%BW", 0.6 * 9.80665),
        ("ground_reaction_vertical", "N/kg", 60.0),
    ],
)
def test_units_become_those_of_the_table_of_strides(tmp_path: Path, variable: str, unit: str, one: float) -> None:
    rows = f"{variable},{unit},0,1,0.5\n{variable},{unit},100,1,0.5\n"
    mean, sd = read_normal_bands(written(tmp_path, rows))[variable].for_person(PERSON)
    assert mean[50] == pytest.approx(one, rel=1e-3) and sd[50] == pytest.approx(0.5 * one, rel=1e-3)


@pytest.mark.parametrize(
    "variable, signs, right, left",
    [
        ("hip_flexion", "clinical", 1, 1),
        ("hip_flexion_moment", "gaitcal", 1, 1),
        ("hip_flexion_moment", "external", -1, -1),
        ("hip_flexion_moment", "Clinical", -1, -1),
        ("pelvis_tilt", "clinical", -1, -1),
        ("pelvis_list", "clinical", -1, 1),
        ("pelvis_rotation", "clinical", 1, -1),
        ("pelvis_list", "external", 1, 1),
        ("hip_power", "clinical", 1, 1),
    ],
)
def test_signs_become_those_of_the_table_of_strides(
    tmp_path: Path, variable: str, signs: str, right: int, left: int
) -> None:
    unit = {"moment": "N m", "power": "W"}.get(variable.rpartition("_")[2], "deg")
    path = written(tmp_path, f"{variable},{unit},0,2,1\n{variable},{unit},100,2,1\n", signs)
    band = read_normal_bands(path)[variable]
    for side, sign in (("r", right), ("l", left)):
        mean, sd = band.for_person(PERSON, side)
        assert mean[0] == 2.0 * sign and sd[0] == 1.0


@pytest.mark.parametrize(
    "rows, message",
    [
        ("", "found no row"),
        ("hip_flexion,deg,0,1\n", "line 4: found 4 cells; allowed: 5"),
        ("hip_flexion_r,deg,0,1,1\n", "line 4: found variable 'hip_flexion_r'; .*names have no side"),
        ("hip_flexoin,deg,0,1,1\n", "did you mean 'hip_flexion'|hip_flexion"),
        ("hip_flexion,N m,0,1,1\n", "found unit 'N m' of hip_flexion; allowed: deg, rad"),
        ("hip_flexion,deg,101,1,1\n", "found percent '101'; allowed: a number from 0 to 100"),
        ("hip_flexion,deg,0,nan,1\n", "found mean 'nan'"),
        ("hip_flexion,deg,0,1,-1\n", "found sd '-1'"),
        ("hip_flexion,deg,0,1,x\n", "found sd 'x'"),
        ("hip_flexion,deg,0,1,1\n", "found one percent of hip_flexion"),
        ("hip_flexion,deg,5,1,1\nhip_flexion,deg,5,1,1\n", "line 5: found percent 5 of hip_flexion after 5"),
        ("hip_flexion,deg,0,1,1\nhip_flexion,rad,5,1,1\n", "found hip_flexion in rad, before it in deg"),
    ],
)
def test_what_is_wrong_is_one_line_with_the_line_of_the_file(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_normal_bands(written(tmp_path, rows))
    assert "\n" not in str(caught.value) and "normal.csv" in str(caught.value)


@pytest.mark.parametrize(
    "header, message",
    [
        ("variable,unit,percent,mean,sd\n", "signs: missing; allowed: a line '# signs: gaitcal"),
        ("# signs: mine\nvariable,unit,percent,mean,sd\n", "found 'mine'"),
        ("# signs: gaitcal\nname,mean\n", "columns: found 'name,mean'; allowed: 'variable,unit,percent,mean,sd'"),
    ],
)
def test_signs_and_columns_must_be_told(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_normal_bands(written(tmp_path, "hip_flexion,deg,0,1,1\nhip_flexion,deg,9,1,1\n", header=header))


def test_a_file_that_a_spreadsheet_program_saved_is_the_same_file(tmp_path: Path) -> None:
    rows = "hip_flexion,deg,0,1,1\nhip_flexion,deg,9,1,1\n"
    padded = (
        '"# source: Somebody, 2020",,,\n# signs: clinical,,,,\n,,,,\nvariable,unit,percent,mean,sd,,\n'
        + rows
        + ",,,,\n"
    )
    path = tmp_path / "normal.csv"
    path.write_text(padded.replace("\n", "\r\n"), encoding="utf-8-sig", newline="")
    band = read_normal_bands(path)["hip_flexion"]
    assert (band.source, band.signs, band.percent.tolist()) == ("Somebody, 2020", BAND_SIGNS["clinical"], [0.0, 9.0])


def test_lines_on_signs_must_agree(tmp_path: Path) -> None:
    rows = "variable,unit,percent,mean,sd\nhip_flexion,deg,0,1,1\nhip_flexion,deg,9,1,1\n"
    header = "# signs: {signs}\n"
    same = written(tmp_path, rows, "opensim", header + "# signs: GaitCal\n# source: a\n# source: b\n")
    band = read_normal_bands(same)["hip_flexion"]
    assert band.signs is BAND_SIGNS["gaitcal"] and band.source == "a; b"
    with pytest.raises(InputError, match="signs: found 'clinical' and 'external'; allowed: a line"):
        read_normal_bands(written(tmp_path, rows, "clinical", header + "# signs: external\n"))


def test_bands_that_come_with_the_program_have_names() -> None:
    assert "hip_flexion_moment" in read_normal_bands("schwartz2008")
    assert all(bands_file(name).is_file() for name in SHIPPED)
    with pytest.raises(InputError, match="no such file; allowed: a CSV file, or .*schwartz2008.*; did you mean 'schw"):
        read_normal_bands("schwartz")


def test_every_variable_of_the_table_of_strides_may_have_a_band() -> None:
    from gaitcal.results.cycles import cycle_table
    from tests.fake_result import fake_calibration

    whole = fake_calibration()
    assert set(cycle_table(whole.model, whole.trials)["variable"]) <= set(known_variables())
