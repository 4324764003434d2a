"""Where draws are kept: `DIR/montecarlo/`, one Parquet file per chunk, each written whole; or in memory.

A chunk is a run of draws of one cell (a set at a level): the unit that is computed, stored, and lost when a process
dies. What is missing is told by the names of the files alone, so that a run killed at any moment goes on where it was,
and a larger number of draws runs only the new ones. The folder `draws` can be read as one Parquet data set, one row per
draw, the same whatever order they came in. `settings.json` says what the draws depend on; a store made with other
settings or another model is refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.errors import InputError
from gaitcal.files.atomic import atomic_file, atomic_text
from gaitcal.files.package_data import package_version
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw import COLUMNS, DrawResult
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan, Varied

FORMAT = 2
"""Raised whenever the same settings would give other draws."""
KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)
_NAME = re.compile(r"(jp|ip|both|noise)_(\d{4})_(\d{8})_(\d{8})\.parquet")
_VERSIONED = ("gaitcal", "numpy", "scipy", "pin")


@dataclass(frozen=True)
class Chunk:
    """Draws first, first + 1, ..., stop - 1 of a set at a level."""

    varied: Varied
    level: int
    first: int
    stop: int

    @property
    def numbers(self) -> range:
        """Of its draws."""
        return range(self.first, self.stop)


def records(chunk: Chunk, results: Sequence[DrawResult]) -> pa.Table:
    """The draws of a chunk, in order, as a table with the columns `FIELDS`."""
    columns: dict[str, pa.Array] = {
        "set": pa.array([chunk.varied.value] * len(results)),
        "level": pa.array(np.full(len(results), chunk.level, dtype=np.int64)),
        "draw": pa.array(np.array(chunk.numbers, dtype=np.int64)),
        "evaluations": pa.array(np.array([r.evaluations for r in results], dtype=np.int64)),
        "failure": pa.array([r.failure for r in results], pa.string()),
    }
    values = np.array([r.values for r in results])
    return pa.table(columns | {name: pa.array(values[:, k]) for k, name in enumerate(COLUMNS)})


class Store:
    """The results of one case with one kind of settings, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.draws = folder / "draws"
        self._settings = folder / "settings.json"

    def open(self, case: MonteCarloCase, settings: MonteCarloSettings) -> tuple[str, ...]:
        """Make the store, or make sure that it holds draws of this case with these settings.

        Returns notes: libraries of other versions than those that the store was made with.

        Raises
        ------
        InputError
            It was made with other settings or another model; the message names the differences.
        """
        wanted = {"format": FORMAT, "settings": dict(settings.as_json()), "model": dict(case.fingerprint())}
        if self._settings.exists():
            held = self._held()
            _refuse_other(held, wanted, self.folder)
            return _other_versions(held)
        if any(self.draws.glob("*.parquet")):
            raise InputError(
                "found draws without the settings they were made with; remove the folder", source=self.folder
            )
        content = {**wanted, "case": case.name, "versions": {name: package_version(name) for name in _VERSIONED}}
        atomic_text(self._settings, json.dumps(content, indent=1) + "\n")
        return ()

    @property
    def case_name(self) -> str | None:
        """The trial whose draws are here; None where there are none yet."""
        name = self._held().get("case") if self._settings.exists() else None
        return name if isinstance(name, str) else None

    def require_model_of(self, case: MonteCarloCase) -> None:
        """Make sure, before draws are read, that they are of this case; InputError as of `open`."""
        if self._settings.exists():
            held = self._held()
            _refuse_other(held, {**held, "model": dict(case.fingerprint())}, self.folder)

    def _held(self) -> dict[str, object]:
        """What the draws that are here were made with."""
        try:
            content = json.loads(self._settings.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read: {error}", source=self._settings) from None
        return content if isinstance(content, dict) else {}

    def write(self, chunk: Chunk, draws: pa.Table) -> None:
        """Keep the records of a chunk."""
        name = f"{chunk.varied.value}_{chunk.level:04d}_{chunk.first:08d}_{chunk.stop:08d}.parquet"
        with atomic_file(self.draws / name) as path:
            pq.write_table(draws, path)

    def missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        """Chunks of a plan that are not there yet."""
        return missing_chunks(self._files().values(), plan, size)

    def read(self, plan: Plan | None = None) -> pd.DataFrame:
        """All draws that are there, or those of a plan; columns `FIELDS`."""
        return _together((pq.read_table(self.draws / name) for name in sorted(self._files())), plan)

    def _files(self) -> dict[str, Chunk]:
        """Name -> chunk of every file that is whole."""
        out = {}
        for path in self.draws.glob("*.parquet"):
            if name := _NAME.fullmatch(path.name):
                chunk = Chunk(Varied(name[1]), int(name[2]), int(name[3]), int(name[4]))
                if _rows(path) == len(chunk.numbers):
                    out[path.name] = chunk
        return out


class MemoryStore:
    """A store that is gone with the process."""

    def __init__(self) -> None:
        self._held: dict[Chunk, pa.Table] = {}

    def write(self, chunk: Chunk, draws: pa.Table) -> None:
        """Keep the records of a chunk."""
        self._held[chunk] = draws

    def missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        """Chunks of a plan that are not there yet."""
        return missing_chunks(self._held, plan, size)

    def read(self, plan: Plan) -> pd.DataFrame:
        """The draws of a plan that are there; columns `FIELDS`."""
        return _together(self._held.values(), plan)


def missing_chunks(held: Iterable[Chunk], plan: Plan, size: int) -> Iterator[Chunk]:
    """What a plan still needs beside the chunks `held`, cut at multiples of `size` draws."""
    chunks = list(held)
    for varied, level in plan.cells:
        of_cell = sorted((c.first, c.stop) for c in chunks if (c.varied, c.level) == (varied, level))
        reached = 0
        for first, stop in [*of_cell, (plan.draws, plan.draws)]:
            for a, b in cut(reached, min(first, plan.draws), size):
                yield Chunk(varied, level, a, b)
            reached = max(reached, stop)


def cut(first: int, stop: int, size: int) -> list[tuple[int, int]]:
    """Runs [first, stop) cut at multiples of `size`."""
    edges = [first, *range((first // size + 1) * size, stop, size), stop]
    return [(a, b) for a, b in pairwise(edges) if a < b]


def _rows(path: Path) -> int:
    """Number of rows of a file; -1 where it cannot be read (power failed while it was written): it is made anew."""
    try:
        count: int = pq.read_metadata(path).num_rows
    except (OSError, pa.ArrowException):
        return -1
    return count


def _refuse_other(held: Mapping[str, object], wanted: Mapping[str, object], folder: Path) -> None:
    differences = []
    if held.get("format") != wanted["format"]:
        differences.append(f"its format is {held.get('format')}, this version writes {wanted['format']}")
    for part, with_values in (("settings", True), ("model", False)):  # of the model there are hashes only
        old, new = held.get(part), wanted[part]
        old, new = old if isinstance(old, dict) else {}, new if isinstance(new, dict) else {}
        for name in sorted({*old, *new}):
            if old.get(name) != new.get(name):
                values = f"{name} = {old.get(name)}, not {new.get(name)}"
                differences.append(values if with_values else f"other {name}")
    if differences:
        raise InputError(
            f"this store was made with {'; '.join(differences)}; ask for the same again, or remove the folder",
            source=folder,
        )


def _other_versions(held: Mapping[str, object]) -> tuple[str, ...]:
    """A note where libraries changed since: draws of one seed may then differ in their last digits, no more."""
    versions = held.get("versions")
    changed = [
        f"{name} {versions[name]}, now {package_version(name)}"
        for name in _VERSIONED
        if isinstance(versions, dict) and name in versions and versions[name] != package_version(name)
    ]
    if not changed:
        return ()
    return (f"draws kept here were begun with {'; '.join(changed)}: old and new ones may differ in their last digits",)


def _together(tables: Iterable[pa.Table], plan: Plan | None) -> pd.DataFrame:
    """All draws among `tables`, or those of a plan, ordered by set, level and number, each once."""
    kept = list(tables)
    if not kept:
        return pd.DataFrame(columns=list(FIELDS))
    draws = pa.concat_tables(kept).to_pandas()
    if plan is not None:
        sets, levels = [varied.value for varied in plan.sets], list(plan.levels)
        draws = draws[(draws["draw"] < plan.draws) & draws["set"].isin(sets) & draws["level"].isin(levels)]
    draws = draws.drop_duplicates(list(KEYS))
    order = {varied.value: varied.key for varied in Varied}
    return draws.sort_values(list(KEYS), key=lambda c: c.map(order) if c.name == "set" else c, ignore_index=True)
