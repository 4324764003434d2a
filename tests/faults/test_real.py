"""Real recordings: no false errors, and the true peculiarities found."""

from pathlib import Path

import pytest

from gaitcal.errors import Finding, Severity
from gaitcal.faults.study import check_file
from tests.real_studies import REAL, write_study

FOUND = {"subject01": [], "uf3": [], "functional_c3d": [], "pig_c3d": []}
"""Trial, topic, words of warnings that are true of these recordings; there are no others."""
NOTED = {
    "pig_c3d": [("gait", "plate to foot", "left foot rests partly beside it (")],
    "uf3": [("ankle_r", "time", "CameraRate 100"), ("knee_r", "jumps", "the recording has a seam")],
    "functional_c3d": [
        ("hip_r", "exchanged", "'RLFE' and 'RMFE' carry each other's label in 958 frames, 7.49-17.06 s")
    ],
}
"""The same of notes: facts that need no action."""


def checked(name: str, data_dir: Path, folder: Path) -> tuple[Finding, ...]:
    return check_file(write_study(name, data_dir, folder))


@pytest.mark.parametrize("name", REAL)
def test_no_false_error_and_the_known_warnings(name: str, data_dir: Path, tmp_path: Path) -> None:
    found = checked(name, data_dir, tmp_path)
    assert [f.line for f in found if f.severity is Severity.ERROR] == []
    for where, topic, words in FOUND[name]:
        told = [f.found for f in found if (f.where, f.topic, f.severity) == (where, topic, Severity.WARNING)]
        assert any(words in text for text in told), told
    assert len([f.line for f in found if f.severity is Severity.WARNING]) == len(FOUND[name])
    for where, topic, words in NOTED.get(name, []):
        told = [f.evidence for f in found if (f.where, f.topic, f.severity) == (where, topic, Severity.INFO)]
        assert any(words in text for text in told), told


def test_unreadable_files_are_findings(data_dir: Path, tmp_path: Path) -> None:
    path = write_study("pig_c3d", data_dir, tmp_path)
    mips = (data_dir / "c3d_formats/Eb015si.c3d").as_posix()
    text = path.read_text(encoding="utf-8").replace((data_dir / "pig_c3d/gait.c3d").as_posix(), mips)
    path.write_text(text, encoding="utf-8")
    (found,) = check_file(path)
    assert (found.where, found.severity) == ("gait", Severity.ERROR)
    assert "MIPS" in found.found and found.source == mips
