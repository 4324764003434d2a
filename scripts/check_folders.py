"""Result folders under attack: commands at once, kills at any moment, damaged files. Nothing lost, nothing wrong.

    python scripts/check_folders.py [--pairs 1] [--kills 50] [--chunks 300] [--files 100] [--seed 0] [--keep DIR]

pairs   ten pairs of commands at once on one folder, each pair so often
kills   of each of dynamics, export and montecarlo, SIGKILL and SIGTERM in turn
chunks  damaged chunks of Monte Carlo draws: flipped bits, zeroed blocks, truncations
files   damaged files of a result, likewise

Exit code 1 where anything was lost, wrong, left behind or damaged without a word. POSIX only.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from folders import damage, kills, pairs  # noqa: E402
from folders.commands import made_bench  # noqa: E402


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


def main(words: Sequence[str] | None = None) -> int:
    """Run the checks; exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, count in (("pairs", 1), ("kills", 50), ("chunks", 300), ("files", 100), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--keep", type=Path, help="work in this folder and leave it")
    counts = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as temporary:
        found = check(counts.keep or Path(temporary), counts)
    print(f"{len(found)} faults")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
