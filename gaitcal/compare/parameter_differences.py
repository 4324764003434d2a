"""Joint parameters of two sessions, each in its own segment frames, and the error bars of their differences.

Errors of a calibration come by source (`calibration/joint_estimate.py`): columns M of the markers of its trials, N of
the nominal joints, Z of the skin. Markers of different recordings are independent. On one static trial the nominal
joints are wrong by the same in both, and markers sit on the same skin, so that columns meet by name:

    se^2 = |M_A|^2 + |M_B|^2 + |N_B - N_A|^2 + |Z_B - Z_A|^2.

With a static trial each, of the deviation d of joints from their nominal values (covariance P0 = F F^T of causes, to
which the columns of N belong; `calibration/joint_prior.py`) a part is the person's own, the same in both, and a part Q
comes from where the markers were put this time: p^2 in both views of a bone end, whose nominal place is one point of
the laboratory. The latter turns and shifts the segment frames, in which the joints are told, too: it counts in full,
once for each session,

    se^2 = |M_A|^2 + |M_B|^2 + |N_B R_B - N_A R_A|^2 + |Z_A|^2 + |Z_B|^2 + 2 p^2,      R R^T = 1 - F^-1 Q F^-T,

which is diagonal by anatomy: 1 - p^2 / sigma^2 of a bone end's place, 1 of how far apart its two views are. p by
`placement`: 6 mm of a position along each axis (palpated landmarks scatter by 10 mm, Della Croce et al. 2005), and
of an orientation what landmarks turn the segment by (`dynamics/axis_errors.py`). A talus has no landmarks: the angle
between its axes is nominally that between axes of shank and foot, and as wrong as both.

Markers are independent in this; on skin that moves alike in two walks they are not, and bars are then rather too wide:
walk against walk of one person scatters by 0.4 of them. Between walks of two kinds they are a little too narrow by what
skin does that no marker shows: straight walks against turns of four children, with two markers on each thigh, have 75 %
inside bars of 68, 93 inside those of 95 (68 and 87 while those thighs were taken to be still,
`python -m scripts.validation people`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import in_both_views, prior_root
from gaitcal.compare.difference import Difference
from gaitcal.compare.session import Common, Session
from gaitcal.dynamics.axis_errors import PALPATED_DEG
from gaitcal.model.linkage import segment_kind
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Kind
from gaitcal.study.joint_prior import JointPrior

PLACED = 0.006
"""m, of a landmark along each axis."""
NOMINAL, SKIN, FOUND = "nominal/", "skin/", "skin/found"
"""How columns of an `ErrorSources` begin, and the skin's one that moves no joint."""


def placement(names: Sequence[str]) -> Array:
    """(n,) m, rad: what markers that are put on anew do to joint parameters told in the frames they make."""
    out = []
    for name in names:
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        segment = segment_kind(p.segment)
        if p.kind is Kind.POSITION:
            out.append(PLACED)
        elif segment.palpated is None:
            out.append(float(np.deg2rad(np.hypot(PALPATED_DEG["shank"][1], PALPATED_DEG["foot"][1]))))
        else:
            out.append(float(np.deg2rad(segment.palpated[p.axis])))
    return np.array(out)


def told_parameters(influence: ErrorSources | None) -> tuple[str, ...]:
    """Joint parameters that markers told something of."""
    if influence is None:
        return ()
    markers = np.array([not c.startswith(NOMINAL) for c in influence.clusters])
    told = (influence.parameters[:, markers] != 0.0).any(axis=1)
    return tuple(name for name, seen in zip(influence.free, told, strict=True) if seen and name in JP_INDEX)


def parameter_differences(a: Session, b: Session, common: Common) -> Iterator[Difference]:
    """Every joint parameter that both calibrations fitted."""
    known = set(told_parameters(b.influence))
    names = tuple(name for name in told_parameters(a.influence) if name in known)
    if not names or a.influence is None or b.influence is None:
        return
    errors = np.sqrt(difference_variance((a.influence, b.influence), names, common, (a.prior, b.prior)))
    for name, error in zip(names, errors, strict=True):
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        of_a, of_b = (s.model.parameters.joint[JP_INDEX[name]] / p.kind.to_si for s in (a, b))
        yield Difference(
            kind=f"joint {'position' if p.kind is Kind.POSITION else 'orientation'}",
            side=p.joint[-1] if p.joint[-2:] in ("_r", "_l") else "",
            name=name,
            measure="",
            unit=p.kind.unit,
            a=float(of_a),
            b=float(of_b),
            se_strides=0.0,
            se_shared=float(error / p.kind.to_si),
            strides_a=0,
            strides_b=0,
        )


def difference_variance(
    both: tuple[ErrorSources, ErrorSources],
    names: Sequence[str],
    common: Common,
    priors: tuple[JointPrior | None, JointPrior | None] = (None, None),
) -> Array:
    """(n,) m^2, rad^2: variance of differences of joint parameters `names`. `priors`: of each; None: anatomy's."""
    if common is Common.MODEL:
        return np.zeros(len(names))
    of_a, of_b = (_columns(influence, names) for influence in both)
    shared = common is Common.STATIC
    causes = [name for name in JP_NAMES if NOMINAL + name in {*of_a, *of_b}]
    nominal = []
    for columns, prior in zip((of_a, of_b), priors, strict=True):
        found = [columns.pop(NOMINAL + name, np.zeros(len(names))) for name in causes]
        own = np.array(found).reshape(len(causes), len(names)).T
        nominal.append(own if shared else own @ own_causes(causes, prior))
    out = ((nominal[1] - nominal[0]) ** 2).sum(axis=1) + (0.0 if shared else 2.0 * placement(names) ** 2)
    for column in dict.fromkeys((*of_a, *of_b)):
        one, other = of_a.get(column), of_b.get(column)
        if shared and column.startswith(SKIN) and column != FOUND and one is not None and other is not None:
            out = out + (other - one) ** 2
        else:
            out = out + sum(c**2 for c in (one, other) if c is not None)
    return np.asarray(out)


def own_causes(names: Sequence[str], prior: JointPrior | None) -> Array:
    """(n, n) R, symmetric: of the causes e of nominal errors F e, R R^T is the covariance of what is the person's own
    rather than the markers', nothing of it negative.
    """
    root = prior_root(names, prior)
    index = [JP_INDEX[name] for name in names]
    half = np.linalg.solve(root, in_both_views(placement(JP_NAMES))[np.ix_(index, index)])
    values, vectors = np.linalg.eigh(np.eye(len(names)) - np.linalg.solve(root, half.T))
    out: Array = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return out


def _columns(influence: ErrorSources, names: Sequence[str]) -> dict[str, Array]:
    """Source -> (n,) what it does to the joint parameters `names`."""
    rows = influence.parameters[[influence.free.index(name) for name in names]]
    return dict(zip(influence.clusters, rows.T, strict=True))
