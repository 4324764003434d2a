"""An exported model in OpenSim, asked for forces and marker positions. Importable without OpenSim installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.export.osim import safe_name
from gaitcal.model.linkage import COORDINATES, SEGMENTS
from tests.export.mechanics import FEET, State

Array = NDArray[np.float64]


class OpenSimModel:
    """`model.osim`, loaded; order of coordinates ours."""

    def __init__(self, osim: Any, path: Path) -> None:
        self.osim = osim
        self.model = osim.Model(str(path))
        self.state = self.model.initSystem()
        self.solver = osim.InverseDynamicsSolver(self.model)
        names = self.model.getCoordinateSet()
        self.coordinates = [names.get(name) for name in COORDINATES]
        assert names.getSize() == len(COORDINATES)
        self.mobility = [self._mobility(name) for name in range(len(COORDINATES))]

    def _mobility(self, index: int) -> int:
        """Which entry of u belongs to a coordinate."""
        for i, coordinate in enumerate(self.coordinates):
            coordinate.setSpeedValue(self.state, float(i == index))
        return int(np.argmax(self.state.getU().to_numpy()))

    def set(self, state: State) -> None:
        for coordinate, q, v in zip(self.coordinates, state.q, state.v, strict=True):
            if not coordinate.getLocked(self.state):
                coordinate.setValue(self.state, q, False)
            coordinate.setSpeedValue(self.state, v)
        self.model.realizeVelocity(self.state)

    def markers(self, labels: tuple[str, ...]) -> Array:
        """(nm, 3) m."""
        markers = self.model.getMarkerSet()
        return np.array([markers.get(safe_name(n)).getLocationInGround(self.state).to_numpy() for n in labels])

    def forces(self, state: State) -> Array:
        """(27,) by InverseDynamicsSolver. Given body forces replace all forces, gravity too: take the difference."""
        osim, n = self.osim, len(COORDINATES)
        udot = osim.Vector(n, 0.0)
        for mobility, a in zip(self.mobility, state.a, strict=True):
            udot[mobility] = a
        nothing = osim.SpatialVec(osim.Vec3(0), osim.Vec3(0))
        none, ground = (osim.VectorOfSpatialVec(len(SEGMENTS) + 1, nothing) for _ in range(2))
        for foot, wrench in zip(FEET, state.wrenches, strict=True):
            body = self.model.getBodySet().get(foot)
            moment = wrench[3:] - np.cross(body.getPositionInGround(self.state).to_numpy(), wrench[:3])
            ground.set(int(body.getMobilizedBodyIndex()), osim.SpatialVec(osim.Vec3(*moment), osim.Vec3(*wrench[:3])))
        zero = osim.Vector(n, 0.0)
        tau = self.solver.solve(self.state, udot).to_numpy()
        tau = tau + self.solver.solve(self.state, zero, zero, ground).to_numpy()
        tau = tau - self.solver.solve(self.state, zero, zero, none).to_numpy()
        return tau[self.mobility]
