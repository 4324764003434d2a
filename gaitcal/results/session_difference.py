"""One difference between two sessions: its standard error, the least that the recordings could not
have missed, its words, and the tables of all.

Of a figure with the mean m_s over the n_s strides of session s, d = m_B - m_A,

    se^2 = t^2 v (1 / n_A + 1 / n_B) + c^2,        mdc95 = 1.96 se.

v is the variance between strides, pooled (Student's two-sample test): of this figure in both
sessions and, where these give fewer than `LEAST_FREEDOM` degrees of freedom, in both legs; t widens
it for being known from few strides, by the 97.5 % point of Student's distribution against that of
the normal one. Measurement error of the single stride is in v. c is what the errors c_A, c_B that
all strides of a session share leave in the difference:

    one model            c = |c_A - c_B|                      one error, and as large as the posture makes it in each
    one static trial     c^2 = (f_A - f_B)^2 + (c_A^2 - f_A^2) + (c_B^2 - f_B^2),     f: axes and masses
    a static trial each  c^2 = c_A^2 + c_B^2

Errors of the joint parameters that two calibrations on one static trial share through its nominal
joints, and of the same force plates, are taken as independent here: c is then rather too large. How
a person walks differently on another day is no error of a recording, and in none of these figures:
two sessions do not tell it.

Joint parameters of two sessions stand each in its own segment frames. Errors of a calibration come
by source (`calibration/joint_estimate.py`): columns M of the markers of its trials, N of the
nominal joints, Z of the skin. Markers of different recordings are independent. On one static trial
the nominal joints are wrong by the same in both, and markers sit on the same skin, so that columns
meet by name:

    se^2 = |M_A|^2 + |M_B|^2 + |N_B - N_A|^2 + |Z_B - Z_A|^2.

With a static trial each, of the deviation d of joints from their nominal values (covariance P0 = F
F^T of causes, to which the columns of N belong; `calibration/joint_prior.py`) a part is the
person's own, the same in both, and a part Q comes from where the markers were put this time: p^2 in
both views of a bone end, whose nominal place is one point of the laboratory. The latter turns and
shifts the segment frames, in which the joints are told, too: it counts in full, once for each
session,

    se^2 = |M_A|^2 + |M_B|^2 + |N_B R_B - N_A R_A|^2 + |Z_A|^2 + |Z_B|^2 + 2 p^2,      R R^T = 1 - F^-1 Q F^-T,

which is diagonal by anatomy: 1 - p^2 / sigma^2 of a bone end's place, 1 of how far apart its two
views are. p by `placement`: 6 mm of a position along each axis (palpated landmarks scatter by 10
mm, Della Croce et al. 2005), and of an orientation what landmarks turn the segment by
(`dynamics/measurement_errors.py`). A talus has no landmarks: the angle between its axes is
nominally that between axes of shank and foot, and as wrong as both.

Markers are independent in this; on skin that moves alike in two walks they are not, and bars are
then rather too wide: walk against walk of one person scatters by 0.4 of them. Between walks of two
kinds they are a little too narrow by what skin does that no marker shows: straight walks against
turns of four children, with two markers on each thigh, have 75 % inside bars of 68, 93 inside those
of 95 (68 and 87 while those thighs were taken to be still, `python -m scripts.validation people`).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import factor_prior, make_view_covariance
from gaitcal.dynamics.measurement_errors import PALPATED_DEG
from gaitcal.gait.cycles import GROUND_REACTION, CurveKind, coordinate_of, kind_of
from gaitcal.gait.moments import SIDE_WORDS, counted, parameter_words
from gaitcal.model.coordinates import describe_coordinate, get_senses
from gaitcal.model.linkage import LEG_JOINTS, SIDES, get_segment
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES
from gaitcal.model.parameters import ParameterKind as ParameterKind
from gaitcal.results.stride_sets import Common, RecordedSession, mean_over
from gaitcal.study.cohort_prior import JointPrior

MDC = 1.96  # Standard errors: the normal distribution's 97.5 % point
LEAST_FREEDOM = 8  # Degrees of freedom from which the leg's own strides tell their spread


@dataclass(frozen=True, kw_only=True)
class StrideSpread:
    """How strides vary."""

    variance: Array  # (m,) v; NaN where no session has two strides
    freedom: Array  # (m,) degrees of freedom


def pooled(groups: Sequence[Array]) -> StrideSpread:
    """Of strides in groups (n, m), each about its own mean."""
    squares = np.array([np.nansum((group - mean_over(group)) ** 2, axis=0) for group in groups])
    freedom = np.array([np.maximum(np.isfinite(group).sum(axis=0) - 1, 0) for group in groups]).sum(
        axis=0
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return StrideSpread(
            variance=np.where(freedom > 0, squares.sum(axis=0) / freedom, np.nan), freedom=freedom
        )


def spread_of(here: Sequence[Array], other_leg: Sequence[Array]) -> StrideSpread:
    """Of this leg's strides in both sessions; of both legs' where those are few."""
    alone = pooled(here)
    if not other_leg:
        return alone
    both = pooled([*here, *other_leg])
    few = alone.freedom < LEAST_FREEDOM
    return StrideSpread(
        variance=np.where(few, both.variance, alone.variance),
        freedom=np.where(few, both.freedom, alone.freedom),
    )


def stride_part(spread: StrideSpread, n_a: Array, n_b: Array) -> Array:
    """(m,) variance of the difference of two means by strides; NaN where nothing tells how they
    vary.
    """
    factor = np.where(
        spread.freedom > 0, stdtrit(np.maximum(spread.freedom, 1), 0.975) / MDC, np.nan
    )
    both = (n_a > 0) & (n_b > 0)
    each = np.where(both, 1.0 / np.maximum(n_a, 1) + 1.0 / np.maximum(n_b, 1), np.nan)
    out: Array = factor**2 * spread.variance * each
    return out


def shared_variance(
    common: Common, shared: tuple[Array, Array], frames: tuple[Array, Array]
) -> Array:
    """c^2 of errors (m,) that all strides of session A and of session B share."""
    a, b = shared
    if common is Common.MODEL:
        return np.asarray((a - b) ** 2)
    if common is Common.STATIC:
        f_a, f_b = frames
        return np.asarray((f_a - f_b) ** 2 + (a**2 - f_a**2) + (b**2 - f_b**2))
    return np.asarray(a**2 + b**2)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A figure in both sessions; in `unit`, as all that follows it."""

    kind: str  # angle, moment, power, force, spatiotemporal, joint position, joint orientation
    side: str  # `r`, `l`; empty for what belongs to neither leg
    name: str  # Variable of `cycles.csv` or `spatiotemporal.csv`, or joint parameter
    # Which figure of a curve: `highest in swing`; `mean` of a measure of strides; empty for a
    # parameter
    measure: str
    unit: str
    a: float
    b: float
    # Standard error by how strides differ; NaN where nothing tells it, 0 where it has no part
    se_strides: float
    se_shared: float  # By errors that all strides of a session share, as far as they do not cancel
    strides_a: int
    strides_b: int

    @property
    def difference(self) -> float:
        """From A to B."""
        return self.b - self.a

    @property
    def se(self) -> float:
        """Of the difference; without the strides' part where that is not known."""
        known = self.se_strides if self.spread_known else 0.0
        return float((known**2 + self.se_shared**2) ** 0.5)

    @property
    def mdc95(self) -> float:
        """The minimal detectable change: what these recordings could miss."""
        return MDC * self.se

    @property
    def spread_known(self) -> bool:
        """Whether anything tells how strides vary."""
        return self.se_strides == self.se_strides

    @property
    def times(self) -> float:
        """How many times the minimal detectable change it is; 0 where there is no difference."""
        if self.difference == 0.0:
            return 0.0
        return abs(self.difference) / self.mdc95 if self.mdc95 > 0.0 else float("inf")

    @property
    def beyond_legs(self) -> bool:
        """Whether it is a joint parameter of trunk or arms, whose error bars know nothing of a
        spine that bends.
        """
        return self.kind.startswith("joint") and not self.name.startswith(LEG_JOINTS)

    @property
    def exceeds(self) -> bool:
        """Whether it is more than the recordings could miss; never where nobody knows how strides
        vary.
        """
        return self.spread_known and self.times > 1.0


COLUMNS = (
    *(
        "kind",
        "side",
        "name",
        "measure",
        "unit",
        "a",
        "b",
        "difference",
        "se",
        "mdc95",
        "times",
        "exceeds",
    ),
    *("se_strides", "se_shared", "strides_a", "strides_b"),
)
DIFFERENCES_HEADER = (
    "differences between two sessions of one person, b - a; the largest against what could be "
    "missed come first",
    "se: standard error of the difference, by how strides vary (se_strides; Student's t for few "
    "strides; empty where",
    "each session has one stride: such a difference never counts as exceeding) and by errors that "
    "all strides of a",
    "session share, as far as they are not the same in both sessions (se_shared)",
    "mdc95: minimal detectable change, 1.96 se; times: |difference| / mdc95; exceeds: 1 where that "
    "is above 1",
    "joint parameters: each session's in its own segment frames, which new markers place anew",
)
"""Comment lines of `differences.csv`."""
DIGITS = 6


def ranked(differences: Iterable[Difference]) -> tuple[Difference, ...]:
    """Those that exceed first, of the legs and of curves before trunk and arms; what nobody can
    judge last.
    """
    return tuple(
        sorted(
            differences,
            key=lambda d: (
                not d.exceeds or d.beyond_legs,
                not d.exceeds,
                not d.spread_known,
                -d.times,
            ),
        )
    )


def difference_table(differences: Iterable[Difference]) -> pd.DataFrame:
    """`differences.csv`: one row each, with `COLUMNS`."""
    rows = [{name: getattr(d, name) for name in COLUMNS} for d in differences]
    table = pd.DataFrame(rows, columns=list(COLUMNS)).astype({"exceeds": int})
    numbers = ["a", "b", "difference", "se", "mdc95", "times", "se_strides", "se_shared"]
    return table.astype(dict.fromkeys(numbers, float)).round(dict.fromkeys(numbers, DIGITS))


TOLD = 12  # Variables that are told in words; the table has all
BY_CHANCE = (
    0.05  # Of differences that are none, the part that exceeds a minimal detectable change of 95 %
)
_PARAMETERS = ("joint position", "joint orientation")


def lines_of(
    names: tuple[str, str], common: Common, found: Sequence[Difference]
) -> tuple[str, ...]:
    """What differs, largest first: a sentence for each variable with the figure that is furthest
    beyond its error.
    """
    judged = [d for d in found if d.spread_known]
    legs = [d for d in judged if not d.beyond_legs]
    beyond = [d for d in legs if d.exceeds]
    lines = [f"{names[1]} against {names[0]}; {common.words}"]
    if not found:
        return (*lines, "nothing that both have can be compared")
    lines.append(
        f"{len(beyond)} of {counted(len(legs), 'difference')} exceed what these recordings could "
        "miss (95 %); "
        f"were none real, about {BY_CHANCE * len(legs):.0f} would"
    )
    told: dict[tuple[str, str], Difference] = {}
    swings = {(d.side, d.name) for d in beyond if d.name.startswith("swing")}
    for d in beyond:
        other_leg = (
            SIDES[d.side == SIDES[0]],
            d.name.replace("single_support", "swing"),
        )  # which swings meanwhile
        if not d.name.startswith("single_support") or other_leg not in swings:
            told.setdefault((d.side, d.name), d)
    lines += [f"{sentence(d)}{_others(d, beyond)}" for d in list(told.values())[:TOLD]]
    if len(told) > TOLD:
        lines.append(f"and {len(told) - TOLD} more variables: differences.csv")
    if upper := sum(d.exceeds and d.beyond_legs for d in judged):
        lines.append(
            f"{counted(upper, 'joint parameter')} of trunk and arms besides, whose error bars know "
            "nothing of a spine "
            "that bends and shoulders that slide: differences.csv"
        )
    if unknown := len(found) - len(judged):
        why = "one stride in each session does not tell how strides vary"
        lines.append(f"{counted(unknown, 'difference')} cannot be judged: {why}")
    return tuple(lines)


def _told(d: Difference) -> Difference:
    """A moment that is lowest counts in the sense in which it acts: as knee abduction, no negative
    adduction.
    """
    acts = d.kind == CurveKind.MOMENT.words and d.measure.startswith("lowest")
    return replace(d, a=-d.a, b=-d.b) if acts else d


def sentence(d: Difference) -> str:
    """`right knee flexion, highest in swing: 8.1 deg less (52.3 against 60.4), 3.2 times what ...
    could miss`.
    """
    d = _told(d)
    digits = 3 if d.unit == "m" or d.unit == "m/s" else 2 if d.unit == "s" else 1
    below = max(d.a, d.b) < 0.0  # of a negative moment, a larger number is less
    way = (
        ("less negative" if below else "more")
        if d.difference > 0
        else ("more negative" if below else "less")
    )
    size = (
        f"{abs(d.difference):.{digits}f} {d.unit} {way} ({d.b:.{digits}f} against {d.a:.{digits}f})"
    )
    if d.mdc95 == 0.0:
        return f"{subject(d)}: {size}"
    return f"{subject(d)}: {size}, {d.times:.1f} times what these recordings could miss"


def subject(d: Difference) -> str:
    """`right knee flexion, highest in swing`; `left stance, % of the stride`; `right hip centre in
    the pelvis, up`.
    """
    side = f"{SIDE_WORDS[d.side]} " if d.side else ""
    if d.kind in _PARAMETERS:
        return f"{side}{parameter_words(d.name)}"
    if d.kind == "spatiotemporal":
        return f"{side}{d.name.removesuffix('_percent').replace('_', ' ')}"
    kind = kind_of(d.name)
    if d.name == GROUND_REACTION:
        return f"{side}vertical ground reaction, {d.measure}"
    coordinate = coordinate_of(d.name)
    title = describe_coordinate(coordinate).title
    title = title[:1].lower() + title[1:] + (" power" if kind is CurveKind.POWER else "")
    if kind is CurveKind.MOMENT and (senses := get_senses(coordinate)):
        figure, _, phase = d.measure.partition(" in ")
        return f"{side}{title.split()[0]} {senses[figure == 'lowest']} moment, {phase}"
    if coordinate.startswith(("pelvis", "lumbar")):
        return f"{title} in {side}strides, {d.measure}"
    return f"{side}{title}, {d.measure}"


def numbers_of(d: Difference) -> tuple[str, ...]:
    """Both sessions, their difference, what could be missed, and how many times that it is."""
    d, digits = _told(d), 3 if d.unit in ("m", "m/s", "s") else 1
    figures = [
        f"{round(value, digits) + 0.0:.{digits}f}" for value in (d.a, d.b, d.difference)
    ]  # + 0.0: no -0.0
    limit = ("unknown", "") if not d.spread_known else (f"{d.mdc95:.{digits}f}", f"{d.times:.1f}")
    return (*figures, *limit)


def _others(d: Difference, beyond: Sequence[Difference]) -> str:
    """How many further figures of the same variable exceed."""
    same = sum((o.side, o.name) == (d.side, d.name) for o in beyond) - 1
    return f" ({same} more of its figures exceed)" if same else ""


PLACED = 0.006  # m, of a landmark along each axis
NOMINAL, SKIN, FOUND = "nominal/", "skin/", "skin/found"
"""How columns of an `ErrorSources` begin, and the skin's one that moves no joint."""


def placement(names: Sequence[str]) -> Array:
    """(n,) m, rad: what markers that are put on anew do to joint parameters told in the frames they
    make.
    """
    out = []
    for name in names:
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        segment = get_segment(p.segment)
        if p.kind is ParameterKind.POSITION:
            out.append(PLACED)
        elif segment.palpated is None:
            out.append(
                float(np.deg2rad(np.hypot(PALPATED_DEG["shank"][1], PALPATED_DEG["foot"][1])))
            )
        else:
            out.append(float(np.deg2rad(segment.palpated[p.axis])))
    return np.array(out)


def told_parameters(influence: ErrorSources | None) -> tuple[str, ...]:
    """Joint parameters that markers told something of."""
    if influence is None:
        return ()
    markers = np.array([not c.startswith(NOMINAL) for c in influence.clusters])
    told = (influence.parameters[:, markers] != 0.0).any(axis=1)
    return tuple(
        name for name, seen in zip(influence.free, told, strict=True) if seen and name in JP_INDEX
    )


def parameter_differences(
    a: RecordedSession, b: RecordedSession, common: Common
) -> Iterator[Difference]:
    """Every joint parameter that both calibrations fitted."""
    known = set(told_parameters(b.influence))
    names = tuple(name for name in told_parameters(a.influence) if name in known)
    if not names or a.influence is None or b.influence is None:
        return
    errors = np.sqrt(
        difference_variance((a.influence, b.influence), names, common, (a.prior, b.prior))
    )
    for name, error in zip(names, errors, strict=True):
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        of_a, of_b = (s.model.parameters.joint[JP_INDEX[name]] / p.kind.to_si for s in (a, b))
        yield Difference(
            kind=f"joint {'position' if p.kind is ParameterKind.POSITION else 'orientation'}",
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
    """(n,) m^2, rad^2: variance of differences of joint parameters `names`. `priors`: of each;
    None: anatomy's.
    """
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
    out = ((nominal[1] - nominal[0]) ** 2).sum(axis=1) + (
        0.0 if shared else 2.0 * placement(names) ** 2
    )
    for column in dict.fromkeys((*of_a, *of_b)):
        one, other = of_a.get(column), of_b.get(column)
        if (
            shared
            and column.startswith(SKIN)
            and column != FOUND
            and one is not None
            and other is not None
        ):
            out = out + (other - one) ** 2
        else:
            out = out + sum(c**2 for c in (one, other) if c is not None)
    return np.asarray(out)


def own_causes(names: Sequence[str], prior: JointPrior | None) -> Array:
    """(n, n) R, symmetric: of the causes e of nominal errors F e, R R^T is the covariance of what
    is the person's own rather than the markers', nothing of it negative.
    """
    root = factor_prior(names, prior)
    index = [JP_INDEX[name] for name in names]
    half = np.linalg.solve(root, make_view_covariance(placement(JP_NAMES))[np.ix_(index, index)])
    values, vectors = np.linalg.eigh(np.eye(len(names)) - np.linalg.solve(root, half.T))
    out: Array = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return out


def _columns(influence: ErrorSources, names: Sequence[str]) -> dict[str, Array]:
    """Source -> (n,) what it does to the joint parameters `names`."""
    rows = influence.parameters[[influence.free.index(name) for name in names]]
    return dict(zip(influence.clusters, rows.T, strict=True))
