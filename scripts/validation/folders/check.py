"""Result folders under attack: commands at once, kills at any moment, damaged files. Nothing lost, nothing wrong.

    folders [--pairs 1] [--kills 50] [--chunks 300] [--files 100] [--seed 0] [--keep DIR]

pairs   ten pairs of commands at once on one folder, each pair so often
kills   of each of dynamics, export and montecarlo, SIGKILL and SIGTERM in turn
chunks  damaged chunks of Monte Carlo draws: flipped bits, zeroed blocks, truncations
files   damaged files of a result, likewise

Exit code 1 where anything was lost, wrong, left behind or damaged without a word. POSIX only.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from pathlib import Path

from scripts.validation.folders import damage, kills, pairs
from scripts.validation.folders.commands import made_bench

SHARED = ("--seed",)


def check(folder: Path, counts: argparse.Namespace) -> list[str]:
    """Do it all in a folder; everything that went wrong."""
    rng = random.Random(counts.seed)
    seen: list[str] = []
    found: list[str] = []
    began = time.monotonic()

    def tell() -> None:
        for line in seen:
            print(f"{time.monotonic() - began:6.0f} s  {line}", flush=True)
        seen.clear()

    bench = made_bench(folder)
    # Threads of Arrow must not be there when processes are forked: what reads draws here comes last.
    for faults in (
        pairs.faults(bench, folder / "pairs", counts.pairs, rng, seen) if counts.pairs else (),
        kills.faults(bench, folder / "kills", counts.kills, rng, seen) if counts.kills else (),
        damage.result_faults(bench, folder / "damaged", counts.files, rng, seen),
        damage.chunk_faults(folder / "chunks", counts.chunks, rng, seen),
    ):
        for fault in faults:
            print(f"FAULT  {fault}", flush=True)
            found.append(fault)
        tell()
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    """How often each."""
    for name, count in (("pairs", 1), ("kills", 50), ("chunks", 300), ("files", 100)):
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--keep", type=Path, help="work in this folder and leave it")


def run(chosen: argparse.Namespace) -> list[str]:
    """Run the checks; everything that went wrong."""
    with tempfile.TemporaryDirectory() as temporary:
        found = check(chosen.keep or Path(temporary), chosen)
    print(f"{len(found)} faults")
    return found


def passed(found: list[str]) -> bool:
    """Whether nothing went wrong."""
    return not found
