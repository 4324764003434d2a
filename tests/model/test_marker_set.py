"""Marker sets: the built-in ones are sound, a user's own is read, and every mistake in it is told in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SEGMENTS
from gaitcal.model.marker_set import LANDMARKS, REQUIRED, built_in_sets, instead_of, load_marker_set
from gaitcal.model.nominal import published_model
from gaitcal.model.present_markers import worn
from tests.model.people import PEOPLE

OWN = """\
description = "mine"
[landmarks]
"asis_{s}" = "{S}ASI"
sacrum = ["RPSI", "LPSI"]
"knee_lat_{s}" = "{S}KNE"
"ankle_lat_{s}" = "{S}ANK"
"heel_{s}" = "{S}HEE"
"toe_{s}" = "{S}TOE"
[tracking]
pelvis = ["{S}ASI", "{S}PSI"]
"thigh_{s}" = ["{S}THI", "{S}KNE"]
[weights]
"{S}THI" = { weight = 0.5, reason = "a wand" }
[aliases]
RTHI = ["RTHIGH"]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_built_in_sets() -> None:
    ours = "cast conventional73 gait2354 ior opencap plug-in-gait published rajagopal rcnl ufabc visual3d"
    assert built_in_sets() == tuple(ours.split())
    for name in built_in_sets():
        made = load_marker_set(name)
        assert made.name == name
        assert set(REQUIRED) <= set(made.landmarks) <= set(LANDMARKS)
        assert set(made.tracking) <= set(SEGMENTS)
        for label, weight in made.weights.items():
            assert label in made.labels
            assert weight >= 0
            assert len(made.reasons[label]) > 20, "a weight has its reason"


def test_sides_are_written_once() -> None:
    made = load_marker_set("gait2354")
    assert made.landmarks["knee_lat_l"] == ("L.Knee.Lat",)
    assert made.tracking["thigh_r"] == ("R.Thigh.Upper", "R.Thigh.Front", "R.Thigh.Rear")
    assert made.weight("R.Temple") == made.weight("L.Temple") == 0
    assert made.weight("R.Heel") == 1


def test_the_published_set_has_the_published_markers_with_one_weight() -> None:
    made, model = load_marker_set("published"), published_model(static_only=True)
    assert set(made.labels) == set(model.markers.labels)
    assert len(made.labels) == 49
    assert not made.weights
    segment_of = dict(zip(model.markers.labels, model.markers.segments, strict=True))
    for groups in (made.tracking, made.static_only):
        for segment, labels in groups.items():
            assert {segment_of[label] for label in labels} == {segment}


@pytest.mark.parametrize("name", PEOPLE)
def test_real_static_trials_have_the_markers(name: str, data_dir: Path) -> None:
    person = PEOPLE[name]
    recording = person.markers.renamed(read_recording(data_dir / person.file))
    optional = {"RUPA", "LUPA", "RFRM", "LFRM"}  # Plug-in Gait: placed by some laboratories
    needed = {label for labels in worn(person.markers, recording).landmarks.values() for label in labels}
    assert needed - {"RELM", "LELM"} <= set(recording.labels)
    assert set(worn(person.markers, recording).labels) - optional <= set(recording.labels)


def test_own_set(tmp_path: Path) -> None:
    made = load_marker_set(str(write(tmp_path, OWN)))
    assert (made.name, made.description) == ("own", "mine")
    assert made.landmarks["sacrum"] == ("RPSI", "LPSI")
    assert made.tracking["pelvis"] == ("RASI", "LASI", "RPSI", "LPSI")
    assert made.tracking["thigh_l"] == ("LTHI", "LKNE")
    assert made.weights == {"RTHI": 0.5, "LTHI": 0.5}
    assert load_marker_set(write(tmp_path, OWN)) == made


EXTENDED = """
description = "ours"
extends = "plug-in-gait"
[landmarks]
sacrum = { first_of = ["SACR", ["RPSI", "LPSI"]] }
[tracking]
"thigh_{s}" = ["{S}THI", "{S}TH2"]
[weights]
RTH2 = { weight = 0.5, reason = "hangs loose" }
"""


def test_a_set_may_extend_a_built_in_one(tmp_path: Path) -> None:
    made, base = load_marker_set(write(tmp_path, EXTENDED)), load_marker_set("plug-in-gait")
    assert made.options("sacrum") == (("SACR",), ("RPSI", "LPSI"))
    assert made.tracking["thigh_l"] == ("LTHI", "LTH2")
    assert made.tracking["shank_l"] == base.tracking["shank_l"]
    assert made.options("toe_r") == base.options("toe_r")
    assert made.weight("C7") == base.weight("C7") and made.weight("RTH2") == 0.5
    for old, new, message in (
        ("plug-in-gait", "plugin-gait", "extends: found 'plugin-gait', which is no built-in marker set; did you mean"),
        ("first_of", "fist_of", "did you mean 'first_of'?"),
        ('"{S}THI", ', '"{S}TIB", ', "marker 'RTIB' is on thigh_r and on shank_r"),
        ("[tracking]", '[knee_device]\nRKNE = ["A", "B"]\n[tracking]', "knee_device: found 2 markers for 'RKNE'"),
    ):
        assert old in EXTENDED
        with pytest.raises(InputError, match=".") as caught:
            load_marker_set(write(tmp_path, EXTENDED.replace(old, new, 1)))
        assert message in str(caught.value)


def test_aliases_are_other_spellings(tmp_path: Path) -> None:
    made = load_marker_set(write(tmp_path, OWN))
    recording = Recording(source="f", time=np.arange(2.0), labels=("RTHIGH", "LTHI"), markers=np.zeros((2, 2, 3)))
    renamed = made.renamed(recording)
    assert renamed.labels == ("RTHI", "LTHI")
    assert renamed.notes == ("markers renamed: RTHIGH -> RTHI",)
    assert made.renamed(renamed) is renamed
    both = Recording(source="f", time=np.arange(2.0), labels=("RTHIGH", "RTHI"), markers=np.zeros((2, 2, 3)))
    assert made.renamed(both) is both


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sacrum = ", "sakrum = ", "landmarks: found 'sakrum', which is no landmark; did you mean 'sacrum'?"),
        ('"ankle_lat_{s}" = "{S}ANK"\n', "", "landmarks: 'ankle_lat_r' is missing: give a marker on the lateral mall"),
        ('"thigh_{s}" =', '"tigh_{s}" =', "tracking: found 'tigh_r', which is no segment; did you mean 'thigh_r'"),
        ('"thigh_{s}" =', '"talus_{s}" =', "tracking: found 'talus_r', which is no segment"),
        ('"{S}KNE"]', '"{S}ASI"]', "marker 'RASI' is on pelvis and on thigh_r; a marker is fixed in one segment"),
        ('"{S}THI" = { w', '"{S}TH" = { w', "weights: found 'RTH', which is no tracked marker; did you mean 'RTHI'"),
        ("weight = 0.5", "weight = -1", "weights.'{S}THI'.weight: found -1"),
        (', reason = "a wand"', "", "weights.'{S}THI'.reason: missing: why the weight is not 1"),
        ("[aliases]", "[alias]", "unknown key 'alias'; did you mean 'aliases'?"),
        ("RTHI = [", "RTIB = [", "aliases: found 'RTIB', which is no marker"),
        ('sacrum = ["RPSI", "LPSI"]', "sacrum = 1", "landmarks.sacrum: found 1; allowed: a list"),
        ('sacrum = ["RPSI", "LPSI"]', "sacrum = []", "landmarks.sacrum"),
        ("[tracking]", "[landmarks]", "not valid TOML"),
        ('"heel_{s}" = ', '"toe_{s}" = ', "not valid TOML"),
        ('"toe_{s}" = "{S}TOE"', '"toe_{s}" = "{S}TOE"\ntoe_r = "X"', "landmarks: 'toe_r' is given twice"),
    ],
)
def test_mistakes_are_told_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in OWN
    path = write(tmp_path, OWN.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_marker_set(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_set_names_the_built_in_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"allowed: cast, conventional73, gait2354, .*; did you mean 'gait2354'\?"):
        load_marker_set("gait2345")
    with pytest.raises(InputError, match="no such file"):
        load_marker_set(tmp_path / "none.toml")
    with pytest.raises(InputError, match="no such file"):
        load_marker_set("folder/none.toml")


def test_every_required_landmark_has_a_substitute_to_name() -> None:
    for name in REQUIRED:
        assert instead_of(name).startswith("a marker ")
