"""Known motions of the built-in subject: one gait cycle and the six isolated trials.

The nominal gait curves (`models/nominal_subject.json`, six harmonics a coordinate, derived from OpenSim's Gait2392
`subject01`, CC BY 3.0) and the isolated movements are fitted by quintic splines of 20 nodes and sampled from these:
the true motion lies in the spline space exactly, so that a noiseless reproduction can be exact. The curves have knee
flexion negative and shoulder abduction positive; the signs of the product's coordinates are made here.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.files.package_data import models_path
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.motion.spline import SplineBasis, spline_basis

RATE = 200.0
"""Frames per second of all published trials."""
GAIT_CYCLE = 1.035
"""s, `cycle_s` of the nominal gait."""
GAIT_FRAMES = 208
ISOLATED_FRAMES = 1200
NODES = 20

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

HIP_TURNS = ((20.0, 30.0), (-15.0, 20.0))
"""Mean and amplitude, degrees, of hip flexion in the first and adduction in the second half of the hip trial."""
KNEE_TURN = (45.0, 40.0)
ANKLE_TURN = (-8.0, 24.0)
SUBTALAR_AMPLITUDE = 18.0
ISOLATED_HZ = {"hip": 2.0 / 3.0, "knee": 0.5, "ankle": 0.5}


@dataclass(frozen=True)
class TrueMotion:
    """A motion that lies in the spline space."""

    basis: SplineBasis
    nodes: Array
    """(20, 27) m, rad."""

    @property
    def q(self) -> Array:
        """(nf, 27)."""
        return self.basis.evaluate(self.nodes)


def gait_motion() -> TrueMotion:
    """One gait cycle of the nominal subject, right heel strike first: 208 frames at 200 Hz."""
    data = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))["nominal_gait"]
    time = np.arange(GAIT_FRAMES) / RATE
    phase = time / GAIT_CYCLE
    q = np.empty((GAIT_FRAMES, len(COORDINATES)))
    for i, name in enumerate(COORDINATES):
        stem = name if name in _CURVE_OF else name[:-2]
        curve, sign = _CURVE_OF[stem]
        shift = 0.5 if name.endswith("_l") else 0.0
        q[:, i] = sign * _harmonics(data["curves"][curve], phase + shift)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += data["stride_m"] * phase
    return _in_spline_space(time, q)


def isolated_motion(joint: str, standing: Array | None = None, rate: float = RATE) -> TrueMotion:
    """An isolated trial of `hip_r` ... `ankle_l`: 1200 frames at 200 Hz; the rest of the body nearly still.

    At another `rate` (frames per second) the same 1200 poses follow one another more slowly or faster: the cycles are
    as many, so that 20 nodes still hold them exactly.
    """
    kind, side = joint.split("_")
    time = np.arange(ISOLATED_FRAMES) / RATE
    q = np.tile(standing_pose() if standing is None else standing, (ISOLATED_FRAMES, 1))
    cycle = 2 * np.pi * ISOLATED_HZ[kind] * time

    def put(name: str, degrees: Array) -> None:
        q[:, COORDINATE_INDEX[f"{name}_{side}"]] = np.deg2rad(degrees)

    if kind == "hip":
        half = time[-1] / 2
        first = _window(time, 0.0, half)
        second = _window(time, half, float(time[-1]))
        (flexion, flexion_amplitude), (adduction, adduction_amplitude) = HIP_TURNS
        put("hip_flexion", first * (flexion + flexion_amplitude * np.sin(cycle)))
        put("hip_adduction", second * (adduction + adduction_amplitude * np.sin(cycle)))
    elif kind == "knee":
        put("knee_angle", KNEE_TURN[0] + KNEE_TURN[1] * np.sin(cycle))
        put("hip_flexion", np.full(len(time), 30.0))
    else:
        put("ankle_angle", ANKLE_TURN[0] + ANKLE_TURN[1] * np.sin(cycle))
        put("subtalar_angle", SUBTALAR_AMPLITUDE * np.cos(cycle))
    sway = 0.004 * np.sin(2 * np.pi * 0.3 * time)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += sway
    q[:, COORDINATE_INDEX["pelvis_tz"]] += 0.5 * sway
    q[:, COORDINATE_INDEX["pelvis_tilt"]] += np.deg2rad(1.0) * np.sin(2 * np.pi * 0.25 * time)
    moved = _in_spline_space(time, q)
    return moved if rate == RATE else TrueMotion(spline_basis(np.arange(ISOLATED_FRAMES) / rate, NODES), moved.nodes)


def standing_pose() -> Array:
    """(27,) upright, arms slightly away from the body."""
    q = np.zeros(len(COORDINATES))
    q[COORDINATE_INDEX["pelvis_ty"]] = 0.95
    for side in ("r", "l"):
        q[COORDINATE_INDEX[f"arm_add_{side}"]] = np.deg2rad(-12.0)
        q[COORDINATE_INDEX[f"elbow_flex_{side}"]] = np.deg2rad(10.0)
    return q


def static_motion(frames: int = 100) -> TrueMotion:
    """Quiet standing."""
    time = np.arange(frames) / RATE
    return _in_spline_space(time, np.tile(standing_pose(), (frames, 1)))


def _harmonics(curve: dict[str, object], phase: Array) -> Array:
    a, b = np.array(curve["a"], dtype=float), np.array(curve["b"], dtype=float)
    k = np.arange(len(a))
    angle = 2 * np.pi * np.outer(phase, k)
    values: Array = np.cos(angle) @ a + np.sin(angle) @ b
    return values if curve["unit"] == "m" else np.deg2rad(values)


def _window(time: Array, start: float, end: float) -> Array:
    x = np.clip((time - start) / (end - start), 0.0, 1.0)
    return np.sin(np.pi * x) ** 2


def _in_spline_space(time: Array, q: Array) -> TrueMotion:
    basis = spline_basis(time, NODES)
    return TrueMotion(basis, basis.fit(q))
