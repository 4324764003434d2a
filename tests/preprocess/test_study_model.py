"""A trunk that only the walks show: its markers go where the static trial would have had them."""

from collections.abc import Callable

import numpy as np
import pytest

from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.study import Study
from tests.messages import check_text
from tests.quality.spoilt import with_trial, without

THORAX = ("C7", "T10", "CLAV", "STRN", "RSHO", "LSHO", "RBAK")
POSTURE_MM = 25.0
"""How far trunk markers are elsewhere in walking than in standing, in the mean; 18 mm on this
person.
"""


@pytest.fixture(scope="module")
def study(real_study: Callable[[str], Study]) -> Study:
    return real_study("pig_c3d")


def test_walks_place_the_trunk_that_the_static_trial_lacks(study: Study) -> None:
    whole, borrowed = (
        build_nominal_model(study),
        build_nominal_model(with_trial(study, "static", without(*THORAX))),
    )
    assert not any("placed by the walks" in note for note in whole.notes)
    assert not any(name.startswith("lumbar") for name in borrowed.frozen)
    check_text(borrowed.notes, "C7, T10, CLAV, STRN, RSHO, LSHO")
    place = [dict(zip(m.markers.labels, m.markers.local, strict=True)) for m in (whole, borrowed)]
    for label in ("C7", "CLAV", "STRN", "T10"):
        assert 1e3 * np.linalg.norm(place[1][label] - place[0][label]) < POSTURE_MM, label
    for label in ("RASI", "LKNE", "RTOE"):
        np.testing.assert_array_equal(place[1][label], place[0][label])


def test_one_marker_in_walks_is_placed_too(study: Study) -> None:
    head = ("LFHD", "RFHD", "LBHD", "RBHD")
    fewer = with_trial(study, "static", without(*THORAX, *head))
    model = build_nominal_model(with_trial(fewer, "gait", without(*THORAX[1:], *head)))
    assert [
        m
        for m, s in zip(model.markers.labels, model.markers.segments, strict=True)
        if s == "head_trunk"
    ] == ["C7"]
    check_text(model.notes, "C7")
