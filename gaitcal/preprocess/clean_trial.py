"""Clean one trial: remove outliers, isolated jumps, and frames in which the pelvis is not visible.

*Outliers.* No least-squares fit tolerates a marker metres away. Let c(s, t) be the median,
coordinate by coordinate, of all markers visible in frame t on segment s and on the segments that
share a joint with s. A marker of s farther than `REACH_M` from c(s, t) is removed in that frame.
Nothing is removed in a frame in which more than `MOST_SHARE` of all markers are that far: the
unit or the labels are wrong then, which is a separate finding.

*Isolated jumps.* With a the distance of x_k from the midpoint of x_(k-1) and x_(k+1), and s the
step between these two less the steps before and after it, position k is removed where a is larger
than any acceleration of a body explains and s is not. Swapped labels are therefore kept: their
path continues at another position.

*Frames without the pelvis.* A moving trial that is tracked from the pelvis is cut to its longest
part that shows three pelvis markers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_runs, find_visible, format_spans, measure_duration
from gaitcal.model.linkage import JOINTS, find_base_segment, get_segment
from gaitcal.model.subject_model import PointNoise
from gaitcal.study.study_trial import Role, Trial

REACH_M = 1.0
"""m. Markers of a segment and its neighbours lie within 0.6 m of their median on people of 1.8 m
with raised arms.
"""
FEWEST_AROUND = 4
"""Markers for a median; a segment with fewer nearby is compared with the whole body."""
REACH_BODY_M = 1.7
"""m, from the median of the whole body: wrists are up to 0.94 m away."""
MOST_SHARE = 0.3
"""Share of all markers that may be outliers in one frame."""


@dataclass(frozen=True, kw_only=True)
class Outlier:
    """A marker that was removed in the frames in which it is metres away from the body."""

    label: str
    frames: int
    """Number of frames in which it was removed."""
    visible_frames: int
    """Number of frames in which it was visible at all."""
    farthest: float
    """m, largest distance from the median of the markers around it."""
    when: str
    """Time spans (s) of the removed frames."""

    @property
    def description(self) -> str:
        """Label, distance, number of frames and time spans."""
        return (
            f"{self.label} up to {self.farthest:.1f} m away, "
            f"{self.frames} of {self.visible_frames} frames ({self.when})"
        )


def remove_outliers(
    recording: Recording, segment_of: Mapping[str, str]
) -> tuple[Recording, tuple[Outlier, ...]]:
    """Remove markers of the given segments in frames in which they are metres away from the body.

    Parameters
    ----------
    recording
        Marker positions of one trial.
    segment_of
        Label -> segment. Markers that are not listed are kept.

    Returns
    -------
    recording : Recording
        NaN where a marker was removed. A marker that is never near the body loses its column.
    outliers : tuple of Outlier
        One entry per marker that was removed in any frame.
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
        "Markers removed in frames in which they are metres away from the body: "
        f"{'; '.join(outlier.description for outlier in outliers)}."
    )
    labels = tuple(recording.labels[k] for k in kept)
    return replace(recording, labels=labels, markers=masked[:, kept]).with_notes(note), outliers


def _find_outliers(recording: Recording, segment_of: Mapping[str, str]) -> tuple[BoolArray, Array]:
    """Return which positions (nf, nm) are outliers, and their distances (nf, nm) m."""
    x, visible = recording.markers, find_visible(recording.markers)
    out, away = np.zeros_like(visible), np.full(visible.shape, np.nan)
    of_marker = np.array([segment_of.get(label, "") for label in recording.labels])
    known = np.flatnonzero(of_marker != "")
    if len(known) < FEWEST_AROUND:
        return out, away
    for segment in dict.fromkeys(of_marker[known].tolist()):
        on = np.flatnonzero(of_marker == segment)
        around = np.flatnonzero(np.isin(of_marker, list(_list_near_segments(segment))))
        # too few neighbours: compare with the whole body, at a larger distance
        few = len(around) < FEWEST_AROUND
        centre = _compute_median(x[:, known if few else around])
        away[:, on] = np.linalg.norm(x[:, on] - centre[:, None], axis=2)
        out[:, on] = away[:, on] > (REACH_BODY_M if few else REACH_M)
    # where many markers stray, the median itself is wrong
    out[out.sum(axis=1) > MOST_SHARE * np.maximum(visible[:, known].sum(axis=1), 1)] = False
    return out, away


def _list_near_segments(segment: str) -> set[str]:
    """List a segment and its neighbours; across a segment without markers the next one."""

    def list_neighbours(centre: str) -> set[str]:
        neighbours = {centre}
        for joint in JOINTS:
            if centre in (joint.parent, joint.child):
                neighbours |= {joint.parent, joint.child}
        return neighbours

    near = list_neighbours(segment)
    # a segment that never carries markers
    for between in [name for name in near if not get_segment(name).markers]:
        near = near | list_neighbours(between)
    return near


def _compute_median(x: Array) -> Array:
    """Compute (nf, 3), the lower median of x (nf, n, 3) over the visible markers."""
    # gaps come last
    ordered = np.sort(x, axis=1)
    count = np.isfinite(x[:, :, 0]).sum(axis=1)
    return np.take_along_axis(ordered, (np.maximum(count - 1, 0) // 2)[:, None, None], axis=1)[:, 0]


SPIKE_M = 0.02
"""m, smallest isolated jump."""
SPIKE_ACCELERATION = 300.0
"""m/s^2, largest acceleration of a marker that is still on a body."""
MOST_SPIKES = 0.05
"""Share of a marker's frames. More jumps than this are noise, which is not removed."""
SPIKE_DEVIATIONS = 6.0
"""Smallest jump of a markerless point, in standard deviations of a coordinate: three frames of
white noise give 1.2.
"""


def compute_jump_limit(recording: Recording, noise: PointNoise | None) -> float:
    """Compute how far a position may be from the midpoint of its neighbours in time.

    Parameters
    ----------
    recording
        Only its sampling rate is used.
    noise
        Of markerless points; None for markers.

    Returns
    -------
    float
        m.
    """
    of_noise = 0.0 if noise is None else SPIKE_DEVIATIONS * 1e-3 * noise.size_mm
    return max(SPIKE_M, 0.5 * SPIKE_ACCELERATION / recording.rate**2, of_noise)


Spikes: TypeAlias = dict[str, tuple[int, float]]
"""Marker -> number of isolated jumps, and the distance (m) of the largest one."""


def remove_spikes(
    recording: Recording, noise: PointNoise | None = None
) -> tuple[Recording, Spikes]:
    """Remove single positions that jump away from their neighbours in time and come back.

    `recording`: marker positions (nf, nm, 3) of one trial. `noise`: of markerless points; None for
    markers. Returns: `recording` NaN at the removed positions; `spikes` marker -> number of removed
    positions, and the distance (m) of the largest jump.
    """
    x, limit = recording.markers, compute_jump_limit(recording, noise)
    if len(x) < 5:
        return recording, {}
    before, across, after = x[1:-3] - x[:-4], x[3:-1] - x[1:-3], x[4:] - x[3:-1]
    # next to a gap the step on the other side stands for both
    before, after = (np.where(np.isfinite(a), a, b) for a, b in ((before, after), (after, before)))
    away = np.linalg.norm(x[2:-2] - 0.5 * (x[3:-1] + x[1:-3]), axis=2)
    goes_on = np.linalg.norm(across - before - after, axis=2) <= limit
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
    note = f"Isolated jumps of markers removed: {'; '.join(entries)}."
    return replace(recording, markers=np.where(out[:, :, None], np.nan, x)).with_notes(note), found


@dataclass(frozen=True, kw_only=True)
class CleanTrial(Trial):
    """A trial as it is fitted, and the samples that were removed from its recording."""

    outliers: tuple[Outlier, ...] = ()
    """Markers removed in frames in which they were metres away from the body."""
    spikes: Spikes = field(default_factory=dict)
    """Isolated jumps that were removed."""
    cut: str = ""
    """Message about the frames that were cut off without a visible pelvis; empty: none."""


BRIDGED_S = 0.2
"""s, longest gap of the pelvis that the splines bridge; a longer one hides a part of a step."""


def clean_trial(
    trial: Trial, segment_of: Mapping[str, str], noise: PointNoise | None = None
) -> CleanTrial:
    """Remove outliers, isolated jumps and frames without the pelvis from a trial.

    A static trial keeps its jumps and all frames.

    Parameters
    ----------
    trial
        As it was read.
    segment_of
        Label -> segment.
    noise
        Of the marker set, if its points are markerless.

    Returns
    -------
    CleanTrial
        The trial with a clean recording, and the removed samples.
    """
    recording, outliers = remove_outliers(trial.recording, segment_of)
    given = trial.collect_fields()
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
    """Cut a recording to its longest part that shows the pelvis; return the message about it."""
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
        f"({format_spans(time, lasting)}): the trial is cut to "
        f"{time[start]:.2f}-{time[stop - 1]:.2f} s, "
        "the longest part with three pelvis markers"
    )
    return recording.frames((frames >= start) & (frames < stop)).with_notes(message), message
