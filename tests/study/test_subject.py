"""What files tell of the person where the study file says nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from gaitcal.errors import Code
from gaitcal.intake.draft_file import build_study, format_draft
from gaitcal.io.csv_recordings import write_markers_csv
from gaitcal.io.labels import Facts
from gaitcal.io.recording import Recording
from gaitcal.io.toml import validate_table
from gaitcal.study.study import Study, build_subject
from gaitcal.study.study_file import SubjectTable
from tests.intake.folders import SAID, draft, recordings, write
from tests.messages import check_text, refuses
from tests.real_studies import write_study
from tests.refusal import refusal

TABLE = SubjectTable(name="S07", mass_kg=70, height_m=1.8, sex="male")


def told(**facts: Any) -> Recording:
    shown = {"time": np.arange(2.0), "labels": ("A",), "markers": np.zeros((2, 1, 3))}
    return Recording(source="f", facts=Facts(**facts), **shown)


def test_the_study_comes_first_then_the_first_file_that_tells_and_never_another_person() -> None:
    files = [
        told(name="P1", knee_width={"r": 0.11}),
        told(
            name="P1", knee_width={"r": 0.12, "l": 0.12}, marker_diameter=0.010, asis_distance=0.245
        ),
    ]
    of_files = build_subject(TABLE, files)
    known = (of_files.knee_width, of_files.marker_diameter, of_files.asis_distance)
    assert known == ({"r": 0.11, "l": 0.12}, 0.010, 0.245)
    said = {"knee_width_mm": {"r": 105.0}, "marker_diameter_mm": 9.0, "asis_distance_mm": 230.0}
    of_study = build_subject(TABLE.model_copy(update=said), files)
    assert of_study.knee_width == pytest.approx({"r": 0.105, "l": 0.12})
    assert (of_study.marker_diameter, of_study.asis_distance) == pytest.approx((0.009, 0.230))
    assert not build_subject(
        TABLE, [told(name="P1"), told(name="P2", knee_width={"r": 0.12})]
    ).knee_width


def test_dates_come_from_the_study_else_from_the_files_and_give_the_age() -> None:
    said = TABLE.model_copy(update={"birth_date": "2006-03-01", "diagnosis": "CP"})
    subject = build_subject(
        said, [told(session_date="2016-03-01", birth_date="1999-01-01", leg_length={"r": 0.71})]
    )
    assert subject.age == pytest.approx(10.0, abs=0.01) and subject.leg_length == {"r": 0.71}
    known = {"birth_date": "2006-03-01", "session_date": "2016-03-01", "diagnosis": "CP"}
    assert subject.record.known == known
    assert build_subject(said, []).age is None, "never by the day of the computation"
    for wrong in ({"age_years": 12.0}, {"birth_date": "2017-01-01"}):
        table = said.model_copy(update={"session_date": "2016-03-01", **wrong})
        with refuses(Code.BAD_VALUE, field="subject.birth_date"):
            build_subject(table, [])


@pytest.mark.parametrize(
    ("born", "said", "age", "told_too"),
    [
        ("2006-03-20", None, 9.9, ""),
        ("2006-03-20", 9.5, 9.5, ""),
        ("1900-01-01", None, None, "make an age of 116.2 years: no age is known"),
        ("2020-01-01", None, None, "make an age of -3.8 years: no age is known"),
        ("1999-01-01", 10.0, 10.0, "make an age of 17.2 years: age_years = 10 counts"),
    ],
)
def test_a_date_of_birth_of_a_file_gives_an_age_that_can_be_and_nothing_else(
    born: str, said: float | None, age: float | None, told_too: str, tmp_path: Path
) -> None:
    """Neither the person nor a drafted study has the date; one that cannot be is a note, no fault
    of the study.
    """
    folder = write(tmp_path, recordings())
    facts = Facts(session_date="2016-03-01", birth_date=born)
    write_markers_csv(folder / "static.csv", replace(recordings()["static"], facts=facts))
    made = draft(folder, replace(SAID, age=said))
    drafted = format_draft(made, folder)
    study = build_study(made)
    assert (study.subject.age, study.subject.record.birth_date) == (age, "")
    assert born not in drafted and ("# age_years =" in drafted) == (age is None)
    notes = [note for note in study.static.recording.notes if "make an age" in note]
    assert (told_too in notes[0]) if told_too else not notes
    assert (
        build_subject(TABLE.model_copy(update={"age_years": said}), [told(**vars(facts))]).age
        == age
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("birth_date", "1.3.2006"),
        ("session_date", 2016),
        ("affected_side", "links"),
        ("diagnosis", "a\nb"),
        ("leg_length_mm", 0.71),
    ],
)
def test_what_a_clinic_writes_down_is_checked(field: str, value: object, tmp_path: Path) -> None:
    table = {**TABLE.model_dump(exclude_none=True, exclude_defaults=True), field: value}
    with refuses(Code.BAD_VALUE, field):
        validate_table(SubjectTable, table, tmp_path)


@pytest.mark.parametrize(
    ("field", "value", "unit"),
    [
        ("knee_width_mm", 10.5, "centimetres: 105 mm"),
        ("ankle_width_mm", {"r": 0.07, "l": 70}, "metres: 70 mm"),
        ("marker_diameter_mm", 0.014, "metres: 14 mm"),
        ("asis_distance_mm", 24.5, "centimetres: 245 mm"),
        ("knee_width_mm", 900, ""),
        ("marker_diameter_mm", True, ""),
    ],
)
def test_lengths_in_another_unit_are_refused_and_the_unit_named(
    field: str, value: object, unit: str
) -> None:
    with pytest.raises(ValidationError) as fault:
        SubjectTable(**{**TABLE.model_dump(), field: value})
    assert (f"this looks like {unit}" in str(fault.value)) is bool(unit)
    assert " mm" in str(fault.value) and "allowed: " in str(fault.value)


def test_a_height_that_nobody_says_is_that_of_people_with_such_legs(
    data_dir: Path, tmp_path: Path
) -> None:
    def loaded(name: str, *gone: str) -> Study:
        path = write_study(name, data_dir, tmp_path)
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text(
            "\n".join(line for line in lines if not line.startswith(gone)), encoding="utf-8"
        )
        return Study.load(path)

    study = loaded("subject01", "height_m")
    person = study.subject
    assert (
        0.03 < person.height_error < 0.12 and abs(person.height - 1.803) < 2.0 * person.height_error
    )
    check_text(study.static.recording.notes)
    said = loaded("pig_c3d", "height_m").subject
    assert (said.height, said.height_error) == (1.79, 0.0), "its C3D file says it"
    assert "mass_kg" in refusal(loaded, "subject01", "mass_kg")
