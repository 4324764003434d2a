"""Where and when the feet are put down: speed, cadence, steps, stance and swing; means, and how
alike both legs are.

A stride of a foot goes from its strike at t0 to its next one at t1. With p(t) the horizontal place
of its heel and o(t) that of the other one, both against the ground (a treadmill's belt is taken
off: p - v_belt t, of split belts each foot's own; a step goes beyond where the belt has the other
foot at its end), t_o the other foot's strike between, s the vector p(t1) - p(t0):

    stride length = |s|,   speed = |s| / (t1 - t0),   cadence = 120 / (t1 - t0)  (steps a minute, two steps a stride)
    step length   = (p(t1) - o(t_o)) . s / |s|,       step time = t1 - t_o
    step width    = distance of p(t1) from o(t_o) across s, positive where the right foot is right of the left one

The line of progression is that of each stride by itself (Huxham, Gong, Baker, Morris & Iansek, Gait
& Posture 2006), so that lengths and widths hold on straight walks, in turns, and for any direction
in the room. The step of a stride is the one that ends it: that of the leg that is named. Stance
lasts from strike to off, swing from off to the next strike; double support is the part of a stance
in which the other foot is down, too, single support the rest of it. Percent are of the stride.
Vicon's programs measure between the toe markers, which are further apart as toes point outwards: in
five walks of a hospital its step width is 55 to 80 mm larger than between heels.

A stride that turns (`gait/strides.py`) is measured along its own line, too, and left out of means.
Feet that swing and get no further than a decimetre have no lengths: they step on the spot, or on a
belt that looks like a floor. A stride that the recording cuts counts for what it shows: the stance
of a last strike, the step to a first one (along the other foot's stride, where that is whole).
Nothing is told of a foot at a strike at which no marker shows it.

    symmetry index = 100 (R - L) / ((R + L) / 2)   (%)

of the means R and L of both legs over strides and trials (Robinson, Herzog & Nigg, J Manipulative
Physiol Ther 1987): 0 where they are alike, positive where the right one is larger. Its standard
error is that of both means, whose strides vary by what they are seen to, and at least by
`LEAST_SD`: a frame of double support is no asymmetry. There is none of the step width, which is one
distance between both feet. Mean and standard deviations are those of `gait/ensemble.py`: each
stride counts the same, also where the recording shows a part of it. Legs that are refused are left
out, with steps and supports beside them, to which both feet belong: what makes a leg's markers or
forces wrong, or of the other side, need not spare its clock.
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

PER_STRIDE: Final = 120.0  # two steps, sixty seconds
# m: feet that swing and get no further step on the spot, or on a belt that nothing tells of
LEAST_STRIDE: Final = 0.1
LEAST_VALID: Final = (
    0.9  # part of a stride that must be valid: the peak of a curve that is not seen is not known
)
OF_BOTH_LEGS: Final = (
    "step_width",
)  # one distance between both feet, told at the strikes of either
OF_BOTH_FEET: Final = ("step", "first_double", "second_double", "double", "single")
"""How measures begin that need the other foot's events or place, too."""
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
    """What one stride of one foot measures, or the part of it that the recording shows."""

    side: str  # `r` or `l`
    number: (
        int | None
    )  # from 1, as in `cycles.csv`; None where the recording holds only a part of it
    start: float | None  # s, the strike that begins it; None where it is not recorded
    stop: float | None  # s, the strike that ends it
    sources: tuple[EventSource, ...]  # what told these strikes
    measures: Mapping[str, float]  # name of `MEASURES` -> value; what is not known is absent
    line: float | None = (
        None  # rad, direction of progression, to the left of the room's x axis; None: not known
    )
    turn: float | None = None  # deg to the left by which the pelvis turns in it; None: not known
    on_the_spot: bool = False  # the feet swing and get no further: without lengths and speed


def measure_strides(
    events: GaitEvents,
    time: Array,
    feet: FootPoints | None,
    unseen: Mapping[str, BoolArray] | None = None,
    faced: Array | None = None,
) -> tuple[Stride, ...]:
    """Of every stride of both feet: right, then left, in order of time.

    `events`: of the trial. `time`: (nf,) s. `feet`: heels on the laboratory's axes, and how the
    ground moves; None where the model has none: times alone. `unseen`: `foot_r`, `foot_l` -> (nf,)
    frames in which no marker shows the foot. `faced`: (nf,) rad, where the pelvis points
    (`gait/strides.py`); None: whether a stride turns is not known.
    """
    of_feet = {side: events.select_foot(side) for side in SIDES}
    places: dict[
        str, Array
    ] = {}  # side -> (nf, 2) m, forward and to the right; NaN where no marker shows the foot
    if feet is not None:
        for k, side in enumerate(SIDES):
            lost = (unseen or {}).get(f"foot_{side}", np.zeros(len(time), dtype=bool))
            against_ground = feet.heel[:, k] - (time - time[0])[:, None] * feet.ground[k]
            places[side] = np.where(lost[:, None], np.nan, against_ground[:, [0, 2]])

    def heel(side: str, when: float) -> Array:
        return resample(time, places[side], np.array([when]))[0]

    def apart(side: str, when: float) -> Array:
        """How far a foot's belt has come beyond the other one's, whose foot it carries on until
        then.
        """
        if feet is None:
            return np.zeros(2)
        own, other = (feet.ground[SIDES.index(s)] for s in (side, OTHER_SIDE[side]))
        return np.asarray((when - time[0]) * (own - other)[[0, 2]])

    out: list[Stride] = []
    for side, other in OTHER_SIDE.items():
        foot, opposite, number = of_feet[side], of_feet[other], 0
        for start, stop in _list_spans(foot, opposite):
            whole = start is not None and stop is not None
            number += whole
            struck = None if stop is None else _find_step_start(foot, opposite, start, stop)
            measures, lengths = (
                _measure_times(foot, opposite, start, stop, struck),
                dict[str, float](),
            )
            period = _find_whole_stride(opposite, start, stop, struck)
            along, length = np.full(2, np.nan), np.nan  # m, of the stride
            if places and stop is not None and period is not None:
                stepping = side if start is not None else other
                along = heel(stepping, period[1]) - heel(stepping, period[0])
                length = float(np.linalg.norm(along))
            gets_further = length >= LEAST_STRIDE
            if gets_further and stop is not None and start is not None:
                lengths |= {"stride_length": length, "speed": length / (stop - start)}
            if gets_further and stop is not None and struck is not None:
                step, forward = (
                    heel(side, stop) - heel(other, struck) + apart(side, stop),
                    along / length,
                )
                across = float(step @ np.array([-forward[1], forward[0]]))
                lengths |= {
                    "step_length": float(step @ forward),
                    "step_width": across if side == "r" else -across,
                }
            measures |= {name: value for name, value in lengths.items() if np.isfinite(value)}
            sources: list[EventSource] = []
            if len(foot.sources) == len(foot.strikes):
                sources = [
                    s for t, s in zip(foot.strikes, foot.sources, strict=True) if t in (start, stop)
                ]
            if measures:
                out.append(
                    Stride(
                        side=side,
                        number=number if whole else None,
                        start=start,
                        stop=stop,
                        sources=tuple(sources),
                        measures={name: measures[name] for name in MEASURES if name in measures},
                        line=float(np.arctan2(-along[1], along[0])) if gets_further else None,
                        turn=None
                        if faced is None or period is None
                        else measure_turn(time, faced, *period),
                        on_the_spot=length < LEAST_STRIDE,
                    )
                )
    return tuple(out)


def assign_stride_lines(strides: Sequence[Stride], time: Array) -> Array:
    """(nf, 2) rad: line of progression at each time (nf,) s for the right and the left foot.

    Of the foot's stride around it, else of the nearest one, of either foot where one has none; 0
    without any.
    """
    whole = [
        (s.side, s.start, s.stop, s.line) for s in strides if None not in (s.start, s.stop, s.line)
    ]
    out = np.zeros((len(time), len(SIDES)))
    for k, side in enumerate(SIDES):
        if of_foot := [row for row in whole if row[0] == side] or whole:
            start, stop, line = np.array([row[1:] for row in of_foot], dtype=np.float64).T
            away = np.maximum(start - time[:, None], time[:, None] - stop)
            out[:, k] = line[np.argmin(away, axis=1)]
    return out


def _list_spans(foot: FootEvents, other: FootEvents) -> list[tuple[float | None, float | None]]:
    """From each strike to the next, from before the first and to after the last; apart where it is
    no stride.
    """
    strikes: list[float] = foot.strikes.tolist()
    if not strikes:
        return []
    out: list[tuple[float | None, float | None]] = [(None, strikes[0])]
    for start, stop in itertools.pairwise(strikes):
        out += (
            [(start, stop)]
            if is_stride(start, stop, foot, other)
            else [(start, None), (None, stop)]
        )
    return [*out, (strikes[-1], None)]


def _measure_times(
    foot: FootEvents,
    other: FootEvents,
    start: float | None,
    stop: float | None,
    struck: float | None,
) -> dict[str, float]:
    """What events alone tell; `struck`: when the other foot began the step that ends the stride."""
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
    """The off of a stride: the first one after its start; the last one before its stop, where the
    start is unknown.

    None where a strike is missing beside it: two strikes of the other foot between.
    """
    low = start if start is not None else float(stop or 0.0) - CYCLE_RANGE[1]
    high = stop if stop is not None else low + CYCLE_RANGE[1]
    earlier, later = foot.strikes[foot.strikes < high], foot.strikes[foot.strikes > low]
    cut_before, cut_after = start is None and len(earlier), stop is None and len(later)
    low, high = (
        max(low, float(earlier[-1])) if cut_before else low,
        min(high, float(later[0])) if cut_after else high,
    )
    found = select_between(foot.toe_offs, low, high)
    if not len(found) or (
        (cut_before or cut_after)
        and len(found) < 2
        and len(select_between(other.strikes, low, high)) > 1
    ):
        return None
    off = float(found[0] if start is not None else found[-1])
    phase = (
        select_between(other.strikes, start, off)
        if start is not None
        else select_between(other.strikes, off, high)
    )
    return None if len(phase) > 1 else off


def _find_step_start(
    foot: FootEvents, other: FootEvents, start: float | None, stop: float
) -> float | None:
    """s, the other foot's strike from which a foot steps to its own one at `stop`."""
    earlier = foot.strikes[foot.strikes < stop]  # not across a strike of its own
    since = max([stop - CYCLE_RANGE[1], *([] if start is None else [start]), *earlier[-1:]])
    before = select_between(other.strikes, since, stop)
    return float(before[-1]) if len(before) else None


def _find_whole_stride(
    other: FootEvents, start: float | None, stop: float | None, struck: float | None
) -> tuple[float, float] | None:
    """A whole stride (s): that of the foot, else that of the other one in which it steps; None
    where neither is.
    """
    if start is not None and stop is not None:
        return start, stop
    if stop is None or struck is None:
        return None
    ahead = other.strikes[(other.strikes > stop) & (other.strikes <= struck + CYCLE_RANGE[1])]
    return (struck, float(ahead[0])) if len(ahead) else None


def is_usable_measure(name: str, side: str, refused: Sequence[str]) -> bool:
    """Whether a measure of a leg may be used where the verdict refuses the legs `refused`."""
    return side not in refused and not (refused and name.startswith(OF_BOTH_FEET))


def select_straight_strides(
    strides: Sequence[Stride], refused: Sequence[str] = ()
) -> tuple[Stride, ...]:
    """The strides of a trial that belong into means: straight ones, without what needs a leg that
    is refused.
    """
    return tuple(
        replace(
            s,
            measures={n: v for n, v in s.measures.items() if is_usable_measure(n, s.side, refused)},
        )
        for s in strides
        if not is_turning(s.turn)
    )


def check_strides(trial: str, strides: Sequence[Stride]) -> tuple[Finding, ...]:
    """What to say of strides that turn, and of those that get no further."""
    whole = [s for s in strides if s.number]
    short = (
        f"less than {LEAST_STRIDE:g} m a stride, as on the spot or on a slow belt: no lengths, "
        "widths, speed"
    )
    left_out = "left out of means of strides and steps"
    kinds = (
        (Code.TURNING_STRIDES, [s for s in whole if is_turning(s.turn)], "strides turn", left_out),
        (
            Code.ON_THE_SPOT,
            [s for s in whole if s.on_the_spot],
            "feet swing and get no further",
            short,
        ),
    )
    return tuple(
        Finding(
            severity=Severity.INFO,
            topic="strides",
            where=trial,
            cause=cause,
            found=f"{_format_strides(found)}: {so}",
            code=code,
        )
        for code, found, cause, so in kinds
        if found
    )


def _format_strides(strides: Sequence[Stride]) -> str:
    """`right 1 and 2, left 1 (turned by 48 deg at most)`."""
    numbers = {side: [str(s.number) for s in strides if s.side == side] for side in SIDES}
    by_side = [
        f"{SIDE_WORDS[side]} {moments.format_list(of_side)}"
        for side, of_side in numbers.items()
        if of_side
    ]
    most = max(
        (abs(s.turn) for s in strides if is_turning(s.turn) and s.turn is not None), default=None
    )
    return ", ".join(by_side) + ("" if most is None else f" (by up to {most:.0f} deg)")


@dataclass(frozen=True, kw_only=True)
class Average:
    """One measure of one leg over strides and trials, in its unit."""

    n: int  # strides
    trials: int
    mean: float
    sd: float | None  # over all strides; None of one alone
    sd_within: float | None  # between strides of one trial; None where no trial has two
    sd_between: float | None  # between trials; None where it cannot be told from `sd_within`


@dataclass(frozen=True)
class MeasureMeans:
    """One measure of both legs."""

    name: str  # of `MEASURES`
    unit: str
    right: Average | None  # None where no stride of that leg shows it
    left: Average | None

    @property
    def symmetry(self) -> float | None:
        """%, of the means; None where a leg has none, both are 0, or the measure is one of both
        legs.
        """
        if self.name in OF_BOTH_LEGS:
            return None
        if self.right is None or self.left is None or self.right.mean + self.left.mean == 0.0:
            return None
        return 200.0 * (self.right.mean - self.left.mean) / (self.right.mean + self.left.mean)

    @property
    def symmetry_error(self) -> float | None:
        """%, standard error of `symmetry`; None where there is none."""
        if self.symmetry is None or self.right is None or self.left is None:
            return None
        right, left = (
            max(a.sd or 0.0, LEAST_SD[self.unit]) / a.n**0.5 for a in (self.right, self.left)
        )
        both = self.right.mean + self.left.mean
        return float(400.0 * np.hypot(self.left.mean * right, self.right.mean * left) / both**2)


def average_measures(strides: Mapping[str, Sequence[Stride]]) -> tuple[MeasureMeans, ...]:
    """Of every measure that some stride shows, in the order of `MEASURES`; `strides`: trial ->
    those that count.
    """
    out = []
    for name, unit in MEASURES.items():
        right, left = (_average(strides, side, name) for side in SIDES)
        if right is not None or left is not None:
            out.append(MeasureMeans(name, unit, right, left))
    return tuple(out)


def _average(strides: Mapping[str, Sequence[Stride]], side: str, name: str) -> Average | None:
    measured = [(trial, s.measures) for trial, of in strides.items() for s in of if s.side == side]
    known = [(trial, measures[name]) for trial, measures in measured if name in measures]
    if not known:
        return None
    found = ensemble.compute_statistics(
        np.array([[value] for _, value in known]), np.array([trial for trial, _ in known])
    )
    sd, within, between_trials = (
        float(value[0]) if np.isfinite(value[0]) else None
        for value in (found.sd, found.sd_within, found.sd_between)
    )
    return Average(
        n=len(known),
        trials=int(found.trials[0]),
        mean=float(found.mean[0]),
        sd=sd,
        sd_within=within,
        sd_between=between_trials,
    )
