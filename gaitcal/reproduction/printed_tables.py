"""Make the rows of `tables.csv` and `times.csv`: printed figures of the paper, and ours.

Figures that depend on the noise are medians over draws of the noise. A note has their range and
whether the printed figure is inside: the published study drew its noise once, and one draw can only
be compared with a range. Times are of the processor; the published ones are of a 3.4 GHz Pentium 4
with Matlab.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

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
"""Figures of Table I: key of the printed figure, row, unit, ours; None if a joint has no parameter
of that kind.
"""
Figure = Callable[[InertialRecovery], float]
RESIDUALS: tuple[tuple[str, str, Figure], ...] = (
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
"""Rows of times: title, key of the published time, ours of one result (s)."""
RUN = "this run"
"""Row of `times.csv` with the time of the parts of a run."""
SAME_COST = 1.0001
"""Largest ratio of the costs of two searches that end in the same minimum."""
MARKER_SET = (
    "the paper gives neither marker set nor frame rate; ours: 41 markers at 200 Hz; fewer markers "
    "or shorter trials leave less of the noise"
)
SLOW_NOISE = (
    "noise slower than the trial shifts markers like another joint centre; the trial does not "
    "distinguish them"
)
ANKLE = "this trial hardly determines a common rotation of the talocrural and subtalar axes"
LITERAL = "re-seeded until residuals change by less than 0.1 %, as published"
STOP = "grows with the number of re-seeds, and so depends on where 0.1 % is reached"
WEAK = "the pelvis residual determines 31 of the 36 directions; the others keep the seed's values"


@dataclass(frozen=True)
class DrawSpread:
    """A figure over the draws of the noise."""

    median: float
    low: float
    high: float
    draws: int

    def locate(self, published: float) -> str:
        """Return whether a published figure is `inside`, `below` or `above` the range."""
        if published < self.low:
            return "below"
        return "above" if published > self.high else "inside"


def summarise_draws(values: Iterable[float]) -> DrawSpread:
    """Compute median and range of a figure over draws.

    Parameters
    ----------
    values : iterable of float
        One for each draw, at least one.

    Returns
    -------
    DrawSpread
    """
    array = np.array(list(values), dtype=float)
    return DrawSpread(float(np.median(array)), float(array.min()), float(array.max()), len(array))


@dataclass(frozen=True)
class TableRow:
    """One cell of the tables: a published figure, and ours; None if there is none."""

    table: str
    row: str
    column: str
    unit: str
    published: float | None = None
    ours: float | None = None
    note: str = ""

    def fill(self, published: float | None, ours: float | None, *notes: str) -> "TableRow":
        """Return the cell with figures.

        Parameters
        ----------
        published : float or None
            The printed figure.
        ours : float or None
            Our figure.
        *notes : str
            Joined to one note; empty ones are left out.

        Returns
        -------
        TableRow
        """
        return replace(self, published=published, ours=ours, note="; ".join(filter(None, notes)))

    def fill_with_draws(
        self, published: float | None, values: Iterable[float], note: str = ""
    ) -> "TableRow":
        """Return the cell with the median over draws, and their range in the note.

        `published`: the printed figure, whose position relative to the range is noted. `values`:
        our figure for each draw of the noise. `note`: a further note.
        """
        ours = summarise_draws(values)
        summary = f"median of {ours.draws} noise draws, range {ours.low:.3g} to {ours.high:.3g}"
        located = "" if published is None else f"published value {ours.locate(published)} the range"
        return self.fill(published, ours.median, summary, located, note)

    def fill_experiment(self, published: float, note: str = "") -> "TableRow":
        """Return the cell with a printed figure that needs the unpublished trial."""
        return self.fill(published, None, EXPERIMENT, note)


def make_table_one(clean: SeedResult, draws: Sequence[SeedResult]) -> list[TableRow]:
    """Make Table I: marker distances and joint errors of phase 1.

    Parameters
    ----------
    clean : SeedResult
        Without noise.
    draws : sequence of SeedResult
        Draws of the noise.

    Returns
    -------
    list of TableRow
        Without and with noise, then the experimental rows as printed.
    """
    rows: list[TableRow] = []
    for key, title, unit, figure in JOINT_FIGURES:
        # Without noise there is one result; with noise there is a distribution over draws.
        for problem, published in get_table_one("synthetic_without_noise", key).items():
            cell = TableRow("I", f"synthetic without noise: {title}", problem, unit)
            recovery = clean.joints[problem]
            ours = figure(recovery)
            if ours is not None:
                note = f"from absolute zero in {recovery.steps} steps"
                rows.append(cell.fill(published, ours, note))
    for key, title, unit, figure in JOINT_FIGURES:
        for problem, published in get_table_one("synthetic_with_noise", key).items():
            cell = TableRow("I", f"synthetic with noise: {title}", problem, unit)
            figures = [figure(draw.joints[problem]) for draw in draws]
            values = [value for value in figures if value is not None]
            if values and published is not None:
                rows.append(cell.fill_with_draws(published, values, _explain(key, problem)))
    cell = TableRow("I", "synthetic with noise: largest marker distance", "any", "mm")
    peaks = []
    for draw in draws:
        peaks.append(max(r.largest_mm for r in draw.joints.values()))
    # The paper gives one largest distance for all problems.
    largest = float(get_figure("largest_marker_distance_mm")["single"])
    rows.append(cell.fill_with_draws(largest, peaks))
    return [*rows, *_list_experimental_distances(), *_compare_minima(draws)]


def _list_experimental_distances() -> list[TableRow]:
    """List the experimental marker distances of Table I, as printed."""
    rows: list[TableRow] = []
    for printed, row in (
        ("experimental_phase1", "phase 1"),
        ("experimental_anatomical", "anatomical"),
    ):
        for problem, published in get_table_one(printed, "marker_distance_mm").items():
            if published is not None:
                cell = TableRow("I", f"experimental, {row}: marker distance RMS", problem, "mm")
                rows.append(cell.fill_experiment(published))
    for problem, fall in zip(PROBLEMS, get_figure("jp_reduction_marker_error_pct"), strict=True):
        cell = TableRow("I", "experimental: fall of marker distance", problem, "%")
        rows.append(cell.fill_experiment(fall))
    return rows


def _compare_minima(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Count the searches from zero that end where one from the truth does; not in the paper."""
    rows = []
    title = "synthetic with noise: same minimum from zero as from the truth"
    for problem in PROBLEMS:
        found = [d.joints[problem] for d in draws]
        same = [r.cost <= SAME_COST * r.cost_from_truth for r in found]
        note = f"of {len(same)} noise draws; cost within 0.01 %"
        cell = TableRow("I", title, problem, "%")
        rows.append(cell.fill(None, 100.0 * float(np.mean(same)), note))
    return rows


def _explain(key: str, problem: str) -> str:
    """Explain why a figure of Table I may differ from the printed one."""
    if key == "marker_distance_mm":
        return MARKER_SET
    return {"ankle": ANKLE, "hip": SLOW_NOISE}.get(problem, "")


def make_table_two(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Make Table II: signed errors of the 27 joint parameters of the left leg.

    Parameters
    ----------
    draws : sequence of SeedResult
        Draws of the noise.

    Returns
    -------
    list of TableRow
        With noise, and the experimental columns as printed.
    """
    rows: list[TableRow] = []
    for printed in get_table_two():
        joint = printed.name.split("_")[0]
        isolated = joint if joint in PROBLEMS else "ankle"
        for column, problem, (published, experimental) in (
            ("single joint", isolated, printed.single_joint),
            ("full leg", "full leg", printed.full_leg),
        ):
            recovered = [draw.joints[problem] for draw in draws]
            # Signed errors over the draws, mm or deg.
            values = np.array([r.errors[r.names.index(printed.name)] for r in recovered])
            size = f"median size {np.median(np.abs(values)):.3g}"
            cell = TableRow("II", printed.title, f"{column}, synthetic", printed.unit)
            rows.append(cell.fill_with_draws(published, values, size))
            cell = TableRow("II", printed.title, f"{column}, experimental", printed.unit)
            rows.append(cell.fill_experiment(experimental))
    return rows


def make_table_three(clean: SeedResult, draws: Sequence[SeedResult]) -> list[TableRow]:
    """Make Table III: pelvis residuals and errors of inertial parameters.

    Parameters
    ----------
    clean : SeedResult
        Without noise.
    draws : sequence of SeedResult
        Draws of the noise.

    Returns
    -------
    list of TableRow
        From the correct seed and from random seeds, then the experimental rows as printed.
    """
    cell = TableRow(
        "III", "synthetic with noise, random seeds: bodies that could exist", "solutions", "%"
    )
    is_possible = [r.physical for d in draws for r in d.random]
    possible = 100.0 * float(np.mean(is_possible))
    return [
        *_list_inertia_without_noise(clean),
        *_list_inertia_with_noise(draws),
        *_list_experimental_residuals(),
        cell.fill(None, possible, "the published cost does not require it"),
    ]


def _list_inertia_without_noise(clean: SeedResult) -> list[TableRow]:
    """List the rows of Table III without noise."""
    rows: list[TableRow] = []
    published = get_table_three("synthetic_without_noise")
    passes = (
        f"penalty times {NOISELESS_DECAY} at every re-seed, up to "
        f"{max(r.seeds for r in clean.random)} seeds"
    )
    for k, (column, unit, figure) in enumerate(INERTIAL_FIGURES):
        cell = TableRow("III", "synthetic without noise, correct seed", column, unit)
        rows.append(cell.fill(published[k], figure(clean.correct)))
        cell = TableRow("III", "synthetic without noise, random seeds: mean", column, unit)
        values = [figure(r) for r in clean.random]
        note = f"mean of {len(values)} seeds, range {min(values):.3g} to {max(values):.3g}"
        weak = WEAK if k >= len(RESIDUALS) else ""
        rows.append(cell.fill(None, float(np.mean(values)), note, passes, weak))
    return rows


def _list_inertia_with_noise(draws: Sequence[SeedResult]) -> list[TableRow]:
    """List the rows of Table III with noise."""
    rows: list[TableRow] = []
    correct = get_table_three("synthetic_with_noise_correct_seed")
    random = get_table_three("synthetic_with_noise_random_seeds")
    for k, (column, unit, figure) in enumerate(INERTIAL_FIGURES):
        why = LITERAL if k < len(RESIDUALS) else f"{LITERAL}; {STOP}"
        from_correct = [figure(d.correct) for d in draws]
        single_pass = [figure(d.single_pass) for d in draws]
        mean, deviation = _summarise_seeds(draws, figure)
        for row, published, values, note in (
            ("correct seed", correct[k], from_correct, why),
            ("correct seed, without re-seeding", correct[k], single_pass, ""),
            ("random seeds: mean", random[k][0], mean, why),
            ("random seeds: standard deviation", random[k][1], deviation, ""),
        ):
            cell = TableRow("III", f"synthetic with noise, {row}", column, unit)
            rows.append(cell.fill_with_draws(published, values, note))
    return rows


def _summarise_seeds(
    draws: Sequence[SeedResult], figure: Figure
) -> tuple[list[float], list[float]]:
    """Compute mean and standard deviation of a figure over the random seeds of each draw."""
    means, deviations = [], []
    for draw in draws:
        values = np.array([figure(r) for r in draw.random])
        means.append(float(values.mean()))
        deviations.append(float(values.std(ddof=1)))
    return means, deviations


def _get_error(recovery: InertialRecovery, name: str) -> float:
    """Get the error of one inertial parameter."""
    return recovery.each[name]


def _list_experimental_residuals() -> list[TableRow]:
    """List the experimental residuals of Table III, as printed."""
    rows: list[TableRow] = []
    for k, (column, unit, _) in enumerate(RESIDUALS):
        for printed, row in (
            ("experimental_phase2", "phase 2"),
            ("experimental_anatomical", "anatomical"),
        ):
            cell = TableRow("III", f"experimental, {row}", column, unit)
            rows.append(cell.fill_experiment(get_table_three(printed)[k]))
    for (column, _, _), key in zip(RESIDUALS, ("force", "torque"), strict=True):
        for stage, name in (
            ("phase 2", "ip_reduction_residual_pct"),
            ("third step", "third_step_reduction_pct"),
        ):
            cell = TableRow("III", f"experimental, {stage}: fall of residual", column, "%")
            rows.append(cell.fill_experiment(get_figure(name)[key]))
    return rows


def make_table_four(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Make Table IV: errors of the 36 inertial parameters, and of `foot superior`, which was held.

    Parameters
    ----------
    draws : sequence of SeedResult
        Draws of the noise.

    Returns
    -------
    list of TableRow
        With noise, and the experimental column as printed.
    """
    rows: list[TableRow] = []
    for p in get_table_four():
        held = (
            "drawn with the random seeds and held: no variable" if p.name == "foot.com.sup" else ""
        )
        correct = [d.correct.each[p.name] for d in draws]
        mean, deviation = _summarise_seeds(draws, partial(_get_error, name=p.name))
        for column, published, values in (
            ("correct seed", p.correct_seed, correct),
            ("random seeds: mean", p.random_seeds[0], mean),
            ("random seeds: standard deviation", p.random_seeds[1], deviation),
        ):
            cell = TableRow("IV", p.title, column, p.unit)
            rows.append(cell.fill_with_draws(published, values, held))
        cell = TableRow("IV", p.title, "experimental", p.unit)
        rows.append(cell.fill_experiment(p.experimental, p.note))
    cell = TableRow("IV", "mass, whole body", "correct seed", "kg")
    masses = [d.correct.total_mass for d in draws]
    return [*rows, cell.fill_with_draws(get_figure("mass_sum_kg"), masses)]


def make_discussion_rows(draws: Sequence[SeedResult]) -> list[TableRow]:
    """Make the rows of the discussion: normalisations of torque, and the third step.

    Parameters
    ----------
    draws : sequence of SeedResult
        Draws of the noise.

    Returns
    -------
    list of TableRow
        The published figures are of the experimental trial.
    """
    rows: list[TableRow] = []
    other = "published figure: experimental trial; ours: synthetic with noise"
    for scale, (key, divisor) in SCALES.items():
        printed = get_figure("torque_weighting")[key]
        for k, (column, unit, figure) in enumerate(RESIDUALS):
            cell = TableRow("discussion", f"torque divided by {divisor}", column, unit)
            values = [figure(d.scales[scale]) for d in draws]
            rows.append(cell.fill_with_draws(printed[k], values, f"{other}, correct seed"))
    third, printed = [d.third for d in draws if d.third is not None], get_figure("third_step")
    for column, unit, pairs, figures in (
        ("residual force RMS", "N", [t.force for t in third], printed["force_N"]),
        ("residual torque RMS", "N*m", [t.torque for t in third], printed["torque_Nm"]),
        ("marker distance RMS", "mm", [t.marker_mm for t in third], [None, None]),
        ("position error RMS of the 17", "mm", [t.position_mm for t in third], [None, None]),
    ):
        for k, when in enumerate(("before", "after")):
            cell = TableRow("discussion", f"third step, {when}", column, unit)
            rows.append(cell.fill_with_draws(figures[k], [pair[k] for pair in pairs], other))
    return rows


def make_time_rows(results: Sequence[SeedResult]) -> list[TableRow]:
    """Make the rows of computing time, which differ from run to run.

    Parameters
    ----------
    results : sequence of SeedResult
        Without and with noise.

    Returns
    -------
    list of TableRow
        Shortest, median and longest time of the problems of each phase, s.
    """
    rows: list[TableRow] = []
    for row, key, times in PHASES:
        # Processor time: independent of other programs of the machine.
        seconds = np.array([s for result in results for s in times(result)])
        shortest, longest = get_cpu_seconds(key)
        for column, published, ours in (
            ("shortest", shortest, seconds.min()),
            ("median", None, np.median(seconds)),
            ("longest", longest, seconds.max()),
        ):
            cell = TableRow("time", row, column, "s")
            note = f"processor time of {len(seconds)} problems"
            rows.append(cell.fill(published, float(ours), note))
    return rows


def make_run_time_rows(laps: Mapping[str, float]) -> list[TableRow]:
    """Make the rows of elapsed time (s) of each part of this run, and of all."""
    parts = {**laps, "everything": sum(laps.values())}
    return [
        TableRow("time", RUN, part, "s").fill(None, seconds, "elapsed time")
        for part, seconds in parts.items()
    ]


def compute_speed_factor(results: Sequence[SeedResult]) -> float:
    """Compute the smallest ratio of the shortest published time of a phase to our longest."""
    ratios = []
    for _, key, times in PHASES:
        longest = max(seconds for result in results for seconds in times(result))
        ratios.append(get_cpu_seconds(key)[0] / longest)
    return min(ratios)
