"""What errors of force plates make of the ground reactions on the feet: place, gain and clock of the plates.

The wrench w = [F; M] of the ground on a foot, M about the laboratory origin, is wrong by

    gain    g      d w = g w
    place   d      d w = [0; d x F]                the plate lies elsewhere by d; so does every centre of pressure
    clock   s      d w = s dw/dt                   all plates together: they share one converter

Linear in w as generalised forces are, they become  d tau = -J_foot^T d w  (`Dynamics.of_ground`). Each foot stands on a
plate of its own, errors of plates being independent.

Sizes: four commercial plates placed the centre of pressure 2.3, 2.6, 11.8 and 14.0 mm off on average, 0.5 to 2.3 mm
once they were calibrated where they stood, which left forces 3 to 5 N wrong (Cappello et al., Gait & Posture 33:724,
2011); corrected piezoelectric plates 5.8 (SD 3.7) mm, uncorrected up to 30 mm (Schmiedmayer and Kastner, J Biomech Eng
122:523, 2000); calibration in place takes away 63 % of the error of the centre of pressure and a fifth of that of
forces (Collins et al., Gait & Posture 29:59, 2009), 60 % of it in another laboratory (Gait & Posture 58:98, 2017).
5 mm along each axis are 7 mm in the plane. The clock has no such source: 2 ms is a fifth of a frame at 100 Hz.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.records import dataclass
from gaitcal.study.settings import PlateErrorTable


@dataclass(frozen=True, kw_only=True)
class PlateErrors:
    """Standard deviations of what force plates say."""

    place: float
    """m, of a plate's place along each axis."""
    gain: float
    """Of 1."""
    clock: float
    """s, plates against cameras."""

    @staticmethod
    def of(table: PlateErrorTable) -> PlateErrors:
        """From `calibration.plate_error`."""
        return PlateErrors(place=1e-3 * table.place_mm, gain=1e-2 * table.gain_percent, clock=1e-3 * table.clock_ms)

    @property
    def any(self) -> bool:
        """Whether some error is not zero."""
        return bool(self.place or self.gain or self.clock)


DEFAULT = PlateErrors.of(PlateErrorTable())


def wrench_rates(time: Array, wrenches: Array) -> Array:
    """(nf, 2, 6) per s, how foot wrenches (nf, 2, 6) change at the frames (nf,) s."""
    if len(time) < 2:
        return np.zeros_like(wrenches)
    out: Array = np.gradient(wrenches, time, axis=0)
    return out


def wrench_errors(wrenches: Array, rates: Array, errors: PlateErrors) -> Array:
    """(nf, 2, 6, 9) one standard deviation of each source: gain and place of either foot's plate, then the clock.

    `rates`: of the foot wrenches (nf, 2, 6), from `wrench_rates` of the whole trial.
    """
    feet = wrenches.shape[1]
    out = np.zeros((*wrenches.shape, 4 * feet + 1))
    for foot in range(feet):
        out[:, foot, :, 4 * foot] = errors.gain * wrenches[:, foot]
        for k, axis in enumerate(np.eye(3)):
            out[:, foot, 3:, 4 * foot + 1 + k] = errors.place * np.cross(axis, wrenches[:, foot, :3])
    out[..., -1] = errors.clock * rates
    return out
