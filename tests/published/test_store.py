"""Chunks of draws are what was written, or are named and made again; one study at a time works in a store."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.errors import InputError
from gaitcal.io import lock
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.protocol import MonteCarloSettings, Plan, Varied
from gaitcal.published.study import PURPOSE, MonteCarloStudy, Store, monte_carlo
from gaitcal.published.workers import ThisProcess, alone

PLAN = Plan(sets=(Varied.IP,), levels=(100,), draws=4)
Spoil = Callable[[bytes], bytes]
DAMAGE: dict[str, Spoil] = {
    "bit": lambda b: b[: len(b) // 2] + bytes([b[len(b) // 2] ^ 16]) + b[len(b) // 2 + 1 :],
    "last bit": lambda b: b[:-1] + bytes([b[-1] ^ 1]),
    "zeroed block": lambda b: b[:512] + bytes(512) + b[1024:],
    "cut": lambda b: b[:-100],
    "empty": lambda b: b"",
    "longer": lambda b: b + b"\0",
}


def study(case: MonteCarloCase, folder: Path) -> MonteCarloStudy:
    return monte_carlo(case, folder, plan=PLAN, workers=ThisProcess(), chunk_draws=2)


@pytest.fixture
def whole(case: MonteCarloCase, tmp_path: Path) -> MonteCarloStudy:
    return study(case, tmp_path)


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_chunk_is_named_and_made_again(
    damage: str, case: MonteCarloCase, whole: MonteCarloStudy, tmp_path: Path
) -> None:
    path = sorted((tmp_path / "draws").iterdir())[1]
    path.write_bytes(DAMAGE[damage](path.read_bytes()))
    with pytest.raises(InputError, match=f"{path.name}: is damaged; run the same study again"):
        Store(tmp_path).read()
    again = study(case, tmp_path)
    assert again.notes == (f"{path.name}: was damaged; its draws are made again",)
    assert again.computed == 2
    pd.testing.assert_frame_equal(again.draws, whole.draws, check_exact=True)
    assert study(case, tmp_path).notes == ()


@pytest.mark.parametrize("damage", ["bit", "cut", "empty"])
def test_damaged_settings_cost_no_draw(
    damage: str, case: MonteCarloCase, whole: MonteCarloStudy, tmp_path: Path
) -> None:
    path = tmp_path / "settings.json"
    sound = path.read_bytes()
    path.write_bytes(DAMAGE[damage](sound))
    again = study(case, tmp_path)
    assert again.computed == 0 and "settings.json was damaged" in again.notes[0]
    assert path.read_bytes() == sound
    path.write_bytes(DAMAGE[damage](sound))
    with pytest.raises(InputError, match=r"settings\.json: .*remove the folder"):
        monte_carlo(case, tmp_path, settings=MonteCarloSettings(seed=1), plan=PLAN, workers=ThisProcess())


def test_one_study_at_a_time(case: MonteCarloCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "WAIT_S", 0.1)
    told: list[str] = []

    def other() -> None:
        try:
            study(case, tmp_path / "store")
        except InputError as error:
            told.append(str(error))

    with alone(tmp_path / "store", PURPOSE):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert "is being written by another process" in told[0]
    assert list(tmp_path.iterdir()) == []


def test_draws_that_vanish_meanwhile_are_computed_again(case: MonteCarloCase, tmp_path: Path) -> None:
    """As where somebody puts another copy of the folder in its place."""

    class Losing(ThisProcess):
        lost = False

        def run(self, function, tasks, lost=None):  # type: ignore[no-untyped-def]
            for task in tasks:
                yield function(task)
                if not Losing.lost:
                    Losing.lost = True
                    next((tmp_path / "store/draws").iterdir()).unlink()

    found = monte_carlo(case, tmp_path / "store", plan=PLAN, workers=Losing(), chunk_draws=2)
    assert (len(found.draws), found.computed) == (4, 6)
