"""A fifth of the markers missing at random, and a neighbour lost: clean people's labels stay theirs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.exchanged import exchanged
from gaitcal.study.study import Study, nominal_of
from tests.checks.spoilt import sound_study
from tests.real_studies import write_study

MISSING = 0.2


def accused(study: Study, seed: int, weights: float | None = None) -> list[str]:
    rng = np.random.default_rng(seed)
    own = dict.fromkeys(study.marker_set.tracked, weights) if weights else dict(study.weights)
    model, out = nominal_of(study), []
    for trial in study.moving[:3]:
        markers = trial.recording.markers.copy()
        markers[rng.random(markers.shape[:2]) < MISSING] = np.nan
        markers[:, rng.random(markers.shape[1]) < 0.1] = np.nan
        spoilt = replace(trial, recording=replace(trial.recording, markers=markers))
        marker_set = study.marker_set.with_weights(own)
        evidence = TrialEvidence.of(spoilt, marker_set, study.subject, study.settings, model)
        out += [f.line for f in exchanged(evidence)]
    return out


@pytest.mark.parametrize("seed", range(4))
def test_synthetic_person(seed: int) -> None:
    assert accused(sound_study(), seed) == []


@pytest.mark.parametrize("name", ["subject01", "uf3"])
def test_real_people_whatever_the_weights(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    for seed in range(3):
        assert accused(study, seed, weights=1.0) == []


def test_arms_that_turn_under_their_skin_are_not_accused(data_dir: Path, tmp_path: Path) -> None:
    """In `knee_r` of functional_c3d both elbows' epicondyles lie a right angle from where the static trial has them."""
    study = Study.load(write_study("functional_c3d", data_dir, tmp_path))
    model = nominal_of(study)
    trial = next(t for t in study.trials if t.name == "knee_r")
    evidence = TrialEvidence.of(trial, study.marker_set, study.subject, study.settings, model)
    assert [f.found for f in exchanged(evidence) if "LHE" in f.found] == []
