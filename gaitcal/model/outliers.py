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
FEWEST = 4  # markers of a median; segments with fewer around them are held against the whole body
REACH_BODY_M = 1.7  # m; from the median of the whole body wrists have been up to 0.94 m away
MOST_SHARE = 0.3  # share of all markers that may stray in a frame


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """A marker that was left out where it is metres away from the body."""

    label: str
    frames: int
    of: int  # frames in which it was seen at all
    farthest: float  # m, from the markers around it
    when: str  # from when to when, s

    @property
    def words(self) -> str:
        """Which marker, how far, how long."""
        return f"{self.label} up to {self.farthest:.1f} m away, {self.frames} of {self.of} frames ({self.when})"


def without_outliers(recording: Recording, segment_of: Mapping[str, str]) -> tuple[Recording, tuple[Outlier, ...]]:
    """The recording with markers of the given segments left out where they are metres away, and which these were.

    `segment_of`: label -> segment. A marker that is nowhere on the body loses its column.
    """
    found, away = _outliers(recording, segment_of)
    if not found.any():
        return recording, ()
    seen = seen_mask(recording.markers)
    outliers = tuple(
        Outlier(
            label=recording.labels[k],
            frames=int(found[:, k].sum()),
            of=int(seen[:, k].sum()),
            farthest=float(away[found[:, k], k].max()),
            when=spans(recording.time, runs(found[:, k])),
        )
        for k in np.flatnonzero(found.any(axis=0))
    )
    kept = [k for k in range(len(recording.labels)) if not found[:, k].any() or (seen[:, k] & ~found[:, k]).any()]
    masked = np.where(found[:, :, None], np.nan, recording.markers)
    note = f"Markers left out where they are metres away from the body: {'; '.join(o.words for o in outliers)}."
    labels = tuple(recording.labels[k] for k in kept)
    return replace(recording, labels=labels, markers=masked[:, kept]).with_notes(note), outliers


def _outliers(recording: Recording, segment_of: Mapping[str, str]) -> tuple[BoolArray, Array]:
    """(nf, nm) where a marker is out of reach, and how far (m) each is from the median of the markers around it."""
    x, seen = recording.markers, seen_mask(recording.markers)
    out, away = np.zeros_like(seen), np.full(seen.shape, np.nan)
    of_marker = np.array([segment_of.get(label, "") for label in recording.labels])
    known = np.flatnonzero(of_marker != "")
    if len(known) < FEWEST:
        return out, away
    for segment in dict.fromkeys(of_marker[known].tolist()):
        on, around = np.flatnonzero(of_marker == segment), np.flatnonzero(np.isin(of_marker, list(_near(segment))))
        few = len(around) < FEWEST
        centre = _median(x[:, known if few else around])
        away[:, on] = np.linalg.norm(x[:, on] - centre[:, None], axis=2)
        out[:, on] = away[:, on] > (REACH_BODY_M if few else REACH_M)
    out[out.sum(axis=1) > MOST_SHARE * np.maximum(seen[:, known].sum(axis=1), 1)] = False
    return out, away


def _near(segment: str) -> set[str]:
    """A segment and its neighbours with markers."""

    def beside(one: str) -> set[str]:
        return {one, *(e for j in JOINTS if one in (j.parent, j.child) for e in (j.parent, j.child))}

    near = beside(segment)
    for between in [s for s in near if not segment_kind(s).markers]:  # a segment that never carries markers
        near = near | beside(between)
    return near


def _median(x: Array) -> Array:
    """(nf, 3) lower median of x (nf, n, 3) over the markers seen; NaN where none is."""
    ordered = np.sort(x, axis=1)  # gaps come last
    count = np.isfinite(x[:, :, 0]).sum(axis=1)
    return np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None, None], axis=1)[:, 0]
