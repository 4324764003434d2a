"""Errors by source: effects of independent errors on joint parameters and on motions.

Joint parameters p have the Hessian H with motions eliminated. They are fitted to trials of score
u_t = S_t^1/2 n_t and to a prior Lambda about c. Fixed parameters k and the prior's centre c have
errors d p_k and d c, from an earlier phase or from the nominal model:

    d p = -H^-1 (sum_t u_t + S_pk d p_k - Lambda d c),
    H = sum_t S_pp + Lambda,       n_t, independent, N(0, 1).

A source c of the joint parameters changes the motion by  d N_c = - S d p_c,  S = -d N/d p. The
trial's markers change it with known joints (their effect on the joints is in u_t). The control
points depend on the residuals of marker coordinate c, one axis of one marker, through its score g_c
= sum_f J_cf r_cf, and change by n_c = -H_qq^-1 g_c. Soft tissue repeats its movement from frame to
frame, so frames are dependent. Marker coordinates are taken as independent: the cluster-robust
sandwich (Liang and Zeger 1986). Residuals are first inflated by the part that the motion absorbs:
r / (1 - h), h the leverage of the coordinate in its frame's least-squares problem (Mancini and
DeRouen 2001). Soft tissue is slow compared with the splines, so the motion of a frame can follow
it.

Coordinates change by B d N_c. Quantities that depend on coordinates and parameters, such as a
torque at a frame, change by their derivatives. Their variance is the sum of squares over the
sources.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise

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
from gaitcal.study.normal_prior import JointPrior
from gaitcal.tracking.banded import eliminate
from gaitcal.tracking.spline import ORDER, SplineBasis
from gaitcal.tracking.trial_problem import MotionProblem

# Largest leverage: a marker that alone determines a coordinate has no residual to inflate
LEVERAGE_CAP = 0.9
# Frames at a time at most, whose changes by the marker coordinates of all trials are held at once
BLOCK = 125


@dataclass(frozen=True)
class ErrorSources:
    """Effects of independent error sources on the joint parameters."""

    names: tuple[str, ...]  # (np,) joint parameters
    effects: Array  # (np, nc) d p_c, m and rad
    # (nc,) names of the sources: `markers/trial/number`, `skin/column`, `nominal/parameter`
    sources: tuple[str, ...]

    @property
    def covariance(self) -> Array:
        """(np, np) covariance; zero along directions that no trial determines."""
        return self.effects @ self.effects.T

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error (m, rad) of each free joint parameter."""
        errors = np.sqrt((self.effects**2).sum(axis=1))
        return {name: float(e) for name, e in zip(self.names, errors, strict=True)}

    def select(self, names: Sequence[str]) -> "ErrorSources":
        """Select some of the parameters, in the order of `names`."""
        return ErrorSources(
            tuple(names), self.effects[[self.names.index(n) for n in names]], self.sources
        )

    def replace_errors(self, other: "ErrorSources") -> "ErrorSources":
        """Replace the errors of those parameters that `other` has.

        Parameters
        ----------
        other : ErrorSources
            Independent errors of some parameters.

        Returns
        -------
        ErrorSources
            Without sources that have no effect any more.
        """
        kept = self.select([name for name in self.names if name not in other.names])
        moving = np.flatnonzero(kept.effects.any(axis=0)).tolist()
        errors = block_diag(kept.effects[:, moving], other.effects)
        sources = [self.sources[c] for c in moving]
        return ErrorSources((*kept.names, *other.names), errors, (*sources, *other.sources))


def make_nominal_errors(
    names: Sequence[str] = JP_NAMES, prior: JointPrior | None = None
) -> ErrorSources:
    """Make the errors of nominal joint parameters, one column for each cause.

    Parameters
    ----------
    names : sequence of str
        Joint parameters; all if not given.
    prior : JointPrior, optional
        Prior of their deviations; anatomy's if not given. Its doubts are further causes.

    Returns
    -------
    ErrorSources
        m and rad.
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
        tuple(names), np.hstack([joint_prior.factor_prior(names, prior), more]), causes
    )


def compute_posterior_ratio(
    joint: str, errors: ErrorSources | None, prior: JointPrior | None = None
) -> float:
    """Compute the standard error of a joint's parameters over that before any trial.

    Parameters
    ----------
    joint : str
        Name of the joint.
    errors : ErrorSources or None
        Errors after the fit; None if unknown.
    prior : JointPrior, optional
        Prior; anatomy's if not given.

    Returns
    -------
    float
        The larger ratio of positions and of orientations; 0 if errors are unknown.
    """
    if errors is None:
        return 0.0
    now, found = errors.standard_errors, []
    for kind in ParameterKind:
        names = [p.name for p in JOINT_PARAMETERS if p.joint == joint and p.kind is kind]
        if names:
            before = np.sqrt(np.diag(joint_prior.select_prior(names, prior)[1]))
            after = np.array(
                [now.get(name, size) for name, size in zip(names, before, strict=True)]
            )
            found.append(float(np.linalg.norm(after) / np.linalg.norm(before)))
    return max(found)


def propagate_errors(
    free: tuple[str, ...], scores: ErrorSources, arrow: Arrow, held: Array, known: ErrorSources
) -> ErrorSources:
    """Propagate errors to fitted parameters, and keep those of the others.

    Parameters
    ----------
    free : tuple of str
        Fitted parameters.
    scores : ErrorSources
        (np, nc) u_t of every source of the fit.
    arrow : Arrow
        H and Lambda.
    held : (np, nk) array
        S_pk, in the order of those of `known.names` that were not fitted.
    known : ErrorSources
        Errors before the fit, of the priors' centres and of fixed parameters.

    Returns
    -------
    ErrorSources
        Of `free`, then of the others.
    """
    others = known.select([name for name in known.names if name not in free])
    centre = np.zeros((len(free), len(known.sources)))
    given = [name in known.names for name in free]
    centre[given] = known.select([name for name in free if name in known.names]).effects
    kept = others.effects
    of_known = arrow.solve(arrow.multiply_by_precision(centre) - held @ kept)
    fitted = np.vstack(
        [arrow.solve(scores.effects), np.zeros((len(kept), scores.effects.shape[1]))]
    )
    return ErrorSources(
        (*free, *others.names),
        np.hstack([fitted, np.vstack([of_known, kept])]),
        (*scores.sources, *known.sources),
    )


@dataclass(frozen=True)
class CoefficientErrors:
    """Effects of k independent sources on one trial's control points and joint parameters."""

    nodes: Array
    """(nn * nq, k) d N_c."""
    parameters: Array
    """(np, ku) d p_c, joint parameters before soft tissue, of the last ku sources; the others move
    none.
    """

    def compute_coordinate_errors(
        self, basis: SplineBasis, frames: slice | IntArray, derivatives: int = 1
    ) -> Array:
        """Compute the effects on coordinates and, if wanted, on their time derivatives.

        Parameters
        ----------
        basis : SplineBasis
            Splines of the trial.
        frames : slice or array of int
            Frames.
        derivatives : int
            1: coordinates; 2: and rates; 3: and accelerations.

        Returns
        -------
        (frames, derivatives * nq, k) array
            m, rad and their rates.
        """
        weights = np.stack([basis.value, basis.rate, basis.acceleration][:derivatives], axis=1)[
            frames
        ]
        first = basis.first[frames]
        by_node = self.nodes.reshape(basis.control_points, -1)
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

    def propagate(
        self, basis: SplineBasis, frames: slice | IntArray, by_state: Array, by_parameter: Array
    ) -> Array:
        """Propagate the effects to m quantities.

        Parameters
        ----------
        basis : SplineBasis
            Splines of the trial.
        frames : slice or array of int
            Frames.
        by_state : (frames, m, 3 nq) array
            Derivatives by coordinates, rates and accelerations.
        by_parameter : (frames, m, npj) array
            Derivatives by the joint parameters.

        Returns
        -------
        (frames, m, k) array
            Effect of each source.
        """
        out: Array = by_state @ self.compute_coordinate_errors(basis, frames, 3)
        changed = self.parameters[: by_parameter.shape[2]]
        first = out.shape[2] - changed.shape[1]
        # Of `MotionSensitivity.together` only as many sources as parameters change these.
        count = int(np.flatnonzero(changed.any(axis=0)).max(initial=-1)) + 1
        out[:, :, first : first + count] += by_parameter @ changed[:, :count]
        return out


@dataclass(frozen=True, kw_only=True)
class MarkerScores:
    """Effects of one trial's marker coordinates on its motion."""

    # (nn * nq, nm) n_c: effects of the nm marker coordinates of this trial with known joints
    coefficients: Array
    # (nn * nq, np) S = - d N / d p, joint parameters before soft tissue
    sensitivity: Array
    clusters: tuple[str, ...]
    """(nm,) source of each column: `trial/label/axis`, `bandwidth/trial` or `posture/trial/k`."""

    def append_unknowns(self) -> CoefficientErrors:
        """Append a unit of each unknown to the marker coordinates."""
        return CoefficientErrors(
            np.hstack([self.coefficients, -self.sensitivity]), np.eye(self.sensitivity.shape[1])
        )


@dataclass(frozen=True, kw_only=True)
class MotionSensitivity:
    """Error sources of one trial's motion: its markers, and unknowns that trials share."""

    # (nn * nq, nm) n_c: effects of the nm marker coordinates of this trial with known joints
    coefficients: Array
    # (nn * nq, np) S = - d N / d p, joint parameters before soft tissue
    sensitivity: Array
    shift: Array
    """(np, nc) d p_c of the free joint parameters, then of the skin. The columns of a source are np
    or fewer with the same covariance."""
    # (nm,) of the columns of `coefficients`
    trial_sources: tuple[ErrorSource, ...]
    shared_sources: tuple[ErrorSource, ...]  # (nc,) of the columns of `shift`

    @cached_property
    def by_source(self) -> CoefficientErrors:
        """Effects of all sources: the trial's, then those of the unknowns (nm + nc columns)."""
        return self._combine_with(self.shift)

    @cached_property
    def together(self) -> CoefficientErrors:
        """Return the same errors with the covariance of all sources together in fewer columns."""
        return self._combine_with(np.asarray(np.linalg.qr(self.shift.T, mode="r")).T)

    def _combine_with(self, shift: Array) -> CoefficientErrors:
        return CoefficientErrors(np.hstack([self.coefficients, -self.sensitivity @ shift]), shift)

    def sum_by_source(self, moved: Array) -> dict[ErrorSource, Array]:
        """Sum squared effects of each source.

        Parameters
        ----------
        moved : (frames, m, nm + nc) array
            Effects of the columns of `by_source` on m quantities.

        Returns
        -------
        dict of ErrorSource to (frames, m) array
            Variances.
        """
        out, start = dict[ErrorSource, Array](), 0
        # The columns of a source follow each other, so a view of them suffices, without a copy.
        for source, run in groupby((*self.trial_sources, *self.shared_sources)):
            stop = start + len(list(run))
            variance = sum_squares(moved[:, :, start:stop])
            out[source] = out[source] + variance if source in out else variance
            start = stop
        return out

    def sum_all_and_trial(self, moved: Array) -> tuple[Array, Array]:
        """Sum squared effects of all sources, and of the trial's markers alone.

        Parameters
        ----------
        moved : (frames, m, k) array
            Effects of the columns of `together` on m quantities.

        Returns
        -------
        tuple of (frames, m) array
            Both variances.
        """
        markers = self.trial_sources.count(ErrorSource.MOTION)
        return sum_squares(moved), sum_squares(moved[:, :, :markers])


def sum_squares(moves: Array) -> Array:
    """Sum the squared effects (nf, m, k) of independent sources: variances (nf, m)."""
    return np.einsum("fmk,fmk->fm", moves, moves)


def classify_source(name: str) -> ErrorSource:
    """Classify a column of an `ErrorSources` by its name."""
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


def compute_marker_scores(
    problem: MotionProblem, coefficients: Array, parameters: Parameters, joint: ErrorSources | None
) -> MarkerScores:
    """Compute the effects of one trial's markers on its motion.

    Parameters
    ----------
    problem : MotionProblem
        The trial.
    coefficients : (nn, nq) array
        Its motion.
    parameters : Parameters
        Parameters of the linkage.
    joint : ErrorSources or None
        Its joint parameters are free; None: none is free.

    Returns
    -------
    MarkerScores
        Columns of markers, bandwidth and posture.
    """
    problem = problem.with_free(joint.names if joint else ())
    body = problem.build_body(parameters)
    eliminated = eliminate(problem.assemble_equations(coefficients, body))
    columns = [_compute_cluster_gradients(problem, body, coefficients)]
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


def _compute_cluster_gradients(
    problem: MotionProblem, body: LinkageModel, coefficients: Array
) -> Array:
    """Compute half gradients (nn * nq, nc) of each marker coordinate's cost, residuals inflated."""
    chain, data, basis = problem.chain, problem.data, problem.basis
    nq = len(chain.coordinates)
    q = basis.evaluate(coefficients)
    spatial = Kinematics(body, q, data.secondary).columns
    x = problem.compute_positions(coefficients, body)
    residual = x - data.measured
    least = 0.0 if problem.noise is None else 1e-3 * problem.noise.size_mm
    of_one = (
        np.arange(len(data.segment))
        if problem.noise is None
        else _find_first_duplicates(data.measured)
    )
    inverse = _invert_frame_hessians(problem, body, q)
    matrix = basis.matrices[0]
    by_node = np.zeros((basis.control_points, nq, 3 * len(data.segment)))
    for m, segment in enumerate(data.segment):
        moving = np.flatnonzero(chain.support[:nq, segment])
        v, w = spatial[moving, :3], spatial[moving, 3:]
        velocity = np.ascontiguousarray(v + np.cross(w, x[m][None], axis=1))
        # h = w J (J^T W J)^-1 J^T of this marker's three axes, frame by frame: the part that the
        # motion absorbs
        by_frame = velocity.transpose(2, 1, 0)
        met = by_frame @ inverse[np.ix_(np.arange(len(q)), moving, moving)]
        leverage = (met * by_frame).sum(axis=2).T
        leverage = np.clip(data.weight[m] * leverage, 0.0, LEVERAGE_CAP)
        inflated = residual[m] / (1.0 - leverage)
        # Markers computed by another program's model have smaller residuals than errors.
        if least and (data.weight[m] > 0).any():
            spread = np.sqrt(np.mean(inflated[:, data.weight[m] > 0] ** 2, axis=1, keepdims=True))
            inflated = inflated * np.maximum(least / np.maximum(spread, 1e-9), 1.0)
        pull = velocity * (data.weight[m] * inflated)
        for i in range(3):
            by_node[:, moving, 3 * of_one[m] + i] += (pull[:, i] @ matrix).T
    return by_node.reshape(basis.control_points * nq, -1)


def _find_first_duplicates(measured: Array) -> IntArray:
    """Find for each point (nm, 3, nf) the first equal one: key points of two segments err once."""
    _, first, which = np.unique(
        measured.reshape(len(measured), -1), axis=0, return_index=True, return_inverse=True
    )
    return np.asarray(first[which.ravel()])


def _invert_frame_hessians(problem: MotionProblem, body: LinkageModel, q: Array) -> Array:
    """Compute pseudo-inverses (nf, nq, nq) of the Gauss-Newton matrices of single frames."""
    hessian = problem.compute_frame_hessians(q, body)
    # m^2 and rad^2 on one diagonal: scaled to ones, so that the cut of the pseudo-inverse means the
    # same for all
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("fii->fi", hessian), 1e-12))
    scaled = hessian * scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.pinv(scaled, rcond=1e-8, hermitian=True)
    return inverse * scale[:, :, None] * scale[:, None, :]


def compute_motion_sensitivity(
    problem: MotionProblem,
    coefficients: Array,
    parameters: Parameters,
    joint: ErrorSources | None,
    scores: MarkerScores | None = None,
) -> MotionSensitivity:
    """Compute the error sources of one whole-body trial's motion.

    Parameters
    ----------
    problem : MotionProblem
        The trial.
    coefficients : (nn, nq) array
        Its motion.
    parameters : Parameters
        Parameters of the linkage.
    joint : ErrorSources or None
        Errors of joint parameters; None if they were not calibrated.
    scores : MarkerScores, optional
        Result of `compute_marker_scores`, if available.

    Returns
    -------
    MotionSensitivity
        Columns of the trial, then of the shared unknowns.
    """
    scores = scores or compute_marker_scores(problem, coefficients, parameters, joint)
    found = [classify_source(c) for c in scores.clusters]
    trial_sources = [
        source if source in (ErrorSource.BANDWIDTH, ErrorSource.POSTURE) else ErrorSource.MOTION
        for source in found
    ]
    shift, others = np.zeros((scores.sensitivity.shape[1], 0)), list[ErrorSource]()
    if joint is not None:
        errors = joint.effects[problem.with_free(joint.names).locate_in(joint.names)]
        named = [classify_source(name) for name in joint.sources]
        for source in dict.fromkeys(named):
            columns = errors[
                :, [k for k, column in enumerate(named) if column is source and errors[:, k].any()]
            ]
            compressed = np.asarray(np.linalg.qr(columns.T, mode="r")).T
            shift = np.hstack([shift, compressed])
            others += [source] * compressed.shape[1]
    return MotionSensitivity(
        coefficients=scores.coefficients,
        sensitivity=scores.sensitivity,
        shift=shift,
        trial_sources=tuple(trial_sources),
        shared_sources=tuple(others),
    )


def compute_coordinate_variances(
    problem: MotionProblem, moves: MotionSensitivity, more: Array | None = None
) -> tuple[Array, Array]:
    """Compute variances of the coordinates of one whole-body trial.

    Parameters
    ----------
    problem : MotionProblem
        The trial.
    moves : MotionSensitivity
        Its error sources.
    more : (nf, m, nq) array, optional
        Derivatives of m further quantities by the coordinates.

    Returns
    -------
    tuple of (nf, nq + m) array
        Variances by all sources, and by the trial's markers; m^2 and rad^2.
    """

    def moved(part: slice | IntArray) -> Array:
        found = moves.together.compute_coordinate_errors(basis, part)
        return found if more is None else np.concatenate([found, more[part] @ found], axis=1)

    basis = problem.basis
    parts = [moves.sum_all_and_trial(moved(part)) for part in stretches(len(basis.time), BLOCK)]
    whole, by_markers = (np.concatenate(pieces) for pieces in zip(*parts, strict=True))
    return whole, by_markers


def compute_coordinate_errors(
    problem: MotionProblem,
    moves: MotionSensitivity,
    turned: Array | None = None,
    variances: Array | None = None,
) -> Array:
    """Compute standard errors of the coordinates of one whole-body trial.

    Parameters
    ----------
    problem : MotionProblem
        The trial.
    moves : MotionSensitivity
        Its error sources.
    turned : (nf, nq) array, optional
        Errors by the axes of the segments (`AxisErrors.coordinate_errors`), rad. They are left out
        for coordinates that no marker moves with: those are fixed at zero.
    variances : (nf, nq) array, optional
        Variances by all sources, if available.

    Returns
    -------
    (nf, nq) array
        m and rad.
    """
    out: Array = np.sqrt(
        compute_coordinate_variances(problem, moves)[0] if variances is None else variances
    )
    return out if turned is None else np.hypot(out, np.where(problem.active, turned, 0.0))
