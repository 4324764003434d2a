"""Classify the movement of a recording: standing, walking, one joint, another activity, or other.

*Standing* needs a still window, knees that are not flexed much (the pelvis is nearly as high above
the ankles as the legs are long), and both feet at one height. A walk may contain a still window,
too; it is a worse static trial than one that only stands. *Walking* is detected by the feet:
relative to the pelvis and in its direction, one foot moves backward while the other one moves
forward, over ground or on a treadmill. A *single joint* is detected by the rotation of the joints
about their mean postures (`quality/trial_role.py`) while pelvis and other leg are still. Running,
climbing, squats, rising and jumps move the whole body.
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
"""Smallest height of the pelvis over the ankles as a share of the leg length: 0.97 to 1.00 in
standing, 0.94 with knees flexed by 40 deg, 0.7 in sitting."""
LEVEL_M = 0.08
"""m, largest difference in height of the two feet; beyond it one is lifted."""
LOW_M = 0.3
"""m, smallest distance from the pelvis to the feet of a standing person."""
HIGH_M = 1.5
"""m, largest distance: from child to tall adult it is less than a power of ten."""
UNITS = {1000: ("m", "mm"), 100: ("m", "cm"), 10: ("cm", "mm")}
"""Ratio -> longer and shorter unit of files."""
STAYS_M = 0.03
"""m, RMS distance of pelvis and feet from their mean positions in a recording that only stands."""
BELL_HIP = np.array([-0.19, -0.30, 0.14])
"""Hip centre from the ASIS as a share of their distance: forward, up, inward (Bell, Pedersen and
Brand, J Biomech 23:617-621, 1990). It serves only to find the joint that moves."""


@dataclass(frozen=True, kw_only=True)
class StandingPosture:
    """A posture in which the person stands still."""

    speed: float
    """m/s, in the still window."""
    sway: float
    """m, over the whole recording, see `_measure_sway`."""
    start: float
    """s, of the still window."""
    stop: float
    """s, of the still window."""
    marker_set: MarkerSet
    """The set with the alternatives that this recording shows."""
    landmarks: dict[str, Array]
    """Name -> (3,) m."""
    stance: Stance | None
    """For the rotations of segments in other recordings; None without ASIS."""

    @property
    def throughout(self) -> bool:
        """Whether the person stands in the whole recording."""
        return self.sway <= STAYS_M


def detect_standing(
    recording: Recording, marker_set: MarkerSet
) -> tuple[StandingPosture | None, str]:
    """Detect the standing posture in a recording.

    Parameters
    ----------
    recording
        With the labels of the set; of segment poses the upright posture is taken in any movement.
    marker_set
        The set.

    Returns
    -------
    posture : StandingPosture or None
    reason : str
        Why there is none; else empty.
    """
    moving, recording = recording, complete_static(make_upright_posture(recording), marker_set)
    marker_set = resolve_marker_set(marker_set, recording)
    try:
        window = find_still_window(recording, marker_set.labels)
    except InputError as fault:
        return None, str(fault).split(": ")[-1]
    points = _average_positions(recording, marker_set, window.frames)
    landmarks = _measure_landmarks(recording, marker_set, window.frames, points)
    reason = _check_upright(points, landmarks, marker_set)
    if reason:
        return None, reason
    return StandingPosture(
        speed=window.speed,
        sway=_measure_sway(moving, marker_set),
        start=window.start,
        stop=window.stop,
        marker_set=marker_set,
        landmarks=landmarks,
        stance=_estimate_stance(points, landmarks, marker_set),
    ), ""


def _average_positions(
    recording: Recording, marker_set: MarkerSet, frames: slice
) -> dict[str, Array]:
    """Average the positions (3,) m of the set's visible markers over frames."""
    with warnings.catch_warnings():
        # all NaN: not visible
        warnings.simplefilter("ignore", RuntimeWarning)
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
    """Measure the landmarks as the model will have them; else those whose markers are visible."""
    try:
        return dict(measure_static_posture(recording, marker_set, frames).landmarks)
    except InputError:
        out = {}
        for name, labels in marker_set.landmarks.items():
            if all(label in points for label in labels):
                out[name] = np.mean([points[label] for label in labels], axis=0)
        return out


def _check_upright(
    points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet
) -> str:
    """Return why a posture is not standing; empty if it may be."""
    # mean position of each segment's markers
    groups: dict[str, list[Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            groups.setdefault(segment, []).append(points[label])
    middle = {segment: np.mean(found, axis=0) for segment, found in groups.items()}
    if "pelvis" not in middle:
        return "no marker of the pelvis is visible in the still window"
    feet = [middle[f"foot_{side}"] for side in linkage.SIDES if f"foot_{side}" in middle]
    if len(feet) < 2:
        return "not both feet are visible in the still window"
    difference = abs(feet[0][1] - feet[1][1])
    if difference > LEVEL_M:
        return f"one foot is {difference:.2f} m above the other in the still window"
    # height of each leg over its length
    straight = []
    for side in linkage.SIDES:
        hip, knee, ankle = (
            landmarks.get(f"{name}_{side}") for name in ("asis", "knee_lat", "ankle_lat")
        )
        if hip is not None and knee is not None and ankle is not None:
            length = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
            straight.append(float(hip[1] - ankle[1]) / length)
    height = float(middle["pelvis"][1] - np.mean(feet, axis=0)[1])
    if straight and min(straight) < STRAIGHT:
        return (
            "the legs are flexed or not upright: the height of the pelvis is "
            f"{100 * min(straight):.0f} % of their length"
        )
    if height < LOW_M:
        return f"the pelvis is only {height:.2f} m above the feet in the still window"
    return ""


def check_units(recording: Recording, marker_set: MarkerSet) -> str:
    """Check whether lengths are wrong by a power of ten, in any movement.

    Parameters
    ----------
    recording
        With the labels of the set.
    marker_set
        The set.

    Returns
    -------
    str
        What is wrong and what to do; empty if the lengths are those of a body.
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
        for factor, error, actual, declared in (
            (ratio, "small", longer, shorter),
            (1 / ratio, "large", shorter, longer),
        ):
            if LOW_M <= factor * reach <= HIGH_M:
                return (
                    f"lengths appear {ratio} times too {error}: the numbers are in {actual}, the "
                    f"header declares {declared}; declare the unit of the numbers"
                )
    return ""


def _measure_sway(recording: Recording, marker_set: MarkerSet) -> float:
    """Measure the RMS distance of markers from their mean positions.

    Parameters
    ----------
    recording
        With the labels of the set.
    marker_set
        The set.

    Returns
    -------
    float
        m: the median over the markers of the segment, of pelvis and feet, that moves most.
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


def _estimate_stance(
    points: dict[str, Array], landmarks: dict[str, Array], marker_set: MarkerSet
) -> Stance | None:
    """Estimate the static posture, with joint centres accurate to some centimetres.

    `points`: marker -> (3,) m. `landmarks`: name -> (3,) m. Returns: None without both ASIS.
    """
    if not {"asis_r", "asis_l"} <= set(landmarks):
        return None
    asis_width = float(np.linalg.norm(landmarks["asis_r"] - landmarks["asis_l"]))
    right = segment_frames.project_across(landmarks["asis_r"] - landmarks["asis_l"], UP)
    axes = np.vstack([np.cross(UP, right), UP, right])
    by_segment: dict[str, dict[str, Array]] = {}
    for label, segment in marker_set.segment_of.items():
        if label in points:
            by_segment.setdefault(segment, {})[label] = axes @ points[label]
    in_axes = {name: axes @ position for name, position in landmarks.items()}
    # hip centres by regression, knees and ankles from their epicondyles and malleoli
    centres = {}
    for sign, side in zip((1.0, -1.0), linkage.SIDES, strict=True):
        centres[f"hip_{side}"] = in_axes[f"asis_{side}"] + asis_width * BELL_HIP * [1.0, 1.0, -sign]
        for joint in ("knee", "ankle"):
            if f"{joint}_lat_{side}" in in_axes:
                medial = in_axes.get(f"{joint}_med_{side}", in_axes[f"{joint}_lat_{side}"])
                centres[f"{joint}_{side}"] = 0.5 * (in_axes[f"{joint}_lat_{side}"] + medial)
    return Stance(points=by_segment, centres=centres, landmarks=in_axes)


OPPOSITE = -0.4
"""Largest correlation of the two feet's positions forward of the pelvis: -1.0 to -0.7 in walks."""
TURNING_DEG = 0.5
"""deg, RMS from which a joint is listed among those that rotate."""
SWING_M = 0.05
"""m, smallest standard deviation of a foot's position forward of the pelvis: 0.15 to 0.25 m in
walks, 0.09 m in those of children.
"""
EVEN = 0.35
"""Smallest ratio of the two feet's standard deviations."""
CLIMB_M = 0.25
"""m, net rise or fall of the pelvis on stairs or when lying down."""
CROUCH_M = 0.12
"""m, largest range of the pelvis height (5th to 95th percentile) in a functional trial: more is a
squat or sitting down.
"""
SHORTEST_S = 0.3
"""s, shortest recording of a movement."""
FEWEST_MOVEMENT_FRAMES = 15
"""Of a recording of a movement."""
FLYING = 0.2
"""Share of the fastest marker's speed that every foot marker exceeds in flight."""
FLIGHT = 0.05
"""Share of the frames in flight from which the movement is running: walking has none."""
UP_M = 0.02
"""m above its lowest position from which a foot marker is in the air."""
CLEAR_LEAD = 1.6
"""Ratio of the moving joint's rotation to the next one's from which it is certain."""


class MovementKind(Enum):
    """Kinds of movement."""

    STANDS = "stands"
    WALKS = "walks"
    ONE_JOINT = "moves one joint"
    MOVES = "moves the whole body"
    OTHER = "moves otherwise"
    NOTHING = "shows too little"


@dataclass(frozen=True, kw_only=True)
class RecordedMovement:
    """The movement of a recording, and the evidence for it."""

    kind: MovementKind
    joint: str = ""
    """`hip_r`, ...: of a functional trial."""
    evidence: str
    """A sentence with numbers."""
    certain: bool = True
    """Whether the figures are far from the limits."""


def classify_movement(
    recording: Recording,
    marker_set: MarkerSet,
    posture: StandingPosture | None,
    reference: Stance | None,
) -> RecordedMovement:
    """Classify the movement of a recording.

    Parameters
    ----------
    recording
        With the labels of the set.
    marker_set
        The set.
    posture
        Standing posture in this recording, if there is one.
    reference
        Of the static trial, from which rotations count; None without one.

    Returns
    -------
    RecordedMovement
    """
    recording, _ = remove_outliers(recording, marker_set.segment_of)
    time = recording.time
    if posture is not None and posture.throughout:
        evidence = f"still to {1e3 * posture.speed:.0f} mm/s, upright, {time[-1] - time[0]:.1f} s"
        if len(time) == 1:
            evidence = "upright in its only frame"
        return RecordedMovement(kind=MovementKind.STANDS, evidence=evidence)
    if len(time) < FEWEST_MOVEMENT_FRAMES or time[-1] - time[0] < SHORTEST_S:
        return RecordedMovement(
            kind=MovementKind.NOTHING, evidence=f"{len(time)} frames, too short to classify"
        )
    pelvis = compute_segment_middle(recording, marker_set, "pelvis")
    feet = [compute_segment_middle(recording, marker_set, f"foot_{side}") for side in linkage.SIDES]
    walk = _classify_walk(pelvis, feet, _estimate_facing(recording, marker_set, reference, pelvis))
    if walk is not None:
        kind, evidence, certain = walk
        share = _measure_flight(recording, marker_set) if kind is MovementKind.WALKS else 0.0
        if share > FLIGHT:
            kind = MovementKind.MOVES
            evidence = f"{evidence}, both feet in flight in {100 * share:.0f} % of the frames"
        return RecordedMovement(kind=kind, evidence=evidence, certain=certain)
    rotations: dict[str, float] = {}
    if reference is not None:
        clusters = fit_clusters(
            recording,
            reference,
            marker_set.landmarks,
            lambda m: marker_set.weight(m) > NEGLIGIBLE_WEIGHT,
        )
        rotations = {
            joint: link.rms
            for joint, link in compute_joint_links(clusters, reference.centres).items()
        }
    return _classify_joint_motion(pelvis, rotations, _measure_sway(recording, marker_set))


def compute_segment_middle(recording: Recording, marker_set: MarkerSet, segment: str) -> Array:
    """Compute the mean position of a segment's most visible markers.

    Parameters
    ----------
    recording
        With the labels of the set.
    marker_set
        The set.
    segment
        Of the model.

    Returns
    -------
    Array
        (nf, 3) m; NaN in frames in which one of these markers is not visible.
    """
    labels = (*marker_set.tracking.get(segment, ()), *marker_set.static_only.get(segment, ()))
    columns = [i for i, label in enumerate(recording.labels) if label in labels]
    visible = np.isfinite(recording.markers[:, columns]).all(axis=2)
    if not columns or not visible.any():
        return np.full((len(recording.time), 3), np.nan)
    shares = visible.mean(axis=0)
    kept = [c for c, share in zip(columns, shares, strict=True) if share >= 0.8 * shares.max()]
    out: Array = recording.markers[:, kept].mean(axis=1)
    return out


def _measure_flight(recording: Recording, marker_set: MarkerSet) -> float:
    """Measure the share of the frames in which no foot marker is at rest or near the ground."""
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
    visible = np.isfinite(speed).all(axis=1)
    if not visible.any():
        return 0.0
    # no foot marker is at rest
    moving = speed[visible].min(axis=1) > FLYING * float(
        np.percentile(speed[visible].max(axis=1), 90)
    )
    # the height, too: on a belt that stops, feet on the ground move
    heights = points[visible, :, 1]
    up = (heights > np.percentile(heights, 5, axis=0) + UP_M).all(axis=1)
    return float(np.mean(moving & up))


def _estimate_facing(
    recording: Recording, marker_set: MarkerSet, reference: Stance | None, pelvis: Array
) -> Array | None:
    """Estimate the direction (nf, 2) of the pelvis, x and z.

    Without a static trial it is the direction of progression; None without either.
    """
    if reference is not None:
        alone = replace(reference, points={"pelvis": reference.points.get("pelvis", {})})
        clusters = fit_clusters(recording, alone, marker_set.landmarks, lambda m: True)
        cluster = clusters.get("pelvis")
        if cluster is not None:
            facing = cluster.rotation[:, [0, 2], 0].copy()
            facing[~cluster.determined] = np.nan
            return facing
    known = np.flatnonzero(np.isfinite(pelvis).all(axis=1))
    if not len(known):
        return None
    path = pelvis[known[-1], [0, 2]] - pelvis[known[0], [0, 2]]
    return np.tile(path, (len(pelvis), 1)) if np.linalg.norm(path) > TRAVEL_M else None


def _classify_walk(
    pelvis: Array, feet: list[Array], facing: Array | None
) -> tuple[MovementKind, str, bool] | None:
    """Classify walking and other movements of the whole body; None if the body stays."""
    known: BoolArray = np.asarray(np.isfinite(pelvis).all(axis=1))
    if known.sum() < FEWEST_MOVEMENT_FRAMES:
        return None
    middle = pelvis[known]
    travel = float(np.linalg.norm(np.ptp(middle[:, [0, 2]], axis=0)))
    rise = float(middle[-1, 1] - middle[0, 1])
    if abs(rise) > CLIMB_M:
        return (
            MovementKind.MOVES,
            f"the pelvis ends {abs(rise):.2f} m {'higher' if rise > 0 else 'lower'} than it starts",
            True,
        )
    if facing is not None:
        both = (
            known
            & np.isfinite(feet[0]).all(axis=1)
            & np.isfinite(feet[1]).all(axis=1)
            & np.isfinite(facing[:, 0])
        )
        if both.sum() >= FEWEST_MOVEMENT_FRAMES:
            unit = facing[both] / np.linalg.norm(facing[both], axis=1, keepdims=True)
            # positions of the feet forward of the pelvis
            right, left = (
                np.sum((foot[both] - pelvis[both])[:, [0, 2]] * unit, axis=1) for foot in feet
            )
            swing = sorted([float(right.std()), float(left.std())])
            correlation = float(np.corrcoef(right, left)[0, 1]) if swing[0] > 1e-6 else 0.0
            if correlation < OPPOSITE and swing[1] > SWING_M and swing[0] > EVEN * swing[1]:
                where = f"over {travel:.1f} m" if travel > TRAVEL_M else "on the spot (treadmill?)"
                evidence = f"the feet move in alternation (correlation {correlation:.2f}), {where}"
                certain = correlation < 1.5 * OPPOSITE and swing[0] > 2 * EVEN * swing[1]
                return MovementKind.WALKS, evidence, certain
            if travel > TRAVEL_M:
                evidence = f"the body moves {travel:.1f} m, but the feet do not alternate"
                return MovementKind.MOVES, evidence, False
    if travel > TRAVEL_M:
        evidence = f"the body moves {travel:.1f} m, but not both feet are visible"
        return MovementKind.OTHER, evidence, False
    return None


def _classify_joint_motion(
    pelvis: Array, rotation_of: dict[str, float], sway: float
) -> RecordedMovement:
    """Classify the motion of one joint alone, or other movements.

    `rotation_of`: joint -> RMS rotation (rad).
    """
    # joints by their rotation, and those that are listed
    ranked = sorted(rotation_of, key=lambda joint: -rotation_of[joint])
    degrees = {joint: np.rad2deg(rotation_of[joint]) for joint in ranked}
    listed = [joint for joint in ranked[:3] if degrees[joint] >= TURNING_DEG] or ranked[:1]
    rotations = ", ".join(f"{joint} {degrees[joint]:.0f}" for joint in listed)
    evidence = "no joint rotation available (markers missing, or no static trial)"
    if rotations:
        evidence = f"joints rotate by {rotations} deg RMS"
    other = RecordedMovement(kind=MovementKind.OTHER, evidence=evidence)
    if not ranked:
        return other
    # signs of another movement: steps of the other leg, a crouch, a second joint
    first = ranked[0]
    opposite = "l" if first.endswith("r") else "r"
    steps = [rotation_of.get(f"{joint}_{opposite}", 0.0) for joint in ("hip", "knee")]
    heights = pelvis[np.isfinite(pelvis).all(axis=1), 1]
    crouch = float(np.diff(np.percentile(heights, (5, 95)))[0]) if len(heights) else 0.0
    lead = (
        rotation_of[first] / rotation_of[ranked[1]]
        if len(ranked) > 1 and rotation_of[ranked[1]] > 0
        else np.inf
    )
    if crouch > CROUCH_M:
        evidence = f"{evidence}, range of the pelvis height {crouch:.2f} m"
        return replace(other, kind=MovementKind.MOVES, evidence=evidence)
    if rotation_of[first] < 2 * MOVES_RAD:
        swaying = ", swaying" if sway > STAYS_M else ""
        return replace(other, evidence=f"hardly any movement: {evidence}{swaying}")
    if lead < LEAD or min(steps) > STEPS_RAD:
        return replace(other, kind=MovementKind.MOVES, certain=False)
    certain = lead >= CLEAR_LEAD and len(ranked) > 2
    return replace(other, kind=MovementKind.ONE_JOINT, joint=first, certain=certain)
