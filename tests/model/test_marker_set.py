"""Marker sets: built-in ones are sound, own ones are read and written, mistakes are told, and
labels covered.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Code, InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SEGMENTS
from gaitcal.model.marker_set import (
    LANDMARKS,
    NO_REASON,
    REQUIRED,
    format_marker_set,
    list_built_in_sets,
    load_marker_set,
)
from gaitcal.model.nominal import nominal_model, published_model
from gaitcal.model.present_markers import resolve_marker_set
from tests.messages import refuses
from tests.model.people import PEOPLE
from tests.refusal import refusal

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
    ours = (
        "cast conventional73 davis gait2354 ior key-points landmarks opencap opencap-measured "
        "plug-in-gait poses "
        "published rajagopal rcnl ufabc visual3d"
    )
    assert list_built_in_sets() == tuple(ours.split())
    for name in list_built_in_sets():
        made = load_marker_set(name)
        assert made.name == name
        assert set(REQUIRED) <= set(made.landmarks) <= set(LANDMARKS)
        assert set(made.tracking) <= set(SEGMENTS)
        for label, weight in made.weights.items():
            assert label in made.labels and weight >= 0
            assert len(made.reasons[label]) > 20, "a weight has its reason"


def test_the_published_set_has_the_published_markers_with_one_weight() -> None:
    made, model = load_marker_set("published"), published_model(static_only=True)
    assert (
        set(made.labels) == set(model.markers.labels)
        and len(made.labels) == 49
        and not made.weights
    )
    segment_of = dict(zip(model.markers.labels, model.markers.segments, strict=True))
    for groups in (made.tracking, made.static_only):
        for segment, labels in groups.items():
            assert {segment_of[label] for label in labels} == {segment}


@pytest.mark.parametrize("name", PEOPLE)
def test_real_static_trials_have_the_markers(name: str, data_dir: Path) -> None:
    person = PEOPLE[name]
    recording = person.markers.renamed(read_recording(data_dir / person.file))
    optional = {"RUPA", "LUPA", "RFRM", "LFRM"}  # Plug-in Gait: placed by some laboratories
    needed = {
        label
        for labels in resolve_marker_set(person.markers, recording).landmarks.values()
        for label in labels
    }
    assert needed - {"RELM", "LELM"} <= set(recording.labels)
    assert set(resolve_marker_set(person.markers, recording).labels) - optional <= set(
        recording.labels
    )


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


def test_aliases_are_other_spellings(tmp_path: Path) -> None:
    made = load_marker_set(write(tmp_path, OWN))
    recording = Recording(
        source="f", time=np.arange(2.0), labels=("RTHIGH", "LTHI"), markers=np.zeros((2, 2, 3))
    )
    renamed = made.renamed(recording)
    assert renamed.labels == ("RTHI", "LTHI")
    assert renamed.notes == ("markers renamed: RTHIGH -> RTHI",)
    assert made.renamed(renamed) is renamed
    both = Recording(
        source="f", time=np.arange(2.0), labels=("RTHIGH", "RTHI"), markers=np.zeros((2, 2, 3))
    )
    assert made.renamed(both) is both


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "sacrum = ",
            "sakrum = ",
            "landmarks: found 'sakrum', which is no landmark; did you mean 'sacrum'?",
        ),
        (
            '"ankle_lat_{s}" = "{S}ANK"\n',
            "",
            "landmarks: 'ankle_lat_r' is missing: give a marker on the lateral mall",
        ),
        (
            '"thigh_{s}" =',
            '"tigh_{s}" =',
            "tracking: found 'tigh_r', which is no segment; did you mean 'thigh_r'",
        ),
        ('"thigh_{s}" =', '"talus_{s}" =', "tracking: found 'talus_r', which is no segment"),
        (
            '"{S}KNE"]',
            '"{S}ASI"]',
            "marker 'RASI' is on pelvis and on thigh_r; a marker is fixed in one segment",
        ),
        (
            '"{S}THI" = { w',
            '"{S}TH" = { w',
            "weights: found 'RTH', which is no tracked marker; did you mean 'RTHI'",
        ),
        ("weight = 0.5", "weight = -1", "weights.'{S}THI'.weight: found -1"),
        (', reason = "a wand"', "", "weights.'{S}THI'.reason: missing: why the weight is not 1"),
        ("[aliases]", "[alias]", "unknown key 'alias'; did you mean 'aliases'?"),
        ("RTHI = [", "RTIB = [", "aliases: found 'RTIB', which is no marker"),
        ('sacrum = ["RPSI", "LPSI"]', "sacrum = 1", "landmarks.sacrum: found 1; allowed: a list"),
        ('sacrum = ["RPSI", "LPSI"]', "sacrum = []", "landmarks.sacrum"),
        ("[tracking]", "[landmarks]", "not valid TOML"),
        ('"heel_{s}" = ', '"toe_{s}" = ', "not valid TOML"),
        (
            '"toe_{s}" = "{S}TOE"',
            '"toe_{s}" = "{S}TOE"\ntoe_r = "X"',
            "landmarks: 'toe_r' is given twice",
        ),
        (
            "plug-in-gait",
            "plugin-gait",
            "extends: found 'plugin-gait', which is no built-in marker set; did you mean",
        ),
        ("first_of", "fist_of", "did you mean 'first_of'?"),
        ('"{S}THI", "{S}TH2"', '"{S}TIB"', "marker 'RTIB' is on thigh_r and on shank_r"),
        (
            '"ours"',
            '"ours"\nknee_device.RKNE = ["A", "B"]',
            "knee_device: found 2 markers for 'RKNE'",
        ),
    ],
)
def test_mistakes_are_told_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = OWN if old in OWN else EXTENDED
    assert old in text
    path = write(tmp_path, text.replace(old, new, 1))
    said = refusal(load_marker_set, path)
    assert str(path) in said and message in said


def test_an_unknown_set_names_the_built_in_ones(tmp_path: Path) -> None:
    with refuses(InputError, *list_built_in_sets()):
        load_marker_set("gait2345")
    for missing in (tmp_path / "none.toml", "folder/none.toml"):
        with refuses(Code.NO_FILE, "none.toml"):
            load_marker_set(missing)


@pytest.mark.parametrize("name", list_built_in_sets())
def test_built_in_sets_come_back(name: str, tmp_path: Path) -> None:
    made = load_marker_set(name)
    path = tmp_path / f"{name}.toml"
    path.write_text(format_marker_set(made), encoding="utf-8")
    assert load_marker_set(path) == made


def test_weights_and_labels_of_a_study(tmp_path: Path) -> None:
    made = load_marker_set("published")
    tracked = next(iter(made.tracking.values()))[0]
    odd = 'a "b" \\ {x} é'
    made = replace(made, aliases={**made.aliases, tracked: (odd,)})
    made = made.with_weights({tracked: 0.25, "not tracked": 0.0})
    back = load_marker_set(write(tmp_path, format_marker_set(made)))
    assert back.weight(tracked) == 0.25 and back.reasons[tracked] == NO_REASON
    assert "not tracked" not in back.weights and back.aliases[tracked] == (odd,)


@pytest.mark.parametrize("name", list_built_in_sets())
def test_a_set_covers_its_own_labels_best_of_all(name: str) -> None:
    made = load_marker_set(name)
    labels = [
        label for group in (*made.tracking.values(), *made.landmarks.values()) for label in group
    ]
    found = made.coverage(dict.fromkeys(labels))
    assert found.complete and not found.unknown
    assert found.score == 2.0
    for other in list_built_in_sets():
        assert load_marker_set(other).coverage(labels).score <= found.score


def test_what_is_missing_and_left_over_is_named() -> None:
    made = load_marker_set("gait2354")
    labels = [label for label in made.labels if label not in ("V.Sacral", "L.Heel", "R.ASIS")]
    found = made.coverage([*labels, "Stranger"])
    assert found.required_missing == (
        "sacrum",
        "asis_r",
    )  # a heel alone may be missed, not both ends of a foot
    assert (found.bare, found.unknown, found.complete) == (("pelvis",), ("Stranger",), False)
    assert found.score < 1 < made.coverage([*labels, "V.Sacral", "R.ASIS", "Stranger"]).score


SAME = 1e-9
"""m; the same landmarks make the same joints, to rounding."""

WINDOW = slice(0, 50)
"""Frames of standing: the stillest depend on which markers there are."""

OURS = "ASIS PSIS LFE MFE LM SPH CAL TT2 MFH1 MFH5 THI1 THI2 THI3 LEG1 LEG2 LEG3"
"""What these laboratories share with the 73 markers that the person wore, without the side."""
THEIRS = {
    "ior": "{S}IAS {S}IPS {S}FLE {S}FME {S}FAL {S}TAM {S}FCC {S}FM2 {S}FM1 {S}FM5 "
    "{S}TH1 {S}TH2 {S}TH3 {S}SK1 {S}SK2 {S}SK3",
    "cast": "{S}_IAS {S}_IPS {S}_FLE {S}_FME {S}_FAL {S}_TAM {S}_FCC {S}_FM2 {S}_FM1 {S}_FM5 "
    "{S}_TH1 "
    "{S}_TH2 {S}_TH3 {S}_SK1 {S}_SK2 {S}_SK3",
    "visual3d": "{S}ASIS {S}PSIS {S}LK {S}MK {S}LA {S}MA {S}HEEL {S}TOE {S}MT1 {S}MT5 "
    "{S}TH1 {S}TH2 {S}TH3 {S}SK1 {S}SK2 {S}SK3",
    "opencap": "{s}.ASIS_study {s}.PSIS_study {s}_knee_study {s}_mknee_study {s}_ankle_study "
    "{s}_mankle_study "
    "{s}_calc_study {s}_toe_study - {s}_5meta_study {s}_thigh1_study {s}_thigh2_study "
    "{s}_thigh3_study "
    "{s}_sh1_study {s}_sh2_study "
    "{s}_sh3_study",
    "rajagopal": "{S}ASI {S}PSI {S}LFC {S}MFC {S}LMAL {S}MMAL {S}CAL {S}TOE - {S}MT5 {S}TH1 {S}TH2 "
    "{S}TH3 {S}TB1 "
    "{S}TB2 {S}TB3",
    "ufabc": "{S}.ASIS {S}.PSIS {S}.Knee {S}.Knee.Medial {S}.Ankle {S}.Ankle.Medial {S}.Heel "
    "{S}.MT2 {S}.MT1 {S}.MT5 "
    "{S}.GTR - - {S}.HF {S}.TT -",
    "plug-in-gait": "{S}ASI {S}PSI {S}KNE {S}KNM {S}ANK {S}MED {S}HEE {S}TOE {S}MT1 {S}MT5 {S}THI "
    "{S}THAP {S}THAD "
    "{S}TIB {S}TIAP {S}TIAD",
}


@pytest.mark.parametrize("name", THEIRS)
def test_the_same_person_under_their_labels(name: str, data_dir: Path) -> None:
    person = PEOPLE["functional"]
    recording = person.markers.renamed(person.static(data_dir))
    new: dict[str, str] = {}
    for side in "RL":
        small = "r" if side == "R" else "L"  # OpenCap's spelling
        for ours, theirs in zip(OURS.split(), THEIRS[name].split(), strict=True):
            new[side + ours] = theirs.replace("{S}", side).replace("{s}", small)
    kept = [i for i, label in enumerate(recording.labels) if new.get(label, "-") != "-"]
    legs = replace(
        recording,
        labels=tuple(new[recording.labels[i]] for i in kept),
        markers=recording.markers[:, kept],
    )
    marker_set = load_marker_set(name)
    found = marker_set.coverage(legs.labels)
    assert found.complete and not found.unknown
    model = nominal_model(legs, marker_set, person.subject, window=WINDOW)
    known = nominal_model(recording, person.markers, person.subject, window=WINDOW)
    for landmark in ("hjc", "kjc", "ajc", "heel", "toe"):
        for side in "rl":
            (segment, at), (same_segment, same_at) = (
                m.landmarks[f"{landmark}_{side}"] for m in (model, known)
            )
            assert segment == same_segment
            np.testing.assert_allclose(at, same_at, atol=SAME)
    assert {label for label in legs.labels if label in marker_set.tracked} <= set(
        model.markers.labels
    )
