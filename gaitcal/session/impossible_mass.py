"""Whether the mass that a file says can be a person's: against the plates under the standing person, and the height.

A mass in pounds is 2.2, a weight in newtons 9.81 times the mass in kg; forces and torques would be blamed for it.
"""

from __future__ import annotations

from collections.abc import Mapping

from gaitcal.model.build import GRAVITY
from gaitcal.session.person_facts import Known, Options

WEIGHS_ANOTHER = 0.2
"""Relative difference from the plates with which no torque is worth anything."""
BODY_MASS_INDEX = (8.0, 70.0)
"""kg/m^2, outside of which nobody is recorded walking."""
FACTORS = {"lb": 2.2046, "N": GRAVITY}
"""Unit -> how many of it are a kilogram."""
ALIKE = 0.1
"""Relative difference from such a factor up to which it is named."""


def mass_fault(person: Mapping[str, Known], options: Options, plates: tuple[str, float] | None) -> str:
    """Why the mass of a file cannot be that of the person; empty where it can, or where the user says it.

    `plates`: static trial, and the mass (kg) that the plates weigh in it.
    """
    known = person.get("mass_kg")
    if known is None or options.mass is not None:
        return ""
    mass = float(str(known.value))
    said = f"subject.mass_kg: found {mass:g} ({known.reason.partition(';')[0]})"
    cure = "give --mass KG"
    if plates is not None and abs(mass / plates[1] - 1) > WEIGHS_ANOTHER:
        ratio = mass / plates[1]
        unit = next((f": {mass / by:.1f} kg if it is in {u}" for u, by in FACTORS.items() if _near(ratio, by)), "")
        return f"{said}, {ratio:.2f} times the {plates[1]:.1f} kg that the plates weigh in {plates[0]}{unit}; {cure}"
    if (height := person.get("height_m")) is not None:
        tall = float(str(height.value)) ** 2
        low, high = (limit * tall for limit in BODY_MASS_INDEX)
        if not low <= mass <= high:
            meant = {unit: mass / by for unit, by in FACTORS.items() if low <= mass / by <= high}
            units = " or ".join(f"{kg:.1f} kg if it is in {unit}" for unit, kg in meant.items())
            words = f"{said}; allowed: {low:.0f} to {high:.0f} kg at a height of {height.value} m"
            return f"{words}{': ' if units else ''}{units}; {cure}, or --height M"
    return ""


def _near(ratio: float, factor: float) -> bool:
    return abs(ratio / factor - 1) < ALIKE
