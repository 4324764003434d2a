"""Priors of joint parameters.

Deviations d from nominal values are N(m0, P0): from anatomy (`TABLE`), with means and
deviations of a study file (`[calibration] joint_prior`) if any, or from a cohort, which replaces
both (`combine_joint_priors`).

A joint centre is one position of one bone end, described in two segments: hip in pelvis and thigh,
knee in thigh and shank, the talus in shank and foot, and the subtalar axis in talus and foot. An
error of a landmark or regression is the same in both. In each direction

    cov(parent, child) = [ d^2   d^2       ]      d: the centre about its nominal position,
                         [ d^2   d^2 + a^2 ]      a: difference between the two segments.

The lower triangle [d, 0; d, a] is the Cholesky root F of that: its columns are the causes, the
error of the centre under the parent's name and the difference under the child's. Markers that are
attached again move the centre in both segments alike (`make_shared_centre_covariance`), and do not
change the second cause.

`TABLE` has mean, d and a; their sources:

hip         Harrington's regression against computed tomography of 29 people, 39 hips: 6.5 mm
            forward, 6.9 up, 7.0 lateral (SD; landmarks of Fischer 2019 to 2023; `python -m
            scripts.validation people --parts hips`). Palpation and flesh over the ASIS come on top,
            10, 8 and 6 mm (Della Croce et al., Gait Posture 21:226-237, 2005): 11.9, 10.6 and 9.2
            together, known to a tenth. The means, 2.3, 1.9 and 0.2 mm, differ between both sources
            by 4 mm, and flesh moves markers the other way: none is taken.
knee        five raters put the middle of the epicondyles of 19 femurs in images within 1.7 mm along
            each axis, and their line within 2 degrees; palpated ones scatter by some 4 mm and 5 to
            10 degrees about the thigh, by less in the frontal plane (Della Croce 2005). The axis
            about which tracked bones flex is 10 mm (RMS along each axis, four people) and 5 degrees
            from the transepicondylar one (`bones`).
talocrural  its axis runs just below the tips of the malleoli (Inman 1976), markers sit on their
            most prominent points, in front of its middle: 5 mm behind and 10 mm below; axes of
            living ankles scatter by 9 to 11 degrees.
subtalar    deviates by 23 +- 11 degrees (nominal) from the midline of cadavers' feet (Inman 1976),
            by 18 +- 16 of living ones (van den Bogert et al., J Biomech 27:1477-1488, 1994): one
            axis, described in talus and foot. It is inclined by 42 +- 9 degrees, so the scatter in
            the talus is smaller (12 for 16 in the foot: common 14, difference 6); its position is
            that of the talocrural axis.
others      20 mm and 10 degrees: landmarks of trunk and arms, which one hinge or ball stands for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, ParameterKind
from gaitcal.model.subject_model import PointNoise
from gaitcal.study.cohort_prior import SIDES_OF
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import ParameterPriorTable


@dataclass(frozen=True, kw_only=True)
class _Row:
    """One direction of one joint, in mm or deg."""

    parameters: tuple[str, ...]  # Parent's, then child's, without side
    deviation: float
    segment_difference: float = 0.0
    mean: float = 0.0

    @property
    def by_side(self) -> tuple[list[int], ...]:
        """Indices of its parameters, for each side."""
        right, left = list[int](), list[int]()
        for name in self.parameters:
            right_name, left_name = SIDES_OF[name]
            right.append(JP_INDEX[right_name])
            left.append(JP_INDEX[left_name])
        return right, left


def _make_rows(
    joint: str,
    parent: str,
    child: str,
    directions: str,
    deviation: Sequence[float],
    difference: float,
) -> tuple[_Row, ...]:
    """Make the rows of a bone end in two adjacent segments."""
    return tuple(
        _Row(
            parameters=(f"{joint}.{parent}.{name}", f"{joint}.{child}.{name}"),
            deviation=d,
            segment_difference=difference,
        )
        for name, d in zip(directions.split(), deviation, strict=True)
    )


TABLE: tuple[_Row, ...] = (
    *_make_rows("hip", "pelvis", "thigh", "ant sup lat", (12.0, 10.0, 9.0), 4.0),
    *_make_rows("knee", "thigh", "shank", "ant sup", (10.0, 10.0), 4.0),
    _Row(parameters=("knee.shank.lat",), deviation=10.0),
    *_make_rows("knee", "thigh", "shank", "front trans", (6.0, 10.0), 4.0),
    _Row(
        parameters=("talocrural.shank.ant", "subtalar.foot.ant"),
        deviation=8.0,
        segment_difference=5.0,
        mean=-5.0,
    ),
    _Row(
        parameters=("talocrural.shank.sup", "subtalar.foot.sup"),
        deviation=8.0,
        segment_difference=5.0,
        mean=-10.0,
    ),
    _Row(
        parameters=("talocrural.shank.lat", "subtalar.foot.lat"),
        deviation=8.0,
        segment_difference=5.0,
    ),
    _Row(
        parameters=("subtalar.talus.trans", "subtalar.foot.trans"),
        deviation=14.0,
        segment_difference=6.0,
        mean=-4.0,
    ),
)
"""Joints of the legs; all others have `OTHER_MM` or `OTHER_DEG`."""
OTHER_MM, OTHER_DEG = 20.0, 10.0
OTHER_DEVIATIONS = np.where(
    [p.kind is ParameterKind.POSITION for p in JOINT_PARAMETERS], OTHER_MM, OTHER_DEG
)  # (98,) mm, deg


def _find_shared_parameters() -> IntArray:
    """Find the parameter whose error each joint parameter shares."""
    out = np.arange(len(JP_NAMES))
    for row in TABLE:
        for indices in row.by_side:
            out[indices] = indices[0]
    return out


SHARED_PARAMETER_INDEX = _find_shared_parameters()
"""(98,) index of the parameter with the same joint centre error: that of the same direction in the
parent segment; of all others their index.
"""


def make_shared_centre_covariance(deviation: Array) -> Array:
    """Make the covariance of joint centre errors that both adjacent segments share.

    Parameters
    ----------
    deviation : (98,) array
        Standard deviations, m and rad; of a shared error that of the parent segment is used.

    Returns
    -------
    (98, 98) array
        m^2, m rad and rad^2.
    """
    size = deviation[SHARED_PARAMETER_INDEX]
    return np.outer(size, size) * (SHARED_PARAMETER_INDEX[:, None] == SHARED_PARAMETER_INDEX)


def _make_anatomy_prior() -> JointPrior:
    """Make the prior of anatomy from `TABLE`."""
    mean, difference = np.zeros(len(JP_NAMES)), np.zeros(len(JP_NAMES))
    deviation = OTHER_DEVIATIONS.copy()
    for row in TABLE:
        for side, indices in enumerate(row.by_side):
            mirrored = np.array([JOINT_PARAMETERS[k].mirrored for k in indices])
            mean[indices] = row.mean * np.where(mirrored & (side == 1), -1.0, 1.0)
            deviation[indices], difference[indices[1:]] = row.deviation, row.segment_difference
    covariance = make_shared_centre_covariance(JP_TO_SI * deviation) + np.diag(
        (JP_TO_SI * difference) ** 2
    )
    return JointPrior(names=JP_NAMES, mean=JP_TO_SI * mean, covariance=covariance)


ANATOMY = _make_anatomy_prior()
WEAK = JointPrior(
    names=JP_NAMES,
    mean=np.zeros(len(JP_NAMES)),
    covariance=np.diag((JP_TO_SI * OTHER_DEVIATIONS) ** 2),
)
"""Of the published protocol, where it has one (`prior = "weak"`): the same for all joints, none
tied to another.
"""
MEAN, COVARIANCE = ANATOMY.mean, ANATOMY.covariance


def get_prior_deviations(names: Sequence[str]) -> Array:
    """Get standard deviations (n,) of joint parameters by anatomy, m and rad."""
    return np.sqrt(np.diag(COVARIANCE))[[JP_INDEX[name] for name in names]]


def select_prior(names: Sequence[str], prior: JointPrior | None) -> tuple[Array, Array]:
    """Select the prior of deviations from nominal values for some joint parameters.

    Parameters
    ----------
    names : sequence of str
        Joint parameters.
    prior : JointPrior or None
        Prior of some parameters; anatomy's for the others.

    Returns
    -------
    tuple of array
        Mean m0 (n,) and covariance P0 (n, n), m and rad.
    """
    at, whole = (
        [JP_INDEX[name] for name in names],
        ANATOMY if prior is None else ANATOMY.update(prior),
    )
    return whole.mean[at], whole.covariance[np.ix_(at, at)]


def factor_prior(names: Sequence[str], prior: JointPrior | None) -> Array:
    """Factor the prior covariance: F (n, n), lower triangular, F F^T = P0.

    Parameters
    ----------
    names : sequence of str
        Joint parameters.
    prior : JointPrior or None
        As in `select_prior`.

    Returns
    -------
    (n, n) array
        Each column is the effect of one cause, under its parameter's name.
    """
    return np.asarray(np.linalg.cholesky(select_prior(names, prior)[1]), float)


def combine_joint_priors(
    given: Mapping[str, ParameterPriorTable],
    learnt: JointPrior | None = None,
    noise: PointNoise | None = None,
) -> JointPrior:
    """Make the prior of all joint parameters by anatomy, study file and cohort.

    A study file gives mean and standard deviation of a parameter, and correlations stay those of
    anatomy. Rows and columns of P0 are scaled. Both parameters of a shared centre, with deviations
    d and e and correlation c, may then differ by (d^2 + e^2 - 2 c d e)^1/2. A name without a side
    is for both, the left as the mirror image of the right. A name with a side takes precedence.

    Parameters
    ----------
    given : mapping of str to ParameterPriorTable
        Entries of the study file, mm and deg; they replace anatomy's.
    learnt : JointPrior, optional
        Prior of a cohort; it replaces both.
    noise : PointNoise, optional
        For points that are no markers: anatomy's deviations times `joints`, for hinges times
        `hinges`.

    Returns
    -------
    JointPrior
        m and rad.
    """
    mean, scale = MEAN.copy(), np.ones(len(JP_NAMES))
    if noise is not None:
        positions = [p.kind is ParameterKind.POSITION for p in JOINT_PARAMETERS]
        scale = np.where(positions, noise.joints, noise.hinges)
    for name in sorted(given, key=lambda name: name in JP_INDEX):
        for side, parameter in enumerate(SIDES_OF[name]):
            k, entry = JP_INDEX[parameter], given[name]
            if entry.mean is not None:
                mean[k] = (
                    JP_TO_SI[k]
                    * entry.mean
                    * (-1.0 if side and JOINT_PARAMETERS[k].mirrored else 1.0)
                )
            if entry.deviation is not None:
                scale[k] = JP_TO_SI[k] * entry.deviation / np.sqrt(COVARIANCE[k, k])
    of_study = tuple(dict.fromkeys(parameter for name in given for parameter in SIDES_OF[name]))
    notes = (f"priors from the study file: {', '.join(given)}",) if given else ()
    covariance = np.outer(scale, scale) * COVARIANCE
    prior = replace(ANATOMY, mean=mean, covariance=covariance, of_study=of_study, notes=notes)
    if learnt is None:
        return prior
    return replace(prior.update(learnt), of_cohort=learnt.names, notes=(*notes, *learnt.notes))
