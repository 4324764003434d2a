"""Each check finds the fault it is about, tells it with numbers, and says nothing about a sound study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.model.nominal import published_model
from gaitcal.recording import ForcePlate, Recording
from gaitcal.study.checks import Finding, Severity, check_study
from gaitcal.study.person import Study
from tests.study.checks.spoilt import (
    CORNERS,
    Change,
    findings,
    moved,
    plate,
    relabelled,
    sound_study,
    swapped,
    with_trial,
)

ERROR, WARNING, INFO = Severity.ERROR, Severity.WARNING, Severity.INFO


@pytest.fixture(scope="module")
def sound() -> Study:
    return sound_study()


def test_sound_study_has_only_facts(sound: Study) -> None:
    assert [f for f in check_study(sound) if f.severity is not INFO] == []


def scaled(factor: float) -> Change:
    return lambda r: replace(r, markers=factor * r.markers)


def gone(frames: slice) -> Change:
    return moved("R.Thigh.Front", lambda x: _put(x, frames, np.nan))


def _put(x: np.ndarray, where: object, value: object) -> np.ndarray:
    x[where] = value
    return x


def held(x: np.ndarray) -> np.ndarray:
    x[60:100] = x[60]
    return x


def spiked(x: np.ndarray) -> np.ndarray:
    x[[40, 90, 140], 1] += 0.1
    return x


def later(seconds: float) -> Change:
    def spoil(recording: Recording) -> Recording:
        moved_ = tuple(_resampled(p, seconds) for p in recording.plates)
        return replace(recording, plates=moved_)

    return spoil


def _resampled(p: ForcePlate, seconds: float) -> ForcePlate:
    """The plate's signal `seconds` later on the same clock."""
    shift = round(seconds / float(p.time[1] - p.time[0]))
    return replace(
        p, force=np.roll(p.force, shift, 0), point=np.roll(p.point, shift, 0), moment=np.roll(p.moment, shift, 0)
    )


def slower(recording: Recording) -> Recording:
    return replace(recording, time=recording.time * 200.0)


def torn(recording: Recording) -> Recording:
    return replace(recording, time=recording.time + np.where(recording.time > 0.5, 0.2, 0.0), plates=())


def backwards(recording: Recording) -> Recording:
    return replace(recording, markers=recording.markers[::-1].copy(), plates=())


def lying(recording: Recording) -> Recording:
    return replace(recording, markers=recording.markers[:, :, [1, 0, 2]] * [1.0, -1.0, 1.0], plates=())


def mirrored(recording: Recording) -> Recording:
    order = [
        recording.labels.index(label[0].translate(str.maketrans("RL", "LR")) + label[1:])
        if label[:2] in ("R.", "L.") and "ASIS" not in label
        else i
        for i, label in enumerate(recording.labels)
    ]
    return replace(recording, markers=recording.markers[:, order])


def clipped(p: ForcePlate) -> ForcePlate:
    return replace(p, force=np.where(p.force > 600.0, 600.0, p.force))


def offset(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force + [0.0, 25.0, 0.0])


def half(p: ForcePlate) -> ForcePlate:
    return replace(p, force=0.4 * p.force, moment=0.4 * p.moment)


def pulling(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force * np.where(p.time > 0.4, -1.0, 1.0)[:, None])


def aslant(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force[:, [1, 1, 2]])


def elsewhere(p: ForcePlate) -> ForcePlate:
    return replace(p, point=p.point + [0.0, 0.0, 0.8])


def sunk(p: ForcePlate) -> ForcePlate:
    return replace(p, point=p.point - [0.0, 0.4, 0.0])


def with_corners(x_end: float) -> Change:
    """Plate 1 ends at x_end m."""
    corners = np.column_stack([np.minimum(CORNERS[:, 0], x_end), CORNERS[:, 1:]])
    return plate(1, lambda p: replace(p, corners=corners))


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
    "never seen": ("walk", gone(slice(None)), "labels", ERROR, ("R.Thigh.Front", "0 of 208 frames")),
    "landmark not labelled": ("static", relabelled("R.Heel", "Heel"), "static trial", ERROR, ("heel_r", "R.Heel")),
    "label twice": ("walk", relabelled("R.Bicep", "R.ASIS#2"), "labels", WARNING, ("R.ASIS",)),
    "unknown label": ("walk", relabelled("R.Temple", "Wand1"), "labels", INFO, ("Wand1",)),
    "seldom seen": ("walk", gone(slice(60, None)), "gaps", WARNING, ("R.Thigh.Front 29 %",)),
    "long gap": ("walk", gone(slice(60, 120)), "gaps", INFO, ("R.Thigh.Front 0.30 s",)),
    "pelvis lost": (
        "walk",
        moved(ASIS, lambda x: _put(x, slice(20, 62), np.nan)),
        "gaps",
        WARNING,
        ("20 %", "0.10-0.30 s"),
    ),
    "frozen": ("walk", moved("R.Thigh.Front", held), "frozen", WARNING, ("R.Thigh.Front", "0.30-0.49 s")),
    "flat": (
        "walk",
        moved("R.Thigh.Front", lambda x: _put(x, (slice(None), 2), 0.1)),
        "frozen",
        WARNING,
        ("R.Thigh.Front",),
    ),
    "spikes": ("walk", moved("R.Thigh.Front", spiked), "jumps", WARNING, ("R.Thigh.Front (3 frames)", "100 mm")),
    "exchanged a while": (
        "walk",
        swapped("R.Thigh.Front", "R.Thigh.Rear", slice(50, 90)),
        "exchanged",
        WARNING,
        ("R.Thigh.Front", "R.Thigh.Rear", "40 frames", "0.25-0.45 s"),
    ),
    "exchanged across": (
        "walk",
        swapped("R.Shank.Rear", "L.Shank.Rear", slice(50, 90)),
        "exchanged",
        WARNING,
        ("R.Shank.Rear", "L.Shank.Rear"),
    ),
    "exchanged for good": ("walk", swapped("R.Thigh.Front", "R.Shank.Front"), "exchanged", ERROR, ("208 frames",)),
    "sides exchanged": ("walk", mirrored, "sides", ERROR, ("R.Thigh.Upper", "mm")),
    "sides exchanged, standing": ("static", mirrored, "static trial", ERROR, ("exchanged",)),
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
    text = " | ".join(f"{f.found} {f.cure}" for f in found)
    for word in words:
        assert word in text


def test_foot_beside_its_plate(sound: Study) -> None:
    model = published_model()
    walk = next(t for t in sound.trials if t.name == "walk").recording
    toe = float(np.median(walk.markers[40:100, walk.labels.index("R.Toe.Tip"), 0]))
    assert model.markers.labels == walk.labels
    beside = findings(with_trial(sound, "walk", with_corners(toe - 0.04)), "plate to foot", WARNING)
    assert "right foot rests partly beside it (toes" in beside[0].found
    assert findings(with_trial(sound, "walk", with_corners(toe + 0.06)), "plate to foot", WARNING) == []


def test_plate_given_to_the_wrong_foot(sound: Study) -> None:
    trials = tuple(replace(t, plates={"1": "l"}) if t.name == "walk" else t for t in sound.trials)
    found = findings(replace(sound, trials=trials), "plate to foot", ERROR)
    assert "left foot" in found[0].found and 'plates = { 1 = "r" }' in found[0].cure


def test_mass_against_standing_force(sound: Study) -> None:
    static = sound.static.recording
    weight = 69.4 * 9.81
    force = np.tile([0.0, weight / 2, 0.0], (len(static.time), 1))
    zero = np.zeros_like(force)
    both = tuple(ForcePlate(name, static.time, force, zero, zero) for name in "12")
    study = with_trial(sound, "static", lambda r: replace(r, plates=both))
    assert "69.4 kg" in findings(study, "body mass", INFO)[0].found
    heavier = replace(study, subject=replace(study.subject, mass=80.0))
    assert "69.4 kg while standing; subject.mass_kg is 80" in findings(heavier, "body mass", WARNING)[0].found


def test_height_against_legs(sound: Study) -> None:
    assert findings(sound, "height") == []
    taller = replace(sound, subject=replace(sound.subject, height=2.05))
    assert "2.05 m" in findings(taller, "height", WARNING)[0].found


@pytest.mark.parametrize(
    "field, value, severity, words",
    [
        ("force_filter_hz", 150.0, ERROR, "half of that, 100 Hz"),
        ("force_filter_hz", 60.0, INFO, "differ"),
        ("nodes", 400, ERROR, "400 for 208 frames"),
        ("nodes", 7, WARNING, "pass 0.9 Hz"),
    ],
)
def test_cut_offs(sound: Study, field: str, value: float, severity: Severity, words: str) -> None:
    study = replace(sound, settings=sound.settings.model_copy(update={field: value}))
    found = findings(study, "sampling", severity)
    assert any(words in f"{f.found} {f.cure}" for f in found), found


def test_line_names_file_trial_and_cure() -> None:
    finding = Finding(ERROR, "units", "walk", "found 1800 m", "declare mm", "walk.csv")
    assert finding.line == "walk.csv: trial 'walk': units: found 1800 m; declare mm"


def test_time_column_against_header(tmp_path: Path, sound: Study) -> None:
    path = tmp_path / "walk.trc"
    header = "DataRate\tCameraRate\tNumFrames\n{}\t{}\t208\n"
    for rates, count in (((200, 200), 0), ((50, 200), 0), ((200, 100), 1), ((50, 100), 1)):
        path.write_text("PathFileType\t4\n" + header.format(*rates), encoding="utf-8")
        found = findings(with_trial(sound, "walk", lambda r: replace(r, source=str(path))), "time", WARNING)
        assert len(found) == count, rates
