"""Each exported model, in the program it is for, answers as ours does: 27 generalised forces, all
markers.
"""

import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.errors import Code
from gaitcal.export.opensim.osim_reader import read_osim
from gaitcal.export.opensim.osim_writer import write_osim
from gaitcal.export.other_formats import write_mjcf, write_urdf
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, view_as_table
from gaitcal.model.subject_model import SubjectModel
from tests.export.mechanics import (
    FORCE_TOLERANCE,
    POSITION_TOLERANCE,
    SEEDS,
    State,
    our_forces,
    our_markers,
    perturbed,
    random_states,
)
from tests.export.peer_programs import peer
from tests.export.peers import (
    Answers,
    OpenSimModel,
    mjcf_answers,
    mujoco_answers,
    opensim_answers,
    urdf_answers,
)
from tests.messages import refuses

PINOCCHIO_TOLERANCE = 1e-9
"""N, N·m: the same library on both sides, so only rounding of the placements differs."""
INERTIA = ("mass", "mass_center", "inertia")
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


VARIANTS = [pytest.param(seed, id=f"seed {seed}") for seed in SEEDS] + [
    pytest.param(-1, id="talus marker")
]


def variant(model: SubjectModel, seed: int) -> SubjectModel:
    return with_talus_marker(perturbed(model, 1)) if seed < 0 else perturbed(model, seed)


def assert_same(
    model: SubjectModel, states: list[State], answers: Answers, force: float = FORCE_TOLERANCE
) -> None:
    tau, markers = answers
    np.testing.assert_allclose(tau, [our_forces(model, s) for s in states], rtol=0, atol=force)
    np.testing.assert_allclose(
        markers, [our_markers(model, s.q) for s in states], rtol=0, atol=POSITION_TOLERANCE
    )


@pytest.mark.parametrize("seed", VARIANTS)
def test_opensim(osim: Any, published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model, states = variant(published, seed), random_states(abs(seed))
    write_osim(model, tmp_path / "model.osim")
    assert_same(
        model, states, opensim_answers(osim, tmp_path / "model.osim", model.markers.labels, states)
    )


@pytest.mark.parametrize("seed", VARIANTS)
def test_mujoco(mujoco: Any, published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model, states = variant(published, seed), random_states(abs(seed))
    write_mjcf(model, tmp_path / "model.xml")
    assert_same(
        model, states, mujoco_answers(mujoco, tmp_path / "model.xml", model.markers.labels, states)
    )


@pytest.mark.parametrize("seed", VARIANTS)
def test_urdf(published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model, states = variant(published, seed), random_states(abs(seed))
    write_urdf(model, tmp_path / "model.urdf")
    answers = urdf_answers(tmp_path / "model.urdf", model.markers.labels, states)
    assert_same(model, states, answers, PINOCCHIO_TOLERANCE)


@pytest.mark.parametrize("seed", VARIANTS)
def test_mjcf(published: SubjectModel, tmp_path: Path, seed: int) -> None:
    model, states = variant(published, seed), random_states(abs(seed))
    write_mjcf(model, tmp_path / "model.xml")
    assert_same(
        model,
        states,
        mjcf_answers(tmp_path / "model.xml", model.markers.labels, states),
        PINOCCHIO_TOLERANCE,
    )


@pytest.mark.parametrize("seed", VARIANTS)
def test_osim_places_every_marker_and_mass(
    published: SubjectModel, tmp_path: Path, seed: int
) -> None:
    """Read back without OpenSim: the same bodies in the same places are the same
    mechanical system.
    """
    model = variant(published, seed)
    write_osim(model, tmp_path / "model.osim")
    peer = read_osim(tmp_path / "model.osim")
    for state in random_states(abs(seed)):
        poses = {"ground": pin.SE3.Identity()}
        for joint in peer.joints.values():
            values = dict(zip(COORDINATES, state.q, strict=True))
            poses[joint.child] = poses[joint.parent] * peer.compute_joint_pose(joint, values)
        markers = [poses[body].act(place) for body, place in peer.markers.values()]
        np.testing.assert_allclose(
            markers, our_markers(model, state.q), rtol=0, atol=POSITION_TOLERANCE
        )
    bodies = ET.parse(tmp_path / "model.osim").getroot().iter("Body")
    inertias = {
        body.get("name"): [float(x) for tag in INERTIA for x in (body.findtext(tag) or "").split()]
        for body in bodies
    }
    rows = view_as_table(model.parameters.inertial)
    for segment, row in zip(MASSIVE_SEGMENTS, rows, strict=True):
        assert inertias.pop(segment) == [*row, 0.0, 0.0, 0.0]
    assert inertias == {"talus_r": [0.0] * 10, "talus_l": [0.0] * 10}


def test_osim_locks_what_is_held_at_zero(published: SubjectModel, tmp_path: Path) -> None:
    write_osim(replace(published, frozen=ARM), tmp_path / "model.osim")
    joints = read_osim(tmp_path / "model.osim").joints.values()
    assert {c.name for joint in joints for c in joint.coordinates if c.locked} == set(ARM)


def test_opensim_with_coordinates_held_at_zero(
    osim: Any, published: SubjectModel, tmp_path: Path
) -> None:
    model = replace(published, frozen=ARM)
    write_osim(model, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    held = {c.getName() for c in peer.coordinates if c.getLocked(peer.state)}
    assert held == set(ARM)
    for state in random_states(7, still=ARM):
        peer.set(state)
        np.testing.assert_allclose(
            peer.forces(state), our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE
        )


def test_mujoco_with_coordinates_held_at_zero(
    mujoco: Any, published: SubjectModel, tmp_path: Path
) -> None:
    model, states = replace(published, frozen=ARM), random_states(7, still=ARM)
    write_mjcf(model, tmp_path / "model.xml")
    assert_same(
        model, states, mujoco_answers(mujoco, tmp_path / "model.xml", model.markers.labels, states)
    )


def test_opensim_integrates_the_model_forwards(
    osim: Any, published: SubjectModel, tmp_path: Path
) -> None:
    """The massless talus lies between bodies with mass: accelerations exist, and are those of our
    own mass matrix.
    """
    write_osim(published, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    state = random_states(5, 1)[0]
    peer.set(state)
    peer.model.realizeAcceleration(peer.state)
    a = np.array([c.getAccelerationValue(peer.state) for c in peer.coordinates])
    falling = replace(state, a=a, wrenches=np.zeros((2, 6)))
    np.testing.assert_allclose(our_forces(published, falling), 0.0, atol=FORCE_TOLERANCE)


def test_mujoco_refuses_what_we_refuse_to_write(
    osim: Any, published: SubjectModel, tmp_path: Path
) -> None:
    inertial = published.parameters.inertial.copy()
    inertial[4] = inertial[5] + inertial[6] + 0.001  # the pelvis' first moment
    model = published.with_parameters(published.parameters.with_inertial(inertial))
    with refuses(Code.IMPOSSIBLE_BODY, field="pelvis", source="model.xml"):
        write_mjcf(model, tmp_path / "model.xml")
    assert not (tmp_path / "model.xml").exists()
    write_osim(model, tmp_path / "model.osim")
    peer = OpenSimModel(osim, tmp_path / "model.osim")
    state = random_states(3, 1)[0]
    peer.set(state)
    np.testing.assert_allclose(
        peer.forces(state), our_forces(model, state), rtol=0, atol=FORCE_TOLERANCE
    )


@pytest.mark.parametrize("name", ["mujoco", "opensim"])
def test_a_missing_peer_fails_in_ci(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match=f"no {name} here"):
        peer(name)
    monkeypatch.setenv("CI", "true")
    wanted = (
        pytest.skip.Exception
        if name == "opensim" and sys.version_info < (3, 11)
        else pytest.fail.Exception
    )
    with pytest.raises(wanted, match="`peers`"):
        peer(name)
