"""Do two recordings of one person differ by as much as their error bars say, and does a shared model help?

    sessions [--parts real,made-up,angles] [--people 10] [--seed 0] [--out DIR]

real      every walk of `labs_c3d/multi` calibrated by itself: how many differences of curves are inside bars of 68 and
          95 % (joint parameters of real recordings: `people --parts pairs`)
made-up   two sessions of a person of our own linkage: the same joints, markers put on anew by 10 mm, other noise;
          errors of the joint parameters of each alone and of both together (`gaitcal compare A B --shared-model`)
angles    the angles of the same people's sessions, through result folders: inside their error bars?

`--out` keeps the results of `real`, and reads them if they are there.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from scripts.validation.harness import commas, say, side_by_side
from scripts.validation.sessions import made_up, made_up_angles, real

SHARED = ("--jobs", "--seed")


def _real(chosen: argparse.Namespace) -> Iterable[str]:
    with tempfile.TemporaryDirectory() as folder:
        yield from real.report(chosen.out or Path(folder))


def _seeds(chosen: argparse.Namespace) -> range:
    return range(chosen.seed, chosen.seed + chosen.people)


def _outcomes(chosen: argparse.Namespace) -> list[made_up.Outcome]:
    return list(side_by_side([partial(made_up.outcome, seed) for seed in _seeds(chosen)], chosen.jobs))


PARTS: dict[str, Callable[[argparse.Namespace], Iterable[str]]] = {
    "real": _real,
    "made-up": lambda chosen: made_up.report(_outcomes(chosen)),
    "angles": lambda chosen: made_up_angles.report(_seeds(chosen)),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Parts and people."""
    parser.add_argument("--parts", type=commas(PARTS), default=list(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--people", type=int, default=10, help="made-up people")
    parser.add_argument("--out", type=Path, help="folder that keeps the results")


def run(chosen: argparse.Namespace) -> None:
    """Print the figures, part by part."""
    for part in chosen.parts:
        for line in PARTS[part](chosen):
            say(line)
