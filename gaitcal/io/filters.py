"""Low-pass filter for plate wrenches, and their values at the marker frames.

Butterworth, second order, run forwards and backwards: fourth order in all and no delay. Two passes square the gain, so
each pass is designed for the higher cut-off at which its own gain is 2^(-1/4) at the cut-off asked for; with the
bilinear transform's w = tan(pi f / fs),

    1 / (1 + (w/wd)^4) = 2^(-1/2)   =>   wd = w / (sqrt(2) - 1)^(1/4)

(Winter, Biomechanics and Motor Control of Human Movement, 4th ed., 2009, section 3.4.4.2). One pass is the recursion

    y_n + a1 y_(n-1) + a2 y_(n-2) = b0 x_n + b1 x_(n-1) + b2 x_(n-2),   d = 1 + sqrt(2) wd + wd^2,
    b0 = b2 = b1 / 2 = wd^2 / d,   a1 = 2 (wd^2 - 1) / d,   a2 = (1 - sqrt(2) wd + wd^2) / d,

a triangular band matrix, begun as if the first sample had been there for ever: y = x before it. That is SciPy's
`butter` and `sosfiltfilt`, whose package takes as long to load as a short trial to calibrate.

What is filtered is force and moment about the laboratory origin, both linear in the channels; never the centre of
pressure, a quotient.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.force_plate import LOADED_N, UP, plate_from_moment
from gaitcal.io.intervals import runs
from gaitcal.io.recording import ForcePlate


def low_pass(values: Array, rate: float, cutoff_hz: float) -> Array:
    """(ns, k) values at `rate` Hz without what is faster than `cutoff_hz` (-3 dB there, both passes together).

    Stretches between NaN are filtered each alone. InputError unless 0 < cutoff_hz < rate / 2.
    """
    nyquist = 0.5 * rate
    if not 0.0 < cutoff_hz < nyquist:
        raise InputError(
            f"found {cutoff_hz:g} Hz; between 0 and half the sampling rate, {nyquist:g} Hz, is allowed",
            field="filter cut-off",
            code=Code.FORCE_FILTER,
        )
    warped = math.tan(math.pi * cutoff_hz / rate) / (math.sqrt(2.0) - 1.0) ** 0.25
    out = np.array(values, dtype=np.float64)
    known = np.asarray(np.isfinite(out).all(axis=1))
    # Enough padding for the transient to die out, so that the ends do not ring; reflected about the end value.
    padding = round(3.0 * rate / cutoff_hz)
    for stretch in runs(known):
        x, pad = out[stretch], min(padding, stretch.stop - stretch.start - 1)
        if pad > 0:
            padded = np.concatenate([2.0 * x[0] - x[pad:0:-1], x, 2.0 * x[-1] - x[-2 : -pad - 2 : -1]])
            back = _pass(_pass(padded, warped)[::-1], warped)[::-1]
            out[stretch] = back[pad : pad + len(x)]
    return out


def _pass(values: Array, warped: float) -> Array:
    """(n, k) one pass over values (n, k)."""
    d = 1.0 + math.sqrt(2.0) * warped + warped**2
    b, a1, a2 = warped**2 / d, 2.0 * (warped**2 - 1.0) / d, (1.0 - math.sqrt(2.0) * warped + warped**2) / d
    x = np.concatenate([values[:1], values[:1], values])
    right = b * (x[2:] + 2.0 * x[1:-1] + x[:-2])
    right[0] -= (a1 + a2) * values[0]
    right[1] -= a2 * values[0]
    band = np.empty((3, len(values)))
    band[:] = np.array([[1.0], [a1], [a2]])
    out: Array = lapack.dtbtrs(band, right, uplo="L")[0]
    return out


def filterable(plate: ForcePlate, cutoff_hz: float) -> bool:
    """Whether a cut-off is below half of the plate's sampling rate."""
    return len(plate.time) > 1 and cutoff_hz < 0.5 / float(np.median(np.diff(plate.time)))


def filter_plate(plate: ForcePlate, cutoff_hz: float) -> ForcePlate:
    """The plate with its wrench low-passed, and centre of pressure and free moment worked out anew from it.

    Points lie at the height of the plate's points under load; where it carries nothing, in the middle of those.
    InputError where the cut-off is not below half the sampling rate.
    """
    if len(plate.time) < 2:
        return plate
    wrench = low_pass(plate.wrench(), float(1.0 / np.median(np.diff(plate.time))), cutoff_hz)
    # A point of the surface, not from the corners: a plate read from a table has none, and is to give the same numbers.
    loaded = plate.force[:, 1] > LOADED_N
    points = plate.point[loaded if loaded.any() else slice(None)]
    points = points[np.isfinite(points).all(axis=1)]
    centre = np.asarray(np.median(points, axis=0)) if len(points) else np.zeros(3)
    force = np.ascontiguousarray(wrench[:, :3])
    moment = wrench[:, 3:] - np.cross(centre, force)
    return plate_from_moment(plate.name, plate.time, force, moment, centre, UP, plate.corners)


def resample_wrench(plate: ForcePlate, time: Array) -> Array:
    """(nf, 6) force and moment about the laboratory origin at `time` (nf,) s, linear between samples.

    NaN outside the span of the plate's own time, and next to samples that are NaN.
    """
    wrench = plate.wrench()
    tolerance = 1e-6 * float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 1e-9
    inside = (time >= plate.time[0] - tolerance) & (time <= plate.time[-1] + tolerance)
    out = np.full((len(time), 6), np.nan)
    for column in range(6):
        out[inside, column] = np.interp(time[inside], plate.time, wrench[:, column])
    return out
