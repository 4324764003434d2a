"""`gaitcal export --format cycles`: strides in other conventions, each row with its unit and what is positive."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner, Result

from gaitcal.cli.application import app
from gaitcal.gait.cycles import EventSource, GaitCycle, GaitEvent, normalise
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.events import GaitEvents
from gaitcal.io.labels import FootMoment
from gaitcal.results.cycles import read_cycles
from tests.kept import kept_folder
from tests.synthetic_studies import write_synthetic_study

RUNNER = CliRunner()
ROUNDED = 2e-6
TIMES = 2e-3
"""Relative: events of the summary are rounded to 0.1 ms, which moves strides by a hundredth of a percent."""
MASS = 69.4


def run(*words: object) -> Result:
    return RUNNER.invoke(app, list(map(str, words)))


def strides(*_: object) -> GaitEvents:
    """One stride of either foot, wherever its feet may be: what counts here is that they are cut out alike."""
    times = [(0.21234, "r"), (0.4, "l"), (0.95, "r"), (1.1, "l")]
    return GaitEvents(tuple(GaitEvent(FootMoment.STRIKE, side, t, EventSource.MOTION) for t, side in times))


def kept_strides(kept: Path) -> Path:
    """A result with one stride of either foot."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("gaitcal.session.trial_result.trial_events", strides)
            done = run("calibrate", write_synthetic_study(folder / "study"), "--out", folder / "result", "-q")
        assert done.exit_code == 0, done.output

    return kept_folder(kept / "strides", make) / "result"


@pytest.fixture(scope="module")
def made(kept: Path) -> Path:
    return kept_strides(kept)


@pytest.fixture
def result(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made.parent / "study", tmp_path / "study")
    return Path(shutil.copytree(made, tmp_path / "result"))


def table(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, comment="#")


def exported(result: Path, *options: str) -> pd.DataFrame:
    done = run("export", result, "--format", "cycles", *options)
    assert done.exit_code == 0, done.output
    return table(result / "export" / "cycles.csv")


def test_strides_as_they_are_say_their_units_and_signs(result: Path) -> None:
    before, after = table(result / "cycles.csv"), exported(result)
    pd.testing.assert_frame_equal(after[list(before.columns)], before)
    assert set(after["unit"]) >= {"deg", "N m", "W"} and after["positive"].notna().all()
    said = after.groupby("variable")["positive"].first()
    assert said["ankle_angle_moment"] == "internal, dorsiflexion" and said["hip_power"] == "generated"


def test_a_clinical_convention_changes_signs_and_units_alone(result: Path) -> None:
    before = table(result / "cycles.csv")
    after = exported(result, "--convention", "clinical", "--units", "Nm/kg", "--external")
    of_leg = before["variable"].str.endswith("_moment") & ~before["variable"].str.startswith("lumbar")
    trunk = before["variable"].str.endswith("_moment") & ~of_leg
    powers = before["variable"].str.endswith("_power")
    assert of_leg.any() and trunk.any() and powers.any()
    extension = before["variable"].eq("lumbar_extension_moment") | before["side"].eq("l")
    of_trunk = np.where(extension[trunk], 1.0, -1.0) / MASS
    for rows, factor in ((of_leg, -1.0 / MASS), (trunk, of_trunk), (powers, 1.0 / MASS)):
        np.testing.assert_allclose(after["value"][rows], factor * before["value"][rows], atol=ROUNDED)
        np.testing.assert_allclose(after["se"][rows], before["se"][rows] / MASS, atol=ROUNDED)
    assert (after["se"].dropna() >= 0).all()
    pelvis = before["variable"].eq("pelvis_list")
    sign = np.where(before["side"][pelvis] == "r", -1.0, 1.0)
    np.testing.assert_allclose(after["value"][pelvis], sign * before["value"][pelvis], atol=ROUNDED)
    pd.testing.assert_series_equal(after["valid"], before["valid"])
    text = (result / "export/cycles.csv").read_text(encoding="utf-8").splitlines()
    head = "\n".join(line for line in text if line.startswith("#"))
    assert "external" in head and "clinical" in head and "N m/kg" in head
    assert set(after["unit"][of_leg]) == {"N m/kg"} and set(after["positive"][of_leg]) >= {"external, flexion"}
    manifest = json.loads((result / "export/manifest.json").read_text(encoding="utf-8"))
    assert manifest["written"]["cycles.csv"]["convention"] == {
        "signs": "clinical",
        "moments": "external",
        "frame": "coordinates",
        "moment_unit": "Nm/kg",
        "power_unit": "W/kg",
    }


@pytest.mark.parametrize("frame", ["proximal", "distal", "jcs"])
def test_moments_in_other_frames_are_those_of_the_vectors_over_the_same_strides(result: Path, frame: str) -> None:
    before, after = table(result / "cycles.csv"), exported(result, "--moments", frame)
    others = ~before["variable"].str.endswith("_moment")
    kept = after[~after["variable"].str.endswith("_moment")].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept[list(before.columns)], before[others].reset_index(drop=True))
    vectors = table(result / "moment_vectors/walk.csv")
    events = json.loads((result / "summary.json").read_text(encoding="utf-8"))["trials"]["walk"]["events"]
    strikes = [e["time"] for e in events if e["side"] == "l" and e["event"] == FootMoment.STRIKE.value]
    cycle = GaitCycle(strikes[0], strikes[1], None)
    found = after[(after["side"] == "l") & (after["stride"] == 1)]
    assert {"hip_rotation_moment", "knee_rotation_moment", "ankle_inversion_moment"} <= set(found["variable"])
    for name in ("knee_rotation", "ankle_angle", "hip_adduction"):
        rows = found[found["variable"] == f"{name}_moment"]
        known = rows[rows["se"].notna()]
        assert len(known) and known["se_stride"].between(1e-9, known["se"] + ROUNDED).all()
        for column, suffix in (("value", ""), ("se", "_se"), ("se_stride", "_se_stride")):
            expected = normalise(vectors["time"].to_numpy(), vectors[f"{name}_l_{frame}{suffix}"].to_numpy(), cycle)
            np.testing.assert_allclose(rows[column], expected, atol=ROUNDED)
    own = before[(before["side"] == "l") & (before["stride"] == 1)]
    means = ensemble(read_cycles(result / "export"))
    of_knee = means[(means["variable"] == "knee_rotation_moment") & (means["n"] > 0)]
    assert len(of_knee) and of_knee[["se", "sd_error"]].notna().all(axis=None) and set(of_knee["unit"]) == {"N m"}
    hip = found[found["variable"] == "hip_flexion_moment"]
    as_it_was = own[own["variable"] == "hip_flexion_moment"]
    assert hip["valid"].tolist() == as_it_was["valid"].tolist()
    if frame != "distal":  # the hip's flexion axis is the pelvis' z
        size = as_it_was["value"].abs().max()
        np.testing.assert_allclose(hip["value"].to_numpy(), as_it_was["value"].to_numpy(), atol=TIMES * size)


def test_powers_of_a_result_are_torques_times_velocities(made: Path) -> None:
    """Of the files alone: moments/, motion/ and powers/."""
    motion, moments, powers = (table(made / folder / "walk.csv") for folder in ("motion", "moments", "powers"))
    names = ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r")
    expected = sum(moments[name] * np.radians(motion[f"{name}_velocity"]) for name in names)
    np.testing.assert_allclose(powers["hip_power_r"], expected, atol=1e-5)
    np.testing.assert_allclose(powers["hip_power_r_per_kg"], expected / MASS, atol=1e-5)
    np.testing.assert_array_equal(powers["valid_l"], moments["valid_l"])
    assert (powers["hip_power_r_se"] > 0).all()


def test_further_trials_have_a_table_of_their_own(result: Path) -> None:
    """Told where the model has changed since."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitcal.session.trial_result.trial_events", strides)
        study = result.parent / "study"
        done = run("dynamics", result, study / "walk.csv", "--forces", study / "walk_forces.csv", "-q")
    assert done.exit_code == 0, done.output
    done = run("export", result, "--format", "cycles", "--external", "--moments", "distal")
    assert done.exit_code == 0 and "another model" not in done.output, done.output
    found = table(result / "export/dynamics_cycles.csv")
    vectors = table(result / "dynamics/moment_vectors/walk.csv")
    of_knee = found[(found["variable"] == "knee_angle_moment") & (found["side"] == "r")]
    assert len(of_knee) == 101 and -of_knee["value"].max() >= vectors["knee_angle_r_distal"].min() - ROUNDED
    with (result / "model.toml").open("a", encoding="utf-8") as model:
        model.write("# edited\n")
    assert "walk; run dynamics again" in run("export", result, "--format", "cycles").output.replace("\n", " ")


def test_wrong_words_are_told(result: Path) -> None:
    for options, said in (
        (("--convention", "clinicl"), "found 'clinicl'; allowed: opensim, clinical"),
        (("--moments", "tibia"), "allowed: coordinates, proximal, distal, jcs"),
        (("--units", "Nmm"), "allowed: Nm, Nm/kg, %BW*H"),
    ):
        done = run("export", result, "--format", "cycles", *options)
        assert done.exit_code and said in str(done.exception)
    done = run("export", result, "--format", "osim", "--external")
    assert done.exit_code and "--format cycles" in str(done.exception)


def test_a_result_without_vectors_gives_no_moments_in_their_frames(result: Path) -> None:
    shutil.rmtree(result / "moment_vectors")
    done = run("export", result, "--format", "cycles", "--moments", "distal")
    assert done.exit_code and not (result / "export").exists()
