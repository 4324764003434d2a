"""Vertical axis, right and left, the moving joint, and whether further static trials agree."""

from dataclasses import replace

import pytest
from scipy.spatial.transform import Rotation

from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.recording import Recording
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from tests.messages import check_finding
from tests.quality.spoilt import (
    Change,
    backwards,
    findings,
    lying,
    moved,
    recording_of,
    serious,
    with_trial,
)


def sides_exchanged(r: Recording, pelvis: bool = True) -> Recording:
    def other(label: str) -> str:
        kept = label[:2] not in ("R.", "L.") or (not pelvis and "ASIS" in label)
        return label if kept else label[0].translate(str.maketrans("RL", "LR")) + label[1:]

    return replace(r, labels=tuple(other(label) for label in r.labels))


CASES: dict[str, tuple[Change, str]] = {
    "all labels": (sides_exchanged, "right and left"),
    "labels of the legs": (lambda r: sides_exchanged(r, pelvis=False), ""),
    "z mirrored": (lambda r: replace(r, markers=r.markers * [1.0, 1.0, -1.0]), "axis is mirrored"),
    "y down": (lambda r: replace(r, markers=r.markers * [1.0, -1.0, -1.0]), "points down"),
    "y mirrored": (lambda r: replace(r, markers=r.markers * [1.0, -1.0, 1.0]), "points down"),
}


@pytest.mark.parametrize(
    ("trial", "case"),
    [("static", "all labels"), ("knee_r", "y mirrored"), *(("walk", case) for case in CASES)],
)
def test_one_error_names_the_cause_in_every_role(sound: Study, trial: str, case: str) -> None:
    change, words = CASES[case]
    (error,) = findings(
        with_trial(sound, trial, lambda r: replace(change(r), plates=())), severity=Severity.ERROR
    )
    assert error.where == trial and words in error.cause


def test_lying_is_no_fault_of_a_functional_trial(sound: Study) -> None:
    assert findings(with_trial(sound, "knee_r", lying), severity=Severity.ERROR) == []


def on_the_spot(r: Recording) -> Recording:
    """As on a belt."""
    return replace(
        r, markers=r.markers - r.markers.mean(axis=1, keepdims=True) * [1, 0, 1], plates=()
    )


def test_walk_declared_as_functional_trial(sound: Study) -> None:
    walk = recording_of(sound)
    for recording, goes in ((walk, True), (on_the_spot(walk), False)):
        (found,) = findings(with_trial(sound, "knee_r", lambda _, walk=recording: walk), "role")  # type: ignore[misc]
        check_finding(found, Code.LOOKS_LIKE_WALK, "knee_r")
        assert ("pelvis" in found.found) == goes


def test_walking_direction_on_a_belt_is_that_of_the_feet(sound: Study) -> None:
    """A belt under the same walk; then the same with its frames in reverse."""

    def heading(change: Change) -> list[Severity]:
        found = findings(with_trial(sound, "walk", change), "heading")
        return sorted((f.severity for f in found), key=lambda s: s.rank)

    assert heading(on_the_spot) == [Severity.INFO]
    assert heading(lambda r: on_the_spot(backwards(r))) == [Severity.WARNING, Severity.INFO]


def with_second(study: Study, change: Change) -> Study:
    """The study with its static trial added at another position, rotated and changed."""
    turn = Rotation.from_euler("y", 130.0, degrees=True).as_matrix()
    again = change(study.static.recording)
    again = replace(again, source="again.csv", markers=again.markers @ turn.T + [1.0, 0.0, -2.0])
    return replace(
        study, trials=(*study.trials, replace(study.static, name="standing2", recording=again))
    )


def report_contradictions(study: Study) -> list[Finding]:
    return [f for f in serious(study) if f.where == "standing2"]


def test_same_body_at_another_position_agrees(sound: Study) -> None:
    two = with_second(sound, lambda r: r)
    assert report_contradictions(two) == []
    assert any(
        f.code is Code.STATICS_DISAGREE and "static" in f.found
        for f in check_study(two)
        if f.where == "standing2"
    )


@pytest.mark.parametrize(
    ("label", "shift", "severity"),
    [
        ("R.Midfoot.Lat", 0.015, Severity.WARNING),
        ("L.Toe.Lat", 0.015, Severity.WARNING),
        ("R.Knee.Med", 0.030, Severity.ERROR),
    ],
)
def test_a_marker_that_moved_between_two_static_trials_is_named(
    sound: Study, label: str, shift: float, severity: Severity
) -> None:
    (found,) = [
        f
        for f in report_contradictions(
            with_second(sound, moved(label, lambda x: x + [0.0, 0.0, shift]))
        )
        if "body" in f.cause
    ]
    assert found.severity is severity
    assert found.found.split("'")[1] == label
    assert abs(float(found.found.split("' ")[1].split(" mm")[0]) - 1e3 * shift) < 3.0
