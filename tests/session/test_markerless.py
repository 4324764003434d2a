"""Recordings without markers: from a bare folder to a verdict, and made-up ones against the truth."""

from __future__ import annotations

from pathlib import Path

import pytest

from gaitcal import load_model
from gaitcal.model.model_file import save_model
from gaitcal.session.draft import draft_text
from gaitcal.session.drafting import draft_of
from gaitcal.session.folder import read_folder
from gaitcal.session.person_facts import Options
from gaitcal.study.study import Study, nominal_of
from scripts.validation.harness import results


def test_a_bare_folder_of_poses(data_dir: Path, tmp_path: Path) -> None:
    """The only file walks: it is the walk, and the standing posture comes from its segments; mass is asked for."""
    made = draft_of(read_folder(data_dir / "more_labs/theia"), Options())
    assert made.fault == made.problem == "" and made.missing == ("mass_kg",)
    assert [(trial.name, trial.role) for trial in made.trials] == [("poses_upright", "static"), ("poses", "gait")]
    assert all(trial.certain for trial in made.trials)
    path = tmp_path / "study.toml"
    path.write_text(draft_text(draft_of(read_folder(data_dir / "more_labs/theia"), Options(mass=75.0)), tmp_path))
    study = Study.load(path)
    model = nominal_of(study)
    assert model.noise is not None and model.noise == study.marker_set.noise
    assert any("hip centres are points of the file" in note for note in model.notes)
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
