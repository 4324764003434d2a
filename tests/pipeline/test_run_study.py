"""A study or folder is run, and further trials are analysed, from Python as from the
command line.
"""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitcal as gc
from gaitcal.errors import Code, Severity
from gaitcal.intake.subject_metadata import Options
from gaitcal.pipeline import run_study as pipeline
from tests.kept import copied_person, kept_result


def test_a_folder_without_a_static_trial_is_refused_before_anything_is_written(
    kept: Path, tmp_path: Path
) -> None:
    study = copied_person(kept, tmp_path / "person")
    for file in study.parent.glob("*.*"):
        if file.name != "gait.c3d":
            file.unlink()
    with pytest.raises(gc.InputError) as refused:
        gc.run_study(study.parent, tmp_path / "result")
    assert refused.value.code is Code.FOLDER
    assert not (tmp_path / "result").exists()


def test_a_study_file_in_a_folder_is_used(kept: Path, tmp_path: Path) -> None:
    study = copied_person(kept, tmp_path / "person")
    assert pipeline.find_study(study.parent, Options()) == study
    assert pipeline.find_study(study, Options()) == study


def test_errors_of_the_checks_stop_a_run(
    monkeypatch: pytest.MonkeyPatch, kept: Path, tmp_path: Path
) -> None:
    study = gc.Study.load(kept_result(kept) / "study" / "study.toml")
    finding = gc.check_study(study)[0]
    error = replace(finding, severity=Severity.ERROR, where=study.static.name)
    monkeypatch.setattr(pipeline, "check_preprocessed", lambda _: (error, error))
    with pytest.raises(pipeline.FaultyStudyError) as refused:
        gc.run_study(study.source, tmp_path / "result")
    assert refused.value.errors == (error, error)
    assert refused.value.code is error.code


@pytest.mark.slow
def test_a_run_writes_what_the_command_writes_and_takes_further_trials(
    kept: Path, tmp_path: Path
) -> None:
    made = kept_result(kept)
    calibration = gc.run_study(made / "study" / "study.toml", tmp_path / "result")
    for name in ("parameters.csv", "cycles.csv"):
        assert (tmp_path / "result" / name).read_bytes() == (made / "result" / name).read_bytes()
    walk = next(trial for trial in calibration.study.trials if trial.role.value == "gait")
    further = gc.analyse_trial(
        tmp_path / "result",
        walk.files["file"],
        forces=walk.files.get("forces"),
        out=tmp_path / "further",
    )
    (trial,) = further.trials
    first = calibration.trial(walk.name)
    assert np.abs(trial.body.q - first.body.q).max() < 2e-3
    assert trial.loads is not None and trial.loads.errors is not None
    assert further.verdict.judgement.value in repr(further)
    written = pd.read_csv(next((tmp_path / "further" / "motion").glob("*.csv")), comment="#")
    np.testing.assert_allclose(
        written.knee_angle_r, trial.body.to_dataframe().knee_angle_r, atol=1e-4
    )


def test_what_a_study_says_is_not_said_beside_it(kept: Path, tmp_path: Path) -> None:
    study = copied_person(kept, tmp_path / "person")
    for source in (study, study.parent):
        with pytest.raises(gc.InputError):
            gc.run_study(source, tmp_path / "result", mass=200.0)
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize("wrong", [{"role": "joint"}, {"role": "walk"}, {"plates": {"1": "x"}}])
def test_a_further_trial_of_no_kind_is_refused(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(gc.InputError) as refused:
        gc.analyse_trial(tmp_path, tmp_path / "walk.c3d", **wrong)
    assert refused.value.code is Code.ARGUMENT


def test_errors_that_stop_a_run_can_be_sent_between_processes(kept: Path) -> None:
    finding = gc.check_study(gc.Study.load(kept_result(kept) / "study" / "study.toml"))[0]
    again = pickle.loads(pickle.dumps(pipeline.FaultyStudyError([finding])))
    assert again.errors == (finding,)
