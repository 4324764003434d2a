"""Does the fitted knee axis pass the epicondyles, between which every living knee bends?

Standard errors of a fit come from residuals of markers. Skin that slides over thigh and shank in step with the walk
moves the axis without leaving a residual, and no error bar shows it. The epicondyles do: the flexion axis of living
knees is the line through them to within a few millimetres (Asano et al., J Arthroplasty 20:1060-1067, 2005), and
palpation places each with its scatter. With e an epicondyle in the thigh and the axis a + t u,

    d = (1 - u u^T)(a - e),    cov(d) = J C J^T + (s_p^2 + s_a^2) 1 + T,    times = |d|^2 / sqrt(d^T cov(d) d),

C the covariance of the knee's parameters in the thigh, J = dd/dp, s_p the scatter of palpation, s_a that of the axis
about the epicondyles. Where no marker shows the medial one, it is the mirror image of the lateral one in the nominal
centre, and T what it can be off by: it lies twice the half width away, turned by what nobody measured.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.codes import Code
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.chain import axis_rotation
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.knee_and_ankle import NOMINAL_HEIGHT, SIDE_WORDS
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.records import dataclass

TOPIC = "knee axis"
CAUSE = "the fitted knee axis passes far from the epicondyles"
PALPATION_M = 0.008
"""m a coordinate: epicondyles found by different examiners (Della Croce et al., Gait Posture 21:226-237, 2005, give 6
to 21 mm for landmarks of the leg, all directions together)."""
ANATOMY_M = 0.005
"""m a coordinate, by which flexion axes pass beside the epicondyles: assumed."""
TURN, TILT = np.deg2rad(10.0), np.deg2rad(4.0)
"""rad: how far an axis without a medial marker may be turned about the thigh's length, and tilted in the frontal plane
(women and men differ by about 3 degrees in the slope of their epicondyles against the line from hip to knee)."""
FAR_M = 0.025
"""m, of a person of nominal height: beyond it the axis lies outside the condyle, whose circle has about 20 mm."""
TIMES, TOLD_TIMES = 2.5, 2.0
"""Combined standard deviations from which an axis is doubted (scatter alone: 4 % of ends), and its place noted. Only
together with `FAR_M` is it a doubt: an axis outside the bone is wrong, or its epicondyle is."""
_STEP = 1e-6
_NAMES = ("ant", "sup", "front", "trans")


@dataclass(frozen=True, kw_only=True)
class Pass:
    """Where the fitted axis passes one epicondyle."""

    end: str
    """`lateral` or `medial`."""
    palpated: bool
    """Whether a marker shows the epicondyle; else the nominal axis was assumed."""
    offset: Array
    """(3,) m in the thigh from the epicondyle to the axis, across it: forward, up, right."""
    error: float
    """m: standard error of that distance by the fit alone."""
    times: float
    """The distance in standard deviations of fit, palpation and anatomy together."""

    @property
    def distance(self) -> float:
        """M."""
        return float(np.linalg.norm(self.offset))

    @property
    def words(self) -> str:
        """In words, with the direction: `18 mm from the palpated lateral one (5 mm behind, 17 mm below)`."""
        known = "palpated" if self.palpated else "assumed"
        parts = [
            f"{abs(1e3 * off):.0f} mm {ahead if off > 0 else back}"
            for off, ahead, back in zip(self.offset[:2], ("in front", "above"), ("behind", "below"), strict=True)
            if abs(off) >= 0.0005
        ]
        where = f" ({', '.join(parts)})" if parts else ""
        return f"{1e3 * self.distance:.0f} mm from the {known} {self.end} one{where}"


def knee_axis_findings(
    model: SubjectModel, fitted: Parameters, influence: Influence, isolated: Collection[str] = ()
) -> Iterator[Finding]:
    """Knees whose fitted axis misses an epicondyle by more than fit, palpation and anatomy explain.

    Parameters
    ----------
    model : the nominal one, with the landmarks of the static trial.
    influence : errors of the fitted joint parameters.
    isolated : joints (`knee_r`, ...) that have an isolated trial of their own.
    """
    for side in SIDES:
        passes = passes_of(model, fitted, influence, side)
        if not passes:
            continue
        worst = max(passes, key=lambda p: p.times)
        if worst.times < TOLD_TIMES:
            continue
        least = FAR_M * model.subject.height / NOMINAL_HEIGHT
        doubted = any(p.times > TIMES and p.distance > least for p in passes)
        found = f"{SIDE_WORDS[side]} knee: it passes {' and '.join(p.words for p in passes)}, "
        found += f"{worst.times:.1f} standard deviations of fit, palpation ({1e3 * PALPATION_M:.0f} mm) and anatomy "
        found += f"({1e3 * ANATOMY_M:.0f} mm) together;"
        found += f" the fit alone says ± {1e3 * max(p.error for p in passes):.0f} mm{_few_markers(model, side)}"
        yield Finding(
            severity=Severity.WARNING if doubted else Severity.INFO,
            topic=TOPIC,
            where=STUDY,
            leg=side,
            cause=CAUSE if doubted else "where the fitted knee axis passes the epicondyles",
            found=found,
            cure=_cure(f"knee_{side}" in isolated, fully=all(p.palpated for p in passes)) if doubted else "",
            weight=worst.times / TIMES,
            code=Code.KNEE_AXIS,
        )


def passes_of(model: SubjectModel, fitted: Parameters, influence: Influence, side: str) -> tuple[Pass, ...]:
    """Of the lateral and the medial epicondyle; empty where the knee was not fitted, or no marker is on it."""
    names = tuple(f"knee_{side}.thigh.{name}" for name in _NAMES)
    columns = [JP_INDEX[name] for name in names]
    nominal = np.array_equal(fitted.joint[columns], model.nominal.joint[columns])
    lateral, middle = (_landmark(model, f"{name}_{side}", f"thigh_{side}") for name in ("knee_lat", "kjc"))
    if nominal or lateral is None or middle is None:
        return ()
    medial = _landmark(model, f"knee_med_{side}", f"thigh_{side}")
    ends = {
        "lateral": (lateral, True),
        "medial": (2.0 * middle - lateral if medial is None else medial, medial is not None),
    }
    spread = _covariance(influence, names)
    return tuple(_pass(name, end, palpated, fitted, side, spread) for name, (end, palpated) in ends.items())


def _pass(name: str, end: Array, palpated: bool, fitted: Parameters, side: str, spread: Array) -> Pass:
    names = tuple(f"knee_{side}.thigh.{n}" for n in _NAMES)
    values = np.array([fitted.joint[JP_INDEX[n]] for n in names])
    offset = _offset(values, end)
    steps = _STEP * np.eye(len(values))
    pulls = np.column_stack([(_offset(values + d, end) - _offset(values - d, end)) / (2 * _STEP) for d in steps])
    fit = pulls @ spread @ pulls.T
    other = (PALPATION_M**2 + ANATOMY_M**2) * np.eye(3)
    if not palpated:
        other += (2.0 * end[2]) ** 2 * np.diag([TURN**2, TILT**2, 0.0])
    distance = max(float(np.linalg.norm(offset)), 1e-12)
    across = offset / distance
    return Pass(
        end=name,
        palpated=palpated,
        offset=offset,
        error=float(np.sqrt(across @ fit @ across)),
        times=distance / float(np.sqrt(across @ (fit + other) @ across)),
    )


def _offset(values: Array, end: Array) -> Array:
    """(3,) m from a point to the axis, across it; `values` are those of `_NAMES`: the axis lies along z turned."""
    ant, sup, front, trans = values
    direction = (axis_rotation(0, front) @ axis_rotation(1, trans))[:, 2]
    away = np.array([ant, sup, 0.0]) - end
    out: Array = away - (away @ direction) * direction
    return out


def _covariance(influence: Influence, names: tuple[str, ...]) -> Array:
    """(4, 4) of these parameters; zero for what was not fitted."""
    place = {name: k for k, name in enumerate(influence.free)}
    rows = np.zeros((len(names), influence.parameters.shape[1]))
    for k, name in enumerate(names):
        if name in place:
            rows[k] = influence.parameters[place[name]]
    out: Array = rows @ rows.T
    return out


def _landmark(model: SubjectModel, name: str, segment: str) -> Array | None:
    found = model.landmarks.get(name)
    return found[1] if found is not None and found[0] == segment else None


def _few_markers(model: SubjectModel, side: str) -> str:
    """Segments beside the knee on which skin that moves cannot show by deforming."""
    pairs = list(zip(model.markers.segments, model.markers.weight, strict=True))
    count = {part: sum(s == f"{part}_{side}" and w > 0 for s, w in pairs) for part in ("thigh", "shank")}
    few = [f"{n} on the {part}" for part, n in count.items() if n < FEWEST_MARKERS]
    return f", which can only assume how skin moves: too few markers to show it, {' and '.join(few)}" if few else ""


def _cure(isolated: bool, *, fully: bool) -> str:
    skin = "skin that slides over thigh and shank in step with the motion does this, and no error bar shows all of it"
    marker = "so does a marker that is not on its epicondyle: look at the static trial"
    if isolated:
        trial = "compare with a slow knee trial of large range, non-weight-bearing"
    else:
        trial = 'gait alone does not tell the two apart: record an isolated knee trial (role "joint")'
    nominal = "or keep the nominal axis ([calibration] jp = false)"
    place = "" if fully else "; a marker on the medial epicondyle in the static trial would say more"
    return f"{skin}, and {marker}; {trial}, {nominal}{place}"
