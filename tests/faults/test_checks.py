"""Each check finds the fault it is about, tells it with numbers, and says nothing about a sound study."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code, Finding, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import (
    CORNERS,
    Change,
    aslant,
    backwards,
    clipped,
    elsewhere,
    findings,
    gone,
    half,
    held,
    later,
    lying,
    mirrored,
    moved,
    offset,
    plate,
    pulling,
    put,
    put_into,
    relabelled,
    scaled,
    slower,
    spiked,
    sunk,
    swapped,
    taken,
    torn,
    with_trial,
)

ERROR, WARNING, INFO = Severity.ERROR, Severity.WARNING, Severity.INFO


def test_sound_study_has_only_facts(sound: Study) -> None:
    assert [f for f in check_study(sound) if f.severity is not INFO] == []


ASIS = "R.ASIS"
CASES: dict[str, tuple[str, Change, str, Severity, tuple[str, ...]]] = {
    "static in mm": ("static", scaled(1000.0), "units", ERROR, ("markers span", "m; allowed")),
    "walk in mm": ("walk", scaled(1000.0), "units", ERROR, ("markers span",)),
    "walk in cm": ("walk", scaled(100.0), "units", ERROR, ("markers span",)),
    "lengths 30 % larger": ("walk", scaled(1.3), "units", ERROR, ("1.3 times",)),
    "lengths 6 % larger": ("walk", scaled(1.06), "units", WARNING, ("1.06 times",)),
    "spelt otherwise": (
        "walk",
        relabelled("R.Thigh.Front", "RThighFront"),
        "labels",
        WARNING,
        ("R.Thigh.Front", "RThighFront"),
    ),
    "pelvis not labelled": ("walk", relabelled("V.Sacral", "x"), "labels", ERROR, ("found 2 markers of the pelvis",)),
    "never seen": ("walk", gone(slice(None)), "labels", WARNING, ("R.Thigh.Front", "0 of 208 frames")),
    "landmark not labelled": (
        "static",
        relabelled("V.Sacral", "Sacrum"),
        "static trial",
        ERROR,
        ("sacrum", "V.Sacral", "no other trial gives it back"),
    ),
    "landmark rebuilt": (
        "static",
        relabelled("R.Heel", "Heel"),
        "lost markers",
        WARNING,
        ("heel_r", '"Heel" = "R.Heel"'),
    ),
    "one trajectory, two labels": (
        "walk",
        put_into("R.Thigh.Rear", "R.Thigh.Front"),
        "labels",
        ERROR,
        ("'R.Thigh.Front' and 'R.Thigh.Rear'",),
    ),
    "label twice": ("walk", relabelled("R.Bicep", "R.ASIS#2"), "labels", WARNING, ("R.ASIS",)),
    "unknown label": ("walk", relabelled("R.Temple", "Wand1"), "labels", INFO, ("Wand1",)),
    "seldom seen": ("walk", gone(slice(60, None)), "gaps", WARNING, ("R.Thigh.Front 29 %",)),
    "long gap": ("walk", gone(slice(60, 120)), "gaps", INFO, ("R.Thigh.Front 0.30 s",)),
    "pelvis lost": (
        "walk",
        moved(ASIS, lambda x: put(x, slice(20, 62), np.nan)),
        "gaps",
        INFO,
        ("20 %", "0.10-0.30 s"),
    ),
    "frozen": ("walk", moved("R.Thigh.Front", held), "frozen", WARNING, ("R.Thigh.Front", "0.30-0.49 s")),
    "flat": (
        "walk",
        moved("R.Thigh.Front", lambda x: put(x, (slice(None), 2), 0.1)),
        "frozen",
        WARNING,
        ("R.Thigh.Front",),
    ),
    "spikes": ("walk", moved("R.Thigh.Front", spiked), "jumps", INFO, ("left out: R.Thigh.Front (3 frames)", "100 mm")),
    "exchanged a while": (
        "walk",
        swapped("R.Thigh.Front", "R.Thigh.Rear", slice(50, 90)),
        "exchanged",
        ERROR,
        ("R.Thigh.Front", "R.Thigh.Rear", "40 frames", "0.25-0.45 s"),
    ),
    "in another's place": (
        "walk",
        taken("R.Thigh.Rear", "R.Shank.Front", slice(50, 90)),
        "exchanged",
        ERROR,
        ("'R.Thigh.Rear' and 'R.Shank.Front' are confused", "40 frames"),
    ),
    "exchanged across": (
        "walk",
        swapped("R.Shank.Rear", "L.Shank.Rear", slice(50, 90)),
        "exchanged",
        ERROR,
        ("R.Shank.Rear", "L.Shank.Rear"),
    ),
    "exchanged for good": ("walk", swapped("R.Thigh.Front", "R.Shank.Front"), "exchanged", ERROR, ("208 frames",)),
    "sides exchanged": ("walk", mirrored, "sides", ERROR, ("R.Thigh.Upper", "mm")),
    "sides exchanged, standing": (
        "static",
        mirrored,
        "landmarks",
        ERROR,
        ("'R.Knee.Lat' and 'L.Knee.Lat'", "each other's"),
    ),
    "one pair of sides": (
        "walk",
        swapped("R.Shank.Front", "L.Shank.Front"),
        "sides",
        ERROR,
        ("R.Shank.Front", "L.Shank.Front"),
    ),
    "lying": ("walk", lying, "axes", ERROR, ("deg",)),
    "walking backwards": ("walk", backwards, "heading", WARNING, ("180 deg",)),
    "never still": (
        "static",
        lambda r: replace(r, markers=r.markers + 0.3 * r.time[:, None, None]),
        "static trial",
        ERROR,
        ("still window", "m/s"),
    ),
    "restless": (
        "static",
        lambda r: replace(r, markers=r.markers + 0.03 * r.time[:, None, None] * [1.0, 0.0, 0.0]),
        "still window",
        WARNING,
        ("30 mm/s RMS and stray by 4.3 mm RMS", "most people stand within 10 mm/s"),
    ),
    "frames as seconds": ("walk", slower, "time", ERROR, ("1 Hz",)),
    "uneven steps": ("walk", torn, "time", WARNING, ("1 time steps", "205 ms")),
    "forces late": ("walk", later(0.15), "time", WARNING, ("s later by force",)),
    "too few frames": (
        "knee_r",
        lambda r: replace(r, time=r.time[:9], markers=r.markers[:9]),
        "sampling",
        ERROR,
        ("9 frames", "12"),
    ),
    "saturated": ("walk", plate(1, clipped), "plates", WARNING, ("600 N", "saturated")),
    "offset": ("walk", plate(1, offset), "plates", WARNING, ("reads 25 N",)),
    "pulling": ("walk", plate(1, pulling), "plates", WARNING, ("pulls",)),
    "aslant": ("walk", plate(1, aslant), "plates", WARNING, ("horizontal",)),
    "sunk": ("walk", plate(1, sunk), "plates", WARNING, ("below",)),
    "off its plate": (
        "walk",
        plate(1, lambda p: replace(p, corners=CORNERS + [30.0, 0, 0])),
        "plates",
        WARNING,
        ("outside its corners",),
    ),
    "half the force": ("walk", lambda r: plate(2, half)(plate(1, half)(r)), "body mass", WARNING, ("body weights",)),
    "under no foot": ("walk", plate(1, elsewhere), "plate to foot", WARNING, ("centre of pressure", "mm")),
    "plate told in words": (
        "walk",
        lambda r: r.with_notes("Plate 3 left out: its type is 7."),
        "plates",
        WARNING,
        ("type is 7",),
    ),
}
"""What is done to which trial, and what the finding is: topic, severity, words."""


@pytest.mark.parametrize("case", CASES)
def test_fault_is_found(case: str, sound: Study) -> None:
    trial, change, topic, severity, words = CASES[case]
    spoilt = with_trial(sound, trial, change)
    found = findings(spoilt, topic, severity)
    assert found, [f.line for f in check_study(spoilt)]
    text = " | ".join(f"{f.evidence} {f.cure}" for f in found)
    for word in words:
        assert word in text


def test_an_empty_column_is_no_more_than_an_absent_label(sound: Study) -> None:
    """A template of labels names markers that nobody wore: only what loses all its markers is an error."""

    def findings_without(*starts: str) -> list[Severity]:
        def emptied(r: Recording) -> Recording:
            columns = [k for k, label in enumerate(r.labels) if label.startswith(starts)]
            return replace(r, markers=put(r.markers.copy(), (slice(None), columns), np.nan))

        spoilt = with_trial(sound, "walk", emptied)
        return [f.severity for f in check_study(spoilt) if "never seen" in f.found]

    assert findings_without("R.Temple", "R.Heel") == [INFO]
    assert findings_without("L.Shank.Front", "L.Shank.Rear") == [WARNING]
    assert findings_without("L.Shank", "L.Ankle") == [ERROR]


@pytest.mark.parametrize(("frames", "step"), [(2, 0.005), (15, 0.005)])
def test_static_trial_too_short_to_be_still(sound: Study, frames: int, step: float) -> None:
    def cut(r: Recording) -> Recording:
        return replace(r, time=step * np.arange(frames), markers=r.markers[:frames])

    spoilt = with_trial(sound, "static", cut)
    (found,) = findings(spoilt, "still window", WARNING)
    assert f"{frames} frames over" in found.found and "at least 3 frames over 0.1 s" in found.found
    assert not [f for f in check_study(spoilt) if f.severity is ERROR]


@pytest.mark.parametrize(("label", "severity"), [("R.Toe.Tip", INFO), ("R.Thigh.Front", WARNING)])
def test_a_marker_that_others_replace_may_be_lost(sound: Study, label: str, severity: Severity) -> None:
    lost = with_trial(sound, "walk", moved(label, lambda x: put(x, slice(60, None), np.nan)))
    assert [f.severity for f in findings(lost, "gaps")] == [severity]


def test_a_static_trial_of_one_frame_is_a_posture(sound: Study) -> None:
    """Nothing blurs a moment; that nobody can see stillness in it is a note."""
    cut = with_trial(sound, "static", lambda r: replace(r, time=r.time[:1], markers=r.markers[:1]))
    (found,) = findings(cut, "still window")
    assert found.severity is INFO and "one frame" in found.found
    assert [f for f in check_study(cut) if f.severity is not INFO] == []


def test_feet_that_do_not_stand_as_the_file_says_are_told_unless_the_study_decides(sound: Study) -> None:
    def forefeet(r: Recording) -> Recording:
        return replace(r, facts=replace(r.facts, static_plantarflexion={"r": -0.15, "l": -0.15}))

    spoilt = with_trial(sound, "static", forefeet)
    (found,) = findings(spoilt, "posture", WARNING)
    assert "right foot: the file's" in found.found and "more plantarflexed" in found.found and not found.leg
    decided = spoilt.settings.model_copy(update={"ankle_zero": "sole"})
    assert not findings(replace(spoilt, settings=decided), "posture")


def test_one_recording_as_two_trials(sound: Study) -> None:
    walk = next(t for t in sound.trials if t.name == "walk")
    again = replace(walk, name="walk2", recording=replace(walk.recording, source="copy.csv", plates=()))
    (found,) = findings(replace(sound, trials=(*sound.trials, again)), "trials", ERROR)
    assert found.where == "walk2" and "same 208 frames as trial 'walk'" in found.found
    part = replace(again.recording, time=walk.recording.time[10:], markers=walk.recording.markers[10:])
    assert findings(replace(sound, trials=(*sound.trials, replace(again, recording=part))), "trials") == []


def test_a_segment_held_still_by_its_maker_is_not_frozen(sound: Study) -> None:
    """As the synthetic isolated trials hold a segment: one coordinate without a change, the others by rounding."""
    rounding = 1e-8 * np.arange(1200)[:, None] * [0.0, 1.0, 1.0]
    assert findings(with_trial(sound, "knee_r", moved("R.Thigh.Rear", lambda x: x[:1] + rounding)), "frozen") == []
    moving = np.column_stack([np.zeros(1200), np.linspace(0.0, 0.2, 1200), np.zeros(1200)])
    (found,) = findings(with_trial(sound, "knee_r", moved("R.Thigh.Rear", lambda x: x[:1] + moving)), "frozen", WARNING)
    assert "one coordinate never changes: R.Thigh.Rear" in found.found


@pytest.mark.parametrize(
    "spoil",
    [
        moved("L.Toe.Tip", lambda x: x + [0.0, 0.06, 0.0]),
        swapped("L.Shank.Upper", "L.Shank.Front"),
        moved("L.Thigh.Front", lambda x: put(x, slice(70, None), np.nan)),
        moved("L.Heel", spiked),
        moved("L.Thigh.Front", held),
        moved("R.ASIS", lambda x: put(x, slice(70, None), np.nan)),
    ],
)
def test_an_isolated_trial_answers_for_its_joint_alone(sound: Study, spoil: Change) -> None:
    """The joint is fitted by thigh and shank: what is wrong elsewhere spoils nothing; in the walk it does."""
    assert [f.line for f in check_study(with_trial(sound, "knee_r", spoil)) if f.severity is not INFO] == []
    notes = {f.line for f in check_study(sound)}
    assert [f for f in check_study(with_trial(sound, "walk", spoil)) if f.line not in notes]


def test_height_against_legs(sound: Study) -> None:
    assert findings(sound, "height") == []
    taller = replace(sound, subject=replace(sound.subject, height=2.05))
    assert "2.05 m" in findings(taller, "height", WARNING)[0].found


@pytest.mark.parametrize(
    "field, value, severity, words",
    [
        ("force_filter_hz", 150.0, ERROR, "half of that, 100 Hz"),
        ("bandwidth_hz", 3.0, WARNING, "pass 2.6 Hz"),
        ("nodes", 400, ERROR, "400 for 208 frames"),
        ("nodes", 7, WARNING, "pass 0.9 Hz"),
    ],
)
def test_cut_offs(sound: Study, field: str, value: float, severity: Severity, words: str) -> None:
    study = replace(sound, settings=sound.settings.model_copy(update={field: value}))
    found = findings(study, "sampling", severity)
    assert any(words in f"{f.found} {f.cure}" for f in found), found


def test_line_names_file_trial_and_cure() -> None:
    finding = Finding(
        code=Code.UNIT_OF_LENGTH,
        severity=ERROR,
        topic="units",
        where="walk",
        found="found 1800 m",
        cure="declare mm",
        source="walk.csv",
    )
    assert finding.line == "walk.csv: trial 'walk': units: found 1800 m; declare mm"


def test_time_column_against_header(tmp_path: Path, sound: Study) -> None:
    path = tmp_path / "walk.trc"
    header = "DataRate\tCameraRate\tNumFrames\n{}\t{}\t208\n"
    for rates, count in (((200, 200), 0), ((50, 200), 0), ((200, 100), 1), ((50, 100), 1)):
        path.write_text("PathFileType\t4\n" + header.format(*rates), encoding="utf-8")
        found = findings(with_trial(sound, "walk", lambda r: replace(r, source=str(path))), "time", WARNING)
        assert len(found) == count, rates


@pytest.mark.parametrize(("factor", "severity"), [(2.0, INFO), (0.25, WARNING)])
def test_a_trial_of_another_frame_rate(sound: Study, factor: float, severity: Severity) -> None:
    study = with_trial(sound, "knee_r", lambda r: replace(r, time=r.time / factor))
    (told,) = [f for f in check_study(study) if "different frame rates" in f.cause]
    assert told.severity is severity and "knee_r" in told.found
