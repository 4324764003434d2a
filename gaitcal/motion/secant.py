"""A slow step that goes further: what two steps in a row tell of the curvature that their matrix leaves out.

With s the step at x, g the gradient there and d the changes since the step before, x + s - t d(x + s) takes back the
part of the last step that did not do what it promised; t makes s - t d(s) shortest in the metric of M, where M d(s) is
-d(g): t = d(s) . g / d(s) . d(g) (Anderson 1965, with one step remembered).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array


@dataclass(frozen=True)
class Step:
    """A step that a matrix formed where it begins gives."""

    x: Array
    """Where it begins."""
    step: Array
    gradient: Array
    """Half of it, at x."""


def further(now: Step, before: Step | None) -> Array | None:
    """Where a step and the one before it lead together; None where they tell nothing."""
    if before is None:
        return None
    change = now.step - before.step
    curvature = float(np.vdot(change, now.gradient - before.gradient))
    if curvature >= 0.0:
        return None
    t = float(np.vdot(change, now.gradient)) / curvature
    out: Array = now.x + now.step - t * (now.x - before.x + change)
    return out
