"""Reading a peer's model: our own comes back as it is, in any body frames, in both generations of
files.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.errors import Code
from gaitcal.export.opensim.model_comparison import ComparisonRow, compare_with_osim
from gaitcal.export.opensim.osim_reader import read_osim
from gaitcal.export.opensim.osim_writer import (
    convert_from_body_fixed_xyz,
    convert_to_body_fixed_xyz,
    format_numbers,
    write_osim,
)
from gaitcal.model.linkage import LEGS
from gaitcal.model.subject_model import SubjectModel
from tests.commands import refused
from tests.export.mechanics import SEEDS, perturbed
from tests.messages import check_text, refuses

ROUNDING = 1e-8
"""mm, deg, kg: singular values and inverse trigonometry on the way."""
PEER_POSE = 1e-9
"""m, of points up to 1 m from the origin: OpenSim's splines and ours."""


def as_dict(rows: list[ComparisonRow]) -> dict[str, ComparisonRow]:
    assert len({row.quantity for row in rows}) == len(rows)
    return {row.quantity: row for row in rows}


@contextmanager
def edited(path: Path) -> Iterator[ET.ElementTree]:
    """The document of a model, written back at the end."""
    tree = ET.parse(path)
    yield tree
    tree.write(path)


def assert_same(rows: list[ComparisonRow]) -> None:
    named = as_dict(rows)
    for side in "rl":
        check_text(named, f"{side}", f"{side}")
        check_text(named, f"{side}", f"{side}")
        check_text(named, f"{side}")
    for row in rows:
        assert abs(row.difference) < ROUNDING, row
        assert row.difference == row.theirs - row.ours


@pytest.mark.parametrize("seed", SEEDS)
def test_our_own_model(published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model = perturbed(published, seed)
    write_osim(model, tmp_path / "m.osim")
    rows = compare_with_osim(model, tmp_path / "m.osim")
    assert_same(rows)
    named = as_dict(rows)
    assert named["total mass"].ours == pytest.approx(model.parameters.mass)


def test_values_are_the_joint_parameters(published: SubjectModel, osim_file: Path) -> None:
    named = as_dict(compare_with_osim(published, osim_file))
    expected = {
        "hip_r centre in pelvis, ant": -47.3,
        "hip_l centre in pelvis, lat": -88.0,
        "knee_r axis in thigh_r, sup": -419.8,
        "knee_r axis in shank_r, trans": 5.0,
        "knee_l axis in shank_l, trans": -5.0,
        "talocrural_r axis in shank_r, front": 7.3,
        "subtalar_r axis in foot_r, trans": 23.0,
        "subtalar_l axis in foot_l, sag": 42.0,
        "thigh_r length, hip centre to knee centre": 419.8,
        "shank_l length, knee centre to talocrural centre": 377.4,
        "talocrural_r to subtalar_r axis": 10.0,
        "thigh_r mass": 9.827,
    }
    for of in ("ours", "theirs"):
        assert {name: getattr(named[name], of) for name in expected} == pytest.approx(
            expected, abs=1e-3
        )


def test_a_moved_axis_shows(published: SubjectModel, tmp_path: Path) -> None:
    p = published.parameters
    i = ("knee_r.thigh.ant", "knee_r.thigh.trans")
    write_osim(
        published.with_parameters(p.with_joint(i, np.array([0.007, np.deg2rad(4)]))),
        tmp_path / "m.osim",
    )
    named = as_dict(compare_with_osim(published, tmp_path / "m.osim"))
    assert named["knee_r axis in thigh_r, ant"].difference == pytest.approx(7.0)
    assert named["knee_r axis in thigh_r, trans"].difference == pytest.approx(4.0)
    assert named["knee_l axis in thigh_l, ant"].difference == pytest.approx(0.0, abs=ROUNDING)


def vector(element: ET.Element, tag: str) -> np.ndarray:
    return np.array([float(word) for word in (element.findtext(tag) or "").split()])


def put(element: ET.Element, tag: str, values: np.ndarray) -> None:
    child = element.find(tag)
    child.text = format_numbers(values)


def in_other_frames(tree: ET.ElementTree) -> None:
    """The same model with body frames that stand elsewhere, as peers choose theirs otherwise."""
    rng = np.random.default_rng(11)
    place = {
        b.get("name"): pin.SE3(
            convert_from_body_fixed_xyz(rng.normal(size=3) * 0.1), rng.normal(size=3) * 0.1
        )
        for b in tree.iter("Body")
    }
    for marker in tree.iter("Marker"):
        body = (marker.findtext("socket_parent_frame") or "").rpartition("/")[2]
        put(marker, "location", place[body].act(vector(marker, "location")))
    for frame in tree.iter("PhysicalOffsetFrame"):
        body = (frame.findtext("socket_parent") or "").rpartition("/")[2]
        if body == "ground":
            continue
        old = pin.SE3(
            convert_from_body_fixed_xyz(vector(frame, "orientation")), vector(frame, "translation")
        )
        new = place[body] * old
        put(frame, "translation", new.translation)
        put(frame, "orientation", convert_to_body_fixed_xyz(new.rotation))


def in_old_format(tree: ET.ElementTree) -> None:
    """The layout of OpenSim 3: joints inside bodies, locations in joints, functions in a
    wrapper.
    """
    tree.getroot().set("Version", "30000")
    model = tree.getroot().find("Model")
    joints = model.find("JointSet")
    model.remove(joints)
    bodies = {b.get("name"): b for b in model.iter("Body")}
    for joint in joints.findall("objects/*"):
        frames = {f.get("name"): f for f in joint.iter("PhysicalOffsetFrame")}
        parent, child = (
            frames[joint.findtext(f"socket_{end}_frame")] for end in ("parent", "child")
        )
        owner = bodies[(child.findtext("socket_parent") or "").rpartition("/")[2]]
        new = ET.SubElement(
            ET.SubElement(owner, "Joint"), "CustomJoint", name=joint.get("name") or ""
        )
        ET.SubElement(new, "parent_body").text = (
            parent.findtext("socket_parent") or ""
        ).rpartition("/")[2]
        for frame, suffix in ((parent, "_in_parent"), (child, "")):
            ET.SubElement(new, "location" + suffix).text = frame.findtext("translation")
            ET.SubElement(new, "orientation" + suffix).text = frame.findtext("orientation")
        objects = ET.SubElement(ET.SubElement(new, "CoordinateSet"), "objects")
        objects.extend(joint.findall("coordinates/Coordinate"))
        transform = joint.find("SpatialTransform")
        for axis in transform:
            function = axis[-1]
            axis.remove(function)
            ET.SubElement(axis, "function").append(function)
        new.append(transform)
    for marker in model.iter("Marker"):
        socket = marker.find("socket_parent_frame")
        socket.tag, socket.text = "body", (socket.text or "").rpartition("/")[2]


@pytest.mark.parametrize(("low", "high", "moved"), [(-0.3, 2.5, False), (-2.5, 0.3, True)])
def test_a_rolling_knee_is_swept_the_way_it_bends(
    published: SubjectModel, osim_file: Path, low: float, high: float, moved: bool
) -> None:
    """A knee that slides with negative angles only: its axis is another one where those are the
    flexion.
    """
    with edited(osim_file) as tree:
        (knee,) = tree.iterfind(".//CustomJoint[@name='knee_r']")
        (coordinate,) = knee.iter("Coordinate")
        put(coordinate, "range", np.array([low, high]))
        (slide,) = knee.iterfind(".//TransformAxis[@name='translation1']")
        slide.find("coordinates").text = "knee_angle_r"
        slide.remove(slide.find("Constant"))
        function = ET.SubElement(slide, "PiecewiseLinearFunction")
        ET.SubElement(function, "x").text, ET.SubElement(function, "y").text = "-2 0 2", "0.02 0 0"
    named = as_dict(compare_with_osim(published, osim_file))
    sup = named["knee_r axis in thigh_r, sup"].difference
    assert (abs(sup) > 1.0) is moved, "mm"


def without_idle_functions(tree: ET.ElementTree) -> None:
    """Functions that are zero left away, as are functions and axes that OpenSim's own defaults
    stand for.
    """
    for axis in tree.iter("TransformAxis"):
        function = axis.find("Constant")
        if function is not None:
            axis.remove(function)
    assert any(len(axis.findall("*")) == 2 for axis in tree.iter("TransformAxis"))


def in_beta_words(tree: ET.ElementTree) -> None:
    """Sockets as the betas of OpenSim 4 spell them."""
    for element in tree.iter():
        if element.tag.startswith("socket_"):
            element.tag = f"{element.tag}_connectee_name"


def with_a_shoulder_of_its_own(tree: ET.ElementTree) -> None:
    """An unknown function, at a joint that no row needs."""
    shoulder = next(j for j in tree.iter("CustomJoint") if "shoulder" in j.get("name", ""))
    axis = next(a for a in shoulder.iter("TransformAxis") if a.find("LinearFunction") is not None)
    axis.find("LinearFunction").tag = "ExpressionBasedFunction"


@pytest.mark.parametrize(
    "change",
    [
        in_other_frames,
        in_old_format,
        without_idle_functions,
        in_beta_words,
        with_a_shoulder_of_its_own,
    ],
)
def test_other_frames_and_formats(
    published: SubjectModel, tmp_path: Path, change: Callable[[ET.ElementTree], None]
) -> None:
    model = perturbed(published, 3)
    write_osim(model, tmp_path / "m.osim")
    with edited(tmp_path / "m.osim") as tree:
        change(tree)
    assert_same(compare_with_osim(model, tmp_path / "m.osim"))


def test_a_marker_in_an_offset_frame_is_where_it_was(
    published: SubjectModel, osim_file: Path
) -> None:
    with edited(osim_file) as tree:
        (body,) = tree.iterfind(".//Body[@name='thigh_r']")
        frame = ET.SubElement(ET.SubElement(body, "components"), "PhysicalOffsetFrame", name="f")
        for tag, text in (
            ("socket_parent", ".."),
            ("translation", "0.1 0 0"),
            ("orientation", f"0 0 {np.pi / 2}"),
        ):
            ET.SubElement(frame, tag).text = text
        for marker in tree.iter("Marker"):
            socket = marker.find("socket_parent_frame")
            if socket.text == "/bodyset/thigh_r":
                x, y, z = vector(marker, "location")
                socket.text = "/bodyset/thigh_r/f"
                put(marker, "location", np.array([y, 0.1 - x, z]))
    assert_same(compare_with_osim(published, osim_file))


def test_without_shared_markers_lengths_and_masses_remain(
    published: SubjectModel, osim_file: Path
) -> None:
    osim_file.write_text(
        osim_file.read_text(encoding="utf-8").replace('<Marker name="', '<Marker name="other '),
        encoding="utf-8",
    )
    named = as_dict(compare_with_osim(published, osim_file))
    assert named["thigh_r length, hip centre to knee centre"].theirs == pytest.approx(419.8)
    assert named["thigh_r markers, and how many the peer shares"].theirs == 0
    assert not [q for q in named if "axis in" in q]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("not xml", "is not well-formed XML"),
        ("", "is not well-formed XML"),
        ("<html/>", "found <html>, expected <OpenSimDocument>"),
        ("<OpenSimDocument><Model/></OpenSimDocument>", "no bodies or no joints"),
        (
            "<OpenSimDocument><Model><BodySet><objects><Body "
            "name='a'><mass>much</mass></Body></objects></BodySet>"
            "</Model></OpenSimDocument>",
            "mass: found 'much', expected numbers",
        ),
    ],
)
def test_what_is_no_model(
    published: SubjectModel, tmp_path: Path, content: str | None, message: str
) -> None:
    if content is not None:
        (tmp_path / "m.osim").write_text(content, encoding="utf-8")
    with refused(message):
        compare_with_osim(published, tmp_path / "m.osim")


REAL = (
    "subject01/reference/subject01_simbody.osim",
    "uf3/reference/scaled.osim",
    "uf3/reference/jmp_sequential.osim",
)


def test_real_models(published: SubjectModel, data_dir: Path) -> None:
    """Figures a reader can check by hand in the files."""
    gait2354 = as_dict(compare_with_osim(published, data_dir / REAL[0]))
    assert gait2354["total mass"].theirs == pytest.approx(72.6, abs=0.01)
    assert gait2354["shank_r mass"].theirs == pytest.approx(3.581, abs=1e-3)
    beyond_the_ankle = sum(
        row.theirs for name in LEGS["r"][2:] if (row := gait2354.get(f"{name} mass"))
    )
    assert beyond_the_ankle == pytest.approx(0.0966 + 1.2074 + 0.2092, abs=1e-3)
    assert gait2354["shank_r length, knee centre to talocrural centre"].theirs == pytest.approx(
        425, abs=20
    )
    check_text(gait2354, "head_trunk")
    before, after = (as_dict(compare_with_osim(published, data_dir / name)) for name in REAL[1:])
    thigh = "thigh_r length, hip centre to knee centre"
    assert 380 < before[thigh].theirs < 420
    assert before[thigh].theirs != after[thigh].theirs
    check_text(before, "upper_arm_l")


def test_an_unknown_function_is_an_error_where_it_is_needed(
    published: SubjectModel, osim_file: Path
) -> None:
    with edited(osim_file) as tree:
        next(
            tree.iterfind(".//CustomJoint[@name='knee_r']//LinearFunction")
        ).tag = "ExpressionBasedFunction"
    with refuses(Code.OTHER_MODEL, field="joint knee_r", source="m.osim"):
        compare_with_osim(published, osim_file)


def test_no_function_is_zero_in_opensim_too(osim: Any, data_dir: Path, tmp_path: Path) -> None:
    tree = ET.parse(data_dir / REAL[0])
    for axis in tree.iter("TransformAxis"):
        if not (axis.findtext("coordinates") or "").strip():
            for function in axis.findall("function"):
                axis.remove(function)
    tree.write(tmp_path / "bare.osim")
    model = osim.Model(str(tmp_path / "bare.osim"))
    state = model.initSystem()
    model.realizePosition(state)
    peer = read_osim(tmp_path / "bare.osim")
    values = {c.name: c.default for joint in peer.joints.values() for c in joint.coordinates}
    for name in ("hip_r", "knee_l", "ankle_r", "subtalar_l"):
        joint = next(j for j in peer.joints.values() if j.name == name)
        theirs = (
            model.getBodySet()
            .get(joint.child)
            .findStationLocationInAnotherFrame(
                state, osim.Vec3(0.1, 0.2, 0.3), model.getBodySet().get(joint.parent)
            )
        )
        ours = peer.compute_joint_pose(joint, values).act(np.array([0.1, 0.2, 0.3]))
        np.testing.assert_allclose(ours, theirs.to_numpy(), atol=PEER_POSE)


@pytest.mark.parametrize("name", REAL)
def test_poses_are_those_of_opensim(osim: Any, data_dir: Path, name: str) -> None:
    """All joints we understand, knee with its splines at several angles, against OpenSim itself."""
    peer = read_osim(data_dir / name)
    model = osim.Model(str(data_dir / name))
    state = model.initSystem()
    coordinates = model.getCoordinateSet()
    for angle in (-0.5, -0.3, 0.0, 0.3, 0.9):
        values = {f"knee_angle_{s}": angle for s in "rl"} | {f"ankle_angle_{s}": 0.2 for s in "rl"}
        for i in range(coordinates.getSize()):
            c = coordinates.get(i)
            c.setLocked(state, False)
            value = c.getDefaultValue() if c.get_locked() else values.get(c.getName(), 0.0)
            c.setClamped(state, False)
            c.setValue(state, value, False)
        model.realizePosition(state)
        checked = 0
        for joint in peer.joints.values():
            if joint.axes is None or joint.name.startswith("patello"):
                continue
            frame = model.getBodySet().get(joint.child)
            base = (
                model.getGround()
                if joint.parent == "ground"
                else model.getBodySet().get(joint.parent)
            )
            ours = peer.compute_joint_pose(joint, values)
            for point in np.vstack([np.zeros(3), np.eye(3)]):
                theirs = frame.findStationLocationInAnotherFrame(state, osim.Vec3(*point), base)
                np.testing.assert_allclose(ours.act(point), theirs.to_numpy(), atol=PEER_POSE)
            checked += 1
        assert checked >= 12
