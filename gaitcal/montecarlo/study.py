"""The Monte Carlo study of a case: what is missing is computed, all is kept, and the whole is returned."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from gaitcal.files.atomic import atomic_file
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.chunk import CHUNK_DRAWS, Chunk, ChunkResult, ChunkTask, run_chunk
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan
from gaitcal.montecarlo.statistics import statistics, unconverged
from gaitcal.montecarlo.store import Store, missing_chunks, table_of, together
from gaitcal.montecarlo.workers import LocalProcesses, Workers

DrawProgress = Callable[[int, int], None]
"""Called with the number of draws done and to be done, of those that this run computes."""

STEP = 1.2
"""Factor by which `until_converged` raises the number of draws."""
MOST_DRAWS = 100_000


@dataclass(frozen=True)
class MonteCarloStudy:
    """A finished study."""

    case: MonteCarloCase
    settings: MonteCarloSettings
    plan: Plan
    draws: pd.DataFrame
    """One row per draw: set, level, draw, evaluations, failure, then `draw.COLUMNS`."""
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
    case : `nominal_case()` or `case_of(calibration)` of `gaitcal.montecarlo.case`, or `case_from(folder)` of
        `gaitcal.montecarlo.case`.
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
        The folder holds a study of another model or with other settings.
    """
    settings, plan = settings or MonteCarloSettings(), plan or Plan()
    workers, progress = workers or LocalProcesses(), progress or _silent
    store = _Memory() if folder is None else Store(Path(folder))
    notes = store.open(case, settings) if isinstance(store, Store) else ()
    computed = 0
    while True:
        chunks = list(store.missing(plan, chunk_draws))
        computed += _compute(store, [ChunkTask(case, settings, chunk) for chunk in chunks], workers, progress)
        draws = store.read(plan)
        table = statistics(draws)
        if not until_converged or plan.draws >= MOST_DRAWS or unconverged(table).empty:
            break
        plan = replace(plan, draws=min(int(STEP * plan.draws) + 1, MOST_DRAWS))
    if isinstance(store, Store):
        with atomic_file(store.folder / "montecarlo.csv") as path:
            table.to_csv(path, index=False, lineterminator="\n")
    return MonteCarloStudy(case, settings, plan, draws, table, computed, notes)


def _silent(done: int, todo: int) -> None:
    """Show nothing."""


def _compute(store: Store | _Memory, tasks: list[ChunkTask], workers: Workers, progress: DrawProgress) -> int:
    """Compute and keep chunks; returns the number of draws."""
    todo, done = sum(task.chunk.draws for task in tasks), 0
    if tasks:
        progress(0, todo)
        with closing(_generator(workers.run(run_chunk, tasks))) as results:
            for result in results:
                store.write(result)
                done += result.chunk.draws
                progress(done, todo)
    return done


def _generator(results: Iterator[ChunkResult]) -> Generator[ChunkResult, None, None]:
    yield from results


class _Memory:
    """A store that is gone with the process."""

    def __init__(self) -> None:
        self._results: list[ChunkResult] = []

    def write(self, result: ChunkResult) -> None:
        self._results.append(result)

    def missing(self, plan: Plan, size: int) -> Iterator[Chunk]:
        return missing_chunks([result.chunk for result in self._results], plan, size)

    def read(self, plan: Plan) -> pd.DataFrame:
        return together((table_of(result) for result in self._results), plan)
