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
    """Find the contacts of the feet with all plates that last longer than a knock.

    Feet are assigned as for torques (`foot_contact.assign_feet`), from the markers alone and
    without the study's assignment. Where one belt carries both feet, a contact is the time in which
    one foot stands alone, as centre and force are that foot's only there.

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
    found, points = list[PlateContact](), feet.build_points(height)
    wrenches = [np.nan_to_num(resample_wrench(plate, feet.time)) for plate in plates]
    one_loaded = np.sum([wrench[:, 1] > LOADED_N for wrench in wrenches], axis=0) == 1
    for plate, wrench in zip(plates, wrenches, strict=True):
        level = foot_contact.get_surface_height(plate)
        for stretch in find_runs(wrench[:, 1] > LOADED_N):
            # A knock is no step, nor is a foot that merely touches the edge of a plate.
            if measure_duration(feet.time, stretch) < foot_contact.MIN_LOADING_S:
                continue
            for part in foot_contact.assign_feet(wrench, stretch, feet.time, points, level):
                # If another plate is loaded meanwhile, it may carry a part of the same force.
                run = part.alone if one_loaded[stretch].all() else part.frames
                if wrench[run, 1].max() < BODY_N:
                    continue
                away = foot_contact.measure_distances(wrench, run, points, level)
                foot = int(np.argmin(away)) if part.foot is None else part.foot
                step = PlateContact(
                    plate=plate,
                    frames=run,
                    foot=foot,
                    distance=away[foot],
                    other_distance=away[1 - foot],
                    point=compute_centre_on_ground(wrench[run], level),
                    load=wrench[run, 1],
                )
                found.append(step)
    return tuple(found)
