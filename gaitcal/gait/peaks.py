"""Peaks of curves in the phases of gait that clinics name, with windows from the foot's events.

Position in the stride is relative to stance and swing, whatever their share of the stride,

    u = percent / toe-off                                     0 to 1   stance
    u = 1 + (percent - toe-off) / (100 - toe-off)             1 to 2   swing

so that a window means the same in a slow walk. With stance at 62 % of the stride, the windows
contain the phases of Perry & Burnfield (Gait Analysis, 2010, chapter 1): loading response to 12 %,
mid-stance to 31 %, terminal stance to 50 %, pre-swing to toe-off. Windows of loads begin at 8 % of
stance (5 % of the stride): earlier, the impact of the strike, as far as filters leave it, is not
the work of a muscle.

The highest or lowest value of a window is a peak only where the curve turns there. An extreme at
the edge of the window, from where the curve goes on, belongs to another phase: then there is no
peak. Each stride has its peaks, and means are over these, because the peak of a mean curve is
flatter than those of its strides (`gait/ensemble.py` has the statistics).

Other activities have whole phases as windows: stance and swing of runs and stairs, and phases of
repetitions (`gait/events.py`). Their highest or lowest value counts anywhere in the phase, except
next to samples that are not valid, as on a seat, where the curve may go on.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import Final, TypeAlias

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.gait import ensemble, spatiotemporal
from gaitcal.gait.cycles import POINTS, CurveKind, get_coordinate, get_curve_kind, get_unit
from gaitcal.model.coordinates import describe_coordinate, get_senses
from gaitcal.model.linkage import SIDES


class PeakKind(Enum):
    """Figure that is taken of a curve within the window."""

    STRIKE = "strike"
    HIGHEST = "highest"
    LOWEST = "lowest"
    MEAN = "mean"
    RANGE = "range"


@dataclass(frozen=True)
class Peak:
    """One figure of a curve in one phase."""

    name: str
    """Name in `peaks.csv`."""
    variable: str
    """Variable of `cycles.csv`, with its signs."""
    figure: PeakKind
    phase: str
    """Phase in words; of an activity that is no gait as in `cycles.csv`."""
    window: tuple[float, float] | None = None
    """u of the module, begin and end; None: the whole phase."""

    def make_title(self, *, external: bool = False) -> str:
        """Make the title: `Hip extension moment, loading response`.

        Parameters
        ----------
        external : bool
            Name moments by the external load instead of the internal one.

        Returns
        -------
        str
            The action that loads have, so that no choice of signs changes the title.
        """
        kind, name = get_curve_kind(self.variable), get_coordinate(self.variable)
        low = self.figure is PeakKind.LOWEST
        if kind is CurveKind.FORCE:
            return f"Vertical ground reaction, {self.measure}"
        title = describe_coordinate(name).title
        if kind is CurveKind.MOMENT:
            # A lowest internal moment acts in the negative sense; external ones are the opposite.
            senses = get_senses(name) or ("", "")
            return f"{title.split()[0]} {senses[low != external]} moment, {self.phase}"
        if kind is CurveKind.POWER:
            return f"{title.capitalize()} power {'absorbed' if low else 'generated'}, {self.phase}"
        return f"{title}, {self.measure}"

    @property
    def measure(self) -> str:
        """Figure and phase: `highest in swing`, `at initial contact`."""
        if self.figure is PeakKind.STRIKE:
            return f"at {self.phase}"
        return f"{self.figure.value} in {self.phase}"

    @property
    def window_label(self) -> str:
        """Window in words: `8 to 45 % of stance`, `the pelvis goes down`."""
        if self.window is None:
            return PHASES[self.phase]
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
"""  # noqa: E501


def _parse_peak(row: str) -> Peak:
    """Parse a row of the table."""
    name, variable, figure, begin, end, phase = row.split(maxsplit=5)
    return Peak(name, variable, PeakKind(figure), phase, (float(begin), float(end)))


PEAKS: Final = {peak.name: peak for peak in map(_parse_peak, _ROWS.strip().splitlines())}
"""Powers are numbered as H1 to H3, K1 to K4, A1 and A2 of Winter (The Biomechanics and Motor
Control of Human Gait, 1991)."""
PHASES: Final = {
    "stance": "strike to off of the foot",
    "swing": "off of the foot to its next strike",
    "lowering": "the pelvis goes down",
    "rising": "the pelvis goes up",
    "push-off": "the pelvis goes up until both feet are off the ground",
    "landing": "from the first strike until the pelvis is lowest",
}
"""Phase of a stride or repetition of an activity that is no gait -> description. Flight has no
peaks.
"""
LEAST_VALID_SHARE: Final = 0.5
"""Part of a phase that must be valid: before a person leaves a seat, samples are not valid."""
_IN_PHASES: Final = """
hip_flexion            hip_flexion              highest stance swing lowering rising push-off landing
hip_extension          hip_flexion              lowest  stance
knee_flexion           knee_angle               highest stance swing lowering rising push-off landing
dorsiflexion           ankle_angle              highest stance lowering rising push-off landing
hip_extension_moment   hip_flexion_moment       lowest  stance lowering rising push-off landing
hip_abduction_moment   hip_adduction_moment     lowest  stance lowering rising push-off landing
knee_extension_moment  knee_angle_moment        lowest  stance lowering rising push-off landing
knee_abduction_moment  knee_adduction_moment    lowest  stance lowering rising push-off landing
plantarflexion_moment  ankle_angle_moment       lowest  stance lowering rising push-off landing
hip_power_absorbed     hip_power                lowest  stance lowering landing
knee_power_absorbed    knee_power               lowest  stance lowering landing
ankle_power_absorbed   ankle_power              lowest  stance lowering landing
hip_power_generated    hip_power                highest stance rising push-off
knee_power_generated   knee_power               highest stance rising push-off
ankle_power_generated  ankle_power              highest stance rising push-off
ground_reaction        ground_reaction_vertical highest stance lowering rising push-off landing
"""  # noqa: E501


def _list_phase_peaks() -> Iterator[Peak]:
    """Yield a peak for each phase in the rows of the table."""
    for row in _IN_PHASES.strip().splitlines():
        ending, variable, figure, *phases = row.split()
        for phase in phases:
            name = f"in_{phase.replace('-', '_')}_{ending}"
            yield Peak(name, variable, PeakKind(figure), phase)


PHASE_PEAKS: Final = {peak.name: peak for peak in _list_phase_peaks()}
"""Name -> peak of activities that are no gait."""
ADDUCTION_PEAK: Final = PEAKS["knee_abduction_moment_1"]
"""The first peak of the external knee adduction moment, which the internal one resists by
abduction.
"""

PeakValue: TypeAlias = tuple[float, float, float, float]
"""Peak of one stride: value, standard error, the part of it that the markers of the trial make,
percent; NaN where not known.
"""


def find_stride_peaks(
    curves: Mapping[str, tuple[Array, Array, Array]], toe_off: float | None
) -> dict[str, PeakValue]:
    """Find the peaks of one stride.

    Parameters
    ----------
    curves : mapping
        Variable of `cycles.csv` -> value, standard error and the part of it that the markers of the
        trial make, each (101,); NaN where not valid or not known.
    toe_off : float or None
        Percent at which stance ends. Without it, only peaks at the strike and over the whole stride
        can be found.

    Returns
    -------
    dict
        Name of the peak -> value; only peaks that the stride has.
    """
    percent = np.arange(float(POINTS))
    # u of the module; without a toe-off only windows that do not depend on it are used.
    at = percent if toe_off is None else np.interp(percent, [0.0, toe_off, 100.0], [0.0, 1.0, 2.0])
    out: dict[str, PeakValue] = {}
    for peak in PEAKS.values():
        curve, window = curves.get(peak.variable), peak.window
        if curve is None or window is None:
            continue
        if toe_off is None and window not in ((0.0, 0.0), (0.0, 2.0)):
            continue
        inside = np.flatnonzero((at >= window[0]) & (at <= window[1]))
        if not len(inside) or np.isfinite(curve[0][inside]).mean() < spatiotemporal.LEAST_VALID:
            continue
        found = _measure_peak(peak.figure, curve, inside)
        if found is not None:
            out[peak.name] = found
    return out


def _measure_peak(
    figure: PeakKind, curve: tuple[Array, Array, Array], inside: IntArray
) -> PeakValue | None:
    """Measure one figure of a curve in the percents `inside`; None where it has no peak there."""
    value, error, individual = curve
    match figure:
        case PeakKind.MEAN:
            known = inside[np.isfinite(value[inside])]
            mean, mean_error, part = (float(v[known].mean()) for v in curve)
            return mean, mean_error, part, np.nan
        case PeakKind.RANGE:
            ends = inside[[np.nanargmin(value[inside]), np.nanargmax(value[inside])]]
            # Errors that all strides share are similar at both ends: their difference counts.
            shared = np.sqrt(np.maximum(error[ends] ** 2 - individual[ends] ** 2, 0.0))
            part = float(np.hypot(*individual[ends]))
            total = float(np.hypot(part, np.ptp(shared)))
            return float(np.ptp(value[ends])), total, part, np.nan
        case PeakKind.STRIKE:
            return float(value[0]), float(error[0]), float(individual[0]), 0.0
        case _:
            signed = value if figure is PeakKind.HIGHEST else -value
            k = int(inside[np.nanargmax(signed[inside])])
            # At the edge of the window the curve may go on: a peak turns there.
            if 0 < k < POINTS - 1 and signed[k] >= signed[k - 1] and signed[k] >= signed[k + 1]:
                return float(value[k]), float(error[k]), float(individual[k]), float(k)
            return None


def find_phase_peaks(
    curves: Mapping[str, tuple[Array, Array, Array]], phases: Sequence[str]
) -> dict[str, PeakValue]:
    """Find the peaks of one stride or repetition of an activity that is no gait.

    Parameters
    ----------
    curves : mapping
        As of `find_stride_peaks`.
    phases : sequence of str
        Phase at each percent, as in `cycles.csv`.

    Returns
    -------
    dict
        Name of the peak -> value; only peaks that the repetition has.
    """
    out: dict[str, PeakValue] = {}
    for peak in PHASE_PEAKS.values():
        inside = np.flatnonzero(np.array(phases) == peak.phase)
        if peak.variable in curves and len(inside):
            value, error, individual = curves[peak.variable]
            signed = value if peak.figure is PeakKind.HIGHEST else -value
            k = int(inside[np.where(np.isfinite(value), signed, -np.inf)[inside].argmax()])
            # Next to a sample that is not valid the curve may go on.
            neighbours_valid = np.isfinite(value[max(k - 1, 0) : k + 2]).all()
            if neighbours_valid and np.isfinite(value[inside]).mean() >= LEAST_VALID_SHARE:
                out[peak.name] = (float(value[k]), float(error[k]), float(individual[k]), float(k))
    return out


@dataclass(frozen=True, kw_only=True)
class PeakMean:
    """Mean of one peak of one leg over strides, in the unit of its variable; NaN if not known."""

    activity: str  # as in `cycles.csv`
    peak: Peak
    side: str
    n: int  # strides with this peak
    strides: int  # strides in which it was searched
    mean: float
    sd: float  # over strides
    se: float  # standard error of the mean, shared errors included
    percent: float  # mean percent of the stride; NaN of a mean and of a range


PEAK_COLUMNS: Final = (
    "side",
    "peak",
    "variable",
    "phase",
    "window",
    "unit",
    "strides",
    "n",
    "mean",
    "sd",
    "se",
    "percent",
    "activity",
)
DIGITS: Final = 6
"""Decimals in `peaks.csv`."""


def average_peaks(
    strides: Iterable[tuple[str, str, str, Mapping[str, PeakValue | Array]]],
) -> tuple[PeakMean, ...]:
    """Average peaks over strides, separately for each activity.

    Parameters
    ----------
    strides : iterable of tuple
        Activity, trial, side and peaks of each stride or repetition.

    Returns
    -------
    tuple of PeakMean
    """
    # (activity, side) -> trial and peaks of each of its strides, activities in order of appearance
    legs: dict[tuple[str, str], list[tuple[str, Mapping[str, PeakValue | Array]]]] = {}
    for activity, trial, side, found in strides:
        legs.setdefault((activity, side), []).append((trial, found))
    activities = dict.fromkeys(activity for activity, _ in legs)
    out = []
    for activity, peak, side in product(activities, (PEAKS | PHASE_PEAKS).values(), SIDES):
        leg = legs.get((activity, side), [])
        rows = [(trial, found[peak.name]) for trial, found in leg if peak.name in found]
        if not rows:
            continue
        trials = np.array([trial for trial, _ in rows])
        values = np.array([value for _, value in rows], dtype=np.float64)
        value, error, individual, percent = values.T
        # Strides of one trial share errors, which do not average out.
        statistics = ensemble.compute_statistics(
            value[:, None], trials, individual[:, None], error[:, None]
        )
        out.append(
            PeakMean(
                activity=activity,
                peak=peak,
                side=side,
                n=len(rows),
                strides=len(leg),
                mean=float(statistics.mean[0]),
                sd=float(statistics.sd[0]),
                se=float(statistics.se[0]),
                percent=float(percent.mean()),
            )
        )
    return tuple(out)


def make_peak_columns(means: Sequence[PeakMean]) -> dict[str, list[object]]:
    """Make the columns of `peaks.csv`.

    Parameters
    ----------
    means : sequence of PeakMean
        Means of peaks, a row each.

    Returns
    -------
    dict
        `PEAK_COLUMNS` -> values.
    """
    columns: dict[str, list[object]] = {name: [] for name in PEAK_COLUMNS}
    for m in means:
        row: tuple[object, ...] = (
            m.side,
            m.peak.name,
            m.peak.variable,
            m.peak.phase,
            m.peak.window_label,
            get_unit(m.peak.variable),
            m.strides,
            m.n,
            *(round(value, DIGITS) for value in (m.mean, m.sd, m.se, m.percent)),
            m.activity,
        )
        for column, value in zip(columns.values(), row, strict=True):
            column.append(value)
    return columns
