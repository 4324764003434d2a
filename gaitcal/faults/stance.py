"""Where the static trial has markers, joint centres and knee axes, in the axes of the person who stands.

x forward, y up, z to the right (the horizontal part of the line between the ASIS): one set of axes for all segments, so
that a segment's turn from the static posture is the turn of its markers, and two segments that keep the static posture
have the same turn. Hip, knee and ankle centres are those of `model/segment_frames.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.chain import Chain, forward, segment_poses
from gaitcal.model.landmarks import static_posture
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters
from gaitcal.model.present_markers import complete_static, worn
from gaitcal.model.segment_frames import Frame, HipCentre, JointWidths, LowerBody, across, lower_body
from gaitcal.model.subject_model import SubjectModel

CENTRE = {"hip": "hjc", "knee": "kjc", "ankle": "ajc"}
MODEL_JOINT = {"hip": ("hip", "pelvis"), "knee": ("knee", "thigh"), "ankle": ("talocrural", "shank")}
"""Joint -> that of the linkage whose centre it is, and the segment above it."""
USUAL_HEIGHT_M = 1.75
"""Clean recordings from which limits in metres are taken are of people up to about this height: taller ones have
longer ways between markers, and those grow with them."""
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Stance:
    """The static posture of pelvis and legs."""

    points: Mapping[str, Mapping[str, Array]]
    """Segment -> marker -> (3,) m."""
    centres: Mapping[str, Array] = field(default_factory=dict)
    """`hip_r`, `knee_r`, ... -> (3,) m; empty where nothing can be said across joints."""
    knee_axes: Mapping[str, Array] = field(default_factory=dict)
    """`knee_r`, `knee_l` -> (3,) from the medial to the lateral epicondyle on the right, the other way on the left."""
    landmarks: Mapping[str, Array] = field(default_factory=dict)
    """(3,) m, of the marker set's landmarks that were seen."""
    size: float = 1.0
    """Of the person, by which limits in metres grow: height over the usual, at least 1."""

    @classmethod
    def of_recording(
        cls, static: Recording, marker_set: MarkerSet, model: SubjectModel, hip_centre: HipCentre
    ) -> Stance:
        """From the static trial of which `model` was made."""
        static = complete_static(marker_set.renamed(static), marker_set)
        marker_set = worn(marker_set, static)
        posture = static_posture(static, marker_set, still_window(static, marker_set.labels).frames)
        legs = lower_body(posture, model.subject.height, hip_centre, widths=JointWidths.of(model.subject))
        axes = _axes(legs)
        placed = zip(model.markers.labels, model.markers.segments, strict=True)
        points: dict[str, dict[str, Array]] = {}
        for label, segment in placed:
            if segment in legs.frames and label in posture.markers:
                points.setdefault(segment, {})[label] = axes @ posture.markers[label]
        landmarks = {name: axes @ at for name, at in posture.landmarks.items()}
        return cls(
            points=points,
            centres={f"{j}_{s}": axes @ legs.centres[f"{c}_{s}"] for j, c in CENTRE.items() for s in SIDES},
            knee_axes={
                f"knee_{s}": (1.0 if s == "r" else -1.0) * (landmarks[f"knee_lat_{s}"] - landmarks[f"knee_med_{s}"])
                for s in SIDES
                if posture.has(f"knee_med_{s}")
            },
            landmarks=landmarks,
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )

    def without(self, labels: Collection[str]) -> Stance:
        """The same posture without markers that are no evidence of where they sit, as they were not seen in it."""
        points = {
            segment: {label: at for label, at in placed.items() if label not in labels}
            for segment, placed in self.points.items()
        }
        return replace(self, points=points) if labels else self

    @classmethod
    def of_model(cls, model: SubjectModel) -> Stance:
        """From a saved model, all coordinates zero: its joint centres and markers."""
        frames = _at_zero(model.parameters)
        points: dict[str, dict[str, Array]] = {}
        placed = zip(model.markers.labels, model.markers.segments, model.markers.local, strict=True)
        for label, segment, local in placed:
            points.setdefault(segment, {})[label] = frames[segment].point(local)
        return cls(
            points=points,
            centres={
                f"{name}_{side}": frames[parent].point(_position(model.parameters, f"{joint}_{side}", parent))
                for name, (joint, part) in MODEL_JOINT.items()
                for side in SIDES
                for parent in (part if part == "pelvis" else f"{part}_{side}",)
            },
            landmarks={name: frames[segment].point(at) for name, (segment, at) in model.landmarks.items()},
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )


def _at_zero(parameters: Parameters) -> dict[str, Frame]:
    """Segment frames of a linkage with all coordinates zero."""
    chain = Chain()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    poses = forward(chain, constants, np.zeros((1, len(chain.coordinates))))
    axes, origins = segment_poses(chain, constants, poses)
    return {name: Frame(axes[i, :, :, 0].T, origins[i, :, 0]) for i, name in enumerate(chain.segments)}


def _position(parameters: Parameters, joint: str, segment: str) -> Array:
    """(3,) m, centre of a joint in the frame of one of its segments."""
    out = np.zeros(3)
    for p in JOINT_PARAMETERS:
        if (p.joint, p.segment, p.kind) == (joint, segment, Kind.POSITION):
            out[p.axis] = parameters.joint[JP_INDEX[p.name]]
    return out


def _axes(legs: LowerBody) -> Array:
    """(3, 3) whose product with a point of the laboratory has the person's forward, up and right."""
    right = across(legs.frames["pelvis"].rotation[:, 2], UP)
    return np.vstack([np.cross(UP, right), UP, right])
