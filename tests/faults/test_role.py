"""Which way is up, which side is right, which joint moves, and whether further static trials show the same body."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.errors import Finding, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import Change, moved, with_trial


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
    ("trial", "case"), [("static", "all labels"), ("knee_r", "y mirrored"), *(("walk", case) for case in CASES)]
)
def test_one_error_names_the_cause_in_every_role(sound: Study, trial: str, case: str) -> None:
    change, words = CASES[case]
    spoilt = with_trial(sound, trial, lambda r: replace(change(r), plates=()))
    errors = [f for f in check_study(spoilt) if f.severity is Severity.ERROR]
    assert [f.where for f in errors] == [trial], [f.line for f in errors]
    assert words in errors[0].cause


def test_lying_on_a_bench_is_no_fault_of_an_isolated_trial(sound: Study) -> None:
    lying = with_trial(sound, "knee_r", lambda r: replace(r, markers=r.markers[:, :, [1, 0, 2]] * [1.0, -1.0, 1.0]))
    assert [f.line for f in check_study(lying) if f.severity is Severity.ERROR] == []


def test_a_walk_that_is_declared_for_one_joint(sound: Study) -> None:
    walk = next(t.recording for t in sound.trials if t.name == "walk")
    found = [f for f in check_study(with_trial(sound, "knee_r", lambda _: walk)) if f.topic == "role"]
    assert [f.cause for f in found] == ["the trial is declared for knee_r alone, but this looks like a walk"]
    assert "the pelvis goes" in found[0].found and "of the other leg turn by" in found[0].found
    on_the_spot = replace(walk, markers=walk.markers - walk.markers[:, :, :].mean(axis=1, keepdims=True) * [1, 0, 1])
    (still,) = [f for f in check_study(with_trial(sound, "knee_r", lambda _: on_the_spot)) if f.topic == "role"]
    assert "the pelvis goes" not in still.found and "of the other leg turn by" in still.found


def test_on_a_belt_a_person_goes_where_the_feet_go(sound: Study) -> None:
    """A belt under the same walk; then the same with its frames in reverse."""

    def on_a_belt(r: Recording) -> Recording:
        return replace(r, markers=r.markers - r.markers.mean(axis=1, keepdims=True) * [1, 0, 1], plates=())

    def heading(change: Change) -> list[Severity]:
        return [f.severity for f in check_study(with_trial(sound, "walk", change)) if f.topic == "heading"]

    assert heading(on_a_belt) == [Severity.INFO]
    backwards = heading(lambda r: replace(on_a_belt(r), markers=on_a_belt(r).markers[::-1]))
    assert sorted(backwards, key=lambda s: s.rank) == [Severity.WARNING, Severity.INFO]


def with_second(study: Study, change: Change) -> Study:
    """The study with its static trial given again, elsewhere in the room, turned, and changed."""
    angle = np.deg2rad(130.0)
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])

    def again(r: Recording) -> Recording:
        return replace(change(r), source="again.csv", markers=change(r).markers @ turn.T + [1.0, 0.0, -2.0])

    second = replace(study.static, name="standing2", recording=again(study.static.recording))
    return replace(study, trials=(*study.trials, second))


def told(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.where == "standing2" and f.severity is not Severity.INFO]


def test_the_same_body_standing_elsewhere_agrees(sound: Study) -> None:
    two = with_second(sound, lambda r: r)
    assert told(two) == []
    assert any("agrees with 'static'" in f.found for f in check_study(two) if f.where == "standing2")


@pytest.mark.parametrize(
    ("label", "severity"), [("R.Midfoot.Lat", Severity.WARNING), ("L.Toe.Lat", Severity.WARNING), ("R.Knee.Med", None)]
)
def test_a_marker_that_moved_between_two_static_trials_is_named(
    sound: Study, label: str, severity: Severity | None
) -> None:
    shift = 0.015 if severity else 0.030
    (found,) = [f for f in told(with_second(sound, moved(label, lambda x: x + [0.0, 0.0, shift]))) if "body" in f.cause]
    assert found.severity is (severity or Severity.ERROR)
    assert found.found.split("'")[1] == label
    assert abs(float(found.found.split("' ")[1].split(" mm")[0]) - 1e3 * shift) < 3.0
