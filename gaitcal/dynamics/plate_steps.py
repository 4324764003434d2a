"""Which foot a force plate carries: its loadings, each given to the foot under whose sole its centre of pressure lies.

A loading that two feet make one after the other is divided where the first has left the ground and the second rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import FootPoints, near
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import LOADED_N, centre_on_ground
from gaitcal.io.intervals import runs
from gaitcal.io.recording import ForcePlate

SIDE_WORDS = ("right", "left")
UNDER_FOOT = 0.15
"""m: largest distance of the centre of pressure from the line heel-toe of the foot that it belongs to."""
SHORTEST = 0.05
"""s: a shorter loading is a knock, not a step."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One loading of one plate by one foot."""

    foot: int
    """0 right, 1 left."""
    frames: slice
    plate: ForcePlate
    wrench: Array
    """(nf, 6) of the plate at all frames of the trial, not filtered."""
    words: str
    """Plate and time, for messages."""

    def at(self, frames: slice) -> bool:
        """Whether it lasts in some of these frames."""
        return bool(self.frames.start < frames.stop and frames.start < self.frames.stop)


def steps_on(
    plate: ForcePlate, wrench: Array, time: Array, feet: FootPoints, side: str | None
) -> tuple[list[Step], list[Finding]]:
    """The steps on one plate, and loadings that fit no foot.

    Parameters
    ----------
    wrench : (nf, 6) of the plate at the frames, not filtered.
    side : "r" or "l" where the study says whose plate it is; None: found.
    """
    steps, findings = [], []
    for stretch in runs(wrench[:, 1] > LOADED_N):
        if time[stretch.stop - 1] - time[stretch.start] < SHORTEST:
            continue
        foot = {"r": 0, "l": 1}[side] if side else foot_under(wrench, stretch, feet)
        if foot is None:
            findings.append(_under_neither(plate, _span(plate, time, stretch)))
            continue
        parts = [(stretch, foot)] if side else _divided(wrench, stretch, foot, time, feet)
        for frames, of in parts:
            words = _span(plate, time, frames)
            steps.append(Step(foot=of, frames=frames, plate=plate, wrench=wrench, words=words))
    return steps, findings


def foot_under(wrench: Array, stretch: slice, feet: FootPoints) -> int | None:
    """The foot whose heel-toe line is nearest to the centre of pressure, weighed by the load; None: far from both."""
    distances = [np.average(_away(wrench, stretch, feet, k), weights=wrench[stretch, 1]) for k in range(len(FEET))]
    best = int(np.argmin(distances))
    return best if distances[best] < UNDER_FOOT else None


def _divided(wrench: Array, stretch: slice, foot: int, time: Array, feet: FootPoints) -> list[tuple[slice, int]]:
    """The stretch, or its two parts, each with the foot that made it."""
    other = 1 - foot
    resting: BoolArray = feet.resting
    gone = ~near(resting[:, foot], time)[stretch] & resting[stretch, other]
    away, mine = (_away(wrench, stretch, feet, k) for k in (other, foot))
    taken = runs(gone & (away < np.minimum(mine, UNDER_FOOT)))
    long = [run for run in taken if time[stretch.start + run.stop - 1] - time[stretch.start + run.start] >= SHORTEST]
    if not long:
        return [(stretch, foot)]
    first, last = stretch.start + long[0].start, stretch.start + long[-1].stop
    if not resting[stretch, foot][: long[0].start].any():  # the other foot was there first
        return [(slice(stretch.start, last), other), (slice(last, stretch.stop), foot)]
    return [(slice(stretch.start, first), foot), (slice(first, stretch.stop), other)]


def _away(wrench: Array, stretch: slice, feet: FootPoints, foot: int) -> Array:
    """(n,) m from the centre of pressure to the line heel-toe of a foot."""
    centre = centre_on_ground(wrench[stretch])[:, [0, 2]]
    return distance_to_line(centre, feet.heel[stretch, foot][:, [0, 2]], feet.toe[stretch, foot][:, [0, 2]])


def distance_to_line(point: Array, a: Array, b: Array) -> Array:
    """(n,) m, from points (n, 2) to the stretches from a to b (n, 2)."""
    along = b - a
    t = np.clip(np.sum((point - a) * along, axis=1) / np.maximum(np.sum(along * along, axis=1), 1e-12), 0.0, 1.0)
    out: Array = np.linalg.norm(a + t[:, None] * along - point, axis=1)
    return out


def _span(plate: ForcePlate, time: Array, frames: slice) -> str:
    return f"plate {plate.name}, {time[frames.start]:.2f}-{time[frames.stop - 1]:.2f} s"


def _under_neither(plate: ForcePlate, span: str) -> Finding:
    return Finding(
        severity=Severity.WARNING,
        topic="plate to foot",
        where="",
        cause=f"the load on plate {plate.name} is under neither foot",
        found=f"{span}: its centre of pressure is further than {1e3 * UNDER_FOOT:.0f} mm from both feet; left out",
        cure="check the position of the plate (corners), the axes of the forces, and that they belong to this trial",
        code=Code.UNDER_NO_FOOT,
    )


def meeting(steps: Sequence[Step], foot: int, frames: slice) -> list[Step]:
    """The steps of a foot that last in some of these frames."""
    return [step for step in steps if step.foot == foot and step.at(frames)]
