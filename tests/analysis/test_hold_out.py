"""The held-out error tells a better model from a merely freer one, and every frame is left out
once.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.fit_joints import FOLDS, assign_folds, compute_held_out_errors, mask_frames
from gaitcal.analysis.prepared_trials import MovingTrial, prepare_trial
from gaitcal.analysis.result import Calibration
from gaitcal.model.anthropometry import move_limb_inertia
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import draw_marker_noise
from tests.commands import gaitcal
from tests.quality.spoilt import sound_study
from tests.synthetic_studies import write_synthetic_study


@pytest.fixture(scope="module")
def study() -> Study:
    """Standing and a knee trial whose shank markers sit 12 mm too far forward: a shifted joint."""
    sound = sound_study()
    rng = np.random.default_rng(4)
    shank = [i for i, s in enumerate(published_model().markers.segments) if s == "shank_r"]
    trials = []
    for trial in sound.trials:
        markers = trial.recording.markers.copy()
        if trial.role is not Role.STATIC:
            markers += draw_marker_noise(trial.recording.time, markers.shape[1], rng, 0.002)
        if trial.role is Role.JOINT:
            markers[:, shank] += [0.012, 0.0, 0.0]
        trials.append(replace(trial, recording=replace(trial.recording, markers=markers)))
    settings = sound.settings.model_copy(update={"ip": "none", "nodes_per_second": 10.0})
    return replace(sound, trials=tuple(t for t in trials if t.name != "walk"), settings=settings)


def prepared(study: Study) -> MovingTrial:
    return prepare_trial(study.moving[0], build_nominal_model(study), study.settings)


def test_every_frame_is_left_out_once(study: Study) -> None:
    trial = prepared(study)
    fold = assign_folds(trial)
    assert set(fold) == set(range(FOLDS))
    held = np.stack(
        [mask_frames(trial, fold == k).joint_fit_problem.data.weight == 0 for k in range(FOLDS)]
    )
    assert (held.sum(axis=0) == 1).all()


def test_every_fold_is_fitted_to_all_but_its_own_blocks(study: Study) -> None:
    trial, nominal, hidden = prepared(study), build_nominal_model(study).parameters, []

    def fit(trials: list[MovingTrial]) -> tuple[None, Parameters]:
        hidden.append((trials[0].joint_fit_problem.data.weight == 0).all(axis=0))
        return None, nominal

    compute_held_out_errors([trial], nominal, fit)
    np.testing.assert_array_equal(np.sum(hidden, axis=0), 1)


def test_nothing_of_a_held_block_reaches_the_fit(study: Study) -> None:
    """Markers torn away in the frames left out change nothing of what is fitted to the rest."""
    trial = prepared(study)
    held = assign_folds(trial) == 1
    fitted = mask_frames(trial, held).joint_fit_problem
    spoilt = replace(fitted.data, measured=fitted.data.measured + np.where(held, 0.5, 0.0))
    coefficients = np.zeros((fitted.basis.control_points, len(fitted.chain.coordinates)))
    body = fitted.build_body(build_nominal_model(study).parameters)
    assert replace(fitted, data=spoilt).compute_cost(coefficients, body) == pytest.approx(
        fitted.compute_cost(coefficients, body), rel=1e-12
    )


@pytest.fixture(scope="module")
def done(study: Study) -> Calibration:
    return calibrate(study, leave_out=True)


def test_masses_go_with_the_joints_where_no_force_tells_of_them(done: Calibration) -> None:
    before, after = done.nominal.parameters, done.model.parameters
    np.testing.assert_allclose(
        after.inertial, move_limb_inertia(before.inertial, before, after), rtol=1e-12
    )
    assert np.abs(after.inertial - before.inertial).max() > 1e-3


def test_a_truly_better_model_is_better_on_frames_left_out(done: Calibration) -> None:
    held = done.trial("knee_r").held_out
    assert held is not None and held.folds == FOLDS and held.legs is None
    fit = done.trial("knee_r").calibrated.errors.rms()
    assert fit is not None
    assert fit < held.calibrated < 0.8 * held.nominal


@pytest.mark.slow
def test_a_merely_freer_model_is_not(study: Study) -> None:
    """A fit that follows its own frames alone: found only where they have weight, lost where they
    have none.
    """
    trial, nominal = prepared(study), build_nominal_model(study).parameters

    def bend(trials: list[MovingTrial]) -> tuple[None, object]:
        wrong = nominal.with_joint(("knee_r.shank.sup",), np.array([nominal.joint.max() + 0.05]))
        return None, wrong

    held = compute_held_out_errors([trial], nominal, bend)["knee_r"]  # type: ignore[arg-type]
    assert held.calibrated > held.nominal


@pytest.mark.slow
def test_command_reports_it(tmp_path: Path) -> None:
    path, result = write_synthetic_study(tmp_path / "study"), tmp_path / "result"
    done = gaitcal("calibrate", path, "--out", result, "--hold-out")
    assert "walk, pelvis and legs: on time blocks left out of the fit (4 folds)" in done.stdout, (
        done.stderr
    )
    told = json.loads((result / "summary.json").read_text(encoding="utf-8"))["trials"]["walk"]
    assert set(told["hold_out_mm"]) == {"nominal", "calibrated", "folds"}
    assert told["pelvis_and_legs_hold_out_mm"]["calibrated"] == pytest.approx(
        told["hold_out_mm"]["calibrated"], abs=1.0
    )
