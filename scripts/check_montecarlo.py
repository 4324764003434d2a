"""What the Monte Carlo study must show, measured on this machine.

python scripts/check_montecarlo.py full OUT [--draws 5000] [--jobs 2]   time, memory, convergence, conclusions
python scripts/check_montecarlo.py kills [--kills 50]                   SIGKILL at random moments, same bits
python scripts/check_montecarlo.py scaling                              linear in draws; two workers against one
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import pandas as pd

from gaitcal.report.monte_carlo_figures import write_monte_carlo_figures
from gaitcal.study.monte_carlo.case import nominal_case
from gaitcal.study.monte_carlo.cluster import Cluster
from gaitcal.study.monte_carlo.conclusions import PUBLISHED, beside, conclusions
from gaitcal.study.monte_carlo.context import MonteCarloContext
from gaitcal.study.monte_carlo.expectation import expect
from gaitcal.study.monte_carlo.settings import MonteCarloSettings, Plan, Varied
from gaitcal.study.monte_carlo.statistics import unconverged
from gaitcal.study.monte_carlo.store import Store
from gaitcal.study.monte_carlo.study import monte_carlo
from gaitcal.study.monte_carlo.variance import variance_contributions
from gaitcal.study.monte_carlo.workers import LocalProcesses, ThisProcess, Workers

SMALL = Plan(levels=(100,), draws=80)
SMALL_CHUNK = 4


class Peak:
    """Largest resident memory of this process and of each of its children, MiB (Linux)."""

    def __init__(self) -> None:
        self.own, self.child = 0.0, 0.0

    def look(self) -> None:
        self.own = max(self.own, _peak(Path("/proc/self")))
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                if int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid():
                    self.child = max(self.child, _peak(stat.parent))
            except OSError:
                continue


def _peak(process: Path) -> float:
    for line in (process / "status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return float(line.split()[1]) / 1024
    return 0.0


def full(out: Path, draws: int, jobs: int) -> None:
    case, peak, started = nominal_case(), Peak(), time.monotonic()

    def look(done: int, todo: int) -> None:
        if done % 2000 == 0 or done == todo:
            peak.look()
            seconds = time.monotonic() - started
            print(f"{done} of {todo} draws, {seconds:.0f} s, {done / max(seconds, 1e-9):.0f} draws/s", flush=True)

    study = monte_carlo(case, out, plan=Plan(draws=draws), workers=LocalProcesses(jobs), progress=look)
    print(f"{study.computed} draws in {time.monotonic() - started:.0f} s, {study.failed} not converged")
    began = time.monotonic()
    contributions = variance_contributions(MonteCarloContext(case, study.settings))
    contributions.to_csv(out / "contributions.csv", index=False)
    write_monte_carlo_figures(study.statistics, contributions, out / "figures")
    peak.look()
    print(
        f"figures in {time.monotonic() - began:.0f} s; peak memory {peak.own:.0f} MiB here, {peak.child:.0f} a worker"
    )
    left = unconverged(study.statistics)
    print(f"converged: {study.converged}")
    print(left[["set", "level", "quantity", "grf", "mean_settles", "cv_settles"]].to_string() if len(left) else "")
    for found in conclusions(study.statistics):
        print(f"{found.frame.value}: {found.claim}: {'holds' if found.holds else 'does not hold'}. {found.numbers}")
    for figure in PUBLISHED:
        ours = {frame.value: round(v, 3) for frame, v in beside(study.statistics, figure, study.settings).items()}
        print(f"{figure.varied.title} {figure.torque}: published {figure.value}, here {ours or 'at another bound'}")
    fifty = MonteCarloSettings(inertial_percent=50.0)
    plan = Plan(sets=(Varied.IP,), levels=(100,), draws=draws)
    wide = monte_carlo(case, settings=fifty, plan=plan, workers=ThisProcess())
    print(f"IP +-50 %: {beside(wide.statistics, PUBLISHED[-1], fifty)}, published {PUBLISHED[-1].value}")
    for distance in (4.0, 6.0, 8.0, 14.0):
        told = [
            f"{c.varied.title} {'>' if c.beyond else ''}{c.level:.0f} %" for c in expect(study.statistics, distance)
        ]
        print(f"marker RMS {distance:g} mm: {', '.join(told)}")


def small(out: Path, workers: Workers) -> None:
    monte_carlo(nominal_case(), out, plan=SMALL, workers=workers, chunk_draws=SMALL_CHUNK)


def kills(wanted: int) -> bool:
    """Kill a small study again and again; whenever it is through, compare it with one that was left alone."""
    moments, count, rounds, equal = random.Random(5), 0, 0, True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        small(folder / "whole", ThisProcess())
        reference = _digest(folder / "whole")
        while count < wanted:
            target = folder / f"killed{rounds}"
            process = subprocess.Popen([sys.executable, __file__, "small", str(target)], stderr=subprocess.DEVNULL)
            try:
                process.wait(moments.uniform(0.0, 8.0))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                count += 1
                continue
            rounds += 1
            equal &= process.returncode == 0 and _digest(target) == reference
            print(f"{count} kills, {rounds} finished, all equal: {equal}", flush=True)
        target = folder / f"killed{rounds}"
        small(target, LocalProcesses(2))
        equal &= _digest(target) == reference
        print(f"{count} kills, {rounds + 1} studies finished, bit-identical to an uninterrupted one: {equal}")
    return equal


def _digest(folder: Path) -> str:
    """Of all draws, bit by bit, and of the statistics, written with all digits."""
    draws = pd.util.hash_pandas_object(Store(folder).read(SMALL)).to_numpy().tobytes()
    return hashlib.sha256(draws + (folder / "montecarlo.csv").read_bytes()).hexdigest()


def scaling() -> None:
    from distributed import LocalCluster

    case = nominal_case()
    for draws in (100, 200, 400):
        began = time.monotonic()
        monte_carlo(case, plan=Plan(levels=(100,), draws=draws), workers=ThisProcess())
        print(f"{4 * draws} draws in this process: {time.monotonic() - began:.1f} s", flush=True)
    plan = Plan(levels=(100,), draws=200)
    best = {1: float("inf"), 2: float("inf")}
    with ExitStack() as stack:
        clusters = {
            count: stack.enter_context(LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None))
            for count in best
        }
        for _ in range(6):  # by turns, the best of each: the machine may have other work; the first also imports
            for count, cluster in clusters.items():
                began = time.monotonic()
                monte_carlo(case, plan=plan, workers=Cluster(cluster.scheduler_address), chunk_draws=10)
                best[count] = min(best[count], time.monotonic() - began)
                print(f"{plan.total} draws on {count} cluster workers: at best {best[count]:.1f} s", flush=True)
    print(f"two workers are {best[1] / best[2]:.2f} times one")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("full", "kills", "scaling", "small"))
    parser.add_argument("out", type=Path, nargs="?", default=Path("montecarlo-check"))
    parser.add_argument("--draws", type=int, default=5000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kills", type=int, default=50)
    told = parser.parse_args(arguments)
    if told.what == "full":
        full(told.out, told.draws, told.jobs)
    elif told.what == "kills":
        return 0 if kills(told.kills) else 1
    elif told.what == "scaling":
        scaling()
    else:
        small(told.out, LocalProcesses(2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
