"""Synthetic measurements: markers of a linkage with known parameters in a known motion, and their noise.

Noise, per marker coordinate and trial: A sin(omega t + phi), A ~ U(0, 10 mm), omega ~ U(0, 25 rad/s),
phi ~ U(0, 2 pi) (Reinbolt et al. 2007, after Cheze et al. 1995). Randomness enters by the `numpy.random.Generator`
that the caller gives, and nowhere else.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import Chain
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement
from gaitcal.motion.marker_residual import PlacedMarkers, marker_positions
from gaitcal.runtime import with_one_blas_thread

NOISE_AMPLITUDE = 0.010
"""m."""
NOISE_OMEGA = 25.0
"""rad/s."""


@with_one_blas_thread
def synthetic_markers(parameters: Parameters, markers: MarkerPlacement, q: Array) -> Array:
    """(nf, nm, 3) m, markers of the linkage at coordinates (nf, nq), in the order of `markers.labels`."""
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
