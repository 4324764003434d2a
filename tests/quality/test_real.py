"""Real recordings: no false errors, and the true peculiarities found."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gaitcal.errors import Severity
from gaitcal.quality.study_checks import check_file, check_study
from gaitcal.study.study import Study
from tests.real_studies import REAL, write_study

NOTED = {
    "pig_c3d": [("gait", "plate to foot", "left foot rests partly beside it (")],
    "uf3": [("ankle_r", "time", "CameraRate 100"), ("knee_r", "jumps", "the recording has a seam")],
    "functional_c3d": [
        (
            "hip_r",
            "swapped labels",
            "'RLFE' and 'RMFE' have swapped labels in 958 frames, 7.49-17.06 s",
        )
    ],
}
"""Trial, topic, words of notes, facts that need no action, that are true of these recordings."""


@pytest.mark.parametrize("name", REAL)
def test_no_error_no_warning_and_the_known_notes(
    name: str, real_study: Callable[[str], Study]
) -> None:
    found = check_study(real_study(name))
    assert [f.line for f in found if f.severity is not Severity.INFO] == []
    for where, topic, words in NOTED.get(name, []):
        reported = [f.evidence for f in found if (f.where, f.topic) == (where, topic)]
        assert any(words in text for text in reported), reported


def test_unreadable_files_are_findings(data_dir: Path, tmp_path: Path) -> None:
    path = write_study("pig_c3d", data_dir, tmp_path)
    mips = (data_dir / "c3d_formats/Eb015si.c3d").as_posix()
    text = path.read_text(encoding="utf-8").replace(
        (data_dir / "pig_c3d/gait.c3d").as_posix(), mips
    )
    path.write_text(text, encoding="utf-8")
    (found,) = check_file(path)
    assert (found.where, found.severity) == ("gait", Severity.ERROR)
    assert "MIPS" in found.found and found.source == mips
