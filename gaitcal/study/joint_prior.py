"""What is known of a person's joint parameters before any recording is looked at: anatomy, study file, cohort.

The type that all three share, and what a study file may say of it (`[calibration] joint_prior`); anatomy's own table is
`calibration/joint_prior.py`, where the three are put together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.validation import shown
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.study.settings import CalibrationSettings


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """Deviations of n joint parameters from their nominal values before any trial: normal."""

    names: tuple[str, ...]
    mean: Array
    """(n,) m, rad."""
    covariance: Array
    """(n, n)."""
    of_study: tuple[str, ...] = ()
    """Parameters of which the study file says what to expect."""
    of_cohort: tuple[str, ...] = ()
    """Parameters of which a cohort does, whatever the study file says."""
    file: str = ""
    """Of the cohort, if there is one."""
    people: int = 0
    left_out: int = 0
    """People whose fold is left out because this person is among them; 0 where this person is not."""
    notes: tuple[str, ...] = ()
    """Where it is from, in words."""
    sha256: str = ""
    """Of the file, hexadecimal."""

    def updated(self, other: JointPrior) -> JointPrior:
        """With what another one says of some of these parameters in its place, independent of the rest."""
        at = [self.names.index(name) for name in other.names]
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[at], covariance[:, at] = 0.0, 0.0
        mean[at], covariance[np.ix_(at, at)] = other.mean, other.covariance
        return replace(self, mean=mean, covariance=covariance)

    def held_near(self, names: Sequence[str]) -> str:
        """What those of some joint parameters that no trial shows stay near, in words; empty: their nominal values."""
        if set(names) & set(self.of_cohort):
            return "what the cohort has"
        return "what the study file expects" if set(names) & set(self.of_study) else ""


def _sides() -> dict[str, tuple[str, ...]]:
    out: dict[str, tuple[str, ...]] = {name: (name,) for name in JP_NAMES}
    for name in JP_NAMES:
        joint, _, rest = name.partition(".")
        if joint[-2:] in ("_r", "_l"):
            plain = f"{joint[:-2]}.{rest}"
            out[plain] = (*out.get(plain, ()), name)
    return out


SIDES_OF = _sides()
"""Name of a joint parameter, with or without its side -> the one, or both of them."""


def require_joint_prior(settings: CalibrationSettings, source: Path | str) -> None:
    """InputError where `joint_prior` names what is no joint parameter, or the settings take no priors."""
    field = "calibration.joint_prior"
    for name in settings.joint_prior:
        if name not in SIDES_OF:
            allowed = nearest(name, SIDES_OF) or "; allowed: those of parameters.csv, with or without their side"
            message = f"found {shown(name)}, which is no joint parameter{allowed}"
            raise InputError(message, source=source, field=field, code=Code.UNKNOWN_FIELD)
    if settings.joint_prior and not settings.takes_priors:
        message = "allowed only with protocol = 'evidence' and jp = true"
        raise InputError(message, source=source, field=field, code=Code.PRIORS)
