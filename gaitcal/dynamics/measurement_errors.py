"""Errors of what is measured, and what they make of torques: directions of the segments' axes, and
force plates.

Axes. Landmarks on the skin say where the axes of a segment point. Let those of a segment really be
turned by a small d (rad, laboratory; constant in the segment), bodies, joint centres and hinges
staying where they are. Every joint passes from parent to child through turns k about axes a_k: its
coordinates, and the joint parameters that tell where a hinge lies. They take the turn up so that
what is beyond the joint stays,

    sum_k a_k x_k = d       where the segment is the child, the three turns next to it,
    sum_k a_k x_k = -d      where it is the parent, the three turns next to it,

so that coordinates move by their x_k, and each axis by what has turned before it,

    d a_k = (e + sum_{j before k} a_j x_j) x a_k,      e = d where the segment is the parent, 0 where it is the child.

With the moment M that the joint carries, three components of which are generalised forces, its
torques a_k . M move by d a_k . M. A hinge stays where it is, and so does its torque; hips, back,
pelvis and the knees' reactions do not. What nobody knows of the place of a hinge is an error of its
own (`calibration/joint_prior.py`), and so is that of a centre.

Sizes: by the landmarks that `model/segment_frames.py` makes each axis of, 1.70 m tall. Palpated
landmarks scatter by 6 to 21 mm (Della Croce et al., Gait Posture 21:226-237, 2005), taken as 10 mm,
6 along each axis; hip centres of regressions miss by 15 to 30 mm (Leardini et al., J Biomech
32:99-103, 1999; Sangeux et al., Gait Posture 34:324-328, 2011), 13 along each axis. Two ASIS 245 mm
apart then turn the pelvis by 2 deg about x and y, epicondyles 112 mm apart the thigh by 4.5 about
its length. The spines of the pelvis scatter most of all, by 15 to 20 mm (Della Croce et al., Med
Biol Eng Comput 37:155-161, 1999; Rabuffetti et al., Hum Mov Sci 21:439-455, 2002), 10 along each
axis. That obliquity scatters by no more than 2 deg, 8.5 mm between both ASIS, means that both are
felt alike, correlated by 0.63: their mean errs by 9 mm, and against the sacrum, 10 mm, by 13.5 mm
over 170 mm: 4.5 deg of tilt. Whole sessions repeated by others scatter alike: mostly less than 5
deg, least in obliquity and hip adduction, most in rotations of hip and knee (McGinley et al., Gait
Posture 29:360-369, 2009).

Sources of error are independent of each other, so that variances add: the share of a source in the
error bar of a torque is its part of the variance, summed over valid frames.

Plates: place, turn, gain and clock. The wrench w = [F; M] of the ground on a foot, M about the
laboratory origin, is wrong by

    gain    g      d w = g w
    place   d      d w = [0; d x F]                the plate lies elsewhere by d; so does every centre of pressure
    turn    a      d w = a [y x F; c x (y x F)]    about the vertical y through the centre of pressure c on the floor:
                                                   what a turn about the plate's middle adds to that
                                                   is place
    clock   s      d w = s dw/dt                   all plates together: they share one converter

Linear in w as generalised forces are, they become  d tau = -J_foot^T d w  (`Dynamics.of_ground`). Each foot stands on a
plate of its own, errors of plates being independent.

Sizes are what spot checks of laboratories find where nobody has calibrated the plates in place. The
centre of pressure on the plate: 2.3, 2.6, 11.8 and 14.0 mm off on average on four commercial plates
(Cappello et al., Gait & Posture 33:724, 2011), 9.7 mm RMS, that is 6.9 mm along each axis; 3.5 and
6.3 mm on average along the short and the long side of three piezoelectric plates, 20 mm at most
(Bobbert and Schamhardt, J Biomech 23:705, 1990), 6.4 mm RMS along each axis; up to 30 mm elsewhere
(Schmiedmayer and Kastner, J Biomech 32:1237, 1999). The plate in the room: 5 to 10 mm are reckoned
with (McCaw and DeVita, J Biomech 28:985, 1995), 5 mm along each axis. Together 8 mm. Calibrated
where they stood: 0.5 to 2.3 mm on the first four plates, less than 4 mm in four laboratories (Gait
& Posture 2016, doi 10.1016/j.gaitpost.2016.08.017). Two corners 0.5 m apart, each known to 5 mm
along each axis, tell the turn to 0.8 deg, taken as 1. The same four plates' forces were 3 to 5 N
wrong, up to 1 % of a person's weight. The clock has no such source: 2 ms is a fifth of a frame at
100 Hz.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross, stretches
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.dynamics.joint_kinetics import ALL_FORCES, KineticErrors
from gaitcal.io.force_plate import LOADED_N, OUTSIDE_M, UP, compute_centre_on_ground
from gaitcal.io.recording import ForcePlate
from gaitcal.model import chain, linkage
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.parameters import JOINT_PARAMETERS, ParameterKind, Parameters
from gaitcal.study.settings import PlateErrorTable

PALPATED_DEG: Mapping[str, tuple[float, float, float]] = {
    row.name: row.palpated for row in linkage.SEGMENT_TABLE.values() if row.palpated
}
"""Segment -> deg, standard deviations of turns about its x, y and z axis. A talus has no landmarks,
and no error.
"""
EXACT: Mapping[str, tuple[float, float, float]] = {}  # Axes that are where they are by definition
BLOCK = 500  # Frames at a time

_ORIENTATIONS = tuple(p.name for p in JOINT_PARAMETERS if p.kind is ParameterKind.ORIENTATION)


@dataclass(frozen=True)
class _Crossing:
    """A joint, or the six coordinates of the pelvis, as turns from parent to child."""

    parent: str | None
    child: str
    turns: tuple[str, ...]  # Coordinates, joint parameters and the locked reaction, in their order

    @property
    def absorbing(self) -> tuple[str, ...]:
        """Turns that may take others up."""
        return tuple(name for name in self.turns if name not in linkage.REACTIONS)

    @property
    def carried(self) -> tuple[str, ...]:
        """Three turns whose generalised forces are the joint's whole moment; empty where no torque
        of it moves.
        """
        for at, name in enumerate(self.turns):
            if name in linkage.REACTIONS:
                return self.turns[at - 1 : at + 2]
        return self.turns if set(self.turns) <= set(linkage.COORDINATES) else ()


CROSSINGS = tuple(
    _Crossing(
        parent,
        child,
        tuple(e.name for e in elements if e.rotates and e.source is not linkage.Source.ZERO_ANGLE),
    )
    for parent, child, elements in (
        (None, "pelvis", linkage.root_elements("pelvis")),
        *(
            (joint.parent, joint.child, linkage.joint_elements(joint, reactions=True))
            for joint in linkage.JOINTS
        ),
    )
)


class AxisErrors:
    """Axes of all segments of one set of parameters, each wrong by its standard deviation.

    `columns`: what each column of the moves below turns, a segment about its x, y or z.
    """

    def __init__(
        self,
        parameters: Parameters,
        deviations_deg: Mapping[str, tuple[float, float, float]] = PALPATED_DEG,
    ) -> None:
        """`deviations_deg`: standard deviations by segment, with or without its side, about x, y
        and z.
        """
        self._body = chain.chain_of(free=_ORIENTATIONS, reactions=True).body(parameters)
        alike = {
            s: deviations_deg.get(linkage.segment_kind(s).name, ())
            for s in self._body.chain.segments
        }
        each = {s: deviations_deg.get(s, of_both) for s, of_both in alike.items()}
        self._deviations = {
            segment: np.deg2rad(turns) for segment, turns in each.items() if any(turns)
        }
        self.columns = tuple((segment, axis) for segment in self._deviations for axis in range(3))

    def coordinate_errors(self, q: Array) -> Array:
        """(nf, nq) m, rad: standard errors that these leave in coordinates (nf, nq)."""
        parts = [
            (self.coordinate_moves(q[part]) ** 2).sum(axis=2) for part in stretches(len(q), BLOCK)
        ]
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
        """(nf, nq, k) m/s, rad/s: what they make of the rates of a motion (nf, nq) at the times
        (nf,) s.
        """
        moves = self.coordinate_moves(q)
        return np.zeros_like(moves) if len(time) < 2 else np.gradient(moves, time, axis=0)

    def torque_moves(self, q: Array, forces: Array) -> Array:
        """(nf, nt, k) N·m, N: the same of the generalised forces, which are (nf, 35), in the order
        of `ALL_FORCES`.
        """
        placed, index = self._placed(q), {name: k for k, name in enumerate(ALL_FORCES)}
        out = np.zeros((len(q), len(FORCES), len(self.columns)))
        for crossing, segment, place, turns, taken in self._taken(placed):
            if not crossing.carried:
                continue
            sides = np.stack(
                [placed.axis(name) for name in crossing.carried], axis=1
            )  # (nf, 3, 3), an axis a row
            torques = forces[:, [index[name] for name in crossing.carried]]
            moment = np.linalg.solve(sides, torques[..., None])[:, None, :, 0]  # (nf, 1, 3)
            turned = (
                turns if segment == crossing.parent else np.zeros((len(q), 3, 3))
            )  # (nf, turn, xyz)
            for name in crossing.turns:
                axis = placed.axis(name)[:, None]
                if name in FORCES:
                    out[:, index[name], place] += (cross(turned, axis) * moment).sum(axis=2)
                if name in taken:
                    turned = turned + taken[name][:, :, None] * axis
        return out

    def _placed(self, q: Array) -> Kinematics:
        return Kinematics(self._body, q)

    def _turns(self, placed: Kinematics) -> Iterator[tuple[str, slice, Array]]:
        """Segment, its three columns, and (nf, 3, 3) rad, laboratory: its turn about each of its
        axes, one a row.
        """
        for k, (segment, deviation) in enumerate(self._deviations.items()):
            yield segment, slice(3 * k, 3 * k + 3), placed.frame(segment) * deviation[:, None]

    def _taken(
        self, placed: Kinematics
    ) -> Iterator[tuple[_Crossing, str, slice, Array, dict[str, Array]]]:
        """Joint, a segment beside it, its columns and turns; by how much (nf, 3) the joint's turns
        take these up.
        """
        for segment, place, turns in self._turns(placed):
            for crossing in CROSSINGS:
                if segment not in (crossing.parent, crossing.child):
                    continue
                above = segment == crossing.parent
                names = crossing.absorbing[:3] if above else crossing.absorbing[-3:]
                basis = np.stack([placed.axis(name) for name in names], axis=2)
                found = np.linalg.solve(basis, (-turns if above else turns).transpose(0, 2, 1))
                yield (
                    crossing,
                    segment,
                    place,
                    turns,
                    dict(zip(names, found.transpose(1, 0, 2), strict=True)),
                )


class ErrorSource(Enum):
    """What makes the error bar of a torque. `key`: in files; `words`: on the page."""

    MOTION = ("motion", "markers and motion")
    """Noise of the trial's own markers, through its motion; with it, through joints fitted to the
    same markers.
    """
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
    """Source -> (nf, nt) variance of the 27 generalised forces and the two knee reactions, (N·m)^2,
    N^2; they sum to the squares of the standard errors. Empty where it is not known."""
    kinetics: KineticErrors | None = None
    """Of the powers and moment vectors that follow; None where they are not known."""

    @staticmethod
    def of(
        by_source: Mapping[ErrorSource, Array], kinetics: KineticErrors | None = None
    ) -> "TorqueErrors":
        """From the variances (nf, nt) of at least one source."""
        errors = np.sqrt(sum(by_source.values()))
        return TorqueErrors(errors[:, :-2], errors[:, -2:], by_source, kinetics)

    @property
    def every(self) -> Array:
        """(nf, nt) all of them."""
        return np.hstack([self.tau, self.knee_adduction])

    def only(self, coordinates: BoolArray) -> "TorqueErrors":
        """The same with NaN for all but some coordinates (nq,), right and left knee's reaction with
        its knee angle.
        """
        knees = coordinates[
            [linkage.COORDINATE_INDEX[f"knee_angle_{side}"] for side in linkage.SIDES]
        ]
        kept = np.concatenate([coordinates, knees])
        by_source = {
            source: np.where(kept, variance, np.nan) for source, variance in self.by_source.items()
        }
        return TorqueErrors(
            np.where(coordinates, self.tau, np.nan),
            np.where(knees, self.knee_adduction, np.nan),
            by_source,
            None if self.kinetics is None else self.kinetics.only(coordinates),
        )

    def shares(self, column: int, valid: BoolArray) -> dict[ErrorSource, float]:
        """Source -> its part of the variance of one of the 29 torques over valid frames, largest
        first.

        They sum to 1; empty where there is no variance.
        """
        parts = {
            source: float(variance[valid, column].sum())
            for source, variance in self.by_source.items()
        }
        total = sum(parts.values())
        if not total > 0.0:
            return {}
        return {
            source: parts[source] / total
            for source in sorted(parts, key=lambda s: -parts[s])
            if parts[source] > 0
        }


OF_A_PLATE = ("gain", "x", "y", "z", "turn")
"""Errors of either foot's plate, in the order of the columns of `wrench_errors`."""
FOOT_LENGTH = 0.152
"""Of body height (Winter 2009): the tip of the foot lies this far before the heel marker, or at the
toe marker.
"""
OUTSIDE_SHARE = 0.1
"""Of the load, with its centre of pressure outside the corners, above which the corners are not
believed.
"""


@dataclass(frozen=True, kw_only=True)
class PlateErrors:
    """Standard deviations of what force plates say."""

    place: float  # m, of a plate's place along each axis
    gain: float  # Of 1
    clock: float  # s, plates against cameras
    turn: float = 0.0  # rad, of a plate about the vertical

    @staticmethod
    def of(table: PlateErrorTable) -> "PlateErrors":
        """From `calibration.plate_error`."""
        return PlateErrors(
            place=1e-3 * table.place_mm,
            gain=1e-2 * table.gain_percent,
            turn=float(np.deg2rad(table.turn_deg)),
            clock=1e-3 * table.clock_ms,
        )

    def beside(self, more: "PlateErrors | None") -> "PlateErrors":
        """With independent errors besides; exact plates stay exact."""
        if more is None or not self.any:
            return self
        both = {
            f.name: float(np.hypot(getattr(self, f.name), getattr(more, f.name)))
            for f in fields(self)
        }
        return PlateErrors(**both)

    @property
    def any(self) -> bool:
        """Whether some error is not zero."""
        return bool(self.place or self.gain or self.turn or self.clock)


DEFAULT = PlateErrors.of(PlateErrorTable())


def wrench_rates(time: Array, wrenches: Array) -> Array:
    """(nf, 2, 6) per s, how foot wrenches (nf, 2, 6) change at the frames (nf,) s."""
    return np.zeros_like(wrenches) if len(time) < 2 else np.gradient(wrenches, time, axis=0)


def wrench_errors(wrenches: Array, rates: Array, errors: PlateErrors) -> Array:
    """(nf, 2, 6, 11) one standard deviation of each source: `OF_A_PLATE` of either foot's, then the
    clock.

    `rates`: of the foot wrenches (nf, 2, 6), from `wrench_rates` of the whole trial.
    """
    feet, each = wrenches.shape[1], len(OF_A_PLATE)
    out = np.zeros((*wrenches.shape, each * feet + 1))
    for foot in range(feet):
        wrench, first = wrenches[:, foot], each * foot
        out[:, foot, :, first] = errors.gain * wrench
        for k, axis in enumerate(np.eye(3)):
            out[:, foot, 3:, first + 1 + k] = errors.place * np.cross(axis, wrench[:, :3])
        on = (
            wrench[:, 1] > LOADED_N
        )  # where a foot hardly presses there is no centre of pressure to turn about
        turned = cross(UP, wrench[on, :3])
        about = cross(compute_centre_on_ground(wrench[on], 0.0), turned)
        out[on, foot, :, first + 4] = errors.turn * np.hstack([turned, about])
    out[..., -1] = errors.clock * rates
    return out


def foot_tip(heel: Array, toe: Array, height: float) -> Array:
    """(..., 3) m, the tip of the foot of a person of this height (m), on the line from heel to toe
    marker (..., 3).
    """
    along = toe - heel
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    return heel + along / length * np.maximum(length, FOOT_LENGTH * height)


def inside(corners: Array, point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie inside the horizontal outline of corners (4, 3); negative
    outside.
    """
    outline = corners[:, [0, 2]]
    middle = outline.mean(axis=0)
    nearest = np.full(len(point), np.inf)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        normal = np.array([-along[1], along[0]])
        if normal @ (middle - a) < 0:
            normal = -normal
        nearest = np.minimum(nearest, (point[:, [0, 2]] - a) @ normal)
    return nearest


def share_outside(plate: ForcePlate, corners: Array, load: float) -> tuple[float, float]:
    """Share of the load (where over `load` N) whose centre of pressure is outside the corners;
    farthest, m.
    """
    pressed = np.nan_to_num(plate.force[:, 1]) > load
    if not pressed.any():
        return 0.0, 0.0
    away = -inside(corners, plate.point[pressed])
    return float(np.average(away > OUTSIDE_M, weights=plate.force[pressed, 1])), float(away.max())


def outline_known(plate: ForcePlate, load: float) -> bool:
    """Whether a plate has corners, and its own centre of pressure keeps to them."""
    return (
        plate.corners is not None and share_outside(plate, plate.corners, load)[0] <= OUTSIDE_SHARE
    )


def outside(plates: Sequence[ForcePlate], point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie outside every one of these plates; not positive on one of
    them.
    """
    depths = [inside(plate.corners, point) for plate in plates if plate.corners is not None]
    return -np.max(depths, axis=0)
