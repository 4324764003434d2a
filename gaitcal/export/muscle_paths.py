"""Lengths and moment arms of the muscles of OpenSim models, by OpenSim itself where it is installed.

Every coordinate of the legs goes through its range, the others at their default. A moment arm r is minus the change of
a muscle's length with the coordinate, all constraints held. Between two neighbouring values the length must change by
-(r_1 + r_2) / 2 times the step; where it does not by more than `JUMP`, the muscle has jumped over a wrapping surface.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.osim_correspondence import LegJoint

VALUES = 13  # Of a coordinate, over its range
JUMP = 2e-3  # m; steps of a tenth of a range are too coarse to see less
CROSSES = 1e-4  # m, by which the length of a muscle changes with a coordinate that it crosses, at least


@dataclass(frozen=True, kw_only=True)
class MusclePath:
    """One muscle over the range of one coordinate."""

    muscle: str
    coordinate: str
    values: Array  # (n,) rad
    length: Array  # (n,) m
    arm: Array  # (n,) m

    @property
    def jumps(self) -> tuple[float, ...]:
        """rad, middles of the steps in which the length jumps."""
        step = np.diff(self.values)
        smooth = -0.5 * (self.arm[1:] + self.arm[:-1]) * step
        found = np.abs(np.diff(self.length) - smooth) > JUMP
        return tuple(float(v) for v in (self.values[:-1] + 0.5 * step)[found])


@dataclass(frozen=True, kw_only=True)
class MuscleChange:
    """A muscle about a coordinate, before and after."""

    before: MusclePath
    after: MusclePath

    @property
    def worst(self) -> int:
        """Where in the range its moment arm changes most."""
        return int(np.argmax(np.abs(self.after.arm - self.before.arm)))

    @property
    def lengthened(self) -> float:
        """m, the largest change of its length, with its sign."""
        by = self.after.length - self.before.length
        return float(by[np.argmax(np.abs(by))])

    @property
    def new_jumps(self) -> tuple[float, ...]:
        """rad, where the muscle jumps that did not before."""
        return tuple(v for v in self.after.jumps if v not in self.before.jumps)


def opensim_is_installed() -> bool:
    """Whether muscles can be looked at."""
    return find_spec("opensim") is not None


def leg_ranges(legs: Sequence[LegJoint]) -> dict[str, Array]:
    """Coordinate of the model's legs -> (n,) rad, its range; locked ones are left out."""
    return {
        c.name: np.linspace(c.low, c.high, VALUES)
        for leg in legs
        for c in leg.theirs.coordinates
        if not c.locked and c.high > c.low and any(a.coordinate == c.name and a.rotates for a in leg.theirs.axes or ())
    }


def muscle_paths(osim: Path, ranges: Mapping[str, Array]) -> dict[tuple[str, str], MusclePath]:
    """(muscle, coordinate) -> its path, of every muscle that crosses the coordinate.

    Raises InputError: OpenSim cannot load or assemble the model.
    """
    import opensim  # type: ignore[import-untyped,import-not-found,unused-ignore]

    opensim.Logger.removeFileSink()  # it writes opensim.log where the user stands
    opensim.Logger.setLevelString("Off")
    out = {}
    try:
        model = opensim.Model(str(osim))
        state = model.initSystem()
        found = model.getMuscles()
        muscles = [found.get(i) for i in range(found.getSize())]
        rest = opensim.Vector(state.getQ())
        for name, values in ranges.items():
            coordinate = model.getCoordinateSet().get(name)
            lengths = np.empty((len(values), len(muscles)))
            postures = []
            for i, value in enumerate(values):
                coordinate.setValue(state, float(value), False)
                model.realizePosition(state)
                if np.abs(state.getQErr().to_numpy()).max(initial=0.0) > model.get_assembly_accuracy():
                    model.assemble(state)  # takes longer than all the rest, and only a patella needs it
                    model.realizePosition(state)
                postures.append(opensim.Vector(state.getQ()))
                lengths[i] = [m.getLength(state) for m in muscles]
            crossing = np.flatnonzero(np.ptp(lengths, axis=0) > CROSSES)
            arms = np.empty((len(values), len(crossing)))
            for i, posture in enumerate(postures):
                state.setQ(posture)
                model.realizePosition(state)
                arms[i] = [muscles[k].computeMomentArm(state, coordinate) for k in crossing]
            state.setQ(rest)
            for k, arm in zip(crossing, arms.T, strict=True):
                muscle = muscles[k].getName()
                out[muscle, name] = MusclePath(
                    muscle=muscle, coordinate=name, values=values, length=lengths[:, k], arm=arm
                )
    except RuntimeError as error:
        message = f"OpenSim cannot use it: {' '.join(str(error).split())[:300]}"
        raise InputError(message, source=osim, code=Code.OTHER_MODEL) from None
    return out


def muscle_changes(
    before: Mapping[tuple[str, str], MusclePath], after: Mapping[tuple[str, str], MusclePath]
) -> list[MuscleChange]:
    """Muscles that cross a coordinate in both models, the largest change of a moment arm first."""
    both = [MuscleChange(before=path, after=after[key]) for key, path in before.items() if key in after]
    return sorted(both, key=lambda c: -float(np.abs(c.after.arm - c.before.arm).max()))


def arm_deviations(change: MuscleChange, draws: Sequence[Mapping[tuple[str, str], MusclePath]]) -> Array | None:
    """(n,) m, standard deviations of its moment arm over draws of the model; None with fewer than two."""
    key = change.before.muscle, change.before.coordinate
    arms = np.array([draw[key].arm for draw in draws if key in draw])
    return arms.std(axis=0, ddof=1) if len(arms) > 1 else None


MUSCLES_HEADER = "muscle,coordinate,deg,length_before_mm,length_after_mm,arm_before_mm,arm_after_mm,arm_sd_mm"


def muscles_csv(changes: Sequence[MuscleChange], draws: Sequence[Mapping[tuple[str, str], MusclePath]] = ()) -> str:
    """A row for every muscle, coordinate and value; `arm_sd_mm` is empty with fewer than two draws."""
    lines = [MUSCLES_HEADER]
    for change in changes:
        key, spread = (change.before.muscle, change.before.coordinate), arm_deviations(change, draws)
        for k, value in enumerate(change.before.values):
            figures = (
                (p.length[k] for p in (change.before, change.after)),
                (p.arm[k] for p in (change.before, change.after)),
            )
            words = [f"{1e3 * x:.4f}" for pair in figures for x in pair]
            last = "" if spread is None else f"{1e3 * spread[k]:.4f}"
            lines.append(",".join([f'"{key[0]}"', f'"{key[1]}"', f"{np.degrees(value):.3f}", *words, last]))
    return "\n".join(lines) + "\n"
