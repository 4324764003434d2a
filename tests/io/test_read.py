"""The door: endings, missing files, and forces that take the place of a file's own plates."""

from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.csv import write_forces_csv
from gaitcal.io.formats import read_forces, read_recording
from gaitcal.io.text_file import read_lines
from tests.io.recordings import loaded_body


@pytest.mark.parametrize("ending", ["c3d", "trc", "csv", "C3D"])
def test_missing_empty_and_folder(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"x.{ending}"
    with pytest.raises(InputError, match="no such file"):
        read_recording(path)
    path.touch()
    with pytest.raises(InputError, match="the file is empty"):
        read_recording(path)
    folder = tmp_path / f"folder.{ending}"
    folder.mkdir()
    with pytest.raises(InputError, match="found a folder"):
        read_recording(folder)


def test_endings_that_no_reader_knows(tmp_path: Path) -> None:
    path = tmp_path / "x.c3dd"
    path.write_text("hello")
    with pytest.raises(
        InputError, match=r"found the ending '.c3dd'; allowed are .c3d, .trc, .csv; did you mean '.c3d'"
    ):
        read_recording(path)
    with pytest.raises(InputError, match="allowed are .mot, .sto, .csv"):
        read_forces(path)


@pytest.mark.parametrize("content", ["hello, this is text\n" * 200, "x", "\x02Pabc"])
def test_text_named_c3d(tmp_path: Path, content: str) -> None:
    path = tmp_path / "x.c3d"
    path.write_text(content)
    with pytest.raises(InputError, match=r"not a C3D|damaged|cut short"):
        read_recording(path)


def test_a_c3d_named_trc(tmp_path: Path) -> None:
    path = tmp_path / "x.c3d"
    write_c3d(path, loaded_body())
    with pytest.raises(InputError, match="binary data"):
        read_recording(path.rename(tmp_path / "x.trc"))


@pytest.mark.parametrize("name", ["x.trc", "x.csv", "x.mot"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_told_to_be_saved_as_utf_8(tmp_path: Path, name: str, encoding: str) -> None:
    path = tmp_path / name
    path.write_bytes("time,A_x,A_y,A_z\n0,1,2,3\n0.01,1,2,3\n".encode(encoding))
    with pytest.raises(InputError, match="found UTF-16 text; save the file as UTF-8"):
        read_recording(path) if name != "x.mot" else read_lines(path)


def test_given_forces_take_the_place_of_the_plates(tmp_path: Path) -> None:
    recording = loaded_body()
    write_c3d(tmp_path / "x.c3d", recording)
    write_forces_csv(tmp_path / "f.csv", recording.plates[:1])
    found = read_recording(str(tmp_path / "x.c3d"), forces=str(tmp_path / "f.csv"))
    assert len(found.plates) == 1
    assert any("gave way" in note for note in found.notes)
    assert len(read_recording(tmp_path / "x.c3d").plates) == 2
