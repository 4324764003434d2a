"""Processes that die stop nobody, and are replaced before they grow old."""

import os
import signal
from pathlib import Path

import pytest

from gaitcal.published.workers import LocalProcesses
from tests.published.worker_tasks import killed_always, killed_once, process, square

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


def no_loss(task: object, words: str) -> object:
    raise AssertionError(words)


def test_every_task_once() -> None:
    assert sorted(LocalProcesses(2).run(square, range(7), no_loss)) == [k * k for k in range(7)]
    assert list(LocalProcesses(2).run(square, [], no_loss)) == []


def test_a_process_that_dies_once_costs_nobody(tmp_path: Path) -> None:
    places = [tmp_path / name for name in "abc"]
    assert sorted(LocalProcesses(2).run(killed_once, places, no_loss)) == ["a", "b", "c"]


def test_a_process_that_dies_between_two_tasks_costs_nobody() -> None:
    results = LocalProcesses(1).run(process, range(3), no_loss)
    first = next(results)
    os.kill(first, signal.SIGKILL)
    assert first not in list(results)


def test_who_kills_every_process_is_given_up_and_the_others_go_on() -> None:
    def lost(task: int, words: str) -> str:
        return f"{task}: {words}"

    found = list(LocalProcesses(2).run(killed_always, range(5), lost))
    assert sorted(map(str, found)) == ["0", "1", "2: ended by SIGKILL, 3 times", "3", "4"]


def test_processes_are_replaced() -> None:
    found = list(LocalProcesses(1, each=2).run(process, range(6), no_loss))
    assert len(set(found)) == 3


def test_what_costs_no_work_makes_no_process_old() -> None:
    found = list(LocalProcesses(1, each=2, ages=lambda result: 0).run(process, range(6), no_loss))
    assert len(set(found)) == 1


def test_closing_ends_the_processes() -> None:
    outcomes = LocalProcesses(2).run(square, range(100), no_loss)
    next(outcomes)
    outcomes.close()  # type: ignore[attr-defined]
    assert list(outcomes) == []
