"""Nominal inertial parameters of a person from the tables of de Leva 1996 and Jensen 1989.

Mass fractions, mass centres and radii of gyration are de Leva's (`models/de_leva_1996.json`). The
fractions are divided by their sum (99.99 % for women), so that the total is the person's mass.
Lengths of thigh, shank, upper arm and forearm are measured between the person's joint centres.
Those of pelvis, trunk, head, hand and foot are de Leva's, scaled by height: no marker set measures
them well. Axes: sagittal = x, longitudinal = y, transverse = z. In the foot longitudinal = x,
transverse = y, sagittal = z.

    pelvis           lower trunk, its lower end at the height of the hip centres, its mass centre
                     straight above them
    head and trunk   middle trunk, upper trunk and head stacked on it along y; head from cervicale
                     up (parallel axes)
    forearm, hand    the hand in line with the forearm

Masses of a child whose age is given follow Jensen 1989 (`models/jensen_1989.json`). Tables of
adults and of children divide the body at different places, so one cannot replace the other.
Jensen's thigh at 18 years has 11 % of the mass, de Leva's of an adult 14 %. The change with age is
a ratio in which the place cancels:

    growth(age) = Jensen's share at that age / Jensen's share at 18 years

for head, upper arm, forearm with hand, thigh, and shank with foot. The torso has the rest. Jensen
measured boys; no polynomials for girls are known.
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
from gaitcal.model.linkage import SEGMENT_TABLE, SIDES, get_segment
from gaitcal.model.parameters import IP_NAMES, MASSIVE_SEGMENTS, Parameters, view_as_table
from gaitcal.model.subject_model import Subject

# m; few adults are shorter, and most children before puberty are
CHILD_HEIGHT = 1.45
YOUTH_HEIGHT, YOUTH_MASS = 1.60, 50.0
"""m and kg: a person below both may be a child of 10 to 14 years. The median child exceeds both
shortly before the 14th birthday (2000 CDC Growth Charts, Vital Health Stat 11(246), 2002). Some
slender women are below both, too."""
UNKNOWN_AGE, UNKNOWN_AGE_OF_YOUTH = 8.0, 12.0
"""Years: assumed age of a probable child below `CHILD_HEIGHT`, and of any other. The error of the
adults' table is estimated from it. Half of the children of 12 are taller than 1.50 m."""

UNSIDED = tuple(name.replace("_r.", ".").replace("_l.", ".") for name in IP_NAMES)
"""(ni,) names of inertial parameters without their side."""


@functools.cache
def _read_json_table(name: str) -> dict[str, Any]:
    """Read a file of `models/` once."""
    data: dict[str, Any] = json.loads((find_models_folder() / name).read_text(encoding="utf-8"))
    return data


def get_growth_ages() -> tuple[float, float]:
    """Get the ages (years) from which and up to which the mass shares change."""
    low, high = _read_json_table("jensen_1989.json")["age_years"]
    return float(low), float(high)


def compute_jensen_share(part: str, age: float) -> float:
    """Compute the share of body mass (0 to 1) of one of Jensen's parts at an age (years)."""
    return float(
        np.polynomial.polynomial.polyval(
            age, _read_json_table("jensen_1989.json")["mass_share"][part]
        )
    )


def compute_growth_ratios(age: float) -> dict[str, float]:
    """Compute the mass shares of a child relative to those of an adult.

    `age`: years; 1 is returned from 18 years on. Returns: de Leva's segment -> its share of body
    mass at this age over that of an adult.
    """
    youngest, adult = get_growth_ages()
    at = float(np.clip(age, youngest, adult))
    parts: dict[str, str] = _read_json_table("jensen_1989.json")["part_of"]
    return {
        name: compute_jensen_share(part, at) / compute_jensen_share(part, adult)
        for name, part in parts.items()
        if name in _BODY_PARTS
    }


def is_probably_child(subject: Subject) -> bool:
    """Return whether the age is missing while height and mass may be those of a child."""
    youth = subject.height < YOUTH_HEIGHT and subject.mass < YOUTH_MASS
    return subject.age is None and (subject.height < CHILD_HEIGHT or youth)


def _estimate_child_age(subject: Subject) -> float:
    """Estimate the age (years) of a person that `is_probably_child`."""
    return UNKNOWN_AGE if subject.height < CHILD_HEIGHT else UNKNOWN_AGE_OF_YOUTH


FOOT_CENTRE_UP = 0.0004 / 1.70
"""Height of the foot's mass centre above the heel-toe line over body height. It is not zero, as the
published cost divides by it."""
_DIAGONAL = {"sagittal": 0, "longitudinal": 1, "transverse": 2}
_FORWARD = {"longitudinal": 0, "transverse": 1, "sagittal": 2}


@dataclass(frozen=True)
class BodyLengths:
    """Lengths (m) that the inertial parameters of a person depend on."""

    limbs: Mapping[str, float]
    """`thigh_r`, `shank_r`, `upper_arm_r`, `forearm_hand_r` (elbow to wrist) and `_l`: between
    joint centres.
    """
    # (2,) anterior and superior coordinate of the middle of the hip centres in the pelvis frame
    hip_centre: Array
    # from there up to the lumbar joint, along the pelvis's y
    lumbar_above_hips: float


@dataclass(frozen=True)
class _Part:
    """One of de Leva's segments, scaled to this person."""

    mass: float
    length: float
    centre: float  # m from the first endpoint
    gyration: dict[str, float]  # axis name -> radius of gyration, m


_BODY_PARTS = tuple(part for segment in MASSIVE_SEGMENTS for part in get_segment(segment).parts)
"""de Leva's segments that make up the body, limbs twice."""


def _get_table_row(name: str, sex: str) -> dict[str, float]:
    """Get a row of de Leva's table; the mean of both sexes if the sex is not given."""
    rows: dict[str, dict[str, float]] = _read_json_table("de_leva_1996.json")["table"][name]
    return (
        rows[sex]
        if sex
        else {key: 0.5 * (value + rows["male"][key]) for key, value in rows["female"].items()}
    )


def compute_mass_shares(sex: str, age: float | None) -> dict[str, float]:
    """Compute the share of body mass of each of de Leva's segments.

    `sex`: `male`, `female`, or empty for the mean of both. `age`: years; None for an adult.
    Returns: segment -> share; limbs of one side. The sum over the whole body is 1.
    """
    percent = {name: _get_table_row(name, sex)["mass_pct"] for name in _BODY_PARTS}
    total = sum(percent[name] for name in _BODY_PARTS)
    shares = {name: value / total for name, value in percent.items()}
    if age is not None:
        grown = compute_growth_ratios(age)
        shares |= {name: shares[name] * factor for name, factor in grown.items()}
        rest = 1.0 - sum(shares[name] for name in _BODY_PARTS if name in grown)
        torso = sum(shares[name] for name in _BODY_PARTS if name not in grown)
        shares |= {name: shares[name] * rest / torso for name in shares if name not in grown}
    return shares


def describe_mass_table(subject: Subject) -> str:
    """Describe the table that the nominal masses are from, and its limits for this person."""
    source = f"de Leva 1996, {subject.sex or 'the mean of women and men, as the sex is not given'}"
    if unknown := _estimate_missing_facts_error(subject):
        thigh, trunk = 100 * unknown.get("thigh.mass", 0.0), 1e3 * unknown["head_trunk.com.sup"]
        source += f"; missing facts of the person count as an error, {thigh:.0f} % of the mass of "
        source += f"a thigh and {trunk:.0f} mm of the trunk's mass centre among it"
    youngest, adult = get_growth_ages()
    if subject.age is not None and subject.age < adult:
        source += (
            f"; masses changed to {max(subject.age, youngest):g} years of age by Jensen 1989, "
            "measured on boys"
        )
        if subject.age < youngest:
            source += f" of {youngest:g} years and more: the person is {subject.age:g} years old"
    elif is_probably_child(subject):
        more = estimate_child_table_error(subject)
        source += (
            f"; a table of adults, though {subject.height:.2f} m looks like a child's, with "
            f"{subject.mass:.0f} kg, and the age is not given: its masses count as less certain, "
            f"by {100 * more['thigh']:.0f} % for thighs and {100 * more['head_trunk']:.0f} % for "
            "head and trunk, as "
            f"those of children of {_estimate_child_age(subject):g} differ (Jensen 1989); "
            "age_years selects the table"
        )
    elif subject.age is None:
        source += "; a table of adults: the age is not given"
    return source


def estimate_child_table_error(subject: Subject) -> dict[str, float]:
    """Estimate how far the adults' table may be from the masses of a child of unknown age.

    Returns: segment without its side -> standard deviation of the logarithm of its mass: the change
    of Jensen's shares from `_estimate_child_age` to adults. Empty if the person is no probable
    child.
    """
    if not is_probably_child(subject):
        return {}
    adult, child = (
        compute_mass_shares(subject.sex, age) for age in (None, _estimate_child_age(subject))
    )
    errors: dict[str, float] = {}
    for row in SEGMENT_TABLE.values():
        # the talus is massless: it has no parts
        if row.parts:
            ratio = sum(child[n] for n in row.parts) / sum(adult[n] for n in row.parts)
            errors[row.name] = float(abs(np.log(ratio)))
    return errors


def estimate_table_error(subject: Subject) -> dict[str, float]:
    """Estimate the error of nominal inertia that stems from missing facts of the person.

    The scatter of people about the tables is not included.

    Parameters
    ----------
    subject : Subject
        The person, whose sex or age may be missing and whose height may be estimated.

    Returns
    -------
    dict
        Parameter without its side (`thigh.mass`, ...) -> standard deviation: of the logarithm of
        masses and second moments, m of mass centres.
    """
    out = _estimate_missing_facts_error(subject)
    for segment, more in estimate_child_table_error(subject).items():
        for name in (n for n in UNSIDED if n.startswith(f"{segment}.") and ".com." not in n):
            out[name] = float(np.hypot(out.get(name, 0.0), more))
    return out


def _estimate_missing_facts_error(subject: Subject) -> dict[str, float]:
    """Estimate the error by an unknown sex or an estimated height, as in `estimate_table_error`.

    It is half the difference between both sexes' tables, or between heights one standard deviation
    too small and too large.
    """
    low, high = subject.height - subject.height_error, subject.height + subject.height_error
    pairs = (
        [(replace(subject, height=low), replace(subject, height=high))]
        if subject.height_error
        else []
    )
    if not subject.sex:
        pairs.append((replace(subject, sex="female"), replace(subject, sex="male")))
    lengths = BodyLengths(compute_default_limb_lengths(subject), np.zeros(2), 0.0)
    variance = np.zeros((len(MASSIVE_SEGMENTS), 7))
    for pair in pairs:
        first, second = (
            compute_inertial_parameters(one, lengths).reshape(variance.shape) for one in pair
        )
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


def compute_default_length(name: str, subject: Subject) -> float:
    """Compute the length (m) of a segment of de Leva's table, scaled by height."""
    people = _read_json_table("de_leva_1996.json")["population"]
    shares = [
        _get_table_row(name, sex)["length_mm"] / people[sex]["height_mm"]
        for sex in people
        if subject.sex in ("", sex)
    ]
    return sum(shares) / len(shares) * subject.height


def compute_default_limb_lengths(subject: Subject) -> dict[str, float]:
    """Compute limb lengths by height alone: `thigh_r`, ... -> m."""
    limbs = ("thigh", "shank", "upper_arm", "forearm_hand")
    return {
        f"{s}_{side}": compute_default_length(SEGMENT_TABLE[s].parts[0], subject)
        for s in limbs
        for side in SIDES
    }


def _scale_part(name: str, subject: Subject, length: float | None = None) -> _Part:
    """Scale a segment of de Leva's to this person; its `length` (m) is by height if not given."""
    row = _get_table_row(name, subject.sex)
    length = compute_default_length(name, subject) if length is None else length
    gyration = {axis: length * row[f"r_{axis}_pct"] / 100 for axis in _DIAGONAL}
    centre = length * row["cm_pct_from_first_endpoint"] / 100
    return _Part(
        subject.mass * compute_mass_shares(subject.sex, subject.age)[name], length, centre, gyration
    )


def compute_inertial_parameters(subject: Subject, lengths: BodyLengths) -> Array:
    """Compute the nominal inertial parameters of a person.

    Parameters
    ----------
    subject : Subject
        Mass, height, sex and age of the person.
    lengths : BodyLengths
        Measured lengths (m).

    Returns
    -------
    (ni,) array
        kg, m, kg m^2 in the order of `parameters.IP_NAMES`.
    """
    rows: dict[str, Array] = {}
    lower = _scale_part("LowerTrunk", subject)
    ant, sup = lengths.hip_centre
    rows["pelvis"] = _combine_parts([(lower, sup + lower.length - lower.centre)])
    rows["pelvis"][1] = ant
    # stacked from the lumbar joint up along the trunk
    middle, upper, head = (
        _scale_part(name, subject) for name in ("MiddleTrunk", "UpperTrunk", "Head2")
    )
    xiphoid = lower.length - lengths.lumbar_above_hips + middle.length
    vertex = xiphoid + compute_default_length("UpperTrunk2", subject) + head.length
    upper_centre, head_centre = xiphoid + upper.length - upper.centre, vertex - head.centre
    rows["head_trunk"] = _combine_parts(
        [(middle, xiphoid - middle.centre), (upper, upper_centre), (head, head_centre)]
    )
    for segment in (s for s in MASSIVE_SEGMENTS if s not in rows):
        kind, end, placed = get_segment(segment), 0.0, list[tuple[_Part, float]]()
        # parts follow one another from the segment's origin; the first has the measured length
        for name in kind.parts:
            part = _scale_part(name, subject, None if placed else lengths.limbs.get(segment))
            placed.append((part, end + part.centre if kind.forward else end - part.centre))
            end += part.length if kind.forward else -part.length
        rows[segment] = _combine_parts(placed, _FORWARD if kind.forward else _DIAGONAL)
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


def move_limb_inertia(inertial: Array, before: Parameters, after: Parameters) -> Array:
    """Move the tabulated inertia of limbs with joints that were found elsewhere.

    Mass centres keep their share of the line between both joints. Second moments change with the
    square of its length. Pelvis and trunk stay: moved with the hips, they explain pelvis residuals
    worse.

    Parameters
    ----------
    inertial : (ni,) array
        Inertial parameters of the table, SI units.
    before, after : Parameters
        Joint parameters that the table was applied to, and those found.

    Returns
    -------
    (ni,) array
        Inertial parameters, SI units.
    """
    rows = view_as_table(inertial).copy()
    for side, (segment, ends) in product(SIDES, LIMB_ENDS.items()):
        name = f"{segment}_{side}"
        row, joints = rows[MASSIVE_SEGMENTS.index(name)], [f"{end}_{side}" for end in ends]
        old = np.array([before.centre(joint, name) for joint in joints])
        new = np.array([after.centre(joint, name) for joint in joints])
        # share of the line between the joints at which the mass centre is
        square = float(np.sum((old[1] - old[0]) ** 2))
        share = float((row[1:4] - old[0]) @ (old[1] - old[0])) / square
        row[1:4] += (1.0 - share) * (new - old)[0] + share * (new - old)[1]
        row[4:7] *= float(np.sum((new[1] - new[0]) ** 2)) / square
    return rows.ravel()


def _combine_parts(
    parts: Sequence[tuple[_Part, float]], axes: Mapping[str, int] = _DIAGONAL
) -> Array:
    """Combine parts on the longitudinal axis to one body: (7,) mass, mass centre, moments.

    `parts` have the positions (m) of their mass centres; `axes` maps de Leva's axes to the
    segment's.
    """
    mass = sum(part.mass for part, _ in parts)
    centre, moments = np.zeros(3), np.zeros(3)
    centre[axes["longitudinal"]] = middle = sum(part.mass * place for part, place in parts) / mass
    for part, place in parts:
        for name, axis in axes.items():
            away = 0.0 if name == "longitudinal" else place - middle
            moments[axis] += part.mass * (part.gyration[name] ** 2 + away**2)
    return np.array([mass, *centre, *moments])
