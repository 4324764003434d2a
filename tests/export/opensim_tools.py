"""OpenSim's own tools, run on exported files without an edit, and the optimum its inverse kinematics is to find."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gaitcal.export.osim import safe_name
from gaitcal.io.opensim_files import read_table
from gaitcal.model.chain import Chain, forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES, is_translation
from gaitcal.model.subject_model import MarkerPlacement, SubjectModel

Array = NDArray[np.float64]

SCALE = 1e3
"""mm, so that the tolerances of the reference are far below its residuals."""
RESTED, GRADIENT = 1e-10, 1e-9
"""Relative last step and gradient (mm^2) of the reference: a thousandth of what is compared, and less."""


def run_inverse_dynamics(osim: Any, model: Path, motion: Path, loads: Path, time: Array) -> tuple[Array, Array]:
    """InverseDynamicsTool: (nf, 27) N·m and N, and the (nf, 3, 27) q, v, a that its own splines made of the file."""
    out = motion.parent / "tool.sto"
    tool = osim.InverseDynamicsTool()
    tool.setModelFileName(str(model))
    tool.setCoordinatesFileName(str(motion))
    tool.setExternalLoadsFileName(str(loads))
    tool.setStartTime(float(time[0]))
    tool.setEndTime(float(time[-1]))
    tool.setLowpassCutoffFrequency(-1.0)
    nothing = osim.ArrayStr()
    nothing.append("Muscles")
    tool.setExcludedForces(nothing)
    tool.setResultsDir(str(out.parent))
    tool.setOutputGenForceFileName(out.name)
    assert tool.run()
    found = read_table(out)
    columns = [f"{name}_{'force' if is_translation(name) else 'moment'}" for name in COORDINATES]
    return np.stack([found.column(name) for name in columns], axis=1), _derivatives(osim, model, motion, time)


def _derivatives(osim: Any, model: Path, motion: Path, time: Array) -> Array:
    storage = osim.Storage(str(motion))
    peer = osim.Model(str(model))
    peer.initSystem()
    peer.getSimbodyEngine().convertDegreesToRadians(storage)
    splines = osim.GCVSplineSet(5, storage)
    rows = [splines.getIndex(name) for name in COORDINATES]
    return np.array([[[splines.evaluate(i, order, float(t)) for i in rows] for order in range(3)] for t in time])


def run_inverse_kinematics(
    osim: Any, model: Path, markers: Path, placed: MarkerPlacement, time: Array, accuracy: float | None = None
) -> Array:
    """InverseKinematicsTool with our marker weights: (nf, 27) m and rad. `accuracy`: OpenSim's unless given."""
    out = markers.parent / "ik.mot"
    tool = osim.InverseKinematicsTool()
    peer = osim.Model(str(model))
    tool.setModel(peer)
    if accuracy is not None:
        tool.set_accuracy(accuracy)
    tool.setMarkerDataFileName(str(markers))
    tool.setStartTime(float(time[0]))
    tool.setEndTime(float(time[-1]))
    tool.setOutputMotionFileName(str(out))
    tool.setResultsDir(str(out.parent))
    tasks = [osim.IKMarkerTask() for _ in placed.labels]  # held here: OpenSim copies them late
    for task, label, weight in zip(tasks, placed.labels, placed.weight, strict=True):
        task.setName(safe_name(label))
        task.setWeight(float(weight))
        task.setApply(bool(weight > 0))
        tool.getIKTaskSet().cloneAndAppend(task)
    assert tool.run()
    found = read_table(out)
    np.testing.assert_allclose(found.time, time, rtol=0, atol=1e-8)
    units = [1.0 if is_translation(name) else np.pi / 180 for name in COORDINATES]
    return np.stack([found.column(name) * unit for name, unit in zip(COORDINATES, units, strict=True)], axis=1)


def optimum(model: SubjectModel, measured: Array, start: Array) -> Array:
    """(27,) the coordinates that bring the markers closest to `measured` (nm, 3), by weight, without a spline."""
    chain = Chain()
    constants = chain.constants(model.parameters.joint, model.parameters.zero_angles)
    segment = [chain.segments.index(s) for s in model.markers.segments]
    moved = chain.support[:, segment] > 0
    root = SCALE * np.sqrt(model.markers.weight)[:, None]

    def positions(q: Array) -> Array:
        axes, origins = segment_poses(chain, constants, forward(chain, constants, q[None]))
        return np.asarray(np.einsum("mj,mji->mi", model.markers.local, axes[segment, :, :, 0]) + origins[segment, :, 0])

    def slopes(q: Array) -> Array:
        spatial = jacobian(chain, constants, forward(chain, constants, q[None]))[:, :, 0]
        turned = np.cross(spatial[:, None, 3:], positions(q)[None])
        full = np.where(moved[:, :, None], spatial[:, None, :3] + turned, 0.0)
        return np.asarray((root[None] * full).reshape(len(q), -1).T)

    found = least_squares(
        lambda q: (root * (positions(q) - measured)).ravel(), start, slopes, ftol=None, xtol=RESTED, gtol=GRADIENT
    )
    assert found.status > 0, "the reference has not converged"
    return np.asarray(found.x)
