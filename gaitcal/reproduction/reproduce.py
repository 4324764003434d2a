"""The whole reproduction: synthetic truth without noise and with many draws of it, tables, claims, real people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gaitcal.montecarlo.case import nominal_case
from gaitcal.montecarlo.settings import MonteCarloSettings, Plan, Varied
from gaitcal.montecarlo.study import monte_carlo
from gaitcal.montecarlo.workers import LocalProcesses
from gaitcal.reproduction.claims import table_claims
from gaitcal.reproduction.disturbance_claims import WIDE_PERCENT, Disturbances, disturbance_claims
from gaitcal.reproduction.inertial_recovery import RANDOM_SEEDS
from gaitcal.reproduction.inertial_tables import discussion_rows, table_four_rows, table_three_rows
from gaitcal.reproduction.joint_tables import table_one_rows, table_two_rows, time_rows
from gaitcal.reproduction.noise_seed import SeedResult, noiseless, noisy_draws
from gaitcal.reproduction.people import people_rows
from gaitcal.reproduction.rows import Claim, TableRow
from gaitcal.runtime import Progress, silent

NOISE_SEEDS = 20


@dataclass(frozen=True)
class ReproductionSettings:
    """How much to do."""

    noise_seeds: int = NOISE_SEEDS
    seed: int = 0
    random_seeds: int = RANDOM_SEEDS
    """Of phase 2, for each draw of the noise; at least 2."""
    draws: int = 0
    """Of the Monte Carlo study, each set and level; 0: none."""
    jobs: int = -1
    """Processes; -1: one for every core. The results do not depend on it."""
    data: Path | None = None
    """Folder of real recordings, for the people shown instead of the experimental trial."""


@dataclass(frozen=True)
class Reproduction:
    """Everything that was computed."""

    settings: ReproductionSettings
    clean: SeedResult
    noisy: list[SeedResult]
    tables: list[TableRow]
    times: list[TableRow]
    claims: list[Claim]
    disturbances: pd.DataFrame | None
    """Statistics of the Monte Carlo study; see `monte_carlo.statistics`."""


def reproduce(
    settings: ReproductionSettings | None = None, draws_folder: Path | None = None, progress: Progress = silent
) -> Reproduction:
    """Run the published study.

    Parameters
    ----------
    draws_folder : where Monte Carlo draws are kept, so that an interrupted study goes on; None keeps nothing.
    """
    settings = settings or ReproductionSettings()
    progress("without noise")
    clean = noiseless(settings.seed, settings.random_seeds)
    progress(f"{settings.noise_seeds} draws of the noise")
    noisy = noisy_draws(settings.seed, settings.noise_seeds, settings.jobs, settings.random_seeds)
    rows = [
        *table_one_rows(clean, noisy),
        *table_two_rows(noisy),
        *table_three_rows(clean, noisy),
        *table_four_rows(noisy),
        *discussion_rows(noisy),
    ]
    if settings.data is not None:
        rows += people_rows(settings.data, progress)
    found = _disturb(settings, draws_folder, progress) if settings.draws else None
    return Reproduction(
        settings,
        clean,
        noisy,
        rows,
        time_rows([clean, *noisy]),
        [*table_claims(clean, noisy), *disturbance_claims(found)],
        None if found is None else found.table,
    )


def _disturb(settings: ReproductionSettings, folder: Path | None, progress: Progress) -> Disturbances:
    case, workers = nominal_case(), LocalProcesses(settings.jobs)

    def tell(words: str) -> Callable[[int, int], None]:
        return lambda done, todo: progress(f"Monte Carlo, {words}: {done} of {todo} draws")

    usual = monte_carlo(
        case,
        None if folder is None else folder / "published",
        settings=MonteCarloSettings(settings.seed),
        plan=Plan(draws=settings.draws),
        workers=workers,
        progress=tell("published bounds"),
    )
    wide = monte_carlo(
        case,
        None if folder is None else folder / "inertial50",
        settings=MonteCarloSettings(settings.seed, inertial_percent=WIDE_PERCENT),
        plan=Plan((Varied.IP,), (100,), settings.draws),
        workers=workers,
        progress=tell("inertial parameters +-50 %"),
    )
    return Disturbances(usual.statistics, wide.statistics, settings.draws)
