"""Whole tasks, timed: the median of several runs after a warm-up, beside references measured in the same run.
Short tasks run as often as half a second allows.

    python -m scripts.tools.benchmark                      # every section
    python -m scripts.tools.benchmark track ip --json out.json

One BLAS thread and one process, unless a figure says otherwise (whole programs run in their own). References: SciPy's
`least_squares` on the plain problem with the sparse analytic Jacobian, and with finite differences on a part of it;
OpenSim's inverse kinematics and inverse dynamics on our exported model and the same markers (where `opensim` is
installed); and, as a lower bound, the bare Pinocchio calls that a pass over the frames cannot avoid.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

from scripts.tools.benchmark.figure import Amount, Timing
from scripts.tools.benchmark.tasks import SECTIONS

PACKAGES = ("pin", "numpy", "scipy", "opensim")
MODULES = {"pin": "pinocchio"}
SHORT_SECONDS, MOST_RUNS = 0.5, 50
"""A task is repeated until that much time has gone, or so often: five runs of some milliseconds scatter."""


def timed(task: Callable[[], object], runs: int, *, more: bool = False) -> list[tuple[float, float]]:
    """Seconds, and seconds of processor time, of `runs` runs after one warm-up; a single run has none.

    `more`: as many runs as `SHORT_SECONDS` allows, if those are more.
    """
    if runs > 1:
        task()
    out: list[tuple[float, float]] = []
    while len(out) < runs or (more and len(out) < MOST_RUNS and sum(wall for wall, _ in out) < SHORT_SECONDS):
        start, used = perf_counter(), processor_time()
        task()
        out.append((perf_counter() - start, processor_time() - used))
    return out


def processor_time() -> float:
    """Seconds of this process and of the children that have ended: what other work on the machine disturbs least."""
    try:
        import resource
    except ImportError:  # Windows
        return process_time()
    parts = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in parts)


def machine() -> dict[str, object]:
    """What the figures were measured on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "blas_threads": 1,
        "worker_threads": 1,
        "versions": {name: version(name) for name in PACKAGES if find_spec(MODULES.get(name, name))},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def main(arguments: list[str] | None = None) -> dict[str, object]:
    """Run the chosen sections and print one line a figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}; all unless given")
    parser.add_argument("--runs", type=int, default=5, help="timed runs of each task, at least (default 5)")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    chosen = parser.parse_args(arguments)
    unknown = [name for name in chosen.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"unknown section {unknown[0]}; allowed: {', '.join(SECTIONS)}")
    results: dict[str, object] = {"machine": machine()}
    print(json.dumps(results["machine"]))
    for name in chosen.sections or SECTIONS:
        print(f"\n{name}: seconds and processor time, median of at least {chosen.runs} runs unless told", flush=True)
        results[name] = _section(SECTIONS[name](), chosen.runs)
    results["load_average_after"] = round(os.getloadavg()[0], 2)
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return results


def exponent(points: Sequence[tuple[float, float]]) -> float:
    """E of  value = c size^e, by least squares in logarithms."""
    sizes, values = np.log(points).T
    return float(np.polyfit(sizes, values, 1)[0])


def _section(parts: list[Timing] | list[Timing | Amount], runs: int) -> dict[str, dict[str, object]]:
    """Measure and print the figures of a section, and the exponents of its series."""
    figures: dict[str, dict[str, object]] = {}
    series: dict[str, list[tuple[float, float]]] = {}
    for part in parts:
        if isinstance(part, Timing):
            free = part.runs is None
            both = timed(part.task, runs if free else min(part.runs, runs), more=free and runs > 1)
            seconds, processor = zip(*both, strict=True)
            value, used = median(seconds), median(processor)
            said = part.note(value) if callable(part.note) else part.note
            told = {"seconds": value, "least": min(seconds), "processor_seconds": used, "runs": len(both), "note": said}
            figures[part.name] = told
            first = next(float(f["seconds"]) for f in figures.values() if "seconds" in f)  # type: ignore[arg-type]
            print(f"  {part.name:<50}{value:10.4f} s {used:10.4f} s  x {value / first:<9.3g}{said}", flush=True)
            value /= part.share() if part.share else 1.0
        else:
            value = part.measure()
            figures[part.name] = {"value": value, "unit": part.unit, "note": part.note}
            print(f"  {part.name:<50}{value:10.4f} {part.unit:<26}{part.note}", flush=True)
        if part.series:
            series.setdefault(part.series, []).append((part.size, value))
    for name, points in series.items():
        if len(points) > 1:
            found = exponent(points)
            figures[f"exponent: {name}"] = {"value": found, "unit": "", "note": f"over {len(points)} sizes"}
            print(f"  exponent: {name:<40}{found:10.3f}")
    return figures


if __name__ == "__main__":
    main()
