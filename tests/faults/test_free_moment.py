"""The sign of the free moment: how walking people hold their feet against turning."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.codes import Code
from gaitcal.faults.study import check_study
from gaitcal.findings import Finding
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import Change, sound_study, with_trial
from tests.real_studies import write_study

REAL = {"subject01": "walk", "pig_c3d": "gait"}
"""Study -> its walk over plates."""


def times(factor: float) -> Change:
    """Free moments times a factor."""

    def spoil(recording: Recording) -> Recording:
        return replace(recording, plates=tuple(replace(p, moment=factor * p.moment) for p in recording.plates))

    return spoil


def backwards(recording: Recording) -> Recording:
    """From the end to the beginning: a body that walks backwards, and turns its feet the other way."""
    plates = tuple(
        replace(p, force=p.force[::-1], point=p.point[::-1], moment=p.moment[::-1]) for p in recording.plates
    )
    return replace(recording, markers=recording.markers[::-1].copy(), plates=plates)


def found(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.code is Code.FREE_MOMENT]


def test_a_wrong_sign_is_told_and_a_wrong_size_is_not_taken_for_one() -> None:
    sound = sound_study()
    [told] = found(with_trial(sound, "walk", times(-1.0)))
    assert told.cause == "the free moment of all plates has the wrong sign"
    assert "whole steps" in told.found
    assert found(with_trial(sound, "walk", times(0.1))) == []
    assert found(with_trial(sound, "walk", times(-0.1))) == [], "too small to tell, and to matter"


def test_backwards_and_with_another_sign_wrong_nothing_is_said() -> None:
    """Both turn the moment round, or may: the cause is told elsewhere."""
    sound = sound_study()
    assert found(with_trial(sound, "walk", backwards)) == []

    def pushing_outwards(recording: Recording) -> Recording:
        return replace(recording, plates=tuple(replace(p, force=p.force * [-1, 1, -1]) for p in recording.plates))

    spoilt = with_trial(with_trial(sound, "walk", times(-1.0)), "walk", pushing_outwards)
    assert found(spoilt) == []
    assert any(f.code is Code.FORCE_SIGN for f in check_study(spoilt))


@pytest.mark.parametrize("name", REAL)
def test_real_people_have_the_usual_sign(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    assert found(study) == []
    assert len(found(with_trial(study, REAL[name], times(-1.0)))) == 1
