"""Conversion between formats."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.csv import write_forces_csv, write_plates_csv
from gaitcal.io.formats import convert, read_forces, read_recording
from gaitcal.io.opensim_files import write_trc
from gaitcal.io.recording import Recording
from tests.io.recordings import body, loaded_body


def require_same(found: Recording, expected: Recording) -> None:
    """Markers, times and plates in every bit."""
    assert found.labels == expected.labels
    np.testing.assert_array_equal(found.time, expected.time)
    np.testing.assert_array_equal(found.markers, expected.markers)
    for a, b in zip(found.plates, expected.plates, strict=True):
        assert a.name == b.name
        for field in ("time", "force", "point", "moment"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
        assert (a.corners is None) == (b.corners is None)
        if a.corners is not None:
            np.testing.assert_array_equal(a.corners, b.corners)


@pytest.mark.parametrize(
    "file",
    [
        "pig_c3d/gait.c3d",
        "pig_c3d/static.c3d",
        "functional_c3d/static.c3d",
        "c3d_formats/Eb015vi.c3d",
        "c3d_formats/TYPE-1.C3D",
    ],
)
def test_a_real_c3d_and_its_csv_are_the_same_bits(data_dir: Path, tmp_path: Path, file: str) -> None:
    written = convert(data_dir / file, tmp_path / "out.csv")
    facts = ("_facts",) if file.startswith("pig") else ()  # the others say nothing of person and events
    assert written == tuple(tmp_path / f"out{kind}.csv" for kind in ("", "_forces", "_plates", *facts))
    require_same(read_recording(written[0], forces=written[1]), read_recording(data_dir / file))


def test_corners_go_with_the_forces_and_not_with_others(tmp_path: Path) -> None:
    plate = loaded_body().plates[0]
    write_forces_csv(tmp_path / "a_forces.csv", (plate,))
    assert read_forces(tmp_path / "a_forces.csv").plates[0].corners is None
    write_plates_csv(tmp_path / "a_plates.csv", (plate,))
    read = read_forces(tmp_path / "a_forces.csv")
    np.testing.assert_array_equal(read.plates[0].corners, plate.corners)
    assert any("a_plates.csv" in note for note in read.notes)
    written = convert(tmp_path / "a_forces.csv", tmp_path / "b_forces.mot")
    assert written == (tmp_path / "b_forces.mot", tmp_path / "b_plates.csv")
    np.testing.assert_array_equal(read_forces(written[0]).plates[0].corners, plate.corners)
    (tmp_path / "a_plates.csv").unlink()
    assert convert(tmp_path / "a_forces.csv", tmp_path / "b_forces.mot") == written
    assert read_forces(written[0]).plates[0].corners is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("corner,x\n", "a header 'plate,corner,x,y,z' is needed"),
        ("", "empty"),
        ("plate,corner,x,y,z\n1,1,0,0,0\n", "corner 2, 3, 4 of plate '1' is missing"),
        ("plate,corner,x,y,z\n1,5,0,0,0\n", "a corner of 1 to 4"),
        ("plate,corner,x,y,z\n1,1,0,nan,0\n", "three numbers"),
        ("plate,corner,x,y,z\n1,1,0,0\n", "three numbers"),
        ("plate,corner,x,y,z\n1,one,0,0,0\n", "plate,corner,x,y,z are needed"),
        ("plate,corner,x,y,z\n1,1,0,0,0\n1,1,0,0,0\n", "corner 1 of plate '1' twice"),
        ("plate,corner,x,y,z\n9,1,0,0,0\n9,2,0,0,0\n9,3,0,0,0\n9,4,0,0,0\n", "found the plate '9'"),
    ],
)
def test_damaged_corners_are_told(tmp_path: Path, text: str, told: str) -> None:
    write_forces_csv(tmp_path / "a_forces.csv", loaded_body().plates)
    (tmp_path / "a_plates.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=told) as caught:
        read_forces(tmp_path / "a_forces.csv")
    assert "a_plates.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_c3d_to_trc_brings_its_forces(tmp_path: Path) -> None:
    write_c3d(tmp_path / "x.c3d", loaded_body())
    written = tuple(tmp_path / name for name in ("y.trc", "y_forces.mot", "y_plates.csv"))
    assert convert(tmp_path / "x.c3d", tmp_path / "y.trc") == written
    require_same(
        read_recording(tmp_path / "y.trc", forces=tmp_path / "y_forces.mot"), read_recording(tmp_path / "x.c3d")
    )


def test_faults_leave_the_target_as_it_was(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", body(5))
    write_forces_csv(tmp_path / "f.csv", loaded_body().plates)
    target = tmp_path / "out.mot"
    target.write_text("old")
    with pytest.raises(InputError, match=r"a.trc can become .csv, .trc, .c3d"):
        convert(tmp_path / "a.trc", target)
    with pytest.raises(InputError, match=r"f.csv can become .csv, .mot, .sto"):
        convert(tmp_path / "f.csv", tmp_path / "out.trc")
    with pytest.raises(InputError, match="no such file"):
        convert(tmp_path / "absent.c3d", target)
    with pytest.raises(InputError, match="the same file"):
        convert(tmp_path / "a.trc", tmp_path / "." / "a.trc")
    with pytest.raises(InputError, match="found a folder"):
        convert(tmp_path / "a.trc", tmp_path)
    (tmp_path / "bad.mot").write_text("no table")
    with pytest.raises(InputError, match="endheader"):
        convert(tmp_path / "bad.mot", tmp_path / "bad.csv")
    assert target.read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.trc", "bad.mot", "f.csv", "out.mot"]
