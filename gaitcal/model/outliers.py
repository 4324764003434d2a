"""Markers metres away from the body, which no least-squares fit survives: found, named and left out.

c(s, t) is the median, coordinate by coordinate, of all markers seen in frame t on segment s and on those that a joint
connects with it. A marker of s farther than REACH from c is nowhere on that body. The median stands while fewer than
half of these markers stray; where more of all markers do, the unit or the labels are wrong, which is another fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.intervals import runs, spans
from gaitcal.io.recording import Recording, seen_mask
from gaitcal.model.linkage import JOINTS, segment_kind

REACH_M = 1.0
"""m; markers of one segment and its neighbours lie within 0.6 m of their median on people of 1.8 m, arms raised."""
FEWEST = 4
"""Markers of a median; segments with fewer around them are held against the whole body."""
REACH_BODY_M = 1.7
"""m; from the median of the whole body wrists have been up to 0.94 m away."""
_SURELY = 0.999
"""Of the reach: within it rounding makes no stray."""
MOST_SHARE = 0.3
"""Share of all markers that may stray in a frame."""


@dataclass(frozen=True, kw_only=True)
class Stray:
    """A marker that was left out where it is metres away from the body."""

    label: str
    frames: int
    of: int
    """Frames in which it was seen at all."""
    farthest: float
    """m, from the markers around it."""
    when: str
    """From when to when, s."""

    @property
    def words(self) -> str:
        """Which marker, how far, how long."""
        return f"{self.label} up to {self.farthest:.1f} m away, {self.frames} of {self.of} frames ({self.when})"


def without_strays(recording: Recording, segment_of: Mapping[str, str]) -> tuple[Recording, tuple[Stray, ...]]:
    """The recording with markers of the given segments left out where they are metres away, and which these were.

    `segment_of`: label -> segment. A marker that is nowhere on the body loses its column.
    """
    found = stray_mask(recording, segment_of)
    if not found.any():
        return recording, ()
    seen = seen_mask(recording.markers)
    away = _distances(recording, segment_of)
    strays = tuple(
        Stray(
            label=recording.labels[k],
            frames=int(found[:, k].sum()),
            of=int(seen[:, k].sum()),
            farthest=float(np.nanmax(np.where(found[:, k], away[:, k], np.nan))),
            when=spans(recording.time, runs(found[:, k])),
        )
        for k in np.flatnonzero(found.any(axis=0))
    )
    kept = [k for k in range(len(recording.labels)) if not found[:, k].any() or (seen[:, k] & ~found[:, k]).any()]
    masked = np.where(found[:, :, None], np.nan, recording.markers)
    told = f"left out where they are metres away from the body: {'; '.join(s.words for s in strays)}."
    labels = tuple(recording.labels[k] for k in kept)
    return replace(recording, labels=labels, markers=masked[:, kept]).with_notes(f"Markers {told}"), strays


def stray_mask(recording: Recording, segment_of: Mapping[str, str]) -> BoolArray:
    """(nf, nm) where a marker of one of the segments is metres away from the body."""
    seen = seen_mask(recording.markers)
    known = [k for k, label in enumerate(recording.labels) if label in segment_of]
    out = np.zeros_like(seen)
    if len(known) < FEWEST:
        return out
    out = _beyond(recording, segment_of)
    crowded = out.sum(axis=1) > MOST_SHARE * np.maximum(seen[:, known].sum(axis=1), 1)
    out[crowded] = False
    return out


def _around(recording: Recording, segment_of: Mapping[str, str], segment: str) -> list[int]:
    """Columns of the markers of a segment and its neighbours, or of all where these are few."""
    near = _near(segment)
    around = [k for k, label in enumerate(recording.labels) if segment_of.get(label) in near]
    return around if len(around) >= FEWEST else [k for k, label in enumerate(recording.labels) if label in segment_of]


def _near(segment: str) -> set[str]:
    """A segment and its neighbours with markers."""
    near = _beside(segment)
    for between in [s for s in near if not segment_kind(s).markers]:  # a segment that never carries markers
        near = near | _beside(between)
    return near


def _beside(segment: str) -> set[str]:
    """A segment and those that a joint connects with it."""
    return {segment, *(e for j in JOINTS if segment in (j.parent, j.child) for e in (j.parent, j.child))}


def _own(recording: Recording, segment_of: Mapping[str, str]) -> dict[str, list[int]]:
    """Segment -> columns of its markers, of segments that have some."""
    own: dict[str, list[int]] = {segment: [] for segment in segment_of.values()}
    for k, label in enumerate(recording.labels):
        if label in segment_of:
            own[segment_of[label]].append(k)
    return {segment: columns for segment, columns in own.items() if columns}


def _beyond(recording: Recording, segment_of: Mapping[str, str]) -> BoolArray:
    """(nf, nm) where a marker is out of reach of the median around it.

    A median lies in the box of its markers; it is looked for only in frames in which the segment's own box has a corner
    out of reach of a corner of that one.
    """
    x = recording.markers
    out = np.zeros(x.shape[:2], dtype=np.bool_)
    own = _own(recording, segment_of)
    boxes = {
        s: (np.fmin.reduce(x[:, columns], axis=1), np.fmax.reduce(x[:, columns], axis=1)) for s, columns in own.items()
    }
    for segment, columns in own.items():
        near = [s for s in own if s in _near(segment)]
        few = sum(len(own[s]) for s in near) < FEWEST
        reach = REACH_BODY_M if few else REACH_M
        least, most = (
            f.reduce([boxes[s][k] for s in (own if few else near)]) for k, f in enumerate((np.fmin, np.fmax))
        )
        low, high = boxes[segment]
        with np.errstate(invalid="ignore"):
            farthest = np.linalg.norm(np.maximum(high - least, most - low), axis=1)
            frames = np.flatnonzero(farthest > _SURELY * reach)
            if len(frames):
                part = x[frames]
                centre = _median(part[:, _around(recording, segment_of, segment)])
                away = np.linalg.norm(part[:, columns] - centre[:, None], axis=2)
                out[frames[:, None], columns] = away > reach
    return out


def _distances(recording: Recording, segment_of: Mapping[str, str]) -> Array:
    """(nf, nm) m, from the median of the markers around; NaN where nothing tells."""
    x = recording.markers
    out = np.full(x.shape[:2], np.nan)
    for segment, own in _own(recording, segment_of).items():
        centre = _median(x[:, _around(recording, segment_of, segment)])
        out[:, own] = np.linalg.norm(x[:, own] - centre[:, None], axis=2)
    return out


def _median(x: Array) -> Array:
    """(nf, 3) lower median of x (nf, n, 3) over the markers seen; NaN where none is."""
    ordered = np.sort(x, axis=1)  # gaps come last
    count = np.isfinite(x[:, :, 0]).sum(axis=1)
    middle = np.maximum(count - 1, 0) // 2
    out: Array = np.take_along_axis(ordered, middle[:, None, None], axis=1)[:, 0]
    return out
