"""Files damaged on the disk: every damage is named before the file is used, and chunks of draws are made again."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from gaitcal.errors import InputError
from gaitcal.files.snapshot import read_whole
from gaitcal.montecarlo.case import nominal_case, read_case
from gaitcal.montecarlo.settings import Plan, Varied
from gaitcal.montecarlo.store import Store
from gaitcal.montecarlo.study import monte_carlo
from gaitcal.montecarlo.workers import ThisProcess
from gaitcal.page import load_scene
from gaitcal.results.saved import load_result
from scripts.validation.folders.commands import CHUNK_DRAWS, Bench

PLAN = Plan((Varied.IP,), (100,), 12)
Damage = Callable[[bytearray, random.Random], bytearray]


def flipped(data: bytearray, rng: random.Random) -> bytearray:
    """One to eight bits."""
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return data


def zeroed(data: bytearray, rng: random.Random) -> bytearray:
    """A block of a disk, or a part of one."""
    length = min(rng.choice((16, 512, 4096)), len(data))
    at = rng.randrange(len(data) - length + 1)
    data[at : at + length] = bytes(length)
    return data


def cut(data: bytearray, rng: random.Random) -> bytearray:
    """Truncated, perhaps to nothing."""
    return data[: rng.choice((0, rng.randrange(len(data))))]


KINDS: dict[str, Damage] = {"flipped": flipped, "zeroed": zeroed, "cut": cut}


def damaged(path: Path, rng: random.Random) -> str:
    """Spoil a file, such that it differs; which kind it was."""
    data = path.read_bytes()
    while True:
        kind = rng.choice(tuple(KINDS))
        spoilt = bytes(KINDS[kind](bytearray(data), rng))
        if spoilt != data:
            path.unlink()  # copies of the folder may share it by a link
            path.write_bytes(spoilt)
            return kind


def chunk_faults(folder: Path, count: int, rng: random.Random, seen: list[str]) -> Iterator[str]:
    """Damage chunks one at a time, and run the study again."""
    shutil.rmtree(folder, ignore_errors=True)
    case = nominal_case()
    whole = monte_carlo(case, folder, plan=PLAN, workers=ThisProcess(), chunk_draws=CHUNK_DRAWS).draws
    kinds = dict.fromkeys(KINDS, 0)
    named = 0
    for k in range(count):
        path = rng.choice(sorted((folder / "draws").glob("*.parquet")))
        kind = damaged(path, rng)
        kinds[kind] += 1
        try:
            Store(folder).read()
            yield f"chunk {k} {kind}: read without a word"
        except InputError as error:
            named += path.name in str(error)
        again = monte_carlo(case, folder, plan=PLAN, workers=ThisProcess(), chunk_draws=CHUNK_DRAWS)
        if not any(path.name in note for note in again.notes):
            yield f"chunk {k} {kind}: made again without a word"
        if again.computed != CHUNK_DRAWS or not again.draws.equals(whole):
            yield f"chunk {k} {kind}: other draws than before"
    seen.append(f"chunks: {count} damaged {kinds}, {named} named when read, all made again")


def result_faults(bench: Bench, folder: Path, count: int, rng: random.Random, seen: list[str]) -> Iterator[str]:
    """Damage files of a result one at a time, and read it as commands do."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(bench.result("first"), folder)
    readers: dict[str, Callable[[], object]] = {
        name: lambda: load_result(folder).files for name in ("model.toml", "marker_set.toml", "uncertainty.npz")
    }
    readers["manifest.json"] = readers["model.toml"]
    readers["splines.npz"] = readers["marker_errors/walk.csv"] = lambda: read_case(folder)[1]
    readers["scene.npz"] = lambda: read_whole(folder, ("scene.npz",), lambda: load_scene(folder / "scene.npz"))[1]
    refused = told = 0
    for k in range(count):
        name = rng.choice(sorted(readers))
        data = (folder / name).read_bytes()
        kind = damaged(folder / name, rng)
        try:
            remarks = getattr(readers[name](), "remarks", ())
            if any(name in remark for remark in remarks):
                told += 1
            else:
                yield f"{name} {kind}, {k}: read without a word"
        except InputError as error:
            refused += 1
            if name not in str(error):
                yield f"{name} {kind}, {k}: said {error}"
        (folder / name).write_bytes(data)
    seen.append(f"files of a result: {count} damaged, {refused} refused by name, {told} told as edited")
