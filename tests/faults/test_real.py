"""Real recordings: no false errors, and the true peculiarities found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.faults.study import check_file, check_study
from gaitcal.findings import Finding, Severity
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import with_trial
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


def test_each_plate_of_subject01_has_one_foot(data_dir: Path, tmp_path: Path) -> None:
    told = [f.found for f in checked("subject01", data_dir, tmp_path) if f.topic == "plate to foot"]
    assert len(told) == 5
    assert all(("plate 1" in text) == ("right foot" in text) for text in told)


def test_standing_force_of_real_people(data_dir: Path, tmp_path: Path) -> None:
    told = [f.found for f in checked("functional_c3d", data_dir, tmp_path) if f.topic == "body mass"]
    assert told == ["the plates carry 647 N = 66.0 kg while standing; subject.mass_kg is 66"]


def test_mass_that_is_wrong(data_dir: Path, tmp_path: Path) -> None:
    path = write_study("functional_c3d", data_dir, tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("mass_kg = 66.0", "mass_kg = 76.0"), encoding="utf-8")
    assert [f.severity for f in check_file(path) if f.topic == "body mass"] == [Severity.WARNING]


@pytest.mark.parametrize("name", REAL)
def test_what_real_people_do_is_no_finding(name: str, data_dir: Path, tmp_path: Path) -> None:
    told = [f for f in checked(name, data_dir, tmp_path) if f.severity is not Severity.INFO]
    assert [f.line for f in told if f.topic in ("body mass", "trials", "static trial", "frozen")] == []
    assert [f.line for f in told if "wrong sign" in f.cause or "of both feet" in f.found] == []


@pytest.mark.parametrize(
    ("force", "shift", "words"),
    [
        ((-1.0, 1.0, 1.0), 0.0, "drive first and brake later"),
        ((1.0, 1.0, -1.0), 0.0, "push outwards"),
        ((1.0, 1.2, 1.0), 0.0, "the plates carry 87"),
        ((1.0, 1.0, 1.0), 0.05, "to the right of the line heel-toe of both feet"),
        ((1.0, 1.0, 1.0), -0.05, "to the left of the line heel-toe of both feet"),
    ],
)
def test_faults_of_forces_on_a_real_treadmill(
    force: tuple[float, ...], shift: float, words: str, data_dir: Path, tmp_path: Path
) -> None:
    study = Study.load(write_study("subject01", data_dir, tmp_path))

    def spoil(r: Recording) -> Recording:
        # The moment is about the point, so that the wrench about any other place follows.
        plates = [replace(p, force=p.force * force, point=p.point + [0.0, 0.0, shift]) for p in r.plates]
        return replace(r, plates=tuple(plates))

    told = [f.found for f in check_study(with_trial(study, "walk", spoil)) if f.severity is Severity.WARNING]
    assert any(words in text for text in told), told


def test_unreadable_files_are_findings(data_dir: Path, tmp_path: Path) -> None:
    path = write_study("pig_c3d", data_dir, tmp_path)
    mips = (data_dir / "c3d_formats/Eb015si.c3d").as_posix()
    text = path.read_text(encoding="utf-8").replace((data_dir / "pig_c3d/gait.c3d").as_posix(), mips)
    path.write_text(text, encoding="utf-8")
    (found,) = check_file(path)
    assert (found.where, found.severity) == ("gait", Severity.ERROR)
    assert "MIPS" in found.found and found.source == mips
