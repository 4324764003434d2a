"""The clusters and joints of one trial as one body, and by how much each quantity exceeds what clean recordings show.

The quantities: the offsets of a cluster, the gap and the turns of a joint near the static posture. A segment whose pose
is wrong for a reason that was found gets a rigid motion C that puts it right, and all quantities are read with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.faults.cluster import FEWEST, Cluster, alignment
from gaitcal.faults.joint_link import JointLink, side_turns

OFFSET_M: Mapping[str, float] = {"pelvis": 0.008, "thigh": 0.010, "shank": 0.008, "foot": 0.008}
"""Largest offset of a cluster. 91 clean trials of 20 people (10 of them synthetic, with noise) reach
5.4, 6.4, 5.2 and 6.1 mm."""
STEADY_M, STEADY_RATIO, JITTER_M = 0.007, 4.0, 0.0015
"""A smaller offset counts where it is so many times its own scatter in time, which is at least JITTER."""
REDUCED = 1.6
"""Factor of the offset where a cluster of a large set borrows from the segment above, whose skin moves otherwise; sets
that always borrow stay within the limits without it."""
GAP_M: Mapping[str, float] = {"hip": 0.035, "knee": 0.028, "ankle": 0.016}
"""Gap of a joint. Clean recordings reach 27, 25 and 13 mm, noise that scatters apart."""
TURN_RAD: Mapping[str, tuple[float, float]] = {
    name: (float(np.deg2rad(ab)), float(np.deg2rad(axial)))
    for name, (ab, axial) in {"hip": (15.0, 18.0), "knee": (12.0, 15.0), "ankle": (20.0, 18.0)}.items()
}
"""Ab/adduction and axial turn of a joint against the static posture. Clean recordings reach 11 and 13, 6 and 15, 16
and 15 deg."""
SCATTERED = 2.0
"""Standard deviations, as markers scatter within the trial, that widen the limits of gap and turn: a small cluster far
from the joint tells little of it."""
GAP_PER_RAD, TURN_PER_RAD = 0.10, 1.0
"""m and rad that widen them for each rad by which the trial stays away from the static posture. Parts of clean trials
in which a thigh stays flexed reach gaps of 43 mm at 20 deg, feet that stay inverted turns of 30 deg at 35 deg."""
KNEE_TURN_FROM = float(np.deg2rad(10.0))
"""rad, from where on those of the knee, a hinge whose turns stay small, widen."""
SPREAD = 3.0
"""A limit is taken as so many standard deviations."""
NO_MOTION = (np.eye(3), np.zeros(3))


def gap_limit(link: JointLink) -> float:
    """m, gap of a joint of this trial that says something."""
    return float(np.hypot(_gap_base(link), SCATTERED * link.gap_spread))


def turn_limits(link: JointLink) -> Array:
    """(2,) rad, ab/adduction and axial turn of a joint of this trial that say something."""
    out: Array = np.hypot(_turn_base(link), SCATTERED * link.turn_spread)
    return out


def reach(link: JointLink) -> float:
    """M from the joint centre to the points on its axis: there the limits of gap and turn weigh alike."""
    return _gap_base(link) / float(np.mean(_turn_base(link)))


def _gap_base(link: JointLink) -> float:
    return link.size * float(np.hypot(GAP_M[link.name], GAP_PER_RAD * link.far))


def _turn_base(link: JointLink) -> Array:
    far = max(0.0, link.far - KNEE_TURN_FROM) if link.name == "knee" else link.far
    out: Array = np.hypot(TURN_RAD[link.name], TURN_PER_RAD * far)
    return out


def offset_limit(cluster: Cluster) -> float:
    """m, largest offset of a marker of the cluster, in a person of its size."""
    return cluster.size * OFFSET_M[cluster.part] * (REDUCED if cluster.reduced else 1.0)


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

    def forget(self, segment: str, labels: tuple[str, ...], pose_lost: bool) -> None:
        """Leave out what rests on a segment that was found wrong: clusters that borrow of it, and the joints of these;
        with `pose_lost` its own joints too.
        """
        lost = {
            name
            for name, c in self.clusters.items()
            if c.borrowed
            and name != segment
            and (c.labels[-1] in labels or (segment == "pelvis" and c.part == "thigh"))
        }
        self.clusters = {name: c for name, c in self.clusters.items() if name not in lost}
        gone = lost | {segment} if pose_lost else lost
        self.links = {j: k for j, k in self.links.items() if gone.isdisjoint((k.above, k.below))}

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
            aside = [0.0, 0.0, reach(link)]
            points = np.array([link.centre + aside, link.centre - aside])
            turn, shift = self.moved(link.below if up else link.above)
            rotation, carried = (link.rotation, link.carried_up) if up else (link.rotation.T, link.carried_down)
            yield link, points, ((points - shift) @ turn - link.centre) @ rotation.T + carried

    def excesses(self) -> dict[str, float]:
        """Segment or joint -> the largest of its quantities in units of the limit, where that is above 1."""
        out = {name: value for name, c in self.clusters.items() if (value := self.offset_excess(c)) > 1.0}
        for joint, link in self.links.items():
            turn, gap = self.relation(link)
            ratios = np.abs(side_turns(turn)) / turn_limits(link)
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
        limit = self.strictness * offset_limit(cluster)
        value = float((away / np.hypot(limit, cluster.scatter[kept])).max())
        if not cluster.reduced and self.strictness == 1.0:
            least = cluster.size * STEADY_M
            counted = (away > least) & (steady > STEADY_RATIO)
            value = max(value, float((away[counted] / least).max(initial=0.0)))
        return value
