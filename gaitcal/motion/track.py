"""Marker tracking: the nodes that bring the model's markers nearest to the measured ones, over a whole trial.

A trial with fixed joint parameters as a problem for `descend`: x are the nodes, the matrix is the band of
`banded.py`. From rigid fits undamped Gauss-Newton steps nearly always do; markers that stay far from where the model
has them ask for Newton's.

The penalty at work on one coordinate alone, whose samples y (nf,) all weigh 1.

    y -> A y = B (G + rho R)^-1 B^T y,       G = B^T B,       rho = rate (2 pi f)^-6,

keeps  tr A = sum_j 1 / (1 + (nu_j / f)^6)  degrees of freedom: the gains at the Demmler-Reinsch frequencies nu_j,

    R u_j = mu_j G u_j,       nu_j = (rate mu_j)^(1/6) / 2 pi        (Demmler and Reinsch 1975).

Splines are told by their nodes, series by B^T y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gaitcal.arrays import Array
from gaitcal.model.chain import ChainConstants
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.descent import DescentSettings, Ending, Evaluation, descend
from gaitcal.motion.spline import ORDER, Roughness, SplineBasis, roughness, stiffness
from gaitcal.motion.trial_problem import TrialProblem

LARGE_BYTES = 2**27
"""Size of a normal matrix above which only one is held at a time: a trial of some 20 000 frames."""
NOTHING_LEFT_M = 1e-14
"""m, RMS residual below which there is nothing left to fit."""


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """The end of a tracking run."""

    nodes: Array
    """(nn, nq) m, rad."""
    cost: float
    """m^2; where the last step was taken on its promise alone, that of the nodes before it."""
    steps: int
    ending: Ending
    curved: bool
    """Whether it ended with Newton's steps."""

    @property
    def converged(self) -> bool:
        """Whether it reached its tolerance."""
        return self.ending.converged


def track_nodes(
    problem: TrialProblem,
    constants: ChainConstants,
    start: Array,
    settings: DescentSettings | None = None,
    known: BandFactor | None = None,
) -> Tracked:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq).

    `known`: the factor of a matrix that serves at `start`, if there is one: it does not depend on the markers.
    """
    end = descend(_Tracking(problem, constants), start.ravel(), settings or DescentSettings(), known)
    nodes = end.x.reshape(start.shape)
    return Tracked(nodes=nodes, cost=end.cost, steps=end.steps, ending=end.ending, curved=end.curved)


class _Tracking:
    """The marker cost of a trial by its nodes, one after the other; all joint parameters are fixed."""

    def __init__(self, problem: TrialProblem, constants: ChainConstants) -> None:
        self.problem, self.constants = problem, constants
        self.nothing_left = NOTHING_LEFT_M**2 * float(problem.data.weight.sum())
        self.has_curvature = not problem.chain.free

    def nodes(self, x: Array) -> Array:
        return x.reshape(self.problem.basis.nodes, -1)

    def evaluate(self, x: Array) -> Evaluation:
        cost, gradient = self.problem.gradient(self.nodes(x), self.constants)
        return Evaluation(cost, gradient.ravel())

    def linearise(self, x: Array, *, curved: bool) -> _TrackingMatrix:
        return _TrackingMatrix(self, x, curved)


class _TrackingMatrix:
    """The normal equations at some nodes. A large matrix is factorised in its own place."""

    def __init__(self, tracking: _Tracking, x: Array, curved: bool) -> None:
        self._form = partial(tracking.problem.equations, tracking.nodes(x), tracking.constants, curved=curved)
        equations = self._form()
        self.evaluation = Evaluation(equations.cost, equations.node_gradient.ravel())
        self._band: Array | None = equations.band
        self.spent = equations.band.nbytes > LARGE_BYTES

    def factor(self, damping: float) -> BandFactor:
        band = self._form().band if self._band is None else self._band
        if not self.spent:
            return BandFactor(band, damping)
        self._band = None
        try:
            return BandFactor(band, damping, overwrite=True)
        except np.linalg.LinAlgError:
            return BandFactor(self._form().band, damping)  # with a copy: a larger floor may do


FLOOR = 1e-14
"""Of the largest diagonal entry: two nodes between the same frames."""


class Smoother:
    """A of one basis and one cut-off."""

    def __init__(self, basis: SplineBasis, cutoff_hz: float, known: tuple[Array, Roughness] | None = None) -> None:
        """`known`: G and R of the basis, where they were worked out before."""
        self.basis = basis
        self.gram, self.rough = known or (gram(basis), roughness(basis.knots))
        self.stiffness = stiffness(basis, cutoff_hz)
        band = self.gram + self.stiffness * self.rough.band.T
        band[0] += FLOOR * band[0].max()
        self._factor = cholesky_banded(band, lower=True)

    def with_cutoff(self, cutoff_hz: float) -> Smoother:
        """The same with another cut-off."""
        return Smoother(self.basis, cutoff_hz, (self.gram, self.rough))

    def nodes(self, right: Array) -> Array:
        """(nn, k) nodes of A y, from B^T y (nn, k)."""
        out: Array = cho_solve_banded((self._factor, True), right)
        return out

    def lost(self, nodes: Array) -> Array:
        """(nn, k) nodes of y - A y, for splines y with nodes (nn, k)."""
        return self.nodes(self.stiffness * self.rough.times(nodes))

    def kept(self) -> float:
        """Tr A."""
        nn = self.basis.nodes
        whole = np.diag(self.gram[0])
        for d in range(1, min(ORDER, nn)):
            whole += np.diag(self.gram[d, : nn - d], d) + np.diag(self.gram[d, : nn - d], -d)
        return float(np.trace(self.nodes(whole)))


def gram(basis: SplineBasis) -> Array:
    """(6, nn) lower band of G."""
    values, _, _ = basis.matrices
    whole = (values.T @ values).tocsr()
    out = np.zeros((ORDER, basis.nodes))
    for d in range(min(ORDER, basis.nodes)):
        out[d, : basis.nodes - d] = whole.diagonal(-d)
    return out


def onto(basis: SplineBasis, series: Array) -> Array:
    """(nn, k) B^T y of series y (nf, k)."""
    out: Array = basis.matrices[0].T @ series
    return out
