"""What a force plate says at some moments, as a fault of it acts: force, centre of pressure, moment about that.

    w = [f; t + c x f]                  the wrench about the laboratory origin; c the centre of pressure, t free moment
    M = t + (c - m) x f                 the moment about the middle m of the plate's surface

A fault of the force f -> f' keeps either what the file gives as centre of pressure and free moment (tables of forces),
or the moments of the plate's channels (C3D, plate types 2 to 4):

    centre kept   w' = [f'; t' + c x f']
    moments kept  w' = [f'; M + m x f']
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, cross
from gaitcal.io.force_plate import LOADED_N, centre_on_ground


@dataclass(frozen=True, kw_only=True)
class PlateForces:
    """One plate at the frames (k,) that a diagnosis looks at."""

    name: str
    force: Array
    """(k, 3) N on the body."""
    centre: Array
    """(k, 3) m, centre of pressure; the middle where the plate carries nothing."""
    free: Array
    """(k, 3) N·m about `centre`."""
    middle: Array
    """(3,) m of the surface: of its corners, or where feet stand on it."""
    place: Array
    """(3,) m, where the file says that it is: its corners, or else its load."""
    path: CubicSpline
    """s -> (n, 6) wrench about the laboratory origin: the plate at any other time."""
    until: tuple[float, float]
    """s, the time that `path` covers."""

    @staticmethod
    def of(
        name: str,
        path: CubicSpline,
        until: tuple[float, float],
        time: Array,
        middle: Array | None = None,
        place: Array | None = None,
    ) -> PlateForces:
        """At the times (k,) s. The centre of pressure lies at the height of `middle` (3,) m; it and `place` (3,) m
        are the middle of the load where they are not known.
        """
        wrench = path(time)
        height = 0.0 if middle is None else float(middle[1])
        loaded = np.abs(wrench[:, 1]) > LOADED_N
        if not loaded.any():
            loaded = np.abs(wrench[:, 1]) >= 0.5 * np.abs(wrench[:, 1]).max()  # in other units, or empty
        centre = np.zeros((len(time), 3))
        with np.errstate(all="ignore"):
            centre[loaded] = np.nan_to_num(centre_on_ground(wrench[loaded], height))
        if middle is None:
            middle = np.average(centre[loaded], axis=0, weights=np.abs(wrench[loaded, 1]) + 1e-9)
        centre[~loaded] = middle
        force, moment = wrench[:, :3], wrench[:, 3:]
        free = moment - cross(centre, force)
        return PlateForces(
            name=name,
            force=force,
            centre=centre,
            free=free,
            middle=middle,
            place=np.average(centre, axis=0, weights=np.abs(force[:, 1]) + 1e-9) if place is None else place,
            path=path,
            until=until,
        )

    @cached_property
    def wrench(self) -> Array:
        """(k, 6) about the laboratory origin, as measured."""
        return joined(self.force, self.centre, self.free)

    def centre_kept(self, force: Array, free: Array | None = None) -> Array:
        """(k, 6) wrench of another force (k, 3) at the same centre; free moment as measured unless given."""
        return joined(force, self.centre, self.free if free is None else free)

    def moments_kept(self, force: Array, factor: float = 1.0) -> Array:
        """(k, 6) wrench of another force (k, 3) with `factor` times the same moment about the middle of the plate."""
        about = self.free + cross(self.centre - self.middle, self.force)
        return joined(force, self.middle, factor * about)

    def moved(self, change: Array) -> Array:
        """(k, 6) wrench of the same plate, lying elsewhere by (3,) or (k, 3) m."""
        return joined(self.force, self.centre + change, self.free)

    def nearer(self, factor: float) -> Array:
        """(k, 6) wrench with centres of pressure `factor` times as far from the laboratory origin.

        The free moment goes with them: a filter has mixed it with what far centres make of the horizontal force.
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
    """(k, 6) wrench about the laboratory origin of forces (k, 3) at points (3,) or (k, 3) with moments (k, 3) there."""
    return np.hstack([force, moment + cross(point, force)])


def rotation(vector: Array) -> Array:
    """(3, 3) rotation about an axis (3,) by its length, rad."""
    out: Array = Rotation.from_rotvec(vector).as_matrix()
    return out
