"""What the recordings of one person alone say of the joint parameters, the prior of the fit taken out again.

A calibration says of deviations y from nominal joints (in units of the default prior): the estimate y^ with covariance
C, in which the prior, N(0, 1), counts already. What the recordings say is S = C^-1 - 1, nothing of it negative, and
S m = C^-1 y^, m being where they alone would have it (`compare/shared_model.py` does the same with two sessions).
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_evidence import LEG_PARAMETERS, UPPER_PARAMETERS
from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.records import dataclass
from gaitcal.study.people_design import Person

PARTS = {"legs": LEG_PARAMETERS, "trunk and arms": UPPER_PARAMETERS}
"""Joint parameters that are fitted together, and so learnt together."""
RANK = 1e-9
"""Part of the largest eigenvalue of C below which a direction would be known exactly."""


@dataclass(frozen=True, kw_only=True)
class PartEvidence:
    """Of the n joint parameters of a part, in units of the default prior."""

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


def parts_of(influence: Influence, deviation: Array, names: tuple[str, ...]) -> dict[str, PartEvidence] | None:
    """What a calibration says of every part of the body; None where its errors are no covariance of rank.

    Parameters
    ----------
    influence : errors of joint parameters by source, of a calibration with the default prior.
    deviation : (98,) m, rad: fitted minus nominal, in the order of `names`.
    """
    out = {}
    for part, wanted in PARTS.items():
        known = [k for k, name in enumerate(wanted) if name in influence.free]
        information, right = np.zeros((len(wanted),) * 2), np.zeros(len(wanted))
        if known:
            free = [wanted[k] for k in known]
            unit = prior_deviations(free)
            rows = influence.parameters[[influence.free.index(name) for name in free]] / unit[:, None]
            values, vectors = np.linalg.eigh(rows @ rows.T)
            if values[0] <= RANK * values[-1]:
                return None
            estimate = vectors.T @ (deviation[[names.index(name) for name in free]] / unit)
            # eigenvectors of C are those of S: what the recordings add along each
            seen = np.maximum(1.0 / values - 1.0, 0.0)
            information[np.ix_(known, known)] = (vectors * seen) @ vectors.T
            right[known] = vectors @ np.where(seen > 0.0, estimate / values, 0.0)
        out[part] = PartEvidence(information=information, right=right)
    return out
