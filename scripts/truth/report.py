"""One table of many fits: medians with ranges, RMS, and how many error bars held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from truth.outcome import Bars, Outcome, rms

HEADING = (
    f"{'figure':30}{'before':>9}{'median':>9}   {'least to most':17}{'RMS':>8}{'peer':>9}{'SE':>9}"
    f"{'in 68 %':>9}{'in 95 %':>9}{'bars':>8}"
)


def lines(outcomes: list[Outcome], *, details: bool = False) -> Iterator[str]:
    """The table: part by part and case by case, one line a figure; with `details` each direction by itself, too."""
    yield HEADING
    for part in dict.fromkeys(o.part for o in outcomes):
        of_part = [o for o in outcomes if o.part == part]
        for case in dict.fromkeys(o.case for o in of_part):
            yield from _case([o for o in of_part if o.case == case], details)


def _case(outcomes: list[Outcome], details: bool) -> Iterator[str]:
    first, seconds = outcomes[0], np.median([o.seconds for o in outcomes])
    people = len({o.person for o in outcomes})
    yield f"\n{first.part}, {first.case}: {len(outcomes)} fits of {people} people, {seconds:.2f} s each (median)"
    for name in dict.fromkeys(name for o in outcomes for name in o.figures):
        if name.count(", ") > 1 and not details:
            continue
        figures = [o.figures[name] for o in outcomes if name in o.figures]
        errors = [abs(f.error) for f in figures]
        spread = f"{_digits(min(errors))} to {_digits(max(errors))}"
        befores = [f.before for f in figures if f.before is not None]
        peers = [f.peer for f in figures if f.peer is not None]
        row = f"{name:30}{_digits(np.median(np.abs(befores))) if befores else '':>9}{_digits(np.median(errors)):>9}"
        row += f"   {spread:17}{_digits(rms(errors)):>8}{_digits(rms(peers)) if peers else '':>9}"
        yield (row + _bars(sum((f.bars for f in figures), Bars()))).rstrip()


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


def content(outcomes: list[Outcome]) -> list[dict[str, object]]:
    """Every figure of every fit, for a JSON file."""
    return [asdict(outcome) for outcome in outcomes]
