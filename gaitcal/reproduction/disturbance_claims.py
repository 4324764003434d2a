"""The claims of the published study that rest on its Monte Carlo analysis: expected ones, and those at risk.

At risk are those that depend on how ground reactions follow a disturbed model, which the paper does not say: both
readings are tested, fixed in the laboratory and carried along with the foot, and what comes out is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gaitcal.montecarlo.conclusions import (
    INTERACTION_LIMIT,
    IP_LIMIT,
    TORQUE_WORDS,
    top_errors,
)
from gaitcal.montecarlo.leg_torques import TORQUES
from gaitcal.montecarlo.settings import PUBLISHED_DRAWS, ReactionFrame, Varied
from gaitcal.montecarlo.statistics import expect, levels_of, unconverged
from gaitcal.reproduction.published import SIDE
from gaitcal.reproduction.rows import Claim, Verdict, verdict

Array = NDArray[np.float64]

FRAMES = {ReactionFrame.LAB: "ground reactions fixed in the laboratory", ReactionFrame.FOOT: "carried with the foot"}
WITHIN = 0.25
"""Relative difference from a published torque error that still counts as the same."""
SMALL_TORQUE = 1.0
"""%BW*H that a small torque error from marker noise stays below."""
WIDE_PERCENT = 50.0
"""%: inertial bounds of the extra analysis."""


@dataclass(frozen=True)
class Disturbances:
    """Statistics of the Monte Carlo studies (see `monte_carlo.statistics`)."""

    table: pd.DataFrame
    """The four sets at the published bounds."""
    wide: pd.DataFrame
    """Inertial parameters alone, +-50 %."""
    draws: int


_Finding = tuple[str, bool]
_Test = Callable[[Disturbances, ReactionFrame], _Finding]


def _error(d: Disturbances, varied: Varied, torque: str, frame: ReactionFrame, measure: str = "rms") -> float:
    return float(levels_of(d.table, varied.value, f"{torque}_{SIDE}", frame.value, measure)["average"].iloc[-1])


def _markers(table: pd.DataFrame, varied: Varied, measure: str = "rms") -> list[float]:
    return [float(v) for v in levels_of(table, varied.value, f"markers_{SIDE}", measure=measure)["average"]]


def _tops(d: Disturbances, varied: Varied, frame: ReactionFrame) -> Array:
    found = top_errors(d.table, varied, frame, SIDE)
    if found is None:
        raise ValueError(f"the study lacks the set {varied.value}")
    return found


def _dominate(d: Disturbances, frame: ReactionFrame) -> _Finding:
    ratio = _tops(d, Varied.JP, frame) / _tops(d, Varied.IP, frame)
    return f"JP / IP between {ratio.min():.1f} and {ratio.max():.0f}", bool(ratio.min() > 1.0)


def _no_interaction(d: Disturbances, frame: ReactionFrame) -> _Finding:
    both, apart = _tops(d, Varied.BOTH, frame), np.hypot(_tops(d, Varied.JP, frame), _tops(d, Varied.IP, frame))
    ratio = both / apart
    return (
        f"JP+IP / root of the sum of squares between {ratio.min():.2f} and {ratio.max():.2f}",
        bool(np.abs(ratio - 1.0).max() < INTERACTION_LIMIT),
    )


def _ip_markers(d: Disturbances, frame: ReactionFrame) -> _Finding:
    moved = max(_markers(d.table, Varied.IP))
    return f"{moved:.2g} mm", moved < 1e-6


def _ip_wide(d: Disturbances, frame: ReactionFrame) -> _Finding:
    found = top_errors(d.wide, Varied.IP, frame, SIDE)
    if found is None:
        raise ValueError("the study lacks the inertial set")
    worst = int(found.argmax())
    named = TORQUES[worst] == "hip_flexion"
    return f"{TORQUE_WORDS[TORQUES[worst]]} {found[worst]:.2f} %BW*H", named and 0.15 < found[worst] < 0.6


def _ip_small(d: Disturbances, frame: ReactionFrame) -> _Finding:
    worst = float(_tops(d, Varied.IP, frame).max())
    return f"{worst:.3f} %BW*H at most", worst < IP_LIMIT


def _noise_monotone(d: Disturbances, frame: ReactionFrame) -> _Finding:
    columns = [
        levels_of(d.table, Varied.NOISE.value, f"{t}_{SIDE}", frame.value)["average"].to_numpy() for t in TORQUES
    ]
    rising = sum(bool((np.diff(c) > 0).all()) for c in columns)
    markers = bool((np.diff(_markers(d.table, Varied.NOISE)) > 0).all())
    holds = markers and rising == len(TORQUES)
    return f"{rising} of {len(TORQUES)} torques grow with every level", holds


def _noise_small(d: Disturbances, frame: ReactionFrame) -> _Finding:
    torque, marker = float(_tops(d, Varied.NOISE, frame).max()), _markers(d.table, Varied.NOISE)[-1]
    return f"{torque:.2f} %BW*H at most, markers {marker:.1f} mm", torque < SMALL_TORQUE


def _rms_over_mean(d: Disturbances, frame: ReactionFrame) -> _Finding:
    pairs = [(_error(d, Varied.NOISE, t, frame), _error(d, Varied.NOISE, t, frame, "abs_mean")) for t in TORQUES]
    return f"RMS / |mean| at least {min(a / b for a, b in pairs):.1f}", all(a > b for a, b in pairs)


def _marker_rms_mean(d: Disturbances, frame: ReactionFrame) -> _Finding:
    whole, mean = _markers(d.table, Varied.NOISE)[-1], _markers(d.table, Varied.NOISE, "mean")[-1]
    return f"{whole:.2f} and {mean:.2f} mm", mean > 0.8 * whole


def _converged(d: Disturbances, frame: ReactionFrame) -> _Finding:
    late = len(unconverged(d.table))
    return f"{late} distributions not settled after {d.draws} draws", late == 0


def _near(torque: str, published: float) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> _Finding:
        errors = _tops(d, Varied.JP, frame)
        order = [TORQUES[k] for k in np.argsort(-errors)]
        ours = errors[TORQUES.index(torque)]
        words = f"{ours:.2f} %BW*H, number {order.index(torque) + 1} of {len(order)}"
        return words, bool(abs(ours / published - 1.0) < WITHIN)

    return test


def _largest(d: Disturbances, frame: ReactionFrame) -> _Finding:
    errors = _tops(d, Varied.JP, frame)
    order = [TORQUES[k] for k in np.argsort(-errors)]
    return f"largest: {', '.join(TORQUE_WORDS[t] for t in order[:3])}", order[:2] == ["hip_flexion", "hip_adduction"]


def _proximal(d: Disturbances, frame: ReactionFrame) -> _Finding:
    hip, knee, ankle = (
        max(_error(d, Varied.JP, t, frame) for t in group) for group in (TORQUES[:3], TORQUES[3:5], TORQUES[5:])
    )
    return f"hip {hip:.2f}, knee {knee:.2f}, ankle {ankle:.2f} %BW*H at most", hip > knee > ankle


def _slightly(first: str, second: str) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> _Finding:
        a, b = _error(d, Varied.JP, first, frame), _error(d, Varied.JP, second, frame)
        return f"{a:.2f} and {b:.2f} %BW*H", b < a < 1.5 * b

    return test


def _adduction_mean(d: Disturbances, frame: ReactionFrame) -> _Finding:
    errors, torque = _tops(d, Varied.JP, frame), "hip_adduction"
    large = errors[TORQUES.index(torque)] >= np.sort(errors)[-2]
    whole, mean = _error(d, Varied.JP, torque, frame), abs(_error(d, Varied.JP, torque, frame, "mean"))
    return f"RMS {whole:.2f}, mean {mean:.2f} %BW*H", bool(large) and mean < 0.25 * whole


def _levels(rms_mm: float, joint: tuple[float, float], noise: tuple[float, float]) -> _Test:
    def test(d: Disturbances, frame: ReactionFrame) -> _Finding:
        causes = {cause.varied: cause for cause in expect(d.table, rms_mm, SIDE)}
        words, holds = [], True
        for varied, (low, high) in ((Varied.JP, joint), (Varied.NOISE, noise)):
            cause = causes[varied]
            level = np.inf if cause.beyond else cause.level
            words.append(f"{varied.title} {'more than 100' if cause.beyond else f'{level:.0f}'} %")
            holds = holds and low <= level <= high
        return ", ".join(words), holds

    return test


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
    _Entry("JP: hip flexion error", "4.14 %BW*H", _near("hip_flexion", 4.14)),
    _Entry("JP: hip adduction error", "1.06 %BW*H", _near("hip_adduction", 1.06)),
    _Entry("JP: knee flexion error", "0.92 %BW*H", _near("knee_angle", 0.92)),
    _Entry("JP: hip flexion is largest, hip adduction second", "4.14 and 1.06 %BW*H", _largest),
    _Entry("JP: errors grow from distal to proximal", "stated", _proximal),
    _Entry("JP: ankle inversion slightly above plantarflexion", "stated", _slightly("subtalar_angle", "ankle_angle")),
    _Entry("JP: knee abduction slightly above flexion", "stated", _slightly("knee_adduction", "knee_angle")),
    _Entry("JP: hip adduction has a large RMS and a small mean error", "stated", _adduction_mean),
    _Entry(
        "4 mm of marker error mean a low level of JP and half of the noise",
        "JP less than 25 %, noise 50 %",
        _levels(4.0, (0.0, 25.0), (40.0, 75.0)),
        framed=False,
    ),
    _Entry(
        "14 mm of marker error mean half of JP and more than all of the noise",
        "JP 50 %, noise more than 100 %",
        _levels(14.0, (40.0, 60.0), (100.0, np.inf)),
        framed=False,
    ),
)


def disturbance_claims(found: Disturbances | None) -> list[Claim]:
    """All claims on disturbed models; without a Monte Carlo study they are there as not run."""
    out: list[Claim] = []
    for group, entries in (("", _EXPECTED), ("at risk: ", _AT_RISK)):
        for entry in entries:
            frames: list[ReactionFrame | None] = list(FRAMES) if entry.framed else [None]
            for frame in frames:
                words = f"{group}{entry.claim}" + ("" if frame is None else f" ({FRAMES[frame]})")
                if found is None:
                    out.append(Claim(words, entry.published, "", Verdict.NOT_RUN))
                    continue
                ours, holds = entry.test(found, frame or ReactionFrame.LAB)
                early = entry.test is _converged and not holds and found.draws < PUBLISHED_DRAWS
                out.append(Claim(words, entry.published, ours, Verdict.NOT_RUN if early else verdict(holds)))
    return out
