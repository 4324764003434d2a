"""What the Monte Carlo study must show, measured on this machine.

python -m scripts.validation montecarlo full OUT [--draws 5000] [--jobs 2]   time, memory, convergence, conclusions
python -m scripts.validation montecarlo kills [--kills 50]                   SIGKILL at random moments, same bits
python -m scripts.validation montecarlo scaling                              linear in draws; two workers against one

Exit code 1 where a limit is not met: 30 minutes, 1 GiB for each process and the published convergence (full), the same
bits (kills), two workers 1.7 times as fast as one (scaling). Limits of time hold on two free cores.
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
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from statistics import median

import pandas as pd

from gaitcal.figures.monte_carlo import write_monte_carlo_figures
from gaitcal.montecarlo.case import nominal_case
from gaitcal.montecarlo.conclusions import PUBLISHED, beside, conclusions
from gaitcal.montecarlo.context import MonteCarloContext
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan, ReactionFrame, Varied
from gaitcal.montecarlo.statistics import expect, unconverged
from gaitcal.montecarlo.store import Store
from gaitcal.montecarlo.study import MonteCarloStudy, monte_carlo
from gaitcal.montecarlo.variance import variance_contributions
from gaitcal.montecarlo.workers import Cluster, LocalProcesses, ThisProcess, Workers

SMALL = Plan(levels=(100,), draws=80)
SMALL_CHUNK = 4
MOST_SECONDS, MOST_MIB = 1800.0, 1024.0
"""Of a full study on two cores; of each of its processes."""
LEAST_SPEED_UP = 1.7
"""Of two workers against one."""


class Peak:
    """Largest resident memory of this process and of each of its children, MiB (Linux)."""

    def __init__(self) -> None:
        self.here, self.worker = 0.0, 0.0

    def look(self) -> None:
        self.here = max(self.here, _peak(Path("/proc/self")))
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                if int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid():
                    self.worker = max(self.worker, _peak(stat.parent))
            except OSError:
                continue


def _peak(process: Path) -> float:
    for line in (process / "status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return float(line.split()[1]) / 1024
    return 0.0


def judged(name: str, figure: str, limit: str, met: bool) -> bool:
    """Say whether a limit is met."""
    print(f"{'met' if met else 'NOT MET'}: {name} {figure}, limit {limit}", flush=True)
    return met


def full_limits(seconds: float, peak: Peak, study: MonteCarloStudy) -> bool:
    """Whether a full study was quick, small and converged: all three are told."""
    largest, late = max(peak.here, peak.worker), len(unconverged(study.statistics))
    met = [
        judged(
            "time", f"{seconds:.0f} s for {study.computed} new draws", f"{MOST_SECONDS:.0f} s", seconds <= MOST_SECONDS
        ),
        judged("peak memory", f"{largest:.0f} MiB", f"{MOST_MIB:.0f} MiB", largest <= MOST_MIB),
        judged("distributions not settled within 2 %", f"{late}", "0", late == 0),
    ]
    return all(met)


def _in_words(errors: Mapping[ReactionFrame, float]) -> str:
    return ", ".join(f"{error:.2f} ({frame.value})" for frame, error in errors.items())


def full(out: Path, draws: int, jobs: int) -> bool:
    case, peak, started = nominal_case(), Peak(), time.monotonic()

    def look(done: int, todo: int) -> None:
        if done % 2000 == 0 or done == todo:
            peak.look()
            seconds = time.monotonic() - started
            print(f"{done} of {todo} draws, {seconds:.0f} s, {done / max(seconds, 1e-9):.0f} draws/s", flush=True)

    study = monte_carlo(case, out, plan=Plan(draws=draws), workers=LocalProcesses(jobs), progress=look)
    seconds = time.monotonic() - started
    print(f"{study.computed} draws in {seconds:.0f} s, {study.failed} not converged")
    began = time.monotonic()
    contributions = variance_contributions(MonteCarloContext(case, study.settings))
    contributions.to_csv(out / "contributions.csv", index=False)
    write_monte_carlo_figures(study.statistics, contributions, out / "figures")
    peak.look()
    print(
        f"figures in {time.monotonic() - began:.0f} s; peak memory {peak.here:.0f} MiB here, {peak.worker:.0f} a worker"
    )
    left = unconverged(study.statistics)
    print(f"converged: {study.converged}")
    print(left[["set", "level", "quantity", "grf", "mean_settles", "cv_settles"]].to_string() if len(left) else "")
    for c in conclusions(study.statistics):
        print(f"{c.frame.value}: {c.claim}: {c.verdict}. {c.numbers}")
    for figure in PUBLISHED:
        ours = _in_words(beside(study.statistics, figure, study.settings))
        print(f"{figure.varied.title} {figure.torque}: published {figure.value}, here {ours or 'at another bound'}")
    fifty = MonteCarloSettings(inertial_percent=50.0)
    plan = Plan(sets=(Varied.IP,), levels=(100,), draws=draws)
    wide = monte_carlo(case, settings=fifty, plan=plan, workers=ThisProcess())
    print(f"IP +-50 %: {_in_words(beside(wide.statistics, PUBLISHED[-1], fifty))}, published {PUBLISHED[-1].value}")
    for distance in (4.0, 6.0, 8.0, 14.0):
        levels = [
            f"{c.varied.title} {'>' if c.beyond else ''}{c.level:.0f} %" for c in expect(study.statistics, distance)
        ]
        print(f"marker RMS {distance:g} mm: {', '.join(levels)}")
    return full_limits(seconds, peak, study)


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


def scaling() -> bool:
    from distributed import LocalCluster

    case = nominal_case()
    for draws in (100, 200, 400):
        began = time.monotonic()
        monte_carlo(case, plan=Plan(levels=(100,), draws=draws), workers=ThisProcess())
        print(f"{4 * draws} draws in this process: {time.monotonic() - began:.1f} s", flush=True)
    plan = Plan(levels=(100,), draws=400)  # a fiftieth of the published study
    seconds: dict[int, list[float]] = {1: [], 2: []}
    with ExitStack() as stack:
        clusters = {
            count: stack.enter_context(LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None))
            for count in seconds
        }
        for turn in range(6):  # by turns, as the machine may have other work; the first also imports and does not count
            for count, cluster in clusters.items():
                began = time.monotonic()
                monte_carlo(case, plan=plan, workers=Cluster(cluster.scheduler_address), chunk_draws=10)
                took = time.monotonic() - began
                print(f"{plan.total} draws on {count} cluster workers: {took:.1f} s", flush=True)
                if turn:
                    seconds[count].append(took)
    one, two = (median(seconds[count]) for count in seconds)
    print(f"two workers against one, medians of {len(seconds[1])}: {two:.1f} and {one:.1f} s")
    return fast_enough(one, two)


def fast_enough(one: float, two: float) -> bool:
    """Whether two workers, in seconds `two`, are enough faster than one, in seconds `one`."""
    return judged(
        "two workers against one", f"{one / two:.2f} times", f"{LEAST_SPEED_UP:g}", one / two >= LEAST_SPEED_UP
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("full", "kills", "scaling", "small"))
    parser.add_argument("out", type=Path, nargs="?", default=Path("montecarlo-check"))
    parser.add_argument("--draws", type=int, default=5000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kills", type=int, default=50)
    chosen = parser.parse_args(arguments)
    if chosen.what == "full":
        return 0 if full(chosen.out, chosen.draws, chosen.jobs) else 1
    if chosen.what == "kills":
        return 0 if kills(chosen.kills) else 1
    if chosen.what == "scaling":
        return 0 if scaling() else 1
    small(chosen.out, LocalProcesses(2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
