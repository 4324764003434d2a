"""Who belongs to a cohort, and its run with stubs: what is run again and why, what the tables hold,
what fails.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from gaitcal.cohort import outcome as tasks
from gaitcal.cohort.cohort_page import PAGE
from gaitcal.cohort.cohort_people import (
    CohortPerson,
    find_people,
    make_safe_name,
    read_cohort,
    read_sheet,
)
from gaitcal.cohort.one_person import COLUMNS, NAMES, CommonSettings
from gaitcal.cohort.outcome import (
    Outcome,
    Task,
    compute_fingerprint,
    get_state_path,
    list_input_files,
    write_outcome,
)
from gaitcal.cohort.run_cohort import (
    CYCLES,
    FAILURES,
    MOST_MIB,
    PEOPLE_CSV,
    PEOPLE_PARQUET,
    make_processes,
    run_cohort,
)
from gaitcal.errors import Code
from gaitcal.intake.draft_file import format_settings
from gaitcal.io.atomic import convert_disk_errors
from tests.cohort.stubs import MASS, Here, of_a_process, rows, run, strides, write_result
from tests.intake.folders import recordings, write
from tests.messages import check_text, refuses

SAME = (PEOPLE_CSV, PEOPLE_PARQUET, CYCLES, FAILURES, PAGE, "manifest.json")


def test_tables(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    ended = run(lab, out)
    assert [e.verdict for e in ended] == ["doubtful", "doubtful", "failed", "failed"]
    ann = rows(out / PEOPLE_CSV)[0]
    assert list(ann) == list(NAMES)
    assert (ann["person"], ann["folder"], ann["first_cause"]) == (
        "Ann",
        "people/Ann",
        'a "heel", moved',
    )
    assert (ann["verdict_r"], ann["verdict_l"], ann["walks_refused_l"]) == (
        "trustworthy",
        "refused",
        "2",
    )
    assert float(ann["marker_rms_calibrated_mm"]) == pytest.approx(
        np.sqrt((100 * 9 + 300) / 400), abs=1e-6
    )
    assert float(ann["residual_force_calibrated_N"]) == 20.0
    assert (float(ann["residual_force_limit_N"]), float(ann["residual_moment_limit_Nm"])) == (
        35.0,
        9.0,
    )
    assert float(ann["speed_r"]) == 1.25
    assert ann["speed_l"] == ""
    assert float(ann["knee_extension_moment_r"]) == pytest.approx(-40.0 / MASS, abs=1e-6), (
        "loads are by mass"
    )
    assert float(ann["knee_extension_moment_se_r"]) == pytest.approx(1.5 / MASS, abs=1e-6)
    assert (ann["knee_flexion_swing_r"], ann["knee_flexion_swing_se_r"]) == ("51.5", "2.0")
    assert ann["knee_flexion_swing_l"] == ann["hip_flexion_moment_r"] == ""  # no such peak
    parquet = pq.read_table(out / PEOPLE_PARQUET)
    assert parquet.column_names == list(NAMES)
    assert parquet["speed_r"].to_pylist() == [1.25, 1.25]
    cycles = pq.ParquetFile(out / CYCLES)
    assert (cycles.num_row_groups, cycles.metadata.num_rows) == (2, 2 * len(strides("Ann")))
    assert rows(out / FAILURES) == [
        {"person": "Yan", "session": "", "group": "", "folder": "Yan"}
        | {
            "code": "GC-240",
            "cause": "internal error: ZeroDivisionError: by zero",
            "what_to_do": "please report it",
        },
        {"person": "Zed", "session": "", "group": "", "folder": "Zed"}
        | {
            "code": "GC-040",
            "cause": "the static trial is restless",
            "what_to_do": "record it again",
        },
    ]
    assert [
        (row["person"], row["activity"], row["mean"]) for row in rows(out / "activity_peaks.csv")
    ] == [(person, "squat", "-40.0") for person in ("Ann", "Bob")]
    assert [row["column"] for row in rows(out / "columns.csv")] == [
        column.name for column in COLUMNS
    ]


@pytest.mark.slow
def test_a_process_that_has_grown_large_is_replaced_at_once() -> None:
    for mebibytes, count in ((MOST_MIB + 1.0, 3), (MOST_MIB - 1.0, 1)):
        ended = make_processes(1).run(of_a_process, [mebibytes] * 3)
        assert len({outcome.name for outcome in ended}) == count


def test_only_what_changed_is_run_again(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    run(lab, out)
    before = {name: (out / name).read_bytes() for name in SAME}
    ran.clear()
    assert not any(e.computed for e in run(lab, out))
    assert ran == []
    assert {name: (out / name).read_bytes() for name in SAME} == before
    (lab / "Ann" / "notes.txt").write_text("no recording")
    (lab / "Bob" / "walk.c3d").write_text("another walk")
    run(lab, out)
    assert ran == ["Bob"]
    run(lab, out, retry=True)
    assert ran == ["Bob", "Yan", "Zed"]
    (out / "people" / "Ann" / "manifest.json").unlink()
    run(lab, out)
    assert ran[3:] == ["Ann"]


def test_a_group_is_no_reason_to_calibrate(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    run(lab, out)
    ran.clear()
    (lab / "people.csv").write_text("person,group\nBob,controls\n")
    run_cohort(read_cohort(lab, out)[0], out, engine=Here())
    assert ran == []
    assert [row["group"] for row in rows(out / PEOPLE_CSV)] == ["", "controls"]
    assert set(pq.read_table(out / CYCLES)["group"].to_pylist()) == {"", "controls"}
    (lab / "people.csv").write_text("person,mass_kg\nBob,61\n")
    run_cohort(read_cohort(lab, out)[0], out, engine=Here())
    assert ran == ["Bob"]


def test_order_and_interruption_do_not_show(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    run(lab, one)
    run(lab, other, backwards=True)
    get_state_path(
        other, "people/Ann", ".json"
    ).unlink()  # killed after the strides, before it was done
    get_state_path(other, "people/Bob", ".json").write_text('{"cut off')
    run(lab, other)
    assert ran[8:] == ["Ann", "Bob"]
    for name in SAME:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_lost_worker_is_tried_again_by_the_next_run(
    lab: Path, tmp_path: Path, ran: list[str]
) -> None:
    class Lost(Here):
        def run(
            self,
            function: Callable[[Task], Outcome],
            tasks: Iterator[Task],
            lost: Callable[[Task, str], Outcome],
        ) -> Iterator[Outcome]:
            first, *others = tasks
            yield lost(first, "ended by SIGKILL, 3 times")
            yield from map(function, others)

    out = tmp_path / "out"
    run_cohort(find_people(lab, out), out, engine=Lost())
    assert "its worker process died: ended by SIGKILL, 3 times" in (out / FAILURES).read_text()
    run(lab, out)
    assert ran[-1] == "Ann"
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Ann", "Bob"]


def test_another_folder_is_left_alone(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    with refuses(Code.FOLDER_TAKEN, "thesis.txt", source="mine"):
        run(lab, tmp_path / "mine")
    assert ran == []


def test_every_failure_has_a_code(tmp_path: Path) -> None:
    lab, out = tmp_path / "lab", tmp_path / "out"
    for name in ("broken", "nobody's"):
        (lab / name).mkdir(parents=True)
        (lab / name / "walk.c3d").write_bytes(b"no recording")
    write(lab / "unknown", recordings(), forces="grf")
    run(lab, out)
    failures = rows(out / FAILURES)
    assert [row["code"] for row in failures] == ["GC-223", "GC-223", "GC-211"]
    for row in failures:
        assert row["what_to_do"]
        check_text(row["cause"], 1 if row["code"] == "GC-223" else "subject.mass_kg")


LONG = "\U00020000"
"""A letter of four bytes."""


def test_who_cannot_be_kept_is_a_failure(
    lab: Path, tmp_path: Path, ran: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when Ann has ended, and when Zed has failed."""
    out = tmp_path / "out"
    run(lab, out)
    (lab / "Ann" / "walk.c3d").write_text("another walk")

    def full(folder: Path, outcome: Outcome) -> None:
        if outcome.name in ("Ann", "Zed"):
            with convert_disk_errors(folder / outcome.place):
                raise OSError(ENOSPC, "No space left on device")
        write_outcome(folder, outcome)

    monkeypatch.setattr(tasks, "write_outcome", full)
    ended = run(lab, out, retry=True)
    assert [e.verdict for e in ended] == ["failed", "doubtful", "failed", "failed"]
    ann, _, zed = rows(out / FAILURES)
    assert (ann["person"], ann["code"]) == ("Ann", "GC-230")
    check_text(ann["cause"])
    check_text(zed["cause"])
    assert "No space left on device" in (out / PAGE).read_text(encoding="utf-8")
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Bob"]
    monkeypatch.undo()
    monkeypatch.setattr(
        tasks, "calibrate_person", lambda person, out, common: write_result(person, out, common)
    )
    run(lab, out)
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Ann", "Bob", "Zed"]


def test_nobody_is_left_out_of_the_tables(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    class Forgetful(Here):
        def run(
            self,
            function: Callable[[Task], Outcome],
            tasks: Iterator[Task],
            lost: Callable[[Task, str], Outcome],
        ) -> Iterator[Outcome]:
            for task in tasks:
                yield function(task)
                get_state_path(task.out, "people/Bob", ".json").unlink(missing_ok=True)

    out = tmp_path / "out"
    written = run_cohort(find_people(lab, out), out, engine=Forgetful())
    assert written == {"doubtful": 1, "failed": 3}
    assert [row["person"] for row in rows(out / FAILURES)] == ["Bob", "Yan", "Zed"]
    check_text(rows(out / FAILURES)[0]["cause"])


def test_a_name_of_many_bytes_is_a_line_of_the_tables(lab: Path, tmp_path: Path) -> None:
    (lab / "people.csv").write_text(f"person\n{70 * LONG}\n", encoding="utf-8")
    out = tmp_path / "out"
    cohort = read_cohort(lab, out)[0]
    one = replace(
        cohort, people=tuple(person for person in cohort.people if person.name.startswith(LONG))
    )
    assert run_cohort(one, out, engine=Here()) == {"failed": 1}
    (line,) = rows(out / FAILURES)
    assert (line["person"], line["code"]) == (70 * LONG, "GC-223")
    check_text(line["cause"])


STUDY = """
[subject]
name = "Ann"
mass_kg = 60
height_m = 1.7
sex = "female"

[markers]
set = "../../sets/own.toml"

[[trial]]
name = "static"
role = "static"
file = "data/raw/static.c3d"

[[trial]]
name = "walk"
role = "gait"
file = "../shared/walk.trc"
forces = "data/raw/loads.xml"
"""
LOADS = '<ExternalLoads><ExternalForce name="r"/><datafile>forces.mot</datafile></ExternalLoads>'
NAMED = (
    "data/raw/static.c3d",
    "../shared/walk.trc",
    "data/raw/loads.xml",
    "data/raw/forces.mot",
    "../../sets/own.toml",
)


@pytest.fixture(params=["study.toml", "before.toml"])
def ann(request: pytest.FixtureRequest, tmp_path: Path) -> CohortPerson:
    folder = tmp_path / "lab" / "Ann"
    folder.mkdir(parents=True)
    (folder / request.param).write_text(STUDY)
    for name in NAMED:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(LOADS if path.suffix == ".xml" else name)
    return CohortPerson(folder=folder, name="Ann")


@pytest.mark.parametrize("name", NAMED)
def test_every_file_that_a_study_names_counts(ann: CohortPerson, name: str) -> None:
    first = compute_fingerprint(ann, CommonSettings())
    path = ann.folder / name
    kept = path.read_bytes()
    path.write_bytes(kept + b" ")
    changed = compute_fingerprint(ann, CommonSettings())
    path.unlink()
    missing = compute_fingerprint(ann, CommonSettings())
    assert len({first, changed, missing}) == 3
    path.write_bytes(kept)
    assert compute_fingerprint(ann, CommonSettings()) == first


def test_no_file_counts_twice(ann: CohortPerson) -> None:
    (ann.folder / "notes.txt").write_text("no recording")
    files = list_input_files(ann.folder)
    whole = [path.resolve() for path in files.values()]
    assert len(set(whole)) == len(whole) == len(NAMED) + 1
    assert "../shared/walk.trc" in files
    assert "data/raw/static.c3d" in files


def test_a_draft_reads_tables_that_an_xml_names(tmp_path: Path) -> None:
    folder = tmp_path / "Bob"
    (folder / "deep" / "tables").mkdir(parents=True)
    (folder / "deep" / "loads.xml").write_text(LOADS.replace("forces.mot", "tables/forces.mot"))
    (folder / "deep" / "tables" / "forces.mot").write_text("1")
    (folder / "deep" / "tables" / "other.mot").write_text("2")
    assert set(list_input_files(folder)) == {"deep/loads.xml", "deep/tables/forces.mot"}


def test_joint_parameters_that_a_cohort_file_expects_are_known_ones(tmp_path: Path) -> None:
    (tmp_path / "Ann").mkdir()
    file = tmp_path / "cohort.toml"
    text = (
        '[[person]]\nfolder = "Ann"\n[calibration.joint_prior]\n"hip.pelvis.NAME" = { mean = -7 }\n'
    )
    file.write_text(text.replace("NAME", "ant"))
    assert read_cohort(file, tmp_path / "out")[1].joint_prior["hip.pelvis.ant"].mean == -7.0
    file.write_text(text.replace("NAME", "front"))
    with refuses(
        Code.UNKNOWN_FIELD,
        "hip.pelvis.front",
        field="calibration.joint_prior",
        source="cohort.toml",
    ):
        read_cohort(file, tmp_path / "out")


def put(*files: Path) -> None:
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two people, one of them with two sessions; a result, a hidden folder, and one without
    recordings.
    """
    here = tmp_path / "lab"
    put(here / "Ann" / "static.c3d", here / "Ann" / "walk.C3D", here / "Ann" / "raw" / "old.trc")
    for session in ("post", "pre"):
        put(here / "Bob" / session / "static.trc", here / "Bob" / session / "walk.trc")
    put(
        here / "notes" / "readme.txt",
        here / ".hidden" / "walk.c3d",
        here / "out" / "deep" / "walk.c3d",
    )
    put(here / "earlier" / "walk.c3d")
    (here / "earlier" / "manifest.json").write_text(json.dumps({"gaitcal": "0.2.0"}))
    return here


def keys(path: Path, out: Path) -> list[tuple[str, str]]:
    return [person.key for person in read_cohort(path, out)[0].people]


def test_folders_are_people_and_complete_folders_in_them_sessions(
    folder: Path, tmp_path: Path
) -> None:
    cohort = find_people(folder, folder / "out")
    assert [p.key for p in cohort.people] == [("Ann", ""), ("Bob", "post"), ("Bob", "pre")]
    assert [p.subfolder for p in cohort.people] == [
        "people/Ann",
        "people/Bob/post",
        "people/Bob/pre",
    ]
    assert cohort.people[1].options.name == "Bob"  # not the session, which the folder is called
    assert cohort.ignored == ("notes",)
    (folder / "people.csv").write_text("person,session\nAnn,2024-01-31\n", encoding="utf-8")
    assert keys(folder, folder / "out")[0] == ("Ann", "2024-01-31"), (
        "the table names an only session"
    )
    parts = tmp_path / "parts"
    put(parts / "Cid/standing/static.c3d", parts / "Cid/walks/a.c3d", parts / "Cid/walks/b.c3d")
    assert keys(parts, tmp_path / "out") == [("Cid", "")], "folders that hold parts are one session"
    put(tmp_path / "alone" / "walk.c3d")
    with refuses(Code.COHORT, source=tmp_path / "alone"):
        find_people(tmp_path / "alone", tmp_path / "out")


def test_people_csv_tells_what_no_file_does(folder: Path) -> None:
    lines = (
        "Person;session;group;sex;mass_kg;height_m;remarks",
        "Bob;;adults;m;70,5;1,8;x",
        "Bob;pre;adults;;71;;",
        "Zoe",
    )
    (folder / "people.csv").write_text("\ufeff" + "\n".join(lines), encoding="utf-8")
    people = {p.key: p for p in read_cohort(folder, folder / "out")[0].people}
    assert list(people) == [("Ann", ""), ("Bob", "post"), ("Bob", "pre"), ("Zoe", "")]
    post, pre = people["Bob", "post"], people["Bob", "pre"]
    assert (post.options.mass, post.options.height, post.options.sex, post.group) == (
        70.5,
        1.8,
        "male",
        "adults",
    )
    assert (pre.options.mass, pre.options.height) == (71.0, 1.8)
    assert not people["Zoe", ""].folder.exists()  # a failure of her own, later


@pytest.mark.parametrize(
    ("text", "code", "field", "parts"),
    [
        ("name,mass_kg\nAnn,60\n", Code.COHORT, "", ("name", "mass_kg", "person")),
        ("person,mass_kg\nAnn,heavy\n", Code.BAD_NUMBER, "mass_kg", ("row 2", "heavy")),
        ("person,height_m\nAnn,1.7\nBob,175\n", Code.BAD_VALUE, "height_m", ("row 3", 175)),
        ("person,sex\nAnn,x\n", Code.BAD_VALUE, "sex", ("row 2", "'x'")),
        ("person,sex\n,m\n", Code.COHORT, "person", ("row 2",)),
        ("person,sex,Person\nAnn,m,Bob\n", Code.COHORT, "", (2, "'person'", "columns")),
        ("person,sex\nAnn,f\nAnn,m\n", Code.COHORT, "sex", ("row 3", "row 2", "'female'")),
        (
            "person,session,mass_kg\nAnn,a,60\nAnn,b,61\nAnn,a,62\n",
            Code.COHORT,
            "mass_kg",
            ("row 4", "row 2", 62, 60),
        ),
        ("person,mass\nAnn,60\n", Code.COHORT, "", ("'mass'", "'mass_kg'")),
        ("person,height\nAnn,1.7\n", Code.COHORT, "", ("'height'", "'height_m'")),
        ("person,age\nAnn,17\n", Code.COHORT, "", ("'age'", "'age_years'")),
        ("person,Weight\nAnn,60\n", Code.COHORT, "", ("'weight'", "'mass_kg'")),
        ("person,height_m\nAnn,1,75\n", Code.COHORT, "", ("row 2", "cells", "semicolons")),
    ],
)
def test_faults_of_the_table_are_one_line(
    tmp_path: Path, text: str, code: Code, field: str, parts: tuple[str | float, ...]
) -> None:
    (tmp_path / "people.csv").write_text(text, encoding="utf-8")
    with refuses(code, *parts, field=field):
        read_sheet(tmp_path / "people.csv")


def test_other_columns_are_told_and_rows_may_repeat(folder: Path) -> None:
    text = "person,diagnosis,mass_kg,mass,sex,\nAnn,none,60,60,f,\nAnn,none,60,,w,\nBob,none,,,m,\n"
    (folder / "people.csv").write_text(text, encoding="utf-8")
    cohort = read_cohort(folder, folder / "out")[0]
    assert (cohort.people[0].options.mass, cohort.people[0].options.sex) == (60.0, "female")
    assert cohort.notes == (
        "people.csv: column 'diagnosis' is not used",
        "people.csv: column 'mass' is not used",
    )


@pytest.mark.parametrize(
    "row", ["/etc,", "../x,", ".,", "..,", "notes/deep,", "Cid,../x", "Cid,/etc"]
)
def test_a_table_leads_nowhere_else(folder: Path, row: str) -> None:
    (folder / "people.csv").write_text(f"person,session\n{row}\n", encoding="utf-8")
    with refuses(Code.COHORT, source=folder / "people.csv"):
        read_cohort(folder, folder / "out")


def test_cohort_file_names_people_and_settings(folder: Path) -> None:
    file = folder / "cohort.toml"
    file.write_text(
        '[[person]]\nfolder = "Bob/pre"\nname = "Bob"\nsession = "pre"\nmass_kg = 70\n'
        '[[person]]\nfolder = "Ann"\n[calibration]\nip = "none"\n'
    )
    cohort, settings = read_cohort(folder, folder / "out")
    assert [p.key for p in cohort.people] == [("Ann", ""), ("Bob", "pre")]
    assert cohort.people[1].folder == (folder / "Bob" / "pre").resolve()
    assert format_settings(settings) == '\n[calibration]\nip = "none"\n'


@pytest.mark.parametrize(
    ("text", "code", "parts"),
    [
        ('[[person]]\nfolder = "A"\n[[person]]\nfolder = "x/A"\n', Code.COHORT, ("'A'", "twice")),
        ('[[person]]\nfolder = "a"\n[[person]]\nfolder = "A"\n', Code.COHORT, ("'a'", "'A'")),
        (
            '[[person]]\nfolder = "A"\n[[person]]\nfolder = "A"\nsession = "pre"\n',
            Code.COHORT,
            ("'A'", "session"),
        ),
        ('[[person]]\nfolder = "A"\nweight = 3\n', Code.UNKNOWN_FIELD, ("weight",)),
        ('[[person]]\nfolder = "A"\nsex = "m"\n', Code.BAD_VALUE, ("sex",)),
    ],
)
def test_faults_of_the_cohort_file_are_one_line(
    tmp_path: Path, text: str, code: Code, parts: tuple[str, ...]
) -> None:
    (tmp_path / "cohort.toml").write_text(text)
    with refuses(code, *parts):
        read_cohort(tmp_path / "cohort.toml", tmp_path / "out")


def test_names_become_folders_that_may_be() -> None:
    assert make_safe_name("P 01 (a)") == "P 01 (a)"
    assert make_safe_name("Jürgen") == "Jürgen"
    for name in ("../up", "a/b", "con", "x" * 200, ".hidden", "a:b", "\U00020000" * 70):
        safe = make_safe_name(name)
        assert safe != name
        assert not set('/\\:<>"|?*') & set(safe)
        assert len(safe.encode()) < 100
        assert not safe.startswith(".")
    assert make_safe_name("a/b") != make_safe_name("a:b")
