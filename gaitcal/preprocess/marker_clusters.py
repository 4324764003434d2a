"""Fit the markers of each segment of a trial to where the static trial has them.

The static posture is in axes of the standing person: x forward, y up, z to the right (the
horizontal part of the line between the ASIS), the same axes for all segments. A segment's rotation
from the static posture is therefore the rotation of its markers, and two segments that keep the
static posture have the same rotation.

The trial's shape m of a cluster (generalised Procrustes, Gower, Psychometrika 40:33-51, 1975, with
the median for the mean, so that a marker that is displaced for a while does not bend it) and the
segment's rotation R_f and translation o_f are

    m = median_f R_f^T (x_f - o_f),      (R_f, o_f) = the rigid motion of m nearest to x_f,

over the frames in which the adjacent joints are flexed about as in the static trial, aligned with
the static shape s by the nearest rigid motion. Then e = m - s is the constant offset of each marker
from its static position, and R_f^T (x_f - o_f) less its median is its displacement in a frame.
Without frames near the static posture, soft tissue that moves a marker by sigma in walking
(`soft_tissue_artefact.SIZES`) moves it by sigma f / SPREAD_RAD at f rad beyond.

A cluster of fewer than three markers borrows a point: a thigh the hip centre, as the pelvis carries
it, a shank and a foot the lateral marker of the joint above.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray, compute_rms
from gaitcal.calibration import soft_tissue_artefact
from gaitcal.io.recording import Recording, find_still_window, find_visible
from gaitcal.model import kinematics, linkage, rotations, segment_frames
from gaitcal.model.landmarks import measure_static_posture
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.subject_model import SubjectModel
from gaitcal.tracking.rigid import RigidFit, fit_rigid

USUAL_HEIGHT_M = 1.75
"""m. Limits in metres are from people up to about this height; for taller ones they grow with it,
as their markers are farther apart.
"""
UP = np.array([0.0, 1.0, 0.0])
FEWEST = 3
"""Points that determine the pose of a segment."""
NEAR_RAD = np.deg2rad(30.0)
"""Flexion from the static posture within which a joint is near it."""
NEAREST_PERCENT = 10.0
"""Share of the frames that are taken as near at least."""
SPREAD_RAD = np.deg2rad(20.0)
"""Standard deviation of the flexion of a knee over a stride of walking, in which sizes of soft
tissue are measured.
"""
SEEN_SHARE = 0.1
"""Smallest share of the frames in which a marker of a cluster is visible."""
SEEN_FRAMES = 5
"""Smallest number of such frames."""
MOST_FRAMES = 150
"""Frames, evenly spread over the trial, from which the shape is found."""
ROUNDS = 4
"""Iterations of the shape: from a start with 30 mm error it is within 0.1 mm."""
HIP_CENTRE = "hip centre"
"""Name of the point that a thigh borrows."""
SEGMENTS = (
    "pelvis",
    *(f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in linkage.SIDES),
)
LENDER = {"shank": "knee_lat", "foot": "ankle_lat"}
"""Segment -> the landmark above it that it may borrow."""


@dataclass(frozen=True)
class Stance:
    """The static posture of pelvis and legs: forward, up and right of the standing person."""

    points: Mapping[str, Mapping[str, Array]]
    """Segment -> marker -> (3,) m."""
    centres: Mapping[str, Array] = field(default_factory=dict)
    """`hip_r`, `knee_r`, `ankle_r`, ... -> (3,) m; empty if joint centres are not available."""
    knee_axes: Mapping[str, Array] = field(default_factory=dict)
    """`knee_r`, `knee_l` -> (3,) m, from medial to lateral epicondyle, on the left reversed.
    """
    landmarks: Mapping[str, Array] = field(default_factory=dict)
    """Visible landmark of the marker set -> (3,) m."""
    size: float = 1.0
    """Factor of limits in metres: height of the person over `USUAL_HEIGHT_M`, at least 1."""

    @classmethod
    def from_recording(
        cls,
        static: Recording,
        marker_set: MarkerSet,
        model: SubjectModel,
        hip_centre: segment_frames.HipCentre,
    ) -> "Stance":
        """Measure the posture in the static trial of which `model` was made.

        Parameters
        ----------
        static
            Static trial, y up.
        marker_set
            Of the trial.
        model
            Nominal model of the same static trial.
        hip_centre
            Regression of the hip centres.

        Returns
        -------
        Stance
            With joint centres, knee axes (with medial markers only) and landmarks.
        """
        static = complete_static(marker_set.renamed(static), marker_set)
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
        # axes of the standing person, and its markers in them
        axes = np.vstack([np.cross(UP, right), UP, right])
        points: dict[str, dict[str, Array]] = {}
        for label, segment in zip(model.markers.labels, model.markers.segments, strict=True):
            if segment in legs.frames and label in posture.markers:
                points.setdefault(segment, {})[label] = axes @ posture.markers[label]
        landmarks = {name: axes @ position for name, position in posture.landmarks.items()}
        centres, knee_axes = dict[str, Array](), dict[str, Array]()
        for joint, centre in (("hip", "hjc"), ("knee", "kjc"), ("ankle", "ajc")):
            for side in linkage.SIDES:
                centres[f"{joint}_{side}"] = axes @ legs.centres[f"{centre}_{side}"]
        for side in linkage.SIDES:
            if posture.has(f"knee_med_{side}"):
                across = landmarks[f"knee_lat_{side}"] - landmarks[f"knee_med_{side}"]
                knee_axes[f"knee_{side}"] = segment_frames.sign(side) * across
        return cls(
            points=points,
            centres=centres,
            knee_axes=knee_axes,
            landmarks=landmarks,
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )

    @classmethod
    def from_model(cls, model: SubjectModel) -> "Stance":
        """Take the posture of a saved model with all coordinates zero.

        Parameters
        ----------
        model
            Nominal or calibrated.

        Returns
        -------
        Stance
            Without knee axes.
        """
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
                centre = model.parameters.centre(f"{joint}_{side}", segment)
                centres[f"{name}_{side}"] = frames[segment].point(centre)
        return cls(
            points=points,
            centres=centres,
            landmarks={
                name: frames[segment].point(centre)
                for name, (segment, centre) in model.landmarks.items()
            },
            size=max(1.0, model.subject.height / USUAL_HEIGHT_M),
        )

    def drop_markers(self, labels: Collection[str]) -> "Stance":
        """Return the posture without markers that are no evidence of their static position.

        Parameters
        ----------
        labels
            Of markers that were reconstructed, not observed.

        Returns
        -------
        Stance
        """
        points: dict[str, dict[str, Array]] = {}
        for segment, placed in self.points.items():
            points[segment] = {m: at for m, at in placed.items() if m not in labels}
        return replace(self, points=points) if labels else self


@dataclass(frozen=True, kw_only=True)
class MarkerCluster:
    """The markers of a segment in a trial, and its motion from the static posture."""

    segment: str
    labels: tuple[str, ...]
    """(n,) points; the last one may be borrowed."""
    borrowed: bool
    """Whether the last point belongs to the segment above."""
    reduced: bool
    """Whether it borrows although the static trial has enough markers: some have no weight, or are
    missing in this trial.
    """
    static: Array
    """(n, 3) m, s."""
    shape: Array
    """(n, 3) m, m aligned with s."""
    rotation: Array
    """(nf, 3, 3) R, from the static posture to the frame."""
    origin: Array
    """(nf, 3) m, o."""
    away: Array
    """(nf, n, 3) m, displacement from the mean position in static axes; NaN where the marker is not
    visible or the segment not determined.
    """
    size: float
    """Of the person, see `Stance.size`."""
    determined: BoolArray
    """(nf,) whether three points that are not on a line are visible."""
    far: float = 0.0
    """rad, median flexion of the adjacent joints in the frames of the shape, beyond `NEAR_RAD`."""
    loose: tuple[int, ...] = ()
    """Indices of its markers that mark no landmark: those of a cluster plate."""

    @cached_property
    def strayed(self) -> Array:
        """Distance (nf, n) m from the mean position; NaN where not visible."""
        out: Array = np.linalg.norm(self.away, axis=2)
        return out

    @property
    def part(self) -> str:
        """`pelvis`, `thigh`, `shank`, `foot`."""
        return self.segment.split("_")[0]

    @property
    def marker_count(self) -> int:
        """Number of points that are markers of the segment, without the borrowed one."""
        return len(self.labels) - self.borrowed

    @property
    def offsets(self) -> Array:
        """Offsets (n, 3) m from the static positions, e."""
        return self.shape - self.static

    @cached_property
    def scatter(self) -> Array:
        """RMS distance (n,) m from the mean position."""
        return compute_rms(self.strayed, axis=0)

    @property
    def static_size(self) -> float:
        """Root (m) of the sum of squared distances of the segment's markers from their centroid."""
        return float(
            np.linalg.norm(
                self.static[: self.marker_count] - self.static[: self.marker_count].mean(axis=0)
            )
        )

    @property
    def size_ratio(self) -> float:
        """Size of the cluster in the trial over its size in the static trial."""
        return (
            float(
                np.linalg.norm(
                    self.shape[: self.marker_count] - self.shape[: self.marker_count].mean(axis=0)
                )
            )
            / self.static_size
        )

    def compute_tissue_spread(self, *, together: bool = False) -> float:
        """Compute the soft tissue artefact of a marker between static posture and trial.

        Parameters
        ----------
        together
            Of all markers together, relative to the point they borrow, instead of one marker.

        Returns
        -------
        float
            m, standard deviation along each axis.
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
        """Compute the uncertainty of the segment's pose by the scatter of its markers.

        Parameters
        ----------
        point
            (3,) m in the static posture, at which the position is wanted.

        Returns
        -------
        position : float
            m, standard deviation (root of the sum over the axes) of the position of `point`.
        rotation : Array
            (3,) rad, standard deviations about x, y, z.

        Notes
        -----
        Markers that scatter by sigma, with centroid c and inertia I of n unit masses about it, give
        the covariances sigma^2 I^-1 of the rotation and sigma^2 (1/n + [r] I^-1 [r]^T) of a point
        at r from c. The fit absorbs six of the 3 n directions of sigma.
        """
        n = len(self.labels)
        hidden = (3.0 * n - 6.0) / (3.0 * n)
        variance = float(np.mean(self.scatter**2)) / (3.0 * hidden)
        away = self.static - self.static.mean(axis=0)
        rotation = variance * np.linalg.pinv(np.eye(3) * (away**2).sum() - away.T @ away)
        lever = segment_frames.compute_position_variance(self.static, point)
        return float(np.sqrt(3.0 * variance * lever)), np.sqrt(np.diag(rotation))

    def transform_point(self, point: Array) -> Array:
        """Compute where the segment carries a point of the static posture.

        Parameters
        ----------
        point
            (3,) m in the static posture.

        Returns
        -------
        Array
            (nf, 3) m in the laboratory; NaN where the segment is not determined.
        """
        path: Array = self.rotation @ point + self.origin
        path[~self.determined] = np.nan
        return path


def compute_tissue_spread(size: float, far: float) -> float:
    """Compute the soft tissue artefact in a posture far from the static one.

    Parameters
    ----------
    size
        m, standard deviation of the artefact in walking.
    far
        rad, flexion beyond what is near the static posture.

    Returns
    -------
    float
        m. The softness of people is log-normal (`soft_tissue_artefact.LOG_SPREAD`).
    """
    return float(np.exp(soft_tissue_artefact.LOG_SPREAD**2)) * size * max(0.0, far) / SPREAD_RAD


def fit_clusters(
    recording: Recording,
    stance: Stance,
    landmarks: Mapping[str, tuple[str, ...]],
    is_counted: Callable[[str], bool],
) -> dict[str, MarkerCluster]:
    """Fit the clusters of pelvis and legs of a trial to the static posture.

    Parameters
    ----------
    recording
        Marker positions of the trial.
    stance
        Static posture.
    landmarks
        Landmark of the marker set -> its markers.
    is_counted
        Returns whether a marker takes part.

    Returns
    -------
    dict
        Segment -> cluster, where three points are visible in enough frames.
    """
    first = _fit_in_frames(recording, stance, landmarks, is_counted, {}, {})
    # again, from the frames near the static posture, for segments whose joints flex beyond
    near: dict[str, tuple[BoolArray, float]] = {}
    for segment in first:
        flexion = _measure_flexion(first, segment)
        if np.nanmax(flexion, initial=0.0) > NEAR_RAD:
            is_near = flexion <= max(NEAR_RAD, float(np.nanpercentile(flexion, NEAREST_PERCENT)))
            near[segment] = is_near, float(np.median(flexion[is_near])) - NEAR_RAD
    return _fit_in_frames(recording, stance, landmarks, is_counted, near, first) if near else first


def _fit_in_frames(
    recording: Recording,
    stance: Stance,
    landmarks: Mapping[str, tuple[str, ...]],
    is_counted: Callable[[str], bool],
    near: Mapping[str, tuple[BoolArray, float]],
    before: Mapping[str, MarkerCluster],
) -> dict[str, MarkerCluster]:
    """Fit the clusters, those of segments in `near` from some frames, others as they were `before`.

    `near`: segment -> frames (nf,) near the static posture, and how far (rad) they still are from
    it.
    """
    column_of = {label: i for i, label in enumerate(recording.labels)}
    frame_counts = find_visible(recording.markers).sum(axis=0)
    needed = max(SEEN_SHARE * len(recording.time), min(SEEN_FRAMES, len(recording.time)))
    on_landmarks = {label for labels in landmarks.values() for label in labels}
    out: dict[str, MarkerCluster] = {}

    def is_usable(label: str) -> bool:
        if label not in column_of or not is_counted(label):
            return False
        return bool(frame_counts[column_of[label]] >= needed)

    def find_borrowed(segment: str) -> tuple[str, Array, Array] | None:
        """Name, static position (3,) and path (nf, 3) of the point that a segment borrows."""
        part, _, side = segment.partition("_")
        if part == "thigh" and "pelvis" in out:
            centre = stance.centres[f"hip_{side}"]
            return HIP_CENTRE, centre, out["pelvis"].transform_point(centre)
        name = f"{LENDER.get(part, '')}_{side}"
        labels = landmarks.get(name, ())
        if len(labels) != 1 or not is_usable(labels[0]) or name not in stance.landmarks:
            return None
        return labels[0], stance.landmarks[name], recording.markers[:, column_of[labels[0]]]

    # the pelvis comes first: thighs borrow from it
    for segment in SEGMENTS:
        labels = [label for label in stance.points.get(segment, {}) if is_usable(label)]
        static = [stance.points[segment][label] for label in labels]
        paths = [recording.markers[:, column_of[label]] for label in labels]
        lent = find_borrowed(segment) if 0 < len(labels) < FEWEST and stance.centres else None
        if lent is not None:
            name, position, path = lent
            labels, static, paths = [*labels, name], [*static, position], [*paths, path]
        # in the second fit, what was near the static posture throughout stays
        if near and segment not in near and lent is None:
            if segment in before:
                out[segment] = before[segment]
            continue
        if len(labels) < FEWEST:
            continue
        frames, far = near.get(segment, (None, 0.0))
        fitted = _fit_shape(np.array(static), np.stack(paths, axis=1), frames)
        if fitted is None:
            continue
        shape, fit, away = fitted
        markers = labels if lent is None else labels[:-1]
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
            loose=tuple(i for i, label in enumerate(markers) if label not in on_landmarks),
        )
    return out


def _measure_flexion(clusters: Mapping[str, MarkerCluster], segment: str) -> Array:
    """Measure (nf,) rad, the largest flexion of the adjacent joints from the static posture."""
    part, _, side = segment.partition("_")
    parts = ("pelvis", "thigh", "shank", "foot")
    adjacent = [p for p in parts if abs(parts.index(p) - parts.index(part)) == 1]
    names = [p if p == "pelvis" else f"{p}_{s}" for p in adjacent for s in (side or linkage.SIDES)]
    cluster, out = clusters[segment], np.full(len(clusters[segment].determined), np.nan)
    for other in (clusters[name] for name in names if name in clusters):
        relative = cluster.rotation.transpose(0, 2, 1) @ other.rotation
        angle = np.abs(rotations.compute_root_angles(relative)[:, 0])
        out = np.fmax(out, np.where(cluster.determined & other.determined, angle, np.nan))
    return out


def _fit_shape(
    static: Array, paths: Array, near: BoolArray | None = None
) -> tuple[Array, RigidFit, Array] | None:
    """Fit shape, motion and displacements to paths (nf, n, 3) m, from the frames `near`.

    None if no frame shows three of the points. Without enough near frames all are taken.
    """
    visible = find_visible(paths)
    shown = visible.sum(axis=1) >= FEWEST
    alike = shown & near if near is not None else shown
    enough = np.flatnonzero(alike if alike.sum() >= SEEN_FRAMES else shown)
    if len(enough) < min(SEEN_FRAMES, len(paths)):
        return None
    some = enough[:: max(1, len(enough) // MOST_FRAMES)]
    measured = np.where(visible[:, :, None], paths, 0.0).transpose(1, 2, 0)
    weight = visible.T.astype(float)
    shape = _compute_mean_shape(
        static, paths[some], visible[some], measured[:, :, some], weight[:, some]
    )
    if shape is None:
        return None
    rotation, shift = align_points(shape, static)
    shape = shape @ rotation.T + shift
    fit = fit_rigid(shape, measured, weight)
    away = (paths - fit.origin[:, None]) @ fit.rotation - shape
    away[~fit.determined] = np.nan
    return shape, fit, away if near is None else away - np.nanmedian(away, axis=0)


def _compute_mean_shape(
    start: Array, paths: Array, visible: BoolArray, measured: Array, weight: Array
) -> Array | None:
    """Compute (n, 3) m, the shape of a cluster; None if a point is never visible with two others.

    `paths` (nf, n, 3) m; `measured` and `weight` as `fit_rigid` takes them.
    """
    shape = start
    for _ in range(ROUNDS):
        fit = fit_rigid(shape, measured, weight)
        local = (paths - fit.origin[:, None]) @ fit.rotation
        known = visible & fit.determined[:, None]
        if not known.any(axis=0).all():
            return None
        shape = (
            np.median(local, axis=0)
            if known.all()
            else np.nanmedian(np.where(known[..., None], local, np.nan), 0)
        )
    return shape


def align_points(points: Array, onto: Array, weight: Array | None = None) -> tuple[Array, Array]:
    """Find the rigid motion of points nearest to other points (Kabsch 1976).

    Parameters
    ----------
    points, onto
        (n, 3) m, in the same order.
    weight
        (n,); None: equal weights.

    Returns
    -------
    rotation, translation : Array
        (3, 3) R and (3,) t m of R p + t.
    """
    w = np.ones(len(points)) if weight is None else weight
    a, b = (w @ p / w.sum() for p in (points, onto))
    rotation = segment_frames.find_nearest_rotation((onto - b).T @ (w[:, None] * (points - a)))
    return rotation, b - rotation @ a
