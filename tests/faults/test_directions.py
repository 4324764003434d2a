"""Which way is up and which side is right, told in every role by one finding."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gaitcal.faults.study import check_study
from gaitcal.findings import Severity
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import Change, sound_study, with_trial


@pytest.fixture(scope="module")
def sound() -> Study:
    return sound_study()


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


@pytest.mark.parametrize("trial", ["static", "walk", "knee_r"])
@pytest.mark.parametrize("case", CASES)
def test_one_error_names_the_cause_in_every_role(sound: Study, trial: str, case: str) -> None:
    change, words = CASES[case]
    spoilt = with_trial(sound, trial, lambda r: replace(change(r), plates=()))
    errors = [f for f in check_study(spoilt) if f.severity is Severity.ERROR]
    assert [f.where for f in errors] == [trial], [f.line for f in errors]
    assert words in errors[0].cause


def test_lying_on_a_bench_is_no_fault_of_an_isolated_trial(sound: Study) -> None:
    lying = with_trial(sound, "knee_r", lambda r: replace(r, markers=r.markers[:, :, [1, 0, 2]] * [1.0, -1.0, 1.0]))
    assert [f.line for f in check_study(lying) if f.severity is Severity.ERROR] == []
