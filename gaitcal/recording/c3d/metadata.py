"""Facts about the person, and foot events, from the parameters of a C3D file.

PROCESSING is where Vicon's programs keep what was measured by hand: kg and mm, angles in rad. EVENT is the standard's
own group: TIMES is (2, n), minutes and seconds from the beginning of the recording, as the frames count.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from gaitcal.recording.labels import clean
from gaitcal.recording.metadata import Facts, FootEvent, FootMoment

MILLIMETRE: Final = 1e-3
MASS_KG, HEIGHT_M = (2.0, 400.0), (0.3, 2.6)
"""Outside of these a number is no mass, no height: 0 stands where nobody filled in the form."""
WIDTH_M, LENGTH_M = (0.02, 0.3), (0.1, 1.5)
SIDES: Final = {"right": "r", "left": "l"}
MOMENTS: Final = {
    "foot strike": FootMoment.STRIKE,
    "heel strike": FootMoment.STRIKE,
    "initial contact": FootMoment.STRIKE,
    "foot contact": FootMoment.STRIKE,
    "foot off": FootMoment.OFF,
    "toe off": FootMoment.OFF,
}


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

    static = _first_number(subjects.get("IS_STATIC"))
    return Facts(
        name=_first_text(subjects.get("NAMES")),
        mass=number(("Bodymass", "Mass", "Weight"), 1.0, MASS_KG),
        height=number(("Height",), MILLIMETRE, HEIGHT_M) or number(("Height",), 1.0, HEIGHT_M),
        marker_set=_first_text(subjects.get("MARKER_SETS")),
        marker_diameter=number(("MarkerDiameter",), MILLIMETRE, (0.003, 0.04)),
        asis_distance=number(("InterAsisDistance",), MILLIMETRE, (0.08, 0.5)),
        knee_width=sided("KneeWidth", MILLIMETRE, WIDTH_M),
        ankle_width=sided("AnkleWidth", MILLIMETRE, WIDTH_M),
        leg_length=sided("LegLength", MILLIMETRE, LENGTH_M),
        static_plantarflexion=sided("StaticPlantFlex", 1.0, (-1.5, 1.5)),
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
