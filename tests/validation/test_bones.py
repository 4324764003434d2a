"""Member `bones`: what it reads, and that skin is learnt and calibrated as tracked bones
have it.
"""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.soft_tissue_table import load_people_table, read_table
from scripts.validation.bones import floor, learn
from scripts.validation.bones.recordings import fit_hinge, hinge_errors, read_recordings
from scripts.validation.harness import results

AXIS = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])


def write_hinge(folder: Path, side: str, slide: float = 0.0, frames: int = 60) -> Path:
    """A knee that is a hinge through (5, 3, 0) mm, on markers of the thigh that slide by `slide` m
    per rad.
    """
    mirror = np.diag([1.0, 1.0, 1.0 if side == "r" else -1.0])
    flexion, rng = np.linspace(0.0, 1.2, frames), np.random.default_rng(1)
    cross = np.array([[0, -AXIS[2], AXIS[1]], [AXIS[2], 0, -AXIS[0]], [-AXIS[1], AXIS[0], 0]])
    turn = np.array(
        [np.eye(3) - np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross for a in flexion]
    )
    thigh, centre = np.repeat(np.eye(3)[None], frames, axis=0), np.array([0.005, 0.003, 0.0])
    at_thigh, at_shank = (rng.uniform(-0.1, 0.1, (5, 3)) for _ in range(2))
    moved = at_thigh + [0.0, slide, 0.0] * flexion[:, None, None]
    arrays = {"rate_hz": np.array(100.0)}
    for name, rotation, origin, markers in (
        ("thigh", thigh, np.zeros((frames, 3)), moved),
        (
            "shank",
            turn,
            centre - turn @ (centre + [0.0, 0.4, 0.0]),
            np.repeat(at_shank[None], frames, axis=0),
        ),
    ):
        arrays[f"{name}_{side}.rotation"] = mirror @ rotation @ mirror
        arrays[f"{name}_{side}.origin"], arrays[f"{name}_{side}.markers"] = (
            origin @ mirror,
            markers @ mirror,
        )
    file = folder / f"P{side}_knee_flexion.npz"
    np.savez(file, **arrays)
    return file


def test_a_left_leg_is_read_as_a_right_one_and_its_hinge_found(tmp_path: Path) -> None:
    for side in "rl":
        write_hinge(tmp_path, side)
    for recording in read_recordings(tmp_path):
        thigh, shank = recording.segments["thigh"], recording.segments["shank"]
        direction, point, _, below = fit_hinge(thigh, shank)
        np.testing.assert_allclose(direction, AXIS, atol=1e-9)
        np.testing.assert_allclose(
            (point - direction * point[2] / direction[2])[:2], [0.005, 0.003], atol=1e-9
        )
        assert max(hinge_errors(thigh, shank)) < 1e-9
        assert recording.knee_flexion[-1] > 1.0 and len(below) == 3


def test_slopes_of_skin_are_those_that_it_was_moved_by(tmp_path: Path) -> None:
    write_hinge(tmp_path, "l", slide=-0.02)
    (recording,) = read_recordings(tmp_path)
    found = learn.slopes_of(recording, "thigh").slopes.reshape(-1, 3) * 0.245 * 1.70 / 0.42
    np.testing.assert_allclose(found, np.tile([0.0, -0.02, 0.0], (5, 1)), rtol=0.1, atol=1e-3)


def test_the_table_that_ships_is_what_the_bones_show(data_dir: Path, tmp_path: Path) -> None:
    """Of the shank, which is quick: coefficients and scatter as `--learn` derives them."""
    recordings = list(read_recordings(data_dir / "bones"))
    field = learn.learn_field(learn.all_slopes(recordings, "shank"))
    learn.write_table({"shank": field}, recordings, tmp_path / "learnt.json")
    learnt, shipped = read_table(tmp_path / "learnt.json")["shank"], load_people_table()["shank"]
    np.testing.assert_allclose(learnt.coefficients, shipped.coefficients, atol=3e-4)
    np.testing.assert_allclose(
        [learnt.shift, learnt.per_marker], [shipped.shift, shipped.per_marker], rtol=0.03
    )


def test_oracles_of_a_hinge_reach_it_and_the_nominal_one_does_not(tmp_path: Path) -> None:
    """Markers of the thigh slide by 20 mm per rad; what the angle explains is all of it."""
    write_hinge(tmp_path, "r", slide=-0.02)
    (recording,) = read_recordings(tmp_path)
    nominal = floor.nominal_joint(recording)
    linear, still = (
        floor.move_back(recording, nominal, still=still).segments["thigh"].markers
        for still in (False, True)
    )
    np.testing.assert_allclose(linear, still, atol=1e-3)
    np.testing.assert_allclose(np.ptp(still, axis=0), 0.0, atol=1e-9)
    table = load_people_table()
    found = floor.compute_floor(recording, table, table)
    assert found is not None
    error = {oracle: np.linalg.norm(of) for oracle, of in found.error_mm.items()}
    assert set(error) == set(floor.ORACLES)
    assert error["nominal"] == pytest.approx(np.hypot(5.0, 3.0), rel=1e-6)
    # what is left is held by the priors of joint and noise, which are of people
    assert max(error["bones"], error["mean given"]) < 1.5
    assert error["all people"] == pytest.approx(error["calibrated"], abs=1e-6)
    assert len(list(floor.floor_lines([found, None]))) == 3


@pytest.mark.slow
def test_left_out_bones_are_met_better_than_by_landmarks_and_by_skin_alone(data_dir: Path) -> None:
    names = "B2_treadmill_walk,B6_sit_to_stand"
    for outcome in results("bones", "--folder", data_dir / "bones", "--only", names)["recordings"]:
        distance = outcome.distance_mm
        assert distance["calibrated"] < min(
            12.0, distance["skin alone"], distance["without soft tissue"]
        )
        assert outcome.flexion_deg["calibrated"][0] < (
            2.5 if outcome.name.endswith("walk") else 4.0
        )
