"""Expected error of each peak moment, and which source makes it: what better input would mend.

At the frame of a peak the variances of independent sources add; the largest comes first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.dynamics.torque_sources import Source, TorqueErrors
from gaitcal.gait.moments import moment_of
from gaitcal.gait.words import coordinate_title
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
from gaitcal.page.sections.error_sources import ErrorSources, error_sources
from gaitcal.page.sections.gait_numbers import GaitNumbers

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
    sources: tuple[tuple[Source, float], ...]
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


def _sources(errors: TorqueErrors, column: int, frame: int) -> tuple[tuple[Source, float], ...]:
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
        for source in Source
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
