"""What a recording shows: standing, walking, one joint that moves alone, any other activity, or
something else.

Standing is: a still window; knees not bent far (the pelvis is nearly as high above the ankles as
the legs are long); both feet at one height. A walk may hold a still window too; it is a worse
static trial than one that only stands. Walking is seen by the feet: from the pelvis, along where it
faces, one foot goes back while the other goes forth, over the ground or on a treadmill. One joint
alone is seen by how far the joints turn about their mean postures (`quality/trial_role.py`), while
pelvis and other leg stay. Who runs, climbs, squats, rises or jumps moves the whole body.
"""

import warnings
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import estimate_ground_velocity
from gaitcal.errors import InputError
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.io.segment_poses import make_upright_posture
from gaitcal.model import linkage, segment_frames
from gaitcal.model.landmarks import measure_static_posture
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.preprocess.clean_trial import remove_outliers
from gaitcal.preprocess.joint_links import compute_joint_links
from gaitcal.preprocess.marker_clusters import UP, Stance, fit_clusters
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT
from gaitcal.quality.trial_role import LEAD, MOVES_RAD, STEPS_RAD, TRAVEL_M

STRAIGHT = 0.8
"""Height of the pelvis over the ankles as a share of the way over the knees: 0.97 to 1.00 in
standing, 0.94 with knees bent by 40 deg, 0.7 in sitting."""
LEVEL_M = 0.08  # Difference in height of the two feet's middles: a foot is lifted from there on
LOW_M, HIGH_M = 0.3, 1.5
"""m, from the pelvis to the feet of a person who stands: from child to tall adult it is less than a
power of ten.
"""
UNITS = {
    1000: ("m", "mm"),
    100: ("m", "cm"),
    10: ("cm", "mm"),
}  # Longer and shorter unit of files, and their ratio
STAYS_M = (
    0.03  # RMS distance of pelvis and feet from their mean places, in a recording that only stands
)
BELL_HIP = np.array([-0.19, -0.30, 0.14])
"""Hip centre from the ASIS as a share of their distance: forward, up, inward (Bell, Pedersen and
Brand, J Biomech 23:617-621, 1990). Only to tell which joint turns: the model has its own."""


@dataclass(frozen=True, kw_only=True)
class StandingPosture:
    """A posture in which the person stands still."""

    speed: float  # m/s of the still window
    sway: float  # m, over the whole recording
    start: float  # s
    stop: float  # s
    marker_set: MarkerSet  # The set as this recording shows it worn
    landmarks: dict[str, Array]  # Name -> (3,) m
    stance: Stance | None  # For turns of segments against it; None without ASIS

    @property
    def throughout(self) -> bool:
        """Whether the whole recording stands, and not a part of it only."""
        return self.sway <= STAYS_M


def detect_standing(
    recording: Recording, marker_set: MarkerSet
) -> tuple[StandingPosture | None, str]:
    """The standing posture, or None and why there is none; that of segment poses whatever the
    person does.
    """
    moving, recording = recording, complete_static(make_upright_posture(recording), marker_set)
    marker_set = resolve_marker_set(marker_set, recording)
    try:
        window = find_still_window(recording, marker_set.labels)
    except InputError as fault:
        return None, str(fault).split(": ")[-1]
    points = _average_positions(recording, marker_set, window.frames)
    landmarks = _measure_landmarks(recording, marker_set, window.frames, points)
    why = _check_upright(points, landmarks, marker_set)
    if why:
        return None, why
    return StandingPosture(
        speed=window.speed,
        sway=measure_sway(moving, marker_set),
        start=window.start,
        stop=window.stop,
        marker_set=marker_set,
        landmarks=landmarks,
        stance=estimate_stance(points, landmarks, marker_set),
    ), ""


def _average_positions(
    recording: Recording, marker_set: MarkerSet, frames: slice
) -> dict[str, Array]:
    """Marker of the set -> (3,) m, mean over frames; those that were seen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all NaN: not seen
        means = {
            label: np.nanmean(recording.markers[frames, i], axis=0)
            for i, label in enumerate(recording.labels)
        }
    return {
        label: m
        for label, m in means.items()
        if label in marker_set.labels and np.isfinite(m).all()
    }


def _measure_landmarks(
    recording: Recording, marker_set: MarkerSet, frames: slice, points: dict[str, Array]
) -> dict[str, Array]:
    """Landmarks as the model will have them; where it cannot be made, those whose markers are
    there.
    """
    try:
        return dict(measure_static_posture(recording, marker_set, frames).landmarks)
    except InputError:
        whole = {
            n: m for n, m in marker_set.landmarks.items() if all(label in points for label in m)
        }
        return {
            name: np.mean([points[label] for label in labels], axis=0)
            for name, labels in whole.items()
        }


def _check_upright(
    points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet
) -> str:
    """Why a posture is not standing; empty where it may be."""
    groups: dict[str, list[Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            groups.setdefault(segment, []).append(points[label])
    middle = {segment: np.mean(found, axis=0) for segment, found in groups.items()}
    if "pelvis" not in middle:
        return "no marker of the pelvis is seen while nothing moves"
    feet = [middle[f"foot_{side}"] for side in linkage.SIDES if f"foot_{side}" in middle]
    if len(feet) < 2:
        return "not both feet are seen while nothing moves"
    if abs(feet[0][1] - feet[1][1]) > LEVEL_M:
        return (
            f"one foot is {abs(feet[0][1] - feet[1][1]):.2f} m above the other while nothing moves"
        )
    straight = []
    for side in linkage.SIDES:
        hip, knee, ankle = (
            landmarks.get(f"{name}_{side}") for name in ("asis", "knee_lat", "ankle_lat")
        )
        if hip is not None and knee is not None and ankle is not None:
            way = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
            straight.append(float(hip[1] - ankle[1]) / way)
    height = float(middle["pelvis"][1] - np.mean(feet, axis=0)[1])
    if straight and min(straight) < STRAIGHT:
        return (
            f"the legs are bent or not upright: the pelvis is at {100 * min(straight):.0f} % of "
            "their length"
        )
    if height < LOW_M:
        return f"the pelvis is {height:.2f} m above the feet while nothing moves"
    return ""


def check_units(recording: Recording, marker_set: MarkerSet) -> str:
    """Say by which power of ten lengths are wrong, whatever the person does; empty where they are
    those of a body.
    """
    pelvis, *feet = (
        compute_segment_middle(recording, marker_set, name)
        for name in ("pelvis", "foot_r", "foot_l")
    )
    away = np.concatenate([np.linalg.norm(foot - pelvis, axis=1) for foot in feet])
    away = away[np.isfinite(away)]
    reach = float(np.percentile(away, 95.0)) if len(away) else np.nan
    if LOW_M <= reach <= HIGH_M:
        return ""
    for ratio, (longer, shorter) in UNITS.items():
        for factor, how, found, said in (
            (ratio, "small", longer, shorter),
            (1 / ratio, "large", shorter, longer),
        ):
            if LOW_M <= factor * reach <= HIGH_M:
                fault = (
                    f"lengths look {ratio} times too {how}: {found} under a header that says {said}"
                )
                return f"{fault}; declare the unit that the numbers have"
    return ""


def measure_sway(recording: Recording, marker_set: MarkerSet) -> float:
    """m, RMS distance of the markers from their mean places; of pelvis and feet the one that moves
    most.
    """
    segments = marker_set.segment_of
    out: dict[str, list[float]] = {}
    for i, label in enumerate(recording.labels):
        segment = segments.get(label, "")
        path = recording.markers[:, i][np.isfinite(recording.markers[:, i]).all(axis=1)]
        if segment.split("_")[0] in ("pelvis", "foot") and len(path):
            away = float(np.sqrt(np.mean(np.sum((path - path.mean(axis=0)) ** 2, axis=1))))
            out.setdefault(segment, []).append(away)
    return max((float(np.median(found)) for found in out.values()), default=np.inf)


def estimate_stance(
    points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet
) -> Stance | None:
    """The posture as turns of segments are told against, with joint centres good to some
    centimetres.
    """
    if not {"asis_r", "asis_l"} <= set(landmarks):
        return None
    wide = float(np.linalg.norm(landmarks["asis_r"] - landmarks["asis_l"]))
    right = segment_frames.project_across(landmarks["asis_r"] - landmarks["asis_l"], UP)
    axes = np.vstack([np.cross(UP, right), UP, right])
    by_segment: dict[str, dict[str, Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            by_segment.setdefault(segment, {})[label] = axes @ points[label]
    turned = {name: axes @ at for name, at in landmarks.items()}
    centres = {}
    for sign, side in zip((1.0, -1.0), linkage.SIDES, strict=True):
        centres[f"hip_{side}"] = turned[f"asis_{side}"] + wide * BELL_HIP * [1.0, 1.0, -sign]
        for joint in ("knee", "ankle"):
            if f"{joint}_lat_{side}" in turned:
                medial = turned.get(f"{joint}_med_{side}", turned[f"{joint}_lat_{side}"])
                centres[f"{joint}_{side}"] = 0.5 * (turned[f"{joint}_lat_{side}"] + medial)
    return Stance(points=by_segment, centres=centres, landmarks=turned)


OPPOSITE = (
    -0.4
)  # Correlation of the two feet's places, forward of the pelvis: -0.7 to -1.0 in walks
TURNING_DEG = 0.5  # RMS from which a joint is named among those that turn
SWING_M = 0.05
"""Standard deviation of a foot's place, forward of the pelvis: 0.15 to 0.25 m in walks, 0.09 m in
children's.
"""
EVEN = 0.35  # The less moving foot's standard deviation as a share of the other's
CLIMB_M = 0.25  # Net rise or fall of the pelvis: stairs, or lying down
CROUCH_M = 0.12
"""Range of the pelvis' height (5th to 95th percentile) in a trial of one joint: more is a squat or
sitting down.
"""
SHORTEST_S, FEWEST_FRAMES = 0.3, 15  # Of a recording in which somebody moves
FLYING, FLIGHT = 0.2, 0.05
"""Part of the fastest marker's speed at which every marker of both feet moves in flight; share of
frames from which somebody runs: walking has none."""
UP_M = 0.02  # m over where it mostly rests, above which a marker of a foot is in the air
CLEAR_LEAD = 1.6  # How many times the next joint the moving one must turn to be beyond doubt


class MovementKind(Enum):
    """What a recording shows."""

    STANDS = "stands"
    WALKS = "walks"
    ONE_JOINT = "moves one joint"
    MOVES = "moves the whole body"
    OTHER = "moves otherwise"
    NOTHING = "shows too little"


@dataclass(frozen=True, kw_only=True)
class RecordedMovement:
    """What a recording shows, and by what that was told."""

    kind: MovementKind
    joint: str = ""  # `hip_r`, ...: of a trial of one joint
    evidence: str  # In words, with numbers
    certain: bool = True  # Whether the figures are far from the limits


def classify_movement(
    recording: Recording,
    marker_set: MarkerSet,
    posture: StandingPosture | None,
    reference: Stance | None,
) -> RecordedMovement:
    """What a recording shows.

    `posture`: the recording's own, where the person stands in it.
    `reference`: of the static trial, whose segments turn in this one; None where there is none.
    """
    recording, _ = remove_outliers(recording, marker_set.segment_of)
    time = recording.time
    if posture is not None and posture.throughout:
        words = f"still to {1e3 * posture.speed:.0f} mm/s, upright, {time[-1] - time[0]:.1f} s"
        words = words if len(time) > 1 else "upright in its one frame"
        return RecordedMovement(kind=MovementKind.STANDS, evidence=words)
    if len(time) < FEWEST_FRAMES or time[-1] - time[0] < SHORTEST_S:
        return RecordedMovement(
            kind=MovementKind.NOTHING, evidence=f"{len(time)} frames, too short to tell"
        )
    pelvis = compute_segment_middle(recording, marker_set, "pelvis")
    feet = [compute_segment_middle(recording, marker_set, f"foot_{side}") for side in linkage.SIDES]
    walk = _classify_walk(pelvis, feet, _estimate_facing(recording, marker_set, reference, pelvis))
    if walk is not None:
        shows, evidence, certain = walk
        if (
            shows is MovementKind.WALKS
            and (share := _measure_flight(recording, marker_set)) > FLIGHT
        ):
            shows, evidence = (
                MovementKind.MOVES,
                f"{evidence}, and both feet fly in {100 * share:.0f} % of the frames",
            )
        return RecordedMovement(kind=shows, evidence=evidence, certain=certain)
    turns: dict[str, float] = {}
    if reference is not None:
        clusters = fit_clusters(
            recording,
            reference,
            marker_set.landmarks,
            lambda m: marker_set.weight(m) > NEGLIGIBLE_WEIGHT,
        )
        turns = {
            joint: link.rms
            for joint, link in compute_joint_links(clusters, reference.centres).items()
        }
    return _classify_joint_motion(pelvis, turns, measure_sway(recording, marker_set))


def compute_segment_middle(recording: Recording, marker_set: MarkerSet, segment: str) -> Array:
    """(nf, 3) m, middle of the markers of a segment that are seen most, in the frames with all of
    them; else NaN.
    """
    labels = (*marker_set.tracking.get(segment, ()), *marker_set.static_only.get(segment, ()))
    columns = [i for i, label in enumerate(recording.labels) if label in labels]
    seen = np.isfinite(recording.markers[:, columns]).all(axis=2)
    if not columns or not seen.any():
        return np.full((len(recording.time), 3), np.nan)
    shares = seen.mean(axis=0)
    kept = [c for c, share in zip(columns, shares, strict=True) if share >= 0.8 * shares.max()]
    out: Array = recording.markers[:, kept].mean(axis=1)
    return out


def _measure_flight(recording: Recording, marker_set: MarkerSet) -> float:
    """Share of the frames in which no marker of either foot is at rest or near the ground: none in
    walking.
    """
    labels = [
        m
        for side in linkage.SIDES
        for m in marker_set.tracking.get(f"foot_{side}", ())
        if m in recording.labels
    ]
    points = recording.markers[:, [recording.labels.index(m) for m in labels]]
    if not labels:
        return 0.0
    velocity = np.gradient(points, recording.time, axis=0)
    speed = np.linalg.norm(velocity - estimate_ground_velocity(points, velocity), axis=2)
    seen = np.isfinite(speed).all(axis=1)
    if not seen.any():
        return 0.0
    moving = speed[seen].min(axis=1) > FLYING * float(np.percentile(speed[seen].max(axis=1), 90))
    heights = points[seen, :, 1]  # of a belt that stops, feet on it move, too
    up = (heights > np.percentile(heights, 5, axis=0) + UP_M).all(axis=1)
    return float(np.mean(moving & up))


def _estimate_facing(
    recording: Recording, marker_set: MarkerSet, reference: Stance | None, pelvis: Array
) -> Array | None:
    """(nf, 2) where the pelvis faces, x and z; without a static trial the way that it goes; None
    where neither.
    """
    if reference is not None:
        alone = replace(reference, points={"pelvis": reference.points.get("pelvis", {})})
        clusters = fit_clusters(recording, alone, marker_set.landmarks, lambda m: True)
        if (cluster := clusters.get("pelvis")) is not None:
            facing = cluster.rotation[:, [0, 2], 0].copy()
            facing[~cluster.determined] = np.nan
            return facing
    known = np.flatnonzero(np.isfinite(pelvis).all(axis=1))
    way = pelvis[known[-1], [0, 2]] - pelvis[known[0], [0, 2]] if len(known) else np.zeros(2)
    return np.tile(way, (len(pelvis), 1)) if np.linalg.norm(way) > TRAVEL_M else None


def _classify_walk(
    pelvis: Array, feet: list[Array], facing: Array | None
) -> tuple[MovementKind, str, bool] | None:
    """Walking, or going about otherwise; None where the body stays."""
    known: BoolArray = np.asarray(np.isfinite(pelvis).all(axis=1))
    if known.sum() < FEWEST_FRAMES:
        return None
    middle = pelvis[known]
    travel = float(np.linalg.norm(np.ptp(middle[:, [0, 2]], axis=0)))
    rise = float(middle[-1, 1] - middle[0, 1])
    if abs(rise) > CLIMB_M:
        return (
            MovementKind.MOVES,
            f"the pelvis ends {abs(rise):.2f} m {'higher' if rise > 0 else 'lower'}",
            True,
        )
    if facing is not None:
        both = (
            known
            & np.isfinite(feet[0]).all(axis=1)
            & np.isfinite(feet[1]).all(axis=1)
            & np.isfinite(facing[:, 0])
        )
        if both.sum() >= FEWEST_FRAMES:
            unit = facing[both] / np.linalg.norm(facing[both], axis=1, keepdims=True)
            right, left = (
                np.sum((foot[both] - pelvis[both])[:, [0, 2]] * unit, axis=1) for foot in feet
            )
            swing = sorted([float(right.std()), float(left.std())])
            together = float(np.corrcoef(right, left)[0, 1]) if swing[0] > 1e-6 else 0.0
            if together < OPPOSITE and swing[1] > SWING_M and swing[0] > EVEN * swing[1]:
                where = f"over {travel:.1f} m" if travel > TRAVEL_M else "on the spot (treadmill?)"
                words = f"the feet go to and fro in turn (correlation {together:.2f}), {where}"
                return (
                    MovementKind.WALKS,
                    words,
                    together < 1.5 * OPPOSITE and swing[0] > 2 * EVEN * swing[1],
                )
            if travel > TRAVEL_M:
                return (
                    MovementKind.MOVES,
                    f"the body goes {travel:.1f} m, but not with one foot after the other",
                    False,
                )
    if travel > TRAVEL_M:
        return (
            MovementKind.OTHER,
            f"the body goes {travel:.1f} m, but not both feet can be followed",
            False,
        )
    return None


def _classify_joint_motion(pelvis: Array, turns: dict[str, float], sway: float) -> RecordedMovement:
    """One joint alone, or something else."""
    ranked = sorted(turns, key=lambda joint: -turns[joint])
    degrees = {joint: np.rad2deg(turns[joint]) for joint in ranked}
    turning = [joint for joint in ranked[:3] if degrees[joint] >= TURNING_DEG] or ranked[:1]
    words = ", ".join(f"{joint} {degrees[joint]:.0f}" for joint in turning)
    said = (
        f"joints turn by {words} deg RMS"
        if words
        else "no joint can be followed (markers, or no static trial)"
    )
    other = RecordedMovement(kind=MovementKind.OTHER, evidence=said)
    if not ranked:
        return other
    first = ranked[0]
    opposite = "l" if first.endswith("r") else "r"
    steps = [turns.get(f"{joint}_{opposite}", 0.0) for joint in ("hip", "knee")]
    heights = pelvis[np.isfinite(pelvis).all(axis=1), 1]
    crouch = float(np.diff(np.percentile(heights, (5, 95)))[0]) if len(heights) else 0.0
    lead = turns[first] / turns[ranked[1]] if len(ranked) > 1 and turns[ranked[1]] > 0 else np.inf
    if crouch > CROUCH_M:
        return replace(
            other,
            kind=MovementKind.MOVES,
            evidence=f"{said}, and the pelvis goes up and down {crouch:.2f} m",
        )
    if turns[first] < 2 * MOVES_RAD:
        return replace(
            other, evidence=f"hardly anything moves: {said}" + (", swaying" * (sway > STAYS_M))
        )
    if lead < LEAD or min(steps) > STEPS_RAD:
        return replace(other, kind=MovementKind.MOVES, certain=False)
    certain = lead >= CLEAR_LEAD and len(ranked) > 2
    return replace(other, kind=MovementKind.ONE_JOINT, joint=first, certain=certain)
