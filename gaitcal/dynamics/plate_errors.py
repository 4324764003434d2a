"""What errors of force plates make of the ground reactions on the feet: place, turn, gain and clock of the plates.

The wrench w = [F; M] of the ground on a foot, M about the laboratory origin, is wrong by

    gain    g      d w = g w
    place   d      d w = [0; d x F]                the plate lies elsewhere by d; so does every centre of pressure
    turn    a      d w = a [y x F; c x (y x F)]    about the vertical y through the centre of pressure c on the floor:
                                                   what a turn about the plate's middle adds to that is place
    clock   s      d w = s dw/dt                   all plates together: they share one converter

Linear in w as generalised forces are, they become  d tau = -J_foot^T d w  (`Dynamics.of_ground`). Each foot stands on a
plate of its own, errors of plates being independent.

Sizes are what spot checks of laboratories find where nobody has calibrated the plates in place. The centre of pressure
on the plate: 2.3, 2.6, 11.8 and 14.0 mm off on average on four commercial plates (Cappello et al., Gait & Posture
33:724, 2011), 9.7 mm RMS, that is 6.9 mm along each axis; 3.5 and 6.3 mm on average along the short and the long side
of three piezoelectric plates, 20 mm at most (Bobbert and Schamhardt, J Biomech 23:705, 1990), 6.4 mm RMS along each
axis; up to 30 mm elsewhere (Schmiedmayer and Kastner, J Biomech 32:1237, 1999). The plate in the room: 5 to 10 mm are
reckoned with (McCaw and DeVita, J Biomech 28:985, 1995), 5 mm along each axis. Together 8 mm. Calibrated where they
stood: 0.5 to 2.3 mm on the first four plates, less than 4 mm in four laboratories (Gait & Posture 2016, doi
10.1016/j.gaitpost.2016.08.017). Two corners 0.5 m apart, each known to 5 mm along each axis, tell the turn to 0.8 deg,
taken as 1. The same four plates' forces were 3 to 5 N wrong, up to 1 % of a person's weight. The clock has no such
source: 2 ms is a fifth of a frame at 100 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.io.force_plate import LOADED_N, OUTSIDE_M, UP, centre_on_ground
from gaitcal.io.recording import ForcePlate
from gaitcal.study.settings import PlateErrorTable

OF_A_PLATE = ("gain", "x", "y", "z", "turn")
"""Errors of either foot's plate, in the order of the columns of `wrench_errors`."""
FOOT_LENGTH = 0.152
"""Of body height (Winter 2009): the tip of the foot lies this far before the heel marker, or at the toe marker."""
OUTSIDE_SHARE = 0.1
"""Of the load, with its centre of pressure outside the corners, above which the corners are not believed."""


@dataclass(frozen=True, kw_only=True)
class PlateErrors:
    """Standard deviations of what force plates say."""

    place: float
    """m, of a plate's place along each axis."""
    gain: float
    """Of 1."""
    clock: float
    """s, plates against cameras."""
    turn: float = 0.0
    """rad, of a plate about the vertical."""

    @staticmethod
    def of(table: PlateErrorTable) -> PlateErrors:
        """From `calibration.plate_error`."""
        return PlateErrors(
            place=1e-3 * table.place_mm,
            gain=1e-2 * table.gain_percent,
            turn=float(np.deg2rad(table.turn_deg)),
            clock=1e-3 * table.clock_ms,
        )

    def beside(self, more: PlateErrors | None) -> PlateErrors:
        """With independent errors besides; exact plates stay exact."""
        if more is None or not self.any:
            return self
        both = {f.name: float(np.hypot(getattr(self, f.name), getattr(more, f.name))) for f in fields(self)}
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
    """(nf, 2, 6, 11) one standard deviation of each source: `OF_A_PLATE` of either foot's, then the clock.

    `rates`: of the foot wrenches (nf, 2, 6), from `wrench_rates` of the whole trial.
    """
    feet, each = wrenches.shape[1], len(OF_A_PLATE)
    out = np.zeros((*wrenches.shape, each * feet + 1))
    for foot in range(feet):
        wrench, first = wrenches[:, foot], each * foot
        out[:, foot, :, first] = errors.gain * wrench
        for k, axis in enumerate(np.eye(3)):
            out[:, foot, 3:, first + 1 + k] = errors.place * np.cross(axis, wrench[:, :3])
        on = wrench[:, 1] > LOADED_N  # where a foot hardly presses there is no centre of pressure to turn about
        turned = cross(UP, wrench[on, :3])
        about = cross(centre_on_ground(wrench[on], 0.0), turned)
        out[on, foot, :, first + 4] = errors.turn * np.hstack([turned, about])
    out[..., -1] = errors.clock * rates
    return out


def foot_tip(heel: Array, toe: Array, height: float) -> Array:
    """(..., 3) m, the tip of the foot of a person of this height (m), on the line from heel to toe marker (..., 3)."""
    along = toe - heel
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    return heel + along / length * np.maximum(length, FOOT_LENGTH * height)


def inside(corners: Array, point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie inside the horizontal outline of corners (4, 3); negative outside."""
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
    """Share of the load (where over `load` N) whose centre of pressure is outside the corners; farthest, m."""
    pressed = np.nan_to_num(plate.force[:, 1]) > load
    if not pressed.any():
        return 0.0, 0.0
    away = -inside(corners, plate.point[pressed])
    return float(np.average(away > OUTSIDE_M, weights=plate.force[pressed, 1])), float(away.max())


def outline_known(plate: ForcePlate, load: float) -> bool:
    """Whether a plate has corners, and its own centre of pressure keeps to them."""
    return plate.corners is not None and share_outside(plate, plate.corners, load)[0] <= OUTSIDE_SHARE


def outside(plates: Sequence[ForcePlate], point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie outside every one of these plates; not positive on one of them."""
    depths = [inside(plate.corners, point) for plate in plates if plate.corners is not None]
    return -np.max(depths, axis=0)
