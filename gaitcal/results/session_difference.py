"""Differences between two sessions: standard errors, minimal detectable changes, sentences, tables.

A figure has the mean m_s over the n_s strides of session s. Its difference is d = m_B - m_A, with

    se^2 = t^2 v (1 / n_A + 1 / n_B) + c^2,        mdc95 = 1.96 se.

v is the variance between strides, pooled over both sessions (Student's two-sample test). If these
give fewer than `LEAST_FREEDOM` degrees of freedom, both legs are pooled. t is the 97.5 % point of
Student's distribution divided by that of the normal one. v includes the measurement error of the
single stride. c is the part that the errors c_A, c_B, shared by all strides of a session, leave:

    one model            c = |c_A - c_B|                      one error, scaled by each posture
    one static trial     c^2 = (f_A - f_B)^2 + (c_A^2 - f_A^2) + (c_B^2 - f_B^2)
    a static trial each  c^2 = c_A^2 + c_B^2

f is the part of c due to segment axes and masses.

Two calibrations on one static trial share errors of nominal joints and force plates. They are taken
as independent here, so that c is rather too large. The day-to-day variation of a person's gait is
not an error of a recording and is not included.

Joint parameters are expressed in the segment frames of their session. Their errors come by source
(`calibration/joint_estimate.py`): columns M of the markers, N of the nominal joints, Z of the soft
tissue artefact. Markers of different recordings are independent. On one static trial the nominal
joints have the same errors and markers the same positions on the skin, so that columns of equal
names combine:

    se^2 = |M_A|^2 + |M_B|^2 + |N_B - N_A|^2 + |Z_B - Z_A|^2.

With a static trial each, the deviation of joints from their nominal values has the covariance P0 =
F F^T (`calibration/joint_prior.py`). The part that belongs to the anatomy is the same in both. The
part Q comes from the placement of markers: p^2 in both views of a bone end, whose nominal position
is one point of the laboratory. It also rotates and translates the segment frames, and counts in
full once for each session:

    se^2 = |M_A|^2 + |M_B|^2 + |N_B R_B - N_A R_A|^2 + |Z_A|^2 + |Z_B|^2 + 2 p^2,
    R R^T = 1 - F^-1 Q F^-T,

R is diagonal for anatomy: 1 - p^2 / sigma^2 for the position of a bone end, 1 for the distance
of its two views. p is given by `compute_placement_errors`: 6 mm of a position along each axis
(palpated landmarks scatter by 10 mm, Della Croce et al. 2005), and the rotation of the segment by
its landmarks (`dynamics/measurement_errors.py`). A talus has no landmarks: the angle between its
axes is nominally that between axes of shank and foot, and has the errors of both.

Markers are taken as independent. Soft tissue that moves alike in two walks makes the standard
errors rather too large; between different activities they are a little too small.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import factor_prior, make_shared_centre_covariance
from gaitcal.dynamics.measurement_errors import PALPATED_DEG
from gaitcal.gait.cycles import GROUND_REACTION, CurveKind, get_coordinate, get_curve_kind
from gaitcal.gait.moments import SIDE_WORDS, describe_parameter, format_count
from gaitcal.model.coordinates import describe_coordinate, get_senses
from gaitcal.model.linkage import LEG_JOINTS, SIDES, get_segment
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES
from gaitcal.model.parameters import ParameterKind as ParameterKind
from gaitcal.results.stride_sets import Common, RecordedSession, average_known
from gaitcal.study.normal_prior import JointPrior

MDC = 1.96  # Standard errors: the normal distribution's 97.5 % point
LEAST_FREEDOM = 8  # Degrees of freedom from which one leg's strides determine their spread


@dataclass(frozen=True, kw_only=True)
class StrideSpread:
    """Variance between strides."""

    variance: Array  # (m,) v; NaN where no session has two strides
    freedom: Array  # (m,) degrees of freedom


def pool_strides(groups: Sequence[Array]) -> StrideSpread:
    """Pool the variance of groups of strides (n, m), each about its mean."""
    squares = np.array([np.nansum((group - average_known(group)) ** 2, axis=0) for group in groups])
    freedom = np.array([np.maximum(np.isfinite(group).sum(axis=0) - 1, 0) for group in groups]).sum(
        axis=0
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return StrideSpread(
            variance=np.where(freedom > 0, squares.sum(axis=0) / freedom, np.nan), freedom=freedom
        )


def estimate_spread(this_leg: Sequence[Array], other_leg: Sequence[Array]) -> StrideSpread:
    """Estimate the spread of this leg's strides; pool both legs if there are few."""
    single = pool_strides(this_leg)
    if not other_leg:
        return single
    both = pool_strides([*this_leg, *other_leg])
    few = single.freedom < LEAST_FREEDOM
    return StrideSpread(
        variance=np.where(few, both.variance, single.variance),
        freedom=np.where(few, both.freedom, single.freedom),
    )


def compute_stride_variance(spread: StrideSpread, n_a: Array, n_b: Array) -> Array:
    """Compute the (m,) variance of the difference of two means due to strides; NaN if unknown."""
    factor = np.where(
        spread.freedom > 0, stdtrit(np.maximum(spread.freedom, 1), 0.975) / MDC, np.nan
    )
    both = (n_a > 0) & (n_b > 0)
    each = np.where(both, 1.0 / np.maximum(n_a, 1) + 1.0 / np.maximum(n_b, 1), np.nan)
    out: Array = factor**2 * spread.variance * each
    return out


def compute_shared_variance(
    common: Common, shared: tuple[Array, Array], frames: tuple[Array, Array]
) -> Array:
    """Compute c^2 of the errors (m,) that all strides of a session share."""
    a, b = shared
    if common is Common.MODEL:
        return np.asarray((a - b) ** 2)
    if common is Common.STATIC:
        f_a, f_b = frames
        return np.asarray((f_a - f_b) ** 2 + (a**2 - f_a**2) + (b**2 - f_b**2))
    return np.asarray(a**2 + b**2)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A figure of both sessions; all values are in `unit`."""

    kind: str  # angle, moment, power, force, spatiotemporal, joint position, joint orientation
    side: str  # `r`, `l`; empty for what belongs to neither leg
    name: str  # Variable of `cycles.csv` or `spatiotemporal.csv`, or joint parameter
    # Which figure of a curve: `highest in swing`; `mean` of a measure of strides; empty for a
    # parameter
    measure: str
    unit: str
    a: float
    b: float
    # Standard error due to variation of strides; NaN if unknown, 0 if it has no part
    se_strides: float
    se_shared: float  # Due to errors that all strides of a session share and that do not cancel
    strides_a: int
    strides_b: int

    @property
    def difference(self) -> float:
        """B minus A."""
        return self.b - self.a

    @property
    def se(self) -> float:
        """Standard error of the difference; without the part of strides if that is unknown."""
        known = self.se_strides if self.spread_known else 0.0
        return float((known**2 + self.se_shared**2) ** 0.5)

    @property
    def mdc95(self) -> float:
        """The minimal detectable change."""
        return MDC * self.se

    @property
    def spread_known(self) -> bool:
        """Whether the variance between strides is known."""
        return self.se_strides == self.se_strides

    @property
    def times(self) -> float:
        """The difference divided by the minimal detectable change; 0 if there is no difference."""
        if self.difference == 0.0:
            return 0.0
        return abs(self.difference) / self.mdc95 if self.mdc95 > 0.0 else float("inf")

    @property
    def beyond_legs(self) -> bool:
        """Whether it is a joint parameter of trunk or arms.

        Their standard errors do not include a spine that bends.
        """
        return self.kind.startswith("joint") and not self.name.startswith(LEG_JOINTS)

    @property
    def exceeds(self) -> bool:
        """Whether it exceeds the minimal detectable change; never if the spread is unknown."""
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
    "differences between two sessions of one person, b - a; the largest relative to mdc95 come "
    "first",
    "se: standard error of the difference, from the variation of strides (se_strides; Student's t "
    "for few strides;",
    "empty if each session has one stride: such a difference never exceeds) and from errors that "
    "all strides of a",
    "session share and that differ between the sessions (se_shared)",
    "mdc95: minimal detectable change, 1.96 se; times: |difference| / mdc95; exceeds: 1 where that "
    "is above 1",
    "joint parameters: in the segment frames of each session, which depend on the marker placement",
)
"""Comment lines of `differences.csv`."""
DIGITS = 6


def rank_differences(differences: Iterable[Difference]) -> tuple[Difference, ...]:
    """Rank differences: exceeding ones first, legs and curves before trunk and arms.

    Differences of unknown spread come last.
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


def build_difference_table(differences: Iterable[Difference]) -> pd.DataFrame:
    """Build `differences.csv`: one row for each difference, with `COLUMNS`."""
    rows = [{name: getattr(d, name) for name in COLUMNS} for d in differences]
    table = pd.DataFrame(rows, columns=list(COLUMNS)).astype({"exceeds": int})
    numbers = ["a", "b", "difference", "se", "mdc95", "times", "se_strides", "se_shared"]
    return table.astype(dict.fromkeys(numbers, float)).round(dict.fromkeys(numbers, DIGITS))


MOST_DESCRIBED = 12  # Variables that are described in sentences; the table has all
BY_CHANCE = 0.05  # Share of zero differences that exceed a minimal detectable change of 95 %
_PARAMETERS = ("joint position", "joint orientation")


def describe_differences(
    names: tuple[str, str], common: Common, found: Sequence[Difference]
) -> tuple[str, ...]:
    """Describe the differences, largest first: one sentence for each variable."""
    judged = [d for d in found if d.spread_known]
    legs = [d for d in judged if not d.beyond_legs]
    exceeding = [d for d in legs if d.exceeds]
    lines = [f"{names[1]} against {names[0]}; {common.description}"]
    if not found:
        return (*lines, "the sessions have nothing in common that can be compared")
    lines.append(
        f"{len(exceeding)} of {format_count(len(legs), 'difference')} exceed what these recordings "
        "could miss (95 %); "
        f"were none real, about {BY_CHANCE * len(legs):.0f} would"
    )
    # the single support of one leg is the swing of the other: one finding
    described: dict[tuple[str, str], Difference] = {}
    swings = {(d.side, d.name) for d in exceeding if d.name.startswith("swing")}
    for d in exceeding:
        other_leg = (SIDES[d.side == SIDES[0]], d.name.replace("single_support", "swing"))
        if not d.name.startswith("single_support") or other_leg not in swings:
            described.setdefault((d.side, d.name), d)
    shown = list(described.values())[:MOST_DESCRIBED]
    lines += [f"{describe_difference(d)}{_format_others(d, exceeding)}" for d in shown]
    if more := len(described) - len(shown):
        lines.append(f"and {more} more variables: differences.csv")
    if upper := sum(d.exceeds and d.beyond_legs for d in judged):
        lines.append(
            f"also {format_count(upper, 'joint parameter')} of trunk and arms, whose standard "
            "errors do not include a bending spine and sliding shoulders: differences.csv"
        )
    if unknown := len(found) - len(judged):
        why = "with one stride in each session their variation is unknown"
        lines.append(f"{format_count(unknown, 'difference')} cannot be judged: {why}")
    return tuple(lines)


def _flip_lowest_moment(d: Difference) -> Difference:
    """Flip the sign of a lowest moment, which is then a moment in the opposite sense."""
    is_lowest = d.kind == CurveKind.MOMENT.label and d.measure.startswith("lowest")
    return replace(d, a=-d.a, b=-d.b) if is_lowest else d


def describe_difference(d: Difference) -> str:
    """Describe a difference in one sentence.

    `right knee flexion, highest in swing: 8.1 deg less (52.3 against 60.4), 3.2 times what these
    recordings could miss`.
    """
    d = _flip_lowest_moment(d)
    digits = 3 if d.unit == "m" or d.unit == "m/s" else 2 if d.unit == "s" else 1
    # "more" would be ambiguous between two negative numbers
    negative = max(d.a, d.b) < 0.0
    if d.difference > 0:
        direction = "less negative" if negative else "more"
    else:
        direction = "more negative" if negative else "less"
    size = (
        f"{abs(d.difference):.{digits}f} {d.unit} {direction} "
        f"({d.b:.{digits}f} against {d.a:.{digits}f})"
    )
    # Without a smallest detectable change there is nothing to compare with.
    if d.mdc95 == 0.0:
        return f"{name_figure(d)}: {size}"
    return f"{name_figure(d)}: {size}, {d.times:.1f} times what these recordings could miss"


def name_figure(d: Difference) -> str:
    """Name a figure in words.

    Parameters
    ----------
    d
        A difference.

    Returns
    -------
    str
        `right knee flexion, highest in swing`; `left stance, % of the stride`; `right hip centre
        in the pelvis, up`.
    """
    side = f"{SIDE_WORDS[d.side]} " if d.side else ""
    if d.kind in _PARAMETERS:
        return f"{side}{describe_parameter(d.name)}"
    if d.kind == "spatiotemporal":
        return f"{side}{d.name.removesuffix('_percent').replace('_', ' ')}"
    kind = get_curve_kind(d.name)
    if d.name == GROUND_REACTION:
        return f"{side}vertical ground reaction, {d.measure}"
    coordinate = get_coordinate(d.name)
    title = describe_coordinate(coordinate).title
    title = title[:1].lower() + title[1:] + (" power" if kind is CurveKind.POWER else "")
    if kind is CurveKind.MOMENT and (senses := get_senses(coordinate)):
        figure, _, phase = d.measure.partition(" in ")
        return f"{side}{title.split()[0]} {senses[figure == 'lowest']} moment, {phase}"
    if coordinate.startswith(("pelvis", "lumbar")):
        return f"{title} in {side}strides, {d.measure}"
    return f"{side}{title}, {d.measure}"


def format_numbers(d: Difference) -> tuple[str, ...]:
    """Format the numbers of a difference.

    Parameters
    ----------
    d
        A difference.

    Returns
    -------
    tuple of str
        A, B, difference, minimal detectable change, and difference divided by it.
    """
    d, digits = _flip_lowest_moment(d), 3 if d.unit in ("m", "m/s", "s") else 1
    # adding 0.0 avoids -0.0
    figures = [f"{round(value, digits) + 0.0:.{digits}f}" for value in (d.a, d.b, d.difference)]
    limit = ("unknown", "") if not d.spread_known else (f"{d.mdc95:.{digits}f}", f"{d.times:.1f}")
    return (*figures, *limit)


def _format_others(d: Difference, beyond: Sequence[Difference]) -> str:
    """Format the number of further figures of the same variable that exceed."""
    same = sum((o.side, o.name) == (d.side, d.name) for o in beyond) - 1
    return f" ({same} more of its figures exceed)" if same else ""


PLACED = 0.006  # m: standard deviation of a palpated landmark along each axis
NOMINAL, SKIN, FOUND = "nominal/", "skin/", "skin/found"
"""Prefixes of `ErrorSources` columns, and the soft tissue column that moves no joint."""


def compute_placement_errors(names: Sequence[str]) -> Array:
    """Compute the (n,) m, rad errors of joint parameters due to a new placement of markers."""
    out = []
    for name in names:
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        segment = get_segment(p.segment)
        # Landmarks are palpated and markers placed anew in every session: errors in m and rad.
        if p.kind is ParameterKind.POSITION:
            out.append(PLACED)
        elif segment.palpated is None:
            out.append(
                float(np.deg2rad(np.hypot(PALPATED_DEG["shank"][1], PALPATED_DEG["foot"][1])))
            )
        else:
            out.append(float(np.deg2rad(segment.palpated[p.axis])))
    return np.array(out)


def list_observed_parameters(influence: ErrorSources | None) -> tuple[str, ...]:
    """List the joint parameters on which the markers have an influence.

    Parameters
    ----------
    influence
        Errors of the joint parameters by source; None if they were not calibrated.

    Returns
    -------
    tuple of str
        Names of joint parameters.
    """
    if influence is None:
        return ()
    markers = np.array([not c.startswith(NOMINAL) for c in influence.sources])
    observed = (influence.effects[:, markers] != 0.0).any(axis=1)
    pairs = zip(influence.names, observed, strict=True)
    return tuple(name for name, is_observed in pairs if is_observed and name in JP_INDEX)


def compare_parameters(
    a: RecordedSession, b: RecordedSession, common: Common
) -> Iterator[Difference]:
    """Compare every joint parameter that both calibrations fitted."""
    # A parameter that one session took from its prior shows no change of the person.
    known = set(list_observed_parameters(b.influence))
    names = tuple(name for name in list_observed_parameters(a.influence) if name in known)
    if not names or a.influence is None or b.influence is None:
        return
    errors = np.sqrt(
        compute_difference_variance((a.influence, b.influence), names, common, (a.prior, b.prior))
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


def compute_difference_variance(
    both: tuple[ErrorSources, ErrorSources],
    names: Sequence[str],
    common: Common,
    priors: tuple[JointPrior | None, JointPrior | None] = (None, None),
) -> Array:
    """Compute the (n,) m^2, rad^2 variance of differences of the joint parameters `names`.

    `priors`: of each session; None: anatomy's.
    """
    if common is Common.MODEL:
        return np.zeros(len(names))
    of_a, of_b = (_collect_columns(influence, names) for influence in both)
    shared = common is Common.STATIC
    # Errors of the nominal joints. On one static trial they are common to both sessions; otherwise
    # their anatomical part is common.
    causes = [name for name in JP_NAMES if NOMINAL + name in {*of_a, *of_b}]
    nominal = []
    for columns, prior in zip((of_a, of_b), priors, strict=True):
        rows = [columns.pop(NOMINAL + name, np.zeros(len(names))) for name in causes]
        errors = np.array(rows).reshape(len(causes), len(names)).T
        nominal.append(errors if shared else errors @ compute_anatomical_root(causes, prior))
    out = ((nominal[1] - nominal[0]) ** 2).sum(axis=1) + (
        0.0 if shared else 2.0 * compute_placement_errors(names) ** 2
    )
    # markers and soft tissue: independent, but for the same soft tissue on one static trial
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


def compute_anatomical_root(names: Sequence[str], prior: JointPrior | None) -> Array:
    """Compute the (n, n) symmetric R of the anatomical part of nominal errors F e.

    R R^T is the covariance of e without the part of marker placement; negative variances become 0.
    """
    root = factor_prior(names, prior)
    index = [JP_INDEX[name] for name in names]
    half = np.linalg.solve(
        root,
        make_shared_centre_covariance(compute_placement_errors(JP_NAMES))[np.ix_(index, index)],
    )
    values, vectors = np.linalg.eigh(np.eye(len(names)) - np.linalg.solve(root, half.T))
    out: Array = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return out


def _collect_columns(influence: ErrorSources, names: Sequence[str]) -> dict[str, Array]:
    """Collect source -> (n,) influence on the joint parameters `names`."""
    rows = influence.effects[[influence.names.index(name) for name in names]]
    return dict(zip(influence.sources, rows.T, strict=True))
