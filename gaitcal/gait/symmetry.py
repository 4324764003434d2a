"""Means of what strides measure, leg by leg over strides and trials, and how alike both legs are.

    symmetry index = 100 (R - L) / ((R + L) / 2)   (%)

of the means R and L of both legs (Robinson, Herzog & Nigg, J Manipulative Physiol Ther 1987): 0 where they are alike,
positive where the right one is larger. There is none of the step width, which is one distance between both feet. Mean
and standard deviations are those of `gait/spread.py`: each stride counts the same, also one of which the recording
shows a part. Strides that turn are left out, and legs that are refused, with steps and supports beside them, to which
both feet belong: what makes a leg's markers or forces wrong, or of the other side, need not spare its clock.

Peaks of a curve over strides: each stride's own, then their mean and standard deviation.

A stride of which little is valid says nothing of its peak: it counts where at least `LEAST_VALID` of its percents are
valid. Of one stride alone the standard error of its peak stands for the deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.findings import Finding, Severity
from gaitcal.gait.ensemble import spread
from gaitcal.gait.events import SIDES
from gaitcal.gait.moments import SIDE_WORDS, listed
from gaitcal.gait.spatiotemporal import LEAST_STRIDE, MEASURES, Stride
from gaitcal.gait.strides import turns

OF_BOTH_LEGS: Final = ("step_width",)
"""One distance between both feet, told at the strikes of either."""
OF_BOTH_FEET: Final = ("step", "first_double", "second_double", "double", "single")
"""How measures begin that need the other foot's events or place, too."""


def counts(name: str, side: str, refused: Sequence[str]) -> bool:
    """Whether a measure of a leg may be used where the verdict refuses the legs `refused`."""
    return side not in refused and not (refused and name.startswith(OF_BOTH_FEET))


def counting(strides: Sequence[Stride], refused: Sequence[str] = ()) -> tuple[Stride, ...]:
    """The strides of a trial that belong into means: straight ones, without what needs a leg that is refused."""
    return tuple(
        replace(s, measures={n: v for n, v in s.measures.items() if counts(n, s.side, refused)})
        for s in strides
        if not turns(s.turn)
    )


def stride_findings(trial: str, strides: Sequence[Stride]) -> tuple[Finding, ...]:
    """What to say of strides that turn, and of those that get no further."""
    told = (
        (
            Code.TURNING_STRIDES,
            [s for s in strides if s.number and turns(s.turn)],
            "strides turn",
            "left out of means of strides and steps",
        ),
        (
            Code.ON_THE_SPOT,
            [s for s in strides if s.number and s.on_the_spot],
            "feet swing and get no further",
            f"less than {LEAST_STRIDE:g} m a stride, as on the spot or on a slow belt: no lengths, widths, speed",
        ),
    )
    return tuple(
        Finding(
            severity=Severity.INFO,
            topic="strides",
            where=trial,
            cause=cause,
            found=f"{_named(of)}: {so}",
            cure="",
            code=code,
        )
        for code, of, cause, so in told
        if of
    )


def _named(strides: Sequence[Stride]) -> str:
    """`right 1 and 2, left 1 (turned by 48 deg at most)`."""
    by_side = [
        f"{SIDE_WORDS[side]} {listed([str(s.number) for s in strides if s.side == side])}"
        for side in SIDES
        if any(s.side == side for s in strides)
    ]
    most = max((abs(s.turn) for s in strides if turns(s.turn) and s.turn is not None), default=None)
    return ", ".join(by_side) + ("" if most is None else f" (by up to {most:.0f} deg)")


@dataclass(frozen=True, kw_only=True)
class Average:
    """One measure of one leg over strides and trials, in its unit."""

    n: int
    """Strides."""
    trials: int
    mean: float
    sd: float | None
    """Over all strides; None of one alone."""
    sd_within: float | None
    """Between strides of one trial; None where no trial has two."""
    sd_between: float | None
    """Between trials; None where it cannot be told from `sd_within`."""


@dataclass(frozen=True)
class MeasureMeans:
    """One measure of both legs."""

    name: str
    """Of `MEASURES`."""
    unit: str
    right: Average | None
    """None where no stride of that leg shows it."""
    left: Average | None

    @property
    def symmetry(self) -> float | None:
        """%, of the means; None where a leg has none, both are 0, or the measure is one of both legs."""
        if self.name in OF_BOTH_LEGS:
            return None
        if self.right is None or self.left is None or self.right.mean + self.left.mean == 0.0:
            return None
        return 200.0 * (self.right.mean - self.left.mean) / (self.right.mean + self.left.mean)


def measure_means(strides: Mapping[str, Sequence[Stride]]) -> tuple[MeasureMeans, ...]:
    """Of every measure that some stride shows, in the order of `MEASURES`; `strides`: trial -> those that count."""
    out = []
    for name, unit in MEASURES.items():
        right, left = (_average(strides, side, name) for side in ("r", "l"))
        if right is not None or left is not None:
            out.append(MeasureMeans(name, unit, right, left))
    return tuple(out)


def _average(strides: Mapping[str, Sequence[Stride]], side: str, name: str) -> Average | None:
    known = [
        (trial, s.measures[name]) for trial, of in strides.items() for s in of if s.side == side if name in s.measures
    ]
    if not known:
        return None
    found = spread(np.array([[value] for _, value in known]), np.array([trial for trial, _ in known]))

    def figure(value: np.ndarray) -> float | None:
        return float(value[0]) if np.isfinite(value[0]) else None

    return Average(
        n=len(known),
        trials=int(found.trials[0]),
        mean=float(found.mean[0]),
        sd=figure(found.sd),
        sd_within=figure(found.sd_within),
        sd_between=figure(found.sd_between),
    )


LEAST_VALID: Final = 0.9
"""Part of a stride that must be valid: the peak of a curve that is not seen is not known."""


@dataclass(frozen=True, kw_only=True)
class StridePeaks:
    """The largest values of a curve in the strides of a leg."""

    mean: float
    """Over the strides that count; NaN where none does."""
    error: float
    """Standard deviation over them; of one alone, the standard error of its peak; NaN where it is not known."""
    count: int
    """Strides that count."""
    strides: int
    """All that were looked at."""


def stride_peaks(values: Array, errors: Array) -> StridePeaks:
    """Of the largest value of each stride.

    Parameters
    ----------
    values : (n, points) n strides; NaN where a value is not valid.
    errors : (n, points) standard errors; NaN where not known.
    """
    counting = np.flatnonzero(np.isfinite(values).mean(axis=1) >= LEAST_VALID)
    if not len(counting):
        return StridePeaks(mean=np.nan, error=np.nan, count=0, strides=len(values))
    places = np.nanargmax(values[counting], axis=1)
    peaks, own = values[counting, places], errors[counting, places]
    error = peaks.std(ddof=1) if len(peaks) > 1 else own[0]
    return StridePeaks(mean=float(peaks.mean()), error=float(error), count=len(counting), strides=len(values))
