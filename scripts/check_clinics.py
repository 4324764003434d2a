"""Does the first command reach torques on any laboratory's folder? Bare folders, and what other laboratories do.

    python scripts/check_clinics.py [--jobs 2] [--only REGEX] [--list] [--keep DIR]

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
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from clinics.run import BAD, Ending, Outcome, run_case
from clinics.variants import cases
from joblib import Parallel, delayed

ENOUGH = 0.9
AS_IT_IS = "as it is"


def _as_it_is(clinic: str, room: Path) -> Any:
    return delayed(run_case)(AS_IT_IS, clinic, room, None)


def told(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """The outcomes, each printed as it comes."""
    out = []
    for outcome in outcomes:
        print(outcome.line, flush=True)
        out.append(outcome)
    return out


def main(arguments: list[str] | None = None) -> list[Outcome]:
    """Run the cases and print a line for each; SystemExit 1 where too few reach torques."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose title, 'FOLDER: VARIANT', matches")
    parser.add_argument("--list", action="store_true", help="titles, nothing is run")
    parser.add_argument("--keep", type=Path, help="where the folders and results stay")
    given = parser.parse_args(arguments)
    chosen = [(v, c) for v, c in cases() if re.search(given.only, f"{c}: {v.name}", re.IGNORECASE)]
    if given.list:
        print("\n".join(f"{clinic}: {variant.name}" for variant, clinic in chosen))
        return []
    with tempfile.TemporaryDirectory() as temporary:
        room = given.keep or Path(temporary)
        room.mkdir(parents=True, exist_ok=True)
        bases = sorted({clinic for _, clinic in chosen})
        first = told(Parallel(given.jobs, return_as="generator")(_as_it_is(clinic, room) for clinic in bases))
        clean = dict(zip(bases, first, strict=True))
        rest = [(v.name, c) for v, c in chosen if v.name != AS_IT_IS]
        changed = Parallel(given.jobs, return_as="generator")(delayed(run_case)(v, c, room, clean[c]) for v, c in rest)
        outcomes = [clean[c] for v, c in chosen if v.name == AS_IT_IS] + told(changed)
    counts = Counter(outcome.ending for outcome in outcomes)
    print(", ".join(f"{ending.value} {counts[ending]}" for ending in Ending), f"of {len(outcomes)}")
    reached = counts[Ending.TORQUES] + counts[Ending.ASKED] + counts[Ending.NAMED]
    if reached < ENOUGH * len(outcomes) or any(counts[bad] for bad in BAD):
        raise SystemExit(1)
    return outcomes


if __name__ == "__main__":
    main()
