"""A Monte Carlo study of the built-in subject on a dask cluster, or on two workers that this script
starts.

    python scripts/examples/03_monte_carlo_cluster.py OUT
        two workers of this machine
    python scripts/examples/03_monte_carlo_cluster.py OUT tcp://scheduler:8786
        an existing cluster

Needs the extra: pip install 'gaitcal[cluster]'. Run again with more draws, it goes on where it was.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from distributed import LocalCluster

from gaitcal.montecarlo.case import make_nominal_case
from gaitcal.montecarlo.draw_study import MonteCarloStudy, monte_carlo
from gaitcal.montecarlo.protocol import Plan
from gaitcal.montecarlo.workers import DaskCluster


def run(out: Path, address: str, draws: int) -> MonteCarloStudy:
    """The study of the nominal subject, at the highest level."""
    return monte_carlo(
        make_nominal_case(),
        out,
        plan=Plan(levels=(100,), draws=draws),
        workers=DaskCluster(address),
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("address", nargs="?")
    parser.add_argument("--draws", type=int, default=500)
    chosen = parser.parse_args(arguments)
    if chosen.address:
        study = run(chosen.out, chosen.address, chosen.draws)
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            study = run(chosen.out, cluster.scheduler_address, chosen.draws)
    torques = study.statistics[
        (study.statistics["measure"] == "rms") & (study.statistics["unit"] == "%BW*H")
    ]
    print(
        torques.pivot_table(index="quantity", columns=["set", "grf"], values="average").to_string()
    )


if __name__ == "__main__":
    main()
