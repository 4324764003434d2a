"""Convert force plate channels to the wrench on the body and its centre of pressure; filter forces.

A wrench (F, M) about the laboratory origin is a force at a point p with the moment T = M - p x F
about it. p is the centre of pressure in the plane y = h where T has no component along x and z.
Plates measure their wrench in the plate frame.

Plate frame (C3D user guide, FORCE_PLATFORM): origin in the middle of the top surface; corners 1 to
4 are in the quadrants (+x,+y), (-x,+y), (-x,-y), (+x,-y); z points **down**. Channels give the
reaction, so Fz < 0 under load. With the force F, the moment M_o about the sensor origin, and the
vector r = ORIGIN from there to the middle of the surface (r_z < 0; some programs write its
negative):

    M = M_o - r x F              moment about the middle of the surface
    p = n x M / (n . F)          centre of pressure from the middle; n the normal
    T = n (M . F) / (n . F)      free moment

so that M = p x F + T with p in the surface and T along its normal.

Type 1: Fx Fy Fz Px Py Tz.  Types 2, 4: Fx Fy Fz Mx My Mz (4: after a calibration matrix).  Type 3:
Fx12 Fx34 Fy14 Fy23 Fz1 Fz2 Fz3 Fz4 with ORIGIN = (a, b, az0), the sensors at (+-a, +-b) (Kistler).

Low-pass filter: Butterworth, second order, forwards and backwards: fourth order in all, without
delay. Two passes square the gain. Each is therefore designed for the higher cut-off at which its
gain is 2^(-1/4) at the requested cut-off; with the bilinear transform's w = tan(pi f / fs),

    1 / (1 + (w/wd)^4) = 2^(-1/2)   =>   wd = w / (sqrt(2) - 1)^(1/4)

(Winter, Biomechanics and Motor Control of Human Movement, 4th ed., 2009, section 3.4.4.2). One pass
is the recursion

    y_n + a1 y_(n-1) + a2 y_(n-2) = b0 x_n + b1 x_(n-1) + b2 x_(n-2),   d = 1 + sqrt(2) wd + wd^2,
    b0 = b2 = b1 / 2 = wd^2 / d,   a1 = 2 (wd^2 - 1) / d,   a2 = (1 - sqrt(2) wd + wd^2) / d,

a triangular band matrix that begins in the steady state of the first sample. It equals SciPy's
`butter` and `sosfiltfilt`, whose package takes long to load. Force and moment about the laboratory
origin are filtered, as both are linear in the channels; the centre of pressure, a quotient, is not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import ForcePlate, find_runs

UP = np.array([0.0, 1.0, 0.0])
LOADED_N = 20.0
"""Vertical force (N) above which a plate or a foot is loaded and has a centre of pressure.

Below it, noise of 1 N·m moves the centre by over 5 cm.
"""
# Vertical force that only a body on the plate makes; unloaded plates read up to about 30 N
BODY_N = 50.0
UNLOADED_N = 60.0  # Vertical readings below this may be the offset of an empty plate
QUIET_N = 10.0  # An empty plate's reading stays this close to its median
QUIET_S = 0.1
"""Shortest period (s) taken as empty.

STEP_MARGIN_S at either end is left out, where a foot may be landing or leaving.
"""
STEP_MARGIN_S = 0.02
LEAST_OFFSET_N = 0.1  # A smaller offset is not removed
STANCE_S = 0.3  # A shorter loading is no step
SIDE_RANGE_M = (0.1, 6.0)  # Sides of a plate; the longest are instrumented treadmills
REVERSED_NOTE = "its force pointed down; force and moment were turned round to act on the body."
"""Note on a plate that `reverse_wrench` has changed."""
# Length of a foot beyond its markers: toes in front of the heads of the metatarsals
FOOT_MARGIN_M = 0.1
# Least displacement of a centre of pressure under load; quiet standing has 10 to 20 mm
LEAST_SWAY_M = 0.003
# Distance of a centre of pressure outside the corners above which the corners are doubtful
OUTSIDE_M = 0.05


@dataclass(frozen=True)
class PlateFrame:
    """Position and orientation of a plate in the axes of the file, from its corners."""

    rotation: Array  # (3, 3) columns are the plate's x, y, z axes
    centre: Array  # (3,) m, middle of the surface
    corners: Array  # (4, 3) m

    @property
    def up(self) -> Array:
        """(3,) unit normal on the side of the body; by convention z points down."""
        return -self.rotation[:, 2]

    @property
    def half_sides(self) -> Array:
        """(2,) m, half the lengths along x and y."""
        local = (self.corners - self.centre) @ self.rotation
        return np.asarray(np.abs(local[:, :2]).max(axis=0))


def build_plate_frame(corners: Array) -> PlateFrame:
    """Build the frame of a plate from its corners.

    Parameters
    ----------
    corners : (4, 3)
        Corners in the order of the C3D guide, m.

    Returns
    -------
    PlateFrame
        The frame in the axes of the corners.

    Raises
    ------
    ValueError
        The corners are no rectangle of a possible size; the text has the reason.
    """
    if corners.shape != (4, 3) or not np.all(np.isfinite(corners)):
        raise ValueError("its corners are not twelve numbers")
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if not (np.all(sides > SIDE_RANGE_M[0]) and np.all(sides < SIDE_RANGE_M[1])):
        raise ValueError(
            f"its sides measure {sides.min():.3g} to {sides.max():.3g} m; allowed are "
            f"{SIDE_RANGE_M[0]} to {SIDE_RANGE_M[1]} m"
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


def find_empty_samples(
    vertical: Array, rate: float, unoccupied: BoolArray | None = None
) -> BoolArray:
    """Find the samples in which nothing is on the plate, by a small and steady reading.

    Parameters
    ----------
    vertical : (ns,)
        Vertical force, N.
    rate
        Sampling rate, Hz.
    unoccupied : (ns,), optional
        Samples without a person over the plate; in these the reading may have any size.

    Returns
    -------
    BoolArray
        (ns,)
    """
    quiet = np.abs(vertical) < UNLOADED_N if unoccupied is None else unoccupied.copy()
    if not quiet.any():
        return quiet
    quiet &= np.abs(vertical - np.median(vertical[quiet])) < QUIET_N
    empty = np.zeros(len(vertical), dtype=bool)
    edge = round(STEP_MARGIN_S * rate)
    for run in find_runs(quiet):
        if run.stop - run.start >= max(3, QUIET_S * rate):
            empty[run.start + edge : run.stop - edge] = True
    return empty


def estimate_offset(
    force: Array, moment: Array, rate: float, occupied: BoolArray, *unoccupied: BoolArray
) -> Array | None:
    """Estimate the offset of a plate: the median wrench of its empty samples.

    Samples without a person are used only if no reading is small, and only if the plate is mostly
    loaded while it is occupied. Otherwise its corners are probably wrong.

    Parameters
    ----------
    force, moment : (ns, 3)
        Wrench in the plate frame, N and N·m.
    rate
        Sampling rate, Hz.
    occupied : (ns,)
        Samples with a person over the plate.
    *unoccupied : (ns,)
        Samples without a person, the most reliable first.

    Returns
    -------
    Array or None
        (6,) N and N·m; None if the plate is never known to be empty.
    """
    for allowed in (None, *unoccupied):
        empty = find_empty_samples(force[:, 2], rate, allowed)
        if not empty.any():
            continue
        wrench = np.asarray(np.median(np.hstack([force, moment])[empty], axis=0))
        loaded = np.abs(force[:, 2] - wrench[2]) > BODY_N
        if allowed is None or (loaded.any() and occupied[loaded].mean() > 0.5):
            return wrench
    return None


def find_points_over_plate(points: Array, frame: PlateFrame) -> tuple[BoolArray, BoolArray]:
    """Find the frames in which points are above or below a plate.

    Parameters
    ----------
    points : (nf, np, 3)
        Marker positions, m; NaN if unknown.
    frame
        Frame of the plate in the same axes.

    Returns
    -------
    above, known
        (nf,) whether any point is over the plate, and whether most points are known.
    """
    local = np.abs((points - frame.centre) @ frame.rotation[:, :2])
    above = np.asarray((local < frame.half_sides + FOOT_MARGIN_M).all(axis=2))
    return np.asarray(above.any(axis=1)), np.asarray(
        np.isfinite(points).all(axis=2).mean(axis=1) > 0.5
    )


def _compute_centre_of_pressure(force: Array, moment: Array, normal: Array) -> Array:
    """Compute the centre of pressure from the point about which `moment` is given.

    `force`, `moment`: N and N·m. `normal`: unit normal of the plane. Returns: (..., 3) m, in the
    plane through that point.
    """
    return cross(normal, moment) / (force @ normal)[..., None]


def compute_centre_on_ground(wrench: Array, height: float = 0.0) -> Array:
    """Compute the centre of pressure in the plane y = `height`.

    Parameters
    ----------
    wrench : (..., 6)
        Force and moment about the laboratory origin, N and N·m; loaded frames only.
    height
        Height of the plane, m.

    Returns
    -------
    Array
        (..., 3) m.
    """
    origin = np.array([0.0, height, 0.0])
    force, moment = wrench[..., :3], wrench[..., 3:]
    return origin + _compute_centre_of_pressure(force, moment - cross(origin, force), UP)


def split_wrench(wrench: Array) -> tuple[Array, Array]:
    """Convert wrenches about the origin to a point of application and the moment about it.

    In loaded frames the point is the centre of pressure in the plane y = 0, and only the free
    moment remains. In other frames the point is that of the nearest loaded frame, and the moment
    takes the rest. The wrench is therefore unchanged in every frame, and the point does not jump.

    Parameters
    ----------
    wrench : (nf, 6)
        Force and moment about the laboratory origin, N and N·m.

    Returns
    -------
    point, moment
        (nf, 3) m and (nf, 3) N·m.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.flatnonzero(np.abs(force[:, 1]) >= LOADED_N)
    point = np.zeros_like(force)
    if len(loaded):
        frames = np.arange(len(force))
        after = np.clip(np.searchsorted(loaded, frames), 0, len(loaded) - 1)
        before = np.maximum(after - 1, 0)
        nearer_before = np.abs(loaded[before] - frames) < np.abs(loaded[after] - frames)
        point = compute_centre_on_ground(wrench[loaded])[np.where(nearer_before, before, after)]
    return point, moment - cross(point, force)


def compute_outside_share(force: Array, moment: Array, frame: PlateFrame) -> float:
    """Compute the share of loaded samples with the centre of pressure outside the plate.

    Parameters
    ----------
    force, moment : (ns, 3)
        Wrench about the middle of the surface in the plate frame, N and N·m.
    frame
        Frame of the plate.

    Returns
    -------
    float
        0 to 1; NaN if the plate is never loaded.
    """
    loaded = np.abs(force[:, 2]) > BODY_N
    if not loaded.any():
        return float("nan")
    point = _compute_centre_of_pressure(force[loaded], moment[loaded], np.array([0.0, 0.0, 1.0]))
    return float(np.mean(np.any(np.abs(point[:, :2]) > frame.half_sides + OUTSIDE_M, axis=1)))


def measure_cop_travel(force: Array, moment: Array) -> float:
    """Measure the range of the centre of pressure under load.

    Parameters
    ----------
    force, moment : (ns, 3)
        Wrench in the plate frame, N and N·m.

    Returns
    -------
    float
        m, from the 5th to the 95th percentile along the longer axis; NaN if never loaded.
    """
    loaded = np.abs(force[:, 2]) > BODY_N
    point = _compute_centre_of_pressure(force[loaded], moment[loaded], np.array([0.0, 0.0, 1.0]))
    return (
        float(np.ptp(np.percentile(point, (5.0, 95.0), axis=0), axis=0).max())
        if loaded.any()
        else float("nan")
    )


def build_plate_from_moment(
    name: str,
    time: Array,
    force: Array,
    moment: Array,
    centre: Array,
    normal: Array,
    corners: Array | None,
) -> ForcePlate:
    """Build a plate from its wrench about a point on its surface.

    Where the force along the normal exceeds `LOADED_N`, `point` is the centre of pressure and
    `moment` the free moment; elsewhere they are `centre` and the full moment about it.

    Parameters
    ----------
    time
        (ns,) s.
    force, moment
        (ns, 3) Force and moment about `centre`, N and N·m.
    centre
        (3,) Point on the surface, m.
    normal
        (3,) Unit normal that points up.
    corners
        (4, 3) or None m.

    Returns
    -------
    ForcePlate
        In the axes of the input.
    """
    point = np.tile(centre, (len(time), 1))
    moment = moment.copy()
    with np.errstate(invalid="ignore"):
        loaded = force @ normal > LOADED_N
    lever = _compute_centre_of_pressure(force[loaded], moment[loaded], normal)
    point[loaded] += lever
    moment[loaded] -= cross(lever, force[loaded])
    return ForcePlate(
        name=name, time=time, force=force, point=point, moment=moment, corners=corners
    )


def is_reaction_on_plate(force: Array, up: Array) -> bool:
    """Return whether the force under load acts on the plate, not on the body.

    Parameters
    ----------
    force : (ns, 3)
        N.
    up : (3,)
        Unit vector of the vertical in the same axes.
    """
    vertical = force @ up
    loaded = np.abs(vertical) > BODY_N
    return bool(loaded.any() and np.median(vertical[loaded]) < 0)


def reverse_wrench(plate: ForcePlate) -> ForcePlate:
    """Return the plate with the opposite wrench at the same points."""
    return replace(plate, force=-plate.force, moment=-plate.moment)


# ----------------------------------------------------------- low-pass filter, values at other times


def filter_low_pass(values: Array, rate: float, cutoff_hz: float) -> Array:
    """Filter values with a zero-phase fourth-order Butterworth low-pass.

    Parameters
    ----------
    values : (ns, k)
        Samples; periods between NaN are filtered separately.
    rate
        Sampling rate, Hz.
    cutoff_hz
        Frequency of -3 dB, both passes together.

    Returns
    -------
    Array
        (ns, k)

    Raises
    ------
    InputError
        Unless 0 < cutoff_hz < rate / 2.
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
    for stretch in find_runs(known):
        x, pad = out[stretch], min(padding, stretch.stop - stretch.start - 1)
        if pad > 0:
            padded = np.concatenate(
                [2.0 * x[0] - x[pad:0:-1], x, 2.0 * x[-1] - x[-2 : -pad - 2 : -1]]
            )
            back = _filter_once(_filter_once(padded, warped)[::-1], warped)[::-1]
            out[stretch] = back[pad : pad + len(x)]
    return out


def _filter_once(values: Array, warped: float) -> Array:
    """Filter values (n, k) by one pass."""
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
    # Imported here, as the process that parses C3D files does not need it and starts sooner
    from scipy.linalg import lapack

    out: Array = lapack.dtbtrs(band, right, uplo="L")[0]
    return out


def find_covered_frames(plates: Sequence[ForcePlate], time: Array) -> slice:
    """Find the frames for which all plates have samples.

    Parameters
    ----------
    time
        (nf,) Times of the frames, s.

    Returns
    -------
    slice
        Frames.
    """
    start, stop = max(p.time[0] for p in plates), min(p.time[-1] for p in plates)
    return slice(
        int(np.searchsorted(time, start - 1e-9)),
        int(np.searchsorted(time, stop + 1e-9, side="right")),
    )


def is_filterable(plate: ForcePlate, cutoff_hz: float) -> bool:
    """Return whether a cut-off (Hz) is below half of the plate's sampling rate."""
    return len(plate.time) > 1 and cutoff_hz < 0.5 / float(np.median(np.diff(plate.time)))


def filter_plate(plate: ForcePlate, cutoff_hz: float) -> ForcePlate:
    """Filter the wrench of a plate, and compute centre of pressure and free moment from it.

    Points are at the median height of the plate's points under load; without load they are in the
    middle of the plate's points.

    Parameters
    ----------
    plate
        Plate with y up.
    cutoff_hz
        Frequency of -3 dB.

    Returns
    -------
    ForcePlate
        The filtered plate; the same one if it has a single sample.

    Raises
    ------
    InputError
        The cut-off is not below half the sampling rate.
    """
    if len(plate.time) < 2:
        return plate
    wrench = filter_low_pass(plate.wrench(), float(1.0 / np.median(np.diff(plate.time))), cutoff_hz)
    # The reference point is not taken from the corners, so that a plate from a table, which has
    # none, gives the same numbers.
    loaded = plate.force[:, 1] > LOADED_N
    points = plate.point[loaded if loaded.any() else slice(None)]
    points = points[np.isfinite(points).all(axis=1)]
    centre = np.asarray(np.median(points, axis=0)) if len(points) else np.zeros(3)
    force = np.ascontiguousarray(wrench[:, :3])
    moment = wrench[:, 3:] - np.cross(centre, force)
    return build_plate_from_moment(plate.name, plate.time, force, moment, centre, UP, plate.corners)


def resample_wrench(plate: ForcePlate, time: Array) -> Array:
    """Interpolate the wrench about the laboratory origin linearly.

    Parameters
    ----------
    time
        (nf,) s.

    Returns
    -------
    Array
        (nf, 6) N and N·m; NaN outside the plate's time and next to NaN samples.
    """
    wrench = plate.wrench()
    tolerance = 1e-6 * float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 1e-9
    inside = (time >= plate.time[0] - tolerance) & (time <= plate.time[-1] + tolerance)
    out = np.full((len(time), 6), np.nan)
    for column in range(6):
        out[inside, column] = np.interp(time[inside], plate.time, wrench[:, column])
    return out
