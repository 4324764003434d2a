"""Which marker of a standing person sits where: one likelihood of places and of what moves together.

A body of height 1 has landmarks, which one marker each may show, and surfaces, about which any number lie
(`models/body_places.toml`). Its place p, with joints k that carry it (body, pelvis, hip, knee, ...), is Gaussian,

    p ~ N(at, C + diag(own^2)),   C_pq = sum over common joints k of spread_k^2  +  SCALE^2 at_p at_q  (each axis),

so that markers which are already known tell where the others have to be: a tree along the body. Marker i at x_i costs
at place p, on a segment s with n markers,

    c_ip = 1/2 sum over axes [ (x_i - m_p)^2 / v_p + log v_p ] - log(w_p / (1 - w_p)) - min(n, 3) t_is,

m, v the mean and variance of p given the markers that are placed so far, w_p the share of laboratories that use a
landmark, t_is the mean over the markers j of s of how likely i and j move together (`marker_motion.py`), of the
likelier one of its two segments for a landmark at a joint. The best one-to-one assignment (scipy's
`linear_sum_assignment`) and (m, v) follow from each other in turn, as in coherent point drift (Myronenko
and Song, IEEE PAMI 32:2262-2275, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.io.toml import models_path, read_toml
from gaitcal.model.linkage import SIDES

SCALE = 0.04
"""Standard deviation of a person's proportions as a share of the lengths."""
HEIGHT_M, HEIGHT_SD_M = 1.6, 0.25
"""Of people who are recorded, children among them, where nobody tells a height."""
SURFACE = 2.0
"""Cost of a place on a surface, which is one of many, against a landmark's."""
NOWHERE = 3.0
"""Cost of a marker that is on nobody: evenly likely in a body's box, one marker in fifty."""
MOST_WITNESSES = 3
ROUNDS = 8


@dataclass(frozen=True)
class Body:
    """Places of a body of height 1."""

    labels: tuple[str, ...]  # in the marker set "landmarks"; empty of a surface
    segments: tuple[str, ...]
    neighbours: tuple[str, ...]  # segment that it moves with, too: of landmarks at joints; else the same
    joints: tuple[str, ...]  # that carries it
    at: Array  # (np, 3) forward, up, to the right
    own: Array  # (np,) spread about where its joints put it
    worn: Array  # (np,) log odds that a laboratory uses it; 0 of a surface
    shared: Array  # (np, np, 3) covariance by common joints

    @property
    def landmark(self) -> BoolArray:
        """(np,) whether one marker only may sit there."""
        return np.array([bool(label) for label in self.labels])

    def with_arm(self, side: str, other: Body) -> Body:
        """The body with an arm as another one holds it."""
        arm = [segment in (f"upper_arm_{side}", f"forearm_hand_{side}") for segment in self.segments]
        return replace(self, at=np.where(np.array(arm)[:, None], other.at, self.at))


def _both(text: str, side: str) -> str:
    return text.replace("{s}", side)


@cache
def standing_bodies() -> tuple[Body, ...]:
    """The body, once for each posture of the arms."""
    table = read_toml(models_path() / "body_places.toml")
    rows: list[tuple[str, str, str, str, list[float], float, float]] = []

    def add(name: str, label: str, segment: str, other: str, joint: str, at: list[float], own: float, p: float) -> None:
        sides = SIDES if "{s}" in name + segment + joint or at[2] else ("r",)
        for side in sides:
            words = [_both(text, side) for text in (label, segment, other, joint)]
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
            spreads[_both(name, side)] = (_both(entry.get("beyond", ""), side), np.square(entry["spread"]))

    def carriers(joint: str) -> set[str]:
        return {joint} | carriers(spreads[joint][0]) if joint else set()

    chains = [carriers(joint) for joint in joints]
    shared = np.array([[sum((spreads[k][1] for k in one & other), np.zeros(3)) for other in chains] for one in chains])
    hanging = Body(labels, segments, neighbours, joints, np.array(at), np.array(own), np.array(worn), shared)
    arms = table["arms"]
    return tuple(replace(hanging, at=_raised(hanging, arms, np.deg2rad(turns))) for turns in arms["postures"])


def _raised(body: Body, arms: dict[str, Any], turns: Array) -> Array:
    """(np, 3) places with the arms raised sideways and forward, and the elbows bent (rad)."""
    at = body.at.copy()

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
class Placed:
    """Markers on a body."""

    cost: float
    """Negative log likelihood, for comparison with other heights, headings and postures of the same markers."""
    places: IntArray
    """(n,) of each marker; -1 on nobody."""
    away: Array
    """(n,) share of the height, from where the others put its place."""
    ahead: Array
    """(n,) how much the next best segment would cost more."""
    body: Body
    height: float
    """m."""


@dataclass(frozen=True, kw_only=True)
class Together:
    """What is known of markers besides their places."""

    moves: Array
    """(n, n) log likelihood ratio that two markers are on one segment; 0 where nothing is known."""
    known: BoolArray
    """(n, n) whether something is known."""
    allowed: BoolArray
    """(n, np) places that a marker may have."""


def place_markers(points: Array, body: Body, height: float, evidence: Together, *, rounds: int = ROUNDS) -> Placed:
    """Assign markers to places; `points` (n, 3) m: forward, up from the floor, right of the body's middle."""
    x, n, landmark = points / height, len(points), body.landmark
    of, segments = _numbers(body)
    spread = body.shared + SCALE**2 * body.at[:, None] * body.at[None]
    mean, variance = body.at, np.einsum("ppa->pa", spread)
    own = np.square(body.own)[:, None] * np.ones(3)
    surfaces, landmarks = np.flatnonzero(~landmark), np.flatnonzero(landmark)
    free = np.where(landmark, 0.0, SURFACE) - body.worn
    places = np.full(n, -1)
    for step in range(rounds):
        v = variance + own
        cost = 0.5 * (np.square(x[:, None] - mean) / v + np.log(v)).sum(axis=2) + free
        if step > 1:
            cost -= _motion(evidence, places, of, segments)
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
        mean, variance, fit = _given(x, places, body, spread, own)
    chosen = table[np.arange(n), column]
    on, found = places >= 0, places[places >= 0]
    total = fit + NOWHERE * float((~on).sum()) + float(free[found].sum()) + 3 * n * np.log(height)
    total -= 0.5 * float(_motion(evidence, places, of, segments)[np.flatnonzero(on), found].sum())
    others = np.where(np.array(of)[None] == np.where(on, np.array(of)[places], -1)[:, None], np.inf, cost)
    return Placed(
        cost=total,
        places=places,
        away=np.where(on, np.linalg.norm(x - mean[places], axis=1), np.nan),
        ahead=np.where(on, np.minimum(others.min(axis=1), NOWHERE) - chosen, 0.0),
        body=body,
        height=height,
    )


def out_of_place(points: Array, placed: Placed) -> Array:
    """(n,) chi-squared of three: how far each of `points` (n, 3), those of `place_markers`, lies from where all
    others put its place; NaN on nobody. With K their covariance and r their residuals, the sum over the axes of
    (K^-1 r)_i^2 / (K^-1)_ii.
    """
    body, on = placed.body, placed.places >= 0
    found, out = placed.places[on], np.full(len(points), np.nan)
    residual = points[on] / placed.height - body.at[found]
    out[on] = 0.0
    for axis in range(3):
        at = body.at[found, axis]
        joint = body.shared[np.ix_(found, found)][:, :, axis] + SCALE**2 * np.outer(at, at)
        inverse = np.linalg.inv(joint + np.diag(np.square(body.own[found])))
        out[on] += np.square(inverse @ residual[:, axis]) / np.diag(inverse)
    return out


def _numbers(body: Body) -> tuple[list[int], list[int]]:
    """Of each place the number of its segment, and of the segment that it moves with, too."""
    names = sorted(set(body.segments))
    return [names.index(s) for s in body.segments], [names.index(s) for s in body.neighbours]


def _motion(evidence: Together, places: IntArray, of: list[int], neighbours: list[int]) -> Array:
    """(n, np) log likelihood that each marker moves with those that are on the segment of each place."""
    member = np.zeros((len(places), max(of) + 1))
    on = places >= 0
    member[on, np.array(of)[places[on]]] = 1.0
    count = evidence.known @ member
    mean = (evidence.moves @ member) / np.maximum(count, 1.0) * np.minimum(count, MOST_WITNESSES)
    out: Array = np.maximum(mean[:, of], mean[:, neighbours])
    return out


def _given(x: Array, places: IntArray, body: Body, spread: Array, own: Array) -> tuple[Array, Array, float]:
    """Mean and variance (np, 3) of all places given the markers that are placed, and what those cost together."""
    on = places >= 0
    found = places[on]
    mean, variance, total = np.empty_like(body.at), np.empty_like(body.at), 0.0
    for axis in range(3):
        prior = spread[:, :, axis]
        joint = prior[np.ix_(found, found)] + np.diag(own[found, axis])
        residual = x[on, axis] - body.at[found, axis]
        factor = np.linalg.cholesky(joint)
        white = np.linalg.solve(factor, np.column_stack([residual, prior[found]]))
        mean[:, axis] = body.at[:, axis] + white[:, 1:].T @ white[:, 0]
        variance[:, axis] = np.maximum(np.diag(prior) - np.square(white[:, 1:]).sum(axis=0), 1e-6)
        total += 0.5 * float(white[:, 0] @ white[:, 0]) + float(np.log(np.diag(factor)).sum())
    return mean, variance, total
