"""Peaks as clinics name them: each has a window of the stride, from the events of the foot itself.

Where a foot is in its stride is told in parts of its own stance and swing, whatever share of the
stride they have,

    u = percent / toe-off                                     0 to 1   stance
    u = 1 + (percent - toe-off) / (100 - toe-off)             1 to 2   swing

so that a window means the same in a slow walk. With stance at 62 % of the stride the windows hold
the phases of Perry & Burnfield (Gait Analysis, 2010, chapter 1): loading response to 12 %,
mid-stance to 31 %, terminal stance to 50 %, pre-swing to toe-off. Windows of loads begin at 8 % of
stance (5 % of the stride): before, the foot strikes, and what filters leave of that shock is no
muscle's work.

The highest or lowest value of a window is a peak only where the curve turns there. Where it lies at
the edge of the window, and the curve goes on, it belongs to another phase: there is none, whatever
wiggles lie beside it. Each stride has its own peaks, and means are of these: the peak of a mean
curve is flatter than those of its strides (`gait/ensemble.py` has their statistics and errors).

Other activities have whole phases for windows: stance and swing of runs and stairs, and what the
pelvis does in a repetition (`gait/events.py`). Their highest or lowest value counts wherever it
lies in the phase, but not beside samples that are not valid, as on a seat: the curve may go on
there.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import Final, TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait import ensemble, spatiotemporal
from gaitcal.gait.cycles import POINTS, CurveKind, coordinate_of, kind_of, unit_of
from gaitcal.model.coordinates import describe_coordinate, get_senses
from gaitcal.model.linkage import SIDES


class PeakKind(Enum):
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
    figure: PeakKind
    phase: str  # in words; of an activity that is no gait as in `cycles.csv`
    window: tuple[float, float] | None = None  # u, see the module; None: the whole phase

    def title(self, *, external: bool = False) -> str:
        """`Hip extension moment, loading response`: loads by what they do, so that no choice of
        signs changes it.
        """
        kind, name, low = (
            kind_of(self.variable),
            coordinate_of(self.variable),
            self.figure is PeakKind.LOWEST,
        )
        title = (
            "Vertical ground reaction"
            if kind is CurveKind.FORCE
            else describe_coordinate(name).title
        )
        if kind is CurveKind.MOMENT:
            return (
                f"{title.split()[0]} {(get_senses(name) or ('', ''))[low != external]} moment, "
                f"{self.phase}"
            )
        if kind is CurveKind.POWER:
            return f"{title.capitalize()} power {'absorbed' if low else 'generated'}, {self.phase}"
        return f"{title}, {self.measure}"

    @property
    def measure(self) -> str:
        """What is taken where: `highest in swing`, `at initial contact`."""
        return (
            f"{'at' if self.figure is PeakKind.STRIKE else f'{self.figure.value} in'} {self.phase}"
        )

    @property
    def words(self) -> str:
        """Its window: `8 to 45 % of stance`, `60 % of stance to 15 % of swing`, `the pelvis goes
        down`.
        """
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
"""


def _peak(row: str) -> Peak:
    name, variable, figure, begin, end, phase = row.split(maxsplit=5)
    return Peak(name, variable, PeakKind(figure), phase, (float(begin), float(end)))


PEAKS: Final = {peak.name: peak for peak in map(_peak, _ROWS.strip().splitlines())}
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
"""Phase of a stride or a repetition of an activity that is no gait -> what it is; flight has no
peaks.
"""
LEAST_SEEN: Final = (
    0.5  # of a phase whose peak counts: what comes before somebody leaves a seat is not valid
)
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
"""
PHASE_PEAKS: Final = {
    name: Peak(name, variable, PeakKind(figure), phase)
    for begin, variable, figure, *phases in map(str.split, _IN_PHASES.strip().splitlines())
    for phase in phases
    for name in (f"in_{phase.replace('-', '_')}_{begin}",)
}
"""Of activities that are no gait."""
ADDUCTION_PEAK: Final = PEAKS["knee_abduction_moment_1"]
"""The first peak of the external knee adduction moment, which the internal one resists by
abduction.
"""

PeakValue: TypeAlias = tuple[float, float, float, float]
"""Of one stride: value, standard error, the part of it that is the stride's own, percent; NaN where
not known.
"""


def stride_peaks(
    curves: Mapping[str, tuple[Array, Array, Array]], toe_off: float | None
) -> dict[str, PeakValue]:
    """Peak -> what it is in one stride; only those that the stride has.

    `curves`: variable of `cycles.csv` -> value, standard error, its own part (101,), NaN where not
    valid or not known. `toe_off`: % at which stance ends; None: not known, and no phase but the
    strike and the whole stride.
    """
    percent = np.arange(float(POINTS))
    out: dict[str, PeakValue] = {}
    at = percent if toe_off is None else np.interp(percent, [0.0, toe_off, 100.0], [0.0, 1.0, 2.0])
    for peak in PEAKS.values():
        known, window = curves.get(peak.variable), peak.window
        if (
            known is None
            or window is None
            or (toe_off is None and window not in ((0.0, 0.0), (0.0, 2.0)))
        ):
            continue
        (value, error, own), (low, high) = known, window
        inside = np.flatnonzero((at >= low) & (at <= high))
        if not len(inside) or np.isfinite(value[inside]).mean() < spatiotemporal.LEAST_VALID:
            continue
        match peak.figure:
            case PeakKind.MEAN:
                mean, *errors = (float(v[inside][np.isfinite(value[inside])].mean()) for v in known)
                out[peak.name] = (mean, errors[0], errors[1], np.nan)
            case PeakKind.RANGE:
                ends = inside[[np.nanargmin(value[inside]), np.nanargmax(value[inside])]]
                shared = np.sqrt(np.maximum(error[ends] ** 2 - own[ends] ** 2, 0.0))
                apart = float(
                    np.hypot(*own[ends])
                )  # what all strides share is about the same at both ends
                out[peak.name] = (
                    float(np.ptp(value[ends])),
                    float(np.hypot(apart, np.ptp(shared))),
                    apart,
                    np.nan,
                )
            case PeakKind.STRIKE:
                out[peak.name] = (float(value[0]), float(error[0]), float(own[0]), 0.0)
            case _:
                signed = value if peak.figure is PeakKind.HIGHEST else -value
                k = int(inside[np.nanargmax(signed[inside])])
                if 0 < k < POINTS - 1 and signed[k] >= signed[k - 1] and signed[k] >= signed[k + 1]:
                    out[peak.name] = (float(value[k]), float(error[k]), float(own[k]), float(k))
    return out


def phase_peaks(
    curves: Mapping[str, tuple[Array, Array, Array]], phases: Sequence[str]
) -> dict[str, PeakValue]:
    """The same of a stride or repetition of an activity that is no gait; `phases`: of each percent
    (`cycles.csv`).
    """
    out: dict[str, PeakValue] = {}
    for peak in PHASE_PEAKS.values():
        inside = np.flatnonzero(np.array(phases) == peak.phase)
        if peak.variable in curves and len(inside):
            value, error, own = curves[peak.variable]
            signed = np.where(
                np.isfinite(value), value if peak.figure is PeakKind.HIGHEST else -value, -np.inf
            )
            k = int(inside[signed[inside].argmax()])
            if (
                np.isfinite(value[max(k - 1, 0) : k + 2]).all()
                and np.isfinite(value[inside]).mean() >= LEAST_SEEN
            ):
                out[peak.name] = (float(value[k]), float(error[k]), float(own[k]), float(k))
    return out


@dataclass(frozen=True, kw_only=True)
class PeakMean:
    """One peak of one leg over strides, in the unit of its variable; NaN where not known."""

    activity: str  # as in `cycles.csv`
    peak: Peak
    side: str
    n: int  # strides that have it
    strides: int  # that were looked at
    mean: float
    sd: float  # over strides
    se: float  # standard error of the mean, shared errors included
    percent: float  # of the stride, mean; NaN of a mean and of a range


PEAK_COLUMNS: Final = (
    *(
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
    ),
)
DIGITS: Final = 6


def peak_means(
    strides: Iterable[tuple[str, str, str, Mapping[str, PeakValue | Array]]],
) -> tuple[PeakMean, ...]:
    """Means of peaks over the strides that count, activity by activity.

    `strides`: activity, trial, side and peaks of each stride or repetition.
    """
    known = list(strides)
    out = []
    for activity, peak, side in product(
        dict.fromkeys(of for of, *_ in known), (PEAKS | PHASE_PEAKS).values(), SIDES
    ):
        of_leg = [
            (trial, found.get(peak.name))
            for of, trial, leg, found in known
            if (of, leg) == (activity, side)
        ]
        rows = [(trial, one) for trial, one in of_leg if one is not None]
        if not rows:
            continue
        value, error, own, percent = np.array([one for _, one in rows], dtype=np.float64).T
        over = ensemble.spread(
            value[:, None], np.array([trial for trial, _ in rows]), own[:, None], error[:, None]
        )
        out.append(
            PeakMean(
                activity=activity,
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
        (
            m.side,
            m.peak.name,
            m.peak.variable,
            m.peak.phase,
            m.peak.words,
            unit_of(m.peak.variable),
            m.strides,
            m.n,
        )
        + (*(round(value, DIGITS) for value in (m.mean, m.sd, m.se, m.percent)), m.activity)
        for m in means
    ]
    return {name: [row[k] for row in rows] for k, name in enumerate(PEAK_COLUMNS)}
