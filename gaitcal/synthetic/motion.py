"""Known motions of the built-in subject: gait (`walk.py`) and the six isolated trials.

They are quintic splines, sampled: the true motion lies in a spline space exactly, so that a noiseless reproduction can
be exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import SplineBasis, spline_basis, to_bspline
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.gait_curves import GAIT_CYCLE
from gaitcal.synthetic.likeness import is_nominal, looking_like_nominal, posture_like_nominal
from gaitcal.synthetic.walk import Meant, nominal_curves, walking_nodes

RATE = 200.0
"""Frames per second of all published trials."""
GAIT_FRAMES = 208
"""Of the published study: one stride, right heel strike first."""
WALK_STRIDES = (-0.2, 1.8)
"""Phases of the walk of a synthetic recording: a whole stride of each foot."""
ISOLATED_FRAMES = 1200
NODES = 20
"""Of a published trial."""
WALK_NODES = 35
"""Of a walk of two strides: knots as far apart as in the published gait. The splines of a published trial are among
those of so many nodes."""

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
    """(nn, nq) m, rad."""
    phase: Array | None = None
    """(nf,) of a gait: strides since a right heel strike."""

    @property
    def q(self) -> Array:
        """(nf, nq)."""
        return self.basis.evaluate(self.nodes)


@cache
@with_one_blas_thread
def gait_motion() -> TrueMotion:
    """The published gait of the nominal subject: one stride, right heel strike first, 208 frames at 200 Hz.

    It is like that stride of a longer walk, whose ends are elsewhere: at an end nothing holds accelerations.
    """
    parameters = published_model().parameters
    time, longer = np.arange(GAIT_FRAMES) / RATE, two_strides(parameters)
    spline, stride = to_bspline(longer.basis, longer.nodes), time - WALK_STRIDES[0] * GAIT_CYCLE
    return _walk(parameters, time, 0.0, NODES, Meant(spline(stride), spline(stride, 2), spread=0.2))


@with_one_blas_thread
def two_strides(parameters: Parameters) -> TrueMotion:
    """A walk of a person with these parameters in which both feet have a whole stride: 415 frames at 200 Hz."""
    begin, end = WALK_STRIDES
    time = np.arange(round((end - begin) * GAIT_CYCLE * RATE) + 1) / RATE
    curves = nominal_curves(begin + time / GAIT_CYCLE)
    if not is_nominal(parameters):
        basis = spline_basis(time, WALK_NODES)
        nodes = looking_like_nominal(parameters, basis, curves.q)
        curves = Meant(basis.evaluate(nodes), basis.evaluate(nodes, 2))
    return _walk(parameters, time, begin, WALK_NODES, curves)


def _walk(parameters: Parameters, time: Array, begin: float, nodes: int, meant: Meant) -> TrueMotion:
    """A walk of a person with these parameters like another; `begin`: its phase, in strides, at time 0."""
    basis, phase = spline_basis(time, nodes), begin + time / GAIT_CYCLE
    return TrueMotion(basis, walking_nodes(parameters, basis, phase, meant), phase)


@with_one_blas_thread
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
        q[:, COORDINATE_INDEX[f"{name}_{side}"]] += np.deg2rad(degrees)

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


def standing_pose(parameters: Parameters | None = None) -> Array:
    """(nq,) upright, arms slightly away from the body; of a person with other joint parameters, what looks so."""
    q = np.zeros(len(COORDINATES))
    q[COORDINATE_INDEX["pelvis_ty"]] = 0.95
    for side in ("r", "l"):
        q[COORDINATE_INDEX[f"arm_add_{side}"]] = np.deg2rad(-12.0)
        q[COORDINATE_INDEX[f"elbow_flex_{side}"]] = np.deg2rad(10.0)
    return q if parameters is None else posture_like_nominal(parameters, q)


@with_one_blas_thread
def static_motion(frames: int = 100, standing: Array | None = None) -> TrueMotion:
    """Quiet standing."""
    time = np.arange(frames) / RATE
    return _in_spline_space(time, np.tile(standing_pose() if standing is None else standing, (frames, 1)))


def _window(time: Array, start: float, end: float) -> Array:
    x = np.clip((time - start) / (end - start), 0.0, 1.0)
    return np.sin(np.pi * x) ** 2


def _in_spline_space(time: Array, q: Array) -> TrueMotion:
    basis = spline_basis(time, NODES)
    return TrueMotion(basis, basis.fit(q))
