"""How far a joint parameter may lie from its nominal value: what is known of people before any trial is looked at.

A joint's centre is one place of one bone end, seen from two segments: hip in pelvis and thigh, knee in thigh and shank,
the talus in shank and foot. A landmark or regression that misses it misses it in both. In each direction

    cov(parent, child) = [ d^2   d^2       ]      d: the centre about its nominal place,
                         [ d^2   d^2 + a^2 ]      a: how far apart the two segments may have it.

`TABLE` holds mean, d and a; what they rest on:

hip         Harrington's regression against computed tomography of ten people, twenty hips: 7.1 mm forward, 6.4 up, 6.5
            lateral (SD; bias at most 2; landmarks of Fischer 2021). Palpation and flesh over the ASIS come on top, some
            10 mm (Della Croce et al., Gait Posture 21:226-237, 2005).
knee        epicondyles are placed with a scatter of some 10 mm, which turns the axis by 5 to 10 degrees about the thigh
            and by less in the frontal plane (Della Croce 2005); the axis of flexion lies within 3 degrees of the
            transepicondylar one (Churchill et al., Clin Orthop 356:111-118, 1998).
talocrural  its axis runs just below the tips of the malleoli (Inman 1976), markers sit on their most prominent points,
            in front of its middle: 5 mm behind and 10 mm below; axes of living ankles scatter by 9 to 11 degrees.
subtalar    23 +- 11 and 42 +- 9 degrees (Inman 1976); its place goes with the talocrural one.
others      20 mm and 10 degrees: landmarks of trunk and arms, which one hinge or ball stands for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, Kind
from gaitcal.records import dataclass
from gaitcal.study.joint_prior import JointPrior


@dataclass(frozen=True, kw_only=True)
class _Row:
    """One direction of one joint, in mm or deg."""

    parameters: tuple[str, ...]
    """Parent's, then child's, without side."""
    deviation: float
    apart: float = 0.0
    mean: float = 0.0


def _seen_twice(
    joint: str, parent: str, child: str, directions: str, deviation: Sequence[float], apart: float
) -> tuple[_Row, ...]:
    return tuple(
        _Row(parameters=(f"{joint}.{parent}.{name}", f"{joint}.{child}.{name}"), deviation=d, apart=apart)
        for name, d in zip(directions.split(), deviation, strict=True)
    )


TABLE: tuple[_Row, ...] = (
    *_seen_twice("hip", "pelvis", "thigh", "ant sup lat", (12.0, 10.0, 9.0), 4.0),
    *_seen_twice("knee", "thigh", "shank", "ant sup", (10.0, 10.0), 4.0),
    _Row(parameters=("knee.shank.lat",), deviation=10.0),
    *_seen_twice("knee", "thigh", "shank", "front trans", (6.0, 10.0), 4.0),
    _Row(parameters=("talocrural.shank.ant", "subtalar.foot.ant"), deviation=8.0, apart=5.0, mean=-5.0),
    _Row(parameters=("talocrural.shank.sup", "subtalar.foot.sup"), deviation=8.0, apart=5.0, mean=-10.0),
    _Row(parameters=("talocrural.shank.lat", "subtalar.foot.lat"), deviation=8.0, apart=5.0),
)
"""Joints of the legs; what is not here has `OTHER_MM` or `OTHER_DEG`."""
OTHER_MM, OTHER_DEG = 20.0, 10.0
ROUNDED = 1e-6
"""Of a variance: what the digits of a file of priors leave open."""


def _anatomy() -> tuple[Array, Array]:
    """(98,) and (98, 98) mean and covariance of deviations from nominal values, m and rad."""
    position = np.array([p.kind is Kind.POSITION for p in JOINT_PARAMETERS])
    mean, covariance = np.zeros(len(JP_NAMES)), np.diag(np.where(position, OTHER_MM, OTHER_DEG) ** 2)
    for row in TABLE:
        for side in ("r", "l"):
            names = [name.replace(".", f"_{side}.", 1) for name in row.parameters]
            own = [JP_INDEX[name] for name in names]
            mean[own] = row.mean
            covariance[np.ix_(own, own)] = row.deviation**2
            if len(own) > 1:
                covariance[own[1], own[1]] += row.apart**2
    return JP_TO_SI * mean, np.outer(JP_TO_SI, JP_TO_SI) * covariance


MEAN, COVARIANCE = _anatomy()


def prior_deviations(names: Sequence[str]) -> Array:
    """(n,) m, rad: standard deviations of joint parameters about their nominal values."""
    return np.sqrt(np.diag(COVARIANCE))[[JP_INDEX[name] for name in names]]


def prior_of(names: Sequence[str], learnt: JointPrior | None) -> tuple[Array, Array]:
    """(n,) m, rad and (n, n): mean and covariance of deviations from nominal values; anatomy's alone where nothing is
    learnt of a parameter.
    """
    at = [JP_INDEX[name] for name in names]
    mean, covariance = MEAN[at].copy(), COVARIANCE[np.ix_(at, at)].copy()
    if learnt is not None:
        own = [k for k, name in enumerate(names) if name in learnt.names]
        there = [learnt.names.index(names[k]) for k in own]
        covariance[own], covariance[:, own] = 0.0, 0.0
        mean[own] = learnt.mean[there]
        covariance[np.ix_(own, own)] = learnt.covariance[np.ix_(there, there)]
    return mean, covariance


def leans_on_cohort(names: Sequence[str], learnt: JointPrior | None) -> bool:
    """Whether a cohort expects something else of some of these joint parameters than anatomy does."""
    (mean, covariance), (own, spread) = prior_of(names, learnt), prior_of(names, None)
    default = np.sqrt(np.diag(spread))
    unlike = (covariance - spread) / np.outer(default, default)
    return bool((np.abs(mean - own) > ROUNDED * default).any() or (np.abs(unlike) > ROUNDED).any())
