"""What other programs answer when they are given an exported model: generalised forces and marker positions.

Each function returns (tau, markers): (ns, 27) N·m and N in our order, and (ns, nm, 3) m, for `ns` states. Importable
without the peers installed; they are handed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.export.osim import safe_name
from gaitcal.model.linkage import COORDINATES
from tests.export.mechanics import FEET, State
from tests.export.opensim_model import OpenSimModel

Array = NDArray[np.float64]
Answers = tuple[Array, Array]


def opensim_answers(osim: Any, path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
    """OpenSim's InverseDynamicsSolver on `model.osim`, ground reactions on the feet."""
    peer = OpenSimModel(osim, path)
    tau, markers = [], []
    for state in states:
        peer.set(state)
        tau.append(peer.forces(state))
        markers.append(peer.markers(labels))
    return np.array(tau), np.array(markers)


def mujoco_answers(mujoco: Any, path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
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
            mujoco.mj_applyFT(peer, data, wrench[:3], wrench[3:], np.zeros(3), peer.body(foot).id, ground)
        tau.append(data.qfrc_inverse - ground)
        markers.append([data.site(safe_name(label)).xpos.copy() for label in labels])
    return np.array(tau), np.array(markers)


def urdf_answers(path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
    """Pinocchio's own reader and RNEA on `model.urdf`."""
    peer = pin.buildModelFromUrdf(str(path))
    assert tuple(peer.names)[1:] == COORDINATES
    frames = [peer.getFrameId(f"marker_{safe_name(label)}", pin.FrameType.BODY) for label in labels]
    return _pinocchio_answers(peer, frames, states)


def mjcf_answers(path: Path, labels: tuple[str, ...], states: Sequence[State]) -> Answers:
    """Pinocchio's own reader and RNEA on `model.xml`."""
    peer = pin.buildModelFromMJCF(str(path))
    frames = [peer.getFrameId(safe_name(label), pin.FrameType.OP_FRAME) for label in labels]
    return _pinocchio_answers(peer, frames, states)


def _pinocchio_answers(peer: pin.Model, frames: list[int], states: Sequence[State]) -> Answers:
    """With y up and ground reactions on the feet; `frames` are those of the markers."""
    peer.gravity.linear = np.array([0.0, -9.81, 0.0])
    data = peer.createData()
    assert max(*frames, *(peer.getFrameId(foot, pin.FrameType.BODY) for foot in FEET)) < peer.nframes, "all are there"
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
