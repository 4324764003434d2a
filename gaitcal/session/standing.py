"""Whether a recording shows the person standing, and the posture it then gives: what a static trial must show.

Standing is: a still window; knees not bent far (the pelvis is nearly as high above the ankles as the legs are long);
both feet at one height. A walk may hold a still window too; it is a worse static trial than one that only stands.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.faults.stance import UP, Stance
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.landmarks import static_posture
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.model.segment_frames import across
from gaitcal.model.worn_markers import complete_static, worn

STRAIGHT = 0.8
"""Height of the pelvis over the ankles as a share of the way over the knees: 0.97 to 1.00 in standing, 0.94 with knees
bent by 40 deg, 0.7 in sitting."""
LEVEL_M = 0.08
"""Difference in height of the two feet's middles: a foot is lifted from there on."""
LOW_M, HIGH_M = 0.3, 1.5
"""Height of the pelvis over the feet of a person who stands."""
TOO_SMALL = {1000: "metres under a header that says mm", 100: "metres under cm", 10: "centimetres under mm"}
STAYS_M = 0.03
"""RMS distance of pelvis and feet from their mean places, in a recording that only stands."""
BELL_HIP = np.array([-0.19, -0.30, 0.14])
"""Hip centre from the ASIS as a share of their distance: forward, up, inward (Bell, Pedersen and Brand, J Biomech
23:617-621, 1990). Only to tell which joint turns: the model has its own."""


@dataclass(frozen=True, kw_only=True)
class Standing:
    """A posture in which the person stands still."""

    speed: float
    """m/s of the still window."""
    sway: float
    """m, over the whole recording."""
    start: float
    """s."""
    stop: float
    """s."""
    worn: MarkerSet
    """The set as this recording shows it worn."""
    landmarks: dict[str, Array]
    """Name -> (3,) m."""
    stance: Stance | None
    """For turns of segments against it; None without ASIS."""

    @property
    def throughout(self) -> bool:
        """Whether the whole recording stands, and not a part of it only."""
        return self.sway <= STAYS_M


def standing(recording: Recording, marker_set: MarkerSet) -> tuple[Standing | None, str]:
    """The standing posture, or None and why there is none."""
    if len(recording.time) < 2:
        return None, "a single frame"
    recording = complete_static(recording, marker_set)
    marker_set = worn(marker_set, recording)
    try:
        window = still_window(recording, marker_set.labels)
    except InputError as fault:
        return None, str(fault).split(": ")[-1]
    points = positions(recording, marker_set, window.frames)
    landmarks = _landmarks(recording, marker_set, window.frames, points)
    why = _not_upright(points, landmarks, marker_set)
    if why:
        return None, why
    return Standing(
        speed=window.speed,
        sway=sway(recording, marker_set),
        start=window.start,
        stop=window.stop,
        worn=marker_set,
        landmarks=landmarks,
        stance=rough_stance(points, landmarks, marker_set),
    ), ""


def positions(recording: Recording, marker_set: MarkerSet, frames: slice) -> dict[str, Array]:
    """Marker of the set -> (3,) m, mean over frames; those that were seen."""
    out = {}
    wanted = set(marker_set.labels)
    for i, label in enumerate(recording.labels):
        if label not in wanted:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # all NaN: not seen
            mean = np.nanmean(recording.markers[frames, i], axis=0)
        if np.isfinite(mean).all():
            out[label] = mean
    return out


def _landmarks(
    recording: Recording, marker_set: MarkerSet, frames: slice, points: dict[str, Array]
) -> dict[str, Array]:
    """Landmarks as the model will have them; where it cannot be made, those whose markers are there."""
    try:
        return dict(static_posture(recording, marker_set, frames).landmarks)
    except InputError:
        whole = {n: m for n, m in marker_set.landmarks.items() if all(label in points for label in m)}
        return {name: np.mean([points[label] for label in labels], axis=0) for name, labels in whole.items()}


def middles(points: dict[str, Array], marker_set: MarkerSet) -> dict[str, Array]:
    """Segment -> (3,) m, middle of its markers."""
    groups: dict[str, list[Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            groups.setdefault(segment, []).append(points[label])
    return {segment: np.mean(found, axis=0) for segment, found in groups.items()}


def _not_upright(points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet) -> str:
    """Why a posture is not standing; empty where it may be."""
    middle = middles(points, marker_set)
    if "pelvis" not in middle:
        return "no marker of the pelvis is seen while nothing moves"
    feet = [middle[f"foot_{side}"] for side in SIDES if f"foot_{side}" in middle]
    if len(feet) < 2:
        return "not both feet are seen while nothing moves"
    if abs(feet[0][1] - feet[1][1]) > LEVEL_M:
        return f"one foot is {abs(feet[0][1] - feet[1][1]):.2f} m above the other while nothing moves"
    straight = []
    for side in SIDES:
        hip, knee, ankle = (landmarks.get(f"{name}_{side}") for name in ("asis", "knee_lat", "ankle_lat"))
        if hip is not None and knee is not None and ankle is not None:
            way = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
            straight.append(float(hip[1] - ankle[1]) / way)
    height = float(middle["pelvis"][1] - np.mean(feet, axis=0)[1])
    if straight and min(straight) < STRAIGHT:
        return f"the legs are bent or not upright: the pelvis is at {100 * min(straight):.0f} % of their length"
    if height < LOW_M:
        for factor, units in TOO_SMALL.items():
            if LOW_M <= factor * height <= HIGH_M:
                return f"lengths look {factor} times too small: {units}"
        return f"the pelvis is {height:.2f} m above the feet while nothing moves"
    return ""


def sway(recording: Recording, marker_set: MarkerSet) -> float:
    """m, RMS distance of the markers from their mean places; of pelvis and feet the one that moves most."""
    segments = marker_set.segment_of
    out: dict[str, list[float]] = {}
    for i, label in enumerate(recording.labels):
        segment = segments.get(label, "")
        path = recording.markers[:, i][np.isfinite(recording.markers[:, i]).all(axis=1)]
        if segment.split("_")[0] in ("pelvis", "foot") and len(path):
            away = float(np.sqrt(np.mean(np.sum((path - path.mean(axis=0)) ** 2, axis=1))))
            out.setdefault(segment, []).append(away)
    return max((float(np.median(found)) for found in out.values()), default=np.inf)


def rough_stance(points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet) -> Stance | None:
    """The posture as turns of segments are told against, with joint centres good to some centimetres."""
    if not {"asis_r", "asis_l"} <= set(landmarks):
        return None
    wide = float(np.linalg.norm(landmarks["asis_r"] - landmarks["asis_l"]))
    right = across(landmarks["asis_r"] - landmarks["asis_l"], UP)
    axes = np.vstack([np.cross(UP, right), UP, right])
    by_segment: dict[str, dict[str, Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            by_segment.setdefault(segment, {})[label] = axes @ points[label]
    turned = {name: axes @ at for name, at in landmarks.items()}
    centres = {}
    for sign, side in zip((1.0, -1.0), SIDES, strict=True):
        centres[f"hip_{side}"] = turned[f"asis_{side}"] + wide * BELL_HIP * [1.0, 1.0, -sign]
        for joint in ("knee", "ankle"):
            if f"{joint}_lat_{side}" in turned:
                medial = turned.get(f"{joint}_med_{side}", turned[f"{joint}_lat_{side}"])
                centres[f"{joint}_{side}"] = 0.5 * (turned[f"{joint}_lat_{side}"] + medial)
    return Stance(points=by_segment, centres=centres, landmarks=turned)
