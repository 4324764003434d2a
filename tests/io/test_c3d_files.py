"""C3D files, made up and real: clock, units, gaps, and files larger or odder than the usual."""

import struct
from collections.abc import Iterator
from pathlib import Path

import ezc3d
import numpy as np
import pytest

import gaitcal.io.c3d.reader as parse
from gaitcal.errors import Code, InputError
from gaitcal.io.c3d.layout import parse_records
from gaitcal.io.c3d.reader import ParserDiedError, parse_c3d
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from tests.io.recordings import standing_points_mm, write_raw_c3d
from tests.messages import check_text, refuses

LABELS = [f"M{i}" for i in range(8)]


@pytest.mark.parametrize(
    "units, factor, told",
    [("mm", 1.0, False), ("m", 1e-3, False), ("cm", 0.1, False), ("ell", 1.0, True)],
)
def test_units_become_metres(tmp_path: Path, units: str, factor: float, told: bool) -> None:
    points = standing_points_mm(5)
    recording = read_recording(
        write_raw_c3d(tmp_path / "u.c3d", factor * points, LABELS, units=units)
    )
    np.testing.assert_allclose(recording.markers[..., 1], points[..., 2] / 1e3, rtol=1e-6)
    assert any("'ell'" in note for note in recording.notes) == told


def test_gaps_stay_gaps_and_zeros_become_gaps(tmp_path: Path) -> None:
    points = standing_points_mm(20)
    points[3:6, 2] = np.nan
    points[8, 1] = 0.0
    recording = read_recording(write_raw_c3d(tmp_path / "g.c3d", points, LABELS))
    gaps = np.isnan(recording.markers).all(axis=2)
    expected = np.zeros((20, 8), dtype=bool)
    expected[3:6, 2] = True
    expected[8, 1] = True
    np.testing.assert_array_equal(gaps, expected)
    check_text(recording.notes, 1, 0)


def test_cut_short_is_told_with_both_lengths(tmp_path: Path) -> None:
    path = write_raw_c3d(tmp_path / "t.c3d", standing_points_mm(200), LABELS)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with refuses(Code.DAMAGED_RECORDING, 200, source="t.c3d"):
        read_recording(path)


@pytest.fixture
def parser(monkeypatch: pytest.MonkeyPatch) -> Iterator[parse._Parser]:
    """A new process, which ends with the test."""
    parser = parse._Parser()
    monkeypatch.setattr(parse, "_PARSER", parser)
    yield parser
    parser.end()


@pytest.mark.parametrize(
    "fault, told",
    [
        ("os.kill(os.getpid(), 11)", "signal 11"),
        ("time.sleep(60)", "longer than 1 s"),
        ("numpy.ones(2**33)", "allocate"),
    ],
)
def test_a_parser_that_dies_hangs_or_wants_all_memory_ends_in_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parser: parse._Parser, fault: str, told: str
) -> None:
    """The parser is replaced by one that does what a damaged file may make it do; the next file has
    a new one.
    """
    path = write_raw_c3d(tmp_path / "c.c3d", standing_points_mm(5), LABELS)
    (tmp_path / "ezc3d.py").write_text(
        f"import os, time, numpy\ndef c3d(*_): {fault}\n", encoding="utf-8"
    )
    with monkeypatch.context() as patch:
        patch.setattr(parse, "BASE_SECONDS", 1.0)
        patch.syspath_prepend(tmp_path)
        with pytest.raises((ParserDiedError, ValueError), match=told):
            parse_c3d(path, path.stat().st_size)
    assert parser._process is None
    assert read_recording(path).labels == tuple(LABELS)


def test_one_process_parses_all_files(tmp_path: Path, parser: parse._Parser) -> None:
    path = write_raw_c3d(tmp_path / "s.c3d", standing_points_mm(20), LABELS)
    read_recording(path)
    first = parser._process
    read_recording(path)
    assert first is not None and parser._process is first


G = 9.81
SAME = 2e-4
"""m and N: integers and floats of one trial differ by the integers' step, 0.083 mm."""


def marker(recording: Recording, label: str) -> np.ndarray:
    return recording.markers[:, recording.labels.index(label)]


@pytest.mark.parametrize("name", ["Eb015pr", "Eb015vi", "Eb015vr"])
def test_every_supported_encoding_gives_the_same_numbers(data_dir: Path, name: str) -> None:
    first = read_recording(data_dir / "c3d_formats/Eb015pi.c3d")
    other = read_recording(data_dir / f"c3d_formats/{name}.c3d")
    assert other.labels == first.labels
    assert len(first.labels) == 26
    np.testing.assert_array_equal(other.time, first.time)
    np.testing.assert_allclose(other.markers, first.markers, atol=SAME)
    assert len(other.plates) == 2
    for a, b in zip(first.plates, other.plates, strict=True):
        np.testing.assert_allclose(b.wrench(), a.wrench(), atol=SAME)


@pytest.mark.parametrize("name", ["Eb015si", "Eb015sr"])
def test_mips_encoding_is_refused_by_name(data_dir: Path, name: str) -> None:
    with refuses(Code.FILE_FORMAT):
        read_recording(data_dir / f"c3d_formats/{name}.c3d")


def test_plug_in_gait_forces_and_centres_of_pressure_fit_the_person(data_dir: Path) -> None:
    """66.5 kg, 1.79 m: the plates carry the person and push where the feet are."""
    static = read_recording(data_dir / "pig_c3d/static.c3d")
    total = sum(plate.force[:, 1].mean() for plate in static.plates)
    assert 0.94 < total / (66.5 * G) < 1.02
    for plate, side in zip(static.plates, "RL", strict=True):
        heel, toe = (
            marker(static, f"{side}HEE").mean(axis=0),
            marker(static, f"{side}TOE").mean(axis=0),
        )
        centre = plate.point.mean(axis=0)
        along = np.dot(centre - heel, toe - heel) / np.dot(toe - heel, toe - heel)
        assert 0.1 < along < 0.9
        assert np.linalg.norm((heel + along * (toe - heel) - centre)[[0, 2]]) < 0.04
    gait = read_recording(data_dir / "pig_c3d/gait.c3d")
    assert gait.time[0] == pytest.approx(3.41)  # first frame is 342 of 100 Hz
    right = gait.plates[0]
    assert right.time[0] == gait.time[0]
    assert 1.0 < right.force[:, 1].max() / (66.5 * G) < 1.15
    loaded = right.force[:, 1] > 200
    assert right.time[loaded][0] == pytest.approx(4.05, abs=0.03)
    assert right.time[loaded][-1] == pytest.approx(4.83, abs=0.04)
    heel = np.interp(right.time[loaded], gait.time, marker(gait, "RHEE")[:, 0])
    toe = np.interp(right.time[loaded], gait.time, marker(gait, "RTOE")[:, 0])
    inside = (right.point[loaded, 0] > heel - 0.03) & (right.point[loaded, 0] < toe + 0.08)
    assert inside.mean() > 0.98


def test_type_4_plates_of_a_treadmill_lie_under_the_feet(data_dir: Path) -> None:
    """ORIGIN has no height there, so that its sign cannot be read off it."""
    static = read_recording(data_dir / "functional_c3d/static.c3d")
    assert len(static.labels) == 73
    assert static.time[0] == pytest.approx(1.2)
    for plate, side in zip(static.plates, "LR", strict=True):
        heel, toe = (
            marker(static, f"{side}CAL").mean(axis=0),
            marker(static, f"{side}MFH1").mean(axis=0),
        )
        centre = plate.point[np.isfinite(plate.point).all(axis=1)].mean(axis=0)
        assert heel[0] < centre[0] < toe[0]
        assert abs(centre[2] - heel[2]) < 0.06
    assert sum(np.nanmean(p.force[:, 1]) for p in static.plates) == pytest.approx(647, abs=15)
    hip = read_recording(data_dir / "functional_c3d/hip_r.c3d")
    # The right foot is in the air until it lands in the last instants; the empty plate read 9.6 N.
    assert np.percentile(np.abs(hip.plates[1].force[:, 1]), 95) < 1


def test_type_1_file_without_analog_rate_is_laid_out_after_its_header(data_dir: Path) -> None:
    """ezc3d takes this file's analog values for points: markers at 2.8 m, no plate."""
    recording = read_recording(data_dir / "c3d_formats/TYPE-1.C3D")
    check_text(recording.notes)
    assert np.nanmax(recording.markers[..., 1]) < 1.0  # m, the pelvis is the highest segment
    (plate,) = recording.plates
    assert 650 < plate.force[:, 1].max() < 800
    loaded = np.flatnonzero(plate.force[:, 1] > 100)  # one sample a frame
    ankle, toe = marker(recording, "RANK")[loaded], marker(recording, "RMET")[loaded]
    middle = 0.5 * (ankle + toe)
    away = (plate.point[loaded] - middle)[:, [0, 2]]
    assert np.nanmax(np.linalg.norm(away, axis=1)) < 0.15


@pytest.mark.parametrize(
    ("channels", "found"), [(3, "no marker, only 3 analog channels"), (0, "no marker")]
)
def test_a_file_without_points_is_told_as_such_and_not_by_its_rate(
    tmp_path: Path, channels: int, found: str
) -> None:
    """As programs of force plates and inertial sensors write it: no POINT:RATE either."""
    file = ezc3d.c3d()
    file["data"]["points"] = np.zeros((4, 0, 50))
    if channels:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [100.0]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"Fz{k}" for k in range(channels)]
        file["data"]["analogs"] = np.ones((1, channels, 50))
    file.write(str(tmp_path / "forces.c3d"))
    with refuses(Code.FILE_FORMAT, found, source="forces.c3d"):
        read_recording(tmp_path / "forces.c3d")


@pytest.mark.parametrize(("case", "start"), [("late_crop", 700.0), ("crosses_65536", 653.99)])
def test_frames_that_the_header_cannot_hold_are_those_of_trial(
    data_dir: Path, case: str, start: float
) -> None:
    """A frame counter that stopped at 65535, and one that began again at zero: all but the clock
    stays as it was.
    """
    found = read_recording(data_dir / "cases" / case / "gait.c3d")
    usual = read_recording(data_dir / "pig_c3d/gait.c3d")
    assert found.time[0] == pytest.approx(start) and len(found.time) == len(usual.time)
    np.testing.assert_array_equal(found.markers, usual.markers)
    for ours, theirs in zip(found.plates, usual.plates, strict=True):
        np.testing.assert_array_equal(ours.force, theirs.force)
        assert ours.time[0] == pytest.approx(start)


FRAMES = 66500
"""More than 16 bits count."""


@pytest.mark.parametrize("words", [(1, 65535), (1, FRAMES % 65536), (65535, 65535)])
def test_frames_beyond_the_greatest_that_a_header_counts_are_read(
    tmp_path: Path, words: tuple[int, int]
) -> None:
    """Neither TRIAL nor FRAMES knows them: the length of the file does."""
    points = np.repeat(standing_points_mm(1)[:, :2], FRAMES, axis=0)
    points[:, 0, 0] += 0.01 * np.arange(FRAMES)
    path = write_raw_c3d(tmp_path / "long.c3d", points, LABELS[:2])
    content = bytearray(path.read_bytes())
    content[6:10] = struct.pack("<2H", *words)
    path.write_bytes(content)
    recording = read_recording(path)
    assert len(recording.time) == FRAMES
    np.testing.assert_allclose(recording.markers[:, 0, 0], points[:, 0, 0] / 1e3, rtol=1e-6)
    assert any("65535" in note and "66500" in note for note in recording.notes)
    assert any("times may begin later" in note for note in recording.notes) == (words[0] == 65535)


def test_a_header_whose_frames_fit_no_length_is_still_refused(tmp_path: Path) -> None:
    path = write_raw_c3d(tmp_path / "f.c3d", standing_points_mm(50), LABELS)
    content = bytearray(path.read_bytes())
    content[6:10] = struct.pack("<2H", 40, 12)
    path.write_bytes(content)
    with refuses(Code.DAMAGED_RECORDING, 40, 12, field="header", source="f.c3d"):
        read_recording(path)


@pytest.mark.parametrize(("name", "kind"), [("LABELS", 37), ("UNITS", 1), ("RATE", -3)])
def test_damage_is_told_by_the_record_and_not_in_the_words_of_a_library(
    tmp_path: Path, name: str, kind: int
) -> None:
    path = write_raw_c3d(tmp_path / "d.c3d", standing_points_mm(5), LABELS)
    content = path.read_bytes()
    record = next(record for record in parse_records(content) if record.name == name)
    path.write_bytes(
        content.replace(record.content, struct.pack("<b", kind) + record.content[1:], 1)
    )
    try:
        read_recording(path)
    except InputError as fault:
        assert fault.code is Code.DAMAGED_RECORDING
        assert not any(
            word in str(fault) for word in ("ignoreBadFormatting", "std::", "iostream", "dtype")
        )
        assert f"the parameter {name}" in str(fault) if kind == 37 else True
    else:
        assert kind != 37, "a type that is none has to be found"
