"""Are faults of force plates named, with their size, and clean recordings left in peace?

    python scripts/check_force_faults.py [--cases 360] [--seed N] [--people subject01,pig,...] [--track] [--verbose]

Single faults, drawn at random (sizes log-uniform; in one plate or all, in one trial or all of a session; centre of
pressure or moments kept), are put into the recordings of people whose joint parameters were calibrated once; their
trials are then diagnosed as `gaitcal calibrate` does, by the clean motion unless --track has it sought again. Printed:
how each kind of fault was met, the sizes found, what was taken for another, the smallest size from which 80 % are
found, and every clean recording. Real people need the environment variable GAITCAL_DATA. Exit code 1 where a clean
recording is accused, or the right cause comes first in less than 90 % of the faults that are spoken of.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which the next imports do
sys.path.insert(0, str(Path(__file__).resolve().parent))

from force_faults.cases import cases  # noqa: E402
from force_faults.people import people  # noqa: E402
from force_faults.report import accused, first_share, line_of, print_clean, print_table  # noqa: E402

LEAST_FIRST = 0.90


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=360)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--people", type=lambda text: tuple(text.split(",")), default=())
    parser.add_argument("--track", action="store_true", help="track the motion again for each fault")
    parser.add_argument("--verbose", action="store_true", help="a line for each fault")
    chosen = parser.parse_args(arguments)
    data = Path(os.environ["GAITCAL_DATA"]) if "GAITCAL_DATA" in os.environ else None
    with tempfile.TemporaryDirectory() as folder:
        everybody = list(people(data, Path(folder), chosen.people))
        print_clean(everybody)
        found = []
        for case in cases(everybody, chosen.cases, chosen.seed, track=chosen.track):
            found.append(case)
            if chosen.verbose:
                print(line_of(case), flush=True)
    print_table(found)
    return 1 if accused(everybody) or first_share(found) < LEAST_FIRST else 0


if __name__ == "__main__":
    sys.exit(main())
