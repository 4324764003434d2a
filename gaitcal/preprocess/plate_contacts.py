"""Find when each plate bears a foot, and whose: by the markers of heels and toes, and by the centre
of pressure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact
from gaitcal.dynamics.measurement_errors import compute_foot_tip
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
        Gives the path (nf, 3) m of a landmark; None where the trial does not show it.
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
        """(nf, 2) the foot is down: its heel or its toe moves with the ground."""

    def build_points(self, height: float) -> foot_contact.FootPoints:
        """Heels, toes and tips of the feet of a person of this height (m); NaN where they are not
        seen.
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
        """m, mean distance of points (n, 3) from the line heel-toe, seen from above; infinite where
        it is not seen.
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
    """A plate under load, and the foot whose line from heel to toe is nearest to the centre of
    pressure.
    """

    distance: (
        float  # m, mean distance of the centre of pressure from that line, weighed by the load
    )
    other_distance: float  # m, the same for the other foot

    @property
    def under_foot(self) -> bool:
        """Whether the foot stands where the load is."""
        return self.distance < foot_contact.UNDER_FOOT_M

    def is_whole(self, time: Array) -> bool:
        """Whether it begins and ends while the plate is recorded, at frames of `time` (nf,) s."""
        inner = find_covered_frames([self.plate], time)
        return self.frames.start > inner.start and self.frames.stop < inner.stop


def find_plate_contacts(
    feet: Feet, plates: Sequence[ForcePlate], height: float
) -> tuple[PlateContact, ...]:
    """Find all loadings of all plates that are longer than a knock.

    Parameters
    ----------
    feet
        Of the trial.
    plates
        Of the trial.
    height
        m, of the person.
    """
    found, points = [], feet.build_points(height)
    wrenches = [np.nan_to_num(resample_wrench(plate, feet.time)) for plate in plates]
    one_loaded = np.sum([wrench[:, 1] > LOADED_N for wrench in wrenches], axis=0) == 1
    for plate, wrench in zip(plates, wrenches, strict=True):
        loadings = list[slice]()
        for whole in find_runs(wrench[:, 1] > LOADED_N, 2):
            turns = (
                foot_contact.find_single_stances(wrench, whole, feet.time, points)
                if one_loaded[whole].all()
                else []
            )
            loadings += [part for part, _ in turns] or [whole]
        for run in loadings:
            if (
                measure_duration(feet.time, run) < foot_contact.MIN_LOADING_S
                or wrench[run, 1].max() < BODY_N
            ):
                continue
            level = (
                float(np.nanmedian(plate.point[:, 1]))
                if np.isfinite(plate.point[:, 1]).any()
                else 0.0
            )
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
