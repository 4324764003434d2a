"""The case of a calibrated person: the same from the calibration and from its folder, with the
markers tracked.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration
from gaitcal.errors import Code
from gaitcal.montecarlo.case import load_case, make_case
from gaitcal.pipeline.write_results import write_results
from gaitcal.study.study import Study
from tests.messages import refuses
from tests.quality.spoilt import gone, with_trial
from tests.synthetic_studies import write_synthetic_study

QUICK = '[calibration]\njp = false\nip = "none"\nnodes = 20\n'
LOST = "R.Bicep"


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A walk, tracked with the nominal model; one marker was never seen. Before it comes a trial
    without plates.
    """
    study = Study.load(write_synthetic_study(tmp_path_factory.mktemp("study"), ("knee_r",), QUICK))
    for name in ("walk", "knee_r"):
        study = with_trial(study, name, gone(slice(None), LOST))
    static, walk, knee = study.trials
    # `check` would refuse markers that are never seen
    return calibrate(replace(study, trials=(static, knee, walk)), checked=())


@pytest.fixture(scope="module")
def folder(calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its result folder, without what is for the eye."""
    path = tmp_path_factory.mktemp("result") / "result"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitcal.pipeline.write_results.write_page", lambda *_: None)
        write_results(calibration, path)
    return path


def test_the_folder_of_a_result_gives_the_case_of_its_calibration(
    calibration: Calibration, folder: Path
) -> None:
    case, read = make_case(calibration), load_case(folder)
    assert case.name == read.name == "walk"
    assert read.compute_fingerprint() == case.compute_fingerprint()
    worn = set(calibration.trial("walk").recording.labels) & set(calibration.model.markers.labels)
    assert LOST in worn
    assert set(case.markers.labels) == worn - {LOST}
    local = dict(
        zip(calibration.model.markers.labels, calibration.model.markers.local, strict=True)
    )
    np.testing.assert_array_equal(
        case.markers.local, [local[label] for label in case.markers.labels]
    )
    assert case.valid.any() and not case.valid.all()


def test_trials_without_ground_reactions_are_refused(
    calibration: Calibration, folder: Path, tmp_path: Path
) -> None:
    """And a folder that holds nothing of ours."""
    for case, result in ((make_case, calibration), (load_case, folder)):
        with refuses(Code.OPTION, "knee_r", "walk", field="--trial"):
            case(result, "knee_r")
    isolated = replace(calibration, trials=calibration.trials[:1])
    with refuses(Code.MONTE_CARLO):
        make_case(isolated)
    with refuses(Code.NO_RESULT, "model.toml", "study.toml"):
        load_case(tmp_path)
