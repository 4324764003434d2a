"""The landmarks that a marker set may name, and what serves as each of them."""

from __future__ import annotations

from collections.abc import Iterable

from gaitcal.model.linkage import SIDES, of_side

_SIDED = {
    "asis": "pelvis",
    "knee_lat": "thigh",
    "knee_med": "thigh",
    "knee_axis": "thigh",
    "ankle_lat": "shank",
    "ankle_med": "shank",
    "heel": "foot",
    "toe": "foot",
    "acromion": "head_trunk",
    "elbow_lat": "upper_arm",
    "elbow_med": "upper_arm",
    "wrist": "forearm_hand",
    "hjc": "pelvis",
}
_OF_TRUNK = ("c7", "t10", "jugular_notch", "xiphoid")
SEGMENT_OF: dict[str, str] = {
    "sacrum": "pelvis",
    **dict.fromkeys(_OF_TRUNK, "head_trunk"),
    **{f"{name}_{side}": of_side(segment, side) for side in SIDES for name, segment in _SIDED.items()},
}
"""Landmark -> the segment that it lies in."""
LANDMARKS: tuple[str, ...] = tuple(SEGMENT_OF)
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its centre; `knee_axis` is
a point on the knee's flexion axis outwards of the lateral epicondyle, as a knee alignment device shows it; `hjc` the
centre of a hip, for `hip_centre = "given"`. Those of the trunk's midline tell where it faces where acromia are missing,
`c7` and `jugular_notch` also where the shoulders are; `t10` may be any spinous process from T6 to T12."""

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
