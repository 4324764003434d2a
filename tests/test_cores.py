"""Steps side by side give what steps one after the other give, also where one fails or its process dies."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaitcal import cores
from gaitcal.codes import Code
from gaitcal.cores import all_of, beside, each, several_cores
from gaitcal.errors import InputError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="copies of a process are made on Linux only")


@pytest.fixture(autouse=True)
def _three_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "_available", lambda: 3)


def slowly(number: int) -> tuple[int, int]:
    time.sleep(0.02)
    return number, os.getpid()


def test_answers_come_in_the_order_of_the_items_from_several_processes() -> None:
    with several_cores():
        answers = each(slowly, range(30))
    assert [number for number, _ in answers] == list(range(30))
    assert len({process for _, process in answers}) == 3


def test_nobody_who_did_not_ask_gets_a_copy_of_the_process() -> None:
    with several_cores():
        each(slowly, range(4))
    assert {process for _, process in each(slowly, range(4))} == {os.getpid()}


def test_steps_of_a_step_stay_in_its_process() -> None:
    def outer(_: int) -> bool:
        return {process for _, process in each(slowly, range(3))} == {os.getpid()}

    with several_cores():
        assert all(each(outer, range(4)))


def test_arrays_and_closures_pass() -> None:
    scale = np.arange(200_000.0)
    with several_cores():
        answers = each(lambda k: k * scale, range(5))
    np.testing.assert_array_equal(answers, [k * scale for k in range(5)])


def test_the_longest_begin_first(tmp_path: Path) -> None:
    def noted(number: int) -> None:
        with (tmp_path / "begun").open("a") as file:
            file.write(f"{number}\n")
        time.sleep(0.05)

    with several_cores():
        each(noted, range(6), longest=lambda number: number)
    assert set((tmp_path / "begun").read_text().split()[:3]) == {"5", "4", "3"}


def test_the_exception_of_the_first_step_that_fails_is_raised() -> None:
    def failing(number: int) -> int:
        if number > 1:
            raise InputError(f"number {number}", code=Code.FOLDER)
        return number

    with several_cores(), pytest.raises(InputError, match="number 2"):
        each(failing, range(8))


def test_what_dies_with_a_copy_is_computed_again() -> None:
    mine = os.getpid()

    def dying(number: int) -> int:
        if os.getpid() != mine:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.02)
        return number**2

    with several_cores():
        assert each(dying, range(6)) == [number**2 for number in range(6)]


def test_what_cannot_be_sent_is_computed_again() -> None:
    with several_cores():
        functions: list[Callable[[], int]] = each(lambda k: lambda: k, range(4))
    assert [function() for function in functions] == [0, 1, 2, 3]


def test_an_interrupt_ends_the_copies(tmp_path: Path) -> None:
    mine = os.getpid()

    def interrupted(number: int) -> None:
        if os.getpid() == mine:
            while len(list(tmp_path.iterdir())) < 2:
                time.sleep(0.01)
            raise KeyboardInterrupt
        (tmp_path / str(os.getpid())).touch()
        time.sleep(60)

    began = time.monotonic()
    with several_cores(), pytest.raises(KeyboardInterrupt):
        each(interrupted, range(3))
    assert time.monotonic() - began < 30
    for copy in tmp_path.iterdir():
        with pytest.raises(ProcessLookupError):
            os.kill(int(copy.name), 0)


def test_several_functions_at_once() -> None:
    with several_cores():
        assert all_of(lambda: 1, lambda: "two") == [1, "two"]
    assert all_of(lambda: 1, lambda: "two") == [1, "two"]


def test_where_no_process_may_be_added_one_does_it_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", full)
    with several_cores():
        assert {process for _, process in each(slowly, range(4))} == {os.getpid()}


def test_an_interrupt_while_a_copy_is_made_is_neither_lost_nor_heard_by_the_copy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fork, mine = os.fork, os.getpid()
    copies = []

    def interrupted() -> int:
        child = fork()
        copies.append(child)
        os.kill(os.getpid(), signal.SIGINT)
        return child

    def noted(number: int) -> None:
        (tmp_path / f"{os.getpid() == mine} {number}").touch()
        time.sleep(0.3)

    monkeypatch.setattr(os, "fork", interrupted)
    with several_cores(), pytest.raises(KeyboardInterrupt):
        each(noted, range(9))
    assert not any(path.name.startswith("True") for path in tmp_path.iterdir())
    for copy in copies:
        with pytest.raises(ProcessLookupError):
            os.kill(copy, 0)


def test_a_step_beside_what_only_this_process_can_do() -> None:
    mine = os.getpid()

    def slow_step() -> tuple[int, set[int]]:
        time.sleep(0.1)
        return os.getpid(), {process for _, process in each(slowly, range(12))}

    with several_cores(), beside(slow_step) as told:
        time.sleep(0.5)
        process, processes = told()
    assert process != mine
    assert len(processes) > 1, "the copy shares its steps"
    assert mine not in processes
    with beside(os.getpid) as told_here:
        assert told_here() == mine


def test_a_step_beside_that_fails_or_dies_is_computed_here() -> None:
    mine = os.getpid()

    def failing() -> int:
        raise InputError("no file", code=Code.FOLDER)

    def dying() -> int:
        if os.getpid() != mine:
            os.kill(os.getpid(), signal.SIGKILL)
        return 1

    with several_cores():
        with beside(failing) as told, pytest.raises(InputError, match="no file"):
            told()
        with beside(dying) as told:
            assert told() == 1


def test_an_interrupt_ends_a_step_beside_and_its_own_steps(tmp_path: Path) -> None:
    def endless(number: int) -> None:
        (tmp_path / str(os.getpid())).touch()
        time.sleep(60)

    def interrupted() -> None:
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.01)
        raise KeyboardInterrupt

    with several_cores(), pytest.raises(KeyboardInterrupt), beside(lambda: each(endless, range(4))):
        interrupted()
    for copy in tmp_path.iterdir():
        assert _ended(int(copy.name))


def _ended(process: int) -> bool:
    """Whether a process ends within ten seconds: its end follows its parent's."""
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        if Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] == "Z":
            return True  # whoever took it over has not asked how it ended
        time.sleep(0.1)
    return False


def test_a_copy_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    mine = os.getpid()

    def loud(number: int) -> None:
        time.sleep(0.05)
        if os.getpid() != mine:
            for stream in (sys.stdout, sys.stderr):
                stream.write("something\n")
                stream.flush()

    with several_cores():
        each(loud, range(6))
    assert capfd.readouterr() == ("", "")
