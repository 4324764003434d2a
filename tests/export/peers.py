"""What other programs answer when they are given exported files: models, motions, ground reactions,
markers.

Importable without the peers installed; they are handed in. `..._answers` return (tau, markers):
(ns, 27) N·m and N in our order, and (ns, nm, 3) m, for `ns` states.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gaitcal.export.opensim.osim_writer import encode_name
from gaitcal.io.opensim_files import read_table
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, SEGMENTS, is_translation
from gaitcal.model.subject_model import MarkerPlacement, SubjectModel
from tests.export.mechanics import FEET, State

Array = NDArray[np.float64]
Answers = tuple[Array, Array]

SCALE = 1e3
"""mm, so that the tolerances of the reference are far below its residuals."""
RESTED, GRADIENT = 1e-10, 1e-9
"""Relative last step and gradient (mm^2) of the reference: a thousandth of what is compared, and
less.
"""


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
        return np.array(
            [markers.get(encode_name(n)).getLocationInGround(self.state).to_numpy() for n in labels]
        )

    def forces(self, state: State) -> Array:
        """(27,) by InverseDynamicsSolver. Given body forces replace all forces, gravity too: take
        the difference.
        """
        osim, n = self.osim, len(COORDINATES)
        udot = osim.Vector(n, 0.0)
        for mobility, a in zip(self.mobility, state.a, strict=True):
            udot[mobility] = a
        nothing = osim.SpatialVec(osim.Vec3(0), osim.Vec3(0))
        none, ground = (osim.VectorOfSpatialVec(len(SEGMENTS) + 1, nothing) for _ in range(2))
        for foot, wrench in zip(FEET, state.wrenches, strict=True):
            body = self.model.getBodySet().get(foot)
            moment = wrench[3:] - np.cross(
                body.getPositionInGround(self.state).to_numpy(), wrench[:3]
            )
            ground.set(
                int(body.getMobilizedBodyIndex()),
                osim.SpatialVec(osim.Vec3(*moment), osim.Vec3(*wrench[:3])),
            )
        zero = osim.Vector(n, 0.0)
        tau = self.solver.solve(self.state, udot).to_numpy()
        tau = tau + self.solver.solve(self.state, zero, zero, ground).to_numpy()
        tau = tau - self.solver.solve(self.state, zero, zero, none).to_numpy()
        return tau[self.mobility]


def opensim_answers(
    osim: Any, path: Path, labels: tuple[str, ...], states: Sequence[State]
) -> Answers:
    """OpenSim's InverseDynamicsSolver on `model.osim`, ground reactions on the feet."""
    peer = OpenSimModel(osim, path)
    tau, markers = [], []
    for state in states:
        peer.set(state)
        tau.append(peer.forces(state))
        markers.append(peer.markers(labels))
    return np.array(tau), np.array(markers)


def mujoco_answers(
    mujoco: Any, path: Path, labels: tuple[str, ...], states: Sequence[State]
) -> Answers:
    """MuJoCo's mj_inverse on `model.xml`, ground reactions on the feet."""
    peer = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(peer)
    assert tuple(peer.joint(i).name for i in range(peer.njnt)) == COORDINATES
    tau, markers = [], []
    for state in states:
        data.qpos[:], data.qvel[:], data.qacc[:] = state.q, state.v, state.a
        mujoco.mj_inverse(peer, data)
        ground = np.zeros(len(COORDINATES))
        for foot, wrench in zip(FEET, state.wrenches, strict=True):
            mujoco.mj_applyFT(
                peer, data, wrench[:3], wrench[3:], np.zeros(3), peer.body(foot).id, ground
            )
        tau.append(data.qfrc_inverse - ground)
        markers.append([data.site(encode_name(label)).xpos.copy() for label in labels])
    return np.array(tau), np.array(markers)


def urdf_answers(path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
    """Pinocchio's reader and RNEA on `model.urdf`."""
    peer = pin.buildModelFromUrdf(str(path))
    assert tuple(peer.names)[1:] == COORDINATES
    frames = [
        peer.getFrameId(f"marker_{encode_name(label)}", pin.FrameType.BODY) for label in labels
    ]
    return _pinocchio_answers(peer, frames, states)


def mjcf_answers(path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
    """Pinocchio's reader and RNEA on `model.xml`."""
    peer = pin.buildModelFromMJCF(str(path))
    frames = [peer.getFrameId(encode_name(label), pin.FrameType.OP_FRAME) for label in labels]
    return _pinocchio_answers(peer, frames, states)


def _pinocchio_answers(peer: pin.Model, frames: list[int], states: Sequence[State]) -> Answers:
    """With y up and ground reactions on the feet; `frames` are those of the markers."""
    peer.gravity.linear = np.array([0.0, -9.81, 0.0])
    data = peer.createData()
    assert (
        max(*frames, *(peer.getFrameId(foot, pin.FrameType.BODY) for foot in FEET)) < peer.nframes
    ), "all are there"
    feet = [peer.frames[peer.getFrameId(foot, pin.FrameType.BODY)].parentJoint for foot in FEET]
    tau, markers = [], []
    for state in states:
        forces = pin.rnea(peer, data, state.q, state.v, state.a).copy()
        pin.computeJointJacobians(peer, data, state.q)
        for joint, wrench in zip(feet, state.wrenches, strict=True):
            forces -= pin.getJointJacobian(peer, data, joint, pin.ReferenceFrame.WORLD).T @ wrench
        pin.framesForwardKinematics(peer, data, state.q)
        tau.append(forces)
        markers.append([data.oMf[frame].translation.copy() for frame in frames])
    return np.array(tau), np.array(markers)


# ------------------------------------------------------------------------------ OpenSim's own tools


def run_inverse_dynamics(
    osim: Any, model: Path, motion: Path, loads: Path, time: Array
) -> tuple[Array, Array]:
    """InverseDynamicsTool: (nf, 27) N·m and N, and the (nf, 3, 27) q, v, a that its own splines
    made of the file.
    """
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
    return np.stack([found.get_column(name) for name in columns], axis=1), _derivatives(
        osim, model, motion, time
    )


def _derivatives(osim: Any, model: Path, motion: Path, time: Array) -> Array:
    storage = osim.Storage(str(motion))
    peer = osim.Model(str(model))
    peer.initSystem()
    peer.getSimbodyEngine().convertDegreesToRadians(storage)
    splines = osim.GCVSplineSet(5, storage)
    rows = [splines.getIndex(name) for name in COORDINATES]
    return np.array(
        [[[splines.evaluate(i, order, float(t)) for i in rows] for order in range(3)] for t in time]
    )


def run_inverse_kinematics(
    osim: Any,
    model: Path,
    markers: Path,
    placed: MarkerPlacement,
    time: Array,
    accuracy: float | None = None,
) -> Array:
    """InverseKinematicsTool with our marker weights: (nf, 27) m and rad. `accuracy`: OpenSim's
    unless given.
    """
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
        task.setName(encode_name(label))
        task.setWeight(float(weight))
        task.setApply(bool(weight > 0))
        tool.getIKTaskSet().cloneAndAppend(task)
    assert tool.run()
    found = read_table(out)
    np.testing.assert_allclose(found.time, time, rtol=0, atol=1e-8)
    units = [1.0 if is_translation(name) else np.pi / 180 for name in COORDINATES]
    return np.stack(
        [found.get_column(name) * unit for name, unit in zip(COORDINATES, units, strict=True)],
        axis=1,
    )


def optimum(model: SubjectModel, measured: Array, start: Array) -> Array:
    """(27,) the coordinates that bring the markers closest to `measured` (nm, 3), by weight,
    without a spline.
    """
    chain = Chain()
    body = chain.body(model.parameters)
    segment = [chain.segments.index(s) for s in model.markers.segments]
    moved = chain.support[:, segment] > 0
    root = SCALE * np.sqrt(model.markers.weight)[:, None]

    def positions(q: Array) -> Array:
        placed = Kinematics(body, q[None], columns=False)
        axes, origins = placed.axes, placed.origins
        return np.asarray(
            np.einsum("mj,mji->mi", model.markers.local, axes[segment, :, :, 0])
            + origins[segment, :, 0]
        )

    def slopes(q: Array) -> Array:
        spatial = Kinematics(body, q[None]).columns[:, :, 0]
        turned = np.cross(spatial[:, None, 3:], positions(q)[None])
        full = np.where(moved[:, :, None], spatial[:, None, :3] + turned, 0.0)
        return np.asarray((root[None] * full).reshape(len(q), -1).T)

    found = least_squares(
        lambda q: (root * (positions(q) - measured)).ravel(),
        start,
        slopes,
        ftol=None,
        xtol=RESTED,
        gtol=GRADIENT,
    )
    assert found.status > 0, "the reference has not converged"
    return np.asarray(found.x)
