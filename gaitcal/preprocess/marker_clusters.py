"""Markers of one segment in one trial, against where the static trial has them.

The static posture is in the axes of the person who stands: x forward, y up, z to the right (the
horizontal part of the line between the ASIS), one set of axes for all segments. So a segment's turn
from the static posture is the turn of its markers, and two segments that keep the static posture
have the same turn.

The trial's shape m of a cluster (generalised Procrustes, Gower, Psychometrika 40:33-51, 1975, with
the median for the mean, so that a marker that is elsewhere for a while does not bend it) and the
segment's turn R_f and place o_f:

    m = median_f R_f^T (x_f - o_f),      (R_f, o_f) = the rigid motion of m nearest to x_f,

over the frames in which the joints beside the segment are flexed about as in the static trial, laid
on the static shape s by the nearest rigid motion. Then e = m - s is how far each marker sits from
its static place all the time, and R_f^T (x_f - o_f) less its median how far it strays in a frame.
Where no frame is near the static posture, soft tissue that moves a marker by sigma in walking
(`soft_tissue_artefact.SIZES`) moves it by sigma f / SPREAD_RAD at f rad beyond.

A cluster of fewer than three markers borrows: a thigh the hip centre as the pelvis carries it, a
shank and a foot the lateral marker above.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration import soft_tissue_artefact
from gaitcal.io.recording import Recording, find_still_window, find_visible
from gaitcal.model import kinematics, linkage, rotations, segment_frames
from gaitcal.model.landmarks import measure_static_posture
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.subject_model import SubjectModel
from gaitcal.tracking.rigid import RigidFit, fit_rigid

USUAL_HEIGHT_M = 1.75
"""Clean recordings from which limits in metres are taken are of people up to about this height:
taller ones have longer ways between markers, and those grow with them."""
UP = np.array([0.0, 1.0, 0.0])
FEWEST = 3  # Points that tell how a segment is turned
NEAR_RAD = np.deg2rad(30.0)
"""Flexion from the static posture within which a joint is near it; at least the nearest tenth of
the frames.
"""
NEAREST_PERCENT = 10.0
SPREAD_RAD = np.deg2rad(20.0)
"""Standard deviation of the flexion of a knee over a stride of walking, in which sizes of soft
tissue are measured.
"""
SEEN_SHARE, SEEN_FRAMES = 0.1, 5  # A marker seen in fewer frames takes no part
MOST_FRAMES = 150  # Frames, spread over the trial, from which the shape is found
ROUNDS = 4  # Of the shape: from a start 30 mm off it is then still within 0.1 mm
HIP_CENTRE = "hip centre"  # Name of the point that a thigh borrows
SEGMENTS = (
    "pelvis",
    *(f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in linkage.SIDES),
)
LENDER = {
    "shank": "knee_lat",
    "foot": "ankle_lat",
}  # Segment -> the landmark above it that it may borrow


@dataclass(frozen=True)
class Stance:
    """The static posture of pelvis and legs."""

    points: Mapping[str, Mapping[str, Array]]  # Segment -> marker -> (3,) m
    centres: Mapping[str, Array] = field(default_factory=dict)
    """`hip_r`, `knee_r`, `ankle_r`, ... -> (3,) m; empty where nothing can be said across joints.
    """
    knee_axes: Mapping[str, Array] = field(default_factory=dict)
    """`knee_r`, `knee_l` -> (3,) from the medial to the lateral epicondyle on the right, the other
    way on the left.
    """
    landmarks: Mapping[str, Array] = field(
        default_factory=dict
    )  # (3,) m, of the marker set's landmarks that were seen
    size: float = (
        1.0  # Of the person, by which limits in metres grow: height over the usual, at least 1
    )

    @classmethod
    def from_recording(
        cls,
        static: Recording,
        marker_set: MarkerSet,
        model: SubjectModel,
        hip_centre: segment_frames.HipCentre,
    ) -> "Stance":
        """From the static trial of which `model` was made."""
        static = complete_static(marker_set.rename_labels(static), marker_set)
        marker_set = resolve_marker_set(marker_set, static)
        posture = measure_static_posture(
            static, marker_set, find_still_window(static, marker_set.labels).frames
        )
        legs = segment_frames.measure_lower_body(
            posture,
            model.subject.height,
            hip_centre,
            widths=segment_frames.JointWidths.from_subject(model.subject),
        )
        right = segment_frames.project_across(legs.frames["pelvis"].rotation[:, 2], UP)
        axes = np.vstack([np.cross(UP, right), UP, right])
        points: dict[str, dict[str, Array]] = {}
        for label, segment in zip(model.markers.labels, model.markers.segments, strict=True):
            if segment in legs.frames and label in posture.markers:
                points.setdefault(segment, {})[label] = axes @ posture.markers[label]
        centre = {"hip": "hjc", "knee": "kjc", "ankle": "ajc"}
        landmarks = {name: axes @ at for name, at in posture.landmarks.items()}
        return cls(
            points=points,
            centres={
                f"{j}_{s}": axes @ legs.centres[f"{c}_{s}"]
                for j, c in centre.items()
                for s in linkage.SIDES
            },
            knee_axes={
                f"knee_{s}": segment_frames.sign(s)
                * (landmarks[f"knee_lat_{s}"] - landmarks[f"knee_med_{s}"])
                for s in linkage.SIDES
                if posture.has(f"knee_med_{s}")
            },
            landmarks=landmarks,
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )

    @classmethod
    def from_model(cls, model: SubjectModel) -> "Stance":
        """From a saved model, all coordinates zero: its joint centres and markers."""
        axes, origins = kinematics.compute_body_poses(
            model.parameters, np.zeros((1, len(linkage.COORDINATES)))
        )
        frames = {
            name: segment_frames.Frame(axes[name][:, :, 0].T, origins[name][:, 0]) for name in axes
        }
        points: dict[str, dict[str, Array]] = {}
        placed = zip(model.markers.labels, model.markers.segments, model.markers.local, strict=True)
        for label, segment, local in placed:
            points.setdefault(segment, {})[label] = frames[segment].point(local)
        centres = {}
        above = {
            "hip": ("hip", "pelvis"),
            "knee": ("knee", "thigh"),
            "ankle": ("talocrural", "shank"),
        }
        for name, (joint, part) in above.items():
            for side in linkage.SIDES:
                segment = part if part == "pelvis" else f"{part}_{side}"
                at = model.parameters.centre(f"{joint}_{side}", segment)
                centres[f"{name}_{side}"] = frames[segment].point(at)
        return cls(
            points=points,
            centres=centres,
            landmarks={
                name: frames[segment].point(at) for name, (segment, at) in model.landmarks.items()
            },
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )

    def drop_markers(self, labels: Collection[str]) -> "Stance":
        """The same posture without markers that are no evidence of where they sit, as they were not
        seen in it.
        """
        points = {
            s: {m: at for m, at in placed.items() if m not in labels}
            for s, placed in self.points.items()
        }
        return replace(self, points=points) if labels else self


@dataclass(frozen=True, kw_only=True)
class MarkerCluster:
    """The markers of a segment in a trial."""

    segment: str
    labels: tuple[str, ...]  # (n,) markers; the last may be borrowed
    borrowed: bool  # Whether the last point belongs to the segment above
    reduced: bool
    """Whether it borrows though the static trial has enough markers: some have no weight, or are
    missing here.
    """
    static: Array  # (n, 3) m, s
    shape: Array  # (n, 3) m, m, laid on s
    rotation: Array  # (nf, 3, 3) R: from the static posture to the frame
    origin: Array  # (nf, 3) m, o
    # (nf, n, 3) m, from the mean place, in static axes; NaN where the marker or the segment is not
    # seen
    away: Array
    size: float  # Of the person, by which limits in metres grow
    determined: BoolArray  # (nf,) whether three points not on a line were seen
    # rad, median flexion of the joints beside it in the frames of the shape, beyond NEAR_RAD
    far: float = 0.0
    loose: tuple[int, ...] = ()  # Its own markers that mark no landmark: what is worn as a cluster

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
    def marker_count(self) -> int:
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
    def static_size(self) -> float:
        """m, root of the sum of the squares of the distances of its own markers from their middle."""
        return float(
            np.linalg.norm(
                self.static[: self.marker_count] - self.static[: self.marker_count].mean(axis=0)
            )
        )

    @property
    def size_ratio(self) -> float:
        """Size of the cluster against the static one."""
        return (
            float(
                np.linalg.norm(
                    self.shape[: self.marker_count] - self.shape[: self.marker_count].mean(axis=0)
                )
            )
            / self.static_size
        )

    def compute_tissue_spread(self, *, together: bool = False) -> float:
        """m, standard deviation along each axis of what soft tissue does to a marker by itself, or
        `together` with the others against what they borrow, between the static posture and the
        frames of the shape.
        """
        size = soft_tissue_artefact.SIZES[self.part]
        return compute_tissue_spread(
            float(np.hypot(size.per_marker, size.shift if together and self.borrowed else 0.0)),
            self.far,
        )

    @property
    def swelling(self) -> float:
        """Share by which scatter across the lines between markers lengthens them."""
        return float((self.scatter[: self.marker_count] ** 2).sum()) / self.static_size**2

    def compute_pose_spread(self, point: Array) -> tuple[float, Array]:
        """m, and (3,) rad about x y z: how far the segment's pose at a point (3,) is uncertain as
        its markers scatter.

        Markers that scatter by sigma, with middle c and inertia I of n unit masses about it, leave
        the covariances sigma^2 I^-1 of a turn and sigma^2 (1/n + [r] I^-1 [r]^T) of a point at r
        from c; the fit hides six of the 3 n directions of sigma.
        """
        n = len(self.labels)
        hidden = (3.0 * n - 6.0) / (3.0 * n)
        variance = float(np.mean(self.scatter**2)) / (3.0 * hidden)
        away = self.static - self.static.mean(axis=0)
        turn = variance * np.linalg.pinv(np.eye(3) * (away**2).sum() - away.T @ away)
        return float(
            np.sqrt(3.0 * variance * segment_frames.compute_position_variance(self.static, point))
        ), np.sqrt(np.diag(turn))

    def transform_point(self, point: Array) -> Array:
        """(nf, 3) m, where the segment has a point (3,) of the static posture; NaN where it is not
        determined.
        """
        path: Array = self.rotation @ point + self.origin
        path[~self.determined] = np.nan
        return path


def compute_tissue_spread(size: float, far: float) -> float:
    """m, of soft tissue of a `size` (m) in walking, where joints are flexed by `far` (rad) beyond
    what is near; people are of a softness that is log-normal.
    """
    return float(np.exp(soft_tissue_artefact.LOG_SPREAD**2)) * size * max(0.0, far) / SPREAD_RAD


def fit_clusters(
    recording: Recording,
    stance: Stance,
    landmarks: Mapping[str, tuple[str, ...]],
    judged: Callable[[str], bool],
    near: Mapping[str, tuple[BoolArray, float]] | None = None,
    before: Mapping[str, MarkerCluster] | None = None,
) -> dict[str, MarkerCluster]:
    """Segment -> its cluster, for pelvis and legs; `judged` tells which markers count, `near` of a
    segment in which frames (nf,) its posture is near the static one, and how far (rad) that still
    is: without it that is found first, from the clusters `before`.
    """
    place = {label: i for i, label in enumerate(recording.labels)}
    shares = find_visible(recording.markers).sum(axis=0)
    needed = max(SEEN_SHARE * len(recording.time), min(SEEN_FRAMES, len(recording.time)))
    out: dict[str, MarkerCluster] = {}

    def usable(label: str) -> bool:
        return label in place and judged(label) and shares[place[label]] >= needed

    def borrowed(segment: str) -> tuple[str, Array, Array] | None:
        """Name, static place (3,) and path (nf, 3) of the point that a segment borrows; None where
        there is none.
        """
        part, _, side = segment.partition("_")
        if part == "thigh" and "pelvis" in out:
            centre = stance.centres[f"hip_{side}"]
            return HIP_CENTRE, centre, out["pelvis"].transform_point(centre)
        name = f"{LENDER.get(part, '')}_{side}"
        labels = landmarks.get(name, ())
        if len(labels) != 1 or not usable(labels[0]) or name not in stance.landmarks:
            return None
        return labels[0], stance.landmarks[name], recording.markers[:, place[labels[0]]]

    for segment in SEGMENTS:
        labels = [label for label in stance.points.get(segment, {}) if usable(label)]
        static = [stance.points[segment][label] for label in labels]
        paths = [recording.markers[:, place[label]] for label in labels]
        lent = borrowed(segment) if 0 < len(labels) < FEWEST and stance.centres else None
        if lent is not None:
            name, at, path = lent
            labels, static, paths = [*labels, name], [*static, at], [*paths, path]
        if before and near and segment not in near and lent is None:
            out |= {segment: before[segment]} if segment in before else {}
            continue
        frames, far = (near or {}).get(segment, (None, 0.0))
        known = (
            _fit_shape(np.array(static), np.stack(paths, axis=1), frames)
            if len(labels) >= FEWEST
            else None
        )
        if known is not None:
            own = len(labels) - (lent is not None)
            shape, fit, away = known
            out[segment] = MarkerCluster(
                segment=segment,
                labels=tuple(labels),
                borrowed=lent is not None,
                reduced=lent is not None and len(stance.points[segment]) >= FEWEST,
                static=np.array(static),
                shape=shape,
                rotation=fit.rotation,
                origin=fit.origin,
                away=away,
                size=stance.size,
                determined=fit.determined,
                far=far,
                loose=tuple(
                    i
                    for i in range(own)
                    if not any(labels[i] in named for named in landmarks.values())
                ),
            )
    if near is not None:
        return out
    flexed = {
        s: flexion
        for s in out
        if np.nanmax(flexion := _measure_flexion(out, s), initial=0.0) > NEAR_RAD
    }
    limits = {
        s: max(NEAR_RAD, float(np.nanpercentile(flexion, NEAREST_PERCENT)))
        for s, flexion in flexed.items()
    }
    near = {
        s: (f <= limits[s], float(np.median(f[f <= limits[s]])) - NEAR_RAD)
        for s, f in flexed.items()
    }
    return fit_clusters(recording, stance, landmarks, judged, near, out) if near else out


def _measure_flexion(clusters: Mapping[str, MarkerCluster], segment: str) -> Array:
    """(nf,) rad, from the static posture, of the joint beside a segment that is flexed most; NaN
    where none is seen.
    """
    part, _, side = segment.partition("_")
    parts = ("pelvis", "thigh", "shank", "foot")
    beside = [p for p in parts if abs(parts.index(p) - parts.index(part)) == 1]
    names = [p if p == "pelvis" else f"{p}_{s}" for p in beside for s in (side or linkage.SIDES)]
    one, out = clusters[segment], np.full(len(clusters[segment].determined), np.nan)
    for other in (clusters[name] for name in names if name in clusters):
        angle = np.abs(
            rotations.compute_root_angles(one.rotation.transpose(0, 2, 1) @ other.rotation)[:, 0]
        )
        out = np.fmax(out, np.where(one.determined & other.determined, angle, np.nan))
    return out


def _fit_shape(
    static: Array, paths: Array, near: BoolArray | None = None
) -> tuple[Array, RigidFit, Array] | None:
    """Shape, in the frames `near` (nf,) where they show it, motion and ways away of points with
    paths (nf, n, 3); None where no frame shows three of them.
    """
    visible = find_visible(paths)
    shown = visible.sum(axis=1) >= FEWEST
    alike = shown & near if near is not None else shown
    enough = np.flatnonzero(alike if alike.sum() >= SEEN_FRAMES else shown)
    if len(enough) < min(SEEN_FRAMES, len(paths)):
        return None
    some = enough[:: max(1, len(enough) // MOST_FRAMES)]
    measured, weight = (
        np.where(visible[:, :, None], paths, 0.0).transpose(1, 2, 0),
        visible.T.astype(float),
    )
    shape = _compute_mean_shape(
        static, paths[some], visible[some], measured[:, :, some], weight[:, some]
    )
    if shape is None:
        return None
    turn, shift = align_points(shape, static)
    shape = shape @ turn.T + shift
    fit = fit_rigid(shape, measured, weight)
    away = (paths - fit.origin[:, None]) @ fit.rotation - shape
    away[~fit.determined] = np.nan
    return shape, fit, away if near is None else away - np.nanmedian(away, axis=0)


def _compute_mean_shape(
    start: Array, paths: Array, seen: BoolArray, measured: Array, weight: Array
) -> Array | None:
    """(n, 3) m, the shape of a cluster with paths (nf, n, 3), `measured` and `weight` as
    `fit_rigid` takes them; None where a point is never seen with two others.
    """
    shape = start
    for _ in range(ROUNDS):
        fit = fit_rigid(shape, measured, weight)
        local = (paths - fit.origin[:, None]) @ fit.rotation
        known = seen & fit.determined[:, None]
        if not known.any(axis=0).all():
            return None
        shape = (
            np.median(local, axis=0)
            if known.all()
            else np.nanmedian(np.where(known[..., None], local, np.nan), 0)
        )
    return shape


def align_points(points: Array, onto: Array, weight: Array | None = None) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) of the rigid motion  R p + t  of `points` (n, 3) nearest to those `onto`
    (Kabsch 1976).
    """
    w = np.ones(len(points)) if weight is None else weight
    a, b = (w @ p / w.sum() for p in (points, onto))
    rotation = segment_frames.find_nearest_rotation((onto - b).T @ (w[:, None] * (points - a)))
    return rotation, b - rotation @ a
