"""The landmarks that a marker set may name, and what serves as each of them."""

from __future__ import annotations

from collections.abc import Iterable

from gaitcal.model.linkage import SIDES

_SIDED = (
    "asis",
    "knee_lat",
    "knee_med",
    "knee_axis",
    "ankle_lat",
    "ankle_med",
    "heel",
    "toe",
    "acromion",
    "elbow_lat",
    "elbow_med",
    "wrist",
)
LANDMARKS: tuple[str, ...] = ("sacrum", *(f"{name}_{side}" for side in SIDES for name in _SIDED))
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its centre; `knee_axis` is
a point on the knee's flexion axis outwards of the lateral epicondyle, as a knee alignment device shows it."""

_INSTEAD = {
    "asis": "a marker on the anterior superior iliac spine",
    "sacrum": "a marker midway between the posterior superior iliac spines, or the list of the two on them",
    "knee_lat": "a marker on the lateral femoral epicondyle",
    "ankle_lat": "a marker on the lateral malleolus",
    "heel": "a marker on the back of the heel",
    "toe": "a marker on the tip of the foot or over the head of the second metatarsal",
}
REQUIRED: tuple[str, ...] = tuple(
    name for name in LANDMARKS if name == "sacrum" or name.rsplit("_", 1)[0] in set(_INSTEAD)
)
"""Landmarks without which there is no model; all others have a default or freeze their segment."""
PARTNER: dict[str, str] = {
    f"{one}_{side}": f"{other}_{side}" for side in SIDES for one, other in (("heel", "toe"), ("toe", "heel"))
}
"""Landmark of a foot -> the one from which it is guessed where no marker shows it."""


def missing_landmarks(given: Iterable[str]) -> tuple[str, ...]:
    """Required landmarks that are not among those given; of a foot, heel or toe is enough."""
    there = set(given)
    return tuple(name for name in REQUIRED if name not in there and PARTNER.get(name) not in there)


def instead_of(landmark: str) -> str:
    """What serves as a required landmark, for an error message."""
    return _INSTEAD.get(landmark) or _INSTEAD[landmark.rsplit("_", 1)[0]]
