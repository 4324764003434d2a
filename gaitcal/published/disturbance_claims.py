"""Claims of the published study that rest on its Monte Carlo analysis.

All compare mean RMS torque errors of one leg at the highest level studied (%BW*H). Limits are ours, except where the
paper names one. `conclusions` says of any study what its draws decide: fewer than `FEWEST` are not judged, nor is a
difference that chance alone could bring about. `disturbance_claims` puts the paper's sentences to the test; at risk are
those that depend on how ground reactions follow a disturbed model, which the paper does not say: both readings are
tested, fixed in the laboratory and carried along with the foot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.published.claims import Claim, Verdict, tested
from gaitcal.published.draw import TORQUE_WORDS, TORQUES
from gaitcal.published.protocol import PUBLISHED_DRAWS, SIDE, MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.statistics import FEWEST, expect, levels_of, unconverged

IP_LIMIT = 0.25
"""%BW*H: the paper's own limit for inertial parameters at +-10 %; that of marker noise too, which the paper calls small
without a number."""
INTERACTION_LIMIT = 0.15
"""Relative difference of JP + IP and what both alone add up to that would be called an interaction."""
SAMPLING = 3.0
"""Standard errors of the averages within which chance lies. Where they are wider than `INTERACTION_LIMIT`, the draws
cannot tell an interaction from chance."""


class PublishedFigure(NamedTuple):
    """A figure that the paper gives in prose: mean RMS at 100 %, %BW*H."""

    varied: Varied
    torque: str
    inertial_percent: float
    value: float


PUBLISHED = (
    PublishedFigure(Varied.JP, "hip_flexion", 10.0, 4.14),
    PublishedFigure(Varied.JP, "hip_adduction", 10.0, 1.06),
    PublishedFigure(Varied.JP, "knee_angle", 10.0, 0.92),
    PublishedFigure(Varied.IP, "hip_flexion", 50.0, 0.31),
)


@dataclass(frozen=True, kw_only=True)
class Conclusion:
    """One claim, whether it holds here, and why."""

    claim: str
    frame: ReactionFrame
    holds: bool | None  # None where the draws are too few to judge
    numbers: str  # A sentence with the figures behind it
    draws: int  # Draws that the smallest of its sets has, failed ones left out

    @property
    def verdict(self) -> str:
        """In words."""
        if self.holds is None:
            return f"not judged: {self.draws} draws"
        return "holds" if self.holds else "does not hold"


def beside(
    table: pd.DataFrame, figure: PublishedFigure, settings: MonteCarloSettings, side: str = "l"
) -> dict[ReactionFrame, float]:
    """Our mean RMS (%BW*H) for a published figure, in either frame; empty where the study did not look at it."""
    if figure.varied is Varied.IP and settings.inertial_percent != figure.inertial_percent:
        return {}
    levels = {frame: levels_of(table, figure.varied, f"{figure.torque}_{side}", frame) for frame in ReactionFrame}
    at_full = {frame: rows.loc[rows["level"] == 100, "average"] for frame, rows in levels.items()}
    return {frame: float(rows.iloc[0]) for frame, rows in at_full.items() if len(rows)}


def top_errors(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str = "l") -> pd.DataFrame | None:
    """Statistics of the RMS torque errors (%BW*H) of a leg at the highest level, in the order of `TORQUES`; None where
    the set is absent.
    """
    rows = pd.concat([levels_of(table, varied, f"{torque}_{side}", frame).tail(1) for torque in TORQUES])
    return rows if len(rows) == len(TORQUES) else None


def conclusions(table: pd.DataFrame, side: str = "l") -> tuple[Conclusion, ...]:
    """The claims that the sets in `table` (from `statistics`) allow to test, both ground-reaction frames."""
    out: list[Conclusion] = []
    for frame in ReactionFrame:
        tops = {varied: top_errors(table, varied, frame, side) for varied in Varied}
        averages = {varied: rows["average"].to_numpy(float) for varied, rows in tops.items() if rows is not None}
        jp, ip, both, noise = (averages.get(varied) for varied in Varied)

        def conclude(claim: str, sets: tuple[Varied, ...], holds: np.bool_, numbers: str, *, sure: bool = True) -> None:
            draws = min(int(rows["draws"].iloc[0]) for varied in sets if (rows := tops[varied]) is not None)  # noqa: B023
            verdict = bool(holds) if draws >= FEWEST and sure else None
            out.append(Conclusion(claim=claim, frame=frame, holds=verdict, numbers=numbers, draws=draws))  # noqa: B023

        if jp is not None and ip is not None:
            means = f"mean over torques {jp.mean():.3f} and {ip.mean():.3f} %BW*H"
            numbers = f"JP / IP, torque by torque: {_range(jp / ip)}; {means}"
            conclude("joint parameters dominate", (Varied.JP, Varied.IP), (jp > ip).all(), numbers)
        if ip is not None:
            markers = levels_of(table, Varied.IP, f"markers_{side}")
            moved = f"; markers move {markers['average'].iloc[-1]:.3g} mm" if len(markers) else ""
            numbers = f"largest IP error {ip.max():.3f} %BW*H ({_name(ip.argmax())}), limit {IP_LIMIT}{moved}"
            conclude("inertial parameters matter little", (Varied.IP,), ip.max() < IP_LIMIT, numbers)
        if jp is not None and both is not None and ip is not None:
            apart = both / np.hypot(jp, ip) - 1.0
            errors = [
                (rows["sd"] / rows["average"] / np.sqrt(rows["draws"].clip(lower=1))).to_numpy()
                for varied in (Varied.JP, Varied.BOTH)
                if (rows := tops[varied]) is not None
            ]
            chance = SAMPLING * np.hypot(*errors)
            numbers = (
                f"JP + IP against JP: {_range(both / jp)}; against the root of the sum of squares, as without "
                f"interaction: {_range(1.0 + apart)}, limit {1 - INTERACTION_LIMIT:g} to {1 + INTERACTION_LIMIT:g}, "
                f"chance {chance.max():.2f}"
            )
            sets, little = (Varied.JP, Varied.IP, Varied.BOTH), (np.abs(apart) < INTERACTION_LIMIT).all()
            conclude("no interaction", sets, little, numbers, sure=bool((chance < INTERACTION_LIMIT).all()))
        if jp is not None and noise is not None:
            numbers = (
                f"noise / JP: {_range(noise / jp)}; largest noise error {noise.max():.3f} %BW*H "
                f"({_name(noise.argmax())}), limit {IP_LIMIT}"
            )
            little = (noise < jp).all() & (noise.max() < IP_LIMIT)
            conclude("marker noise matters little", (Varied.JP, Varied.NOISE), little, numbers)
    return tuple(out)


def _range(values: Array) -> str:
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return f"{values[low]:.2f} ({_name(low)}) to {values[high]:.2f} ({_name(high)})"


def _name(torque: np.intp | int) -> str:
    return TORQUE_WORDS[TORQUES[int(torque)]]


FRAMES = {ReactionFrame.LAB: "ground reactions fixed in the laboratory", ReactionFrame.FOOT: "carried with the foot"}
WITHIN = 0.25  # Relative difference from a published torque error that still counts as the same
SMALL_TORQUE = 1.0  # %BW*H that a small torque error from marker noise stays below
WIDE_PERCENT = 50.0  # %: inertial bounds of the extra analysis
_JP_FIGURES = tuple(figure for figure in PUBLISHED if figure.varied is Varied.JP)


@dataclass(frozen=True)
class Disturbances:
    """Statistics of the Monte Carlo studies (see `statistics.statistics`)."""

    table: pd.DataFrame  # The four sets at the published bounds
    wide: pd.DataFrame  # Inertial parameters alone, +-50 %
    draws: int

    def torque(self, varied: Varied, torque: str, frame: ReactionFrame, measure: str = "rms") -> list[float]:
        """Averages of a torque error, level by level, %BW*H."""
        return list(levels_of(self.table, varied, f"{torque}_{SIDE}", frame, measure)["average"])

    def markers(self, varied: Varied, measure: str = "rms") -> list[float]:
        """Averages of the marker distance, level by level, mm."""
        return list(levels_of(self.table, varied, f"markers_{SIDE}", measure=measure)["average"])

    def top(self, varied: Varied, frame: ReactionFrame) -> Array:
        """(7,) averages of the RMS torque errors of the published leg at the highest level, %BW*H."""
        return _errors(self.table, varied, frame)


def _errors(table: pd.DataFrame, varied: Varied, frame: ReactionFrame) -> Array:
    rows = top_errors(table, varied, frame, SIDE)
    if rows is None:
        raise ValueError(f"the study lacks the set {varied.value}")
    return rows["average"].to_numpy(dtype=float)


Outcome = tuple[str, bool | np.bool_]  # Our figures in words, and whether the claim holds
_Test = Callable[[Disturbances, ReactionFrame], Outcome]


def _dominate(d: Disturbances, frame: ReactionFrame) -> Outcome:
    ratio = d.top(Varied.JP, frame) / d.top(Varied.IP, frame)
    return f"JP / IP between {ratio.min():.1f} and {ratio.max():.0f}", ratio.min() > 1.0


def _no_interaction(d: Disturbances, frame: ReactionFrame) -> Outcome:
    ratio = d.top(Varied.BOTH, frame) / np.hypot(d.top(Varied.JP, frame), d.top(Varied.IP, frame))
    figures = f"JP+IP / root of the sum of squares between {ratio.min():.2f} and {ratio.max():.2f}"
    return figures, np.abs(ratio - 1.0).max() < INTERACTION_LIMIT


def _ip_markers(d: Disturbances, frame: ReactionFrame) -> Outcome:
    moved = max(d.markers(Varied.IP))
    return f"{moved:.2g} mm", moved < 1e-6


def _ip_wide(d: Disturbances, frame: ReactionFrame) -> Outcome:
    errors = _errors(d.wide, Varied.IP, frame)
    worst = TORQUES[int(errors.argmax())]
    figures = f"{TORQUE_WORDS[worst]} {errors.max():.2f} %BW*H"
    return figures, worst == "hip_flexion" and 0.15 < errors.max() < 0.6


def _ip_small(d: Disturbances, frame: ReactionFrame) -> Outcome:
    worst = d.top(Varied.IP, frame).max()
    return f"{worst:.3f} %BW*H at most", worst < IP_LIMIT


def _noise_monotone(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rising = sum((np.diff(d.torque(Varied.NOISE, t, frame)) > 0).all() for t in TORQUES)
    markers = (np.diff(d.markers(Varied.NOISE)) > 0).all()
    return f"{rising} of {len(TORQUES)} torques grow with every level", markers and rising == len(TORQUES)


def _noise_small(d: Disturbances, frame: ReactionFrame) -> Outcome:
    torque, marker = d.top(Varied.NOISE, frame).max(), d.markers(Varied.NOISE)[-1]
    return f"{torque:.2f} %BW*H at most, markers {marker:.1f} mm", torque < SMALL_TORQUE


def _rms_over_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rms, mean = (np.array([d.torque(Varied.NOISE, t, frame, m)[-1] for t in TORQUES]) for m in ("rms", "abs_mean"))
    return f"RMS / |mean| at least {(rms / mean).min():.1f}", (rms > mean).all()


def _marker_rms_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rms, mean = (d.markers(Varied.NOISE, measure)[-1] for measure in ("rms", "mean"))
    return f"{rms:.2f} and {mean:.2f} mm", mean > 0.8 * rms


def _converged(d: Disturbances, frame: ReactionFrame) -> Outcome:
    late = len(unconverged(d.table))
    return f"{late} distributions not settled after {d.draws} draws", late == 0


def _largest_first(d: Disturbances, varied: Varied, frame: ReactionFrame) -> list[str]:
    return [TORQUES[k] for k in np.argsort(-d.top(varied, frame))]


def _near(figure: PublishedFigure) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        ours = d.top(figure.varied, frame)[TORQUES.index(figure.torque)]
        rank = _largest_first(d, figure.varied, frame).index(figure.torque) + 1
        return f"{ours:.2f} %BW*H, number {rank} of {len(TORQUES)}", abs(ours / figure.value - 1.0) < WITHIN

    return test


def _largest(d: Disturbances, frame: ReactionFrame) -> Outcome:
    order = _largest_first(d, Varied.JP, frame)
    return f"largest: {', '.join(TORQUE_WORDS[t] for t in order[:3])}", order[:2] == ["hip_flexion", "hip_adduction"]


def _proximal(d: Disturbances, frame: ReactionFrame) -> Outcome:
    hip, knee, ankle = (joint.max() for joint in np.split(d.top(Varied.JP, frame), [3, 5]))
    return f"hip {hip:.2f}, knee {knee:.2f}, ankle {ankle:.2f} %BW*H at most", hip > knee > ankle


def _slightly_above(larger: str, smaller: str) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        a, b = (d.torque(Varied.JP, torque, frame)[-1] for torque in (larger, smaller))
        return f"{a:.2f} and {b:.2f} %BW*H", b < a < 1.5 * b

    return test


def _adduction_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    large = "hip_adduction" in _largest_first(d, Varied.JP, frame)[:2]
    rms, mean = (abs(d.torque(Varied.JP, "hip_adduction", frame, measure)[-1]) for measure in ("rms", "mean"))
    return f"RMS {rms:.2f}, mean {mean:.2f} %BW*H", large and mean < 0.25 * rms


def _levels(rms_mm: float, joint: tuple[float, float], noise: tuple[float, float]) -> _Test:
    """Whether a marker error means levels of JP and of noise between these."""
    wanted = {Varied.JP: joint, Varied.NOISE: noise}

    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        figures, holds = [], True
        for cause in expect(d.table, rms_mm, SIDE):
            low, high = wanted[cause.varied]
            figures.append(f"{cause.varied.title} {'more than 100' if cause.beyond else f'{cause.level:.0f}'} %")
            holds = holds and low <= (np.inf if cause.beyond else cause.level) <= high
        return ", ".join(figures), holds

    return test


FOUR_MM = _levels(4.0, (0.0, 25.0), (40.0, 75.0))
FOURTEEN_MM = _levels(14.0, (40.0, 60.0), (100.0, np.inf))  # Of the levels that the printed marker errors mean


def printed_markers(d: Disturbances) -> Outcome:
    """Whether both printed marker errors mean the levels that the paper says."""
    (four, four_holds), (more, more_holds) = (test(d, ReactionFrame.LAB) for test in (FOUR_MM, FOURTEEN_MM))
    return f"4 mm: {four}; 14 mm: {more}", four_holds and more_holds


def printed_torques(d: Disturbances, frame: ReactionFrame) -> Outcome:
    """Whether the three printed JP torque errors come out together."""
    errors = dict(zip(TORQUES, d.top(Varied.JP, frame), strict=True))
    figures = ", ".join(f"{TORQUE_WORDS[figure.torque]} {errors[figure.torque]:.2f}" for figure in _JP_FIGURES)
    near = [abs(errors[figure.torque] / figure.value - 1.0) < WITHIN for figure in _JP_FIGURES]
    return f"{figures} %BW*H", all(near)


_EXPECTED: tuple[tuple[str, str, _Test, bool], ...] = (
    ("joint parameters disturb every torque more than inertial parameters", "stated", _dominate, True),
    ("joint and inertial parameters do not interact: JP+IP is as JP and IP apart", "stated", _no_interaction, True),
    ("inertial parameters leave the markers alone", "stated", _ip_markers, False),
    ("inertial parameters +-50 %: hip flexion is worst", "0.31 %BW*H", _ip_wide, False),
    ("inertial parameters +-10 %: every torque error is small", "less than 0.25 %BW*H", _ip_small, False),
    ("marker noise: errors grow with the amplitude", "stated", _noise_monotone, True),
    ("marker noise: small in torques, moderate in markers", "stated", _noise_small, True),
    ("marker noise: RMS torque errors exceed mean ones", "stated", _rms_over_mean, True),
    ("marker noise: RMS and mean marker distance are alike", "stated", _marker_rms_mean, False),
    ("mean and CV of every torque settle within 2 % over the last tenth", "5000 draws", _converged, False),
)
"""Claim, what is published, our test, and whether it depends on where ground reactions stay."""
_FOUR_MM_CLAIM = "4 mm of marker error mean a low level of JP and half of the noise"
_FOURTEEN_MM_CLAIM = "14 mm of marker error mean half of JP and more than all of the noise"
_INVERSION, _ABDUCTION = ("subtalar_angle", "ankle_angle"), ("knee_adduction", "knee_angle")
_AT_RISK: tuple[tuple[str, str, _Test, bool], ...] = (
    *((f"JP: {TORQUE_WORDS[f.torque]} error", f"{f.value} %BW*H", _near(f), True) for f in _JP_FIGURES),
    (
        "JP: hip flexion, hip adduction and knee flexion errors together",
        "4.14, 1.06 and 0.92 %BW*H",
        printed_torques,
        True,
    ),
    ("JP: hip flexion is largest, hip adduction second", "4.14 and 1.06 %BW*H", _largest, True),
    ("JP: errors grow from distal to proximal", "stated", _proximal, True),
    ("JP: ankle inversion slightly above plantarflexion", "stated", _slightly_above(*_INVERSION), True),
    ("JP: knee abduction slightly above flexion", "stated", _slightly_above(*_ABDUCTION), True),
    ("JP: hip adduction has a large RMS and a small mean error", "stated", _adduction_mean, True),
    (_FOUR_MM_CLAIM, "JP less than 25 %, noise 50 %", FOUR_MM, False),
    (_FOURTEEN_MM_CLAIM, "JP 50 %, noise more than 100 %", FOURTEEN_MM, False),
)


def disturbance_claims(disturbances: Disturbances | None) -> list[Claim]:
    """All claims on disturbed models; without a Monte Carlo study they are there as not run."""
    out: list[Claim] = []
    for group, entries in (("", _EXPECTED), ("at risk: ", _AT_RISK)):
        for claim, published, test, framed in entries:
            for frame in FRAMES if framed else (None,):
                sentence = f"{group}{claim}" + ("" if frame is None else f" ({FRAMES[frame]})")
                found = Claim(sentence, published, "", Verdict.NOT_RUN)
                if disturbances is not None:
                    ours, holds = test(disturbances, frame or ReactionFrame.LAB)
                    found = tested(sentence, published, ours, holds)
                    if test is _converged and not holds and disturbances.draws < PUBLISHED_DRAWS:
                        found = replace(found, verdict=Verdict.NOT_RUN)  # fewer draws than the claim is about
                out.append(found)
    return out
