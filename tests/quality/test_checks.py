"""Each check finds its fault, reports numbers, and finds nothing in a sound study."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from tests.messages import check_finding, require_parts
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


def test_sound_study_has_only_notes(sound: Study) -> None:
    assert serious(sound) == []


@dataclass(frozen=True)
class Case:
    """A fault of one trial and its finding; `parts`: names and numbers in it."""

    code: Code
    severity: Severity
    topic: str
    change: Change
    parts: tuple[str | float, ...]
    trial: str
    serious: set[str]
    """Topics of all that is reported beside notes."""


def case(
    code: Code,
    severity: Severity,
    topic: str,
    change: Change,
    *parts: str | float,
    trial: str = "walk",
    others: Sequence[str] = (),
) -> Case:
    return Case(
        code,
        severity,
        topic,
        change,
        parts,
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
    """The plate's signal later on the same time axis."""
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
    "static in mm": case(Code.UNIT_OF_LENGTH, ERROR, "units", scaled(1000.0), trial="static"),
    "walk in mm": case(Code.UNIT_OF_LENGTH, ERROR, "units", scaled(1000.0)),
    "walk in cm": case(Code.UNIT_OF_LENGTH, ERROR, "units", scaled(100.0)),
    "lengths 30 % larger": case(Code.UNIT_OF_LENGTH, ERROR, "units", scaled(1.3), 1.3),
    "lengths 6 % larger": case(
        Code.OTHER_SCALE, WARNING, "units", scaled(1.06), 1.06, others=["body size"]
    ),
    "spelt otherwise": case(
        Code.MISSING_MARKERS,
        WARNING,
        "labels",
        relabelled(FRONT, "RThighFront"),
        FRONT,
        "RThighFront",
    ),
    "pelvis not labelled": case(
        Code.FEW_MARKERS, ERROR, "labels", relabelled("V.Sacral", "x"), 2, "pelvis"
    ),
    "never seen": case(Code.NEVER_SEEN, WARNING, "labels", gone(slice(None)), FRONT, 208),
    "landmark not labelled": case(
        Code.LANDMARKS,
        ERROR,
        "static trial",
        relabelled("V.Sacral", "Sacrum"),
        "V.Sacral",
        trial="static",
    ),
    "landmark rebuilt": case(
        Code.REBUILT_MARKER,
        WARNING,
        "lost markers",
        relabelled("R.Heel", "Heel"),
        "heel_r",
        '"Heel" = "R.Heel"',
        trial="static",
    ),
    "one trajectory, two labels": case(
        Code.ONE_TRAJECTORY, ERROR, "labels", put_into(REAR, FRONT), FRONT, REAR
    ),
    "label twice": case(
        Code.LABEL_TWICE, WARNING, "labels", relabelled("R.Bicep", "R.ASIS#2"), "R.ASIS"
    ),
    "unknown label": case(
        Code.UNKNOWN_LABELS, INFO, "labels", relabelled("R.Temple", "Wand1"), "Wand1"
    ),
    "seldom seen": case(Code.GAPS, WARNING, "gaps", gone(slice(60, None)), FRONT, 29),
    "seldom seen, but others are": case(
        Code.GAPS, INFO, "gaps", gone(slice(60, None), "R.Toe.Tip"), "R.Toe.Tip", 29
    ),
    "long gap": case(Code.GAPS, INFO, "gaps", gone(slice(60, 120)), FRONT, 0.3),
    "pelvis lost": case(
        Code.PELVIS_LOST, INFO, "gaps", gone(slice(20, 62), "R.ASIS"), 20, 0.1, 0.3
    ),
    "frozen": case(
        Code.FROZEN_MARKER,
        WARNING,
        "frozen",
        moved(FRONT, held),
        0.3,
        0.49,
        others=["displaced markers", "jumps"],
    ),
    "flat": case(
        Code.CONSTANT_COORDINATE,
        WARNING,
        "frozen",
        moved(FRONT, lambda x: put(x, (slice(None), 2), 0.1)),
        FRONT,
    ),
    "spikes": case(Code.SPIKES, INFO, "jumps", moved(FRONT, spiked), FRONT, 3, 100),
    "exchanged a while": case(
        Code.EXCHANGED_BACK,
        INFO,
        "swapped labels",
        swapped(FRONT, REAR, WHILE),
        FRONT,
        REAR,
        40,
        0.25,
        0.45,
    ),
    "in another's place": case(
        Code.EXCHANGED_LABELS, ERROR, "swapped labels", taken(REAR, SHANK, WHILE), REAR, SHANK
    ),
    "exchanged across": case(
        Code.EXCHANGED_BACK,
        INFO,
        "swapped labels",
        swapped(SHANK, LEFT_SHANK, WHILE),
        SHANK,
        LEFT_SHANK,
        40,
    ),
    "exchanged for good": case(
        Code.EXCHANGED_LABELS, ERROR, "swapped labels", swapped(FRONT, SHANK), 208
    ),
    "sides exchanged": case(
        Code.SIDES_EXCHANGED, ERROR, "sides", mirrored, "R.Thigh.Upper", others=["forces"]
    ),
    "sides exchanged, standing": case(
        Code.LANDMARKS_EXCHANGED,
        ERROR,
        "landmarks",
        mirrored,
        "R.Knee.Lat",
        "L.Knee.Lat",
        trial="static",
    ),
    "one pair of sides": case(
        Code.SIDES_EXCHANGED, ERROR, "sides", swapped(SHANK, LEFT_SHANK), SHANK, LEFT_SHANK
    ),
    "lying": case(Code.NOT_UPRIGHT, ERROR, "axes", lying),
    "walking backwards": case(Code.HEADING, INFO, "heading", backwards, 180),
    "never still": case(
        Code.NO_STILL_WINDOW, ERROR, "static trial", drifting(0.3, 0.3, 0.3), trial="static"
    ),
    "restless": case(
        Code.STILLNESS, WARNING, "still window", drifting(0.03, 0, 0), 30, 4.3, 10, trial="static"
    ),
    "2 frames standing": case(
        Code.SHORT_STATIC, WARNING, "still window", cut(2), 2, 3, 0.1, trial="static"
    ),
    "15 frames standing": case(
        Code.SHORT_STATIC, WARNING, "still window", cut(15), 15, trial="static"
    ),
    "a posture": case(Code.SHORT_STATIC, INFO, "still window", cut(1), trial="static"),
    "frames as seconds": case(
        Code.TIME_UNIT, ERROR, "time", faster(1 / 200), 1, others=["plate to foot", "sampling"]
    ),
    "uneven steps": case(Code.UNEVEN_TIME, WARNING, "time", torn, 1, 205),
    "forces late": case(
        Code.CLOCKS_DIFFER, WARNING, "time", plates(later), others=["plate to foot"]
    ),
    "twice the rate": case(
        Code.RATES_DIFFER, INFO, "sampling", faster(2.0), "knee_r", trial="knee_r"
    ),
    "a quarter of the rate": case(
        Code.RATES_DIFFER, WARNING, "sampling", faster(0.25), "knee_r", trial="knee_r"
    ),
    "too few frames": case(Code.SHORT_TRIAL, ERROR, "sampling", cut(9), 9, 12, trial="knee_r"),
    "saturated": case(
        Code.SATURATED_PLATE,
        WARNING,
        "plates",
        of_plate_1(lambda p: np.minimum(p.force, 600.0)),
        600,
    ),
    "offset": case(
        Code.PLATE_OFFSET, WARNING, "plates", of_plate_1(lambda p: p.force + [0.0, 25.0, 0.0]), 25
    ),
    "pulling": case(
        Code.PLATE_PULLS,
        WARNING,
        "plates",
        of_plate_1(lambda p: p.force * np.where(p.time > 0.4, -1.0, 1.0)[:, None]),
    ),
    "aslant": case(Code.PLATE_AXES, WARNING, "plates", of_plate_1(lambda p: p.force[:, [1, 1, 2]])),
    "no Fx": case(
        Code.DEAD_CHANNEL,
        WARNING,
        "plates",
        of_plate_1(lambda p: p.force * [0, 1, 1]),
        1,
        "Fx",
        others=["forces"],
    ),
    "no Fz": case(
        Code.DEAD_CHANNEL, WARNING, "plates", of_plate_1(lambda p: p.force * [1, 1, 0]), 1, "Fz"
    ),
    "sunk": case(
        Code.PLATE_HEIGHT,
        WARNING,
        "plates",
        plates(lambda p: replace(p, point=p.point - [0.0, 0.4, 0.0]), 1),
    ),
    "off its plate": case(
        Code.PLATE_CORNERS,
        WARNING,
        "plates",
        plates(lambda p: replace(p, corners=CORNERS + [30.0, 0, 0]), 1),
    ),
    "half the force": case(Code.BODY_MASS, WARNING, "body mass", plates(times(0.4))),
    "under no foot": case(
        Code.UNDER_NO_FOOT,
        WARNING,
        "plate to foot",
        plates(lambda p: replace(p, point=p.point + [0, 0, 0.8]), 1),
    ),
    "plate reported in words": case(
        Code.PLATE_DESCRIPTION,
        WARNING,
        "plates",
        lambda r: r.with_notes("Plate 3 left out: its type is 7."),
        7,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_fault_is_found_and_nothing_else(name: str, sound: Study) -> None:
    wanted = CASES[name]
    found = check_study(with_trial(sound, wanted.trial, wanted.change))
    own = [f for f in found if (f.code, f.severity) == (wanted.code, wanted.severity)]
    assert own, [f.line for f in found]
    require_parts(" | ".join(f.line for f in own), wanted.parts)
    for finding in own:
        check_finding(finding, wanted.code, topic=wanted.topic)
    assert {f.topic for f in found if f.severity is not INFO} == wanted.serious


@pytest.mark.parametrize(
    ("starts", "severity"),
    [
        (("R.Temple", "R.Heel"), INFO),
        (("L.Shank.Front", "L.Shank.Rear"), WARNING),
        (("L.Shank", "L.Ankle"), ERROR),
    ],
)
def test_empty_column_counts_as_absent_label(
    sound: Study, starts: tuple[str, ...], severity: Severity
) -> None:
    """A label template names markers that were not worn: only a segment without markers is an
    error.
    """

    def emptied(r: Recording) -> Recording:
        columns = [k for k, label in enumerate(r.labels) if label.startswith(starts)]
        return replace(r, markers=put(r.markers.copy(), (slice(None), columns), np.nan))

    found = check_study(with_trial(sound, "walk", emptied))
    assert [f.severity for f in found if f.code is Code.NEVER_SEEN] == [severity]


def test_feet_that_contradict_the_file_are_reported_unless_the_study_decides(sound: Study) -> None:
    def forefeet(r: Recording) -> Recording:
        return replace(r, facts=replace(r.facts, static_plantarflexion={"r": -0.15, "l": -0.15}))

    spoilt = with_trial(sound, "static", forefeet)
    (found,) = findings(spoilt, "posture", WARNING)
    check_finding(found, Code.FEET_NOT_FLAT, Severity.WARNING, leg="")
    decided = spoilt.settings.model_copy(update={"ankle_zero": "sole"})
    assert not findings(replace(spoilt, settings=decided), "posture")


def test_one_recording_as_two_trials(sound: Study) -> None:
    def reported(recording: Recording) -> list[Finding]:
        again = replace(sound.trials[1], name="walk2", recording=recording)
        return findings(replace(sound, trials=(*sound.trials, again)), "trials")

    copy = replace(recording_of(sound), source="copy.csv", plates=())
    (found,) = reported(copy)
    check_finding(found, Code.SAME_RECORDING, ERROR, "walk", 208, where="walk2")
    assert reported(replace(copy, time=copy.time[10:], markers=copy.markers[10:])) == []


def test_segment_held_still_is_not_frozen(sound: Study) -> None:
    """As in synthetic functional trials: one coordinate is constant, the others change by
    rounding.
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
    check_finding(found, Code.CONSTANT_COORDINATE, Severity.WARNING, "R.Thigh.Rear")


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
def test_functional_trial_is_checked_for_its_joint_only(sound: Study, spoil: Change) -> None:
    """Thigh and shank determine the joint: other faults have no effect; in the walk they have."""
    assert serious(with_trial(sound, "knee_r", spoil)) == []
    notes = {f.line for f in check_study(sound)}
    assert [f for f in check_study(with_trial(sound, "walk", spoil)) if f.line not in notes]


def test_height_against_legs(sound: Study) -> None:
    assert findings(sound, "height") == []
    taller = replace(sound, subject=replace(sound.subject, height=2.05))
    check_finding(findings(taller, "height")[0], Code.BODY_HEIGHT, WARNING, 2.05)


@pytest.mark.parametrize(
    "field, value, severity, code, parts",
    [
        ("force_filter_hz", 150.0, ERROR, Code.FORCE_FILTER, [100]),
        ("bandwidth_hz", 3.0, WARNING, Code.SMOOTHED_TOO_MUCH, [2.6]),
        ("nodes", 400, ERROR, Code.MANY_NODES, [400, 208]),
        ("nodes", 7, WARNING, Code.SMOOTHED_TOO_MUCH, [0.9]),
    ],
)
def test_cut_offs(
    sound: Study, field: str, value: float, severity: Severity, code: Code, parts: list[float]
) -> None:
    study = replace(sound, settings=sound.settings.model_copy(update={field: value}))
    check_finding(findings(study, code=code)[0], code, severity, *parts)


def test_line_names_file_trial_and_cure(sound: Study) -> None:
    (found,) = serious(
        with_trial(sound, "walk", lambda r: replace(scaled(1000.0)(r), source="walk.csv"))
    )
    check_finding(found, Code.UNIT_OF_LENGTH, Severity.ERROR, "walk.csv", "walk")


def test_time_column_against_header(tmp_path: Path, sound: Study) -> None:
    path = tmp_path / "walk.trc"
    header = "DataRate\tCameraRate\tNumFrames\n{}\t{}\t208\n"
    for rates, count in (((200, 200), 0), ((50, 200), 0), ((200, 100), 1), ((50, 100), 1)):
        path.write_text("PathFileType\t4\n" + header.format(*rates), encoding="utf-8")
        found = findings(
            with_trial(sound, "walk", lambda r: replace(r, source=str(path))), "time", WARNING
        )
        assert len(found) == count, rates
