"""Model as MuJoCo XML (MJCF) and URDF; motions, generalised forces, ground reactions for OpenSim.

MJCF: each segment with mass is a body that contains its joints. MuJoCo applies the joints of a body
in order, each about an axis given in the body's frame at q = 0. For a chain of constants C and
motions M,

    X(q) = C_0 M_1 C_1 M_2 ... M_n C_n = (C_0 ... C_n) M'_1 ... M'_n
    M'_k = S_k^-1 M_k S_k,   S_k = C_k ... C_n,

so joint k has the axis R_k^T a_k through the point -R_k^T t_k, with (R_k, t_k) = S_k. Moving bodies
need mass in MuJoCo: the talus, which has none, is merged into the foot's body by the same formula,
exactly. Only where it carries a marker is it a body, of mass `TALUS_MASS`. Nothing is limited,
damped or actuated: the mechanical system is the same. Coordinates held at zero are fixed by an
equality.

URDF: a joint has one degree of freedom, so a joint of ours becomes a chain: a fixed joint to its
frame in the parent, one link without inertia for each coordinate, a fixed joint to the child
segment. Readers such as Pinocchio sort siblings alphabetically; the fixed joints are numbered so
that this is our order, and q is the same vector as ours. URDF has no gravity. The root link
`ground` is our laboratory, **y up**: set gravity to (0, -9.81, 0). Markers are links `marker_NAME`
without inertia. Coordinates that are held at zero have limits of zero.

Motions and forces are tables of OpenSim's Storage (`.mot`, `.sto`). It stops reading at the first
NaN without a message: rows with NaN are left out, and the header reports it. Ground reactions are
written as force at the centre of pressure and moment about it, with an XML file that assigns the
columns to the feet.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim import osim_writer
from gaitcal.io import atomic, force_plate
from gaitcal.io.opensim_files import StorageTable
from gaitcal.model.linkage import (
    COORDINATE_INDEX,
    COORDINATES,
    FILE_COORDINATES,
    SEGMENTS,
    Element,
    is_translation,
)
from gaitcal.model.parameters import MASSIVE_SEGMENTS, is_physical
from gaitcal.model.subject_model import GRAVITY, SubjectModel

TALUS_MASS = 1e-12
"""kg, of a talus that carries a marker: its weight of 1e-11 N is far below the resolution of any
result.
"""
_TALUS_MOMENT = 1e-14
"""kg m^2: MuJoCo accepts nothing below 1e-15."""
_SITE_RADIUS = 0.008
"""m, of the spheres that show markers."""
MARKER_PREFIX = "marker_"
_UNLIMITED = 1e4
"""N or N·m, m/s or rad/s: URDF requires limits of effort and speed, which we do not have."""


@dataclass(frozen=True)
class BodyJoint:
    """One coordinate as a joint of a MuJoCo body."""

    motion: Element
    axis: Array  # (3,) unit axis in the body's frame at q = 0
    point: Array  # (3,) m, on the axis, in the same frame


def write_mjcf(model: SubjectModel, path: Path | str) -> None:
    """Write the model for MuJoCo: m, kg, rad; y up; qpos, qvel, qacc are the vectors of ours.

    Parameters
    ----------
    model : SubjectModel
        Model; its markers become sites.
    path : Path or str
        File to write (.xml).

    Raises
    ------
    InputError
        No rigid body can have the inertia of a segment: a principal moment is larger than the sum
        of the others, or not positive. MuJoCo refuses to load it.
    """
    for segment, physical in zip(
        MASSIVE_SEGMENTS, is_physical(model.parameters.inertial), strict=True
    ):
        if not physical:
            inertia = osim_writer.get_segment_inertia(model.parameters, segment)
            raise InputError(
                f"found mass {inertia.mass:.4g} kg, principal moments {inertia.moments[0]:.4g}, "
                f"{inertia.moments[1]:.4g}, {inertia.moments[2]:.4g} kg m^2, which no rigid body "
                "can have; MuJoCo accepts only positive ones, none larger than the sum of the "
                "other two (osim and urdf can be written)",
                source=path,
                field=segment,
                code=Code.IMPOSSIBLE_BODY,
            )
    document = ET.Element("mujoco", model=osim_writer.encode_name(model.subject.name))
    compiler = {
        "angle": "radian",
        "autolimits": "true",
        "inertiafromgeom": "false",
        "balanceinertia": "false",
    }
    osim_writer.add_child(document, "compiler", **compiler)
    osim_writer.add_child(
        document, "option", gravity=osim_writer.format_numbers((0.0, -GRAVITY, 0.0))
    )
    osim_writer.add_child(
        osim_writer.add_child(document, "default"),
        "joint",
        limited="false",
        damping="0",
        armature="0",
        frictionloss="0",
    )
    parents = {osim_writer.GROUND: osim_writer.add_child(document, "worldbody")}
    # Segment that is merged into the one below -> joints above it.
    chains: dict[str, tuple[osim_writer.JointFrames, ...]] = {}
    for joint in osim_writer.list_joint_frames(model.parameters):
        chain = (*chains.pop(joint.parent, ()), joint)
        mass = osim_writer.get_segment_inertia(model.parameters, joint.child).mass
        if mass == 0.0 and joint.child not in model.markers.segments:
            chains[joint.child] = chain
        else:
            parents[joint.child] = _add_body(parents[chain[0].parent], chain, model)
    if model.locked:
        equality = osim_writer.add_child(document, "equality")
        for name in model.locked:
            osim_writer.add_child(equality, "joint", joint1=name, polycoef="0 0 0 0 0")
    osim_writer.write_xml(document, path)


def _convert_to_body_joints(
    chain: tuple[osim_writer.JointFrames, ...],
) -> tuple[pin.SE3, tuple[BodyJoint, ...]]:
    """Convert a chain of joints to joints of the last child's body.

    `chain`: joints from top to bottom. Returns: pose of the last child in the first parent at q =
    0; coordinates in between, in order.
    """
    # S_k of the module: all constants after the coordinate.
    to_end = pin.SE3.Identity()
    joints: list[BodyJoint] = []
    for frames in reversed(chain):
        to_end = frames.to_child * to_end
        inverse = to_end.inverse()
        for motion in reversed(frames.motions):
            axis = inverse.rotation @ osim_writer.make_axis_vector(motion)
            joints.append(BodyJoint(motion, axis, inverse.translation))
        to_end = frames.in_parent * to_end
    return to_end, tuple(reversed(joints))


def _add_body(
    parent: ET.Element, chain: tuple[osim_writer.JointFrames, ...], model: SubjectModel
) -> ET.Element:
    """Add a body with inertia, joints and sites of its markers."""
    segment = chain[-1].child
    place, joints = _convert_to_body_joints(chain)
    quaternion = pin.Quaternion(place.rotation)
    wxyz = (quaternion.w, quaternion.x, quaternion.y, quaternion.z)
    body = osim_writer.add_child(
        parent,
        "body",
        name=segment,
        pos=osim_writer.format_numbers(place.translation),
        quat=osim_writer.format_numbers(wxyz),
    )
    inertia = osim_writer.get_segment_inertia(model.parameters, segment)
    mass, moments = (
        (inertia.mass, inertia.moments) if inertia.mass else (TALUS_MASS, [_TALUS_MOMENT] * 3)
    )
    osim_writer.add_child(
        body,
        "inertial",
        pos=osim_writer.format_numbers(inertia.centre),
        mass=osim_writer.format_numbers([mass]),
        diaginertia=osim_writer.format_numbers(moments),
    )
    for joint in joints:
        element = osim_writer.add_child(
            body, "joint", name=joint.motion.name, type="hinge" if joint.motion.rotates else "slide"
        )
        element.set("axis", osim_writer.format_numbers(joint.axis))
        if joint.motion.rotates:
            element.set("pos", osim_writer.format_numbers(joint.point))
        element.set(
            "range", osim_writer.format_numbers(osim_writer.COORDINATE_RANGES[joint.motion.name])
        )
    markers = model.markers
    for label, holder, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        if holder == segment:
            osim_writer.add_child(
                body,
                "site",
                name=osim_writer.encode_name(label),
                pos=osim_writer.format_numbers(local),
                size=osim_writer.format_numbers([_SITE_RADIUS]),
            )
    return body


def write_urdf(model: SubjectModel, path: Path | str) -> None:
    """Write the model as URDF: m, kg, rad; root link `ground`, y up; joints named as coordinates.

    Parameters
    ----------
    model : SubjectModel
        Model.
    path : Path or str
        File to write (.urdf).
    """
    robot = ET.Element("robot", name=osim_writer.encode_name(model.subject.name))
    robot.append(
        ET.Comment(
            f" Written by gaitcal. y is up: gravity is (0, -{GRAVITY}, 0) in the root link. "
        )
    )
    osim_writer.add_child(robot, "link", name=osim_writer.GROUND)
    for number, joint in enumerate(osim_writer.list_joint_frames(model.parameters)):
        _add_chain(robot, f"{number:02d}_{joint.name}", joint, model.locked)
    for segment in SEGMENTS:
        link = osim_writer.add_child(robot, "link", name=segment)
        inertia = osim_writer.get_segment_inertia(model.parameters, segment)
        if inertia.mass:
            inertial = osim_writer.add_child(link, "inertial")
            osim_writer.add_child(
                inertial, "origin", xyz=osim_writer.format_numbers(inertia.centre), rpy="0 0 0"
            )
            osim_writer.add_child(
                inertial, "mass", value=osim_writer.format_numbers([inertia.mass])
            )
            x, y, z = (osim_writer.format_numbers([moment]) for moment in inertia.moments)
            osim_writer.add_child(
                inertial, "inertia", ixx=x, iyy=y, izz=z, ixy="0", ixz="0", iyz="0"
            )
    markers = model.markers
    for label, segment, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        name = MARKER_PREFIX + osim_writer.encode_name(label)
        osim_writer.add_child(robot, "link", name=name)
        _add_fixed(
            robot, f"{name}_fixed", segment, name, pin.SE3(pin.SE3.Identity().rotation, local)
        )
    osim_writer.write_xml(robot, path)


def _add_chain(
    robot: ET.Element, name: str, frames: osim_writer.JointFrames, frozen: tuple[str, ...]
) -> None:
    """Add a joint as a fixed joint, one joint for each coordinate, and another fixed joint."""
    osim_writer.add_child(robot, "link", name=name)
    _add_fixed(robot, f"{name}_in_{frames.parent}", frames.parent, name, frames.in_parent)
    link, bound = name, osim_writer.format_numbers([_UNLIMITED])
    for motion in frames.motions:
        moved = f"{name}_{motion.name}"
        osim_writer.add_child(robot, "link", name=moved)
        joint = osim_writer.add_child(
            robot, "joint", name=motion.name, type="revolute" if motion.rotates else "prismatic"
        )
        osim_writer.add_child(joint, "parent", link=link)
        osim_writer.add_child(joint, "child", link=moved)
        osim_writer.add_child(
            joint, "axis", xyz=osim_writer.format_numbers(osim_writer.make_axis_vector(motion))
        )
        low, high = (
            (0.0, 0.0) if motion.name in frozen else osim_writer.COORDINATE_RANGES[motion.name]
        )
        osim_writer.add_child(
            joint,
            "limit",
            lower=osim_writer.format_numbers([low]),
            upper=osim_writer.format_numbers([high]),
            effort=bound,
            velocity=bound,
        )
        link = moved
    _add_fixed(robot, f"{name}_to_{frames.child}", link, frames.child, frames.to_child)


def _add_fixed(robot: ET.Element, name: str, parent: str, link: str, place: pin.SE3) -> None:
    """Add a fixed joint between two links."""
    joint = osim_writer.add_child(robot, "joint", name=name, type="fixed")
    osim_writer.add_child(joint, "parent", link=parent)
    osim_writer.add_child(joint, "child", link=link)
    osim_writer.add_child(
        joint,
        "origin",
        xyz=osim_writer.format_numbers(place.translation),
        rpy=osim_writer.format_numbers(osim_writer.convert_to_space_fixed_xyz(place.rotation)),
    )


MOTION_COMMENTS = (
    "Coordinates of the model.osim beside this file; rotations in degrees, translations in m.",
)

MOMENT_COMMENTS = (
    "Units: N m for rotations (NAME_moment), N for translations (NAME_force); time in s.",
    "Internal and net: the generalised force of all structures that cross the joint, on the child "
    "segment.",
    "Sign: positive drives the coordinate of that name in its positive direction; an external "
    "moment is the negative.",
    "Frame: each about or along the axis of its own coordinate; laboratory x forward, y up, z "
    "right.",
    "pelvis rows are the residual: what the ground reactions do not explain.",
)


def write_mot(path: Path | str, time: Array, coordinates: tuple[str, ...], q: Array) -> None:
    """Write coordinates as an OpenSim motion: m and degrees, pelvis rotations first.

    Parameters
    ----------
    path : Path or str
        File to write (.mot).
    time : (nf,) Array
        s, increasing.
    coordinates : tuple of str
        Names of the columns.
    q : (nf, n) Array
        m, rad; rows with NaN are left out.

    Raises
    ------
    InputError
        A name is none of the 27 coordinates, or shapes do not agree.
    """
    names, values = _sort_columns(path, coordinates, q)
    scale = np.array([1.0 if is_translation(name) else 180.0 / np.pi for name in names])
    _write_table(
        path,
        "Coordinates",
        MOTION_COMMENTS,
        StorageTable(np.asarray(time), names, values * scale, True),
    )


def write_sto_moments(
    path: Path | str,
    time: Array,
    tau: Array,
    coordinates: tuple[str, ...] = COORDINATES,
    *,
    comments: tuple[str, ...] = (),
) -> None:
    """Write generalised forces with the column names of OpenSim's inverse dynamics tool.

    Parameters
    ----------
    path : Path or str
        File to write (.sto).
    time : (nf,) Array
        s, increasing.
    tau : (nf, n) Array
        N·m and N; rows with NaN are left out.
    coordinates : tuple of str
        Names of the columns.
    comments : tuple of str
        Further lines of the header.

    Raises
    ------
    InputError
        A name is none of the 27 coordinates, or shapes do not agree.
    """
    names, values = _sort_columns(path, coordinates, tau)
    columns = tuple(f"{name}_{'force' if is_translation(name) else 'moment'}" for name in names)
    table = StorageTable(np.asarray(time), columns, values, False)
    _write_table(path, "Inverse Dynamics Generalized Forces", (*MOMENT_COMMENTS, *comments), table)


def write_external_loads(
    folder: Path | str, time: Array, wrenches: Array, stem: str = "ground_reactions"
) -> tuple[Path, Path]:
    """Write ground reactions on both feet as `STEM.mot` and `STEM.xml` (OpenSim's ExternalLoads).

    Parameters
    ----------
    folder : Path or str
        Folder for both files.
    time : (nf,) Array
        s, increasing.
    wrenches : (nf, 2, 6) Array
        Force (N) and moment (N·m) about the laboratory's origin, on the right and the left foot.
    stem : str
        Name of the files, encoded for every file system: a trial's name may be used.

    Returns
    -------
    tuple of Path
        Table and loads.

    Raises
    ------
    InputError
        Shapes do not agree or a number is not finite.
    """
    name = osim_writer.encode_name(stem)
    path, loads = Path(folder) / f"{name}.mot", Path(folder) / f"{name}.xml"
    if wrenches.shape != (len(time), len(FEET), 6):
        raise _make_error(
            path, f"found wrenches of shape {wrenches.shape}, expected (frames, 2, 6)"
        )
    if not np.isfinite(wrenches).all():
        raise _make_error(path, "a ground reaction is not finite; leave out frames without one")
    document = ET.Element("OpenSimDocument", Version=osim_writer.DOCUMENT_VERSION)
    external = osim_writer.add_child(document, "ExternalLoads", name="ground_reactions")
    objects = osim_writer.add_child(external, "objects")
    names: list[str] = []
    columns: list[Array] = []
    for foot, wrench in zip(FEET, np.moveaxis(wrenches, 1, 0), strict=True):
        side = foot[-1]
        force, point, torque = (
            f"ground_force_{side}_v",
            f"ground_force_{side}_p",
            f"ground_torque_{side}_",
        )
        names += [f"{identifier}{axis}" for identifier in (force, point, torque) for axis in "xyz"]
        columns += [wrench[:, :3], *force_plate.split_wrench(wrench)]
        load = osim_writer.add_child(objects, "ExternalForce", name=f"ground_on_{foot}")
        osim_writer.add_child(load, "applied_to_body", foot)
        osim_writer.add_child(load, "force_expressed_in_body", "ground")
        osim_writer.add_child(load, "point_expressed_in_body", "ground")
        osim_writer.add_child(load, "force_identifier", force)
        osim_writer.add_child(load, "point_identifier", point)
        osim_writer.add_child(load, "torque_identifier", torque)
    osim_writer.add_child(external, "datafile", path.name)
    comments = (
        "Ground reactions on the feet, laboratory axes: force N, point m, moment about the point N "
        "m.",
    )
    table = StorageTable(np.asarray(time), tuple(names), np.hstack(columns), False)
    _write_table(path, "Ground reactions", comments, table)
    osim_writer.write_xml(document, loads)
    return path, loads


def _make_error(path: Path | str, message: str, field: str | None = None) -> InputError:
    """Make the error of a file that cannot be written."""
    return InputError(message, source=path, field=field, code=Code.NOT_WRITABLE)


def _sort_columns(
    path: Path | str, coordinates: tuple[str, ...], values: Array
) -> tuple[tuple[str, ...], Array]:
    """Sort coordinates and the columns of `values` (nf, n) in the order of OpenSim's files."""
    for name in coordinates:
        if name not in COORDINATE_INDEX:
            raise _make_error(
                path, f"found '{name}'; allowed are {', '.join(FILE_COORDINATES)}", "columns"
            )
    if values.ndim != 2 or values.shape[1] != len(coordinates):
        raise _make_error(
            path, f"found values of shape {values.shape}, expected (frames, {len(coordinates)})"
        )
    names = tuple(name for name in FILE_COORDINATES if name in coordinates)
    return names, values[:, [coordinates.index(name) for name in names]]


def _write_table(
    path: Path | str, title: str, comments: tuple[str, ...], table: StorageTable
) -> None:
    """Write a table without rows that contain NaN, where OpenSim's Storage stops reading.

    Titles and comments that the header could be confused by are changed.
    """
    nf, columns = len(table.time), len(table.names)
    if table.values.shape != (nf, columns):
        raise _make_error(
            path, f"found values of shape {table.values.shape}, expected {(nf, columns)}"
        )
    if not (np.isfinite(table.time).all() and (np.diff(table.time) > 0).all()):
        raise _make_error(path, "must be finite and increase from row to row", "time")
    known = np.isfinite(table.values).all(axis=1)
    missing = nf - int(known.sum())
    if missing:
        comments = (*comments, f"{missing} of {nf} rows are left out: they hold no value.")
    kept = replace(table, time=table.time[known], values=table.values[known])
    atomic.write_text_atomically(
        path, kept.format_text(_make_one_line(title), tuple(map(_make_one_line, comments)))
    )


def _make_one_line(text: str) -> str:
    """Make a text safe for one line of the header."""
    return (
        " ".join(text.split()).replace("=", ":").replace("endheader", "end of header") or "gaitcal"
    )
