"""What one trial holds after reading, whatever file it came from: markers with their gaps, and
force plates.

Frames and units are settled once, on reading: metres, seconds, newtons, newton metres; y up,
right-handed. The turn about the vertical that brings x along the progression is a step of its own
(`axes.py`). Gaps stay gaps, weighed with zero later, and never filled.

Stretches of frames are slices. A static trial may hold walking before and after its stillest
stretch. The speed of one is the RMS, over its frames and markers, of displacement across LAG_S
divided by LAG_S. The lag keeps measurement noise out: 0.2 mm of it would read as 28 mm/s from one
100 Hz frame to the next, and so as 3 mm/s. Where noise is so large that no stretch looks still,
paths are first averaged over SMOOTH_S: 3 mm of white noise reads as 73 mm/s across the lag at 100
Hz, and as 12 mm/s after that; whoever walks or sways slowly keeps the speed.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.display import Displayed, describe_time, shorten
from gaitcal.errors import Code, InputError
from gaitcal.io.labels import ComputedPoints, Facts, FootEvent, clean
from gaitcal.io.text_file import FileFault

if TYPE_CHECKING:
    import pandas as pd

LAG_S = 0.1
STILL_M_S = 0.05
"""Quiet standing sways at up to 0.02 m/s at the height of the head; the slowest walk moves a body
at over 0.2 m/s. In a window of 0.5 s at this speed a marker strays by 12 mm from its mean, at
worst."""
RESTLESS_M_S = 0.1
"""Most of a window that is used with a doubt, where none is still: half of the slowest walk. The
mean of a marker over 0.5 s is within 12 mm of where it was for half of the time."""
WALKS_M_S = 0.3
"""The slowest walk moves a body at over 0.2 m/s, and noise of 1 mm moves two frames at 100 Hz at
0.2 m/s.
"""
SMOOTH_S = 0.2
SEEN = 0.7
"""Share of the frames averaged in which a marker must be seen: the mean of a part of a movement
lies elsewhere.
"""
DURATION_S = 0.5


@dataclass(frozen=True, kw_only=True)
class ForcePlate:
    """Ground reaction measured by one force plate, as it acts **on the body**.

    The wrench is the force at `point` plus the moment about `point`; where the plate is loaded,
    `point` is the centre of pressure and `moment` the free moment; elsewhere any fixed point with
    the full moment about it.
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


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(Displayed):
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
    """What was assumed, converted or left out on reading, one sentence each; shown in every output.
    """
    events: tuple[FootEvent, ...] = ()
    """Foot strikes and offs that the file tells, in order of time."""
    corrected: bool = False
    """Whether a person set `events` (`events.csv`): then there are no others."""
    facts: Facts = field(default=Facts())
    """What the file says about the person."""
    computed: ComputedPoints | None = None
    """Points of other programs, at the same frames and in the same axes; None where the file has
    none.
    """

    @property
    def rate(self) -> float:
        """Frames per second (median step); NaN for fewer than two frames."""
        return float(1.0 / np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the marker paths as a table, with the columns of `gaitcal convert`'s CSV file.

        Returns
        -------
        pandas.DataFrame
            `time` (s), then `NAME_x`, `NAME_y` and `NAME_z` (m) of every marker; NaN where it was
            not visible.
        """
        import pandas as pd

        columns = {
            f"{name}_{axis}": self.markers[:, m, i]
            for m, name in enumerate(self.labels)
            for i, axis in AXES
        }
        return pd.DataFrame({"time": self.time, **columns})

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        extent = describe_time(
            len(self.time), self.rate, float(np.ptp(self.time)) if len(self.time) else 0.0
        )
        visible = (
            f", {100 * seen_mask(self.markers).mean():.1f} % of samples visible"
            if self.markers.size
            else ""
        )
        plates = [f"{plate.name} ({plate_rate(plate):.0f} Hz)" for plate in self.plates]
        rows = [
            ("time", extent),
            ("markers", f"{len(self.labels)}{visible}: {shorten(self.labels)}"),
            ("force plates", shorten(plates) or "none"),
        ]
        if self.events:
            rows.append(("foot events", str(len(self.events))))
        if self.notes:
            rows.append(("notes", str(len(self.notes))))
        return f"Recording {Path(self.source).name}", rows

    def with_notes(self, *notes: str) -> "Recording":
        """The same recording with more notes."""
        return replace(self, notes=self.notes + notes)

    def frames(self, chosen: BoolArray) -> "Recording":
        """The recording at its frames `chosen` (nf,) only; plates keep their own clock, and all
        their samples.
        """
        computed = self.computed
        if computed is not None:
            computed = ComputedPoints(computed.labels, computed.points[chosen])
        return replace(
            self, time=self.time[chosen], markers=self.markers[chosen], computed=computed
        )


AXES = tuple(enumerate("xyz"))


def plate_rate(plate: ForcePlate) -> float:
    """Return the samples per second of a force plate (median step); NaN for fewer than two."""
    return float(1.0 / np.median(np.diff(plate.time))) if len(plate.time) > 1 else float("nan")


def seen_mask(markers: Array) -> BoolArray:
    """(nf, nm) bool: which of markers (nf, nm, 3) were seen; a marker is seen whole or not at all."""
    return np.asarray(np.isfinite(markers).all(axis=2), dtype=np.bool_)


def seen_means(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Name -> (3,) m, mean of a path (nf, 3) over the frames in which it is known; without those
    that never are.
    """
    known = {name: path[np.isfinite(path).all(axis=1)] for name, path in paths.items()}
    return {name: path.mean(axis=0) for name, path in known.items() if len(path)}


def zeros_to_missing(markers: Array) -> tuple[Array, tuple[str, ...]]:
    """Markers (nf, nm, 3) with the literal 0 0 0 that some programs write for a gap made NaN, and a
    note if any was.

    A marker known in part is not known: where one coordinate is NaN, all three are.
    """
    zero = (markers == 0).all(axis=2)
    part = np.isnan(markers).any(axis=2)
    notes: tuple[str, ...] = ()
    if zero.any():
        where = int(zero.any(axis=0).sum())
        notes = (
            f"{int(zero.sum())} positions of exactly 0 0 0 taken as gaps, in {where} markers.",
        )
    return np.where((zero | part)[:, :, None], np.nan, markers), notes


def require_plain_labels(recording: Recording) -> None:
    """FileFault for marker or plate names that no text table can hold."""
    for name in (*recording.labels, *(plate.name for plate in recording.plates)):
        if clean(name) != name or not name:
            message = f"the name {name[:40]!r} cannot be written; it has odd characters"
            raise FileFault(message, code=Code.NOT_WRITABLE)


def runs(marked: BoolArray, shortest: int = 1) -> list[slice]:
    """Stretches of at least `shortest` marked frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [
        slice(int(a), int(b))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a >= shortest
    ]


def duration(time: Array, stretch: slice) -> float:
    """Time (s) from the first to the last frame of a stretch."""
    return float(time[stretch.stop - 1] - time[stretch.start])


def spans(time: Array, stretches: Sequence[slice], most: int = 3) -> str:
    """Stretches of frames as times, `0.42-0.58, 1.10-1.12 s`."""
    named = [f"{time[s.start]:.2f}-{time[s.stop - 1]:.2f}" for s in stretches[:most]]
    more = f" and {len(stretches) - most} more" if len(stretches) > most else ""
    return ", ".join(named) + f" s{more}"


@dataclass(frozen=True)
class MarkerGaps:
    """The gaps of one marker."""

    label: str
    seen: float  # Share of the frames in which it was seen, 0 to 1
    longest_gap: float
    """s from the last frame before to the first frame after the longest gap; at an end of the
    trial, to that end.
    """


def marker_gaps(recording: Recording) -> tuple[MarkerGaps, ...]:
    """One entry for each marker, in the order of the labels."""
    visible = seen_mask(recording.markers)
    time = recording.time
    gaps = []
    for index, label in enumerate(recording.labels):
        frames = np.flatnonzero(visible[:, index])
        if len(frames) == 0:
            longest = float(time[-1] - time[0])
        else:
            last = np.flatnonzero(np.diff(frames) > 1)
            between = (time[frames[last + 1]] - time[frames[last]]).max(initial=0.0)
            longest = float(max(between, time[frames[0]] - time[0], time[-1] - time[frames[-1]]))
        gaps.append(MarkerGaps(label, float(len(frames) / len(time)), longest))
    return tuple(gaps)


# ------------------------------------------------------------------------------------- the still part of a trial


@dataclass(frozen=True)
class StillWindow:
    """Where a subject stood still."""

    frames: slice  # Frames of the recording
    speed: float
    """m/s, RMS over frames and markers of the averaged paths; of a recording shorter than LAG_S the
    median over its markers; 0 for a single frame, which has none."""
    start: float  # s
    stop: float  # s, time of the last frame
    scatter: float = 0.0
    """m, RMS distance of the markers from their means over the window: how far a landmark of this
    posture is uncertain because the person moved."""


def still_window(recording: Recording, labels: Iterable[str]) -> StillWindow:
    """The window of `DURATION_S` in which most of the markers `labels` are seen, and of those the
    stillest.

    Without a still one, the stillest that is merely restless. A recording shorter than `DURATION_S`
    is taken whole, one shorter than LAG_S even where it moves a little: noise moves it, too.
    InputError where none of the labels is ever seen, or where no window is slower than
    RESTLESS_M_S; it names the smallest speed found.
    """

    def fault(message: str, code: Code = Code.NO_STILL_WINDOW) -> InputError:
        return InputError(message, source=recording.source, field="static trial", code=code)

    wanted = list(dict.fromkeys(labels))
    places = [recording.labels.index(label) for label in wanted if label in recording.labels]
    time, markers = recording.time, recording.markers[:, places]
    if not places or not seen_mask(markers).any():
        some = ", ".join(wanted[:6]) + ("..." if len(wanted) > 6 else "")
        raise fault(f"none of the markers {some} is seen", Code.TOO_LITTLE_SEEN)
    frames = len(time)
    if time[-1] - time[0] < LAG_S:
        speed = _speed_of_few(time, markers)
        if speed > WALKS_M_S:
            message = (
                f"no still window: {frames} frames in all, half of the markers move at {speed:.3g} "
                "m/s or more; "
            )
            message += f"at most {WALKS_M_S:g} m/s is allowed where there are so few"
            raise fault(message)
        return StillWindow(
            slice(0, frames), speed, float(time[0]), float(time[-1]), _scatter(markers)
        )
    length = min(frames, max(2, round(DURATION_S * recording.rate) + 1))
    lag = min(length - 1, max(1, round(LAG_S * recording.rate)))
    speeds = _speeds(time, markers, lag, length)
    wide = max(1, min(round(SMOOTH_S * recording.rate), length - lag))
    smooth = _speeds(*_averaged(time, markers, wide), lag, length - wide + 1)
    for ranking, limit in ((speeds, STILL_M_S), (smooth, STILL_M_S), (smooth, RESTLESS_M_S)):
        slow = ranking <= limit
        if slow.any():
            break
    else:
        reason = (
            f"the stillest {length / recording.rate:.2g} s move at "
            f"{np.nanmin([*smooth, np.inf]):.3g} m/s RMS"
        )
        if np.isnan(smooth).all():
            reason = "no marker is seen twice within a window"
        raise fault(f"no still window: {reason}; at most {RESTLESS_M_S:g} m/s is allowed")
    coverage = (_moving_sum(seen_mask(markers).astype(np.float64), length) > 0.5).sum(axis=1)
    start = int(np.argmin(np.where(slow & (coverage == coverage[slow].max()), ranking, np.inf)))
    window = slice(start, start + length)
    speed = float(smooth[start] if np.isfinite(smooth[start]) else speeds[start])
    return StillWindow(
        window, speed, float(time[window][0]), float(time[window][-1]), _scatter(markers[window])
    )


def _speed_of_few(time: Array, markers: Array) -> float:
    """m/s from the first to the second half of frames too few to tell noise from movement; 0 of a
    single one.

    The median over the markers, as one of them that jumps would make the RMS of all look like a
    walk.
    """
    half = len(time) // 2
    if half == 0:
        return 0.0
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # a marker seen in one half alone says nothing
        way = np.nanmean(markers[half:], axis=0) - np.nanmean(markers[:half], axis=0)
    ways = np.linalg.norm(way[np.isfinite(way).all(axis=1)], axis=1)
    lasts = float(time[half:].mean() - time[:half].mean())
    return float(np.median(ways)) / lasts if len(ways) else 0.0


def _scatter(markers: Array) -> float:
    """m, RMS distance of markers (nf, nm, 3) from their means over the frames; those seen once say
    nothing.
    """
    visible = seen_mask(markers)
    often = visible.sum(axis=0) > 1
    kept = np.where(visible[:, often, None], markers[:, often], 0.0)
    count = visible[:, often].sum(axis=0)
    away = np.where(
        visible[:, often, None], markers[:, often] - kept.sum(axis=0) / count[:, None], 0.0
    )
    return float(np.sqrt((away**2).sum() / max(int(count.sum()), 1)))


def _averaged(time: Array, markers: Array, wide: int) -> tuple[Array, Array]:
    """Times and paths (nf - wide + 1, nm, 3), each the mean over `wide` frames; NaN where a marker
    is seldom seen.
    """
    known = seen_mask(markers)
    count = _moving_sum(known.astype(np.float64), wide)
    total = _moving_sum(np.where(known[..., None], markers, 0.0), wide)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count[..., None]
    mean[count < SEEN * wide] = np.nan
    return _moving_sum(time, wide) / wide, mean


def _speeds(time: Array, markers: Array, lag: int, length: int) -> Array:
    """RMS speed of each window of `length` frames, m/s; NaN where unknown."""
    steps = (time[lag:] - time[:-lag])[:, None]
    squares = np.sum((markers[lag:] - markers[:-lag]) ** 2, axis=2) / steps**2
    known = np.isfinite(squares)
    total = _moving_sum(np.where(known, squares, 0.0).sum(axis=1), length - lag)
    count = _moving_sum(known.sum(axis=1).astype(np.float64), length - lag)
    with np.errstate(invalid="ignore", divide="ignore"):
        speeds: Array = np.sqrt(np.maximum(total, 0.0) / count)
    speeds[count < 0.5] = np.nan
    return speeds


def _moving_sum(values: Array, length: int) -> Array:
    """Sums over `length` successive values (n, ...), one for each start."""
    cumulative = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return np.asarray(cumulative[length:] - cumulative[:-length])
