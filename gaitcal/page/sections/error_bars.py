"""Expected error of each peak moment, and which source makes it: what better input would mend.

At the frame of a peak the variances of independent sources add; the largest comes first.

What makes the error bar of each torque of the legs: the bars of the report, one a torque and side.

The error of a joint moment to expect from each source of a Monte Carlo study, the largest first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from gaitcal.dynamics.axis_errors import ErrorSource, TorqueErrors
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.gait.moments import coordinate_title, moment_of
from gaitcal.model.coordinates import LEG_COORDINATES, coordinate_words, split_side
from gaitcal.model.linkage import SIDES
from gaitcal.page.sections.blocks import (
    Block,
    Cell,
    bars,
    cell,
    fold,
    heading,
    named,
    number,
    number_rounded,
    pair,
    table,
    text,
)
from gaitcal.page.sections.summary import GaitNumbers
from gaitcal.published.draw import TORQUES
from gaitcal.published.protocol import ReactionFrame, Varied
from gaitcal.published.statistics import CauseOfMarkerError, expect
from gaitcal.session.result import TrialResult


@dataclass(frozen=True, kw_only=True)
class ErrorPart:
    """One source of one error bar."""

    source: ErrorSource
    percent: float
    """Of the variance."""


@dataclass(frozen=True, kw_only=True)
class ErrorBar:
    """The error bar of one torque."""

    title: str
    """`Right hip flexion`."""
    short: str
    """`Hip flexion`."""
    error: float
    """N·m/kg, RMS standard error over valid frames."""
    parts: tuple[ErrorPart, ...]
    """Their percentages sum to 100; in the order of `ErrorSource`."""

    @property
    def largest(self) -> ErrorPart:
        """The part that makes most of it."""
        return max(self.parts, key=lambda part: part.percent)

    def percent(self, source: ErrorSource) -> float:
        """Of one source; 0 where it has no part."""
        return sum(part.percent for part in self.parts if part.source is source)


@dataclass(frozen=True)
class ErrorSources:
    """Of one trial."""

    right: tuple[ErrorBar, ...]
    left: tuple[ErrorBar, ...]

    @property
    def sources(self) -> tuple[ErrorSource, ...]:
        """Those that have a part in some bar."""
        shown = {part.source for bar in (*self.right, *self.left) for part in bar.parts}
        return tuple(source for source in ErrorSource if source in shown)


def error_sources(trial: TrialResult, mass: float) -> ErrorSources | None:
    """The error bars of a trial's leg torques; None where it is not known what makes them. `mass`: of the body, kg."""
    if trial.loads is None or trial.loads.errors is None:
        return None
    errors, reactions = trial.loads.errors, trial.loads.reactions

    def bar(name: str) -> ErrorBar | None:
        column, valid = FORCES.index(name), reactions.valid_for(name)
        shares = errors.shares(column, valid)
        if not shares:
            return None
        return ErrorBar(
            title=coordinate_title(name),
            short=coordinate_words(name).title,
            error=float(np.sqrt((errors.every[valid, column] ** 2).mean())) / mass,
            parts=tuple(ErrorPart(source=s, percent=100.0 * shares[s]) for s in ErrorSource if s in shares),
        )

    right, left = (tuple(b for name in LEG_COORDINATES if (b := bar(f"{name}_{side}"))) for side in "rl")
    return ErrorSources(right, left) if right or left else None


FIRST = "knee_adduction"
"""The moment that is told in full; the others are folded."""
LITTLE = 0.005
"""Of the variance: sources below it are told together."""
SENSES = {"knee_adduction": ("external adduction", -1.0)}
"""Moment -> which of its peaks is meant, and its sign: the external moment is the opposite of the internal one."""


@dataclass(frozen=True, kw_only=True)
class PeakError:
    """The error of one moment at its peak."""

    name: str
    """`knee_adduction_r`."""
    value: float
    """N·m/kg, internal."""
    time: float
    """s from the begin of the trial."""
    error: float
    """N·m/kg, standard error."""
    sources: tuple[tuple[ErrorSource, float], ...]
    """Each with its part (0 to 1) of the variance, largest first."""

    @property
    def side(self) -> str:
        """`r` or `l`."""
        return split_side(self.name)[1]

    def alone(self, share: float) -> float:
        """N·m/kg, the error of one source by itself."""
        return float(self.error * np.sqrt(share))


def peak_error(walk: GaitNumbers, name: str, mass: float) -> PeakError | None:
    """Of one moment at the largest magnitude in its valid frames, of the knee's adduction at the abductor's peak.

    None without valid frames or standard errors.
    """
    loads = walk.trial.loads
    if loads is None or loads.errors is None:
        return None
    error = moment_of(loads.errors, name)
    frames = np.flatnonzero(walk.layout.valid_for(leg_of(name)) & np.isfinite(error))
    if not len(frames):
        return None
    moment = moment_of(loads.final, name)
    sense = SENSES.get(split_side(name)[0])
    looked_at = np.abs(moment[frames]) if sense is None else sense[1] * moment[frames]
    frame = int(frames[looked_at.argmax()])
    return PeakError(
        name=name,
        value=float(moment[frame]) / mass,
        time=float(walk.layout.time[frame] - walk.layout.time[0]),
        error=float(error[frame]) / mass,
        sources=_sources(loads.errors, FORCES.index(name), frame),
    )


def _sources(errors: TorqueErrors, column: int, frame: int) -> tuple[tuple[ErrorSource, float], ...]:
    here = np.zeros(len(errors.tau), dtype=bool)
    here[frame] = True
    return tuple(errors.shares(column, here).items())


def error_bar_blocks(walk: GaitNumbers, mass: float) -> list[Block]:
    """Of one walk; empty where it is not known what makes its error bars."""
    shown = error_sources(walk.trial, mass)
    if shown is None:
        return []
    names = [f"{base}_{side}" for base in LEG_COORDINATES for side in SIDES]
    peaks = [p for name in names if (p := peak_error(walk, name, mass)) and p.sources]
    out = []
    if first := [p for p in peaks if split_side(p.name)[0] == FIRST]:
        out += [
            heading(f"Expected error of the peak knee adduction moment, trial {named(walk.trial.name)}"),
            *_ranked(first),
        ]
    out += [
        heading("What makes the error bar of each peak moment", 4),
        text(
            "One standard error at the peak of each moment. A bar is as long as the error; its parts are in proportion "
            "to their parts of the variance. Where one is large, better input of this kind narrows the bar.",
            "soft",
        ),
        bars("N·m/kg", [_bar(peak) for peak in peaks]),
        fold("Expected error of every other peak, source by source", _others(peaks)),
        _shares(shown),
    ]
    return out


def _others(peaks: list[PeakError]) -> list[Block]:
    out = []
    for base in dict.fromkeys(split_side(p.name)[0] for p in peaks):
        if base != FIRST:
            out.append(heading(coordinate_title(base), 4))
            out += _ranked([p for p in peaks if split_side(p.name)[0] == base])
    return out


def _ranked(peaks: list[PeakError]) -> list[Block]:
    """The sources of each side, the largest first."""
    shown = [[_peak_table(peak)] for peak in peaks]
    return [pair(*shown)] if len(shown) == 2 else [block for blocks in shown for block in blocks]


def _peak_table(peak: PeakError) -> Block:
    words = peak_words(peak)
    rows = [
        [cell(source.words), f"± {number(peak.alone(share), 3)}", number(100.0 * share, 0)]
        for source, share in peak.sources
        if share >= LITTLE
    ]
    if (rest := sum(share for _, share in peak.sources if share < LITTLE)) > 0.0:
        rows.append(["all others", f"± {number(peak.alone(rest), 3)}", number(100.0 * rest, 0)])
    rows.append(["all together", f"± {number(peak.error, 3)}", "100"])
    head: list[Cell] = [cell(coordinate_title(peak.name), side=peak.side), "error alone, N·m/kg", "% of the variance"]
    return table(head, rows, caption=f"{words}, at {number(peak.time, 2)} s", total=[len(rows) - 1])


def peak_words(peak: PeakError) -> str:
    """`Peak 0.412 ± 0.031 N·m/kg (external adduction)`."""
    base = split_side(peak.name)[0]
    words, sign = SENSES.get(base, (f"internal, {coordinate_words(base).moment} positive", 1.0))
    return f"Peak {number(sign * peak.value, 3)} ± {number(peak.error, 3)} N·m/kg ({words})"


def _bar(peak: PeakError) -> dict[str, object]:
    shares = dict(peak.sources)
    parts = [
        {"name": source.words, "value": number_rounded(peak.error * shares[source], 6)}
        for source in ErrorSource
        if source in shares
    ]
    base, side = split_side(peak.name)
    return {"label": coordinate_title(base), "side": side, "total": number_rounded(peak.error, 6), "parts": parts}


def _shares(shown: ErrorSources) -> Block:
    rows = [
        [
            cell(bar.title, unit=f"± {number(bar.error, 3)} N·m/kg"),
            *(number(bar.percent(source), 1) for source in shown.sources),
        ]
        for bar in (*shown.right, *shown.left)
    ]
    head: list[Cell] = ["% of the variance", *(cell(source.words) for source in shown.sources)]
    caption = (
        "Parts of the variance over all valid frames; those of a moment sum to 100 %. Beside each moment stands its "
        "RMS standard error."
    )
    return table(head, rows, caption=caption, fold="All parts as numbers, over all valid frames")


SOURCE_WORDS: Final = {
    Varied.JP: "joint positions and axes",
    Varied.IP: "masses and inertia",
    Varied.BOTH: "joints, masses and inertia together",
    Varied.NOISE: "markers",
}
SOURCES: Final = (Varied.JP, Varied.IP, Varied.NOISE)
"""Those that are no sum of others."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """One source, RMS error over the trial in %BW·H."""

    varied: Varied
    level: float
    """Per cent of the bounds."""
    beyond: bool
    """The marker error is larger than at the highest level: the error is a lower limit."""
    average: float
    low: float
    """10 % of the draws are below."""
    high: float
    """10 % of the draws are above."""

    @property
    def words(self) -> str:
        """What is off."""
        return SOURCE_WORDS[self.varied]


Quantity = tuple[Varied, str, str, str]
"""What was varied; torque or markers; ground-reaction frame (empty for markers); measure."""


def levels_by_quantity(statistics: pd.DataFrame) -> dict[Quantity, list[dict[str, Any]]]:
    """The rows of each quantity with any draws, ordered by level."""
    out: dict[Quantity, list[dict[str, Any]]] = {}
    known = statistics[statistics["draws"] > 0].sort_values("level", kind="stable")
    for row in known.to_dict("records"):
        out.setdefault((Varied(row["set"]), row["quantity"], row["grf"], row["measure"]), []).append(row)
    return out


def expected_errors(
    statistics: pd.DataFrame, marker_rms: float | None, side: str
) -> dict[tuple[str, ReactionFrame], tuple[Expected, ...]]:
    """Torque (`knee_adduction_l`) of one leg and frame -> its sources; those that were not disturbed are left out.

    `marker_rms`: mm, where known joints and markers are as far off as would make it; else as far as was studied.
    """
    levels = levels_by_quantity(statistics)
    causes = {} if marker_rms is None else {c.varied: _of_cause(c) for c in expect(statistics, marker_rms, side)}
    out = {}
    for torque in (f"{name}_{side}" for name in TORQUES):
        for frame in ReactionFrame:
            found = []
            for varied in SOURCES:
                if varied in causes:
                    found.append(causes[varied][torque, frame.value])
                elif rows := levels.get((varied, torque, frame.value, "rms")):
                    found.append(_expected(varied, rows[-1]["level"], rows[-1]))
            out[torque, frame] = tuple(sorted(found, key=lambda e: -e.average))
    return out


def _of_cause(cause: CauseOfMarkerError) -> dict[tuple[str, str], Expected]:
    """Torque and frame -> its error if this cause alone has made the marker error."""
    return {
        (row["torque"], row["grf"]): _expected(cause.varied, cause.level, row, cause.beyond)
        for row in cause.torques.to_dict("records")
    }


def _expected(varied: Varied, level: float, row: Mapping[str, float], beyond: bool = False) -> Expected:
    return Expected(
        varied=varied,
        level=float(level),
        beyond=beyond,
        average=float(row["average"]),
        low=float(row["p10"]),
        high=float(row["p90"]),
    )
