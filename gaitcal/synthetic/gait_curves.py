"""The curves of the nominal gait: the coordinates of one person over the gait cycle, as harmonics.

Six harmonics a coordinate (`models/nominal_subject.json`), derived from OpenSim's Gait2392 `subject01` (CC BY 3.0).
They have knee flexion negative and shoulder abduction positive; the signs of the product's coordinates are made here.
Nothing makes them a motion that the ground can carry: that is done for each person (`walk.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.toml import models_path
from gaitcal.model.coordinates import split_side
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES

GAIT_CYCLE = 1.035
"""s, `cycle_s` of the nominal gait."""

_CURVE_OF = {
    "pelvis_tx": ("tx", 1.0),
    "pelvis_ty": ("ty", 1.0),
    "pelvis_tz": ("tz", 1.0),
    "pelvis_tilt": ("tilt", 1.0),
    "pelvis_list": ("list", 1.0),
    "pelvis_rotation": ("prot", 1.0),
    "hip_flexion": ("hflex", 1.0),
    "hip_adduction": ("hadd", 1.0),
    "hip_rotation": ("hrot", 1.0),
    "knee_angle": ("knee", -1.0),
    "ankle_angle": ("tc", 1.0),
    "subtalar_angle": ("st", 1.0),
    "lumbar_extension": ("lext", 1.0),
    "lumbar_bending": ("lbend", 1.0),
    "lumbar_rotation": ("lrot", 1.0),
    "arm_flex": ("sflex", 1.0),
    "arm_add": ("sabd", -1.0),
    "elbow_flex": ("elb", 1.0),
}
"""Coordinate without its side -> its curve in the file, and the factor of its sign, where it is not there by name."""


def gait_curves(phase: Array) -> Array:
    """(nf, nq) m, rad, at phases (nf,) in strides; 0: right heel strike."""
    data, out = _nominal_gait(), _sums(phase, _values)
    out[:, COORDINATE_INDEX["pelvis_tx"]] += data["stride_m"] * phase
    return out


def gait_accelerations(phase: Array) -> Array:
    """(nf, nq) m/s^2, rad/s^2 of the curves."""
    return _sums(phase, _accelerations)


def _sums(phase: Array, of: Callable[[Array, Array, Array], Array]) -> Array:
    curves = _nominal_gait()["curves"]
    out = np.empty((len(phase), len(COORDINATES)))
    for i, name in enumerate(COORDINATES):
        stem = split_side(name)[0]
        curve, sign = _CURVE_OF.get(stem, (stem, 1.0))
        a, b = (np.array(curves[curve][part], dtype=float) for part in "ab")
        values = of(phase + (0.5 if name.endswith("_l") else 0.0), a, b)
        out[:, i] = sign * (values if curves[curve]["unit"] == "m" else np.deg2rad(values))
    return out


def _values(phase: Array, a: Array, b: Array) -> Array:
    angle = 2 * np.pi * np.outer(phase, np.arange(len(a)))
    out: Array = np.cos(angle) @ a + np.sin(angle) @ b
    return out


def _accelerations(phase: Array, a: Array, b: Array) -> Array:
    omega = 2 * np.pi * np.arange(len(a)) / GAIT_CYCLE
    return _values(phase, -(omega**2) * a, -(omega**2) * b)


@cache
def _nominal_gait() -> dict[str, Any]:
    gait: dict[str, Any] = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))[
        "nominal_gait"
    ]
    return gait
