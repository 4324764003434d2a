"""The random numbers of a draw: a function of seed, set, level and number, and of nothing else.

Every draw has a stream of its own, spawned from the seed by (set, level, number), so that draws can be made in any
order and anywhere. Uniform within the bounds; noise is one sinusoid per marker coordinate (method, sections 5 and 6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.study.monte_carlo.settings import MonteCarloSettings, Varied
from gaitcal.study.synthetic_data import marker_noise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Disturbance:
    """What one draw changes; None where its set leaves something alone."""

    joint: Array | None
    """(np,) m, rad added to the joint parameters that vary."""
    inertial: Array | None
    """(36,) parts by which the symmetric inertial parameters change: 0.1 is ten per cent more."""
    noise: Array | None
    """(nm, 3, nf) m added to the markers, in the order of the context's data."""


def generator(settings: MonteCarloSettings, varied: Varied, level: int, number: int) -> np.random.Generator:
    """The stream of draw `number` of a set at a level (per cent)."""
    return np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(varied.key, level, number)))


def disturbance(
    settings: MonteCarloSettings, inertial: int, labels: int, time: Array, cell: tuple[Varied, int], number: int
) -> Disturbance:
    """Draw `number` of a cell.

    Parameters
    ----------
    inertial, labels : number of inertial parameters that vary, and of markers.
    time : (nf,) s.
    cell : set and level (per cent).
    """
    varied, level = cell
    rng, part = generator(settings, varied, level, number), level / 100.0
    joint = inertial_part = noise = None
    if varied.joint:
        bounds = settings.joint_bounds
        joint = part * bounds * rng.uniform(-1.0, 1.0, len(bounds))
    if varied.inertial:
        inertial_part = part * settings.inertial_percent / 100.0 * rng.uniform(-1.0, 1.0, inertial)
    if varied is Varied.NOISE:
        waves = marker_noise(time - time[0], labels, rng, amplitude=part * 1e-3 * settings.noise_mm)
        noise = np.ascontiguousarray(waves.transpose(1, 2, 0))
    return Disturbance(joint, inertial_part, noise)
