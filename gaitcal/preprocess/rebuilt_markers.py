"""Reconstruct markers that the static trial lost, from frames that show them with others.

Companions c_i of a lost marker m are the other markers of its segment, at their mean positions s_i
of the still window. If fewer than three are left, the joint above is one of them, as the segment
above carries it: the hip centre, or the midpoint of the markers at the sides of knee or ankle. In
every frame f that shows m and its companions, the rigid motion R_f s + o_f nearest to them (Kabsch
1976) takes m back to the static trial, and the median over frames is its position:

    p_f = R_f^T (m_f - o_f),      p = median_f p_f.

Its variance has two parts: the scatter of the p_f about p, as skin moves, and the difference
between the companions' mean shape and the static one, RMS e over those 3n - 6 of 3n directions that
a rigid fit leaves, enlarged by the lever from their centroid to p:

    e^2 (1/n + trace([r] I^-1 [r]^T) / 3),      I the inertia of n unit masses at s, r from the
                                                centroid to p.

The trial with the smallest uncertainty is taken. A reconstructed marker repeats its companions: it
gives a position to a marker that moving trials track, and is no evidence about the static trial.
Trunk and arms, which are not rigid, are left out.
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

FEWEST = 3
"""Points that determine the pose of a segment."""
FLAT_M = 0.012
"""m, smallest RMS distance of the companions from a line: the rotation about a line is free."""
FEWEST_RECONSTRUCTION_FRAMES = 3
MOST_FRAMES = 200
"""Frames of a trial, evenly spaced, that are used."""
LOOSE_M = 0.020
"""m, largest uncertainty of a reconstructed marker: that of joint centres by regression."""
SKIN_M = 0.003
"""m, smallest displacement of a marker with its skin between two trials."""
NEAR_M = 0.01
"""m. An unknown marker this near to a reconstructed one, or within its uncertainty, may be it."""
JOINT_ABOVE = {"shank": ("knee", "thigh"), "foot": ("ankle", "shank")}
"""Segment -> the joint above it, and the segment above it that carries the joint."""


@dataclass(frozen=True, kw_only=True)
class RebuiltMarker:
    """A marker that the static trial lost, and its reconstructed position."""

    label: str
    segment: str
    landmarks: tuple[str, ...]
    """Landmarks of the marker set that it defines."""
    position: Array
    """(3,) m in the laboratory of the static trial, at the mean positions of its companions."""
    companions: tuple[str, ...]
    """Points by which it was placed."""
    trial: str
    """Name of the trial that shows it together with its companions."""
    frames: int
    """Number of frames of that trial that were used."""
    uncertainty: float
    """m, RMS of scatter and difference of shape."""
    unknown_marker: str = ""
    """Label of an unknown marker of the static trial at the same position: it may be the same."""

    @property
    def description(self) -> str:
        """Label, trial, companions and uncertainty."""
        same = ""
        if self.unknown_marker:
            same = (
                f" ('{self.unknown_marker}' of the static trial has the same position: is it this "
                "marker?)"
            )
        return (
            f"'{self.label}' reconstructed from {self.frames} frames of '{self.trial}' by "
            f"{', '.join(self.companions)}, uncertainty {1e3 * self.uncertainty:.1f} mm{same}"
        )


@dataclass(frozen=True, kw_only=True)
class MarkerReconstruction:
    """A static trial with the markers that could be reconstructed."""

    static: Recording
    """With the reconstructed markers in every frame that shows their companions."""
    markers: tuple[RebuiltMarker, ...] = ()
    not_reconstructed: Mapping[str, str] = field(default_factory=dict)
    """Lost marker that other trials show -> why it is not reconstructed."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the reconstructed markers, which are no evidence about the static trial."""
        return tuple(marker.label for marker in self.markers)

    def describe_failures(self, message: str) -> str:
        """Describe why markers that an error message names were not reconstructed.

        Parameters
        ----------
        message
            Of the error.

        Returns
        -------
        str
            To be appended to the message; empty if it names no such marker.
        """
        reasons = [
            f"'{label}': {why}"
            for label, why in self.not_reconstructed.items()
            if f"'{label}'" in message
        ]
        return f"; no other trial reconstructs it ({'; '.join(reasons)})" if reasons else ""


def reconstruct_markers(
    static: Recording, marker_set: MarkerSet, others: Sequence[tuple[str, Recording]], name: str
) -> MarkerReconstruction:
    """Reconstruct the markers of the set that the static trial does not show in its still window.

    Parameters
    ----------
    static
        Static trial, with the labels of the set. It is searched too: it may show a marker at
        another time.
    marker_set
        Of the study.
    others
        Name and recording of further trials, of any role.
    name
        Of the static trial, for messages.

    Returns
    -------
    MarkerReconstruction
        Nothing is reconstructed if the static trial has no still window.
    """
    try:
        window = find_still_window(static, marker_set.labels).frames
    except InputError:
        # reported where the model is made
        return MarkerReconstruction(static=static)
    sources = [(name, static), *others]
    standing = average_visible(
        {label: static.markers[window, k] for k, label in enumerate(static.labels)}
    )
    known = set(marker_set.labels)
    found, failed = list[RebuiltMarker](), dict[str, str]()
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
            failed[label] = next(attempt for attempt in attempts if isinstance(attempt, str))
        elif best.uncertainty > LOOSE_M:
            by = ", ".join(best.companions)
            failed[label] = (
                f"its position relative to {by} is uncertain by {1e3 * best.uncertainty:.0f} mm"
            )
        else:
            away = {
                m: float(np.linalg.norm(position - best.position))
                for m, position in standing.items()
                if m not in known
            }
            nearest = min(away, key=away.__getitem__, default="")
            is_there = nearest and away[nearest] <= max(best.uncertainty, NEAR_M)
            found.append(replace(best, unknown_marker=nearest if is_there else ""))
            # only markers of the pelvis become companions themselves: they carry the hip centre
            if best.segment == "pelvis":
                standing[label] = best.position
    for marker in found:
        static = _fill_static(static, marker, window, standing, marker_set)
    notes = []
    if found:
        lost = "; ".join(marker.description for marker in found)
        notes.append(f"markers that this trial lost: {lost}")
    return MarkerReconstruction(
        static=static.with_notes(*notes), markers=tuple(found), not_reconstructed=failed
    )


def _list_wanted_labels(marker_set: MarkerSet) -> tuple[str, ...]:
    """List markers of pelvis and legs that are fitted or define a landmark; the pelvis first."""
    landmarks = {label for labels in marker_set.landmarks.values() for label in labels}
    rigid = {m for m, segment in marker_set.segment_of.items() if segment in LOWER_BODY}
    labels = [
        m for m in marker_set.tracked if m in rigid and (marker_set.weight(m) > 0 or m in landmarks)
    ]
    return tuple(sorted(labels, key=lambda m: marker_set.segment_of[m] != "pelvis"))


def _is_visible(recording: Recording, label: str) -> bool:
    """Return whether a recording shows a marker in any frame."""
    return label in recording.labels and bool(np.isfinite(get_path(recording, label)).any())


def _try_rebuilding(
    label: str,
    marker_set: MarkerSet,
    standing: Mapping[str, Array],
    trial: str,
    recording: Recording,
) -> RebuiltMarker | str:
    """Reconstruct a marker from one trial, or return why that is not possible."""
    segment = marker_set.segment_of[label]
    path = get_path(recording, label)
    frames = np.flatnonzero(np.isfinite(path).all(axis=1))
    points = _find_companions(label, marker_set, standing, recording)
    names = [
        name for name, (_, other) in points.items() if np.isfinite(other[frames]).all(axis=1).any()
    ]
    if len(names) < FEWEST:
        return (
            f"only {' and '.join(names)} of {segment} visible with it; "
            "three points that are not on a line are needed"
            if names
            else f"no other point of {segment} visible with it; three that are not on a line are "
            "needed"
        )
    static = np.array([points[name][0] for name in names])
    if measure_distance_from_line(static) < FLAT_M:
        return (
            f"{', '.join(names)} of {segment}, which are visible with it, are on one line: the "
            "rotation about it is not determined"
        )
    paths = np.stack([points[name][1] for name in names], axis=1)
    frames = frames[np.isfinite(paths[frames]).all(axis=(1, 2))]
    if len(frames) < FEWEST_RECONSTRUCTION_FRAMES:
        return f"it is never visible together with {', '.join(names)} of {segment}"
    frames = frames[:: max(1, len(frames) // MOST_FRAMES)]
    # p_f and p of the module's equations
    rotation, origin = fit_rigid_motions(static, paths[frames])
    back = np.einsum("fji,fj->fi", rotation, path[frames] - origin)
    position = np.median(back, axis=0)
    # variances: difference of shape e^2, corrected for the six directions of the fit, and scatter
    shape = np.mean(np.einsum("fji,fnj->fni", rotation, paths[frames] - origin[:, None]), axis=0)
    visible_share = (3.0 * len(static) - 6.0) / (3.0 * len(static))
    difference = np.mean(((shape - static) ** 2).sum(axis=1)) / visible_share + SKIN_M**2
    scatter = np.mean(((back - position) ** 2).sum(axis=1)) + SKIN_M**2
    lever = compute_position_variance(static, position)
    return RebuiltMarker(
        label=label,
        segment=segment,
        landmarks=tuple(name for name, labels in marker_set.landmarks.items() if label in labels),
        position=position,
        companions=tuple(names),
        trial=trial,
        frames=len(frames),
        uncertainty=float(np.sqrt(scatter + difference * lever)),
    )


def _find_companions(
    label: str, marker_set: MarkerSet, standing: Mapping[str, Array], recording: Recording
) -> dict[str, tuple[Array, Array]]:
    """Find possible carriers of a lost marker: name -> static position (3,), path (nf, 3), both m.

    The joint above is one of them only if the segment has too few markers.
    """

    def collect_points(segment: str) -> dict[str, tuple[Array, Array]]:
        labels = [
            m for m in marker_set.tracked if marker_set.segment_of[m] == segment and m != label
        ]
        return {
            m: (standing[m], get_path(recording, m))
            for m in labels
            if m in standing and _is_visible(recording, m)
        }

    segment = marker_set.segment_of[label]
    out = collect_points(segment)
    if len(out) >= FEWEST:
        return out
    part, _, side = segment.partition("_")
    joint = _locate_joint_above(part, side, marker_set, standing)
    if joint is None:
        return out
    name, centre, above = joint
    carriers = list(collect_points(above).values())
    if len(carriers) < FEWEST:
        return out
    if measure_distance_from_line(np.array([position for position, _ in carriers])) < FLAT_M:
        return out
    return {**out, name: (centre, _propagate_point(centre, carriers))}


def _propagate_point(point: Array, points: Sequence[tuple[Array, Array]]) -> Array:
    """Compute the path (nf, 3) m of a static point (3,) fixed to others; NaN in their gaps.

    `points`: static position (3,) m and path (nf, 3) m of each.
    """
    static = np.array([position for position, _ in points])
    paths = np.stack([path for _, path in points], axis=1)
    out = np.full((len(paths), 3), np.nan)
    visible = np.isfinite(paths).all(axis=(1, 2))
    rotation, origin = fit_rigid_motions(static, paths[visible])
    out[visible] = rotation @ point + origin
    return out


def _locate_joint_above(
    part: str, side: str, marker_set: MarkerSet, standing: Mapping[str, Array]
) -> tuple[str, Array, str] | None:
    """Locate a segment's proximal joint in the static trial: name, position (3,) m, segment above.

    The hip centre is Bell's; knee and ankle are midway between the markers at their sides, or at
    the lateral one.
    """

    def locate(name: str) -> Array | None:
        labels = marker_set.landmarks.get(name, ())
        known = bool(labels) and all(m in standing for m in labels)
        return np.mean([standing[m] for m in labels], axis=0) if known else None

    if part in JOINT_ABOVE:
        joint, above = JOINT_ABOVE[part]
        both = (locate(f"{joint}_lat_{side}"), locate(f"{joint}_med_{side}"))
        sides = [position for position in both if position is not None]
        return (joint, np.mean(sides, axis=0), f"{above}_{side}") if sides else None
    right, left, sacrum = (locate(name) for name in ("asis_r", "asis_l", "sacrum"))
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
    """Add a reconstructed marker in the frames that show its companions, or in the still window."""
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
