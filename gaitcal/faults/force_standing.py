"""Which foot stands on a plate, told by time alone: forces that are at fault may put their load anywhere.

A plate's loading and a foot's contact belong together where they last together for most of the time that either does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.dynamics.plate_steps import SHORTEST, UNDER_FOOT, distance_to_line
from gaitcal.faults.force_witnesses import empty_reading
from gaitcal.io.filters import resample_wrench
from gaitcal.io.force_plate import LOADED_N, centre_on_ground
from gaitcal.io.intervals import duration, runs
from gaitcal.io.recording import ForcePlate

TOGETHER = 0.5
"""Of the time that a plate's load and a foot's contact last together: the common part by which they belong together."""
WALKING = (0.75, 2.2)
"""Body weights that the plates carry at most while somebody walks or runs slowly."""
FORCE_UNITS: dict[str, float] = {"N": 1.0, "kgf": 9.80665, "lbf": 4.4482216, "kN": 1000.0}
"""N in a unit of force."""


def as_walked_on(plates: tuple[ForcePlate, ...], time: Array, weight: float) -> tuple[ForcePlate, ...]:
    """The plates in newtons and without what they read while empty, by which feet can be told to stand; the same where
    they need neither.
    """
    loads = np.stack([np.nan_to_num(resample_wrench(plate, time))[:, 1] for plate in plates])
    most = float(loads.sum(axis=0).max()) / weight
    unit = 1.0
    if most < 0.5 * WALKING[0]:
        unit = next((u for u in FORCE_UNITS.values() if WALKING[0] < most * u < WALKING[1]), 1.0)
    empty = [unit * (empty_reading(plate, weight / unit) or 0.0) for plate in plates]
    if unit == 1.0 and max(abs(b) for b in empty) < LOADED_N:
        return plates
    return tuple(
        replace(plate, force=unit * plate.force - np.array([0.0, b, 0.0]), moment=unit * plate.moment)
        for plate, b in zip(plates, empty, strict=True)
    )


def standing_feet(plate: ForcePlate, time: Array, resting: BoolArray) -> IntArray:
    """(nf,) the foot that is down while the plate is loaded, by time alone: 0 right, 1 left, -1 none."""
    out = np.full(len(time), -1)
    for loaded in runs(np.nan_to_num(resample_wrench(plate, time))[:, 1] > LOADED_N):
        if duration(time, loaded) < SHORTEST:
            continue
        shares = [max((_common(loaded, down) for down in runs(resting[:, k])), default=0.0) for k in range(len(FEET))]
        if max(shares) > TOGETHER:
            out[loaded] = int(np.argmax(shares))
    return out


def _common(one: slice, other: slice) -> float:
    """Part of the time that two stretches cover in which both last."""
    both = min(one.stop, other.stop) - max(one.start, other.start)
    return float(max(0, both) / (max(one.stop, other.stop) - min(one.start, other.start)))


def side_carried(standing: IntArray) -> int | None:
    """The foot that a plate carries for most of the time."""
    counts = [int((standing == k).sum()) for k in range(len(FEET))]
    return int(np.argmax(counts)) if max(counts) else None


def off_feet(plates: tuple[ForcePlate, ...], standing: IntArray, time: Array, feet: FootPoints) -> bool:
    """Whether the load of a plate is not under the foot (plates, nf) that stands when it is loaded."""
    for plate, row in zip(plates, standing, strict=True):
        wrench = np.nan_to_num(resample_wrench(plate, time))
        for foot in range(len(FEET)):
            on = (row == foot) & (wrench[:, 1] > LOADED_N)
            if on.any():
                heel, toe = (path[on, foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                away = distance_to_line(centre_on_ground(wrench[on])[:, [0, 2]], heel, toe)
                if np.average(away, weights=wrench[on, 1]) > UNDER_FOOT:
                    return True
    return False
