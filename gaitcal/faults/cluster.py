"""Markers of one segment in one trial, against where the static trial has them.

The trial's own shape m of a cluster (generalised Procrustes, Gower, Psychometrika 40:33-51, 1975, with the median for
the mean, so that a marker that is elsewhere for a while does not bend it) and the segment's turn R_f and place o_f:

    m = median_f R_f^T (x_f - o_f),      (R_f, o_f) = the rigid motion of m nearest to x_f,

laid on the static shape s by the nearest rigid motion. Then e = m - s is how far each marker sits from its static place
all the time, and |x_f - R_f m - o_f| how far it strays from its mean place in a frame. A cluster of fewer than three
markers borrows: a thigh the hip centre as the pelvis carries it, a shank and a foot the lateral marker above.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.faults.stance import Stance
from gaitcal.io.recording import Recording, seen_mask
from gaitcal.model.linkage import SIDES
from gaitcal.motion.rigid import rigid_fit

FEWEST = 3
"""Points that tell how a segment is turned."""
SEEN_SHARE, SEEN_FRAMES = 0.1, 5
"""A marker seen in fewer frames takes no part."""
MOST_FRAMES = 150
"""Frames, spread over the trial, from which the shape is found."""
ROUNDS = 4
"""Of the shape: from a start 30 mm off it is then still within 0.1 mm."""
HIP_CENTRE = "hip centre"
"""Name of the point that a thigh borrows."""
SEGMENTS = ("pelvis", *(f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in SIDES))
LENDER = {"shank": "knee_lat", "foot": "ankle_lat"}
"""Segment -> the landmark above it that it may borrow."""


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """The markers of a segment in a trial."""

    segment: str
    labels: tuple[str, ...]
    """(n,) markers; the last may be borrowed."""
    borrowed: bool
    """Whether the last point belongs to the segment above."""
    reduced: bool
    """Whether it borrows though the static trial has enough markers: some have no weight, or are missing here."""
    static: Array
    """(n, 3) m, s."""
    shape: Array
    """(n, 3) m, m, laid on s."""
    rotation: Array
    """(nf, 3, 3) R: from the static posture to the frame."""
    origin: Array
    """(nf, 3) m, o."""
    away: Array
    """(nf, n, 3) m, from the mean place, in static axes; NaN where the marker or the segment is not seen."""
    size: float = 1.0
    """Of the person, by which limits in metres grow."""
    determined: BoolArray
    """(nf,) whether three points not on a line were seen."""

    @cached_property
    def strayed(self) -> Array:
        """(nf, n) m, distance from the mean place; NaN where not seen."""
        out: Array = np.linalg.norm(self.away, axis=2)
        return out

    @property
    def part(self) -> str:
        """`pelvis`, `thigh`, `shank`, `foot`."""
        return self.segment.split("_")[0]

    @property
    def own(self) -> int:
        """How many of the points are markers of the segment."""
        return len(self.labels) - self.borrowed

    @property
    def offsets(self) -> Array:
        """(n, 3) m, e."""
        return self.shape - self.static

    @cached_property
    def scatter(self) -> Array:
        """(n,) m, RMS distance from the mean place."""
        out: Array = np.sqrt(np.nanmean(self.strayed**2, axis=0))
        return out

    @property
    def size_ratio(self) -> float:
        """Size of the cluster against the static one, RMS about the middle."""
        sizes = [np.linalg.norm(p[: self.own] - p[: self.own].mean(axis=0)) for p in (self.shape, self.static)]
        return float(sizes[0] / sizes[1])

    @property
    def swelling(self) -> float:
        """Share by which scatter across the lines between markers lengthens them."""
        away = self.static[: self.own] - self.static[: self.own].mean(axis=0)
        return float((self.scatter[: self.own] ** 2).sum() / (away**2).sum())

    def pose_spread(self, point: Array) -> tuple[float, Array]:
        """m, and (3,) rad about x y z: how far the segment's pose at a point (3,) is uncertain as its markers scatter.

        Markers that scatter by sigma, with middle c and inertia I of n unit masses about it, leave the covariances
        sigma^2 I^-1 of a turn and sigma^2 (1/n + [r] I^-1 [r]^T) of a point at r from c; the fit hides six of the 3 n
        directions of sigma.
        """
        n = len(self.labels)
        hidden = (3.0 * n - 6.0) / (3.0 * n)
        variance = float(np.mean(self.scatter**2)) / (3.0 * hidden)
        away = self.static - self.static.mean(axis=0)
        inertia = np.eye(3) * (away**2).sum() - away.T @ away
        turn = variance * np.linalg.pinv(inertia)
        x, y, z = point - self.static.mean(axis=0)
        lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        place = 3.0 * variance / n + float(np.trace(lever @ turn @ lever.T))
        return float(np.sqrt(place)), np.sqrt(np.diag(turn))

    def carries(self, point: Array) -> Array:
        """(nf, 3) m, where the segment has a point (3,) of the static posture; NaN where it is not determined."""
        path: Array = self.rotation @ point + self.origin
        path[~self.determined] = np.nan
        return path


def clusters_of(
    recording: Recording, stance: Stance, landmarks: Mapping[str, tuple[str, ...]], judged: Callable[[str], bool]
) -> dict[str, Cluster]:
    """Segment -> its cluster, for pelvis and legs; `judged` tells which markers count."""
    place = {label: i for i, label in enumerate(recording.labels)}
    shares = seen_mask(recording.markers).sum(axis=0)
    needed = max(SEEN_SHARE * len(recording.time), min(SEEN_FRAMES, len(recording.time)))

    def usable(label: str) -> bool:
        return label in place and judged(label) and shares[place[label]] >= needed

    out: dict[str, Cluster] = {}
    for segment in SEGMENTS:
        labels = [label for label in stance.points.get(segment, {}) if usable(label)]
        static = [stance.points[segment][label] for label in labels]
        paths = [recording.markers[:, place[label]] for label in labels]
        lent = None
        if 0 < len(labels) < FEWEST and stance.centres:
            lent = _borrowed(segment, recording, stance, landmarks, usable, out)
        if lent is not None:
            name, at, path = lent
            labels, static, paths = [*labels, name], [*static, at], [*paths, path]
        if len(labels) >= FEWEST:
            reduced = lent is not None and len(stance.points[segment]) >= FEWEST
            cluster = _cluster(segment, tuple(labels), lent is not None, reduced, np.array(static), np.stack(paths, 1))
            if cluster is not None:
                out[segment] = replace(cluster, size=stance.size)
    return out


def _borrowed(
    segment: str,
    recording: Recording,
    stance: Stance,
    landmarks: Mapping[str, tuple[str, ...]],
    usable: Callable[[str], bool],
    known: Mapping[str, Cluster],
) -> tuple[str, Array, Array] | None:
    """Name, static place (3,) and path (nf, 3) of the point that a segment borrows; None where there is none."""
    part, _, side = segment.partition("_")
    if part == "thigh" and "pelvis" in known:
        centre = stance.centres[f"hip_{side}"]
        return HIP_CENTRE, centre, known["pelvis"].carries(centre)
    if part not in LENDER:
        return None
    name = f"{LENDER[part]}_{side}"
    labels = landmarks.get(name, ())
    if len(labels) != 1 or not usable(labels[0]) or name not in stance.landmarks:
        return None
    return labels[0], stance.landmarks[name], recording.markers[:, recording.labels.index(labels[0])]


def _cluster(
    segment: str, labels: tuple[str, ...], borrowed: bool, reduced: bool, static: Array, paths: Array
) -> Cluster | None:
    """From paths (nf, n, 3); None where no frame shows three points."""
    seen = seen_mask(paths)
    enough = np.flatnonzero(seen.sum(axis=1) >= FEWEST)
    if len(enough) < min(SEEN_FRAMES, len(paths)):
        return None
    some = enough[:: max(1, len(enough) // MOST_FRAMES)]
    shape = _mean_shape(static, paths[some], seen[some])
    if shape is None:
        return None
    turn, shift = alignment(shape, static)
    shape = shape @ turn.T + shift
    fit = rigid_fit(shape, np.where(seen[:, :, None], paths, 0.0).transpose(1, 2, 0), seen.T.astype(float))
    away = (paths - fit.origin[:, None]) @ fit.rotation - shape
    away[~fit.determined] = np.nan
    return Cluster(
        segment=segment,
        labels=labels,
        borrowed=borrowed,
        reduced=reduced,
        static=static,
        shape=shape,
        rotation=fit.rotation,
        origin=fit.origin,
        away=away,
        determined=fit.determined,
    )


def _mean_shape(start: Array, paths: Array, seen: BoolArray) -> Array | None:
    """(n, 3) m, the shape of a cluster with paths (nf, n, 3); None where a point is never seen with two others."""
    measured, weight = np.where(seen[:, :, None], paths, 0.0).transpose(1, 2, 0), seen.T.astype(float)
    shape = start
    for _ in range(ROUNDS):
        fit = rigid_fit(shape, measured, weight)
        local = (paths - fit.origin[:, None]) @ fit.rotation
        known = seen & fit.determined[:, None]
        if not known.any(axis=0).all():
            return None
        shape = np.median(local, axis=0) if known.all() else np.nanmedian(np.where(known[..., None], local, np.nan), 0)
    return shape


def alignment(points: Array, onto: Array, weight: Array | None = None) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) of the rigid motion  R p + t  of `points` (n, 3) nearest to those `onto` (Kabsch 1976)."""
    w = np.ones(len(points)) if weight is None else weight
    a, b = (w @ p / w.sum() for p in (points, onto))
    u, _, vt = np.linalg.svd((points - a).T @ (w[:, None] * (onto - b)))
    flip = np.array([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    rotation: Array = (vt.T * flip) @ u.T
    return rotation, b - rotation @ a
