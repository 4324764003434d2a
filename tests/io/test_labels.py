"""Which labels are markers and how they are spelt; what a C3D file says of the person and of foot
events.
"""

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from gaitcal.errors import Code
from gaitcal.io.formats import read_recording
from gaitcal.io.labels import (
    Facts,
    FootEvent,
    FootMoment,
    find_common_prefix,
    find_computed_points,
    number_repetitions,
    parse_events,
    parse_facts,
)
from tests.io.recordings import standing_points_mm, write_raw_c3d
from tests.messages import check_text, refuses


def read(
    folder: Path, labels: list[str], **more: object
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    path = write_raw_c3d(
        folder / "labels.c3d", standing_points_mm(5)[:, : len(labels)], labels, **more
    )
    recording = read_recording(path)
    assert recording.markers.shape == (5, len(recording.labels), 3)
    return recording.labels, recording.notes


def test_a_common_prefix_goes_and_is_told(tmp_path: Path) -> None:
    labels, notes = read(tmp_path, ["Anna:LASI", "Anna:RASI", "Anna:C7", "*12"])
    assert labels == ("LASI", "RASI", "C7")
    check_text(notes, "Anna:")
    check_text(notes, 1)


def test_computed_points_go_by_the_files_own_lists_and_by_their_spelling(tmp_path: Path) -> None:
    lists = {"TYPE_GROUPS": ["MINE", "MINE"], "MINE": ["Odd"], "ANGLES": ["Tilt"]}
    labels, notes = read(
        tmp_path,
        ["LASI", "Odd", "Tilt", "PELO", "PELA", "PELL", "PELP", "LKneeMoment"],
        point_lists=lists,
    )
    assert labels == ("LASI",)
    check_text(notes)


@pytest.mark.parametrize(
    ("labels", "computed"),
    [
        (
            "PELO PELA PELL LTOA LHEE",
            "",
        ),  # LTOA alone may be a marker's name; so may any three of the four
        ("pelo pela pell pelp ltoa", "pelo pela pell pelp"),
        *[("CentreOfMass CentreOfMassFloor LHJC LKneeAngles RGroundReactionForce",) * 2],
        (
            "LASI RASI SACR LTHI LKNE LTIB LANK LHEE LTOE RMED R.Knee.Lat V.Sacral L_Toe "
            "R_Shank_Superior LFHD LRAR",
            "",
        ),
    ],
    ids=["parts of a set", "a whole set", "by their spelling", "markers of real sets"],
)
def test_only_whole_sets_of_segment_points_are_taken_for_such(labels: str, computed: str) -> None:
    assert find_computed_points(labels.split()) == set(computed.split())


def test_only_computed_points_is_an_error(tmp_path: Path) -> None:
    with refuses(Code.FILE_FORMAT, source="labels.c3d"):
        read(tmp_path, ["LKneeAngles", "RKneeAngles"])


def test_unique_never_makes_a_name_that_is_taken_and_a_prefix_needs_a_rest() -> None:
    names, notes = number_repetitions(["X", "X", "X#2", "X"])
    assert names == ("X", "X#3", "X#2", "X#4")
    assert notes == ("Marker names that occur more than once were numbered: X#3, X#4.",)
    for labels, prefix in ((["A:", "A:B"], ""), (["A:B", "C"], ""), (["A:B"], "A:")):
        assert find_common_prefix(labels)[0] == prefix


LABELS = [f"M{i}" for i in range(8)]
SINGLE = 1e-6
"""Relative: the file keeps numbers in single precision."""


def file_with(path: Path, **groups: dict[str, Any]) -> Path:
    """A standing person's file with further groups of parameters."""
    write_raw_c3d(path, standing_points_mm(5), LABELS)
    file = ezc3d.c3d(str(path))
    for group, parameters in groups.items():
        for name, value in parameters.items():
            file.add_parameter(group, name, value)
    file.write(str(path))
    return path


def events(labels: list[Any], contexts: list[Any], times: Any) -> tuple[FootEvent, ...]:
    return parse_events({"EVENT": {"LABELS": labels, "CONTEXTS": contexts, "TIMES": times}})


def test_events_come_with_side_in_order_of_time(tmp_path: Path) -> None:
    path = file_with(
        tmp_path / "e.c3d",
        EVENT={
            "LABELS": ["Foot Off", "Foot Strike", "Foot Strike"],
            "CONTEXTS": ["Left", "Right", "Left"],
            "TIMES": np.array([[0.0, 1.0, 0.0], [2.5, 3.25, 1.75]]),
        },
    )
    assert read_recording(path).events == (
        FootEvent(FootMoment.STRIKE, "l", 1.75),
        FootEvent(FootMoment.OFF, "l", 2.5),
        FootEvent(FootMoment.STRIKE, "r", 63.25),
    ), "minutes count"


@pytest.mark.parametrize("word", ["Heel Strike", "FOOT STRIKE", " foot strike ", "Initial Contact"])
def test_strikes_by_other_names(word: str) -> None:
    assert events([word], ["RIGHT"], [[0.0], [1.0]]) == (FootEvent(FootMoment.STRIKE, "r", 1.0),)


@pytest.mark.parametrize(
    "labels, contexts, times",
    [
        (["Event"], ["General"], [[0.0], [1.0]]),
        (["Foot Strike"], ["General"], [[0.0], [1.0]]),
        (["Foot Strike"], ["Left"], [[0.0], [np.nan]]),
        (["Foot Strike"], ["Left"], [[1.0], [1.0], [1.0]]),
        (["Foot Strike"], [], [[0.0], [1.0]]),
        ([7], ["Left"], [[0.0], [1.0]]),
    ],
)
def test_what_is_no_foot_event_is_none(labels: list[Any], contexts: list[Any], times: Any) -> None:
    assert events(labels, contexts, times) == ()


def test_facts_are_metres_kilograms_and_radians(tmp_path: Path) -> None:
    numbers = {
        "Bodymass": 61.5, "Height": 1655.0, "RKneeWidth": 104.0, "LKneeWidth": 102.0,
        "RAnkleWidth": 71.0,
        "LLegLength": 870.0, "InterAsisDistance": 241.0, "MarkerDiameter": 14.0,
        "RStaticPlantFlex": 0.05,
    }  # fmt: skip
    path = file_with(
        tmp_path / "p.c3d",
        PROCESSING={name: [value] for name, value in numbers.items()},
        SUBJECTS={"NAMES": ["Anna  "], "MARKER_SETS": ["PlugInGait"], "IS_STATIC": [1]},
    )
    facts = read_recording(path).facts
    assert (facts.name, facts.marker_set, facts.is_static) == ("Anna", "PlugInGait", True)
    assert (facts.mass, facts.height) == pytest.approx((61.5, 1.655), rel=SINGLE)
    assert facts.knee_width == pytest.approx({"r": 0.104, "l": 0.102}, rel=SINGLE)
    assert facts.ankle_width == pytest.approx({"r": 0.071}, rel=SINGLE)
    assert facts.leg_length == pytest.approx({"l": 0.87}, rel=SINGLE)
    assert facts.static_plantarflexion == pytest.approx({"r": 0.05}, rel=SINGLE)
    assert (facts.asis_distance, facts.marker_diameter) == pytest.approx((0.241, 0.014), rel=SINGLE)


@pytest.mark.parametrize("value", [[0.0], [-3.0], [np.nan], [np.inf], ["n/a"], [], None, [4e7]])
def test_forms_that_nobody_filled_in_say_nothing(value: Any) -> None:
    names = (
        "Bodymass",
        "Height",
        "RKneeWidth",
        "LAnkleWidth",
        "RLegLength",
        "MarkerDiameter",
        "InterAsisDistance",
    )
    assert parse_facts({"PROCESSING": dict.fromkeys(names, value)}) == Facts()


@pytest.mark.parametrize("given, height", [(1780.0, 1.78), (1.78, 1.78), (0.9, 0.9), (178.0, None)])
def test_heights_in_millimetres_or_metres(given: float, height: float | None) -> None:
    assert parse_facts({"PROCESSING": {"HEIGHT": [given]}}).height == (
        None if height is None else pytest.approx(height)
    )


@pytest.mark.parametrize(
    "file",
    [
        "pig_c3d/gait.c3d",
        "labs_c3d/multi/walk04.c3d",
        "labs_c3d/kad/walk.c3d",
        "children/HC030A/straight.c3d",
    ],
)
def test_strikes_of_real_files_lie_on_the_clock_of_the_plates(data_dir: Path, file: str) -> None:
    """At least one plate becomes loaded within 10 ms of a strike of the file: no clock is wrong by
    a frame.
    """
    recording = read_recording(data_dir / file)
    begins = [
        p.time[1:][(p.force[1:, 1] > 20.0) & ~(p.force[:-1, 1] > 20.0)] for p in recording.plates
    ]
    strikes = [e.time for e in recording.events if e.moment is FootMoment.STRIKE]
    assert min(abs(t - s) for plate in begins for t in plate for s in strikes) < 0.01


@pytest.mark.parametrize(
    ("name", "value", "fact", "words", "meant"),
    [
        ("Height", 179.0, "height", "no height in mm or m; 1.79 m if cm", 1.79),
        ("Height", 70.0, "height", "0.7 m if cm or 1.778 m if inches", None),
        ("Bodymass", 652.4, "mass", "no mass in kg; 66.53 kg if N", 66.53),
        ("RKneeWidth", 12.0, "knee_width_r", "no width in mm; 0.12 m if cm", 0.12),
        (
            "LLegLength",
            100.0,
            "leg_length_l",
            "no length in mm; 1 m if cm",
            1.0,
        ),  # the study file refuses 100 mm
    ],
)
def test_figures_in_other_units_are_kept_and_told(
    name: str, value: float, fact: str, words: str, meant: float | None
) -> None:
    facts = parse_facts({"PROCESSING": {name: [value]}})
    assert facts.height is facts.mass is None and facts.knee_width == facts.leg_length == {}
    told, guess = facts.doubtful[fact]
    assert told.startswith(f"{name} = {value:g}: ") and words in told
    assert guess == (None if meant is None else pytest.approx(meant, rel=1e-3))
    assert parse_facts({"PROCESSING": {name: [0.0]}}).doubtful == {}, (
        "0 stands where nobody filled in the form"
    )


@pytest.mark.parametrize(
    ("text", "day"), [("2016-03-09", "2016-03-09"), ("20160309", "2016-03-09"), ("6/14/35", None)]
)
def test_a_date_is_read_where_it_can_be_read_in_one_way_only(text: str, day: str | None) -> None:
    facts = parse_facts({"TRIAL": {"DATE": [text]}, "SUBJECT": {"DATE_OF_BIRTH": [text]}})
    assert (facts.session_date, facts.birth_date) == (day, day)
