"""Find the recordings of a folder that show one person in one session.

Skin moves a marker relative to others of its segment by some millimetres; another person, or
markers attached again, differ in several segments by more. D(a, b) is the median distance of two
markers of a segment in a recording:

    d_s = max over pairs (a, b) of segment s of |D(a, b) - D'(a, b)|

Within sessions of eight people the second largest d_s of pelvis and legs is at most 9 mm, between
people at least 11 mm.

The soft tissue artefact depends on flexion. D is therefore the median over the frames in which the
leg is about as straight as it ever is in that recording: its length from pelvis to foot is at least
cos(NEAR_RAD / 2) of the largest one. If that posture is far from the other recording's, as in a
lunge, the limits are widened by the soft tissue artefact between both.

Markerless points (`model/subject_model.py`) show bones, from joint to joint: corners of a pose keep
their distances in any person. Their errors sigma last for a time tau each, so that a median over T
has the error

    e = sqrt(2) sigma / sqrt(max(T / tau, 1)),

by which the limits are widened: to (limit^2 + z^2 (e^2 + e'^2))^1/2, z = 1.96.

A folder may contain two people, or one person on two days. Each static trial collects the
recordings with the same marker positions; the largest such group is the session, and the others
keep the reason. If one swap of labels (any two of pelvis and legs, or all of the right with those
of the left) explains the difference, the recording stays in the study, and the checks report the
swap.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.soft_tissue_artefact import SIZES
from gaitcal.errors import differ_by_side
from gaitcal.intake.trial_movement import StandingPosture, compute_segment_middle, detect_standing
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import has_key_points, has_poses
from gaitcal.model.linkage import LOWER_BODY, SIDES
from gaitcal.model.marker_set import REQUIRED, MarkerSet
from gaitcal.preprocess.marker_clusters import NEAR_RAD, NEAREST_PERCENT, compute_tissue_spread
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT

APART_M = 0.015
"""m, second largest d_s from which marker positions differ: one detached marker affects only one
segment.
"""
ALL_APART_M = 0.008
"""m, median d_s from which they differ, too."""
FEWEST_DISTANCE_FRAMES = 5
MOST_FRAMES = 500
"""Frames, evenly spread, for a median distance."""
FEWEST_COMMON = 4
"""Markers by which two recordings are compared."""
SAME_M = {True: 0.00015, False: 0.002}
"""m, RMS difference, frame by frame, of a recording and its copy: of a posture, where only rounding
differs, and of a movement, where one may be filtered. No two walks agree to 2 mm in the same
frames; postures of one person may."""
MOVES_M = 0.01
"""m, standard deviation of a marker's distance from the centroid from which a recording is a
movement."""

DOUBT = 1.96
"""z of 95 %."""


@dataclass(frozen=True)
class Distances:
    """Distances between the points of one recording."""

    medians: Mapping[frozenset[str], float]
    """Two labels -> median distance (m)."""
    error: float = 0.0
    """m, e of markerless points."""
    extension: Mapping[str, float] = field(default_factory=dict)
    """Side -> length of the leg (m), from pelvis to foot, where the distances were measured."""


def measure_pair_distances(recording: Recording, marker_set: MarkerSet) -> Distances:
    """Measure the distances between markers of pelvis and legs, within segments and across them."""
    column = {label: i for i, label in enumerate(recording.labels)}
    worn = sorted(
        {
            label
            for group in _list_tracked_labels(marker_set, recording.labels).values()
            for label in group
        }
    )
    markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)]
    straight = _find_straight_legs(recording, marker_set) if marker_set.noise is None else {}
    segment_of = marker_set.segment_of
    out: dict[frozenset[str], float] = {}
    for a, b in combinations(worn, 2):
        distance = np.linalg.norm(markers[:, column[a]] - markers[:, column[b]], axis=1)
        # with a straight leg, if that is visible
        side = segment_of.get(a, "")[-1:]
        near = distance[straight[side][0]] if side in straight else distance
        distance = near if np.isfinite(near).sum() >= FEWEST_DISTANCE_FRAMES else distance
        if np.isfinite(distance).sum() >= min(FEWEST_DISTANCE_FRAMES, len(distance)):
            out[frozenset((a, b))] = float(np.nanmedian(distance))
    noise = marker_set.noise
    if noise is None:
        return Distances(out, extension={side: length for side, (_, length) in straight.items()})
    looks = max(float(recording.time[-1] - recording.time[0]) / noise.memory_s, 1.0)
    # the joint of a pose is the mean of four corners
    corners = 4.0 if has_poses(recording.labels) and not has_key_points(recording.labels) else 1.0
    return Distances(out, 1e-3 * noise.size_mm * float(np.sqrt(2.0 / (looks * corners))))


def _find_straight_legs(
    recording: Recording, marker_set: MarkerSet
) -> dict[str, tuple[BoolArray, float]]:
    """Find the frames in which each leg is about as straight as ever, and its length (m)."""
    out: dict[str, tuple[BoolArray, float]] = {}
    pelvis = compute_segment_middle(recording, marker_set, "pelvis")
    step = max(1, len(recording.markers) // MOST_FRAMES)
    for side in SIDES:
        foot = compute_segment_middle(recording, marker_set, f"foot_{side}")
        length = np.linalg.norm(foot - pelvis, axis=1)[::step]
        if np.isfinite(length).sum() >= FEWEST_DISTANCE_FRAMES:
            longest = np.nanpercentile(length, 100.0 - NEAREST_PERCENT)
            near = np.nan_to_num(length) >= longest * np.cos(0.5 * NEAR_RAD)
            out[side] = near, float(np.median(length[near]))
    return out


def _list_tracked_labels(marker_set: MarkerSet, labels: Iterable[str]) -> dict[str, list[str]]:
    """List the labels that determine the pose of each segment of pelvis and legs.

    `labels`: of a recording.
    """
    available = set(labels)
    out: dict[str, list[str]] = {}
    has_joint_centres = marker_set.noise is not None and "hjc_r" in marker_set.landmarks
    for segment in LOWER_BODY:
        if has_joint_centres:
            ends = _list_bone_ends(segment)
            on_ends = {m for name in ends for m in marker_set.landmarks.get(name, ())}
            out[segment] = sorted(available & on_ends)
            continue
        worn = {*marker_set.tracking.get(segment, ()), *marker_set.optional.get(segment, ())}
        out[segment] = sorted(
            m for m in worn & available if marker_set.weight(m) > NEGLIGIBLE_WEIGHT
        )
    return out


def _list_bone_ends(segment: str) -> tuple[str, ...]:
    """List the landmarks at the ends of a segment's bone; none of the talus."""
    kind, _, side = segment.partition("_")
    ends = {
        "thigh": ("hjc", "knee_lat"),
        "shank": ("knee_lat", "ankle_lat"),
        "foot": ("ankle_lat", "toe"),
    }
    if kind == "pelvis":
        return ("hjc_r", "hjc_l")
    return tuple(f"{end}_{side}" for end in ends.get(kind, ()))


def _compare_by_segment(
    one: Distances, other: Distances, marker_set: MarkerSet
) -> dict[str, float]:
    """Compare the distances of two recordings within each segment.

    `one`, `other`: of `measure_pair_distances`. Returns: segment -> d_s (m); segments without a
    common pair are left out.
    """
    common = set(one.medians) & set(other.medians)
    worn = _list_tracked_labels(marker_set, {label for pair in common for label in pair})
    out: dict[str, float] = {}
    for segment, labels in worn.items():
        pairs = [pair for pair in map(frozenset, combinations(labels, 2)) if pair in common]
        if pairs:
            out[segment] = max(abs(one.medians[pair] - other.medians[pair]) for pair in pairs)
    return out


def describe_placement_difference(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """Describe by how much the marker positions of two recordings differ.

    `one`, `other`: of `measure_pair_distances`. Returns: empty if they may be the same.
    """
    by_segment = _compare_by_segment(one, other, marker_set)
    # segments with the largest difference first
    ranked = sorted(by_segment, key=lambda segment: (-by_segment[segment], segment))
    if len(ranked) < 2:
        return ""
    differ = [by_segment[segment] for segment in ranked]
    lengths = [
        sorted((one.extension[side], other.extension[side]))
        for side in one.extension.keys() & other.extension
    ]
    # knee flexion that shortens a leg of two equal parts by so much
    flexed = 2.0 * float(np.arccos(min((short / long for short, long in lengths), default=1.0)))
    # limits widened by soft tissue and by the errors of markerless points
    tissue = compute_tissue_spread(
        float(np.sqrt(2.0)) * max(size.per_marker for size in SIZES.values()), flexed - NEAR_RAD
    )
    doubt = DOUBT * float(np.linalg.norm([one.error, other.error, tissue]))
    is_small = differ[1] <= np.hypot(APART_M, doubt)
    if is_small and float(np.median(differ)) <= np.hypot(ALL_APART_M, doubt):
        return ""
    return "distances within segments differ: " + ", ".join(
        f"{s} {1e3 * by_segment[s]:.0f} mm" for s in ranked[:3]
    )


def is_same_recording(one: Recording, other: Recording) -> bool:
    """Return whether the shorter of two recordings is the other one or a part of it.

    Their axes and the order of their labels may differ.
    """
    common = sorted(set(one.labels) & set(other.labels))
    if len(common) < FEWEST_COMMON:
        return False
    short, long = sorted((one, other), key=lambda r: len(r.time))
    if abs(short.rate / long.rate - 1) > 0.01:
        return False
    a, b = (_measure_from_middle(recording, common) for recording in (short, long))
    # any start at which both agree in their common frames
    for start in _find_starts(a, b):
        part = b[start : start + len(a)]
        both = np.isfinite(a) & np.isfinite(part)
        if both.sum() < 0.5 * np.isfinite(a).sum() or not both.any():
            continue
        still = float(np.median(np.std(np.where(both, a, 0.0), axis=0))) < MOVES_M
        if float(np.sqrt(np.mean((a - part)[both] ** 2))) <= SAME_M[still]:
            return True
    return False


def _measure_from_middle(recording: Recording, labels: list[str]) -> Array:
    """Measure (nf, nl) m, the distances of markers from their mean, whatever the axes."""
    markers = recording.markers[:, [recording.labels.index(label) for label in labels]]
    out: Array = np.linalg.norm(markers - markers.mean(axis=1, keepdims=True), axis=2)
    return out


def _find_starts(short: Array, long: Array) -> list[int]:
    """Find frames of `long` at which `short` may begin, by three of its complete frames."""
    spare = len(long) - len(short)
    complete = np.flatnonzero(np.isfinite(short).all(axis=1))
    if spare == 0:
        return [0]
    starts = set()
    for frame in complete[[0, len(complete) // 2, -1]] if len(complete) else ():
        away = np.abs(long - short[frame]).mean(axis=1)
        if np.isfinite(away).any():
            starts.add(int(np.nanargmin(away)) - int(frame))
    return sorted(start for start in starts if 0 <= start <= spare)


WITHIN_M = 0.009
"""m, second largest d_s after the swap: the largest within a session of one person."""
REMAINS = 0.5
"""Share of the largest d_s that may be left: the swap must explain the difference."""
SIDES_EXCHANGED = "left and right"


def find_explaining_swap(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """Find the swap of labels in one of two recordings after which their marker positions agree.

    `one`, `other`: of `measure_pair_distances`. Returns: the swapped labels; empty if no swap
    explains the difference.
    """
    present = _compare_by_segment(one, other, marker_set)
    if len(present) < 2:
        return ""
    fits: list[tuple[float, str]] = []
    for name, swap in _list_swaps(marker_set, other):
        by_segment = _compare_by_segment(one, _swap_distances(other, swap), marker_set)
        left = sorted(by_segment.values(), reverse=True)
        median = sorted(left)[len(left) // 2]
        tight = left[0] <= min(APART_M, REMAINS * max(present.values())) and left[1] <= WITHIN_M
        if tight and median <= ALL_APART_M:
            fits.append((sum(left), name))
    return min(fits)[1] if fits else ""


def _list_swaps(
    marker_set: MarkerSet, distances: Distances
) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Generate swaps with their names: the two sides, then any two markers of pelvis and legs."""
    labels = sorted({label for pair in distances.medians for label in pair})
    of_sides = [(a, b) for a, b in combinations(labels, 2) if differ_by_side(a, b)]
    if of_sides:
        swap: dict[str, str] = {}
        for a, b in of_sides:
            swap |= {a: b, b: a}
        yield SIDES_EXCHANGED, swap
    worn = {label for group in _list_tracked_labels(marker_set, labels).values() for label in group}
    for a, b in combinations([label for label in labels if label in worn], 2):
        yield f"{a} and {b}", {a: b, b: a}


def _swap_distances(distances: Distances, swap: Mapping[str, str]) -> Distances:
    """Return the distances after a swap of labels."""
    medians = {}
    for pair, distance in distances.medians.items():
        medians[frozenset(swap.get(label, label) for label in pair)] = distance
    return replace(distances, medians=medians)


STATIC_WORD = re.compile(
    r"(static|stat(?![a-z])|(?<![a-z])cal(ib\w*)?(?![a-z])|stand|"
    r"(?<![a-z])(st|sc)(?![a-z])|pose|neutral|anatom)",
    re.I,
)
"""Words in the names of static trials; weak evidence."""
CLEAR_WORD = re.compile(r"(static|(?<![a-z])cal(ib\w*)?(?![a-z])|neutral|anatom)", re.IGNORECASE)
"""Those of them that are unambiguous."""
SHIFTS_M = 0.1
"""m, RMS distance from the mean position up to which foot or pelvis only shift; a step moves them
farther.
"""


@dataclass(frozen=True, kw_only=True)
class Session:
    """The recordings of one person with the markers at the same positions."""

    statics: tuple[int, ...]
    """Recordings that may be static trials, best first."""
    members: tuple[int, ...]
    postures: Mapping[int, StandingPosture]
    """Recording -> standing posture in it, if there is one."""
    only_standing: Mapping[int, tuple[str, ...]]
    """Static trial -> its markers that no moving recording has."""
    others: Mapping[int, str]
    """Recordings with the same labels that are not of this session -> why."""

    @property
    def marker_set(self) -> MarkerSet:
        """The marker set with the alternatives that the best static trial shows."""
        return self.postures[self.statics[0]].marker_set


def find_session(
    recordings: Mapping[int, Recording], stems: Mapping[int, str], marker_set: MarkerSet
) -> Session | None:
    """Find the largest session in recordings with the labels of a set.

    Parameters
    ----------
    recordings
        Number -> recording.
    stems
        Number -> file name without ending.
    marker_set
        The set.

    Returns
    -------
    Session or None
        None without a standing posture.
    """
    postures = {}
    for i, recording in recordings.items():
        posture, _ = detect_standing(recording, marker_set)
        if posture is not None:
            postures[i] = posture
    static_only = _find_static_only_labels(recordings, postures)
    candidates = _choose_static_candidates(recordings, stems, postures, static_only)
    if not candidates:
        return None

    def rank(i: int) -> tuple[object, ...]:
        missing = sum(name not in postures[i].landmarks for name in REQUIRED)
        declared = bool(recordings[i].facts.is_static)
        word = STATIC_WORD.search(stems[i]) is not None
        # a single frame does not show whether the person stands still
        single = len(recordings[i].time) == 1
        return (
            missing,
            single,
            not declared,
            -len(static_only[i]),
            not word,
            round(1e3 * postures[i].speed),
            stems[i].lower(),
            i,
        )

    ranked = sorted(candidates, key=rank)
    distances = {i: measure_pair_distances(r, marker_set) for i, r in recordings.items()}
    differences = {
        (i, j): _describe_other_markers(distances[i], distances[j], marker_set)
        for i in ranked
        for j in recordings
    }
    # each static trial collects the recordings with its marker positions; the largest group counts
    groups: dict[int, list[int]] = {i: [] for i in ranked}
    for (i, j), difference in differences.items():
        if not difference:
            groups[i].append(j)
    best = max(ranked, key=lambda i: (len(groups[i]), -ranked.index(i)))
    others = {}
    for j in (j for j in recordings if j not in groups[best]):
        statics = [i for i in ranked if i not in groups[best] and j in groups[i] and i != j]
        more = ""
        if statics:
            more = f"; its static trial is {stems[statics[0]]}: put both into a separate folder"
        others[j] = (
            f"another person, or markers attached again, compared with {stems[best]}: "
            f"{differences[best, j]}{more}"
        )
    return Session(
        statics=(best, *(i for i in ranked if i != best and i in groups[best])),
        members=tuple(groups[best]),
        postures=postures,
        only_standing=static_only,
        others=others,
    )


def _describe_other_markers(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """Describe different marker positions that no swap of labels explains; empty if the same."""
    difference = describe_placement_difference(one, other, marker_set)
    if difference and find_explaining_swap(one, other, marker_set):
        return ""
    return difference


def _choose_static_candidates(
    recordings: Mapping[int, Recording],
    stems: Mapping[int, str],
    postures: Mapping[int, StandingPosture],
    static_only: Mapping[int, tuple[str, ...]],
) -> list[int]:
    """Choose the recordings that may be static trials.

    Those that only stand; without any, those named static or with markers for the static trial
    only, of which a part stands; then those in which the person only shifts; then segment poses,
    which need no standing.
    """
    tiers: tuple[Callable[[int], bool], ...] = (
        lambda i: postures[i].throughout,
        lambda i: bool(
            CLEAR_WORD.search(stems[i]) or recordings[i].facts.is_static or static_only[i]
        ),
        lambda i: postures[i].sway <= SHIFTS_M,
        lambda i: has_poses(recordings[i].labels),
    )
    for tier in tiers:
        found = [i for i in postures if tier(i)]
        if found:
            return found
    return []


def _find_static_only_labels(
    recordings: Mapping[int, Recording], postures: Mapping[int, StandingPosture]
) -> dict[int, tuple[str, ...]]:
    """Find the labels of each standing recording that no moving recording has."""
    moving: set[str] = set()
    for i, recording in recordings.items():
        if i not in postures or not postures[i].throughout:
            moving.update(recording.labels)
    if not moving:
        return dict.fromkeys(postures, ())
    out = {}
    for i in postures:
        out[i] = tuple(label for label in recordings[i].labels if label not in moving)
    return out
