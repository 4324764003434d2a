"""A small study as a program of its own, to be killed: python -m tests.montecarlo.small_study
FOLDER.
"""

import sys
from pathlib import Path

from gaitcal.montecarlo.case import make_nominal_case
from gaitcal.montecarlo.draw_study import monte_carlo
from gaitcal.montecarlo.protocol import Plan
from gaitcal.montecarlo.workers import LocalProcesses

PLAN = Plan(levels=(100,), draws=12)
CHUNK = 2


def main() -> None:
    monte_carlo(
        make_nominal_case(),
        Path(sys.argv[1]),
        plan=PLAN,
        workers=LocalProcesses(2),
        chunk_draws=CHUNK,
    )


if __name__ == "__main__":
    main()
