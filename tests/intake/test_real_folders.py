"""Bare folders of real recordings: marker set, roles and sides as their laboratories meant them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.intake.draft_file import build_study, format_draft
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.people_in_folder import find_session
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.model.parameters import JP_NAMES
from gaitcal.preprocess.study_model import build_nominal_model
from tests.intake.folders import JOINTS, roles
from tests.messages import check_text

FOLDERS = {
    "labs_c3d/kad": ("plug-in-gait", {"static": "static", "walk": "gait"}, ()),
    "labs_c3d/multi": (
        "plug-in-gait",
        {"static": "static"} | {f"walk0{k}": "gait" for k in range(3, 8)},
        (),
    ),
    "children/HC002D": (
        "plug-in-gait",
        {"static": "static", "straight": "gait", "turn": "gait"},
        (),
    ),
    "pig_c3d": ("plug-in-gait", {"static": "static", "gait": "gait"}, ()),
    "functional_c3d": (
        "conventional73",
        {"static": "static", "hip_r": "joint hip_r", "knee_r": "joint knee_r"},
        (),
    ),
    "more_labs/one_frame_static": ("cast", {"static": "static", "walk": "gait"}, ("mass_kg",)),
    "more_labs/mt_feet": ("visual3d", {"static": "static", "walk": "gait"}, ()),
    "subject01": ("gait2354", {"subject01_static": "static", "subject01_walk1": "gait"}, ()),
    "uf3": (
        "rcnl",
        {"static": "static", "gait": "gait"} | {joint: f"joint {joint}" for joint in JOINTS},
        ("mass_kg",),
    ),
}


WITH_HEIGHT = ("labs_c3d/kad", "labs_c3d/multi", "children/HC002D", "pig_c3d")


@pytest.mark.parametrize("name", FOLDERS)
def test_bare_folders(name: str, data_dir: Path) -> None:
    marker_set, expected, missing = FOLDERS[name]
    made = draft_folder(read_folder(data_dir / name), Options())
    assert made.fault == "" and made.problem == ""
    assert made.choice is not None and made.choice.entry == marker_set
    assert roles(made) == expected
    assert made.missing == missing
    assert ("height_error_m" in made.person) == (name not in WITH_HEIGHT)
    assert all(trial.certain for trial in made.trials)
    forces = [trial.forces.file.name for trial in made.trials if trial.forces]
    assert forces == {
        "subject01": ["subject01_walk1_grf.mot"],
        "more_labs/mt_feet": ["walk_grf.mot"],
    }.get(name, [])
    assert [row.name for row in made.left_out] == (
        ["static_unlabelled.c3d"] if name == "uf3" else []
    )
    assert str(data_dir) not in format_draft(made, data_dir / name), "paths are relative"


def test_recordings_without_standing(data_dir: Path) -> None:
    made = draft_folder(read_folder(data_dir / "c3d_formats"), Options())
    assert made.fault and made.trials == ()
    assert {row.name for row in made.rows if "SGI/MIPS" in row.reason} == {
        "Eb015si.c3d",
        "Eb015sr.c3d",
    }


def test_a_recording_with_joint_centres_is_the_walk_again(data_dir: Path) -> None:
    """The set lies beside the folder, as laboratories keep one for all of their people."""
    made = draft_folder(read_folder(data_dir / "opensim_truth/p01"), Options())
    assert roles(made) == {"static": "static", "walk": "gait"}
    assert made.choice is not None and made.choice.entry.endswith("markerset.toml")
    assert made.trials[-1].forces is not None and made.trials[-1].forces.file.name == "grf.mot"
    (again,) = (row for row in made.left_out if row.name == "walk_with_joint_centres.trc")
    check_text(again.reason, "walk.trc")


SWAY = 0.01
"""rad, and m: axes of one frame turn by 0.5 deg against those of the mean, centres lie within 1 mm.
"""


def test_one_frame_stands_for_a_static_trial(data_dir: Path) -> None:
    """Joint parameters of any frame of a child who stands are those of the mean, to what standing
    sways; and where a longer trial is there, too, that one is the first.
    """
    made = draft_folder(read_folder(data_dir / "children/HC002D"), Options(sex="female"))
    assert made.choice is not None
    study = build_study(made)
    standing_still, whole = study.static.recording, build_nominal_model(study).parameters.joint
    legs = [
        i
        for i, name in enumerate(JP_NAMES)
        if name.startswith(("hip", "knee", "talocrural", "subtalar"))
    ]
    shown = np.flatnonzero(np.isfinite(standing_still.markers).all(axis=(1, 2)))
    for frame in shown[[0, len(shown) // 2, -1]]:
        moment = standing_still.frames(np.arange(len(standing_still.time)) == frame)
        one = replace(study, trials=(replace(study.static, recording=moment), *study.trials[1:]))
        assert np.abs(build_nominal_model(one).parameters.joint - whole)[legs].max() < SWAY
    sitting = find_session(
        {0: moment, 1: standing_still}, {0: "static a", 1: "static b"}, made.choice.marker_set
    )
    assert sitting is not None
    assert sitting.statics == (1, 0)
