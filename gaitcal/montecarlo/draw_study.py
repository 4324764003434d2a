"""The Monte Carlo study of a case: what is missing is computed, all is kept, and the whole is
returned.

Workers get the case and the settings with every chunk of draws (some ten kilobytes), so that a
worker can join or be replaced at any time. A chunk is a run of draws of one cell (a set at a
level): the unit that is computed, stored, and lost when a process dies. Chunks are Parquet files in
`DIR/montecarlo/draws`, which can be read as one data set; the files that are there tell what is
missing, so that a run killed at any moment goes on where it was.

`settings.json` says what the draws depend on; a store made with other settings or another model is
refused. The name of a chunk ends in the beginning of its SHA-256: a chunk that was damaged is
removed, named, and made again. Each also says which settings it was made with, so that a damaged
`settings.json` costs no draw.
"""

import hashlib
import json
import re
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.errors import Code, GaitcalError, InputError
from gaitcal.io import atomic, toml
from gaitcal.io.result_folder import SELF_HASH, hash_manifest, lock_result
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw import COLUMNS, DrawResult, MonteCarloContext, draw
from gaitcal.montecarlo.draw_statistics import statistics, unconverged
from gaitcal.montecarlo.protocol import MonteCarloSettings, Plan, Varied
from gaitcal.montecarlo.workers import LocalProcesses, Workers, alone
from gaitcal.runtime import with_one_blas_thread

FORMAT = 2  # Raised whenever the same settings would give other draws
KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)
PURPOSE = "monte carlo study"  # Of the lock on a store
CHUNK_DRAWS = 250  # Some seconds of work
STEP = 1.2  # Factor by which `until_converged` raises the number of draws
MOST_DRAWS = 100_000
# The draws are all there after the first, unless somebody removes files meanwhile or a disk is bad
TRIES = 3
_NAME = re.compile(r"(jp|ip|both|noise)_(\d{4})_(\d{8})_(\d{8})_([0-9a-f]{16})\.parquet")
_MADE_WITH = (
    b"gaitcal.made_with"  # Entry of a chunk's Parquet schema: SHA-256 of format, settings and model
)
_VERSIONED = ("gaitcal", "numpy", "scipy", "pin")

DrawProgress = Callable[[int, int], None]
"""Called with the number of draws done and to be done, of those that this run computes."""


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


class Store:
    """The draws of one case with one kind of settings, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.draws = folder / "draws"
        self._settings = folder / "settings.json"
        self._made_with = ""

    def open(self, case: MonteCarloCase, settings: MonteCarloSettings) -> tuple[str, ...]:
        """Make the store, or make sure that it holds draws of this case with these settings; remove
        damaged chunks.

        Returns notes: what was damaged, and libraries of other versions than those that the store
        was made with.

        Raises InputError: It was made with other settings or another model; the message names the
        differences.
        """
        wanted = {
            "format": FORMAT,
            "settings": dict(settings.as_json()),
            "model": dict(case.fingerprint()),
        }
        self._made_with = hash_manifest(wanted)
        notes = [
            f"{path.name}: was damaged; its draws are made again" for path in self._remove_damaged()
        ]
        chunks = list(self.draws.glob("*.parquet"))
        if self._settings.exists():
            try:
                held = self._held()
                self._refuse_other(held, wanted)
                return (*notes, *_other_versions(held.get("versions")))
            except _DamagedError:
                made_with = [
                    (pq.read_schema(path).metadata or {}).get(_MADE_WITH) for path in chunks
                ]
                if any(hashed != self._made_with.encode() for hashed in made_with):
                    raise
                notes.append(
                    f"{self._settings.name} was damaged; it is written again, the draws say what "
                    "it held"
                )
        elif chunks:
            message = "found draws without the settings they were made with; remove the folder"
            raise InputError(message, source=self.folder, code=Code.MONTE_CARLO)
        content = {
            **wanted,
            "case": case.name,
            "versions": {name: toml.get_package_version(name) for name in _VERSIONED},
        }
        atomic.write_text_atomically(
            self._settings,
            json.dumps({**content, SELF_HASH: hash_manifest(content)}, indent=1) + "\n",
        )
        return tuple(notes)

    @property
    def case_name(self) -> str | None:
        """The trial whose draws are here; None where there are none yet."""
        name = self._held().get("case") if self._settings.exists() else None
        return name if isinstance(name, str) else None

    def require_model_of(self, case: MonteCarloCase) -> None:
        """Make sure, before draws are read, that they are of this case; InputError as of `open`."""
        if self._settings.exists():
            held = self._held()
            self._refuse_other(held, {**held, "model": dict(case.fingerprint())})

    def _held(self) -> dict[str, object]:
        """What the draws that are here were made with."""
        try:
            content = json.loads(self._settings.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise _DamagedError(
                f"cannot be read: {error}; remove the folder", source=self._settings
            ) from None
        if not isinstance(content, dict) or (
            SELF_HASH in content and content[SELF_HASH] != hash_manifest(content)
        ):
            message = "is damaged, or was edited: not as gaitcal wrote it; remove the folder"
            raise _DamagedError(message, source=self._settings)
        return content

    def _refuse_other(self, held: Mapping[str, object], wanted: Mapping[str, object]) -> None:
        differences = []
        if held.get("format") != wanted["format"]:
            differences.append(
                f"its format is {held.get('format')}, this version writes {wanted['format']}"
            )
        for part in ("settings", "model"):
            old, new = (
                content if isinstance(content, dict) else {}
                for content in (held.get(part), wanted[part])
            )
            for name in sorted({*old, *new}):
                if old.get(name) != new.get(name):  # of the model there are hashes only
                    values = f"{name} = {old.get(name)}, not {new.get(name)}"
                    differences.append(values if part == "settings" else f"other {name}")
        if differences:
            message = (
                f"this store was made with {'; '.join(differences)}; ask for the same again, or "
                "remove the folder"
            )
            raise InputError(message, source=self.folder, code=Code.MONTE_CARLO)

    def write(self, chunk: Chunk, draws: pa.Table) -> None:
        """Keep the draws of a chunk; InputError where that cannot be."""
        buffer = pa.BufferOutputStream()
        pq.write_table(draws.replace_schema_metadata({_MADE_WITH: self._made_with}), buffer)
        content: bytes = buffer.getvalue().to_pybytes()
        cell = f"{chunk.varied.value}_{chunk.level:04d}_{chunk.first:08d}_{chunk.stop:08d}"
        target = self.draws / f"{cell}_{_beginning(content)}.parquet"
        # Under the lock of the result: not while another one takes its place, and this folder
        # along.
        with (
            atomic.convert_disk_errors(self.folder),
            lock_result(self.folder),
            atomic.write_atomically(target) as path,
        ):
            path.write_bytes(content)

    def missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        """What a plan still needs beside the chunks that are there, cut at multiples of `size`
        draws.
        """
        held = [chunk for path, chunk in self._named() if _content(path) is not None]
        for varied, level in plan.cells:
            absent = np.ones(plan.draws, dtype=bool)
            for chunk in held:
                if (chunk.varied, chunk.level) == (varied, level):
                    absent[chunk.first : chunk.stop] = False
            numbers = np.flatnonzero(absent)
            cuts = 1 + np.flatnonzero((np.diff(numbers) > 1) | (numbers[1:] % size == 0))
            for run in np.split(numbers, cuts) if len(numbers) else ():
                yield Chunk(varied, level, int(run[0]), int(run[-1]) + 1)

    def read(self, plan: Plan | None = None) -> pd.DataFrame:
        """All draws that are there, or those of a plan, ordered by set, level and number; columns
        `FIELDS`.

        Raises InputError: A chunk is damaged.
        """
        tables = []
        for path, _ in self._named():
            content = _content(path)
            if content is None:
                message = "is damaged; run the same study again, which makes it again"
                raise InputError(message, source=path, code=Code.MONTE_CARLO)
            tables.append(pq.read_table(pa.BufferReader(content)).replace_schema_metadata())
        if not tables:
            return pd.DataFrame(columns=list(FIELDS))
        draws = pa.concat_tables(tables).to_pandas()
        if plan is not None:
            sets, levels = [varied.value for varied in plan.sets], list(plan.levels)
            draws = draws[
                (draws["draw"] < plan.draws) & draws["set"].isin(sets) & draws["level"].isin(levels)
            ]
        return in_order(draws.drop_duplicates(list(KEYS)), KEYS)

    def _named(self) -> list[tuple[Path, Chunk]]:
        """Every file with the name of a chunk, in the order of names."""
        matches = (
            (path, _NAME.fullmatch(path.name)) for path in sorted(self.draws.glob("*.parquet"))
        )
        return [
            (path, Chunk(Varied(m[1]), int(m[2]), int(m[3]), int(m[4]))) for path, m in matches if m
        ]

    def _remove_damaged(self) -> list[Path]:
        damaged = [path for path, _ in self._named() if _content(path) is None]
        for path in damaged:
            path.unlink(missing_ok=True)
        for left in self.draws.glob(f"{atomic.UNFINISHED_PREFIX}*"):  # of a run that was killed
            shutil.rmtree(left, ignore_errors=True)
        return damaged


class _DamagedError(InputError):
    """`settings.json` is not as it was written."""

    code = Code.MONTE_CARLO


def _beginning(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _content(path: Path) -> bytes | None:
    """A chunk's file; None where it is not as it was written (power failed, a disk is bad, a copy
    broke off).
    """
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content if path.stem.endswith(f"_{_beginning(content)}") else None


def _other_versions(versions: object) -> tuple[str, ...]:
    """A note where libraries changed since: draws of one seed may then differ in their last digits,
    no more.
    """
    held = versions if isinstance(versions, dict) else {}
    now = {name: toml.get_package_version(name) for name in _VERSIONED}
    changed = [
        f"{n} {held[n]}, now {version}"
        for n, version in now.items()
        if held.get(n, version) != version
    ]
    note = (
        f"draws kept here were begun with {'; '.join(changed)}: old and new ones may differ in "
        "their last digits"
    )
    return (note,) if changed else ()


def in_order(frame: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Rows sorted by these columns, sets as in `Varied`."""
    order = {varied.value: varied.key for varied in Varied}
    return frame.sort_values(
        list(keys),
        key=lambda c: c.map(order) if c.name == "set" else c,
        kind="stable",
        ignore_index=True,
    )


@dataclass(frozen=True, kw_only=True)
class MonteCarloStudy:
    """A finished study."""

    case: MonteCarloCase
    settings: MonteCarloSettings
    plan: Plan
    draws: pd.DataFrame
    """One row per draw, columns `FIELDS`."""
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
    case
        `nominal_case()`, `case_of(calibration)` or `case_from(folder)` of
        `gaitcal.montecarlo.case`.
    folder
        Where draws are kept and a later run goes on, and where `montecarlo.csv` goes; None keeps
        nothing.
    settings
        Seed and bounds: what a draw depends on; as published unless given.
    plan
        Which sets are disturbed, at which levels, how often; as published unless given.
    workers
        Who computes; `LocalProcesses()` unless given.
    progress
        Called with the numbers of draws done and to be done.
    until_converged
        Raise the number of draws until the published criterion is met (or `MOST_DRAWS` is reached).
    chunk_draws
        Draws computed and stored together; the results do not depend on it.

    Raises
    ------
    InputError
        The folder holds a study of another model or with other settings, or another process works
        in it.
    """
    settings, plan, workers = (
        settings or MonteCarloSettings(),
        plan or Plan(),
        workers or LocalProcesses(),
    )
    work = partial(run_chunk, case, settings)
    with ExitStack() as stack:
        if folder is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
        store = Store(Path(folder))
        stack.enter_context(alone(store.folder, PURPOSE))
        notes, computed = store.open(case, settings), 0
        while True:
            computed += _compute(
                store, plan, work, workers, progress or (lambda done, todo: None), chunk_draws
            )
            draws = store.read(plan)
            table = statistics(draws)
            if not until_converged or plan.draws >= MOST_DRAWS or unconverged(table).empty:
                break
            plan = replace(plan, draws=min(int(STEP * plan.draws) + 1, MOST_DRAWS))
        with atomic.write_atomically(store.folder / "montecarlo.csv") as path:
            table.to_csv(path, index=False, lineterminator="\n")
    return MonteCarloStudy(
        case=case,
        settings=settings,
        plan=plan,
        draws=draws,
        statistics=table,
        computed=computed,
        notes=notes,
    )


def _compute(
    store: Store,
    plan: Plan,
    work: Callable[[Chunk], tuple[Chunk, pa.Table]],
    workers: Workers,
    progress: DrawProgress,
    size: int,
) -> int:
    """Compute what is missing of a plan, until nothing is; returns the number of draws."""
    computed = 0
    for _ in range(TRIES):
        chunks = list(store.missing(plan, size))
        if not chunks:
            return computed
        done, todo = 0, sum(len(chunk.numbers) for chunk in chunks)
        progress(done, todo)
        with closing(
            result for result in workers.run(work, chunks)
        ) as results:  # interrupted, workers end at once
            for chunk, draws in results:
                store.write(chunk, draws)
                done += len(chunk.numbers)
                progress(done, todo)
        computed += done
    raise GaitcalError(
        "draws that were written are not there when they are read back; is the disk sound?"
    )


_kept = threading.local()


@with_one_blas_thread
def run_chunk(
    case: MonteCarloCase, settings: MonteCarloSettings, chunk: Chunk
) -> tuple[Chunk, pa.Table]:
    """Compute a chunk: its draws, in order, as a table with the columns `FIELDS`.

    BLAS works with one thread, wherever this runs: more would change the last bits.
    """
    key = (case.fingerprint(), settings)
    if (
        getattr(_kept, "key", None) != key
    ):  # made once per thread, and kept until another case comes
        _kept.key, _kept.context = key, MonteCarloContext(case, settings)
    results: list[DrawResult] = [
        draw(_kept.context, chunk.varied, chunk.level, number) for number in chunk.numbers
    ]
    values = np.array([result.values for result in results])
    columns = {
        "set": [chunk.varied.value] * len(results),
        "level": [chunk.level] * len(results),
        "draw": list(chunk.numbers),
        "evaluations": [result.evaluations for result in results],
        "failure": [result.failure for result in results],
    }
    return chunk, pa.table(columns | {name: values[:, k] for k, name in enumerate(COLUMNS)})
