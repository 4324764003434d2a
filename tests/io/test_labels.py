"""Which labels are markers, and how they are spelt."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.labels import clean, common_prefix, computed_points, unique
from tests.io.recordings import standing_points_mm, write_raw_c3d


def read(folder: Path, labels: list[str], **more: object) -> tuple[tuple[str, ...], tuple[str, ...]]:
    path = write_raw_c3d(folder / "labels.c3d", standing_points_mm(5)[:, : len(labels)], labels, **more)  # type: ignore[arg-type]
    recording = read_recording(path)
    assert recording.markers.shape == (5, len(recording.labels), 3)
    return recording.labels, recording.notes


def test_a_common_prefix_goes_and_is_told(tmp_path: Path) -> None:
    labels, notes = read(tmp_path, ["Anna:LASI", "Anna:RASI", "Anna:C7", "*12"])
    assert labels == ("LASI", "RASI", "C7")
    assert "Prefix 'Anna:' taken off the marker names." in notes
    assert "1 unlabelled trajectories left out." in notes


def test_two_subjects_keep_their_prefixes(tmp_path: Path) -> None:
    labels, _ = read(tmp_path, ["Anna:LASI", "Bert:LASI"])
    assert labels == ("Anna:LASI", "Bert:LASI")


def test_repeated_names_are_kept_and_numbered(tmp_path: Path) -> None:
    labels, notes = read(tmp_path, ["LASI", "KNEE", "KNEE", "KNEE"])
    assert labels == ("LASI", "KNEE", "KNEE#2", "KNEE#3")
    assert any("KNEE#2, KNEE#3" in note for note in notes)


def test_computed_points_go_by_the_files_own_lists_and_by_their_spelling(tmp_path: Path) -> None:
    lists = {"TYPE_GROUPS": ["MINE", "MINE"], "MINE": ["Odd"], "ANGLES": ["Tilt"]}
    labels, notes = read(
        tmp_path, ["LASI", "Odd", "Tilt", "PELO", "PELA", "PELL", "PELP", "LKneeMoment"], point_lists=lists
    )
    assert labels == ("LASI",)
    assert any("Odd, Tilt, PELO, PELA, PELL, PELP, LKneeMoment" in note for note in notes)


def test_only_whole_sets_of_segment_points_are_taken_for_such() -> None:
    """LTOA alone may be a marker's name; so may any three of the four."""
    assert computed_points(["PELO", "PELA", "PELL", "LTOA", "LHEE"]) == set()
    assert computed_points(["CentreOfMass", "CentreOfMassFloor", "LHJC", "LKneeAngles", "RGroundReactionForce"]) == {
        "CentreOfMass",
        "CentreOfMassFloor",
        "LHJC",
        "LKneeAngles",
        "RGroundReactionForce",
    }


def test_marker_names_of_real_sets_are_never_taken_for_computed_points() -> None:
    names = (
        "LASI RASI SACR LTHI LKNE LTIB LANK LHEE LTOE RMED R.Knee.Lat V.Sacral L_Toe R_Shank_Superior LFHD LRAR LPSI"
    )
    assert computed_points(names.split()) == set()


def test_only_computed_points_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="computed ones; markers are needed"):
        read(tmp_path, ["LKneeAngles", "RKneeAngles"])


def test_unique_never_makes_a_name_that_is_taken() -> None:
    names, notes = unique(["X", "X", "X#2", "X"])
    assert len(set(names)) == 4
    assert names[0] == "X"
    assert names[2] == "X#2"
    assert notes == ("Marker names that occur more than once were numbered: X#3, X#4.",)


def test_prefix_needs_a_rest() -> None:
    assert common_prefix(["A:", "A:B"])[0] == ""
    assert common_prefix(["A:B", "C"])[0] == ""
    assert common_prefix(["A:B"])[0] == "A:"


def test_clean_makes_names_safe_for_any_text() -> None:
    assert clean("  LASI\t") == "LASI"
    assert clean("a\nb\x00c\u2028d\udcff") == "a?b?c?d?"
    np.testing.assert_equal(clean("Knie, außen"), "Knie, außen")
