"""Errors of measurements and their effect on torques: directions of segment axes, and force plates.

Axes. Palpated landmarks give the directions of the axes of a segment. Let the true axes be rotated
by a small d (rad, laboratory; constant in the segment), while bodies, joint centres and hinges keep
their positions. Every joint passes from parent to child through rotations k about axes a_k: its
coordinates, and the orientation parameters of a hinge. They compensate d, so that the segments
beyond the joint keep their poses,

    sum_k a_k x_k = d       where the segment is the child, the three rotations next to it,
    sum_k a_k x_k = -d      where it is the parent, the three rotations next to it.

Coordinates change by their x_k, and each axis by the rotations before it,

    d a_k = (e + sum_{j before k} a_j x_j) x a_k,
    e = d where the segment is the parent, 0 where it is the child.

With the moment M of the joint, three components of which are generalised forces, its torques
a_k . M change by d a_k . M. A hinge keeps its position, and so does its torque; hips, back, pelvis
and the reactions of the knees change. Errors of hinges and centres are separate sources
(`calibration/joint_prior.py`).

`PALPATED_DEG` has the sizes and their sources.

Sources of error are independent, so that variances add. The share of a source in the error of a
torque is its part of the variance, summed over valid frames.

Plates: position, rotation, gain and time offset. The wrench w = [F; M] of the ground on a foot, M
about the laboratory origin, has the errors

    gain         g      d w = g w
    position     d      d w = [0; d x F]              every centre of pressure moves with the plate
    rotation     a      d w = a [y x F; c x (y x F)]  about the vertical y through the centre of
                                                      pressure c on the floor
    time offset  s      d w = s dw/dt                 all plates together, on one converter

(A rotation about the middle of a plate differs from that about c by an error of position.)

Linear in w, they become  d tau = -J_foot^T d w  (`Dynamics.compute_ground_forces`). Each
foot has a separate plate, and errors of plates are independent.

`DEFAULT` has the sizes and their sources.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross, stretches
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.dynamics.joint_kinetics import ALL_FORCES, KineticErrors
from gaitcal.io.force_plate import LOADED_N, UP, compute_centre_on_ground
from gaitcal.model import chain, linkage
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.parameters import JOINT_PARAMETERS, ParameterKind, Parameters
from gaitcal.study.settings import PlateErrorTable

PALPATED_DEG: Mapping[str, tuple[float, float, float]] = {
    row.name: row.palpated for row in linkage.SEGMENT_TABLE.values() if row.palpated
}
"""Segment -> deg, standard deviations of rotations about its x, y and z axis. A talus has no
landmarks, and no error.

Sizes follow from the landmarks that `model/segment_frames.py` makes each axis of, at 1.70 m height.
Palpated landmarks scatter by 6 to 21 mm (Della Croce et al., Gait Posture 21:226-237, 2005), taken
as 10 mm, 6 along each axis. Hip centres of regressions are off by 15 to 30 mm (Leardini et al., J
Biomech 32:99-103, 1999; Sangeux et al., Gait Posture 34:324-328, 2011), 13 along each axis. Two
ASIS 245 mm apart then rotate the pelvis by 2 deg about x and y, epicondyles 112 mm apart the thigh
by 4.5 deg about its length. Pelvic spines scatter by 15 to 20 mm (Della Croce et al., Med Biol Eng
Comput 37:155-161, 1999; Rabuffetti et al., Hum Mov Sci 21:439-455, 2002), 10 along each axis.
Obliquity scatters by no more than 2 deg, 8.5 mm between both ASIS: their errors are correlated by
0.63. The mean of both is off by 9 mm, and against the sacrum, 10 mm, by 13.5 mm over 170 mm: 4.5
deg of tilt. Repeated sessions scatter alike: mostly less than 5 deg, least in obliquity and hip
adduction, most in rotations of hip and knee (McGinley et al., Gait Posture 29:360-369, 2009).
"""
EXACT_AXES: Mapping[str, tuple[float, float, float]] = {}
"""No errors: axes are correct by definition."""
BLOCK = 500
"""Frames in one block, to bound memory."""

_ORIENTATIONS = tuple(p.name for p in JOINT_PARAMETERS if p.kind is ParameterKind.ORIENTATION)


@dataclass(frozen=True)
class _JointRotations:
    """A joint, or the six coordinates of the pelvis, as rotations from parent to child."""

    parent: str | None
    child: str
    rotations: tuple[str, ...]
    """Coordinates, joint parameters and the locked reaction, in their order."""

    @property
    def compensating(self) -> tuple[str, ...]:
        """Rotations that may compensate others."""
        return tuple(name for name in self.rotations if name not in linkage.REACTIONS)

    @property
    def moment_axes(self) -> tuple[str, ...]:
        """Three rotations whose generalised forces are the whole moment of the joint.

        Empty where none of its torques changes.
        """
        for at, name in enumerate(self.rotations):
            if name in linkage.REACTIONS:
                return self.rotations[at - 1 : at + 2]
        return self.rotations if set(self.rotations) <= set(linkage.COORDINATES) else ()


def _list_rotations(elements: Iterable[linkage.Element]) -> tuple[str, ...]:
    """List the rotations among the elements of a joint that may change."""
    zero = linkage.Source.ZERO_ANGLE
    return tuple(e.name for e in elements if e.rotates and e.source is not zero)


def _list_joint_rotations() -> tuple[_JointRotations, ...]:
    """List the pelvis and all joints."""
    out = [_JointRotations(None, "pelvis", _list_rotations(linkage.make_root_elements("pelvis")))]
    for joint in linkage.JOINTS:
        elements = linkage.list_joint_elements(joint, reactions=True)
        out.append(_JointRotations(joint.parent, joint.child, _list_rotations(elements)))
    return tuple(out)


JOINT_ROTATIONS = _list_joint_rotations()


class AxisErrors:
    """Errors of the segment axes of one set of parameters, one standard deviation each.

    `columns`: segment and axis (0, 1, 2 for x, y, z) of each column of the sensitivities below.
    """

    def __init__(
        self,
        parameters: Parameters,
        deviations_deg: Mapping[str, tuple[float, float, float]] = PALPATED_DEG,
    ) -> None:
        """`deviations_deg`: standard deviations by segment, with or without its side, about x, y
        and z.
        """
        self._body = chain.get_chain(free=_ORIENTATIONS, reactions=True).body(parameters)
        alike = {
            s: deviations_deg.get(linkage.get_segment(s).name, ())
            for s in self._body.chain.segments
        }
        # A segment's deviations, or those of both sides.
        each = {s: deviations_deg.get(s, both_sides) for s, both_sides in alike.items()}
        self._deviations = {
            segment: np.deg2rad(angles) for segment, angles in each.items() if any(angles)
        }
        self.columns = tuple((segment, axis) for segment in self._deviations for axis in range(3))

    def compute_coordinate_errors(self, q: Array) -> Array:
        """Compute the standard errors of coordinates by the directions of the axes.

        Parameters
        ----------
        q
            (nf, nq) coordinates, m and rad.

        Returns
        -------
        (nf, nq) array
            m, rad.
        """
        parts = [
            (self.compute_coordinate_sensitivities(q[part]) ** 2).sum(axis=2)
            for part in stretches(len(q), BLOCK)
        ]
        return np.sqrt(np.concatenate(parts))

    def compute_coordinate_sensitivities(self, q: Array) -> Array:
        """Compute the changes of coordinates by one standard deviation of each rotation.

        `q`: (nf, nq) coordinates, m and rad. Returns: (nf, nq, k) m, rad.
        """
        placed, out = self._place(q), np.zeros((*q.shape, len(self.columns)))
        for _, _, columns, _, compensation in self._iterate_compensations(placed):
            for name, by in compensation.items():
                if name in linkage.COORDINATE_INDEX:
                    out[:, linkage.COORDINATE_INDEX[name], columns] += by
        return out

    def compute_segment_rotations(self, q: Array) -> dict[str, Array]:
        """Compute the rotation of each segment by each column.

        Parameters
        ----------
        q
            (nf, nq) coordinates, m and rad.

        Returns
        -------
        dict
            Segment -> (nf, k, 3) rad, laboratory axes.
        """
        placed = self._place(q)
        out = {segment: np.zeros((len(q), len(self.columns), 3)) for segment in self._deviations}
        for segment, columns, rotations in self._iterate_rotations(placed):
            out[segment][:, columns] = rotations
        return out

    def compute_rate_sensitivities(self, q: Array, time: Array) -> Array:
        """Compute the changes of the rates of a motion.

        Parameters
        ----------
        q
            (nf, nq) coordinates, m and rad.
        time
            (nf,) s.

        Returns
        -------
        (nf, nq, k) array
            m/s, rad/s.
        """
        changes = self.compute_coordinate_sensitivities(q)
        return np.zeros_like(changes) if len(time) < 2 else np.gradient(changes, time, axis=0)

    def compute_torque_sensitivities(self, q: Array, forces: Array) -> Array:
        """Compute the changes of the generalised forces.

        Parameters
        ----------
        q
            (nf, nq) coordinates, m and rad.
        forces
            (nf, 35) in the order of `ALL_FORCES`.

        Returns
        -------
        (nf, nt, k) array
            N·m, N.
        """
        placed, index = self._place(q), {name: k for k, name in enumerate(ALL_FORCES)}
        out = np.zeros((len(q), len(FORCES), len(self.columns)))
        for joint, segment, columns, rotations, compensation in self._iterate_compensations(placed):
            if not joint.moment_axes:
                continue
            # Moment of the joint from three of its torques; axes: (nf, 3, 3), one in each row.
            axes = np.stack([placed.axis(name) for name in joint.moment_axes], axis=1)
            torques = forces[:, [index[name] for name in joint.moment_axes]]
            # (nf, 1, 3)
            moment = np.linalg.solve(axes, torques[..., None])[:, None, :, 0]
            # Rotation (nf, error, xyz) accumulated from parent to child: it moves each axis a_k.
            accumulated = rotations if segment == joint.parent else np.zeros((len(q), 3, 3))
            for name in joint.rotations:
                axis = placed.axis(name)[:, None]
                if name in FORCES:
                    out[:, index[name], columns] += (cross(accumulated, axis) * moment).sum(axis=2)
                if name in compensation:
                    accumulated = accumulated + compensation[name][:, :, None] * axis
        return out

    def _place(self, q: Array) -> Kinematics:
        return Kinematics(self._body, q)

    def _iterate_rotations(self, placed: Kinematics) -> Iterator[tuple[str, slice, Array]]:
        """Iterate over segments: name, columns, and (nf, 3, 3) rad, a rotation in each row."""
        for k, (segment, deviation) in enumerate(self._deviations.items()):
            yield segment, slice(3 * k, 3 * k + 3), placed.frame(segment) * deviation[:, None]

    def _iterate_compensations(
        self, placed: Kinematics
    ) -> Iterator[tuple[_JointRotations, str, slice, Array, dict[str, Array]]]:
        """Iterate over joints beside a segment with errors.

        Yields joint, segment, its columns and rotations, and (nf, 3) rad by which each rotation of
        the joint compensates them.
        """
        for segment, columns, rotations in self._iterate_rotations(placed):
            for joint in JOINT_ROTATIONS:
                if segment not in (joint.parent, joint.child):
                    continue
                # The three rotations next to the segment compensate, see the equations above.
                above = segment == joint.parent
                names = joint.compensating[:3] if above else joint.compensating[-3:]
                basis = np.stack([placed.axis(name) for name in names], axis=2)
                found = np.linalg.solve(
                    basis, (-rotations if above else rotations).transpose(0, 2, 1)
                )
                yield (
                    joint,
                    segment,
                    columns,
                    rotations,
                    dict(zip(names, found.transpose(1, 0, 2), strict=True)),
                )


class ErrorSource(Enum):
    """Source of the error of a torque. `key`: in files; `label`: on the page."""

    MOTION = ("motion", "markers and motion")
    """Noise of the markers of this trial, through its motion and joints fitted to the same markers.
    """
    JOINT_MARKERS = ("joint_markers", "joint parameters: markers")
    """Noise of the markers that the joint parameters were found from."""
    JOINT_NOMINAL = ("joint_nominal", "joint parameters: what is known before")
    """Nominal joint parameters, where markers do not determine them."""
    SKIN = ("skin", "skin that moves with joints")
    BANDWIDTH = ("bandwidth", "bandwidth of the motion")
    POSTURE = ("posture", "segments that markers do not determine")
    INERTIA = ("inertia", "masses and inertia")
    PLATES = ("plates", "force plates")
    FRAMES = ("frames", "direction of segment axes")

    def __init__(self, key: str, label: str) -> None:
        self.key, self.label = key, label


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
    def from_sources(
        by_source: Mapping[ErrorSource, Array], kinetics: KineticErrors | None = None
    ) -> "TorqueErrors":
        """Sum the variances of independent sources.

        Parameters
        ----------
        by_source
            Source -> (nf, nt) variance, (N·m)^2 and N^2; at least one source.
        kinetics
            Errors of powers and moment vectors.

        Returns
        -------
        TorqueErrors
        """
        errors = np.sqrt(sum(by_source.values()))
        return TorqueErrors(errors[:, :-2], errors[:, -2:], by_source, kinetics)

    @property
    def all_forces(self) -> Array:
        """(nf, nt) standard errors of all generalised forces and knee reactions."""
        return np.hstack([self.tau, self.knee_adduction])

    def select(self, coordinates: BoolArray) -> "TorqueErrors":
        """Set all errors to NaN but those of some coordinates.

        The reaction of a knee is kept with its knee angle.

        Parameters
        ----------
        coordinates
            (nq,) coordinates to keep.

        Returns
        -------
        TorqueErrors
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
            None if self.kinetics is None else self.kinetics.select(coordinates),
        )

    def compute_shares(self, column: int, valid: BoolArray) -> dict[ErrorSource, float]:
        """Compute the share of each source in the variance of a torque.

        Parameters
        ----------
        column
            Index of the torque among the 29.
        valid
            (nf,) frames to include.

        Returns
        -------
        dict
            Source -> share, largest first; they sum to 1. Empty where there is no variance.
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


PLATE_ERROR_COLUMNS = ("gain", "x", "y", "z", "turn")
"""Errors of either foot's plate, in the order of the columns of `wrench_errors`."""


@dataclass(frozen=True, kw_only=True)
class PlateErrors:
    """Standard deviations of the errors of force plates."""

    position: float  # m, of a plate along each axis
    gain: float  # Of 1
    time_offset: float  # s, plates against cameras
    rotation: float = 0.0  # rad, of a plate about the vertical

    @staticmethod
    def from_table(table: PlateErrorTable) -> "PlateErrors":
        """Convert `calibration.plate_error` of a study to SI units."""
        return PlateErrors(
            position=1e-3 * table.place_mm,
            gain=1e-2 * table.gain_percent,
            rotation=float(np.deg2rad(table.turn_deg)),
            time_offset=1e-3 * table.clock_ms,
        )

    def add(self, more: "PlateErrors | None") -> "PlateErrors":
        """Add independent errors; exact plates stay exact.

        Parameters
        ----------
        more
            Further standard deviations; None: none.

        Returns
        -------
        PlateErrors
        """
        if more is None or not self.nonzero:
            return self
        both = {
            f.name: float(np.hypot(getattr(self, f.name), getattr(more, f.name)))
            for f in fields(self)
        }
        return PlateErrors(**both)

    @property
    def nonzero(self) -> bool:
        """Whether any error is not zero."""
        return bool(self.position or self.gain or self.rotation or self.time_offset)


DEFAULT = PlateErrors.from_table(PlateErrorTable())
"""Errors of plates that were not calibrated in place.

Sizes are those of spot checks on plates that were not calibrated in place. The centre of pressure
on the plate was 2.3, 2.6, 11.8 and 14.0 mm off on average on four commercial plates (Cappello et
al., Gait & Posture 33:724, 2011), 9.7 mm RMS, that is 6.9 mm along each axis. It was 3.5 and 6.3 mm
off along the short and the long side of three piezoelectric plates (Bobbert and Schamhardt, J
Biomech 23:705, 1990), 6.4 mm RMS along each axis, and up to 30 mm elsewhere (Schmiedmayer and
Kastner, J Biomech 32:1237, 1999). The position of the plate in the room adds 5 to 10 mm (McCaw and
DeVita, J Biomech 28:985, 1995), 5 mm along each axis. Together 8 mm. Calibration in place leaves
0.5 to 2.3 mm on the first four plates, less than 4 mm in four laboratories (Gait & Posture 2016,
doi 10.1016/j.gaitpost.2016.08.017). Two corners 0.5 m apart, each known to 5 mm along each axis,
give the rotation to 0.8 deg, taken as 1. The forces of the same four plates were 3 to 5 N off, up
to 1 % of a person's weight. The time offset has no such source: 2 ms is a fifth of a frame at 100
Hz.
"""


def compute_wrench_rates(time: Array, wrenches: Array) -> Array:
    """Compute the rates (nf, 2, 6), per s, of foot wrenches (nf, 2, 6) at times (nf,) s."""
    return np.zeros_like(wrenches) if len(time) < 2 else np.gradient(wrenches, time, axis=0)


def compute_wrench_errors(wrenches: Array, rates: Array, errors: PlateErrors) -> Array:
    """Compute the errors of foot wrenches, one standard deviation of each source.

    Parameters
    ----------
    wrenches
        (nf, 2, 6) N and N·m about the laboratory origin.
    rates
        (nf, 2, 6) from `compute_wrench_rates` of the whole trial.
    errors
        Standard deviations.

    Returns
    -------
    (nf, 2, 6, 11) array
        `PLATE_ERROR_COLUMNS` of the right foot, of the left foot, then the time offset.
    """
    feet, each = wrenches.shape[1], len(PLATE_ERROR_COLUMNS)
    out = np.zeros((*wrenches.shape, each * feet + 1))
    for foot in range(feet):
        wrench, first = wrenches[:, foot], each * foot
        out[:, foot, :, first] = errors.gain * wrench
        for k, axis in enumerate(np.eye(3)):
            out[:, foot, 3:, first + 1 + k] = errors.position * np.cross(axis, wrench[:, :3])
        # where a foot hardly presses there is no centre of pressure to rotate about
        on = wrench[:, 1] > LOADED_N
        rotated_force = cross(UP, wrench[on, :3])
        rotated_moment = cross(compute_centre_on_ground(wrench[on], 0.0), rotated_force)
        out[on, foot, :, first + 4] = errors.rotation * np.hstack([rotated_force, rotated_moment])
    out[..., -1] = errors.time_offset * rates
    return out
