"""Find when each plate is loaded, and by which foot, from markers and centres of pressure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact
from gaitcal.dynamics.plate_outline import compute_foot_tip
from gaitcal.io.force_plate import (
    BODY_N,
    LOADED_N,
    compute_centre_on_ground,
    find_covered_frames,
    resample_wrench,
)
from gaitcal.io.recording import ForcePlate, find_runs, measure_duration
from gaitcal.model.linkage import SIDES


class Feet:
    """Heels and toes of a trial, right and left, from the markers alone.

    Parameters
    ----------
    time
        (nf,) s.
    landmark
        Returns the path (nf, 3) m of a landmark; None if the trial does not show it.

    Attributes
    ----------
    heel, toe
        (nf, 2, 3) m, right and left; NaN where not visible.
    visible
        (nf, 2) whether heel and toe are visible.
    belt_velocities
        (2, 3) m/s, of the ground under each foot.
    heel_speed, toe_speed
        (nf, 2) m/s relative to the ground.
    """

    def __init__(self, time: Array, landmark: Callable[[str], Array | None]) -> None:
        self.time = time
        shape = (len(self.time), len(SIDES))
        self.visible = np.zeros(shape, dtype=bool)
        self.heel, self.toe = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
        for k, side in enumerate(SIDES):
            heel, toe = landmark(f"heel_{side}"), landmark(f"toe_{side}")
            if heel is not None and toe is not None:
                self.heel[:, k], self.toe[:, k] = heel, toe
                self.visible[:, k] = np.isfinite(heel).all(axis=1) & np.isfinite(toe).all(axis=1)
        points = np.concatenate([self.heel, self.toe], axis=1)
        velocity = np.gradient(points, self.time, axis=0)
        self.belt_velocities = foot_contact.estimate_belt_velocities(points, velocity)
        speed = np.linalg.norm(velocity - np.tile(self.belt_velocities, (2, 1)), axis=2)
        self.heel_speed, self.toe_speed = speed[:, :2], speed[:, 2:]
        self.resting: BoolArray = (
            np.fmin(self.heel_speed, self.toe_speed) < foot_contact.RESTING_SPEED
        )
        """(nf, 2) whether the foot is on the ground: its heel or its toe moves with it."""

    def build_points(self, height: float) -> foot_contact.FootPoints:
        """Compute heels, toes and tips of the feet.

        Parameters
        ----------
        height
            m, of the person, from which foot tip and breadth follow.

        Returns
        -------
        FootPoints
            NaN where not visible.
        """
        return foot_contact.FootPoints(
            heel=self.heel,
            toe=self.toe,
            tip=compute_foot_tip(self.heel, self.toe, height),
            heel_speed=self.heel_speed,
            toe_speed=self.toe_speed,
            width=foot_contact.FOOT_BREADTH * height,
        )

    def measure_distance(self, foot: int, point: Array, frames: slice, load: Array) -> float:
        """Measure the load-weighted mean distance of points from the line heel-toe, from above.

        Parameters
        ----------
        foot
            0: right, 1: left.
        point
            (n, 3) m, in `frames`.
        frames
            Of the trial.
        load
            (n,) N, weights.

        Returns
        -------
        float
            m; infinite if the foot is not visible in any of the frames.
        """
        known = self.visible[frames, foot]
        if not known.any():
            return float("inf")
        a, b = self.heel[frames, foot][known][:, [0, 2]], self.toe[frames, foot][known][:, [0, 2]]
        return float(
            np.average(
                foot_contact.compute_distance_to_line(point[known][:, [0, 2]], a, b),
                weights=load[known],
            )
        )


@dataclass(frozen=True, kw_only=True)
class PlateContact(foot_contact.Loading):
    """A loaded plate, and the foot whose line heel-toe is nearest to the centre of pressure."""

    distance: float
    """m, load-weighted mean distance of the centre of pressure from that line."""
    other_distance: float
    """m, the same for the other foot."""

    @property
    def under_foot(self) -> bool:
        """Whether the load is under the foot."""
        return self.distance < foot_contact.UNDER_FOOT_M

    def is_whole(self, time: Array) -> bool:
        """Return whether the loading begins and ends while the plate is recorded.

        Parameters
        ----------
        time
            (nf,) s, of the trial.

        Returns
        -------
        bool
        """
        inner = find_covered_frames([self.plate], time)
        return self.frames.start > inner.start and self.frames.stop < inner.stop


def find_plate_contacts(
    feet: Feet, plates: Sequence[ForcePlate], height: float
) -> tuple[PlateContact, ...]:
    """Find all loadings of all plates that last longer than a knock.

    A loading during which the other foot takes over is split into single stances, if no other plate
    is loaded meanwhile.

    Parameters
    ----------
    feet
        Of the trial.
    plates
        Of the trial.
    height
        m, of the person.

    Returns
    -------
    tuple of PlateContact
        In the order of the plates and in time.
    """
    found, points = [], feet.build_points(height)
    wrenches = [np.nan_to_num(resample_wrench(plate, feet.time)) for plate in plates]
    one_loaded = np.sum([wrench[:, 1] > LOADED_N for wrench in wrenches], axis=0) == 1
    for plate, wrench in zip(plates, wrenches, strict=True):
        loadings = list[slice]()
        for whole in find_runs(wrench[:, 1] > LOADED_N, 2):
            stances = []
            if one_loaded[whole].all():
                stances = foot_contact.find_single_stances(wrench, whole, feet.time, points)
            loadings += [part for part, _ in stances] or [whole]
        for run in loadings:
            is_knock = measure_duration(feet.time, run) < foot_contact.MIN_LOADING_S
            if is_knock or wrench[run, 1].max() < BODY_N:
                continue
            heights = plate.point[:, 1]
            level = float(np.nanmedian(heights)) if np.isfinite(heights).any() else 0.0
            point, load = compute_centre_on_ground(wrench[run], level), wrench[run, 1]
            away = [feet.measure_distance(k, point, run, load) for k in range(len(SIDES))]
            foot = int(np.argmin(away))
            step = PlateContact(
                plate=plate,
                frames=run,
                foot=foot,
                distance=away[foot],
                other_distance=away[1 - foot],
                point=point,
                load=load,
            )
            found.append(step)
    return tuple(found)
