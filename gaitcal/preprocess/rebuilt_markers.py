"""Rebuild markers that the static trial lost where other frames or trials show them beside others
of their segment.

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
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.io.recording import Recording, average_visible, find_still_window
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import get_path
from gaitcal.model.segment_frames import (
    HipCentre,
    build_pelvis_frame,
    compute_hip_centre,
    compute_position_variance,
    fit_rigid_motions,
    measure_distance_from_line,
)

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
    position: Array
    companions: tuple[str, ...]  # what it was placed by
    trial: str  # name of the trial that shows it beside them
    frames: int  # of that trial, which were used
    uncertainty: float  # m, RMS: scatter and differing shape together
    unknown_marker: str = (
        ""  # a marker of the static trial that the set does not know, there: it may be the same
    )

    @property
    def description(self) -> str:
        """Which marker, from where, how well."""
        same = (
            f" ('{self.unknown_marker}' of the static trial lies there: is it the same?)"
            if self.unknown_marker
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

    def describe_failures(self, message: str) -> str:
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
    for label in _list_wanted_labels(marker_set):
        showing = [
            (trial, recording) for trial, recording in sources if _is_visible(recording, label)
        ]
        if label in standing or not showing:
            continue
        attempts = [
            _try_rebuilding(label, marker_set, standing, trial, recording)
            for trial, recording in showing
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
                m: float(np.linalg.norm(at - best.position))
                for m, at in standing.items()
                if m not in known
            }
            nearest = min(away, key=away.__getitem__, default="")
            is_there = nearest and away[nearest] <= max(best.uncertainty, NEAR_M)
            found.append(replace(best, unknown_marker=nearest if is_there else ""))
            # what the pelvis has got back may carry a hip centre; no companion is ever a rebuilt
            # marker but there
            if best.segment == "pelvis":
                standing[label] = best.position
    for marker in found:
        static = _fill_static(static, marker, window, standing, marker_set)
    notes = (
        [f"markers that this trial lost: {'; '.join(marker.description for marker in found)}"]
        if found
        else []
    )
    return Rebuilding(static=static.with_notes(*notes), markers=tuple(found), left=left)


def _list_wanted_labels(marker_set: MarkerSet) -> tuple[str, ...]:
    """Markers that pull, or that make a landmark, on a segment; those of the pelvis first."""
    landmarks = {label for labels in marker_set.landmarks.values() for label in labels}
    rigid = {m for m, segment in marker_set.segment_of.items() if segment in LOWER_BODY}
    labels = [
        m for m in marker_set.tracked if m in rigid and (marker_set.weight(m) > 0 or m in landmarks)
    ]
    return tuple(sorted(labels, key=lambda m: marker_set.segment_of[m] != "pelvis"))


def _is_visible(recording: Recording, label: str) -> bool:
    return label in recording.labels and bool(np.isfinite(get_path(recording, label)).any())


def _try_rebuilding(
    label: str,
    marker_set: MarkerSet,
    standing: Mapping[str, Array],
    trial: str,
    recording: Recording,
) -> RebuiltMarker | str:
    """The marker as one trial has it, or why this one does not tell."""
    segment = marker_set.segment_of[label]
    path = get_path(recording, label)
    frames = np.flatnonzero(np.isfinite(path).all(axis=1))
    points = _find_companions(label, marker_set, standing, recording)
    names = [
        name for name, (_, way) in points.items() if np.isfinite(way[frames]).all(axis=1).any()
    ]
    if len(names) < FEWEST:
        return (
            f"{' and '.join(names) or 'no other point'} of {segment} seen beside it; three are "
            "needed, not on a line"
        )
    at = np.array([points[name][0] for name in names])
    if measure_distance_from_line(at) < FLAT_M:
        return (
            f"{', '.join(names)} of {segment}, seen beside it, lie on one line: nothing tells the "
            "turn about it"
        )
    ways = np.stack([points[name][1] for name in names], axis=1)
    frames = frames[np.isfinite(ways[frames]).all(axis=(1, 2))]
    if len(frames) < FEWEST_FRAMES:
        return f"it is never seen together with {', '.join(names)} of {segment}"
    frames = frames[:: max(1, len(frames) // MOST_FRAMES)]
    rotation, origin = fit_rigid_motions(at, ways[frames])
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
        position=place,
        companions=tuple(names),
        trial=trial,
        frames=len(frames),
        uncertainty=float(np.sqrt(scatter + differs * compute_position_variance(at, place))),
    )


def _find_companions(
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
            m: (standing[m], get_path(recording, m))
            for m in labels
            if m in standing and _is_visible(recording, m)
        }

    segment = marker_set.segment_of[label]
    out = on(segment)
    lent = (
        _locate_joint_above(*segment.partition("_")[::2], marker_set, standing)
        if len(out) < FEWEST
        else None
    )
    carriers = on(lent[2]) if lent else {}
    if (
        lent is None
        or len(carriers) < FEWEST
        or measure_distance_from_line(np.array([at for at, _ in carriers.values()])) < FLAT_M
    ):
        return out
    return {**out, lent[0]: (lent[1], _propagate_point(lent[1], list(carriers.values())))}


def _propagate_point(place: Array, points: Sequence[tuple[Array, Array]]) -> Array:
    """(nf, 3) path of a place (3,) fixed to points, each a place (3,) and a path (nf, 3); NaN where
    one is not seen.
    """
    at, ways = (
        np.array([point for point, _ in points]),
        np.stack([path for _, path in points], axis=1),
    )
    out = np.full((len(ways), 3), np.nan)
    visible = np.isfinite(ways).all(axis=(1, 2))
    rotation, origin = fit_rigid_motions(at, ways[visible])
    out[visible] = rotation @ place + origin
    return out


def _locate_joint_above(
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
    pelvis, width = build_pelvis_frame(right, left, sacrum), float(np.linalg.norm(right - left))
    depth = float(np.linalg.norm(pelvis.origin - sacrum))
    return (
        "hip centre",
        pelvis.point(compute_hip_centre(HipCentre.BELL, width, depth, side)),
        "pelvis",
    )


def _fill_static(
    static: Recording,
    marker: RebuiltMarker,
    window: slice,
    standing: Mapping[str, Array],
    marker_set: MarkerSet,
) -> Recording:
    """The static trial with a rebuilt marker in every frame that shows its companions, or else in
    the window.
    """
    points = _find_companions(marker.label, marker_set, standing, static)
    path = np.full((len(static.time), 3), np.nan)
    if all(name in points for name in marker.companions):
        path = _propagate_point(marker.position, [points[name] for name in marker.companions])
    if not np.isfinite(path[window]).any():
        path[window] = marker.position
    if marker.label not in static.labels:
        markers = np.concatenate([static.markers, path[:, None]], axis=1)
        return replace(static, labels=(*static.labels, marker.label), markers=markers)
    markers, k = static.markers.copy(), static.labels.index(marker.label)
    markers[:, k] = np.where(
        np.isfinite(markers[:, k]).all(axis=1, keepdims=True), markers[:, k], path
    )
    return replace(static, markers=markers)
