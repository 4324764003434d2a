"""TRC files with the quirks that real ones have."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.io.axes import Turn
from gaitcal.io.formats import read_recording
from gaitcal.io.opensim_files import parse_trc, write_trc
from tests.commands import refused
from tests.io.recordings import body

HEADER = (
    "PathFileType\t4\t(X/Y/Z)\tmade up.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "{rate}\t100\t{frames}\t{markers}\t{units}\t100\t1\t   999\n"
    "Frame#\tTime\t{names}\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = "1\t0.00\t1\t900\t3\t4\t50\t6\n2\t0.01\t1.5\t900\t3\t4\t50\t6\n3\t0.02\t2\t900\t3\t4\t50\t6\n"


def write(
    folder: Path, rows: str = ROWS, names: str = "A\t\t\tB\t\t", units: str = "mm", frames: int = 3, markers: int = 2
) -> Path:
    path = folder / "t.trc"
    text = HEADER.format(rate=50, frames=frames, markers=markers, units=units, names=names) + rows
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("blank", ["", "\n", "\t\t\t\t\t\t\t\n"])
@pytest.mark.parametrize("tail", ["", "\t", "\t   \t\t"])
def test_blank_line_six_and_trailing_tabs(tmp_path: Path, blank: str, tail: str) -> None:
    recording = parse_trc(write(tmp_path, blank + ROWS.replace("\n", tail + "\n")))
    assert recording.labels == ("A", "B")
    np.testing.assert_array_equal(recording.markers[:, 0, 0], [0.001, 0.0015, 0.002])
    np.testing.assert_array_equal(recording.time, [0, 0.01, 0.02])
    assert recording.notes == ()


def test_counts_that_lie_are_told_or_ignored(tmp_path: Path) -> None:
    recording = parse_trc(write(tmp_path, frames=1763, markers=40))
    assert recording.markers.shape == (3, 2, 3)
    assert recording.rate == pytest.approx(100)  # the Time column, not DataRate 50
    assert recording.notes == ("Header says 1763 frames; 3 found.",)


@pytest.mark.parametrize("gap", ["\t\t", "NaN\tnan\tNaN", "0\t0.0\t0.000", "7\t\t8"])
def test_every_spelling_of_a_gap(tmp_path: Path, gap: str) -> None:
    recording = parse_trc(write(tmp_path, ROWS.replace("1.5\t900\t3", gap)))
    assert np.argwhere(np.isnan(recording.markers)).tolist() == [[1, 0, axis] for axis in range(3)]


def test_rows_without_their_trailing_empty_cells(tmp_path: Path) -> None:
    recording = parse_trc(write(tmp_path, ROWS.replace("1.5\t900\t3\t4\t50\t6", "1.5\t900\t3")))
    assert np.isnan(recording.markers[1, 1]).all()
    assert any("1 rows end before" in note for note in recording.notes)


@pytest.mark.parametrize("units, height", [("mm", 0.9), ("m", 900.0), ("cm", 9.0), ("MM", 0.9)])
def test_units(tmp_path: Path, units: str, height: float) -> None:
    assert parse_trc(write(tmp_path, units=units)).markers[0, 0, 1] == pytest.approx(height)


@pytest.mark.parametrize(
    "rows, units, message",
    [
        (ROWS, "inch", "Units: found 'inch'; allowed are mm, cm and m"),
        (ROWS.replace("900", "9x0", 1), "mm", "line 6, column 4: found '9x0'"),
        (ROWS.replace("900", "9_0", 1), "mm", "found '9_0'"),
        (ROWS.replace("900", "1e999", 1), "mm", "infinite number"),
        (ROWS.replace("0.02", "0.01"), "mm", "line 8, time: found 0.01 s after 0.01 s; time must increase"),
        (ROWS.replace("0.01", ""), "mm", "line 7, time: found no number"),
        (ROWS + "4\t0.03\t1\t2", "mm", "line 9: found 4 cells (file cut short?); 8 are needed"),
    ],
)
def test_faults_name_line_and_cell(tmp_path: Path, rows: str, units: str, message: str) -> None:
    with refused(message):
        parse_trc(write(tmp_path, rows, units=units))


def test_names_in_any_layout(tmp_path: Path) -> None:
    assert parse_trc(write(tmp_path, names="A\tB")).labels == ("A", "B")
    assert parse_trc(write(tmp_path, names="S:A\t\t\tS:A\t\t\t\t\t")).labels == ("A", "A#2")
    recording = parse_trc(write(tmp_path, names="\t\t\tB\t\t"))
    assert recording.labels == ("B",)
    np.testing.assert_array_equal(recording.markers[0, 0], np.array([4, 50, 6]) / 1000)


def test_a_z_up_file_is_stood_up(tmp_path: Path) -> None:
    upright = body(5)
    z_up = replace(upright, markers=Turn((0, 2, 1), (1, -1, 1)).apply(upright.markers))
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
    lines = HEADER.format(rate=50, frames=3, markers=2, units="cm", names="A\t\t\tB\t\t").split("\n")
    lines[3] = "Frame#\tTime\tA" + between * "\t" + "B"
    rows = [row.replace("1.5\t900\t3", "\t\t" if gap else "1.5\t900\t3") + tail for row in ROWS.strip().split("\n")]
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
