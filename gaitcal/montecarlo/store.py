"""Where results are kept: `DIR/montecarlo/`, one Parquet file per chunk, each written whole.

What is missing is told by the names of the files alone, so that a run killed at any moment goes on where it was, and
a larger number of draws runs only the new ones. The folder `draws` can be read as one Parquet data set.
`settings.json` says what the draws depend on; a store made with other settings or another model is refused.

The records of draws as tables: one row per draw, the same whatever order they came in.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.errors import InputError
from gaitcal.files.atomic import atomic_file, atomic_text
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.chunk import CHUNK_DRAWS, Chunk, ChunkResult, cut
from gaitcal.montecarlo.draw import COLUMNS
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan, Varied

FORMAT = 1
"""Raised whenever the same settings would give other draws."""
_NAME = re.compile(r"(jp|ip|both|noise)_(\d{4})_(\d{8})_(\d{8})\.parquet")
_VERSIONED = ("gaitcal", "numpy", "scipy", "pin")


class Store:
    """The results of one case with one kind of settings."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.draws = folder / "draws"

    def open(self, case: MonteCarloCase, settings: MonteCarloSettings) -> tuple[str, ...]:
        """Make the store, or make sure that it holds draws of this case with these settings.

        Returns notes: libraries of other versions than those that the store was made with.

        Raises
        ------
        InputError
            It was made with other settings or another model; the message names the differences.
        """
        wanted = {"format": FORMAT, "settings": dict(settings.as_json()), "model": dict(case.fingerprint())}
        path = self.folder / "settings.json"
        if path.exists():
            found = _read_json(path)
            _refuse_other(found, wanted, path)
            return _other_versions(found)
        if any(self.draws.glob("*.parquet")):
            raise InputError(
                "found draws without the settings they were made with; remove the folder", source=self.folder
            )
        content = {**wanted, "case": case.name, "versions": {name: _version(name) for name in _VERSIONED}}
        atomic_text(path, json.dumps(content, indent=1) + "\n")
        return ()

    @property
    def case_name(self) -> str | None:
        """The trial whose draws are here; None where there are none yet."""
        path = self.folder / "settings.json"
        found = _read_json(path).get("case") if path.exists() else None
        return found if isinstance(found, str) else None

    def require_model_of(self, case: MonteCarloCase) -> None:
        """Make sure, before draws are read, that they are of this case; InputError as of `open`."""
        path = self.folder / "settings.json"
        if path.exists():
            found = _read_json(path)
            _refuse_other(found, {**found, "model": dict(case.fingerprint())}, path)

    def write(self, result: ChunkResult) -> None:
        """Keep the records of a chunk."""
        chunk = result.chunk
        name = f"{chunk.varied.value}_{chunk.level:04d}_{chunk.first:08d}_{chunk.stop:08d}.parquet"
        with atomic_file(self.draws / name) as path:
            pq.write_table(table_of(result), path)

    def missing(self, plan: Plan, size: int = CHUNK_DRAWS) -> Iterator[Chunk]:
        """Chunks of a plan that are not there yet."""
        return missing_chunks(list(self._files().values()), plan, size)

    def read(self, plan: Plan | None = None) -> pd.DataFrame:
        """All draws that are there, or those of a plan; columns `records.FIELDS`."""
        return together((pq.read_table(self.draws / name) for name in sorted(self._files())), plan)

    def _files(self) -> dict[str, Chunk]:
        """Name -> chunk of every file that is whole."""
        out = {}
        for path in self.draws.glob("*.parquet"):
            told = _NAME.fullmatch(path.name)
            if told is None:
                continue
            chunk = Chunk(Varied(told[1]), int(told[2]), int(told[3]), int(told[4]))
            if _rows(path) == chunk.draws:
                out[path.name] = chunk
        return out


def missing_chunks(held: Sequence[Chunk], plan: Plan, size: int = CHUNK_DRAWS) -> Iterator[Chunk]:
    """What a plan still needs beside the chunks `held`, cut at multiples of `size` draws."""
    for varied, level in plan.cells:
        own = sorted((c.first, c.stop) for c in held if (c.varied, c.level) == (varied, level))
        at = 0
        for first, stop in [*own, (plan.draws, plan.draws)]:
            for a, b in cut(at, min(first, plan.draws), size):
                yield Chunk(varied, level, a, b)
            at = max(at, stop)


def _rows(path: Path) -> int:
    """Number of rows of a file; -1 where it cannot be read (power failed while it was written): it is made anew."""
    try:
        count: int = pq.read_metadata(path).num_rows
    except (OSError, pa.ArrowException):
        return -1
    return count


def _read_json(path: Path) -> dict[str, object]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", source=path) from None
    return content if isinstance(content, dict) else {}


def _refuse_other(found: Mapping[str, object], wanted: Mapping[str, object], path: Path) -> None:
    differences = []
    if found.get("format") != wanted["format"]:
        differences.append(f"its format is {found.get('format')}, this version writes {wanted['format']}")
    for part, tell in (("settings", True), ("model", False)):
        old, new = found.get(part), wanted[part]
        old, new = old if isinstance(old, dict) else {}, new if isinstance(new, dict) else {}
        for name in sorted({*old, *new}):
            if old.get(name) != new.get(name):
                differences.append(f"{name} = {old.get(name)}, not {new.get(name)}" if tell else f"other {name}")
    if differences:
        raise InputError(
            f"this store was made with {'; '.join(differences)}; ask for the same again, or remove the folder",
            source=path.parent,
        )


def _other_versions(found: Mapping[str, object]) -> tuple[str, ...]:
    """A note where libraries changed since: draws of one seed may then differ in their last digits, no more."""
    held = found.get("versions")
    told = [
        f"{name} {held[name]}, now {_version(name)}"
        for name in _VERSIONED
        if isinstance(held, dict) and name in held and held[name] != _version(name)
    ]
    if not told:
        return ()
    return (f"draws kept here were begun with {'; '.join(told)}: old and new ones may differ in their last digits",)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)


def table_of(result: ChunkResult) -> pa.Table:
    """The records of a chunk, columns `FIELDS`."""
    chunk = result.chunk
    columns: dict[str, pa.Array] = {
        "set": pa.array([chunk.varied.value] * chunk.draws),
        "level": pa.array(np.full(chunk.draws, chunk.level, dtype=np.int64)),
        "draw": pa.array(np.arange(chunk.first, chunk.stop, dtype=np.int64)),
        "evaluations": pa.array(result.evaluations),
        "failure": pa.array(result.failures, pa.string()),
    }
    return pa.table(columns | {name: pa.array(result.values[:, k]) for k, name in enumerate(COLUMNS)})


def together(tables: Iterable[pa.Table], plan: Plan | None = None) -> pd.DataFrame:
    """All draws among `tables`, or those of a plan, ordered by set, level and number, each once."""
    kept = list(tables)
    if not kept:
        return pd.DataFrame(columns=list(FIELDS))
    draws = pa.concat_tables(kept).to_pandas()
    order = {varied.value: varied.key for varied in Varied}
    if plan is not None:
        sets, levels = [varied.value for varied in plan.sets], list(plan.levels)
        draws = draws[(draws["draw"] < plan.draws) & draws["set"].isin(sets) & draws["level"].isin(levels)]
    draws = draws.drop_duplicates(list(KEYS))
    return draws.sort_values(list(KEYS), key=lambda c: c.map(order) if c.name == "set" else c, ignore_index=True)
