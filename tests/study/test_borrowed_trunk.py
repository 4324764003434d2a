"""A trunk that only the walks show: its markers go where the static trial would have had them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.study.study import Study, nominal_of
from gaitcal.study.study_trial import Role
from tests.real_studies import write_study

THORAX = ("C7", "T10", "CLAV", "STRN", "RSHO", "LSHO", "RBAK")
POSTURE_MM = 25.0
"""How far trunk markers are elsewhere in walking than in standing, in the mean; 18 mm on this person."""


@pytest.fixture(scope="module")
def study(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_study("pig_c3d", data_dir, tmp_path_factory.mktemp("study")))


def hidden(study: Study, labels: tuple[str, ...], *roles: Role) -> Study:
    """The study with these markers in no trial of these roles."""
    trials = []
    for trial in study.trials:
        r = trial.recording
        kept = [i for i, label in enumerate(r.labels) if trial.role not in roles or label not in labels]
        part = replace(r, labels=tuple(r.labels[i] for i in kept), markers=r.markers[:, kept])
        trials.append(replace(trial, recording=part))
    return replace(study, trials=tuple(trials))


def test_walks_place_the_trunk_that_the_static_trial_lacks(study: Study) -> None:
    whole, borrowed = nominal_of(study), nominal_of(hidden(study, THORAX, Role.STATIC))
    assert not any(name.startswith("lumbar") for name in borrowed.frozen)
    assert any("C7, T10, CLAV, STRN, RSHO, LSHO are not in the static trial" in note for note in borrowed.notes)
    place = [dict(zip(m.markers.labels, m.markers.local, strict=True)) for m in (whole, borrowed)]
    for label in ("C7", "CLAV", "STRN", "T10"):
        assert 1e3 * np.linalg.norm(place[1][label] - place[0][label]) < POSTURE_MM, label
    for label in ("RASI", "LKNE", "RTOE"):
        np.testing.assert_array_equal(place[1][label], place[0][label])


def test_one_marker_in_walks_is_placed_too(study: Study) -> None:
    head = ("LFHD", "RFHD", "LBHD", "RBHD")
    fewer = hidden(hidden(study, (*THORAX, *head), Role.STATIC), (*THORAX[1:], *head), Role.GAIT)
    model = nominal_of(fewer)
    assert [m for m, s in zip(model.markers.labels, model.markers.segments, strict=True) if s == "head_trunk"] == ["C7"]
    assert any("C7 are not in the static trial and were placed by the walks" in note for note in model.notes)


def test_a_static_trial_with_its_trunk_borrows_nothing(study: Study) -> None:
    assert not any("placed by the walks" in note for note in nominal_of(study).notes)
