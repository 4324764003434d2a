"""A small study as a program of its own, to be killed: python -m tests.published.small_study FOLDER."""

import sys
from pathlib import Path

from gaitcal.published.case import nominal_case
from gaitcal.published.protocol import Plan
from gaitcal.published.study import monte_carlo
from gaitcal.published.workers import LocalProcesses

PLAN = Plan(levels=(100,), draws=12)
CHUNK = 2


def main() -> None:
    monte_carlo(nominal_case(), Path(sys.argv[1]), plan=PLAN, workers=LocalProcesses(2), chunk_draws=CHUNK)


if __name__ == "__main__":
    main()
