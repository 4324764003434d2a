"""The claims of the published study that rest on its Monte Carlo analysis: expected ones, and those at risk.

At risk are those that depend on how ground reactions follow a disturbed model, which the paper does not say: both
readings are tested, fixed in the laboratory and carried along with the foot, and what comes out is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class PublishedFigure:
    """A figure that the paper gives in prose."""

    varied: Varied
    torque: str
    inertial_percent: float
    value: float
    """%BW*H, mean RMS at 100 %."""


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
    holds: bool | None
    """None where the draws are too few to judge."""
    numbers: str
    """A sentence with the figures behind it."""
    draws: int
    """Draws that the smallest of its sets has, failed ones left out."""

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


def conclusions(table: pd.DataFrame, side: str = "l") -> tuple[Conclusion, ...]:
    """The claims that the sets in `table` (from `statistics`) allow to test, both ground-reaction frames."""
    return tuple(conclusion for frame in ReactionFrame for conclusion in _of_frame(table, frame, side))


def top_errors(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str = "l") -> Array | None:
    """(7,) mean RMS errors (%BW*H) at the highest level, in the order of `TORQUES`; None where the set is absent."""
    rows = _top_rows(table, varied, frame, side)
    return rows["average"].to_numpy(dtype=float) if len(rows) == len(TORQUES) else None


def _top_rows(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str) -> pd.DataFrame:
    """Statistics of the torques of a leg at the highest level, in the order of `TORQUES`."""
    return pd.concat([levels_of(table, varied, f"{torque}_{side}", frame).tail(1) for torque in TORQUES])


def _relative_error(rows: pd.DataFrame) -> Array:
    """(7,) standard errors of averages, relative to them."""
    out: Array = (rows["sd"] / rows["average"] / np.sqrt(rows["draws"].clip(lower=1))).to_numpy()
    return out


def _of_frame(table: pd.DataFrame, frame: ReactionFrame, side: str) -> list[Conclusion]:
    jp, ip, both, noise = (top_errors(table, varied, frame, side) for varied in Varied)
    out: list[Conclusion] = []

    def conclude(
        claim: str, sets: tuple[Varied, ...], holds: np.bool_, numbers: str, *, told_apart: bool = True
    ) -> None:
        draws = min(int(_top_rows(table, varied, frame, side)["draws"].iloc[0]) for varied in sets)
        verdict = bool(holds) if draws >= FEWEST and told_apart else None
        out.append(Conclusion(claim=claim, frame=frame, holds=verdict, numbers=numbers, draws=draws))

    if jp is not None and ip is not None:
        numbers = f"JP / IP, torque by torque: {_range(jp / ip)}; mean over torques {jp.mean():.3f} and {ip.mean():.3f}"
        conclude("joint parameters dominate", (Varied.JP, Varied.IP), (jp > ip).all(), numbers + " %BW*H")
    if ip is not None:
        numbers = f"largest IP error {ip.max():.3f} %BW*H ({_name(ip.argmax())}), limit {IP_LIMIT}{_moved(table, side)}"
        conclude("inertial parameters matter little", (Varied.IP,), ip.max() < IP_LIMIT, numbers)
    if jp is not None and both is not None and ip is not None:
        apart = both / np.hypot(jp, ip) - 1.0
        tops = (_top_rows(table, varied, frame, side) for varied in (Varied.JP, Varied.BOTH))
        chance = SAMPLING * np.hypot(*map(_relative_error, tops))
        numbers = (
            f"JP + IP against JP: {_range(both / jp)}; against the root of the sum of squares, as without "
            f"interaction: {_range(1.0 + apart)}, limit {1 - INTERACTION_LIMIT:g} to {1 + INTERACTION_LIMIT:g}, chance "
            f"{chance.max():.2f}"
        )
        little = (np.abs(apart) < INTERACTION_LIMIT).all()
        sure = bool((chance < INTERACTION_LIMIT).all())
        conclude("no interaction", (Varied.JP, Varied.IP, Varied.BOTH), little, numbers, told_apart=sure)
    if jp is not None and noise is not None:
        numbers = (
            f"noise / JP: {_range(noise / jp)}; largest noise error {noise.max():.3f} %BW*H "
            f"({_name(noise.argmax())}), limit {IP_LIMIT}"
        )
        little = (noise < jp).all() & (noise.max() < IP_LIMIT)
        conclude("marker noise matters little", (Varied.JP, Varied.NOISE), little, numbers)
    return out


def _moved(table: pd.DataFrame, side: str) -> str:
    markers = levels_of(table, Varied.IP, f"markers_{side}")
    return f"; markers move {markers['average'].iloc[-1]:.3g} mm" if len(markers) else ""


def _range(values: Array) -> str:
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return f"{values[low]:.2f} ({_name(low)}) to {values[high]:.2f} ({_name(high)})"


def _name(torque: np.intp | int) -> str:
    return TORQUE_WORDS[TORQUES[int(torque)]]


FRAMES = {ReactionFrame.LAB: "ground reactions fixed in the laboratory", ReactionFrame.FOOT: "carried with the foot"}
WITHIN = 0.25
"""Relative difference from a published torque error that still counts as the same."""
SMALL_TORQUE = 1.0
"""%BW*H that a small torque error from marker noise stays below."""
WIDE_PERCENT = 50.0
"""%: inertial bounds of the extra analysis."""


@dataclass(frozen=True)
class Disturbances:
    """Statistics of the Monte Carlo studies (see `montecarlo.statistics`)."""

    table: pd.DataFrame
    """The four sets at the published bounds."""
    wide: pd.DataFrame
    """Inertial parameters alone, +-50 %."""
    draws: int


Outcome = tuple[str, bool | np.bool_]
"""Our figures in words, and whether the claim holds."""
_Test = Callable[[Disturbances, ReactionFrame], Outcome]


def _averages(d: Disturbances, varied: Varied, torque: str, frame: ReactionFrame, measure: str = "rms") -> list[float]:
    """Of a torque error, level by level, %BW*H."""
    return list(levels_of(d.table, varied, f"{torque}_{SIDE}", frame, measure)["average"])


def _markers(d: Disturbances, varied: Varied, measure: str = "rms") -> list[float]:
    """Average marker distance, level by level, mm."""
    return list(levels_of(d.table, varied, f"markers_{SIDE}", measure=measure)["average"])


def mean_rms(table: pd.DataFrame, varied: Varied, frame: ReactionFrame) -> Array:
    """(7,) averages of the RMS torque errors of the published leg at the highest level, %BW*H."""
    errors = top_errors(table, varied, frame, SIDE)
    if errors is None:
        raise ValueError(f"the study lacks the set {varied.value}")
    return errors


def _dominate(d: Disturbances, frame: ReactionFrame) -> Outcome:
    ratio = mean_rms(d.table, Varied.JP, frame) / mean_rms(d.table, Varied.IP, frame)
    return f"JP / IP between {ratio.min():.1f} and {ratio.max():.0f}", ratio.min() > 1.0


def _no_interaction(d: Disturbances, frame: ReactionFrame) -> Outcome:
    joint, inertial, both = (mean_rms(d.table, varied, frame) for varied in (Varied.JP, Varied.IP, Varied.BOTH))
    ratio = both / np.hypot(joint, inertial)
    words = f"JP+IP / root of the sum of squares between {ratio.min():.2f} and {ratio.max():.2f}"
    return words, np.abs(ratio - 1.0).max() < INTERACTION_LIMIT


def _ip_markers(d: Disturbances, frame: ReactionFrame) -> Outcome:
    moved = max(_markers(d, Varied.IP))
    return f"{moved:.2g} mm", moved < 1e-6


def _ip_wide(d: Disturbances, frame: ReactionFrame) -> Outcome:
    errors = mean_rms(d.wide, Varied.IP, frame)
    worst = TORQUES[int(errors.argmax())]
    words = f"{TORQUE_WORDS[worst]} {errors.max():.2f} %BW*H"
    return words, worst == "hip_flexion" and 0.15 < errors.max() < 0.6


def _ip_small(d: Disturbances, frame: ReactionFrame) -> Outcome:
    worst = mean_rms(d.table, Varied.IP, frame).max()
    return f"{worst:.3f} %BW*H at most", worst < IP_LIMIT


def _noise_monotone(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rising = sum((np.diff(_averages(d, Varied.NOISE, t, frame)) > 0).all() for t in TORQUES)
    markers = (np.diff(_markers(d, Varied.NOISE)) > 0).all()
    return f"{rising} of {len(TORQUES)} torques grow with every level", markers and rising == len(TORQUES)


def _noise_small(d: Disturbances, frame: ReactionFrame) -> Outcome:
    torque, marker = mean_rms(d.table, Varied.NOISE, frame).max(), _markers(d, Varied.NOISE)[-1]
    return f"{torque:.2f} %BW*H at most, markers {marker:.1f} mm", torque < SMALL_TORQUE


def _rms_over_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rms, mean = (np.array([_averages(d, Varied.NOISE, t, frame, m)[-1] for t in TORQUES]) for m in ("rms", "abs_mean"))
    return f"RMS / |mean| at least {(rms / mean).min():.1f}", (rms > mean).all()


def _marker_rms_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    rms, mean = (_markers(d, Varied.NOISE, measure)[-1] for measure in ("rms", "mean"))
    return f"{rms:.2f} and {mean:.2f} mm", mean > 0.8 * rms


def _converged(d: Disturbances, frame: ReactionFrame) -> Outcome:
    late = len(unconverged(d.table))
    return f"{late} distributions not settled after {d.draws} draws", late == 0


def _largest_first(errors: Array) -> list[str]:
    return [TORQUES[k] for k in np.argsort(-errors)]


def _near(figure: PublishedFigure) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        errors = mean_rms(d.table, figure.varied, frame)
        ours, place = errors[TORQUES.index(figure.torque)], _largest_first(errors).index(figure.torque) + 1
        return f"{ours:.2f} %BW*H, number {place} of {len(TORQUES)}", abs(ours / figure.value - 1.0) < WITHIN

    return test


def _largest(d: Disturbances, frame: ReactionFrame) -> Outcome:
    order = _largest_first(mean_rms(d.table, Varied.JP, frame))
    return f"largest: {', '.join(TORQUE_WORDS[t] for t in order[:3])}", order[:2] == ["hip_flexion", "hip_adduction"]


def _proximal(d: Disturbances, frame: ReactionFrame) -> Outcome:
    errors = mean_rms(d.table, Varied.JP, frame)
    hip, knee, ankle = (joint.max() for joint in np.split(errors, [3, 5]))
    return f"hip {hip:.2f}, knee {knee:.2f}, ankle {ankle:.2f} %BW*H at most", hip > knee > ankle


def _slightly_above(larger: str, smaller: str) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        a, b = (_averages(d, Varied.JP, torque, frame)[-1] for torque in (larger, smaller))
        return f"{a:.2f} and {b:.2f} %BW*H", b < a < 1.5 * b

    return test


def _adduction_mean(d: Disturbances, frame: ReactionFrame) -> Outcome:
    torque = "hip_adduction"
    large = torque in _largest_first(mean_rms(d.table, Varied.JP, frame))[:2]
    rms, mean = (abs(_averages(d, Varied.JP, torque, frame, measure)[-1]) for measure in ("rms", "mean"))
    return f"RMS {rms:.2f}, mean {mean:.2f} %BW*H", large and mean < 0.25 * rms


def _levels(rms_mm: float, joint: tuple[float, float], noise: tuple[float, float]) -> _Test:
    wanted = {Varied.JP: joint, Varied.NOISE: noise}

    def test(d: Disturbances, frame: ReactionFrame) -> Outcome:
        words, holds = [], True
        for cause in expect(d.table, rms_mm, SIDE):
            low, high = wanted[cause.varied]
            words.append(f"{cause.varied.title} {'more than 100' if cause.beyond else f'{cause.level:.0f}'} %")
            holds = holds and low <= (np.inf if cause.beyond else cause.level) <= high
        return ", ".join(words), holds

    return test


FOUR_MM = _levels(4.0, (0.0, 25.0), (40.0, 75.0))
FOURTEEN_MM = _levels(14.0, (40.0, 60.0), (100.0, np.inf))
"""Of the levels that the printed marker errors mean."""


def printed_markers(d: Disturbances) -> Outcome:
    """Whether both printed marker errors mean the levels that the paper says."""
    (four, four_holds), (more, more_holds) = (test(d, ReactionFrame.LAB) for test in (FOUR_MM, FOURTEEN_MM))
    return f"4 mm: {four}; 14 mm: {more}", four_holds and more_holds


def printed_torques(d: Disturbances, frame: ReactionFrame) -> Outcome:
    """Whether the three printed JP torque errors come out together."""
    figures = [figure for figure in PUBLISHED if figure.varied is Varied.JP]
    errors = mean_rms(d.table, Varied.JP, frame)
    ours = [errors[TORQUES.index(figure.torque)] for figure in figures]
    words = ", ".join(f"{TORQUE_WORDS[figure.torque]} {e:.2f}" for figure, e in zip(figures, ours, strict=True))
    near = [abs(e / figure.value - 1.0) < WITHIN for figure, e in zip(figures, ours, strict=True)]
    return f"{words} %BW*H", all(near)


@dataclass(frozen=True)
class _Entry:
    claim: str
    published: str
    test: _Test
    framed: bool = True
    """Whether it depends on where ground reactions stay."""


_EXPECTED = (
    _Entry("joint parameters disturb every torque more than inertial parameters", "stated", _dominate),
    _Entry("joint and inertial parameters do not interact: JP+IP is as JP and IP apart", "stated", _no_interaction),
    _Entry("inertial parameters leave the markers alone", "stated", _ip_markers, framed=False),
    _Entry("inertial parameters +-50 %: hip flexion is worst", "0.31 %BW*H", _ip_wide, framed=False),
    _Entry("inertial parameters +-10 %: every torque error is small", "less than 0.25 %BW*H", _ip_small, framed=False),
    _Entry("marker noise: errors grow with the amplitude", "stated", _noise_monotone),
    _Entry("marker noise: small in torques, moderate in markers", "stated", _noise_small),
    _Entry("marker noise: RMS torque errors exceed mean ones", "stated", _rms_over_mean),
    _Entry("marker noise: RMS and mean marker distance are alike", "stated", _marker_rms_mean, framed=False),
    _Entry("mean and CV of every torque settle within 2 % over the last tenth", "5000 draws", _converged, framed=False),
)
_AT_RISK = (
    *(
        _Entry(f"JP: {TORQUE_WORDS[figure.torque]} error", f"{figure.value} %BW*H", _near(figure))
        for figure in PUBLISHED
        if figure.varied is Varied.JP
    ),
    _Entry(
        "JP: hip flexion, hip adduction and knee flexion errors together", "4.14, 1.06 and 0.92 %BW*H", printed_torques
    ),
    _Entry("JP: hip flexion is largest, hip adduction second", "4.14 and 1.06 %BW*H", _largest),
    _Entry("JP: errors grow from distal to proximal", "stated", _proximal),
    _Entry(
        "JP: ankle inversion slightly above plantarflexion", "stated", _slightly_above("subtalar_angle", "ankle_angle")
    ),
    _Entry("JP: knee abduction slightly above flexion", "stated", _slightly_above("knee_adduction", "knee_angle")),
    _Entry("JP: hip adduction has a large RMS and a small mean error", "stated", _adduction_mean),
    _Entry(
        "4 mm of marker error mean a low level of JP and half of the noise",
        "JP less than 25 %, noise 50 %",
        FOUR_MM,
        framed=False,
    ),
    _Entry(
        "14 mm of marker error mean half of JP and more than all of the noise",
        "JP 50 %, noise more than 100 %",
        FOURTEEN_MM,
        framed=False,
    ),
)


def disturbance_claims(disturbances: Disturbances | None) -> list[Claim]:
    """All claims on disturbed models; without a Monte Carlo study they are there as not run."""
    out: list[Claim] = []
    for group, entries in (("", _EXPECTED), ("at risk: ", _AT_RISK)):
        for entry in entries:
            for frame in FRAMES if entry.framed else (None,):
                words = f"{group}{entry.claim}" + ("" if frame is None else f" ({FRAMES[frame]})")
                if disturbances is None:
                    out.append(Claim(words, entry.published, "", Verdict.NOT_RUN))
                    continue
                ours, holds = entry.test(disturbances, frame or ReactionFrame.LAB)
                claim = tested(words, entry.published, ours, holds)
                if entry.test is _converged and not holds and disturbances.draws < PUBLISHED_DRAWS:
                    claim = replace(claim, verdict=Verdict.NOT_RUN)  # fewer draws than the claim is about
                out.append(claim)
    return out
