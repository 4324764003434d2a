"""Markers of made-up C3D files: clock, units, gaps, and files larger or odder than the usual."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import gaitcal.io.c3d.reader as parse
from gaitcal.errors import InputError
from gaitcal.io.c3d.reader import ParserDiedError, parse_c3d
from gaitcal.io.formats import read_recording
from tests.io.recordings import standing_points_mm, write_raw_c3d

LABELS = [f"M{i}" for i in range(8)]


@pytest.mark.parametrize(
    "units, factor, told", [("mm", 1.0, False), ("m", 1e-3, False), ("cm", 0.1, False), ("ell", 1.0, True)]
)
def test_units_become_metres(tmp_path: Path, units: str, factor: float, told: bool) -> None:
    points = standing_points_mm(5)
    recording = read_recording(write_raw_c3d(tmp_path / "u.c3d", factor * points, LABELS, units=units))
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
    assert any("1 positions of exactly 0 0 0" in note for note in recording.notes)


def test_cut_short_is_told_with_both_lengths(tmp_path: Path) -> None:
    path = write_raw_c3d(tmp_path / "t.c3d", standing_points_mm(200), LABELS)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(InputError, match=r"cut short: \d+ bytes found, \d+ needed for its 200 frames"):
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
    """The parser is replaced by one that does what a damaged file may make it do; the next file has a new one."""
    path = write_raw_c3d(tmp_path / "c.c3d", standing_points_mm(5), LABELS)
    (tmp_path / "ezc3d.py").write_text(f"import os, time, numpy\ndef c3d(*_): {fault}\n", encoding="utf-8")
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
