"""Which of our segments a peer's body belongs to, and which of its markers is which of ours.

Body names as in the OpenSim models Gait2354, Gait2392 and Rajagopal2016, and our own.
"""

from __future__ import annotations

from gaitcal.model.joint_parameters import SIDES
from gaitcal.model.linkage import SEGMENTS

ARMS: tuple[str, ...] = tuple(f"{part}_{side}" for side in SIDES for part in ("upper_arm", "forearm_hand"))

_MIDDLE = {"pelvis": "pelvis", "torso": "head_trunk", "trunk": "head_trunk", "head": "head_trunk"}
_SIDED = {
    "femur": "thigh",
    "patella": "thigh",
    "tibia": "shank",
    "fibula": "shank",
    "pretalus": "foot",
    "talus": "foot",
    "calcn": "foot",
    "toes": "foot",
    "humerus": "upper_arm",
    "ulna": "forearm_hand",
    "radius": "forearm_hand",
    "hand": "forearm_hand",
}
_SLIDING = ("patella_r", "patella_l")
"""Bodies that slide on the segment they are counted with, so that their markers are no part of it."""


def segment_of(body: str) -> str | None:
    """Our segment for a peer's body (the talus counts with the foot), or None."""
    if body in _MIDDLE:
        return _MIDDLE[body]
    stem, _, side = body.rpartition("_")
    if side in SIDES and stem in _SIDED:
        return f"{_SIDED[stem]}_{side}"
    return body if body in SEGMENTS else None


def moves_with_segment(body: str) -> bool:
    """Whether a marker on this body may stand for its segment."""
    return body not in _SLIDING


def same_label(label: str, candidates: tuple[str, ...]) -> str | None:
    """The candidate with this name; else the only one that is the same but for case and punctuation; else None."""
    if label in candidates:
        return label
    plain = _plain(label)
    alike = [c for c in candidates if _plain(c) == plain]
    return alike[0] if len(alike) == 1 and plain else None


def _plain(label: str) -> str:
    return "".join(c for c in label.casefold() if c.isalnum())
