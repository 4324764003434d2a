"""Do two recordings of one person differ by as much as their error bars say, and does a shared model help?

    python scripts/check_sessions.py [--parts real,made-up,angles] [--people 10] [--seed 0] [--out DIR]

real      every walk of `labs_c3d/multi` calibrated by itself: how many differences of curves are inside bars of 68 and
          95 % (joint parameters of real recordings: `check_people.py --parts pairs`)
made-up   two sessions of a person of our own linkage: the same joints, markers put on anew by 10 mm, other noise;
          errors of the joint parameters of each alone and of both together (`gaitcal compare A B --shared-model`)
angles    the angles of the same people's sessions, through result folders: inside their error bars?

`--out` keeps the results of `real`, and reads them if they are there.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which the next imports do
sys.path.insert(0, str(Path(__file__).resolve().parent))

from sessions import made_up, made_up_angles, real  # noqa: E402

PARTS = ("real", "made-up", "angles")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures, part by part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default=",".join(PARTS), help="comma-separated: real, made-up, angles")
    parser.add_argument("--people", type=int, default=10, help="made-up people")
    parser.add_argument("--seed", type=int, default=0, help="of the first of them")
    parser.add_argument("--out", type=Path, help="folder that keeps the results")
    chosen = parser.parse_args(arguments)
    parts = chosen.parts.split(",")
    if unknown := [part for part in parts if part not in PARTS]:
        parser.error(f"found {', '.join(unknown)}; allowed: {', '.join(PARTS)}")
    if "real" in parts:
        with tempfile.TemporaryDirectory() as folder:
            for line in real.report(chosen.out or Path(folder)):
                print(line, flush=True)
    if "made-up" in parts:
        outcomes = [made_up.outcome(seed) for seed in range(chosen.seed, chosen.seed + chosen.people)]
        for line in made_up.report(outcomes):
            print(line, flush=True)
    if "angles" in parts:
        for line in made_up_angles.report(range(chosen.seed, chosen.seed + chosen.people)):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
