"""What is kept of one fit: figures with their errors, and how many error bars held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter

import gaitcal
from gaitcal import Calibration, Study
from scripts.validation.error_bars import Bars


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of one fit."""

    error: float
    """RMS, in the unit that its name tells."""
    before: float | None = None
    """The same with the nominal model."""
    peer: float | None = None
    """The same with SCoRE or SARA."""
    bars: Bars = field(default_factory=Bars)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """All figures of one fit."""

    part: str
    """`gait`, `isolated`, `synthetic`."""
    case: str
    """How markers moved."""
    person: str
    seed: int
    seconds: float
    """Of `gaitcal.calibrate`."""
    converged: bool = True
    """Whether every phase of the calibration did."""
    figures: Mapping[str, Figure]
    """`hip in pelvis, mm` -> figure."""


@dataclass(frozen=True)
class TimedFit:
    """A calibration with its time."""

    calibration: Calibration
    seconds: float

    def outcome(self, part: str, case: str, person: str, seed: int, figures: Mapping[str, Figure]) -> Outcome:
        """What is kept of it."""
        return Outcome(
            part=part,
            case=case,
            person=person,
            seed=seed,
            seconds=self.seconds,
            converged=self.calibration.converged,
            figures=figures,
        )


def timed_fit(study: Study) -> TimedFit:
    """Calibrate."""
    start = perf_counter()
    calibration = gaitcal.calibrate(study)
    return TimedFit(calibration, perf_counter() - start)
