"""A cohort whose calibrations are stubs: what is run again, what the tables hold, what a failure leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from gaitcal.cohort.outcome import Outcome, Task, state_file
from gaitcal.cohort.page import PAGE
from gaitcal.cohort.people import people_in
from gaitcal.cohort.row import COLUMNS, NAMES
from gaitcal.cohort.run import CYCLES, FAILURES, MOST_MIB, PEOPLE_CSV, PEOPLE_PARQUET, processes, run_cohort
from gaitcal.errors import InputError
from gaitcal.gait.ensemble import ensemble
from tests.cohort.stubs import MASS, Here, of_a_process, rows, run, strides
from tests.session.folders import recordings, write

SAME = (PEOPLE_CSV, PEOPLE_PARQUET, CYCLES, FAILURES, PAGE, "manifest.json")


def test_tables(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    ended = run(lab, out)
    assert [e.outcome.verdict for e in ended] == ["doubtful", "doubtful", "failed", "failed"]
    ann = rows(out / PEOPLE_CSV)[0]
    assert list(ann) == list(NAMES)
    assert (ann["person"], ann["folder"], ann["first_cause"]) == ("Ann", "people/Ann", 'a "heel", moved')
    assert (ann["verdict_r"], ann["verdict_l"], ann["walks_refused_l"]) == ("trustworthy", "refused", "2")
    assert float(ann["marker_rms_calibrated_mm"]) == pytest.approx(np.sqrt((100 * 9 + 300) / 400), abs=1e-6)
    assert float(ann["residual_force_calibrated_N"]) == 20.0
    assert (float(ann["residual_force_limit_N"]), float(ann["residual_moment_limit_Nm"])) == (35.0, 9.0)
    assert float(ann["speed_r"]) == 1.25
    assert ann["speed_l"] == ""
    parquet = pq.read_table(out / PEOPLE_PARQUET)
    assert parquet.column_names == list(NAMES)
    assert parquet["speed_r"].to_pylist() == [1.25, 1.25]
    cycles = pq.ParquetFile(out / CYCLES)
    assert (cycles.num_row_groups, cycles.metadata.num_rows) == (2, 2 * len(strides("Ann")))
    assert rows(out / FAILURES) == [
        {"person": "Yan", "session": "", "group": "", "folder": "Yan"}
        | {"code": "GC-240", "cause": "internal error: ZeroDivisionError: by zero", "what_to_do": "please report it"},
        {"person": "Zed", "session": "", "group": "", "folder": "Zed"}
        | {"code": "GC-040", "cause": "the static trial is restless", "what_to_do": "record it again"},
    ]
    assert [row["column"] for row in rows(out / "columns.csv")] == [column.name for column in COLUMNS]


def test_a_process_that_has_grown_large_is_replaced_at_once() -> None:
    for mebibytes, count in ((MOST_MIB + 1.0, 3), (MOST_MIB - 1.0, 1)):
        ended = processes(1).run(of_a_process, [mebibytes] * 3)
        assert len({outcome.name for outcome in ended}) == count


def test_peaks_are_those_of_the_mean_over_valid_strides(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    run(lab, tmp_path / "out")
    ann = rows(tmp_path / "out" / PEOPLE_CSV)[0]
    mean = ensemble(strides("Ann")).set_index(["variable", "percent"])
    high = mean.loc["knee_angle_moment", 25]
    assert float(ann["knee_angle_moment_max_r"]) == pytest.approx(high["mean"] / MASS, abs=1e-6)
    assert float(ann["knee_angle_moment_max_se_r"]) == pytest.approx(high["se"] / MASS, abs=1e-6)
    assert float(ann["knee_angle_range_r"]) == pytest.approx(40.0, abs=1e-6)
    assert float(ann["knee_angle_max_r"]) == pytest.approx(51.5, abs=1e-6)
    assert ann["hip_flexion_moment_max_r"] == ""  # half a stride is not seen: its peak is not known


def test_only_what_changed_is_run_again(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    run(lab, out)
    before = {name: (out / name).read_bytes() for name in SAME}
    ran.clear()
    assert not any(e.outcome.computed for e in run(lab, out))
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
    from gaitcal.cohort.people import read_cohort

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
    state_file(other, "people/Ann", ".json").unlink()  # killed after the strides, before it was done
    state_file(other, "people/Bob", ".json").write_text('{"cut off')
    run(lab, other)
    assert ran[8:] == ["Ann", "Bob"]
    for name in SAME:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_lost_worker_is_tried_again_by_the_next_run(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    class Lost(Here):
        def run(
            self, function: Callable[[Task], Outcome], tasks: Iterator[Task], lost: Callable[[Task, str], Outcome]
        ) -> Iterator[Outcome]:
            first, *others = tasks
            yield lost(first, "ended by SIGKILL, 3 times")
            yield from map(function, others)

    out = tmp_path / "out"
    run_cohort(people_in(lab, out), out, engine=Lost())
    assert "its worker process died: ended by SIGKILL, 3 times" in (out / FAILURES).read_text()
    run(lab, out)
    assert ran[-1] == "Ann"
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Ann", "Bob"]


def test_another_folder_is_left_alone(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    with pytest.raises(InputError, match="holds 'thesis.txt', and is no cohort"):
        run(lab, tmp_path / "mine")
    assert ran == []


def test_every_failure_has_a_code(tmp_path: Path) -> None:
    lab, out = tmp_path / "lab", tmp_path / "out"
    for name in ("broken", "nobody's"):
        (lab / name).mkdir(parents=True)
        (lab / name / "walk.c3d").write_bytes(b"no recording")
    write(lab / "unknown", recordings(), forces="grf")
    run(lab, out)
    found = {row["cause"]: (row["code"], bool(row["what_to_do"])) for row in rows(out / FAILURES)}
    assert found == {
        "holds 1 files, but no recording that can be read (.c3d, .trc or .csv)": ("GC-223", True),
        "no file says subject.mass_kg, subject.height_m, subject.sex": ("GC-211", True),
    }
