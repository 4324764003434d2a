"""Standard errors of generalised forces, and which source of error makes them.

Sources are independent of each other, so that variances add: the share of a source in the error bar of a torque is its
part of the variance, summed over valid frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.joint_kinetics import KineticErrors
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES


class Source(Enum):
    """What makes the error bar of a torque. `key`: in files; `words`: on the page."""

    MOTION = ("motion", "markers and motion")
    """Noise of the trial's own markers, through its motion; with it, through joints fitted to the same markers."""
    JOINT_MARKERS = ("joint_markers", "joint parameters: markers")
    """Noise of the markers that the joint parameters were found from."""
    JOINT_NOMINAL = ("joint_nominal", "joint parameters: what is known before")
    """Nominal joint parameters, where markers do not tell."""
    SKIN = ("skin", "skin that moves with joints")
    BANDWIDTH = ("bandwidth", "bandwidth of the motion")
    POSTURE = ("posture", "segments that markers do not determine")
    INERTIA = ("inertia", "masses and inertia")
    PLATES = ("plates", "force plates")
    FRAMES = ("frames", "direction of segment axes")

    def __init__(self, key: str, words: str) -> None:
        self.key, self.words = key, words


@dataclass(frozen=True)
class TorqueErrors:
    """Standard errors of the final generalised forces."""

    tau: Array
    """(nf, nq) N·m, N."""
    knee_adduction: Array
    """(nf, 2) N·m."""
    by_source: Mapping[Source, Array] = field(default_factory=dict)
    """Source -> (nf, nt) variance of the 27 generalised forces and the two knee reactions, (N·m)^2, N^2; they sum to
    the squares of the standard errors. Empty where it is not known."""
    kinetics: KineticErrors | None = None
    """Of the powers and moment vectors that follow; None where they are not known."""

    @staticmethod
    def of(by_source: Mapping[Source, Array], kinetics: KineticErrors | None = None) -> TorqueErrors:
        """From the variances (nf, nt) of at least one source."""
        errors = np.sqrt(sum(by_source.values()))
        return TorqueErrors(errors[:, :-2], errors[:, -2:], by_source, kinetics)

    @property
    def every(self) -> Array:
        """(nf, nt) all of them."""
        return np.hstack([self.tau, self.knee_adduction])

    def only(self, coordinates: BoolArray) -> TorqueErrors:
        """The same with NaN for all but some coordinates (nq,), right and left knee's reaction with its knee angle."""
        knees = coordinates[[COORDINATE_INDEX[f"knee_angle_{side}"] for side in SIDES]]
        kept = np.concatenate([coordinates, knees])
        by_source = {source: np.where(kept, variance, np.nan) for source, variance in self.by_source.items()}
        return TorqueErrors(
            np.where(coordinates, self.tau, np.nan),
            np.where(knees, self.knee_adduction, np.nan),
            by_source,
            None if self.kinetics is None else self.kinetics.only(coordinates),
        )

    def shares(self, column: int, valid: BoolArray) -> dict[Source, float]:
        """Source -> its part of the variance of one of the 29 torques over valid frames, largest first.

        They sum to 1; empty where there is no variance.
        """
        parts = {source: float(variance[valid, column].sum()) for source, variance in self.by_source.items()}
        total = sum(parts.values())
        if not total > 0.0:
            return {}
        return {source: parts[source] / total for source in sorted(parts, key=lambda s: -parts[s]) if parts[source] > 0}
