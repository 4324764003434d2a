"""Errors by source: what every independent source of error makes of the joint parameters, and of a
trial's motion.

Joint parameters p with Hessian H, motions eliminated, are fitted to trials of score u_t = S_t^1/2
n_t and to a prior Lambda about c. What is kept fixed, k, is not exact either, nor is c: with errors
d p_k, d c of their own, from an earlier phase or of the nominal model,

    d p = -H^-1 (sum_t u_t + S_pk d p_k - Lambda d c),        H = sum_t S_pp + Lambda,       n_t, independent, N(0, 1).

A source c of the joint parameters moves the motion by  d N_c = - S d p_c,  S = -d N/d p. The trial's own markers move
it while joints are known (what they do to the joints is told by the noise of the trial): the nodes
depend on the residuals of marker coordinate c, one axis of one marker, through its score g_c =
sum_f J_cf r_cf, and move by n_c = -H_qq^-1 g_c. Skin movement repeats itself from frame to frame,
so frames are not independent; marker coordinates are taken to be: the cluster-robust sandwich
(Liang and Zeger 1986), with residuals first inflated for what the motion itself has absorbed: r /
(1 - h), h the leverage of the coordinate in its frame's own least-squares problem (Mancini and
DeRouen 2001; skin noise is slow against the splines, so that the motion of a frame can follow it).

Coordinates move by B d N_c, and whatever follows from coordinates and parameters, a torque at a
frame, by its derivatives; the squares of what the sources do sum to its variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array, IntArray, stretches
from gaitcal.calibration import joint_prior, soft_tissue_artefact
from gaitcal.calibration.tissue_elimination import Arrow
from gaitcal.dynamics.measurement_errors import ErrorSource
from gaitcal.model.chain import LinkageModel
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, ParameterKind, Parameters
from gaitcal.study.cohort_prior import JointPrior
from gaitcal.tracking.banded import eliminate
from gaitcal.tracking.spline import ORDER, SplineBasis
from gaitcal.tracking.trial_problem import MotionProblem

# Leverages are cut here: a marker that alone holds a coordinate has no residual to learn from
LEVERAGE_CAP = 0.9
# Frames at a time at most, whose changes by the marker coordinates of all trials are held at once
BLOCK = 125


@dataclass(frozen=True)
class ErrorSources:
    """What every independent source of error makes of the joint parameters: the markers of trials,
    soft tissue, and how far the nominal model may be wrong.
    """

    free: tuple[str, ...]
    parameters: Array  # (np, nc) d p_c, m and rad
    clusters: tuple[
        str, ...
    ]  # (nc,) names of the sources: `markers/trial/number`, `skin/column`, `nominal/parameter`

    @property
    def covariance(self) -> Array:
        """(np, np) of the joint parameters; zero along directions that the trials cannot see."""
        return self.parameters @ self.parameters.T

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error (m, rad) of each free joint parameter."""
        errors = np.sqrt((self.parameters**2).sum(axis=1))
        return {name: float(e) for name, e in zip(self.free, errors, strict=True)}

    def of(self, names: Sequence[str]) -> "ErrorSources":
        """Those of some of its parameters."""
        return ErrorSources(
            tuple(names), self.parameters[[self.free.index(n) for n in names]], self.clusters
        )

    def updated(self, other: "ErrorSources") -> "ErrorSources":
        """With other errors in the place of those of their parameters, and no source that moves
        nothing any more.
        """
        kept = self.of([name for name in self.free if name not in other.free])
        moving = np.flatnonzero(kept.parameters.any(axis=0)).tolist()
        errors = block_diag(kept.parameters[:, moving], other.parameters)
        clusters = [self.clusters[c] for c in moving]
        return ErrorSources((*kept.free, *other.free), errors, (*clusters, *other.clusters))


def nominal_errors(
    names: Sequence[str] = JP_NAMES, prior: JointPrior | None = None
) -> ErrorSources:
    """How far nominal joint parameters may be wrong, a column a cause (`joint_prior.py`; anatomy's
    unless given).
    """
    doubted = (
        {} if prior is None else {name: by for name, by in prior.doubted.items() if name in names}
    )
    more = np.zeros((len(names), len(doubted)))
    more[[list(names).index(name) for name in doubted], np.arange(len(doubted))] = list(
        doubted.values()
    )
    causes = tuple(f"nominal/{name}" for name in (*names, *doubted))
    return ErrorSources(
        tuple(names), np.hstack([joint_prior.prior_root(names, prior), more]), causes
    )


def left_of_prior(
    joint: str, errors: ErrorSources | None, prior: JointPrior | None = None
) -> float:
    """Standard error of a joint's parameters over that before any trial, of positions or of
    directions, whichever is larger; 0 where errors are not known.
    """
    if errors is None:
        return 0.0
    now, found = errors.standard_errors, []
    for kind in ParameterKind:
        names = [p.name for p in JOINT_PARAMETERS if p.joint == joint and p.kind is kind]
        if names:
            before = np.sqrt(np.diag(joint_prior.prior_of(names, prior)[1]))
            after = np.array(
                [now.get(name, size) for name, size in zip(names, before, strict=True)]
            )
            found.append(float(np.linalg.norm(after) / np.linalg.norm(before)))
    return max(found)


def errors_by_source(
    free: tuple[str, ...], scores: ErrorSources, arrow: Arrow, held: Array, known: ErrorSources
) -> ErrorSources:
    """Errors of parameters that were fitted, and of those known before that the fit leaves alone.

    `free`: what was fitted.
    `scores`: (np, nc) u_t of every source of the fit's own.
    `arrow`: H, and Lambda.
    `held`: (np, nk) S_pk, in the order of those of `known.free` that were not fitted.
    `known`: errors before the fit, of the priors' centres and of what it kept fixed.
    """
    others = known.of([name for name in known.free if name not in free])
    centre = np.zeros((len(free), len(known.clusters)))
    given = [name in known.free for name in free]
    centre[given] = known.of([name for name in free if name in known.free]).parameters
    kept = others.parameters
    of_known = arrow.solve(arrow.weighted(centre) - held @ kept)
    own = np.vstack(
        [arrow.solve(scores.parameters), np.zeros((len(kept), scores.parameters.shape[1]))]
    )
    return ErrorSources(
        (*free, *others.free),
        np.hstack([own, np.vstack([of_known, kept])]),
        (*scores.clusters, *known.clusters),
    )


@dataclass(frozen=True)
class NodeMoves:
    """What k independent sources of error make of one trial's nodes and of the joint parameters."""

    nodes: Array
    """(nn * nq, k) d N_c."""
    parameters: Array
    """(np, ku) d p_c, joint parameters before soft tissue, of the last ku sources; the others move
    none.
    """

    def moved(self, basis: SplineBasis, frames: slice | IntArray, derivatives: int = 1) -> Array:
        """Compute what they make of coordinates (frames, nq, k), followed by as many derivatives by
        time less one.
        """
        weights = np.stack([basis.value, basis.rate, basis.acceleration][:derivatives], axis=1)[
            frames
        ]
        first = basis.first[frames]
        by_node = self.nodes.reshape(basis.nodes, -1)
        out = np.empty((len(first), derivatives, by_node.shape[1]))
        # frames between the same nodes together
        for start, stop in pairwise(
            [0, *(np.flatnonzero(np.diff(first)) + 1).tolist(), len(first)]
        ):
            near = by_node[first[start] : first[start] + ORDER]
            np.matmul(
                weights[start:stop].reshape(-1, ORDER),
                near,
                out=out[start:stop].reshape(-1, near.shape[1]),
            )
        return out.reshape(len(first), -1, self.nodes.shape[1])

    def through(
        self, basis: SplineBasis, frames: slice | IntArray, by_state: Array, by_parameter: Array
    ) -> Array:
        """Compute what they make (frames, m, k) of m quantities.

        Parameters
        ----------
        by_state : (frames, m, 3 nq) derivatives by coordinates, rates and accelerations.
        by_parameter : (frames, m, npj) derivatives by the joint parameters.
        """
        out: Array = by_state @ self.moved(basis, frames, 3)
        last = out.shape[2] - self.parameters.shape[1]
        out[:, :, last:] += by_parameter @ self.parameters[: by_parameter.shape[2]]
        return out


@dataclass(frozen=True, kw_only=True)
class MarkerScores:
    """What one trial's marker coordinates make of its motion."""

    coefficients: (
        Array  # (nn * nq, own) n_c: what the own coordinates do, the joint parameters being known
    )
    sensitivity: Array  # (nn * nq, np) S = - d N / d p, joint parameters before soft tissue
    clusters: tuple[str, ...]
    """(own,) which source each column is: `trial/label/axis`, `bandwidth/trial`,
    `posture/trial/number`.
    """

    def and_unknowns(self) -> NodeMoves:
        """The own coordinates, and then a unit of each unknown."""
        return NodeMoves(
            np.hstack([self.coefficients, -self.sensitivity]), np.eye(self.sensitivity.shape[1])
        )


@dataclass(frozen=True, kw_only=True)
class MotionSensitivity:
    """What moves one trial's motion: its own marker coordinates, and errors of the unknowns that
    trials share.
    """

    coefficients: (
        Array  # (nn * nq, own) n_c: what the own coordinates do, the joint parameters being known
    )
    sensitivity: Array  # (nn * nq, np) S = - d N / d p, joint parameters before soft tissue
    shift: Array
    """(np, nc) d p_c of the free joint parameters, then of the skin. The columns of a source are np
    or fewer with the same covariance."""
    own: tuple[ErrorSource, ...]  # (own,) of the columns of `coefficients`
    others: tuple[ErrorSource, ...]  # (nc,) of the columns of `shift`

    @cached_property
    def by_source(self) -> NodeMoves:
        """(own + nc columns) of every source: the trial's own, then those of the unknowns."""
        return self._with(self.shift)

    @cached_property
    def together(self) -> NodeMoves:
        """(own + np columns or fewer) the same with the covariance of the unknowns by all sources
        at once.
        """
        return self._with(np.asarray(np.linalg.qr(self.shift.T, mode="r")).T)

    def _with(self, shift: Array) -> NodeMoves:
        return NodeMoves(np.hstack([self.coefficients, -self.sensitivity @ shift]), shift)

    def variances(self, moved: Array) -> dict[ErrorSource, Array]:
        """ErrorSource -> (frames, m) the variance that it makes; `moved` (frames, m, own + nc) of
        `by_source`.
        """
        columns = (*self.own, *self.others)
        out = dict[ErrorSource, Array]()
        for source in dict.fromkeys(columns):
            out[source] = squares(moved[:, :, [k for k, of in enumerate(columns) if of is source]])
        return out

    def whole_and_own(self, moved: Array) -> tuple[Array, Array]:
        """(frames, m) variance by all sources, and by the trial's own markers; `moved` (frames, m,
        k) of `together`.
        """
        own = [k for k, of in enumerate(self.own) if of is ErrorSource.MOTION]
        return squares(moved), squares(moved[:, :, own])


def squares(moves: Array) -> Array:
    """(nf, m) variance from what independent sources (nf, m, k) make."""
    return np.einsum("fmk,fmk->fm", moves, moves)


def source_of(name: str) -> ErrorSource:
    """The source that a column of an `ErrorSources` belongs to, by its name."""
    first, _, rest = name.partition("/")
    if first == "nominal" and rest in JP_INDEX:
        return ErrorSource.JOINT_NOMINAL
    parts = {part.removesuffix(soft_tissue_artefact.SQUARES) for part in rest.split("/")}
    if first == "skin" and (rest == "found" or not parts.isdisjoint(COORDINATES)):
        return ErrorSource.SKIN
    if first == "posture" and rest.rpartition("/")[2].isdigit():
        return ErrorSource.POSTURE
    return (
        ErrorSource.BANDWIDTH
        if first == "bandwidth" and "/" not in rest
        else ErrorSource.JOINT_MARKERS
    )


def whole_body_scores(
    problem: MotionProblem, coefficients: Array, parameters: Parameters, joint: ErrorSources | None
) -> MarkerScores:
    """Scores of one trial's markers, for the joint parameters of `joint`; None: no parameter is
    free.
    """
    problem = problem.with_free(joint.free if joint else ())
    body = problem.build_body(parameters)
    eliminated = eliminate(problem.assemble_equations(coefficients, body))
    columns = [_cluster_gradients(problem, body, coefficients)]
    clusters = [f"{problem.name}/{label}/{axis}" for label in problem.labels for axis in "xyz"]
    if problem.penalty is not None:
        columns.append(problem.penalty.evaluate(coefficients)[1].reshape(-1, 1))
        clusters.append(f"bandwidth/{problem.name}")
    for prior in problem.priors:
        if prior.centred:
            columns.append(prior.compute_scores(problem.basis, problem.chain.coordinates))
            clusters += [f"posture/{problem.name}/{k}" for k in range(columns[-1].shape[1])]
    moves = -eliminated.factor.solve(np.hstack(columns))
    return MarkerScores(
        coefficients=moves, sensitivity=eliminated.sensitivity, clusters=tuple(clusters)
    )


def _cluster_gradients(problem: MotionProblem, body: LinkageModel, coefficients: Array) -> Array:
    """(nn * nq, nc) half gradients of each marker coordinate's own cost by the coefficients,
    residuals inflated.
    """
    chain, data, basis = problem.chain, problem.data, problem.basis
    nq = len(chain.coordinates)
    q = basis.evaluate(coefficients)
    spatial = Kinematics(body, q, data.secondary).columns
    x = problem.compute_positions(coefficients, body)
    residual = x - data.measured
    least = 0.0 if problem.noise is None else 1e-3 * problem.noise.size_mm
    of_one = np.arange(len(data.segment)) if problem.noise is None else _first_alike(data.measured)
    inverse = _frame_inverses(problem, body, q)
    matrix = basis.matrices[0]
    by_node = np.zeros((basis.nodes, nq, 3 * len(data.segment)))
    for m, segment in enumerate(data.segment):
        moving = np.flatnonzero(chain.support[:nq, segment])
        v, w = spatial[moving, :3], spatial[moving, 3:]
        velocity = np.ascontiguousarray(v + np.cross(w, x[m][None], axis=1))
        # h = w J (J^T W J)^-1 J^T of this marker's three axes in its own frame: what the motion
        # absorbs of it
        by_frame = velocity.transpose(2, 1, 0)
        met = by_frame @ inverse[np.ix_(np.arange(len(q)), moving, moving)]
        leverage = (met * by_frame).sum(axis=2).T
        leverage = np.clip(data.weight[m] * leverage, 0.0, LEVERAGE_CAP)
        inflated = residual[m] / (1.0 - leverage)
        if (
            least and (data.weight[m] > 0).any()
        ):  # a program that fitted a body of its own shows less than its errors
            spread = np.sqrt(np.mean(inflated[:, data.weight[m] > 0] ** 2, axis=1, keepdims=True))
            inflated = inflated * np.maximum(least / np.maximum(spread, 1e-9), 1.0)
        pull = velocity * (data.weight[m] * inflated)
        for i in range(3):
            by_node[:, moving, 3 * of_one[m] + i] += (pull[:, i] @ matrix).T
    return by_node.reshape(basis.nodes * nq, -1)


def _first_alike(measured: Array) -> IntArray:
    """(nm,) of each point of (nm, 3, nf) m the first that is the same: a key point of two segments
    errs once.
    """
    _, first, which = np.unique(
        measured.reshape(len(measured), -1), axis=0, return_index=True, return_inverse=True
    )
    return np.asarray(first[which.ravel()])


def _frame_inverses(problem: MotionProblem, body: LinkageModel, q: Array) -> Array:
    """(nf, nq, nq) pseudo-inverses of the frames' own Gauss-Newton matrices."""
    hessian = problem.compute_frame_hessians(q, body)
    # m^2 and rad^2 on one diagonal: scaled to ones, so that the cut of the pseudo-inverse means the
    # same for all
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("fii->fi", hessian), 1e-12))
    scaled = hessian * scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.pinv(scaled, rcond=1e-8, hermitian=True)
    return inverse * scale[:, :, None] * scale[:, None, :]


def marker_moves(
    problem: MotionProblem,
    coefficients: Array,
    parameters: Parameters,
    joint: ErrorSources | None,
    scores: MarkerScores | None = None,
) -> MotionSensitivity:
    """Moves of one whole-body trial.

    `joint`: None where no joint parameters were calibrated.
    `scores`: of `whole_body_scores`, where known already.
    """
    scores = scores or whole_body_scores(problem, coefficients, parameters, joint)
    found = [source_of(c) for c in scores.clusters]
    own = [
        source if source in (ErrorSource.BANDWIDTH, ErrorSource.POSTURE) else ErrorSource.MOTION
        for source in found
    ]
    shift, others = np.zeros((scores.sensitivity.shape[1], 0)), list[ErrorSource]()
    if joint is not None:
        errors = joint.parameters[problem.with_free(joint.free).locate_in(joint.free)]
        named = [source_of(name) for name in joint.clusters]
        for source in dict.fromkeys(named):
            columns = errors[
                :, [k for k, of in enumerate(named) if of is source and errors[:, k].any()]
            ]
            compressed = np.asarray(np.linalg.qr(columns.T, mode="r")).T
            shift = np.hstack([shift, compressed])
            others += [source] * compressed.shape[1]
    return MotionSensitivity(
        coefficients=scores.coefficients,
        sensitivity=scores.sensitivity,
        shift=shift,
        own=tuple(own),
        others=tuple(others),
    )


def coordinate_variances(
    problem: MotionProblem, moves: MotionSensitivity, more: Array | None = None
) -> tuple[Array, Array]:
    """(nf, nq) m^2, rad^2: variances of the coordinates of one whole-body trial by all sources, and
    by its own markers.

    `more`: (nf, m, nq) m quantities' derivatives by coordinates; their variances follow, (nf, nq +
    m).
    """

    def moved(part: slice | IntArray) -> Array:
        found = moves.together.moved(basis, part)
        return found if more is None else np.concatenate([found, more[part] @ found], axis=1)

    basis = problem.basis
    parts = [moves.whole_and_own(moved(part)) for part in stretches(len(basis.time), BLOCK)]
    whole, own = (np.concatenate(of) for of in zip(*parts, strict=True))
    return whole, own


def coordinate_standard_errors(
    problem: MotionProblem,
    moves: MotionSensitivity,
    turned: Array | None = None,
    variances: Array | None = None,
) -> Array:
    """(nf, nq) m, rad: standard errors of the coordinates of one whole-body trial.

    `turned`: (nf, nq) those that errors of the segments' axes make
    (`AxisErrors.coordinate_errors`); a coordinate that no marker moves with is held at zero, and
    has none. `variances`: by all sources, where known already.
    """
    out: Array = np.sqrt(
        coordinate_variances(problem, moves)[0] if variances is None else variances
    )
    return out if turned is None else np.hypot(out, np.where(problem.active, turned, 0.0))
