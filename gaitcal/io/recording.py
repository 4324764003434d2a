"""What one trial holds after reading, whatever file it came from: markers with their gaps, and force plates.

Frames and units are settled once, on reading: metres, seconds, newtons, newton metres; y up, right-handed.
The turn about the vertical that brings x along the progression is a step of its own (`axes.py`).
Gaps stay gaps, weighed with zero later, and never filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.errors import Code
from gaitcal.io.labels import ComputedPoints, Facts, FootEvent, clean
from gaitcal.io.text_file import FileFault


@dataclass(frozen=True, kw_only=True)
class ForcePlate:
    """Ground reaction measured by one force plate, as it acts **on the body**.

    The wrench is the force at `point` plus the moment about `point`; where the plate is loaded, `point` is the
    centre of pressure and `moment` the free moment; elsewhere any fixed point with the full moment about it.
    """

    name: str
    """Plate number or name as the study file refers to it: "1", "2", ..."""
    time: Array
    """(ns,) s, on the same clock as the markers; may be denser than the marker frames."""
    force: Array
    """(ns, 3) N."""
    point: Array
    """(ns, 3) m."""
    moment: Array
    """(ns, 3) N·m about `point`."""
    corners: Array | None = None
    """(4, 3) m, or None where the file does not tell."""

    def wrench(self) -> Array:
        """(ns, 6) force and moment about the laboratory origin."""
        return np.hstack([self.force, self.moment + cross(self.point, self.force)])


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Markers and plate wrenches of one trial."""

    source: str
    """The file it was read from, for messages."""
    time: Array
    """(nf,) s, strictly increasing."""
    labels: tuple[str, ...]
    """Marker names, unique."""
    markers: Array
    """(nf, nm, 3) m; NaN where a marker was not seen."""
    plates: tuple[ForcePlate, ...] = ()
    """Force plates, in the order of the file; none where forces were not recorded."""
    feet: Mapping[str, str] = field(default_factory=dict)
    """Plate -> "r" or "l", where the file of the forces says on which foot it acts."""
    notes: tuple[str, ...] = field(default=())
    """What was assumed, converted or left out on reading, one sentence each; shown in every output."""
    events: tuple[FootEvent, ...] = ()
    """Foot strikes and offs that the file tells, in order of time."""
    corrected: bool = False
    """Whether a person set `events` (`events.csv`): then there are no others."""
    facts: Facts = field(default=Facts())
    """What the file says about the person."""
    computed: ComputedPoints | None = None
    """Points of other programs, at the same frames and in the same axes; None where the file has none."""

    @property
    def rate(self) -> float:
        """Frames per second (median step); NaN for fewer than two frames."""
        return float(1.0 / np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")

    def with_notes(self, *notes: str) -> Recording:
        """The same recording with more notes."""
        return replace(self, notes=self.notes + notes)

    def frames(self, chosen: BoolArray) -> Recording:
        """The recording at its frames `chosen` (nf,) only; plates keep their own clock, and all their samples."""
        computed = self.computed
        if computed is not None:
            computed = ComputedPoints(computed.labels, computed.points[chosen])
        return replace(self, time=self.time[chosen], markers=self.markers[chosen], computed=computed)


def seen_mask(markers: Array) -> BoolArray:
    """(nf, nm) bool: which of markers (nf, nm, 3) were seen; a marker is seen whole or not at all."""
    return np.asarray(np.isfinite(markers).all(axis=2), dtype=np.bool_)


def seen_means(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Name -> (3,) m, mean of a path (nf, 3) over the frames in which it is known; without those that never are."""
    known = {name: path[np.isfinite(path).all(axis=1)] for name, path in paths.items()}
    return {name: path.mean(axis=0) for name, path in known.items() if len(path)}


def zeros_to_missing(markers: Array) -> tuple[Array, tuple[str, ...]]:
    """Markers (nf, nm, 3) with the literal 0 0 0 that some programs write for a gap made NaN, and a note if any was.

    A marker known in part is not known: where one coordinate is NaN, all three are.
    """
    zero = (markers == 0).all(axis=2)
    part = np.isnan(markers).any(axis=2)
    notes: tuple[str, ...] = ()
    if zero.any():
        where = int(zero.any(axis=0).sum())
        notes = (f"{int(zero.sum())} positions of exactly 0 0 0 taken as gaps, in {where} markers.",)
    return np.where((zero | part)[:, :, None], np.nan, markers), notes


def require_plain_labels(recording: Recording) -> None:
    """FileFault for marker or plate names that no text table can hold."""
    for name in (*recording.labels, *(plate.name for plate in recording.plates)):
        if clean(name) != name or not name:
            message = f"the name {name[:40]!r} cannot be written; it has odd characters"
            raise FileFault(message, code=Code.NOT_WRITABLE)
