"""Normal prior of a person's joint parameters before any recording.

Its sources: anatomy and study file (`calibration/joint_prior.py`), and a cohort
(`cohort_prior.py`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """Normal prior of the deviations of n joint parameters from their nominal values."""

    names: tuple[str, ...]
    mean: Array
    """(n,) m, rad."""
    covariance: Array
    """(n, n)."""
    of_study: tuple[str, ...] = ()
    """Parameters with a prior in the study file."""
    of_cohort: tuple[str, ...] = ()
    """Parameters with a prior of a cohort, which precedes the study file."""
    file: str = ""
    """File of the cohort, if there is one."""
    people: int = 0
    left_out: int = 0
    """People of the fold that is left out because this person is in it; else 0."""
    notes: tuple[str, ...] = ()
    """Descriptions of the sources."""
    sha256: str = ""
    """SHA-256 of the file, hexadecimal."""
    doubted: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> m, rad of further error, from causes that no fit models."""

    def update(self, other: "JointPrior") -> "JointPrior":
        """Replace the prior of some parameters by another, independent of the rest.

        Parameters
        ----------
        other
            Prior of some of these parameters.

        Returns
        -------
        JointPrior
            Prior of all parameters.
        """
        at = [self.names.index(name) for name in other.names]
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[at], covariance[:, at] = 0.0, 0.0
        mean[at], covariance[np.ix_(at, at)] = other.mean, other.covariance
        return replace(self, mean=mean, covariance=covariance)

    def widen(self, more: Mapping[str, float]) -> "JointPrior":
        """Add independent errors (m, rad; standard deviations) to some parameters.

        Parameters
        ----------
        more
            Parameter -> m, rad.

        Returns
        -------
        JointPrior
            Prior with a larger covariance.
        """
        variance = np.array([more.get(name, 0.0) for name in self.names]) ** 2
        return replace(self, covariance=self.covariance + np.diag(variance))

    def describe_fallback(self, names: Sequence[str]) -> str:
        """Describe the values near which unobservable joint parameters stay.

        Parameters
        ----------
        names
            Joint parameters that no trial shows.

        Returns
        -------
        str
            Empty for their nominal values.
        """
        if set(names) & set(self.of_cohort):
            return "the cohort mean"
        return "the prior mean of the study file" if set(names) & set(self.of_study) else ""
