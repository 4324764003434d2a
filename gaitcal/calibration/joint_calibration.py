"""Joint parameters, soft tissue and motions from markers: SciPy's `least_squares` on the compressed problem.

Without a prior and without soft tissue this is phase 1 of Reinbolt et al. 2007, eq. 1 (`reduced_problem.py`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from gaitcal.arrays import Array
from gaitcal.calibration.reduced_problem import ReducedProblem, ReducedState
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.trial_problem import MotionProblem

POSITION_SCALE = 0.1
"""m: one unit of a position inside the solver is 1 dm, of an orientation 1 rad, as both move a marker about as far."""


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Bounds and tolerances of a joint-parameter calibration."""

    position_bound: float = np.inf  # m, largest distance of a position from its nominal value
    orientation_bound: float = np.inf  # rad, the same for orientations
    tolerance: float = 1e-11
    """Relative tolerance on cost and parameters: with 1e-10 a hardly determined subtalar axis ends 6e-5 rad off."""
    most_evaluations: int = 100
    tracking: DescentSettings = field(default_factory=DescentSettings)

    def bound(self, name: str) -> float:
        """m, rad, of one joint parameter."""
        position = JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION
        return self.position_bound if position else self.orientation_bound


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Joint parameters found, and everything needed to say how well."""

    free: tuple[str, ...]
    keys: tuple[str, ...]  # Columns of the soft tissue, `kind/regressor/segment/component`, kind by kind
    values: Array  # (np + nz,) m, rad of `free`; then those of the soft tissue, m, rad
    parameters: Parameters
    state: ReducedState
    iterations: int
    seconds: float
    converged: bool
    message: str
    at_bound: tuple[str, ...]  # Free parameters that ended on a bound

    @property
    def coefficients(self) -> tuple[Array, ...]:
        """Per trial (nn, nq)."""
        return tuple(trial.coefficients for trial in self.state.trials)

    @property
    def tissue(self) -> Array:
        """(nz,) m, rad."""
        return self.values[len(self.free) :]


class JointSearch:
    """The fit of joint parameters to some trials, which may be run again with trials that count more or less."""

    def __init__(
        self,
        problems: Sequence[MotionProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: JointSettings | None = None,
        *,
        nominal: Parameters | None = None,
        tissue: TissuePrior = NO_TISSUE,
        expected: tuple[Array, Array] | None = None,
        kinds: Sequence[str] | None = None,
    ) -> None:
        """Set up the search.

        `problems`: the trials; each has its own motion, all share the joint parameters.
        `parameters`: where the search starts, and the values of all that is not free.
        `free`: of these, the joint parameters that some trial passes are fitted.
        `starts`: per trial, coefficients (nn, nq) to start from.
        `nominal`: where bounds are centred; `parameters` unless given.
        `tissue`: prior of the soft tissue that the problems have.
        `expected`: (np,) m, rad and (np, np) mean and precision of the joint parameters `free` before any trial;
        nothing is expected of them unless given.
        `kinds`: kind of task of each trial, of which the soft tissue is its own; one for all unless given.
        """
        self.settings = settings or JointSettings()
        self.free = passed(problems, free)
        index = [JP_INDEX[name] for name in self.free]
        self.present = parameters.joint[index]
        self.middle = (nominal or parameters).joint[index]
        self.reach = np.array([self.settings.bound(name) for name in self.free])
        position = np.array([JOINT_PARAMETERS[i].kind is Kind.POSITION for i in index], dtype=bool)
        self.scale = np.where(position, POSITION_SCALE, 1.0)
        centre, rows = self.present, np.zeros((0, len(index)))
        if expected is not None:
            centre, rows = expected[0], np.asarray(np.linalg.cholesky(expected[1]).T, float)
        self.problem = ReducedProblem(
            problems,
            parameters,
            self.free,
            starts,
            self.settings.tracking,
            prior=rows,
            centre=centre,
            tissue=tissue,
            kinds=kinds,
        )

    def run(self, start_values: Array | None = None) -> JointFit:
        """Fit to the end, from where the last search ended unless told otherwise."""
        began = time.perf_counter()
        self.problem.may_curve = True
        result = self._least_squares(self.settings.tolerance, start_values)
        state = self.problem.settle(result.x)
        bounded = np.isfinite(self.reach)
        edge = bounded & (np.abs(result.x - self.middle) > 0.999 * np.where(bounded, self.reach, 1.0))
        return JointFit(
            free=self.free,
            keys=tuple(key for kind in state.kinds for key in kind.prior.keys),
            values=np.concatenate([result.x, *(kind.z for kind in state.kinds)]),
            parameters=self.problem.linkage(result.x),
            state=state,
            iterations=int(result.nfev),
            seconds=time.perf_counter() - began,
            converged=bool(result.status > 0) and all(trial.converged for trial in state.trials),
            message=ending(result),
            at_bound=tuple(name for name, on_edge in zip(self.free, edge, strict=True) if on_edge),
        )

    def approach(self, tolerance: float) -> ReducedState:
        """Where such a search ends that stops at a larger tolerance; motions are those on the way."""
        return self.problem.at(self._least_squares(tolerance).x)

    def _least_squares(self, tolerance: float, start: Array | None = None) -> OptimizeResult:
        """From the best point so far, unless told otherwise."""
        if start is None:
            start = self.present if self.problem.best is None else self.problem.best.p
        if not len(start):
            return OptimizeResult(x=start, status=1, nfev=0, message="")
        lower, upper = self.middle - self.reach, self.middle + self.reach
        bounded = np.isfinite(self.reach)
        inside = np.clip(start, lower + 1e-9 * (upper - lower) if bounded.all() else lower, upper)
        return least_squares(
            self.problem.residual,
            inside,
            jac=self.problem.jacobian,
            bounds=(lower, upper) if bounded.any() else (-np.inf, np.inf),
            x_scale=self.scale,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-15,
            max_nfev=self.settings.most_evaluations,
        )


def passed(problems: Sequence[MotionProblem], names: Sequence[str]) -> tuple[str, ...]:
    """The joint parameters of `names` that the linkage of some trial passes."""
    found = {name for problem in problems for name in problem.with_free(tuple(names)).chain.free}
    return tuple(name for name in names if name in found)


_STATUS = {
    0: "stopped at the largest number of evaluations",
    1: "the cost is stationary",
    2: "the cost falls no further",
    3: "the parameters move no further",
    4: "neither cost nor parameters change any more",
}


def ending(result: OptimizeResult) -> str:
    """SciPy's status in words; its own message where the number is new."""
    return _STATUS.get(int(result.status), str(result.message))
