"""The torques of a calibration are those of the model and the motion that they are said
to be of.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.analysis.trial_result import estimate_axis_deviations
from gaitcal.calibration.torque_errors import ForceErrors
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.dynamics.measurement_errors import DEFAULT, AxisErrors
from gaitcal.errors import Severity
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.tracking.bandwidth import apply_bandwidth
from gaitcal.tracking.motion import Motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import build_trial_problem
from tests.synthetic_studies import write_synthetic_study

SAME = 1e-9
"""N, N·m: the same sums in the same order."""


def calibrated(folder: Path, ip: str) -> tuple[Study, Calibration]:
    """The published subject, 3 kg heavier on paper than on the plates: every step has something to
    change.
    """
    path = write_synthetic_study(folder, more=f'\n[calibration]\nip = "{ip}"\n')
    path.write_text(path.read_text(encoding="utf-8").replace("69.4", "72.4"), encoding="utf-8")
    study = Study.load(path)
    return study, calibrate(study)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Calibration]:
    return calibrated(tmp_path_factory.mktemp("study"), "consistent")


@pytest.mark.slow
def test_each_step_has_its_own_model_and_motion(tmp_path: Path) -> None:
    _, done = calibrated(tmp_path / "study", "published")
    trial = done.trial("walk")
    wrench = trial.loads.reactions.wrench

    def torques(parameters: Parameters, motion: Motion) -> np.ndarray:
        forces = Dynamics(parameters).compute_forces(
            motion.q, motion.velocity, motion.acceleration, wrench
        )
        return forces[:, : len(COORDINATES)]

    nominal, final = done.nominal.parameters, done.model.parameters
    np.testing.assert_allclose(trial.loads.nominal.tau, torques(nominal, trial.nominal), atol=SAME)
    np.testing.assert_allclose(trial.loads.final.tau, torques(final, trial.body), atol=SAME)
    assert np.abs(trial.nominal.q - trial.body.q).max() > 1e-6
    assert np.abs(trial.loads.nominal.tau - trial.loads.final.tau).max() > 1.0


@pytest.mark.slow
def test_errors_are_those_of_the_last_step(made: tuple[Study, Calibration]) -> None:
    """With what is too weak to be told: how far the markers may have moved since the
    static trial.
    """
    study, done = made
    trial = done.trial("walk")
    spread, hz = done.uncertainty, trial.bandwidth.motion_hz if trial.bandwidth else 0.0
    plain = build_trial_problem("walk", done.nominal, trial.recording, ControlPointRule())
    problem = replace(
        apply_bandwidth(plain, done.nominal.parameters, hz), tissue=done.joint.tissue["walk"]
    )
    problem = done.joint.artefact.displace_markers(problem)
    turned = estimate_axis_deviations(
        study.settings, done.nominal, preprocess_study(study).find_possible_moves()["walk"]
    )
    errors = ForceErrors(
        problem,
        trial.body.coefficients,
        done.model.parameters,
        trial.loads.reactions.wrench,
        spread.joint,
        spread.inertial,
        plates=DEFAULT,
        axes=AxisErrors(done.model.parameters, turned),
    ).compute_errors()
    np.testing.assert_allclose(trial.loads.errors.tau, errors.tau, rtol=1e-6)
    np.testing.assert_allclose(trial.loads.errors.knee_adduction, errors.knee_adduction, rtol=1e-6)


@pytest.mark.parametrize(
    ("role", "newtons", "severity"),
    [
        (Role.GAIT, 0.0, Severity.INFO),
        (Role.GAIT, 700.0, Severity.WARNING),
        (Role.MOTION, 0.0, Severity.WARNING),
    ],
)
def test_dead_plates_of_a_squat_stay_a_warning(
    role: Role, newtons: float, severity: Severity
) -> None:
    """Of a walk, soles and outlines say whether plates should have read something; of another
    activity nothing does.
    """
    reactions = SimpleNamespace(
        findings=(), has_torques=False, valid_legs=np.zeros((3, 2), dtype=bool)
    )
    recording = SimpleNamespace(plates=(SimpleNamespace(force=np.full((3, 3), newtons)),))
    trial = SimpleNamespace(
        name="trial", role=role, recording=recording, loads=SimpleNamespace(reactions=reactions)
    )
    (found,) = TrialResult._check_loads(trial)
    assert found.severity is severity
