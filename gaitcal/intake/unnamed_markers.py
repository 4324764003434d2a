"""Markers whatever they are called: what moves together, which way the person faces, which one sits
where.

Skin moves the markers of a segment against each other by some millimetres; those of two segments
change their distance by a few centimetres and more as joints turn. S_ij, the standard deviation of
the distance of markers i and j over a trial (the largest over all of them; half of what its mean
differs between two trials, where that is more), is log-normal about ON_ONE if they are on one
segment, about APART if not.

Where a foot is higher it swings forward, over the ground and on a treadmill, and where it is lower
it stays, or goes back with the belt. With h the height and u the horizontal velocity of a low
marker, in the axes of the standing person (`_turns_to`: the turn about the vertical that fits all
markers best),

    forward ~ sum over frames of (h - mean h) (u - mean u),

by each foot for itself; what counts is in how far both say the same, 2 min(a, b) / (a + b) with a
and b how much each says, and a recording counts by 2 min(a, b): one in which one foot moves says
nothing.

Which marker of a standing person sits where is one likelihood of places and of what moves together.
A body of height 1 has landmarks, which one marker each may show, and surfaces, about which any
number lie (`models/body_places.toml`). Its place p, with joints k that carry it (body, pelvis, hip,
knee, ...), is Gaussian,

    p ~ N(at, C + diag(own^2)),   C_pq = sum over common joints k of spread_k^2  +  SCALE^2 at_p at_q  (each axis),

so that markers which are already known tell where the others have to be: a tree along the body.
Marker i at x_i costs at place p, on a segment s with n markers,

    c_ip = 1/2 sum over axes [ (x_i - m_p)^2 / v_p + log v_p ] - log(w_p / (1 - w_p)) - min(n, 3)
    t_is,

m, v the mean and variance of p given the markers that are placed so far, w_p the share of
laboratories that use a landmark, t_is the mean over the markers j of s of how likely i and j move
together, of the likelier one of its two segments for a landmark at a joint. The best one-to-one
assignment (scipy's `linear_sum_assignment`) and (m, v) follow from each other in turn, as in
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
FEWEST_FRAMES = 10
LAG_S = 0.05
LOW_M = 0.16  # Height over the lowest marker of those that are taken for the feet's
# Markers, those that keep their distance best, by which one is placed that the static trial lacks
SEEN_BESIDE = 6


def measure_standing_points(recording: Recording, labels: Sequence[str]) -> Array:
    """(n, 3) m, where markers are in the stillest part of a recording; NaN of those that are not
    seen in it.

    InputError where nobody stands still in it.
    """
    frames = find_still_window(recording, labels).frames
    out = np.full((len(labels), 3), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all NaN: not seen
        for i, label in enumerate(labels):
            if label in recording.labels:
                path = recording.markers[:, recording.labels.index(label)]
                still = np.nanmean(path[frames], axis=0)
                out[i] = still if np.isfinite(still).all() else np.nanmean(path, axis=0)
    return out


def compute_distance_scatter(
    recordings: Sequence[Recording], labels: Sequence[str], standing: Array | None = None
) -> Array:
    """(n, n) m, S_ij; NaN where two markers are never seen together for long enough. `standing`:
    (n, 3) m, where they are in a further trial, in which nothing moves.
    """
    number = {label: i for i, label in enumerate(labels)}
    out = np.full((len(labels), len(labels)), np.nan)
    low, high = np.full_like(out, np.nan), np.full_like(out, np.nan)
    if standing is not None:
        low = high = np.linalg.norm(standing[:, None] - standing, axis=2)
        low, high = low.copy(), high.copy()
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in number]
        markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)][:, columns]
        seen = find_visible(markers)
        both = seen.T.astype(np.float64) @ seen
        if not (both >= FEWEST_FRAMES).any():
            continue
        apart = np.linalg.norm(markers[:, :, None] - markers[:, None], axis=3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            scatter = np.where(both >= FEWEST_FRAMES, np.nanstd(apart, axis=0), np.nan)
            mean = np.where(both >= FEWEST_FRAMES, np.nanmean(apart, axis=0), np.nan)
        rows = np.ix_(*[[number[recording.labels[c]] for c in columns]] * 2)
        out[rows] = np.fmax(out[rows], scatter)
        low[rows], high[rows] = np.fmin(low[rows], mean), np.fmax(high[rows], mean)
    return np.where(np.isfinite(out), np.fmax(out, 0.5 * (high - low)), np.nan)


def compute_segment_log_odds(scatter: Array) -> Array:
    """(n, n) log ratio of the likelihoods that two markers are on one segment or on two; 0 where
    nothing is known.
    """
    log = np.log(np.maximum(scatter, 1e-3))

    def density(median: float, deviation: float) -> Array:
        out: Array = -0.5 * np.square((log - np.log(median)) / deviation) - np.log(deviation)
        return out

    out = np.nan_to_num(density(*ON_ONE) - density(*APART))
    np.fill_diagonal(out, 0.0)
    return out


def place_missing_markers(
    points: Array, labels: Sequence[str], recordings: Sequence[Recording], scatter: Array
) -> Array:
    """`points` (n, 3) with markers that only the moving trials have, placed by those that they move
    with.
    """
    out = points.copy()
    known = np.isfinite(points).all(axis=1)
    for i in np.flatnonzero(~known):
        beside = np.flatnonzero(known & np.isfinite(scatter[i]))
        beside = beside[np.argsort(scatter[i, beside])][:SEEN_BESIDE]
        for recording in recordings:
            wanted = [labels[k] for k in (i, *beside)]
            if len(beside) < 3 or not set(wanted) <= set(recording.labels):
                continue
            paths = recording.markers[:, [recording.labels.index(label) for label in wanted]]
            paths = paths[find_visible(paths).all(axis=1)][:MOST_FRAMES]
            if len(paths) < FEWEST_FRAMES:
                continue
            middle, place = paths[:, 1:].mean(axis=1), points[beside].mean(axis=0)
            moments = np.einsum(
                "fmi,mj->ijf", paths[:, 1:] - middle[:, None], points[beside] - place
            )
            turn = find_best_rotation(moments)[0]
            out[i] = place + np.einsum("ijf,fi->fj", turn, paths[:, 0] - middle).mean(axis=0)
            break
    return out


def _compute_rotations_to(markers: Array, points: Array) -> Array:
    """(nf,) rad, turn about the vertical that brings markers (nf, n, 3) nearest to where they stand
    (n, 3).
    """
    seen = find_visible(markers).astype(np.float64)[..., None]
    count = np.maximum(seen.sum(axis=1), 1.0)
    x = np.where(seen > 0, markers, 0.0)
    here = x - (x * seen).sum(axis=1, keepdims=True) / count[:, None]
    there = points[None] - ((seen * points).sum(axis=1) / count)[:, None]
    along = (seen[..., 0] * (here[..., 0] * there[..., 0] + here[..., 2] * there[..., 2])).sum(
        axis=1
    )
    across = (seen[..., 0] * (here[..., 0] * there[..., 2] - here[..., 2] * there[..., 0])).sum(
        axis=1
    )
    out: Array = np.arctan2(across, along)
    return out


def estimate_forward_direction(
    recordings: Sequence[Recording], points: Array, labels: Sequence[str]
) -> Array:
    """(2,) horizontal direction (x, z) in which the person faces who stands at `points` (n, 3); its
    length, 0 to 1, is how far both feet of all recordings say the same. Zero where nobody walks.
    """
    total, weight = np.zeros(2), 0.0
    known = {label: k for k, label in enumerate(labels) if np.isfinite(points[k]).all()}
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in known]
        lag = max(1, round(LAG_S * recording.rate)) if len(recording.time) > 1 else 1
        if len(columns) < 4 or len(recording.time) < FEWEST_FRAMES + 2 * lag:
            continue
        names = [recording.labels[c] for c in columns]
        standing = points[[known[name] for name in names]]
        markers = recording.markers[:, columns]
        low = standing[:, 1] < standing[:, 1].min() + LOW_M
        feet = _split_into_feet(
            compute_distance_scatter([recording], [n for n, k in zip(names, low, strict=True) if k])
        )
        if feet is None:
            continue
        turn = _compute_rotations_to(markers, standing)[lag:-lag, None]
        velocity = (markers[2 * lag :, low] - markers[: -2 * lag, low]) / (2 * lag / recording.rate)
        height = markers[lag:-lag, low, 1]
        cos, sin = np.cos(turn), np.sin(turn)
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
    """(n,) 1 or 2, which low markers move together: those of a foot; None where there are no two."""
    if len(scatter) < 2 or not np.isfinite(scatter).any():
        return None
    pairs = np.nan_to_num(scatter, nan=float(np.nanmax(scatter)))[np.triu_indices(len(scatter), 1)]
    return np.asarray(fcluster(linkage(pairs, "average"), 2, "maxclust"), dtype=np.intp)


SCALE = 0.04  # Standard deviation of a person's proportions as a share of the lengths
HEIGHT_M, HEIGHT_SD_M = (
    1.6,
    0.25,
)  # Of people who are recorded, children among them, where nobody tells a height
SURFACE = 2.0  # Cost of a place on a surface, which is one of many, against a landmark's
NOWHERE = (
    3.0  # Cost of a marker that is on nobody: evenly likely in a body's box, one marker in fifty
)
MOST_WITNESSES = 3
ROUNDS = 8


@dataclass(frozen=True)
class BodyTemplate:
    """Places of a body of height 1."""

    labels: tuple[str, ...]  # in the marker set "landmarks"; empty of a surface
    segments: tuple[str, ...]
    neighbours: tuple[
        str, ...
    ]  # segment that it moves with, too: of landmarks at joints; else the same
    joints: tuple[str, ...]  # that carries it
    positions: Array  # (np, 3) forward, up, to the right
    spread: Array  # (np,) spread about where its joints put it
    worn: Array  # (np,) log odds that a laboratory uses it; 0 of a surface
    shared_covariance: Array  # (np, np, 3) covariance by common joints

    @property
    def landmark(self) -> BoolArray:
        """(np,) whether one marker only may sit there."""
        return np.array([bool(label) for label in self.labels])

    def replace_arm(self, side: str, other: "BodyTemplate") -> "BodyTemplate":
        """The body with an arm as another one holds it."""
        arm = [
            segment in (f"upper_arm_{side}", f"forearm_hand_{side}") for segment in self.segments
        ]
        return replace(
            self, positions=np.where(np.array(arm)[:, None], other.positions, self.positions)
        )


def _insert_side(text: str, side: str) -> str:
    return text.replace("{s}", side)


@cache
def load_standing_bodies() -> tuple[BodyTemplate, ...]:
    """The body, once for each posture of the arms."""
    table = read_toml(find_models_folder() / "body_places.toml")
    rows: list[tuple[str, str, str, str, list[float], float, float]] = []

    def add(
        name: str,
        label: str,
        segment: str,
        other: str,
        joint: str,
        at: list[float],
        own: float,
        p: float,
    ) -> None:
        sides = SIDES if "{s}" in name + segment + joint or at[2] else ("r",)
        for side in sides:
            words = [_insert_side(text, side) for text in (label, segment, other, joint)]
            sign = 1.0 if side == "r" else -1.0
            rows.append((*words, [at[0], at[1], sign * at[2]], own, float(np.log(p / (1 - p)))))  # type: ignore[arg-type]

    for name, entry in table["landmarks"].items():
        add(
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
        for joint, places in by_joint.items():
            for *at, own in places:
                add(name, "", name, name, joint, at, own, 0.5)
    labels, segments, neighbours, joints, at, own, worn = zip(*rows, strict=True)
    spreads: dict[str, tuple[str, Array]] = {}
    for name, entry in table["joints"].items():
        for side in SIDES:
            spreads[_insert_side(name, side)] = (
                _insert_side(entry.get("beyond", ""), side),
                np.square(entry["spread"]),
            )

    def carriers(joint: str) -> set[str]:
        return {joint} | carriers(spreads[joint][0]) if joint else set()

    chains = [carriers(joint) for joint in joints]
    shared = np.array(
        [
            [sum((spreads[k][1] for k in one & other), np.zeros(3)) for other in chains]
            for one in chains
        ]
    )
    hanging = BodyTemplate(
        labels, segments, neighbours, joints, np.array(at), np.array(own), np.array(worn), shared
    )
    arms = table["arms"]
    return tuple(
        replace(hanging, positions=_raise_arms(hanging, arms, np.deg2rad(turns)))
        for turns in arms["postures"]
    )


def _raise_arms(body: BodyTemplate, arms: dict[str, Any], turns: Array) -> Array:
    """(np, 3) places with the arms raised sideways and forward, and the elbows bent (rad)."""
    at = body.positions.copy()

    def turn(v: Array, first: int, second: int, angle: float) -> Array:
        out: Array = v.copy()
        out[first] = np.cos(angle) * v[first] - np.sin(angle) * v[second]
        out[second] = np.sin(angle) * v[first] + np.cos(angle) * v[second]
        return out

    for i, segment in enumerate(body.segments):
        if not segment.startswith(("upper_arm", "forearm_hand")):
            continue
        mirror = np.array([1.0, 1.0, 1.0 if segment.endswith("_r") else -1.0])
        place, shoulder, elbow = at[i] * mirror, np.array(arms["shoulder"]), np.array(arms["elbow"])
        if segment.startswith("forearm"):
            place = elbow + turn(place - elbow, 0, 1, turns[2])
        from_shoulder = turn(turn(place - shoulder, 0, 1, turns[1]), 2, 1, turns[0])
        at[i] = (shoulder + from_shoulder) * mirror
    return at


@dataclass(frozen=True, kw_only=True)
class PlacedMarkers:
    """Markers on a body."""

    # Negative log likelihood, for comparison with other heights, headings and postures of the same
    # markers
    cost: float
    places: IntArray  # (n,) of each marker; -1 on nobody
    away: Array  # (n,) share of the height, from where the others put its place
    ahead: Array  # (n,) how much the next best segment would cost more
    body: BodyTemplate
    height: float  # m


@dataclass(frozen=True, kw_only=True)
class MotionEvidence:
    """What is known of markers besides their places."""

    # (n, n) log likelihood ratio that two markers are on one segment; 0 where nothing is known
    log_odds: Array
    known: BoolArray  # (n, n) whether something is known
    allowed: BoolArray  # (n, np) places that a marker may have


def place_markers(
    points: Array,
    body: BodyTemplate,
    height: float,
    evidence: MotionEvidence,
    *,
    rounds: int = ROUNDS,
) -> PlacedMarkers:
    """Assign markers to places; `points` (n, 3) m: forward, up from the floor, right of the body's
    middle.
    """
    x, n, landmark = points / height, len(points), body.landmark
    of, segments = _number_segments(body)
    spread = body.shared_covariance + SCALE**2 * body.positions[:, None] * body.positions[None]
    mean, variance = body.positions, np.einsum("ppa->pa", spread)
    own = np.square(body.spread)[:, None] * np.ones(3)
    surfaces, landmarks = np.flatnonzero(~landmark), np.flatnonzero(landmark)
    free = np.where(landmark, 0.0, SURFACE) - body.worn
    places = np.full(n, -1)
    for step in range(rounds):
        v = variance + own
        cost = 0.5 * (np.square(x[:, None] - mean) / v + np.log(v)).sum(axis=2) + free
        if step > 1:
            cost -= _compute_motion_evidence(evidence, places, of, segments)
        cost = np.where(evidence.allowed, cost, np.inf)
        at_surface = surfaces[np.argmin(cost[:, surfaces], axis=1)]
        spare = np.minimum(cost[np.arange(n), at_surface], NOWHERE)
        table = np.full((n, len(landmarks) + n), 1e6)
        table[:, : len(landmarks)] = np.minimum(cost[:, landmarks], 1e5)
        table[np.arange(n), len(landmarks) + np.arange(n)] = spare
        column = linear_sum_assignment(table)[1]
        at_landmark = column < len(landmarks)
        places = np.where(spare < NOWHERE, at_surface, -1)
        places[at_landmark] = landmarks[column[at_landmark]]
        mean, variance, fit = _compute_conditional_positions(x, places, body, spread, own)
    chosen = table[np.arange(n), column]
    on, found = places >= 0, places[places >= 0]
    total = fit + NOWHERE * float((~on).sum()) + float(free[found].sum()) + 3 * n * np.log(height)
    total -= 0.5 * float(
        _compute_motion_evidence(evidence, places, of, segments)[np.flatnonzero(on), found].sum()
    )
    others = np.where(
        np.array(of)[None] == np.where(on, np.array(of)[places], -1)[:, None], np.inf, cost
    )
    return PlacedMarkers(
        cost=total,
        places=places,
        away=np.where(on, np.linalg.norm(x - mean[places], axis=1), np.nan),
        ahead=np.where(on, np.minimum(others.min(axis=1), NOWHERE) - chosen, 0.0),
        body=body,
        height=height,
    )


def compute_misplacement(points: Array, placed: PlacedMarkers) -> Array:
    """(n,) chi-squared of three: how far each of `points` (n, 3), those of `place_markers`, lies
    from where all others put its place; NaN on nobody. With K their covariance and r their
    residuals, the sum over the axes of (K^-1 r)_i^2 / (K^-1)_ii.
    """
    body, on = placed.body, placed.places >= 0
    found, out = placed.places[on], np.full(len(points), np.nan)
    residual = points[on] / placed.height - body.positions[found]
    out[on] = 0.0
    for axis in range(3):
        at = body.positions[found, axis]
        joint = body.shared_covariance[np.ix_(found, found)][:, :, axis] + SCALE**2 * np.outer(
            at, at
        )
        inverse = np.linalg.inv(joint + np.diag(np.square(body.spread[found])))
        out[on] += np.square(inverse @ residual[:, axis]) / np.diag(inverse)
    return out


def _number_segments(body: BodyTemplate) -> tuple[list[int], list[int]]:
    """Of each place the number of its segment, and of the segment that it moves with, too."""
    names = sorted(set(body.segments))
    return [names.index(s) for s in body.segments], [names.index(s) for s in body.neighbours]


def _compute_motion_evidence(
    evidence: MotionEvidence, places: IntArray, of: list[int], neighbours: list[int]
) -> Array:
    """(n, np) log likelihood that each marker moves with those that are on the segment of each
    place.
    """
    member = np.zeros((len(places), max(of) + 1))
    on = places >= 0
    member[on, np.array(of)[places[on]]] = 1.0
    count = evidence.known @ member
    mean = (evidence.log_odds @ member) / np.maximum(count, 1.0) * np.minimum(count, MOST_WITNESSES)
    out: Array = np.maximum(mean[:, of], mean[:, neighbours])
    return out


def _compute_conditional_positions(
    x: Array, places: IntArray, body: BodyTemplate, spread: Array, own: Array
) -> tuple[Array, Array, float]:
    """Mean and variance (np, 3) of all places given the markers that are placed, and what those
    cost together.
    """
    on = places >= 0
    found = places[on]
    mean, variance, total = np.empty_like(body.positions), np.empty_like(body.positions), 0.0
    for axis in range(3):
        prior = spread[:, :, axis]
        joint = prior[np.ix_(found, found)] + np.diag(own[found, axis])
        residual = x[on, axis] - body.positions[found, axis]
        factor = np.linalg.cholesky(joint)
        white = np.linalg.solve(factor, np.column_stack([residual, prior[found]]))
        mean[:, axis] = body.positions[:, axis] + white[:, 1:].T @ white[:, 0]
        variance[:, axis] = np.maximum(np.diag(prior) - np.square(white[:, 1:]).sum(axis=0), 1e-6)
        total += 0.5 * float(white[:, 0] @ white[:, 0]) + float(np.log(np.diag(factor)).sum())
    return mean, variance, total
