"""What a laboratory may do wrong in a static trial: told in one line, or said in the model's notes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.recording import Recording
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.nominal import PUBLISHED, nominal_model
from gaitcal.model.subject_model import Subject
from tests.model.people import PEOPLE, published_static, without


def test_a_tracking_marker_less_is_told() -> None:
    model = nominal_model(without(published_static(), "R.Midfoot.Sup"), load_marker_set("published"), PUBLISHED)
    assert any("left out: R.Midfoot.Sup" in note for note in model.notes)
    assert "R.Midfoot.Sup" not in model.markers.labels


def spoiled(change: str) -> tuple[Recording, Subject]:
    static, subject = published_static(), PUBLISHED
    if change == "millimetres":
        static = replace(static, markers=1e3 * static.markers)
    elif change == "sides":
        pairs = {"R.ASIS": "L.ASIS", "L.ASIS": "R.ASIS"}
        static = replace(static, labels=tuple(pairs.get(m, m) for m in static.labels))
    elif change == "medial":
        pairs = {"R.Knee.Lat": "R.Knee.Med", "R.Knee.Med": "R.Knee.Lat"}
        static = replace(static, labels=tuple(pairs.get(m, m) for m in static.labels))
    elif change == "sacrum in front":
        markers = static.markers.copy()
        at = static.labels.index("V.Sacral")
        markers[:, at] = 2 * markers[:, static.labels.index("R.ASIS")] - markers[:, at]
        static = replace(static, markers=markers)
    elif change == "child":
        subject = replace(subject, height=0.7)
    elif change.startswith("unseen "):
        markers = static.markers.copy()
        markers[:, static.labels.index(change.split(" ")[1])] = np.nan
        static = replace(static, markers=markers)
    else:
        static = without(static, change)
    return static, subject


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("R.Heel", "landmark heel_r: the file has no marker 'R.Heel'; instead it could be"),
        ("V.Sacral", "landmark sacrum: the file has no marker 'V.Sacral'"),
        ("unseen L.ASIS", "landmark asis_l: marker 'L.ASIS' was not seen while the subject stood still"),
        ("millimetres", "found 2.45e+05 mm; allowed: 136 to 425 mm for a height of 1.70 m; is the file's unit"),
        ("child", "distance between the ASIS: found 245 mm; allowed: 56 to 175 mm"),
        ("sides", "are the sides exchanged?"),
        ("medial", "landmark knee_lat_r: the lateral marker lies on the medial side of knee_med_r"),
        ("sacrum in front", "the pelvis is upside down"),
    ],
)
def test_faults_are_told_in_one_line(change: str, message: str) -> None:
    static, subject = spoiled(change)
    with pytest.raises(InputError) as caught:
        nominal_model(static, load_marker_set("published"), subject)
    assert message in str(caught.value)
    assert str(caught.value).startswith("made up: ")
    assert "\n" not in str(caught.value)


def test_a_thigh_without_markers_is_refused(data_dir: Path) -> None:
    # the landmark itself must be there: the knee marker is seen, and has no weight
    person = PEOPLE["plug-in-gait"]
    with pytest.raises(InputError, match="segment thigh_l: found 0 markers with weight, 'LTHI' not seen"):
        nominal_model(without(person.static(data_dir), "LTHI"), person.markers, person.subject, weights={"LKNE": 0})


def test_a_thigh_of_one_marker_is_placed_and_the_other_is_said_to_be_left_out(data_dir: Path) -> None:
    person = PEOPLE["plug-in-gait"]
    model = nominal_model(without(person.static(data_dir), "LTHI"), person.markers, person.subject)
    assert "LTHI" not in model.markers.labels
    assert any("left out" in note and "LTHI" in note for note in model.notes)
