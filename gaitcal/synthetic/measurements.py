"""Synthetic measurements: markers and ground reactions of a linkage with known parameters in a known motion.

The ground reactions are what the motion asks for: the total external wrench is the root inverse dynamics, shared
between the feet by quintic ramps (`grf_split` of the nominal subject), so that the true pelvis residual is zero.
Noise, per marker coordinate and trial: A sin(omega t + phi), A ~ U(0, 10 mm), omega ~ U(0, 25 rad/s),
phi ~ U(0, 2 pi) (Reinbolt et al. 2007, after Cheze et al. 1995). Randomness enters by the `numpy.random.Generator`
that the caller gives, and nowhere else.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.model.chain import Chain
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement
from gaitcal.motion.marker_residual import marker_positions
from gaitcal.motion.placed_markers import PlacedMarkers
from gaitcal.synthetic.motion import GAIT_CYCLE, TrueMotion

NOISE_AMPLITUDE = 0.010
"""m."""
NOISE_OMEGA = 25.0
"""rad/s."""


def synthetic_markers(parameters: Parameters, markers: MarkerPlacement, q: Array) -> Array:
    """(nf, nm, 3) m, markers of the linkage at coordinates (nf, 27), in the order of `markers.labels`."""
    chain = Chain()
    segment = np.array([chain.segments.index(s) for s in markers.segments], dtype=np.intp)
    order = np.argsort(segment, kind="stable")
    in_order = PlacedMarkers(segment[order], markers.local[order])
    placed = marker_positions(chain, chain.constants(parameters.joint, parameters.zero_angles), in_order, q)
    out = np.empty((len(q), len(segment), 3))
    out[:, order] = placed.transpose(2, 0, 1)
    return out


def marker_noise(time: Array, markers: int, rng: np.random.Generator, amplitude: float = NOISE_AMPLITUDE) -> Array:
    """(nf, nm, 3) m of continuous noise: one sinusoid per marker coordinate."""
    a = rng.uniform(0.0, amplitude, (markers, 3))
    omega = rng.uniform(0.0, NOISE_OMEGA, (markers, 3))
    phi = rng.uniform(0.0, 2 * np.pi, (markers, 3))
    out: Array = a * np.sin(omega * time[:, None, None] + phi)
    return out


def residual_free_wrench(parameters: Parameters, motion: TrueMotion) -> Array:
    """(nf, 2, 6) wrenches on right and left foot about the laboratory origin that leave no pelvis residual in gait."""
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    total = pelvis_residual(q, Dynamics(parameters).forces(q, v, a, np.zeros((len(q), 2, 6))))
    total[:, 3:] += np.cross(q[:, :3], total[:, :3])
    right = right_share(motion.basis.time / GAIT_CYCLE)
    return np.stack([right[:, None] * total, (1.0 - right)[:, None] * total], axis=1)


def right_share(phase: Array) -> Array:
    """(nf,) share of the right foot over the gait cycle (0: right heel strike)."""
    rise, fall = _ramp(phase / 0.12), 1.0 - _ramp((phase - 0.50) / 0.12)
    return np.where(phase < 0.12, rise, np.where(phase < 0.50, 1.0, np.where(phase < 0.62, fall, 0.0)))


def _ramp(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    out: Array = x**3 * (10.0 + x * (-15.0 + 6.0 * x))
    return out
