"""Standard errors of torques and coordinates: size in `test_coverage`; here, blocks of long trials change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration import torque_errors
from gaitcal.calibration.influence import influence_of
from gaitcal.calibration.joint_calibration import calibrate_joints
from gaitcal.model.joint_parameters import gait_parameters
from gaitcal.model.nominal import published_model
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import NodeRule, trial_problem
from gaitcal.recording import Recording
from gaitcal.synthetic.measurements import marker_noise, residual_free_wrench, synthetic_markers
from gaitcal.synthetic.motion import NODES, gait_motion


def test_blocks_of_frames_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    model, motion = published_model(), gait_motion()
    time = motion.basis.time
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    noise = marker_noise(time, markers.shape[1], np.random.default_rng(3), 0.005)
    recording = Recording("made up", time, model.markers.labels, markers + noise)
    problem = trial_problem("gait", model, recording, NodeRule(fixed=NODES))
    free = gait_parameters("r")
    closed = problem.with_free(())
    start = starting_nodes(closed.chain, closed.constants(model.parameters), problem.data, problem.basis)
    fit = calibrate_joints([problem], model.parameters, free, [start])
    wrench = residual_free_wrench(model.parameters, motion)

    moves = torque_errors.marker_moves(problem, fit.nodes[0], fit.parameters, influence_of([problem], fit))

    def errors() -> tuple[np.ndarray, np.ndarray]:
        torques = torque_errors.torque_standard_errors(
            problem, fit.nodes[0], fit.parameters, wrench, influence_of([problem], fit), None
        )
        return torques, torque_errors.coordinate_standard_errors(problem, moves)

    torques, coordinates = errors()
    assert torques.shape == (len(time), 29)
    assert coordinates.shape == (len(time), 27)
    assert (torques > 0).all() and (coordinates > 0).all()
    for module in (torque_errors,):
        monkeypatch.setattr(module, "BLOCK", 17)
    for found, whole in zip(errors(), (torques, coordinates), strict=True):
        np.testing.assert_allclose(found, whole, rtol=1e-9)
