"""Whole tasks, timed: the median of several runs after a warm-up, beside references measured in the
same run. Short tasks run as often as half a second allows.

    python -m scripts.tools.benchmark                      # every section
    python -m scripts.tools.benchmark track ip --json out.json

One BLAS thread and one process, unless a figure says otherwise (whole programs run in their own).
References: SciPy's `least_squares` on the plain problem with the sparse analytic Jacobian, and with
finite differences on a part of it; OpenSim's inverse kinematics and inverse dynamics on our
exported model and the same markers (where `opensim` is installed); and, as a lower bound, the bare
Pinocchio calls that a pass over the frames cannot avoid.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import timeit
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np

from scripts.tools.benchmark.references import Figure
from scripts.tools.benchmark.tasks import SECTIONS
from scripts.validation.harness import say

PACKAGES = ("pin", "numpy", "scipy", "opensim")
MODULES = {"pin": "pinocchio"}
SHORT_SECONDS, MOST_RUNS = 0.5, 50
"""A task is repeated until that much time has gone, or so often: five runs of some milliseconds
scatter.
"""


def timed(task: Callable[[], object], runs: int, *, more: bool = False) -> list[float]:
    """Seconds of `runs` runs after one warm-up; a single run has none.

    `more`: as many runs as `SHORT_SECONDS` allows, if those are more.
    """
    if runs > 1:
        task()
    out: list[float] = []
    while len(out) < runs or (more and len(out) < MOST_RUNS and sum(out) < SHORT_SECONDS):
        out += timeit.repeat(task, repeat=1, number=1)
    return out


def machine() -> dict[str, object]:
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "blas_threads": 1,
        "worker_threads": 1,
        "versions": {
            name: version(name) for name in PACKAGES if find_spec(MODULES.get(name, name))
        },
    }


def _processor() -> str:
    known = Path("/proc/cpuinfo")
    lines = known.read_text(encoding="utf-8").splitlines() if known.exists() else []
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def main(arguments: list[str] | None = None) -> dict[str, object]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "sections",
        nargs="*",
        choices=[[], *SECTIONS],
        metavar="SECTION",
        help=f"of {', '.join(SECTIONS)}",
    )
    parser.add_argument(
        "--runs", type=int, default=5, help="timed runs of each task, at least (default 5)"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    chosen = parser.parse_args(arguments)
    results: dict[str, object] = {"machine": machine()}
    say(json.dumps(results["machine"]))
    for name in chosen.sections or SECTIONS:
        say(f"\n{name}: median of at least {chosen.runs} runs unless told")
        results[name] = _section(SECTIONS[name](), chosen.runs)
    results["load_average_after"] = round(os.getloadavg()[0], 2)
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return results


def exponent(points: Sequence[tuple[float, float]]) -> float:
    """E of  value = c size^e, by least squares in logarithms."""
    sizes, values = np.log(points).T
    return float(np.polyfit(sizes, values, 1)[0])


def _section(parts: Iterable[Figure], runs: int) -> dict[str, dict[str, object]]:
    figures: dict[str, dict[str, object]] = {}
    series: dict[str, list[tuple[float, float]]] = {}
    first = 0.0
    for part in parts:
        if part.unit == "s":
            free = part.runs is None
            seconds = timed(
                part.task, runs if free else min(part.runs, runs), more=free and runs > 1
            )
            value = median(seconds)
            first = first or value
            told = {"seconds": value, "least": min(seconds), "runs": len(seconds)}
            beside = f"x {value / first:<9.3g}"
        else:
            value = float(part.task())  # type: ignore[arg-type]
            told, beside = {"value": value, "unit": part.unit}, ""
        said = part.note(value) if callable(part.note) else part.note
        figures[part.name] = {**told, "note": said}
        say(f"  {part.name:<50}{value:10.4f} {part.unit:<4}{beside}{said}")
        if part.series:
            series.setdefault(part.series, []).append(
                (part.size, value / (part.share() if part.share else 1.0))
            )
    for name, points in series.items():
        if len(points) > 1:
            found = exponent(points)
            figures[f"exponent: {name}"] = {
                "value": found,
                "unit": "",
                "note": f"over {len(points)} sizes",
            }
            say(f"  exponent: {name:<40}{found:10.3f}")
    return figures


if __name__ == "__main__":
    main()
