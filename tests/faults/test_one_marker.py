"""Segments of the legs that one marker follows: told, and refused where the joints beside them do not tell the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.faults.study import check_study
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.motion.motion import Motion, track
from gaitcal.study.study import Study, nominal_of
from tests.real_studies import write_study

CLOSE_DEG = 6.0
"""RMS between hip, knee and ankle angles with and without the second markers of thighs and shanks: at most 3.6."""


@pytest.fixture(scope="module")
def pig(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_study("pig_c3d", data_dir, tmp_path_factory.mktemp("pig")))


def renamed(study: Study, names: Mapping[str, str], trials: tuple[str, ...]) -> Study:
    out = []
    for trial in study.trials:
        r = trial.recording
        other = replace(r, labels=tuple(names.get(label, label) for label in r.labels))
        out.append(replace(trial, recording=other) if trial.name in trials else trial)
    return replace(study, trials=tuple(out))


def told(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.topic == "one marker"]


def test_plug_in_gait_has_two_and_is_left_alone(pig: Study) -> None:
    assert told(pig) == []


def test_wands_that_the_set_does_not_know_are_named_and_the_joints_tell_the_rest(pig: Study) -> None:
    names = {"RTHI": "WandA", "RTIB": "WandB"}
    found = told(renamed(pig, names, ("static", "gait")))
    assert [f.severity for f in found] == [Severity.WARNING] * 2
    assert {f.leg for f in found} == {"r"}
    thigh, shank = found
    assert "'WandA'" in thigh.cure and "'WandB'" not in thigh.cure
    assert "'WandB'" in shank.cure and "'WandA'" not in shank.cure
    assert "('RKNE')" in thigh.found


def test_a_foot_without_its_toe_is_refused_with_the_angles_that_nobody_knows(pig: Study) -> None:
    (found,) = told(renamed(pig, {"RTOE": "Unknown"}, ("gait",)))
    assert found.severity is Severity.ERROR
    assert "subtalar_angle_r" in found.found  # the heel and the posture tell the ankle's
    assert "'Unknown'" in found.cure


def test_one_marker_on_each_segment_of_a_leg_is_refused(pig: Study) -> None:
    found = told(renamed(pig, {"LTHI": "A", "LTIB": "B", "LHEE": "C"}, ("gait",)))
    assert [f.severity for f in found] == [Severity.ERROR] * 3
    assert {f.leg for f in found} == {"l"}


def test_a_while_with_one_marker_is_a_note_with_its_seconds(pig: Study) -> None:
    gait = pig.trials[1]
    markers = gait.recording.markers.copy()
    markers[100:140, gait.recording.labels.index("RTHI")] = np.nan
    gappy = replace(gait, recording=replace(gait.recording, markers=markers))
    (found,) = told(replace(pig, trials=(pig.trials[0], gappy)))
    start = gait.recording.time[100]
    assert found.severity is Severity.INFO
    assert f"thigh_r shows fewer than two markers with weight in {start:.2f}" in found.found


def tracked(study: Study) -> Motion:
    return track(nominal_of(study), study.trials[1].recording, root="pelvis", segments=LOWER_BODY)


def test_the_posture_found_is_that_of_all_markers(pig: Study) -> None:
    """Started with the thigh straight below the pelvis, both legs fell into another posture 33 to 56 deg away."""
    whole = tracked(pig)
    reduced = tracked(renamed(pig, {f"{s}{m}": f"{s}{m}x" for s in "RL" for m in ("THI", "TIB")}, ("gait",)))
    away = np.degrees(np.sqrt(np.mean((whole.q - reduced.q) ** 2, axis=0)))
    judged = {n: a for n, a in zip(whole.coordinates, away, strict=True) if n.startswith(("hip", "knee", "ankle"))}
    assert reduced.converged
    assert max(judged.values()) < CLOSE_DEG, judged
