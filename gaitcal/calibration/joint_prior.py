"""How far a joint parameter may lie from its nominal value: what is known of people before any trial is looked at.

A nominal joint comes from landmarks and regressions. Hip centres of regressions miss those of imaging by 15 to 30 mm
(Leardini et al., J Biomech 32:99-103, 1999; Sangeux, Peters and Baker, Gait Posture 34:324-328, 2011), landmarks are
placed with a scatter of 6 to 21 mm (Della Croce et al., Gait Posture 21:226-237, 2005), and the axes of living ankles
scatter by 9 to 11 degrees (Inman 1976).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.study.joint_prior import JointPrior

POSITION = 0.020
"""m, standard deviation of a coordinate of a joint's place about its nominal value."""
ORIENTATION = np.deg2rad(10.0)
"""rad, of a turn of a joint's axis."""
ROUNDED = 1e-6
"""Of a variance: what the digits of a file of priors leave open."""


def prior_deviations(names: Sequence[str]) -> Array:
    """(n,) m, rad: standard deviations of joint parameters about their nominal values."""
    position = [JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION for name in names]
    return np.where(position, POSITION, ORIENTATION)


def prior_of(names: Sequence[str], learnt: JointPrior | None) -> tuple[Array, Array]:
    """(n,) m, rad and (n, n): mean and covariance of deviations from nominal values; by default alone where nothing
    is learnt of a parameter.
    """
    mean, covariance = np.zeros(len(names)), np.diag(prior_deviations(names) ** 2)
    if learnt is not None:
        own = [k for k, name in enumerate(names) if name in learnt.names]
        there = [learnt.names.index(names[k]) for k in own]
        mean[own] = learnt.mean[there]
        covariance[np.ix_(own, own)] = learnt.covariance[np.ix_(there, there)]
    return mean, covariance


def leans_on_cohort(names: Sequence[str], learnt: JointPrior | None) -> bool:
    """Whether a cohort expects something else of some of these joint parameters than the default prior does."""
    mean, covariance = prior_of(names, learnt)
    default = prior_deviations(names)
    unlike = covariance / np.outer(default, default) - np.eye(len(names))
    return bool(mean.any() or (np.abs(unlike) > ROUNDED).any())
