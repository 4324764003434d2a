"""Which healthy people somebody is held against, by age and non-dimensional speed, and what they walk like.

Gait changes with speed more than with age, and speed means the same for a small and a tall body once length and time
are told in leg length L and sqrt(L / g) (Hof, Gait Posture 4:222-223, 1996):

    speed v / sqrt(g L)        cadence f sqrt(L / g), f in steps/s        step length s / L

L is from the anterior superior iliac spine to the medial malleolus, as clinics measure it; where nobody did, 0.52 of
body height, as in the 81 children below (SD 0.028).

Curves: typically developing children of 4 to 17 years at five speeds (Schwartz, Rozumalski and Trost, J Biomech
41:1639-1650, 2008), in files that gaitcal brings (`models/norms/`). Their limits between speeds are the paper's; the 81
children of the same laboratory whose own figures are published (Pinzone et al., Gait Posture 40:286-290, 2014, centre
one) walk freely at 0.431 (SD 0.069), so that `free` is mean -+ SD, and `slow` and `fast` the next two SD. From the
same 81 come the spatiotemporal norms.

There are no curves of adults that gaitcal could bring, and whose age is not told may be a small adult: neither is held
against children. Own norms (`--normal FILE`) are taken as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from gaitcal.gait.normal_bands import Bands, read_normal_bands
from gaitcal.model.subject_model import GRAVITY, Subject

LEG_OF_HEIGHT: Final = 0.52
AGES: Final = (4.0, 18.0)
"""Years, from and below which the children's norms hold."""


class _Speed(NamedTuple):
    name: str
    """Of `SHIPPED`."""
    words: str
    high: float
    """Non-dimensional speed below which it holds."""


SPEEDS: Final = (
    _Speed("schwartz2008-very-slow", "very slow", 0.227),
    _Speed("schwartz2008-slow", "slow", 0.363),
    _Speed("schwartz2008-free", "free", 0.500),
    _Speed("schwartz2008-fast", "fast", 0.636),
    _Speed("schwartz2008-very-fast", "very fast", 0.705),
)
SLOWEST: Final = 0.158
"""Non-dimensional speed below which none holds. This and the highest are one SD of `FREE` beyond the paper's limits:
outside few of those children walked."""
FREE: Final = {"speed": (0.431, 0.069), "cadence": (0.561, 0.050), "step_length": (0.765, 0.080)}
"""Measure -> mean and SD, non-dimensional, of 81 children at the speed of their choice."""
MODEL: Final = "Theirs is Plug-in Gait's model: offsets of hip rotation and adduction are partly that."
"""In a child's straight walk the vendor's hip rotation is 15 and 5 deg from ours, adduction 2 and 3.5."""
FREE_WORDS: Final = "children 4 to 17 years, free speed, n = 81 (Pinzone 2014), by leg length"


@dataclass(frozen=True, kw_only=True)
class Norm:
    """Healthy people to hold somebody against; empty where none fit."""

    bands: Bands = field(default_factory=dict)
    steps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Measure of `spatiotemporal.MEASURES` -> mean and SD, in its unit, for a leg of this length, at free speed."""
    words: str = ""
    """Who they are: for legends."""
    remark: str = ""
    """Why these, or why none: a sentence."""


def leg_length(subject: Subject) -> tuple[float, str]:
    """m, and how it is known."""
    measured = list(subject.leg_length.values())
    if measured:
        return float(np.mean(measured)), f"{np.mean(measured):.2f} m"
    length = LEG_OF_HEIGHT * subject.height
    return length, f"{length:.2f} m by height, as nobody measured it"


def norm_for(subject: Subject, speed: float | None) -> Norm:
    """The norm that gaitcal brings for somebody who walks at `speed` (m/s; None: not known)."""
    low, high = AGES
    theirs = f"those that gaitcal brings are of children from {low:.0f} to below {high:.0f} years"
    if subject.age is None:
        return Norm(remark=f"No norm: no age is told (age_years), and {theirs}.")
    if not low <= subject.age < high:
        age = _years(subject.age)
        return Norm(remark=f"No norm fits an age of {age} years: {theirs}. Your laboratory's own: --normal FILE.")
    length, how = leg_length(subject)
    steps = free_steps(length)
    if speed is None:
        return Norm(steps=steps, remark="No norm of curves: no stride tells the speed, which chooses it.")
    relative = speed / np.sqrt(GRAVITY * length)
    told = f"Walks at {speed:.2f} m/s, {relative:.2f} times √(g · leg length), {how}"
    chosen = next((of for of in SPEEDS if SLOWEST <= relative < of.high), None)
    if chosen is None:
        limits = f"{SLOWEST:g} to {SPEEDS[-1].high:g}"
        return Norm(steps=steps, remark=f"{told}: no norm of curves fits, those that gaitcal brings are of {limits}.")
    bands = read_normal_bands(chosen.name)
    return Norm(bands=bands, steps=steps, words=sources(bands), remark=f"{told}: {chosen.words} speed. {MODEL}")


def own_norm(bands: Bands, name: str, subject: Subject) -> Norm:
    """The norm that somebody names (`--normal`), with a word where those of children are taken for an adult."""
    low, high = AGES
    remark = ""
    if name.lower().startswith("schwartz2008") and not (subject.age is not None and low <= subject.age < high):
        age = "no age is told" if subject.age is None else f"this person is {_years(subject.age)} years old"
        remark = f"Bands of children of {low:.0f} to {high - 1:.0f} years, as asked for: {age}."
    return Norm(bands=bands, words=sources(bands), remark=remark)


def _years(age: float) -> str:
    """As people tell it: whom a day is missing to 4 years is 3.9."""
    return f"{np.floor(10.0 * age) / 10.0:g}"


def sources(bands: Bands) -> str:
    """Whom the bands are of, each source once."""
    return "; ".join(dict.fromkeys(band.source for band in bands.values() if band.source))


def free_steps(length: float) -> dict[str, tuple[float, float]]:
    """`speed` m/s, `cadence` steps/min, `step_length` and `stride_length` m: mean and SD for a leg of `length` m."""
    units = {"speed": np.sqrt(GRAVITY * length), "cadence": 60.0 * np.sqrt(GRAVITY / length), "step_length": length}
    out = {name: (float(unit * FREE[name][0]), float(unit * FREE[name][1])) for name, unit in units.items()}
    return out | {"stride_length": (2.0 * out["step_length"][0], 2.0 * out["step_length"][1])}
