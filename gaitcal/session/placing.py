"""Which recordings show the same person with the markers in the same places, and which are one recording twice.

Skin moves a marker against another one of its segment by some millimetres; another person, or markers put on anew,
differ in several segments by more. D(a, b) is the median distance of two markers of a segment in a recording:

    d_s = max over pairs (a, b) of segment s of |D(a, b) - D'(a, b)|

Within sessions of eight people the second largest d_s of pelvis and legs is at most 9 mm, between people from 11 mm.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.faults.evidence import NEGLIGIBLE_WEIGHT
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import MarkerSet

APART_M = 0.015
"""Second largest d_s from which the markers are placed otherwise: one marker that fell off spoils one segment only."""
ALL_APART_M = 0.008
"""Median d_s from which they are, too."""
FEWEST_FRAMES = 5
MOST_FRAMES = 500
"""Frames, evenly spread, that tell a median distance."""
FEWEST_COMMON = 4
"""Markers by which two recordings are compared."""
SAME_M = {True: 0.00015, False: 0.002}
"""RMS difference of two recordings, frame by frame, that are one: of a posture, where only rounding differs, and of a
movement, where one may be filtered. No two walks agree to 2 mm at the same frames; postures of one person may."""
MOVES_M = 0.01
"""Standard deviation of a marker's distance from the middle from which a recording is a movement."""

Distances = dict[frozenset[str], float]
"""Two markers -> m, median distance."""


def pair_distances(recording: Recording, marker_set: MarkerSet) -> Distances:
    """Two markers of pelvis and legs -> m, median distance, within one segment or not."""
    column = {label: i for i, label in enumerate(recording.labels)}
    worn = sorted({label for group in worn_labels(marker_set, recording.labels).values() for label in group})
    markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)]
    out: Distances = {}
    for a, b in combinations(worn, 2):
        apart = np.linalg.norm(markers[:, column[a]] - markers[:, column[b]], axis=1)
        if np.isfinite(apart).sum() >= min(FEWEST_FRAMES, len(apart)):
            out[frozenset((a, b))] = float(np.nanmedian(apart))
    return out


def worn_labels(marker_set: MarkerSet, labels: Iterable[str]) -> dict[str, list[str]]:
    """Segment of pelvis and legs -> those of the labels that are followed on it and tell places."""
    there = set(labels)
    out: dict[str, list[str]] = {}
    for segment in LOWER_BODY:
        worn = (*marker_set.tracking.get(segment, ()), *marker_set.optional.get(segment, ()))
        out[segment] = sorted(m for m in dict.fromkeys(worn) if m in there and marker_set.weight(m) > NEGLIGIBLE_WEIGHT)
    return out


def apart_by_segment(one: Distances, other: Distances, marker_set: MarkerSet) -> dict[str, float]:
    """Segment -> m, d_s; without segments of which the two recordings have no pair in common."""
    common = set(one) & set(other)
    worn = worn_labels(marker_set, {label for pair in common for label in pair})
    out: dict[str, float] = {}
    for segment, labels in worn.items():
        pairs = [pair for pair in map(frozenset, combinations(labels, 2)) if pair in common]
        if pairs:
            out[segment] = max(abs(one[pair] - other[pair]) for pair in pairs)
    return out


def placed_otherwise(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """In what the markers of two recordings are placed otherwise, in words; empty where they may be the same."""
    by_segment = apart_by_segment(one, other, marker_set)
    ranked = sorted(by_segment, key=lambda segment: (-by_segment[segment], segment))
    if len(ranked) < 2:
        return ""
    differ = [by_segment[segment] for segment in ranked]
    if differ[1] <= APART_M and float(np.median(differ)) <= ALL_APART_M:
        return ""
    return "distances within segments differ: " + ", ".join(f"{s} {1e3 * by_segment[s]:.0f} mm" for s in ranked[:3])


def same_recording(one: Recording, other: Recording) -> bool:
    """Whether the shorter of two recordings is the other one, or a part of it, whatever its axes and labels' order."""
    common = sorted(set(one.labels) & set(other.labels))
    if len(common) < FEWEST_COMMON:
        return False
    short, long = sorted((one, other), key=lambda r: len(r.time))
    if abs(short.rate / long.rate - 1) > 0.01:
        return False
    a, b = (_from_middle(recording, common) for recording in (short, long))
    for start in _starts(a, b):
        part = b[start : start + len(a)]
        both = np.isfinite(a) & np.isfinite(part)
        if both.sum() < 0.5 * np.isfinite(a).sum() or not both.any():
            continue
        still = float(np.median(np.std(np.where(both, a, 0.0), axis=0))) < MOVES_M
        if float(np.sqrt(np.mean((a - part)[both] ** 2))) <= SAME_M[still]:
            return True
    return False


def _from_middle(recording: Recording, labels: list[str]) -> Array:
    """(nf, nl) m, distance of each marker from the mean of all, which no turn of the axes changes; NaN where one is
    not seen.
    """
    markers = recording.markers[:, [recording.labels.index(label) for label in labels]]
    out: Array = np.linalg.norm(markers - markers.mean(axis=1, keepdims=True), axis=2)
    return out


def _starts(short: Array, long: Array) -> list[int]:
    """Frames of `long` at which `short` may begin, from those nearest to its first, middle and last whole frame."""
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
