"""How people are built and stand, as no fault of any landmark: legs bow, bones are twisted, feet turn, somebody leans.

A joint turned by theta and shifted by s moves all landmarks beyond it and nothing else, whether posture or bone made it
do so. With theta ~ N(0, TURN_DEG^2) and s ~ N(0, SHIFT_M^2) about and along each body axis at hips, knees and ankles
of both sides, and B = [dz / dtheta TURN_DEG, dz / ds SHIFT_M], the best such explanation of deviations z costs

    min over x of |z - B x|^2 + |x|^2  =  z^T (I + B B^T)^-1 z,

to be held against what one landmark off its bone would cost. B is taken at the landmarks as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.faults.plan import body_axes, measures
from gaitcal.model.linkage import SIDES

TURN_DEG = 8.0
"""Standard deviation about each axis. Torsion of the tibia scatters by 8 deg, version of the femur by 9 (Strecker et
al. 1997), the line of the leg from the front by 2 to 3, all more in patients."""
SHIFT_M = 0.006
"""Standard deviation along each axis: as joints lie otherwise in their segments than in most people."""
STEP_DEG, STEP_M = 0.5, 5e-4
BEYOND = {
    "hip": ("knee_lat", "knee_med", "ankle_lat", "ankle_med", "heel", "toe"),
    "knee": ("ankle_lat", "ankle_med", "heel", "toe"),
    "ankle": ("heel", "toe"),
}
"""Joint -> landmarks that move with what lies beyond it."""
CENTRE = {"hip": ("asis",), "knee": ("knee_lat", "knee_med"), "ankle": ("ankle_lat", "ankle_med")}
"""Joint -> landmarks whose mean stands for its centre."""

Landmarks = Mapping[str, Array]


def cost_of_build(p: Landmarks, height: float, *, even: bool = True) -> float:
    """What it costs to explain landmarks p ((3,) m each, y up) by build and stance alone."""
    z = _deviations(p, height, even)
    columns = [(_deviations(moved, height, even) - z) * scale for moved, scale in moved(p)]
    if not columns:
        return float(z @ z)
    U, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return float(z @ z - np.sum((U.T @ z) ** 2 * s**2 / (1.0 + s**2)))


def _deviations(p: Landmarks, height: float, even: bool) -> Array:
    return np.array([m.z for m in measures(p, height, even=even)])


def moved(p: Landmarks) -> Iterator[tuple[dict[str, Array], float]]:
    """Landmarks with one joint turned or shifted a little, and how many such steps its standard deviation has."""
    axes = body_axes(p)
    if axes is None:
        return
    for joint, beyond in BEYOND.items():
        for side in SIDES:
            own = [f"{name}_{side}" for name in beyond if f"{name}_{side}" in p]
            centre = [p[f"{name}_{side}"] for name in CENTRE[joint] if f"{name}_{side}" in p]
            if not own or not centre:
                continue
            origin = np.mean(centre, axis=0)
            for axis in axes.T:
                R = pin.exp3(np.deg2rad(STEP_DEG) * axis)
                yield {**p, **{n: origin + R @ (p[n] - origin) for n in own}}, TURN_DEG / STEP_DEG
                yield {**p, **{n: p[n] + STEP_M * axis for n in own}}, SHIFT_M / STEP_M
