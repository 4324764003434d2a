"""The rows of small multiples: which coordinates belong to which joint, and what their signs mean."""

from __future__ import annotations

from typing import Any, Final

from gaitcal.gait.conventions import PELVIS_SENSES, SENSES, TRUNK_SENSES
from gaitcal.gait.words import coordinate_words

JOINTS: Final = {
    "hip": ("Hip", ("hip_flexion", "hip_adduction", "hip_rotation")),
    "knee": ("Knee", ("knee_angle", "knee_adduction")),
    "ankle": ("Ankle and foot", ("ankle_angle", "subtalar_angle")),
    "pelvis": ("Pelvis", ("pelvis_tilt", "pelvis_list", "pelvis_rotation")),
    "trunk": ("Trunk", ("lumbar_extension", "lumbar_bending", "lumbar_rotation")),
    "arm": ("Arm", ("arm_flex", "arm_add", "elbow_flex")),
}
"""Joint of the page -> its title and its coordinates, in the order of the page."""
POWER_OF: Final = {"hip": "hip", "knee": "knee", "ankle": "ankle", "trunk": "lumbar"}
"""Joint of the page -> its power over all axes, as in `powers/TRIAL.csv`."""


def sheet_rows() -> list[dict[str, Any]]:
    """Joints with their coordinates: titles, and what positive and negative values mean.

    `angle`, `moment`: words for a positive and a negative value with OpenSim's signs, moments internal. `flips`: the
    clinical signs have the opposite moment. `pelvis`: side of the stride -> sign and word of the clinical angle.
    """
    return [
        {"joint": joint, "title": title, "power": POWER_OF.get(joint), "rows": [_row(base) for base in bases]}
        for joint, (title, bases) in JOINTS.items()
    ]


def joint_of(base: str) -> str:
    """The joint of the page that a coordinate, or a power of a joint, belongs to; empty where none."""
    for joint, (_, bases) in JOINTS.items():
        if base in bases or base == POWER_OF.get(joint):
            return joint
    return ""


def _row(base: str) -> dict[str, Any]:
    words, senses = coordinate_words(base), {**SENSES, **TRUNK_SENSES}.get(base)
    pelvis = {side: PELVIS_SENSES[base, side] for side in "rl" if (base, side) in PELVIS_SENSES}
    return {
        "base": base,
        "title": words.title,
        "angle": list(senses or (words.angle, f"not {words.angle}")),
        "moment": list(senses or (words.moment, f"not {words.moment}")),
        "actor": words.moment,
        "flips": base in SENSES,
        "pelvis": {side: {"sign": sign, "words": sense} for side, (sign, sense) in pelvis.items()},
    }
