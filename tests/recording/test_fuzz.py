"""Damaged files end in a recording or in one clear error: never in another exception, a hang or a dead process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import GaitcalError
from gaitcal.recording import (
    Recording,
    read_forces,
    read_recording,
    write_c3d,
    write_forces_csv,
    write_forces_mot,
    write_markers_csv,
    write_trc,
)
from gaitcal.recording.c3d import parser
from tests.recording.recordings import loaded_body
from tests.scripts import script

MUTANTS = 200
mutated = script("fuzz_readers").mutated


def write_marker_file(path: Path, recording: Recording) -> None:
    {".c3d": write_c3d, ".trc": write_trc, ".csv": write_markers_csv}[path.suffix](path, recording)


def write_force_file(path: Path, recording: Recording) -> None:
    {".mot": write_forces_mot, ".csv": write_forces_csv}[path.suffix](path, recording.plates)


def fuzz(path: Path, content: bytes, read: Callable[[Path], object], head: int) -> int:
    """How many mutants were read all the same."""
    rng = np.random.default_rng(len(content))
    read_well = 0
    for _ in range(MUTANTS):
        path.write_bytes(mutated(content, rng, head))
        try:
            read(path)
        except GaitcalError as error:
            assert "\n" not in str(error)
            assert str(path) in str(error)
        else:
            read_well += 1
    return read_well


def read_and_require_sound(path: Path) -> None:
    recording = read_recording(path)
    assert len(set(recording.labels)) == len(recording.labels) == recording.markers.shape[1]
    assert recording.markers.shape == (len(recording.time), len(recording.labels), 3)
    assert np.all(np.diff(recording.time) > 0)
    assert not np.isinf(recording.markers).any()
    for plate in recording.plates:
        assert plate.force.shape == plate.point.shape == plate.moment.shape == (len(plate.time), 3)


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some damage makes the C3D parser loop; two seconds show that as well as six."""
    monkeypatch.setattr(parser, "BASE_SECONDS", 2.0)


@pytest.mark.parametrize("suffix, head", [(".c3d", 3000), (".trc", 600), (".csv", 300)])
def test_marker_files(tmp_path: Path, suffix: str, head: int) -> None:
    path = tmp_path / f"m{suffix}"
    write_marker_file(path, loaded_body(12))
    assert 0 < fuzz(path, path.read_bytes(), read_and_require_sound, head) < MUTANTS


@pytest.mark.parametrize("suffix, head", [(".mot", 600), (".csv", 300)])
def test_force_files(tmp_path: Path, suffix: str, head: int) -> None:
    path = tmp_path / f"f{suffix}"
    write_force_file(path, loaded_body(3))
    assert 0 < fuzz(path, path.read_bytes(), read_forces, head) < MUTANTS


@pytest.mark.parametrize("name", ["TYPE-1.C3D", "TYPE-4.C3D", "Eb015vi.c3d"])
def test_real_c3d_files(data_dir: Path, tmp_path: Path, name: str) -> None:
    content = (data_dir / "c3d_formats" / name).read_bytes()
    assert 0 < fuzz(tmp_path / "m.c3d", content, read_and_require_sound, 5000) < MUTANTS
