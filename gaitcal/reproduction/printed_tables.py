"""The rows of `tables.csv` and `times.csv`: every printed figure of the paper, with ours beside it.

What depends on the noise is told as the median over draws of the noise; a note tells their range
and where the printed figure lies, for the published study drew its noise once, and one draw can
only be compared with a range. Times are of the processor; the published ones are of a 3.4 GHz
Pentium 4 with Matlab.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.calibration.inertial_calibration import TorqueScale
from gaitcal.montecarlo.protocol import (
    PROBLEMS,
    get_cpu_seconds,
    get_figure,
    get_table_four,
    get_table_one,
    get_table_three,
    get_table_two,
)
from gaitcal.reproduction.recovery import (
    NOISELESS_DECAY,
    InertialRecovery,
    JointRecovery,
    SeedResult,
)

EXPERIMENT = "needs the unpublished experimental trial; cannot be reproduced"
JOINT_FIGURES: tuple[tuple[str, str, str, Callable[[JointRecovery], float | None]], ...] = (
    ("marker_distance_mm", "marker distance RMS", "mm", lambda r: r.marker_mm),
    ("orientation_deg", "orientation error RMS", "deg", lambda r: r.orientation_deg),
    ("position_mm", "position error RMS", "mm", lambda r: r.position_mm),
)
"""Of Table I: key of the printed figure, row, unit, ours; None where a joint has no parameter of
that kind.
"""
RESIDUALS: tuple[tuple[str, str, Callable[[InertialRecovery], float]], ...] = (
    ("residual force RMS", "N", lambda r: r.force),
    ("residual torque RMS", "N*m", lambda r: r.torque),
)
INERTIAL_FIGURES = (
    *RESIDUALS,
    ("inertia error RMS", "kg*mm^2", lambda r: r.errors.inertia),
    ("mass error RMS", "kg", lambda r: r.errors.mass),
    ("mass centre error RMS", "mm", lambda r: r.errors.centre),
)
"""Columns of Table III: title, unit, ours."""
SCALES = {
    TorqueScale.BODY_HEIGHT: ("BWxH", "BW*H"),
    TorqueScale.PELVIS_WIDTH: ("BWxPelvicWidth", "BW*pelvic width"),
    TorqueScale.MILLIMETRE: ("BWx1mm", "BW*1 mm"),
}
PHASES: tuple[tuple[str, str, Callable[[SeedResult], list[float]]], ...] = (
    ("phase 1, isolated trials", "isolated", lambda d: [d.joints[p].seconds for p in PROBLEMS[:3]]),
    ("phase 1, gait", "gait", lambda d: [d.joints["full leg"].seconds]),
    ("phase 2", "inertial", lambda d: [d.correct.seconds, *(r.seconds for r in d.random)]),
)
RUN = "this run"  # Row of `times.csv` with the time of the parts of a run
SAME_COST = 1.0001
MARKER_SET = (
    "the paper gives neither marker set nor frame rate; ours: 41 markers at 200 Hz; fewer markers "
    "or shorter trials "
    "leave less of the noise"
)
SLOW_NOISE = (
    "slow noise moves markers for good; nothing in the trial can tell it from another joint centre"
)
ANKLE = "the axes of talocrural and subtalar joint turn together almost freely in this trial"
LITERAL = "re-seeded until residuals change by less than 0.1 %, as published"
STOP = "grows with the number of re-seeds, hence with where exactly 0.1 % is reached"
WEAK = "31 of the 36 directions are seen by the pelvis residual; the others keep the seed's values"


@dataclass(frozen=True)
class DrawSpread:
    """A figure over the draws of the noise."""

    median: float
    low: float
    high: float
    draws: int

    def place(self, published: float) -> str:
        """`inside`, `below` or `above` the range."""
        if published < self.low:
            return "below"
        return "above" if published > self.high else "inside"


def spread(values: Iterable[float]) -> DrawSpread:
    """Median and range of at least one figure."""
    array = np.array(list(values), dtype=float)
    return DrawSpread(float(np.median(array)), float(array.min()), float(array.max()), len(array))


@dataclass(frozen=True)
class TableRow:
    """A place in the tables, one published figure, and ours; None where there is none."""

    table: str
    row: str
    column: str
    unit: str
    published: float | None = None
    ours: float | None = None
    note: str = ""

    def filled(self, published: float | None, ours: float | None, *notes: str) -> "TableRow":
        """With one figure of ours, or none."""
        return replace(self, published=published, ours=ours, note="; ".join(filter(None, notes)))

    def over_draws(
        self, published: float | None, values: Iterable[float], note: str = ""
    ) -> "TableRow":
        """With a figure that depends on the noise: its median, with range and place of the printed
        one in the note.
        """
        ours = spread(values)
        summary = f"median of {ours.draws} noise draws, range {ours.low:.3g} to {ours.high:.3g}"
        place = "" if published is None else f"published value {ours.place(published)} the range"
        return self.filled(published, ours.median, summary, place, note)

    def experiment(self, published: float, note: str = "") -> "TableRow":
        """With a printed figure that only the unpublished trial could give."""
        return self.filled(published, None, EXPERIMENT, note)


def table_one_rows(clean: SeedResult, draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table I: what phase 1 leaves of markers, without and with noise, and the experimental rows as
    printed.
    """
    rows: list[TableRow] = []
    for key, title, unit, figure in JOINT_FIGURES:
        for problem, published in get_table_one("synthetic_without_noise", key).items():
            cell, recovery = (
                TableRow("I", f"synthetic without noise: {title}", problem, unit),
                clean.joints[problem],
            )
            if (ours := figure(recovery)) is not None:
                rows.append(
                    cell.filled(published, ours, f"from absolute zero in {recovery.steps} steps")
                )
    for key, title, unit, figure in JOINT_FIGURES:
        for problem, published in get_table_one("synthetic_with_noise", key).items():
            cell = TableRow("I", f"synthetic with noise: {title}", problem, unit)
            values = [v for draw in draws if (v := figure(draw.joints[problem])) is not None]
            if values and published is not None:
                rows.append(cell.over_draws(published, values, _why(key, problem)))
    cell = TableRow("I", "synthetic with noise: largest marker distance", "any", "mm")
    peaks = [max(r.largest_mm for r in draw.joints.values()) for draw in draws]
    rows.append(cell.over_draws(float(get_figure("largest_marker_distance_mm")["single"]), peaks))
    for printed, row in (
        ("experimental_phase1", "phase 1"),
        ("experimental_anatomical", "anatomical"),
    ):
        for problem, published in get_table_one(printed, "marker_distance_mm").items():
            if published is not None:
                cell = TableRow("I", f"experimental, {row}: marker distance RMS", problem, "mm")
                rows.append(cell.experiment(published))
    for problem, fall in zip(PROBLEMS, get_figure("jp_reduction_marker_error_pct"), strict=True):
        rows.append(
            TableRow("I", "experimental: fall of marker distance", problem, "%").experiment(fall)
        )
    return [*rows, *_minimum_rows(draws)]


def _minimum_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """In how many problems the search from zero ended where one from the truth does: not in the
    paper.
    """
    rows = []
    for problem in PROBLEMS:
        same = [
            d.joints[problem].cost <= SAME_COST * d.joints[problem].cost_from_truth for d in draws
        ]
        cell = TableRow(
            "I", "synthetic with noise: same minimum from zero as from the truth", problem, "%"
        )
        rows.append(
            cell.filled(
                None,
                100.0 * float(np.mean(same)),
                f"of {len(same)} noise draws; cost within 0.01 %",
            )
        )
    return rows


def _why(key: str, problem: str) -> str:
    """Why a figure of Table I may differ from the printed one."""
    if key == "marker_distance_mm":
        return MARKER_SET
    return {"ankle": ANKLE, "hip": SLOW_NOISE}.get(problem, "")


def table_two_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table II: signed errors of the left leg's 27 parameters with noise, and the experimental
    columns as printed.
    """
    rows: list[TableRow] = []
    for printed in get_table_two():
        joint = printed.name.split("_")[0]
        isolated = joint if joint in PROBLEMS else "ankle"
        for column, problem, (published, experiment) in (
            ("single joint", isolated, printed.single_joint),
            ("full leg", "full leg", printed.full_leg),
        ):
            recovered = [draw.joints[problem] for draw in draws]
            values = np.array([r.errors[r.names.index(printed.name)] for r in recovered])
            size = f"median size {np.median(np.abs(values)):.3g}"
            cell = TableRow("II", printed.title, f"{column}, synthetic", printed.unit)
            rows.append(cell.over_draws(published, values, size))
            cell = TableRow("II", printed.title, f"{column}, experimental", printed.unit)
            rows.append(cell.experiment(experiment))
    return rows


def table_three_rows(clean: SeedResult, draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table III: pelvis residuals and errors of inertial parameters, from the correct seed and from
    random seeds.
    """
    rows: list[TableRow] = []
    without = get_table_three("synthetic_without_noise")
    correct = get_table_three("synthetic_with_noise_correct_seed")
    random = get_table_three("synthetic_with_noise_random_seeds")
    passes = (
        f"penalty times {NOISELESS_DECAY} at every re-seed, up to "
        f"{max(r.seeds for r in clean.random)} seeds"
    )
    for k, (column, unit, figure) in enumerate(INERTIAL_FIGURES):
        cell = TableRow("III", "synthetic without noise, correct seed", column, unit)
        rows.append(cell.filled(without[k], figure(clean.correct)))
        cell = TableRow("III", "synthetic without noise, random seeds: mean", column, unit)
        values = [figure(r) for r in clean.random]
        note = f"mean of {len(values)} seeds, range {min(values):.3g} to {max(values):.3g}"
        rows.append(
            cell.filled(
                None, float(np.mean(values)), note, passes, WEAK if k >= len(RESIDUALS) else ""
            )
        )
    for k, (column, unit, figure) in enumerate(INERTIAL_FIGURES):
        why = LITERAL if k < len(RESIDUALS) else f"{LITERAL}; {STOP}"
        cases = [np.array([figure(r) for r in d.random]) for d in draws]
        for row, published, values, note in (
            ("correct seed", correct[k], [figure(d.correct) for d in draws], why),
            (
                "correct seed, without re-seeding",
                correct[k],
                [figure(d.single_pass) for d in draws],
                "",
            ),
            ("random seeds: mean", random[k][0], [float(c.mean()) for c in cases], why),
            (
                "random seeds: standard deviation",
                random[k][1],
                [float(c.std(ddof=1)) for c in cases],
                "",
            ),
        ):
            cell = TableRow("III", f"synthetic with noise, {row}", column, unit)
            rows.append(cell.over_draws(published, values, note))
    for k, (column, unit, _) in enumerate(RESIDUALS):
        for printed, row in (
            ("experimental_phase2", "phase 2"),
            ("experimental_anatomical", "anatomical"),
        ):
            rows.append(
                TableRow("III", f"experimental, {row}", column, unit).experiment(
                    get_table_three(printed)[k]
                )
            )
    for (column, _, _), key in zip(RESIDUALS, ("force", "torque"), strict=True):
        for stage, name in (
            ("phase 2", "ip_reduction_residual_pct"),
            ("third step", "third_step_reduction_pct"),
        ):
            cell = TableRow("III", f"experimental, {stage}: fall of residual", column, "%")
            rows.append(cell.experiment(get_figure(name)[key]))
    cell = TableRow(
        "III", "synthetic with noise, random seeds: bodies that could exist", "solutions", "%"
    )
    possible = 100.0 * float(np.mean([r.physical for d in draws for r in d.random]))
    return [*rows, cell.filled(None, possible, "the published cost does not ask for it")]


def table_four_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Table IV: errors of the 36 parameters with noise, and of `foot superior`, which was held."""
    rows: list[TableRow] = []
    for p in get_table_four():
        held = (
            "drawn with the random seeds and held: no variable" if p.name == "foot.com.sup" else ""
        )
        cases = [np.array([r.each[p.name] for r in d.random]) for d in draws]
        for column, published, values in (
            ("correct seed", p.correct_seed, [d.correct.each[p.name] for d in draws]),
            ("random seeds: mean", p.random_seeds[0], [float(c.mean()) for c in cases]),
            (
                "random seeds: standard deviation",
                p.random_seeds[1],
                [float(c.std(ddof=1)) for c in cases],
            ),
        ):
            rows.append(TableRow("IV", p.title, column, p.unit).over_draws(published, values, held))
        rows.append(
            TableRow("IV", p.title, "experimental", p.unit).experiment(p.experimental, p.note)
        )
    cell = TableRow("IV", "mass, whole body", "correct seed", "kg")
    return [
        *rows,
        cell.over_draws(get_figure("mass_sum_kg"), [d.correct.total_mass for d in draws]),
    ]


def discussion_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """The discussion: normalisations of torque, and the third step; published for the experimental
    trial only.
    """
    rows: list[TableRow] = []
    other = "published figure: experimental trial; ours: synthetic with noise"
    for scale, (key, divisor) in SCALES.items():
        for k, (column, unit, figure) in enumerate(RESIDUALS):
            cell, printed = (
                TableRow("discussion", f"torque divided by {divisor}", column, unit),
                get_figure("torque_weighting")[key],
            )
            values = [figure(d.scales[scale]) for d in draws]
            rows.append(cell.over_draws(printed[k], values, f"{other}, correct seed"))
    third, printed = [d.third for d in draws if d.third is not None], get_figure("third_step")
    for column, unit, pairs, figures in (
        ("residual force RMS", "N", [t.force for t in third], printed["force_N"]),
        ("residual torque RMS", "N*m", [t.torque for t in third], printed["torque_Nm"]),
        ("marker distance RMS", "mm", [t.marker_mm for t in third], [None, None]),
        ("position error RMS of the 17", "mm", [t.position_mm for t in third], [None, None]),
    ):
        for k, when in enumerate(("before", "after")):
            cell = TableRow("discussion", f"third step, {when}", column, unit)
            rows.append(cell.over_draws(figures[k], [pair[k] for pair in pairs], other))
    return rows


def time_rows(results: Sequence[SeedResult]) -> list[TableRow]:
    """Shortest, median and longest time of every problem solved in this run; they differ from run
    to run.
    """
    rows: list[TableRow] = []
    for row, key, times in PHASES:
        seconds = np.array([s for result in results for s in times(result)])
        shortest, longest = get_cpu_seconds(key)
        for column, published, ours in (
            ("shortest", shortest, seconds.min()),
            ("median", None, np.median(seconds)),
            ("longest", longest, seconds.max()),
        ):
            cell = TableRow("time", row, column, "s")
            rows.append(
                cell.filled(published, float(ours), f"processor time of {len(seconds)} problems")
            )
    return rows


def run_time_rows(laps: Mapping[str, float]) -> list[TableRow]:
    """Seconds by the clock of each part of this run, and of all."""
    parts = {**laps, "everything": sum(laps.values())}
    return [
        TableRow("time", RUN, part, "s").filled(None, seconds, "by the clock")
        for part, seconds in parts.items()
    ]


def speed_factor(results: Sequence[SeedResult]) -> float:
    """Smallest ratio over the phases of the shortest published time to our longest."""
    return min(
        get_cpu_seconds(key)[0] / max(s for result in results for s in times(result))
        for _, key, times in PHASES
    )
