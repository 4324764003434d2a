"""Peaks as clinics name them: each has a window of the stride, from the events of the foot itself.

Where a foot is in its stride is told in parts of its own stance and swing, whatever share of the stride they have,

    u = percent / toe-off                                     0 to 1   stance
    u = 1 + (percent - toe-off) / (100 - toe-off)             1 to 2   swing

so that a window means the same in a slow walk. With stance at 62 % of the stride the windows hold the phases of Perry &
Burnfield (Gait Analysis, 2010, chapter 1): loading response to 12 %, mid-stance to 31 %, terminal stance to 50 %,
pre-swing to toe-off. Windows of loads begin at 8 % of stance (5 % of the stride): before, the foot strikes, and what
filters leave of that shock is no muscle's work.

The highest or lowest value of a window is a peak only where the curve turns there. Where it lies at the edge of the
window, and the curve goes on, it belongs to another phase: there is none, whatever wiggles lie beside it. Each stride
has its own peaks, and means are of these: the peak of a mean curve is flatter than those of its strides
(`gait/ensemble.py` has their statistics and errors).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeAlias

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.gait.cycles import POINTS, Kind, coordinate_of, kind_of, unit_of
from gaitcal.gait.ensemble import spread
from gaitcal.gait.spatiotemporal import LEAST_VALID
from gaitcal.model.coordinates import coordinate_words, senses_of
from gaitcal.model.linkage import SIDES


class Figure(Enum):
    """What is taken of a curve within the window."""

    STRIKE = "strike"
    HIGHEST = "highest"
    LOWEST = "lowest"
    MEAN = "mean"
    RANGE = "range"


@dataclass(frozen=True)
class Peak:
    """One figure of a curve in one phase."""

    name: str  # as in `peaks.csv`
    variable: str  # of `cycles.csv`, in its signs
    figure: Figure
    phase: str  # in words
    window: tuple[float, float]  # u, see the module

    def title(self, *, external: bool = False) -> str:
        """`Hip extension moment, loading response`: loads by what they do, so that no choice of signs changes it."""
        kind, name, low = kind_of(self.variable), coordinate_of(self.variable), self.figure is Figure.LOWEST
        title = "Vertical ground reaction" if kind is Kind.FORCE else coordinate_words(name).title
        if kind is Kind.MOMENT:
            return f"{title.split()[0]} {(senses_of(name) or ('', ''))[low != external]} moment, {self.phase}"
        if kind is Kind.POWER:
            return f"{title.capitalize()} power {'absorbed' if low else 'generated'}, {self.phase}"
        return f"{title}, {self.measure}"

    @property
    def measure(self) -> str:
        """What is taken where: `highest in swing`, `at initial contact`."""
        return f"{'at' if self.figure is Figure.STRIKE else f'{self.figure.value} in'} {self.phase}"

    @property
    def words(self) -> str:
        """Its window: `8 to 45 % of stance`, `60 % of stance to 15 % of swing`."""
        begin, end = (round(100 * (u if u < 1 else u - 1)) for u in self.window)
        match self.window:
            case (0.0, 0.0):
                return "strike of the foot"
            case (0.0, 2.0):
                return "whole stride"
            case (_, last) if last <= 1.0:
                return f"{begin} to {end or 100} % of stance"
            case (first, _) if first >= 1.0:
                return f"{begin} to {end} % of swing"
            case _:
                return f"{begin} % of stance to {end} % of swing"


_ROWS: Final = """
pelvis_tilt_mean               pelvis_tilt              mean    0     2     stride
pelvis_tilt_range              pelvis_tilt              range   0     2     stride
pelvis_list_range              pelvis_list              range   0     2     stride
pelvis_rotation_range          pelvis_rotation          range   0     2     stride
hip_flexion_strike             hip_flexion              strike  0     0     initial contact
hip_extension_terminal_stance  hip_flexion              lowest  0.6   1.15  terminal stance
hip_flexion_swing              hip_flexion              highest 1     2     swing
hip_adduction_stance           hip_adduction            highest 0     1     stance
hip_abduction_swing            hip_adduction            lowest  0.8   2     swing
hip_rotation_stance            hip_rotation             mean    0     1     stance
knee_flexion_strike            knee_angle               strike  0     0     initial contact
knee_flexion_loading           knee_angle               highest 0.08  0.45  loading response
knee_extension_stance          knee_angle               lowest  0.4   0.95  terminal stance
knee_flexion_swing             knee_angle               highest 1     2     swing
ankle_angle_strike             ankle_angle              strike  0     0     initial contact
dorsiflexion_stance            ankle_angle              highest 0.4   1     terminal stance
plantarflexion_push_off        ankle_angle              lowest  0.9   1.4   push-off
dorsiflexion_swing             ankle_angle              highest 1.2   2     swing
hip_extension_moment           hip_flexion_moment       lowest  0.08  0.45  loading response
hip_flexion_moment             hip_flexion_moment       highest 0.6   1.15  push-off
hip_abduction_moment_1         hip_adduction_moment     lowest  0.08  0.5   loading response
hip_abduction_moment_2         hip_adduction_moment     lowest  0.5   1     terminal stance
knee_extension_moment          knee_angle_moment        lowest  0.08  0.45  loading response
knee_flexion_moment            knee_angle_moment        highest 0.4   0.95  terminal stance
knee_extension_moment_2        knee_angle_moment        lowest  0.8   1.15  push-off
knee_abduction_moment_1        knee_adduction_moment    lowest  0.08  0.5   loading response
knee_abduction_moment_2        knee_adduction_moment    lowest  0.5   1     terminal stance
dorsiflexion_moment            ankle_angle_moment       highest 0.08  0.35  loading response
plantarflexion_moment          ankle_angle_moment       lowest  0.6   1     push-off
hip_power_1                    hip_power                highest 0.08  0.5   loading response
hip_power_2                    hip_power                lowest  0.4   0.85  terminal stance
hip_power_3                    hip_power                highest 0.75  1.3   push-off
knee_power_1                   knee_power               lowest  0.08  0.35  loading response
knee_power_2                   knee_power               highest 0.15  0.55  mid-stance
knee_power_3                   knee_power               lowest  0.8   1.2   push-off
knee_power_4                   knee_power               lowest  1.6   2     terminal swing
ankle_power_1                  ankle_power              lowest  0.3   0.85  mid-stance and terminal stance
ankle_power_2                  ankle_power              highest 0.7   1.1   push-off
ground_reaction_1              ground_reaction_vertical highest 0.12  0.5   loading response
ground_reaction_2              ground_reaction_vertical lowest  0.3   0.7   mid-stance
ground_reaction_3              ground_reaction_vertical highest 0.6   1     push-off
"""


def _peak(row: str) -> Peak:
    name, variable, figure, begin, end, phase = row.split(maxsplit=5)
    return Peak(name, variable, Figure(figure), phase, (float(begin), float(end)))


PEAKS: Final = {peak.name: peak for peak in map(_peak, _ROWS.strip().splitlines())}
"""Powers are numbered as H1 to H3, K1 to K4, A1 and A2 of Winter (The Biomechanics and Motor Control of Human Gait,
1991)."""
ADDUCTION_PEAK: Final = PEAKS["knee_abduction_moment_1"]
"""The first peak of the external knee adduction moment, which the internal one resists by abduction."""

PeakValue: TypeAlias = tuple[float, float, float, float]
"""Of one stride: value, standard error, the part of it that is the stride's own, percent; NaN where not known."""


def stride_peaks(curves: Mapping[str, tuple[Array, Array, Array]], toe_off: float | None) -> dict[str, PeakValue]:
    """Peak -> what it is in one stride; only those that the stride has.

    Parameters
    ----------
    curves : variable of `cycles.csv` -> value, standard error, its own part (101,), NaN where not valid or not known.
    toe_off : % at which stance ends; None: not known, and no phase but the strike and the whole stride.
    """
    percent = np.arange(float(POINTS))
    out: dict[str, PeakValue] = {}
    at = percent if toe_off is None else np.interp(percent, [0.0, toe_off, 100.0], [0.0, 1.0, 2.0])
    for peak in PEAKS.values():
        known, (low, high) = curves.get(peak.variable), peak.window
        if known is None or (toe_off is None and (low, high) not in ((0.0, 0.0), (0.0, 2.0))):
            continue
        value, error, own = known
        inside = np.flatnonzero((at >= low) & (at <= high))
        if not len(inside) or np.isfinite(value[inside]).mean() < LEAST_VALID:
            continue
        match peak.figure:
            case Figure.MEAN:
                mean, *errors = (float(v[inside][np.isfinite(value[inside])].mean()) for v in known)
                out[peak.name] = (mean, errors[0], errors[1], np.nan)
            case Figure.RANGE:
                ends = inside[[np.nanargmin(value[inside]), np.nanargmax(value[inside])]]
                shared = np.sqrt(np.maximum(error[ends] ** 2 - own[ends] ** 2, 0.0))
                apart = float(np.hypot(*own[ends]))  # what all strides share is about the same at both ends
                out[peak.name] = (float(np.ptp(value[ends])), float(np.hypot(apart, np.ptp(shared))), apart, np.nan)
            case Figure.STRIKE:
                out[peak.name] = (float(value[0]), float(error[0]), float(own[0]), 0.0)
            case _:
                k = _turning(value if peak.figure is Figure.HIGHEST else -value, inside)
                if k is not None:
                    out[peak.name] = (float(value[k]), float(error[k]), float(own[k]), float(k))
    return out


def _turning(value: Array, inside: IntArray) -> int | None:
    """Where a curve is highest in a window, if neither neighbour is above it; else None."""
    k = int(inside[np.nanargmax(value[inside])])
    return k if 0 < k < POINTS - 1 and value[k] >= value[k - 1] and value[k] >= value[k + 1] else None


@dataclass(frozen=True, kw_only=True)
class PeakMean:
    """One peak of one leg over strides, in the unit of its variable; NaN where not known."""

    peak: Peak
    side: str
    n: int  # strides that have it
    strides: int  # that were looked at
    mean: float
    sd: float  # over strides
    se: float  # standard error of the mean, shared errors included
    percent: float  # of the stride, mean; NaN of a mean and of a range


PEAK_COLUMNS: Final = (
    *("side", "peak", "variable", "phase", "window", "unit", "strides", "n", "mean", "sd", "se", "percent"),
)
DIGITS: Final = 6


def peak_means(strides: Iterable[tuple[str, str, Mapping[str, PeakValue | Array]]]) -> tuple[PeakMean, ...]:
    """Means of peaks over the strides that count.

    `strides`: trial, side and peaks of each stride.
    """
    known = list(strides)
    out = []
    for peak in PEAKS.values():
        for side in SIDES:
            of_leg = [(trial, found.get(peak.name)) for trial, leg, found in known if leg == side]
            rows = [(trial, one) for trial, one in of_leg if one is not None]
            if not rows:
                continue
            value, error, own, percent = np.array([one for _, one in rows], dtype=np.float64).T
            over = spread(value[:, None], np.array([trial for trial, _ in rows]), own[:, None], error[:, None])
            out.append(
                PeakMean(
                    peak=peak,
                    side=side,
                    n=len(rows),
                    strides=len(of_leg),
                    mean=float(over.mean[0]),
                    sd=float(over.sd[0]),
                    se=float(over.se[0]),
                    percent=float(percent.mean()),
                )
            )
    return tuple(out)


def peak_columns(means: Sequence[PeakMean]) -> dict[str, list[object]]:
    """`PEAK_COLUMNS` of means, as in `peaks.csv`."""
    rows = [
        (m.side, m.peak.name, m.peak.variable, m.peak.phase, m.peak.words, unit_of(m.peak.variable), m.strides, m.n)
        + tuple(round(value, DIGITS) for value in (m.mean, m.sd, m.se, m.percent))
        for m in means
    ]
    return {name: [row[k] for row in rows] for k, name in enumerate(PEAK_COLUMNS)}
