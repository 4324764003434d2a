"""The table of steps and phases: what strides measure, in the words of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gaitcal.gait.spatiotemporal import Average, counting, measure_means
from gaitcal.session.result import TrialResult

SHOWN = {
    "speed": ("Walking speed", 2),
    "cadence": ("Cadence", 1),
    "stride_length": ("Stride length", 3),
    "stride_time": ("Stride time", 3),
    "step_length": ("Step length", 3),
    "step_width": ("Step width", 3),
    "step_time": ("Step time", 3),
    "stance_percent": ("Stance", 1),
    "swing_percent": ("Swing", 1),
    "double_support_percent": ("Double support", 1),
    "single_support_percent": ("Single support", 1),
}
"""Measure -> its words and decimals; `spatiotemporal.csv` has all of them."""


@dataclass(frozen=True, kw_only=True)
class StepRow:
    """One measure of both legs."""

    title: str
    unit: str
    digits: int
    right: Average | None
    left: Average | None
    symmetry: float | None
    """%."""


def step_rows(trials: Sequence[TrialResult]) -> tuple[StepRow, ...]:
    """Of all walks together, without strides that turn and legs that are refused; empty where none shows anything."""
    means = {
        found.name: found for found in measure_means({t.name: counting(t.strides, t.refused_legs) for t in trials})
    }
    return tuple(
        StepRow(
            title=title,
            unit="% of stride" if (found := means[name]).unit == "%" else found.unit,
            digits=digits,
            right=found.right,
            left=found.left,
            symmetry=found.symmetry,
        )
        for name, (title, digits) in SHOWN.items()
        if name in means
    )
