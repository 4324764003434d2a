"""`events.csv`: what a person corrected wins over file, plates and motion; every fault names file,
line, field.
"""

from pathlib import Path

import pytest

from gaitcal.errors import Code
from gaitcal.intake.draft_file import build_study
from gaitcal.intake.recordings_folder import FileKind, read_folder
from gaitcal.io.csv_recordings import EVENT_FILE, apply_corrected_events, write_markers_csv
from gaitcal.io.labels import FootEvent, FootMoment
from tests.commands import refused
from tests.intake.folders import draft, recordings, write
from tests.io.recordings import body
from tests.messages import check_text, refuses

HEAD = "file,time,side,event\n"


def folder_with(folder: Path, rows: str, head: str = HEAD) -> Path:
    write_markers_csv(folder / "walk.csv", body())  # 0 to 0.49 s
    (folder / EVENT_FILE).write_text(head + rows, encoding="utf-8")
    return folder / "walk.csv"


def test_rows_are_events_in_order_of_time_and_others_stay(tmp_path: Path) -> None:
    walk = folder_with(
        tmp_path, "walk.csv,0.4,left,foot off\n\nwalk.csv, 0.125 ,right,foot strike\n"
    )
    recording = apply_corrected_events(body(), walk)
    strike, off = FootEvent(FootMoment.STRIKE, "r", 0.125), FootEvent(FootMoment.OFF, "l", 0.4)
    assert recording.events == (strike, off) and recording.corrected
    check_text(recording.notes[-1], "events.csv", 2)
    assert not apply_corrected_events(body(), tmp_path / "other.csv").corrected
    (tmp_path / EVENT_FILE).unlink()
    assert not apply_corrected_events(body(), walk).corrected


@pytest.mark.parametrize(
    "rows, told",
    [
        ("walk.csv,0.4,l,foot off\n", "line 2, side: found 'l'; allowed: right, left"),
        (
            "walk.csv,0.4,left,toe off\n",
            "line 2, event: found 'toe off'; allowed: foot strike, foot off",
        ),
        ("walk.csv,nan,left,foot off\n", "line 2, time: found 'nan'; allowed: a number, in s"),
        ("walk.csv,0.5,left,foot off,by eye\n", "line 2: found 5 cells; 4 are needed"),
        (
            "\nrun.csv,0.4,left,foot off\n",
            "line 3, file: found 'run.csv'; allowed: the name of a recording in this",
        ),
        ("../walk.csv,0.4,left,foot off\n", "line 2, file: found '../walk.csv'"),
        (
            "walk.csv,0.4,left,foot off\nwalk.csv,0.40,left,foot off\n",
            "line 3, time: found '0.40'; allowed: each",
        ),
        (
            "walk.csv,0.4,left,foot off\nwalk.csv,7,left,foot off\n",
            "line 3, time: found 7; allowed: 0 to 0.49 s",
        ),
    ],
)
def test_a_fault_names_file_line_and_field(tmp_path: Path, rows: str, told: str) -> None:
    walk = folder_with(tmp_path, rows)
    with refused(f"{tmp_path / EVENT_FILE}: {told}"):
        apply_corrected_events(body(), walk)


def test_what_a_spreadsheet_adds_does_no_harm(tmp_path: Path) -> None:
    rows = "walk.csv,0.125,Right,Foot Strike,,\n,,,\n,,,,,\nwalk.csv,0.4,LEFT,foot off\n"
    recording = apply_corrected_events(
        body(), folder_with(tmp_path, rows, head="File,time,side,event,,\n")
    )
    assert [(e.moment, e.side, e.time) for e in recording.events] == [
        (FootMoment.STRIKE, "r", 0.125),
        (FootMoment.OFF, "l", 0.4),
    ]


def test_a_table_of_another_program_is_told_and_not_used_and_one_that_is_meant_as_ours_stops(
    tmp_path: Path,
) -> None:
    folder = write(tmp_path, recordings())
    (folder / EVENT_FILE).write_text("frame,event\n12,RHS\n", encoding="utf-8")
    made = draft(folder)
    [row] = [row for row in made.left_out if row.name == EVENT_FILE]
    check_text(row.reason, "file,time,side,event")
    study = build_study(made)
    walk = next(trial for trial in study.trials if trial.name == "walk")
    assert not walk.recording.corrected and EVENT_FILE not in study.inputs
    check_text(walk.recording.notes, "events.csv")
    (folder / EVENT_FILE).write_text(
        "file;time;side;event\nwalk.csv;0,5;right;foot strike\n", encoding="utf-8"
    )
    with refuses(Code.FILE_FORMAT, "file,time,side,event", field="line 1", source="events.csv"):
        build_study(made)


def test_a_study_of_a_folder_uses_it_and_has_its_hash(tmp_path: Path) -> None:
    folder = write(tmp_path, recordings())
    (folder / EVENT_FILE).write_text(f"{HEAD}walk.csv,0.5,right,foot strike\n", encoding="utf-8")
    read = read_folder(folder)
    assert [file.name for file in read.select_kind(FileKind.EVENTS)] == [EVENT_FILE]
    made = draft(folder)
    assert [row.used for row in made.rows if row.name == EVENT_FILE] == [
        "foot events of the recordings that it names"
    ]
    study = build_study(made)
    static, walk = study.static, next(trial for trial in study.trials if trial.name == "walk")
    assert [event.time for event in walk.recording.events] == [0.5] and walk.recording.corrected
    assert not static.recording.corrected
    assert EVENT_FILE in study.inputs and study.input_names(walk)["events"] == EVENT_FILE
