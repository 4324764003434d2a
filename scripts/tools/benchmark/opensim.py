"""OpenSim on our exported model and the same markers, in this process; nothing where it is not installed.

Its inverse kinematics solves one frame after the other, each from the last, with the accuracy that its own tool has
by default (1e-5), the weights of our marker set, and no coordinate tasks. It has no splines; so its marker RMS is to be
that of our own fit with a node for every frame, which is told beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.export.osim import write_osim
from gaitcal.io.opensim_files import write_trc
from gaitcal.model.linkage import COORDINATES
from gaitcal.motion.motion import track
from gaitcal.motion.spline import NodeRule
from scripts.tools.benchmark.figure import Timing, temporary_folder

if TYPE_CHECKING:
    from gaitcal.io.recording import Recording
    from gaitcal.model.subject_model import SubjectModel

ACCURACY = 1e-5


def _opensim() -> Any:
    try:
        import opensim
    except ImportError:
        return None
    opensim.Logger.setLevelString("Off")
    return opensim


def inverse_kinematics(model: SubjectModel, recording: Recording) -> list[Timing]:
    """OpenSim's inverse kinematics solver over all frames, without its file reading and writing."""
    opensim = _opensim()
    if opensim is None:
        return []
    folder = temporary_folder()
    write_osim(model, folder / "model.osim")
    write_trc(folder / "markers.trc", recording)
    peer = opensim.Model(str(folder / "model.osim"))
    peer.initSystem()
    weight_of = dict(zip(model.markers.labels, model.markers.weight, strict=True))
    weights = opensim.SetMarkerWeights()
    for label in recording.labels:
        weights.cloneAndAppend(opensim.MarkerWeight(label, float(weight_of[label])))
    reference = opensim.MarkersReference(str(folder / "markers.trc"), weights)
    coordinates = opensim.SimTKArrayCoordinateReference()

    def run(squares: list[float] | None = None) -> None:
        state = peer.initSystem()
        solver = opensim.InverseKinematicsSolver(peer, reference, coordinates)
        solver.setAccuracy(ACCURACY)
        for k, t in enumerate(recording.time):
            state.setTime(float(t))
            if k == 0:
                solver.assemble(state)
            else:
                solver.track(state)
            if squares is not None:
                found = opensim.SimTKArrayDouble()
                solver.computeCurrentSquaredMarkerErrors(found)
                squares += [found.getElt(i) for i in range(found.size())]

    squares: list[float] = []
    run(squares)
    theirs = 1e3 * float(np.sqrt(np.mean(squares)))
    ours = 1e3 * (track(model, recording, rule=NodeRule(fixed=len(recording.time))).errors.rms() or np.nan)
    note = f"{len(recording.time)} frames, marker RMS {theirs:.3f} mm (ours with a node a frame {ours:.3f} mm)"
    return [Timing(f"OpenSim inverse kinematics, accuracy {ACCURACY:g}", run, note)]


def inverse_dynamics(model: SubjectModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[Timing]:
    """OpenSim's inverse dynamics solver, frame by frame."""
    opensim = _opensim()
    if opensim is None:
        return []
    folder = temporary_folder()
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

    return [Timing("OpenSim inverse dynamics solver", run, f"{len(q)} frames, without ground reactions")]
