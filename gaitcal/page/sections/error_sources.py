"""What makes the error bar of each torque of the legs: the bars of the report, one a torque and side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.dynamics.torque_sources import Source
from gaitcal.gait.words import coordinate_title
from gaitcal.model.coordinates import LEG_COORDINATES, coordinate_words
from gaitcal.session.result import TrialResult


@dataclass(frozen=True, kw_only=True)
class ErrorPart:
    """One source of one error bar."""

    source: Source
    percent: float
    """Of the variance."""


@dataclass(frozen=True, kw_only=True)
class ErrorBar:
    """The error bar of one torque."""

    title: str
    """`Right hip flexion`."""
    short: str
    """`Hip flexion`."""
    error: float
    """N·m/kg, RMS standard error over valid frames."""
    parts: tuple[ErrorPart, ...]
    """Their percentages sum to 100; in the order of `Source`."""

    @property
    def largest(self) -> ErrorPart:
        """The part that makes most of it."""
        return max(self.parts, key=lambda part: part.percent)

    def percent(self, source: Source) -> float:
        """Of one source; 0 where it has no part."""
        return sum(part.percent for part in self.parts if part.source is source)


@dataclass(frozen=True)
class ErrorSources:
    """Of one trial."""

    right: tuple[ErrorBar, ...]
    left: tuple[ErrorBar, ...]

    @property
    def sources(self) -> tuple[Source, ...]:
        """Those that have a part in some bar."""
        shown = {part.source for bar in (*self.right, *self.left) for part in bar.parts}
        return tuple(source for source in Source if source in shown)


def error_sources(trial: TrialResult, mass: float) -> ErrorSources | None:
    """The error bars of a trial's leg torques; None where it is not known what makes them. `mass`: of the body, kg."""
    if trial.loads is None or trial.loads.errors is None:
        return None
    errors, reactions = trial.loads.errors, trial.loads.reactions

    def bar(name: str) -> ErrorBar | None:
        column, valid = FORCES.index(name), reactions.valid_for(name)
        shares = errors.shares(column, valid)
        if not shares:
            return None
        return ErrorBar(
            title=coordinate_title(name),
            short=coordinate_words(name).title,
            error=float(np.sqrt((errors.every[valid, column] ** 2).mean())) / mass,
            parts=tuple(ErrorPart(source=s, percent=100.0 * shares[s]) for s in Source if s in shares),
        )

    right, left = (tuple(b for name in LEG_COORDINATES if (b := bar(f"{name}_{side}"))) for side in "rl")
    return ErrorSources(right, left) if right or left else None
