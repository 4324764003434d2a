"""Recordings without markers: from a bare folder to a verdict, and made-up ones against
the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal import load_model
from gaitcal.intake.draft_file import format_draft
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.people_in_folder import describe_placement_difference, measure_pair_distances
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.csv_recordings import write_markers_csv
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import add_landmarks, make_upright_posture
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.model_file import save_model
from gaitcal.model.nominal import published_model
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.study import Study
from gaitcal.synthetic.synthetic_motion import simulate_gait
from scripts.validation.harness import results
from scripts.validation.markerless import (
    TORQUES,
    Errors,
    body_poses,
    points_recording,
    poses_recording,
)
from tests.messages import check_text
from tests.quality.spoilt import serious


def test_a_bare_folder_of_poses(data_dir: Path, tmp_path: Path) -> None:
    """The only file walks: it is the walk, and the standing posture comes from its segments; mass
    is asked for.
    """
    made = draft_folder(read_folder(data_dir / "more_labs/theia"), Options())
    assert made.fault == made.problem == "" and made.missing == ("mass_kg",)
    assert [(trial.name, trial.role) for trial in made.trials] == [
        ("poses_upright", "static"),
        ("poses", "gait"),
    ]
    assert all(trial.certain for trial in made.trials)
    path = tmp_path / "study.toml"
    path.write_text(
        format_draft(
            draft_folder(read_folder(data_dir / "more_labs/theia"), Options(mass=75.0)), tmp_path
        )
    )
    study = Study.load(path)
    model = build_nominal_model(study)
    assert model.noise is not None and model.noise == study.marker_set.noise
    check_text(model.notes)
    save_model(model, tmp_path / "model.toml")
    assert load_model(tmp_path / "model.toml").noise == model.noise


@pytest.mark.slow
def test_poses_against_the_truth() -> None:
    """Poses 10 mm and 4 deg off their segments, and 5 mm and 2 deg that come and go."""
    found = results("markerless", "--parts", "biased", "--people", 1, "--seed", 1)["biased"]
    assert found["verdicts"] == ["trustworthy"]
    assert max(found["centres_mm"].values()) < 30.0
    for torque in ("hip_flexion", "hip_adduction", "knee_angle", "ankle_angle"):
        assert found[torque]["covered"] >= 0.9 and 2.0 < found[torque]["se"] < 15.0
        assert found[torque]["rms"] < 12.0


def test_a_bare_folder_of_key_points(tmp_path: Path) -> None:
    """One walk of key points alone: a standing person is made of it, and nothing is said to be
    wrong.
    """
    person, walk = published_model().parameters, simulate_gait()
    exact = Errors(place=0.0, turn=0.0)
    write_markers_csv(
        tmp_path / "walk.csv",
        points_recording(0, exact, body_poses(person, walk.q), walk.basis.time),
    )
    made = draft_folder(read_folder(tmp_path), Options(mass=69.4, height=1.7, sex="male"))
    assert (
        made.fault == made.problem == ""
        and made.choice is not None
        and made.choice.entry == "key-points"
    )
    assert [(trial.name, trial.role) for trial in made.trials] == [
        ("walk_upright", "static"),
        ("walk", "gait"),
    ]
    (tmp_path / "study.toml").write_text(format_draft(made, tmp_path))
    study = Study.load(tmp_path / "study.toml")
    assert serious(study) == []
    model, poses = build_nominal_model(study), body_poses(person, walk.q)
    for side in "rl":
        for segment, above in (("shank", "thigh"), ("foot", "shank")):
            length = np.linalg.norm(
                poses[f"{side}_{segment}"][1] - poses[f"{side}_{above}"][1], axis=1
            ).mean()
            centre = {"shank": "kjc", "foot": "ajc"}[segment]
            assert np.linalg.norm(model.landmarks[f"{centre}_{side}"][1]) == pytest.approx(
                length, abs=1e-3
            )


def test_augmented_markers_beside_key_points_are_the_set() -> None:
    """OpenCap leaves the key points in the file of the markers that it makes of them."""
    walk = simulate_gait()
    poses = body_poses(published_model().parameters, walk.q)
    points = points_recording(0, Errors(place=0.0, turn=0.0), poses, walk.basis.time)
    augmented = load_marker_set("opencap").labels
    both = replace(
        points,
        labels=(*points.labels, *augmented),
        markers=np.concatenate(
            [points.markers, np.ones((len(points.time), len(augmented), 3))], axis=1
        ),
    )
    assert add_landmarks(points).labels != points.labels
    assert add_landmarks(both) is both and make_upright_posture(both) is both


@pytest.mark.parametrize(
    ("made", "marker_set", "errors"),
    [(poses_recording, "poses", Errors()), (points_recording, "key-points", Errors(place=0.015))],
)
def test_another_person_without_markers(
    made: Callable[..., Recording], marker_set: str, errors: Errors
) -> None:
    """Corners of a pose keep their distances whoever moves; bones tell, beyond what they err by."""
    walk, known = simulate_gait(), load_marker_set(marker_set)
    poses = body_poses(published_model().parameters, walk.q)
    child = {name: (axes, 0.8 * origin) for name, (axes, origin) in poses.items()}
    recordings = [
        add_landmarks(made(seed, errors, of, walk.basis.time))
        for seed, of in enumerate([poses] * 3 + [child])
    ]
    first, *others = (measure_pair_distances(recording, known) for recording in recordings)
    assert [bool(describe_placement_difference(first, other, known)) for other in others] == [
        False,
        False,
        True,
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "centres_mm"), [("opensim_poses", 20.0), ("opensim_points", 40.0)]
)
def test_people_whom_opensim_knows_without_markers(
    data_dir: Path, part: str, centres_mm: float
) -> None:
    """Knees that are no hinges, masses that are not ours: feet of 2.1 % of the body swing on the
    knees.
    """
    found = results("markerless", "--parts", part, "--people", 1)[part]
    assert (
        set(found["verdicts"]) == {"trustworthy"} and max(found["centres_mm"].values()) < centres_mm
    )
    covered = {torque: found[torque]["covered"] for torque in TORQUES if torque in found}
    assert min(covered.values()) > 0.8 and sum(covered.values()) / len(covered) > 0.92
