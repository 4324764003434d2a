"""From a start far away: motions and joint parameters stepped together.

Variable projection solves each motion fully for the joint parameters of the moment; where those are absurd (all zero,
as in the published protocol) that motion folds up and leads into a valley of its own. Levenberg-Marquardt steps in
nodes and joint parameters together do not: damped, they move both a little, and converge from absolute zero. Each step
solves the arrow of `motion/arrow.py` over all trials at once.
"""

from __future__ import annotations

from collections.abc import Sequence

from gaitcal.arrays import Array
from gaitcal.model.parameters import Parameters
from gaitcal.motion.arrow import SharedTrials
from gaitcal.motion.descent import DescentSettings, Ending, descend
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass

DAMPED = DescentSettings(first_damping=1e-3, keep_within=0.0, most_steps=60)
"""Every step on its own matrix: far away none serves twice."""


@dataclass(frozen=True, kw_only=True)
class FarStart:
    """Where the steps ended."""

    p: Array
    """(np,) m, rad."""
    nodes: tuple[Array, ...]
    cost: float
    """m^2."""
    steps: int
    ending: Ending

    @property
    def converged(self) -> bool:
        """Whether it reached its tolerance."""
        return self.ending.converged


def step_together(
    problems: Sequence[TrialProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    p: Array,
    settings: DescentSettings = DAMPED,
) -> FarStart:
    """Bring motions and joint parameters `free` down together, from nodes `starts` (each (nn, nq)) and `p` (np,)."""
    shared = SharedTrials(problems, parameters, free)
    end = descend(shared, shared.joined(p, starts), settings)
    values, nodes = shared.parted(end.x)
    return FarStart(p=values, nodes=tuple(nodes), cost=end.cost, steps=end.steps, ending=end.ending)
