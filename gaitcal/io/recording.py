"""Hold the markers and force plates of one trial, and find visible, still and marked frames.

Frames and units are fixed on reading: metres, seconds, newtons, newton metres; y up, right-handed.
The rotation about the vertical that brings x along the progression is a separate step (`axes.py`).
Gaps are never filled; later they have zero weight.

Periods of frames are slices. A static trial may contain walking before and after its stillest
period. The speed of a period is the RMS, over its frames and markers, of the displacement during
LAG_S divided by LAG_S. The lag suppresses measurement noise: noise of 0.2 mm reads as 28 mm/s from
one 100 Hz frame to the next, and as 3 mm/s with the lag. If no period looks still, paths are first
averaged over SMOOTH_S: white noise of 3 mm then reads as 12 mm/s instead of 73 mm/s, while walking
and slow sway keep their speed.
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
from gaitcal.io.labels import ComputedPoints, Facts, FootEvent, clean_label
from gaitcal.io.text_file import FileFault

if TYPE_CHECKING:
    import pandas as pd

LAG_S = 0.1
STILL_M_S = 0.05
"""Largest speed (m/s) of a still window.

Quiet standing sways at up to 0.02 m/s at head height; the slowest walk moves a body at over
0.2 m/s. In 0.5 s at this speed a marker moves by at most 12 mm from its mean.
"""
RESTLESS_M_S = 0.1
"""Largest speed (m/s) of a window that is used with a warning if none is still.

It is half of the slowest walk. The mean of a marker over 0.5 s is within 12 mm of where it was for
half of the time.
"""
WALKS_M_S = 0.3
"""Largest speed (m/s) of a recording shorter than LAG_S.

The slowest walk moves a body at over 0.2 m/s; noise of 1 mm reads as 0.2 m/s at 100 Hz.
"""
SMOOTH_S = 0.2
VISIBLE_SHARE = 0.7
"""Least share of the averaged frames in which a marker must be visible.

The mean of a part of a movement is at another position.
"""
WINDOW_S = 0.5


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
    """(ns,) s, on the same time axis as the markers; may be denser than the marker frames."""
    force: Array
    """(ns, 3) N."""
    point: Array
    """(ns, 3) m."""
    moment: Array
    """(ns, 3) N·m about `point`."""
    corners: Array | None = None
    """(4, 3) m, or None if the file does not have them."""

    def wrench(self) -> Array:
        """Compute the (ns, 6) force and moment about the laboratory origin, N and N·m."""
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
    """(nf, nm, 3) m; NaN where a marker was not visible."""
    plates: tuple[ForcePlate, ...] = ()
    """Force plates, in the order of the file; none where forces were not recorded."""
    feet: Mapping[str, str] = field(default_factory=dict)
    """Plate -> "r" or "l", if the file of the forces gives the foot on which it acts."""
    notes: tuple[str, ...] = field(default=())
    """Assumptions, conversions and omissions on reading, one sentence each; in every output."""
    events: tuple[FootEvent, ...] = ()
    """Foot strikes and offs of the file, in order of time."""
    corrected: bool = False
    """Whether a person corrected `events` (`events.csv`); then no others are used."""
    facts: Facts = field(default=Facts())
    """Subject data of the file."""
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
            f", {100 * find_visible(self.markers).mean():.1f} % of samples visible"
            if self.markers.size
            else ""
        )
        plates = [f"{plate.name} ({_compute_plate_rate(plate):.0f} Hz)" for plate in self.plates]
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
        """Return the recording with further notes, one sentence each."""
        return replace(self, notes=self.notes + notes)

    def frames(self, chosen: BoolArray) -> "Recording":
        """Return the recording with its frames `chosen` only; plates keep all their samples.

        Parameters
        ----------
        chosen : (nf,)
            Frames to keep.

        Returns
        -------
        Recording
            With fewer frames.
        """
        computed = self.computed
        if computed is not None:
            computed = ComputedPoints(computed.labels, computed.points[chosen])
        return replace(
            self, time=self.time[chosen], markers=self.markers[chosen], computed=computed
        )


AXES = tuple(enumerate("xyz"))


def _compute_plate_rate(plate: ForcePlate) -> float:
    """Return the samples per second of a force plate (median step); NaN for fewer than two."""
    return float(1.0 / np.median(np.diff(plate.time))) if len(plate.time) > 1 else float("nan")


def find_visible(markers: Array) -> BoolArray:
    """Find in which frames each marker is visible; a marker with one NaN coordinate is not.

    Parameters
    ----------
    markers : (nf, nm, 3)
        Marker positions, m.

    Returns
    -------
    BoolArray
        (nf, nm)
    """
    return np.asarray(np.isfinite(markers).all(axis=2), dtype=np.bool_)


def average_visible(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Average paths over the frames in which they are known.

    Parameters
    ----------
    paths
        Name -> (nf, 3) m, NaN where unknown.

    Returns
    -------
    dict
        Name -> (3,) m, without paths that are never known.
    """
    known = {name: path[np.isfinite(path).all(axis=1)] for name, path in paths.items()}
    return {name: path.mean(axis=0) for name, path in known.items() if len(path)}


def replace_zeros(markers: Array) -> tuple[Array, tuple[str, ...]]:
    """Replace positions of exactly 0 0 0, which some programs write for a gap, by NaN.

    A marker with one NaN coordinate becomes NaN in all three.

    Parameters
    ----------
    markers : (nf, nm, 3)
        Marker positions as read.

    Returns
    -------
    markers, notes
        The positions, and a note if any was replaced.
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
    """Require marker and plate names that a text table can hold.

    Raises
    ------
    FileFault
        A name has control characters or is empty.
    """
    for name in (*recording.labels, *(plate.name for plate in recording.plates)):
        if clean_label(name) != name or not name:
            message = f"the name {name[:40]!r} cannot be written; it has odd characters"
            raise FileFault(message, code=Code.NOT_WRITABLE)


def find_runs(marked: BoolArray, shortest: int = 1) -> list[slice]:
    """Find the runs of at least `shortest` consecutive marked frames.

    Parameters
    ----------
    marked : (nf,)
        Marked frames.
    shortest
        Least number of frames.

    Returns
    -------
    list of slice
        In order of time.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [
        slice(int(a), int(b))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a >= shortest
    ]


def measure_duration(time: Array, stretch: slice) -> float:
    """Measure the time (s) from the first to the last frame of a run."""
    return float(time[stretch.stop - 1] - time[stretch.start])


def format_spans(time: Array, stretches: Sequence[slice], most: int = 3) -> str:
    """Format runs of frames as times, such as `0.42-0.58, 1.10-1.12 s`.

    Parameters
    ----------
    time : (nf,)
        s.
    stretches
        Runs of frames.
    most
        Number of runs that are written out; further ones are counted.

    Returns
    -------
    str
        Times in s.
    """
    named = [f"{time[s.start]:.2f}-{time[s.stop - 1]:.2f}" for s in stretches[:most]]
    more = f" and {len(stretches) - most} more" if len(stretches) > most else ""
    return ", ".join(named) + f" s{more}"


@dataclass(frozen=True)
class MarkerGaps:
    """Visibility and longest gap of one marker."""

    label: str
    visible_share: float  # Share of the frames in which it was visible, 0 to 1
    longest_gap: float
    """s, from the last frame before to the first frame after the longest gap.

    A gap at an end of the trial counts to that end.
    """


def measure_gaps(recording: Recording) -> tuple[MarkerGaps, ...]:
    """Measure the gaps of every marker, in the order of the labels.

    Parameters
    ----------
    recording
        Recording with at least one frame.

    Returns
    -------
    tuple of MarkerGaps
        One entry for each marker.
    """
    visible = find_visible(recording.markers)
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


# ------------------------------------------------------------------------ the still part of a trial


@dataclass(frozen=True)
class StillWindow:
    """Window in which a subject stood still."""

    frames: slice  # Frames of the recording
    speed: float
    """m/s, RMS over frames and markers of the averaged paths.

    For a recording shorter than LAG_S it is the median over its markers; for a single frame, 0.
    """
    start: float  # s
    stop: float  # s, time of the last frame
    scatter: float = 0.0
    """m, RMS distance of the markers from their means over the window.

    It is the uncertainty of a landmark of this posture that is due to movement.
    """


def find_still_window(recording: Recording, labels: Iterable[str]) -> StillWindow:
    """Find the stillest window of `WINDOW_S` among those with the most visible markers.

    If none is still, the stillest restless one is taken. A recording shorter than `WINDOW_S` is
    taken whole. One shorter than `LAG_S` may move a little more, as noise dominates its speed.

    Parameters
    ----------
    recording
        Recording of a static trial.
    labels
        Markers to look at.

    Returns
    -------
    StillWindow
        The window.

    Raises
    ------
    InputError
        No marker of `labels` is visible, or no window is slower than `RESTLESS_M_S`; the message
        has the smallest speed.
    """

    def fault(message: str, code: Code = Code.NO_STILL_WINDOW) -> InputError:
        return InputError(message, source=recording.source, field="static trial", code=code)

    wanted = list(dict.fromkeys(labels))
    places = [recording.labels.index(label) for label in wanted if label in recording.labels]
    time, markers = recording.time, recording.markers[:, places]
    if not places or not find_visible(markers).any():
        some = ", ".join(wanted[:6]) + ("..." if len(wanted) > 6 else "")
        raise fault(f"none of the markers {some} is visible", Code.TOO_LITTLE_SEEN)
    frames = len(time)
    if time[-1] - time[0] < LAG_S:
        speed = _estimate_speed_of_few(time, markers)
        if speed > WALKS_M_S:
            message = (
                f"no still window: {frames} frames in all, half of the markers move at {speed:.3g} "
                "m/s or more; "
            )
            message += f"at most {WALKS_M_S:g} m/s is allowed where there are so few"
            raise fault(message)
        return StillWindow(
            slice(0, frames), speed, float(time[0]), float(time[-1]), _measure_scatter(markers)
        )
    # Speeds of all windows, of the paths as measured and averaged; the first that is slow enough
    length = min(frames, max(2, round(WINDOW_S * recording.rate) + 1))
    lag = min(length - 1, max(1, round(LAG_S * recording.rate)))
    speeds = _compute_speeds(time, markers, lag, length)
    wide = max(1, min(round(SMOOTH_S * recording.rate), length - lag))
    smooth = _compute_speeds(*_average_paths(time, markers, wide), lag, length - wide + 1)
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
            reason = "no marker is visible in two frames of a window"
        raise fault(f"no still window: {reason}; at most {RESTLESS_M_S:g} m/s is allowed")
    coverage = (_sum_moving(find_visible(markers).astype(np.float64), length) > 0.5).sum(axis=1)
    start = int(np.argmin(np.where(slow & (coverage == coverage[slow].max()), ranking, np.inf)))
    window = slice(start, start + length)
    speed = float(smooth[start] if np.isfinite(smooth[start]) else speeds[start])
    return StillWindow(
        window,
        speed,
        float(time[window][0]),
        float(time[window][-1]),
        _measure_scatter(markers[window]),
    )


def _estimate_speed_of_few(time: Array, markers: Array) -> float:
    """Estimate the speed (m/s) from the first to the second half of a few frames.

    The median over the markers is used, as one marker that jumps would dominate an RMS. A single
    frame has speed 0.
    """
    half = len(time) // 2
    if half == 0:
        return 0.0
    with warnings.catch_warnings():
        # A marker that is visible in one half only has no speed
        warnings.simplefilter("ignore", RuntimeWarning)
        way = np.nanmean(markers[half:], axis=0) - np.nanmean(markers[:half], axis=0)
    ways = np.linalg.norm(way[np.isfinite(way).all(axis=1)], axis=1)
    lasts = float(time[half:].mean() - time[:half].mean())
    return float(np.median(ways)) / lasts if len(ways) else 0.0


def _measure_scatter(markers: Array) -> float:
    """Measure the RMS distance (m) of markers from their means; one visible frame is too few."""
    visible = find_visible(markers)
    often = visible.sum(axis=0) > 1
    kept = np.where(visible[:, often, None], markers[:, often], 0.0)
    count = visible[:, often].sum(axis=0)
    away = np.where(
        visible[:, often, None], markers[:, often] - kept.sum(axis=0) / count[:, None], 0.0
    )
    return float(np.sqrt((away**2).sum() / max(int(count.sum()), 1)))


def _average_paths(time: Array, markers: Array, wide: int) -> tuple[Array, Array]:
    """Average times and paths over `wide` frames; NaN where a marker is seldom visible."""
    known = find_visible(markers)
    count = _sum_moving(known.astype(np.float64), wide)
    total = _sum_moving(np.where(known[..., None], markers, 0.0), wide)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count[..., None]
    mean[count < VISIBLE_SHARE * wide] = np.nan
    return _sum_moving(time, wide) / wide, mean


def _compute_speeds(time: Array, markers: Array, lag: int, length: int) -> Array:
    """Compute the RMS speed (m/s) of each window of `length` frames; NaN where unknown."""
    steps = (time[lag:] - time[:-lag])[:, None]
    squares = np.sum((markers[lag:] - markers[:-lag]) ** 2, axis=2) / steps**2
    known = np.isfinite(squares)
    total = _sum_moving(np.where(known, squares, 0.0).sum(axis=1), length - lag)
    count = _sum_moving(known.sum(axis=1).astype(np.float64), length - lag)
    with np.errstate(invalid="ignore", divide="ignore"):
        speeds: Array = np.sqrt(np.maximum(total, 0.0) / count)
    speeds[count < 0.5] = np.nan
    return speeds


def _sum_moving(values: Array, length: int) -> Array:
    """Sum `length` successive values (n, ...), for each start."""
    cumulative = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return np.asarray(cumulative[length:] - cumulative[:-length])
