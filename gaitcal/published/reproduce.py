"""The whole reproduction: synthetic truth without noise and with many draws of it, tables, claims, real people."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import pandas as pd

from gaitcal.published.case import nominal_case
from gaitcal.published.claims import Claim, table_claims
from gaitcal.published.disturbance_claims import WIDE_PERCENT, Disturbances, disturbance_claims
from gaitcal.published.inertial_recovery import RANDOM_SEEDS
from gaitcal.published.noise_seed import SeedResult, noiseless, noisy_draws
from gaitcal.published.people import people_rows
from gaitcal.published.sensitivities import (
    Sensitivities,
    SensitivityDraws,
    sensitivities,
    sensitivity_claims,
    sensitivity_rows,
)
from gaitcal.published.settings import MonteCarloSettings, Plan, Varied
from gaitcal.published.stop_watch import StopWatch
from gaitcal.published.study import monte_carlo
from gaitcal.published.tables import (
    TableRow,
    discussion_rows,
    run_time_rows,
    table_four_rows,
    table_one_rows,
    table_three_rows,
    table_two_rows,
    time_rows,
)
from gaitcal.published.workers import LocalProcesses
from gaitcal.runtime import Progress, silent, with_one_blas_thread

NOISE_SEEDS = 20


@dataclass(frozen=True, kw_only=True)
class ReproductionSettings:
    """How much to do."""

    noise_seeds: int = NOISE_SEEDS
    seed: int = 0
    random_seeds: int = RANDOM_SEEDS
    """Of phase 2, for each draw of the noise; at least 2."""
    draws: int = 0
    """Of the Monte Carlo study, each set and level; 0: none."""
    sensitivities: SensitivityDraws | None = field(default_factory=SensitivityDraws)
    """None: none are computed."""
    jobs: int = -1
    """Processes; -1: one for every core. The results do not depend on it."""
    data: Path | None = None
    """Folder of real recordings, for the people shown instead of the experimental trial."""


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Everything that was computed."""

    settings: ReproductionSettings
    clean: SeedResult
    noisy: list[SeedResult]
    tables: list[TableRow]
    times: list[TableRow]
    claims: list[Claim]
    disturbances: pd.DataFrame | None
    """Statistics of the Monte Carlo study; see `montecarlo.statistics`."""
    sensitivities: Sensitivities | None


@with_one_blas_thread
def reproduce(
    settings: ReproductionSettings | None = None, draws_folder: Path | None = None, progress: Progress = silent
) -> Reproduction:
    """Run the published study.

    Parameters
    ----------
    draws_folder : where Monte Carlo draws are kept, so that an interrupted study goes on; None keeps nothing.
    """
    settings, clock = settings or ReproductionSettings(), StopWatch()
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
    clock.lap("tables")
    found = disturbances = None
    if settings.sensitivities is not None:
        found = sensitivities(settings.seed, settings.sensitivities, settings.jobs, progress)
        rows += sensitivity_rows(found)
        clock.lap("sensitivities")
    if settings.data is not None:
        rows += people_rows(settings.data, progress)
        clock.lap("real people")
    if settings.draws:
        disturbances = _disturb(settings, draws_folder, progress)
        clock.lap("Monte Carlo study, draws that were not there yet")
    return Reproduction(
        settings=settings,
        clean=clean,
        noisy=noisy,
        tables=rows,
        times=[*time_rows([clean, *noisy]), *run_time_rows(clock.laps)],
        claims=[*table_claims(clean, noisy), *disturbance_claims(disturbances), *sensitivity_claims(found)],
        disturbances=disturbances.table if disturbances else None,
        sensitivities=found,
    )


def _disturb(settings: ReproductionSettings, folder: Path | None, progress: Progress) -> Disturbances:
    def study(name: str, words: str, bounds: MonteCarloSettings, plan: Plan) -> pd.DataFrame:
        return monte_carlo(
            nominal_case(),
            folder / name if folder else None,
            settings=bounds,
            plan=plan,
            workers=LocalProcesses(settings.jobs),
            progress=lambda done, todo: progress(f"Monte Carlo, {words}: {done} of {todo} draws"),
        ).statistics

    published = MonteCarloSettings(seed=settings.seed)
    wide = replace(published, inertial_percent=WIDE_PERCENT)
    only_inertial = Plan((Varied.IP,), (100,), settings.draws)
    return Disturbances(
        study("published", "published bounds", published, Plan(draws=settings.draws)),
        study("inertial50", "inertial parameters +-50 %", wide, only_inertial),
        settings.draws,
    )
