"""Recordings of a result are found where the study says that was drafted into it, known by their SHA-256."""

import json
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io.result_folder import sha256_of
from gaitcal.results.cycles_export import find_original


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A result, and its recording in a folder that is neither beside it nor in it."""
    recording = tmp_path / "clinic/2024/gait.c3d"
    recording.parent.mkdir(parents=True)
    recording.write_bytes(b"walk")
    folder = tmp_path / "results/somebody"
    folder.mkdir(parents=True)
    manifest = {"kind": "calibration", "inputs_sha256": {"gait.c3d": sha256_of(recording)}}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    (folder / "study.toml").write_text(
        '[[trial]]\nname = "gait"\nfile = "../../clinic/2024/gait.c3d"\n', encoding="utf-8"
    )
    return folder


def test_the_drafted_study_tells_where_a_recording_lies(result: Path) -> None:
    assert find_original(result, "gait.c3d", None).read_bytes() == b"walk"


def test_another_file_at_that_place_is_not_taken(result: Path) -> None:
    (result / "../../clinic/2024/gait.c3d").write_bytes(b"another walk")
    with pytest.raises(InputError, match=r"gait\.c3d"):
        find_original(result, "gait.c3d", None)


@pytest.mark.parametrize("text", ["", "no [toml", "trial = 3", "[[trial]]\nfile = 5"])
def test_a_study_of_another_form_tells_nothing(result: Path, text: str) -> None:
    (result / "study.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="--inputs"):
        find_original(result, "gait.c3d", None)
