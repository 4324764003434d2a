"""Our own CSV tables."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.formats import read_forces, read_recording

FORCES = "time," + ",".join(f"1_{q}{a}" for q in "fpt" for a in "xyz")


def write(folder: Path, text: str) -> Path:
    path = folder / "t.csv"
    path.write_bytes(text.encode("utf-8"))
    return path


def test_markers_as_written_whatever_their_axes(tmp_path: Path) -> None:
    """A CSV is y up by definition: a lying body stays lying."""
    recording = read_recording(
        write(tmp_path, "# made up\ntime,A_x,A_y,A_z,B_x,B_y,B_z\n0,1,2,3,9,2,3\n0.017,,,,0.1,NaN,3\n")
    )
    assert recording.labels == ("A", "B")
    np.testing.assert_array_equal(recording.markers[0], [[1, 2, 3], [9, 2, 3]])
    assert np.isnan(recording.markers[1]).all()
    np.testing.assert_array_equal(recording.time, [0, 0.017])


def test_quoted_names_columns_in_any_order_and_foreign_line_ends(tmp_path: Path) -> None:
    text = '\ufefftime,"A, left_z",B_x,"A, left_x",B_z,B_y,"A, left_y"\r\n0,3,4,1,6,5,2\r\n'
    recording = read_recording(write(tmp_path, text))
    assert recording.labels == ("A, left", "B")
    np.testing.assert_array_equal(recording.markers[0], [[1, 2, 3], [4, 5, 6]])


def test_repeated_columns_are_further_markers(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path, "time,A_x,A_y,A_z,A_x,A_y,A_z\n0,1,2,3,4,5,6\n"))
    assert recording.labels == ("A", "A#2")
    np.testing.assert_array_equal(recording.markers[0, 1], [4, 5, 6])


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "the file is empty"),
        ("\n \n", "only blank lines"),
        ("# only\n# comments\n", "only comments"),
        ("A_x,A_y,A_z\n1,2,3\n", "a header 'time,NAME_x,NAME_y,...' with commas is needed"),
        ("time;A_x;A_y;A_z\n0;1;2;3\n", "separated by ';'"),
        ("time,A_x,A_y\n0,1,2\n", "marker A: found only x, y; x, y and z are needed"),
        ("time,A_x,A_y,A_z,knee\n0,1,2,3,4\n", "found the column 'knee'"),
        ("time\n0\n", "found no marker columns"),
        ("time,A_x,A_y,A_z\n", "found no row of numbers"),
        ("time,A_x,A_y,A_z\n0,1,2\n", "line 2: found 3 cells (file cut short?); 4 are needed"),
        ("time,A_x,A_y,A_z\n0,1,2,3,4\n", "line 2: found 5 cells; 4 are allowed"),
        ("time,A_x,A_y,A_z\n0,1,zwei,3\n", "line 2, column 3: found 'zwei'"),
        ("time,A_x,A_y,A_z\n1,1,2,3\n0,1,2,3\n", "line 3, time: found 0 s after 1 s"),
        (FORCES + "\n0,1,2,3,4,5,6,7,8,9\n", "this is a table of forces"),
        ("time,A_x,A_y,A_z\n0,1\0,2,3\n", "binary data"),
    ],
)
def test_faults(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_recording(write(tmp_path, text))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_forces(tmp_path: Path) -> None:
    (plate,) = read_forces(write(tmp_path, FORCES + "\n0,1,700,3,4,5,6,7,8,9\n")).plates
    assert plate.name == "1"
    assert np.hstack([plate.force, plate.point, plate.moment])[0].tolist() == [1, 700, 3, 4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize(
    "text, message",
    [
        ("time,A_x,A_y,A_z\n0,1,2,3\n", "found the column 'A_x'; 1_fx, 1_px, 1_tx"),
        ("time,1_fx,1_fx\n0,1,2\n", "found the column '1_fx' twice"),
        ("time,1_fx,1_fy,1_fz\n0,1,2,3\n", "no point of application"),
        (FORCES.replace(",1_pz", "") + "\n0,1,2,3,4,5,6,7,8\n", "plate 1: found only x, y of the point"),
        (FORCES + "\n0,,,,,,,,,\n", "plate 1: its force columns hold no numbers"),
        ("time\n0\n", "found no force columns"),
    ],
)
def test_faults_of_forces(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_forces(write(tmp_path, text))
    assert message in str(caught.value)
