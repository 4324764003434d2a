"""What is kept of one fit: figures with their errors, and how many error bars held. One table of
many fits: medians with ranges, RMS, and how many error bars held.

Figures of both legs are gathered on their way to one each, parameters beside the truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

import gaitcal
from gaitcal import Calibration, Study
from scripts.validation.harness import Bars, bars, rms
from scripts.validation.truth.people import DIRECTIONS


@dataclass(frozen=True, kw_only=True)
class Figure:
    error: float
    """RMS, in the unit that its name tells."""
    before: float | None = None
    """The same with the nominal model."""
    peer: float | None = None
    """The same with SCoRE or SARA."""
    bars: Bars = field(default_factory=Bars)


@dataclass(frozen=True)
class Outcome:
    part: str
    """`gait`, `isolated`, `synthetic`."""
    case: str
    """How markers moved."""
    person: str
    seed: int
    seconds: float
    """Of `gaitcal.calibrate`."""
    converged: bool
    """Whether every phase of the calibration did."""
    figures: Mapping[str, Figure]
    """`hip in pelvis, mm` -> figure."""


@dataclass(frozen=True)
class TimedFit:
    calibration: Calibration
    seconds: float

    def outcome(
        self, part: str, case: str, person: str, seed: int, figures: Mapping[str, Figure]
    ) -> Outcome:
        return Outcome(part, case, person, seed, self.seconds, self.calibration.converged, figures)


def timed_fit(study: Study) -> TimedFit:
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
    values: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    """Figure -> `error`, `before`, `peer` -> values."""
    held: dict[str, Bars] = field(default_factory=dict)

    def put(self, name: str, **values: float) -> None:
        for what, value in values.items():
            self.values.setdefault(name, {}).setdefault(what, []).append(value)

    def add_bars(self, name: str, held: Bars) -> None:
        self.held[name] = self.held.get(name, Bars()) + held

    def single(self, name: str, parameter: str, fitted: Fitted, unit: str) -> None:
        for when, values in fitted.times:
            self.put(name, **{when: (values[parameter] - fitted.truth[parameter]) / TO_UNIT[unit]})
        self.add_bars(name, fitted.bars([parameter], unit))

    def hip(self, fitted: Fitted, side: str) -> None:
        """A hip's centre in pelvis and thigh: its distance from the true one,"""
        for end in ("pelvis", "thigh"):
            names = [f"hip_{side}.{end}.{d}" for d in DIRECTIONS]
            for when, values in fitted.times:
                gap = 1e3 * np.array([values[n] - fitted.truth[n] for n in names])
                self.put(f"hip in {end}, mm", **{when: float(np.linalg.norm(gap))})
            self.add_bars(f"hip in {end}, mm", fitted.bars(names, "mm"))

    def figures(self) -> dict[str, Figure]:
        each = {n: {what: rms(v) for what, v in kinds.items()} for n, kinds in self.values.items()}
        return {n: Figure(**v, bars=self.held.get(n, Bars())) for n, v in each.items()}


HEADING = (
    f"{'figure':30}{'before':>9}{'median':>9}   {'least to most':17}{'RMS':>8}{'peer':>9}{'SE':>9}"
    f"{'in 68 %':>9}{'in 95 %':>9}{'bars':>8}"
)


def lines(outcomes: list[Outcome]) -> Iterator[str]:
    """The table: part by part and case by case, one line a figure."""
    yield HEADING
    for part in dict.fromkeys(o.part for o in outcomes):
        of_part = [o for o in outcomes if o.part == part]
        for case in dict.fromkeys(o.case for o in of_part):
            fits = [o for o in of_part if o.case == case]
            yield from ("", _title(fits))
            for name in dict.fromkeys(name for o in fits for name in o.figures):
                yield _row(name, [o.figures[name] for o in fits if name in o.figures]).rstrip()


def _title(fits: list[Outcome]) -> str:
    seconds, people = np.median([o.seconds for o in fits]), len({o.person for o in fits})
    lost = sum(not o.converged for o in fits)
    words = (
        f"{fits[0].part}, {fits[0].case}: fits {len(fits)}, people {people}, median {seconds:.2f} "
        "s each"
    )
    return words + (f"; {lost} NOT CONVERGED" if lost else "")


def _row(name: str, figures: list[Figure]) -> str:
    errors = [abs(f.error) for f in figures]
    befores = [abs(f.before) for f in figures if f.before is not None]
    peers = [f.peer for f in figures if f.peer is not None]
    before, peer = (
        (_digits(np.median(befores)) if befores else ""),
        (_digits(rms(peers)) if peers else ""),
    )
    spread = f"{_digits(min(errors))} to {_digits(max(errors))}"
    row = (
        f"{name:30}{before:>9}{_digits(np.median(errors)):>9}   "
        f"{spread:17}{_digits(rms(errors)):>8}{peer:>9}"
    )
    held = sum((f.bars for f in figures), Bars())
    shares = f"{held.shares[0]:9.1f}{held.shares[1]:9.1f}{held.count:8}" if held.count else ""
    return row + (f"{_digits(held.rms):>9}{shares}" if held.count else "")


def _digits(value: float | np.floating) -> str:
    """Three digits that matter, at most four places."""
    value = float(value)
    if value == 0:
        return "0"
    places = int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 4))
    return f"{value:.{places}f}"
