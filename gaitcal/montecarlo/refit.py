"""A motion fitted anew to its markers after a disturbance.

The iteration is that of tracking (`motion/descent.py`), made for many small problems of one kind: it starts on a
Gauss-Newton factor, which does not depend on the markers and may be known already, keeps it however long the steps are,
and where they no longer shrink tenfold goes on with Newton's. The end is told by the size of the step, so that every
draw is solved as far as every other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import ChainConstants
from gaitcal.montecarlo.settings import RefitSettings
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.descent import DescentSettings, Ending
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem


@dataclass(frozen=True)
class Refit:
    """The end of a re-fit."""

    nodes: Array
    """(nn, nq) m, rad."""
    evaluations: int
    """Steps taken, each with an evaluation of the gradient."""
    failure: str
    """Why it did not converge; empty where it did."""


def refit(
    problem: TrialProblem,
    constants: ChainConstants,
    start: Array,
    settings: RefitSettings,
    known: BandFactor | None = None,
) -> Refit:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq).

    Parameters
    ----------
    problem : the markers to fit; no joint parameter is free.
    constants : of the disturbed linkage.
    known : the factor of the Gauss-Newton matrix at `start`, if there is one: it does not depend on the markers.
    """
    rule = DescentSettings(
        gain=0.0,
        shortest_step=settings.tolerance,
        most_steps=settings.most_evaluations,
        keep_within=np.inf,
        curved=True,
    )
    factor = known or BandFactor(problem.equations(start, constants).band)
    tracked = track_nodes(problem, constants, start, rule, factor)
    if tracked.ending is Ending.MOST_STEPS:
        return Refit(tracked.nodes, tracked.steps, f"{tracked.steps} evaluations did not settle it")
    return Refit(tracked.nodes, tracked.steps, "" if tracked.converged else tracked.ending.value)
