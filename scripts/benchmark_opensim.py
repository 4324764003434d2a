"""OpenSim on our exported model and the same markers, in this process; nothing where it is not installed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.export import write_osim
from gaitcal.model.linkage import COORDINATES
from gaitcal.recording import write_trc

if TYPE_CHECKING:
    from benchmark_tasks import Timing

    from gaitcal.model.subject_model import SubjectModel
    from gaitcal.recording import Recording


def inverse_kinematics(model: SubjectModel, recording: Recording, folder: Path) -> list[Timing]:
    """OpenSim's inverse kinematics solver over all frames, without its file writing."""
    from benchmark_tasks import Timing

    try:
        import opensim
    except ImportError:
        return []
    opensim.Logger.setLevelString("Off")
    write_osim(model, folder / "model.osim")
    write_trc(folder / "markers.trc", recording)
    peer = opensim.Model(str(folder / "model.osim"))
    peer.initSystem()
    weights = opensim.SetMarkerWeights()
    for label in recording.labels:
        weights.cloneAndAppend(opensim.MarkerWeight(label, 1.0))
    reference = opensim.MarkersReference(str(folder / "markers.trc"), weights)
    coordinates = opensim.SimTKArrayCoordinateReference()

    def run() -> None:
        state = peer.initSystem()
        solver = opensim.InverseKinematicsSolver(peer, reference, coordinates)
        solver.setAccuracy(1e-5)
        state.setTime(float(recording.time[0]))
        solver.assemble(state)
        for t in recording.time[1:]:
            state.setTime(float(t))
            solver.track(state)

    return [Timing("OpenSim inverse kinematics, accuracy 1e-5", run, f"{len(recording.time)} frames", runs=2)]


def inverse_dynamics(model: SubjectModel, q: np.ndarray, v: np.ndarray, a: np.ndarray, folder: Path) -> list[Timing]:
    """OpenSim's inverse dynamics solver, frame by frame."""
    from benchmark_tasks import Timing

    try:
        import opensim
    except ImportError:
        return []
    opensim.Logger.setLevelString("Off")
    write_osim(model, folder / "model.osim")
    peer = opensim.Model(str(folder / "model.osim"))
    peer.initSystem()

    def run() -> None:
        state = peer.initSystem()  # held here: OpenSim's objects do not keep their model alive
        coordinates = peer.getCoordinateSet()
        place = [COORDINATES.index(coordinates.get(i).getName()) for i in range(coordinates.getSize())]
        solver = opensim.InverseDynamicsSolver(peer)
        for f in range(len(q)):
            for i, k in enumerate(place):
                coordinates.get(i).setValue(state, float(q[f, k]), False)
                coordinates.get(i).setSpeedValue(state, float(v[f, k]))
            udot = opensim.Vector(len(place), 0.0)
            for i, k in enumerate(place):
                udot.set(i, float(a[f, k]))
            solver.solve(state, udot)

    return [Timing("OpenSim inverse dynamics solver", run, "208 frames", runs=3)]
