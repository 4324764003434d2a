"""Angles, moments and powers that a C3D file holds beside its markers, as Plug-in Gait names them; unit and sign.

`RKneeAngles` and `RKneeMoment` hold three curves each: sagittal, frontal, transverse. Files call the unit of their
moments `Nmm` and mean N·mm/kg, mostly; external moments have the other sign. Neither is believed: the unit is the one
that comes nearest to our own moments in size, the sign that of their correlation. Powers (`W`) are those of W/kg.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import ezc3d
import numpy as np

from gaitcal.arrays import Array

UNITS: dict[str, Callable[[float], float]] = {
    "N·mm/kg": lambda mass: 1e-3,
    "N·m/kg": lambda mass: 1.0,
    "N·mm": lambda mass: 1e-3 / mass,
}
"""Name -> factor to N·m/kg, of a body of this mass (kg)."""


@dataclass(frozen=True)
class Quantity:
    """One of our curves, and the vendor's of the same."""

    ours: str
    """Without its side: `hip_flexion`."""
    theirs: str
    """Without its side: `HipAngles`."""
    axis: int
    """0 sagittal, 1 frontal, 2 transverse; a power has one curve, the last."""

    @property
    def words(self) -> str:
        """As the table shows it."""
        return f"{self.ours} {'power' if self.is_power else 'moment' if self.is_moment else 'angle'}"

    @property
    def is_moment(self) -> bool:
        """Whether it is a moment."""
        return self.theirs.endswith("Moment")

    @property
    def is_power(self) -> bool:
        """Whether it is a power; neither: an angle."""
        return self.theirs.endswith("Power")


QUANTITIES = (
    Quantity("hip_flexion", "HipAngles", 0),
    Quantity("hip_adduction", "HipAngles", 1),
    Quantity("hip_rotation", "HipAngles", 2),
    Quantity("knee_angle", "KneeAngles", 0),
    Quantity("ankle_angle", "AnkleAngles", 0),
    Quantity("hip_flexion", "HipMoment", 0),
    Quantity("hip_adduction", "HipMoment", 1),
    Quantity("knee_angle", "KneeMoment", 0),
    Quantity("knee_adduction", "KneeMoment", 1),
    Quantity("ankle_angle", "AnkleMoment", 0),
    Quantity("hip", "HipPower", 2),
    Quantity("knee", "KneePower", 2),
    Quantity("ankle", "AnklePower", 2),
)
IN_FRAMES = (
    *(q for q in QUANTITIES if q.is_moment),
    Quantity("hip_rotation", "HipMoment", 2),
    Quantity("knee_rotation", "KneeMoment", 2),
    Quantity("ankle_inversion", "AnkleMoment", 1),
    Quantity("ankle_rotation", "AnkleMoment", 2),
)
"""Moments that are told in the frames of segments, too."""


def vendor_curves(path: str) -> dict[str, Array]:
    """Name (`RHipAngles`) -> (nf, 3) as the file has it, NaN where it says nothing (zeros, or no number)."""
    file = ezc3d.c3d(path)
    group = file["parameters"]["POINT"]
    labels = [label for name in ("LABELS", "LABELS2", "LABELS3") if name in group for label in group[name]["value"]]
    names = {side + q.theirs for side in "RL" for q in (*QUANTITIES, *IN_FRAMES)}
    out = {}
    for k, label in enumerate(labels):
        plain = str(label).split(":")[-1].strip()
        if plain in names:
            curve = np.moveaxis(file["data"]["points"][:3, k], 0, -1).astype(float)
            known = np.isfinite(curve).all(axis=1) & (curve != 0.0).any(axis=1)
            out[plain] = np.where(known[:, None], curve, np.nan)
    return out


def unit_of(ours: Sequence[Array], theirs: Sequence[Array], mass: float) -> str:
    """The unit in which the vendor's moments are as large as ours (N·m/kg); frames where either is NaN do not count."""
    one, other = np.concatenate(ours), np.concatenate(theirs)
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        return next(iter(UNITS))
    ratio = np.sqrt(np.mean(one[both] ** 2) / np.mean(other[both] ** 2))
    return min(UNITS, key=lambda name: abs(float(np.log(ratio / UNITS[name](mass)))))


def sign_of(ours: Array, theirs: Array) -> float:
    """1 or -1, that of the correlation of two curves; frames where either is NaN do not count."""
    both = np.isfinite(ours) & np.isfinite(theirs)
    if both.sum() < 2:
        return 1.0
    covariance = np.mean((ours[both] - ours[both].mean()) * (theirs[both] - theirs[both].mean()))
    return -1.0 if covariance < 0 else 1.0
