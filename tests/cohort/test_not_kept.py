"""People of a cohort whose outcome the disk does not take: they are failures, and never left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path

import pytest

from gaitcal.cohort import outcome as tasks
from gaitcal.cohort.outcome import Outcome, Task, keep, state_file
from gaitcal.cohort.page import PAGE
from gaitcal.cohort.people import people_in, read_cohort
from gaitcal.cohort.run import FAILURES, PEOPLE_CSV, run_cohort
from gaitcal.io.atomic import disk_errors
from tests.cohort.stubs import Here, rows, run, write_result

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
            with disk_errors(folder / outcome.place):
                raise OSError(ENOSPC, "No space left on device")
        keep(folder, outcome)

    monkeypatch.setattr(tasks, "keep", full)
    ended = run(lab, out, retry=True)
    assert [e.outcome.verdict for e in ended] == ["failed", "doubtful", "failed", "failed"]
    ann, _, zed = rows(out / FAILURES)
    assert (ann["person"], ann["code"]) == ("Ann", "GC-230")
    assert ann["cause"] == "people/Ann: cannot be written: No space left on device"
    assert zed["cause"] == "the static trial is restless"
    assert "No space left on device" in (out / PAGE).read_text(encoding="utf-8")
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Bob"]
    monkeypatch.undo()
    monkeypatch.setattr(tasks, "calibrate_person", lambda person, out, common: write_result(person, out, common))
    run(lab, out)
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Ann", "Bob", "Zed"]


def test_nobody_is_left_out_of_the_tables(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    class Forgetful(Here):
        def run(
            self, function: Callable[[Task], Outcome], tasks: Iterator[Task], lost: Callable[[Task, str], Outcome]
        ) -> Iterator[Outcome]:
            for task in tasks:
                yield function(task)
                state_file(task.out, "people/Bob", ".json").unlink(missing_ok=True)

    out = tmp_path / "out"
    written = run_cohort(people_in(lab, out), out, engine=Forgetful())
    assert written.verdicts == {"doubtful": 1, "failed": 3}
    assert [row["person"] for row in rows(out / FAILURES)] == ["Bob", "Yan", "Zed"]
    assert "was not found on disk" in rows(out / FAILURES)[0]["cause"]


def test_a_name_of_many_bytes_is_a_line_of_the_tables(lab: Path, tmp_path: Path) -> None:
    (lab / "people.csv").write_text(f"person\n{70 * LONG}\n", encoding="utf-8")
    out = tmp_path / "out"
    cohort = read_cohort(lab, out)[0]
    one = replace(cohort, people=tuple(person for person in cohort.people if person.name.startswith(LONG)))
    assert run_cohort(one, out, engine=Here()).verdicts == {"failed": 1}
    (line,) = rows(out / FAILURES)
    assert (line["person"], line["code"]) == (70 * LONG, "GC-223")
    assert line["cause"].startswith("no folder '")
