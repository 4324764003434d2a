"""Trunk and arms in the static posture, or the assumption that stands in for a part that no marker shows.

A part without the markers it needs is frozen: its coordinates stay zero, its lengths are de Leva's, scaled by height.
A frozen trunk is parallel to the pelvis frame, and its mass and shoulders lie straight above the lumbar joint as the
subject stood, so that the pelvis's own inclination does not bend the trunk forward. A frozen arm hangs along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.anthropometry import default_length, default_limbs
from gaitcal.model.arm_frames import arm
from gaitcal.model.joint_parameters import SIDES
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import JOINT_OF_CHILD, Source
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.nominal_joints import ArmJoints
from gaitcal.model.segment_frames import NOMINAL_HEIGHT, Frame, LowerBody, sign, trunk, unit
from gaitcal.model.subject_model import Subject

Array = NDArray[np.float64]

TRUNK_SUPPORT = 3
"""Markers with weight that a trunk needs, as its three turns are free."""
_SHOULDER_UP, _SHOULDER_OUT = 0.3519, 0.165
"""m from the lumbar joint in the nominal subject."""
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class UpperBody:
    """Frames and joint centres of trunk and arms, laboratory."""

    frames: dict[str, Frame]
    centres: dict[str, Array]
    """`sjc ejc wjc` of both sides, (3,) m."""
    trunk_direction: Array
    """(3,) in the trunk frame: from the lumbar joint towards the head."""
    arms: ArmJoints
    raised: tuple[str, ...]
    """Sides whose arm is raised sideways in the static trial."""
    frozen_segments: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def frozen(self) -> tuple[str, ...]:
        """Coordinates of the frozen segments."""
        elements = [e for segment in self.frozen_segments for e in JOINT_OF_CHILD[segment].elements]
        return tuple(e.name for e in elements if e.source is Source.COORDINATE)


def upper_body(posture: StaticPosture, marker_set: MarkerSet, legs: LowerBody, subject: Subject) -> UpperBody:
    """Trunk and arms, measured as far as there are markers."""
    lumbar, pelvis = legs.centres["lumbar"], legs.frames["pelvis"]
    frozen: list[str] = []
    notes: list[str] = []
    reason = _why_no_trunk(posture, marker_set)
    if reason is None:
        frame, centres = trunk(posture, lumbar)
        direction = np.array([0.0, 1.0, 0.0])
        notes.append("shoulder centres 17 % of the distance between the acromia below them (Rab 2002)")
    else:
        frame = Frame(pelvis.rotation, lumbar)
        scale = subject.height / NOMINAL_HEIGHT
        outwards = unit(pelvis.rotation[:, 2] - (pelvis.rotation[:, 2] @ _UP) * _UP)
        above = lumbar + scale * _SHOULDER_UP * _UP
        centres = {f"sjc_{side}": above + sign(side) * scale * _SHOULDER_OUT * outwards for side in SIDES}
        direction = frame.rotation.T @ _UP
        frozen += ["head_trunk"]
        notes.append(f"head and trunk upright and fixed to the pelvis, as {reason}")
    frames = {"head_trunk": frame}
    turn, axis, raised = {"r": 0.0, "l": 0.0}, {"r": frame.rotation[:, 2], "l": frame.rotation[:, 2]}, []
    limbs = default_limbs(subject)
    for side in SIDES:
        upper, forearm = f"upper_arm_{side}", f"forearm_hand_{side}"
        shoulder = centres[f"sjc_{side}"]
        why = _why_no_segment(posture, marker_set, upper, f"elbow_lat_{side}")
        why_not_forearm = _why_no_segment(posture, marker_set, forearm, f"wrist_{side}")
        if reason is not None or why is not None:
            frozen += [upper, forearm]
            if reason is None:
                notes.append(f"{upper} and {forearm} hang along the trunk and are fixed to it, as {why}")
            frames[upper] = Frame(frame.rotation, shoulder)
            centres[f"ejc_{side}"] = elbow = shoulder - limbs[upper] * frame.rotation[:, 1]
            frames[forearm] = Frame(frame.rotation, elbow)
            centres[f"wjc_{side}"] = elbow - limbs[forearm] * frame.rotation[:, 1]
            continue
        seen = arm(posture, side, frame, shoulder, subject.height)
        notes += seen.notes
        frames[upper], centres[f"ejc_{side}"] = seen.upper, seen.elbow
        turn[side], axis[side] = seen.turn, seen.axis
        raised += [side] if seen.raised else []
        if why_not_forearm is None and seen.forearm is not None and seen.wrist is not None:
            frames[forearm], centres[f"wjc_{side}"] = seen.forearm, seen.wrist
        else:
            frozen.append(forearm)
            notes.append(f"{forearm} straight and fixed to the upper arm, as {why_not_forearm}")
            frames[forearm], axis[side] = Frame(seen.upper.rotation, seen.elbow), seen.upper.rotation[:, 2]
            centres[f"wjc_{side}"] = seen.elbow - default_length("Forearm", subject) * seen.upper.rotation[:, 1]
    return UpperBody(frames, centres, direction, ArmJoints(turn, axis), tuple(raised), tuple(frozen), tuple(notes))


def _why_no_trunk(posture: StaticPosture, marker_set: MarkerSet) -> str | None:
    for name in ("acromion_r", "acromion_l"):
        if not posture.has(name):
            return posture.why_not(name)
    pulling = [m for m in marker_set.tracking.get("head_trunk", ()) if marker_set.weight(m) > 0]
    seen = [m for m in pulling if m in posture.markers]
    if len(seen) < TRUNK_SUPPORT:
        return f"it has {len(seen)} markers with weight and needs {TRUNK_SUPPORT}"
    return None


def _why_no_segment(posture: StaticPosture, marker_set: MarkerSet, segment: str, landmark: str) -> str | None:
    if not posture.has(landmark):
        return posture.why_not(landmark)
    if not any(label in posture.markers for label in marker_set.tracking.get(segment, ())):
        return "no tracking marker was seen"
    return None
