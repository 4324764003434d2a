"""One table of many fits: medians with ranges, RMS, and how many error bars held; and what is
wanted of the figures: each limit with what was found.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from scripts.validation.error_bars import Bars, rms
from scripts.validation.truth.outcome import Figure, Outcome
from scripts.validation.truth.skin import SKIN, Kind

Earlier = Mapping[tuple[str, str, str], float]
"""(part, case, figure) -> RMS of an earlier run."""

HEADING = (
    f"{'figure':30}{'before':>9}{'median':>9}   {'least to most':17}{'RMS':>8}{'peer':>9}{'SE':>9}"
    f"{'in 68 %':>9}{'in 95 %':>9}{'bars':>8}"
)


def lines(outcomes: list[Outcome], earlier: Earlier | None = None, *, details: bool = False) -> Iterator[str]:
    """The table: part by part and case by case, one line a figure; with `details` each direction by itself, too."""
    yield HEADING + (f"{'then':>9}" if earlier else "")
    for part in dict.fromkeys(o.part for o in outcomes):
        of_part = [o for o in outcomes if o.part == part]
        for case in dict.fromkeys(o.case for o in of_part):
            fits = [o for o in of_part if o.case == case]
            yield from ("", _title(fits))
            for name in dict.fromkeys(name for o in fits for name in o.figures):
                if details or name.count(", ") == 1:
                    row = _row(name, [o.figures[name] for o in fits if name in o.figures])
                    then = (earlier or {}).get((part, case, name))
                    yield (row if then is None else f"{row:117}{_digits(then):>9}").rstrip()


def _title(fits: list[Outcome]) -> str:
    seconds, people = np.median([o.seconds for o in fits]), len({o.person for o in fits})
    lost = sum(not o.converged for o in fits)
    words = f"{fits[0].part}, {fits[0].case}: fits {len(fits)}, people {people}, median {seconds:.2f} s each"
    return words + (f"; {lost} NOT CONVERGED" if lost else "")


def _row(name: str, figures: list[Figure]) -> str:
    errors = [abs(f.error) for f in figures]
    spread = f"{_digits(min(errors))} to {_digits(max(errors))}"
    befores = [abs(f.before) for f in figures if f.before is not None]
    peers = [f.peer for f in figures if f.peer is not None]
    before, peer = (_digits(np.median(befores)) if befores else ""), (_digits(rms(peers)) if peers else "")
    row = f"{name:30}{before:>9}{_digits(np.median(errors)):>9}   {spread:17}{_digits(rms(errors)):>8}{peer:>9}"
    return row + _bars(sum((f.bars for f in figures), Bars()))


def _bars(held: Bars) -> str:
    if not held.count:
        return ""
    first, second = held.shares
    return f"{_digits(held.rms):>9}{first:9.1f}{second:9.1f}{held.count:8}"


def _digits(value: float | np.floating) -> str:
    """Three digits that matter, at most four places."""
    value = float(value)
    if value == 0:
        return "0"
    places = int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 4))
    return f"{value:.{places}f}"


def read(file: Path) -> Earlier:
    """RMS over the fits of an earlier run."""
    found: dict[tuple[str, str, str], list[float]] = {}
    for fit in json.loads(file.read_text(encoding="utf-8")):
        for name, figure in fit["figures"].items():
            found.setdefault((fit["part"], fit["case"], name), []).append(figure["error"])
    return {key: rms(errors) for key, errors in found.items()}


COVERAGE = (90.0, 98.0)
"""% of the 95 % intervals that should hold the truth."""
AT_LEAST = (90.0, 100.0)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One figure's error at most so large, or its 95 % intervals within these shares."""

    part: str
    cases: tuple[Kind | str, ...]
    """Each of these by itself."""
    figures: tuple[str, ...]
    """Patterns; each figure by itself."""
    error: float | None = None
    """Largest RMS over fits, in the figure's unit."""
    median: float | None = None
    """Largest median over fits."""
    shares: tuple[float, float] | None = None
    """% of intervals of 95 % that should hold."""


HIPS = ("hip in pelvis, mm", "hip in thigh, mm")
LIMITS = (
    Limit(part="gait", cases=(Kind.NONE,), figures=("hip in laboratory, mm",), median=3.0),
    Limit(part="gait", cases=(Kind.NONE,), figures=("torques of legs, N·m",), median=2.7),  # half of version 0.2's
    Limit(part="gait", cases=(Kind.NONE,), figures=("torque *",), shares=AT_LEAST),
    Limit(part="gait", cases=(*SKIN, Kind.MIXTURE), figures=("hip in laboratory, mm",), median=8.0),
    Limit(part="isolated", cases=(Kind.NONE,), figures=HIPS, error=0.1),
    Limit(part="isolated", cases=(Kind.NONE,), figures=("talocrural axis, deg", "subtalar axis, deg"), error=0.5),
    Limit(part="isolated", cases=(Kind.SINUSOIDS,), figures=HIPS, error=3.5),
    Limit(part="isolated", cases=(*SKIN, Kind.MIXTURE), figures=HIPS, error=7.0),
    Limit(part="isolated", cases=(*SKIN, Kind.SINUSOIDS, Kind.MIXTURE), figures=HIPS, shares=COVERAGE),
    Limit(part="synthetic", cases=("waves",), figures=("torques of legs, N·m",), median=2.2),
    Limit(part="synthetic", cases=("waves",), figures=("torque *",), shares=COVERAGE),
)


@dataclass(frozen=True)
class Check:
    """A limit beside what was found."""

    words: str
    found: float
    wanted: str
    met: bool


def checks(outcomes: list[Outcome], limits: tuple[Limit, ...] = LIMITS) -> Iterator[Check]:
    """Every limit that these fits speak to."""
    for limit in limits:
        for case in limit.cases:
            name = case.value if isinstance(case, Kind) else case
            here = [o for o in outcomes if (o.part, o.case) == (limit.part, name)]
            known = dict.fromkeys(figure for o in here for figure in o.figures)
            for figure in (f for f in known if any(fnmatch(f, pattern) for pattern in limit.figures)):
                yield _check(limit, name, figure, here)


def _check(limit: Limit, case: str, figure: str, outcomes: list[Outcome]) -> Check:
    figures = [o.figures[figure] for o in outcomes if figure in o.figures]
    words = f"{limit.part}, {case}: {figure}"
    if limit.shares is not None:
        low, high = limit.shares
        found = sum((f.bars for f in figures), Bars()).shares[1]
        return Check(f"{words}, in 95 %", found, f"{low:g} to {high:g} %", low <= found <= high)
    errors = [abs(f.error) for f in figures]
    if limit.median is not None:
        found = float(np.median(errors))
        return Check(f"{words}, median", found, f"<= {limit.median:g}", found <= limit.median)
    most = limit.error or 0.0
    return Check(f"{words}, RMS", rms(errors), f"<= {most:g}", rms(errors) <= most)


def wanted_lines(outcomes: list[Outcome]) -> Iterator[str]:
    """One line a limit."""
    found = list(checks(outcomes))
    if found:
        yield f"\nwanted: {sum(c.met for c in found)} of {len(found)} met"
        for check in found:
            yield f"{check.words:62}{check.found:9.4g}   {check.wanted:14}{'yes' if check.met else 'no'}"
