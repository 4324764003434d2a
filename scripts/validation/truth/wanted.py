"""What is wanted of the figures: each limit with what was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np

from scripts.validation.error_bars import Bars, rms
from scripts.validation.truth.outcome import Outcome
from scripts.validation.truth.skin import SKIN, Kind

COVERAGE = (90.0, 98.0)
"""% of the 95 % intervals that should hold the truth."""
AT_LEAST = (90.0, 100.0)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One figure's error at most so large, or its 95 % intervals within these shares."""

    part: str
    cases: tuple[Kind | str, ...]
    """Each of these by itself."""
    figures: tuple[str, ...]
    """Patterns; each figure by itself."""
    error: float | None = None
    """Largest RMS over fits, in the figure's unit."""
    median: float | None = None
    """Largest median over fits."""
    shares: tuple[float, float] | None = None
    """% of intervals of 95 % that should hold."""


HIPS = ("hip in pelvis, mm", "hip in thigh, mm")
LIMITS = (
    Limit(part="gait", cases=(Kind.NONE,), figures=("hip in laboratory, mm",), median=3.0),
    Limit(part="gait", cases=(Kind.NONE,), figures=("torques of legs, N·m",), median=2.7),  # half of version 0.2's
    Limit(part="gait", cases=(Kind.NONE,), figures=("torque *",), shares=AT_LEAST),
    Limit(part="gait", cases=(*SKIN, Kind.MIXTURE), figures=("hip in laboratory, mm",), median=8.0),
    Limit(part="isolated", cases=(Kind.NONE,), figures=HIPS, error=0.1),
    Limit(part="isolated", cases=(Kind.NONE,), figures=("talocrural axis, deg", "subtalar axis, deg"), error=0.5),
    Limit(part="isolated", cases=(Kind.SINUSOIDS,), figures=HIPS, error=3.5),
    Limit(part="isolated", cases=(*SKIN, Kind.MIXTURE), figures=HIPS, error=7.0),
    Limit(part="isolated", cases=(*SKIN, Kind.SINUSOIDS, Kind.MIXTURE), figures=HIPS, shares=COVERAGE),
    Limit(part="synthetic", cases=("waves",), figures=("torques of legs, N·m",), median=2.2),
    Limit(part="synthetic", cases=("waves",), figures=("torque *",), shares=COVERAGE),
)


@dataclass(frozen=True)
class Check:
    """A limit beside what was found."""

    words: str
    found: float
    wanted: str
    met: bool


def checks(outcomes: list[Outcome], limits: tuple[Limit, ...] = LIMITS) -> Iterator[Check]:
    """Every limit that these fits speak to."""
    for limit in limits:
        for case in limit.cases:
            name = case.value if isinstance(case, Kind) else case
            here = [o for o in outcomes if (o.part, o.case) == (limit.part, name)]
            known = dict.fromkeys(figure for o in here for figure in o.figures)
            for figure in (f for f in known if any(fnmatch(f, pattern) for pattern in limit.figures)):
                yield _check(limit, name, figure, here)


def _check(limit: Limit, case: str, figure: str, outcomes: list[Outcome]) -> Check:
    figures = [o.figures[figure] for o in outcomes if figure in o.figures]
    words = f"{limit.part}, {case}: {figure}"
    if limit.shares is not None:
        low, high = limit.shares
        found = sum((f.bars for f in figures), Bars()).shares[1]
        return Check(f"{words}, in 95 %", found, f"{low:g} to {high:g} %", low <= found <= high)
    errors = [abs(f.error) for f in figures]
    if limit.median is not None:
        found = float(np.median(errors))
        return Check(f"{words}, median", found, f"<= {limit.median:g}", found <= limit.median)
    most = limit.error or 0.0
    return Check(f"{words}, RMS", rms(errors), f"<= {most:g}", rms(errors) <= most)


def lines(outcomes: list[Outcome]) -> Iterator[str]:
    """One line a limit."""
    found = list(checks(outcomes))
    if found:
        yield f"\nwanted: {sum(c.met for c in found)} of {len(found)} met"
        for check in found:
            yield f"{check.words:62}{check.found:9.4g}   {check.wanted:14}{'yes' if check.met else 'no'}"
