"""Our linkage with the very joints of an OpenSim model: for what is put into such a model, a truth.

Segment frames are the model's body frames (the talus has its own); the person stands with all coordinates of the model
zero. A line of the model's joint becomes joint parameters as `gaitcal/model/linkage.py` defines them.
"""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.export.osim import frames_of
from gaitcal.export.osim_correspondence import Hinge, LegJoint, leg_joints
from gaitcal.export.peer_model import Axis, PeerModel
from gaitcal.model.chain import axis_rotation
from gaitcal.model.linkage import JOINTS, SIDES, ZERO_ANGLES
from gaitcal.model.parameters import Parameters, published_subject
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel

JOINT = {joint.name: joint for joint in JOINTS}
FREE_POINTS = 4
"""Markers of a segment, where those of the model are not to be used."""


def person_of(peer: PeerModel, *, markers: bool = True) -> SubjectModel:
    """A person whose legs are those of the model, and who wears its markers (or others, that it does not have)."""
    parameters, posture = published_subject(), dict[str, float]()
    legs = {leg.ours: leg.theirs for leg in leg_joints(peer)}
    bodies = {"pelvis": legs["hip_r"].parent}
    for side in SIDES:
        bodies |= {f"thigh_{side}": legs[f"hip_{side}"].child, f"shank_{side}": legs[f"knee_{side}"].child}
        bodies[f"foot_{side}"] = legs[f"subtalar_{side}"].child
        values, angles, standing = _leg(peer, side, bodies, parameters)
        zero = parameters.zero_angles.copy()
        for name, value in angles.items():
            zero[ZERO_ANGLES.index(name)] = value
        parameters = Parameters(
            parameters.with_joint(tuple(values), np.array(list(values.values()))).joint, parameters.inertial, zero
        )
        posture |= standing
    placed = list(_markers(peer, bodies) if markers else _free_points(bodies))
    labels, segments, local = zip(*placed, strict=True)
    placement = MarkerPlacement(labels, segments, np.array(local), np.ones(len(labels)))
    who = Subject("truth", 70.0, 1.75, "male")
    return SubjectModel(subject=who, parameters=parameters, nominal=parameters, markers=placement, posture=posture)


def _hinge(leg: LegJoint) -> Hinge:
    if leg.hinge is None:
        raise InputError(f"{leg.theirs.name} is no hinge; allowed: a hinge as {leg.ours}")
    return leg.hinge


def _leg(
    peer: PeerModel, side: str, bodies: dict[str, str], base: Parameters
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Joint parameters, zero angles and standing coordinates of one leg."""
    s = 1.0 if side == "r" else -1.0
    legs = {leg.ours.partition("_")[0]: leg for leg in leg_joints(peer) if leg.ours.endswith(f"_{side}")}
    thigh, shank, foot = (bodies[f"{name}_{side}"] for name in ("thigh", "shank", "foot"))
    jp: dict[str, float] = {}
    zero: dict[str, float] = {}

    def axis(joint: str, body: str) -> Axis:
        line = _hinge(legs[joint]).in_parent
        found = Axis(line.translation, line.rotation[:, 2])
        return found.moved(peer.body_pose(legs[joint].theirs.parent, body)).pointing(0 if joint == "subtalar" else 2)

    def frames(joint: str) -> tuple[pin.SE3, pin.SE3]:
        angles = base.zero_angles.copy()
        for name, value in zero.items():
            angles[ZERO_ANGLES.index(name)] = value
        used = Parameters(base.with_joint(tuple(jp), np.array(list(jp.values()))).joint, base.inertial, angles)
        found = frames_of(JOINT[f"{joint}_{side}"], used)
        return found.in_parent, found.in_child

    def point(place: str, position: Array) -> None:
        jp.update({f"{place}.{d}": float(x) for d, x in zip(("ant", "sup", "lat"), position, strict=True)})

    def turns(place: str, direction: Array) -> None:
        jp[f"{place}.front"] = float(np.arctan2(-direction[1], direction[2]))
        jp[f"{place}.trans"] = float(np.arcsin(direction[0]))

    hip, knee = legs["hip"].theirs, legs["knee"].theirs
    pose = peer.joint_pose(hip, {})
    point(f"hip_{side}.pelvis", (pose * hip.in_child).translation)
    point(f"hip_{side}.thigh", hip.in_child.translation)
    r = pose.rotation  # Rz(flexion) Rx(s adduction) Ry(s rotation)
    standing = {
        f"hip_flexion_{side}": float(np.arctan2(-r[0, 1], r[1, 1])),
        f"hip_adduction_{side}": s * float(np.arcsin(r[2, 1])),
        f"hip_rotation_{side}": s * float(np.arctan2(-r[2, 0], r[2, 2])),
    }

    # one point of the knee's axis in both segments: where it crosses the thigh's sagittal plane
    line, hinge = axis("knee", thigh), _hinge(legs["knee"])
    pose = peer.body_pose(knee.parent, thigh) * hinge.pose(hinge.angle(peer.joint_pose(knee, {})))  # it does not roll
    crossing = line.crossing(2)
    jp[f"knee_{side}.thigh.ant"], jp[f"knee_{side}.thigh.sup"] = map(float, crossing[:2])
    point(f"knee_{side}.shank", pose.actInv(crossing))
    turns(f"knee_{side}.thigh", line.direction)
    turns(f"knee_{side}.shank", line.moved(pose.inverse()).direction)
    in_parent, in_child = frames("knee")
    rest = in_parent.actInv(pose) * in_child
    standing[f"knee_angle_{side}"] = float(np.arctan2(-rest.rotation[1, 0], rest.rotation[0, 0]))

    # the talus lies on the ankle's axis where the common perpendicular with the subtalar axis meets it, y along that
    first, second = axis("talocrural", shank), axis("subtalar", shank)
    normal = np.cross(first.direction, second.direction)
    normal *= np.sign(normal[1]) / np.linalg.norm(normal)
    gap = float(normal @ (second.point - first.point))
    along = np.stack([first.direction, -second.direction], axis=1)
    steps = np.linalg.lstsq(along, second.point - first.point - gap * normal, rcond=None)[0]
    point(f"talocrural_{side}.shank", first.point + steps[0] * first.direction)
    turns(f"talocrural_{side}.shank", first.direction)
    zero[f"talocrural_{side}.zero"] = 0.0
    in_parent, _ = frames("talocrural")
    y = in_parent.rotation.T @ normal
    zero[f"talocrural_{side}.zero"] = float(np.arctan2(-y[0], y[1]))
    talus = in_parent * pin.SE3(axis_rotation(2, zero[f"talocrural_{side}.zero"]), np.zeros(3))
    x = talus.rotation.T @ second.direction
    jp[f"subtalar_{side}.talus.sup"], jp[f"subtalar_{side}.talus.trans"] = gap, float(np.arctan2(-x[2], x[0]))

    calcn = peer.body_pose(foot, shank)
    x = calcn.rotation.T @ second.direction
    jp[f"subtalar_{side}.foot.trans"], jp[f"subtalar_{side}.foot.sag"] = (
        float(np.arctan2(-x[2], x[0])),
        float(np.arcsin(x[1])),
    )
    zero[f"subtalar_{side}.zero"] = 0.0
    in_parent, in_child = frames("subtalar")
    point(f"subtalar_{side}.foot", calcn.actInv((talus * in_parent).translation))
    rest = (talus * in_parent).actInv(calcn) * in_child
    zero[f"subtalar_{side}.zero"] = float(np.arctan2(rest.rotation[2, 1], rest.rotation[1, 1]))
    return jp, zero, standing


def _markers(peer: PeerModel, bodies: dict[str, str]) -> Iterator[tuple[str, str, Array]]:
    """Those that the model has on these bodies, or on what hangs on them."""
    for label, (carrier, position) in peer.markers.items():
        for segment, body in reversed(bodies.items()):
            if peer.is_below(carrier, body):
                yield label, segment, peer.body_pose(carrier, body).act(position)
                break


def _free_points(bodies: dict[str, str]) -> Iterator[tuple[str, str, Array]]:
    rng = np.random.default_rng(0)
    for segment in bodies:
        for k in range(FREE_POINTS):
            yield f"{segment} {k}", segment, 0.1 * rng.normal(size=3)
