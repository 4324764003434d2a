"""Correspondence of joints: those of an OpenSim model that are our leg joints, and their hinges.

Joints are found by the names of their coordinates (those of Gait2354, Gait2392, Rajagopal2016),
else by topology: the pelvis is the body with two legs; a leg is a chain of three or more moving
joints that does not branch into two such chains. Its first three are hip, knee and ankle; a fourth
within `TALUS` of the third is the subtalar joint. A file of the user takes precedence over both.

A knee may roll and slide. It is represented by the hinge that is nearest to its motion in the
postures of the recordings (else of a stride of the built-in person), by least squares over points
at the distance `LEVER` from its centre,

    X_parent_child(q) = A Rz(theta(q)) B^-1    (nearly),

so that markers of such a knee would lead to a linkage with that hinge. A hinge represents itself.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic import Field
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.peer_model import Axis, PeerJoint, PeerModel, find_displacement_axis
from gaitcal.io.toml import Table, read_validated, require_known
from gaitcal.model.linkage import COORDINATE_INDEX, NEEDED_JOINTS, SEGMENTS, SIDES
from gaitcal.model.parameters import MASSIVE_SEGMENTS
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.synthetic.walk import compute_gait_curves

COORDINATE_OF = {
    "hip": "hip_flexion",
    "knee": "knee_angle",
    "talocrural": "ankle_angle",
    "subtalar": "subtalar_angle",
}
"""Joint of a leg -> its first coordinate, in our linkage and in the usual models."""
TALUS = 0.08
"""m, size of the talus: a joint that is farther from the ankle is one of the toes."""
LEVER = 0.2
"""m, typical distance of markers from a joint."""
POSTURES = 20
"""Postures of a stride, or quantiles of the coordinate in the recordings."""
EXACT = 1e-9
"""m: a joint that differs less from a hinge is one."""


@dataclass(frozen=True)
class Hinge:
    """Hinge: frames in both bodies with z along the axis, at zero mean translation along it."""

    in_parent: pin.SE3
    in_child: pin.SE3
    deviation: float = 0.0
    """m RMS, distance of points at `LEVER` from the centre from those of the rolling joint."""

    def measure_angle(self, pose: pin.SE3) -> float:
        """Measure the hinge's angle that is nearest to a pose.

        Parameters
        ----------
        pose : pin.SE3
            Pose of the child in the parent.

        Returns
        -------
        float
            rad
        """
        r = (self.in_parent.rotation.T @ pose.rotation) @ self.in_child.rotation
        return float(np.arctan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1]))

    def measure_slide(self, pose: pin.SE3) -> float:
        """Measure the translation (m) of the child along the axis at a pose in the parent."""
        return float((self.in_parent.actInv(pose) * self.in_child).translation[2])

    def compute_pose(self, angle: float) -> pin.SE3:
        """Compute the pose of the child in the parent at an angle (rad)."""
        return (
            self.in_parent
            * pin.SE3(make_axis_rotation(2, angle), np.zeros(3))
            * self.in_child.inverse()
        )


@dataclass(frozen=True, kw_only=True)
class LegJoint:
    """Joint of a leg in the user's model."""

    ours: str
    """`hip_r`, `knee_r`, `talocrural_r`, `subtalar_r`, or `_l`."""
    theirs: PeerJoint
    """Joint of the model."""
    coordinate: str
    """Coordinate whose motion shows its axis."""
    found_by: str
    """`name`, `topology`, or the user's file."""
    hinge: Hinge | None
    """Hinge that represents a knee, talocrural or subtalar joint; None of a hip."""


class _NamesFile(Table):
    """Tables of the TOML file."""

    joints: dict[str, str] = Field(default={})
    coordinates: dict[str, str] = Field(default={})


def read_names(path: Path) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Read which joints of a model are hips, knees and ankles.

    Parameters
    ----------
    path : Path
        TOML file with the tables `joints` and `coordinates`.

    Returns
    -------
    tuple of mapping
        Our joint -> joint of the model; our joint -> coordinate of the model.

    Raises
    ------
    InputError
        The file is not valid.
    """
    file = read_validated(_NamesFile, path)
    allowed = [f"{joint}_{side}" for side in SIDES for joint in NEEDED_JOINTS]
    for field in ("joints", "coordinates"):
        require_known(
            getattr(file, field), allowed, "joint of a leg", source=path, field=field, listed=True
        )
    return file.joints, file.coordinates


def find_leg_joints(
    peer: PeerModel, names: Path | None = None, recorded: Mapping[str, Array] | None = None
) -> tuple[LegJoint, ...]:
    """Find the joints of both legs, as far as the model has them.

    Parameters
    ----------
    peer : PeerModel
        Model of the user.
    names : Path, optional
        TOML file with the names of joints.
    recorded : mapping, optional
        Our coordinate -> (n,) rad: postures for which the hinge of a joint shall hold.

    Returns
    -------
    tuple of LegJoint
        Each joint after the one above it.

    Raises
    ------
    InputError
        Legs cannot be identified, do not form a chain, or a name of the user is not in the model.
    """
    joints, coordinates = ({}, {}) if names is None else read_names(names)
    source = names or Path()
    by_name = {j.name: j for j in peer.joints.values()}
    require_known(joints.values(), by_name, "joint of the model", source=source, field="joints")
    has_usual_names = any(
        peer.find_joint(f"hip_flexion_{s}") and peer.find_joint(f"knee_angle_{s}") for s in SIDES
    )
    by_topology = None
    if not has_usual_names and not any(name.startswith("hip") for name in joints):
        by_topology = _find_legs_by_topology(peer)
    out = []
    for side in SIDES:
        # Kind of joint -> joint of the model; those of the user's file take precedence.
        found = _find_side_joints(peer, side, by_topology)
        given = {
            kind: by_name[joints[f"{kind}_{side}"]]
            for kind in NEEDED_JOINTS
            if f"{kind}_{side}" in joints
        }
        leg = found | given
        for kind in NEEDED_JOINTS:
            # Both ankle coordinates may belong to one joint.
            if kind not in leg or (kind == "subtalar" and leg[kind] is leg.get("talocrural")):
                continue
            known = [c.name for c in leg[kind].coordinates]
            chosen = coordinates.get(f"{kind}_{side}")
            if chosen is not None:
                what = "coordinate of that joint"
                require_known([chosen], known, what, source=source, field="coordinates")
            usual = f"{COORDINATE_OF[kind]}_{side}"
            if not chosen:
                chosen = usual if usual in known else _select_main_coordinate(peer, leg, kind)
            found_by = "name" if by_topology is None else "topology"
            leg_joint = LegJoint(
                ours=f"{kind}_{side}",
                theirs=leg[kind],
                coordinate=chosen,
                found_by="your file" if kind in given else found_by,
                hinge=None,
            )
            out.append(leg_joint)
    _require_chain(peer, out)
    for k, leg_joint in enumerate(out):
        if not leg_joint.ours.startswith("hip"):
            out[k] = replace(leg_joint, hinge=fit_hinge(peer, leg_joint, recorded or {}))
    return tuple(out)


def _find_side_joints(
    peer: PeerModel, side: str, by_topology: Mapping[str, PeerJoint] | None
) -> dict[str, PeerJoint]:
    """Find the joints of one leg by topology, or else by the usual names of coordinates."""
    found = {}
    for kind in NEEDED_JOINTS:
        if by_topology is not None:
            joint = by_topology.get(f"{kind}_{side}")
        else:
            joint = peer.find_joint(f"{COORDINATE_OF[kind]}_{side}")
        if joint is not None:
            found[kind] = joint
    return found


def fit_hinge(peer: PeerModel, leg: LegJoint, recorded: Mapping[str, Array]) -> Hinge:
    """Fit the hinge that is nearest to a joint's motion.

    `leg`: joint; its `hinge` is not used. `recorded`: our coordinate -> (n,) rad of the postures;
    without it those of a stride. Raises InputError: the joint does not rotate with its coordinate.
    """
    c = next(c for c in leg.theirs.coordinates if c.name == leg.coordinate)
    kind, side = leg.ours.split("_")
    name = f"{COORDINATE_OF[kind]}_{side}"
    if name in recorded:
        angles = np.quantile(recorded[name], (np.arange(POSTURES) + 0.5) / POSTURES)
    else:
        angles = compute_gait_curves(np.arange(POSTURES) / POSTURES)[0][:, COORDINATE_INDEX[name]]
    # Some models bend the knee by negative angles.
    angles = angles if kind != "knee" or c.high >= -c.low else -angles
    poses = [peer.compute_joint_pose(leg.theirs, {c.name: float(angle)}) for angle in angles]
    ends = poses[int(np.argmin(angles))], poses[int(np.argmax(angles))]
    axis = find_displacement_axis(*ends)
    if axis is None:
        message = f"does not rotate with its coordinate {c.name}"
        raise InputError(
            message, source=peer.source, field=f"joint {leg.theirs.name}", code=Code.OTHER_MODEL
        )
    # First guess: the axis of the whole displacement, through the point nearest to the joint.
    centre = axis.find_nearest((ends[0] * leg.theirs.in_child).translation)
    along = pin.Quaternion.FromTwoVectors(np.eye(3)[2], axis.direction).toRotationMatrix()
    first = pin.SE3(along, centre)
    hinge = Hinge(first, ends[0].actInv(first))
    tips = LEVER * np.vstack([np.eye(3), -np.eye(3)])
    points = [leg.theirs.in_child.act(tip) for tip in tips]

    def locate(child_poses: Sequence[pin.SE3]) -> Array:
        """Locate the points (POSTURES, 6, 3) m in the parent."""
        located = np.empty((len(child_poses), len(points), 3))
        for k, pose in enumerate(child_poses):
            located[k] = [pose.act(point) for point in points]
        return located

    measured = locate(poses)

    def move(x: Array) -> Hinge:
        """Move the first hinge by small rotations and translations (9,) rad, m in both bodies."""
        by_parent = pin.SE3(pin.exp3(np.array([*x[:2], 0.0])), np.array([*x[2:4], 0.0]))
        by_child = pin.SE3(pin.exp3(np.array([*x[4:6], 0.0])), x[6:9])
        return Hinge(hinge.in_parent * by_parent, hinge.in_child * by_child)

    def compute_residual(x: Array) -> Array:
        """Compute distances (m) of the points between the hinge and the joint."""
        moved = move(x)
        nearest = [moved.compute_pose(moved.measure_angle(pose)) for pose in poses]
        return (locate(nearest) - measured).ravel()

    if np.abs(compute_residual(np.zeros(9))).max() > EXACT:
        best = least_squares(compute_residual, np.zeros(9), method="lm", xtol=1e-12, ftol=1e-12)
        deviation = float(np.sqrt(3.0 * np.mean(np.square(best.fun))))
        hinge = replace(move(best.x), deviation=deviation)
    return hinge


def _select_main_coordinate(peer: PeerModel, leg: Mapping[str, PeerJoint], kind: str) -> str:
    """Select the coordinate whose axis is nearest to the pelvis' z: that of flexion.

    Of a subtalar joint, whose axis is oblique, it is the one with the widest range. `leg`: kind of
    our joint -> joint of the model.
    """
    joint, hip = leg[kind], leg.get("hip")
    # Coordinate -> axis of its rotation in the joint's frame.
    axes = {
        a.coordinate: a.axis for a in joint.axes or () if a.rotates and a.coordinate is not None
    }
    flexes = kind != "subtalar" and len(axes) > 1
    if flexes and hip is not None and peer.is_below(joint.parent, hip.parent):
        z = (peer.compute_body_pose(joint.parent, hip.parent) * joint.in_parent).rotation[2]
        return max(axes, key=lambda name: abs(float(z @ axes[name])))
    found = [c for c in joint.coordinates if c.name in axes] or list(joint.coordinates)
    return max(found, key=lambda c: c.high - c.low).name if found else ""


def _require_chain(peer: PeerModel, found: Iterable[LegJoint]) -> None:
    """Raise InputError unless every joint moves and is below the one above it."""
    above: LegJoint | None = None
    for leg in found:
        where = f"joint {leg.theirs.name} ({leg.ours})"
        if not leg.coordinate:
            raise InputError(
                "has no coordinate", source=peer.source, field=where, code=Code.OTHER_MODEL
            )
        for body in (leg.theirs.parent, leg.theirs.child):
            if body not in peer.masses:
                message = f"is fixed to '{body}', which is no body of the model"
                raise InputError(message, source=peer.source, field=where, code=Code.OTHER_MODEL)
        same_leg = above is not None and above.ours[-2:] == leg.ours[-2:]
        if (
            above is not None
            and same_leg
            and not peer.is_below(leg.theirs.parent, above.theirs.child)
        ):
            message = f"is not below {above.theirs.name} ({above.ours})"
            raise InputError(message, source=peer.source, field=where, code=Code.OTHER_MODEL)
        above = leg


def _find_legs_by_topology(peer: PeerModel) -> dict[str, PeerJoint]:
    """Find `hip_r` and so on by the tree of bodies; raise InputError without two legs."""
    below: dict[str, list[PeerJoint]] = {}
    for joint in peer.joints.values():
        below.setdefault(joint.parent, []).append(joint)

    def list_chain(joint: PeerJoint, depth: int = 0) -> list[PeerJoint]:
        """List the longest row of moving joints from this one on."""
        # A file may contain a circle: the depth is limited.
        further = below.get(joint.child, []) if depth <= len(peer.joints) else []
        longest = max((list_chain(j, depth + 1) for j in further), key=len, default=[])
        return [joint, *longest] if joint.coordinates else longest

    def is_leg(joint: PeerJoint) -> bool:
        """Check that a chain has three moving joints and no branch into two rows of two."""
        bodies = [joint.child]
        for body in bodies:
            bodies += [j.child for j in below.get(body, []) if len(bodies) <= len(peer.joints)]
            if sum(len(list_chain(j)) > 1 for j in below.get(body, [])) > 1:
                return False
        return len(list_chain(joint)) >= 3

    for body in peer.masses:
        legs = [j for j in below.get(body, []) if is_leg(j)]
        if len(legs) != 2:
            continue
        right, left = sorted(legs, key=lambda j: -j.in_parent.translation[2])
        out: dict[str, PeerJoint] = {}
        for side, leg in (("r", right), ("l", left)):
            row = list_chain(leg)
            out |= {f"{k}_{side}": j for k, j in zip(NEEDED_JOINTS[:3], row, strict=False)}
            if len(row) > 3:
                fourth = peer.compute_body_pose(row[3].child, row[2].child).translation
                if np.linalg.norm(fourth) < TALUS:
                    out[f"subtalar_{side}"] = row[3]
        return out
    raise InputError(
        "has no pelvis with two legs of three joints or more, nor coordinates hip_flexion_r, "
        f"knee_angle_r (and _l); found the bodies {', '.join(peer.masses)}; --names FILE.toml "
        "names the joints",
        source=peer.source,
        code=Code.OTHER_MODEL,
    )


@dataclass(frozen=True, kw_only=True)
class MovedJoint:
    """Frames of a moved joint, and the displacement of centre and axis in both bodies."""

    in_parent: pin.SE3
    in_child: pin.SE3
    centre: Array  # (3,) m, in the parent, now
    displacements: tuple[Array, Array]
    rotations: tuple[float, float]


def move_ball_joint(
    leg: LegJoint, was: pin.SE3, target: Axis, standing: pin.SE3 | None
) -> MovedJoint:
    """Move the centre of a joint to the point of `target`.

    Parameters
    ----------
    leg : LegJoint
        Joint of the model.
    was : pin.SE3
        Pose of the child in the parent at q0.
    target : Axis
        Its point (m, in the parent) is the new centre.
    standing : pin.SE3 or None
        Pose of the child in the parent of the standing bones; None where the joint keeps its frame
        in the child.

    Returns
    -------
    MovedJoint
    """
    joint = leg.theirs
    displacement = target.point - (was * joint.in_child).translation
    in_parent = pin.SE3(np.eye(3), displacement) * joint.in_parent
    in_child = joint.in_child
    if standing is not None:
        # C' of the module: the motion at q0 leads to the standing bones.
        in_child = standing.actInv(in_parent * joint.in_parent.actInv(was * joint.in_child))
    return MovedJoint(
        in_parent=in_parent,
        in_child=in_child,
        centre=target.point,
        displacements=(displacement, in_child.translation - joint.in_child.translation),
        rotations=(0.0, measure_rotation(joint.in_child, in_child)),
    )


def move_hinge(leg: LegJoint, was: pin.SE3, target: Axis, standing: pin.SE3 | None) -> MovedJoint:
    """Move the axis of a joint to a line.

    Parameters
    ----------
    leg, was, standing
        As of `move_ball_joint`.
    target : Axis
        New axis (m, in the parent).

    Returns
    -------
    MovedJoint
    """
    joint, hinge = leg.theirs, leg.hinge
    if hinge is None:
        raise ValueError(f"{leg.ours} is no hinge")
    step, displacement, centre = compute_smallest_motion(
        hinge.in_parent, target, (was * joint.in_child).translation
    )
    in_child, child_displacement, child_rotation = joint.in_child, np.zeros(3), 0.0
    if standing is not None:
        other, child_displacement, _ = compute_smallest_motion(
            hinge.in_child, target.transform(standing.inverse()), joint.in_child.translation
        )
        new = Hinge(step * hinge.in_parent, other * hinge.in_child)
        # phi and d of the module: rotation and translation of the standing bones in the new hinge.
        phi = new.measure_angle(standing) - hinge.measure_angle(was)
        d = new.measure_slide(standing)
        back = pin.SE3(make_axis_rotation(2, -phi), np.array([0.0, 0.0, -d]))
        in_child = new.in_child * back * hinge.in_child.actInv(joint.in_child)
        old_axis, new_axis = hinge.in_child.rotation[:, 2], new.in_child.rotation[:, 2]
        sine = np.linalg.norm(np.cross(old_axis, new_axis))
        child_rotation = float(np.arctan2(sine, old_axis @ new_axis))
    return MovedJoint(
        in_parent=step * joint.in_parent,
        in_child=in_child,
        centre=centre,
        displacements=(displacement, child_displacement),
        rotations=(measure_rotation(pin.SE3.Identity(), step), child_rotation),
    )


def compute_smallest_motion(
    hinge: pin.SE3, target: Axis, centre: Array
) -> tuple[pin.SE3, Array, Array]:
    """Compute the smallest rigid motion of a hinge's axis to a line.

    Parameters
    ----------
    hinge : pin.SE3
        Frame of the hinge, z along the axis.
    target : Axis
        Line, in the frame in which `hinge` is given.
    centre : (3,) Array
        m, position of the joint.

    Returns
    -------
    motion : pin.SE3
        Translation across the axis and rotation of it.
    displacement : (3,) Array
        m, of the point of the axis nearest to `centre`.
    point : (3,) Array
        m, new position of that point.
    """
    axis = Axis(hinge.translation, hinge.rotation[:, 2])
    direction = target.direction * (1.0 if target.direction @ axis.direction >= 0 else -1.0)
    start = axis.find_nearest(centre)
    end = target.find_nearest(start)
    rotation = pin.Quaternion.FromTwoVectors(axis.direction, direction).toRotationMatrix()
    # Rotation about `start`, then translation to `end`.
    about = pin.SE3(rotation, np.zeros(3)) * pin.SE3(np.eye(3), -start)
    return pin.SE3(np.eye(3), end) * about, end - start, end


def measure_rotation(a: pin.SE3, b: pin.SE3) -> float:
    """Measure the angle (rad) between two frames."""
    return float(np.linalg.norm(pin.log3(a.rotation.T @ b.rotation)))


def measure_distance(a: pin.SE3, b: pin.SE3) -> float:
    """Measure the distance (m) between the origins of two frames."""
    return float(np.linalg.norm(a.translation - b.translation))


def solve_standing_coordinates(
    peer: PeerModel, row: Sequence[PeerJoint], target: pin.SE3, legs: Mapping[str, LegJoint]
) -> dict[str, float]:
    """Solve for coordinates of the model that rotate its bodies relative to each other as given.

    Locked coordinates keep their value. A single hinge takes its angle only.

    Parameters
    ----------
    peer : PeerModel
        Model of the user.
    row : sequence of PeerJoint
        Joints between the two bodies, from top to bottom.
    target : pin.SE3
        Pose of the lower body in the upper one.
    legs : mapping
        Name of a joint of the model -> LegJoint.

    Returns
    -------
    dict
        Coordinate -> rad (m).
    """
    held: dict[str, float] = {}
    free: list[str] = []
    for joint in row:
        used = {axis.coordinate for axis in joint.axes or ()}
        for coordinate in (c for c in joint.coordinates if c.name in used):
            if coordinate.locked:
                held[coordinate.name] = coordinate.default
            else:
                free.append(coordinate.name)
    if not free:
        return held

    def get_values(q: Array) -> dict[str, float]:
        """Get the values of all coordinates from those of the free ones."""
        return held | {name: float(x) for name, x in zip(free, q, strict=True)}

    single = None
    if len(row) == 1 and row[0].name in legs and len(free) == 1:
        single = legs[row[0].name].hinge

    def compute_residual(q: Array) -> Array:
        """Compute the difference of angles, or the rotation vector between both orientations."""
        if single is not None:
            pose = peer.compute_joint_pose(row[0], get_values(q))
            return np.array([single.measure_angle(pose) - single.measure_angle(target)])
        rotation = np.eye(3)
        for joint in row:
            rotation = rotation @ peer.compute_joint_pose(joint, get_values(q)).rotation
        # The small weight on q determines coordinates that do not rotate the bodies.
        return np.concatenate([pin.log3(rotation.T @ target.rotation), 1e-9 * q])

    start = np.zeros(len(free))
    fit = least_squares(compute_residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return get_values(fit.x)


ARMS: tuple[str, ...] = tuple(
    f"{part}_{side}" for side in SIDES for part in ("upper_arm", "forearm_hand")
)
"""Segments of the arms."""
_MIDDLE = {"pelvis": "pelvis", "torso": "head_trunk", "trunk": "head_trunk", "head": "head_trunk"}
_SIDED = {
    "femur": "thigh",
    "patella": "thigh",
    "tibia": "shank",
    "fibula": "shank",
    "pretalus": "foot",
    "talus": "foot",
    "calcn": "foot",
    "toes": "foot",
    "humerus": "upper_arm",
    "ulna": "forearm_hand",
    "radius": "forearm_hand",
    "hand": "forearm_hand",
}


def is_sliding_body(body: str) -> bool:
    """Check whether a body slides on its segment (patella): its markers do not belong to it."""
    return body.startswith("patella_")


def find_segment(body: str) -> str | None:
    """Find our segment of a body of another model.

    Parameters
    ----------
    body : str
        Name of the body: one of the usual OpenSim models, or ours.

    Returns
    -------
    str or None
        The talus belongs to the foot, the patella to the thigh; None for an unknown body.
    """
    if body in MASSIVE_SEGMENTS:
        return body
    if body in _MIDDLE:
        return _MIDDLE[body]
    stem, _, side = body.rpartition("_")
    if side in SIDES and stem in _SIDED:
        return f"{_SIDED[stem]}_{side}"
    return body if body in SEGMENTS else None


def match_label(label: str, candidates: tuple[str, ...]) -> str | None:
    """Match a label: the same one, or the only one that differs in case and punctuation only.

    Parameters
    ----------
    label : str
        Label to be found.
    candidates : tuple of str
        Labels of the other model.

    Returns
    -------
    str or None
    """
    if label in candidates:
        return label
    plain = _normalise_label(label)
    alike = [c for c in candidates if _normalise_label(c) == plain]
    return alike[0] if len(alike) == 1 and plain else None


def _normalise_label(label: str) -> str:
    """Remove case and punctuation."""
    return "".join(c for c in label.casefold() if c.isalnum())
