"""One table of many fits: medians with ranges, RMS, and how many error bars held."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from scripts.validation.error_bars import Bars, rms
from scripts.validation.truth.outcome import Figure, Outcome

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
