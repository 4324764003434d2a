"""What every source of error moves: the joint parameters, and through them and by itself the motion of a trial.

A source c of the joint parameters (`influence.py`) moves them by d p_c and the motion by  d N_c = - S d p_c,
S = -d N/d p. A coordinate of the trial's own markers moves its nodes by n_c while joints are known: what it does to the
joints is told by the noise of the trial. The coordinates of the motion move by B d N_c; squares sum to the variance
that skin movement leaves in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, stretches
from gaitcal.calibration.influence import Influence, TrialScores, trial_scores
from gaitcal.calibration.soft_tissue_artefact import SQUARES
from gaitcal.dynamics.torque_sources import Source
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import ORDER, SplineBasis, basis_matrix
from gaitcal.motion.trial_problem import TrialProblem

BLOCK = 125
"""Frames at a time at most, whose changes by the marker coordinates of all trials are held at once."""
COLUMNS_AT_ONCE, ROWS_AT_ONCE = 64, 1000
"""Of a product of which only squares are kept."""


@dataclass(frozen=True)
class MarkerMoves:
    """What every source of error moves: this trial's own marker coordinates the nodes, all others the unknowns."""

    shift: Array
    """(np, nc) d p_c of the free joint parameters, then of the skin. The columns of a source are np or fewer with the
    same covariance."""
    nodes: Array
    """(nn * nq, own) n_c: what the own coordinates do."""
    sensitivity: Array
    """(nn * nq, np) - d N / d p."""
    own: tuple[Source, ...]
    """(own,) of the columns of `nodes`."""
    others: tuple[Source, ...]
    """(nc,) of the columns of `shift`."""

    @property
    def present(self) -> tuple[Source, ...]:
        """Every source once."""
        return tuple(dict.fromkeys((*self.own, *self.others)))

    def states(self, basis: SplineBasis, part: slice, nq: int) -> Array:
        """(frames, 3 nq, own + np) `moved` of coordinates, rates and accelerations."""
        return np.concatenate([self.moved(basis, part, nq, derivative) for derivative in range(3)], axis=1)

    def moved(self, basis: SplineBasis, part: slice, nq: int, derivative: int) -> Array:
        """(frames, nq, own + np) B n_c and - B S in some frames, or their derivatives."""
        near = slice(int(basis.first[part.start]), int(basis.first[part.stop - 1]) + ORDER)
        rows = slice(near.start * nq, near.stop * nq)  # only the nodes whose splines reach these frames
        by_node = np.hstack([self.nodes[rows], -self.sensitivity[rows]]).reshape(near.stop - near.start, -1)
        out: Array = basis_matrix(basis, derivative)[part, near] @ by_node
        return out.reshape(part.stop - part.start, nq, -1)

    def variances(self, moved: Array) -> dict[Source, Array]:
        """Source -> (frames, m) the variance that it makes; `moved`: (frames, m, own + np) what own coordinates and
        unknowns do.
        """
        (nf, m, _), count, out = moved.shape, self.nodes.shape[1], dict[Source, Array]()
        by_unknown = moved[:, :, count:].reshape(nf * m, -1)
        for source in self.present:
            own = [k for k, of in enumerate(self.own) if of is source]
            shared = [k for k, of in enumerate(self.others) if of is source]
            found = squares(moved[:, :, :count] if len(own) == count else moved[:, :, own])
            out[source] = found + _product_squares(by_unknown, self.shift[:, shared]).reshape(nf, m)
        return out


def squares(moves: Array) -> Array:
    """(nf, m) variance from what independent sources (nf, m, k) make."""
    out: Array = np.einsum("fmk,fmk->fm", moves, moves)
    return out


def _product_squares(left: Array, right: Array) -> Array:
    """(n,) sums of squares of the rows of left @ right, (n, k) and (k, c); `right` is half zeros, beside a diagonal."""
    out = np.zeros(len(left))
    for start in range(0, right.shape[1], COLUMNS_AT_ONCE):
        part = right[:, start : start + COLUMNS_AT_ONCE]
        rows = np.flatnonzero(part.any(axis=1))
        if not len(rows):
            continue
        kept = slice(rows[0], rows[-1] + 1)
        for first in range(0, len(left), ROWS_AT_ONCE):
            some = slice(first, first + ROWS_AT_ONCE)
            product = left[some, kept] @ part[kept]
            out[some] += np.einsum("ij,ij->i", product, product)
    return out


def source_of(name: str) -> Source:
    """The source that a column of an `Influence` belongs to, by its name."""
    first, _, rest = name.partition("/")
    if first == "nominal" and rest in JP_INDEX:
        return Source.JOINT_NOMINAL
    parts = {part.removesuffix(SQUARES) for part in rest.split("/")}
    if first == "skin" and (rest == "found" or not parts.isdisjoint(COORDINATES)):
        return Source.SKIN
    if first == "posture" and rest.rpartition("/")[2].isdigit():
        return Source.POSTURE
    return Source.BANDWIDTH if first == "bandwidth" and "/" not in rest else Source.JOINT_MARKERS


def whole_body_scores(
    problem: TrialProblem, nodes: Array, parameters: Parameters, joint: Influence | None
) -> TrialScores:
    """Scores of one whole-body trial's markers, for the joint parameters of `joint`; None: no parameter is free."""
    return trial_scores(problem.with_free(joint.free if joint else ()), parameters, nodes)


def marker_moves(
    problem: TrialProblem,
    nodes: Array,
    parameters: Parameters,
    joint: Influence | None,
    scores: TrialScores | None = None,
) -> MarkerMoves:
    """Moves of one whole-body trial.

    Parameters
    ----------
    joint : None where no joint parameters were calibrated.
    scores : of `whole_body_scores`, where known already.
    """
    scores = scores or whole_body_scores(problem, nodes, parameters, joint)
    found = [source_of(c) for c in scores.clusters]
    own = [source if source in (Source.BANDWIDTH, Source.POSTURE) else Source.MOTION for source in found]
    shift, others = np.zeros((scores.sensitivity.shape[1], 0)), list[Source]()
    if joint is not None:
        errors = joint.parameters[problem.with_free(joint.free).places_in(joint.free)]
        named = [source_of(name) for name in joint.clusters]
        for source in dict.fromkeys(named):
            columns = errors[:, [k for k, of in enumerate(named) if of is source and errors[:, k].any()]]
            compressed = np.asarray(np.linalg.qr(columns.T, mode="r")).T
            shift = np.hstack([shift, compressed])
            others += [source] * compressed.shape[1]
    return MarkerMoves(shift, -scores.nodes, scores.sensitivity, tuple(own), tuple(others))


def coordinate_variances(problem: TrialProblem, moves: MarkerMoves) -> dict[Source, Array]:
    """Source -> (nf, nq) m^2, rad^2: variance that it leaves in the coordinates of one whole-body trial."""
    basis, nq = problem.basis, len(problem.chain.coordinates)
    out = {source: np.empty((len(basis.time), nq)) for source in moves.present}
    for part in stretches(len(basis.time), BLOCK):
        for source, variance in moves.variances(moves.moved(basis, part, nq, 0)).items():
            out[source][part] = variance
    return out


def coordinate_standard_errors(
    problem: TrialProblem,
    moves: MarkerMoves,
    turned: Array | None = None,
    variances: Mapping[Source, Array] | None = None,
) -> Array:
    """(nf, nq) m, rad: standard errors of the coordinates of one whole-body trial.

    `turned`: (nf, nq) those that errors of the segments' axes make (`AxisErrors.coordinate_errors`); a coordinate that
    no marker moves with is held at zero, and has none. `variances`: of `coordinate_variances`, where known already.
    """
    out: Array = np.sqrt(sum((variances or coordinate_variances(problem, moves)).values()))
    return out if turned is None else np.hypot(out, np.where(problem.active, turned, 0.0))
