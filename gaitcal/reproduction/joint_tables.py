"""Tables I and II: what phase 1 leaves of markers, and the errors of joint parameters.

Processor time of each problem beside the published times (3.4 GHz Pentium 4, Matlab).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gaitcal.reproduction.joint_recovery import JointRecovery
from gaitcal.reproduction.noise_seed import SeedResult
from gaitcal.reproduction.published import PROBLEMS, JointParameterRow, cpu_seconds, table_one, table_two, text
from gaitcal.reproduction.rows import TableRow, experiment_row, spread, spread_row

QUANTITIES = (
    ("marker_distance_mm", "marker distance RMS", "mm"),
    ("orientation_deg", "orientation error RMS", "deg"),
    ("position_mm", "position error RMS", "mm"),
)
MARKER_SET = (
    "the paper gives neither marker set nor frame rate; ours: 41 markers at 200 Hz; fewer markers or shorter trials "
    "leave less of the noise"
)
SLOW_NOISE = "slow noise moves markers for good; nothing in the trial can tell it from another joint centre"
SAME_COST = 1.0001
ANKLE = "the axes of talocrural and subtalar joint turn together almost freely in this trial"


def quantity(recovery: JointRecovery, name: str) -> float | None:
    """A figure of Table I; None where the joint has no parameter of that kind."""
    return {
        "marker_distance_mm": recovery.marker_mm,
        "orientation_deg": recovery.orientation_deg,
        "position_mm": recovery.position_mm,
    }[name]


def table_one_rows(clean: SeedResult, draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table I, synthetic without and with noise, and the experimental rows as printed."""
    rows: list[TableRow] = []
    for name, title, unit in QUANTITIES:
        row = f"synthetic without noise: {title}"
        for problem, published in table_one("synthetic_without_noise", name).items():
            ours = quantity(clean.joints[problem], name)
            if ours is not None:
                steps = f"from absolute zero in {clean.joints[problem].steps} steps"
                rows.append(TableRow("I", row, problem, published, ours, unit, steps))
    for name, title, unit in QUANTITIES:
        row = f"synthetic with noise: {title}"
        for problem, published in table_one("synthetic_with_noise", name).items():
            values = [v for draw in draws if (v := quantity(draw.joints[problem], name)) is not None]
            if values and published is not None:
                rows.append(spread_row("I", row, problem, published, spread(values), unit, _why(name, problem)))
    peaks = spread(max(r.largest_mm for r in draw.joints.values()) for draw in draws)
    printed_peak = float(text("largest_marker_distance_mm")["single"])
    rows.append(spread_row("I", "synthetic with noise: largest marker distance", "any", printed_peak, peaks, "mm"))
    for printed, row in (("experimental_phase1", "phase 1"), ("experimental_anatomical", "anatomical")):
        for problem, published in table_one(printed, "marker_distance_mm").items():
            if published is not None:
                rows.append(experiment_row("I", f"experimental, {row}: marker distance RMS", problem, published, "mm"))
    for problem, fall in zip(PROBLEMS, text("jp_reduction_marker_error_pct"), strict=True):
        rows.append(experiment_row("I", "experimental: fall of marker distance", problem, fall, "%"))
    return [*rows, *_minimum_rows(draws)]


def _minimum_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """In how many problems the search from zero ended where one from the truth does: not in the paper."""
    rows = []
    for problem in PROBLEMS:
        found = [draw.joints[problem] for draw in draws]
        same = 100.0 * float(np.mean([r.cost <= SAME_COST * r.cost_from_truth for r in found]))
        row = "synthetic with noise: same minimum from zero as from the truth"
        rows.append(TableRow("I", row, problem, None, same, "%", f"of {len(found)} noise draws; cost within 0.01 %"))
    return rows


def _why(name: str, problem: str) -> str:
    if name == "marker_distance_mm":
        return MARKER_SET
    if problem == "ankle":
        return ANKLE
    return SLOW_NOISE if problem == "hip" else ""


def table_two_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table II: signed errors of the left leg's 27 parameters with noise, and the experimental columns as printed."""
    rows: list[TableRow] = []
    for printed in table_two():
        isolated = _problem_of(printed.name)
        for column, problem, published, experiment in (
            ("single joint", isolated, printed.single_joint, printed.single_joint_experimental),
            ("full leg", "full leg", printed.full_leg, printed.full_leg_experimental),
        ):
            values = np.array([_error(draw.joints[problem], printed) for draw in draws])
            size = f"median size {np.median(np.abs(values)):.3g}"
            rows.append(
                spread_row("II", printed.title, f"{column}, synthetic", published, spread(values), printed.unit, size)
            )
            rows.append(experiment_row("II", printed.title, f"{column}, experimental", experiment, printed.unit))
    return rows


def _problem_of(name: str) -> str:
    joint = name.split("_")[0]
    return joint if joint in PROBLEMS else "ankle"


def _error(recovery: JointRecovery, printed: JointParameterRow) -> float:
    return float(recovery.errors[recovery.names.index(printed.name)])


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
