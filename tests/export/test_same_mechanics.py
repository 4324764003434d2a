"""Each exported model, in the program it is for, answers as ours does: 27 generalised forces, all markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.errors import InputError
from gaitcal.export import safe_name, write_mjcf, write_osim, write_urdf
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.subject_model import SubjectModel
from tests.export.mechanics import (
    FEET,
    FORCE_TOLERANCE,
    POSITION_TOLERANCE,
    SEEDS,
    our_forces,
    our_markers,
    perturbed,
    random_states,
)
from tests.export.opensim_model import OpenSimModel

URDF_TOLERANCE = 1e-9
"""N, N·m: the same library on both sides, so only rounding of the placements differs."""
ARM = ("arm_flex_r", "arm_add_r", "elbow_flex_r")


def with_talus_marker(model: SubjectModel) -> SubjectModel:
    m = model.markers
    markers = replace(
        m,
        labels=(*m.labels, "R.Talus"),
        segments=(*m.segments, "talus_r"),
        local=np.vstack([m.local, [0.01, 0.02, 0.03]]),
        weight=np.append(m.weight, 1.0),
    )
    return replace(model, markers=markers)


VARIANTS = [pytest.param(seed, id=f"seed {seed}") for seed in SEEDS] + [pytest.param(-1, id="talus marker")]


def variant(model: SubjectModel, seed: int) -> SubjectModel:
    return with_talus_marker(perturbed(model, 1)) if seed < 0 else perturbed(model, seed)


@pytest.mark.peers
@pytest.mark.parametrize("seed", VARIANTS)
def test_opensim(osim: Any, published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model = variant(published, seed)
    write_osim(model, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    for state in random_states(abs(seed)):
        peer.set(state)
        np.testing.assert_allclose(peer.forces(state), our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE)
        found = peer.markers(model.markers.labels)
        np.testing.assert_allclose(found, our_markers(model, state.q), rtol=0, atol=POSITION_TOLERANCE)


@pytest.mark.peers
@pytest.mark.parametrize("seed", VARIANTS)
def test_mujoco(published: SubjectModel, tmp_path: Path, seed: int) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = variant(published, seed)
    check_mujoco(mujoco, model, tmp_path / "model.xml", random_states(abs(seed)))


def check_mujoco(mujoco: SimpleNamespace, model: SubjectModel, path: Path, states: list) -> None:
    write_mjcf(model, path)
    peer = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(peer)
    assert tuple(peer.joint(i).name for i in range(peer.njnt)) == COORDINATES
    for state in states:
        data.qpos[:], data.qvel[:], data.qacc[:] = state.q, state.v, state.a
        mujoco.mj_inverse(peer, data)
        ground = np.zeros(27)
        for foot, wrench in zip(FEET, state.wrenches, strict=True):
            body = peer.body(foot).id
            mujoco.mj_applyFT(peer, data, wrench[:3], wrench[3:], np.zeros(3), body, ground)
        tau = data.qfrc_inverse - ground
        np.testing.assert_allclose(tau, our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE)
        found = np.array([data.site(safe_name(label)).xpos for label in model.markers.labels])
        np.testing.assert_allclose(found, our_markers(model, state.q), rtol=0, atol=POSITION_TOLERANCE)


@pytest.mark.parametrize("seed", VARIANTS)
def test_urdf(published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model = variant(published, seed)
    write_urdf(model, tmp_path / "model.urdf")
    peer = pin.buildModelFromUrdf(str(tmp_path / "model.urdf"))
    peer.gravity.linear = np.array([0.0, -9.81, 0.0])
    data = peer.createData()
    assert tuple(peer.names)[1:] == COORDINATES
    for state in random_states(abs(seed)):
        tau = pin.rnea(peer, data, state.q, state.v, state.a).copy()
        unloaded = replace(state, wrenches=np.zeros((2, 6)))
        np.testing.assert_allclose(tau, our_forces(model, unloaded), rtol=0, atol=URDF_TOLERANCE)
        pin.framesForwardKinematics(peer, data, state.q)
        names = [f"marker_{safe_name(label)}" for label in model.markers.labels]
        found = np.array([data.oMf[peer.getFrameId(name, pin.FrameType.BODY)].translation for name in names])
        np.testing.assert_allclose(found, our_markers(model, state.q), rtol=0, atol=POSITION_TOLERANCE)


@pytest.mark.peers
def test_opensim_with_coordinates_held_at_zero(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    model = replace(published, frozen=ARM)
    write_osim(model, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    held = {c.getName() for c in peer.coordinates if c.getLocked(peer.state)}
    assert held == set(ARM)
    for state in random_states(7, still=ARM):
        peer.set(state)
        np.testing.assert_allclose(peer.forces(state), our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE)


@pytest.mark.peers
def test_mujoco_with_coordinates_held_at_zero(published: SubjectModel, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = replace(published, frozen=ARM)
    check_mujoco(mujoco, model, tmp_path / "model.xml", random_states(7, still=ARM))


@pytest.mark.peers
def test_opensim_integrates_the_model_forwards(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    """The massless talus lies between bodies with mass: accelerations exist, and are those of our own mass matrix."""
    write_osim(published, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    state = random_states(5, 1)[0]
    peer.set(state)
    peer.model.realizeAcceleration(peer.state)
    a = np.array([c.getAccelerationValue(peer.state) for c in peer.coordinates])
    falling = replace(state, a=a, wrenches=np.zeros((2, 6)))
    np.testing.assert_allclose(our_forces(published, falling), 0.0, atol=FORCE_TOLERANCE)


@pytest.mark.peers
def test_mujoco_refuses_what_we_refuse_to_write(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    inertial = published.parameters.inertial.copy()
    inertial[4] = inertial[5] + inertial[6] + 0.001  # the pelvis' first moment
    model = published.with_parameters(published.parameters.with_inertial(inertial))
    with pytest.raises(InputError, match="pelvis: found mass .* no rigid body"):
        write_mjcf(model, tmp_path / "model.xml")
    assert not (tmp_path / "model.xml").exists()
    write_osim(model, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    state = random_states(3, 1)[0]
    peer.set(state)
    np.testing.assert_allclose(peer.forces(state), our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE)
