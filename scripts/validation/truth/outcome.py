"""What is kept of one fit: figures with their errors, and how many error bars held.

Figures of both legs are gathered on their way to one each, parameters beside the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

import gaitcal
from gaitcal import Calibration, Study
from scripts.validation.error_bars import Bars, bars, rms
from scripts.validation.truth.people import DIRECTIONS


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


TO_UNIT = {"mm": 1e-3, "deg": np.pi / 180}


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """Parameters of a calibration beside the truth, m and rad."""

    nominal: Mapping[str, float]
    fitted: Mapping[str, float]
    error: Mapping[str, float]
    """Standard errors; NaN where there is none."""
    truth: Mapping[str, float]

    @property
    def times(self) -> tuple[tuple[str, Mapping[str, float]], ...]:
        """Values with the calibrated and with the nominal model, by the figure's field."""
        return ("error", self.fitted), ("before", self.nominal)

    def bars(self, names: list[str], unit: str) -> Bars:
        """Whether the standard errors of these parameters hold."""
        wrong = np.array([self.fitted[n] - self.truth[n] for n in names])
        return bars(wrong / TO_UNIT[unit], np.array([self.error[n] for n in names]) / TO_UNIT[unit])


def fitted_parameters(calibration: Calibration, truth: Mapping[str, float]) -> Fitted:
    """From the parameter table, and the standard errors of the calibration."""
    table = gaitcal.parameter_table(calibration).set_index("name").loc[list(truth)]
    scale = table["unit"].map(TO_UNIT)
    errors = calibration.standard_errors
    return Fitted(
        nominal=(table["nominal"] * scale).to_dict(),
        fitted=(table["fitted"] * scale).to_dict(),
        error={name: errors.get(name, float("nan")) for name in truth},
        truth=truth,
    )


@dataclass
class Gathered:
    """Figures of both sides, before they become one."""

    values: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    """Figure -> `error`, `before`, `peer` -> values."""
    held: dict[str, Bars] = field(default_factory=dict)

    def put(self, name: str, **values: float) -> None:
        """One side's value of a figure."""
        for what, value in values.items():
            self.values.setdefault(name, {}).setdefault(what, []).append(value)

    def add_bars(self, name: str, held: Bars) -> None:
        """One side's error bars of a figure."""
        self.held[name] = self.held.get(name, Bars()) + held

    def single(self, name: str, parameter: str, fitted: Fitted, unit: str) -> None:
        """One parameter."""
        for when, values in fitted.times:
            self.put(name, **{when: (values[parameter] - fitted.truth[parameter]) / TO_UNIT[unit]})
        self.add_bars(name, fitted.bars([parameter], unit))

    def hip(self, fitted: Fitted, side: str) -> None:
        """A hip's centre in pelvis and thigh: its distance from the true one, and each coordinate."""
        for end in ("pelvis", "thigh"):
            names = [f"hip_{side}.{end}.{d}" for d in DIRECTIONS]
            for when, values in fitted.times:
                gap = 1e3 * np.array([values[n] - fitted.truth[n] for n in names])
                self.put(f"hip in {end}, mm", **{when: float(np.linalg.norm(gap))})
            self.add_bars(f"hip in {end}, mm", fitted.bars(names, "mm"))
            for direction, parameter in zip(DIRECTIONS, names, strict=True):
                self.single(f"hip in {end}, {direction}, mm", parameter, fitted, "mm")

    def figures(self) -> dict[str, Figure]:
        """RMS over the sides."""
        each = {n: {what: rms(v) for what, v in kinds.items()} for n, kinds in self.values.items()}
        return {n: Figure(**v, bars=self.held.get(n, Bars())) for n, v in each.items()}
