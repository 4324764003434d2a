"""What is fixed to a bone moves with its two joints, or stays, as the user chooses."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.errors import InputError
from gaitcal.export.opensim.joint_moves import (
    MOVED_POINTS_HEADER,
    Bone,
    format_moved_points_csv,
    move_attachments,
)
from gaitcal.export.opensim.joint_transfer import transfer_joints
from gaitcal.export.opensim.osim_correspondence import find_leg_joints
from gaitcal.export.opensim.osim_reader import (
    FramePlacement,
    build_peer_model,
    read_document,
    read_osim,
)
from gaitcal.export.opensim.transfer_account import compute_muscle_paths, list_leg_ranges
from scripts.validation.muscles import person_of

MODELS = ("opensim_truth/p01/subject01.osim", "subject01/reference/subject01_simbody.osim")
"""Wraps, patella by constraint; points that move with a coordinate, knee that rolls, no wraps."""
ALIKE = 1e-3
"""m, of moment arms: nothing puts a hinge along its axis, here 1 to 3 mm."""


def shifted(source: Path, out: Path) -> Path:
    """All joints of a bone as far off in it: the bone is another place under its joints, of the
    same shape.
    """
    rng, document = np.random.default_rng(4), read_document(source)
    by: dict[str, np.ndarray] = {}
    places = {}
    for leg in find_leg_joints(build_peer_model(document)):
        for end, body, frame in (
            ("parent", leg.theirs.parent, leg.theirs.in_parent),
            ("child", leg.theirs.child, leg.theirs.in_child),
        ):
            if not leg.ours.startswith(("hip", "knee", "talocrural")) or body.startswith("talus"):
                continue
            across = (1.0, 1.0, body == "pelvis")  # nothing determines the point along a hinge
            way = by.setdefault(body, rng.uniform(-0.02, 0.02, size=3) * across)
            places[leg.theirs.name, end] = FramePlacement(frame.translation + way, None)
    out.write_bytes(document.apply_changes(places))
    return out


def test_a_bone_is_stretched_along_itself() -> None:
    rng = np.random.default_rng(0)
    a, b, a_now, b_now, x = rng.normal(size=(5, 3))
    length = float(np.linalg.norm(b - a))
    bone = Bone(
        middle_before=0.5 * (a + b),
        middle_after=0.5 * (a_now + b_now),
        rotation=pin.Quaternion.FromTwoVectors(b - a, b_now - a_now).toRotationMatrix(),
        direction=(b - a) / length,
        stretch=float(np.linalg.norm(b_now - a_now)) / length,
    )
    assert bone.map_point(a) == pytest.approx(a_now) and bone.map_point(b) == pytest.approx(b_now)

    def off_the_line(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
        return float(
            np.linalg.norm(np.cross(point - start, end - start)) / np.linalg.norm(end - start)
        )

    assert off_the_line(bone.map_point(x), a_now, b_now) == pytest.approx(off_the_line(x, a, b))


POINTS = """<OpenSimDocument><Model><BodySet><objects><Body name="femur_r"/></objects></BodySet>
<PathPoint name="p"><location>0 0 0</location><{tag}>{body}</{tag}></PathPoint>
<MovingPathPoint name="m"><location>1 0 0</location><{tag}>{body}</{tag}><x_location><SimmSpline><x>0 1</x><y>0 2</y>
</SimmSpline></x_location><y_location><Constant><value>0</value></Constant></y_location>
<z_location><Constant><value>0</value></Constant></z_location></MovingPathPoint></Model></OpenSimDocument>"""  # noqa: E501
UP = Bone(
    middle_before=np.zeros(3),
    middle_after=np.array([0.0, 0.5, 0.0]),
    rotation=np.eye(3),
    direction=np.eye(3)[1],
    stretch=1.0,
)


@pytest.mark.parametrize(
    ("tag", "body"),
    [
        ("body", "femur_r"),
        ("socket_parent_frame", "/bodyset/femur_r"),
        ("socket_parent_frame_connectee_name", "../femur_r"),
    ],
)
def test_points_follow_however_their_body_is_named(tmp_path: Path, tag: str, body: str) -> None:
    """Of OpenSim 3, whose moving points have a location, too; of 4; of its betas."""
    path = tmp_path / "model.osim"
    path.write_text(POINTS.format(tag=tag, body=body))
    document = read_document(path)
    made = document.apply_changes({}, further=move_attachments(document, {"femur_r": UP})).decode()
    fixed, moving = made.split("<MovingPathPoint")
    assert (
        "<location>0.0 0.5 0.0</location>" in fixed and "<location>1.0 0.5 0.0</location>" in moving
    )
    assert "<y>0.0 2.0</y>" in moving and "<value>0.5</value>" in moving
    if tag.startswith("socket"):  # in an offset frame of the body, z to its left
        frame = """<components><PhysicalOffsetFrame name="f"><socket_parent>..</socket_parent>
            <translation>1 0 0</translation><orientation>0 0 1.5707963267948966</orientation>
            <WrapObjectSet><objects><WrapSphere name="w"><translation>0 0 0</translation>
            <xyz_body_rotation>0 0 0</xyz_body_rotation></WrapSphere></objects></WrapObjectSet>
            </PhysicalOffsetFrame></components>"""
        offset = tmp_path / "offset.osim"
        offset.write_text(
            path.read_text()
            .replace('<Body name="femur_r"/>', f'<Body name="femur_r">{frame}</Body>')
            .replace(f"{body}</{tag}>", f"{body}/f</{tag}>")
        )
        document = read_document(offset)
        bone = replace(
            UP,
            middle_before=np.array([1.0, 2.0, 0.0]),
            middle_after=np.array([1.0, 2.7, 0.0]),
            stretch=1.5,
        )
        ((at,), (m, *_), *_, (wrap, _)) = (
            c[2] for c in move_attachments(document, {"femur_r": bone})
        )
        assert at == pytest.approx([-0.3, 0.0, 0.0]) and m == pytest.approx([1.2, 0.0, 0.0])
        assert wrap == pytest.approx(at)
    path.write_text(path.read_text().replace("<y>0 2</y>", "<polynomial>0 2</polynomial>"))
    document = read_document(path)
    with pytest.raises(
        InputError, match="model.osim: m: found x_location of another kind, allowed: "
    ):
        list(move_attachments(document, {"femur_r": UP}))


def test_meshes_in_offset_frames_follow(tmp_path: Path) -> None:
    """Meshes of a body and of an offset frame in it move alike, each in the axes of its frame."""
    drawn = "<attached_geometry><Mesh/></attached_geometry>"
    frame = f"""<PhysicalOffsetFrame name="f"><socket_parent>..</socket_parent><translation>1 2 3</translation>
        <orientation>0.3 0 1.5</orientation>{drawn}</PhysicalOffsetFrame>"""  # noqa: E501
    path = tmp_path / "model.osim"
    body = f'<Body name="b"><components>{frame}</components>{drawn}</Body>'
    path.write_text(
        f"<OpenSimDocument><Model><BodySet><objects>{body}</objects></BodySet></Model></OpenSimDocument>"
    )
    document, motion = (
        read_document(path),
        pin.SE3(pin.exp3(np.array([0.1, 0.2, -0.4])), np.array([0.02, 0.0, -0.1])),
    )
    path.write_bytes(document.apply_changes({}, meshes={"b": motion}))
    pose = {
        key: pose
        for key, pose, e in read_document(path).list_frames("b")
        if e.find("attached_geometry") is not None
    }
    assert sorted(pose) == ["b/b_meshes", "b/f/f_meshes"]
    was = {key: place for key, place, _ in document.list_frames("b")}
    for key in was:
        now = pose[f"{key}/{key.rpartition('/')[2]}_meshes"]
        assert now.isApprox(motion * was[key], 1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_bones_of_joints_that_stay_are_the_same_bytes(data_dir: Path, name: str) -> None:
    done = transfer_joints(person_of(read_osim(data_dir / name)), data_dir / name, follow=True)
    assert done.content == (data_dir / name).read_bytes() and not done.moved_points


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_muscles_keep_their_arms_where_bones_follow(
    osim: Any, data_dir: Path, tmp_path: Path, name: str
) -> None:
    """Of a model whose bones lie elsewhere under their joints: with `follow` muscles pull as they
    did in that model, in `stay` as in the one that is right. Meshes are drawn in an offset frame;
    markers and all else keep their bytes.
    """
    path = data_dir / name
    model, wrong = person_of(read_osim(path)), shifted(path, tmp_path / "wrong.osim")
    files = {"wrong": wrong, "right": path}
    for follow in (False, True):
        done = transfer_joints(model, wrong, follow=follow)
        files[f"follow {follow}"] = tmp_path / f"{follow}.osim"
        files[f"follow {follow}"].write_bytes(done.content)
        assert bool(done.moved_points) == follow
    assert {m.points for m in done.moved_points} > {2} and 0.005 < done.moved_points[
        0
    ].farthest < 0.06
    rows = format_moved_points_csv(done.moved_points).splitlines()
    assert rows[0] == MOVED_POINTS_HEADER and len(rows) == 1 + len(done.moved_points)
    ranges = {
        k: v[3:10:3]
        for k, v in list_leg_ranges(done.legs).items()
        if k in ("hip_flexion_r", "knee_angle_r")
    }
    arms = {key: compute_muscle_paths(file, ranges) for key, file in files.items()}
    for of, like, unlike in (("follow True", "wrong", "right"), ("follow False", "right", "wrong")):
        gaps = [
            [np.abs(p.arm - arms[to][key].arm).max() for key, p in arms[of].items()]
            for to in (like, unlike)
        ]
        assert max(gaps[0]) < ALIKE < 5 * ALIKE < max(gaps[1]), of
    text = files["follow True"].read_text()
    numbers = re.compile(r"(<(translation|orientation|location|y|value|xyz_body_rotation)>)[^<]*<")
    frames = re.compile(
        r'(<components>)?<PhysicalOffsetFrame name="\w+_meshes">.*?</orientation>(?=<attached)',
        re.S,
    )
    bare = frames.sub("", numbers.sub(r"\1<", text)).replace(
        "</PhysicalOffsetFrame></components>", ""
    )
    assert bare == numbers.sub(r"\1<", wrong.read_text())
    markers = [read_osim(p).markers for p in (wrong, files["follow True"])]
    for label, (body, place) in markers[0].items():
        assert markers[1][label][0] == body and (markers[1][label][1] == place).all()
