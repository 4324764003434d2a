"""What users see of public objects at a prompt and in a notebook, and their tables."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

import gaitcal as gc
from gaitcal.analysis.result import Calibration
from gaitcal.display import Displayed
from gaitcal.pipeline.write_results import write_results
from tests.kept import kept_synthetic


@pytest.fixture(scope="module")
def calibration(kept: Path) -> Calibration:
    return kept_synthetic(kept)


@pytest.fixture(scope="module")
def public_objects(calibration: Calibration) -> dict[str, Displayed]:
    trial = calibration.trial("walk")
    assert trial.loads is not None and trial.loads.kinetics is not None
    return {
        "Study": calibration.study,
        "Recording": trial.recording,
        "MarkerSet": calibration.study.marker_set,
        "SubjectModel": calibration.model,
        "Motion": trial.body,
        "GroundReactions": trial.loads.reactions,
        "Moments": trial.loads.final,
        "JointKinetics": trial.loads.kinetics,
        "Calibration": calibration,
        "TrialResult": trial,
        "Trial": calibration.study.trials[0],
        "Parameters": calibration.model.parameters,
        "MarkerErrors": trial.body.errors,
    }


def test_public_objects_are_printed_in_two_to_six_short_lines(
    public_objects: dict[str, Displayed],
) -> None:
    for name, shown in public_objects.items():
        lines = repr(shown).splitlines()
        assert 2 <= len(lines) <= 6, name
        assert max(map(len, lines)) <= 160, name
        table = ET.fromstring(shown._repr_html_())
        assert len(table.findall("tr")) == len(lines) - 1, name


def test_numbers_of_a_description_are_those_of_the_object(
    public_objects: dict[str, Displayed],
) -> None:
    motion, study = public_objects["Motion"], public_objects["Study"]
    assert isinstance(motion, gc.Motion) and isinstance(study, gc.Study)
    rms = motion.errors.rms()
    assert rms is not None
    assert f"{1e3 * rms:.1f} mm" in repr(motion)
    assert f"{len(motion.time)} frames" in repr(motion)
    assert all(trial.name in repr(study) for trial in study.trials)


def test_names_of_files_are_escaped_in_notebooks() -> None:
    recording = gc.Recording(
        source="a<b>.csv", time=np.zeros(1), labels=("<i>",), markers=np.zeros((1, 1, 3))
    )
    assert "<i>" in repr(recording)
    assert "<i>" not in recording._repr_html_()


def test_tables_have_the_columns_and_values_of_the_csv_files(
    calibration: Calibration, public_objects: dict[str, Displayed], tmp_path: Path
) -> None:
    write_results(calibration, tmp_path)
    files = {
        "Motion": ("motion",),
        "Moments": ("moments",),
        "JointKinetics": ("powers", "moment_vectors"),
    }
    for name, folders in files.items():
        table = public_objects[name].to_dataframe()  # type: ignore[attr-defined]
        written = [pd.read_csv(tmp_path / folder / "walk.csv", comment="#") for folder in folders]
        known = {column for of_file in written for column in of_file}
        assert set(table) <= known
        for of_file in written:
            left = [c for c in of_file if c not in table and not c.startswith("valid")]
            assert all(c.endswith(("_se", "_se_stride", "_per_kg")) for c in left)
            for column in set(of_file) & set(table):
                np.testing.assert_allclose(
                    of_file[column], table[column], rtol=1e-5, atol=1e-4, err_msg=column
                )


def test_tables_of_recordings_and_ground_reactions(public_objects: dict[str, Displayed]) -> None:
    recording, ground = public_objects["Recording"], public_objects["GroundReactions"]
    assert isinstance(recording, gc.Recording) and isinstance(ground, gc.GroundReactions)
    paths = recording.to_dataframe()
    label = recording.labels[3]
    np.testing.assert_array_equal(
        paths[[f"{label}_{axis}" for axis in "xyz"]], recording.markers[:, 3]
    )
    table = ground.to_dataframe()
    force = table[[f"ground_force_l_v{axis}" for axis in "xyz"]].to_numpy()
    point = table[[f"ground_force_l_p{axis}" for axis in "xyz"]].to_numpy()
    torque = table[[f"ground_torque_l_{axis}" for axis in "xyz"]].to_numpy()
    np.testing.assert_allclose(
        np.hstack([force, torque + np.cross(point, force)]), ground.wrench[:, 1], atol=1e-9
    )
    assert (table.valid == ground.valid).all()


def test_a_model_is_built_from_a_person_or_from_parameters(calibration: Calibration) -> None:
    person, parameters = (
        gc.build_model(calibration.model),
        gc.build_model(calibration.model.parameters),
    )
    assert person == parameters
