"""A recording of bones as a laboratory would calibrate it: nominal joint, estimate, motion.

The recording becomes skin markers in the laboratory. The nominal model is made of the anatomical
axes of the bones, which all recordings have: the knee in the middle of the epicondyles, the origin
of the thigh, its axis along the thigh's z; the hip by Harrington's regression from the spines. The
two segments of the joint are then fitted by the phase that fits the legs of a person
(`calibration/joint_phases.py`), as the kind of task that the recording shows: a walk or a run as
gait, a knee or hip that moves alone as its isolated trial, anything else as an activity. Bones that
were pinned without skin markers carry points that never move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.analysis.trial_bandwidth import choose_bandwidth
from gaitcal.arrays import Array
from gaitcal.calibration import soft_tissue_artefact
from gaitcal.calibration.joint_estimate import BY_EVIDENCE, select_movable_parameters
from gaitcal.calibration.joint_phases import LEG_PARAMETERS, PhasePlan, PhaseResult, fit_phase
from gaitcal.calibration.soft_tissue_table import SkinTable
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import compute_knee_flexion, published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.rotations import compute_root_angles
from gaitcal.model.segment_frames import (
    Frame,
    HipCentre,
    build_frame,
    build_pelvis_frame,
    compute_hip_centre,
    find_nearest_rotation,
    normalise,
)
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, Trial
from gaitcal.tracking.bandwidth import apply_bandwidth
from gaitcal.tracking.motion import Motion, track_motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from scripts.validation.bones.recordings import BoneRecording

THIGH_OF_HEIGHT = 0.245
"""Length of the thigh over body height (Winter 2009)."""
MEAN_HEIGHT_M, MEAN_MASS_KG = 1.70, 70.0
DEFINED_M = 5e-3
"""Error of the bones' axis from which it is no truth: half of how far nominal knees are off."""
PINNED_M = 0.1
"""Half the way between the points of a bone that carries no skin marker."""
SEGMENT_NAMES = {"pelvis": "pelvis", "thigh": "thigh_r", "shank": "shank_r"}
GAIT_WORDS, KNEE_WORDS, HIP_WORDS = (
    ("walk", "run", "gait"),
    ("flexion", "extension"),
    ("arc", "rotation", "hip"),
)


@dataclass(frozen=True, kw_only=True)
class NominalJoint:
    """A joint as a static trial has it."""

    joint: str
    """`knee_r` or `hip_r`."""
    above: str
    below: str
    frames: Mapping[str, Frame]
    """Segment -> its axes in those of its bone."""
    model: SubjectModel

    @property
    def segments(self) -> tuple[str, str]:
        """As the linkage names them."""
        return SEGMENT_NAMES[self.above], SEGMENT_NAMES[self.below]


def joint_of(recording: BoneRecording) -> str:
    """The joint that a recording can show: the hip where the pelvis was tracked, else the knee."""
    return "hip_r" if recording.has("pelvis", "thigh") else "knee_r"


def kind_of(recording: BoneRecording) -> str:
    """The kind of task, as a calibration names it."""
    task = recording.task.lower()
    if any(word in task for word in GAIT_WORDS):
        return soft_tissue_artefact.GAIT
    if joint_of(recording) == "hip_r":
        return "hip_r" if any(word in task for word in HIP_WORDS) else f"activity {task}"
    return "knee_r" if any(word in task for word in KNEE_WORDS) else f"activity {task}"


def nominal_joint(recording: BoneRecording) -> NominalJoint:
    """The nominal model of a recording's joint, with all markers in their static places."""
    joint = joint_of(recording)
    above, below = ("pelvis", "thigh") if joint == "hip_r" else ("thigh", "shank")
    still = recording.standing(above, below)
    one, other = recording.segments[above], recording.segments[below]
    turn = find_nearest_rotation(recording.relative(above, below)[still].mean(axis=0))
    away = np.einsum("fji,fj->fi", one.rotation, other.origin - one.origin)[still].mean(axis=0)
    height = MEAN_HEIGHT_M if np.isnan(recording.height) else recording.height
    if joint == "knee_r":
        frames, values = _knee(turn, away, height)
    else:
        frames, values = _hip(recording, turn, away)
    parameters = published_model().parameters.with_joint(
        tuple(values), np.array(list(values.values()))
    )
    subject = Subject(
        name=recording.person,
        mass=MEAN_MASS_KG if np.isnan(recording.mass) else recording.mass,
        height=height,
        sex="",
    )
    labels, segments, places = list[str](), list[str](), list[Array]()
    for name in (above, below):
        rest = _skin_or_pins(recording, name)[still].mean(axis=0)
        labels += [f"{name}{k}" for k in range(len(rest))]
        segments += [SEGMENT_NAMES[name]] * len(rest)
        places += [frames[name].local(point) for point in rest]
    model = SubjectModel(
        subject=subject,
        parameters=parameters,
        nominal=parameters,
        markers=MarkerPlacement(
            tuple(labels), tuple(segments), np.array(places), np.ones(len(labels))
        ),
        posture=_posture(joint, frames, turn, parameters),
    )
    return NominalJoint(joint=joint, above=above, below=below, frames=frames, model=model)


def _skin_or_pins(recording: BoneRecording, name: str) -> Array:
    """(nf, nm, 3) m in the bone: its skin markers, or points that never move."""
    bone = recording.segments[name]
    if bone.markers.shape[1]:
        return bone.markers
    return np.repeat(PINNED_M * np.vstack([np.eye(3), -np.ones(3)])[None], len(bone.origin), axis=0)


def _knee(turn: Array, away: Array, height: float) -> tuple[dict[str, Frame], dict[str, float]]:
    """Segment axes in the bones' axes, and the nominal knee; `turn`, `away`: static pose of the
    shank in the thigh.
    """
    knee = np.zeros(3)
    thigh = Frame(np.eye(3), np.array([0.0, THIGH_OF_HEIGHT * height, 0.0]))
    shank = Frame(np.eye(3), turn.T @ (knee - away))
    axis = turn.T @ thigh.rotation[:, 2]
    place = thigh.local(knee)
    values = {
        "knee_r.thigh.ant": place[0],
        "knee_r.thigh.sup": place[1],
        "knee_r.thigh.front": 0.0,
        "knee_r.thigh.trans": 0.0,
        "knee_r.shank.ant": 0.0,
        "knee_r.shank.sup": 0.0,
        "knee_r.shank.lat": 0.0,
        "knee_r.shank.front": float(np.arctan2(-axis[1], axis[2])),
        "knee_r.shank.trans": float(np.arcsin(np.clip(axis[0], -1.0, 1.0))),
    }
    return {"thigh": thigh, "shank": shank}, values


def _hip(
    recording: BoneRecording, turn: Array, away: Array
) -> tuple[dict[str, Frame], dict[str, float]]:
    """Segment axes in the bones' axes, and the nominal hip; `turn`, `away`: static pose of the
    thigh in the pelvis.
    """
    points = recording.segments["pelvis"].landmarks
    right, left, back = points["RASI"], points["LASI"], 0.5 * (points["RPSI"] + points["LPSI"])
    pelvis = build_pelvis_frame(right, left, back)
    width, depth = float(np.linalg.norm(right - left)), float(np.linalg.norm(pelvis.origin - back))
    place = compute_hip_centre(HipCentre.HARRINGTON, width, depth, "r")
    hip_below = turn.T @ (pelvis.point(place) - away)
    thigh = build_frame(hip_below, normalise(hip_below), np.array([0.0, 0.0, 1.0]))
    values = {
        f"hip_r.pelvis.{d}": x for d, x in zip(("ant", "sup", "lat"), place.tolist(), strict=True)
    }
    values |= {f"hip_r.thigh.{d}": 0.0 for d in ("ant", "sup", "lat")}
    return {"pelvis": pelvis, "thigh": thigh}, values


def _posture(
    joint: str, frames: Mapping[str, Frame], turn: Array, parameters: Parameters
) -> dict[str, float]:
    """Coordinate -> rad in the static posture."""
    if joint == "hip_r":
        hip = frames["pelvis"].rotation.T @ turn @ frames["thigh"].rotation
        return dict(
            zip(
                ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r"),
                map(float, compute_root_angles(hip)),
                strict=True,
            )
        )
    shank = frames["thigh"].rotation.T @ turn @ frames["shank"].rotation
    return {"knee_angle_r": compute_knee_flexion(shank, parameters.joint, "r")}


def problem_of(recording: BoneRecording, nominal: NominalJoint) -> MotionProblem:
    """The skin markers of a recording in the laboratory as the problem of its two segments."""
    paths = []
    for name in (nominal.above, nominal.below):
        bone = recording.segments[name]
        local = _skin_or_pins(recording, name)
        paths.append(np.einsum("fij,fmj->fmi", bone.rotation, local) + bone.origin[:, None])
    measured = Recording(
        source=recording.name,
        time=np.arange(len(paths[0])) / recording.rate,
        labels=nominal.model.markers.labels,
        markers=np.concatenate(paths, axis=1),
    )
    kind, settings = kind_of(recording), CalibrationSettings()
    isolated = nominal.joint if kind == nominal.joint else None
    root, below = nominal.segments
    problem = build_trial_problem(
        recording.name,
        nominal.model,
        measured,
        ControlPointRule(),
        root=root,
        segments=(root, below),
        isolated=isolated,
    )
    trial = Trial(name=recording.name, role=Role.JOINT, joint=nominal.joint, recording=measured)
    bandwidth = choose_bandwidth(problem, trial, nominal.model, settings)
    return (
        apply_bandwidth(problem, nominal.model.nominal, bandwidth.joints_hz)
        if bandwidth.penalised
        else problem
    )


@dataclass(frozen=True, kw_only=True)
class BoneFit:
    """What a calibration makes of a recording."""

    phase: PhaseResult
    motion: Motion
    """As a calibration would track the trial in the end."""
    softness: float
    """How soft the person is, by how the markers deform."""


def fit_recording(
    recording: BoneRecording,
    nominal: NominalJoint,
    problem: MotionProblem,
    *,
    tissue: bool,
    table: SkinTable | None = None,
) -> BoneFit:
    """Calibrate the joint of a recording.

    Parameters
    ----------
    tissue : whether skin may move; else markers are taken to stay in their places.
    table : skin of people; gaitcal's own unless given.
    """
    kind, start = kind_of(recording), nominal.model.nominal
    plan = PhasePlan(
        name=recording.name,
        tasks={kind: (problem,)},
        free=select_movable_parameters([problem], LEG_PARAMETERS),
        recordings=(recording.name,),
    )
    tracked, softness = problem, 0.0
    if tissue:
        bare = [name for name, bone in recording.segments.items() if not bone.markers.shape[1]]
        pinned = [SEGMENT_NAMES[name] for name in bare]
        of_trial = {recording.name: kind}, {recording.name: problem}
        soft = soft_tissue_artefact.prepare_task_tissue(*of_trial, start, table, pinned=pinned)
        plan = plan.with_tissue(soft)
    phase = fit_phase(plan, start, BY_EVIDENCE)
    if tissue:
        tracked = soft.make_found_tissue(
            phase.estimate.keys, phase.estimate.tissue
        ).displace_markers(plan.problems[0])
        softness = soft.scales[kind].mean
    return BoneFit(
        phase=phase, motion=track_motion(tracked, phase.estimate.parameters), softness=softness
    )


def tracked_flexion(motion: Motion) -> Array:
    """(nf,) rad."""
    return np.asarray(motion.q[:, motion.coordinates.index("knee_angle_r")])


def parameters_of_axis(
    nominal: NominalJoint, hinge: tuple[Array, Array, Array, Array]
) -> dict[str, float]:
    """Joint parameters of an axis: where it crosses the planes of lateral position zero, and its
    directions.

    The shank's lateral position is no part of it: a point may slide along the axis.
    """
    out = {}
    for segment, direction, point in (("thigh", *hinge[:2]), ("shank", *hinge[2:])):
        frame: Frame = nominal.frames[segment]
        along, at = frame.rotation.T @ direction, frame.local(point)
        at = at - along * (at[2] / along[2])
        out |= {
            f"knee_r.{segment}.ant": float(at[0]),
            f"knee_r.{segment}.sup": float(at[1]),
            f"knee_r.{segment}.front": float(np.arctan2(-along[1], along[2])),
            f"knee_r.{segment}.trans": float(np.arcsin(along[0])),
        }
    return out
