"""The Monte Carlo study of a case: what is missing is computed, all is kept, and the whole is returned.

Workers get the case and the settings with every chunk of draws (some ten kilobytes) and keep what they made of them,
so that a worker can join or be replaced at any time.

Where draws are kept: `DIR/montecarlo/`, one Parquet file per chunk, each written whole; or in memory.

A chunk is a run of draws of one cell (a set at a level): the unit that is computed, stored, and lost when a process
dies. What is missing is told by the files that are whole, so that a run killed at any moment goes on where it was, and
a larger number of draws runs only the new ones. The folder `draws` can be read as one Parquet data set, one row per
draw, the same whatever order they came in. `settings.json` says what the draws depend on; a store made with other
settings or another model is refused.

The name of a chunk ends in the beginning of its SHA-256, which is compared before anything of it is read: a chunk that
was damaged is removed, named, and made again. Each also says which settings it was made with, so that a damaged
`settings.json` costs no draw.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.codes import Code
from gaitcal.errors import GaitcalError, InputError
from gaitcal.io.atomic import atomic_file, atomic_text, disk_errors
from gaitcal.io.lock import UNFINISHED, locked
from gaitcal.io.snapshot import SELF, self_hash
from gaitcal.io.toml import package_version
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.draw import COLUMNS, DrawResult, MonteCarloContext, draw
from gaitcal.published.protocol import MonteCarloSettings, Plan, Varied
from gaitcal.published.statistics import statistics, unconverged
from gaitcal.published.workers import LocalProcesses, Workers
from gaitcal.runtime import with_one_blas_thread

FORMAT = 2
"""Raised whenever the same settings would give other draws."""
KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)
_NAME = re.compile(r"(jp|ip|both|noise)_(\d{4})_(\d{8})_(\d{8})_([0-9a-f]{16})\.parquet")
_MADE_WITH = b"gaitcal.made_with"
"""Entry of a chunk's Parquet schema: SHA-256 of format, settings and model."""
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
        self._made_with = ""

    def open(self, case: MonteCarloCase, settings: MonteCarloSettings) -> tuple[str, ...]:
        """Make the store, or make sure that it holds draws of this case with these settings; remove damaged chunks.

        Returns notes: what was damaged, and libraries of other versions than those that the store was made with.

        Raises
        ------
        InputError
            It was made with other settings or another model; the message names the differences.
        """
        wanted = {"format": FORMAT, "settings": dict(settings.as_json()), "model": dict(case.fingerprint())}
        self._made_with = self_hash(wanted)
        damaged = self._remove_damaged()
        notes = tuple(f"{name}: was damaged; its draws are made again" for name in damaged)
        if self._settings.exists():
            try:
                held = self._held()
            except InputError:
                if not all(self._is_of(path, self._made_with) for path in self.draws.glob("*.parquet")):
                    raise
                notes = (*notes, f"{self._settings.name} was damaged; it is written again, the draws say what it held")
            else:
                _refuse_other(held, wanted, self.folder)
                return (*notes, *_other_versions(held))
        elif any(self.draws.glob("*.parquet")):
            raise InputError(
                "found draws without the settings they were made with; remove the folder",
                source=self.folder,
                code=Code.MONTE_CARLO,
            )
        content = {**wanted, "case": case.name, "versions": {name: package_version(name) for name in _VERSIONED}}
        atomic_text(self._settings, json.dumps({**content, SELF: self_hash(content)}, indent=1) + "\n")
        return notes

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
            raise InputError(
                f"cannot be read: {error}; remove the folder", source=self._settings, code=Code.MONTE_CARLO
            ) from None
        if not isinstance(content, dict) or (SELF in content and content[SELF] != self_hash(content)):
            raise InputError(
                "is damaged, or was edited: not as gaitcal wrote it; remove the folder",
                source=self._settings,
                code=Code.MONTE_CARLO,
            )
        return content

    def write(self, chunk: Chunk, draws: pa.Table) -> None:
        """Keep the records of a chunk; InputError where that cannot be."""
        buffer = pa.BufferOutputStream()
        pq.write_table(draws.replace_schema_metadata({_MADE_WITH: self._made_with}), buffer)
        content: bytes = buffer.getvalue().to_pybytes()
        cell = f"{chunk.varied.value}_{chunk.level:04d}_{chunk.first:08d}_{chunk.stop:08d}"
        target = self.draws / f"{cell}_{_beginning(content)}.parquet"
        # Under the lock of the result: not while another one takes its place, and this folder along.
        with disk_errors(self.folder), locked(self.folder), atomic_file(target) as path:
            path.write_bytes(content)

    def missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        """Chunks of a plan that are not there yet."""
        held = [chunk for path, chunk in self._named() if _content(path) is not None]
        return missing_chunks(held, plan, size)

    def read(self, plan: Plan | None = None) -> pd.DataFrame:
        """All draws that are there, or those of a plan; columns `FIELDS`.

        Raises
        ------
        InputError
            A chunk is damaged.
        """
        return _together((_whole(path) for path, _ in self._named()), plan)

    def _named(self) -> list[tuple[Path, Chunk]]:
        """Every file with the name of a chunk, in the order of names."""
        matches = ((path, _NAME.fullmatch(path.name)) for path in sorted(self.draws.glob("*.parquet")))
        return [(path, Chunk(Varied(m[1]), int(m[2]), int(m[3]), int(m[4]))) for path, m in matches if m]

    def _remove_damaged(self) -> list[str]:
        damaged = [path for path, _ in self._named() if _content(path) is None]
        for path in damaged:
            path.unlink(missing_ok=True)
        for left in self.draws.glob(f"{UNFINISHED}*"):  # of a run that was killed
            shutil.rmtree(left, ignore_errors=True)
        return [path.name for path in damaged]

    def _is_of(self, path: Path, made_with: str) -> bool:
        """Whether a chunk says that it was made so."""
        metadata: dict[bytes, bytes] = pq.read_schema(path).metadata or {}
        return metadata.get(_MADE_WITH) == made_with.encode()


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


def _beginning(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _content(path: Path) -> bytes | None:
    """A chunk's file; None where it is not as it was written (power failed, a disk is bad, a copy broke off)."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content if path.stem.endswith(f"_{_beginning(content)}") else None


def _whole(path: Path) -> pa.Table:
    content = _content(path)
    if content is None:
        raise InputError(
            "is damaged; run the same study again, which makes it again", source=path, code=Code.MONTE_CARLO
        )
    return pq.read_table(pa.BufferReader(content)).replace_schema_metadata()


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
            code=Code.MONTE_CARLO,
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


DrawProgress = Callable[[int, int], None]
"""Called with the number of draws done and to be done, of those that this run computes."""

CHUNK_DRAWS = 250
"""Some seconds of work."""
STEP = 1.2
"""Factor by which `until_converged` raises the number of draws."""
MOST_DRAWS = 100_000
TRIES = 3
"""The draws are all there after the first, unless somebody removes files meanwhile or a disk is bad."""


@dataclass(frozen=True, kw_only=True)
class MonteCarloStudy:
    """A finished study."""

    case: MonteCarloCase
    settings: MonteCarloSettings
    plan: Plan
    draws: pd.DataFrame
    """One row per draw, columns `store.FIELDS`."""
    statistics: pd.DataFrame
    """See `statistics.statistics`."""
    computed: int
    """Draws that this run computed; the others were there."""
    notes: tuple[str, ...] = ()
    """What a reader should know of the draws that were there."""

    @property
    def converged(self) -> bool:
        """Whether every torque of every set and level meets the published criterion."""
        return bool(unconverged(self.statistics).empty)

    @property
    def failed(self) -> int:
        """Number of draws that did not converge."""
        return int((self.draws["failure"] != "").sum())


@with_one_blas_thread
def monte_carlo(
    case: MonteCarloCase,
    folder: Path | str | None = None,
    *,
    settings: MonteCarloSettings | None = None,
    plan: Plan | None = None,
    workers: Workers | None = None,
    progress: DrawProgress | None = None,
    until_converged: bool = False,
    chunk_draws: int = CHUNK_DRAWS,
) -> MonteCarloStudy:
    """Disturb a model thousands of times and collect what becomes of its joint torques.

    Parameters
    ----------
    case : `nominal_case()`, `case_of(calibration)` or `case_from(folder)` of `gaitcal.published.case`.
    folder : where draws are kept and a later run goes on, and where `montecarlo.csv` goes; None keeps nothing.
    settings : seed and bounds: what a draw depends on; as published unless given.
    plan : which sets are disturbed, at which levels, how often; as published unless given.
    workers : who computes; `LocalProcesses()` unless given.
    progress : called with the numbers of draws done and to be done.
    until_converged : raise the number of draws until the published criterion is met (or `MOST_DRAWS` is reached).
    chunk_draws : draws computed and stored together; the results do not depend on it.

    Raises
    ------
    InputError
        The folder holds a study of another model or with other settings, or another process works in it.
    """
    settings, plan = settings or MonteCarloSettings(), plan or Plan()
    workers = workers or LocalProcesses()
    progress = progress or (lambda done, todo: None)
    if folder is None:
        return _study(case, MemoryStore(), settings, plan, workers, progress, until_converged, chunk_draws)
    with alone(Path(folder)):
        return _study(case, Store(Path(folder)), settings, plan, workers, progress, until_converged, chunk_draws)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """No other Monte Carlo study works in the folder meanwhile: it would compute the same draws a second time."""
    with ExitStack() as stack:
        with disk_errors(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder, "monte carlo study"))
        yield


def _study(
    case: MonteCarloCase,
    store: Store | MemoryStore,
    settings: MonteCarloSettings,
    plan: Plan,
    workers: Workers,
    progress: DrawProgress,
    until_converged: bool,
    chunk_draws: int,
) -> MonteCarloStudy:
    notes = store.open(case, settings) if isinstance(store, Store) else ()
    computed = 0
    while True:
        computed += _compute(case, store, settings, plan, workers, progress, chunk_draws)
        draws = store.read(plan)
        table = statistics(draws)
        if not until_converged or plan.draws >= MOST_DRAWS or unconverged(table).empty:
            break
        plan = replace(plan, draws=min(int(STEP * plan.draws) + 1, MOST_DRAWS))
    if isinstance(store, Store):
        with atomic_file(store.folder / "montecarlo.csv") as path:
            table.to_csv(path, index=False, lineterminator="\n")
    return MonteCarloStudy(
        case=case, settings=settings, plan=plan, draws=draws, statistics=table, computed=computed, notes=notes
    )


def _compute(
    case: MonteCarloCase,
    store: Store | MemoryStore,
    settings: MonteCarloSettings,
    plan: Plan,
    workers: Workers,
    progress: DrawProgress,
    chunk_draws: int,
) -> int:
    """Compute what is missing of a plan, until nothing is; returns the number of draws."""
    computed = 0
    for _ in range(TRIES):
        chunks = list(store.missing(plan, chunk_draws))
        if not chunks:
            return computed
        done, todo = 0, sum(len(chunk.numbers) for chunk in chunks)
        progress(done, todo)
        with closing(_generator(workers.run(partial(run_chunk, case, settings), chunks))) as results:
            for chunk, records_of_chunk in results:
                store.write(chunk, records_of_chunk)
                done += len(chunk.numbers)
                progress(done, todo)
        computed += done
    raise GaitcalError("draws that were written are not there when they are read back; is the disk sound?")


def _generator(results: Iterator[tuple[Chunk, pa.Table]]) -> Generator[tuple[Chunk, pa.Table], None, None]:
    """The same, to be closed where the study is interrupted: workers then end at once."""
    yield from results


_kept = threading.local()


@with_one_blas_thread
def run_chunk(case: MonteCarloCase, settings: MonteCarloSettings, chunk: Chunk) -> tuple[Chunk, pa.Table]:
    """Compute a chunk. BLAS works with one thread, wherever this runs: more would change the last bits."""
    context = _context(case, settings)
    return chunk, records(chunk, [draw(context, chunk.varied, chunk.level, k) for k in chunk.numbers])


def _context(case: MonteCarloCase, settings: MonteCarloSettings) -> MonteCarloContext:
    """The context of a case, made once per thread and kept until another case comes."""
    key = (case.fingerprint(), settings)
    if getattr(_kept, "key", None) != key:
        _kept.context = MonteCarloContext(case, settings)
        _kept.key = key
    context: MonteCarloContext = _kept.context
    return context
