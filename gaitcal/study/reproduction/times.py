"""Processor time of each problem beside the published times (3.4 GHz Pentium 4, Matlab)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gaitcal.study.reproduction.noise_seed import SeedResult
from gaitcal.study.reproduction.published import PROBLEMS, cpu_seconds
from gaitcal.study.reproduction.rows import TableRow

PHASES: tuple[tuple[str, str, Callable[[SeedResult], list[float]]], ...] = (
    ("phase 1, isolated trials", "isolated", lambda d: [d.joints[p].seconds for p in PROBLEMS[:3]]),
    ("phase 1, gait", "gait", lambda d: [d.joints["full leg"].seconds]),
    ("phase 2", "inertial", lambda d: [d.correct.seconds, *(r.seconds for r in d.random)]),
)


def time_rows(results: Sequence[SeedResult]) -> list[TableRow]:
    """Shortest, median and longest time of every problem solved in this run; they differ from run to run."""
    rows: list[TableRow] = []
    for row, key, of in PHASES:
        seconds = np.array([s for result in results for s in of(result)])
        low, high = cpu_seconds(key)
        figures = (
            ("shortest", low, seconds.min()),
            ("median", None, np.median(seconds)),
            ("longest", high, seconds.max()),
        )
        for column, published, ours in figures:
            note = f"processor time of {len(seconds)} problems"
            rows.append(TableRow("time", row, column, published, float(ours), "s", note))
    return rows


def speed_factor(results: Sequence[SeedResult]) -> float:
    """Smallest ratio over the phases of the shortest published time to our longest."""
    return min(cpu_seconds(key)[0] / max(s for result in results for s in of(result)) for _, key, of in PHASES)
