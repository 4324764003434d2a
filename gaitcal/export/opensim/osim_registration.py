"""Registration of an OpenSim model's bodies on our segments; its standing posture and its masses.

A body is registered on our segment by the rigid motion that fits their common markers (Kabsch).
With residuals e of n markers at x_k about their mean c and s^2 = |e|^2 / (3 n - 6), a point p of
the body has the covariance

    s^2 ( I / n + [p - c] J^-1 [p - c]^T ),    J = sum |x_k|^2 I - x_k x_k^T,

and its rotation s^2 J^-1. With fewer than three common markers, points on the axes of joints
replace markers, as both models have them; differences of these are then in the residual as well.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim import osim_reader, osim_writer
from gaitcal.export.opensim.osim_correspondence import (
    ARMS,
    Hinge,
    LegJoint,
    find_segment,
    is_sliding_body,
    match_label,
)
from gaitcal.export.opensim.peer_model import Axis, PeerModel
from gaitcal.model.chain import LinkageModel, get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import FOLLOWED_SEGMENT, JOINTS, LOWER_BODY
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters
from gaitcal.model.subject_model import MarkerPlacement, SubjectModel
from gaitcal.tracking.rigid import FEWEST_MARKERS, compute_rigid_distances, fit_rigid

JOINT_OF = {joint.name: joint for joint in JOINTS}
MISFIT = 0.05  # m RMS; markers of a generic model, unscaled, on another person agree to 20 to 30 mm
MISFIT_OF_AXES = 0.02
"""m RMS, of joints' axes where no three markers are shared: `FAR_M` of `joint_transfer.py`, as far
as regressions ever miss a joint of the same person; a larger gap is another person's size. (To two
children's an adult's had 28 and 32.)"""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Pose of a body of the model in our segment, and its uncertainty."""

    segment: str
    body: str
    markers: int  # Our markers on the segment
    common: int
    # Laid on the segment by the axes of its joints, as no three shared markers tell its place
    by_axes: bool
    pose: pin.SE3  # Of the body in our segment
    rms: float  # m, of the distances that remain
    centre: Array  # (3,) m, mean of the shared points in our segment
    rotation_covariance: Array  # (3, 3) rad^2, axes of our segment
    translation_variance: float  # m^2, of `centre` in each direction

    def compute_point_covariance(self, point: Array) -> Array:
        """Compute the covariance (3, 3) m^2 of a point (3,) m of our segment in the body."""
        arm = pin.skew(point - self.centre)
        out: Array = self.translation_variance * np.eye(3) + arm @ self.rotation_covariance @ arm.T
        return out

    def draw_pose(self, rng: np.random.Generator) -> pin.SE3:
        """Draw the pose of the body in our segment from its errors."""
        turn = rng.multivariate_normal(np.zeros(3), self.rotation_covariance, method="eigh")
        shift = rng.normal(size=3) * np.sqrt(self.translation_variance)
        about = pin.SE3(pin.exp3(turn), self.centre + shift) * pin.SE3(np.eye(3), -self.centre)
        return about * self.pose


def add_landmarks(model: SubjectModel, marker_set: MarkerSet) -> SubjectModel:
    """Add the markers of the static trial, at the ends of bones, to those of the model.

    Parameters
    ----------
    model : SubjectModel
        Model of the person.
    marker_set : MarkerSet
        Landmarks of one label each are used.

    Returns
    -------
    SubjectModel
        Added markers have the weight 0.
    """
    m = model.markers
    at = {
        labels[0]: model.landmarks.get(name)
        for name, labels in marker_set.landmarks.items()
        if len(labels) == 1
    }
    further = {
        label: place for label, place in at.items() if place is not None and label not in m.labels
    }
    if not further:
        return model
    segments, places = zip(*further.values(), strict=True)
    markers = MarkerPlacement(
        labels=(*m.labels, *further),
        segments=(*m.segments, *segments),
        local=np.vstack([m.local, *places]),
        weight=np.concatenate([m.weight, np.zeros(len(further))]),
    )
    return replace(model, markers=markers)


def find_shared_markers(
    model: SubjectModel, peer: PeerModel, segment: str, body: str, moved: Iterable[str] = ()
) -> tuple[Array, Array]:
    """Find the markers that both models have on a segment.

    Parameters
    ----------
    model : SubjectModel
        Our model.
    peer : PeerModel
        OpenSim model.
    segment, body : str
        Our segment and its body.
    moved : iterable of str
        Bodies below which a marker belongs to another segment.

    Returns
    -------
    theirs : (n, 3) Array
        m, in the body.
    ours : (n, 3) Array
        m, in our segment.
    """
    theirs, ours = [], []
    labels, others = tuple(peer.markers), [b for b in moved if b != body]
    for label, of, local in zip(
        model.markers.labels, model.markers.segments, model.markers.local, strict=True
    ):
        same = match_label(label, labels) if of == segment else None
        if same is None:
            continue
        carrier, position = peer.markers[same]
        on = find_segment(carrier)
        if (
            is_sliding_body(carrier)
            or FOLLOWED_SEGMENT.get(on or "", on) not in (segment, None)
            or not peer.is_below(carrier, body)
        ):
            continue
        if any(peer.is_below(carrier, b) and peer.is_below(b, body) for b in others):
            continue
        theirs.append(peer.compute_body_pose(carrier, body).act(position))
        ours.append(local)
    return np.array(theirs).reshape(-1, 3), np.array(ours).reshape(-1, 3)


def register_body(
    segment: str, body: str, markers: int, theirs: Array, ours: Array, common: int | None = None
) -> Registration | None:
    """Register a body on a segment by common points.

    Parameters
    ----------
    segment, body : str
        Our segment and its body.
    markers : int
        Number of our markers on the segment.
    theirs, ours : (n, 3) Array
        m, common points in the body and in our segment.
    common : int, optional
        Number of common markers, where the points are on the axes of joints instead.

    Returns
    -------
    Registration or None
        None where the points do not determine the rotation.
    """
    n = len(theirs)
    if n < FEWEST_MARKERS:
        return None
    shared = theirs, ours[:, :, None], np.ones((n, 1))  # one "frame"
    fit = fit_rigid(*shared)
    if not fit.determined[0]:
        return None
    distances = compute_rigid_distances(*shared)
    centre = ours.mean(axis=0)
    x = ours - centre
    variance = float((distances**2).sum()) / (3 * n - 6)
    return Registration(
        segment=segment,
        body=body,
        markers=markers,
        common=n if common is None else common,
        by_axes=common is not None,
        pose=pin.SE3(fit.rotation[0], fit.origin[0]),
        rms=float(np.sqrt(np.mean(distances**2))),
        centre=centre,
        rotation_covariance=variance * np.linalg.inv(float((x**2).sum()) * np.eye(3) - x.T @ x),
        translation_variance=variance / n,
    )


def compute_joint_axis(joint: str, parameters: Parameters, in_parent: bool) -> Axis:
    """Compute the axis of one of our joints; of a hip its centre and first axis.

    Parameters
    ----------
    joint : str
        Our joint (`knee_r`).
    parameters : Parameters
        Joint parameters.
    in_parent : bool
        Express it in the parent segment instead of the child.

    Returns
    -------
    Axis
        m, in the frame of that segment.
    """
    frames = osim_writer.get_joint_frames(JOINT_OF[joint], parameters)
    place = frames.in_parent if in_parent else frames.in_child
    return Axis(place.translation, place.rotation[:, frames.motions[0].axis])


def perturb_joint(
    leg: LegJoint,
    peer: PeerModel,
    bodies: Mapping[str, Registration],
    was: Parameters,
    drawn: Parameters,
) -> LegJoint:
    """Move a joint of the model as our axis moves from one set of parameters to another.

    Parameters
    ----------
    leg : LegJoint
        Joint of the model.
    peer : PeerModel
        OpenSim model.
    bodies : mapping
        Our segment -> registration.
    was, drawn : Parameters
        Joint parameters before and after.

    Returns
    -------
    LegJoint
        With moved frames in both bodies, and a moved hinge.
    """
    ours, joint, hinge = JOINT_OF[leg.ours], leg.theirs, leg.hinge
    steps = []
    for segment, body, frame in (
        (ours.parent, joint.parent, joint.in_parent),
        (ours.child, joint.child, joint.in_child),
    ):
        turned = _compute_rotation_into(body, segment, peer, bodies, was)
        a, b = (
            compute_joint_axis(leg.ours, p, segment == ours.parent).transform(turned)
            for p in (was, drawn)
        )
        shift, turn = b.point - a.point, np.eye(3)
        if hinge is not None:
            turn = pin.Quaternion.FromTwoVectors(a.direction, b.direction).toRotationMatrix()
            shift = b.find_nearest(a.point) - a.point
        about = pin.SE3(np.eye(3), frame.translation)
        steps.append(about * pin.SE3(turn, shift) * about.inverse())
    if hinge is not None:
        hinge = Hinge(steps[0] * hinge.in_parent, steps[1] * hinge.in_child)
    theirs = replace(
        joint, in_parent=steps[0] * joint.in_parent, in_child=steps[1] * joint.in_child
    )
    return replace(leg, theirs=theirs, hinge=hinge)


def _compute_rotation_into(
    body: str,
    segment: str,
    peer: PeerModel,
    bodies: Mapping[str, Registration],
    parameters: Parameters,
) -> pin.SE3:
    """Compute the rotation from our segment's axes to a body's; talus at zero coordinates."""
    turn, side = np.eye(3), segment[-1]
    if segment not in bodies and (foot := f"foot_{side}") in bodies:
        frames = osim_writer.get_joint_frames(JOINT_OF[f"subtalar_{side}"], parameters)
        segment, turn = foot, (frames.in_child * frames.in_parent.inverse()).rotation
    if segment in bodies:
        main = bodies[segment]
        turn = compute_relative_pose(peer, main.body, body).rotation @ main.pose.rotation.T @ turn
    return pin.SE3(turn, np.zeros(3))


def register_bodies(
    model: SubjectModel, peer: PeerModel, legs: Sequence[LegJoint]
) -> dict[str, Registration]:
    """Register pelvis, thighs, shanks and feet, as far as the model has them.

    Parameters
    ----------
    model : SubjectModel
        Our model.
    peer : PeerModel
        OpenSim model.
    legs : sequence of LegJoint
        Its leg joints.

    Returns
    -------
    dict
        Our segment -> registration.

    Raises
    ------
    InputError
        A body cannot be registered, or has the size of another person: `MISFIT`, or
        `MISFIT_OF_AXES` with fewer than three common markers.
    """
    bodies: dict[str, str] = {}
    for leg in legs:
        kind, side = leg.ours[:-2], leg.ours[-1]
        if kind == "hip":
            bodies.setdefault("pelvis", leg.theirs.parent)
        child = {"hip": "thigh", "knee": "shank", "talocrural": "foot", "subtalar": "foot"}[kind]
        bodies[f"{child}_{side}"] = leg.theirs.child
    out = {}
    for segment, body in bodies.items():
        count = model.markers.segments.count(segment)
        theirs, ours = find_shared_markers(model, peer, segment, body, bodies.values())
        found = register_body(segment, body, count, theirs, ours)
        if found is None:
            points = _list_axis_points(model, peer, legs, segment, body)
            found = register_body(segment, body, count, *points, common=len(theirs))
        if found is None:
            known = ", ".join(leg.theirs.name for leg in legs)
            message = (
                f"shares {len(theirs)} markers with {segment}, and the axes of the joints found "
                f"({known}) do not tell "
                "its place: name the model's markers as the recordings do, or tell the others by "
                "--names FILE.toml"
            )
            raise InputError(
                message, source=peer.source, field=f"body {body}", code=Code.OTHER_MODEL
            )
        allowed = MISFIT_OF_AXES if found.by_axes else MISFIT
        if found.rms > allowed:
            what, then = (
                "its markers lie",
                ": scale the model to this person first, with these markers",
            )
            if found.by_axes:
                what, then = (
                    "the axes of its joints are",
                    f"; it shares {found.common or 'no'} markers with it: {NAME_OR_SCALE}",
                )
            message = (
                f"{what} {1e3 * found.rms:.0f} mm (RMS) from this person's on {segment}; allowed: "
                "up to "
                f"{1e3 * allowed:.0f} mm{then}"
            )
            raise InputError(
                message, source=peer.source, field=f"body {body}", code=Code.OTHER_MODEL
            )
        out[segment] = found
    return out


NAME_OR_SCALE = "name the model's markers as the recordings do, or scale it to this person first"
_ARM = 0.05  # m, on either side of a joint's centre: points that stand for its axis


def _list_axis_points(
    model: SubjectModel, peer: PeerModel, legs: Sequence[LegJoint], segment: str, body: str
) -> tuple[Array, Array]:
    """List points (n, 3) m on the axes of joints in a body and in our segment, nominal joints.

    The joints of pelvis and foot leave a rotation open: points along the axes of their frames,
    taken as parallel, are added.
    """
    theirs: list[Array] = []
    ours: list[Array] = []
    for leg in legs:
        ends = JOINT_OF[leg.ours]
        of_ours = {ends.parent: True, ends.child: False}
        if segment not in of_ours and not (
            segment.startswith("foot") and leg.ours == f"talocrural_{segment[-1]}"
        ):
            continue
        if segment not in of_ours and any(
            other.ours == f"subtalar_{segment[-1]}" for other in legs
        ):
            continue
        our_axis = compute_joint_axis(leg.ours, model.nominal, of_ours.get(segment, False))
        in_parent = of_ours.get(segment, False)
        carrier = leg.theirs.parent if in_parent else leg.theirs.child
        frame = (
            (peer.compute_joint_pose(leg.theirs, {}) * leg.theirs.in_child)
            if in_parent
            else leg.theirs.in_child
        )
        hinge = (
            None if leg.hinge is None else leg.hinge.in_parent if in_parent else leg.hinge.in_child
        )
        to_body = (
            peer.compute_body_pose(carrier, body)
            if peer.is_below(carrier, body)
            else pin.SE3.Identity()
        )
        if hinge is None:
            theirs.append(to_body.act(frame.translation))
            ours.append(our_axis.point)
            continue
        axis = Axis(to_body.act(hinge.translation), to_body.rotation @ hinge.rotation[:, 2])
        axis = Axis(axis.find_nearest(to_body.act(frame.translation)), axis.direction)
        direction = our_axis.direction * (1.0 if our_axis.direction @ axis.direction >= 0 else -1.0)
        for reach in (-_ARM, _ARM):
            theirs.append(axis.point + reach * axis.direction)
            ours.append(our_axis.point + reach * direction)
    if theirs and segment.startswith(("pelvis", "foot")):
        a, b = np.mean(theirs, axis=0), np.mean(ours, axis=0)
        for direction in np.eye(3)[:2]:
            theirs += [a + _ARM * direction]
            ours += [b + _ARM * direction]
    return np.array(theirs).reshape(-1, 3), np.array(ours).reshape(-1, 3)


_HOLD = 1e-6  # m per rad: what holds a coordinate of the standing posture that no marker shows


def fit_standing_segments(model: SubjectModel, parameters: Parameters) -> dict[str, pin.SE3]:
    """Fit the linkage to the markers of the static posture.

    The markers are where the nominal model has them in that posture.

    Parameters
    ----------
    model : SubjectModel
        Our model, with its posture.
    parameters : Parameters
        Joint parameters of the linkage to fit.

    Returns
    -------
    dict
        Segment of pelvis and legs -> pose in the laboratory.
    """
    chain = get_chain("pelvis", LOWER_BODY)
    start = np.array([model.posture.get(name, 0.0) for name in chain.coordinates])
    at = [k for k, s in enumerate(model.markers.segments) if s in LOWER_BODY]
    of = [chain.segments.index(model.markers.segments[k]) for k in at]
    local = model.markers.local[at]

    def poses(body: LinkageModel, q: Array) -> tuple[Array, Array]:
        """Compute rotations and origins of the segments at q."""
        placed = Kinematics(body, q[None], columns=False)
        return placed.axes[..., 0], placed.origins[..., 0]

    def places(body: LinkageModel, q: Array) -> Array:
        """Compute the positions (n, 3) m of the markers at q."""
        axes, origins = poses(body, q)
        out: Array = np.einsum("mji,mj->mi", axes[of], local) + origins[of]
        return out

    nominal, now = (chain.body(p) for p in (model.nominal, parameters))
    measured = places(nominal, start)

    def residual(q: Array) -> Array:
        return np.concatenate([(places(now, q) - measured).ravel(), _HOLD * (q - start)])

    q = least_squares(residual, start, method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12).x
    axes, origins = poses(now, q)
    return {s: pin.SE3(axes[k].T, origins[k]) for k, s in enumerate(chain.segments)}


# -------------------------------------------------------------------------------------------------------------- masses


@dataclass(frozen=True, kw_only=True)
class SegmentMass:
    """Mass of a segment in both models."""

    segment: str
    bodies: tuple[str, ...]
    theirs: float  # kg, of these bodies together, as they were
    ours: float


def compute_body_masses(
    parameters: Parameters,
    document: osim_reader.OsimDocument,
    peer: PeerModel,
    bodies: Mapping[str, Registration],
) -> tuple[dict[str, osim_reader.BodyMass], tuple[SegmentMass, ...]]:
    """Compute the masses of the model's bodies from those of our segments.

    The bodies of a segment keep their shares of its mass; their moments of inertia scale with it.
    The mass centres of the bodies of a registered segment (pelvis, thighs, shanks, feet) are
    displaced together so that that of the segment is ours, at zero coordinates. The trunk gets the
    mass of the arms where the model has none. Bodies of no segment of ours keep theirs.

    Parameters
    ----------
    parameters : Parameters
        Our inertial parameters.
    document : OsimDocument
        Model file, for mass centres.
    peer : PeerModel
        OpenSim model.
    bodies : mapping
        Our segment -> registration.

    Returns
    -------
    dict
        Body -> new mass.
    tuple of SegmentMass
    """
    groups: dict[str, list[str]] = {}
    for body in peer.masses:
        on = next((s for s, r in bodies.items() if r.body == body), None) or find_segment(body)
        if on is not None:
            groups.setdefault(on, []).append(body)
    ours = {s: osim_writer.get_segment_inertia(parameters, s) for s in MASSIVE_SEGMENTS}
    mass = {s: inertia.mass for s, inertia in ours.items()}
    if not any(arm in groups for arm in ARMS):
        mass["head_trunk"] += sum(mass[arm] for arm in ARMS)
    weights: dict[str, osim_reader.BodyMass] = {}
    masses = []
    for segment, group in groups.items():
        theirs = sum(peer.masses[body] for body in group)
        if segment not in mass or theirs <= 0.0:
            continue
        share = mass[segment] / theirs
        moved = dict[str, Array]()
        if segment in bodies:
            main = bodies[segment]
            centres = {body: document.read_mass_centre(body) for body in group}
            poses = {body: compute_relative_pose(peer, body, main.body) for body in group}
            was = sum(peer.masses[b] * poses[b].act(centres[b]) for b in group) / theirs
            shift = main.pose.actInv(ours[segment].centre) - was
            moved = {b: centres[b] + poses[b].rotation.T @ shift for b in group}
        weights |= {
            b: osim_reader.BodyMass(share * peer.masses[b], moved.get(b), share) for b in group
        }
        masses.append(
            SegmentMass(segment=segment, bodies=tuple(group), theirs=theirs, ours=mass[segment])
        )
    return weights, tuple(masses)


def compute_relative_pose(peer: PeerModel, body: str, main: str) -> pin.SE3:
    """Compute the pose of a body in another one of its segment, above or below it.

    Parameters
    ----------
    peer : PeerModel
        OpenSim model.
    body, main : str
        Body, and the one in whose frame the pose is given.

    Returns
    -------
    pin.SE3
        m, at zero coordinates.
    """
    return (
        peer.compute_body_pose(body, main)
        if peer.is_below(body, main)
        else peer.compute_body_pose(main, body).inverse()
    )
