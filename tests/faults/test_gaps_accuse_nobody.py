"""Gaps, a fifth of the markers missing, a neighbour lost: clean people's labels stay theirs, and cures can be done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.exchanged import exchanged
from gaitcal.faults.markers import gaps
from gaitcal.findings import Finding, Severity
from gaitcal.study.study import Study, nominal_of
from tests.faults.spoilt import sound_study
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


def pelvis_found(study: Study, lost: Callable[[float, int], bool]) -> tuple[Finding, ...]:
    """What is said of gaps, beside each marker's own, with two pelvis markers unseen where `lost` (s, frame)."""
    model = nominal_of(study)
    trial = next(t for t in study.moving if t.name == "walk")
    r = trial.recording
    markers = r.markers.copy()
    away = np.array([lost(float(t), k) for k, t in enumerate(r.time)])
    of_pelvis = [i for i, label in enumerate(r.labels) if study.marker_set.segment_of.get(label) == "pelvis"]
    for i in of_pelvis[2:]:
        markers[away, i] = np.nan
    spoilt = replace(trial, recording=replace(r, markers=markers))
    evidence = TrialEvidence.of(spoilt, study.marker_set, study.subject, study.settings, model)
    return tuple(f for f in gaps(evidence) if "pelvis markers" in f.found)


def test_single_frames_without_the_pelvis_need_no_cure() -> None:
    (found,) = pelvis_found(sound_study(), lambda t, k: k % 12 == 5)
    assert found.severity is Severity.INFO and "8 % of the frames" in found.found and not found.cure


def test_a_part_of_a_step_without_the_pelvis_is_told_with_the_part_to_keep() -> None:
    (found,) = pelvis_found(sound_study(), lambda t, k: 0.195 < t < 0.455 or k % 12 == 5)
    assert found.severity is Severity.WARNING
    assert "(0.20-0.45 s)" in found.found
    end = next(t for t in sound_study().moving if t.name == "walk").recording.time[-1]
    assert f"time = [0.46, {end:.2f}]" in found.cure
