"""Which recordings of a folder show one person in one session: the static trials, and those with
markers as in them.

Skin moves a marker against another one of its segment by some millimetres; another person, or
markers put on anew, differ in several segments by more. D(a, b) is the median distance of two
markers of a segment in a recording:

    d_s = max over pairs (a, b) of segment s of |D(a, b) - D'(a, b)|

Within sessions of eight people the second largest d_s of pelvis and legs is at most 9 mm, between
people from 11 mm.

Soft tissue goes with flexion, so D is the median over the frames in which the leg is about as
straight as it ever is in that recording: e, from its hip to its foot, is at least cos(NEAR_RAD / 2)
of the longest. Where that is a posture far from the other recording's, as in a lunge that is held,
the limits are widened by what soft tissue does on the way.

Points that are no markers (`model/subject_model.py`) show bones, from joint to joint: corners of a
pose keep their distances whoever moves. Their errors sigma last for a time tau each, so that a
median over T errs by

    e = sqrt(2) sigma / sqrt(max(T / tau, 1)),

which the limits are widened by: to (limit^2 + z^2 (e^2 + e'^2))^1/2, z = 1.96.

A folder may hold two people, or one person on two days. Each static trial gathers the recordings
whose markers sit as in itself; the largest such group is the session, and the others keep their
reason. Where one exchange of labels (any two of pelvis and legs, or all of the right with those of
the left) explains the difference, it is no other person: the recording stays in the study, and the
checks find what is wrong with it.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.soft_tissue_artefact import SIZES
from gaitcal.errors import other_side
from gaitcal.intake.trial_movement import StandingPosture, compute_segment_middle, detect_standing
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import has_key_points, has_poses
from gaitcal.model.linkage import LOWER_BODY, SIDES
from gaitcal.model.marker_set import REQUIRED, MarkerSet
from gaitcal.preprocess.marker_clusters import NEAR_RAD, NEAREST_PERCENT, compute_tissue_spread
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT

APART_M = 0.015
"""Second largest d_s from which the markers are placed otherwise: one marker that fell off spoils
one segment only.
"""
ALL_APART_M = 0.008  # Median d_s from which they are, too
FEWEST_FRAMES = 5
MOST_FRAMES = 500  # Frames, evenly spread, that tell a median distance
FEWEST_COMMON = 4  # Markers by which two recordings are compared
SAME_M = {True: 0.00015, False: 0.002}
"""RMS difference of two recordings, frame by frame, that are one: of a posture, where only rounding
differs, and of a movement, where one may be filtered. No two walks agree to 2 mm at the same
frames; postures of one person may."""
# Standard deviation of a marker's distance from the middle from which a recording is a movement
MOVES_M = 0.01

DOUBT = 1.96  # z, of 95 %


@dataclass(frozen=True)
class Distances:
    """How far the points of one recording are from each other."""

    medians: Mapping[frozenset[str], float]  # Two labels -> m, median distance
    error: float = 0.0  # m, e of points that are no markers
    extension: Mapping[str, float] = field(
        default_factory=dict
    )  # Side -> m, from pelvis to foot where it was measured


def measure_pair_distances(recording: Recording, marker_set: MarkerSet) -> Distances:
    """Distances of markers of pelvis and legs, within one segment or not."""
    column = {label: i for i, label in enumerate(recording.labels)}
    worn = sorted(
        {
            label
            for group in list_tracked_labels(marker_set, recording.labels).values()
            for label in group
        }
    )
    markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)]
    straight = _find_straight_legs(recording, marker_set) if marker_set.noise is None else {}
    segment_of = marker_set.segment_of
    out: dict[frozenset[str], float] = {}
    for a, b in combinations(worn, 2):
        apart = np.linalg.norm(markers[:, column[a]] - markers[:, column[b]], axis=1)
        side = segment_of.get(a, "")[-1:]
        near = apart[straight[side][0]] if side in straight else apart
        apart = near if np.isfinite(near).sum() >= FEWEST_FRAMES else apart
        if np.isfinite(apart).sum() >= min(FEWEST_FRAMES, len(apart)):
            out[frozenset((a, b))] = float(np.nanmedian(apart))
    if (noise := marker_set.noise) is None:
        return Distances(out, extension={side: length for side, (_, length) in straight.items()})
    looks = max(float(recording.time[-1] - recording.time[0]) / noise.memory_s, 1.0)
    # where a pose has a joint, four corners say
    corners = 4.0 if has_poses(recording.labels) and not has_key_points(recording.labels) else 1.0
    return Distances(out, 1e-3 * noise.size_mm * float(np.sqrt(2.0 / (looks * corners))))


def _find_straight_legs(
    recording: Recording, marker_set: MarkerSet
) -> dict[str, tuple[BoolArray, float]]:
    """Side -> which of the frames show the leg about as straight as it ever is, and m, how long it
    is there.
    """
    out: dict[str, tuple[BoolArray, float]] = {}
    pelvis, some = (
        compute_segment_middle(recording, marker_set, "pelvis"),
        max(1, len(recording.markers) // MOST_FRAMES),
    )
    for side in SIDES:
        length = np.linalg.norm(
            compute_segment_middle(recording, marker_set, f"foot_{side}") - pelvis, axis=1
        )[::some]
        if np.isfinite(length).sum() >= FEWEST_FRAMES:
            near = np.nan_to_num(length) >= np.nanpercentile(
                length, 100.0 - NEAREST_PERCENT
            ) * np.cos(0.5 * NEAR_RAD)
            out[side] = near, float(np.median(length[near]))
    return out


def list_tracked_labels(marker_set: MarkerSet, labels: Iterable[str]) -> dict[str, list[str]]:
    """Segment of pelvis and legs -> those of the labels that are followed on it and tell places; of
    points that are no markers the ends of its bone.
    """
    there = set(labels)
    out: dict[str, list[str]] = {}
    for segment in LOWER_BODY:
        worn = (*marker_set.tracking.get(segment, ()), *marker_set.optional.get(segment, ()))
        if marker_set.noise is not None and "hjc_r" in marker_set.landmarks:
            worn = tuple(
                label
                for name in _list_bone_ends(segment)
                for label in marker_set.landmarks.get(name, ())
            )
            out[segment] = sorted(there.intersection(worn))
            continue
        out[segment] = sorted(
            m
            for m in dict.fromkeys(worn)
            if m in there and marker_set.weight(m) > NEGLIGIBLE_WEIGHT
        )
    return out


def _list_bone_ends(segment: str) -> tuple[str, ...]:
    """Landmarks at the ends of the bone of a segment of the lower body; none of the talus."""
    kind, _, side = segment.partition("_")
    ends = {
        "thigh": ("hjc", "knee_lat"),
        "shank": ("knee_lat", "ankle_lat"),
        "foot": ("ankle_lat", "toe"),
    }
    return (
        ("hjc_r", "hjc_l")
        if kind == "pelvis"
        else tuple(f"{end}_{side}" for end in ends.get(kind, ()))
    )


def compare_by_segment(one: Distances, other: Distances, marker_set: MarkerSet) -> dict[str, float]:
    """Segment -> m, d_s; without segments of which the two recordings have no pair in common."""
    common = set(one.medians) & set(other.medians)
    worn = list_tracked_labels(marker_set, {label for pair in common for label in pair})
    out: dict[str, float] = {}
    for segment, labels in worn.items():
        pairs = [pair for pair in map(frozenset, combinations(labels, 2)) if pair in common]
        if pairs:
            out[segment] = max(abs(one.medians[pair] - other.medians[pair]) for pair in pairs)
    return out


def describe_placement_difference(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """In what the markers of two recordings are placed otherwise, in words; empty where they may be
    the same.
    """
    by_segment = compare_by_segment(one, other, marker_set)
    ranked = sorted(by_segment, key=lambda segment: (-by_segment[segment], segment))
    if len(ranked) < 2:
        return ""
    differ = [by_segment[segment] for segment in ranked]
    lengths = [
        sorted((one.extension[side], other.extension[side]))
        for side in one.extension.keys() & other.extension
    ]
    # of a knee between two equal parts, that makes a leg so much shorter
    flexed = 2.0 * float(np.arccos(min((short / long for short, long in lengths), default=1.0)))
    tissue = compute_tissue_spread(
        float(np.sqrt(2.0)) * max(size.per_marker for size in SIZES.values()), flexed - NEAR_RAD
    )
    doubt = DOUBT * float(np.linalg.norm([one.error, other.error, tissue]))
    if differ[1] <= np.hypot(APART_M, doubt) and float(np.median(differ)) <= np.hypot(
        ALL_APART_M, doubt
    ):
        return ""
    return "distances within segments differ: " + ", ".join(
        f"{s} {1e3 * by_segment[s]:.0f} mm" for s in ranked[:3]
    )


def is_same_recording(one: Recording, other: Recording) -> bool:
    """Whether the shorter of two recordings is the other one, or a part of it, whatever its axes
    and labels' order.
    """
    common = sorted(set(one.labels) & set(other.labels))
    if len(common) < FEWEST_COMMON:
        return False
    short, long = sorted((one, other), key=lambda r: len(r.time))
    if abs(short.rate / long.rate - 1) > 0.01:
        return False
    a, b = (_measure_from_middle(recording, common) for recording in (short, long))
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
    """(nf, nl) m, distance of each marker from the mean of all, which no turn of the axes changes;
    NaN where one is not seen.
    """
    markers = recording.markers[:, [recording.labels.index(label) for label in labels]]
    out: Array = np.linalg.norm(markers - markers.mean(axis=1, keepdims=True), axis=2)
    return out


def _find_starts(short: Array, long: Array) -> list[int]:
    """Frames of `long` at which `short` may begin, from those nearest to its first, middle and last
    whole frame.
    """
    spare = len(long) - len(short)
    whole = np.flatnonzero(np.isfinite(short).all(axis=1))
    if spare == 0:
        return [0]
    starts = set()
    for frame in whole[[0, len(whole) // 2, -1]] if len(whole) else ():
        away = np.abs(long - short[frame]).mean(axis=1)
        if np.isfinite(away).any():
            starts.add(int(np.nanargmin(away)) - int(frame))
    return sorted(start for start in starts if 0 <= start <= spare)


# Second largest d_s of `placing` after the exchange: the largest of one person in one session
WITHIN_M = 0.009
# Share of the largest d_s that may be left: the exchange has to tell the difference, not to share
# in it
REMAINS = 0.5
SIDES_EXCHANGED = "left and right"


def find_explaining_swap(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """The exchange of labels in one of two recordings after which their markers sit alike; empty
    where none does.

    `one`, `other`: of `pair_distances`.
    """
    present = compare_by_segment(one, other, marker_set)
    if len(present) < 2:
        return ""
    fits: list[tuple[float, str]] = []
    for words, exchange in _list_swaps(marker_set, other):
        apart = sorted(
            compare_by_segment(one, _swap_distances(other, exchange), marker_set).values(),
            reverse=True,
        )
        median = sorted(apart)[len(apart) // 2]
        tight = apart[0] <= min(APART_M, REMAINS * max(present.values())) and apart[1] <= WITHIN_M
        if tight and median <= ALL_APART_M:
            fits.append((sum(apart), words))
    return min(fits)[1] if fits else ""


def _list_swaps(
    marker_set: MarkerSet, distances: Distances
) -> Iterator[tuple[str, Mapping[str, str]]]:
    labels = sorted({label for pair in distances.medians for label in pair})
    of_sides = [(a, b) for a, b in combinations(labels, 2) if other_side(a, b)]
    if of_sides:
        yield SIDES_EXCHANGED, {old: new for a, b in of_sides for old, new in ((a, b), (b, a))}
    worn = {label for group in list_tracked_labels(marker_set, labels).values() for label in group}
    for a, b in combinations([label for label in labels if label in worn], 2):
        yield f"{a} and {b}", {a: b, b: a}


def _swap_distances(distances: Distances, exchange: Mapping[str, str]) -> Distances:
    """Distances as they are after the exchange."""
    apart = {
        frozenset(exchange.get(label, label) for label in pair): d
        for pair, d in distances.medians.items()
    }
    return replace(distances, medians=apart)


STATIC_WORD = re.compile(
    r"(static|stat(?![a-z])|(?<![a-z])cal(ib\w*)?(?![a-z])|stand|(?<![a-z])(st|sc)(?![a-z])|pose|neutral|anatom)",
    re.I,
)
"""What files of static trials are called; weak evidence."""
CLEAR_WORD = re.compile(r"(static|(?<![a-z])cal(ib\w*)?(?![a-z])|neutral|anatom)", re.IGNORECASE)
"""The same, where no other word is meant."""
SHIFTS_M = 0.1
"""RMS distance from the mean place up to which a foot or the pelvis is merely restless: a step
moves it by more.
"""


@dataclass(frozen=True, kw_only=True)
class Session:
    """The recordings of one person with the markers in the same places."""

    statics: tuple[int, ...]  # Recordings that may be static trials, the best first
    members: tuple[int, ...]
    postures: Mapping[
        int, StandingPosture
    ]  # Recording -> how the person stands in it, where that is seen
    only_standing: Mapping[
        int, tuple[str, ...]
    ]  # Static trial -> markers of it that no other recording has
    others: Mapping[int, str]  # Recordings of the same labels that are not of this session, and why

    @property
    def marker_set(self) -> MarkerSet:
        """The marker set as the best static trial shows it worn."""
        return self.postures[self.statics[0]].marker_set


def find_session(
    recordings: Mapping[int, Recording], stems: Mapping[int, str], marker_set: MarkerSet
) -> Session | None:
    """The largest session in recordings with the set's labels; None where nobody stands still.

    `stems`: file names without ending.
    """
    postures = {
        i: found
        for i, r in recordings.items()
        if (found := detect_standing(r, marker_set)[0]) is not None
    }
    worn = _find_static_only_labels(recordings, postures)
    only = _choose_static_candidates(recordings, stems, postures, worn)
    if not only:
        return None

    def rank(i: int) -> tuple[object, ...]:
        missing = sum(name not in postures[i].landmarks for name in REQUIRED)
        told = bool(recordings[i].facts.is_static)
        word = STATIC_WORD.search(stems[i]) is not None
        moment = len(recordings[i].time) == 1  # nobody can tell whether they stand still in it
        return (
            missing,
            moment,
            not told,
            -len(worn[i]),
            not word,
            round(1e3 * postures[i].speed),
            stems[i].lower(),
            i,
        )

    ranked = sorted(only, key=rank)
    distances = {i: measure_pair_distances(r, marker_set) for i, r in recordings.items()}
    otherwise = {
        (i, j): "" if find_explaining_swap(distances[i], distances[j], marker_set) else words
        for i in ranked
        for j in recordings
        if (words := describe_placement_difference(distances[i], distances[j], marker_set))
    }
    groups = {i: [j for j in recordings if not otherwise.get((i, j))] for i in ranked}
    best = max(ranked, key=lambda i: (len(groups[i]), -ranked.index(i)))
    others = {}
    for j in recordings:
        if j not in groups[best]:
            own = next(
                (i for i in ranked if i not in groups[best] and j in groups[i] and i != j), None
            )
            more = (
                f"; its static trial is {stems[own]}: put these into a folder of their own"
                if own is not None
                else ""
            )
            words = otherwise[best, j]
            others[j] = (
                f"another person, or markers put on anew, against {stems[best]}: {words}{more}"
            )
    return Session(
        statics=(best, *(i for i in ranked if i != best and i in groups[best])),
        members=tuple(groups[best]),
        postures=postures,
        only_standing=worn,
        others=others,
    )


def _choose_static_candidates(
    recordings: Mapping[int, Recording],
    stems: Mapping[int, str],
    postures: Mapping[int, StandingPosture],
    worn: Mapping[int, tuple[str, ...]],
) -> list[int]:
    """Recordings that only stand; where there are none, those called static or with markers of
    their own, of which a part stands; then those in which somebody merely shifts; then those of
    segment poses, in which nobody has to stand.
    """
    tiers: tuple[Callable[[int], bool], ...] = (
        lambda i: postures[i].throughout,
        lambda i: bool(CLEAR_WORD.search(stems[i]) or recordings[i].facts.is_static or worn[i]),
        lambda i: postures[i].sway <= SHIFTS_M,
        lambda i: has_poses(recordings[i].labels),
    )
    return next((found for tier in tiers if (found := [i for i in postures if tier(i)])), [])


def _find_static_only_labels(
    recordings: Mapping[int, Recording], postures: Mapping[int, StandingPosture]
) -> dict[int, tuple[str, ...]]:
    """Standing recording -> its labels that no recording has in which the person moves."""
    moving = {
        m
        for i, r in recordings.items()
        if i not in postures or not postures[i].throughout
        for m in r.labels
    }
    if not moving:
        return dict.fromkeys(postures, ())
    return {i: tuple(m for m in recordings[i].labels if m not in moving) for i in postures}
