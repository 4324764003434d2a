"""A person's nominal model from the static trial, and the published nominal subject.

still window -> static posture -> segment frames -> joint parameters, marker positions, lengths -> inertial parameters
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.io.toml import models_path
from gaitcal.model.ankle_zero import AnkleZero, standing_ankles
from gaitcal.model.anthropometry import BodyLengths, inertial_parameters, table_words
from gaitcal.model.chain import axis_rotation, root_angles
from gaitcal.model.joint_centres import HipCentre, JointWidths
from gaitcal.model.landmark_names import SEGMENT_OF
from gaitcal.model.landmarks import StaticPosture, check_plausible, static_posture
from gaitcal.model.linkage import (
    JOINTS,
    LEG_SEGMENTS,
    LEGS,
    SEGMENT_TABLE,
    SEGMENTS,
    SIDES,
    coordinates_before,
    segment_kind,
)
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.nominal_joints import CENTRE_OF, nominal_joint_parameters
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters, published_subject
from gaitcal.model.present_markers import complete_static, worn
from gaitcal.model.segment_frames import Frame, lower_body, sign
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from gaitcal.model.trunk import upper_body
from gaitcal.runtime import with_one_blas_thread

__all__ = ["AnkleZero", "HipCentre", "nominal_model", "published_model"]


FULL_SUPPORT = 3
"""Markers that the pelvis needs, which no joint holds."""

RAISED = 0.1
"""Factor of the weights of shoulder and arm markers where the arm is raised sideways in the static trial: the acromion
is then some 40 mm higher and nearer to the neck than in walking."""

_OF_POINT = SEGMENT_OF | {CENTRE_OF[joint.name]: joint.parent for joint in JOINTS if joint.name in CENTRE_OF}
"""Landmark or joint centre -> the segment that keeps it."""


@with_one_blas_thread
def nominal_model(
    static: Recording,
    marker_set: MarkerSet,
    subject: Subject,
    *,
    hip_centre: HipCentre = HipCentre.HARRINGTON,
    ankle_zero: AnkleZero = AnkleZero.AUTO,
    weights: Mapping[str, float] | None = None,
    window: slice | None = None,
) -> SubjectModel:
    """The nominal linkage model of a person.

    Parameters
    ----------
    static : the static trial; y up, m, any heading.
    marker_set : what its markers mean.
    subject : whose mass, height and sex give joint widths and inertia.
    hip_centre : regression for the hip centres, or those of the file.
    ankle_zero : what ankle angles are counted from.
    weights : marker -> weight, instead of the set's own.
    window : frames to use; the stillest half second if not given.

    Raises
    ------
    InputError
        No still window; a landmark that is needed is missing; a leg segment has too few markers; no human proportions.
    """
    given_weights = weights or {}
    marker_set = marker_set.with_weights(given_weights)
    static = complete_static(marker_set.renamed(static), marker_set)
    marker_set = worn(marker_set, static)
    stray = ""
    if window is None:
        found = still_window(static, marker_set.labels)
        window, stray = found.frames, f", markers {1e3 * found.scatter:.1f} mm RMS from it"
    still = window
    frames_used = range(*still.indices(len(static.time)))
    posture = static_posture(static, marker_set, still)
    check_plausible(posture, subject.height)
    legs = lower_body(posture, subject.height, hip_centre, widths=JointWidths.of(subject))
    body = upper_body(posture, marker_set, legs, subject)
    frames, centres = legs.frames | body.frames, legs.centres | body.centres
    standing = standing_ankles(posture, legs, static.facts.static_plantarflexion, ankle_zero)
    joint, zero = nominal_joint_parameters(frames, centres, body.arms, standing.dorsiflexion)
    inertial = inertial_parameters(subject, _lengths(frames["pelvis"], centres))
    parameters = Parameters(joint, inertial, zero)
    frozen = (*body.frozen_segments, *_bare(marker_set, posture))
    carried = [label for label in _carried(marker_set, body.raised) if label not in given_weights]
    raised = {label: marker_set.weight(label) * RAISED for label in carried}
    markers, notes = _placement(posture, marker_set.with_weights(raised), frames, frozen)
    if raised:
        names = ", ".join(raised)
        notes = (*notes, f"arms raised in the static trial displace the shoulders: weights times {RAISED:g} on {names}")
    return SubjectModel(
        subject=subject,
        parameters=parameters,
        nominal=parameters,
        markers=markers,
        frozen=coordinates_before(frozen),
        posture=_posture(frames, standing.dorsiflexion),
        landmarks=_landmarks({**posture.landmarks, **centres}, frames, frozen),
        notes=(
            *(f"static trial: {note}" for note in static.notes),
            f"static posture: mean of {len(frames_used)} frames from {static.time[frames_used[0]]:.2f} s{stray}",
            *marker_set.notes,
            *posture.notes,
            *legs.notes,
            *standing.notes,
            *body.notes,
            *notes,
            f"inertia: {table_words(subject)}",
        ),
    )


def _bare(marker_set: MarkerSet, posture: StaticPosture) -> tuple[str, ...]:
    """Segments of the legs that may do without markers and of which none was seen."""
    optional = [s for leg in LEGS.values() for s in leg if segment_kind(s).markers and s not in LEG_SEGMENTS]
    return tuple(s for s in optional if not set(marker_set.tracking.get(s, ())) & set(posture.markers))


def _posture(frames: Mapping[str, Frame], dorsiflexion: Mapping[str, float]) -> dict[str, float]:
    """Coordinates (rad) of pelvis, lumbar joint, hips and ankles in the static posture."""
    pelvis = frames["pelvis"].rotation
    ahead = axis_rotation(1, float(np.arctan2(pelvis[2, 0], pelvis[0, 0]))) @ pelvis
    turns = {
        ("pelvis_tilt", "pelvis_list", "pelvis_rotation"): (ahead, 1.0),
        ("lumbar_extension", "lumbar_bending", "lumbar_rotation"): (pelvis.T @ frames["head_trunk"].rotation, 1.0),
    }
    for side in SIDES:
        names = (f"hip_flexion_{side}", f"hip_adduction_{side}", f"hip_rotation_{side}")
        turns[names] = (pelvis.T @ frames[f"thigh_{side}"].rotation, sign(side))
    out = {f"ankle_angle_{side}": float(dorsiflexion[side]) for side in SIDES}
    for names, (rotation, mirrored) in turns.items():
        (angles,) = root_angles(rotation[None]) * [1.0, mirrored, mirrored]
        out |= dict(zip(names, map(float, angles), strict=True))
    return out


def _carried(marker_set: MarkerSet, sides: tuple[str, ...]) -> list[str]:
    """Markers of the set on the shoulders and arms of these sides that have weight."""
    labels: list[str] = []
    for side in sides:
        labels += marker_set.landmarks.get(f"acromion_{side}", ())
        labels += [m for part in ("upper_arm", "forearm_hand") for m in marker_set.tracking.get(f"{part}_{side}", ())]
    return [label for label in labels if marker_set.weight(label) > 0]


def _lengths(pelvis: Frame, centres: Mapping[str, Array]) -> BodyLengths:
    """What inertia depends on, from the joint centres (3,) m in the laboratory."""
    legs = {"thigh": ("hjc", "kjc"), "shank": ("kjc", "ajc")}
    ends = legs | {"upper_arm": ("sjc", "ejc"), "forearm_hand": ("ejc", "wjc")}
    limbs = {
        f"{segment}_{side}": float(np.linalg.norm(centres[f"{a}_{side}"] - centres[f"{b}_{side}"]))
        for segment, (a, b) in ends.items()
        for side in SIDES
    }
    hips = pelvis.local(0.5 * (centres["hjc_r"] + centres["hjc_l"]))
    return BodyLengths(limbs, hips[:2], float(pelvis.local(centres["lumbar"])[1] - hips[1]))


def _placement(
    posture: StaticPosture, marker_set: MarkerSet, frames: Mapping[str, Frame], frozen: tuple[str, ...]
) -> tuple[MarkerPlacement, tuple[str, ...]]:
    """Local positions of all markers that were seen, in segments that move."""
    weight = marker_set.weight
    labels: list[str] = []
    segments: list[str] = []
    dropped: list[str] = []
    for segment in SEGMENTS:
        if segment in frozen:
            continue
        tracking = marker_set.tracking.get(segment, ())
        present = [label for label in tracking if label in posture.markers]
        missing = [label for label in tracking if label not in posture.markers]
        kept = sum(weight(label) > 0 for label in present)
        needed = FULL_SUPPORT if segment == "pelvis" else 1  # whether the joints tell the rest: faults/one_marker.py
        if kept < needed and segment in ("pelvis", *LEG_SEGMENTS):
            lost = ", ".join(f"'{label}'" for label in missing if weight(label) > 0)
            why = f"{lost} not seen while the subject stood still" if lost else "the marker set gives it no more"
            raise InputError(
                f"found {kept} markers with weight, {why}; allowed: at least {needed}",
                source=posture.source,
                field=f"segment {segment}",
                code=Code.TOO_LITTLE_SEEN,
            )
        dropped += missing
        static_only = [label for label in marker_set.static_only.get(segment, ()) if label in posture.markers]
        labels += [*present, *static_only]
        segments += [segment] * (len(present) + len(static_only))
    local = np.array([frames[s].local(posture.markers[m]) for m, s in zip(labels, segments, strict=True)])
    notes = (f"markers of the set that the static trial lacks, left out: {', '.join(dropped)}",) if dropped else ()
    return MarkerPlacement(tuple(labels), tuple(segments), local, np.array([weight(m) for m in labels])), notes


def _landmarks(
    points: Mapping[str, Array], frames: Mapping[str, Frame], frozen: tuple[str, ...]
) -> dict[str, tuple[str, Array]]:
    """Points of the laboratory (3,) m that the model keeps, each in its segment, but for segments that are frozen."""
    out = {}
    for name, point in points.items():
        segment = _OF_POINT.get(name)
        if segment is not None and segment not in frozen:
            out[name] = (segment, frames[segment].local(point))
    return dict(sorted(out.items()))


PUBLISHED = Subject("published nominal subject", 69.4, 1.70, "male")


@with_one_blas_thread
def published_model(*, static_only: bool = False) -> SubjectModel:
    """The published nominal subject with the published markers (`models/nominal_subject.json`).

    With `static_only`, the medial and lateral knee and ankle markers of the static trial are there too.
    """
    data = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))
    placed: dict[str, tuple[str, Array]] = {}
    bodies = {name.replace("_", ""): name for name in SEGMENT_TABLE}
    for body, listed in data["markers_local_mm_right_side"].items():
        segment = bodies[body]
        for label, position in listed.items():
            local = 1e-3 * np.array(position, dtype=float)
            if segment in SEGMENTS:
                placed[label] = (segment, local)
            else:
                placed[f"R.{label}"] = (f"{segment}_r", local)
                placed[f"L.{label}"] = (f"{segment}_l", local * [1.0, 1.0, -1.0])
    marker_set = load_marker_set("published")
    taken_off = {label for group in marker_set.static_only.values() for label in group}
    kept = {label: place for label, place in placed.items() if static_only or label not in taken_off}
    ordered = sorted(kept, key=lambda label: SEGMENTS.index(kept[label][0]))
    markers = MarkerPlacement(
        tuple(ordered),
        tuple(kept[label][0] for label in ordered),
        np.array([kept[label][1] for label in ordered]),
        np.array([marker_set.weight(label) for label in ordered]),
    )
    parameters = published_subject()
    landmarks = {
        name: (placed[labels[0]][0], np.mean([placed[label][1] for label in labels], axis=0))
        for name, labels in marker_set.landmarks.items()
    }
    for joint in JOINTS:
        if joint.name in CENTRE_OF:
            centre = np.zeros(3)
            for p in JOINT_PARAMETERS:
                if (p.joint, p.segment, p.kind) == (joint.name, joint.parent, Kind.POSITION):
                    centre[p.axis] = parameters.joint[JP_INDEX[p.name]]
            landmarks[CENTRE_OF[joint.name]] = (joint.parent, centre)
    return SubjectModel(
        subject=PUBLISHED,
        parameters=parameters,
        nominal=parameters,
        markers=markers,
        landmarks=dict(sorted(landmarks.items())),
        notes=("the published nominal subject; markers and inertia as in models/nominal_subject.json",),
    )
