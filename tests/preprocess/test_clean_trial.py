"""What no least-squares fit survives is left out of a trial, and nothing else."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.io.recording import Recording
from gaitcal.preprocess.clean_trial import clean_trial, remove_outliers, remove_spikes
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from tests.quality.spoilt import sound_study
from tests.real_studies import REAL

RealStudies = Callable[[str], Study]


@pytest.mark.parametrize("name", REAL)
def test_nothing_of_real_recordings_is_left_out(name: str, real_study: RealStudies) -> None:
    study = real_study(name)
    for trial in study.trials:
        assert remove_outliers(trial.recording, study.marker_set.segment_of)[1] == (), trial.name


def test_single_positions_out_of_line_are_left_out_and_steps_are_not() -> None:
    """A path that steps aside and stays, noise, and what borders on a gap stay as they are."""
    time = np.arange(200) / 100.0
    path = np.stack([np.sin(4.0 * time), 0.1 * np.cos(9.0 * time), time], axis=1)
    labels = ("spiked", "stepped", "noisy", "beside a gap", "at the ends")
    markers = np.repeat(path[:, None], len(labels), axis=1)
    markers[[40, 90, 140], 0] += [0.0, 0.1, 0.0]
    markers[100:, 1] += 0.1
    markers[:, 2] += np.random.default_rng(1).normal(0.0, 0.03, (200, 3))
    markers[50, 3], markers[51, 3] = np.nan, path[51] + 0.1
    markers[[0, -1], 4] += 0.1
    found, out = remove_spikes(Recording(source="x", time=time, labels=labels, markers=markers))
    assert list(out) == ["spiked"] and out["spiked"] == (3, pytest.approx(0.1, abs=0.005))
    gone = np.isnan(found.markers[:, :, 0]) & ~np.isnan(markers[:, :, 0])
    assert np.argwhere(gone).tolist() == [[40, 0], [90, 0], [140, 0]]


def test_a_trial_without_fault_keeps_its_recording_and_what_is_known_of_it() -> None:
    study = sound_study()
    for trial in study.trials:
        clean = clean_trial(trial, study.marker_set.segment_of)
        assert (clean.name, clean.role, clean.joint) == (trial.name, trial.role, trial.joint)
        assert clean.recording is trial.recording
        assert (clean.outliers, clean.spikes, clean.cut) == ((), {}, "")


def test_only_what_hangs_on_the_pelvis_is_cut_to_it() -> None:
    study = sound_study()
    walk = study.trials[1]
    of_pelvis = [
        i
        for i, label in enumerate(walk.recording.labels)
        if study.marker_set.segment_of.get(label) == "pelvis"
    ]
    markers = walk.recording.markers.copy()
    markers[100:, of_pelvis] = np.nan
    spoilt = replace(walk, recording=replace(walk.recording, markers=markers))
    cut = clean_trial(spoilt, study.marker_set.segment_of)
    np.testing.assert_array_equal(cut.recording.time, walk.recording.time[:100])
    assert cut.cut and cut.cut in cut.recording.notes
    standing = replace(spoilt, role=Role.STATIC)
    assert clean_trial(standing, study.marker_set.segment_of).recording is spoilt.recording
