"""Run the Monte Carlo study of a case: compute missing draws, store them, summarise all.

Workers get the case and the settings with every chunk of draws (some ten kilobytes), so that a
worker can join or be replaced at any time. A chunk is a run of draws of one cell (a set at a
level): the unit that is computed, stored, and lost when a process dies. Chunks are Parquet files in
`DIR/montecarlo/draws`, which can be read as one data set. A run that was killed continues with the
chunks that are missing.

`settings.json` has what the draws depend on; a store made with other settings or another model is
refused. The name of a chunk ends in the beginning of its SHA-256: a damaged chunk is removed,
reported, and computed again. Each chunk also has the hash of its settings, so that a damaged
`settings.json` loses no draw.
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
from gaitcal.montecarlo.draw_statistics import compute_statistics, select_unconverged
from gaitcal.montecarlo.protocol import MonteCarloSettings, Plan, Varied
from gaitcal.montecarlo.workers import LocalProcesses, Workers, lock_folder
from gaitcal.runtime import with_one_blas_thread

FORMAT = 2
"""Increased whenever the same settings would give other draws."""
KEYS = ("set", "level", "draw")
FIELDS = (*KEYS, "evaluations", "failure", *COLUMNS)
PURPOSE = "monte carlo study"
"""Of the lock on a store."""
CHUNK_DRAWS = 250
"""Some seconds of work."""
STEP = 1.2
"""Factor by which `until_converged` increases the number of draws."""
MOST_DRAWS = 100_000
TRIES = 3
"""Times that missing draws are computed: once, unless files disappear or a disk is damaged."""
_NAME = re.compile(r"(jp|ip|both|noise)_(\d{4})_(\d{8})_(\d{8})_([0-9a-f]{16})\.parquet")
_MADE_WITH = b"gaitcal.made_with"
"""Entry of a chunk's Parquet schema: SHA-256 of format, settings and model."""
_VERSIONED = ("gaitcal", "numpy", "scipy", "pin")

DrawProgress = Callable[[int, int], None]
"""Called with the number of draws done, and of all that this run computes."""


@dataclass(frozen=True)
class Chunk:
    """Draws first, first + 1, ..., stop - 1 of a set at a level."""

    varied: Varied
    level: int
    first: int
    stop: int

    @property
    def numbers(self) -> range:
        """Numbers of its draws."""
        return range(self.first, self.stop)


class Store:
    """The stored draws of one case with one kind of settings."""

    def __init__(self, folder: Path) -> None:
        """Refer to a folder, which need not exist yet.

        Parameters
        ----------
        folder : Path
            Of the store.
        """
        self.folder = folder
        self.draws = folder / "draws"
        self._settings = folder / "settings.json"
        self._made_with = ""

    def open(self, case: MonteCarloCase, settings: MonteCarloSettings) -> tuple[str, ...]:
        """Create the store, or check that its draws are of this case and these settings.

        Damaged chunks are removed.

        Parameters
        ----------
        case : MonteCarloCase
            The undisturbed case.
        settings : MonteCarloSettings
            Seed and bounds.

        Returns
        -------
        tuple of str
            Notes: damaged files, and libraries of other versions than when the store was made.

        Raises
        ------
        InputError
            It was made with other settings or another model; the message names the differences.
        """
        # Draws with other settings, or of another model, cannot be pooled.
        wanted = {
            "format": FORMAT,
            "settings": dict(settings.convert_to_json()),
            "model": dict(case.compute_fingerprint()),
        }
        self._made_with = hash_manifest(wanted)
        notes = [
            f"{path.name} was damaged; its draws are computed again"
            for path in self._remove_damaged()
        ]
        chunks = list(self.draws.glob("*.parquet"))
        if self._settings.exists():
            try:
                stored = self._read_settings()
                self._refuse_other(stored, wanted)
                return (*notes, *_note_other_versions(stored.get("versions")))
            except _DamagedError:
                # Every chunk has the hash of its settings, too.
                made_with = [
                    (pq.read_schema(path).metadata or {}).get(_MADE_WITH) for path in chunks
                ]
                if any(hashed != self._made_with.encode() for hashed in made_with):
                    raise
                notes.append(
                    f"{self._settings.name} was damaged; it is written again, as its draws have "
                    "the same settings"
                )
        elif chunks:
            message = "found draws, but no settings.json; remove the folder"
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
        """Trial whose draws are stored; None if there are none yet."""
        name = self._read_settings().get("case") if self._settings.exists() else None
        return name if isinstance(name, str) else None

    def require_model(self, case: MonteCarloCase) -> None:
        """Check, before draws are read, that they are of this case.

        Parameters
        ----------
        case : MonteCarloCase
            The undisturbed case.

        Raises
        ------
        InputError
            As of `open`.
        """
        if self._settings.exists():
            stored = self._read_settings()
            self._refuse_other(stored, {**stored, "model": dict(case.compute_fingerprint())})

    def _read_settings(self) -> dict[str, object]:
        """Read what the stored draws were made with."""
        try:
            content = json.loads(self._settings.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise _DamagedError(
                f"cannot be read: {error}; remove the folder", source=self._settings
            ) from None
        if not isinstance(content, dict) or (
            SELF_HASH in content and content[SELF_HASH] != hash_manifest(content)
        ):
            message = "is damaged or was edited; remove the folder"
            raise _DamagedError(message, source=self._settings)
        return content

    def _refuse_other(self, stored: Mapping[str, object], wanted: Mapping[str, object]) -> None:
        """Raise InputError if the store was made with other settings or another model."""
        differences = []
        if stored.get("format") != wanted["format"]:
            differences.append(
                f"format {stored.get('format')} (this version writes {wanted['format']})"
            )
        for part in ("settings", "model"):
            old, new = (
                content if isinstance(content, dict) else {}
                for content in (stored.get(part), wanted[part])
            )
            for name in sorted({*old, *new}):
                if old.get(name) != new.get(name):
                    # Of the model there are only hashes.
                    values = f"{name} = {old.get(name)}, not {new.get(name)}"
                    differences.append(values if part == "settings" else f"other {name}")
        if differences:
            message = (
                f"this store was made with {'; '.join(differences)}; use the same settings and "
                "model, or remove the folder"
            )
            raise InputError(message, source=self.folder, code=Code.MONTE_CARLO)

    def write(self, chunk: Chunk, draws: pa.Table) -> None:
        """Store the draws of a chunk.

        Parameters
        ----------
        chunk : Chunk
            Which draws.
        draws : pyarrow.Table
            Columns `FIELDS`.

        Raises
        ------
        InputError
            The disk cannot be written.
        """
        buffer = pa.BufferOutputStream()
        pq.write_table(draws.replace_schema_metadata({_MADE_WITH: self._made_with}), buffer)
        content: bytes = buffer.getvalue().to_pybytes()
        cell = f"{chunk.varied.value}_{chunk.level:04d}_{chunk.first:08d}_{chunk.stop:08d}"
        # The name holds the hash of the content, so that damage is noticed.
        target = self.draws / f"{cell}_{_hash_beginning(content)}.parquet"
        # Under the lock of the result, which another result may replace together with this folder.
        with (
            atomic.convert_disk_errors(self.folder),
            lock_result(self.folder),
            atomic.write_atomically(target) as path,
        ):
            path.write_bytes(content)

    def list_missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        """List the chunks of a plan that are not stored.

        `size`: draws at whose multiples chunks are cut.
        """
        stored = [chunk for path, chunk in self._list_chunks() if _read_intact(path) is not None]
        for varied, level in plan.cells:
            absent = np.ones(plan.draws, dtype=bool)
            for chunk in stored:
                if (chunk.varied, chunk.level) == (varied, level):
                    absent[chunk.first : chunk.stop] = False
            numbers = np.flatnonzero(absent)
            cuts = 1 + np.flatnonzero((np.diff(numbers) > 1) | (numbers[1:] % size == 0))
            for run in np.split(numbers, cuts) if len(numbers) else ():
                yield Chunk(varied, level, int(run[0]), int(run[-1]) + 1)

    def read(self, plan: Plan | None = None) -> pd.DataFrame:
        """Read the stored draws, ordered by set, level and number.

        Parameters
        ----------
        plan : Plan, optional
            Whose draws; all if not given.

        Returns
        -------
        DataFrame
            Columns `FIELDS`.

        Raises
        ------
        InputError
            A chunk is damaged.
        """
        tables = []
        for path, _ in self._list_chunks():
            content = _read_intact(path)
            if content is None:
                message = "is damaged; run the same study again, which computes it again"
                raise InputError(message, source=path, code=Code.MONTE_CARLO)
            tables.append(pq.read_table(pa.BufferReader(content)).replace_schema_metadata())
        if not tables:
            return pd.DataFrame(columns=list(FIELDS))
        # Chunks may overlap after an interruption; a draw counts once.
        draws = pa.concat_tables(tables).to_pandas()
        if plan is not None:
            sets, levels = [varied.value for varied in plan.sets], list(plan.levels)
            draws = draws[
                (draws["draw"] < plan.draws) & draws["set"].isin(sets) & draws["level"].isin(levels)
            ]
        return _sort_draws(draws.drop_duplicates(list(KEYS)), KEYS)

    def _list_chunks(self) -> list[tuple[Path, Chunk]]:
        """List every file with the name of a chunk, in the order of names."""
        matches = (
            (path, _NAME.fullmatch(path.name)) for path in sorted(self.draws.glob("*.parquet"))
        )
        return [
            (path, Chunk(Varied(m[1]), int(m[2]), int(m[3]), int(m[4]))) for path, m in matches if m
        ]

    def _remove_damaged(self) -> list[Path]:
        """Remove damaged chunks, and unfinished ones of a run that was killed."""
        damaged = [path for path, _ in self._list_chunks() if _read_intact(path) is None]
        for path in damaged:
            path.unlink(missing_ok=True)
        for unfinished in self.draws.glob(f"{atomic.UNFINISHED_PREFIX}*"):
            shutil.rmtree(unfinished, ignore_errors=True)
        return damaged


class _DamagedError(InputError):
    """`settings.json` is not as it was written."""

    code = Code.MONTE_CARLO


def _hash_beginning(content: bytes) -> str:
    """Compute the first 16 digits of the SHA-256."""
    return hashlib.sha256(content).hexdigest()[:16]


def _read_intact(path: Path) -> bytes | None:
    """Read the file of a chunk; None if it is not as written (power failure, broken copy)."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content if path.stem.endswith(f"_{_hash_beginning(content)}") else None


def _note_other_versions(versions: object) -> tuple[str, ...]:
    """Note libraries that changed since the store was made: draws may differ in the last digits."""
    before = versions if isinstance(versions, dict) else {}
    now = {name: toml.get_package_version(name) for name in _VERSIONED}
    changed = [
        f"{n} {before[n]}, now {version}"
        for n, version in now.items()
        if before.get(n, version) != version
    ]
    note = (
        f"the stored draws were computed with {'; '.join(changed)}: old and new draws may differ "
        "in their last digits"
    )
    return (note,) if changed else ()


def _sort_draws(frame: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Sort rows by columns, with sets in the order of `Varied`.

    `frame`: with a column `set`. `keys`: columns to sort by.
    """
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
    """See `draw_statistics.compute_statistics`."""
    computed: int
    """Draws that this run computed; the others were stored."""
    notes: tuple[str, ...] = ()
    """Notes on the stored draws."""

    @property
    def converged(self) -> bool:
        """Whether every torque of every set and level meets the published criterion."""
        return bool(select_unconverged(self.statistics).empty)

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
    """Disturb a model thousands of times and compute the errors of its joint torques.

    Parameters
    ----------
    case : MonteCarloCase
        `make_nominal_case()`, `make_case(calibration)` or `load_case(folder)` of
        `gaitcal.montecarlo.case`.
    folder : path, optional
        Where draws are stored, so that a later run continues, and where `montecarlo.csv` is
        written; nothing is stored if not given.
    settings : MonteCarloSettings, optional
        Seed and bounds: what a draw depends on; as published if not given.
    plan : Plan, optional
        Which sets are disturbed, at which levels, how often; as published if not given.
    workers : Workers, optional
        What computes the draws; `LocalProcesses()` if not given.
    progress : callable, optional
        Called with the number of draws done, and of all that this run computes.
    until_converged : bool
        Increase the number of draws until the published criterion is met (or `MOST_DRAWS` is
        reached).
    chunk_draws : int
        Draws computed and stored together; the results do not depend on it.

    Returns
    -------
    MonteCarloStudy

    Raises
    ------
    InputError
        The folder holds a study of another model or with other settings, or another process works
        in it.
    """
    settings, plan = settings or MonteCarloSettings(), plan or Plan()
    workers = workers or LocalProcesses()
    progress = progress or (lambda done, todo: None)
    # Workers get the case with each chunk; `run_chunk` keeps what it prepared of it.
    work = partial(run_chunk, case, settings)
    with ExitStack() as stack:
        if folder is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
        store = Store(Path(folder))
        stack.enter_context(lock_folder(store.folder, PURPOSE))
        notes, computed = store.open(case, settings), 0
        while True:
            computed += _compute_missing(store, plan, work, workers, progress, chunk_draws)
            draws = store.read(plan)
            table = compute_statistics(draws)
            if not until_converged or plan.draws >= MOST_DRAWS or select_unconverged(table).empty:
                break
            # More draws of the same streams: earlier ones are kept.
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


def _compute_missing(
    store: Store,
    plan: Plan,
    work: Callable[[Chunk], tuple[Chunk, pa.Table]],
    workers: Workers,
    progress: DrawProgress,
    size: int,
) -> int:
    """Compute the draws of a plan that are not stored, and return their number."""
    computed = 0
    for _ in range(TRIES):
        # What is missing is listed anew, as another run may have written meanwhile.
        chunks = list(store.list_missing(plan, size))
        if not chunks:
            return computed
        done, todo = 0, sum(len(chunk.numbers) for chunk in chunks)
        progress(done, todo)
        # Closing the generator stops the workers at once if the run is interrupted.
        with closing(result for result in workers.run(work, chunks)) as results:
            for chunk, draws in results:
                store.write(chunk, draws)
                done += len(chunk.numbers)
                progress(done, todo)
        computed += done
    raise GaitcalError("draws that were written cannot be read back: check the disk")


_of_thread = threading.local()
"""Fingerprint (`key`) and context of the last case of each thread."""


@with_one_blas_thread
def run_chunk(
    case: MonteCarloCase, settings: MonteCarloSettings, chunk: Chunk
) -> tuple[Chunk, pa.Table]:
    """Compute the draws of a chunk.

    BLAS uses one thread, wherever this runs: more would change the last bits.

    Returns: the chunk, and its draws in order, columns `FIELDS`.
    """
    key = (case.compute_fingerprint(), settings)
    # Preparing a case costs as much as many draws: once for each worker and case.
    if getattr(_of_thread, "key", None) != key:
        _of_thread.key, _of_thread.context = key, MonteCarloContext(case, settings)
    results: list[DrawResult] = [
        draw(_of_thread.context, chunk.varied, chunk.level, number) for number in chunk.numbers
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
