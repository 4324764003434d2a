"""Whole tasks, timed: the median of several runs after a warm-up, beside references measured in the same run.

    python scripts/benchmark.py                      # every section
    python scripts/benchmark.py track ip --json out.json

One BLAS thread, one process (start-up commands run in their own). References: SciPy's `least_squares` on the plain
problem with the sparse analytic Jacobian and with finite differences; OpenSim's inverse kinematics and inverse
dynamics on our exported model and the same markers (where `opensim` is installed); and, as a lower bound, the bare
Pinocchio calls that a frame and an iteration cannot avoid: one forward kinematics and one CRBA.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from statistics import median
from time import perf_counter

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which the next import does
sys.path.insert(0, str(Path(__file__).resolve().parent))

from benchmark_tasks import SECTIONS, Timing  # noqa: E402


def timed(task: Callable[[], object], runs: int) -> list[float]:
    """Seconds of `runs` runs after one warm-up."""
    task()
    out = []
    for _ in range(runs):
        start = perf_counter()
        task()
        out.append(perf_counter() - start)
    return out


def machine() -> dict[str, object]:
    """What the figures were measured on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "blas_threads": 1,
        "versions": {name: version(name) for name in ("pin", "numpy", "scipy")},
    }


def main(arguments: list[str] | None = None) -> dict[str, object]:
    """Run the chosen sections and print one line a figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}; all unless given")
    parser.add_argument("--runs", type=int, default=5, help="timed runs of each task (default 5)")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    chosen = parser.parse_args(arguments)
    unknown = [name for name in chosen.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"unknown section {unknown[0]}; allowed: {', '.join(SECTIONS)}")
    results: dict[str, object] = {"machine": machine()}
    for name in chosen.sections or SECTIONS:
        print(f"\n{name}")
        figures = {}
        for timing in SECTIONS[name]():
            seconds = timed(timing.task, chosen.runs if timing.runs is None else timing.runs)
            figures[timing.name] = _figure(timing, seconds)
        _print(figures)
        results[name] = figures
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return results


def _figure(timing: Timing, seconds: list[float]) -> dict[str, object]:
    figure: dict[str, object] = {"seconds": median(seconds), "least": min(seconds), "runs": len(seconds)}
    if timing.note:
        figure["note"] = timing.note() if callable(timing.note) else timing.note
    return figure


def _print(figures: dict[str, dict[str, object]]) -> None:
    first = next(iter(figures.values()))["seconds"]
    for name, figure in figures.items():
        seconds = float(figure["seconds"])  # type: ignore[arg-type]
        ratio = seconds / float(first)  # type: ignore[arg-type]
        print(f"  {name:<46}{seconds:12.4f} s   x {ratio:<9.3g}{figure.get('note', '')}")


if __name__ == "__main__":
    main()
