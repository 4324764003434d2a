"""Segment poses as points: four corners err as the pose does; axes and names of the file; a posture
of any movement.
"""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.errors import Code
from gaitcal.io.formats import read_recording
from gaitcal.io.segment_poses import (
    CORNERS,
    LENGTH_PER_TURN,
    NEEDED_SEGMENTS,
    PARENT,
    VISUAL3D,
    compute_pose_points,
    make_upright_posture,
)
from gaitcal.io.text_file import FileFault
from tests.io.recordings import standing_points_mm, write_raw_c3d
from tests.messages import refuses

FRAMES = 7
PLACES = {
    "thigh": (0.0, -0.09),
    "shank": (-0.4, -0.09),
    "foot": (-0.8, -0.09),
    "toes": (-0.85, -0.09),
}
"""Up and left of the pelvis, m."""


def body(
    turned: np.ndarray, names: tuple[str, ...] = tuple(PARENT)
) -> tuple[list[str], np.ndarray]:
    """Labels and (nf, ns, 4, 4) of a person who stands; `turned`: (3, 3), the file's axes in
    forward, up, right.
    """
    rng = np.random.default_rng(1)
    moves = Rotation.from_rotvec(0.3 * rng.standard_normal((FRAMES, 3))).as_matrix()
    out = np.tile(np.eye(4), (FRAMES, len(names), 1, 1))
    for k, name in enumerate(names):
        up, out_of_line = PLACES.get(name[2:], (0.5, -0.2))
        side = {"r": -1.0, "l": 1.0}.get(name[0], 0.0)
        place = np.array([0.15 if name.endswith("toes") else 0.0, up, side * out_of_line])
        out[:, k, :3, :3] = moves @ turned
        out[:, k, :3, 3] = moves @ place
    return [f"{name}_4X4" for name in names], out


def test_four_corners_err_as_position_and_turn_do() -> None:
    """Sum |dp|^2 = 4 (|place|^2 + (sigma_p / sigma_t)^2 |turn|^2), to second order of the turn."""
    rng = np.random.default_rng(0)
    place, turn = 1e-3 * rng.standard_normal(3), 1e-5 * rng.standard_normal(3)
    moved = CORNERS @ Rotation.from_rotvec(turn).as_matrix().T + place
    found = float(((moved - CORNERS) ** 2).sum())
    np.testing.assert_allclose(
        found, 4.0 * (place @ place + LENGTH_PER_TURN**2 * turn @ turn), rtol=1e-4
    )


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_any_axis_may_point_up(order: tuple[int, ...]) -> None:
    """Whichever axes of the file are forward, up and right, and whichever way round, the points are
    the same.
    """
    turned = np.eye(3)[:, order]
    turned[:, 0] *= np.linalg.det(turned)
    labels, points, _ = compute_pose_points(*body(turned))
    usual, expected, _ = compute_pose_points(*body(np.eye(3)))
    assert labels == usual
    np.testing.assert_allclose(points, expected, atol=1e-12)


CODES = {theirs: ours.upper() for ours, theirs in VISUAL3D.items() if len(ours) == 3}
WORDS = {"pelvis": "Pelvis"} | {
    theirs: ours.title() for ours, theirs in VISUAL3D.items() if len(ours) > 3
}


@pytest.mark.parametrize("spelling", [CODES, WORDS])
def test_segments_called_as_visual3d_calls_them(spelling: dict[str, str]) -> None:
    """`RTH`, or `Right Thigh`, for `r_thigh_4X4`, as in what Qualisys makes of Theia's files."""
    labels, poses = body(np.eye(3))
    theirs = [spelling[label.removesuffix("_4X4")] for label in labels]
    expected, found = compute_pose_points(labels, poses), compute_pose_points(theirs, poses)
    assert found[0] == expected[0] and found[2] == expected[2]
    np.testing.assert_array_equal(found[1], expected[1])


def test_both_namings_in_one_file_are_not_the_same_segment_twice() -> None:
    labels, poses = body(np.eye(3))
    both = np.concatenate([poses, poses[:, :1]], axis=1)
    _, points, _ = compute_pose_points([*labels, "RPV"], both)
    np.testing.assert_array_equal(points, compute_pose_points(labels, poses)[1])


def test_origins_of_segments_alone_are_refused_by_what_they_are(tmp_path: Path) -> None:
    """The labels of the public thread: 19 points, none of which shows how its segment turns."""
    labels = [
        f"{side}{code}" for side in "LR" for code in ("AR", "FA", "FT", "HA", "SK", "TH", "TO")
    ]
    labels += ["LAB", "RHE", "RPV", "RTA", "VLB"]
    points = np.random.default_rng(1).normal(0.0, 500.0, (5, len(labels), 3))
    with refuses(Code.TOO_LITTLE_SEEN, field="POINT:LABELS", source="origins.c3d") as fault:
        read_recording(write_raw_c3d(tmp_path / "origins.c3d", points, labels))
    assert fault.value.code is Code.TOO_LITTLE_SEEN


def test_segments_that_are_missing_or_turned_are_named() -> None:
    with refuses(FileFault, "l_thigh_4X4", "l_shank_4X4", "l_foot_4X4", "l_toes_4X4"):
        compute_pose_points(
            *body(np.eye(3), tuple(name for name in PARENT if not name.startswith("l_")))
        )
    labels, poses = body(np.eye(3))
    poses[:, labels.index("r_shank_4X4"), :3, :3] @= np.diag([-1.0, -1.0, 1.0])
    with refuses(FileFault, "r_shank"):
        compute_pose_points(labels, poses)
    labels, poses = body(np.eye(3))
    with refuses(FileFault, "pelvis_4X4"):
        compute_pose_points([*labels, "Pelvis_4x4"], np.concatenate([poses, poses[:, :1]], axis=1))
    with refuses(FileFault, "l_foot_4X4"):
        compute_pose_points(
            labels, np.where(np.array(labels)[:, None, None] == "l_foot_4X4", np.nan, poses)
        )
    poses[..., :3, 3] /= 1000.0
    with refuses(FileFault, 0.0004, 0.1, 0.8):
        compute_pose_points(labels, poses)


def test_lost_poses_are_gaps_and_standing_does_not_need_them(data_dir: Path) -> None:
    """Theia's own recording: its hips are 188 mm apart, whatever the person does, and it walks in
    every frame.
    """
    recording = read_recording(data_dir / "more_labs/theia/poses.c3d")
    assert recording.markers.shape == (340, 63, 3) and set(
        np.isnan(recording.markers[..., 0]).sum(axis=0)
    ) == {3, 5}
    still = make_upright_posture(recording)
    assert (
        np.ptp(still.markers, axis=0).max() == 0.0
        and make_upright_posture(still).labels == still.labels
    )
    at = {label: still.markers[0, i] for i, label in enumerate(still.labels)}
    assert np.linalg.norm(at["hjc_r"] - at["hjc_l"]) == pytest.approx(0.188, abs=0.001)
    assert at["hjc_r"][2] > 0 > at["hjc_l"][2] and at["toe_r"][0] > at["heel_r"][0]
    knees = 0.5 * (at["knee_lat_r"] + at["knee_med_r"])
    np.testing.assert_allclose(knees, [at["hjc_r"][0], 0.573, at["hjc_r"][2]], atol=0.002)
    np.testing.assert_allclose(make_upright_posture(still).markers, still.markers, atol=1e-9)


def test_markers_come_before_poses(tmp_path: Path) -> None:
    """A file of markers alone is read as ever, and none of its labels makes it one of poses."""
    recording = read_recording(
        write_raw_c3d(tmp_path / "m.c3d", standing_points_mm(5), [f"M{i}" for i in range(8)])
    )
    assert make_upright_posture(recording) is recording
    assert len(NEEDED_SEGMENTS) == 9
