"""Clean one trial: markers metres away from the body, single positions out of line, and frames
without the pelvis are left out.

No least-squares fit survives a marker metres away. c(s, t) is the median, coordinate by coordinate,
of all markers seen in frame t on segment s and on those that a joint connects with it. A marker of
s farther than REACH from c is nowhere on that body. The median stands while fewer than half of
these markers stray; where more of all markers do, the unit or the labels are wrong, which is
another fault.

Nor is a marker on a body in a single frame k whose path goes on without it: with a its distance
from the middle of x_k-1 and x_k+1, and s the step between these two less the steps before and
after, it is left out where a is more than any acceleration of a body makes of it and s is not. A
path that steps aside, as where labels are exchanged, is not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_runs, find_visible, format_spans, measure_duration
from gaitcal.model.linkage import JOINTS, find_base_segment, get_segment
from gaitcal.model.subject_model import PointNoise
from gaitcal.study.study_trial import Role, Trial

REACH_M = 1.0
"""m; markers of one segment and its neighbours lie within 0.6 m of their median on people of 1.8 m,
arms raised.
"""
FEWEST_AROUND = (
    4  # markers of a median; segments with fewer around them are held against the whole body
)
REACH_BODY_M = 1.7  # m; from the median of the whole body wrists have been up to 0.94 m away
MOST_SHARE = 0.3  # share of all markers that may stray in a frame


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """A marker that was left out where it is metres away from the body."""

    label: str
    frames: int
    visible_frames: int  # frames in which it was seen at all
    farthest: float  # m, from the markers around it
    when: str  # from when to when, s

    @property
    def description(self) -> str:
        """Which marker, how far, how long."""
        return (
            f"{self.label} up to {self.farthest:.1f} m away, {self.frames} of {self.visible_frames} frames "
            f"({self.when})"
        )


def remove_outliers(
    recording: Recording, segment_of: Mapping[str, str]
) -> tuple[Recording, tuple[Outlier, ...]]:
    """The recording with markers of the given segments left out where they are metres away, and
    which these were.

    `segment_of`: label -> segment. A marker that is nowhere on the body loses its column.
    """
    found, away = _find_outliers(recording, segment_of)
    if not found.any():
        return recording, ()
    visible = find_visible(recording.markers)
    outliers = tuple(
        Outlier(
            label=recording.labels[k],
            frames=int(found[:, k].sum()),
            visible_frames=int(visible[:, k].sum()),
            farthest=float(away[found[:, k], k].max()),
            when=format_spans(recording.time, find_runs(found[:, k])),
        )
        for k in np.flatnonzero(found.any(axis=0))
    )
    kept = [
        k
        for k in range(len(recording.labels))
        if not found[:, k].any() or (visible[:, k] & ~found[:, k]).any()
    ]
    masked = np.where(found[:, :, None], np.nan, recording.markers)
    note = (
        "Markers left out where they are metres away from the body: "
        f"{'; '.join(o.description for o in outliers)}."
    )
    labels = tuple(recording.labels[k] for k in kept)
    return replace(recording, labels=labels, markers=masked[:, kept]).with_notes(note), outliers


def _find_outliers(recording: Recording, segment_of: Mapping[str, str]) -> tuple[BoolArray, Array]:
    """(nf, nm) where a marker is out of reach, and how far (m) each is from the median of the
    markers around it.
    """
    x, visible = recording.markers, find_visible(recording.markers)
    out, away = np.zeros_like(visible), np.full(visible.shape, np.nan)
    of_marker = np.array([segment_of.get(label, "") for label in recording.labels])
    known = np.flatnonzero(of_marker != "")
    if len(known) < FEWEST_AROUND:
        return out, away
    for segment in dict.fromkeys(of_marker[known].tolist()):
        on, around = (
            np.flatnonzero(of_marker == segment),
            np.flatnonzero(np.isin(of_marker, list(_list_near_segments(segment)))),
        )
        few = len(around) < FEWEST_AROUND
        centre = _compute_median(x[:, known if few else around])
        away[:, on] = np.linalg.norm(x[:, on] - centre[:, None], axis=2)
        out[:, on] = away[:, on] > (REACH_BODY_M if few else REACH_M)
    out[out.sum(axis=1) > MOST_SHARE * np.maximum(visible[:, known].sum(axis=1), 1)] = False
    return out, away


def _list_near_segments(segment: str) -> set[str]:
    """A segment and its neighbours with markers."""

    def beside(one: str) -> set[str]:
        return {
            one,
            *(e for j in JOINTS if one in (j.parent, j.child) for e in (j.parent, j.child)),
        }

    near = beside(segment)
    for between in [
        s for s in near if not get_segment(s).markers
    ]:  # a segment that never carries markers
        near = near | beside(between)
    return near


def _compute_median(x: Array) -> Array:
    """(nf, 3) lower median of x (nf, n, 3) over the markers seen; NaN where none is."""
    ordered = np.sort(x, axis=1)  # gaps come last
    count = np.isfinite(x[:, :, 0]).sum(axis=1)
    return np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None, None], axis=1)[:, 0]


SPIKE_M, SPIKE_ACCELERATION = 0.02, 300.0
"""m, m/s^2: the smallest jump out of line, and the largest acceleration of a marker that is still
on a body.
"""
# Share of a marker's frames: what is out of line in more of them is noise, which has no exceptions
MOST_SPIKES = 0.05


SPIKE_DEVIATIONS = 6.0
"""Standard deviations of a coordinate of points that are no markers; three frames of white noise
make 1.2 of one.
"""


def compute_jump_limit(recording: Recording, noise: PointNoise | None) -> float:
    """m, how far a marker, or a point with a noise of its own, may be out of line with the frames
    before and after.
    """
    of_noise = 0.0 if noise is None else SPIKE_DEVIATIONS * 1e-3 * noise.size_mm
    return max(SPIKE_M, 0.5 * SPIKE_ACCELERATION / recording.rate**2, of_noise)


Spikes: TypeAlias = dict[str, tuple[int, float]]
"""Marker -> how many single positions lie out of line, and how far (m) the farthest."""


def remove_spikes(
    recording: Recording, noise: PointNoise | None = None
) -> tuple[Recording, Spikes]:
    """The recording without single positions that lie out of line with their neighbours, and which
    these were.
    """
    x, limit = recording.markers, compute_jump_limit(recording, noise)
    if len(x) < 5:
        return recording, {}
    before, one, after = x[1:-3] - x[:-4], x[3:-1] - x[1:-3], x[4:] - x[3:-1]
    before, after = (np.where(np.isfinite(a), a, b) for a, b in ((before, after), (after, before)))
    away = np.linalg.norm(x[2:-2] - 0.5 * (x[3:-1] + x[1:-3]), axis=2)
    goes_on = np.linalg.norm(one - before - after, axis=2) <= limit
    out = np.zeros(x.shape[:2], dtype=bool)
    out[2:-2] = (away > limit) & goes_on
    rare = out.sum(axis=0) <= MOST_SPIKES * find_visible(x).sum(axis=0)
    out &= rare
    if not out.any():
        return recording, {}
    farthest = np.where(out[2:-2], away, 0.0).max(axis=0)
    found = {
        recording.labels[k]: (int(out[:, k].sum()), float(farthest[k]))
        for k in np.flatnonzero(out.any(axis=0))
    }
    entries = (f"{label} {n} frames, up to {1e3 * far:.0f} mm" for label, (n, far) in found.items())
    note = f"Single positions out of line with their neighbours are left out: {'; '.join(entries)}."
    return replace(recording, markers=np.where(out[:, :, None], np.nan, x)).with_notes(note), found


@dataclass(frozen=True, kw_only=True)
class CleanTrial(Trial):
    """A trial as it is fitted, and what was left out of its recording."""

    outliers: tuple[Outlier, ...] = ()
    """Markers that were left out where they were metres away from the body."""
    spikes: Spikes = field(default_factory=dict)
    """Single positions out of line that were left out."""
    cut: str = ""
    """What was left out of the recording as it does not show the pelvis; empty: nothing."""


BRIDGED_S = 0.2
"""Without three markers the splines carry a pelvis over so much; more hides a part of a step."""


def clean_trial(
    trial: Trial, segment_of: Mapping[str, str], noise: PointNoise | None = None
) -> CleanTrial:
    """Leave out what no least-squares fit survives.

    These are markers metres away from the body and, where the trial moves, single positions out of
    line; it is cut to the longest part that shows the pelvis it hangs on.

    Parameters
    ----------
    trial
        As read.
    segment_of
        Label -> segment.
    noise
        Of the marker set, where its points are no markers.
    """
    recording, outliers = remove_outliers(trial.recording, segment_of)
    given = {f.name: getattr(trial, f.name) for f in fields(Trial)}
    if trial.role is Role.STATIC:
        return CleanTrial(**{**given, "recording": recording}, outliers=outliers)
    recording, spikes = remove_spikes(recording, noise)
    if find_base_segment(trial.joint) in ("", "pelvis"):
        recording, cut = _cut_to_pelvis(recording, segment_of)
    else:
        cut = ""
    return CleanTrial(
        **{**given, "recording": recording}, outliers=outliers, spikes=spikes, cut=cut
    )


def _cut_to_pelvis(recording: Recording, segment_of: Mapping[str, str]) -> tuple[Recording, str]:
    """The longest part of a recording that shows the pelvis, and what was left out for it."""
    time = recording.time
    pelvis = [i for i, label in enumerate(recording.labels) if segment_of.get(label) == "pelvis"]
    lost = find_visible(recording.markers[:, pelvis]).sum(axis=1) < 3
    lasting = [run for run in find_runs(lost) if measure_duration(time, run) > BRIDGED_S]
    if not lasting or lost.all():
        return recording, ""
    edges = [0, *(edge for run in lasting for edge in (run.start, run.stop)), len(time)]
    start, stop = max(zip(edges[::2], edges[1::2], strict=True), key=lambda part: part[1] - part[0])
    frames = np.arange(len(time))
    message = (
        f"fewer than three pelvis markers in {100 * np.mean(lost):.0f} % of the frames "
        f"({format_spans(time, lasting)}): the trial is cut to {time[start]:.2f}-{time[stop - 1]:.2f} s, "
        "the longest part that shows the pelvis"
    )
    return recording.frames((frames >= start) & (frames < stop)).with_notes(message), message
