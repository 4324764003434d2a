"""One calibration of somebody whose truth is known, and how long it took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import gaitcal
from gaitcal import Calibration, Study
from scripts.validation.truth.outcome import Figure, Outcome


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
