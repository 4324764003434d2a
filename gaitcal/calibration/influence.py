"""How each marker coordinate pulls on the solution: influence functions, and standard errors from them.

At the solution the estimate theta = (p, N) depends on the residuals of marker coordinate c (one axis of one marker in
one trial) through its score u_c = sum_f J_cf r_cf, and moves by  d theta_c = -H^-1 u_c  with it. Skin movement repeats
itself from frame to frame, so frames are not independent; marker coordinates are taken to be. The covariance is then
the cluster-robust sandwich (Liang and Zeger 1986)

    cov = sum_c d theta_c d theta_c^T,

with residuals first inflated for what the motion itself has absorbed: r / (1 - h), h the leverage of the coordinate in
its frame's own least-squares problem (Mancini and DeRouen 2001; skin noise is slow against the splines, so that the
motion of a frame can follow it). Parameters k that are not free are not exact either, nor are the centres c of priors
L (p - c): with errors d p_k, d c of their own, from an earlier phase or of the nominal model,

    d p = -H^-1 (sum_c u_c + S_pk d p_k - L^T L d c),        H = S_pp + L^T L.

Any quantity that depends on theta, a torque at a frame, gets its standard error from
the same d theta_c by its derivative.

How much of what the markers say is independent: the noise that priors and earlier trials are weighed against.

Skin movement repeats itself from frame to frame: a thousand frames hold far fewer than a thousand independent samples,
and S^-1, the inverse of the reduced Gauss-Newton matrix, times the variance of the residuals is far too small a
covariance. The noise nu is what makes nu^2 S^-1 as large as the covariance C that the marker coordinates themselves
show (cluster-robust, `influence.py`), every parameter in units of the deviation its prior allows: those that the
markers see least, on which alone a prior acts, count most. Of the G independent scores of the marker coordinates the n
fitted parameters take up n:

    nu^2 = G / (G - n) * (sum_k C_kk / sigma_k^2) / (sum_k (S^-1)_kk / sigma_k^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_calibration import JointFit
from gaitcal.calibration.joint_prior import prior_root
from gaitcal.calibration.reduced_problem import NULL
from gaitcal.model.chain import ChainConstants
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.parameters import Parameters
from gaitcal.motion.arrow import eliminate
from gaitcal.motion.spline import basis_matrix
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass
from gaitcal.study.joint_prior import JointPrior

LEVERAGE_CAP = 0.9
"""Leverages are cut here: a marker that alone holds a coordinate has no residual to learn from."""


@dataclass(frozen=True, kw_only=True)
class TrialScores:
    """Scores of one trial's marker coordinates, the motion eliminated."""

    reduced: Array
    """(np_t, nc) score of each marker coordinate on the free joint parameters of this trial's chain."""
    nodes: Array
    """(nn * nq, nc) H_qq^-1 g_c: what the nodes alone would do, negative."""
    sensitivity: Array
    """(nn * nq, np_t) H_qq^-1 H_qp; those of soft tissue, if the trial has any, come last."""
    hessian: Array
    """(np_t, np_t) S = H_pp - H_pq H_qq^-1 H_qp."""
    clusters: tuple[str, ...]
    """(nc,) which marker coordinate each column is: `trial/label/axis`."""


@dataclass(frozen=True)
class Influence:
    """Influence of every independent source of error on the joint parameters: marker coordinates of trials, and how
    far the nominal model may be wrong.
    """

    free: tuple[str, ...]
    parameters: Array
    """(np, nc) d p_c, m and rad."""
    clusters: tuple[str, ...]
    """(nc,) names of the sources: `trial/label/axis`, `nominal/parameter`."""

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


def nominal_influence(names: Sequence[str] = JP_NAMES, prior: JointPrior | None = None) -> Influence:
    """How far nominal joint parameters may be wrong, a column a cause (`joint_prior.py`; anatomy's unless given)."""
    return Influence(tuple(names), prior_root(names, prior), tuple(f"nominal/{name}" for name in names))


def influence_of(problems: Sequence[TrialProblem], fit: JointFit, known: Influence | None = None) -> Influence:
    """Influence functions at the solution of a joint calibration.

    Parameters
    ----------
    known : errors of the joint parameters before this fit: of its priors' centres, and of what it kept fixed; exact
        unless given. Its rows that the fit leaves alone are those of the result, too.
    """
    known = known or Influence((), np.zeros((0, 0)), ())
    names = tuple(dict.fromkeys((*fit.free, *known.free)))
    place = {name: k for k, name in enumerate(names)}
    pulls: list[Array] = []
    own: list[str] = []
    hessian = np.zeros((len(names), len(names)))
    for problem, nodes in zip(problems, fit.nodes, strict=True):
        opened = problem.with_free(names)
        scores = trial_scores(opened, fit.parameters, nodes)
        rows = [place[name] for name in opened.chain.free]
        pull = np.zeros((len(names), len(scores.clusters)))
        pull[rows] = scores.reduced
        hessian[np.ix_(rows, rows)] += scores.hessian
        pulls.append(pull)
        own += scores.clusters
    # One column a source of error: those of earlier phases first, then this fit's marker coordinates. Sources that
    # both know (a trial that takes part in two phases) share a column, so that their errors add before they square.
    clusters = tuple(dict.fromkeys((*known.clusters, *own)))
    column = {name: k for k, name in enumerate(clusters)}
    error = np.zeros((len(names), len(clusters)))
    error[np.ix_([place[n] for n in known.free], [column[c] for c in known.clusters])] = known.parameters
    count, prior = len(fit.free), fit.prior.T @ fit.prior
    # H d p = -(sum_c u_c + S_pk d p_k - L^T L d c), row by row of the free parameters; other rows stay as known
    right = hessian[:count, count:] @ error[count:] - prior @ error[:count]
    right[:, [column[c] for c in own]] += np.hstack(pulls)[:count]
    error[:count] = -_inverse(hessian[:count, :count] + prior) @ right
    return Influence(names, error, clusters)


@dataclass(frozen=True)
class MarkerEvidence:
    """What the markers of a fit say of its free parameters by themselves, priors left out."""

    covariance: Array
    """(np, np)."""
    unseen: Array
    """(np, n) directions of parameters that the markers cannot see at all."""
    coordinates: int
    """Marker coordinates that say something."""


def marker_evidence(problems: Sequence[TrialProblem], fit: JointFit) -> MarkerEvidence:
    """What the markers say at the solution of a joint calibration."""
    alone = influence_of(problems, replace(fit, prior=np.zeros((0, len(fit.free)))))
    values, vectors = np.linalg.eigh(fit.state.hessian)
    null = vectors[:, values <= NULL * max(float(values[-1]), 1e-300)]
    return MarkerEvidence(alone.covariance, null, int(alone.parameters.any(axis=0).sum()))


def _inverse(hessian: Array) -> Array:
    values, vectors = np.linalg.eigh(hessian)
    kept = values > NULL * max(float(values[-1]), 0.0)
    out: Array = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return out


def trial_scores(problem: TrialProblem, parameters: Parameters, nodes: Array) -> TrialScores:
    """Scores of one trial's marker coordinates at its motion, for the free joint parameters of its chain."""
    constants = problem.constants(parameters)
    eliminated = eliminate(problem.equations(nodes, constants))
    by_node, by_parameter = _cluster_gradients(problem, constants, nodes)
    count = len(problem.chain.free)
    clusters = [f"{problem.name}/{label}/{axis}" for label in problem.labels for axis in "xyz"]
    if problem.penalty is not None:
        by_node = np.column_stack([by_node, problem.penalty.gradient(nodes).ravel()])
        by_parameter = np.column_stack([by_parameter, np.zeros(len(by_parameter))])
        clusters.append(f"bandwidth/{problem.name}")
    for prior in problem.priors:
        if prior.centred:
            of_centre = prior.scores(problem.basis, problem.chain.coordinates)
            by_node = np.column_stack([by_node, of_centre])
            by_parameter = np.column_stack([by_parameter, np.zeros((len(by_parameter), of_centre.shape[1]))])
            clusters += [f"posture/{problem.name}/{k}" for k in range(of_centre.shape[1])]
    return TrialScores(
        reduced=by_parameter - eliminated.sensitivity[:, :count].T @ by_node,
        nodes=eliminated.factor.solve(by_node),
        sensitivity=eliminated.sensitivity,
        hessian=eliminated.hessian[:count, :count],
        clusters=tuple(clusters),
    )


def _cluster_gradients(problem: TrialProblem, constants: ChainConstants, nodes: Array) -> tuple[Array, Array]:
    """(nn * nq, nc) and (np, nc) half gradients of each marker coordinate's own cost, residuals inflated."""
    chain, data, basis = problem.chain, problem.data, problem.basis
    nq = len(chain.coordinates)
    q = basis.evaluate(nodes)
    poses = forward(chain, constants, q, data.secondary)
    spatial = jacobian(chain, constants, poses, data.secondary)
    x = problem.positions(nodes, constants)
    residual = x - data.measured
    inverse = _frame_inverses(problem, constants, q)
    matrix = basis_matrix(basis)
    count = 3 * len(data.segment)
    by_node = np.zeros((basis.nodes, nq, count))
    by_parameter = np.zeros((len(chain.free), count))
    for m, segment in enumerate(data.segment):
        # coordinates come before the free joint parameters in the chain's variables
        moved = np.flatnonzero(chain.support[:, segment])
        own = moved[moved < nq]
        velocity = _point_velocity(spatial[moved], x[m])
        among = velocity[: len(own)]
        # h = w J (J^T W J)^-1 J^T of this marker's three axes in its own frame: what the motion absorbs of it
        by_frame = among.transpose(2, 1, 0)
        met = by_frame @ inverse[np.ix_(np.arange(len(q)), own, own)]
        leverage = (met * by_frame).sum(axis=2).T
        leverage = np.clip(data.weight[m] * leverage, 0.0, LEVERAGE_CAP)
        pull = velocity * (data.weight[m] * residual[m] / (1.0 - leverage))
        for i in range(3):
            by_node[:, own, 3 * m + i] = (pull[: len(own), i] @ matrix).T
            by_parameter[moved[len(own) :] - nq, 3 * m + i] = pull[len(own) :, i].sum(axis=1)
    return by_node.reshape(-1, count), by_parameter


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


LEAST_NOISE = 1e-6
"""m, below anything that is measured: markers without noise leave nothing to weigh."""


def independent_noise(hessian: Array, evidence: MarkerEvidence, kept: Array, deviation: Array) -> float:
    """Marker noise (m) of a fit, as if every unit of S were an independent sample.

    Parameters
    ----------
    hessian : (np, np) m^2 per units of p, S of all parameters of the fit.
    evidence : what its markers say by themselves.
    kept : (n,) indices of the parameters that they determine; at least one.
    deviation : (n,) m, rad: standard deviations of the priors.
    """
    own = np.ix_(kept, kept)
    scores = (hessian @ evidence.covariance @ hessian)[own]
    inverse = np.linalg.inv(hessian[own])
    seen = np.diag(inverse @ scores @ inverse) / deviation**2
    plain = np.diag(inverse) / deviation**2
    degrees = evidence.coordinates / max(evidence.coordinates - len(kept), 1)
    return max(float(np.sqrt(degrees * seen.sum() / plain.sum())), LEAST_NOISE)
