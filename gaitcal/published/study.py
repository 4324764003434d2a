"""The Monte Carlo study of a case: what is missing is computed, all is kept, and the whole is returned.

Workers get the case and the settings with every chunk of draws (some ten kilobytes) and keep what they made of them,
so that a worker can join or be replaced at any time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pandas as pd
import pyarrow as pa

from gaitcal.errors import GaitcalError
from gaitcal.io.atomic import atomic_file, disk_errors
from gaitcal.io.result_folder import locked
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.draw import MonteCarloContext, draw
from gaitcal.published.settings import MonteCarloSettings, Plan
from gaitcal.published.statistics import statistics, unconverged
from gaitcal.published.store import Chunk, MemoryStore, Store, records
from gaitcal.published.workers import LocalProcesses, Workers
from gaitcal.runtime import with_one_blas_thread

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
