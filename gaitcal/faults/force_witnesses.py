"""What else bears witness to a fault of the forces: the foot under the centre of pressure, and the empty plate.

For each plate and the foot that stands while it is loaded, with c the centre of pressure averaged by the load over
frames of more than `LOADED` of body weight, h and t heel and toe, L = |t - h|, u = (t - h) / L, n across u:

    z = (n . (c - h)) / ACROSS_M,     z = (u . (c - h) - MIDDLE L) / ALONG_M

and for each plate that is ever empty, with its reading b there and an offset x that a cause takes away:

    z = (b - x) / EMPTY_N

A cause gains sum (rho(z_0) - rho(z)) / 2 with rho(z) = WIDE^2 log(1 + z^2 / WIDE^2), so that no witness is believed
beyond all bounds (Cauchy-like).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.io.force_plate import centre_on_ground
from gaitcal.io.intervals import duration, runs
from gaitcal.io.recording import ForcePlate

ACROSS_M, ALONG_M, MIDDLE = 0.020, 0.050, 0.70
"""Over 39 steps of clean walks, centres of pressure lie 2 (SD 15) mm outside the line heel-toe, and at 0.69 (SD 0.21,
steps cut short by the end of the valid frames included) of its 150 to 290 mm."""
LOADED, FEWEST = 0.4, 4
"""Of body weight; frames."""
EMPTY_N = 10.0
"""N: unloaded plates read so much with nothing wrong."""
WIDE = 3.0
QUIET_N, QUIET_S = 10.0, 0.1
"""An empty plate's reading stays this close to its own low for at least so long."""
EMPTY_SHARE = 0.3
"""Of body weight: a steady low reading above it is somebody standing."""


@dataclass(frozen=True, kw_only=True)
class Sole:
    """A foot on a plate."""

    plate: int
    frames: IntArray
    """Of the evidence."""
    heel: Array
    """(n, 2) m, x and z."""
    toe: Array
    """(n, 2) m."""


def soles_of(standing: IntArray, frames: IntArray, feet: FootPoints) -> tuple[Sole, ...]:
    """Every foot on every plate: `standing` (plates, k) as in the evidence, whose frames of the trial are `frames`."""
    out = []
    for plate, row in enumerate(standing):
        for foot in range(len(FEET)):
            on = np.flatnonzero(row == foot)
            if len(on) >= FEWEST:
                heel, toe = (path[frames[on], foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                out.append(Sole(plate=plate, frames=on, heel=heel, toe=toe))
    return tuple(out)


def empty_reading(plate: ForcePlate, weight: float) -> float | None:
    """N of vertical force while nobody is on the plate; None where somebody always is."""
    up = np.nan_to_num(plate.force[:, 1])
    low = float(np.quantile(up, 0.05))
    quiet = [run for run in runs(np.abs(up - low) < QUIET_N) if duration(plate.time, run) >= QUIET_S]
    if not quiet:
        return None
    longest = max(quiet, key=lambda run: run.stop - run.start)
    reading = float(np.median(up[longest]))
    return reading if abs(reading) < EMPTY_SHARE * weight else None


def under_feet(wrenches: Array, soles: Sequence[Sole], heights: Array, weight: float) -> Array:
    """(2 soles,) z of wrenches (plates, k, 6) on plates of `heights` (plates,) m; 0 where one carries too little."""
    out = np.zeros((len(soles), 2))
    for i, sole in enumerate(soles):
        wrench = wrenches[sole.plate, sole.frames]
        on = wrench[:, 1] > LOADED * weight
        if on.sum() < FEWEST:
            continue
        centre = centre_on_ground(wrench[on], float(heights[sole.plate]))[:, [0, 2]]
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
    """Nats that witnesses (n,) speak against what they are held against."""
    return float(0.5 * WIDE**2 * np.log1p((z / WIDE) ** 2).sum())
