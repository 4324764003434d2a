"""What the recordings of one person alone say of the joint parameters, the prior of the fit taken out again.

A calibration says of deviations d from nominal joints the estimate d^ with covariance C, in which the prior of the fit,
N(m0, F F^T), counts already. In its units, x = F^-1 (d - m0), that is N(0, 1), and with x^ and its covariance C_x what
the recordings alone say is

    S_x = C_x^-1 - 1 (nothing of it negative),      S_x m_x = C_x^-1 x^      <=>      S m = C^-1 d^ - (F F^T)^-1 m0,

m being where they alone would have it (`compare/shared_model.py` does the same with two sessions). People are told in
units of anatomy's prior, y = G^-1 (d - a), in which x = F^-1 G y - F^-1 (m0 - a), whatever prior their fit had.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_phases import LEG_PARAMETERS, UPPER_PARAMETERS
from gaitcal.calibration.joint_prior import prior_of, prior_root
from gaitcal.compare.parameter_differences import told_parameters
from gaitcal.study.joint_prior import JointPrior, Person

PARTS = {"legs": LEG_PARAMETERS, "trunk and arms": UPPER_PARAMETERS}
"""Joint parameters that are fitted together, and so learnt together."""
RANK = 1e-9
"""Part of the largest eigenvalue of C below which a direction would be known exactly."""


@dataclass(frozen=True, kw_only=True)
class PartEvidence:
    """Of the n joint parameters of a part, in units of anatomy's prior: of y."""

    information: Array
    """(n, n) S."""
    right: Array
    """(n,) S m."""


@dataclass(frozen=True, kw_only=True)
class PersonEvidence:
    """One person, from one session."""

    name: str
    person: Person
    recordings: frozenset[str]
    """SHA-256 of all of them, of every session."""
    parts: dict[str, PartEvidence]
    """By the names of `PARTS`."""

    @property
    def seen(self) -> float:
        """How much the recordings tell: how far the prior is narrowed, in units of its volume's logarithm."""
        return float(sum(np.linalg.slogdet(np.eye(len(p.right)) + p.information)[1] for p in self.parts.values()))


def parts_of(
    influence: ErrorSources, deviation: Array, names: tuple[str, ...], prior: JointPrior | None
) -> dict[str, PartEvidence] | None:
    """What a calibration says of every part of the body; None where its errors are no covariance of rank.

    Parameters
    ----------
    influence : errors of joint parameters by source; those that no trial moved tell nothing.
    deviation : (98,) m, rad: fitted minus nominal, in the order of `names`.
    prior : of the calibration; anatomy's unless given.
    """
    out, told = {}, set(told_parameters(influence))
    for part, wanted in PARTS.items():
        free = [name for name in wanted if name in told]
        information, right = np.zeros((len(wanted),) * 2), np.zeros(len(wanted))
        if free:
            mean, root = prior_of(free, prior)[0], prior_root(free, prior)
            rows = np.linalg.solve(root, influence.parameters[[influence.free.index(name) for name in free]])
            values, vectors = np.linalg.eigh(rows @ rows.T)
            if values[0] <= RANK * values[-1]:
                return None
            estimate = vectors.T @ np.linalg.solve(root, deviation[[names.index(name) for name in free]] - mean)
            # eigenvectors of C_x are those of S_x: what the recordings add along each
            seen = np.maximum(1.0 / values - 1.0, 0.0)
            # from units of the fit's prior to those of anatomy's
            chosen = [wanted.index(name) for name in free]
            turned = vectors.T @ np.linalg.solve(root, prior_root(wanted, None)[chosen])
            moved = vectors.T @ np.linalg.solve(root, mean - prior_of(free, None)[0])
            information = (turned.T * seen) @ turned
            right = turned.T @ (np.where(seen > 0.0, estimate / values, 0.0) + seen * moved)
        out[part] = PartEvidence(information=information, right=right)
    return out
