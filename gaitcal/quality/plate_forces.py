"""Wrenches of a force plate under possible faults, and side evidence of a fault.

Force, centre of pressure, moment about it:

    w = [f; t + c x f]       wrench about the laboratory origin; c centre of pressure, t free moment
    M = t + (c - m) x f      the moment about the middle m of the plate's surface

A fault of the force f -> f' keeps either the centre of pressure and the free moment (tables of
forces), or the moments of the plate's channels (C3D, plate types 2 to 4):

    keep_centre   w' = [f'; t' + c x f']
    keep_moments  w' = [f'; M + m x f']

Side evidence is the foot under the centre of pressure, and the empty plate. For each plate and the
foot in contact while it is loaded, c is the load-weighted mean centre of pressure over frames with
more than `LOADED_SHARE` of body weight. With heel h, toe t, L = |t - h|, u = (t - h) / L and n
across u:

    z = (n . (c - h)) / ACROSS_M,     z = (u . (c - h) - MIDDLE L) / ALONG_M

and for each plate that is ever empty, with its reading b there and an offset x that a cause
subtracts:

    z = (b - x) / EMPTY_N

A cause gains sum (rho(z_0) - rho(z)) / 2 with rho(z) = B^2 log(1 + z^2 / B^2), B = `CAUCHY_SCALE`,
so that no single piece of evidence dominates (Cauchy).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, IntArray, cross
from gaitcal.dynamics import foot_contact, inverse_dynamics
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import ForcePlate, find_runs, measure_duration

ACROSS_M = 0.020  # Standard deviation (m) of the mean centre of pressure across the foot
ALONG_M = 0.050  # The same along the foot
MIDDLE = 0.70
"""Expected position of the mean centre of pressure, in parts of the foot from heel to toe marker.
Over 39 steps of clean walks it is 2 (SD 15) mm outside the line heel-toe, and at 0.69 (SD 0.21,
steps cut short by the end of the valid frames included) of its 150 to 290 mm."""
LOADED_SHARE = 0.4  # Of body weight: lighter loads have an uncertain centre of pressure
FEWEST = 4  # Frames
EMPTY_N = 10.0  # N, standard deviation of the reading of an unloaded plate without a fault
CAUCHY_SCALE = 3.0  # Standard deviations from which side evidence counts less than Gaussian
# The reading of an empty plate stays this close to its low value (N) for at least so long (s)
STEADY_N, STEADY_S = 10.0, 0.1
EMPTY_SHARE = 0.3  # Of body weight: a steady low reading above it is a person standing


@dataclass(frozen=True, kw_only=True)
class PlateForces:
    """One plate at the frames (k,) of a diagnosis."""

    name: str
    force: Array  # (k, 3) N on the body
    centre: Array  # (k, 3) m, centre of pressure; the middle where the plate carries nothing
    free_moment: Array  # (k, 3) N·m about `centre`
    middle: Array  # (3,) m of the surface: of its corners, or of the feet on it
    position: Array  # (3,) m, position according to the file: of its corners, or else of its load
    wrench_spline: CubicSpline  # s -> (n, 6) wrench about the laboratory origin
    span: tuple[float, float]  # s, the time that `wrench_spline` covers

    @staticmethod
    def from_spline(
        name: str,
        wrench_spline: CubicSpline,
        span: tuple[float, float],
        time: Array,
        middle: Array | None = None,
        position: Array | None = None,
    ) -> "PlateForces":
        """Evaluate a plate's spline at some times.

        Parameters
        ----------
        name
            Name of the plate.
        wrench_spline
            s -> (n, 6) wrench about the laboratory origin, N and N·m.
        span
            Time that the spline covers, s.
        time
            (k,) s.
        middle
            (3,) m, middle of the surface; centres of pressure are at its height. None: not known,
            the mean position of the load on the floor.
        position
            (3,) m, position according to the file; None: the mean position of the load.
        """
        wrench = wrench_spline(time)
        height = 0.0 if middle is None else float(middle[1])
        loaded = np.abs(wrench[:, 1]) > LOADED_N
        if not loaded.any():
            # the force is in another unit, or the plate is empty
            loaded = np.abs(wrench[:, 1]) >= 0.5 * np.abs(wrench[:, 1]).max()
        centre = np.zeros((len(time), 3))
        with np.errstate(all="ignore"):
            centre[loaded] = np.nan_to_num(compute_centre_on_ground(wrench[loaded], height))
        if middle is None:
            middle = np.average(centre[loaded], axis=0, weights=np.abs(wrench[loaded, 1]) + 1e-9)
        centre[~loaded] = middle
        force = wrench[:, :3]
        return PlateForces(
            name=name,
            force=force,
            centre=centre,
            free_moment=wrench[:, 3:] - cross(centre, force),
            middle=middle,
            position=np.average(centre, axis=0, weights=np.abs(force[:, 1]) + 1e-9)
            if position is None
            else position,
            wrench_spline=wrench_spline,
            span=span,
        )

    @cached_property
    def wrench(self) -> Array:
        """(k, 6) about the laboratory origin, as measured."""
        return assemble_wrench(self.force, self.centre, self.free_moment)

    def keep_centre(self, force: Array, free_moment: Array | None = None) -> Array:
        """Compute the wrench of another force at the same centre of pressure.

        Parameters
        ----------
        force
            (k, 3) N.
        free_moment
            (k, 3) N·m; None: as measured.

        Returns
        -------
        ndarray
            (k, 6) about the laboratory origin.
        """
        return assemble_wrench(
            force, self.centre, self.free_moment if free_moment is None else free_moment
        )

    def keep_moments(self, force: Array, factor: float = 1.0) -> Array:
        """Compute the wrench of another force with the same moment about the plate's middle.

        Parameters
        ----------
        force
            (k, 3) N.
        factor
            Multiplies the moment about the middle.

        Returns
        -------
        ndarray
            (k, 6) about the laboratory origin.
        """
        about = self.free_moment + cross(self.centre - self.middle, self.force)
        return assemble_wrench(force, self.middle, factor * about)

    def move(self, change: Array) -> Array:
        """Compute the wrench (k, 6) of the plate displaced by `change`, (3,) or (k, 3) m."""
        return assemble_wrench(self.force, self.centre + change, self.free_moment)

    def scale_distance(self, factor: float) -> Array:
        """Compute the wrench (k, 6) with centres of pressure `factor` times as far from the origin.

        The free moment is scaled as well: filtering has mixed it with the moment of the horizontal
        force at distant centres.
        """
        return np.hstack([self.force, factor * self.wrench[:, 3:]])

    def rotate_about_middle(self, rotation: Array) -> Array:
        """Compute the wrench (k, 6) of the plate rotated (3, 3) about its middle."""
        arm = (self.centre - self.middle) @ rotation.T
        return assemble_wrench(
            self.force @ rotation.T, self.middle + arm, self.free_moment @ rotation.T
        )

    def rotate_about_origin(self, rotation: Array) -> Array:
        """Compute the wrench (k, 6) rotated (3, 3) about the laboratory origin."""
        return assemble_wrench(
            self.force @ rotation.T, self.centre @ rotation.T, self.free_moment @ rotation.T
        )

    def evaluate(self, time: Array) -> Array:
        """Compute the wrench (k, 6) at other times (k,) s; beyond the ends that at the end."""
        out: Array = self.wrench_spline(np.clip(time, *self.span))
        return out


def assemble_wrench(force: Array, point: Array, moment: Array) -> Array:
    """Assemble wrenches about the laboratory origin.

    Parameters
    ----------
    force
        (k, 3) N.
    point
        (3,) or (k, 3) m, where the force acts.
    moment
        (k, 3) N·m about `point`.

    Returns
    -------
    ndarray
        (k, 6) N, N·m.
    """
    return np.hstack([force, moment + cross(point, force)])


def build_rotation(vector: Array) -> Array:
    """Build the rotation (3, 3) of a rotation vector (3,) rad."""
    out: Array = Rotation.from_rotvec(vector).as_matrix()
    return out


@dataclass(frozen=True, kw_only=True)
class Sole:
    """A foot on a plate."""

    plate: int
    frames: IntArray  # (n,) frames of the evidence
    heel: Array  # (n, 2) m, x and z
    toe: Array  # (n, 2) m


def list_soles(
    standing: IntArray, frames: IntArray, feet: foot_contact.FootPoints
) -> tuple[Sole, ...]:
    """List every foot on every plate.

    Parameters
    ----------
    standing
        (plates, k) foot in contact while a plate is loaded: 0 right, 1 left, -1 none.
    frames
        (k,) their frames of the trial.
    feet
        Heel and toe points of the trial.

    Returns
    -------
    tuple of Sole
        Each with at least `FEWEST` frames.
    """
    out = []
    for plate, row in enumerate(standing):
        for foot in range(len(inverse_dynamics.FEET)):
            on = np.flatnonzero(row == foot)
            if len(on) >= FEWEST:
                heel, toe = (path[frames[on], foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                out.append(Sole(plate=plate, frames=on, heel=heel, toe=toe))
    return tuple(out)


def estimate_empty_reading(plate: ForcePlate, weight: float) -> float | None:
    """Estimate the vertical force (N) that a plate reads while it is empty.

    `weight`: body weight, N. Returns: None if the plate is never empty.
    """
    up = np.nan_to_num(plate.force[:, 1])
    # a plate that is empty for a part of the recording has a steady low reading
    low = float(np.quantile(up, 0.05))
    steady = [
        run
        for run in find_runs(np.abs(up - low) < STEADY_N)
        if measure_duration(plate.time, run) >= STEADY_S
    ]
    if not steady:
        return None
    longest = max(steady, key=lambda run: run.stop - run.start)
    reading = float(np.median(up[longest]))
    return reading if abs(reading) < EMPTY_SHARE * weight else None


def compute_foot_evidence(
    wrenches: Array, soles: Sequence[Sole], heights: Array, weight: float
) -> Array:
    """Compute the deviation of centres of pressure from their usual position under the foot.

    Parameters
    ----------
    wrenches
        (plates, k, 6) about the laboratory origin.
    soles
        Feet on the plates.
    heights
        (plates,) m, of the plates' surfaces.
    weight
        Body weight, N.

    Returns
    -------
    ndarray
        (2 soles,) z across and along each foot; 0 where a plate carries too little.
    """
    out = np.zeros((len(soles), 2))
    for i, sole in enumerate(soles):
        wrench = wrenches[sole.plate, sole.frames]
        # centres of pressure are reliable under load only
        on = wrench[:, 1] > LOADED_SHARE * weight
        if on.sum() < FEWEST:
            continue
        centre = compute_centre_on_ground(wrench[on], float(heights[sole.plate]))[:, [0, 2]]
        along = sole.toe[on] - sole.heel[on]
        length = np.linalg.norm(along, axis=1)
        along = along / length[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        arm = centre - sole.heel[on]
        load = wrench[on, 1]
        out[i, 0] = np.average((arm * across).sum(axis=1), weights=load) / ACROSS_M
        out[i, 1] = np.average((arm * along).sum(axis=1) - MIDDLE * length, weights=load) / ALONG_M
    return out.ravel()


def compute_surprise(z: Array) -> float:
    """Compute the evidence (nats) of z values (n,) against an assumption, by a Cauchy density."""
    return float(0.5 * CAUCHY_SCALE**2 * np.log1p((z / CAUCHY_SCALE) ** 2).sum())
