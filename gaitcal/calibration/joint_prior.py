"""What is known of a joint parameter before any trial is looked at, and how much of what a trial then says is noise.

Deviations d from nominal values are N(m0, P0): by anatomy (`TABLE`), of which a study file may change means and
deviations (`[calibration] joint_prior`), and what a cohort has learnt takes the place of both (`prior_of_study`).

A joint's centre is one place of one bone end, seen from two segments: hip in pelvis and thigh, knee in thigh and shank,
the talus in shank and foot, and the subtalar axis in talus and foot. A landmark or regression that misses it misses it
in both. In each direction

    cov(parent, child) = [ d^2   d^2       ]      d: the centre about its nominal place,
                         [ d^2   d^2 + a^2 ]      a: how far apart the two segments may have it.

The lower triangle [d, 0; d, a] is the Cholesky root F of that: its columns are the causes, the error of the centre
under the parent's name and that of being apart under the child's. Markers that are put on anew move the centre, in both
views alike (`in_both_views`), and leave the second cause as it is.

`TABLE` holds mean, d and a; what they rest on:

hip         Harrington's regression against computed tomography of 29 people, 39 hips: 6.5 mm forward, 6.9 up, 7.0
            lateral (SD; landmarks of Fischer 2019 to 2023; `python -m scripts.validation people --parts hips`).
            Palpation and flesh over the ASIS come on top, 10, 8 and 6 mm (Della Croce et al., Gait Posture 21:226-237,
            2005): 11.9, 10.6 and 9.2 together, known to a tenth. The means, 2.3, 1.9 and 0.2 mm, differ between both
            sources by 4 mm, and flesh moves markers the other way: none is taken.
knee        five raters put the middle of the epicondyles of 19 femurs in images within 1.7 mm along each axis, and
            their line within 2 degrees; palpated ones scatter by some 4 mm and 5 to 10 degrees about the thigh, by less
            in the frontal plane (Della Croce 2005). The axis about which tracked bones flex is 10 mm (RMS along each
            axis, four people) and 5 degrees from the transepicondylar one (`bones`).
talocrural  its axis runs just below the tips of the malleoli (Inman 1976), markers sit on their most prominent points,
            in front of its middle: 5 mm behind and 10 mm below; axes of living ankles scatter by 9 to 11 degrees.
subtalar    deviates by 23 +- 11 degrees (nominal) from the midline of cadavers' feet (Inman 1976), by 18 +- 16 of
            living ones (van den Bogert et al., J Biomech 27:1477-1488, 1994): one axis, seen from talus and foot. It is
            42 +- 9 degrees steep, by which the talus's turn about it is smaller (12 for 16 in the foot: 14, and 6
            apart); its place goes with the talocrural one.
others      20 mm and 10 degrees: landmarks of trunk and arms, which one hinge or ball stands for.

Noise of a trial: the part of the markers' errors that a joint can see. A segment's markers follow the segment (its
rigid fit) up to their deformation; the linkage follows the rigid fits up to what its joints forbid. Joint parameters
act on the second part alone. With d the difference between the markers of the rigid fits and those of the linkage,
smoothed by the trial's splines, c = 6 (segments) - (coordinates) the directions that the joints forbid, and nf frames,

    nu^2 = tau / (c nf) * sum |d|^2 * n / (n - p),      tau = 1 + 2 sum_k rho_k,      n = c nf / tau,

rho_k the autocorrelation of d (summed until it first falls below 0.05; Bartlett 1946), n the independent samples and p
the joint parameters that these have to serve. A cost divided by nu^2 counts every frame as if it were independent: slow
noise in a short trial weighs little. White noise of variance s^2 gives nu = s; clusters that move as a whole against
their bones give more than their deformation tells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, JP_TO_SI, Kind, Parameters
from gaitcal.model.subject_model import PointNoise
from gaitcal.motion import rigid, spline, trial_problem
from gaitcal.study.joint_prior import SIDES_OF, JointPrior
from gaitcal.study.settings import ParameterPriorTable


@dataclass(frozen=True, kw_only=True)
class _Row:
    """One direction of one joint, in mm or deg."""

    parameters: tuple[str, ...]  # Parent's, then child's, without side
    deviation: float
    apart: float = 0.0
    mean: float = 0.0

    @property
    def by_side(self) -> tuple[list[int], ...]:
        """Of each side, the indices of its parameters."""
        return tuple([JP_INDEX[SIDES_OF[name][side]] for name in self.parameters] for side in (0, 1))


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
    _Row(parameters=("subtalar.talus.trans", "subtalar.foot.trans"), deviation=14.0, apart=6.0, mean=-4.0),
)
"""Joints of the legs; what is not here has `OTHER_MM` or `OTHER_DEG`."""
OTHER_MM, OTHER_DEG = 20.0, 10.0
OTHER = np.where([p.kind is Kind.POSITION for p in JOINT_PARAMETERS], OTHER_MM, OTHER_DEG)  # (98,) mm, deg


def _first_views() -> IntArray:
    out = np.arange(len(JP_NAMES))
    for row in TABLE:
        for own in row.by_side:
            out[own] = own[0]
    return out


FIRST_VIEW = _first_views()
"""(98,) of every joint parameter, the parent's of the same direction of the same bone end; itself where none is."""


def in_both_views(deviation: Array) -> Array:
    """(98, 98) covariance of errors of bone ends, each the same in both segments that see it; `deviation`: (98,), of
    which those of first views count.
    """
    size = deviation[FIRST_VIEW]
    return np.outer(size, size) * (FIRST_VIEW[:, None] == FIRST_VIEW)


def _anatomy() -> JointPrior:
    mean, apart = np.zeros(len(JP_NAMES)), np.zeros(len(JP_NAMES))
    deviation = OTHER.copy()
    for row in TABLE:
        for side, own in enumerate(row.by_side):
            mirrored = np.array([JOINT_PARAMETERS[k].mirrored for k in own])
            mean[own] = row.mean * np.where(mirrored & (side == 1), -1.0, 1.0)
            deviation[own], apart[own[1:]] = row.deviation, row.apart
    covariance = in_both_views(JP_TO_SI * deviation) + np.diag((JP_TO_SI * apart) ** 2)
    return JointPrior(names=JP_NAMES, mean=JP_TO_SI * mean, covariance=covariance)


ANATOMY = _anatomy()
WEAK = JointPrior(names=JP_NAMES, mean=np.zeros(len(JP_NAMES)), covariance=np.diag((JP_TO_SI * OTHER) ** 2))
"""Of the published protocol, where it has one (`prior = "weak"`): the same for all joints, none tied to another."""
MEAN, COVARIANCE = ANATOMY.mean, ANATOMY.covariance


def prior_deviations(names: Sequence[str]) -> Array:
    """(n,) m, rad: standard deviations of joint parameters by anatomy."""
    return np.sqrt(np.diag(COVARIANCE))[[JP_INDEX[name] for name in names]]


def prior_of(names: Sequence[str], prior: JointPrior | None) -> tuple[Array, Array]:
    """(n,) m, rad and (n, n): mean m0 and covariance P0 of deviations from nominal values; anatomy's where `prior` says
    nothing of a parameter.
    """
    at, whole = [JP_INDEX[name] for name in names], ANATOMY if prior is None else ANATOMY.updated(prior)
    return whole.mean[at], whole.covariance[np.ix_(at, at)]


def prior_root(names: Sequence[str], prior: JointPrior | None) -> Array:
    """(n, n) F, lower triangular, F F^T = P0: each column what one cause does, under its parameter's name."""
    return np.asarray(np.linalg.cholesky(prior_of(names, prior)[1]), float)


def prior_of_study(
    told: Mapping[str, ParameterPriorTable], learnt: JointPrior | None = None, noise: PointNoise | None = None
) -> JointPrior:
    """What is expected of all joint parameters: by anatomy, by a study file in its place, by a cohort in that of both.

    Anatomy's deviations are for palpated markers; points that are no markers have `noise.joints` times these,
    hinges `noise.hinges` times.

    A study file tells mean and standard deviation of a parameter; correlations stay as anatomy has them. Rows and
    columns of P0 are scaled, so that two views of one bone end to which it gives d and e, of correlation c, may be
    (d^2 + e^2 - 2 c d e)^1/2 apart. Without a side a name is for both, the left as the mirror image of the right one;
    what is said of a side comes before that.
    """
    mean, scale = MEAN.copy(), np.ones(len(JP_NAMES))
    if noise is not None:
        positions = [p.kind is Kind.POSITION for p in JOINT_PARAMETERS]
        scale = np.where(positions, noise.joints, noise.hinges)
    for name in sorted(told, key=lambda name: name in JP_INDEX):
        for side, own in enumerate(SIDES_OF[name]):
            k, said = JP_INDEX[own], told[name]
            if said.mean is not None:
                mean[k] = JP_TO_SI[k] * said.mean * (-1.0 if side and JOINT_PARAMETERS[k].mirrored else 1.0)
            if said.deviation is not None:
                scale[k] = JP_TO_SI[k] * said.deviation / np.sqrt(COVARIANCE[k, k])
    of_study = tuple(dict.fromkeys(own for name in told for own in SIDES_OF[name]))
    notes = (f"the study file says what to expect of {', '.join(told)}",) if told else ()
    covariance = np.outer(scale, scale) * COVARIANCE
    prior = replace(ANATOMY, mean=mean, covariance=covariance, of_study=of_study, notes=notes)
    if learnt is None:
        return prior
    return replace(prior.updated(learnt), of_cohort=learnt.names, notes=(*notes, *learnt.notes))


UNCORRELATED = 0.05  # Autocorrelation below which the sum ends
LONGEST_LAG = 1.0 / 3.0  # Of the trial: beyond, too few pairs of frames are left
LEAST_SAMPLES = 0.3  # Part of the independent samples that is left at least, however many parameters they serve
LEAST_ERROR, MEMORY_S = 5e-5, 0.25  # m, s: cameras err by at least this much, over at least this time


@dataclass(frozen=True)
class ForbiddenNoise:
    """The noise of one trial in the directions that its joints forbid."""

    variance: float  # m^2, tau times the mean square of d per direction and frame
    samples: float  # n, independent ones


def frames_per_sample(errors: Array, seen: BoolArray | None = None) -> float:
    """Tau of errors (nf, k): frames for one that is independent, all columns taken together; pairs of `seen` frames."""
    nf = len(errors)
    known = np.ones(nf) if seen is None else seen.astype(np.float64)
    spectrum = np.abs(np.fft.rfft(errors * known[:, None], 2 * nf, axis=0)) ** 2
    power = np.fft.irfft(spectrum.sum(axis=1))[:nf]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(known, 2 * nf)) ** 2)[:nf]
    if power[0] <= 0.0:
        return 1.0
    lags = np.arange(1, max(int(nf * LONGEST_LAG), 2))
    rho = power[lags] / power[0] * pairs[0] / np.maximum(pairs[lags], 1.0)
    small = np.flatnonzero(rho < UNCORRELATED)
    return 1.0 + 2.0 * float(rho[: small[0] if len(small) else None].sum())


def least_noise(basis: spline.SplineBasis, noise: PointNoise | None = None) -> float:
    """m, nu below which nothing is believed: that of the cameras, at the frames of a trial, or that of points that are
    no markers.
    """
    if noise is not None:
        return noise.least(spline.frame_rate(basis))
    return LEAST_ERROR * float(np.sqrt(max(MEMORY_S * spline.frame_rate(basis), 1.0)))


def forbidden_noise(
    problem: trial_problem.MotionProblem, parameters: Parameters, coefficients: Array
) -> ForbiddenNoise:
    """The noise at a motion, coefficients (nn, nq).

    Segments of fewer than three markers have no rigid fit, and leave their joints out. Where no joint is left, d is
    what the linkage leaves of the markers themselves, in c = 3 (markers) - (coordinates) directions.
    """
    chain, count = problem.chain, len(problem.chain.coordinates)
    gap, segments, visible = _rigid_gap(problem, parameters, coefficients)
    carried = chain.support[:count][problem.active][:, segments].any(axis=1)
    directions = 6 * len(segments) - int(carried.sum())
    if directions < 1:
        data = problem.data
        gap = problem.positions(coefficients, problem.body(parameters)) - data.measured
        gap *= np.sqrt(data.weight)[:, None]
        pulling = (data.weight > 0).sum(axis=0)
        visible = pulling > pulling.max(initial=0) // 2
        directions = max(3 * int(np.median(pulling[visible])) - int(problem.active.sum()), 1)
    nf = max(int(visible.sum()), 1)
    flat = gap.reshape(-1, len(visible)).T
    smooth = problem.basis.evaluate(problem.basis.fit(flat)) * visible[:, None]
    tau = frames_per_sample(smooth, visible)
    return ForbiddenNoise(tau * float((smooth**2).sum()) / (directions * nf), directions * nf / tau)


def _rigid_gap(
    problem: trial_problem.MotionProblem, parameters: Parameters, coefficients: Array
) -> tuple[Array, list[int], BoolArray]:
    """(nm, 3, nf) m, weighted, from the linkage to the rigid fits; the segments that have one; and the frames (nf,) in
    which all of them do.
    """
    data = problem.data
    gap, segments = np.zeros_like(data.measured), list[int]()
    visible = np.ones(data.weight.shape[1], dtype=bool)
    model = problem.positions(coefficients, problem.body(parameters))
    for segment, markers in data.placed.groups:
        weight = data.weight[markers]
        if ((weight > 0).any(axis=1)).sum() < rigid.FEWEST_MARKERS:
            continue
        fit = rigid.rigid_fit(data.local[markers], data.measured[markers], weight)
        followed = np.einsum("fij,mj->mif", fit.rotation, data.local[markers]) + fit.origin.T
        gap[markers] = np.sqrt(weight)[:, None] * (followed - model[markers]) * fit.determined
        segments.append(segment)
        visible &= fit.determined
    return gap, segments, visible


def trial_noises(seen: Sequence[ForbiddenNoise], least: Sequence[float], effective_parameters: float) -> list[float]:
    """m, nu of every trial of a fit in which so many parameters were found from the samples of all of them."""
    samples = sum(trial.samples for trial in seen)
    spent = samples / max(samples - effective_parameters - 2.0, LEAST_SAMPLES * samples)
    return [max(float(np.sqrt(spent * s.variance)), floor) for s, floor in zip(seen, least, strict=True)]
