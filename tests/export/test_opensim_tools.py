"""OpenSim's own tools take the exported files over as they are: inverse dynamics and inverse kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.export.motion_files import write_external_loads, write_mot
from gaitcal.export.osim import write_osim
from gaitcal.io.opensim_files import write_trc
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.subject_model import SubjectModel
from tests.export.mechanics import IK_TOLERANCE, PRINTED, State, our_forces, our_markers, perturbed
from tests.export.opensim_tools import optimum, run_inverse_dynamics, run_inverse_kinematics
from tests.export.test_motion_files import walking_wrenches

NOISE = 5e-3
"""m, per marker coordinate: about what skin motion does."""


def smooth_motion(time: np.ndarray, seed: int) -> np.ndarray:
    """(nf, nq) slow waves, standing height."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.5, 1.5, len(COORDINATES)) * 2 * np.pi
    q = 0.3 * np.sin(np.outer(time, waves) + rng.uniform(0, 6, len(COORDINATES)))
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
    found, states = run_inverse_dynamics(osim, tmp_path / "model.osim", tmp_path / "walk.mot", loads, time)
    ours = [our_forces(model, State(*state, wrench)) for state, wrench in zip(states, wrenches, strict=True)]
    np.testing.assert_allclose(found, ours, rtol=0, atol=PRINTED)


@pytest.mark.peers
def test_inverse_kinematics_tool(osim: Any, published: SubjectModel, tmp_path: Path) -> None:
    model = perturbed(published, 2)
    time = np.arange(40) / 100.0
    truth = smooth_motion(time, 2)
    labels = model.markers.labels
    noise = np.random.default_rng(3).normal(scale=NOISE, size=(len(time), len(labels), 3))
    measured = np.array([our_markers(model, q) for q in truth]) + noise
    write_osim(model, tmp_path / "model.osim")
    write_trc(tmp_path / "walk.trc", Recording(source="walk", time=time, labels=labels, markers=measured))
    theirs = run_inverse_kinematics(osim, tmp_path / "model.osim", tmp_path / "walk.trc", model.markers, time)
    ours = [optimum(model, *frame) for frame in zip(measured, truth, strict=True)]
    apart = np.array([our_markers(model, q) - our_markers(model, p) for q, p in zip(theirs, ours, strict=True)])
    assert np.sqrt(np.mean(np.sum(apart**2, axis=2))) < IK_TOLERANCE
