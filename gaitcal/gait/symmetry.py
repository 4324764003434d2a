"""Means of what strides measure, leg by leg over strides and trials, and how alike both legs are.

    symmetry index = 100 (R - L) / ((R + L) / 2)   (%)

of the means R and L of both legs (Robinson, Herzog & Nigg, J Manipulative Physiol Ther 1987): 0 where they are alike,
positive where the right one is larger. Mean and standard deviations are those of `gait/ensemble.py`: each stride counts
the same, also one of which the recording shows a part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.gait.ensemble import spread
from gaitcal.gait.spatiotemporal import MEASURES, Stride


@dataclass(frozen=True, kw_only=True)
class Average:
    """One measure of one leg over strides and trials, in its unit."""

    n: int
    """Strides."""
    trials: int
    mean: float
    sd: float | None
    """Over all strides; None of one alone."""
    sd_within: float | None
    """Between strides of one trial; None where no trial has two."""
    sd_between: float | None
    """Between trials; None where it cannot be told from `sd_within`."""


@dataclass(frozen=True)
class MeasureMeans:
    """One measure of both legs."""

    name: str
    """Of `MEASURES`."""
    unit: str
    right: Average | None
    """None where no stride of that leg shows it."""
    left: Average | None

    @property
    def symmetry(self) -> float | None:
        """%, of the means; None where a leg has none, or both are 0."""
        if self.right is None or self.left is None or self.right.mean + self.left.mean == 0.0:
            return None
        return 200.0 * (self.right.mean - self.left.mean) / (self.right.mean + self.left.mean)


def measure_means(strides: Mapping[str, Sequence[Stride]]) -> tuple[MeasureMeans, ...]:
    """Of every measure that some stride shows, in the order of `MEASURES`; `strides`: trial -> its strides."""
    out = []
    for name, unit in MEASURES.items():
        right, left = (_average(strides, side, name) for side in ("r", "l"))
        if right is not None or left is not None:
            out.append(MeasureMeans(name, unit, right, left))
    return tuple(out)


def _average(strides: Mapping[str, Sequence[Stride]], side: str, name: str) -> Average | None:
    known = [
        (trial, s.measures[name]) for trial, of in strides.items() for s in of if s.side == side if name in s.measures
    ]
    if not known:
        return None
    found = spread(np.array([[value] for _, value in known]), np.array([trial for trial, _ in known]))

    def figure(value: np.ndarray) -> float | None:
        return float(value[0]) if np.isfinite(value[0]) else None

    return Average(
        n=len(known),
        trials=int(found.trials[0]),
        mean=float(found.mean[0]),
        sd=figure(found.sd),
        sd_within=figure(found.sd_within),
        sd_between=figure(found.sd_between),
    )
