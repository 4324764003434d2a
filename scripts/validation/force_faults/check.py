"""Are faults of force plates named, with their size, and clean recordings left in peace?

    force_faults [--cases 360] [--seed N] [--only subject01,pig,...] [--track] [--verbose]

Single faults, drawn at random (sizes log-uniform; in one plate or all, in one trial or all of a session; centre of
pressure or moments kept), are put into the recordings of people whose joint parameters were calibrated once; their
trials are then diagnosed as `gaitcal calibrate` does, by the clean motion unless --track has it sought again. Printed:
how each kind of fault was met, the sizes found, what was taken for another, the smallest size from which 80 % are
found, and every clean recording. Real people need the environment variable GAITCAL_DATA. Exit code 1 where a clean
recording is accused, or the right cause comes first in less than 90 % of the faults that are spoken of.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from gaitcal.faults.force_choice import choose, fits
from gaitcal.faults.force_evidence import ForceResidual
from scripts.validation.force_faults.cases import Case, Outcome, Person, cases, people
from scripts.validation.harness import say

SPOKEN = (Outcome.FIRST, Outcome.IN_SET, Outcome.OTHER_PLATE, Outcome.WRONG)
FOUND = 0.8


def accused(everybody: list[Person]) -> int:
    """How many clean studies have a named cause, or an unexplained disagreement."""
    return sum(any(choose(person.clean)) for person in everybody)


def print_clean(everybody: list[Person]) -> None:
    print("clean recordings: |y|^2 a row (1: usual), the best cause there is (not told), what is told")
    for person in everybody:
        for trial in person.clean:
            size, found = fits(ForceResidual([trial]))
            best = f"{found[0].cause.kind.value} gain {found[0].gain:.1f} explained {found[0].explained:.2f}"
            print(f"  {person.name:12}{trial.name:10}{size:6.2f}  {best}")
        named, unexplained = choose(person.clean)
        print(f"  {person.name:12}told: {len(named)} causes, {len(unexplained)} unexplained")


def first_share(found: list[Case]) -> float:
    spoken = [case for case in found if case.outcome in SPOKEN]
    return sum(case.outcome is Outcome.FIRST for case in spoken) / max(1, len(spoken))


def line_of(case: Case) -> str:
    ratio = "" if case.ratio is None else f"size x {case.ratio:.2f}"
    where = f"{case.person} {','.join(case.trials)} {case.scope}"
    return f"{case.outcome.value:12}{case.fault.row:28}{case.fault.words:26}{where:40}{ratio} [{case.told}]"


def print_table(found: list[Case]) -> None:
    heads = ("n", *(outcome.value for outcome in Outcome))
    print(f"\n{'fault':34}" + "".join(f"{head:>12}" for head in heads) + "   size found / true: median (10-90 %)")
    rows: dict[str, list[Case]] = {}
    for case in found:
        rows.setdefault(f"{case.fault.row}, {case.scope}", []).append(case)
    for row, of_row in sorted(rows.items()):
        print(_line(row, of_row))
    print(_line("together", found))
    print(f"right cause first in {100 * first_share(found):.1f} % of those spoken of")
    within = [abs(case.ratio - 1.0) <= 0.2 for case in found if case.ratio is not None]
    print(f"size within 20 % in {sum(within)} of {len(within)}")
    told = Counter(case.causes for case in found if case.outcome in SPOKEN)
    print("causes told at once: " + ", ".join(f"{n}: {told[n]}" for n in sorted(told)))
    print("\ntaken for another")
    for case in found:
        if case.outcome in (Outcome.IN_SET, Outcome.OTHER_PLATE, Outcome.WRONG):
            where = f"{case.person} {','.join(case.trials)} {case.scope}"
            print(f"  {case.outcome.value:12}{case.fault.row}, {case.fault.words} ({where}): {case.told}")
    print("\nnothing told")
    for row, of_row in sorted(rows.items()):
        missed = sorted(c.fault.words for c in of_row if c.outcome in (Outcome.NONE, Outcome.NO_FRAMES))
        if missed:
            print(f"  {row}: {', '.join(missed)}")
    print(f"\nsmallest size from which {100 * FOUND:.0f} % are found (first or in the set)")
    for row, of_row in sorted(rows.items()):
        if of_row[0].fault.size:
            print(f"  {row:34}{smallest(of_row)}")


def _line(row: str, of_row: list[Case]) -> str:
    counts = Counter(case.outcome for case in of_row)
    ratios = [case.ratio for case in of_row if case.ratio is not None]
    sizes = ""
    if ratios:
        low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
        sizes = f"   {middle:.2f} ({low:.2f}-{high:.2f})"
    return f"{row:34}{len(of_row):12}" + "".join(f"{counts[outcome]:12}" for outcome in Outcome) + sizes


def smallest(of_row: list[Case]) -> str:
    """The size above which enough faults are found, in words."""
    ordered = sorted(of_row, key=lambda case: magnitude(case))
    hits = np.array([case.outcome in (Outcome.FIRST, Outcome.IN_SET) for case in ordered], dtype=float)
    shares = np.cumsum(hits[::-1])[::-1] / np.arange(len(hits), 0, -1)
    enough = np.flatnonzero((shares >= FOUND) & (hits > 0))
    if not len(enough):
        return "-"
    case = ordered[int(enough[0])]
    return f"{case.fault.words} ({int(hits[enough[0] :].sum())} of {len(ordered) - int(enough[0])})"


def magnitude(case: Case) -> float:
    """How large a fault is among those of its row."""
    size = case.fault.size
    if case.fault.kind.value.endswith("gain") or case.fault.row == "free moment":
        return abs(float(np.log(abs(size[0]))))
    return float(np.linalg.norm(size))


SHARED = ("--only", "--seed")
LEAST_FIRST = 0.90


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many faults."""
    parser.add_argument("--cases", type=int, default=360)
    parser.add_argument("--track", action="store_true", help="track the motion again for each fault")
    parser.add_argument("--verbose", action="store_true", help="a line for each fault")


def run(chosen: argparse.Namespace) -> tuple[list[Person], list[Case]]:
    """Diagnose clean and spoilt recordings, and print how each was met."""
    with tempfile.TemporaryDirectory() as folder:
        everybody = list(people(Path(folder), chosen.only))
        print_clean(everybody)
        found = []
        for case in cases(everybody, chosen.cases, chosen.seed, track=chosen.track):
            found.append(case)
            if chosen.verbose:
                say(line_of(case))
    print_table(found)
    return everybody, found


def passed(results: tuple[list[Person], list[Case]]) -> bool:
    """Whether no clean recording is accused, and the right cause comes first often enough."""
    everybody, found = results
    return not accused(everybody) and first_share(found) >= LEAST_FIRST
