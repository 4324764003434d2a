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
from pathlib import Path

from scripts.validation.force_faults.cases import Case, cases
from scripts.validation.force_faults.people import Person, people
from scripts.validation.force_faults.report import accused, first_share, line_of, print_clean, print_table
from scripts.validation.harness import say

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
