"""What makes a trial's body another one than the static trial's: the one cause that explains it best.

A trial contradicts the static one where a cluster's offsets, a joint's gap or its turn (`cluster.py`, `joint_link.py`)
exceed what clean recordings show. A marker that moved bends its cluster and, through the segment's pose, both joints of
the segment; so the cause is sought with all of them together. For a segment with markers m_i (static place s_i) and the
axis points p_k of its joints, which the neighbours have at q_k, every explanation has a cost

    J = min over rigid C of   sum_i |C m_i - s_i|^2 / sigma^2  +  sum_k |C q_k - p_k|^2 / (2 sigma_k^2)   +  price:

one marker left its place (without its term), two markers carry each other's label (m exchanged), the cluster is
mirrored (m reflected), or all of it slid or turned on the segment (the two sums each with a C of its own). The price is
what a free quantity gains by chance. The cheapest of the segments concerned is told; what is left is explained anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.checks.cluster import FEWEST, Cluster, alignment
from gaitcal.checks.joint_link import JointLink, angle_of, side_turns

OFFSET_M: Mapping[str, float] = {"pelvis": 0.008, "thigh": 0.010, "shank": 0.008, "foot": 0.008}
"""Largest offset of a cluster. Clean recordings of 32 people in five laboratories reach 5.0, 6.3, 5.5 and 6.1 mm."""
STEADY_M, STEADY_RATIO, JITTER_M = 0.007, 4.0, 0.0015
"""A smaller offset counts where it is so many times its own scatter in time, which is at least JITTER."""
BORROWED = 1.6
"""Factor of the offset where a cluster borrows from the segment above, whose skin moves otherwise."""
GAP_M: Mapping[str, float] = {"hip": 0.035, "knee": 0.028, "ankle": 0.016}
"""Gap of a joint. Clean recordings reach 27, 25 and 13 mm."""
TURN_RAD: Mapping[str, tuple[float, float]] = {
    name: (float(np.deg2rad(ab)), float(np.deg2rad(axial)))
    for name, (ab, axial) in {"hip": (15.0, 18.0), "knee": (12.0, 15.0), "ankle": (20.0, 18.0)}.items()
}
"""Ab/adduction and axial turn of a joint against the static posture. Clean recordings reach 11 and 13, 6 and 15, 16
and 15 deg."""
SCATTERED = 2.0
"""Standard deviations, as markers scatter within the trial, that widen the limits of gap and turn: a small cluster far
from the joint tells little of it."""
SPREAD = 3.0
"""A limit is taken as so many standard deviations."""
PRICE = {"marker": 9.0, "labels": 4.0, "mirrored": 4.0, "cluster": 18.0}
"""Of an explanation: three times its free quantities, and a little for a choice among few."""
WAY_M = 0.04
"""Spread of the ways that markers go when they are put on again or lie elsewhere: a longer one is the less likely."""
ALIKE_M = 0.008
"""Two markers whose exchange moves neither by more are not told apart by it."""
MIRRORED = 0.5
"""Share of the offsets that may be left after a reflection."""
MOST_CAUSES = 4
NO_MOTION = (np.eye(3), np.zeros(3))


class Fault(Enum):
    """What can be wrong with a cluster."""

    MARKER = "marker"
    LABELS = "labels"
    MIRRORED = "mirrored"
    CLUSTER = "cluster"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """One cause, and what it does."""

    fault: Fault
    segment: str
    """For an unknown cause the joint at which it is seen."""
    labels: tuple[str, ...]
    offset: float
    """m: of the marker, of the largest one, or by which a cluster slid."""
    turn: float
    """rad, by which the segment's pose is wrong."""
    shift: float
    """m, by which the pose carries a joint centre away."""
    direction: Array
    """(3,) m, of the offset: forward, up, to the right."""
    excess: float
    """How many times the limits were exceeded, the worst."""
    seen_at: tuple[str, ...]
    """What exceeded its limit, in words."""


@dataclass
class Body:
    """The clusters and joints of one trial, and what was found wrong with them so far."""

    clusters: Mapping[str, Cluster]
    links: Mapping[str, JointLink]
    pose: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    """Segment -> rigid motion that puts its mean shape where it belongs, where that is not the nearest."""
    cleared: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> markers that are explained."""
    strictness: float = 1.0
    """Factor of the limits of offsets."""

    def moved(self, segment: str) -> tuple[Array, Array]:
        """The rigid motion of a segment's mean shape."""
        return self.pose.get(segment, NO_MOTION)

    def relation(self, link: JointLink) -> tuple[Array, Array]:
        """Turn (3, 3) and gap (3,) m of a joint, both segments' poses as corrected."""
        (rp, tp), (rq, tq) = self.moved(link.above), self.moved(link.below)
        at = rq.T @ (link.centre - tq)
        carried = link.rotation @ (at - link.centre) + link.carried_up
        return rp @ link.rotation @ rq.T, rp @ carried + tp - link.centre

    def seen_from(self, segment: str) -> Iterator[tuple[JointLink, Array, Array]]:
        """Joint, p (2, 3) and q (2, 3) m, the axis points of a segment's joints where its neighbours have them."""
        for link in self.links.values():
            if segment not in (link.above, link.below):
                continue
            up = segment == link.above
            reach = [0.0, 0.0, _reach(link)]
            points = np.array([link.centre + reach, link.centre - reach])
            turn, shift = self.moved(link.below if up else link.above)
            rotation, carried = (link.rotation, link.carried_up) if up else (link.rotation.T, link.carried_down)
            yield link, points, ((points - shift) @ turn - link.centre) @ rotation.T + carried

    def excesses(self) -> dict[str, float]:
        """Segment or joint -> the largest of its quantities in units of the limit, where that is above 1."""
        out = {name: value for name, c in self.clusters.items() if (value := self.offset_excess(c)) > 1.0}
        for joint, link in self.links.items():
            turn, gap = self.relation(link)
            ratios = np.abs(side_turns(turn)) / np.hypot(TURN_RAD[link.name], SCATTERED * link.turn_spread)
            value = max(float(np.linalg.norm(gap)) / gap_limit(link), float(ratios.max()))
            if value > 1.0:
                out[joint] = value
        return out

    def offset_excess(self, cluster: Cluster) -> float:
        """The largest offset of a cluster in units of the limit."""
        kept = [i for i, label in enumerate(cluster.labels) if label not in self.cleared.get(cluster.segment, ())]
        if len(kept) < FEWEST:
            return 0.0
        turn, shift = alignment(cluster.shape[kept], cluster.static[kept])
        away = np.linalg.norm(cluster.shape[kept] @ turn.T + shift - cluster.static[kept], axis=1)
        steady = away / np.hypot(cluster.scatter[kept], JITTER_M)
        limit = self.strictness * OFFSET_M[cluster.part] * (BORROWED if cluster.borrowed else 1.0)
        value = float((away / np.hypot(limit, cluster.scatter[kept])).max())
        if not cluster.borrowed and self.strictness == 1.0:
            counted = (away > STEADY_M) & (steady > STEADY_RATIO)
            value = max(value, float((away[counted] / STEADY_M).max(initial=0.0)))
        return value


def contradictions(
    clusters: Mapping[str, Cluster], links: Mapping[str, JointLink], strictness: float = 1.0
) -> tuple[Contradiction, ...]:
    """The causes found in one trial, in the order in which they explain most; `strictness`: factor of the limits."""
    body, found = Body(clusters, links, strictness=strictness), []
    for _ in range(MOST_CAUSES):
        excess = body.excesses()
        if not excess:
            break
        best = _cheapest(body, excess)
        if best is None:
            found += [_unexplained(body, joint, excess[joint]) for joint in excess if joint in links]
            break
        cause, pose, cleared = best
        found.append(cause)
        body.pose[cause.segment] = pose
        body.cleared[cause.segment] = (*body.cleared.get(cause.segment, ()), *cleared)
    return tuple(found)


_Explanation = tuple[Contradiction, tuple[Array, Array], tuple[str, ...]]


def _cheapest(body: Body, excess: Mapping[str, float]) -> _Explanation | None:
    """The explanation that saves most, if it saves anything."""
    best, most = None, 0.0
    for segment, cluster in body.clusters.items():
        joints = [link.joint for link in body.links.values() if segment in (link.above, link.below)]
        concerned = [name for name in (segment, *joints) if name in excess]
        if not concerned:
            continue
        before = _cost(body, cluster, cluster.shape, range(len(cluster.labels)))[0]
        for fault, labels, cost, pose, shape in _explanations(body, cluster):
            if before - cost > most:
                most = before - cost
                worst = max(excess[name] for name in concerned)
                best = _told(body, cluster, fault, labels, pose, shape, worst, tuple(concerned))
    return best


def _explanations(
    body: Body, cluster: Cluster
) -> Iterator[tuple[Fault, tuple[str, ...], float, tuple[Array, Array], Array]]:
    """Fault, markers, cost with its price, the pose that belongs to it, and the shape as it should have been."""
    n, own = len(cluster.labels), cluster.own
    free = [i for i in range(own) if cluster.labels[i] not in body.cleared.get(cluster.segment, ())]
    for i in free:
        cost, (turn, shift) = _cost(body, cluster, cluster.shape, [k for k in range(n) if k != i])
        way = float(np.linalg.norm(turn @ cluster.shape[i] + shift - cluster.static[i]))
        price = PRICE["marker"] + (way / WAY_M) ** 2
        yield Fault.MARKER, (cluster.labels[i],), cost + price, (turn, shift), cluster.shape
    for i, k in combinations(free, 2):
        if np.linalg.norm(cluster.static[i] - cluster.static[k]) < ALIKE_M:
            continue
        order = np.arange(n)
        order[[i, k]] = k, i
        shape = cluster.shape[order]
        cost, pose = _cost(body, cluster, shape, range(n))
        yield Fault.LABELS, (cluster.labels[i], cluster.labels[k]), cost + PRICE["labels"], pose, shape
    if not cluster.borrowed:
        shape = cluster.shape * [1.0, 1.0, -1.0]
        cost, pose = _cost(body, cluster, shape, range(n))
        yield Fault.MIRRORED, cluster.labels[:own], cost + PRICE["mirrored"], pose, shape
    if cluster.segment not in body.cleared or len(free) == own:
        inside = _cost(body, cluster, cluster.shape, range(n), joints=False)[0]
        across, pose = _cost(body, cluster, cluster.shape, ())
        yield Fault.CLUSTER, cluster.labels[:own], inside + across + PRICE["cluster"], pose, cluster.shape


def _cost(
    body: Body, cluster: Cluster, shape: Array, kept: range | list[int] | tuple[()], joints: bool = True
) -> tuple[float, tuple[Array, Array]]:
    """J without its price, and the C that makes it least."""
    taken = [i for i in kept if cluster.labels[i] not in body.cleared.get(cluster.segment, ())]
    sigma = OFFSET_M[cluster.part] / SPREAD
    points, targets = [shape[taken]], [cluster.static[taken]]
    weights = [np.full(len(taken), sigma**-2)]
    for link, p, q in body.seen_from(cluster.segment) if joints else ():
        points.append(q)
        targets.append(p)
        weights.append(np.full(2, 0.5 * (gap_limit(link) / SPREAD) ** -2))
    a, b, w = np.concatenate(points), np.concatenate(targets), np.concatenate(weights)
    if len(a) < 2:
        return 0.0, NO_MOTION
    turn, shift = alignment(a, b, w)
    return float(w @ ((a @ turn.T + shift - b) ** 2).sum(axis=1)), (turn, shift)


def gap_limit(link: JointLink) -> float:
    """m, gap of a joint of this trial that says something."""
    return float(np.hypot(GAP_M[link.name], SCATTERED * link.gap_spread))


def _reach(link: JointLink) -> float:
    """M from the joint centre to the points on its axis: there the limits of gap and turn weigh alike."""
    return GAP_M[link.name] / float(np.mean(TURN_RAD[link.name]))


def _told(
    body: Body,
    cluster: Cluster,
    fault: Fault,
    labels: tuple[str, ...],
    pose: tuple[Array, Array],
    shape: Array,
    excess: float,
    seen_at: tuple[str, ...],
) -> _Explanation:
    turn, shift = pose
    at = [cluster.labels.index(label) for label in labels]
    centres = [link.centre for link in body.links.values() if cluster.segment in (link.above, link.below)]
    moved = [turn @ c + shift - c for c in centres]
    if fault is Fault.CLUSTER:
        direction = -(turn @ cluster.static.mean(axis=0) + shift - cluster.static.mean(axis=0))
    else:
        away = cluster.shape[at] @ turn.T + shift - cluster.static[at]
        direction = away[int(np.linalg.norm(away, axis=1).argmax())]
    cause = Contradiction(
        fault=fault,
        segment=cluster.segment,
        labels=labels,
        offset=float(np.linalg.norm(direction)),
        turn=float(angle_of(turn)),
        shift=max((float(np.linalg.norm(m)) for m in moved), default=0.0),
        direction=direction,
        excess=excess,
        seen_at=seen_at,
    )
    # The reflection or the exchange is in the shape: what is left to be explained is judged without these markers.
    cleared = cluster.labels if fault in (Fault.MIRRORED, Fault.LABELS) else labels if fault is Fault.MARKER else ()
    return cause, pose, cleared


def _unexplained(body: Body, joint: str, excess: float) -> Contradiction:
    """A joint whose segments disagree for no reason that was found."""
    turn, gap = body.relation(body.links[joint])
    return Contradiction(
        fault=Fault.UNKNOWN,
        segment=joint,
        labels=(),
        offset=float(np.linalg.norm(gap)),
        turn=float(np.abs(side_turns(turn)).max()),
        shift=float(np.linalg.norm(gap)),
        direction=gap,
        excess=excess,
        seen_at=(joint,),
    )
