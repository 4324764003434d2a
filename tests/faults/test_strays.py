"""Markers metres away are named and take no part; those on the body stay, however it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.faults.study import check_study
from gaitcal.findings import Severity
from gaitcal.model.outliers import outlier_mask, without_outliers
from gaitcal.session.session import prepare_trial
from gaitcal.study.study import Study, cleaned, nominal_of
from tests.faults.spoilt import moved, put, sound_study, with_trial
from tests.real_studies import REAL, write_study


@pytest.fixture(scope="module")
def sound() -> Study:
    return sound_study()


@pytest.mark.parametrize("name", REAL)
def test_nothing_of_real_recordings_is_left_out(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    for trial in study.trials:
        assert not outlier_mask(trial.recording, study.marker_set.segment_of).any(), trial.name


@pytest.mark.parametrize("label", ["R.Thigh.Front", "L.Heel", "L.Shank.Rear", "R.Wrist.Lat"])
def test_a_marker_two_metres_off_is_told_and_left_out_throughout(sound: Study, label: str) -> None:
    spoilt = with_trial(sound, "walk", moved(label, lambda x: x + [0.0, 2.0, 0.0]))
    told = [f for f in check_study(spoilt) if f.topic == "strays"]
    assert len(told) == 1 and told[0].severity is Severity.WARNING
    assert f"'{label}' is metres away" in told[0].cause and "208 of 208 frames (0.00-1.03 s)" in told[0].found
    walk = next(t for t in cleaned(spoilt).trials if t.name == "walk")
    fitted = prepare_trial(walk, nominal_of(spoilt), spoilt.settings).recording
    assert label not in fitted.labels and label in fitted.notes[-1]


def test_a_marker_that_flies_off_is_left_out_there_alone(sound: Study) -> None:
    spoilt = with_trial(sound, "walk", moved("R.Thigh.Front", lambda x: put(x, slice(50, 60), [5.0, 3.0, 0.0])))
    walk = next(t for t in spoilt.trials if t.name == "walk").recording
    kept, strays = without_outliers(walk, spoilt.marker_set.segment_of)
    gone = ~np.isfinite(kept.markers[:, kept.labels.index("R.Thigh.Front")]).all(axis=1)
    assert np.flatnonzero(gone).tolist() == list(range(50, 60))
    assert [(s.label, s.frames) for s in strays] == [("R.Thigh.Front", 10)]
    assert any("0.25-0.29 s" in f.found for f in check_study(spoilt) if f.topic == "strays")


def test_a_tracking_marker_metres_away_in_the_static_trial_is_in_no_model(sound: Study) -> None:
    spoilt = with_trial(sound, "static", moved("R.Thigh.Front", lambda x: x + [0.0, 0.0, 2.0]))
    assert "R.Thigh.Front" not in nominal_of(replace(spoilt, weights={"R.Thigh.Front": 0.0})).markers.labels
    assert any(f.topic == "strays" and f.where == "static" for f in check_study(spoilt))
