"""Each check finds the fault it is about, tells it with numbers, and says nothing about a sound
study.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Finding, Severity
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from tests.quality.spoilt import (
    CORNERS,
    Array,
    Change,
    backwards,
    findings,
    gone,
    held,
    lying,
    mirrored,
    moved,
    plates,
    put,
    put_into,
    recording_of,
    relabelled,
    scaled,
    serious,
    spiked,
    swapped,
    taken,
    times,
    with_trial,
)

ERROR, WARNING, INFO = Severity.ERROR, Severity.WARNING, Severity.INFO


def test_sound_study_has_only_facts(sound: Study) -> None:
    assert serious(sound) == []


@dataclass(frozen=True)
class Case:
    """A fault of one trial, and the finding that it is: severity, topic, words."""

    severity: Severity
    topic: str
    change: Change
    words: tuple[str, ...]
    trial: str
    serious: set[str]
    """Topics of all that is told beside notes."""


def case(
    severity: Severity,
    topic: str,
    change: Change,
    *words: str,
    trial: str = "walk",
    others: Sequence[str] = (),
) -> Case:
    return Case(
        severity,
        topic,
        change,
        words,
        trial,
        {*others} | ({topic} if severity is not INFO else set()),
    )


def cut(frames: int, step: float = 0.005) -> Change:
    return lambda r: replace(r, time=step * np.arange(frames), markers=r.markers[:frames])


def drifting(*velocity: float) -> Change:
    return lambda r: replace(r, markers=r.markers + r.time[:, None, None] * velocity)


def of_plate_1(change: Callable[[ForcePlate], Array]) -> Change:
    """Another force (m, 3) N of plate 1."""
    return plates(lambda p: replace(p, force=change(p)), 1)


def later(p: ForcePlate, seconds: float = 0.15) -> ForcePlate:
    """The plate's signal later on the same clock."""
    shift = round(seconds / float(p.time[1] - p.time[0]))
    return replace(
        p, **{name: np.roll(getattr(p, name), shift, 0) for name in ("force", "point", "moment")}
    )


def faster(factor: float) -> Change:
    return lambda r: replace(r, time=r.time / factor)


def torn(recording: Recording) -> Recording:
    return replace(
        recording, time=recording.time + np.where(recording.time > 0.5, 0.2, 0.0), plates=()
    )


FRONT, REAR, SHANK, LEFT_SHANK = "R.Thigh.Front", "R.Thigh.Rear", "R.Shank.Front", "L.Shank.Front"
WHILE = slice(50, 90)


CASES = {
    "static in mm": case(
        ERROR, "units", scaled(1000.0), "markers span", "m; allowed", trial="static"
    ),
    "walk in mm": case(ERROR, "units", scaled(1000.0), "markers span"),
    "walk in cm": case(ERROR, "units", scaled(100.0), "markers span"),
    "lengths 30 % larger": case(ERROR, "units", scaled(1.3), "1.3 times"),
    "lengths 6 % larger": case(WARNING, "units", scaled(1.06), "1.06 times", others=["body size"]),
    "spelt otherwise": case(
        WARNING, "labels", relabelled(FRONT, "RThighFront"), FRONT, "RThighFront"
    ),
    "pelvis not labelled": case(
        ERROR, "labels", relabelled("V.Sacral", "x"), "found 2 markers of the pelvis"
    ),
    "never seen": case(WARNING, "labels", gone(slice(None)), FRONT, "0 of 208 frames"),
    "landmark not labelled": case(
        ERROR,
        "static trial",
        relabelled("V.Sacral", "Sacrum"),
        "V.Sacral",
        "no other trial gives",
        trial="static",
    ),
    "landmark rebuilt": case(
        WARNING,
        "lost markers",
        relabelled("R.Heel", "Heel"),
        "heel_r",
        '"Heel" = "R.Heel"',
        trial="static",
    ),
    "one trajectory, two labels": case(
        ERROR, "labels", put_into(REAR, FRONT), f"'{FRONT}' and '{REAR}'"
    ),
    "label twice": case(WARNING, "labels", relabelled("R.Bicep", "R.ASIS#2"), "R.ASIS"),
    "unknown label": case(INFO, "labels", relabelled("R.Temple", "Wand1"), "Wand1"),
    "seldom seen": case(WARNING, "gaps", gone(slice(60, None)), f"{FRONT} 29 %"),
    "seldom seen, but others are": case(
        INFO, "gaps", gone(slice(60, None), "R.Toe.Tip"), "R.Toe.Tip 29 %"
    ),
    "long gap": case(INFO, "gaps", gone(slice(60, 120)), f"{FRONT} 0.30 s"),
    "pelvis lost": case(INFO, "gaps", gone(slice(20, 62), "R.ASIS"), "20 %", "0.10-0.30 s"),
    "frozen": case(
        WARNING, "frozen", moved(FRONT, held), "0.30-0.49 s", others=["left its place", "jumps"]
    ),
    "flat": case(WARNING, "frozen", moved(FRONT, lambda x: put(x, (slice(None), 2), 0.1)), FRONT),
    "spikes": case(INFO, "jumps", moved(FRONT, spiked), f"left out: {FRONT} (3 frames)", "100 mm"),
    "exchanged a while": case(
        INFO,
        "exchanged",
        swapped(FRONT, REAR, WHILE),
        FRONT,
        REAR,
        "40 frames",
        "0.25-0.45 s",
        "exchanged back",
    ),
    "in another's place": case(
        ERROR, "exchanged", taken(REAR, SHANK, WHILE), f"'{REAR}' and '{SHANK}' are confused"
    ),
    "exchanged across": case(
        INFO,
        "exchanged",
        swapped(SHANK, LEFT_SHANK, WHILE),
        SHANK,
        LEFT_SHANK,
        "40 frames",
        "exchanged back",
    ),
    "exchanged for good": case(ERROR, "exchanged", swapped(FRONT, SHANK), "208 frames"),
    "sides exchanged": case(ERROR, "sides", mirrored, "R.Thigh.Upper", "mm", others=["forces"]),
    "sides exchanged, standing": case(
        ERROR,
        "landmarks",
        mirrored,
        "'R.Knee.Lat' and 'L.Knee.Lat'",
        "each other's",
        trial="static",
    ),
    "one pair of sides": case(ERROR, "sides", swapped(SHANK, LEFT_SHANK), SHANK, LEFT_SHANK),
    "lying": case(ERROR, "axes", lying, "deg"),
    "walking backwards": case(INFO, "heading", backwards, "180 deg", "walks backwards"),
    "never still": case(
        ERROR, "static trial", drifting(0.3, 0.3, 0.3), "still window", "m/s", trial="static"
    ),
    "restless": case(
        WARNING,
        "still window",
        drifting(0.03, 0, 0),
        "30 mm/s RMS",
        "4.3 mm RMS",
        "within 10 mm/s",
        trial="static",
    ),
    "2 frames standing": case(
        WARNING,
        "still window",
        cut(2),
        "2 frames over",
        "at least 3 frames over 0.1 s",
        trial="static",
    ),
    "15 frames standing": case(WARNING, "still window", cut(15), "15 frames over", trial="static"),
    "a posture": case(INFO, "still window", cut(1), "one frame", trial="static"),
    "frames as seconds": case(
        ERROR, "time", faster(1 / 200), "1 Hz", others=["plate to foot", "sampling"]
    ),
    "uneven steps": case(WARNING, "time", torn, "1 time steps", "205 ms"),
    "forces late": case(
        WARNING, "time", plates(later), "s later by force", others=["plate to foot"]
    ),
    "twice the rate": case(
        INFO, "sampling", faster(2.0), "knee_r", "different frame rates", trial="knee_r"
    ),
    "a quarter of the rate": case(
        WARNING, "sampling", faster(0.25), "knee_r", "frame rates", trial="knee_r"
    ),
    "too few frames": case(ERROR, "sampling", cut(9), "9 frames", "12", trial="knee_r"),
    "saturated": case(
        WARNING, "plates", of_plate_1(lambda p: np.minimum(p.force, 600.0)), "600 N", "saturated"
    ),
    "offset": case(
        WARNING, "plates", of_plate_1(lambda p: p.force + [0.0, 25.0, 0.0]), "reads 25 N"
    ),
    "pulling": case(
        WARNING,
        "plates",
        of_plate_1(lambda p: p.force * np.where(p.time > 0.4, -1.0, 1.0)[:, None]),
        "pulls",
    ),
    "aslant": case(WARNING, "plates", of_plate_1(lambda p: p.force[:, [1, 1, 2]]), "horizontal"),
    "no Fx": case(
        WARNING,
        "plates",
        of_plate_1(lambda p: p.force * [0, 1, 1]),
        "plate 1 is missing: Fx",
        others=["forces"],
    ),
    "no Fz": case(
        WARNING, "plates", of_plate_1(lambda p: p.force * [1, 1, 0]), "plate 1 is missing: Fz"
    ),
    "sunk": case(
        WARNING, "plates", plates(lambda p: replace(p, point=p.point - [0.0, 0.4, 0.0]), 1), "below"
    ),
    "off its plate": case(
        WARNING,
        "plates",
        plates(lambda p: replace(p, corners=CORNERS + [30.0, 0, 0]), 1),
        "outside its corners",
    ),
    "half the force": case(WARNING, "body mass", plates(times(0.4)), "body weights"),
    "under no foot": case(
        WARNING,
        "plate to foot",
        plates(lambda p: replace(p, point=p.point + [0, 0, 0.8]), 1),
        "centre of pressure",
    ),
    "plate told in words": case(
        WARNING, "plates", lambda r: r.with_notes("Plate 3 left out: its type is 7."), "type is 7"
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_fault_is_found_and_nothing_else(name: str, sound: Study) -> None:
    wanted = CASES[name]
    found = check_study(with_trial(sound, wanted.trial, wanted.change))
    own = [f for f in found if (f.topic, f.severity) == (wanted.topic, wanted.severity)]
    text = " | ".join(f"{f.evidence} {f.cure}" for f in own)
    assert own and all(word in text for word in wanted.words), [f.line for f in found]
    assert {f.topic for f in found if f.severity is not INFO} == wanted.serious


@pytest.mark.parametrize(
    ("starts", "severity"),
    [
        (("R.Temple", "R.Heel"), INFO),
        (("L.Shank.Front", "L.Shank.Rear"), WARNING),
        (("L.Shank", "L.Ankle"), ERROR),
    ],
)
def test_an_empty_column_is_no_more_than_an_absent_label(
    sound: Study, starts: tuple[str, ...], severity: Severity
) -> None:
    """A template of labels names markers that nobody wore: only what loses all its markers is an
    error.
    """

    def emptied(r: Recording) -> Recording:
        columns = [k for k, label in enumerate(r.labels) if label.startswith(starts)]
        return replace(r, markers=put(r.markers.copy(), (slice(None), columns), np.nan))

    found = check_study(with_trial(sound, "walk", emptied))
    assert [f.severity for f in found if "never seen" in f.found] == [severity]


def test_feet_that_do_not_stand_as_the_file_says_are_told_unless_the_study_decides(
    sound: Study,
) -> None:
    def forefeet(r: Recording) -> Recording:
        return replace(r, facts=replace(r.facts, static_plantarflexion={"r": -0.15, "l": -0.15}))

    spoilt = with_trial(sound, "static", forefeet)
    (found,) = findings(spoilt, "posture", WARNING)
    assert (
        "right foot: the file's" in found.found
        and "more plantarflexed" in found.found
        and not found.leg
    )
    decided = spoilt.settings.model_copy(update={"ankle_zero": "sole"})
    assert not findings(replace(spoilt, settings=decided), "posture")


def test_one_recording_as_two_trials(sound: Study) -> None:
    def told(recording: Recording) -> list[Finding]:
        again = replace(sound.trials[1], name="walk2", recording=recording)
        return findings(replace(sound, trials=(*sound.trials, again)), "trials")

    copy = replace(recording_of(sound), source="copy.csv", plates=())
    (found,) = told(copy)
    assert (found.severity, found.where) == (
        ERROR,
        "walk2",
    ) and "same 208 frames as trial 'walk'" in found.found
    assert told(replace(copy, time=copy.time[10:], markers=copy.markers[10:])) == []


def test_a_segment_held_still_by_its_maker_is_not_frozen(sound: Study) -> None:
    """As the synthetic isolated trials hold a segment: one coordinate without a change, the others
    by rounding.
    """
    rounding = 1e-8 * np.arange(1200)[:, None] * [0.0, 1.0, 1.0]
    assert (
        findings(
            with_trial(sound, "knee_r", moved("R.Thigh.Rear", lambda x: x[:1] + rounding)), "frozen"
        )
        == []
    )
    moving = np.column_stack([np.zeros(1200), np.linspace(0.0, 0.2, 1200), np.zeros(1200)])
    (found,) = findings(
        with_trial(sound, "knee_r", moved("R.Thigh.Rear", lambda x: x[:1] + moving)),
        "frozen",
        WARNING,
    )
    assert "one coordinate never changes: R.Thigh.Rear" in found.found


@pytest.mark.parametrize(
    "spoil",
    [
        moved("L.Toe.Tip", lambda x: x + [0.0, 0.06, 0.0]),
        swapped("L.Shank.Upper", "L.Shank.Front"),
        gone(slice(70, None), "L.Thigh.Front"),
        moved("L.Heel", spiked),
        moved("L.Thigh.Front", held),
        gone(slice(70, None), "R.ASIS"),
    ],
)
def test_an_isolated_trial_answers_for_its_joint_alone(sound: Study, spoil: Change) -> None:
    """The joint is fitted by thigh and shank: what is wrong elsewhere spoils nothing; in the walk
    it does.
    """
    assert serious(with_trial(sound, "knee_r", spoil)) == []
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


def test_line_names_file_trial_and_cure(sound: Study) -> None:
    (found,) = serious(
        with_trial(sound, "walk", lambda r: replace(scaled(1000.0)(r), source="walk.csv"))
    )
    assert re.fullmatch(
        r"walk\.csv: trial 'walk': units: the markers span .* m; .*declare mm.*", found.line
    )


def test_time_column_against_header(tmp_path: Path, sound: Study) -> None:
    path = tmp_path / "walk.trc"
    header = "DataRate\tCameraRate\tNumFrames\n{}\t{}\t208\n"
    for rates, count in (((200, 200), 0), ((50, 200), 0), ((200, 100), 1), ((50, 100), 1)):
        path.write_text("PathFileType\t4\n" + header.format(*rates), encoding="utf-8")
        found = findings(
            with_trial(sound, "walk", lambda r: replace(r, source=str(path))), "time", WARNING
        )
        assert len(found) == count, rates
