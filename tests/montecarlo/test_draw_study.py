"""The study: the same table however computed, resumed or raised; stores of others, damaged ones,
dying workers.
"""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import pytest

from gaitcal.errors import Code, InputError
from gaitcal.io import result_folder
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw_study import PURPOSE, MonteCarloStudy, Store, monte_carlo
from gaitcal.montecarlo.protocol import MonteCarloSettings, ParameterChoice, Plan, Varied
from gaitcal.montecarlo.workers import LocalProcesses, Workers, lock_folder
from tests.messages import check_text, refuses
from tests.montecarlo.worker_tasks import killed_always, killed_once, process, square
from tests.refusal import refusal

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")
Task = TypeVar("Task")
Result = TypeVar("Result")

PLAN = Plan(levels=(50, 100), draws=3)
QUICK = Plan(sets=(Varied.IP,), levels=(50, 100), draws=30)
HERE = Workers()


class Backwards:
    """Workers that begin with the last task."""

    def run(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], lost: object = None
    ) -> Iterator[Result]:
        return map(function, reversed(list(tasks)))


class Dying:
    """Workers that are gone after a number of chunks."""

    def __init__(self, chunks: int) -> None:
        self.chunks = chunks

    def run(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], lost: object = None
    ) -> Iterator[Result]:
        for k, task in enumerate(tasks):
            if k == self.chunks:
                raise KeyboardInterrupt
            yield function(task)


@pytest.fixture(scope="module")
def reference(case: MonteCarloCase) -> MonteCarloStudy:
    return monte_carlo(case, plan=PLAN, workers=HERE)


def same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def test_one_row_a_draw_in_order(reference: MonteCarloStudy) -> None:
    draws = reference.draws
    cells = [(v.value, level, k) for v in Varied for level in (50, 100) for k in range(PLAN.draws)]
    assert list(zip(draws["set"], draws["level"], draws["draw"], strict=True)) == cells
    assert (reference.computed, reference.failed) == (PLAN.total, 0) and PLAN.total == len(draws)


def test_any_order_gives_the_same_bits(
    case: MonteCarloCase, reference: MonteCarloStudy, tmp_path: Path
) -> None:
    found = monte_carlo(case, tmp_path, plan=PLAN, workers=Backwards(), chunk_draws=2)
    same(found.draws, reference.draws)
    same(found.statistics, reference.statistics)


def test_an_interrupted_run_goes_on_where_it_was(
    case: MonteCarloCase, reference: MonteCarloStudy, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        monte_carlo(case, tmp_path, plan=PLAN, workers=Dying(5), chunk_draws=2)
    assert len(list((tmp_path / "draws").iterdir())) == 5
    done: list[tuple[int, int]] = []

    def progress(*counts: int) -> None:
        done.append(counts)  # type: ignore[arg-type]

    found = monte_carlo(case, tmp_path, plan=PLAN, workers=HERE, chunk_draws=3, progress=progress)
    assert found.computed == PLAN.total - 8  # three chunks of two draws and two of one
    assert (done[0], done[-1]) == ((0, found.computed), (found.computed, found.computed))
    same(found.draws, reference.draws)
    assert monte_carlo(case, tmp_path, plan=PLAN, workers=HERE).computed == 0


def test_more_draws_levels_and_sets_run_only_what_is_new(
    case: MonteCarloCase, tmp_path: Path
) -> None:
    monte_carlo(
        case, tmp_path, plan=replace(QUICK, draws=11, levels=(50,)), workers=HERE, chunk_draws=10
    )
    found = monte_carlo(case, tmp_path, plan=QUICK, workers=HERE, chunk_draws=10)
    assert found.computed == 60 - 11
    same(found.draws, monte_carlo(case, plan=QUICK, workers=HERE).draws)
    fewer = monte_carlo(case, tmp_path, plan=replace(QUICK, draws=5), workers=HERE)
    assert (fewer.computed, len(fewer.draws), len(Store(tmp_path).read())) == (0, 10, 60)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 1}, "seed = 0, not 1"),
        ({"inertial_percent": 50.0}, "inertial_percent = 10.0, not 50.0"),
        ({"parameters": ParameterChoice.GAIT}, f"parameters = {ParameterChoice.LEG.value}, not "),
        ({"refit_tolerance": 1e-7}, "refit_tolerance = 1e-06, not 1e-07"),
    ],
)
def test_other_settings_are_refused(
    case: MonteCarloCase, tmp_path: Path, change: dict[str, object], told: str
) -> None:
    plan = replace(QUICK, draws=1)
    monte_carlo(case, tmp_path, plan=plan, workers=HERE)
    settings = replace(MonteCarloSettings(), **change)
    with refuses(Code.MONTE_CARLO, told):
        monte_carlo(case, tmp_path, settings=settings, plan=plan, workers=HERE)


def test_another_model_is_refused(case: MonteCarloCase, tmp_path: Path) -> None:
    plan = replace(QUICK, draws=1)
    monte_carlo(case, tmp_path, plan=plan, workers=HERE)
    heavier = case.parameters.with_inertial(1.01 * case.parameters.inertial)
    moved = case.parameters.with_joint(("back.pelvis.ant",), np.ones(1))
    others = {
        "other inertial parameters;": replace(case, parameters=heavier),
        "other ground reactions;": replace(case, wrench=1.01 * case.wrench),
        "other motion;": replace(case, coefficients=case.coefficients + 1e-9),
        "other markers;": replace(
            case, markers=replace(case.markers, local=case.markers.local + 1e-9)
        ),
        "other joint parameters;": replace(case, parameters=moved),
    }
    for difference, other in others.items():
        with refuses(Code.MONTE_CARLO, difference) as caught:
            monte_carlo(other, tmp_path, plan=plan, workers=HERE)
        assert str(caught.value).count("other ") == 1
    (tmp_path / "settings.json").unlink()
    with refuses(Code.MONTE_CARLO, "settings.json"):
        monte_carlo(case, tmp_path, plan=plan, workers=HERE)


def test_failed_draws_are_kept_and_counted(case: MonteCarloCase, tmp_path: Path) -> None:
    plan = Plan(sets=(Varied.JP, Varied.IP), levels=(100,), draws=3)
    hasty = MonteCarloSettings(refit_most_evaluations=2)
    monte_carlo(case, tmp_path, settings=hasty, plan=plan, workers=HERE)
    found = monte_carlo(case, tmp_path, settings=hasty, plan=plan, workers=HERE)
    assert (found.failed, len(found.draws)) == (3, 6)
    assert (
        found.draws.loc[found.draws["set"] == "jp", "failure"].str.contains("did not settle").all()
    )
    assert found.statistics.groupby("set")["failed"].unique().map(list).to_dict() == {
        "jp": [3],
        "ip": [0],
    }


@pytest.mark.slow
def test_until_converged_adds_draws(
    case: MonteCarloCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = monte_carlo(
        case, tmp_path, plan=replace(QUICK, draws=20), workers=HERE, until_converged=True
    )
    assert found.plan.draws > 20 and found.converged and found.computed == len(found.draws)
    monkeypatch.setattr("gaitcal.montecarlo.draw_study.MOST_DRAWS", 25)
    stopped = monte_carlo(case, plan=replace(QUICK, draws=20), workers=HERE, until_converged=True)
    assert (stopped.plan.draws, stopped.converged) == (25, False)


FEW = Plan(sets=(Varied.IP,), levels=(100,), draws=4)
Spoil = Callable[[bytes], bytes]
DAMAGE: dict[str, Spoil] = {
    "bit": lambda b: b[: len(b) // 2] + bytes([b[len(b) // 2] ^ 16]) + b[len(b) // 2 + 1 :],
    "cut": lambda b: b[:-100],
    "longer": lambda b: b + b"\0",
}


def study(case: MonteCarloCase, folder: Path) -> MonteCarloStudy:
    return monte_carlo(case, folder, plan=FEW, workers=Workers(), chunk_draws=2)


@pytest.fixture
def whole(case: MonteCarloCase, tmp_path: Path) -> MonteCarloStudy:
    return study(case, tmp_path)


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_chunk_is_named_and_made_again(
    damage: str, case: MonteCarloCase, whole: MonteCarloStudy, tmp_path: Path
) -> None:
    path = sorted((tmp_path / "draws").iterdir())[1]
    path.write_bytes(DAMAGE[damage](path.read_bytes()))
    with pytest.raises(InputError) as caught:
        Store(tmp_path).read()
    assert caught.value.code is Code.MONTE_CARLO and f"{path}: " in str(caught.value)
    again = study(case, tmp_path)
    assert again.computed == 2 and len(again.notes) == 1 and path.name in again.notes[0]
    same(again.draws, whole.draws)
    assert study(case, tmp_path).notes == ()


@pytest.mark.parametrize("damage", ["bit", "cut"])
def test_damaged_settings_cost_no_draw(
    damage: str, case: MonteCarloCase, whole: MonteCarloStudy, tmp_path: Path
) -> None:
    path = tmp_path / "settings.json"
    sound = path.read_bytes()
    path.write_bytes(DAMAGE[damage](sound))
    again = study(case, tmp_path)
    assert again.computed == 0
    check_text(again.notes, "settings.json")
    assert path.read_bytes() == sound
    path.write_bytes(DAMAGE[damage](sound))
    other = MonteCarloSettings(seed=1)
    with refuses(Code.MONTE_CARLO, source=path):
        monte_carlo(case, tmp_path, settings=other, plan=FEW, workers=Workers())


def test_one_study_at_a_time(
    case: MonteCarloCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(result_folder, "LOCK_WAIT_S", 0.1)
    with lock_folder(tmp_path / "store", PURPOSE), ThreadPoolExecutor(1) as other:
        told = other.submit(refusal, study, case, tmp_path / "store").result()
    assert "is being written by another process" in told
    assert list(tmp_path.iterdir()) == []


def test_draws_that_vanish_meanwhile_are_computed_again(
    case: MonteCarloCase, tmp_path: Path
) -> None:
    """As where somebody puts another copy of the folder in its place."""

    class Losing(Workers):
        lost = False

        def run(self, function, tasks, lost=None):  # type: ignore[no-untyped-def]
            for task in tasks:
                yield function(task)
                if not Losing.lost:
                    Losing.lost = True
                    next((tmp_path / "store/draws").iterdir()).unlink()

    found = monte_carlo(case, tmp_path / "store", plan=FEW, workers=Losing(), chunk_draws=2)
    assert (len(found.draws), found.computed) == (4, 6)


def no_loss(task: object, words: str) -> object:
    raise AssertionError(words)


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


def test_processes_are_replaced_unless_what_they_did_cost_no_work() -> None:
    for ages, processes in ((lambda result: 1, 3), (lambda result: 0, 1)):
        found = list(
            LocalProcesses(1, tasks_per_process=2, count_tasks=ages).run(process, range(6), no_loss)
        )
        assert len(set(found)) == processes


def test_closing_ends_the_processes() -> None:
    outcomes = LocalProcesses(2).run(square, range(100), no_loss)
    next(outcomes)
    outcomes.close()  # type: ignore[attr-defined]
    assert list(outcomes) == []
