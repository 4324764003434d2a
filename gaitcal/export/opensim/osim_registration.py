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
MISFIT = 0.05
"""m RMS, largest distance of markers: those of a generic model, unscaled, agree with another person
to 20 to 30 mm.
"""
MISFIT_OF_AXES = 0.02
"""m RMS, largest distance of joint axes where fewer than three markers are common: `FAR_M` of
`joint_transfer.py`, the error of regressions for the same person. A larger distance shows the size
of another person (from an adult to two children: 28 and 32 mm).
"""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Pose of a body of the model in our segment, and its uncertainty."""

    segment: str
    body: str
    markers: int
    """Our markers on the segment."""
    common: int
    """Markers that both models have."""
    by_axes: bool
    """Registered by the axes of joints, because fewer than three markers are common."""
    pose: pin.SE3
    """Pose of the body in our segment, m."""
    rms: float
    """m, of the remaining distances."""
    centre: Array
    """(3,) m, mean of the common points in our segment."""
    rotation_covariance: Array
    """(3, 3) rad^2, axes of our segment."""
    translation_variance: float
    """m^2, of `centre` in each direction."""

    def compute_point_covariance(self, point: Array) -> Array:
        """Compute the covariance of a point as a position in the body.

        Parameters
        ----------
        point : (3,) Array
            m, in our segment.

        Returns
        -------
        (3, 3) Array
            m^2, axes of our segment.
        """
        arm = pin.skew(point - self.centre)
        out: Array = self.translation_variance * np.eye(3) + arm @ self.rotation_covariance @ arm.T
        return out

    def draw_pose(self, rng: np.random.Generator) -> pin.SE3:
        """Draw the pose of the body from its errors.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        pin.SE3
            In our segment, m.
        """
        rotation = rng.multivariate_normal(np.zeros(3), self.rotation_covariance, method="eigh")
        translation = rng.normal(size=3) * np.sqrt(self.translation_variance)
        # Rotation about the centre of the common points.
        to_centre = pin.SE3(np.eye(3), -self.centre)
        return pin.SE3(pin.exp3(rotation), self.centre + translation) * to_centre * self.pose


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
    for label, holder, local in zip(
        model.markers.labels, model.markers.segments, model.markers.local, strict=True
    ):
        same = match_label(label, labels) if holder == segment else None
        if same is None:
            continue
        marked, position = peer.markers[same]
        known = find_segment(marked)
        if is_sliding_body(marked) or not peer.is_below(marked, body):
            continue
        if FOLLOWED_SEGMENT.get(known or "", known) not in (segment, None):
            continue
        # The marker belongs to another registered body between this one and its own.
        if any(peer.is_below(marked, b) and peer.is_below(b, body) for b in others):
            continue
        theirs.append(peer.compute_body_pose(marked, body).act(position))
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
        to_body = _compute_rotation_into(body, segment, peer, bodies, was)
        a, b = (
            compute_joint_axis(leg.ours, p, segment == ours.parent).transform(to_body)
            for p in (was, drawn)
        )
        translation, rotation = b.point - a.point, np.eye(3)
        if hinge is not None:
            rotation = pin.Quaternion.FromTwoVectors(a.direction, b.direction).toRotationMatrix()
            translation = b.find_nearest(a.point) - a.point
        # The motion acts about the joint as the model has it.
        about = pin.SE3(np.eye(3), frame.translation)
        steps.append(about * pin.SE3(rotation, translation) * about.inverse())
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
    rotation, side = np.eye(3), segment[-1]
    foot = f"foot_{side}"
    # The talus is not registered: it is taken at zero coordinates relative to the foot.
    if segment not in bodies and foot in bodies:
        frames = osim_writer.get_joint_frames(JOINT_OF[f"subtalar_{side}"], parameters)
        segment, rotation = foot, (frames.in_child * frames.in_parent.inverse()).rotation
    if segment in bodies:
        main = bodies[segment]
        to_body = _compute_relative_pose(peer, main.body, body).rotation
        rotation = to_body @ main.pose.rotation.T @ rotation
    return pin.SE3(rotation, np.zeros(3))


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
                f"has {len(theirs)} markers in common with {segment}, and the axes of the joints "
                f"found ({known}) do not determine its position: name the model's markers as the "
                "recordings do, or name the other joints by --names FILE.toml"
            )
            raise InputError(
                message, source=peer.source, field=f"body {body}", code=Code.OTHER_MODEL
            )
        _require_fit(peer, found)
        out[segment] = found
    return out


def _require_fit(peer: PeerModel, found: Registration) -> None:
    """Raise InputError where a body has the size of another person."""
    allowed = MISFIT_OF_AXES if found.by_axes else MISFIT
    if found.rms <= allowed:
        return
    what = "the axes of its joints are" if found.by_axes else "its markers are"
    remedy = ": scale the model to this person first, with these markers"
    if found.by_axes:
        remedy = f"; {found.common or 'no'} markers are common: {NAME_OR_SCALE}"
    message = (
        f"{what} {1e3 * found.rms:.0f} mm (RMS) from this person's on {found.segment}; allowed: "
        f"up to {1e3 * allowed:.0f} mm{remedy}"
    )
    raise InputError(message, source=peer.source, field=f"body {found.body}", code=Code.OTHER_MODEL)


NAME_OR_SCALE = "name the model's markers as the recordings do, or scale it to this person first"
_ARM = 0.05
"""m, on both sides of a joint's centre: distance of points that represent its axis."""


def _list_axis_points(
    model: SubjectModel, peer: PeerModel, legs: Sequence[LegJoint], segment: str, body: str
) -> tuple[Array, Array]:
    """List points (n, 3) m on the axes of joints in a body and in our segment, nominal joints.

    The joints of pelvis and foot leave a rotation open: points along the axes of their frames,
    taken as parallel, are added.
    """
    theirs: list[Array] = []
    ours: list[Array] = []
    side = segment[-1]
    has_subtalar = any(leg.ours == f"subtalar_{side}" for leg in legs)
    for leg in legs:
        our_joint = JOINT_OF[leg.ours]
        if segment not in (our_joint.parent, our_joint.child):
            # A foot without a subtalar joint takes the talocrural axis, of the talus.
            is_ankle = segment.startswith("foot") and leg.ours == f"talocrural_{side}"
            if not is_ankle or has_subtalar:
                continue
        in_parent = segment == our_joint.parent
        our_axis = compute_joint_axis(leg.ours, model.nominal, in_parent)
        holder, frame = leg.theirs.child, leg.theirs.in_child
        hinge = None if leg.hinge is None else leg.hinge.in_child
        if in_parent:
            holder = leg.theirs.parent
            frame = peer.compute_joint_pose(leg.theirs, {}) * leg.theirs.in_child
            hinge = None if leg.hinge is None else leg.hinge.in_parent
        to_body = pin.SE3.Identity()
        if peer.is_below(holder, body):
            to_body = peer.compute_body_pose(holder, body)
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
        their_mean, our_mean = np.mean(theirs, axis=0), np.mean(ours, axis=0)
        for direction in np.eye(3)[:2]:
            theirs.append(their_mean + _ARM * direction)
            ours.append(our_mean + _ARM * direction)
    return np.array(theirs).reshape(-1, 3), np.array(ours).reshape(-1, 3)


_HOLD = 1e-6
"""m per rad: weight of the prior for coordinates of the standing posture without markers."""


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
    markers = [k for k, s in enumerate(model.markers.segments) if s in LOWER_BODY]
    segments = [chain.segments.index(model.markers.segments[k]) for k in markers]
    local = model.markers.local[markers]

    def compute_poses(body: LinkageModel, q: Array) -> tuple[Array, Array]:
        """Compute axes and origins of the segments at q."""
        kinematics = Kinematics(body, q[None], columns=False)
        return kinematics.axes[..., 0], kinematics.origins[..., 0]

    def locate_markers(body: LinkageModel, q: Array) -> Array:
        """Compute the positions (n, 3) m of the markers at q."""
        axes, origins = compute_poses(body, q)
        out: Array = np.einsum("mji,mj->mi", axes[segments], local) + origins[segments]
        return out

    nominal, calibrated = (chain.body(p) for p in (model.nominal, parameters))
    measured = locate_markers(nominal, start)

    def compute_residual(q: Array) -> Array:
        """Compute distances of the markers, and from the start for what they do not determine."""
        distances = locate_markers(calibrated, q) - measured
        return np.concatenate([distances.ravel(), _HOLD * (q - start)])

    fit = least_squares(compute_residual, start, method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    axes, origins = compute_poses(calibrated, fit.x)
    return {s: pin.SE3(axes[k].T, origins[k]) for k, s in enumerate(chain.segments)}


# ------------------------------------------------------------------------------------------ masses


@dataclass(frozen=True, kw_only=True)
class SegmentMass:
    """Mass of a segment in both models."""

    segment: str
    bodies: tuple[str, ...]
    theirs: float  # kg, of these bodies together, before
    ours: float  # kg


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
        registered = next((s for s, r in bodies.items() if r.body == body), None)
        group = registered or find_segment(body)
        if group is not None:
            groups.setdefault(group, []).append(body)
    ours = {s: osim_writer.get_segment_inertia(parameters, s) for s in MASSIVE_SEGMENTS}
    mass = {s: inertia.mass for s, inertia in ours.items()}
    if not any(arm in groups for arm in ARMS):
        mass["head_trunk"] += sum(mass[arm] for arm in ARMS)
    weights: dict[str, osim_reader.BodyMass] = {}
    masses = []
    for segment, members in groups.items():
        theirs = sum(peer.masses[body] for body in members)
        if segment not in mass or theirs <= 0.0:
            continue
        factor = mass[segment] / theirs
        moved = dict[str, Array]()
        if segment in bodies:
            main = bodies[segment]
            centres = {body: document.read_mass_centre(body) for body in members}
            poses = {body: _compute_relative_pose(peer, body, main.body) for body in members}
            centre = sum(peer.masses[b] * poses[b].act(centres[b]) for b in members) / theirs
            # All mass centres are displaced as that of the segment.
            displacement = main.pose.actInv(ours[segment].centre) - centre
            moved = {b: centres[b] + poses[b].rotation.T @ displacement for b in members}
        for body in members:
            weights[body] = osim_reader.BodyMass(
                factor * peer.masses[body], moved.get(body), factor
            )
        masses.append(
            SegmentMass(segment=segment, bodies=tuple(members), theirs=theirs, ours=mass[segment])
        )
    return weights, tuple(masses)


def _compute_relative_pose(peer: PeerModel, body: str, main: str) -> pin.SE3:
    """Compute the pose of a body in another one of its segment, above or below it.

    `body`, `main`: body, and the one in whose frame the pose is given. Returns: m, at zero
    coordinates.
    """
    if peer.is_below(body, main):
        return peer.compute_body_pose(body, main)
    return peer.compute_body_pose(main, body).inverse()
