"""OpenSim's own tools take the exported files over as they are: inverse dynamics and inverse kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.export import write_external_loads, write_mot, write_osim
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.recording.mot import read_table
from gaitcal.recording.recording import Recording
from gaitcal.recording.trc import write_trc
from tests.export.mechanics import State, our_forces, our_markers, perturbed
from tests.export.test_motion_files import walking_wrenches

PRINTED = 1e-6
"""N, N·m: OpenSim writes eight decimals; accelerations come from its own splines on both sides."""
IK_TOLERANCE = 0.2e-3
"""m: the promise, RMS over markers of the distance between OpenSim's pose and our per-frame optimum."""
NOISE = 5e-3
"""m, per marker coordinate: about what skin motion does."""


def smooth_motion(time: np.ndarray, seed: int) -> np.ndarray:
    """(nf, 27) slow waves, standing height."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.5, 1.5, 27) * 2 * np.pi
    q = 0.3 * np.sin(np.outer(time, waves) + rng.uniform(0, 6, 27))
    q[:, COORDINATES.index("pelvis_ty")] += 0.95
    return q


@pytest.mark.peers
def test_inverse_dynamics_tool(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    model = perturbed(published, 1)
    wrenches = walking_wrenches()
    time = np.linspace(0.4, 1.6, len(wrenches))
    write_osim(model, tmp_path / "model.osim")
    write_mot(tmp_path / "walk.mot", time, COORDINATES, smooth_motion(time, 1))
    _, loads = write_external_loads(tmp_path, time, wrenches, "walk_grf")
    tool = osim.InverseDynamicsTool()
    tool.setModelFileName(str(tmp_path / "model.osim"))
    tool.setCoordinatesFileName(str(tmp_path / "walk.mot"))
    tool.setExternalLoadsFileName(str(loads))
    tool.setStartTime(float(time[0]))
    tool.setEndTime(float(time[-1]))
    tool.setLowpassCutoffFrequency(-1.0)
    nothing = osim.ArrayStr()
    nothing.append("Muscles")
    tool.setExcludedForces(nothing)
    tool.setResultsDir(str(tmp_path))
    tool.setOutputGenForceFileName("tool.sto")
    assert tool.run()

    storage = osim.Storage(str(tmp_path / "walk.mot"))
    peer = osim.Model(str(tmp_path / "model.osim"))
    peer.initSystem()
    peer.getSimbodyEngine().convertDegreesToRadians(storage)
    splines = osim.GCVSplineSet(5, storage)
    found = read_table(tmp_path / "tool.sto")
    assert len(found.time) == len(time)
    for frame, t in enumerate(time):
        derivatives = np.array(
            [[splines.evaluate(splines.getIndex(name), order, float(t)) for order in range(3)] for name in COORDINATES]
        )
        ours = our_forces(model, State(*derivatives.T, wrenches[frame]))
        for i, name in enumerate(COORDINATES):
            column = f"{name}_{'force' if is_translation(name) else 'moment'}"
            assert abs(found.column(column)[frame] - ours[i]) < PRINTED


def optimum(model: SubjectModel, measured: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(27,) the coordinates that bring the markers closest to `measured` (nm, 3): Gauss-Newton to rounding."""
    chain = Chain()
    constants = chain.constants(model.parameters.joint, model.parameters.zero_angles)
    segment = [chain.segments.index(s) for s in model.markers.segments]
    frame_of = chain.segment_frame[segment]
    q = start.copy()
    for _ in range(30):
        poses = forward(chain, constants, q[None])
        axes, origins = segment_poses(chain, constants, poses)
        x = np.einsum("mj,mji->mi", model.markers.local, axes[segment, :, :, 0]) + origins[segment, :, 0]
        spatial = jacobian(chain, constants, poses)[:, :, 0]
        full = np.zeros((len(x), 3, 27))
        for k in range(27):
            moved = chain.support[k, segment] > 0
            full[moved, :, k] = spatial[k, :3] + np.cross(spatial[k, 3:], x[moved])
        step = np.linalg.lstsq(full.reshape(-1, 27), (measured - x).ravel(), rcond=None)[0]
        q += step
        if np.abs(step).max() < 1e-12:
            break
    assert np.abs(step).max() < 1e-9, "the reference has not converged"
    assert len(frame_of) == len(x)
    return q


@pytest.mark.peers
def test_inverse_kinematics_tool(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    model = perturbed(published, 2)
    time = np.arange(40) / 100.0
    truth = smooth_motion(time, 2)
    labels = model.markers.labels
    noise = np.random.default_rng(3).normal(scale=NOISE, size=(len(time), len(labels), 3))
    measured = np.array([our_markers(model, q) for q in truth]) + noise
    write_osim(model, tmp_path / "model.osim")
    write_trc(tmp_path / "walk.trc", Recording("walk", time, labels, measured))

    tool = osim.InverseKinematicsTool()
    peer = osim.Model(str(tmp_path / "model.osim"))
    tool.setModel(peer)
    tool.setMarkerDataFileName(str(tmp_path / "walk.trc"))
    tool.setStartTime(float(time[0]))
    tool.setEndTime(float(time[-1]))
    tool.setOutputMotionFileName(str(tmp_path / "ik.mot"))
    tool.setResultsDir(str(tmp_path))
    tasks = [osim.IKMarkerTask() for _ in labels]
    for task, label in zip(tasks, labels, strict=True):
        task.setName(label)
        task.setWeight(1.0)
        tool.getIKTaskSet().cloneAndAppend(task)
    assert tool.run()

    found = read_table(tmp_path / "ik.mot")
    assert len(found.time) == len(time)
    squares = []
    for frame in range(len(time)):
        units = [1.0 if is_translation(name) else np.pi / 180 for name in COORDINATES]
        theirs = np.array([found.column(n)[frame] * u for n, u in zip(COORDINATES, units, strict=True)])
        ours = optimum(model, measured[frame], truth[frame])
        squares.append(np.sum((our_markers(model, theirs) - our_markers(model, ours)) ** 2, axis=1))
    assert np.sqrt(np.mean(squares)) < IK_TOLERANCE
