"""Markers that the static trial lost are rebuilt where other frames or trials show them beside
others of their segment; those that lie metres away from the body are left out.

Companions c_i of a lost marker m are the other markers of its segment, at their mean places s_i of
the still window. Where fewer than three are left, the joint above is one, as the segment above
carries it: the hip centre, or the middle between the markers at the sides of knee or ankle. In
every frame f that shows m and its companions, the rigid motion R_f s + o_f nearest to them (Kabsch
1976) takes m back to the static trial, and the median over frames is its place:

    p_f = R_f^T (m_f - o_f),      p = median_f p_f.

Two things make p uncertain, and are added in squares: how far the p_f scatter about p, as skin
moves, and how far the companions' mean shape differs from the static one, RMS e over those 3n - 6
of 3n directions that a rigid fit leaves, which the lever from their middle to p enlarges:

    e^2 (1/n + trace([r] I^-1 [r]^T) / 3),      I the inertia of n unit masses at s, r from their middle to p.

Of all trials the one that leaves the least is taken. A rebuilt marker repeats what its companions
say: it is a place for the marker where it moves, never evidence for the static trial. Trunk and
arms, which are not rigid, are left out.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import InputError
from gaitcal.io.recording import (
    Recording,
    average_visible,
    find_runs,
    find_still_window,
    find_visible,
    format_spans,
)
from gaitcal.model.linkage import JOINTS, LOWER_BODY, segment_kind
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import path_of
from gaitcal.model.segment_frames import (
    HipCentre,
    hip_centre,
    off_line,
    pelvis_frame,
    place_variance,
    rigid_motions,
)
from gaitcal.model.subject_model import PointNoise

FEWEST = 3  # points that tell how a segment is turned
# RMS distance from their line that companions must have: the turn about a line is not told by less
FLAT_M = 0.012
FEWEST_FRAMES = 3
MOST_FRAMES = 200  # of a trial that are looked at, evenly spaced
# a marker more uncertain is not rebuilt: regressions for joint centres err by as much at worst
LOOSE_M = 0.020
# how far a marker shifts with its skin from one trial to the next while nobody touches it, at least
SKIN_M = 0.003
# a marker without a meaning so near to a rebuilt one, or within its uncertainty, may be the same
NEAR_M = 0.01
BESIDE = {"shank": ("knee", "thigh"), "foot": ("ankle", "shank")}
"""Segment -> the joint above it, and the segment there that carries it."""


@dataclass(frozen=True, kw_only=True)
class RebuiltMarker:
    """A marker that the static trial lost, and where it was."""

    label: str
    segment: str
    landmarks: tuple[str, ...]  # of the set that it makes
    # (3,) m in the laboratory of the static trial, where its companions have their mean places
    place: Array
    companions: tuple[str, ...]  # what it was placed by
    trial: str  # name of the trial that shows it beside them
    frames: int  # of that trial, which were used
    uncertainty: float  # m, RMS: scatter and differing shape together
    stranger: str = (
        ""  # a marker of the static trial that the set does not know, there: it may be the same
    )

    @property
    def words(self) -> str:
        """Which marker, from where, how well."""
        same = (
            f" ('{self.stranger}' of the static trial lies there: is it the same?)"
            if self.stranger
            else ""
        )
        by, to = ", ".join(self.companions), 1e3 * self.uncertainty
        return (
            f"'{self.label}' rebuilt from {self.frames} frames of '{self.trial}' by {by}, to "
            f"{to:.1f} mm{same}"
        )


@dataclass(frozen=True, kw_only=True)
class Rebuilding:
    """A static trial with what could be rebuilt."""

    static: Recording  # with the rebuilt markers in every frame that shows their companions
    markers: tuple[RebuiltMarker, ...] = ()
    left: Mapping[str, str] = field(
        default_factory=dict
    )  # lost marker that others show -> why it is not rebuilt

    @property
    def labels(self) -> tuple[str, ...]:
        """Markers that were rebuilt: no evidence for the static trial."""
        return tuple(marker.label for marker in self.markers)

    def why_not(self, message: str) -> str:
        """Why markers that an error message names were not rebuilt, to be added to it."""
        reasons = [
            f"'{label}': {why}" for label, why in self.left.items() if f"'{label}'" in message
        ]
        return f"; no other trial gives it back ({'; '.join(reasons)})" if reasons else ""


def rebuild_lost(
    static: Recording, marker_set: MarkerSet, others: Sequence[tuple[str, Recording]], name: str
) -> Rebuilding:
    """The static trial with the markers of the set that it does not show while the person stands
    still.

    `static`, `name`: the recording, its labels those of the set, and what to call it. `others`:
    name and recording of further trials, of any role. The static trial itself is asked too: it may
    show a marker at another time.
    """
    try:
        window = find_still_window(static, marker_set.labels).frames
    except InputError:
        return Rebuilding(static=static)  # told where the model is made
    sources = [(name, static), *others]
    standing = average_visible(
        {label: static.markers[window, k] for k, label in enumerate(static.labels)}
    )
    known = set(marker_set.labels)
    found, left = list[RebuiltMarker](), dict[str, str]()
    for label in _wanted(marker_set):
        showing = [(trial, recording) for trial, recording in sources if _shows(recording, label)]
        if label in standing or not showing:
            continue
        attempts = [
            _attempt(label, marker_set, standing, trial, recording) for trial, recording in showing
        ]
        placed = [attempt for attempt in attempts if isinstance(attempt, RebuiltMarker)]
        best = min(placed, key=lambda marker: marker.uncertainty, default=None)
        if best is None:
            left[label] = next(attempt for attempt in attempts if isinstance(attempt, str))
        elif best.uncertainty > LOOSE_M:
            by = ", ".join(best.companions)
            left[label] = f"its place beside {by} is uncertain by {1e3 * best.uncertainty:.0f} mm"
        else:
            away = {
                m: float(np.linalg.norm(at - best.place))
                for m, at in standing.items()
                if m not in known
            }
            nearest = min(away, key=away.__getitem__, default="")
            is_there = nearest and away[nearest] <= max(best.uncertainty, NEAR_M)
            found.append(replace(best, stranger=nearest if is_there else ""))
            # what the pelvis has got back may carry a hip centre; no companion is ever a rebuilt
            # marker but there
            if best.segment == "pelvis":
                standing[label] = best.place
    for marker in found:
        static = _filled(static, marker, window, standing, marker_set)
    notes = (
        [f"markers that this trial lost: {'; '.join(marker.words for marker in found)}"]
        if found
        else []
    )
    return Rebuilding(static=static.with_notes(*notes), markers=tuple(found), left=left)


def _wanted(marker_set: MarkerSet) -> tuple[str, ...]:
    """Markers that pull, or that make a landmark, on a segment; those of the pelvis first."""
    landmarks = {label for labels in marker_set.landmarks.values() for label in labels}
    rigid = {m for m, segment in marker_set.segment_of.items() if segment in LOWER_BODY}
    labels = [
        m for m in marker_set.tracked if m in rigid and (marker_set.weight(m) > 0 or m in landmarks)
    ]
    return tuple(sorted(labels, key=lambda m: marker_set.segment_of[m] != "pelvis"))


def _shows(recording: Recording, label: str) -> bool:
    return label in recording.labels and bool(np.isfinite(path_of(recording, label)).any())


def _attempt(
    label: str,
    marker_set: MarkerSet,
    standing: Mapping[str, Array],
    trial: str,
    recording: Recording,
) -> RebuiltMarker | str:
    """The marker as one trial has it, or why this one does not tell."""
    segment = marker_set.segment_of[label]
    path = path_of(recording, label)
    frames = np.flatnonzero(np.isfinite(path).all(axis=1))
    points = _companions(label, marker_set, standing, recording)
    names = [
        name for name, (_, way) in points.items() if np.isfinite(way[frames]).all(axis=1).any()
    ]
    if len(names) < FEWEST:
        return (
            f"{' and '.join(names) or 'no other point'} of {segment} seen beside it; three are "
            "needed, not on a line"
        )
    at = np.array([points[name][0] for name in names])
    if off_line(at) < FLAT_M:
        return (
            f"{', '.join(names)} of {segment}, seen beside it, lie on one line: nothing tells the "
            "turn about it"
        )
    ways = np.stack([points[name][1] for name in names], axis=1)
    frames = frames[np.isfinite(ways[frames]).all(axis=(1, 2))]
    if len(frames) < FEWEST_FRAMES:
        return f"it is never seen together with {', '.join(names)} of {segment}"
    frames = frames[:: max(1, len(frames) // MOST_FRAMES)]
    rotation, origin = rigid_motions(at, ways[frames])
    back = np.einsum("fji,fj->fi", rotation, path[frames] - origin)
    place = np.median(back, axis=0)
    shape = np.mean(np.einsum("fji,fnj->fni", rotation, ways[frames] - origin[:, None]), axis=0)
    differs = (
        np.mean(((shape - at) ** 2).sum(axis=1)) / ((3.0 * len(at) - 6.0) / (3.0 * len(at)))
        + SKIN_M**2
    )
    scatter = np.mean(((back - place) ** 2).sum(axis=1)) + SKIN_M**2
    return RebuiltMarker(
        label=label,
        segment=segment,
        landmarks=tuple(name for name, labels in marker_set.landmarks.items() if label in labels),
        place=place,
        companions=tuple(names),
        trial=trial,
        frames=len(frames),
        uncertainty=float(np.sqrt(scatter + differs * place_variance(at, place))),
    )


def _companions(
    label: str, marker_set: MarkerSet, standing: Mapping[str, Array], recording: Recording
) -> dict[str, tuple[Array, Array]]:
    """Name -> place (3,) m in the static trial and path (nf, 3) m, of what may carry a lost marker.

    Points of the segment above only where the segment's own are short.
    """

    def on(segment: str) -> dict[str, tuple[Array, Array]]:
        labels = [
            m for m in marker_set.tracked if marker_set.segment_of[m] == segment and m != label
        ]
        return {
            m: (standing[m], path_of(recording, m))
            for m in labels
            if m in standing and _shows(recording, m)
        }

    segment = marker_set.segment_of[label]
    out = on(segment)
    lent = (
        _joint_above(*segment.partition("_")[::2], marker_set, standing)
        if len(out) < FEWEST
        else None
    )
    carriers = on(lent[2]) if lent else {}
    if (
        lent is None
        or len(carriers) < FEWEST
        or off_line(np.array([at for at, _ in carriers.values()])) < FLAT_M
    ):
        return out
    return {**out, lent[0]: (lent[1], _carried(lent[1], list(carriers.values())))}


def _carried(place: Array, points: Sequence[tuple[Array, Array]]) -> Array:
    """(nf, 3) path of a place (3,) fixed to points, each a place (3,) and a path (nf, 3); NaN where
    one is not seen.
    """
    at, ways = (
        np.array([point for point, _ in points]),
        np.stack([path for _, path in points], axis=1),
    )
    out = np.full((len(ways), 3), np.nan)
    visible = np.isfinite(ways).all(axis=(1, 2))
    rotation, origin = rigid_motions(at, ways[visible])
    out[visible] = rotation @ place + origin
    return out


def _joint_above(
    part: str, side: str, marker_set: MarkerSet, standing: Mapping[str, Array]
) -> tuple[str, Array, str] | None:
    """Name and place (3,) m in the static trial of a segment's upper joint, and the segment above
    it.

    The hip centre is Bell's; knee and ankle are midway between the markers at their sides, or at
    the lateral one.
    """

    def landmark(name: str) -> Array | None:
        labels = marker_set.landmarks.get(name, ())
        known = bool(labels) and all(m in standing for m in labels)
        return np.mean([standing[m] for m in labels], axis=0) if known else None

    if part in BESIDE:
        joint, above = BESIDE[part]
        sides = [
            p
            for p in (landmark(f"{joint}_lat_{side}"), landmark(f"{joint}_med_{side}"))
            if p is not None
        ]
        return (joint, np.mean(sides, axis=0), f"{above}_{side}") if sides else None
    right, left, sacrum = (landmark(name) for name in ("asis_r", "asis_l", "sacrum"))
    if part != "thigh" or right is None or left is None or sacrum is None:
        return None
    pelvis, width = pelvis_frame(right, left, sacrum), float(np.linalg.norm(right - left))
    depth = float(np.linalg.norm(pelvis.origin - sacrum))
    return "hip centre", pelvis.point(hip_centre(HipCentre.BELL, width, depth, side)), "pelvis"


def _filled(
    static: Recording,
    marker: RebuiltMarker,
    window: slice,
    standing: Mapping[str, Array],
    marker_set: MarkerSet,
) -> Recording:
    """The static trial with a rebuilt marker in every frame that shows its companions, or else in
    the window.
    """
    points = _companions(marker.label, marker_set, standing, static)
    path = np.full((len(static.time), 3), np.nan)
    if all(name in points for name in marker.companions):
        path = _carried(marker.place, [points[name] for name in marker.companions])
    if not np.isfinite(path[window]).any():
        path[window] = marker.place
    if marker.label not in static.labels:
        markers = np.concatenate([static.markers, path[:, None]], axis=1)
        return replace(static, labels=(*static.labels, marker.label), markers=markers)
    markers, k = static.markers.copy(), static.labels.index(marker.label)
    markers[:, k] = np.where(
        np.isfinite(markers[:, k]).all(axis=1, keepdims=True), markers[:, k], path
    )
    return replace(static, markers=markers)


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
    of: int  # frames in which it was seen at all
    farthest: float  # m, from the markers around it
    when: str  # from when to when, s

    @property
    def words(self) -> str:
        """Which marker, how far, how long."""
        return (
            f"{self.label} up to {self.farthest:.1f} m away, {self.frames} of {self.of} frames "
            f"({self.when})"
        )


def without_outliers(
    recording: Recording, segment_of: Mapping[str, str]
) -> tuple[Recording, tuple[Outlier, ...]]:
    """The recording with markers of the given segments left out where they are metres away, and
    which these were.

    `segment_of`: label -> segment. A marker that is nowhere on the body loses its column.
    """
    found, away = _outliers(recording, segment_of)
    if not found.any():
        return recording, ()
    visible = find_visible(recording.markers)
    outliers = tuple(
        Outlier(
            label=recording.labels[k],
            frames=int(found[:, k].sum()),
            of=int(visible[:, k].sum()),
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
        f"{'; '.join(o.words for o in outliers)}."
    )
    labels = tuple(recording.labels[k] for k in kept)
    return replace(recording, labels=labels, markers=masked[:, kept]).with_notes(note), outliers


def _outliers(recording: Recording, segment_of: Mapping[str, str]) -> tuple[BoolArray, Array]:
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
            np.flatnonzero(np.isin(of_marker, list(_near(segment)))),
        )
        few = len(around) < FEWEST_AROUND
        centre = _median(x[:, known if few else around])
        away[:, on] = np.linalg.norm(x[:, on] - centre[:, None], axis=2)
        out[:, on] = away[:, on] > (REACH_BODY_M if few else REACH_M)
    out[out.sum(axis=1) > MOST_SHARE * np.maximum(visible[:, known].sum(axis=1), 1)] = False
    return out, away


def _near(segment: str) -> set[str]:
    """A segment and its neighbours with markers."""

    def beside(one: str) -> set[str]:
        return {
            one,
            *(e for j in JOINTS if one in (j.parent, j.child) for e in (j.parent, j.child)),
        }

    near = beside(segment)
    for between in [
        s for s in near if not segment_kind(s).markers
    ]:  # a segment that never carries markers
        near = near | beside(between)
    return near


def _median(x: Array) -> Array:
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


def jump_limit(recording: Recording, noise: PointNoise | None) -> float:
    """m, how far a marker, or a point with a noise of its own, may be out of line with the frames
    before and after.
    """
    of_noise = 0.0 if noise is None else SPIKE_DEVIATIONS * 1e-3 * noise.size_mm
    return max(SPIKE_M, 0.5 * SPIKE_ACCELERATION / recording.rate**2, of_noise)


Spikes: TypeAlias = dict[str, tuple[int, float]]
"""Marker -> how many single positions lie out of line, and how far (m) the farthest."""


def without_spikes(
    recording: Recording, noise: PointNoise | None = None
) -> tuple[Recording, Spikes]:
    """The recording without single positions that lie out of line with their neighbours, and which
    these were.
    """
    x, limit = recording.markers, jump_limit(recording, noise)
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
