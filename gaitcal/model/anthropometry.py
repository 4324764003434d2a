"""Nominal inertial parameters from de Leva 1996 (`models/de_leva_1996.json`), with this person's
mass and lengths.

Mass fractions, mass centres and radii of gyration are de Leva's; the fractions are divided by their
sum (99.99 % for women), so that the total is the person's mass. Those of a child whose age is known
are changed as Jensen's change with age. Lengths: thigh, shank, upper arm and forearm as measured
between the person's joint centres; pelvis, trunk, head, hand and foot as de Leva's, scaled by
height, because no marker set measures them well (vertex, suprasternale, third metacarpal, toe in a
shoe). Axes: sagittal = x, longitudinal = y, transverse = z; in the foot longitudinal = x,
transverse = y, sagittal = z.

    pelvis           lower trunk, its lower end at the height of the hip centres, its mass centre straight above them
    head and trunk   middle trunk, upper trunk and head stacked on it along y; head from cervicale up (parallel axes)
    forearm, hand    the hand in line with the forearm

How the shares of body mass change as a child grows (Jensen 1989, `models/jensen_1989.json`).

Tables of adults and of children cut the body in different places (Jensen's thigh of an 18 year old
has 11 % of the mass, de Leva's of an adult 14 %), so that one cannot stand for the other. What
children's tables tell reliably is the change with age, a ratio in which the cut cancels:

    growth(age) = Jensen's share at that age / Jensen's share at 18 years

for head, upper arm, forearm with hand, thigh, and shank with foot. The torso has what these leave.
Measured on boys; no polynomials of girls were found.
"""

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.toml import find_models_folder
from gaitcal.model.linkage import SEGMENT_TABLE, SIDES, segment_kind
from gaitcal.model.parameters import IP_NAMES, MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.subject_model import Subject

CHILD_HEIGHT = 1.45  # m; few adults are shorter, and most children before puberty are
YOUTH_HEIGHT, YOUTH_MASS = 1.60, 50.0
"""m and kg; somebody below both may be a child of 10 to 14 years: the median child passes both
shortly before the 14th birthday (2000 CDC Growth Charts, Vital Health Stat 11(246), 2002); some
slender women are below both, too."""
UNKNOWN_AGE, UNKNOWN_AGE_OF_YOUTH = 8.0, 12.0
"""Years that a child counts as where its age is not known, to say how wrong the table of adults may
be: one shorter than CHILD_HEIGHT, and any other; half of the children of 12 are taller than 1.50 m.
"""

UNSIDED = tuple(name.replace("_r.", ".").replace("_l.", ".") for name in IP_NAMES)
"""(ni,) names of inertial parameters without their side."""


@functools.cache
def _tables(name: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((find_models_folder() / name).read_text(encoding="utf-8"))
    return data


def youngest_and_adult_age() -> tuple[float, float]:
    """Years of age from which and up to which the shares change."""
    low, high = _tables("jensen_1989.json")["age_years"]
    return float(low), float(high)


def jensen_share(part: str, age: float) -> float:
    """Share of body mass, 0 to 1, of one part of Jensen's, at an age in years."""
    return float(
        np.polynomial.polynomial.polyval(age, _tables("jensen_1989.json")["mass_share"][part])
    )


def growth(age: float) -> dict[str, float]:
    """Segment of de Leva's -> its share of body mass at this age (years) over that of an adult; 1
    from 18 years on.
    """
    youngest, adult = youngest_and_adult_age()
    at = float(np.clip(age, youngest, adult))
    parts: dict[str, str] = _tables("jensen_1989.json")["part_of"]
    return {
        name: jensen_share(part, at) / jensen_share(part, adult)
        for name, part in parts.items()
        if name in _WHOLE
    }


def looks_like_child(subject: Subject) -> bool:
    """Whether the age is not given, and height and mass may be those of a child."""
    youth = subject.height < YOUTH_HEIGHT and subject.mass < YOUTH_MASS
    return subject.age is None and (subject.height < CHILD_HEIGHT or youth)


def supposed_age(subject: Subject) -> float:
    """Years that somebody who looks like a child counts as."""
    return UNKNOWN_AGE if subject.height < CHILD_HEIGHT else UNKNOWN_AGE_OF_YOUTH


FOOT_CENTRE_UP = (
    0.0004 / 1.70
)  # of the foot's mass centre above the heel-toe line over body height: costs divide by it
_DIAGONAL = {"sagittal": 0, "longitudinal": 1, "transverse": 2}
_FORWARD = {"longitudinal": 0, "transverse": 1, "sagittal": 2}


@dataclass(frozen=True)
class BodyLengths:
    """What of a person's lengths inertia depends on, m."""

    limbs: Mapping[str, float]
    """`thigh_r`, `shank_r`, `upper_arm_r`, `forearm_hand_r` (elbow to wrist) and `_l`: between
    joint centres.
    """
    # (2,) anterior and superior coordinate of the middle of the hip centres in the pelvis frame
    hip_centre: Array
    lumbar_above_hips: float  # from there up to the lumbar joint, along the pelvis's y


@dataclass(frozen=True)
class _Part:
    """A segment of de Leva's in this person."""

    mass: float
    length: float
    centre: float  # m from the first endpoint
    gyration: dict[str, float]  # axis name -> radius of gyration, m


_WHOLE = tuple(part for segment in MASSIVE_SEGMENTS for part in segment_kind(segment).parts)
"""What the body consists of, limbs twice."""


def _row(name: str, sex: str) -> dict[str, float]:
    """A row of the table; where nobody says the sex, the mean of both."""
    rows: dict[str, dict[str, float]] = _tables("de_leva_1996.json")["table"][name]
    return (
        rows[sex]
        if sex
        else {key: 0.5 * (value + rows["male"][key]) for key, value in rows["female"].items()}
    )


def mass_shares(sex: str, age: float | None) -> dict[str, float]:
    """Share of body mass of each of de Leva's segments that make up the body, those of limbs for
    one side; their sum over the whole body is 1. `age` in years; None for an adult.
    """
    percent = {name: _row(name, sex)["mass_pct"] for name in _WHOLE}
    total = sum(percent[name] for name in _WHOLE)
    shares = {name: value / total for name, value in percent.items()}
    if age is not None:
        grown = growth(age)
        shares |= {name: shares[name] * factor for name, factor in grown.items()}
        rest = 1.0 - sum(shares[name] for name in _WHOLE if name in grown)
        torso = sum(shares[name] for name in _WHOLE if name not in grown)
        shares |= {name: shares[name] * rest / torso for name in shares if name not in grown}
    return shares


def table_words(subject: Subject) -> str:
    """The table that the nominal masses are from, and what speaks against it."""
    source = f"de Leva 1996, {subject.sex or 'the mean of women and men, as nobody says the sex'}"
    if unknown := _unknown_spread(subject):
        thigh, trunk = 100 * unknown.get("thigh.mass", 0.0), 1e3 * unknown["head_trunk.com.sup"]
        source += (
            f"; what is not known of the person counts as an error, {thigh:.0f} % of the mass of a "
            "thigh and "
        )
        source += f"{trunk:.0f} mm of the trunk's mass centre among it"
    youngest, adult = youngest_and_adult_age()
    if subject.age is not None and subject.age < adult:
        source += (
            f"; masses changed to {max(subject.age, youngest):g} years of age by Jensen 1989, "
            "measured on boys"
        )
        if subject.age < youngest:
            source += f" of {youngest:g} years and more: the person is {subject.age:g} years old"
    elif looks_like_child(subject):
        more = child_spread(subject)
        source += (
            f"; a table of adults, though {subject.height:.2f} m looks like a child's, with "
            f"{subject.mass:.0f} kg, and no age is known: its masses count as less certain, "
            f"by {100 * more['thigh']:.0f} % for thighs and {100 * more['head_trunk']:.0f} % for "
            "head and trunk, as "
            f"those of children of {supposed_age(subject):g} differ (Jensen 1989); age_years tells "
            "which table to use"
        )
    elif subject.age is None:
        source += "; a table of adults: no age is known"
    return source


def child_spread(subject: Subject) -> dict[str, float]:
    """How far (standard deviation of the logarithm) the table of adults may be from the masses of a
    child whose age is not known: what Jensen's shares change from `supposed_age` to adults. By
    segment without its side; empty for others.
    """
    if not looks_like_child(subject):
        return {}
    adult, child = (mass_shares(subject.sex, age) for age in (None, supposed_age(subject)))
    return {
        segment: float(abs(np.log(sum(child[n] for n in names) / sum(adult[n] for n in names))))
        for segment, names in ((row.name, row.parts) for row in SEGMENT_TABLE.values() if row.parts)
    }


def table_spread(subject: Subject) -> dict[str, float]:
    """How far (standard deviation) the nominal inertia may be off, beside how people scatter about
    the tables, as facts of the person are not known: parameter without its side (`thigh.mass`, ...)
    -> logarithm of masses and second moments, m of mass centres.
    """
    out = _unknown_spread(subject)
    for segment, more in child_spread(subject).items():
        for name in (n for n in UNSIDED if n.startswith(f"{segment}.") and ".com." not in n):
            out[name] = float(np.hypot(out.get(name, 0.0), more))
    return out


def _unknown_spread(subject: Subject) -> dict[str, float]:
    """Of sex and height: half of what women's table differs from men's, or a height one standard
    deviation too large from one as much too small.
    """
    low, high = subject.height - subject.height_error, subject.height + subject.height_error
    pairs = (
        [(replace(subject, height=low), replace(subject, height=high))]
        if subject.height_error
        else []
    )
    if not subject.sex:
        pairs.append((replace(subject, sex="female"), replace(subject, sex="male")))
    lengths = BodyLengths(default_limbs(subject), np.zeros(2), 0.0)
    variance = np.zeros((len(MASSIVE_SEGMENTS), 7))
    for pair in pairs:
        first, second = (inertial_parameters(one, lengths).reshape(variance.shape) for one in pair)
        for rows in (first, second):
            moments = rows[:, 4:7]
            rows[:, 4:7] = np.log(0.5 * moments.sum(axis=1, keepdims=True) - moments)
            rows[:, 0] = np.log(rows[:, 0])
        variance += (0.5 * (second - first)) ** 2
    return {
        name: s
        for name, s in zip(UNSIDED, np.sqrt(variance).ravel().tolist(), strict=True)
        if s > 0
    }


def default_length(name: str, subject: Subject) -> float:
    """Length (m) of a segment of de Leva's table, scaled by height."""
    people = _tables("de_leva_1996.json")["population"]
    shares = [
        _row(name, sex)["length_mm"] / people[sex]["height_mm"]
        for sex in people
        if subject.sex in ("", sex)
    ]
    return sum(shares) / len(shares) * subject.height


def default_limbs(subject: Subject) -> dict[str, float]:
    """Lengths of the limbs where nothing is measured, m."""
    limbs = ("thigh", "shank", "upper_arm", "forearm_hand")
    return {
        f"{s}_{side}": default_length(SEGMENT_TABLE[s].parts[0], subject)
        for s in limbs
        for side in SIDES
    }


def _part(name: str, subject: Subject, length: float | None = None) -> _Part:
    """A segment of de Leva's with this person's share of mass, and of the length (m) given or his."""
    row = _row(name, subject.sex)
    length = default_length(name, subject) if length is None else length
    gyration = {axis: length * row[f"r_{axis}_pct"] / 100 for axis in _DIAGONAL}
    centre = length * row["cm_pct_from_first_endpoint"] / 100
    return _Part(
        subject.mass * mass_shares(subject.sex, subject.age)[name], length, centre, gyration
    )


def inertial_parameters(subject: Subject, lengths: BodyLengths) -> Array:
    """(ni,) nominal inertial parameters, SI."""
    rows: dict[str, Array] = {}
    lower = _part("LowerTrunk", subject)
    ant, sup = lengths.hip_centre
    rows["pelvis"] = _in_line([(lower, sup + lower.length - lower.centre)])
    rows["pelvis"][1] = ant
    # stacked from the lumbar joint up along the trunk
    middle, upper, head = (_part(name, subject) for name in ("MiddleTrunk", "UpperTrunk", "Head2"))
    xiphoid = lower.length - lengths.lumbar_above_hips + middle.length
    vertex = xiphoid + default_length("UpperTrunk2", subject) + head.length
    upper_centre, head_centre = xiphoid + upper.length - upper.centre, vertex - head.centre
    rows["head_trunk"] = _in_line(
        [(middle, xiphoid - middle.centre), (upper, upper_centre), (head, head_centre)]
    )
    for segment in (s for s in MASSIVE_SEGMENTS if s not in rows):
        kind, end, placed = segment_kind(segment), 0.0, list[tuple[_Part, float]]()
        for name in (
            kind.parts
        ):  # one after another from the origin of the segment; the first is what was measured
            part = _part(name, subject, None if placed else lengths.limbs.get(segment))
            placed.append((part, end + part.centre if kind.forward else end - part.centre))
            end += part.length if kind.forward else -part.length
        rows[segment] = _in_line(placed, _FORWARD if kind.forward else _DIAGONAL)
        if kind.forward:
            rows[segment][2] = FOOT_CENTRE_UP * subject.height
    return np.concatenate([rows[segment] for segment in MASSIVE_SEGMENTS])


LIMB_ENDS = {
    "thigh": ("hip", "knee"),
    "shank": ("knee", "talocrural"),
    "upper_arm": ("shoulder", "elbow"),
}
"""Segment -> the joints at its ends. Forearm with hand ends at no joint of the linkage, the foot at
markers.
"""


def with_joints_of(inertial: Array, before: Parameters, after: Parameters) -> Array:
    """(ni,) inertial parameters, SI, of a table, when the joints that it counts from are found
    elsewhere.

    Mass centres of limbs keep their share of the way between both joints, and second moments go
    with the square of its length. Pelvis and trunk stay: counted from the hips found, they explain
    pelvis residuals worse, of people as well.
    """
    rows = table(inertial).copy()
    for side, (segment, ends) in product(SIDES, LIMB_ENDS.items()):
        name = f"{segment}_{side}"
        row, joints = rows[MASSIVE_SEGMENTS.index(name)], [f"{end}_{side}" for end in ends]
        old, new = (
            np.array([parameters.centre(j, name) for j in joints]) for parameters in (before, after)
        )
        square = float(np.sum((old[1] - old[0]) ** 2))
        share = float((row[1:4] - old[0]) @ (old[1] - old[0])) / square
        row[1:4] += (1.0 - share) * (new - old)[0] + share * (new - old)[1]
        row[4:7] *= float(np.sum((new[1] - new[0]) ** 2)) / square
    return rows.ravel()


def _in_line(parts: Sequence[tuple[_Part, float]], axes: Mapping[str, int] = _DIAGONAL) -> Array:
    """(7,) one body of parts whose mass centres lie at these places (m) on the axis that is
    longitudinal; `axes` of the segment's frame by the names of de Leva's.
    """
    mass = sum(part.mass for part, _ in parts)
    centre, moments = np.zeros(3), np.zeros(3)
    centre[axes["longitudinal"]] = middle = sum(part.mass * place for part, place in parts) / mass
    for part, place in parts:
        for name, axis in axes.items():
            away = 0.0 if name == "longitudinal" else place - middle
            moments[axis] += part.mass * (part.gyration[name] ** 2 + away**2)
    return np.array([mass, *centre, *moments])
