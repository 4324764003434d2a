"""The scene of a page: a calibrated subject in all trials, without numerics.

A scene is made from a calibration once, saved as `scene.npz` in the result, and shown from that
file.

A joint belongs to the two segments that it connects. Its frames (`export/opensim/osim_writer.py`)
contain its constants: those before the first coordinate in the parent, those after the last in the
child:

    centre = translation of X
    axis   = sign * R[:, axis of the coordinate next to that segment]

Standard errors s_p of the joint parameters p propagate to centre and axis through the Jacobian, cov
= sum_p s_p^2 (d./dp)(d./dp)^T, with parameters taken as uncorrelated, as the table of errors has no
correlations. The columns of its matrix square root are the half axes of the one-sigma ellipsoid.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.export.opensim.osim_writer import get_joint_frames
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import Recording
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINTS, SEGMENTS, Joint, get_segment
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page import body_meshes, bone_landmarks
from gaitcal.tracking.motion import Motion

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
    """One joint in one of its two segments."""

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


def build_joint_marks(
    nominal: Parameters, fitted: Parameters, errors: Mapping[str, float]
) -> tuple[JointMark, ...]:
    """Build the marks of all joints in both their segments.

    Parameters
    ----------
    nominal, fitted
        Parameters before and after calibration.
    errors
        Joint parameter -> standard error (m, rad) of every fitted one.

    Returns
    -------
    tuple of JointMark
        Centres and axes in segment frames.
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
                places[f"{stage}_centre"], places[f"{stage}_axis"] = _locate_centre_and_axis(
                    joint, segment, parameters
                )
            places["centre_spread"], places["axis_spread"] = _propagate_errors(
                joint, segment, fitted, known
            )
            # A joint counts as fitted if it has a standard error or has moved.
            moved = bool(known) or not np.array_equal(nominal.joint[columns], fitted.joint[columns])
            marks.append(JointMark(joint=joint.name, segment=segment, fitted=moved, **places))
    return tuple(marks)


def _locate_centre_and_axis(
    joint: Joint, segment: str, parameters: Parameters
) -> tuple[Array, Array]:
    """Locate the (3,) centre and (3,) axis in a segment; the axis of a ball joint is NaN."""
    frames = get_joint_frames(joint, parameters)
    in_parent = segment == joint.parent
    place = frames.in_parent if in_parent else frames.in_child
    axis = frames.motions[0 if in_parent else -1]
    centre = place.translation + 0.0  # no negative zeros, which would stand in the page
    return centre, np.full(3, np.nan) if len(frames.motions) > 2 else axis.sign * place.rotation[
        :, axis.axis
    ]


def _propagate_errors(
    joint: Joint, segment: str, fitted: Parameters, errors: Mapping[str, float]
) -> tuple[Array, Array]:
    """Propagate errors to the (3, 3) ellipsoid half axes of centre and axis; NaN without errors."""
    if not errors:
        return np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    columns = []
    for name, error in errors.items():
        value = fitted.joint[JP_INDEX[name]]
        # Central differences: the map from parameters to centre and axis is smooth and cheap.
        low, high = (
            np.concatenate(
                _locate_centre_and_axis(
                    joint, segment, fitted.with_joint((name,), np.array([value + step]))
                )
            )
            for step in (-_STEP, _STEP)
        )
        columns.append(error * (high - low) / (2 * _STEP))
    jacobian = np.array(columns).T
    return _compute_square_root(jacobian[:3]), _compute_square_root(jacobian[3:])


def _compute_square_root(jacobian: Array) -> Array:
    """Compute the (3, 3) square root of J J^T with orthogonal columns.

    Their lengths are the standard deviations.
    """
    if not np.isfinite(jacobian).all():
        return np.full((3, 3), np.nan)
    values, vectors = np.linalg.eigh(jacobian @ jacobian.T)
    # an axis points either way: the largest entry of each column is positive
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    out: Array = vectors * np.where(largest < 0, -1.0, 1.0) * np.sqrt(np.maximum(values, 0.0))
    return out


@dataclass(frozen=True, kw_only=True)
class MotionScene:
    """One trial: poses of the fitted model, markers and ground reactions."""

    name: str
    role: str
    recorded: int  # Frames of the recording
    stride: int  # Every how many of them is kept here
    time: Array  # (nf,) s
    origins: Single  # (nf, ns, 3) m, segment origins in the laboratory
    turns: Single  # (nf, ns, 4) unit quaternions x y z w from segment to laboratory
    # (ns,) whether any marker of this trial is fixed in the segment (talus: in its foot)
    tracked: BoolArray
    measured: Single  # (nf, nm, 3) m; NaN where a marker was not visible
    forces: Single  # (nf, 2, 3) N, ground on right and left foot; NaN where there is none
    pressure_centres: Single  # (nf, 2, 3) m; NaN where there is no force
    valid: BoolArray  # (nf,) every foot on the ground is on a plate; all False without force plates
    # (nf, 2) the same of the right and of the left foot alone; a foot in the air is valid
    valid_legs: BoolArray
    plates: Single  # (np, 4, 3) m, corners of the force plates with a recorded position

    @property
    def has_forces(self) -> bool:
        """Whether a foot is on a plate in any frame."""
        return bool(np.isfinite(self.forces).any())


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A calibrated subject in all trials."""

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


def build_person_scene(
    model: SubjectModel, trials: tuple[MotionScene, ...], errors: Mapping[str, float]
) -> Scene:
    """Build the scene of a subject from scenes of trials.

    Parameters
    ----------
    model
        The calibrated subject.
    trials
        Scenes of trials.
    errors
        Joint parameter -> standard error (m, rad) of every fitted one.

    Returns
    -------
    Scene
        Subject and trials.
    """
    return Scene(
        subject=model.subject.name,
        mass=model.subject.mass,
        height=model.subject.height,
        labels=model.markers.labels,
        marker_segments=model.markers.segments,
        marker_places=model.markers.local,
        joints=build_joint_marks(model.nominal, model.parameters, errors),
        body=body_meshes.fit_body_meshes(model),
        trials=trials,
        landmarks=bone_landmarks.collect_person_landmarks(model),
    )


def build_trial_scene(
    model: SubjectModel,
    name: str,
    role: str,
    motion: Motion,
    recording: Recording,
    reactions: GroundReactions | None,
) -> MotionScene:
    """Build the scene of one trial.

    Parameters
    ----------
    model
        The calibrated subject.
    name, role
        Of the trial.
    motion
        Of the whole body, tracked with `model`, at the frames of the recording.
    recording
        Markers and plates.
    reactions
        None without force plates.

    Returns
    -------
    MotionScene
        At most `MOST_FRAMES` frames.
    """
    recorded = len(motion.time)
    # A page of a long recording would be too large for browsers: every n-th frame.
    stride = max(1, -(-recorded // MOST_FRAMES))
    kept = slice(None, None, stride)
    placed = Kinematics(get_chain().body(model.parameters), motion.q[kept], columns=False)
    axes, origins = placed.axes, placed.origins
    plates = collect_plate_corners(recording)
    frames = len(motion.time[kept])
    if reactions is None:
        forces = centres = np.full((frames, 2, 3), np.nan, dtype=np.float32)
        valid, legs = np.zeros(frames, dtype=np.bool_), np.zeros((frames, 2), dtype=np.bool_)
    else:
        # m, height of the plates, on which the force arrows begin.
        level = float(np.median(plates[:, :, 1])) if len(plates) else 0.0
        forces, centres = compute_force_arrows(reactions.wrench[kept], level)
        valid, legs = reactions.valid[kept], reactions.valid_legs[kept]
    return MotionScene(
        name=name,
        role=role,
        recorded=recorded,
        stride=stride,
        time=motion.time[kept],
        origins=origins.transpose(2, 0, 1).astype(np.float32),  # from (ns, 3, nf)
        turns=_convert_to_quaternions(axes),
        tracked=find_tracked_segments(motion),
        measured=collect_measured_markers(model, recording, kept),
        forces=forces,
        pressure_centres=centres,
        valid=valid,
        valid_legs=legs,
        plates=plates,
    )


def _convert_to_quaternions(axes: Array) -> Single:
    """Convert axes (ns, 3, 3, nf) to (nf, ns, 4) quaternions x y z w without jumps of sign."""
    ns, nf = axes.shape[0], axes.shape[-1]
    matrices = axes.transpose(3, 0, 2, 1).reshape(
        -1, 3, 3
    )  # frame, segment, and the axes as columns
    turns = Rotation.from_matrix(matrices).as_quat().reshape(nf, ns, 4)
    flips = np.where(np.sum(turns[1:] * turns[:-1], axis=2) < 0, -1.0, 1.0)
    turns[1:] *= np.cumprod(flips, axis=0)[:, :, None]
    out: Single = turns.astype(np.float32)
    return out


def find_tracked_segments(motion: Motion) -> BoolArray:
    """Find the (ns,) segments with a visible marker; a talus, which has none, follows its foot."""
    distance = motion.errors.distance
    carrying = {
        s for k, s in enumerate(motion.errors.segments) if np.isfinite(distance[:, k]).any()
    }
    carrying |= {
        j.parent for j in JOINTS if j.child in carrying and not get_segment(j.parent).markers
    }
    return np.array([s in carrying for s in SEGMENTS], dtype=np.bool_)


def collect_plate_corners(recording: Recording) -> Single:
    """Collect the (np, 4, 3) m corners of the force plates with a recorded position."""
    corners = [plate.corners for plate in recording.plates if plate.corners is not None]
    return np.array([c for c in corners if np.isfinite(c).all()], dtype=np.float32).reshape(
        -1, 4, 3
    )


def collect_measured_markers(model: SubjectModel, recording: Recording, kept: slice) -> Single:
    """Collect the (nf, nm, 3) m measured markers of the model; NaN if missing."""
    column = {label: i for i, label in enumerate(recording.labels)}
    markers = recording.markers[kept]
    out = np.full((len(markers), len(model.markers.labels), 3), np.nan, dtype=np.float32)
    for i, label in enumerate(model.markers.labels):
        if label in column:
            out[:, i] = markers[:, column[label]]
    return out


def compute_force_arrows(wrench: Array, level: float) -> tuple[Single, Single]:
    """Compute force and centre of pressure in the plane y = `level`.

    Parameters
    ----------
    wrench
        (nf, 2, 6) N, N·m about the laboratory origin.
    level
        m.

    Returns
    -------
    forces, centres
        (nf, 2, 3) N and m; NaN without load.
    """
    pressed = wrench[..., 1] > LOADED_N
    force, centre = np.full((2, *wrench.shape[:-1], 3), np.nan, dtype=np.float32)
    force[pressed], centre[pressed] = (
        wrench[pressed, :3],
        compute_centre_on_ground(wrench[pressed], level),
    )
    return force, centre
