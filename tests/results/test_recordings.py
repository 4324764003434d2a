"""`gaitcal export --format c3d`: the recording as it was, and angles, moments, powers, events,
joint centres in it.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pandas as pd
import pytest

from gaitcal.errors import Code, UsageError
from gaitcal.io.c3d.writer import AddedPoint, PointKind, open_c3d_original, supplement_c3d
from gaitcal.io.csv_recordings import EVENT_FILE
from gaitcal.io.formats import convert, read_recording
from gaitcal.io.labels import FootMoment
from gaitcal.io.result_folder import compute_sha256, read_listed_hashes
from gaitcal.results.cycles_export import find_original
from tests.commands import edited
from tests.commands import tried as run
from tests.kept import kept_result
from tests.messages import refuses
from tests.real_studies import write_study
from tests.synthetic_studies import STUDY, write_synthetic_study

DEG = np.rad2deg(1.0)
C3D_STUDY = STUDY.replace('file = "walk.csv"\nforces = "walk_forces.csv"\n', 'file = "walk.c3d"\n')
ANGLES = {
    "RHipAngles": ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r"),
    "LHipAngles": ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l"),
    "RKneeAngles": ("knee_angle_r",),
    "LAnkleAngles": ("ankle_angle_l",),
    "LSubtalarAngles": ("subtalar_angle_l",),
}
MOMENTS = {
    "RHipMoment": ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r"),
    "LKneeMoment": ("knee_angle_l", "knee_adduction_l"),
    "RAnkleMoment": ("ankle_angle_r",),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose walk is a C3D file, and its result."""
    folder = tmp_path_factory.mktemp("made")
    write_synthetic_study(folder / "study")
    convert(folder / "study/walk.csv", folder / "study/walk.c3d")
    (folder / "study/study.toml").write_text(C3D_STUDY, encoding="utf-8")
    done = run(
        "calibrate", folder / "study/study.toml", "--out", folder / "result", "-q", "--force"
    )
    assert done.exit_code == 0, done.output
    return folder


def points(path: Path) -> tuple[dict[str, Any], Any]:
    """Label -> (nf, 3) of a C3D file, NaN where missing; and the file."""
    file = ezc3d.c3d(str(path))
    values = file["data"]["points"][:3].transpose(1, 2, 0).copy()
    values[file["data"]["meta_points"]["residuals"][0] < 0] = np.nan
    return dict(zip(entries(file, "LABELS"), values, strict=True)), file


def entries(file: Any, name: str) -> list[str]:
    """A list of POINT, with what goes on in `NAME2`."""
    group = file["parameters"]["POINT"]
    return [text for key in (name, f"{name}2") if key in group for text in group[key]["value"]]


def same(a: Any, b: Any) -> bool:
    """Equal as 32-bit floats."""
    return bool(
        np.array_equal(
            np.asarray(a, dtype=np.float32), np.asarray(b, dtype=np.float32), equal_nan=True
        )
    )


def test_the_recording_and_what_was_computed(folder: Path) -> None:
    result = folder / "result"
    done = run("export", result, "--format", "c3d", "--inputs", folder / "study")
    assert done.exit_code == 0, done.output
    before, after = (
        read_recording(folder / "study/walk.c3d"),
        read_recording(result / "export/walk.c3d"),
    )
    assert before.labels == after.labels and np.array_equal(
        before.markers, after.markers, equal_nan=True
    )
    assert all(
        np.array_equal(a.wrench(), b.wrench())
        for a, b in zip(before.plates, after.plates, strict=True)
    )
    found, file = points(result / "export/walk.c3d")
    motion = pd.read_csv(result / "motion/walk.csv", comment="#")
    moments = pd.read_csv(result / "moments/walk.csv", comment="#")
    for label, names in ANGLES.items():
        assert same(found[label][:, : len(names)], motion[list(names)].to_numpy())
    assert same(
        found["RPelvisAngles"] * [-1, -1, 1],
        motion[["pelvis_tilt", "pelvis_list", "pelvis_rotation"]],
    )
    assert same(
        found["LPelvisAngles"] * [-1, 1, -1],
        motion[["pelvis_tilt", "pelvis_list", "pelvis_rotation"]],
    )
    for label, names in MOMENTS.items():
        side = label[0].lower()
        valid = moments[f"valid_{side}" if f"valid_{side}" in moments else "valid"].to_numpy() == 1
        assert 0.2 < valid.mean() < 1.0
        expected = np.where(valid[:, None], -1e3 / 69.4 * moments[list(names)].to_numpy(), np.nan)
        assert same(found[label][:, : len(names)], expected)
    power = moments["knee_angle_r"] * motion["knee_angle_r_velocity"] / DEG / 69.4
    known = np.isfinite(found["RKneePower"][:, 2])
    assert known.any() and np.allclose(
        found["RKneePower"][known, 2], power[known], rtol=1e-5, atol=1e-6
    )
    assert file["parameters"]["GAITCAL"]["VERDICT"]["value"] == [
        json.loads((result / "summary.json").read_text())["trials"]["walk"]["verdict"]
    ]
    assert "RHJC" in file["parameters"]["POINT"]["MODELED_MARKERS"]["value"]


def test_joint_centres_lie_where_the_markers_do(folder: Path) -> None:
    """In the axes of the file (mm, z up), however the result is turned: knee centres beside the
    knees' markers.
    """
    run("export", folder / "result", "--format", "c3d", "--inputs", folder / "study")
    found, _ = points(folder / "result/export/walk.c3d")
    for side in "RL":
        knee, hip, ankle = (found[f"{side}{joint}JC"] for joint in "KHA")
        assert 350 < np.median(np.linalg.norm(hip - knee, axis=1)) < 480
        assert 350 < np.median(np.linalg.norm(ankle - knee, axis=1)) < 480
        assert (hip[:, 2] > knee[:, 2]).all() and (knee[:, 2] > ankle[:, 2]).all()
        heel = next(v for label, v in found.items() if "Heel" in label and label.startswith(side))
        assert np.nanmax(np.linalg.norm(ankle - heel, axis=1)) < 150


def test_events_are_those_of_the_file_and_the_missing_ones(folder: Path) -> None:
    result = folder / "result"
    run("export", result, "--format", "c3d", "--inputs", folder / "study")
    events = read_recording(result / "export/walk.c3d").events
    assert {(e.side, e.moment) for e in events} == {(s, m) for s in "rl" for m in FootMoment}
    # An export is a recording with these events: exporting it again adds none, and names ours
    # apart.
    shutil.copy(result / "export/walk.c3d", folder / "study/walk.c3d")
    with edited(result, "manifest.json") as manifest:
        manifest["inputs_sha256"]["walk.c3d"] = compute_sha256(folder / "study/walk.c3d")
    done = run(
        "export", result, "--format", "c3d", "--out", folder / "again", "--inputs", folder / "study"
    )
    assert done.exit_code == 0, done.output
    again = read_recording(folder / "again/walk.c3d")
    assert again.events == events
    found, _ = points(folder / "again/walk.c3d")
    assert same(found["gcRHipAngles"], found["RHipAngles"])
    # Those that a person corrected would contradict the file's own.
    (folder / "study" / EVENT_FILE).write_text("as hashed", encoding="utf-8")
    with edited(result, "manifest.json") as manifest:
        manifest["trials"]["walk"]["events"] = EVENT_FILE
        manifest["inputs_sha256"][EVENT_FILE] = compute_sha256(folder / "study" / EVENT_FILE)
    done = run(
        "export", result, "--format", "c3d", "--out", folder / "third", "--inputs", folder / "study"
    )
    assert "events of the file kept; those that were corrected stand in events.csv" in " ".join(
        done.output.split()
    )
    assert read_recording(folder / "third/walk.c3d").events == events


def test_no_torque_leaves_a_refused_trial(folder: Path) -> None:
    result = folder / "result"
    with edited(result, "summary.json") as summary:
        summary["trials"]["walk"]["verdict"] = "refused"
    done = run("export", result, "--format", "c3d", "--inputs", folder / "study")
    assert done.exit_code == 0 and "refused: no moments and no powers" in " ".join(
        done.output.split()
    )
    found, file = points(result / "export/walk.c3d")
    assert "RHipAngles" in found and not any(
        "Moment" in label or "Power" in label for label in found
    )
    assert file["parameters"]["GAITCAL"]["VERDICT"]["value"] == ["refused"]


def test_inputs_must_be_there_and_unchanged(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = folder / "result"
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert run("export", result, "--format", "c3d").exit_code == 0, "in a folder beside the result"
    (folder / "other").mkdir()
    (folder / "other/walk.c3d").write_bytes(b"of somebody else")
    (folder / "away/deep").mkdir(parents=True)
    shutil.move(folder / "study", folder / "away/deep/study")
    assert run("export", result, "--format", "c3d", "--inputs", folder / "away").exit_code == 0
    missing = run("export", result, "--format", "c3d")
    shutil.move(folder / "away/deep/study", folder / "study")
    assert (
        missing.exit_code == 1
        and "walk.c3d" in str(missing.exception)
        and "--inputs" in str(missing.exception)
    )
    monkeypatch.chdir(folder / "study")
    assert run("export", result, "--format", "c3d").exit_code == 0
    with (folder / "study/walk.c3d").open("ab") as stream:
        stream.write(b"\0")
    changed = run("export", result, "--format", "c3d")
    assert changed.exit_code == 1 and "another SHA-256" in str(changed.exception)
    nowhere = run("export", result, "--format", "c3d", "--inputs", folder / "nowhere")
    assert isinstance(nowhere.exception, UsageError)


def test_the_folder_says_what_was_written_of_what(folder: Path) -> None:
    result, export = folder / "result", folder / "result/export"
    run("export", result, "--format", "osim,urdf")
    first = read_listed_hashes(export)
    run("export", result, "--format", "c3d,osim", "--inputs", folder / "study")
    assert set(first) == {"model.osim", "model.urdf"} and set(read_listed_hashes(export)) == {
        *first,
        "walk.c3d",
    }
    assert read_listed_hashes(export) == {
        name: compute_sha256(export / name) for name in read_listed_hashes(export)
    }
    manifest = json.loads((export / "manifest.json").read_text(encoding="utf-8"))
    of_result = manifest["written"]["walk.c3d"]["result"]["sha256"]
    assert {"model.toml", "splines.npz", "moments/walk.csv"} <= set(of_result)
    assert all(compute_sha256(result / name) == digest for name, digest in of_result.items())
    assert manifest["written"]["walk.c3d"]["source_sha256"] == compute_sha256(
        folder / "study/walk.c3d"
    )


@pytest.mark.slow
def test_a_text_recording_becomes_a_c3d(kept: Path, tmp_path: Path) -> None:
    shutil.copytree(kept_result(kept), tmp_path, dirs_exist_ok=True)
    (tmp_path / "result").rename(tmp_path / "study/result")
    done = run("export", tmp_path / "study/result", "--format", "c3d")
    assert done.exit_code == 0, done.output
    before = read_recording(tmp_path / "study/walk.csv", forces=tmp_path / "study/walk_forces.csv")
    after = read_recording(tmp_path / "study/result/export/walk.c3d")
    assert before.labels == after.labels and np.allclose(before.markers, after.markers, atol=1e-6)
    assert len(after.plates) == 2
    found, _ = points(tmp_path / "study/result/export/walk.c3d")
    motion = pd.read_csv(tmp_path / "study/result/motion/walk.csv", comment="#")
    assert same(found["RKneeAngles"][:, 0], motion["knee_angle_r"])


@pytest.mark.slow
def test_a_c3d_of_poses_is_written_with_the_points_that_stand_for_them(
    data_dir: Path, tmp_path: Path
) -> None:
    """It has no markers of its own beside which ours could stand."""
    theia = data_dir / "more_labs/theia"
    done = run(
        "calibrate", theia, "--out", tmp_path / "result", "--mass", "75", "--height", "1.75", "-q"
    )
    assert done.exit_code == 0, done.output
    done = run("export", tmp_path / "result", "--format", "c3d", "--inputs", theia)
    assert done.exit_code == 0 and "written anew: without poses" in done.output, done.output
    after = read_recording(tmp_path / "result/export/poses.c3d")
    assert after.labels == read_recording(theia / "poses.c3d").labels
    found, _ = points(tmp_path / "result/export/poses.c3d")
    motion = pd.read_csv(tmp_path / "result/motion/poses.csv", comment="#")
    assert same(found["RKneeAngles"][:, 0], motion["knee_angle_r"])


@pytest.mark.parametrize("file", ["children/HC002D/straight.c3d", "pig_c3d/gait.c3d"])
def test_points_of_a_vendors_names_take_their_place_and_nothing_else_moves(
    file: str, data_dir: Path, tmp_path: Path
) -> None:
    """Our values and descriptions under the same names, the same count of points; all others bit
    for bit.
    """
    source, target = data_dir / file, tmp_path / "out.c3d"
    before, whole = points(source)
    original = open_c3d_original(source, whole["data"]["points"].shape[2])
    values = np.arange(3.0 * original.frames).reshape(-1, 3)
    values[3] = np.nan
    names = ["LKneeAngles", "RHipAngles"]
    ours = [
        AddedPoint(name=n, kind=PointKind.ANGLE, values=values + k, description=f"ours {k}")
        for k, n in enumerate(names)
    ]
    lost = supplement_c3d(
        original, target, [*ours, AddedPoint(name="new", kind=PointKind.ANGLE, values=values)]
    )
    after, written = points(target)
    assert set(after) - set(before) == {"new"} and len(after) == len(before) + 1
    for k, name in enumerate(names):
        assert same(after[name], values + k) and not same(after[name], before[name])
    assert all(same(after[name], before[name]) for name in before if name not in names)
    described = entries(written, "DESCRIPTIONS")[list(after).index("RHipAngles")]
    assert described == "ours 1" or (described == "" and "POINT:DESCRIPTIONS" in lost)
    assert entries(written, "ANGLES").count("RHipAngles") == entries(whole, "ANGLES").count(
        "RHipAngles"
    )
    assert np.array_equal(whole["data"]["analogs"], written["data"]["analogs"])
    old, new = read_recording(source), read_recording(target)
    assert old.labels == new.labels and np.array_equal(old.markers, new.markers, equal_nan=True)


@pytest.mark.slow
def test_against_the_vendor(data_dir: Path, tmp_path: Path) -> None:
    """Plug-in Gait's own curves in the same file: every sign agrees (correlation over the frames of
    both legs).

    Soft tissue moves the left thigh of this person by 3 degrees: both legs together correlate less
    in adduction.
    """
    least = {
        "HipAngles": (0.99, 0.8, 0.8),
        "KneeAngles": (0.99,),
        "AnkleAngles": (0.95,),
        "PelvisAngles": (0.9, 0.5, 0.9),
        "FootProgressAngles": (-1.0, -1.0, 0.9),
    }
    least |= {"NormalisedGRF": (0.99, 0.97, 0.999)}
    least |= {"HipMoment": (0.85, 0.9, 0.85), "KneeMoment": (0.9, 0.9), "AnkleMoment": (0.99,)}
    study, result = write_study("pig_c3d", data_dir.resolve(), tmp_path), tmp_path / "result"
    study.write_text(study.read_text(encoding="utf-8") + "time = [3.6, 5.8]\n", encoding="utf-8")
    assert run("calibrate", study, "--out", result, "-q").exit_code == 0
    assert run("export", result, "--format", "c3d", "--inputs", data_dir / "pig_c3d").exit_code == 0
    found, _ = points(result / "export/gait.c3d")
    time = read_recording(result / "export/gait.c3d").time
    inside = np.isfinite(found["gcRHipAngles"][:, 0])
    assert np.array_equal(inside, (time > 3.599) & (time < 5.801)), (
        "only the frames that the study asks for"
    )
    for name, floors in least.items():
        ours, theirs = (
            np.concatenate([found[f"{start}{s}{name}"] for s in "RL"]) for start in ("gc", "")
        )
        both = np.isfinite(ours[:, 0]) & np.isfinite(theirs[:, 0]) & theirs.any(axis=1)
        for axis, floor in enumerate(floors):
            r = np.corrcoef(ours[both, axis], theirs[both, axis])[0, 1] if floor > 0.0 else 0.0
            assert r > floor, f"{name} {axis}"
            assert floor > 0.0 or not ours[both, axis].any(), "told along one axis only"
    assert isinstance(run("export", result, "--format", "osim", "--replace").exception, UsageError)
    done = run("export", result, "--format", "c3d", "--inputs", data_dir / "pig_c3d", "--replace")
    assert done.exit_code == 0 and "points of the file replaced" in done.output.replace(
        "\n", " "
    ), done.output
    instead, _ = points(result / "export/gait.c3d")
    assert set(instead) == {name.removeprefix("gc") for name in found}
    assert all(same(instead[name], found.get(f"gc{name}", found.get(name))) for name in instead)
    ours, theirs = found["gcRNormalisedGRF"], found["RNormalisedGRF"]
    both = np.isfinite(ours[:, 0]) & (theirs[:, 2] > 20.0)
    assert both.sum() > 50 and np.sqrt(np.mean((ours - theirs)[both] ** 2)) < 0.3, (
        "% of body weight, unfiltered"
    )
    for joint in ("Hip", "Knee", "Ankle"):
        ours, theirs = found[f"gcR{joint}Power"][:, 2], found[f"R{joint}Power"][:, 2]
        both = np.isfinite(ours) & np.isfinite(theirs)
        assert np.corrcoef(ours[both], theirs[both])[0, 1] > 0.85


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A result, and its recording in a folder that is neither beside it nor in it."""
    recording = tmp_path / "clinic/2024/gait.c3d"
    recording.parent.mkdir(parents=True)
    recording.write_bytes(b"walk")
    folder = tmp_path / "results/somebody"
    folder.mkdir(parents=True)
    manifest = {"kind": "calibration", "inputs_sha256": {"gait.c3d": compute_sha256(recording)}}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    (folder / "study.toml").write_text(
        '[[trial]]\nname = "gait"\nfile = "../../clinic/2024/gait.c3d"\n', encoding="utf-8"
    )
    return folder


def test_the_drafted_study_tells_where_a_recording_lies_and_another_file_there_is_not_taken(
    result: Path,
) -> None:
    assert find_original(result, "gait.c3d", None).read_bytes() == b"walk"
    (result / "../../clinic/2024/gait.c3d").write_bytes(b"another walk")
    with refuses(Code.CHANGED_FILE, "gait.c3d", source="results"):
        find_original(result, "gait.c3d", None)
    for text in ("", "no [toml", "trial = 3", "[[trial]]\nfile = 5"):
        (result / "study.toml").write_text(text, encoding="utf-8")
        with refuses(Code.CHANGED_FILE, source="results"):
            find_original(result, "gait.c3d", None)
