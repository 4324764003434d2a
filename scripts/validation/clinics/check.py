"""Does the first command reach torques on any laboratory's folder? Bare folders, and what other laboratories do.

    clinics [--jobs 2] [--only REGEX] [--list] [--keep DIR]

Each case is a folder of recordings without a study file: as the laboratory left it, or changed as another one would
have written it (`clinics/variants.py`). `gaitcal calibrate FOLDER` runs on it in a process of its own. It ends as one
of

torques     exit code 0 or a verdict that says no, and a leg with valid torques wherever forces were recorded; the same
            as of the folder as it was, within their error bars (RMS over frames of |difference| /
            max(1.96 standard errors, floor), median over the legs' coordinates, at most 1)
asked       a clear line, no torques, where more cannot be said
refused     a clear line, no torques, though there is enough to say more
wrong       other torques than of the folder as it was, and nothing said that is not said there
named       other torques, and a message that the folder as it was does not have
crash       a traceback, or an exit code that no fault of the input explains

Exit code 1 where fewer than nine in ten reach torques (or rightly ask), or anything is wrong or crashes.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from scripts.validation.clinics.run import BAD, Ending, Outcome, run_case
from scripts.validation.clinics.variants import cases
from scripts.validation.harness import side_by_side

SHARED = ("--jobs", "--only", "--list", "--json")
LEAST_SHARE = 0.9
"""Of all cases, that reach torques or rightly ask."""
AS_IT_IS = "as it is"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where to work."""
    parser.add_argument("--keep", type=Path, help="where the folders and results stay")


def printed(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """The outcomes, each printed as it comes."""
    out = []
    for outcome in outcomes:
        print(outcome.line, flush=True)
        out.append(outcome)
    return out


def run(chosen: argparse.Namespace) -> list[Outcome]:
    """Run the cases and print a line for each."""
    wanted = [(v, c) for v, c in cases() if re.search(chosen.only, f"{c}: {v.name}", re.IGNORECASE)]
    if chosen.list:
        print("\n".join(f"{clinic}: {variant.name}" for variant, clinic in wanted))
        return []
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bases = sorted({clinic for _, clinic in wanted})
        first = side_by_side([partial(run_case, AS_IT_IS, clinic, folder, None) for clinic in bases], chosen.jobs)
        clean = dict(zip(bases, printed(first), strict=True))
        rest = [partial(run_case, v.name, c, folder, clean[c]) for v, c in wanted if v.name != AS_IT_IS]
        changed = printed(side_by_side(rest, chosen.jobs))
    outcomes = [clean[c] for v, c in wanted if v.name == AS_IT_IS] + changed
    counts = Counter(outcome.ending for outcome in outcomes)
    print(", ".join(f"{ending.value} {counts[ending]}" for ending in Ending), f"of {len(outcomes)}")
    return outcomes


def passed(outcomes: list[Outcome]) -> bool:
    """Whether enough reach torques or rightly ask, and nothing is wrong or crashes."""
    reached = sum(o.ending in (Ending.TORQUES, Ending.ASKED, Ending.NAMED) for o in outcomes)
    return reached >= LEAST_SHARE * len(outcomes) and not any(o.ending in BAD for o in outcomes)
