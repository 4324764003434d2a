"""What every marker coordinate moves: joint parameters by d p_c, and the motion of one trial by d N_c.

From `calibration/influence.py`. The coordinates themselves then move by B d N_c, frame by frame; squares sum over
marker coordinates to the variance that skin movement leaves in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.influence import Influence, basis_matrix, trial_scores
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import ORDER
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]

BLOCK = 500
"""Frames at a time, whose changes by the marker coordinates of all trials are held at once."""


@dataclass(frozen=True)
class MarkerMoves:
    """What every marker coordinate moves; this trial's own come first, then those of other trials."""

    shift: Array
    """(np, nc) d p_c; all other sources of error are np columns with the same covariance."""
    nodes: Array
    """(nn * nq, own) of d N_c: what the own coordinates do by themselves."""
    sensitivity: Array
    """(nn * nq, np) - d N / d p."""

    def change(self, rows: slice) -> Array:
        """(rows, nc) d N_c of some rows of the nodes."""
        out = -self.sensitivity[rows] @ self.shift
        out[:, : self.nodes.shape[1]] += self.nodes[rows]
        return np.asarray(out, dtype=np.float64)


def marker_moves(problem: TrialProblem, nodes: Array, parameters: Parameters, joint: Influence | None) -> MarkerMoves:
    """Moves of one whole-body trial; `joint` is None where no joint parameters were calibrated."""
    opened = problem.with_free(joint.free if joint else ())
    scores = trial_scores(opened, parameters, nodes)
    shift = np.zeros((scores.sensitivity.shape[1], len(scores.clusters)))
    if joint is not None:
        errors = joint.parameters[[joint.free.index(name) for name in opened.chain.free]]
        place = {name: k for k, name in enumerate(scores.clusters)}
        own = np.array([name in place for name in joint.clusters], dtype=bool)
        shift[:, [place[name] for name in joint.clusters if name in place]] = errors[:, own]
        others = np.asarray(np.linalg.qr(errors[:, ~own].T, mode="r"))
        shift = np.hstack([shift, others.T])
    return MarkerMoves(shift, -scores.nodes, scores.sensitivity)


def coordinate_standard_errors(problem: TrialProblem, moves: MarkerMoves) -> Array:
    """(nf, nq) m, rad: standard errors of the coordinates of one whole-body trial."""
    basis, nq = problem.basis, len(problem.chain.coordinates)
    out = np.empty((len(basis.time), nq))
    weights = basis_matrix(basis, 0)
    for start in range(0, len(out), BLOCK):
        part = slice(start, min(start + BLOCK, len(out)))
        near = slice(int(basis.first[part.start]), int(basis.first[part.stop - 1]) + ORDER)
        by_node = moves.change(slice(near.start * nq, near.stop * nq)).reshape(near.stop - near.start, -1)
        change = (weights[part, near] @ by_node).reshape(part.stop - part.start, nq, -1)
        out[part] = np.sqrt((change**2).sum(axis=2))
    return out
