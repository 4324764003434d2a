"""Phase 1: joint parameters and motions from markers (Reinbolt et al. 2007, eq. 1).

Why an iteration of SciPy's `least_squares` ended, in words that name no variable of its code.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import OptimizeResult, least_squares

from gaitcal.arrays import Array
from gaitcal.calibration.reduced_problem import NULL, ReducedProblem, ReducedState
from gaitcal.calibration.soft_tissue_artefact import TissuePrior
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.model.parameters import Parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

POSITION_SCALE = 0.1
"""m: one unit of a position inside the solver is 1 dm, of an orientation 1 rad, as both move a marker about as far."""
TISSUE_SCALE = 10.0
"""Standard deviations of a column of soft tissue that are one unit inside the solver: one moves markers by a few mm."""


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Bounds, priors and tolerances of a joint-parameter calibration."""

    position_bound: float = np.inf
    """m, largest distance of a position from its nominal value."""
    orientation_bound: float = np.inf
    """rad, the same for orientations."""
    prior_position: float = np.inf
    """m, standard deviation of a position about its nominal value; infinite: no prior."""
    prior_orientation: float = np.inf
    """rad."""
    marker_noise: float = 0.010
    """m: a prior one standard deviation off costs as much as this marker residual, squared and summed."""
    cumulative: bool = False
    """In a sequence of phases, what earlier trials know stays in the cost of later ones; and every phase finds out
    `marker_noise` by itself, this value being where it starts."""
    prior: JointPrior | None = None
    """In place of anatomy's, where the evidence of all trials decides (`joint_evidence.py`)."""
    tolerance: float = 1e-11
    """Relative tolerance on cost and parameters: with 1e-10 a hardly determined subtalar axis ends 6e-5 rad off."""
    most_evaluations: int = 100
    tracking: DescentSettings = field(default_factory=DescentSettings)

    def prior_deviation(self, names: Sequence[str]) -> Array:
        """(n,) m, rad: standard deviations of the priors of joint parameters."""
        position = [JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION for name in names]
        out: Array = np.where(position, self.prior_position, self.prior_orientation)
        return out


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Joint parameters found, and everything needed to say how well."""

    free: tuple[str, ...]
    values: Array
    """(np,) m, rad; then those of the soft tissue, m."""
    parameters: Parameters
    nodes: tuple[Array, ...]
    """Per trial (nn, nq)."""
    state: ReducedState
    prior: Array
    """(n, np) m per unit of p: rows of the prior, and of what earlier trials know."""
    marker_noise: float
    """m, what priors were weighed against."""
    iterations: int
    seconds: float
    converged: bool
    message: str
    at_bound: tuple[str, ...]
    """Free parameters that ended on a bound."""


def calibrate_joints(
    problems: Sequence[TrialProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    settings: JointSettings | None = None,
    *,
    start_values: Array | None = None,
    nominal: Parameters | None = None,
    information: Array | None = None,
) -> JointFit:
    """Fit the joint parameters `free` to the markers of all `problems` together.

    Parameters
    ----------
    problems : the trials; each has its own motion, all share the joint parameters.
    parameters : values of all that is not free, and where priors are centred.
    starts : per trial, nodes (nn, nq) to start from.
    start_values : (np,) where the free parameters start, m and rad; their present values unless given.
    nominal : where bounds are centred; `parameters` unless given.
    information : (98, 98) m^2 per units of p: the reduced Gauss-Newton matrix of earlier trials about `parameters`, so
        that these trials add to what those know; none unless given.
    """
    return JointSearch(problems, parameters, free, starts, settings, nominal=nominal, information=information).run(
        start_values
    )


class JointSearch:
    """The fit of joint parameters to some trials, which may be run again with trials that count more or less."""

    def __init__(
        self,
        problems: Sequence[TrialProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: JointSettings | None = None,
        *,
        nominal: Parameters | None = None,
        information: Array | None = None,
        tissue: TissuePrior | None = None,
        expected: tuple[Array, Array] | None = None,
    ) -> None:
        """As `calibrate_joints`.

        `tissue`: prior of the soft tissue that the problems have; `expected`: (np,) m, rad and (np, np) mean and
        precision of the joint parameters `free` before any trial, instead of the settings' priors.
        """
        self.parameters, self.settings = parameters, settings or JointSettings()
        passed = {name for problem in problems for name in problem.with_free(free).chain.free}
        self.free = tuple(name for name in free if name in passed)
        index = [JP_INDEX[name] for name in self.free]
        position = np.array([JOINT_PARAMETERS[i].kind is Kind.POSITION for i in index])
        self.middle, self.present = (nominal or parameters).joint[index], parameters.joint[index]
        self.reach = np.where(position, self.settings.position_bound, self.settings.orientation_bound)
        self.scale = np.where(position, POSITION_SCALE, 1.0)
        if expected is None:
            rows = _prior_rows(
                self.settings.marker_noise / self.settings.prior_deviation(self.free),
                None if information is None else information[np.ix_(index, index)],
            )
            centre = self.present
        else:
            centre, rows = expected[0], np.asarray(np.linalg.cholesky(expected[1]).T, float)
        if tissue is not None:
            of_tissue = np.linalg.inv(np.linalg.cholesky(tissue.covariance))
            rows, nz = block_diag(rows, of_tissue), len(tissue.keys)
            centre, self.present = np.append(centre, np.zeros(nz)), np.append(self.present, np.zeros(nz))
            self.middle, self.reach = np.append(self.middle, np.zeros(nz)), np.append(self.reach, np.full(nz, np.inf))
            self.scale = np.append(self.scale, TISSUE_SCALE * np.sqrt(np.diag(tissue.covariance)))
        self.problem = ReducedProblem(
            problems,
            parameters,
            self.free,
            starts,
            self.settings.tracking,
            prior=rows,
            centre=centre,
            tissue=tissue.keys if tissue is not None else (),
        )

    def weigh(self, shares: Sequence[float]) -> None:
        """Let the cost of each trial count so much from now on."""
        self.problem.weigh(shares)

    def run(self, start_values: Array | None = None) -> JointFit:
        """Fit to the end, from where the last search ended unless told otherwise."""
        began = time.perf_counter()
        result = self._least_squares(self.first(start_values), self.settings.tolerance)
        state = self.problem.settle(result.x)
        bounded = np.isfinite(self.reach)
        edge = bounded & (np.abs(result.x - self.middle) > 0.999 * np.where(bounded, self.reach, 1.0))
        return JointFit(
            free=self.free,
            values=result.x,
            parameters=self.problem.linkage(result.x),
            nodes=tuple(trial.nodes for trial in state.trials),
            state=state,
            prior=self.problem.prior,
            marker_noise=self.settings.marker_noise,
            iterations=int(result.nfev),
            seconds=time.perf_counter() - began,
            converged=bool(result.status > 0) and all(trial.converged for trial in state.trials),
            message=ending(result),
            at_bound=tuple(name for name, on_edge in zip(self.free, edge[: len(self.free)], strict=True) if on_edge),
        )

    def approach(self, tolerance: float, start_values: Array | None = None) -> ReducedState:
        """Where such a search ends that stops at a larger tolerance; motions are those on the way."""
        return self.problem.at(self._least_squares(self.first(start_values), tolerance).x)

    def first(self, start_values: Array | None = None) -> Array:
        """Where a search begins: at the best point so far, unless told otherwise."""
        best = self.problem.best
        return start_values if start_values is not None else self.present if best is None else best.p

    def _least_squares(self, start: Array, tolerance: float) -> OptimizeResult:
        lower, upper = self.middle - self.reach, self.middle + self.reach
        inside = np.clip(start, lower + 1e-9 * (upper - lower) if np.isfinite(self.reach).all() else lower, upper)
        return least_squares(
            self.problem.residual,
            inside,
            jac=self.problem.jacobian,
            bounds=(lower, upper) if np.isfinite(self.reach).any() else (-np.inf, np.inf),
            x_scale=self.scale,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-15,
            max_nfev=self.settings.most_evaluations,
        )


def _prior_rows(each: Array, information: Array | None) -> Array:
    """(n, np) rows whose squares are the prior of each parameter and what earlier trials know of all together."""
    rows = np.diag(each)[each > 0]
    if information is None:
        return rows
    values, vectors = np.linalg.eigh(information)
    kept = values > NULL * max(float(values[-1]), 1e-300)
    return np.vstack([rows, np.sqrt(values[kept])[:, None] * vectors[:, kept].T])


STATUS = {
    0: "stopped at the largest number of evaluations",
    1: "the cost is stationary",
    2: "the cost falls no further",
    3: "the parameters move no further",
    4: "neither cost nor parameters change any more",
}
"""SciPy's status numbers."""


def ending(result: OptimizeResult) -> str:
    """The status in words; SciPy's own message where the number is new."""
    return STATUS.get(int(result.status), str(result.message))
