"""What the labels of a file give of a marker set."""

from __future__ import annotations

import pytest

from gaitcal.model.marker_set import REQUIRED, built_in_sets, load_marker_set


@pytest.mark.parametrize("name", built_in_sets())
def test_a_set_covers_its_own_labels_best_of_all(name: str) -> None:
    made = load_marker_set(name)
    labels = [label for group in (*made.tracking.values(), *made.landmarks.values()) for label in group]
    found = made.coverage(dict.fromkeys(labels))
    assert found.complete and not found.unknown
    assert found.score == 2.0
    for other in built_in_sets():
        assert load_marker_set(other).coverage(labels).score <= found.score


def test_what_is_missing_and_left_over_is_named() -> None:
    made = load_marker_set("gait2354")
    labels = [label for label in made.labels if label not in ("V.Sacral", "L.Heel", "R.ASIS")]
    found = made.coverage([*labels, "Stranger"])
    assert found.required_missing == ("sacrum", "asis_r")  # a heel alone may be missed, not both ends of a foot
    assert found.bare == ("pelvis",)
    assert found.unknown == ("Stranger",)
    assert not found.complete
    assert found.score < 1 < made.coverage([*labels, "V.Sacral", "R.ASIS", "Stranger"]).score


def test_no_labels_cover_nothing() -> None:
    found = load_marker_set("gait2354").coverage([])
    assert found.score == 0 and not found.tracked and set(found.required_missing) == set(REQUIRED)
