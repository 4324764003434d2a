"""From the channels of a force plate to the wrench on the body, and from there to the centre of
pressure.

A wrench (F, M) about the laboratory origin is a force at a point p with the moment T = M - p x F
about it; p is the centre of pressure in the plane y = h where T has no part along x and z. Plates
tell their wrench in a frame of their own.

Plate frame (C3D user guide, FORCE_PLATFORM): origin in the middle of the top surface; corners 1 to
4 lie in the quadrants (+x,+y), (-x,+y), (-x,-y), (+x,-y); z points **down**. Channels give the
reaction, so Fz < 0 under load. With the force F, the moment M_o about the sensor origin, and the
vector r = ORIGIN from there to the middle of the surface (r_z < 0; some programs write its
negative):

    M = M_o - r x F                                     moment about the middle of the surface
    p = n x M / (n . F),   T = n (M . F) / (n . F)      centre of pressure from the middle, free moment; n the normal

so that M = p x F + T with p in the surface and T along its normal.

Type 1: Fx Fy Fz Px Py Tz.  Types 2, 4: Fx Fy Fz Mx My Mz (4: after a calibration matrix).  Type 3: Fx12 Fx34 Fy14
Fy23 Fz1 Fz2 Fz3 Fz4 with ORIGIN = (a, b, az0), the sensors at (+-a, +-b) (Kistler).

Low-pass filter: Butterworth, second order, run forwards and backwards: fourth order in all and no
delay. Two passes square the gain, so each is designed for the higher cut-off at which its own gain
is 2^(-1/4) at the cut-off asked for; with the bilinear transform's w = tan(pi f / fs),

    1 / (1 + (w/wd)^4) = 2^(-1/2)   =>   wd = w / (sqrt(2) - 1)^(1/4)

(Winter, Biomechanics and Motor Control of Human Movement, 4th ed., 2009, section 3.4.4.2). One pass
is the recursion

    y_n + a1 y_(n-1) + a2 y_(n-2) = b0 x_n + b1 x_(n-1) + b2 x_(n-2),   d = 1 + sqrt(2) wd + wd^2,
    b0 = b2 = b1 / 2 = wd^2 / d,   a1 = 2 (wd^2 - 1) / d,   a2 = (1 - sqrt(2) wd + wd^2) / d,

a triangular band matrix, begun as if the first sample had been there for ever: y = x before it.
That is SciPy's `butter` and `sosfiltfilt`, whose package takes as long to load as a short trial to
calibrate. Force and moment about the laboratory origin are filtered, both linear in the channels;
never the centre of pressure, a quotient.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import ForcePlate, runs

UP = np.array([0.0, 1.0, 0.0])
LOADED_N = 20.0
"""Vertical force above which a plate or a foot counts as loaded and a centre of pressure is given:
below it, 1 N·m of noise moves the centre by over 5 cm."""
# Vertical force that only a body on the plate makes; unloaded plates read up to about 30 N
BODY_N = 50.0
UNLOADED_N = 60.0  # Vertical readings below this may be the offset of an empty plate
QUIET_N = 10.0  # An empty plate's reading stays this close to its own median
QUIET_S = 0.1
"""Shortest stretch taken as empty; EDGE_S at either end of it is left out, where a foot may be
landing or leaving.
"""
EDGE_S = 0.02
OFFSET_TOLD_N = 0.1  # An offset smaller than this is left alone
STANCE_S = 0.3  # A shorter loading is no step
SIDE_M = (0.1, 6.0)  # Sides of a plate, m; instrumented treadmills are the long ones
TURNED_ROUND = "its force pointed down; force and moment were turned round to act on the body."
"""Note on a plate that `turned_round` has changed."""
FOOT_BEYOND_M = (
    0.1  # A foot reaches that far beyond its markers: toes before the heads of the metatarsals
)
SWAY_M = 0.003  # Even quiet standing moves a centre of pressure by more: 10 to 20 mm
OUTSIDE_M = 0.05  # How far a centre of pressure may lie outside the corners before they are doubted


@dataclass(frozen=True)
class PlateFrame:
    """Where a plate lies: its frame in the axes of the file, after its corners."""

    rotation: Array  # (3, 3) columns are the plate's x, y, z axes
    centre: Array  # (3,) m, middle of the surface
    corners: Array  # (4, 3) m

    @property
    def up(self) -> Array:
        """(3,) unit normal on the side where the body stands, by the convention that z points down."""
        return -self.rotation[:, 2]

    @property
    def half_sides(self) -> Array:
        """(2,) m along x and y."""
        local = (self.corners - self.centre) @ self.rotation
        return np.asarray(np.abs(local[:, :2]).max(axis=0))


def plate_frame(corners: Array) -> PlateFrame:
    """The frame of a plate with `corners` (4, 3) m; ValueError, with the reason, where they make no
    rectangle.
    """
    if corners.shape != (4, 3) or not np.all(np.isfinite(corners)):
        raise ValueError("its corners are not twelve numbers")
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if not (np.all(sides > SIDE_M[0]) and np.all(sides < SIDE_M[1])):
        raise ValueError(
            f"its sides measure {sides.min():.3g} to {sides.max():.3g} m; allowed are {SIDE_M[0]} "
            f"to {SIDE_M[1]} m"
        )
    gap = float(np.linalg.norm(corners[0] - corners[1] + corners[2] - corners[3]))
    x, y = corners[0] - corners[1], corners[0] - corners[3]
    skew = abs(float(x @ y)) / float(np.linalg.norm(x) * np.linalg.norm(y))
    if gap > 0.1 * sides.min() or skew > 0.1:
        raise ValueError(
            f"its corners make no rectangle (off by {1e3 * gap:.0f} mm, sides skewed by {skew:.2f})"
        )
    z = cross(x, y)
    z /= np.linalg.norm(z)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return PlateFrame(np.column_stack([x, cross(z, x), z]), corners.mean(axis=0), corners)


def empty_samples(vertical: Array, rate: float, unoccupied: BoolArray | None = None) -> BoolArray:
    """(ns,) bool: where nothing stands on the plate, by a steady reading of `vertical` (ns,) N.

    The reading is a small one. It may have any size in `unoccupied` samples (ns,), with no person
    over the plate.
    """
    quiet = np.abs(vertical) < UNLOADED_N if unoccupied is None else unoccupied.copy()
    if not quiet.any():
        return quiet
    quiet &= np.abs(vertical - np.median(vertical[quiet])) < QUIET_N
    empty = np.zeros(len(vertical), dtype=bool)
    edge = round(EDGE_S * rate)
    for run in runs(quiet):
        if run.stop - run.start >= max(3, QUIET_S * rate):
            empty[run.start + edge : run.stop - edge] = True
    return empty


def offset(
    force: Array, moment: Array, rate: float, occupied: BoolArray, *unoccupied: BoolArray
) -> Array | None:
    """(6,) median wrench of the empty plate; None where it is never known to be empty.

    `occupied` (ns,): samples with a person over the plate. `unoccupied`, each (ns,): samples
    without one, the surest first. These are used where no reading is small, and only if the plate
    is loaded while it is occupied: a plate that is not is located elsewhere.
    """
    for allowed in (None, *unoccupied):
        empty = empty_samples(force[:, 2], rate, allowed)
        if not empty.any():
            continue
        wrench = np.asarray(np.median(np.hstack([force, moment])[empty], axis=0))
        loaded = np.abs(force[:, 2] - wrench[2]) > BODY_N
        if allowed is None or (loaded.any() and occupied[loaded].mean() > 0.5):
            return wrench
    return None


def over_plate(points: Array, frame: PlateFrame) -> tuple[BoolArray, BoolArray]:
    """(nf,) bool each: whether any of the points (nf, np, 3) m is above or below the plate; whether
    most are known.
    """
    local = np.abs((points - frame.centre) @ frame.rotation[:, :2])
    above = np.asarray((local < frame.half_sides + FOOT_BEYOND_M).all(axis=2))
    return np.asarray(above.any(axis=1)), np.asarray(
        np.isfinite(points).all(axis=2).mean(axis=1) > 0.5
    )


def centre_of_pressure(force: Array, moment: Array, normal: Array) -> Array:
    """(..., 3) m from the point about which `moment` is given, in the plane through it across
    `normal`.
    """
    return cross(normal, moment) / (force @ normal)[..., None]


def centre_on_ground(wrench: Array, height: float = 0.0) -> Array:
    """(..., 3) m, centre of pressure in the plane y = `height` (m) of loaded wrenches (..., 6)
    about the origin.
    """
    origin = np.array([0.0, height, 0.0])
    force, moment = wrench[..., :3], wrench[..., 3:]
    return origin + centre_of_pressure(force, moment - cross(origin, force), UP)


def point_and_torque(wrench: Array) -> tuple[Array, Array]:
    """Point of application (nf, 3), m, and moment about it (nf, 3), N·m, of wrenches (nf, 6) about
    the origin.

    Where the foot is loaded the point is the centre of pressure in the plane y = 0, and only the
    free moment about the vertical remains. Where it is not, the point stays where it was in the
    nearest loaded frame and the moment takes what is left, so that the wrench is the same in every
    frame and no point jumps.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.flatnonzero(np.abs(force[:, 1]) >= LOADED_N)
    point = np.zeros_like(force)
    if len(loaded):
        frames = np.arange(len(force))
        after = np.clip(np.searchsorted(loaded, frames), 0, len(loaded) - 1)
        before = np.maximum(after - 1, 0)
        nearer_before = np.abs(loaded[before] - frames) < np.abs(loaded[after] - frames)
        point = centre_on_ground(wrench[loaded])[np.where(nearer_before, before, after)]
    return point, moment - cross(point, force)


def outside_share(force: Array, moment: Array, frame: PlateFrame) -> float:
    """Share of the loaded samples whose centre of pressure lies outside the plate; in the plate
    frame, NaN if none.
    """
    loaded = np.abs(force[:, 2]) > BODY_N
    if not loaded.any():
        return float("nan")
    point = centre_of_pressure(force[loaded], moment[loaded], np.array([0.0, 0.0, 1.0]))
    return float(np.mean(np.any(np.abs(point[:, :2]) > frame.half_sides + OUTSIDE_M, axis=1)))


def travel(force: Array, moment: Array) -> float:
    """m, way of the centre of pressure under load, from its 5th to its 95th percentile; plate axes."""
    loaded = np.abs(force[:, 2]) > BODY_N
    point = centre_of_pressure(force[loaded], moment[loaded], np.array([0.0, 0.0, 1.0]))
    return (
        float(np.ptp(np.percentile(point, (5.0, 95.0), axis=0), axis=0).max())
        if loaded.any()
        else float("nan")
    )


def plate_from_moment(
    name: str,
    time: Array,
    force: Array,
    moment: Array,
    centre: Array,
    normal: Array,
    corners: Array | None,
) -> ForcePlate:
    """A plate from its wrench about `centre` (3,) on its surface with unit `normal` (3,) pointing
    up.

    Where the force along the normal exceeds LOADED_N, `point` is the centre of pressure and
    `moment` the free moment; elsewhere `centre` and the full moment about it.
    """
    point = np.tile(centre, (len(time), 1))
    moment = moment.copy()
    with np.errstate(invalid="ignore"):
        loaded = force @ normal > LOADED_N
    lever = centre_of_pressure(force[loaded], moment[loaded], normal)
    point[loaded] += lever
    moment[loaded] -= cross(lever, force[loaded])
    return ForcePlate(
        name=name, time=time, force=force, point=point, moment=moment, corners=corners
    )


def pushes_down(force: Array, up: Array) -> bool:
    """True where the force under load points against `up`: the reaction on the plate, not on the
    body.
    """
    vertical = force @ up
    loaded = np.abs(vertical) > BODY_N
    return bool(loaded.any() and np.median(vertical[loaded]) < 0)


def turned_round(plate: ForcePlate) -> ForcePlate:
    """The opposite wrench at the same points."""
    return replace(plate, force=-plate.force, moment=-plate.moment)


# ------------------------------------------------------------------------------ low-pass filter, values at other times


def low_pass(values: Array, rate: float, cutoff_hz: float) -> Array:
    """(ns, k) values at `rate` Hz without what is faster than `cutoff_hz` (-3 dB there, both passes
    together).

    Stretches between NaN are filtered each alone. InputError unless 0 < cutoff_hz < rate / 2.
    """
    nyquist = 0.5 * rate
    if not 0.0 < cutoff_hz < nyquist:
        message = (
            f"found {cutoff_hz:g} Hz; between 0 and half the sampling rate, {nyquist:g} Hz, is "
            "allowed"
        )
        raise InputError(message, field="filter cut-off", code=Code.FORCE_FILTER)
    warped = math.tan(math.pi * cutoff_hz / rate) / (math.sqrt(2.0) - 1.0) ** 0.25
    out = np.array(values, dtype=np.float64)
    known = np.asarray(np.isfinite(out).all(axis=1))
    # Enough padding for the transient to die out, so that the ends do not ring; reflected about the
    # end value.
    padding = round(3.0 * rate / cutoff_hz)
    for stretch in runs(known):
        x, pad = out[stretch], min(padding, stretch.stop - stretch.start - 1)
        if pad > 0:
            padded = np.concatenate(
                [2.0 * x[0] - x[pad:0:-1], x, 2.0 * x[-1] - x[-2 : -pad - 2 : -1]]
            )
            back = _pass(_pass(padded, warped)[::-1], warped)[::-1]
            out[stretch] = back[pad : pad + len(x)]
    return out


def _pass(values: Array, warped: float) -> Array:
    """(n, k) one pass over values (n, k)."""
    d = 1.0 + math.sqrt(2.0) * warped + warped**2
    b, a1, a2 = (
        warped**2 / d,
        2.0 * (warped**2 - 1.0) / d,
        (1.0 - math.sqrt(2.0) * warped + warped**2) / d,
    )
    x = np.concatenate([values[:1], values[:1], values])
    right = b * (x[2:] + 2.0 * x[1:-1] + x[:-2])
    right[0] -= (a1 + a2) * values[0]
    right[1] -= a2 * values[0]
    band = np.empty((3, len(values)))
    band[:] = np.array([[1.0], [a1], [a2]])
    from scipy.linalg import (
        lapack,
    )  # only filters ask for it: the process that parses C3D files is ready sooner

    out: Array = lapack.dtbtrs(band, right, uplo="L")[0]
    return out


def covered(plates: Sequence[ForcePlate], time: Array) -> slice:
    """Frames of `time` (nf,) s for which all plates have samples."""
    start, stop = max(p.time[0] for p in plates), min(p.time[-1] for p in plates)
    return slice(
        int(np.searchsorted(time, start - 1e-9)),
        int(np.searchsorted(time, stop + 1e-9, side="right")),
    )


def filterable(plate: ForcePlate, cutoff_hz: float) -> bool:
    """Whether a cut-off is below half of the plate's sampling rate."""
    return len(plate.time) > 1 and cutoff_hz < 0.5 / float(np.median(np.diff(plate.time)))


def filter_plate(plate: ForcePlate, cutoff_hz: float) -> ForcePlate:
    """The plate with its wrench low-passed, and centre of pressure and free moment worked out anew
    from it.

    Points lie at the height of the plate's points under load; where it carries nothing, in the
    middle of those. InputError where the cut-off is not below half the sampling rate.
    """
    if len(plate.time) < 2:
        return plate
    wrench = low_pass(plate.wrench(), float(1.0 / np.median(np.diff(plate.time))), cutoff_hz)
    # A point of the surface, not from the corners: a plate read from a table has none, and is to
    # give the same numbers.
    loaded = plate.force[:, 1] > LOADED_N
    points = plate.point[loaded if loaded.any() else slice(None)]
    points = points[np.isfinite(points).all(axis=1)]
    centre = np.asarray(np.median(points, axis=0)) if len(points) else np.zeros(3)
    force = np.ascontiguousarray(wrench[:, :3])
    moment = wrench[:, 3:] - np.cross(centre, force)
    return plate_from_moment(plate.name, plate.time, force, moment, centre, UP, plate.corners)


def resample_wrench(plate: ForcePlate, time: Array) -> Array:
    """(nf, 6) force and moment about the laboratory origin at `time` (nf,) s, linear between
    samples.

    NaN outside the span of the plate's own time, and next to samples that are NaN.
    """
    wrench = plate.wrench()
    tolerance = 1e-6 * float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 1e-9
    inside = (time >= plate.time[0] - tolerance) & (time <= plate.time[-1] + tolerance)
    out = np.full((len(time), 6), np.nan)
    for column in range(6):
        out[inside, column] = np.interp(time[inside], plate.time, wrench[:, column])
    return out
