"""Fit joint parameters, soft tissue and motions to markers: `least_squares` on a small problem.

Without a prior and without soft tissue this is phase 1 of Reinbolt et al. 2007, eq. 1
(`reduced_problem.py`).
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
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.trial_problem import MotionProblem

POSITION_SCALE = 0.1
"""m: one unit of a position inside the solver is 1 dm, of an orientation 1 rad, as both move a
marker about as far.
"""


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Bounds and tolerances of a joint-parameter calibration."""

    # m, largest distance of a position from its nominal value
    position_bound: float = np.inf
    orientation_bound: float = np.inf  # rad, the same for orientations
    tolerance: float = 1e-11
    """Relative tolerance on cost and parameters: with 1e-10 a hardly determined subtalar axis ends
    6e-5 rad off.
    """
    most_evaluations: int = 100
    tracking: DescentSettings = field(default_factory=DescentSettings)

    def get_bound(self, name: str) -> float:
        """Get the largest distance (m, rad) of a joint parameter from its nominal value."""
        position = JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION
        return self.position_bound if position else self.orientation_bound


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Result of a fit of joint parameters, with its state for error estimates."""

    free: tuple[str, ...]
    # Columns of the soft tissue, `kind/regressor/segment/component`, kind by kind
    keys: tuple[str, ...]
    # (np + nz,) m, rad of `free`; then those of the soft tissue, m, rad
    values: Array
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
    """Search for joint parameters, which may be repeated with other weights of the trials."""

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

        Parameters
        ----------
        problems : sequence of MotionProblem
            The trials; each has its motion, all share the joint parameters.
        parameters : Parameters
            Start of the search, and the values of all that is not free.
        free : tuple of str
            Joint parameters to fit; those that no trial passes are left out.
        starts : sequence of (nn, nq) array
            Start coefficients of each trial.
        settings : JointSettings, optional
            Bounds and tolerances.
        nominal : Parameters, optional
            Centre of the bounds; `parameters` if not given.
        tissue : TissuePrior
            Prior of the soft tissue of the problems.
        expected : tuple of array, optional
            (np,) mean (m, rad) and (np, np) precision of the joint parameters `free` before any
            trial; no prior if not given.
        kinds : sequence of str, optional
            Kind of task of each trial, which has its separate soft tissue; one for all if not
            given.
        """
        self.settings = settings or JointSettings()
        self.free = select_passed_parameters(problems, free)
        index = [JP_INDEX[name] for name in self.free]
        self.present = parameters.joint[index]
        self.middle = (nominal or parameters).joint[index]
        self.reach = np.array([self.settings.get_bound(name) for name in self.free])
        position = np.array(
            [JOINT_PARAMETERS[i].kind is ParameterKind.POSITION for i in index], dtype=bool
        )
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
        """Fit to the final tolerance.

        Parameters
        ----------
        start_values : (np,) array, optional
            Start (m, rad); the best point so far if not given.

        Returns
        -------
        JointFit
            Parameters, soft tissue and motions.
        """
        began = time.perf_counter()
        self.problem.may_curve = True
        result = self._run_least_squares(self.settings.tolerance, start_values)
        state = self.problem.settle(result.x)
        bounded = np.isfinite(self.reach)
        edge = bounded & (
            np.abs(result.x - self.middle) > 0.999 * np.where(bounded, self.reach, 1.0)
        )
        return JointFit(
            free=self.free,
            keys=tuple(key for kind in state.kinds for key in kind.prior.keys),
            values=np.concatenate([result.x, *(kind.z for kind in state.kinds)]),
            parameters=self.problem.get_parameters(result.x),
            state=state,
            iterations=int(result.nfev),
            seconds=time.perf_counter() - began,
            converged=bool(result.status > 0) and all(trial.converged for trial in state.trials),
            message=describe_ending(result),
            at_bound=tuple(name for name, on_edge in zip(self.free, edge, strict=True) if on_edge),
        )

    def run_to_tolerance(self, tolerance: float) -> ReducedState:
        """Search to a larger tolerance; motions are those of the last step."""
        return self.problem.at(self._run_least_squares(tolerance).x)

    def _run_least_squares(self, tolerance: float, start: Array | None = None) -> OptimizeResult:
        """Run SciPy's search from `start`, or from the best point so far."""
        if start is None:
            start = self.present if self.problem.best is None else self.problem.best.p
        if not len(start):
            return OptimizeResult(x=start, status=1, nfev=0, message="")
        lower, upper = self.middle - self.reach, self.middle + self.reach
        bounded = np.isfinite(self.reach)
        inside = np.clip(start, lower + 1e-9 * (upper - lower) if bounded.all() else lower, upper)
        return least_squares(
            self.problem.compute_residual,
            inside,
            jac=self.problem.compute_jacobian,
            bounds=(lower, upper) if bounded.any() else (-np.inf, np.inf),
            x_scale=self.scale,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-15,
            max_nfev=self.settings.most_evaluations,
        )


def select_passed_parameters(
    problems: Sequence[MotionProblem], names: Sequence[str]
) -> tuple[str, ...]:
    """Select the joint parameters that the linkage of some trial passes."""
    found = {name for problem in problems for name in problem.with_free(tuple(names)).chain.free}
    return tuple(name for name in names if name in found)


_STATUS = {
    0: "stopped at the largest number of evaluations",
    1: "the cost is stationary",
    2: "the cost falls no further",
    3: "the parameters move no further",
    4: "neither cost nor parameters change any more",
}


def describe_ending(result: OptimizeResult) -> str:
    """Describe SciPy's status; its message if the number is new."""
    return _STATUS.get(int(result.status), str(result.message))
