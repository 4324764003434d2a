"""Identify markers without their labels: joint movement, heading, and positions.

*Moving together.* Skin moves the markers of a segment relative to each other by some millimetres;
the distance of markers on two segments changes by centimetres as joints rotate. S_ij, the standard
deviation of the distance of markers i and j over a trial (the largest over all of them; half of the
difference of its mean between two trials, if that is more), is log-normal about ON_ONE on one
segment, about APART on two.

*Direction.* A foot swings forward while it is high, over ground and on a treadmill; while it is low
it is at rest, or moves backward with the belt. With h the height and u the horizontal velocity of a
low marker, in the axes of the standing person (`_compute_rotations_to`: the rotation about the
vertical that fits all markers best),

    forward ~ sum over frames of (h - mean h) (u - mean u),

for each foot separately. The result counts by the agreement of both, 2 min(a, b) / (a + b) with
their lengths a and b, and a recording counts by 2 min(a, b): one in which one foot moves is no
evidence.

*Position.* One likelihood combines the positions of markers on a standing person and what moves
together. A body of height 1 has landmarks, with one marker at most each, and surfaces with any
number (`models/body_places.toml`). The position p of a landmark or a surface point, with the joints
k that carry it (body, pelvis, hip, knee, ...), is Gaussian,

    p ~ N(at, C + diag(spread^2)),
    C_pq = sum over common joints k of spread_k^2  +  SCALE^2 at_p at_q       (each axis),

so that markers that are already assigned determine where the others are: a tree along the body.
Marker i at x_i has at position p, on a segment s with n markers, the cost

    c_ip = 1/2 sum over axes [ (x_i - m_p)^2 / v_p + log v_p ]
           - log(w_p / (1 - w_p)) - min(n, 3) t_is,

with m, v the mean and variance of p given the markers that are assigned so far, w_p the share of
laboratories that use a landmark, and t_is the mean over the markers j of s of the log odds that i
and j move together (of the likelier of its two segments for a landmark at a joint). The best
one-to-one assignment (scipy's `linear_sum_assignment`) and (m, v) are computed in turn, as in
coherent point drift (Myronenko and Song, IEEE PAMI 32:2262-2275, 2010).
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.io.recording import Recording, find_still_window, find_visible
from gaitcal.io.toml import find_models_folder, read_toml
from gaitcal.model.linkage import SIDES
from gaitcal.tracking.rigid import find_best_rotation

ON_ONE, APART = (0.005, 0.8), (0.05, 1.2)
"""Median of S_ij (m) and standard deviation of its logarithm, of two markers on one segment and on
two: skin and flesh against bone move by 5 mm RMS, give or take a factor of two (Leardini et al.,
Gait Posture 21:212-225, 2005)."""
MOST_FRAMES = 150
"""Frames, evenly spread, that are used of a recording."""
FEWEST_PATH_FRAMES = 10
LAG_S = 0.05
"""s, half of the time over which velocities are computed."""
LOW_M = 0.16
"""m above the lowest marker up to which markers are taken for those of the feet."""
MOST_COMPANIONS = 6
"""Markers by which a marker is placed that the static trial lacks."""


def measure_standing_points(recording: Recording, labels: Sequence[str]) -> Array:
    """Measure where markers are in the stillest part of a recording.

    Parameters
    ----------
    recording
        Static trial.
    labels
        (n,).

    Returns
    -------
    Array
        (n, 3) m; NaN of markers that are not visible.

    Raises
    ------
    InputError
        There is no still window.
    """
    frames = find_still_window(recording, labels).frames
    out = np.full((len(labels), 3), np.nan)
    with warnings.catch_warnings():
        # all NaN: not visible
        warnings.simplefilter("ignore", RuntimeWarning)
        for i, label in enumerate(labels):
            if label in recording.labels:
                path = recording.markers[:, recording.labels.index(label)]
                still = np.nanmean(path[frames], axis=0)
                out[i] = still if np.isfinite(still).all() else np.nanmean(path, axis=0)
    return out


def compute_distance_scatter(
    recordings: Sequence[Recording], labels: Sequence[str], standing: Array | None = None
) -> Array:
    """Compute the scatter S_ij of the distances between markers.

    Parameters
    ----------
    recordings
        Of movements.
    labels
        (n,).
    standing
        (n, 3) m, positions in a further trial without movement.

    Returns
    -------
    Array
        (n, n) m; NaN where two markers are never visible together for long enough.
    """
    number = {label: i for i, label in enumerate(labels)}
    # largest scatter, and range of the mean distances over the trials
    out = np.full((len(labels), len(labels)), np.nan)
    low, high = np.full_like(out, np.nan), np.full_like(out, np.nan)
    if standing is not None:
        low = high = np.linalg.norm(standing[:, None] - standing, axis=2)
        low, high = low.copy(), high.copy()
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in number]
        markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)][:, columns]
        visible = find_visible(markers)
        both = visible.T.astype(np.float64) @ visible
        if not (both >= FEWEST_PATH_FRAMES).any():
            continue
        distance = np.linalg.norm(markers[:, :, None] - markers[:, None], axis=3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            scatter = np.where(both >= FEWEST_PATH_FRAMES, np.nanstd(distance, axis=0), np.nan)
            mean = np.where(both >= FEWEST_PATH_FRAMES, np.nanmean(distance, axis=0), np.nan)
        indices = [number[recording.labels[c]] for c in columns]
        rows = np.ix_(indices, indices)
        out[rows] = np.fmax(out[rows], scatter)
        low[rows], high[rows] = np.fmin(low[rows], mean), np.fmax(high[rows], mean)
    return np.where(np.isfinite(out), np.fmax(out, 0.5 * (high - low)), np.nan)


def compute_segment_log_odds(scatter: Array) -> Array:
    """Compute the log odds that two markers are on one segment and not on two.

    Parameters
    ----------
    scatter
        (n, n) m, of `compute_distance_scatter`.

    Returns
    -------
    Array
        (n, n); 0 where nothing is known.
    """
    log = np.log(np.maximum(scatter, 1e-3))

    def compute_log_density(median: float, deviation: float) -> Array:
        density: Array = -0.5 * np.square((log - np.log(median)) / deviation) - np.log(deviation)
        return density

    out = np.nan_to_num(compute_log_density(*ON_ONE) - compute_log_density(*APART))
    np.fill_diagonal(out, 0.0)
    return out


def place_missing_markers(
    points: Array, labels: Sequence[str], recordings: Sequence[Recording], scatter: Array
) -> Array:
    """Place markers that only the moving trials have, by the markers that they move with.

    Parameters
    ----------
    points
        (n, 3) m, positions in the static trial; NaN where missing.
    labels
        (n,).
    recordings
        Of movements.
    scatter
        (n, n) m, of `compute_distance_scatter`.

    Returns
    -------
    Array
        (n, 3) m; NaN where a marker has fewer than three companions.
    """
    out = points.copy()
    known = np.isfinite(points).all(axis=1)
    for i in np.flatnonzero(~known):
        # companions: those that keep their distance best
        companions = np.flatnonzero(known & np.isfinite(scatter[i]))
        companions = companions[np.argsort(scatter[i, companions])][:MOST_COMPANIONS]
        for recording in recordings:
            wanted = [labels[k] for k in (i, *companions)]
            if len(companions) < 3 or not set(wanted) <= set(recording.labels):
                continue
            paths = recording.markers[:, [recording.labels.index(label) for label in wanted]]
            paths = paths[find_visible(paths).all(axis=1)][:MOST_FRAMES]
            if len(paths) < FEWEST_PATH_FRAMES:
                continue
            # rigid motion from the frames to the static trial
            middle, centre = paths[:, 1:].mean(axis=1), points[companions].mean(axis=0)
            moments = np.einsum(
                "fmi,mj->ijf", paths[:, 1:] - middle[:, None], points[companions] - centre
            )
            rotation = find_best_rotation(moments)[0]
            out[i] = centre + np.einsum("ijf,fi->fj", rotation, paths[:, 0] - middle).mean(axis=0)
            break
    return out


def _compute_rotations_to(markers: Array, points: Array) -> Array:
    """Compute (nf,) rad, rotations about the vertical from markers (nf, n, 3) to points (n, 3)."""
    visible = find_visible(markers).astype(np.float64)[..., None]
    count = np.maximum(visible.sum(axis=1), 1.0)
    x = np.where(visible > 0, markers, 0.0)
    measured = x - (x * visible).sum(axis=1, keepdims=True) / count[:, None]
    target = points[None] - ((visible * points).sum(axis=1) / count)[:, None]
    along = (
        visible[..., 0] * (measured[..., 0] * target[..., 0] + measured[..., 2] * target[..., 2])
    ).sum(axis=1)
    across = (
        visible[..., 0] * (measured[..., 0] * target[..., 2] - measured[..., 2] * target[..., 0])
    ).sum(axis=1)
    out: Array = np.arctan2(across, along)
    return out


def estimate_forward_direction(
    recordings: Sequence[Recording], points: Array, labels: Sequence[str]
) -> Array:
    """Estimate the horizontal direction in which a walking person faces.

    Parameters
    ----------
    recordings
        Of movements.
    points
        (n, 3) m, of the standing person.
    labels
        (n,).

    Returns
    -------
    Array
        (2,) x and z, in the posture of `points`. Its length, 0 to 1, is the agreement of both feet
        over all recordings; zero without walking.
    """
    total, weight = np.zeros(2), 0.0
    known = {label: k for k, label in enumerate(labels) if np.isfinite(points[k]).all()}
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in known]
        lag = max(1, round(LAG_S * recording.rate)) if len(recording.time) > 1 else 1
        if len(columns) < 4 or len(recording.time) < FEWEST_PATH_FRAMES + 2 * lag:
            continue
        names = [recording.labels[c] for c in columns]
        standing = points[[known[name] for name in names]]
        markers = recording.markers[:, columns]
        # markers of both feet
        low = standing[:, 1] < standing[:, 1].min() + LOW_M
        feet = _split_into_feet(
            compute_distance_scatter([recording], [n for n, k in zip(names, low, strict=True) if k])
        )
        if feet is None:
            continue
        # velocity in the axes of the standing person
        angle = _compute_rotations_to(markers, standing)[lag:-lag, None]
        velocity = (markers[2 * lag :, low] - markers[: -2 * lag, low]) / (2 * lag / recording.rate)
        height = markers[lag:-lag, low, 1]
        cos, sin = np.cos(angle), np.sin(angle)
        u = np.stack(
            [
                cos * velocity[..., 0] - sin * velocity[..., 2],
                sin * velocity[..., 0] + cos * velocity[..., 2],
            ]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            swing = np.nansum(
                (height - np.nanmean(height, axis=0)) * (u - np.nanmean(u, axis=1)[:, None]), axis=1
            )
        # agreement of both feet
        one, other = swing[:, feet == 1].sum(axis=1), swing[:, feet == 2].sum(axis=1)
        sizes = np.linalg.norm(one), np.linalg.norm(other)
        both = 2 * float(min(sizes))
        weight += both
        if one @ other > 0:
            total += (
                both**2 / float(sum(sizes)) * (one + other) / float(np.linalg.norm(one + other))
            )
    out: Array = total / weight if weight > 0 else total
    return out


def _split_into_feet(scatter: Array) -> IntArray | None:
    """Split low markers into those that move together: (n,) 1 or 2; None without two groups."""
    if len(scatter) < 2 or not np.isfinite(scatter).any():
        return None
    pairs = np.nan_to_num(scatter, nan=float(np.nanmax(scatter)))[np.triu_indices(len(scatter), 1)]
    return np.asarray(fcluster(linkage(pairs, "average"), 2, "maxclust"), dtype=np.intp)


SCALE = 0.04
"""Standard deviation of a person's proportions as a share of the lengths."""
HEIGHT_M = 1.6
"""m, mean height of recorded people, with children, if it is not given."""
HEIGHT_SD_M = 0.25
"""m, standard deviation of that height."""
SURFACE = 2.0
"""Cost of a position on a surface, which is one of many, compared with a landmark."""
NOWHERE = 3.0
"""Cost of a marker that is not on the body: uniform in a body's box, one marker in fifty."""
MOST_WITNESSES = 3
"""Markers of a segment that count for its motion."""
ROUNDS = 8
"""Iterations of assignment and positions."""


@dataclass(frozen=True)
class BodyTemplate:
    """Positions on a body of height 1: landmarks and points on surfaces."""

    labels: tuple[str, ...]
    """(np,) landmarks of the marker set "landmarks"; empty of a surface."""
    segments: tuple[str, ...]
    """(np,)."""
    neighbours: tuple[str, ...]
    """(np,) second segment that a landmark at a joint moves with; else the same."""
    joints: tuple[str, ...]
    """(np,) joint that carries the position."""
    positions: Array
    """(np, 3) forward, up, to the right."""
    spread: Array
    """(np,) standard deviation about the position by its joints."""
    worn: Array
    """(np,) log odds that a laboratory uses the landmark; 0 of a surface."""
    shared_covariance: Array
    """(np, np, 3) covariance by common joints."""

    @property
    def landmark(self) -> BoolArray:
        """Whether (np,) a position is a landmark, with one marker at most."""
        return np.array([bool(label) for label in self.labels])

    def replace_arm(self, side: str, other: "BodyTemplate") -> "BodyTemplate":
        """Return the body with one arm in the posture of another body.

        `side`: `r` or `l`. `other`: the same body with other arms.
        """
        arm = [
            segment in (f"upper_arm_{side}", f"forearm_hand_{side}") for segment in self.segments
        ]
        return replace(
            self, positions=np.where(np.array(arm)[:, None], other.positions, self.positions)
        )


def _insert_side(text: str, side: str) -> str:
    """Insert the side into a name of the table."""
    return text.replace("{s}", side)


@cache
def load_standing_bodies() -> tuple[BodyTemplate, ...]:
    """Load the body, once for each posture of the arms.

    Returns: with hanging arms first.
    """
    table = read_toml(find_models_folder() / "body_places.toml")
    rows: list[tuple[str, str, str, str, list[float], float, float]] = []

    def add_sides(
        name: str,
        label: str,
        segment: str,
        other: str,
        joint: str,
        position: list[float],
        spread: float,
        share: float,
    ) -> None:
        sides = SIDES if "{s}" in name + segment + joint or position[2] else ("r",)
        forward, up, right = position
        log_odds = float(np.log(share / (1 - share)))
        for side in sides:
            sign = 1.0 if side == "r" else -1.0
            rows.append(
                (
                    _insert_side(label, side),
                    _insert_side(segment, side),
                    _insert_side(other, side),
                    _insert_side(joint, side),
                    [forward, up, sign * right],
                    spread,
                    log_odds,
                )
            )

    for name, entry in table["landmarks"].items():
        add_sides(
            name,
            name,
            entry["on"],
            entry.get("or", entry["on"]),
            entry["joint"],
            entry["at"],
            entry["spread"],
            entry["worn"],
        )
    for name, by_joint in table["surfaces"].items():
        for joint, points in by_joint.items():
            for *position, spread in points:
                add_sides(name, "", name, name, joint, position, spread, 0.5)
    labels, segments, neighbours, joints, positions, spreads, worn = zip(*rows, strict=True)
    hanging = BodyTemplate(
        labels,
        segments,
        neighbours,
        joints,
        np.array(positions),
        np.array(spreads),
        np.array(worn),
        _compute_shared_covariance(joints, table["joints"]),
    )
    arms = table["arms"]
    return tuple(
        replace(hanging, positions=_raise_arms(hanging, arms, np.deg2rad(angles)))
        for angles in arms["postures"]
    )


def _compute_shared_covariance(joints: Sequence[str], table: dict[str, Any]) -> Array:
    """Compute (np, np, 3), the covariance of positions by the joints that carry both."""
    variances: dict[str, Array] = {}
    proximal: dict[str, str] = {}
    for name, entry in table.items():
        for side in SIDES:
            joint = _insert_side(name, side)
            proximal[joint] = _insert_side(entry.get("beyond", ""), side)
            variances[joint] = np.square(entry["spread"])

    def list_carriers(joint: str) -> set[str]:
        return {joint} | list_carriers(proximal[joint]) if joint else set()

    chains = [list_carriers(joint) for joint in joints]
    out = np.zeros((len(joints), len(joints), 3))
    for i, one in enumerate(chains):
        for k, other in enumerate(chains):
            out[i, k] = sum((variances[joint] for joint in one & other), np.zeros(3))
    return out


def _raise_arms(body: BodyTemplate, arms: dict[str, Any], angles: Array) -> Array:
    """Compute (np, 3) with the arms raised sideways and forward, and the elbows flexed (rad)."""
    positions = body.positions.copy()

    def rotate(v: Array, first: int, second: int, angle: float) -> Array:
        out: Array = v.copy()
        out[first] = np.cos(angle) * v[first] - np.sin(angle) * v[second]
        out[second] = np.sin(angle) * v[first] + np.cos(angle) * v[second]
        return out

    for i, segment in enumerate(body.segments):
        if not segment.startswith(("upper_arm", "forearm_hand")):
            continue
        mirror = np.array([1.0, 1.0, 1.0 if segment.endswith("_r") else -1.0])
        position = positions[i] * mirror
        shoulder, elbow = np.array(arms["shoulder"]), np.array(arms["elbow"])
        if segment.startswith("forearm"):
            position = elbow + rotate(position - elbow, 0, 1, angles[2])
        from_shoulder = rotate(rotate(position - shoulder, 0, 1, angles[1]), 2, 1, angles[0])
        positions[i] = (shoulder + from_shoulder) * mirror
    return positions


@dataclass(frozen=True, kw_only=True)
class MarkerLocations:
    """Markers assigned to positions on a body."""

    cost: float
    """Negative log likelihood, to compare heights, headings and postures of the same markers."""
    assignment: IntArray
    """(n,) index of the position of each marker; -1 if it is not on the body."""
    away: Array
    """(n,) distance from the position by the other markers, as a share of the height."""
    ahead: Array
    """(n,) additional cost of the next best segment."""
    body: BodyTemplate
    height: float
    """m."""


@dataclass(frozen=True, kw_only=True)
class MotionEvidence:
    """Knowledge about markers besides their positions."""

    log_odds: Array
    """(n, n), that two markers are on one segment; 0 where nothing is known."""
    known: BoolArray
    """(n, n) whether it is known."""
    allowed: BoolArray
    """(n, np) positions that a marker may have."""


def place_markers(
    points: Array,
    body: BodyTemplate,
    height: float,
    evidence: MotionEvidence,
    *,
    rounds: int = ROUNDS,
) -> MarkerLocations:
    """Assign markers to positions on a body.

    Parameters
    ----------
    points
        (n, 3) m: forward, up from the floor, right of the body's midline.
    body
        Template of height 1.
    height
        m, of the person.
    evidence
        Besides the positions.
    rounds
        Iterations.

    Returns
    -------
    MarkerLocations
    """
    x, n, landmark = points / height, len(points), body.landmark
    segment_of, neighbour_of = _number_segments(body)
    spread = body.shared_covariance + SCALE**2 * body.positions[:, None] * body.positions[None]
    mean, variance = body.positions, np.einsum("ppa->pa", spread)
    own_variance = np.square(body.spread)[:, None] * np.ones(3)
    surfaces, landmarks = np.flatnonzero(~landmark), np.flatnonzero(landmark)
    free = np.where(landmark, 0.0, SURFACE) - body.worn
    assignment = np.full(n, -1)
    for step in range(rounds):
        v = variance + own_variance
        cost = 0.5 * (np.square(x[:, None] - mean) / v + np.log(v)).sum(axis=2) + free
        # motion counts when the first positions are known
        if step > 1:
            cost -= _compute_motion_evidence(evidence, assignment, segment_of, neighbour_of)
        cost = np.where(evidence.allowed, cost, np.inf)
        # landmarks take one marker each; surfaces, or nowhere, any number
        at_surface = surfaces[np.argmin(cost[:, surfaces], axis=1)]
        spare = np.minimum(cost[np.arange(n), at_surface], NOWHERE)
        table = np.full((n, len(landmarks) + n), 1e6)
        table[:, : len(landmarks)] = np.minimum(cost[:, landmarks], 1e5)
        table[np.arange(n), len(landmarks) + np.arange(n)] = spare
        column = linear_sum_assignment(table)[1]
        at_landmark = column < len(landmarks)
        assignment = np.where(spare < NOWHERE, at_surface, -1)
        assignment[at_landmark] = landmarks[column[at_landmark]]
        mean, variance, fit = _compute_conditional_positions(
            x, assignment, body, spread, own_variance
        )
    chosen = table[np.arange(n), column]
    on, found = assignment >= 0, assignment[assignment >= 0]
    total = fit + NOWHERE * float((~on).sum()) + float(free[found].sum()) + 3 * n * np.log(height)
    motion = _compute_motion_evidence(evidence, assignment, segment_of, neighbour_of)
    total -= 0.5 * float(motion[np.flatnonzero(on), found].sum())
    # costs of the positions on other segments
    segments = np.array(segment_of)
    chosen_segments = np.where(on, segments[assignment], -1)
    others = np.where(segments[None] == chosen_segments[:, None], np.inf, cost)
    return MarkerLocations(
        cost=total,
        assignment=assignment,
        away=np.where(on, np.linalg.norm(x - mean[assignment], axis=1), np.nan),
        ahead=np.where(on, np.minimum(others.min(axis=1), NOWHERE) - chosen, 0.0),
        body=body,
        height=height,
    )


def compute_misplacement(points: Array, placed: MarkerLocations) -> Array:
    """Compute how far markers are from the positions by all others.

    Parameters
    ----------
    points
        (n, 3) m, as of `place_markers`.
    placed
        Their assignment.

    Returns
    -------
    Array
        (n,) chi-squared with three degrees of freedom; NaN of markers that are not on the body.

    Notes
    -----
    With K their covariance and r their residuals, it is the sum over the axes of
    (K^-1 r)_i^2 / (K^-1)_ii.
    """
    body, on = placed.body, placed.assignment >= 0
    found, out = placed.assignment[on], np.full(len(points), np.nan)
    residual = points[on] / placed.height - body.positions[found]
    out[on] = 0.0
    # K and r of the notes, axis by axis
    for axis in range(3):
        mean = body.positions[found, axis]
        joint = body.shared_covariance[np.ix_(found, found)][:, :, axis]
        joint = joint + SCALE**2 * np.outer(mean, mean)
        inverse = np.linalg.inv(joint + np.diag(np.square(body.spread[found])))
        out[on] += np.square(inverse @ residual[:, axis]) / np.diag(inverse)
    return out


def _number_segments(body: BodyTemplate) -> tuple[list[int], list[int]]:
    """Return the number of the segment of each position, and of its second segment."""
    names = sorted(set(body.segments))
    return [names.index(s) for s in body.segments], [names.index(s) for s in body.neighbours]


def _compute_motion_evidence(
    evidence: MotionEvidence, assignment: IntArray, segment_of: list[int], neighbour_of: list[int]
) -> Array:
    """Compute (n, np), the log likelihood of moving with the markers on a position's segment."""
    member = np.zeros((len(assignment), max(segment_of) + 1))
    on = assignment >= 0
    member[on, np.array(segment_of)[assignment[on]]] = 1.0
    count = evidence.known @ member
    mean = (evidence.log_odds @ member) / np.maximum(count, 1.0) * np.minimum(count, MOST_WITNESSES)
    out: Array = np.maximum(mean[:, segment_of], mean[:, neighbour_of])
    return out


def _compute_conditional_positions(
    x: Array, assignment: IntArray, body: BodyTemplate, spread: Array, own_variance: Array
) -> tuple[Array, Array, float]:
    """Compute mean and variance (np, 3) of positions given the placed markers, and their cost."""
    on = assignment >= 0
    found = assignment[on]
    mean, variance, total = np.empty_like(body.positions), np.empty_like(body.positions), 0.0
    for axis in range(3):
        # Gaussian conditioning by a Cholesky factor, axis by axis
        prior = spread[:, :, axis]
        joint = prior[np.ix_(found, found)] + np.diag(own_variance[found, axis])
        residual = x[on, axis] - body.positions[found, axis]
        factor = np.linalg.cholesky(joint)
        white = np.linalg.solve(factor, np.column_stack([residual, prior[found]]))
        mean[:, axis] = body.positions[:, axis] + white[:, 1:].T @ white[:, 0]
        variance[:, axis] = np.maximum(np.diag(prior) - np.square(white[:, 1:]).sum(axis=0), 1e-6)
        total += 0.5 * float(white[:, 0] @ white[:, 0]) + float(np.log(np.diag(factor)).sum())
    return mean, variance, total
