"""Joint parameters of two sessions, each in its own segment frames, and the error bars of their differences.

Errors of a calibration come by source (`calibration/joint_estimate.py`): columns M of the markers of its trials, N of
the nominal joints, Z of the skin. Markers of different recordings are independent. On one static trial the nominal
joints are wrong by the same in both, and markers sit on the same skin, so that columns meet by name:

    se^2 = |M_A|^2 + |M_B|^2 + |N_B - N_A|^2 + |Z_B - Z_A|^2.

With a static trial each, of the deviation of a joint from its nominal value (sigma, `calibration/joint_prior.py`) a
part is the person's own, the same in both, and a part comes from where the markers were put this time. The latter turns
and shifts the segment frames, in which the joints are told, too: it counts in full, once for each session,

    se^2 = |M_A|^2 + |M_B|^2 + |(N_B - N_A) r|^2 + |Z_A|^2 + |Z_B|^2 + 2 p^2,      r^2 = 1 - p^2 / sigma^2,

p by `placement`: 6 mm of a position along each axis (palpated landmarks scatter by 10 mm, Della Croce et al. 2005), and
of an orientation what landmarks turn the segment by (`dynamics/axis_errors.py`). A talus has no landmarks: the angle
between its axes is nominally that between axes of shank and foot, and as wrong as both.

Markers are independent in this; on skin that moves alike in two walks they are not, and bars are then rather too wide:
walk against walk of one person scatters by 0.4 of them. Between walks of two kinds they are a little too narrow by what
skin does that no marker shows: straight walks against turns of four children, with two markers on each thigh, have 75 %
inside bars of 68, 93 inside those of 95 (68 and 87 while those thighs were taken to be still,
`scripts/check_people.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.compare.difference import Difference
from gaitcal.compare.session import Common, Session
from gaitcal.dynamics.axis_errors import PALPATED_DEG
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind

PLACED = 0.006
"""m, of a landmark along each axis."""
NOMINAL, SKIN, FOUND = "nominal/", "skin/", "skin/found"
"""How columns of an `Influence` begin, and the skin's one that moves no joint."""


def placement(names: Sequence[str]) -> Array:
    """(n,) m, rad: what markers that are put on anew do to joint parameters told in the frames they make."""
    out = []
    for name in names:
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        segment = p.segment.removesuffix("_r").removesuffix("_l")
        if p.kind is Kind.POSITION:
            out.append(PLACED)
        elif segment == "talus":
            out.append(float(np.deg2rad(np.hypot(PALPATED_DEG["shank"][1], PALPATED_DEG["foot"][1]))))
        else:
            out.append(float(np.deg2rad(PALPATED_DEG[segment][p.axis])))
    return np.array(out)


def told_parameters(influence: Influence | None) -> tuple[str, ...]:
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
    errors = np.sqrt(difference_variance(a.influence, b.influence, names, common))
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


def difference_variance(a: Influence, b: Influence, names: Sequence[str], common: Common) -> Array:
    """(n,) m^2, rad^2: variance of the differences of joint parameters `names`."""
    if common is Common.MODEL:
        return np.zeros(len(names))
    of_a, of_b = _columns(a, names), _columns(b, names)
    shared = common is Common.STATIC
    placed = np.zeros(len(names)) if shared else placement(names)
    out = 2.0 * placed**2
    for column in dict.fromkeys((*of_a, *of_b)):
        one, other = of_a.get(column), of_b.get(column)
        together = column != FOUND and (column.startswith(NOMINAL) or (shared and column.startswith(SKIN)))
        if together and one is not None and other is not None:
            out = out + own_part(column, shared=shared) * (other - one) ** 2
        else:
            out = out + sum(c**2 for c in (one, other) if c is not None)
    return out


def own_part(column: str, *, shared: bool) -> float:
    """r^2: of the variance of a nominal joint's error, the part that is the person's own rather than the markers'."""
    name = column.removeprefix(NOMINAL)
    if shared or name not in JP_INDEX:
        return 1.0
    return float(1.0 - (placement([name])[0] / prior_deviations([name])[0]) ** 2)


def _columns(influence: Influence, names: Sequence[str]) -> dict[str, Array]:
    """Source -> (n,) what it does to the joint parameters `names`."""
    rows = influence.parameters[[influence.free.index(name) for name in names]]
    return dict(zip(influence.clusters, rows.T, strict=True))
