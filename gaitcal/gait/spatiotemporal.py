"""Spatiotemporal measures of strides: speed, cadence, steps, stance, swing, supports; symmetry.

A stride of a foot goes from its strike at t0 to its next one at t1. With p(t) the horizontal
position of its heel and o(t) that of the other heel, both relative to the ground (p - v_belt t on a
treadmill, each foot with its belt), t_o the strike of the other foot in between, and s = p(t1) -
p(t0):

    stride length = |s|,   speed = |s| / (t1 - t0),   cadence = 120 / (t1 - t0)   (steps/min)
    step length   = (p(t1) - o(t_o)) . s / |s|,       step time = t1 - t_o
    step width    = distance of p(t1) from o(t_o) across s, positive where the right foot is on the
                    right of the left one

Each stride has its line of progression (Huxham, Gong, Baker, Morris & Iansek, Gait & Posture 2006),
so lengths and widths hold on straight walks, in turns, and for any direction in the room. The step
of a stride is the one that ends it: that of the leg that is named. Stance is from strike to off,
swing from off to the next strike. Double support is the part of a stance in which the other foot is
down as well, single support is the rest. Percents are of the stride. Vicon's programs measure
between the toe markers, which are further apart where toes point outwards: in five walks of a
hospital, their step width is 55 to 80 mm larger than between heels.

A stride in which the person turns (`gait/strides.py`) is measured along its line, too, and left out
of means. Feet that swing but travel less than a decimetre have no lengths: they step on the spot,
or on a belt whose motion is not known. A stride that the recording cuts gives the measures that it
shows: the stance of a last strike, the step to a first one (along the stride of the other foot,
where that is complete). At a strike where no marker shows the foot there are no lengths.

    symmetry index = 100 (R - L) / ((R + L) / 2)   (%)

of the means R and L of both legs over strides and trials (Robinson, Herzog & Nigg, J Manipulative
Physiol Ther 1987): 0 for equal legs, positive where the right one is larger. Its standard error is
from those of both means, with a standard deviation of strides of at least `LEAST_SD`: a frame of
double support is no asymmetry. The step width has no index, because it is one distance between both
feet. Means and standard deviations are those of `gait/ensemble.py`: each stride counts the same,
even where the recording shows only a part of it. Legs that are refused are left out, with steps and
supports, which need both feet: what makes markers or forces of a leg wrong may affect its times.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.errors import Code, Finding, Severity
from gaitcal.gait import ensemble, event_checks, moments
from gaitcal.gait.cycles import (
    CYCLE_RANGE,
    EventSource,
    FootEvents,
    is_stride,
    resample,
    select_between,
)
from gaitcal.gait.events import GaitEvents
from gaitcal.gait.strides import is_turning, measure_turn
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS, SIDES

PER_STRIDE: Final = 120.0
"""Cadence times stride time: two steps, sixty seconds."""
LEAST_STRIDE: Final = 0.1
"""m: shorter strides are steps on the spot, or on a belt whose motion is not known."""
LEAST_VALID: Final = 0.9
"""Part of a window that must be valid: a peak may be in the rest."""
OF_BOTH_LEGS: Final = ("step_width",)
"""Measures of both feet together, which have no symmetry."""
OF_BOTH_FEET: Final = ("step", "first_double", "second_double", "double", "single")
"""Beginnings of measures that need events or positions of the other foot as well."""
MEASURES: Final = {
    "speed": "m/s",
    "cadence": "steps/min",
    "stride_length": "m",
    "stride_time": "s",
    "step_length": "m",
    "step_width": "m",
    "step_time": "s",
    "stance": "s",
    "stance_percent": "%",
    "swing": "s",
    "swing_percent": "%",
    "first_double_support": "s",
    "first_double_support_percent": "%",
    "second_double_support": "s",
    "second_double_support_percent": "%",
    "double_support": "s",
    "double_support_percent": "%",
    "single_support": "s",
    "single_support_percent": "%",
}
"""Name -> unit, in the order of tables; `_percent` is of the stride."""
LEAST_SD: Final = {"s": 0.010, "%": 1.0, "m": 0.005, "m/s": 0.01, "steps/min": 1.0}
"""Unit -> standard deviation of a stride by the events and markers alone: 10 ms are a frame at 100
Hz.
"""


@dataclass(frozen=True, kw_only=True)
class Stride:
    """Measures of one stride of one foot, or of the part of it that the recording shows."""

    side: str
    """`r` or `l`."""
    number: int | None
    """From 1, as in `cycles.csv`; None where the recording contains only a part of the stride."""
    start: float | None
    """s, strike that begins it; None where it is not recorded."""
    stop: float | None
    """s, strike that ends it; None where it is not recorded."""
    sources: tuple[EventSource, ...]
    """Sources of these strikes."""
    measures: Mapping[str, float]
    """Name of `MEASURES` -> value; measures that are not known are absent."""
    line: float | None = None
    """rad, direction of progression to the left of the room's x axis; None where not known."""
    turn: float | None = None
    """deg, change of direction of the pelvis to the left; None where not known."""
    on_the_spot: bool = False
    """Whether the stride is shorter than `LEAST_STRIDE`: it has no lengths and no speed."""


@dataclass(frozen=True)
class _Heels:
    """Positions of both heels on the ground."""

    time: Array  # (nf,) s
    positions: Mapping[str, Array]
    """Side -> (nf, 2) m, forward and to the right, relative to the foot's belt; NaN where no
    marker shows the foot.
    """
    belts: Array  # (2, 3) m/s, velocity of the ground under the right and the left foot

    def locate(self, side: str, time: float) -> Array:
        """Interpolate the position (2,) m of a heel at a time (s)."""
        return resample(self.time, self.positions[side], np.array([time]))[0]

    def compute_belt_offset(self, side: str, time: float) -> Array:
        """Compute the displacement (2,) m of a foot's belt relative to the other one at a time."""
        belt, other = (self.belts[SIDES.index(s)] for s in (side, OTHER_SIDE[side]))
        return np.asarray((time - self.time[0]) * (belt - other)[[0, 2]])

    def measure_stride(self, side: str, period: tuple[float, float]) -> Array:
        """Measure the vector (2,) m of a stride of one foot."""
        return self.locate(side, period[1]) - self.locate(side, period[0])


def measure_strides(
    events: GaitEvents,
    time: Array,
    feet: FootPoints | None,
    hidden: Mapping[str, BoolArray] | None = None,
    facing: Array | None = None,
) -> tuple[Stride, ...]:
    """Measure every stride of both feet: right, then left, in order of time.

    Parameters
    ----------
    events : GaitEvents
        Events of the trial.
    time : (nf,) Array
        s.
    feet : FootPoints or None
        Heels in the laboratory's axes and the motion of the ground. None where the model has no
        feet: then only times are measured.
    hidden : mapping, optional
        `foot_r`, `foot_l` -> (nf,) frames in which no marker shows the foot.
    facing : (nf,) Array, optional
        rad, direction of the pelvis (`compute_facing`). Without it, turns are not known.

    Returns
    -------
    tuple of Stride
    """
    by_foot = {side: events.select_foot(side) for side in SIDES}
    heels = None if feet is None else _place_heels(time, feet, hidden or {})
    out: list[Stride] = []
    for side, other in OTHER_SIDE.items():
        foot, opposite, number = by_foot[side], by_foot[other], 0
        for start, stop in _list_spans(foot, opposite):
            whole = start is not None and stop is not None
            number += whole
            struck = None if stop is None else _find_step_start(foot, opposite, start, stop)
            measures = _measure_times(foot, opposite, start, stop, struck)
            period = _find_whole_stride(opposite, start, stop, struck)
            # m, x and z: displacement of the heel over one stride, against the ground or belt.
            along = np.full(2, np.nan)
            if heels is not None and stop is not None and period is not None:
                # A step to a first strike is measured along the stride of the other foot.
                along = heels.measure_stride(side if start is not None else other, period)
            length = float(np.linalg.norm(along))
            line, turn = None, None
            if heels is not None and length >= LEAST_STRIDE:
                line = float(np.arctan2(-along[1], along[0]))
                measures |= _measure_lengths(heels, side, along, start, stop, struck)
            if facing is not None and period is not None:
                turn = measure_turn(time, facing, *period)
            if measures:
                out.append(
                    Stride(
                        side=side,
                        number=number if whole else None,
                        start=start,
                        stop=stop,
                        sources=_list_sources(foot, start, stop),
                        measures={name: measures[name] for name in MEASURES if name in measures},
                        line=line,
                        turn=turn,
                        on_the_spot=length < LEAST_STRIDE,
                    )
                )
    return tuple(out)


def _place_heels(time: Array, feet: FootPoints, hidden: Mapping[str, BoolArray]) -> _Heels:
    """Place both heels relative to the ground; NaN where no marker shows the foot."""
    positions = {}
    for k, side in enumerate(SIDES):
        lost = hidden.get(f"foot_{side}", np.zeros(len(time), dtype=bool))
        position = feet.heel[:, k] - (time - time[0])[:, None] * feet.ground[k]
        positions[side] = np.where(lost[:, None], np.nan, position[:, [0, 2]])
    return _Heels(time, positions, feet.ground)


def _measure_lengths(
    heels: _Heels,
    side: str,
    along: Array,
    start: float | None,
    stop: float | None,
    struck: float | None,
) -> dict[str, float]:
    """Measure stride and step along the vector `along` (2,) m of a stride; finite values only."""
    lengths: dict[str, float] = {}
    length = float(np.linalg.norm(along))
    if stop is not None and start is not None:
        lengths |= {"stride_length": length, "speed": length / (stop - start)}
    if stop is not None and struck is not None:
        step = heels.locate(side, stop) - heels.locate(OTHER_SIDE[side], struck)
        step = step + heels.compute_belt_offset(side, stop)
        forward = along / length
        # To the right of the line; positive where the right foot is on the right of the left one.
        across = float(step @ np.array([-forward[1], forward[0]]))
        lengths["step_length"] = float(step @ forward)
        lengths["step_width"] = across if side == "r" else -across
    return {name: value for name, value in lengths.items() if np.isfinite(value)}


def _list_sources(
    foot: FootEvents, start: float | None, stop: float | None
) -> tuple[EventSource, ...]:
    """List the sources of the strikes of a stride, where they are known."""
    if len(foot.sources) != len(foot.strikes):
        return ()
    known = zip(foot.strikes, foot.sources, strict=True)
    return tuple(source for time, source in known if time in (start, stop))


def assign_stride_lines(strides: Sequence[Stride], time: Array) -> Array:
    """Assign each frame the line of progression of its stride, or of the nearest one.

    Parameters
    ----------
    strides : sequence of Stride
        Strides of the trial.
    time : (nf,) Array
        s.

    Returns
    -------
    (nf, 2) Array
        rad, to the left of the room's x axis; right, left. A foot without a stride takes those of
        the other one; 0 without any.
    """
    whole = [
        (s.side, s.start, s.stop, s.line) for s in strides if None not in (s.start, s.stop, s.line)
    ]
    out = np.zeros((len(time), len(SIDES)))
    if not whole:
        return out
    for k, side in enumerate(SIDES):
        rows = [row for row in whole if row[0] == side] or whole
        start, stop, line = np.array([row[1:] for row in rows], dtype=np.float64).T
        # s, distance of each frame from each stride; negative inside.
        away = np.maximum(start - time[:, None], time[:, None] - stop)
        out[:, k] = line[np.argmin(away, axis=1)]
    return out


def _list_spans(foot: FootEvents, other: FootEvents) -> list[tuple[float | None, float | None]]:
    """List pairs of consecutive strikes (s); None where a strike is missing or not recorded."""
    strikes: list[float] = foot.strikes.tolist()
    if not strikes:
        return []
    out: list[tuple[float | None, float | None]] = [(None, strikes[0])]
    for start, stop in itertools.pairwise(strikes):
        if is_stride(start, stop, foot, other):
            out.append((start, stop))
        else:
            out += [(start, None), (None, stop)]
    return [*out, (strikes[-1], None)]


def _measure_times(
    foot: FootEvents,
    other: FootEvents,
    start: float | None,
    stop: float | None,
    struck: float | None,
) -> dict[str, float]:
    """Measure times from events alone; `struck`: s, strike of the other foot before the step."""
    out: dict[str, float] = {}
    off = _find_off(foot, other, start, stop)
    if stop is not None and struck is not None:
        out["step_time"] = stop - struck
    if start is not None and off is not None:
        out["stance"] = off - start
        out |= event_checks.compute_double_support(other, start, off)
    if stop is not None and off is not None:
        out["swing"] = stop - off
    if start is not None and stop is not None:
        whole = stop - start
        out |= {"stride_time": whole, "cadence": PER_STRIDE / whole}
        for name in [n for n in out if f"{n}_percent" in MEASURES]:
            out[f"{name}_percent"] = 100.0 * out[name] / whole
    return out


def _find_off(
    foot: FootEvents, other: FootEvents, start: float | None, stop: float | None
) -> float | None:
    """Find the off of a stride: the first after its start, or the last before its stop.

    None where a strike is missing next to it: the other foot strikes twice in between.
    """
    low = start if start is not None else float(stop or 0.0) - CYCLE_RANGE[1]
    high = stop if stop is not None else low + CYCLE_RANGE[1]
    earlier, later = foot.strikes[foot.strikes < high], foot.strikes[foot.strikes > low]
    cut_before, cut_after = start is None and len(earlier) > 0, stop is None and len(later) > 0
    # An incomplete stride ends at the next known strike of the foot.
    if cut_before:
        low = max(low, float(earlier[-1]))
    if cut_after:
        high = min(high, float(later[0]))
    found = select_between(foot.toe_offs, low, high)
    if not len(found):
        return None
    # Two strikes of the other foot: an event is missing, so this off may be of another stride.
    crowded = len(select_between(other.strikes, low, high)) > 1
    if (cut_before or cut_after) and len(found) < 2 and crowded:
        return None
    off = float(found[0] if start is not None else found[-1])
    phase = (start, off) if start is not None else (off, high)
    return None if len(select_between(other.strikes, *phase)) > 1 else off


def _find_step_start(
    foot: FootEvents, other: FootEvents, start: float | None, stop: float
) -> float | None:
    """Find the strike (s) of the other foot from which a foot steps to its strike at `stop`."""
    # A step does not extend across another strike of the foot itself.
    since = max([stop - CYCLE_RANGE[1], *foot.strikes[foot.strikes < stop][-1:]])
    if start is not None:
        since = max(since, start)
    before = select_between(other.strikes, since, stop)
    return float(before[-1]) if len(before) else None


def _find_whole_stride(
    other: FootEvents, start: float | None, stop: float | None, struck: float | None
) -> tuple[float, float] | None:
    """Find a complete stride (s): of the foot, else of the other one in which it steps."""
    if start is not None and stop is not None:
        return start, stop
    if stop is None or struck is None:
        return None
    ahead = other.strikes[(other.strikes > stop) & (other.strikes <= struck + CYCLE_RANGE[1])]
    return (struck, float(ahead[0])) if len(ahead) else None


def is_usable_measure(name: str, side: str, refused: Sequence[str]) -> bool:
    """Check that a measure of a leg does not depend on a leg that the verdict refuses.

    Parameters
    ----------
    name : str
        Measure of `MEASURES`.
    side : {"r", "l"}
        Side of the leg.
    refused : sequence of str
        Sides that the verdict refuses.

    Returns
    -------
    bool
    """
    return side not in refused and not (refused and name.startswith(OF_BOTH_FEET))


def select_straight_strides(
    strides: Sequence[Stride], refused: Sequence[str] = ()
) -> tuple[Stride, ...]:
    """Select the strides that belong into means: straight ones, without measures of refused legs.

    Parameters
    ----------
    strides : sequence of Stride
        Strides of a trial.
    refused : sequence of str
        Sides that the verdict refuses.

    Returns
    -------
    tuple of Stride
    """
    out = []
    for stride in strides:
        if not is_turning(stride.turn):
            measures = {
                name: value
                for name, value in stride.measures.items()
                if is_usable_measure(name, stride.side, refused)
            }
            out.append(replace(stride, measures=measures))
    return tuple(out)


def check_strides(trial: str, strides: Sequence[Stride]) -> tuple[Finding, ...]:
    """Report strides in which the person turns, and those without progress.

    Parameters
    ----------
    trial : str
        Name of the trial.
    strides : sequence of Stride
        Strides of the trial.

    Returns
    -------
    tuple of Finding
    """
    whole = [s for s in strides if s.number]
    turning = [s for s in whole if is_turning(s.turn)]
    short = [s for s in whole if s.on_the_spot]
    no_lengths = (
        f"strides shorter than {LEAST_STRIDE:g} m, as on the spot or on a slow belt: no lengths, "
        "widths, speed"
    )
    kinds = (
        (Code.TURNING_STRIDES, turning, "strides turn", "left out of means of strides and steps"),
        (Code.ON_THE_SPOT, short, "feet swing without progress", no_lengths),
    )
    findings = []
    for code, found, cause, consequence in kinds:
        if found:
            finding = Finding(
                severity=Severity.INFO,
                topic="strides",
                where=trial,
                cause=cause,
                found=f"{_format_strides(found)}: {consequence}",
                code=code,
            )
            findings.append(finding)
    return tuple(findings)


def _format_strides(strides: Sequence[Stride]) -> str:
    """Format numbers of strides: `right 1 and 2, left 1 (by up to 48 deg)`."""
    by_side = []
    for side in SIDES:
        numbers = [str(s.number) for s in strides if s.side == side]
        if numbers:
            by_side.append(f"{SIDE_WORDS[side]} {moments.format_list(numbers)}")
    turns = [abs(s.turn) for s in strides if s.turn is not None and is_turning(s.turn)]
    return ", ".join(by_side) + (f" (by up to {max(turns):.0f} deg)" if turns else "")


@dataclass(frozen=True, kw_only=True)
class Average:
    """Statistics of one measure of one leg over strides and trials, in its unit."""

    n: int  # strides
    trials: int
    mean: float
    sd: float | None  # over all strides; None of one alone
    sd_within: float | None  # between strides of one trial; None where no trial has two
    sd_between: float | None  # between trials; None where it cannot be separated from `sd_within`


@dataclass(frozen=True)
class MeasureMeans:
    """One measure of both legs."""

    name: str  # of `MEASURES`
    unit: str
    right: Average | None  # None where no stride of that leg shows it
    left: Average | None

    @property
    def symmetry(self) -> float | None:
        """Symmetry index in %; None for step width, with one leg only, or where both are 0."""
        if self.name in OF_BOTH_LEGS or self.right is None or self.left is None:
            return None
        both = self.right.mean + self.left.mean
        return 200.0 * (self.right.mean - self.left.mean) / both if both != 0.0 else None

    @property
    def symmetry_error(self) -> float | None:
        """Standard error of `symmetry`, in %; None where there is no index."""
        if self.symmetry is None or self.right is None or self.left is None:
            return None
        right, left = (
            max(a.sd or 0.0, LEAST_SD[self.unit]) / a.n**0.5 for a in (self.right, self.left)
        )
        both = self.right.mean + self.left.mean
        return float(400.0 * np.hypot(self.left.mean * right, self.right.mean * left) / both**2)


def average_measures(strides: Mapping[str, Sequence[Stride]]) -> tuple[MeasureMeans, ...]:
    """Average every measure over strides and trials, in the order of `MEASURES`.

    Parameters
    ----------
    strides : mapping
        Trial -> its strides that belong into means.

    Returns
    -------
    tuple of MeasureMeans
        Measures that at least one stride has.
    """
    out = []
    for name, unit in MEASURES.items():
        right, left = (_average(strides, side, name) for side in SIDES)
        if right is not None or left is not None:
            out.append(MeasureMeans(name, unit, right, left))
    return tuple(out)


def _average(strides: Mapping[str, Sequence[Stride]], side: str, name: str) -> Average | None:
    """Average one measure of one side over strides and trials; None without any value."""
    values, trials = [], []
    for trial, members in strides.items():
        for stride in members:
            if stride.side == side and name in stride.measures:
                values.append([stride.measures[name]])
                trials.append(trial)
    if not values:
        return None
    found = ensemble.compute_statistics(np.array(values), np.array(trials))
    sd, within, between_trials = (
        float(value[0]) if np.isfinite(value[0]) else None
        for value in (found.sd, found.sd_within, found.sd_between)
    )
    return Average(
        n=len(values),
        trials=int(found.trials[0]),
        mean=float(found.mean[0]),
        sd=sd,
        sd_within=within,
        sd_between=between_trials,
    )
