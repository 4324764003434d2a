"""Physically possible inertias as unconstrained variables.

x = 0 is the seed. Masses are shares of the seed's total, m_k = M m_k^0 exp(x) / sum; mass centres are shifted by x;
the second moments of mass about the mass centre, sum x_i^2, are scaled by exp(x). Moments of inertia are sums of two
second moments each, so they are positive and obey the triangle inequality: the pseudo-inertia stays positive definite
(Wensing, Kim and Slotine 2017; the axes of a body being fixed, its log-Cholesky parameters are these logarithms).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.parameters import InertialSet, is_physical, table


@dataclass(frozen=True, kw_only=True)
class ConsistentSettings:
    """Spread of people about the anthropometric table, and how good a root wrench can be expected to be."""

    mass_spread: float = 0.10
    """Standard deviation of the logarithm of a segment's share of body mass."""
    foot_mass_spread: float = 0.30
    """The same of a foot, some 1 kg, which tables have bare: a shoe adds 0.3 to 0.4 kg. (Predictions from tables err by
    up to 40 % on some segment: Durkin and Dowling, J Biomech Eng 125:515, 2003.)"""
    centre_spread: float = 0.010
    """m, standard deviation of a mass-centre coordinate."""
    moment_spread: float = 0.15
    """Standard deviation of the logarithm of a second moment of mass."""
    more_of: Mapping[str, float] = field(default_factory=dict)
    """Segment without its side -> standard deviation of the logarithm of its mass and second moments beside that of
    people: of a table that may not be this person's."""
    residual: float = 0.01
    """Least standard deviation of F / BW and T / (BW L) that stems from measurement and motion, not from inertia."""
    independent: float = 10.0
    """Frames per independent sample: neighbouring frames of a residual repeat each other."""


class LogChart:
    """Variables x (0 at the seed) -> IPs: masses by softmax, centres shifted, second moments scaled by exp."""

    def __init__(self, seed: Array, which: InertialSet) -> None:
        if not is_physical(seed).all():
            raise ValueError("the seed of a physically consistent calibration must itself be physically possible")
        self.size = len(which.names)
        self.rows = table(seed)
        kinds = [name.split(".", 1)[1] for name in which.names]
        self.kind = np.array([{"mass": 0, "com": 1, "moi": 2}[k.split(".")[0]] for k in kinds])
        self.selection = which.selection
        self.segments = tuple(name.split(".", 1)[0].removesuffix("_r").removesuffix("_l") for name in which.names)
        self.of_foot = np.array([name.startswith("foot") for name in which.names])
        moments = self.rows[:, 4:7]
        self.second = 0.5 * moments.sum(axis=1, keepdims=True) - moments
        """(12, 3) second moments of mass about the mass centre along each axis."""

    def spread(self, settings: ConsistentSettings) -> Array:
        """(n,) prior standard deviation of each variable."""
        kinds = np.array([settings.mass_spread, settings.centre_spread, settings.moment_spread])[self.kind]
        of_people = np.where(self.of_foot & (self.kind == 0), settings.foot_mass_spread, kinds)
        more = np.array([settings.more_of.get(segment, 0.0) for segment in self.segments])
        out: Array = np.hypot(of_people, np.where(self.kind == 1, 0.0, more))
        return out

    def _parts(self, x: Array) -> tuple[Array, Array, Array]:
        changes = table(self.selection @ x)
        return changes[:, 0], changes[:, 1:4], changes[:, 4:7]

    def inertial(self, x: Array) -> Array:
        """(84,) inertial parameters, SI."""
        log_mass, shift, log_second = self._parts(x)
        raw = self.rows[:, 0] * np.exp(log_mass)
        out = np.empty(self.rows.shape)
        out[:, 0] = raw * (self.rows[:, 0].sum() / raw.sum())
        out[:, 1:4] = self.rows[:, 1:4] + shift
        second = self.second * np.exp(log_second)
        out[:, 4:7] = second.sum(axis=1, keepdims=True) - second
        return out.ravel()

    def jacobian(self, x: Array) -> Array:
        """(84, n) derivative of `inertial`."""
        _, _, log_second = self._parts(x)
        mass = table(self.inertial(x))[:, 0]
        second = self.second * np.exp(log_second)
        chain = np.zeros((*self.rows.shape, *self.rows.shape))
        share = mass / mass.sum()
        chain[:, 0, :, 0] = np.diag(mass) - np.outer(mass, share)
        for s in range(len(self.rows)):
            for axis in range(3):
                chain[s, 1 + axis, s, 1 + axis] = 1.0
                for other in range(3):
                    if other != axis:
                        chain[s, 4 + axis, s, 4 + other] = second[s, other]
        out: Array = chain.reshape(self.rows.size, -1) @ self.selection
        return out
