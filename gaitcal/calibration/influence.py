"""Errors by source: what every independent source of error makes of the joint parameters, and of a trial's motion.

Joint parameters p with Hessian H, motions eliminated, are fitted to trials of score u_t = S_t^1/2 n_t and to a prior
Lambda about c. What is kept fixed, k, is not exact either, nor is c: with errors d p_k, d c of their own, from an
earlier phase or of the nominal model,

    d p = -H^-1 (sum_t u_t + S_pk d p_k - Lambda d c),        H = sum_t S_pp + Lambda,       n_t, independent, N(0, 1).

A motion is tracked with known joints. Its nodes depend on the residuals of marker coordinate c (one axis of one marker)
through its score g_c = sum_f J_cf r_cf, and move by  n_c = -H_qq^-1 g_c  with it. Skin movement repeats itself from
frame to frame, so frames are not independent; marker coordinates are taken to be: the cluster-robust sandwich (Liang
and Zeger 1986), with residuals first inflated for what the motion itself has absorbed: r / (1 - h), h the leverage of
the coordinate in its frame's own least-squares problem (Mancini and DeRouen 2001; skin noise is slow against the
splines, so that the motion of a frame can follow it).

Any quantity that depends on both, a torque at a frame, gets its standard error from the same columns by its derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.calibration.joint_prior import prior_root
from gaitcal.model.chain import ChainConstants
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.parameters import Parameters
from gaitcal.motion.arrow import eliminate
from gaitcal.motion.spline import basis_matrix
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

LEVERAGE_CAP = 0.9
"""Leverages are cut here: a marker that alone holds a coordinate has no residual to learn from."""


@dataclass(frozen=True, kw_only=True)
class TrialScores:
    """What one trial's marker coordinates make of its motion, the joint parameters being known."""

    nodes: Array
    """(nn * nq, nc) H_qq^-1 g_c: what they make of the nodes, negative."""
    sensitivity: Array
    """(nn * nq, np_t) H_qq^-1 H_qp; those of soft tissue, if the trial has any, come last."""
    clusters: tuple[str, ...]
    """(nc,) which marker coordinate each column is: `trial/label/axis`."""


@dataclass(frozen=True)
class Influence:
    """What every independent source of error makes of the joint parameters: the markers of trials, soft tissue, and how
    far the nominal model may be wrong.
    """

    free: tuple[str, ...]
    parameters: Array
    """(np, nc) d p_c, m and rad."""
    clusters: tuple[str, ...]
    """(nc,) names of the sources: `markers/trial/number`, `skin/column`, `nominal/parameter`."""

    @property
    def covariance(self) -> Array:
        """(np, np) of the joint parameters; zero along directions that the trials cannot see."""
        out: Array = self.parameters @ self.parameters.T
        return out

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error (m, rad) of each free joint parameter."""
        errors = np.sqrt((self.parameters**2).sum(axis=1))
        return {name: float(e) for name, e in zip(self.free, errors, strict=True)}

    def of(self, names: Sequence[str]) -> Influence:
        """Those of some of its parameters."""
        return Influence(tuple(names), self.parameters[[self.free.index(n) for n in names]], self.clusters)

    def updated(self, other: Influence) -> Influence:
        """With other errors in the place of those of their parameters, and no source that moves nothing any more."""
        kept = self.of([name for name in self.free if name not in other.free])
        moving = np.flatnonzero(kept.parameters.any(axis=0)).tolist()
        errors = block_diag(kept.parameters[:, moving], other.parameters)
        clusters = [self.clusters[c] for c in moving]
        return Influence((*kept.free, *other.free), errors, (*clusters, *other.clusters))


def nominal_influence(names: Sequence[str] = JP_NAMES, prior: JointPrior | None = None) -> Influence:
    """How far nominal joint parameters may be wrong, a column a cause (`joint_prior.py`; anatomy's unless given)."""
    return Influence(tuple(names), prior_root(names, prior), tuple(f"nominal/{name}" for name in names))


def errors_by_source(
    free: tuple[str, ...], scores: Influence, inverse: Array, precision: Array, held: Array, known: Influence
) -> Influence:
    """Errors of parameters that were fitted, and of those known before that the fit leaves alone.

    Parameters
    ----------
    free : what was fitted.
    scores : (np, nc) u_t of every source of the fit's own.
    inverse : (np, np) H^-1.
    precision : (np, np) Lambda.
    held : (np, nk) S_pk, in the order of those of `known.free` that were not fitted.
    known : errors before the fit, of the priors' centres and of what it kept fixed.
    """
    others = known.of([name for name in known.free if name not in free])
    centre = np.zeros((len(free), len(known.clusters)))
    given = [name in known.free for name in free]
    centre[given] = known.of([name for name in free if name in known.free]).parameters
    kept = others.parameters
    of_known = inverse @ (precision @ centre - held @ kept)
    own = np.vstack([inverse @ scores.parameters, np.zeros((len(kept), scores.parameters.shape[1]))])
    return Influence(
        (*free, *others.free), np.hstack([own, np.vstack([of_known, kept])]), (*scores.clusters, *known.clusters)
    )


def trial_scores(problem: TrialProblem, parameters: Parameters, nodes: Array) -> TrialScores:
    """Scores of one trial's marker coordinates at its motion, with the free joint parameters of its chain."""
    constants = problem.constants(parameters)
    eliminated = eliminate(problem.equations(nodes, constants))
    by_node = _cluster_gradients(problem, constants, nodes)
    clusters = [f"{problem.name}/{label}/{axis}" for label in problem.labels for axis in "xyz"]
    if problem.penalty is not None:
        by_node = np.column_stack([by_node, problem.penalty.gradient(nodes).ravel()])
        clusters.append(f"bandwidth/{problem.name}")
    for prior in problem.priors:
        if prior.centred:
            of_centre = prior.scores(problem.basis, problem.chain.coordinates)
            by_node = np.column_stack([by_node, of_centre])
            clusters += [f"posture/{problem.name}/{k}" for k in range(of_centre.shape[1])]
    return TrialScores(
        nodes=eliminated.factor.solve(by_node), sensitivity=eliminated.sensitivity, clusters=tuple(clusters)
    )


def _cluster_gradients(problem: TrialProblem, constants: ChainConstants, nodes: Array) -> Array:
    """(nn * nq, nc) half gradients of each marker coordinate's own cost by the nodes, residuals inflated."""
    chain, data, basis = problem.chain, problem.data, problem.basis
    nq = len(chain.coordinates)
    q = basis.evaluate(nodes)
    poses = forward(chain, constants, q, data.secondary)
    spatial = jacobian(chain, constants, poses, data.secondary)
    x = problem.positions(nodes, constants)
    residual = x - data.measured
    inverse = _frame_inverses(problem, constants, q)
    matrix = basis_matrix(basis)
    by_node = np.zeros((basis.nodes, nq, 3 * len(data.segment)))
    for m, segment in enumerate(data.segment):
        own = np.flatnonzero(chain.support[:nq, segment])
        velocity = _point_velocity(spatial[own], x[m])
        # h = w J (J^T W J)^-1 J^T of this marker's three axes in its own frame: what the motion absorbs of it
        by_frame = velocity.transpose(2, 1, 0)
        met = by_frame @ inverse[np.ix_(np.arange(len(q)), own, own)]
        leverage = (met * by_frame).sum(axis=2).T
        leverage = np.clip(data.weight[m] * leverage, 0.0, LEVERAGE_CAP)
        pull = velocity * (data.weight[m] * residual[m] / (1.0 - leverage))
        for i in range(3):
            by_node[:, own, 3 * m + i] = (pull[:, i] @ matrix).T
    out: Array = by_node.reshape(basis.nodes * nq, -1)
    return out


def _point_velocity(spatial: Array, x: Array) -> Array:
    """(nk, 3, nf) velocity v + w x x of the point x (3, nf) for spatial velocities (nk, 6, nf)."""
    v, w = spatial[:, :3], spatial[:, 3:]
    out = v.copy()
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] += w[:, j] * x[k] - w[:, k] * x[j]
    return out


def _frame_inverses(problem: TrialProblem, constants: ChainConstants, q: Array) -> Array:
    """(nf, nq, nq) pseudo-inverses of the frames' own Gauss-Newton matrices."""
    hessian = problem.frame_hessians(q, constants)
    # m^2 and rad^2 on one diagonal: scaled to ones, so that the cut of the pseudo-inverse means the same for all
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("fii->fi", hessian), 1e-12))
    scaled = hessian * scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.pinv(scaled, rcond=1e-8, hermitian=True)
    out: Array = inverse * scale[:, :, None] * scale[:, None, :]
    return out
