"""The model as URDF, for Pinocchio, ROS and others.

A URDF joint has one degree of freedom, so a joint of ours becomes a chain: a fixed joint to its frame in the parent,
one link without inertia per coordinate, a fixed joint to the child segment. Readers such as Pinocchio take siblings
in alphabetical order; the fixed joints are numbered so that this is our order, and q is the same vector as ours.

URDF knows no gravity. The root link `ground` is our laboratory, **y up**: set gravity to (0, -9.81, 0). Markers are
links `marker_NAME` without inertia. Coordinates that are held at zero have equal limits of zero.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pinocchio as pin

from gaitcal.export.joint_frames import (
    COORDINATE_RANGES,
    GROUND,
    JointFrames,
    axis_vector,
    joint_frames,
    segment_inertia,
    space_fixed_xyz,
)
from gaitcal.export.xml_text import child, numbers, safe_name, write_xml
from gaitcal.model.build import GRAVITY
from gaitcal.model.linkage import SEGMENTS, Element
from gaitcal.model.subject_model import SubjectModel

MARKER_PREFIX = "marker_"

_UNLIMITED = 1e4
"""N or N·m, m/s or rad/s: URDF demands a bound of effort and speed, we have none."""


def write_urdf(model: SubjectModel, path: Path | str) -> None:
    """Write `model`: m, kg, rad; root link `ground` with y up; joints named as our 27 coordinates."""
    robot = ET.Element("robot", name=safe_name(model.subject.name))
    robot.append(ET.Comment(f" Written by gaitcal. y is up: gravity is (0, -{GRAVITY}, 0) in the root link. "))
    _add_link(robot, GROUND)
    for number, joint in enumerate(joint_frames(model.parameters)):
        _add_chain(robot, f"{number:02d}_{joint.name}", joint, model.locked)
    for segment in SEGMENTS:
        _add_segment(robot, model, segment)
    markers = model.markers
    for label, segment, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        name = MARKER_PREFIX + safe_name(label)
        _add_link(robot, name)
        _add_fixed(robot, f"{name}_fixed", segment, name, pin.SE3(pin.SE3.Identity().rotation, local))
    write_xml(robot, path)


def _add_link(robot: ET.Element, name: str) -> ET.Element:
    return child(robot, "link", name=name)


def _add_segment(robot: ET.Element, model: SubjectModel, segment: str) -> None:
    link = _add_link(robot, segment)
    inertia = segment_inertia(model.parameters, segment)
    if inertia.mass == 0.0:
        return
    inertial = child(link, "inertial")
    child(inertial, "origin", xyz=numbers(inertia.centre), rpy="0 0 0")
    child(inertial, "mass", value=numbers([inertia.mass]))
    x, y, z = (numbers([moment]) for moment in inertia.moments)
    child(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy="0", ixz="0", iyz="0")


def _add_chain(robot: ET.Element, name: str, frames: JointFrames, frozen: tuple[str, ...]) -> None:
    _add_link(robot, name)
    _add_fixed(robot, f"{name}_in_{frames.parent}", frames.parent, name, frames.in_parent)
    link = name
    for motion in frames.motions:
        moved = f"{name}_{motion.name}"
        _add_link(robot, moved)
        _add_coordinate(robot, motion, link, moved, motion.name in frozen)
        link = moved
    _add_fixed(robot, f"{name}_to_{frames.child}", link, frames.child, frames.to_child)


def _add_fixed(robot: ET.Element, name: str, parent: str, link: str, place: pin.SE3) -> None:
    joint = child(robot, "joint", name=name, type="fixed")
    child(joint, "parent", link=parent)
    child(joint, "child", link=link)
    child(joint, "origin", xyz=numbers(place.translation), rpy=numbers(space_fixed_xyz(place.rotation)))


def _add_coordinate(robot: ET.Element, motion: Element, parent: str, link: str, frozen: bool) -> None:
    joint = child(robot, "joint", name=motion.name, type="revolute" if motion.rotates else "prismatic")
    child(joint, "parent", link=parent)
    child(joint, "child", link=link)
    child(joint, "axis", xyz=numbers(axis_vector(motion)))
    low, high = (0.0, 0.0) if frozen else COORDINATE_RANGES[motion.name]
    bound = numbers([_UNLIMITED])
    child(joint, "limit", lower=numbers([low]), upper=numbers([high]), effort=bound, velocity=bound)
