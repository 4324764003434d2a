"""A sensitivity: whether the Monte Carlo study's motions are fitted to the end.

The paper prints a marker error of 14 mm at half of the joint parameters' bounds, where a converged re-fit leaves far
less. Here the re-fit is stopped after some numbers of iterations (`Iteration.counts`) from the undisturbed motion
(`montecarlo/unfinished_refit.py`): marker and torque errors move together, and the question is whether one of these
numbers gives the printed marker errors and the printed torque errors at once. None is chosen: the study's own
figures are those of the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from gaitcal.published.case import nominal_case
from gaitcal.published.claims import Claim, Verdict, tested
from gaitcal.published.conclusions import PUBLISHED
from gaitcal.published.disturbance_claims import FRAMES, Disturbances, printed_markers, printed_torques
from gaitcal.published.leg_torques import TORQUE_WORDS, TORQUES
from gaitcal.published.published import SIDE
from gaitcal.published.settings import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.statistics import statistics
from gaitcal.published.tables import Cell, TableRow
from gaitcal.published.trial_length import SENSITIVITY
from gaitcal.published.unfinished_refit import CONVERGED, Iteration, unfinished_draws

DRAWS = 40
"""At each set and level: averages to some 5 %."""
PRINTED_MM = ((Varied.JP, 50, 14.0), (Varied.NOISE, 50, 4.0))
"""Set, level and the marker error that the paper says it means, mm."""
DECIMALS = 5
"""Of mm and %BW*H in `iterations.csv`."""
_TRIED = "; ".join(
    f"{', '.join(str(count) for count in iteration.counts if count != CONVERGED)} of {iteration.value}"
    for iteration in Iteration
)
_AT_ONCE = (
    f"of the iterations tried from the undisturbed motion ({_TRIED}; the end), one number gives the printed marker and "
    "torque errors at once"
)
_COURSE = {Iteration.GAUSS_NEWTON: (0, 1, 2, CONVERGED), Iteration.STEEPEST_DESCENT: (1, 2, 5, 30)}
"""Numbers of iterations that are told in words; none is the same of both, and so is the end."""
_PUBLISHED = (
    "4 mm: JP less than 25 %, noise 50 %; 14 mm: JP 50 %, noise more than 100 %; hip flexion 4.14, hip adduction "
    "1.06, knee flexion 0.92 %BW*H at JP 100 %"
)


@dataclass(frozen=True)
class StoppedRefits:
    """Statistics of draws whose re-fit was stopped."""

    tables: dict[tuple[Iteration, int], pd.DataFrame]
    """By iteration and number: `montecarlo.statistics` of the sets JP and noise."""
    draws: int
    """At each set and level."""

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


def shown(count: int) -> str:
    """A number of iterations in words."""
    return "converged" if count == CONVERGED else str(count)


def iteration_frame(stopped: StoppedRefits) -> pd.DataFrame:
    """`iterations.csv`: one row per set, level, iteration and number, the printed figures in rows of their own.

    Average RMS of the left leg: `markers_mm`, then each torque as `hip_flexion.lab`, %BW*H.
    """
    quantities = {"markers_mm": (f"markers_{SIDE}", "")}
    quantities |= {f"{t}.{frame.value}": (f"{t}_{SIDE}", frame.value) for t in TORQUES for frame in ReactionFrame}
    rows: list[dict[str, object]] = []
    for (iteration, count), table in stopped.tables.items():
        averages = _averages(table)
        for cell, level in dict.fromkeys((cell, level) for cell, level, _, _ in averages):
            values = {name: averages[cell, level, quantity, frame] for name, (quantity, frame) in quantities.items()}
            key = {"set": cell, "level": level, "iteration": iteration.value, "iterations": shown(count)}
            rows.append(key | values)
    for varied, level, value in PRINTED_MM:
        rows.append({"set": varied.value, "level": level, "iteration": "printed", "markers_mm": value})
    both = {f"{f.torque}.{frame.value}": f.value for f in PUBLISHED if f.varied is Varied.JP for frame in ReactionFrame}
    rows.append({"set": Varied.JP.value, "level": 100, "iteration": "printed", **both})
    frame = pd.DataFrame(rows)
    order = {varied.value: varied.key for varied in Varied}
    ordered = frame.sort_values(["set", "level"], key=lambda c: c.map(order) if c.name == "set" else c, kind="stable")
    return ordered.round(DECIMALS)


_Averages = dict[tuple[str, int, str, str], float]


def _averages(table: pd.DataFrame) -> _Averages:
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
            cell = Cell(SENSITIVITY, f"Monte Carlo, {varied.title} {level} %: {end}", "marker distance RMS", "mm")
            rows.append(cell.filled(printed, averages[varied.value, level, f"markers_{SIDE}", ""], note))
        for figure in PUBLISHED:
            if figure.varied is Varied.JP:
                for frame, words in FRAMES.items():
                    column = f"{TORQUE_WORDS[figure.torque]}, {words}"
                    cell = Cell(SENSITIVITY, f"Monte Carlo, JP 100 %: {end}", column, "%BW*H")
                    ours = averages[Varied.JP.value, 100, f"{figure.torque}_{SIDE}", frame.value]
                    rows.append(cell.filled(figure.value, ours, note))
    return rows


def refit_claims(stopped: StoppedRefits | None) -> list[Claim]:
    """Whether one of the numbers tried gives all that is printed, for either frame of the ground reactions."""
    if stopped is None:
        return [Claim(f"{_AT_ONCE} ({words})", _PUBLISHED, "", Verdict.NOT_RUN) for words in FRAMES.values()]
    claims, studies = [], {_label(key): stopped.as_study(key) for key in stopped.tables}
    markers = [label for label, study in studies.items() if printed_markers(study)[1]]
    for frame, words in FRAMES.items():
        torques = [label for label, study in studies.items() if printed_torques(study, frame)[1]]
        both = [label for label in markers if label in torques]
        ours = (
            f"printed marker errors: {_listed(markers)}; printed torque errors: {_listed(torques)}; both at once: "
            f"{_listed(both)}. {_course(stopped, frame)}; {stopped.draws} draws"
        )
        claims.append(tested(f"{_AT_ONCE} ({words})", _PUBLISHED, ours, bool(both)))
    return claims


def _label(key: tuple[Iteration, int]) -> str:
    """The end is the same of every iteration."""
    iteration, count = key
    return shown(count) if count == CONVERGED else f"{iteration.value} {count}"


def _listed(labels: list[str]) -> str:
    return ", ".join(labels) or "at none of those tried"


def _course(stopped: StoppedRefits, frame: ReactionFrame) -> str:
    """How marker and torque errors move together, in words."""
    parts = []
    for key in ((iteration, count) for iteration, counts in _COURSE.items() for count in counts):
        if key in stopped.tables:
            study = stopped.as_study(key)
            mm = _averages(study.table)[Varied.JP.value, 50, f"markers_{SIDE}", ""]
            parts.append(f"{_label(key)}: {mm:.1f} mm, {printed_torques(study, frame)[0]}")
    return "Markers at JP 50 %, torques at JP 100 %: " + "; ".join(parts)
