"""Facts about the person, and foot events, from the parameters of a C3D file.

PROCESSING is where Vicon's programs keep what was measured by hand: kg and mm, angles in rad. EVENT is the standard's
own group: TIMES is (2, n), minutes and seconds from the beginning of the recording, as the frames count.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from gaitcal.io.labels import clean
from gaitcal.io.metadata import Facts, FootEvent, FootMoment

MILLIMETRE: Final = 1e-3
GRAVITY_M_S2: Final = 9.80665
MASS_KG, HEIGHT_M = (2.0, 400.0), (0.3, 2.6)
"""Outside of these a number is no mass, no height: 0 stands where nobody filled in the form."""
WIDTH_M, LENGTH_M = (0.02, 0.3), (0.1, 1.5)
PERSON_KG, PERSON_M = (5.0, 250.0), (0.5, 2.3)
"""Of a person whose figures are in another unit than they should be: a guess has to be a likely one."""
KNEE_M, ANKLE_M = (0.05, 0.2), (0.03, 0.15)
CENTIMETRE: Final = 1e-2
OTHER_MASSES: Final = {"N": 1 / GRAVITY_M_S2, "g": 1e-3}
OTHER_HEIGHTS: Final = {"cm": CENTIMETRE, "inches": 0.0254}
OTHER_WIDTHS: Final = {"cm": CENTIMETRE}
SIDES: Final = {"right": "r", "left": "l"}
MOMENTS: Final = {
    "foot strike": FootMoment.STRIKE,
    "heel strike": FootMoment.STRIKE,
    "initial contact": FootMoment.STRIKE,
    "foot contact": FootMoment.STRIKE,
    "foot off": FootMoment.OFF,
    "toe off": FootMoment.OFF,
}


_Doubt = tuple[str, float | None] | None
"""A figure that cannot be in its unit, in words, and what it is in the only other unit that fits."""


def facts_of(parameters: Mapping[str, Mapping[str, Any]]) -> Facts:
    """What the groups PROCESSING and SUBJECTS say; a number that cannot be meant is taken as not given."""
    group = {str(name).lower(): value for name, value in parameters.get("PROCESSING", {}).items()}
    subjects = parameters.get("SUBJECTS", {})

    def number(names: Iterable[str], unit: float, allowed: tuple[float, float]) -> float | None:
        for name in names:
            value = _first_number(group.get(name.lower()))
            if value and allowed[0] <= value * unit <= allowed[1]:  # 0 stands where nobody filled in the form
                return value * unit
        return None

    def sided(name: str, unit: float, allowed: tuple[float, float]) -> dict[str, float]:
        found = {s: number([f"{s.upper()}{name}"], unit, allowed) for s in SIDES.values()}
        return {s: value for s, value in found.items() if value is not None}

    def doubt(
        names: Iterable[str], why: str, others: Mapping[str, float], allowed: tuple[float, float], si: str
    ) -> _Doubt:
        for name in names:
            if value := _first_number(group.get(name.lower())):
                told = {unit: value * by for unit, by in others.items() if allowed[0] <= value * by <= allowed[1]}
                if not told:
                    continue  # no figure of a person in any unit: a form that nobody filled in
                words = " or ".join(f"{meant:.4g} {si} if {unit}" for unit, meant in told.items())
                text = f"{name} = {value:g}: {why}; {words}"
                return text, next(iter(told.values())) if len(told) == 1 else None
        return None

    masses, heights = ("Bodymass", "Mass", "Weight"), ("Height",)
    mass = number(masses, 1.0, MASS_KG)
    height = number(heights, MILLIMETRE, HEIGHT_M) or number(heights, 1.0, HEIGHT_M)
    knee, ankle = sided("KneeWidth", MILLIMETRE, WIDTH_M), sided("AnkleWidth", MILLIMETRE, WIDTH_M)
    doubts = {
        "mass": None if mass else doubt(masses, "no mass in kg", OTHER_MASSES, PERSON_KG, "kg"),
        "height": None if height else doubt(heights, "no height in mm or m", OTHER_HEIGHTS, PERSON_M, "m"),
    }
    for field, sides, name, allowed in (
        ("knee_width", knee, "KneeWidth", KNEE_M),
        ("ankle_width", ankle, "AnkleWidth", ANKLE_M),
    ):
        for s in [s for s in SIDES.values() if s not in sides]:
            doubts[f"{field}_{s}"] = doubt([f"{s.upper()}{name}"], "no width in mm", OTHER_WIDTHS, allowed, "m")
    static = _first_number(subjects.get("IS_STATIC"))
    return Facts(
        name=_first_text(subjects.get("NAMES")),
        mass=mass,
        height=height,
        marker_set=_first_text(subjects.get("MARKER_SETS")),
        marker_diameter=number(("MarkerDiameter",), MILLIMETRE, (0.003, 0.04)),
        asis_distance=number(("InterAsisDistance",), MILLIMETRE, (0.08, 0.5)),
        knee_width=knee,
        ankle_width=ankle,
        leg_length=sided("LegLength", MILLIMETRE, LENGTH_M),
        static_plantarflexion=sided("StaticPlantFlex", 1.0, (-1.5, 1.5)),
        doubtful={field: told for field, told in doubts.items() if told is not None},
        is_static=bool(static) if static else None,
    )


def events_of(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[FootEvent, ...]:
    """Foot strikes and offs with a side, in order of time."""
    group = parameters.get("EVENT", {})
    labels, contexts = _texts(group.get("LABELS")), _texts(group.get("CONTEXTS"))
    times = np.asarray(group.get("TIMES", ()), dtype=np.float64)
    if times.ndim != 2 or times.shape[0] != 2:
        return ()
    seconds = 60.0 * times[0] + times[1]
    events = [
        FootEvent(MOMENTS[label.lower()], SIDES[context.lower()], float(second))
        for label, context, second in zip(labels, contexts, seconds, strict=False)
        if label.lower() in MOMENTS and context.lower() in SIDES and np.isfinite(second)
    ]
    return tuple(sorted(events, key=lambda e: e.time))


def _texts(values: Any) -> list[str]:
    return [clean(text) if isinstance(text, str) else "" for text in ([] if values is None else values)]


def _first_text(values: Any) -> str | None:
    return next((text for text in _texts(values) if text), None)


def _first_number(values: Any) -> float | None:
    try:
        found = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None
