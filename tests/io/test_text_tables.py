"""Our own CSV tables, and the door to all readers: endings, encodings, missing files, forces in
place of plates.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.errors import Code
from gaitcal.io.axes import AxisPermutation
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.csv_recordings import write_forces_csv
from gaitcal.io.formats import read_forces, read_recording
from gaitcal.io.opensim_files import parse_trc, write_trc
from gaitcal.io.text_file import read_lines, undo_rounding
from tests.commands import refused
from tests.io.recordings import body, loaded_body
from tests.messages import check_text, refuses

FORCES = "time," + ",".join(f"1_{q}{a}" for q in "fpt" for a in "xyz")


def write(folder: Path, text: str) -> Path:
    path = folder / "t.csv"
    path.write_bytes(text.encode("utf-8"))
    return path


def test_markers_as_written_whatever_their_axes(tmp_path: Path) -> None:
    """A CSV is y up by definition: a lying body stays lying."""
    recording = read_recording(
        write(
            tmp_path, "# made up\ntime,A_x,A_y,A_z,B_x,B_y,B_z\n0,1,2,3,9,2,3\n0.017,,,,0.1,NaN,3\n"
        )
    )
    assert recording.labels == ("A", "B")
    np.testing.assert_array_equal(recording.markers[0], [[1, 2, 3], [9, 2, 3]])
    assert np.isnan(recording.markers[1]).all()
    np.testing.assert_array_equal(recording.time, [0, 0.017])


def test_quoted_names_columns_in_any_order_foreign_line_ends_and_repeated_columns(
    tmp_path: Path,
) -> None:
    text = '\ufefftime,"A, left_z",B_x,"A, left_x",B_z,B_y,"A, left_y"\r\n0,3,4,1,6,5,2\r\n'
    recording = read_recording(write(tmp_path, text))
    assert recording.labels == ("A, left", "B")
    np.testing.assert_array_equal(recording.markers[0], [[1, 2, 3], [4, 5, 6]])
    recording = read_recording(write(tmp_path, "time,A_x,A_y,A_z,A_x,A_y,A_z\n0,1,2,3,4,5,6\n"))
    assert recording.labels == ("A", "A#2"), "a further marker"
    np.testing.assert_array_equal(recording.markers[0, 1], [4, 5, 6])


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "the file is empty"),
        ("# only\n# comments\n", "only comments"),
        ("A_x,A_y,A_z\n1,2,3\n", "a header 'time,NAME_x,NAME_y,...' with commas is needed"),
        ("time;A_x;A_y;A_z\n0;1;2;3\n", "separated by ';'"),
        ("time,A_x,A_y\n0,1,2\n", "marker A: found only x, y; x, y and z are needed"),
        ("time,A_x,A_y,A_z,knee\n0,1,2,3,4\n", "found the column 'knee'"),
        ("time,A_x,A_y,A_z\n0,1,2\n", "line 2: found 3 cells (file cut short?); 4 are needed"),
        ("time,A_x,A_y,A_z\n0,1,zwei,3\n", "line 2, column 3: found 'zwei'"),
        ("time,A_x,A_y,A_z\n1,1,2,3\n0,1,2,3\n", "line 3, time: found 0 s after 1 s"),
        (FORCES + "\n0,1,2,3,4,5,6,7,8,9\n", "this is a table of forces"),
        ("time,A_x,A_y,A_z\n0,1\0,2,3\n", "binary data"),
    ],
)
def test_faults(tmp_path: Path, text: str, message: str) -> None:
    with refused(message):
        read_recording(write(tmp_path, text))


@pytest.mark.parametrize(
    "text, message",
    [
        ("time,A_x,A_y,A_z\n0,1,2,3\n", "found the column 'A_x'; 1_fx, 1_px, 1_tx"),
        ("time,1_fx,1_fx\n0,1,2\n", "found the column '1_fx' twice"),
        ("time,1_fx,1_fy,1_fz\n0,1,2,3\n", "no point of application"),
        (
            FORCES.replace(",1_pz", "") + "\n0,1,2,3,4,5,6,7,8\n",
            "plate 1: found only x, y of the point",
        ),
        (FORCES + "\n0,,,,,,,,,\n", "plate 1: its force columns hold no numbers"),
    ],
)
def test_faults_of_forces(tmp_path: Path, text: str, message: str) -> None:
    with refused(message):
        read_forces(write(tmp_path, text))


RATE = 60.0
EXACT = 7 / RATE + np.arange(40) / RATE


@pytest.mark.parametrize("shorten", [np.round, np.floor, np.ceil])
def test_times_written_to_the_millisecond_are_put_back(shorten: np.ufunc) -> None:
    """Rounded to the nearest, cut off, or rounded up: up to a whole unit of the last digit."""
    time, notes = undo_rounding(shorten(1e3 * EXACT) / 1e3)
    np.testing.assert_allclose(time, EXACT, atol=1e-12)
    check_text(notes[0], 60)


def test_times_that_are_no_rounded_grid_stay() -> None:
    jittered = np.round(EXACT, 3)
    jittered[20] += 0.002
    time, notes = undo_rounding(jittered)
    np.testing.assert_array_equal(time, jittered)
    assert notes == ()
    jittered[20] += 0.005
    assert "uneven" in undo_rounding(jittered)[1][0]


@pytest.mark.parametrize("ending", ["c3d", "trc", "csv", "C3D"])
def test_missing_empty_and_folder(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"x.{ending}"
    with refused("no such file"):
        read_recording(path)
    path.touch()
    with refused("the file is empty"):
        read_recording(path)
    path.unlink()
    path.mkdir()
    with refused("found a folder"):
        read_recording(path)


def test_endings_that_no_reader_knows(tmp_path: Path) -> None:
    path = tmp_path / "x.c3dd"
    path.write_text("hello")
    with refused("found the ending '.c3dd'; allowed are .c3d, .trc, .csv; did you mean '.c3d'"):
        read_recording(path)
    with refused("allowed are .mot, .sto, .csv"):
        read_forces(path)


@pytest.mark.parametrize("content", ["hello, this is text\n" * 200, "x", "\x02Pabc"])
def test_text_named_c3d(tmp_path: Path, content: str) -> None:
    path = tmp_path / "x.c3d"
    path.write_text(content)
    with refuses(Code.FILE_FORMAT, source="x.c3d"):
        read_recording(path)


@pytest.mark.parametrize("name", ["x.trc", "x.csv", "x.mot"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_told_to_be_saved_as_utf_8(tmp_path: Path, name: str, encoding: str) -> None:
    path = tmp_path / name
    path.write_bytes("time,A_x,A_y,A_z\n0,1,2,3\n0.01,1,2,3\n".encode(encoding))
    with refuses(Code.NOT_TEXT, 16, 8):
        read_recording(path) if name != "x.mot" else read_lines(path)


def test_given_forces_take_the_place_of_the_plates(tmp_path: Path) -> None:
    recording = loaded_body()
    write_c3d(tmp_path / "x.c3d", recording)
    write_forces_csv(tmp_path / "f.csv", recording.plates[:1])
    found = read_recording(str(tmp_path / "x.c3d"), forces=str(tmp_path / "f.csv"))
    assert len(found.plates) == 1
    check_text(found.notes)
    assert len(read_recording(tmp_path / "x.c3d").plates) == 2


TRC_HEADER = (
    "PathFileType\t4\t(X/Y/Z)\tmade up.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "{rate}\t100\t{frames}\t{markers}\t{units}\t100\t1\t   999\n"
    "Frame#\tTime\t{names}\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
TWO = "A\t\t\tB\t\t"
TRC_ROWS = (
    "1\t0.00\t1\t900\t3\t4\t50\t6\n2\t0.01\t1.5\t900\t3\t4\t50\t6\n3\t0.02\t2\t900\t3\t4\t50\t6\n"
)


def trc(
    folder: Path,
    rows: str = TRC_ROWS,
    names: str = "A\t\t\tB\t\t",
    units: str = "mm",
    frames: int = 3,
    markers: int = 2,
) -> Path:
    path = folder / "t.trc"
    text = (
        TRC_HEADER.format(rate=50, frames=frames, markers=markers, units=units, names=names) + rows
    )
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("blank", ["", "\n", "\t\t\t\t\t\t\t\n"])
@pytest.mark.parametrize("tail", ["", "\t", "\t   \t\t"])
def test_blank_line_six_and_trailing_tabs(tmp_path: Path, blank: str, tail: str) -> None:
    recording = parse_trc(trc(tmp_path, blank + TRC_ROWS.replace("\n", tail + "\n")))
    assert recording.labels == ("A", "B")
    np.testing.assert_array_equal(recording.markers[:, 0, 0], [0.001, 0.0015, 0.002])
    np.testing.assert_array_equal(recording.time, [0, 0.01, 0.02])
    assert recording.notes == ()


def test_counts_that_lie_are_told_or_ignored(tmp_path: Path) -> None:
    recording = parse_trc(trc(tmp_path, frames=1763, markers=40))
    assert recording.markers.shape == (3, 2, 3)
    assert recording.rate == pytest.approx(100)  # the Time column, not DataRate 50
    assert recording.notes == ("Header declares 1763 frames; 3 found.",)


@pytest.mark.parametrize("gap", ["\t\t", "NaN\tnan\tNaN", "0\t0.0\t0.000", "7\t\t8"])
def test_every_spelling_of_a_gap(tmp_path: Path, gap: str) -> None:
    recording = parse_trc(trc(tmp_path, TRC_ROWS.replace("1.5\t900\t3", gap)))
    assert np.argwhere(np.isnan(recording.markers)).tolist() == [[1, 0, axis] for axis in range(3)]


def test_rows_without_their_trailing_empty_cells(tmp_path: Path) -> None:
    recording = parse_trc(trc(tmp_path, TRC_ROWS.replace("1.5\t900\t3\t4\t50\t6", "1.5\t900\t3")))
    assert np.isnan(recording.markers[1, 1]).all()
    check_text(recording.notes, 1)


@pytest.mark.parametrize("units, height", [("mm", 0.9), ("m", 900.0), ("cm", 9.0), ("MM", 0.9)])
def test_units(tmp_path: Path, units: str, height: float) -> None:
    assert parse_trc(trc(tmp_path, units=units)).markers[0, 0, 1] == pytest.approx(height)


@pytest.mark.parametrize(
    "rows, units, message",
    [
        (TRC_ROWS, "inch", "Units: found 'inch'; allowed are mm, cm and m"),
        (TRC_ROWS.replace("900", "9x0", 1), "mm", "line 6, column 4: found '9x0'"),
        (TRC_ROWS.replace("900", "9_0", 1), "mm", "found '9_0'"),
        (TRC_ROWS.replace("900", "1e999", 1), "mm", "infinite number"),
        (
            TRC_ROWS.replace("0.02", "0.01"),
            "mm",
            "line 8, time: found 0.01 s after 0.01 s; time must increase",
        ),
        (TRC_ROWS.replace("0.01", ""), "mm", "line 7, time: found no number"),
        (TRC_ROWS + "4\t0.03\t1\t2", "mm", "line 9: found 4 cells (file cut short?); 8 are needed"),
    ],
)
def test_faults_name_line_and_cell(tmp_path: Path, rows: str, units: str, message: str) -> None:
    with refused(message):
        parse_trc(trc(tmp_path, rows, units=units))


@pytest.mark.parametrize(("more", "unlabelled"), [(0, 0), (3, 1), (6, 2)])
def test_trajectories_beyond_the_names_are_unlabelled(
    tmp_path: Path, more: int, unlabelled: int
) -> None:
    """In some rows only, too: they are seen for a part of the time."""
    first, *rows = TRC_ROWS.splitlines()
    text = "\n".join([first, *(row + "\t7" * more for row in rows)]) + "\n"
    recording = parse_trc(trc(tmp_path, text))
    assert recording.labels == ("A", "B") and recording.markers.shape == (3, 2, 3)
    assert (f"{unlabelled} unlabelled trajectories left out." in recording.notes) is (more > 0)


def test_cells_beyond_the_names_that_make_no_trajectory_are_refused(tmp_path: Path) -> None:
    with refused("found 10 cells; 8 are allowed"):
        parse_trc(trc(tmp_path, TRC_ROWS.replace("50\t6\n", "50\t6\t1\t2\n")))


def test_a_real_file_with_five_trajectories_without_a_name(data_dir: Path) -> None:
    recording = parse_trc(data_dir / "cases/unnamed_columns/SprintCalib.trc")
    assert recording.markers.shape == (337, 65, 3)
    check_text(recording.notes, 5)


def test_names_in_any_layout(tmp_path: Path) -> None:
    assert parse_trc(trc(tmp_path, names="A\tB")).labels == ("A", "B")
    assert parse_trc(trc(tmp_path, names="S:A\t\t\tS:A\t\t\t\t\t")).labels == ("A", "A#2")
    recording = parse_trc(trc(tmp_path, names="\t\t\tB\t\t"))
    assert recording.labels == ("B",)
    np.testing.assert_array_equal(recording.markers[0, 0], np.array([4, 50, 6]) / 1000)


def test_a_z_up_file_is_stood_up(tmp_path: Path) -> None:
    upright = body(5)
    z_up = replace(upright, markers=AxisPermutation((0, 2, 1), (1, -1, 1)).apply(upright.markers))
    write_trc(tmp_path / "z.trc", z_up)
    recording = read_recording(tmp_path / "z.trc")
    np.testing.assert_array_equal(recording.markers, upright.markers)
    assert any("+z" in note for note in recording.notes)


@given(
    doubled=st.sets(st.sampled_from(["keys", "values", "names", "axes", "rows"])),
    between=st.integers(1, 7),
    gap=st.booleans(),
    tail=st.sampled_from(["", "\t", "\t\t\t"]),
)
def test_doubled_tabs(doubled: set[str], between: int, gap: bool, tail: str) -> None:
    """Tabs doubled in any lines, any number of them between names: the same recording."""
    lines = TRC_HEADER.format(rate=50, frames=3, markers=2, units="cm", names="A\t\t\tB\t\t").split(
        "\n"
    )
    lines[3] = "Frame#\tTime\tA" + between * "\t" + "B"
    rows = [
        row.replace("1.5\t900\t3", "\t\t" if gap else "1.5\t900\t3") + tail
        for row in TRC_ROWS.strip().split("\n")
    ]
    for place, name in enumerate(("keys", "values", "names", "axes"), start=1):
        if name in doubled:
            lines[place] = lines[place].replace("\t", "\t\t")
    if "rows" in doubled:
        rows = [row.replace("\t", "\t\t") for row in rows]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.trc"
        path.write_text("\n".join([*lines[:-1], *rows]) + "\n", encoding="utf-8")
        recording = parse_trc(path)
    assert recording.labels == ("A", "B")
    x = [0.01, np.nan if gap else 0.015, 0.02]
    np.testing.assert_allclose(recording.markers[:, 0, 0], x)
    np.testing.assert_allclose(recording.markers[:, 1], np.tile([0.04, 0.5, 0.06], (3, 1)))
    np.testing.assert_array_equal(recording.time, [0, 0.01, 0.02])
