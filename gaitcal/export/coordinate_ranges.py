"""Ranges of the coordinates, for sliders and documentation: what living people reach, generously.

They are written as they are but enforced nowhere (OpenSim: unclamped; MuJoCo: unlimited), because a calibrated
linkage may pass them and the exported model must stay the same mechanical system. Names and signs of Rajagopal et al.
2016, whose ranges these contain; the lengths are those of a laboratory.
"""

from __future__ import annotations

import math

from gaitcal.model.linkage import COORDINATES, is_translation

_DEGREES = {
    "pelvis_tilt": (-90.0, 90.0),
    "pelvis_list": (-90.0, 90.0),
    "pelvis_rotation": (-180.0, 180.0),
    "hip_flexion": (-40.0, 130.0),
    "hip_adduction": (-60.0, 40.0),
    "hip_rotation": (-50.0, 50.0),
    "knee_angle": (-15.0, 150.0),
    "ankle_angle": (-60.0, 40.0),
    "subtalar_angle": (-40.0, 40.0),
    "lumbar_extension": (-90.0, 90.0),
    "lumbar_bending": (-90.0, 90.0),
    "lumbar_rotation": (-90.0, 90.0),
    "arm_flex": (-90.0, 180.0),
    "arm_add": (-150.0, 90.0),
    "elbow_flex": (-15.0, 160.0),
}
_METRES = {"pelvis_tx": (-20.0, 20.0), "pelvis_ty": (-1.0, 3.0), "pelvis_tz": (-20.0, 20.0)}


def coordinate_range(coordinate: str) -> tuple[float, float]:
    """Lowest and highest usual value, m or rad."""
    if is_translation(coordinate):
        return _METRES[coordinate]
    low, high = _DEGREES[coordinate[:-2] if coordinate.endswith(("_r", "_l")) else coordinate]
    return math.radians(low), math.radians(high)


COORDINATE_RANGES: dict[str, tuple[float, float]] = {name: coordinate_range(name) for name in COORDINATES}
"""All 27, m or rad."""
