"""Populations of people that the program does not know: how the joints of their linkage deviate from nominal ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_NAMES, Kind
from gaitcal.study.joint_prior import HEIGHT, STEP, Person, mirror

POSITION = np.array([p.kind is Kind.POSITION for p in JOINT_PARAMETERS])
Draw = Callable[[np.random.Generator, Person], Array]
"""(98,) m, rad: deviations of a new person."""


def scaled(millimetres: float, degrees: float) -> Array:
    """(98,) m, rad."""
    return np.where(POSITION, 1e-3 * millimetres, np.deg2rad(degrees))


def both_sides(values: Array) -> Array:
    """(98,) the same on both sides."""
    reflected = mirror(JP_NAMES)
    return 0.5 * (values + reflected @ values) * np.where(_paired(), np.sqrt(2.0), 1.0)


def _paired() -> Array:
    return np.array([p.joint[-2:] in ("_r", "_l") for p in JOINT_PARAMETERS])


def offset(rng: np.random.Generator) -> Draw:
    """Everybody deviates by nearly the same: uniform within 10 mm and 10 deg; their own spread is 2 mm and 2 deg."""
    common = both_sides(rng.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0))
    return lambda own, person: common + own.normal(size=len(common)) * scaled(2.0, 2.0)


def wide(rng: np.random.Generator) -> Draw:
    """No deviation in common; each parameter independent, uniform within 10 mm and 10 deg as `synthesize --perturb`."""
    return lambda own, person: own.uniform(-1.0, 1.0, len(JP_NAMES)) * scaled(10.0, 10.0)


def structured(rng: np.random.Generator) -> Draw:
    """Three traits move many parameters of both sides together (4 mm, 4 deg each), size moves them by 4 mm and 3 deg
    for 10 cm, an offset by 4 mm and 4 deg; their own spread is 1.5 mm, 1.5 deg.
    """
    count = len(JP_NAMES)
    traits = np.array([both_sides(rng.normal(size=count) * scaled(4.0, 4.0)) for _ in range(3)])
    size = both_sides(rng.normal(size=count) * scaled(4.0, 3.0))
    common = both_sides(rng.normal(size=count) * scaled(4.0, 4.0))

    def draw(own: np.random.Generator, person: Person) -> Array:
        by_size = (person.height - HEIGHT) / STEP * size
        out: Array = common + by_size + own.normal(size=3) @ traits + own.normal(size=count) * scaled(1.5, 1.5)
        return out

    return draw


POPULATIONS: dict[str, Callable[[np.random.Generator], Draw]] = {
    "offset": offset,
    "wide": wide,
    "structured": structured,
}
"""Of a generator that makes the population, what draws its people."""
