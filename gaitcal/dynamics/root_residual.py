"""The pelvis residual and its derivatives: what a fit to ground reactions minimises.

    rho = [F; T],   F = tau_(tx, ty, tz),   A(q) T = tau_(tilt, list, rotation)

A's rows are the axes of the pelvis rotations in the laboratory, so T is the moment about the pelvis origin in
laboratory axes, and  dT = A^-1 (d tau - dA T).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.derivatives import force_derivatives
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_axes
from gaitcal.model.parameters import Parameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RootResidual:
    """Residual wrench and derivatives, frame by frame; N and N·m."""

    value: Array
    """(nf, 6)."""
    by_position: Array
    """(nf, 6, 27)."""
    by_velocity: Array
    """(nf, 6, 27)."""
    by_acceleration: Array
    """(nf, 6, 27)."""
    by_parameter: Array
    """(nf, 6, np)."""
    free: tuple[str, ...]
    regressor: Array
    """(nf, 6, 120) by the dynamic parameters of the 12 massive segments."""


def root_residual(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> RootResidual:
    """Pelvis residual at coordinates (nf, 27), their derivatives, and foot wrenches (nf, 2, 6)."""
    dynamics = Dynamics(parameters)
    forces = dynamics.forces(q, v, a, wrenches)
    slopes = force_derivatives(parameters, free, q, v, a, wrenches)
    axes, by_tilt, by_list = pelvis_axes(q)

    def laboratory(rows: Array) -> Array:
        return np.concatenate([rows[:, :3], np.linalg.solve(axes, rows[:, 3:6])], axis=1)

    by_position = slopes.by_position[:, :6].copy()
    for k, turned in ((3, by_tilt), (4, by_list)):
        by_position[:, 3:6, k] -= np.einsum("fij,fj->fi", turned, forces.residual_moment)
    return RootResidual(
        np.hstack([forces.residual_force, forces.residual_moment]),
        laboratory(by_position),
        laboratory(slopes.by_velocity[:, :6]),
        laboratory(slopes.by_acceleration[:, :6]),
        laboratory(slopes.by_parameter[:, :6]),
        slopes.free,
        dynamics.root_regressor(q, v, a).reshape(len(q), 6, 120),
    )
