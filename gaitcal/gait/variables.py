"""The variables of the table of strides: what each is, in which unit; `cycles.csv` and all that reads it ask here.

A variable is named after its coordinate, without the side of its leg; an ending says what it is if not the angle:
`hip_flexion` (deg), `hip_flexion_moment` (N m). A further kind is one more member of `Kind`.
"""

from __future__ import annotations

from enum import Enum

from gaitcal.model.coordinates import COORDINATE_TABLE, GROUPS, LEG_GROUPS, LOCKED


class Kind(Enum):
    """What a variable is. `ending`: of its name; `unit`: in tables; `words`: on pages."""

    ANGLE = ("", "deg", "angle")
    MOMENT = ("_moment", "N m", "moment")
    POWER = ("_power", "W", "power")
    FORCE = ("_force", "N", "force")

    def __init__(self, ending: str, unit: str, words: str) -> None:
        self.ending, self.unit, self.words = ending, unit, words


GROUND_REACTION = "ground_reaction_vertical"
"""Upward force of the ground on the foot of that side, N: a force whose name has no ending."""


def kind_of(variable: str) -> Kind:
    """Of a variable of `cycles.csv`: `knee_angle` is an angle, `knee_angle_moment` a moment."""
    if variable == GROUND_REACTION:
        return Kind.FORCE
    return next((kind for kind in Kind if kind.ending and variable.endswith(kind.ending)), Kind.ANGLE)


def unit_of(variable: str) -> str:
    """`deg`, `N m`, `W`, `N`."""
    return kind_of(variable).unit


def coordinate_of(variable: str) -> str:
    """The coordinate of a variable, without a side: `knee_angle_moment` -> `knee_angle`."""
    kind = kind_of(variable)
    return variable.removesuffix(kind.ending) if kind.ending else variable


def known_variables() -> tuple[str, ...]:
    """Every variable that a table of strides may hold, without sides: all but those of the arms."""
    rows = [row for row in COORDINATE_TABLE.values() if row.group != "arm"]
    angles = tuple(row.name for row in rows if row.name not in LOCKED)
    moved = (*(n for n in angles if COORDINATE_TABLE[n].group != "pelvis"), *LOCKED)
    powers = (*moved, *(GROUPS[key].power for key in LEG_GROUPS))
    return (
        *angles,
        *(f"{name}{Kind.MOMENT.ending}" for name in moved),
        *(f"{name}{Kind.POWER.ending}" for name in powers),
        GROUND_REACTION,
    )
