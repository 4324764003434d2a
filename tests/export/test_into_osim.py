"""A person's joints in an OpenSim model of the user's own: nothing changes that need not, what was
moved comes back.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from gaitcal import cli
from gaitcal.analysis.calibrate import calibrate
from gaitcal.calibration.error_sources import ErrorSources, make_nominal_errors
from gaitcal.calibration.joint_prior import get_prior_deviations
from gaitcal.errors import Code
from gaitcal.export.opensim.joint_moves import JOINTS_HEADER, MoveOutcome, format_joints_csv
from gaitcal.export.opensim.joint_transfer import transfer_joints
from gaitcal.export.opensim.osim_correspondence import find_leg_joints, fit_hinge
from gaitcal.export.opensim.osim_reader import build_peer_model, read_document, read_osim
from gaitcal.export.opensim.osim_writer import write_osim
from gaitcal.export.opensim.peer_model import PeerModel, measure_our_leg, read_numbers
from gaitcal.export.opensim.transfer_account import (
    MusclePath,
    compare_muscles,
    compute_muscle_paths,
    format_muscles_csv,
    list_leg_ranges,
    make_joint_tables,
    make_muscle_table,
)
from gaitcal.model.linkage import COORDINATES, JOINTS, LEG_SEGMENTS, LEGS, NEEDED_JOINTS, SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.model_file import load_model
from gaitcal.model.parameters import JP_NAMES, MASSIVE_SEGMENTS, view_as_table
from gaitcal.model.subject_model import MarkerPlacement, SubjectModel
from gaitcal.study.study import Study
from scripts.validation.muscles import OFF, disturbed, person_of
from tests.export.test_compare import edited, in_old_format, in_other_frames
from tests.kept import kept_result
from tests.messages import check_text, refuses

UNKNOWN = make_nominal_errors(JP_NAMES)
"""Errors before any trial."""
BACK = 1e-6
"""m, rad: the solvers' rounding, over 1 m."""
DRAWN = 0.3
"""Relative, of the root of a variance of forty draws: its own error is 0.11 with one direction, and
several count.
"""
NEAR = 0.5e-3
"""m, of hips and knees by a walk without noise."""
WITHIN_ERRORS = 2.5
"""Standard errors, in all directions together."""
ALONG = ("subtalar_turn_r", "subtalar_turn_l")
"""Second axes of universal joints: nothing determines where along the first one they meet it."""
REAL_MODELS = (
    "opensim_truth/p01/subject01.osim",
    "opensim_truth/p18/subject18.osim",
    "subject01/reference/subject01_simbody.osim",
    "uf3/reference/scaled.osim",
)
"""OpenSim 4; knees that roll, locked coordinates, patellae, feet with bodies between."""


def unchanged(tree: ET.ElementTree) -> None:
    """As it is written."""


def under_other_names(tree: ET.ElementTree) -> None:
    """Bodies, joints and coordinates with unusual names, and no markers."""
    model = tree.getroot().find("Model")
    markers = model.find("MarkerSet")
    model.remove(markers)
    named = {
        e.get("name", "") for tag in ("Body", "CustomJoint", "Coordinate") for e in model.iter(tag)
    }
    other = {name: f"x{k}" for k, name in enumerate(sorted(named, key=len, reverse=True))}
    for element in model.iter():
        if element.get("name") in other:
            element.set("name", other[element.get("name", "")])
        words = (element.text or "").strip()
        if words in other:
            element.text = other[words]
        elif words.startswith("/bodyset/"):
            element.text = f"/bodyset/{other[words.rpartition('/')[2]]}"


SIMPLE = {
    "hip": "BallJoint",
    "knee": "PinJoint",
    "talocrural": "PinJoint",
    "subtalar": "UniversalJoint",
}


def of_simple_joints(tree: ET.ElementTree) -> None:
    """Joints without functions: a foot that also turns about y below the subtalar axis, toes that
    do not move.
    """
    for joint in list(tree.iter("CustomJoint")):
        kind, _, side = (joint.get("name") or "").partition("_")
        if kind not in SIMPLE:
            continue
        joint.tag = SIMPLE[kind]
        joint.remove(joint.findall("SpatialTransform")[0])
        if kind == "subtalar":
            ET.SubElement(
                joint.findall("coordinates")[0], "Coordinate", name=f"subtalar_turn_{side}"
            )
            toes = ET.SubElement(
                next(tree.iter("BodySet")).findall("objects")[0], "Body", name=f"tip_{side}"
            )
            ET.SubElement(toes, "mass").text = "0.2"
            weld = ET.SubElement(
                next(tree.iter("JointSet")).findall("objects")[0],
                "WeldJoint",
                name=f"of_tip_{side}",
            )
            for end, body in (("parent", f"foot_{side}"), ("child", f"tip_{side}")):
                ET.SubElement(weld, f"socket_{end}_frame").text = f"/bodyset/{body}"


VARIANTS: dict[str, Callable[[ET.ElementTree], None]] = {
    "opensim 4": unchanged,
    "opensim 3": in_old_format,
    "other frames": in_other_frames,
    "other names": under_other_names,
    "simple joints": of_simple_joints,
}


def written(model: SubjectModel, path: Path, variant: str) -> Path:
    write_osim(model, path)
    with edited(path) as tree:
        VARIANTS[variant](tree)
    return path


def read_back(content: bytes, folder: Path) -> PeerModel:
    (folder / "out.osim").write_bytes(content)
    return read_osim(folder / "out.osim")


def with_joints(model: SubjectModel, **moved: float) -> SubjectModel:
    """A person whose nominal joints are so much elsewhere (m); `hip_r__thigh__ant` is
    `hip_r.thigh.ant`.
    """
    names = tuple(name.replace("__", ".") for name in moved)
    parameters = model.parameters.with_joint(names, np.array(list(moved.values())))
    return replace(model, parameters=parameters, nominal=parameters)


def assert_moves_alike(a: PeerModel, b: PeerModel, within: float) -> None:
    """The legs of both models in random postures."""
    rng = np.random.default_rng(5)
    legs = find_leg_joints(a)
    top = legs[0].theirs.parent
    for _ in range(20):
        free = [
            c
            for leg in legs
            for c in leg.theirs.coordinates
            if not c.locked and c.name not in ALONG
        ]
        q = {c.name: rng.uniform(-0.5, 0.5) for c in free}
        for leg in legs:
            poses = [
                peer.compute_body_pose(leg.theirs.child, top, q).homogeneous for peer in (a, b)
            ]
            # the talus has no markers: it may be elsewhere between shank and foot
            if not leg.ours.startswith("talocrural"):
                assert np.abs(poses[0] - poses[1]).max() < within, leg.ours


@pytest.mark.parametrize("variant", VARIANTS)
def test_joints_that_are_in_place_leave_every_byte(
    published: SubjectModel, tmp_path: Path, variant: str
) -> None:
    path = written(published, tmp_path / "m.osim", variant)
    done = transfer_joints(published, path)
    assert done.content == path.read_bytes()
    assert [m.outcome for m in done.joints] == [MoveOutcome.MOVED] * 2 * len(NEEDED_JOINTS)
    by = {leg.found_by for leg in done.legs}
    assert by == ({"topology"} if variant == "other names" else {"name"})


def test_opensim_reads_them_as_we_do(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for variant in VARIANTS:
        path = written(published, tmp_path / "m.osim", variant)
        peer, model = read_osim(path), osim.Model(str(path))
        state, legs = model.initSystem(), find_leg_joints(peer)
        q = {c.name: rng.uniform(-0.5, 0.5) for j in peer.joints.values() for c in j.coordinates}
        for name, value in q.items():
            model.getCoordinateSet().get(name).setValue(state, value, False)
        model.realizePosition(state)
        top = model.getBodySet().get(legs[0].theirs.parent)
        for leg in legs:
            at = model.getBodySet().get(leg.theirs.child).findTransformBetween(state, top).p()
            ours = peer.compute_body_pose(leg.theirs.child, legs[0].theirs.parent, q).translation
            assert np.abs(np.array([at.get(i) for i in range(3)]) - ours).max() < BACK, variant


@pytest.mark.parametrize("variant", ["opensim 4", "opensim 3", "other frames", "simple joints"])
@pytest.mark.parametrize("deg", [0.0, 4.0])
def test_disturbed_joints_come_back(
    published: SubjectModel, tmp_path: Path, variant: str, deg: float
) -> None:
    """Whatever was done to a joint, its bones move as before, with the same coordinates."""
    path = written(published, tmp_path / "m.osim", variant)
    done = transfer_joints(published, disturbed(path, tmp_path / "wrong.osim", deg=deg))
    was, now = read_osim(path), read_back(done.content, tmp_path)
    if deg == 0.0:
        assert_moves_alike(was, now, BACK)
    # a ball joint's own axes are the user's: with them turned, hips count from elsewhere, and the
    # rest still fits
    for ours, theirs in zip(find_leg_joints(was), find_leg_joints(now), strict=True):
        if ours.hinge is None:
            assert (
                np.abs(
                    ours.theirs.in_parent.translation - theirs.theirs.in_parent.translation
                ).max()
                < BACK
            )
            assert (
                np.abs(ours.theirs.in_child.translation - theirs.theirs.in_child.translation).max()
                < BACK
            )
        elif theirs.hinge is not None and ours.ours.startswith("knee"):
            assert_same_line(ours.hinge.in_parent, theirs.hinge.in_parent)
            assert_same_line(ours.hinge.in_child, theirs.hinge.in_child)
    least = min(
        end.moved
        for m in done.joints
        if m.joint.startswith("hip")
        for end in (m.parent, m.child)
        if end
    )
    assert least > OFF[0] - BACK


def assert_same_line(a: pin.SE3, b: pin.SE3) -> None:
    """The z axes of both frames are one line."""
    assert np.linalg.norm(np.cross(b.translation - a.translation, a.rotation[:, 2])) < BACK
    assert np.linalg.norm(np.cross(b.rotation[:, 2], a.rotation[:, 2])) < BACK


def test_nothing_else_changes(published: SubjectModel, tmp_path: Path) -> None:
    """Comments, blanks, numbers as they were written: all but the text of the places of the legs'
    joints.
    """
    path = written(published, tmp_path / "m.osim", "opensim 4")
    text = (
        path.read_text()
        .replace("<CustomJoint", "<!-- a > b, <c> -->\r\n\t<CustomJoint")
        .replace(" />", "   />")
    )
    path.write_bytes(text.encode())
    done = transfer_joints(published, disturbed(path, tmp_path / "wrong.osim", deg=2.0))
    places = re.compile(r"<(translation|orientation)>[^<]*<")
    assert places.sub("", done.content.decode()) == places.sub("", text)
    changed = [
        a != b
        for a, b in zip(places.finditer(done.content.decode()), places.finditer(text), strict=True)
    ]
    assert sum(changed)
    legs = read_osim(path)
    (tmp_path / "out.osim").write_bytes(done.content)
    for child, joint in read_osim(tmp_path / "out.osim").joints.items():
        if child not in (*LEGS["r"], *LEGS["l"]):
            assert (
                joint.in_parent == legs.joints[child].in_parent
                and joint.in_child == legs.joints[child].in_child
            )


def test_a_joint_without_offset_frames_gets_them(
    published: SubjectModel, tmp_path: Path, osim_file: Path
) -> None:
    with edited(osim_file) as tree:
        (joint,) = tree.iterfind(".//CustomJoint[@name='hip_r']")
        joint.find("frames").remove(joint.find("frames")[1])
        joint.find("socket_child_frame").text = "/bodyset/thigh_r"
    assert (
        np.abs(read_osim(osim_file).joints["thigh_r"].in_child.homogeneous - np.eye(4)).max() == 0.0
    )
    done = transfer_joints(with_joints(published, hip_r__thigh__ant=0.007), osim_file)
    found = read_back(done.content, tmp_path).joints["thigh_r"]
    assert found.in_child.translation[0] == pytest.approx(0.007, abs=1e-9)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        opensim = pytest.importorskip("opensim")
        opensim.Logger.setLevelString("Off")
        opensim.Model("out.osim").initSystem()


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL_MODELS)
def test_real_models(data_dir: Path, tmp_path: Path, name: str) -> None:
    """In place: every byte. Disturbed across their axes: bones move as before; a knee that rolls
    nearly so.
    """
    path = data_dir / name
    model = person_of(read_osim(path))
    assert transfer_joints(model, path).content == path.read_bytes()
    back = tmp_path / "back.osim"
    back.write_bytes(
        transfer_joints(model, disturbed(path, tmp_path / "wrong.osim", across=True)).content
    )
    assert_moves_alike(read_osim(path), read_osim(back), 1e-4)


def test_a_knee_that_rolls_is_its_nearest_hinge(data_dir: Path) -> None:
    """No other hinge is nearer: turned or shifted a little it is farther, over the postures it is
    for.
    """
    peer = read_osim(data_dir / REAL_MODELS[0])
    leg = next(leg for leg in find_leg_joints(peer) if leg.ours == "knee_r")
    postures = np.linspace(0.0, 1.0, 200)
    hinge = fit_hinge(peer, leg, {"knee_angle_r": postures})
    tips = [leg.theirs.in_child.act(0.2 * s * e) for e in np.eye(3) for s in (1.0, -1.0)]
    poses = [peer.compute_joint_pose(leg.theirs, {"knee_angle_r": float(v)}) for v in postures]

    def misfit(off: pin.SE3) -> float:
        near = replace(hinge, in_parent=hinge.in_parent * off)
        reported = [near.compute_pose(near.measure_angle(p)) for p in poses]
        return sum(
            float(np.sum((t.act(x) - p.act(x)) ** 2))
            for t, p in zip(reported, poses, strict=True)
            for x in tips
        )

    least = misfit(pin.SE3.Identity())
    assert (
        hinge.deviation == pytest.approx(np.sqrt(least / len(poses) / len(tips)), rel=0.02)
        and 1e-4 < hinge.deviation < 2e-3
    )
    notes = " ".join(transfer_joints(person_of(peer), data_dir / REAL_MODELS[0]).notes)
    assert "ankle_r is no hinge" not in notes
    check_text(notes, "knee_r")
    for k in range(2):
        for size in (-1.0, 1.0):
            turn, shift = np.zeros(3), np.zeros(3)
            turn[k], shift[k] = np.deg2rad(1.0) * size, 1e-3 * size
            assert misfit(pin.SE3(pin.exp3(turn), np.zeros(3))) > least
            assert misfit(pin.SE3(np.eye(3), shift)) > least


@pytest.mark.slow
def test_errors_are_those_of_the_draws(
    published: SubjectModel, tmp_path: Path, osim_file: Path
) -> None:
    """What is told of a joint's place is how far drawn files have it apart: parameters and
    registration.
    """
    rng = np.random.default_rng(1)
    markers = replace(
        published.markers,
        local=published.markers.local
        + 0.003 * rng.normal(size=(49, 3))[: len(published.markers.local)],
    )
    worn = replace(published, markers=markers)
    spread = make_nominal_errors(JP_NAMES)
    small = ErrorSources(spread.names, 0.2 * spread.effects, spread.sources)
    done = transfer_joints(worn, osim_file, errors=small)
    reported = {m.joint: m for m in done.joints}
    drawn = []
    for k in range(40):
        (tmp_path / "d.osim").write_bytes(done.draw(np.random.default_rng(k)))
        drawn.append(read_osim(tmp_path / "d.osim").joints)
    for side in SIDES:
        hip = np.array([j[f"thigh_{side}"].in_parent.translation for j in drawn])
        end = reported[f"hip_{side}"].parent
        assert np.sqrt(hip.var(axis=0).sum()) == pytest.approx(end.errors[0], rel=DRAWN)
        knee = np.array([j[f"shank_{side}"].in_parent.rotation[:, 2] for j in drawn])
        end = reported[f"knee_{side}"].parent
        assert np.sqrt(knee.var(axis=0).sum()) == pytest.approx(end.errors[1], rel=DRAWN)


def test_joints_that_recordings_hardly_determine_stay(
    published: SubjectModel, tmp_path: Path, osim_file: Path
) -> None:
    path = disturbed(osim_file, tmp_path / "wrong.osim")
    sizes = np.diag(get_prior_deviations(JP_NAMES))
    sizes[[k for k, name in enumerate(JP_NAMES) if not name.startswith("knee_r")]] *= 0.1
    done = transfer_joints(published, path, errors=ErrorSources(JP_NAMES, sizes, tuple(JP_NAMES)))
    left = [m.joint for m in done.joints if m.outcome is MoveOutcome.UNDETERMINED]
    assert left == ["knee_r"] == list(done.unchanged)
    was, now = (
        peer.joints["shank_r"] for peer in (read_osim(path), read_back(done.content, tmp_path))
    )
    assert was.in_parent == now.in_parent and was.in_child == now.in_child
    rows = format_joints_csv(done.joints).splitlines()
    assert rows[0] == JOINTS_HEADER and all(
        row.count(",") == JOINTS_HEADER.count(",") for row in rows
    )
    assert sum(row.startswith("knee_r,") for row in rows) == 1


@pytest.mark.slow
def test_draws_vary_joints_that_stay_about_their_position(
    published: SubjectModel, tmp_path: Path, osim_file: Path
) -> None:
    """Where the model has them, not where we have them, as far off in either body as is known
    before any trial.
    """
    path = disturbed(osim_file, tmp_path / "wrong.osim")
    done = transfer_joints(published, path, errors=UNKNOWN)
    assert len(done.unchanged) == 2 * len(NEEDED_JOINTS) and done.content == path.read_bytes()
    drawn = []
    for k in range(30):
        (tmp_path / "d.osim").write_bytes(done.draw(np.random.default_rng(k)))
        drawn.append(read_osim(tmp_path / "d.osim").joints)
    was, sizes = read_osim(path).joints, UNKNOWN.standard_errors
    for joint, body, end, segment in (
        ("hip_l", "thigh_l", "in_parent", "pelvis"),
        ("hip_l", "thigh_l", "in_child", "thigh"),
        ("talocrural_r", "talus_r", "in_parent", "shank"),
        ("subtalar_r", "foot_r", "in_child", "foot"),
    ):
        apart = np.array(
            [getattr(j[body], end).translation - getattr(was[body], end).translation for j in drawn]
        )
        names = [
            n
            for n in sizes
            if n.startswith(f"{joint}.{segment}.") and n[-3:] in ("ant", "sup", "lat")
        ]
        size = np.linalg.norm([sizes[n] for n in names])
        if joint.startswith("hip"):
            assert np.sqrt(apart.var(axis=0).sum()) == pytest.approx(size, rel=DRAWN)
        assert np.abs(apart.mean(axis=0)).max() < 4 * size / np.sqrt(len(drawn)), joint
        turns = [
            np.linalg.norm(getattr(j[body], end).rotation - getattr(was[body], end).rotation)
            for j in drawn
        ]
        assert (max(turns) < BACK) == joint.startswith("hip")


def test_names_of_the_user(tmp_path: Path, osim_file: Path) -> None:
    names = tmp_path / "names.toml"
    names.write_text(
        '[joints]\ntalocrural_r = "subtalar_r"\n[coordinates]\nhip_r = "hip_rotation_r"\n'
    )
    legs = {leg.ours: leg for leg in find_leg_joints(read_osim(osim_file), names)}
    assert legs["talocrural_r"].theirs.name == "subtalar_r"
    check_text(legs["talocrural_r"].found_by)
    assert legs["hip_r"].coordinate == "hip_rotation_r"
    names.write_text('[joints]\nhip_r = "hipr"\n')
    with refuses(Code.UNKNOWN_FIELD, "hipr", "hip_r", field="joints", source="names.toml"):
        find_leg_joints(read_osim(osim_file), names)


def test_a_joint_of_three_turns_flexes_about_the_axis_across(
    tmp_path: Path, osim_file: Path
) -> None:
    """Whatever its coordinates are called, and whichever of them goes farthest: its bodies' axes
    may lie otherwise.
    """
    peer = read_osim(osim_file)
    ankle = next(leg.theirs for leg in find_leg_joints(peer) if leg.ours == "talocrural_r")
    turned = pin.SE3(pin.exp3(np.array([0.0, 1.4, 0.0])), ankle.in_parent.translation)
    across = turned.rotation.T @ [0.0, 0.0, 1.0]
    axes = [across, np.array([0.0, 1.0, 0.0]), np.cross(across, [0.0, 1.0, 0.0])]
    free = replace(
        ankle,
        in_parent=turned,
        coordinates=tuple(
            replace(ankle.coordinates[0], name=f"q{k}", high=1.0 + k) for k in range(3)
        ),
        axes=tuple(
            replace(ankle.axes[0], axis=axis, coordinate=f"q{k}") for k, axis in enumerate(axes)
        ),
    )
    names = tmp_path / "names.toml"
    names.write_text(f'[joints]\ntalocrural_r = "{ankle.name}"\n')
    found = next(
        leg
        for leg in find_leg_joints(peer.replace_joints([free]), names)
        if leg.ours == "talocrural_r"
    )
    assert found.coordinate == "q0"


def test_the_account_of_joints_and_muscles(
    published: SubjectModel, tmp_path: Path, osim_file: Path
) -> None:
    """A verdict for every joint; of a muscle the place of its largest change, and jumps that were
    not there before.
    """
    wrong = disturbed(osim_file, tmp_path / "wrong.osim")
    done = (
        transfer_joints(published, wrong),
        transfer_joints(published, osim_file),
        transfer_joints(published, wrong, errors=UNKNOWN),
    )
    for export, verdict in zip(done, ("moved", "in place", "left"), strict=True):
        (joints,) = (
            table for table in make_joint_tables(export) if table.text_columns[0] == "joint"
        )
        assert [row[2] for row in joints.rows] == [verdict] * (4 - 2 * (verdict == "left")) * len(
            NEEDED_JOINTS
        )
    values, arm = np.radians([0.0, 45.0, 90.0]), np.array([0.01, 0.01, 0.03])
    length = 0.3 - np.concatenate([[0.0], np.cumsum(0.5 * (arm[1:] + arm[:-1]) * np.diff(values))])
    paths = [
        MusclePath(
            muscle="m",
            coordinate="knee_angle_r",
            values=values,
            length=length - [0, 0, by],
            arm=arm + [0, by, 0],
        )
        for by in (0.0, 0.005, 0.007)
    ]
    draws = [{("m", "knee_angle_r"): osim_file} for osim_file in paths[1:]]
    (row,) = make_muscle_table(
        compare_muscles({("m", "knee_angle_r"): paths[0]}, draws[0]), draws
    ).rows
    assert row == ("m", "knee_angle_r", "10.0", "15.0", "1.4", "45", "-5.0", "68")


def test_elements_fixed_to_a_joints_frame_are_reported(
    published: SubjectModel, osim_file: Path
) -> None:
    """It moves with the joint, which it should not: what belongs to a bone is fixed to the bone."""
    with edited(osim_file) as tree:
        marker = next(
            m for m in tree.iter("Marker") if m.findtext("socket_parent_frame").endswith("thigh_r")
        )
        marker.find("socket_parent_frame").text = "/jointset/hip_r/thigh_r_offset"
    reported = f"{marker.get('name')}: fixed to a frame of joint hip_r, and moved with it"
    assert reported not in transfer_joints(published, osim_file).notes
    assert (
        reported
        in transfer_joints(with_joints(published, hip_r__thigh__ant=0.007), osim_file).notes
    )


def test_a_thigh_of_two_bodies_without_a_joint_is_reported(
    published: SubjectModel, osim_file: Path
) -> None:
    with edited(osim_file) as tree:
        bodies, joints = tree.find(".//BodySet/objects"), tree.find(".//JointSet/objects")
        ET.SubElement(ET.SubElement(bodies, "Body", name="condyle_r"), "mass").text = "0.2"
        weld = ET.SubElement(joints, "WeldJoint", name="condyle_r")
        for end, body in (("parent", "thigh_r"), ("child", "condyle_r")):
            ET.SubElement(weld, f"socket_{end}_frame").text = f"/bodyset/{body}"
        for socket in joints.iterfind("CustomJoint[@name='knee_r']//socket_parent"):
            socket.text = socket.text.replace("thigh_r", "condyle_r")
    names = (
        "hip_r__thigh__ant",
        "knee_r__thigh__ant",
        "subtalar_r__talus__sup",
        "subtalar_r__foot__sup",
    )
    model = with_joints(published, **dict.fromkeys(names, 0.04))
    reported = {
        follow: " ".join(transfer_joints(model, osim_file, follow=follow).notes)
        for follow in (False, True)
    }
    assert "do not follow" not in reported[False]
    check_text(reported[True], "condyle_r", "thigh_r")
    assert "talus_r" not in reported[True].partition("do not follow")[0]
    check_text(reported[True])


def test_a_model_of_one_leg(published: SubjectModel, osim_file: Path) -> None:
    with edited(osim_file) as tree:
        joints = [joint.name for joint in JOINTS if joint.child in LEGS["l"]]
        for tag, names in (("BodySet", LEGS["l"]), ("JointSet", joints)):
            objects = tree.find(f".//{tag}/objects")
            for element in [e for e in objects if e.get("name") in names]:
                objects.remove(element)
    done = transfer_joints(published, osim_file)
    assert done.content == osim_file.read_bytes()
    assert [m.joint for m in done.joints if m.outcome is MoveOutcome.ABSENT] == [
        f"{j}_l" for j in NEEDED_JOINTS
    ]


def test_markers_of_the_static_trial_count(published: SubjectModel, osim_file: Path) -> None:
    """Landmarks that the model wears as markers lay its bodies on our segments, too."""
    few = [k for k, s in enumerate(published.markers.segments) if s != "thigh_r"]
    three = [k for k, s in enumerate(published.markers.segments) if s == "thigh_r"][:3]
    m = published.markers
    fewer = MarkerPlacement(
        tuple(m.labels[k] for k in few),
        tuple(m.segments[k] for k in few),
        m.local[few],
        m.weight[few],
    )
    names = ("knee_lat_r", "knee_med_r", "thigh_r")
    landmarks = {name: ("thigh_r", m.local[k]) for name, k in zip(names, three, strict=True)}
    worn = {name: (m.labels[k],) for name, k in zip(names, three, strict=True)}
    marker_set = MarkerSet(name="few", description="", landmarks=worn, tracking={})
    person = replace(published, markers=fewer, landmarks=landmarks)
    (reported,) = [
        r
        for r in transfer_joints(person, osim_file, marker_set=marker_set).registrations
        if r.segment == "thigh_r"
    ]
    assert (reported.markers, reported.common) == (3, 3) and reported.rms < BACK
    (bare,) = [
        r for r in transfer_joints(person, osim_file).registrations if r.segment == "thigh_r"
    ]
    assert bare.common == 0


@pytest.mark.parametrize("variant", ["opensim 4", "opensim 3", "other frames"])
def test_masses_of_the_segments(published: SubjectModel, tmp_path: Path, variant: str) -> None:
    """Bodies weigh what our segments weigh, and have their mass centres; nothing else of the
    document changes.
    """
    path = written(published, tmp_path / "m.osim", variant)
    heavier = view_as_table(published.parameters.inertial).copy()
    heavier[:, 0] *= np.linspace(0.8, 1.3, len(heavier))
    heavier[:, 1:4] += 0.01
    p = published.parameters.with_inertial(heavier.ravel())
    done = transfer_joints(replace(published, parameters=p), path, masses=True)
    (tmp_path / "out.osim").write_bytes(done.content)
    was, now = read_document(path), read_document(tmp_path / "out.osim")
    weights = build_peer_model(now).masses
    for k, segment in enumerate(MASSIVE_SEGMENTS):
        assert weights[segment] == pytest.approx(heavier[k, 0], rel=1e-12)
        if segment in (*LEG_SEGMENTS, "pelvis"):
            shift = np.linalg.norm(now.read_mass_centre(segment) - was.read_mass_centre(segment))
            expected = np.linalg.norm(
                heavier[k, 1:4] - view_as_table(published.parameters.inertial)[k, 1:4]
            )
            if variant == "other frames":  # whose mass centres were not taken along
                continue
            assert shift == pytest.approx(expected, abs=BACK)
    assert build_peer_model(now).joints.keys() == build_peer_model(was).joints.keys()
    numbers = re.compile(rb"<(mass|mass_center|inertia\w*)>[^<]*<")
    assert numbers.sub(b"", now.content) == numbers.sub(b"", was.content)
    spread = np.zeros((heavier.size, 1))
    spread[0] = 0.5  # kg, of the first segment alone
    drawn = transfer_joints(replace(published, parameters=p), path, masses=True, inertial=spread)
    (tmp_path / "out.osim").write_bytes(drawn.draw(np.random.default_rng(2)))
    apart = read_osim(tmp_path / "out.osim").masses[MASSIVE_SEGMENTS[0]] - heavier[0, 0]
    assert apart == pytest.approx(0.5 * np.random.default_rng(2).normal(), rel=1e-9)
    ratio = heavier[0, 0] / build_peer_model(was).masses[MASSIVE_SEGMENTS[0]]
    moments = [read_numbers(d.find_body(MASSIVE_SEGMENTS[0]), "inertia", path) for d in (was, now)]
    assert moments[1] == pytest.approx(ratio * moments[0], rel=1e-12)


def without_legs(tree: ET.ElementTree) -> None:
    for element in tree.iter("Coordinate"):
        element.set("name", f"{element.get('name')}x")
    for holder in tree.iter("objects"):
        for joint in [j for j in holder.findall("CustomJoint") if "knee" in (j.get("name") or "")]:
            holder.remove(joint)


def of_a_child(tree: ET.ElementTree, size: float = 0.8) -> None:
    """Bones of a smaller person, and no marker that anybody else has."""
    for element in tree.iter("translation"):
        element.text = " ".join(str(size * float(x)) for x in (element.text or "").split())
    for k, element in enumerate(tree.iter("Marker")):
        element.set("name", f"x{k}")


def without_a_body(tree: ET.ElementTree) -> None:
    tree.find(".//BodySet/objects").remove(tree.find(".//Body[@name='talus_l']"))


def with_other_names_of_ankles(tree: ET.ElementTree) -> None:
    """And no marker that anybody else has."""
    for element in tree.iter("Coordinate"):
        element.set("name", (element.get("name") or "").replace("ankle_angle", "ankle_flex"))
    of_a_child(tree, 1.0)


def misplaced_markers(tree: ET.ElementTree) -> None:
    for k, element in enumerate(tree.iter("Marker")):
        element.find(
            "location"
        ).text = f"{0.1 * np.sin(7 * k)} {0.1 * np.cos(5 * k)} {0.1 * np.sin(3 * k)}"


@pytest.mark.parametrize(
    "spoil",
    [without_a_body, without_legs, with_other_names_of_ankles, misplaced_markers, of_a_child],
)
def test_a_model_of_something_else(
    published: SubjectModel, osim_file: Path, spoil: Callable[[ET.ElementTree], None]
) -> None:
    with edited(osim_file) as tree:
        spoil(tree)
    with refuses(Code.OTHER_MODEL, source="m.osim") as caught:
        transfer_joints(published, osim_file)
    assert "\n" not in str(caught.value)


def test_registration_by_axes_is_reported(published: SubjectModel, osim_file: Path) -> None:
    """Without shared markers only the distance of the joints' axes is reported."""
    with edited(osim_file) as tree:
        of_a_child(tree, 0.94)
    (note_text,) = [
        note
        for note in transfer_joints(published, osim_file).notes
        if note.startswith("pelvis, thigh_r")
    ]
    check_text(note_text)


@pytest.mark.slow
def test_one_walk_brings_hips_and_knees_back(data_dir: Path, tmp_path: Path) -> None:
    """A person that OpenSim simulated, the model's joints put off: what calibration finds is where
    they were.
    """
    path = data_dir / "opensim_truth/p01/subject01.osim"
    calibration = calibrate(Study.load(path.parent / "study.toml"))
    recorded = dict(zip(COORDINATES, calibration.trials[0].calibrated.q.T, strict=True))
    wrong = disturbed(path, tmp_path / "wrong.osim")
    done = transfer_joints(
        calibration.model, wrong, errors=calibration.uncertainty.joint, recorded=recorded
    )
    (tmp_path / "back.osim").write_bytes(done.content)
    reported = {move.joint: move.child for move in done.joints}
    truth, found = (
        find_leg_joints(read_osim(p), recorded=recorded) for p in (path, tmp_path / "back.osim")
    )
    for a, b in zip(truth, found, strict=True):
        apart = b.theirs.in_child.translation - a.theirs.in_child.translation
        if a.hinge is not None and b.hinge is not None:
            line = b.hinge.in_child
            apart = a.hinge.in_child.translation - line.translation
            apart = apart - line.rotation[:, 2] * (line.rotation[:, 2] @ apart)
        end, off = reported[a.ours], float(np.linalg.norm(apart))
        if not a.ours.startswith("talocrural"):  # the talus has no segment of ours
            assert off < WITHIN_ERRORS * end.errors[0], a.ours
        if a.ours.startswith(("hip", "knee")):
            assert off < NEAR, a.ours


@pytest.mark.slow
def test_muscles_pull_as_before(osim: Any, data_dir: Path, tmp_path: Path) -> None:
    """Of a person whose joints were put off across their axes: moment arms about the knee come back
    to 1 %.
    """
    path = data_dir / REAL_MODELS[0]
    model = person_of(read_osim(path))
    back = tmp_path / "back.osim"
    wrong = disturbed(path, tmp_path / "wrong.osim", across=True)
    done = transfer_joints(model, wrong)
    back.write_bytes(done.content)
    ranges = {
        name: values
        for name, values in list_leg_ranges(done.legs).items()
        if name == "knee_angle_r"
    }
    before, spoilt, after = (compute_muscle_paths(p, ranges) for p in (path, wrong, back))
    largest = {key: np.abs(p.arm).max() for key, p in before.items()}
    assert (
        max(np.abs(p.arm - spoilt[key].arm).max() / largest[key] for key, p in before.items()) > 0.2
    )
    changes = compare_muscles(before, after)
    for change in changes:
        key = change.before.muscle, change.before.coordinate
        assert np.abs(change.after.arm - change.before.arm).max() < 0.01 * largest[key], key
        assert np.isfinite(change.after.length).all() and not change.new_jumps
    rows = format_muscles_csv(changes, [before, after]).splitlines()
    assert len(rows) == 1 + len(changes) * len(ranges["knee_angle_r"])


def test_standing_hinges_need_no_recording(osim_file: Path) -> None:
    """A hinge is the same hinge whatever it was recorded over."""
    peer = read_osim(osim_file)
    recorded = {"knee_angle_r": np.array([0.2, 0.3, 0.5])}
    for one, other in zip(
        find_leg_joints(peer, recorded=recorded), find_leg_joints(peer), strict=True
    ):
        assert (one.ours, one.hinge is None) == (other.ours, one.ours.startswith("hip"))
        if one.hinge is not None:
            assert_same_line(one.hinge.in_child, other.hinge.in_child)


def run(*words: str) -> int:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr("sys.argv", ["gaitcal", *words])
        cli.main()
    return int(ended.value.code or 0)


@pytest.mark.slow
def test_the_command(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nominal model stands for the user's; with the calibrated joints in it, it is the
    calibrated model.
    """
    result = kept_result(kept) / "result"
    model = load_model(result / "model.toml")
    mine, out = tmp_path / "scaled.osim", tmp_path / "mine.osim"
    write_osim(replace(model, parameters=model.nominal), mine)
    assert run("export", str(result), "--into", str(mine), "--out", str(out), "--draws", "2") == 0
    printed = capsys.readouterr().out
    check_text(printed, 2)
    found, ours = read_osim(out).joints, measure_our_leg(model.parameters, "r")
    assert np.abs(found["thigh_r"].in_parent.translation - ours.hip_in_pelvis).max() < 1e-4
    assert ours.knee_in_thigh.measure_distance(found["shank_r"].in_parent.translation) < 1e-4
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["mine.html", "mine.joints.csv", "mine.osim", "mine_draws", "scaled.osim"]
    page = (tmp_path / "mine.html").read_text(encoding="utf-8")
    assert (
        "<h2>Every joint, in both of its bodies</h2>" in page
        and "<li>muscles: not computed" in page
    )
    assert page.count('<td class="text">moved</td>') == 4 * len(NEEDED_JOINTS), (
        "either end of every joint"
    )
    one, two = ((tmp_path / "mine_draws" / f"00{k}.osim").read_bytes() for k in (1, 2))
    assert one != two
    (tmp_path / "mine_draws" / "my own.osim").write_text("")
    (tmp_path / "mine.muscles.csv").write_text("of an earlier run")
    assert run("export", str(result), "--into", str(mine), "--out", str(out), "--draws", "1") == 0
    assert (tmp_path / "mine_draws" / "001.osim").read_bytes() == one
    assert sorted(p.name for p in (tmp_path / "mine_draws").iterdir()) == [
        "001.osim",
        "my own.osim",
    ]
    assert not (tmp_path / "mine.muscles.csv").exists()
    printed = " ".join(capsys.readouterr().out.split())
    reported = ("001.osim", "002.osim")
    check_text(printed, f"{', '.join(f'mine_draws/{n}' for n in reported)}", "mine.muscles.csv")
    assert "draws have" not in printed, "every joint is known"
    monkeypatch.setattr("gaitcal.export.opensim.joint_transfer.UNDETERMINED_SHARE", 0.0)
    assert run("export", str(result), "--into", str(mine), "--out", str(out), "--draws", "1") == 0
    assert "in draws, hip_r, knee_r, " in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--into", "m.osim"), "--out: found nothing; allowed: a file to write, FILE.osim"),
        (
            ("--into", "m.osim", "--out", "m.osim"),
            "--out: found the model that is read; allowed: another file",
        ),
        (
            ("--into", "m.osim", "--out", "n.osim", "--parameters", "mass"),
            "allowed: joints or joints,masses",
        ),
        (
            ("--into", "m.osim", "--out", "n.osim", "--attachments", "go"),
            "found 'go'; allowed: stay or follow",
        ),
        (("--into", "n_draws/001.osim", "--out", "n.osim"), "--into: found a draw of --out"),
        (("--into", "m.osim", "--out", "n.osim", "--format", "c3d"), "--format: found with --into"),
        (
            ("--into", "m.osim", "--out", "n.osim", "--convention", "clinical"),
            "--convention: found with --into",
        ),
        (("--into", "m.osim", "--out", "n.osim", "--replace"), "--replace: found with --into"),
        (("--seed", "3"), "--seed: found without --into; allowed: with --into MODEL.osim"),
        (("--draws", "3"), "--draws: found without --into; allowed: with --into MODEL.osim"),
    ],
)
def test_options_that_cannot_be(
    words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run("export", str(tmp_path), *words) == 2
    assert message in " ".join(capsys.readouterr().err.split())
