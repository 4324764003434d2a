"""How a trial's signals are laid along the horizontal axis: by gait cycle, or by time where there is no full cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.ground_reactions import foot_points
from gaitcal.gait.cycles import (
    POINTS,
    FootEvents,
    GaitCycle,
    best_cycle,
    foot_events,
    gait_cycles,
    normalise,
    resample,
    stances,
)
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion

MOST_POINTS = 400
"""A plot against time shows no more: about one a pixel."""
MOST_OTHERS = 10
"""Further strides drawn thin beside the main one."""
SIDES = ("r", "l")


@dataclass(frozen=True)
class Layout:
    """The horizontal axis of one trial."""

    time: Array
    """(nf,) s."""
    valid: BoolArray
    """(nf,) torques may be used."""
    down: Mapping[str, tuple[tuple[float, float], ...]]
    """Side -> stretches (s) in which that foot is on the ground."""
    cycles: Mapping[str, tuple[GaitCycle, ...]]
    """Side -> complete cycles; empty where the trial is drawn against time."""

    @property
    def by_cycle(self) -> bool:
        """Whether signals are drawn over the gait cycle."""
        return bool(self.cycles)

    @property
    def xlabel(self) -> str:
        """Label of the horizontal axis."""
        return "gait cycle (%)" if self.by_cycle else "time (s)"

    @property
    def xlimits(self) -> tuple[float, float]:
        """Ends of the horizontal axis."""
        return (0.0, 100.0) if self.by_cycle else (float(self.time[0]), float(self.time[-1]))

    def main(self, side: str) -> GaitCycle:
        """The stride that is drawn in full: the one with the largest share of valid frames."""
        return best_cycle(self.cycles[side or "r"], self.time, self.valid)

    def drawn(self, side: str) -> BoolArray:
        """(nf,) frames of the main stride, or all."""
        if not self.by_cycle:
            return np.ones(len(self.time), dtype=bool)
        cycle = self.main(side)
        return np.asarray((self.time >= cycle.start) & (self.time <= cycle.stop), dtype=np.bool_)

    def lay(self, side: str, values: Array) -> tuple[Array, Array]:
        """X and y of the main stride, or of the whole trial; `values` (nf,)."""
        if self.by_cycle:
            return np.linspace(0.0, 100.0, POINTS), normalise(self.time, values, self.main(side))
        return thinned(self.time, values)

    def others(self, side: str, values: Array) -> list[tuple[Array, Array]]:
        """X and y of the other strides."""
        if not self.by_cycle:
            return []
        main = self.main(side)
        rest = [c for c in self.cycles[side or "r"] if c != main][:MOST_OTHERS]
        return [(np.linspace(0.0, 100.0, POINTS), normalise(self.time, values, c)) for c in rest]

    def stances(self, side: str) -> list[tuple[float, float]]:
        """Stretches of the horizontal axis in which a foot is on the ground."""
        if self.by_cycle:
            end = self.main(side).stance
            return [] if end is None else [(0.0, end)]
        return list(self.down.get(side, ()))


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Time and values (nf,) at no more than `MOST_POINTS` instants."""
    if len(time) <= MOST_POINTS:
        return time, values
    shown = np.linspace(time[0], time[-1], MOST_POINTS)
    return shown, resample(time, values, shown)


def layout(model: SubjectModel, motion: Motion, reactions: GroundReactions | None) -> Layout:
    """Over the gait cycle where both feet of a whole-body motion have a complete one, else against time."""
    time = motion.time
    valid = reactions.valid if reactions else np.ones(len(time), dtype=bool)
    loaded = reactions.loaded if reactions else np.zeros((len(time), 2), dtype=bool)
    events = trial_events(model, motion, loaded)
    cycles = {side: gait_cycles(found) for side, found in events.items()}
    down = {side: stances(found, time) for side, found in events.items()}
    return Layout(time, valid, down, cycles if all(cycles.values()) else {})


def trial_events(model: SubjectModel, motion: Motion, loaded: BoolArray) -> dict[str, FootEvents]:
    """Side -> strikes and toe-offs; `loaded` (nf, 2): a plate carries the right, the left foot."""
    time = motion.time
    heel: list[Array | None] = [None, None]
    toe: list[Array | None] = [None, None]
    if {f"{end}_{side}" for end in ("heel", "toe") for side in SIDES} <= set(model.landmarks):
        feet = foot_points(model, motion, model.parameters)
        pelvis = motion.q[:, motion.coordinates.index("pelvis_tx")]
        heel = [feet.heel[:, k, 0] - pelvis for k in (0, 1)]
        toe = [feet.toe[:, k, 0] - pelvis for k in (0, 1)]
    return {side: foot_events(time, loaded[:, k], heel[k], toe[k]) for k, side in enumerate(SIDES)}


def cycle_sentence(drawn: Layout) -> str:
    """What the horizontal axis is, in words."""
    if not drawn.by_cycle:
        return (
            "Drawn against time: this trial does not hold a complete gait cycle (foot strike to next foot strike of "
            "the same foot) of both feet."
        )
    right, left = (drawn.main(side) for side in SIDES)
    counts = [len(drawn.cycles[side]) for side in SIDES]
    text = (
        "0 to 100 % of the gait cycle, from foot strike to the next foot strike of the same foot: right "
        f"{right.start:.2f}–{right.stop:.2f} s, left {left.start:.2f}–{left.stop:.2f} s."
    )
    if max(counts) > 1:
        text += (
            f" Of {counts[0]} right and {counts[1]} left cycles the one with most valid frames is drawn in full, others"
            " thin."
        )
    return text
