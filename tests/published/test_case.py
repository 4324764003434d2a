"""The case of a calibrated person: the same from the calibration and from its folder, with the markers tracked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.published.case import case_from, case_of
from gaitcal.results.calibration import write_results
from gaitcal.session.calibrate import calibrate
from gaitcal.session.result import Calibration
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from tests.synthetic_studies import write_synthetic_study

QUICK = '[calibration]\njp = false\nip = "none"\nnodes = 20\n'
LOST = "R.Bicep"


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A walk, tracked with the nominal model; one marker was never seen. Before it comes a trial without plates."""
    study = Study.load(write_synthetic_study(tmp_path_factory.mktemp("study"), ("knee_r",), QUICK))
    trials = []
    for trial in study.trials:
        markers = trial.recording.markers.copy()
        if trial.role is not Role.STATIC:
            markers[:, trial.recording.labels.index(LOST)] = np.nan
        trials.append(replace(trial, recording=replace(trial.recording, markers=markers)))
    static, walk, knee = trials
    # `check` would refuse markers that are never seen
    return calibrate(replace(study, trials=(static, knee, walk)), checked=())


@pytest.fixture(scope="module")
def folder(calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its result folder, without what is for the eye."""
    path = tmp_path_factory.mktemp("result") / "result"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitcal.results.calibration.write_page", lambda *_: None)
        write_results(calibration, path)
    return path


def test_the_folder_of_a_result_gives_the_case_of_its_calibration(calibration: Calibration, folder: Path) -> None:
    case, read = case_of(calibration), case_from(folder)
    assert case.name == read.name == "walk"
    assert read.fingerprint() == case.fingerprint()
    worn = set(calibration.trial("walk").recording.labels) & set(calibration.model.markers.labels)
    assert LOST in worn
    assert set(case.markers.labels) == worn - {LOST}
    local = dict(zip(calibration.model.markers.labels, calibration.model.markers.local, strict=True))
    np.testing.assert_array_equal(case.markers.local, [local[label] for label in case.markers.labels])
    assert case.valid.any() and not case.valid.all()


def test_trials_without_ground_reactions_are_refused(calibration: Calibration, folder: Path) -> None:
    with pytest.raises(InputError, match="--trial: found 'knee_r'; allowed: walk"):
        case_of(calibration, "knee_r")
    with pytest.raises(InputError, match="--trial: found 'knee_r'; allowed: walk"):
        case_from(folder, "knee_r")
    with pytest.raises(InputError, match="no gait trial with ground reactions"):
        case_of(replace(calibration, trials=calibration.trials[:1]))


def test_a_folder_that_holds_nothing_of_ours_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found neither model\.toml nor study\.toml"):
        case_from(tmp_path)
