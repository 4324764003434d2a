"""The one list of real people: every file is there, and studies name the right ones."""

from pathlib import Path

from gaitcal.study.study_file import load_study_file
from scripts.validation.recordings import CHILDREN, CLINICS, EVERYBODY, JOINTS, PEOPLE


def test_every_listed_file_is_there(data_dir: Path) -> None:
    missing = [file for person in EVERYBODY.values() for file in person.files if not (data_dir / file).is_file()]
    assert missing == []
    assert set(CHILDREN) < set(PEOPLE) < set(EVERYBODY) and "p01" not in CLINICS


def test_a_study_names_static_trial_walk_forces_and_the_joints_asked_for(data_dir: Path, tmp_path: Path) -> None:
    trials = load_study_file(EVERYBODY["subject01"].recorded()(tmp_path)).trials
    assert [(t.name, t.file.stem, t.forces and t.forces.stem) for t in trials] == [
        ("static", "subject01_static", None),
        ("walk", "subject01_walk1", "subject01_walk1_grf"),
    ]
    trials = load_study_file(EVERYBODY["uf3"].recorded(joints=JOINTS)(tmp_path)).trials
    assert [t.joint for t in trials] == [None, *JOINTS, None] and trials[-1].file.stem == "gait"
    turn = load_study_file(EVERYBODY["HC002D"].recorded("turn")(tmp_path))
    assert (turn.trials[-1].file.stem, turn.subject.mass_kg) == ("turn", 32.1)


def test_what_no_file_holds_is_told_to_the_command() -> None:
    assert EVERYBODY["pig"].options == ("--sex", "male")
    assert EVERYBODY["pig"].facts == ("--mass", "66.5", "--height", "1.79")
    assert EVERYBODY["uf3"].options[::2] == ("--mass", "--height", "--sex") and EVERYBODY["uf3"].facts == ()
