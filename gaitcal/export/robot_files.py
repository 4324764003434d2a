"""The model as MuJoCo XML (MJCF), and as URDF for Pinocchio, ROS and others.

MJCF: every segment with mass is a body with all its joints inside. MuJoCo applies the joints of a body in order, each
about an axis given in the body's own frame at q = 0. For a chain of constants C and motions M,

    X(q) = C_0 M_1 C_1 M_2 ... M_n C_n = (C_0 ... C_n) M'_1 ... M'_n,   M'_k = S_k^-1 M_k S_k,   S_k = C_k ... C_n,

so joint k has the axis R_k^T a_k and passes through the point -R_k^T t_k, with (R_k, t_k) = S_k. Bodies that move
must have mass in MuJoCo: the talus, which has none, is folded into the foot's body by the same formula, exactly. Only
where a marker sits on the talus is it a body of its own, of `TALUS_MASS`. Not limited, damped or actuated: the same
mechanical system. Coordinates held at zero are tied there by an equality.

URDF: a joint has one degree of freedom, so a joint of ours becomes a chain: a fixed joint to its frame in the parent,
one link without inertia per coordinate, a fixed joint to the child segment. Readers such as Pinocchio take siblings
in alphabetical order; the fixed joints are numbered so that this is our order, and q is the same vector as ours. URDF
knows no gravity. The root link `ground` is our laboratory, **y up**: set gravity to (0, -9.81, 0). Markers are links
`marker_NAME` without inertia. Coordinates that are held at zero have equal limits of zero.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.export.osim import (
    COORDINATE_RANGES,
    GROUND,
    JointFrames,
    axis_vector,
    child,
    joint_frames,
    numbers,
    safe_name,
    segment_inertia,
    space_fixed_xyz,
    write_xml,
)
from gaitcal.model.linkage import SEGMENTS, Element
from gaitcal.model.parameters import MASSIVE_SEGMENTS, is_physical
from gaitcal.model.subject_model import GRAVITY, SubjectModel

TALUS_MASS = 1e-12
"""kg, of a talus that carries a marker: its weight is 1e-11 N, far below what any result here resolves."""
_TALUS_MOMENT = 1e-14
"""kg m^2; MuJoCo accepts nothing below 1e-15."""
_SITE_RADIUS = 0.008
"""m, of the spheres that show markers."""
MARKER_PREFIX = "marker_"
_UNLIMITED = 1e4
"""N or N·m, m/s or rad/s: URDF demands a bound of effort and speed, we have none."""


@dataclass(frozen=True)
class BodyJoint:
    """One coordinate as a joint of a MuJoCo body."""

    motion: Element
    axis: Array
    """(3,) unit axis in the body's frame at q = 0."""
    point: Array
    """(3,) m, on the axis, in the same frame."""


def write_mjcf(model: SubjectModel, path: Path | str) -> None:
    """Write `model`: m, kg, rad; y up; qpos, qvel and qacc are the same vectors as ours; markers are sites.

    Raises
    ------
    InputError
        An inertia that no rigid body can have (a principal moment larger than the sum of the others, or not positive):
        MuJoCo refuses to load it, and to change it would be another mechanical system.
    """
    for segment, physical in zip(MASSIVE_SEGMENTS, is_physical(model.parameters.inertial), strict=True):
        if not physical:
            inertia = segment_inertia(model.parameters, segment)
            raise InputError(
                f"found mass {inertia.mass:.4g} kg, principal moments {inertia.moments[0]:.4g}, "
                f"{inertia.moments[1]:.4g}, {inertia.moments[2]:.4g} kg m^2, which no rigid body has; MuJoCo takes "
                "only positive ones, none larger than the sum of the other two (osim and urdf can be written)",
                source=path,
                field=segment,
                code=Code.IMPOSSIBLE_BODY,
            )
    document = ET.Element("mujoco", model=safe_name(model.subject.name))
    compiler = {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false", "balanceinertia": "false"}
    child(document, "compiler", **compiler)
    child(document, "option", gravity=numbers((0.0, -GRAVITY, 0.0)))
    child(child(document, "default"), "joint", limited="false", damping="0", armature="0", frictionloss="0")
    parents = {GROUND: child(document, "worldbody")}
    chains: dict[str, tuple[JointFrames, ...]] = {}
    """Joints above a segment that is folded away."""
    for joint in joint_frames(model.parameters):
        chain = (*chains.pop(joint.parent, ()), joint)
        if segment_inertia(model.parameters, joint.child).mass == 0.0 and joint.child not in model.markers.segments:
            chains[joint.child] = chain
        else:
            parents[joint.child] = _add_body(parents[chain[0].parent], chain, model)
    if model.locked:
        equality = child(document, "equality")
        for name in model.locked:
            child(equality, "joint", joint1=name, polycoef="0 0 0 0 0")
    write_xml(document, path)


def body_joints(chain: tuple[JointFrames, ...]) -> tuple[pin.SE3, tuple[BodyJoint, ...]]:
    """Pose of the last child in the first parent at q = 0, and the coordinates between as joints of that child."""
    to_end = pin.SE3.Identity()  # S_k: all constants that come after the coordinate in hand
    joints: list[BodyJoint] = []
    for frames in reversed(chain):
        to_end = frames.to_child * to_end
        inverse = to_end.inverse()
        for motion in reversed(frames.motions):
            joints.append(BodyJoint(motion, inverse.rotation @ axis_vector(motion), inverse.translation))
        to_end = frames.in_parent * to_end
    return to_end, tuple(reversed(joints))


def _add_body(parent: ET.Element, chain: tuple[JointFrames, ...], model: SubjectModel) -> ET.Element:
    segment = chain[-1].child
    place, joints = body_joints(chain)
    quaternion = pin.Quaternion(place.rotation)
    wxyz = (quaternion.w, quaternion.x, quaternion.y, quaternion.z)
    body = child(parent, "body", name=segment, pos=numbers(place.translation), quat=numbers(wxyz))
    inertia = segment_inertia(model.parameters, segment)
    mass, moments = (inertia.mass, inertia.moments) if inertia.mass else (TALUS_MASS, [_TALUS_MOMENT] * 3)
    child(body, "inertial", pos=numbers(inertia.centre), mass=numbers([mass]), diaginertia=numbers(moments))
    for joint in joints:
        element = child(body, "joint", name=joint.motion.name, type="hinge" if joint.motion.rotates else "slide")
        element.set("axis", numbers(joint.axis))
        if joint.motion.rotates:
            element.set("pos", numbers(joint.point))
        element.set("range", numbers(COORDINATE_RANGES[joint.motion.name]))
    markers = model.markers
    for label, carrier, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        if carrier == segment:
            child(body, "site", name=safe_name(label), pos=numbers(local), size=numbers([_SITE_RADIUS]))
    return body


def write_urdf(model: SubjectModel, path: Path | str) -> None:
    """Write `model`: m, kg, rad; root link `ground` with y up; joints named as our 27 coordinates."""
    robot = ET.Element("robot", name=safe_name(model.subject.name))
    robot.append(ET.Comment(f" Written by gaitcal. y is up: gravity is (0, -{GRAVITY}, 0) in the root link. "))
    child(robot, "link", name=GROUND)
    for number, joint in enumerate(joint_frames(model.parameters)):
        _add_chain(robot, f"{number:02d}_{joint.name}", joint, model.locked)
    for segment in SEGMENTS:
        link = child(robot, "link", name=segment)
        inertia = segment_inertia(model.parameters, segment)
        if inertia.mass:
            inertial = child(link, "inertial")
            child(inertial, "origin", xyz=numbers(inertia.centre), rpy="0 0 0")
            child(inertial, "mass", value=numbers([inertia.mass]))
            x, y, z = (numbers([moment]) for moment in inertia.moments)
            child(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy="0", ixz="0", iyz="0")
    markers = model.markers
    for label, segment, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        name = MARKER_PREFIX + safe_name(label)
        child(robot, "link", name=name)
        _add_fixed(robot, f"{name}_fixed", segment, name, pin.SE3(pin.SE3.Identity().rotation, local))
    write_xml(robot, path)


def _add_chain(robot: ET.Element, name: str, frames: JointFrames, frozen: tuple[str, ...]) -> None:
    """A joint of ours as a fixed joint, one joint for each coordinate, and another fixed joint."""
    child(robot, "link", name=name)
    _add_fixed(robot, f"{name}_in_{frames.parent}", frames.parent, name, frames.in_parent)
    link, bound = name, numbers([_UNLIMITED])
    for motion in frames.motions:
        moved = f"{name}_{motion.name}"
        child(robot, "link", name=moved)
        joint = child(robot, "joint", name=motion.name, type="revolute" if motion.rotates else "prismatic")
        child(joint, "parent", link=link)
        child(joint, "child", link=moved)
        child(joint, "axis", xyz=numbers(axis_vector(motion)))
        low, high = (0.0, 0.0) if motion.name in frozen else COORDINATE_RANGES[motion.name]
        child(joint, "limit", lower=numbers([low]), upper=numbers([high]), effort=bound, velocity=bound)
        link = moved
    _add_fixed(robot, f"{name}_to_{frames.child}", link, frames.child, frames.to_child)


def _add_fixed(robot: ET.Element, name: str, parent: str, link: str, place: pin.SE3) -> None:
    joint = child(robot, "joint", name=name, type="fixed")
    child(joint, "parent", link=parent)
    child(joint, "child", link=link)
    child(joint, "origin", xyz=numbers(place.translation), rpy=numbers(space_fixed_xyz(place.rotation)))
