"""Sensitivities of the Monte Carlo study: where its re-fits end, and where the centres of pressure are.

**Unfinished re-fits.** The paper prints a marker error of 14 mm at half of the joint parameters' bounds, where a
converged re-fit leaves far less, and does not say when its re-fits end. Here they are stopped after some numbers of
iterations (`Iteration.counts`): does one of them give the printed marker errors and the printed torque errors at once?
None is chosen: the study's own figures are those of the end. Two iterations, at the two ends of what one would use:

- *Gauss-Newton*, the whole step of the normal equations, damped only where it would raise the cost;
- *steepest descent*, every node scaled by its own diagonal entry of the Gauss-Newton matrix (of the undisturbed
  motion), as far as the line's minimum.

They begin at the undisturbed motion, without the first-order change that starts the re-fits of the study (`draw.py`).

**Centre of pressure.** In double support each foot has its own centre of pressure, or both have the same: where the
total wrench of a motion is merely divided between the feet, both feet push along one line that stands between them, and
a force carried along with a foot turns about a point far from its own. The same draws, the same re-fits, once with the
person's forces, once with their sum divided in the ratio of the vertical forces. Draws are paired, so that the standard
error of the difference is far smaller than that of either mean, and the claim is on the size of the difference.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.motion import descent, motion
from gaitcal.published import draw as drawing
from gaitcal.published.case import MonteCarloCase, nominal_case
from gaitcal.published.claims import Claim, Verdict, tested
from gaitcal.published.disturbance_claims import FRAMES, PUBLISHED, Disturbances, printed_markers, printed_torques
from gaitcal.published.protocol import PUBLISHED_LEVELS, SIDE, MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.statistics import statistics
from gaitcal.published.study import Chunk, in_order, run_chunk
from gaitcal.published.tables import SENSITIVITY, TableRow
from gaitcal.runtime import with_one_blas_thread

SETS = (Varied.JP, Varied.NOISE)  # Inertial parameters alone need no re-fit
CONVERGED = -1  # Number of iterations of a re-fit that goes on to its end
PROBE = 1e-5  # Part of a step by which positions are differenced along it


class Iteration(Enum):
    """How the motion is fitted."""

    GAUSS_NEWTON = "Gauss-Newton"
    STEEPEST_DESCENT = "steepest descent"

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of iterations that are looked at; the last is the end of the re-fit."""
        of_descent = (30,) if self is Iteration.STEEPEST_DESCENT else ()
        return (0, 1, 2, 3, 5, 10, *of_descent, CONVERGED)


def unfinished_draws(
    case: MonteCarloCase, settings: MonteCarloSettings, draws: int, jobs: int = -1, levels: Sequence[int] = ()
) -> pd.DataFrame:
    """Draws 0 to `draws` - 1 of `SETS` at the levels (the published ones unless given), after each number of steps.

    Columns: `iteration`, `iterations` (`CONVERGED`: to the end), `set`, `level`, `draw`, `failure`, then `COLUMNS`.
    """
    tasks = (
        delayed(_cell)(case, settings, varied, level, draws) for varied in SETS for level in levels or PUBLISHED_LEVELS
    )
    return pd.concat(Parallel(n_jobs=jobs)(tasks), ignore_index=True)


@with_one_blas_thread
def _cell(case: MonteCarloCase, settings: MonteCarloSettings, varied: Varied, level: int, draws: int) -> pd.DataFrame:
    context, rows = drawing.MonteCarloContext(case, settings), []
    for number in range(draws):
        model, end = (
            drawing.disturbed_model(context, drawing.disturb(context, varied, level, number)),
            drawing.draw(context, varied, level, number),
        )
        for iteration in Iteration:
            key = (varied.value, level, number)
            *counts, last = iteration.counts
            for count, coefficients in zip(counts, path(context, model, iteration, counts), strict=True):
                rows.append((iteration.value, count, *key, "", *drawing.errors_of(context, model, coefficients)))
            rows.append((iteration.value, last, *key, end.failure, *end.values))
    return pd.DataFrame(rows, columns=["iteration", "iterations", "set", "level", "draw", "failure", *drawing.COLUMNS])


def path(
    context: drawing.MonteCarloContext, model: drawing.DisturbedModel, iteration: Iteration, counts: Sequence[int]
) -> Iterator[Array]:
    """Coefficients (nn, nq) after each of a rising sequence of numbers of iterations from the undisturbed motion."""
    coefficients, done = context.case.coefficients, 0
    advance = _gauss_newton if iteration is Iteration.GAUSS_NEWTON else _steepest_descent
    for count in counts:
        coefficients = advance(context, model, coefficients, count - done)
        done = count
        yield coefficients


def _gauss_newton(
    context: drawing.MonteCarloContext, model: drawing.DisturbedModel, coefficients: Array, steps: int
) -> Array:
    """So many steps with a new matrix each; one that raised the cost and was damped counts too."""
    rule = descent.DescentSettings(gain=0.0, kept_gain=0.0, most_steps=steps, keep_within=0.0, curved_tries=0)
    return motion.track_nodes(model.problem, model.body, coefficients, rule).x if steps else coefficients


def _steepest_descent(
    context: drawing.MonteCarloContext, model: drawing.DisturbedModel, coefficients: Array, steps: int
) -> Array:
    problem, body = model.problem, model.body
    for _ in range(steps):
        _, gradient = problem.gradient(coefficients, body)
        step = -gradient / context.undisturbed_diagonal
        ahead, behind = (problem.positions(coefficients + part * step, body) for part in (PROBE, -PROBE))
        slope = (ahead - behind) / (2.0 * PROBE)
        bend = float(np.einsum("mcf,mcf,mf->", slope, slope, problem.data.weight))
        if bend > 0.0:
            coefficients = coefficients - float(np.vdot(gradient, step)) / bend * step
    return coefficients


DRAWS = 40  # At each set and level: averages to some 5 %
PRINTED_MM = ((Varied.JP, 50, 14.0), (Varied.NOISE, 50, 4.0))
"""Set, level and the marker error that the paper says it means, mm."""
DECIMALS = 5  # Of mm and %BW*H in `iterations.csv`
_FIGURES = tuple(figure for figure in PUBLISHED if figure.varied is Varied.JP)
_COURSE = {Iteration.GAUSS_NEWTON: (0, 1, 2, CONVERGED), Iteration.STEEPEST_DESCENT: (1, 2, 5, 30)}
"""Numbers of iterations whose errors are in the claim's words; none is the same of both, and so is the end."""


@dataclass(frozen=True)
class StoppedRefits:
    """Statistics of draws whose re-fit was stopped."""

    tables: dict[tuple[Iteration, int], pd.DataFrame]
    """By iteration and number: `statistics.statistics` of the sets JP and noise."""
    draws: int  # At each set and level

    def as_study(self, key: tuple[Iteration, int]) -> Disturbances:
        """One of them, to be tested as the study is."""
        return Disturbances(self.tables[key], pd.DataFrame(), self.draws)


def stopped_refits(seed: int, draws: int = DRAWS, jobs: int = -1) -> StoppedRefits:
    """Draws 0 to `draws` - 1 of the Monte Carlo study under `seed`, their re-fits stopped on the way."""
    drawn = unfinished_draws(nominal_case(), MonteCarloSettings(seed=seed), draws, jobs)
    tables = {
        (iteration, count): statistics(
            drawn[(drawn["iteration"] == iteration.value) & (drawn["iterations"] == count)].reset_index(drop=True)
        )
        for iteration in Iteration
        for count in iteration.counts
    }
    return StoppedRefits(tables, draws)


def iteration_frame(stopped: StoppedRefits) -> pd.DataFrame:
    """`iterations.csv`: one row per set, level, iteration and number, the printed figures in rows of their own.

    Average RMS of the left leg: `markers_mm`, then each torque as `hip_flexion.lab`, %BW*H.
    """
    quantities = {"markers_mm": (f"markers_{SIDE}", "")}
    quantities |= {
        f"{t}.{frame.value}": (f"{t}_{SIDE}", frame.value) for t in drawing.TORQUES for frame in ReactionFrame
    }
    rows: list[dict[str, object]] = []
    for (iteration, count), table in stopped.tables.items():
        averages = _averages(table)
        for name_of_set, level in dict.fromkeys((name, level) for name, level, _, _ in averages):
            values = {
                name: averages[name_of_set, level, quantity, frame] for name, (quantity, frame) in quantities.items()
            }
            number = "converged" if count == CONVERGED else str(count)
            rows.append(
                {"set": name_of_set, "level": level, "iteration": iteration.value, "iterations": number} | values
            )
    for varied, level, value in PRINTED_MM:
        rows.append({"set": varied.value, "level": level, "iteration": "printed", "markers_mm": value})
    both = {f"{figure.torque}.{frame.value}": figure.value for figure in _FIGURES for frame in ReactionFrame}
    rows.append({"set": Varied.JP.value, "level": 100, "iteration": "printed", **both})
    return in_order(pd.DataFrame(rows), ("set", "level")).round(DECIMALS)


def _averages(table: pd.DataFrame) -> dict[tuple[str, int, str, str], float]:
    """Average RMS by set, level, quantity and frame of the ground reactions (markers have none)."""
    rows = table[table["measure"] == "rms"]
    keys = zip(rows["set"], rows["level"], rows["quantity"], rows["grf"], strict=True)
    return dict(zip(keys, rows["average"], strict=True))


def refit_rows(stopped: StoppedRefits) -> list[TableRow]:
    """What the paper prints, after each number of iterations."""
    rows: list[TableRow] = []
    for (iteration, count), table in stopped.tables.items():
        end = "re-fit to the end" if count == CONVERGED else f"{iteration.value}, {count} iterations"
        if count == CONVERGED and iteration is not next(iter(Iteration)):
            continue  # the same draws
        note, averages = f"mean of {stopped.draws} draws, from the undisturbed motion", _averages(table)
        for varied, level, printed in PRINTED_MM:
            cell = TableRow(SENSITIVITY, f"Monte Carlo, {varied.title} {level} %: {end}", "marker distance RMS", "mm")
            rows.append(cell.filled(printed, averages[varied.value, level, f"markers_{SIDE}", ""], note))
        for figure in _FIGURES:
            for frame, stays in FRAMES.items():
                column = f"{drawing.TORQUE_WORDS[figure.torque]}, {stays}"
                cell = TableRow(SENSITIVITY, f"Monte Carlo, JP 100 %: {end}", column, "%BW*H")
                ours = averages[Varied.JP.value, 100, f"{figure.torque}_{SIDE}", frame.value]
                rows.append(cell.filled(figure.value, ours, note))
    return rows


def refit_claims(stopped: StoppedRefits | None) -> list[Claim]:
    """Whether one of the numbers tried gives all that is printed, for either frame of the ground reactions."""
    tried = "; ".join(f"{', '.join(map(str, iteration.counts[:-1]))} of {iteration.value}" for iteration in Iteration)
    claim = (
        f"of the iterations tried from the undisturbed motion ({tried}; the end), one number gives the printed marker "
        "and torque errors at once"
    )
    published = (
        "4 mm: JP less than 25 %, noise 50 %; 14 mm: JP 50 %, noise more than 100 %; hip flexion 4.14, hip adduction "
        "1.06, knee flexion 0.92 %BW*H at JP 100 %"
    )
    if stopped is None:
        return [Claim(f"{claim} ({stays})", published, "", Verdict.NOT_RUN) for stays in FRAMES.values()]

    def label(iteration: Iteration, count: int) -> str:
        """The end is the same of every iteration."""
        return "converged" if count == CONVERGED else f"{iteration.value} {count}"

    def listed(labels: Sequence[str]) -> str:
        return ", ".join(labels) or "at none of those tried"

    claims, studies = [], {label(*key): stopped.as_study(key) for key in stopped.tables}
    markers = [name for name, study in studies.items() if printed_markers(study)[1]]
    course = [
        label(*key)
        for i, counts in _COURSE.items()
        for key in ((i, count) for count in counts)
        if key in stopped.tables
    ]
    for frame, stays in FRAMES.items():
        torques = [name for name, study in studies.items() if printed_torques(study, frame)[1]]
        both = [name for name in markers if name in torques]
        parts = []
        for name in filter(studies.__contains__, course):
            mm = _averages(studies[name].table)[Varied.JP.value, 50, f"markers_{SIDE}", ""]
            parts.append(f"{name}: {mm:.1f} mm, {printed_torques(studies[name], frame)[0]}")
        ours = (
            f"printed marker errors: {listed(markers)}; printed torque errors: {listed(torques)}; both at once: "
            f"{listed(both)}. Markers at JP 50 %, torques at JP 100 %: {'; '.join(parts)}; {stopped.draws} draws"
        )
        claims.append(tested(f"{claim} ({stays})", published, ours, bool(both)))
    return claims


PAIRED_DRAWS = 200
LEVEL = 100
VERTICAL = 1  # Of a force in the laboratory
OWN, SHARED = "each foot's own", "one for both feet"
NO_DIFFERENCE = 0.05  # Part of a torque error: a smaller change counts as none
DECIDED_ERRORS = 2.0  # Standard errors that a change has to be away from that, or the answer is undecided
_PRINTED_TORQUES = ", ".join(f"{drawing.TORQUE_WORDS[figure.torque]} {figure.value}" for figure in _FIGURES) + " %BW*H"


def with_shared_centre(case: MonteCarloCase) -> MonteCarloCase:
    """The case with its total wrench divided between the feet in the ratio of their vertical forces."""
    total = case.wrench.sum(axis=1)
    loaded = total[:, VERTICAL] > 0.0
    share = np.where(loaded[:, None], case.wrench[:, :, VERTICAL], 0.5)
    share = share / share.sum(axis=1, keepdims=True)
    return replace(case, wrench=share[:, :, None] * total[:, None, :])


@dataclass(frozen=True)
class PressureCentres:
    """RMS torque errors at all of the joint parameters' bounds, draw by draw."""

    drawn: Mapping[str, Mapping[ReactionFrame, Array]]
    """`OWN` or `SHARED`, then the frame: (n, 7) %BW*H, left leg, in the order of `TORQUES`; the same draws."""

    @property
    def draws(self) -> int:
        """How many."""
        return len(self.drawn[OWN][ReactionFrame.LAB])

    def errors(self, centre: str, frame: ReactionFrame) -> Array:
        """(7,) means, %BW*H."""
        means: Array = self.drawn[centre][frame].mean(axis=0)
        return means

    def difference(self, frame: ReactionFrame) -> tuple[Array, Array]:
        """(7,) `OWN` - `SHARED` and its standard error over paired draws (NaN for one draw), %BW*H."""
        apart = self.drawn[OWN][frame] - self.drawn[SHARED][frame]
        if len(apart) < 2:
            return apart.mean(axis=0), np.full(apart.shape[1], np.nan)
        return apart.mean(axis=0), apart.std(axis=0, ddof=1) / np.sqrt(len(apart))


@with_one_blas_thread
def pressure_centres(seed: int, draws: int = PAIRED_DRAWS, jobs: int = -1) -> PressureCentres:
    """Draws 0 to `draws` - 1 of the set JP of the Monte Carlo study under `seed`, with either ground reaction."""
    own = nominal_case()
    cases = {OWN: own, SHARED: with_shared_centre(own)}
    settings = MonteCarloSettings(seed=seed)
    chunk = Chunk(Varied.JP, LEVEL, 0, draws)
    found = Parallel(n_jobs=jobs)(delayed(run_chunk)(case, settings, chunk) for case in cases.values())
    tables = [table.to_pandas() for _, table in found]
    good = np.all([table["failure"] == "" for table in tables], axis=0)
    return PressureCentres(
        {
            centre: {
                frame: table.loc[
                    good, [drawing.torque_column(f"{t}_{SIDE}", frame, "rms") for t in drawing.TORQUES]
                ].to_numpy()
                for frame in ReactionFrame
            }
            for centre, table in zip(cases, tables, strict=True)
        }
    )


def pressure_centre_rows(centres: PressureCentres) -> list[TableRow]:
    """All seven torques of the left leg, both frames, both centres of pressure."""
    printed = {figure.torque: figure.value for figure in _FIGURES}
    rows: list[TableRow] = []
    for centre, of_frame in centres.drawn.items():
        for frame in of_frame:
            for torque, error in zip(drawing.TORQUES, centres.errors(centre, frame), strict=True):
                row_title = f"Monte Carlo, JP {LEVEL} %, centre of pressure {centre}: {FRAMES[frame]}"
                cell = TableRow(SENSITIVITY, row_title, drawing.TORQUE_WORDS[torque], "%BW*H")
                rows.append(cell.filled(printed.get(torque), float(error), f"mean of {centres.draws} draws"))
    return rows


def pressure_centre_claims(centres: PressureCentres | None) -> list[Claim]:
    """Whether the three printed errors would be others with one centre of pressure, for either frame."""
    claims = []
    for frame, stays in FRAMES.items():
        claim = (
            "it makes no difference to the three printed JP torque errors (less than "
            f"{100 * NO_DIFFERENCE:.0f} %) whether each foot has its own centre of pressure or both share one ({stays})"
        )
        if centres is None:
            claims.append(Claim(claim, _PRINTED_TORQUES, "", Verdict.NOT_RUN))
            continue
        own, shared = (centres.errors(centre, frame) for centre in (OWN, SHARED))
        change, error = centres.difference(frame)
        three = [drawing.TORQUES.index(figure.torque) for figure in _FIGURES]
        figures = ", ".join(
            f"{drawing.TORQUE_WORDS[drawing.TORQUES[k]]} {own[k]:.2f}/{shared[k]:.2f} "
            f"(difference {change[k]:+.4f} +- {error[k]:.4f})"
            for k in three
        )
        most = int(np.abs(change / shared).argmax())
        ours = (
            f"own centres against one shared: {figures} %BW*H, paired, {centres.draws} draws. Of the seven torques "
            f"{drawing.TORQUE_WORDS[drawing.TORQUES[most]]} changes most: {own[most]:.2f}/{shared[most]:.2f}, "
            f"{100 * change[most] / shared[most]:+.0f} %"
        )
        part, sure = np.abs(change / shared)[three], DECIDED_ERRORS * (error / shared)[three]
        claims.append(Claim(claim, _PRINTED_TORQUES, ours, _no_difference(part, sure)))
    return claims


def _no_difference(part: Array, sure: Array) -> Verdict:
    """From changes as parts of the errors, and how far they are known."""
    if np.isnan(sure).any():
        return Verdict.NOT_RUN
    if (part - sure > NO_DIFFERENCE).any():
        return Verdict.FAILS
    return Verdict.HOLDS if (part + sure < NO_DIFFERENCE).all() else Verdict.UNDECIDED
