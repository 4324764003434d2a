"""What errors in the direction of the segments' axes make of joint angles and torques.

Landmarks on the skin say where the axes of a segment point. Let those of a segment really be turned by a small d (rad,
laboratory; constant in the segment), bodies, joint centres and hinges staying where they are. Every joint passes from
parent to child through turns k about axes a_k: its coordinates, and the joint parameters that tell where a hinge
lies. They take the turn up so that what is beyond the joint stays,

    sum_k a_k x_k = d       where the segment is the child, the three turns next to it,
    sum_k a_k x_k = -d      where it is the parent, the three turns next to it,

so that coordinates move by their x_k, and each axis by what has turned before it,

    d a_k = (e + sum_{j before k} a_j x_j) x a_k,      e = d where the segment is the parent, 0 where it is the child.

With the moment M that the joint carries, three components of which are generalised forces, its torques a_k . M move by
d a_k . M. A hinge stays where it is, and so does its torque; hips, back, pelvis and the knees' reactions do not. What
nobody knows of the place of a hinge is an error of its own (`calibration/joint_prior.py`), and so is that of a centre.

Sizes: by the landmarks that `model/segment_frames.py` makes each axis of, 1.70 m tall. Palpated landmarks scatter by 6
to 21 mm (Della Croce et al., Gait Posture 21:226-237, 2005), taken as 10 mm, 6 along each axis; hip centres of
regressions miss by 15 to 30 mm (Leardini et al., J Biomech 32:99-103, 1999; Sangeux et al., Gait Posture 34:324-328,
2011), 13 along each axis. Two ASIS 245 mm apart then turn the pelvis by 2 deg about x and y, epicondyles 112 mm apart
the thigh by 4.5 about its length. The spines of the pelvis scatter most of all, by 15 to 20 mm (Della Croce et
al., Med Biol Eng Comput 37:155-161, 1999; Rabuffetti et al., Hum Mov Sci 21:439-455, 2002), 10 along each axis. That
obliquity scatters by no more than 2 deg, 8.5 mm between both ASIS, means that both are felt alike, correlated by 0.63:
their mean errs by 9 mm, and against the sacrum, 10 mm, by 13.5 mm over 170 mm: 4.5 deg of tilt. Whole sessions repeated
by others scatter alike: mostly less than 5 deg, least in obliquity and hip adduction, most in rotations of hip and knee
(McGinley et al., Gait Posture 29:360-369, 2009).

Sources of error are independent of each other, so that variances add: the share of a source in the error bar of a
torque is its part of the variance, summed over valid frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross, stretches
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics, PlacedLinkage
from gaitcal.dynamics.joint_kinetics import KineticErrors
from gaitcal.model import linkage
from gaitcal.model.chain import chain_of
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters

PALPATED_DEG: Mapping[str, tuple[float, float, float]] = {
    row.name: row.palpated for row in linkage.SEGMENT_TABLE.values() if row.palpated
}
"""Segment -> deg, standard deviations of turns about its x, y and z axis. A talus has no landmarks, and no error."""
EXACT: Mapping[str, tuple[float, float, float]] = {}
"""Axes that are where they are by definition."""
BLOCK = 500
"""Frames at a time."""

_ORIENTATIONS = tuple(p.name for p in JOINT_PARAMETERS if p.kind is Kind.ORIENTATION)


@dataclass(frozen=True)
class _Crossing:
    """A joint, or the six coordinates of the pelvis, as turns from parent to child."""

    parent: str | None
    child: str
    turns: tuple[str, ...]
    """Coordinates, joint parameters and the locked reaction, in their order."""

    @property
    def absorbing(self) -> tuple[str, ...]:
        """Turns that may take others up."""
        return tuple(name for name in self.turns if name not in linkage.REACTIONS)

    @property
    def carried(self) -> tuple[str, ...]:
        """Three turns whose generalised forces are the joint's whole moment; empty where no torque of it moves."""
        for at, name in enumerate(self.turns):
            if name in linkage.REACTIONS:
                return self.turns[at - 1 : at + 2]
        return self.turns if set(self.turns) <= set(linkage.COORDINATES) else ()


CROSSINGS = tuple(
    _Crossing(parent, child, tuple(e.name for e in elements if e.rotates and e.source is not linkage.Source.ZERO_ANGLE))
    for parent, child, elements in (
        (None, "pelvis", linkage.root_elements("pelvis")),
        *((joint.parent, joint.child, linkage.joint_elements(joint, reactions=True)) for joint in linkage.JOINTS),
    )
)
_HELD = tuple(name for crossing in CROSSINGS for name in crossing.carried if name in JP_INDEX)
"""Joint parameters that complete a knee's moment."""


class AxisErrors:
    """Axes of all segments of one set of parameters, each wrong by its standard deviation.

    `columns`: what each column of the moves below turns, a segment about its x, y or z.
    """

    def __init__(
        self, parameters: Parameters, deviations_deg: Mapping[str, tuple[float, float, float]] = PALPATED_DEG
    ) -> None:
        """`deviations_deg`: standard deviations by segment, with or without its side, about x, y and z."""
        self._chain = chain_of(free=_ORIENTATIONS, reactions=True)
        self._constants = self._chain.constants(parameters.joint, parameters.zero_angles)
        self._dynamics = Dynamics(parameters, _HELD)
        alike = {s: deviations_deg.get(linkage.segment_kind(s).name, ()) for s in self._chain.segments}
        each = {s: deviations_deg.get(s, of_both) for s, of_both in alike.items()}
        self._deviations = {segment: np.deg2rad(turns) for segment, turns in each.items() if any(turns)}
        self.columns = tuple((segment, axis) for segment in self._deviations for axis in range(3))

    def coordinate_errors(self, q: Array) -> Array:
        """(nf, nq) m, rad: standard errors that these leave in coordinates (nf, nq)."""
        parts = [(self.coordinate_moves(q[part]) ** 2).sum(axis=2) for part in stretches(len(q), BLOCK)]
        return np.sqrt(np.concatenate(parts))

    def coordinate_moves(self, q: Array) -> Array:
        """(nf, nq, k) m, rad: one standard deviation of each turn, at coordinates (nf, nq)."""
        placed, out = self._placed(q), np.zeros((*q.shape, len(self.columns)))
        for _, _, place, _, taken in self._taken(placed):
            for name, by in taken.items():
                if name in linkage.COORDINATE_INDEX:
                    out[:, linkage.COORDINATE_INDEX[name], place] += by
        return out

    def segment_turns(self, q: Array) -> dict[str, Array]:
        """Segment -> (nf, k, 3) rad, laboratory: how far each column turns it."""
        placed = self._placed(q)
        out = {segment: np.zeros((len(q), len(self.columns), 3)) for segment in self._deviations}
        for segment, place, turns in self._turns(placed):
            out[segment][:, place] = turns
        return out

    def rate_moves(self, q: Array, time: Array) -> Array:
        """(nf, nq, k) m/s, rad/s: what they make of the rates of a motion (nf, nq) at the times (nf,) s."""
        moves = self.coordinate_moves(q)
        return np.zeros_like(moves) if len(time) < 2 else np.gradient(moves, time, axis=0)

    def torque_moves(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """(nf, nt, k) N·m, N: the same of the generalised forces, foot wrenches being (nf, 2, 6)."""
        placed, forces = self._placed(q), self._dynamics.forces(q, v, a, wrenches)
        index = {name: k for k, name in enumerate((*FORCES, *_HELD))}
        out = np.zeros((len(q), len(FORCES), len(self.columns)))
        for crossing, segment, place, turns, taken in self._taken(placed):
            if not crossing.carried:
                continue
            sides = np.stack([placed.axis(name) for name in crossing.carried], axis=1)  # (nf, 3, 3), an axis a row
            torques = forces[:, [index[name] for name in crossing.carried]]
            moment = np.linalg.solve(sides, torques[..., None])[:, None, :, 0]  # (nf, 1, 3)
            turned = turns if segment == crossing.parent else np.zeros((len(q), 3, 3))  # (nf, turn, xyz)
            for name in crossing.turns:
                axis = placed.axis(name)[:, None]
                if name in FORCES:
                    out[:, index[name], place] += (cross(turned, axis) * moment).sum(axis=2)
                if name in taken:
                    turned = turned + taken[name][:, :, None] * axis
        return out

    def _placed(self, q: Array) -> PlacedLinkage:
        return PlacedLinkage(self._chain, self._constants, q)

    def _turns(self, placed: PlacedLinkage) -> Iterator[tuple[str, slice, Array]]:
        """Segment, its three columns, and (nf, 3, 3) rad, laboratory: its turn about each of its axes, one a row."""
        for k, (segment, deviation) in enumerate(self._deviations.items()):
            yield segment, slice(3 * k, 3 * k + 3), placed.frame(segment) * deviation[:, None]

    def _taken(self, placed: PlacedLinkage) -> Iterator[tuple[_Crossing, str, slice, Array, dict[str, Array]]]:
        """Joint, a segment beside it, its columns and turns; by how much (nf, 3) the joint's turns take these up."""
        for segment, place, turns in self._turns(placed):
            for crossing in CROSSINGS:
                if segment not in (crossing.parent, crossing.child):
                    continue
                above = segment == crossing.parent
                names = crossing.absorbing[:3] if above else crossing.absorbing[-3:]
                basis = np.stack([placed.axis(name) for name in names], axis=2)
                found = np.linalg.solve(basis, (-turns if above else turns).transpose(0, 2, 1))
                yield crossing, segment, place, turns, dict(zip(names, found.transpose(1, 0, 2), strict=True))


class ErrorSource(Enum):
    """What makes the error bar of a torque. `key`: in files; `words`: on the page."""

    MOTION = ("motion", "markers and motion")
    """Noise of the trial's own markers, through its motion; with it, through joints fitted to the same markers."""
    JOINT_MARKERS = ("joint_markers", "joint parameters: markers")
    """Noise of the markers that the joint parameters were found from."""
    JOINT_NOMINAL = ("joint_nominal", "joint parameters: what is known before")
    """Nominal joint parameters, where markers do not tell."""
    SKIN = ("skin", "skin that moves with joints")
    BANDWIDTH = ("bandwidth", "bandwidth of the motion")
    POSTURE = ("posture", "segments that markers do not determine")
    INERTIA = ("inertia", "masses and inertia")
    PLATES = ("plates", "force plates")
    FRAMES = ("frames", "direction of segment axes")

    def __init__(self, key: str, words: str) -> None:
        self.key, self.words = key, words


@dataclass(frozen=True)
class TorqueErrors:
    """Standard errors of the final generalised forces."""

    tau: Array
    """(nf, nq) N·m, N."""
    knee_adduction: Array
    """(nf, 2) N·m."""
    by_source: Mapping[ErrorSource, Array] = field(default_factory=dict)
    """Source -> (nf, nt) variance of the 27 generalised forces and the two knee reactions, (N·m)^2, N^2; they sum to
    the squares of the standard errors. Empty where it is not known."""
    kinetics: KineticErrors | None = None
    """Of the powers and moment vectors that follow; None where they are not known."""

    @staticmethod
    def of(by_source: Mapping[ErrorSource, Array], kinetics: KineticErrors | None = None) -> TorqueErrors:
        """From the variances (nf, nt) of at least one source."""
        errors = np.sqrt(sum(by_source.values()))
        return TorqueErrors(errors[:, :-2], errors[:, -2:], by_source, kinetics)

    @property
    def every(self) -> Array:
        """(nf, nt) all of them."""
        return np.hstack([self.tau, self.knee_adduction])

    def only(self, coordinates: BoolArray) -> TorqueErrors:
        """The same with NaN for all but some coordinates (nq,), right and left knee's reaction with its knee angle."""
        knees = coordinates[[linkage.COORDINATE_INDEX[f"knee_angle_{side}"] for side in linkage.SIDES]]
        kept = np.concatenate([coordinates, knees])
        by_source = {source: np.where(kept, variance, np.nan) for source, variance in self.by_source.items()}
        return TorqueErrors(
            np.where(coordinates, self.tau, np.nan),
            np.where(knees, self.knee_adduction, np.nan),
            by_source,
            None if self.kinetics is None else self.kinetics.only(coordinates),
        )

    def shares(self, column: int, valid: BoolArray) -> dict[ErrorSource, float]:
        """Source -> its part of the variance of one of the 29 torques over valid frames, largest first.

        They sum to 1; empty where there is no variance.
        """
        parts = {source: float(variance[valid, column].sum()) for source, variance in self.by_source.items()}
        total = sum(parts.values())
        if not total > 0.0:
            return {}
        return {source: parts[source] / total for source in sorted(parts, key=lambda s: -parts[s]) if parts[source] > 0}
