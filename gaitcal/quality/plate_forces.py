"""What a force plate says at some moments, as a fault of it acts, and what else tells of a fault.

Force, centre of pressure, moment about that:

    w = [f; t + c x f]                  the wrench about the laboratory origin; c the centre of pressure, t free moment
    M = t + (c - m) x f                 the moment about the middle m of the plate's surface

A fault of the force f -> f' keeps either what the file gives as centre of pressure and free moment
(tables of forces), or the moments of the plate's channels (C3D, plate types 2 to 4):

    centre kept   w' = [f'; t' + c x f']
    moments kept  w' = [f'; M + m x f']

Side evidence is the foot under the centre of pressure, and the empty plate. For each plate and the
foot that stands while it is loaded, with c the centre of pressure averaged by the load over frames
of more than `LOADED_SHARE` of body weight, h and t heel and toe, L = |t - h|, u = (t - h) / L, n
across u:

    z = (n . (c - h)) / ACROSS_M,     z = (u . (c - h) - MIDDLE L) / ALONG_M

and for each plate that is ever empty, with its reading b there and an offset x that a cause takes
away:

    z = (b - x) / EMPTY_N

A cause gains sum (rho(z_0) - rho(z)) / 2 with rho(z) = B^2 log(1 + z^2 / B^2), B = `BELIEVED_Z`, so
that no piece of it is believed beyond all bounds (Cauchy-like).
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

ACROSS_M, ALONG_M, MIDDLE = 0.020, 0.050, 0.70
"""Over 39 steps of clean walks, centres of pressure lie 2 (SD 15) mm outside the line heel-toe, and
at 0.69 (SD 0.21, steps cut short by the end of the valid frames included) of its 150 to 290 mm."""
LOADED_SHARE, FEWEST = 0.4, 4  # Of body weight; frames
EMPTY_N = 10.0  # N: unloaded plates read so much with nothing wrong
BELIEVED_Z = 3.0
STEADY_N, STEADY_S = (
    10.0,
    0.1,
)  # An empty plate's reading stays this close to its own low for at least so long
EMPTY_SHARE = 0.3  # Of body weight: a steady low reading above it is somebody standing


@dataclass(frozen=True, kw_only=True)
class PlateForces:
    """One plate at the frames (k,) that a diagnosis looks at."""

    name: str
    force: Array  # (k, 3) N on the body
    centre: Array  # (k, 3) m, centre of pressure; the middle where the plate carries nothing
    free: Array  # (k, 3) N·m about `centre`
    middle: Array  # (3,) m of the surface: of its corners, or where feet stand on it
    place: Array  # (3,) m, where the file says that it is: its corners, or else its load
    path: CubicSpline  # s -> (n, 6) wrench about the laboratory origin: the plate at any other time
    until: tuple[float, float]  # s, the time that `path` covers

    @staticmethod
    def of(
        name: str,
        path: CubicSpline,
        until: tuple[float, float],
        time: Array,
        middle: Array | None = None,
        place: Array | None = None,
    ) -> "PlateForces":
        """At the times (k,) s. The centre of pressure lies at the height of `middle` (3,) m; it and
        `place` (3,) m are the middle of the load where they are not known.
        """
        wrench = path(time)
        height = 0.0 if middle is None else float(middle[1])
        loaded = np.abs(wrench[:, 1]) > LOADED_N
        if not loaded.any():
            loaded = (
                np.abs(wrench[:, 1]) >= 0.5 * np.abs(wrench[:, 1]).max()
            )  # in other units, or empty
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
            free=wrench[:, 3:] - cross(centre, force),
            middle=middle,
            place=np.average(centre, axis=0, weights=np.abs(force[:, 1]) + 1e-9)
            if place is None
            else place,
            path=path,
            until=until,
        )

    @cached_property
    def wrench(self) -> Array:
        """(k, 6) about the laboratory origin, as measured."""
        return joined(self.force, self.centre, self.free)

    def centre_kept(self, force: Array, free: Array | None = None) -> Array:
        """(k, 6) wrench of another force (k, 3) at the same centre; free moment as measured unless
        given.
        """
        return joined(force, self.centre, self.free if free is None else free)

    def moments_kept(self, force: Array, factor: float = 1.0) -> Array:
        """(k, 6) wrench of another force (k, 3) with `factor` times the same moment about the
        middle of the plate.
        """
        about = self.free + cross(self.centre - self.middle, self.force)
        return joined(force, self.middle, factor * about)

    def moved(self, change: Array) -> Array:
        """(k, 6) wrench of the same plate, lying elsewhere by (3,) or (k, 3) m."""
        return joined(self.force, self.centre + change, self.free)

    def nearer(self, factor: float) -> Array:
        """(k, 6) wrench with centres of pressure `factor` times as far from the laboratory origin.

        The free moment goes with them: a filter has mixed it with what far centres make of the
        horizontal force.
        """
        return np.hstack([self.force, factor * self.wrench[:, 3:]])

    def turned(self, turn: Array) -> Array:
        """(k, 6) wrench of the plate turned about its middle by a rotation (3, 3)."""
        arm = (self.centre - self.middle) @ turn.T
        return joined(self.force @ turn.T, self.middle + arm, self.free @ turn.T)

    def turned_in_the_room(self, turn: Array) -> Array:
        """(k, 6) wrench turned about the laboratory origin by a rotation (3, 3)."""
        return joined(self.force @ turn.T, self.centre @ turn.T, self.free @ turn.T)

    def later(self, time: Array) -> Array:
        """(k, 6) wrench at other times (k,) s; beyond the ends that at the end."""
        out: Array = self.path(np.clip(time, *self.until))
        return out


def joined(force: Array, point: Array, moment: Array) -> Array:
    """(k, 6) wrench about the laboratory origin of forces (k, 3) at points (3,) or (k, 3) with
    moments (k, 3) there.
    """
    return np.hstack([force, moment + cross(point, force)])


def rotation(vector: Array) -> Array:
    """(3, 3) rotation about an axis (3,) by its length, rad."""
    out: Array = Rotation.from_rotvec(vector).as_matrix()
    return out


@dataclass(frozen=True, kw_only=True)
class Sole:
    """A foot on a plate."""

    plate: int
    frames: IntArray  # Of the evidence
    heel: Array  # (n, 2) m, x and z
    toe: Array  # (n, 2) m


def soles_of(
    standing: IntArray, frames: IntArray, feet: foot_contact.FootPoints
) -> tuple[Sole, ...]:
    """Every foot on every plate: `standing` (plates, k) as in the evidence, whose frames of the
    trial are `frames`.
    """
    out = []
    for plate, row in enumerate(standing):
        for foot in range(len(inverse_dynamics.FEET)):
            on = np.flatnonzero(row == foot)
            if len(on) >= FEWEST:
                heel, toe = (path[frames[on], foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                out.append(Sole(plate=plate, frames=on, heel=heel, toe=toe))
    return tuple(out)


def empty_reading(plate: ForcePlate, weight: float) -> float | None:
    """N of vertical force while nobody is on the plate; None where somebody always is."""
    up = np.nan_to_num(plate.force[:, 1])
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


def under_feet(wrenches: Array, soles: Sequence[Sole], heights: Array, weight: float) -> Array:
    """(2 soles,) z of wrenches (plates, k, 6) on plates of `heights` (plates,) m; 0 where one
    carries too little.
    """
    out = np.zeros((len(soles), 2))
    for i, sole in enumerate(soles):
        wrench = wrenches[sole.plate, sole.frames]
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


def surprise(z: Array) -> float:
    """Nats that side evidence (n,) speaks against what it is held against."""
    return float(0.5 * BELIEVED_Z**2 * np.log1p((z / BELIEVED_Z) ** 2).sum())
