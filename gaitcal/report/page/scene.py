"""What the page shows in space: a calibrated person in all trials, and no numerics.

A scene stands on its own: it is made from a calibration once, kept as `scene.npz` in the folder of
the result, and shown from that file alone.

A joint lies in the two segments that it connects. Its frames (`export/opensim/osim_writer.py`) hold
its constants, those before the first coordinate in the parent and those after the last in the
child:

    centre = translation of X            axis = sign * R[:, axis of the coordinate next to that segment]

Standard errors s_p of the joint parameters p spread into centre and axis through the Jacobian, cov
= sum_p s_p^2 (d./dp)(d./dp)^T, parameters taken as uncorrelated (the table of errors tells no
more); its matrix square root is kept, whose columns are the half axes of the one-sigma ellipsoid.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.export.opensim.osim_writer import frames_of
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import Recording
from gaitcal.model.chain import chain_of
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINTS, SEGMENTS, Joint, segment_kind
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page import body_meshes, bone_landmarks
from gaitcal.tracking.motion import Motion

if TYPE_CHECKING:
    from gaitcal.analysis.result import Calibration

Single = NDArray[np.float32]
MOST_FRAMES = 4000
"""Frames kept of one trial; of a longer one every second, third, ... frame. Poses between them are
interpolated.
"""
_STEP = (
    1e-6  # m, rad: step of the central differences; their error, about 1e-12, is far below a pixel
)


@dataclass(frozen=True, kw_only=True)
class JointMark:
    """One joint as it lies in one of its two segments."""

    joint: str
    segment: str
    nominal_centre: Array  # (3,) m, segment frame
    fitted_centre: Array  # (3,) m, segment frame
    nominal_axis: (
        Array  # (3,) unit vector, segment frame; NaN where the joint is a ball and has no axis
    )
    fitted_axis: Array  # (3,)
    # (3, 3) m: half axes of the one-sigma ellipsoid as columns; NaN where no error is known
    centre_spread: Array
    axis_spread: Array  # (3, 3) of the unit vector: the same for the tip of the axis
    fitted: bool  # Whether any of its parameters in this segment was fitted


def joint_marks(
    nominal: Parameters, fitted: Parameters, errors: Mapping[str, float]
) -> tuple[JointMark, ...]:
    """All joints in both their segments.

    `errors`: joint parameter -> standard error (m, rad) of every fitted one.
    """
    marks = []
    for joint in JOINTS:
        for segment in (joint.parent, joint.child):
            names = [
                p.name for p in JOINT_PARAMETERS if (p.joint, p.segment) == (joint.name, segment)
            ]
            if not names:
                continue
            known = {name: errors[name] for name in names if np.isfinite(errors.get(name, np.nan))}
            columns = [JP_INDEX[name] for name in names]
            places = {}
            for stage, parameters in (("nominal", nominal), ("fitted", fitted)):
                places[f"{stage}_centre"], places[f"{stage}_axis"] = _centre_and_axis(
                    joint, segment, parameters
                )
            places["centre_spread"], places["axis_spread"] = _spreads(joint, segment, fitted, known)
            moved = bool(known) or not np.array_equal(nominal.joint[columns], fitted.joint[columns])
            marks.append(JointMark(joint=joint.name, segment=segment, fitted=moved, **places))
    return tuple(marks)


def _centre_and_axis(joint: Joint, segment: str, parameters: Parameters) -> tuple[Array, Array]:
    """(3,) centre and (3,) axis in that segment: the axis of the coordinate next to it, NaN for a
    ball joint.
    """
    frames = frames_of(joint, parameters)
    in_parent = segment == joint.parent
    place = frames.in_parent if in_parent else frames.in_child
    axis = frames.motions[0 if in_parent else -1]
    centre = place.translation + 0.0  # no negative zeros, which would stand in the page
    return centre, np.full(3, np.nan) if len(frames.motions) > 2 else axis.sign * place.rotation[
        :, axis.axis
    ]


def _spreads(
    joint: Joint, segment: str, fitted: Parameters, errors: Mapping[str, float]
) -> tuple[Array, Array]:
    """(3, 3) of the centre and (3, 3) of the axis: half axes of their one-sigma ellipsoids; NaN
    without errors.
    """
    if not errors:
        return np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    columns = []
    for name, error in errors.items():
        value = fitted.joint[JP_INDEX[name]]
        low, high = (
            np.concatenate(
                _centre_and_axis(
                    joint, segment, fitted.with_joint((name,), np.array([value + step]))
                )
            )
            for step in (-_STEP, _STEP)
        )
        columns.append(error * (high - low) / (2 * _STEP))
    pulls = np.array(columns).T
    return _root(pulls[:3]), _root(pulls[3:])


def _root(pulls: Array) -> Array:
    """(3, 3) square root of pulls pulls^T: orthogonal columns whose lengths are the standard
    deviations.
    """
    if not np.isfinite(pulls).all():
        return np.full((3, 3), np.nan)
    values, vectors = np.linalg.eigh(pulls @ pulls.T)
    # an axis points either way: the largest entry of each column is positive
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    out: Array = vectors * np.where(largest < 0, -1.0, 1.0) * np.sqrt(np.maximum(values, 0.0))
    return out


@dataclass(frozen=True, kw_only=True)
class MotionScene:
    """One trial: poses of the fitted model, markers, and ground reactions."""

    name: str
    role: str
    recorded: int  # Frames of the recording
    stride: int  # Every how many of them is kept here
    time: Array  # (nf,) s
    origins: Single  # (nf, ns, 3) m, segment origins in the laboratory
    turns: Single  # (nf, ns, 4) unit quaternions x y z w from segment to laboratory
    # (ns,) whether any marker of this trial is fixed in the segment (talus: in its foot)
    tracked: BoolArray
    measured: Single  # (nf, nm, 3) m; NaN where a marker was not seen
    forces: Single  # (nf, 2, 3) N, ground on right and left foot; NaN where there is none
    pressure_centres: Single  # (nf, 2, 3) m; NaN where there is no force
    valid: BoolArray  # (nf,) every foot on the ground is on a plate; all False without force plates
    # (nf, 2) the same of the right and of the left foot alone; a foot in the air is valid
    valid_legs: BoolArray
    plates: Single  # (np, 4, 3) m, corners of the force plates whose place the recording tells

    @property
    def has_forces(self) -> bool:
        """Whether a foot is on a plate in any frame."""
        return bool(np.isfinite(self.forces).any())


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A calibrated person in all trials."""

    subject: str
    mass: float  # kg
    height: float  # m
    labels: tuple[str, ...]  # (nm) tracking markers
    marker_segments: tuple[str, ...]  # (nm) segment of each
    marker_places: Array  # (nm, 3) m, in the segment frame
    joints: tuple[JointMark, ...]
    body: tuple[body_meshes.FittedMesh, ...]
    trials: tuple[MotionScene, ...]
    landmarks: bone_landmarks.PersonLandmarks  # Where bones must lie
    segments: tuple[str, ...] = SEGMENTS


def scene_of(calibration: "Calibration") -> Scene:
    """The scene of a calibration: all its moving trials."""
    trials = tuple(
        trial_scene(
            calibration.model,
            t.name,
            t.role.value,
            t.body,
            t.recording,
            None if t.loads is None else t.loads.reactions,
        )
        for t in calibration.trials
    )
    return person_scene(calibration.model, trials, calibration.standard_errors)


def person_scene(
    model: SubjectModel, trials: tuple[MotionScene, ...], errors: Mapping[str, float]
) -> Scene:
    """A person's model with trials that are already made into scenes.

    `errors`: joint parameter -> standard error (m, rad) of every fitted one.
    """
    return Scene(
        subject=model.subject.name,
        mass=model.subject.mass,
        height=model.subject.height,
        labels=model.markers.labels,
        marker_segments=model.markers.segments,
        marker_places=model.markers.local,
        joints=joint_marks(model.nominal, model.parameters, errors),
        body=body_meshes.fitted_meshes(model),
        trials=trials,
        landmarks=bone_landmarks.person_landmarks(model),
    )


def trial_scene(
    model: SubjectModel,
    name: str,
    role: str,
    motion: Motion,
    recording: Recording,
    reactions: GroundReactions | None,
) -> MotionScene:
    """One trial of a person.

    `motion`: of the whole body, tracked with `model`, at the frames of the recording.
    `reactions`: None without force plates.
    """
    recorded = len(motion.time)
    stride = max(1, -(-recorded // MOST_FRAMES))
    kept = slice(None, None, stride)
    placed = Kinematics(chain_of().body(model.parameters), motion.q[kept], columns=False)
    axes, origins = placed.axes, placed.origins
    plates = plate_corners(recording)
    frames = len(motion.time[kept])
    if reactions is None:
        forces = centres = np.full((frames, 2, 3), np.nan, dtype=np.float32)
        valid, legs = np.zeros(frames, dtype=np.bool_), np.zeros((frames, 2), dtype=np.bool_)
    else:
        level = float(np.median(plates[:, :, 1])) if len(plates) else 0.0
        forces, centres = force_arrows(reactions.wrench[kept], level)
        valid, legs = reactions.valid[kept], reactions.valid_legs[kept]
    return MotionScene(
        name=name,
        role=role,
        recorded=recorded,
        stride=stride,
        time=motion.time[kept],
        origins=origins.transpose(2, 0, 1).astype(np.float32),  # from (ns, 3, nf)
        turns=_quaternions(axes),
        tracked=tracked_segments(motion),
        measured=measured_markers(model, recording, kept),
        forces=forces,
        pressure_centres=centres,
        valid=valid,
        valid_legs=legs,
        plates=plates,
    )


def _quaternions(axes: Array) -> Single:
    """(nf, ns, 4) x y z w, without jumps of sign from frame to frame, from axes (ns, 3, 3, nf)."""
    ns, nf = axes.shape[0], axes.shape[-1]
    matrices = axes.transpose(3, 0, 2, 1).reshape(
        -1, 3, 3
    )  # frame, segment, and the axes as columns
    turns = Rotation.from_matrix(matrices).as_quat().reshape(nf, ns, 4)
    flips = np.where(np.sum(turns[1:] * turns[:-1], axis=2) < 0, -1.0, 1.0)
    turns[1:] *= np.cumprod(flips, axis=0)[:, :, None]
    out: Single = turns.astype(np.float32)
    return out


def tracked_segments(motion: Motion) -> BoolArray:
    """(ns,) segments with a marker; the talus, which carries none, moves with its foot."""
    distance = motion.errors.distance
    carrying = {
        s for k, s in enumerate(motion.errors.segments) if np.isfinite(distance[:, k]).any()
    }
    carrying |= {
        j.parent for j in JOINTS if j.child in carrying and not segment_kind(j.parent).markers
    }
    return np.array([s in carrying for s in SEGMENTS], dtype=np.bool_)


def plate_corners(recording: Recording) -> Single:
    """(np, 4, 3) m, corners of the force plates whose place the recording tells."""
    corners = [plate.corners for plate in recording.plates if plate.corners is not None]
    return np.array([c for c in corners if np.isfinite(c).all()], dtype=np.float32).reshape(
        -1, 4, 3
    )


def measured_markers(model: SubjectModel, recording: Recording, kept: slice) -> Single:
    """(nf, nm, 3) m of the model's markers; NaN where the recording has none of that label or did
    not see it.
    """
    column = {label: i for i, label in enumerate(recording.labels)}
    markers = recording.markers[kept]
    out = np.full((len(markers), len(model.markers.labels), 3), np.nan, dtype=np.float32)
    for i, label in enumerate(model.markers.labels):
        if label in column:
            out[:, i] = markers[:, column[label]]
    return out


def force_arrows(wrench: Array, level: float) -> tuple[Single, Single]:
    """Force and centre of pressure on the plane y = `level`, from wrenches (nf, 2, 6) about the
    laboratory origin.
    """
    pressed = wrench[..., 1] > LOADED_N
    force, centre = np.full((2, *wrench.shape[:-1], 3), np.nan, dtype=np.float32)
    force[pressed], centre[pressed] = (
        wrench[pressed, :3],
        compute_centre_on_ground(wrench[pressed], level),
    )
    return force, centre
