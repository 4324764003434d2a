"""Reproduce the published study: synthetic data without and with noise, tables, claims, people."""

import json
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.io import result_folder, toml
from gaitcal.montecarlo import case, protocol, workers
from gaitcal.montecarlo.draw_study import monte_carlo
from gaitcal.reproduction import people_rows
from gaitcal.reproduction import printed_tables as table_rows
from gaitcal.reproduction.claims import Claim, check_claims
from gaitcal.reproduction.recovery import (
    RANDOM_SEEDS,
    InertialRecovery,
    SeedResult,
    recover_noiseless,
    recover_noisy_draws,
)
from gaitcal.runtime import Progress, silent, with_one_blas_thread

NOISE_SEEDS = 20
TABLE_COLUMNS = ("table", "row", "column", "published", "ours", "unit", "note")
CLAIM_COLUMNS = ("claim", "published", "ours", "verdict")
DIGITS = 6
"""Significant digits of figures."""


@dataclass(frozen=True, kw_only=True)
class ReproductionSettings:
    """Extent of a reproduction."""

    noise_seeds: int = NOISE_SEEDS
    """Draws of the noise."""
    seed: int = 0
    random_seeds: int = RANDOM_SEEDS
    """Random seeds of phase 2, for each draw of the noise; at least 2."""
    draws: int = 0
    """Draws of the Monte Carlo study, for each set and level; 0: none."""
    jobs: int = -1
    """Processes; -1: one for every core. The results do not depend on it."""
    data: Path | None = None
    """Folder of real recordings, of people instead of the experimental trial."""


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Results of a reproduction."""

    settings: ReproductionSettings
    clean: SeedResult
    noisy: list[SeedResult]
    tables: list[table_rows.TableRow]
    times: list[table_rows.TableRow]
    claims: list[Claim]
    disturbances: pd.DataFrame | None
    """Statistics of the Monte Carlo study; see `draw_statistics.compute_statistics`."""


@with_one_blas_thread
def reproduce(
    settings: ReproductionSettings | None = None,
    draws_folder: Path | None = None,
    progress: Progress = silent,
) -> Reproduction:
    """Run the published study.

    Parameters
    ----------
    settings : ReproductionSettings, optional
        Extent; the default if not given.
    draws_folder : Path, optional
        Where Monte Carlo draws are stored, so that an interrupted study continues; nothing is
        stored if not given.
    progress : callable
        Called with a line of text at the beginning of each step.

    Returns
    -------
    Reproduction
    """
    settings, began = settings or ReproductionSettings(), time.perf_counter()
    laps: dict[str, float] = {}

    def record_lap(part: str) -> None:
        laps[part] = time.perf_counter() - began - sum(laps.values())

    # Phases 1 and 2 on exact data, then draws of the published noise.
    progress("without noise")
    clean = recover_noiseless(settings.seed, settings.random_seeds)
    progress(f"{settings.noise_seeds} draws of the noise")
    noisy = recover_noisy_draws(
        settings.seed, settings.noise_seeds, settings.jobs, settings.random_seeds
    )
    rows = [
        *table_rows.make_table_one(clean, noisy),
        *table_rows.make_table_two(noisy),
        *table_rows.make_table_three(clean, noisy),
        *table_rows.make_table_four(noisy),
        *table_rows.make_discussion_rows(noisy),
    ]
    record_lap("tables")
    if settings.data is not None:
        rows += people_rows.compute_people_rows(settings.data, settings.jobs, progress)
        record_lap("real people")
    disturbances = None
    if settings.draws:
        disturbances = monte_carlo(
            case.make_nominal_case(),
            draws_folder / "published" if draws_folder else None,
            settings=protocol.MonteCarloSettings(seed=settings.seed),
            plan=protocol.Plan(draws=settings.draws),
            workers=workers.LocalProcesses(settings.jobs),
            progress=lambda done, todo: progress(f"Monte Carlo: {done} of {todo} draws"),
        ).statistics
        record_lap("Monte Carlo study, draws that were not stored yet")
    return Reproduction(
        settings=settings,
        clean=clean,
        noisy=noisy,
        tables=rows,
        times=[*table_rows.make_time_rows([clean, *noisy]), *table_rows.make_run_time_rows(laps)],
        claims=check_claims(clean, noisy),
        disturbances=disturbances,
    )


def write_tables(reproduction: Reproduction, folder: Path) -> None:
    """Write tables, claims, draws, times and manifest of a reproduction.

    Parameters
    ----------
    reproduction : Reproduction
        The results.
    folder : Path
        An empty folder.
    """
    tables = {
        "tables": _make_table_frame(reproduction.tables),
        "claims": _make_claim_frame(reproduction.claims),
        "draws": make_draw_frame(reproduction.noisy),
        "times": _make_table_frame(reproduction.times),
        "montecarlo": reproduction.disturbances,
    }
    for name, frame in tables.items():
        if frame is not None:
            frame.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    shutil.copyfile(Path(__file__).with_name("tables_readme.txt"), folder / "README.txt")
    settings = reproduction.settings
    versions = {
        name: toml.get_package_version(name) for name in ("gaitcal", "pin", "numpy", "scipy")
    }
    manifest = {
        "gaitcal": versions["gaitcal"],
        "versions": versions | {"python": platform.python_version()},
        "settings": {
            **{name: getattr(settings, name) for name in ("noise_seeds", "seed", "draws")},
            "real_people": settings.data is not None,
        },
    }
    (folder / result_folder.MANIFEST).write_text(
        json.dumps(manifest, indent=1) + "\n", encoding="utf-8"
    )


def _make_table_frame(rows: Iterable[table_rows.TableRow]) -> pd.DataFrame:
    """Make the table of `tables.csv`.

    Returns: text, columns `TABLE_COLUMNS`; a figure that does not exist is empty.
    """
    values = []
    for row in rows:
        values.append([_format_cell(getattr(row, column)) for column in TABLE_COLUMNS])
    return pd.DataFrame(values, columns=list(TABLE_COLUMNS))


def _format_cell(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.{DIGITS}g}"


def _make_claim_frame(claims: Iterable[Claim]) -> pd.DataFrame:
    """Make the table of `claims.csv`, columns `CLAIM_COLUMNS`."""
    rows = [(c.claim, c.published, c.ours, c.verdict.value) for c in claims]
    return pd.DataFrame(rows, columns=list(CLAIM_COLUMNS))


def make_draw_frame(draws: Sequence[SeedResult]) -> pd.DataFrame:
    """Make the table of `draws.csv`: figures of Tables I and III.

    Returns: one row per draw.
    """
    rows = []
    for number, draw in enumerate(draws):
        row: dict[str, object] = {"draw": number}
        for problem, joint in draw.joints.items():
            key = problem.replace(" ", "_")
            row[f"{key}_marker_mm"] = joint.marker_mm
            row[f"{key}_largest_marker_mm"] = joint.largest_mm
            row[f"{key}_position_mm"] = joint.position_mm
            if joint.orientation_deg is not None:
                row[f"{key}_orientation_deg"] = joint.orientation_deg
            row[f"{key}_steps"] = joint.steps
            row[f"{key}_converged"] = joint.converged
        row["true_ip_force_N"], row["true_ip_torque_Nm"] = draw.residual_before
        seeds = {
            "correct_seed": (draw.correct,),
            "single_pass": (draw.single_pass,),
            "random_seeds": draw.random,
        }
        for name, fits in seeds.items():
            for key, figure in _FIGURES.items():
                row[f"{name}_{key}"] = float(np.mean([figure(f) for f in fits]))
        if draw.third is not None:
            row["third_step_force_N"] = draw.third.force[1]
            row["third_step_torque_Nm"] = draw.third.torque[1]
            row["third_step_marker_mm"] = draw.third.marker_mm[1]
        rows.append(row)
    return pd.DataFrame(rows)


_FIGURES: dict[str, Callable[[InertialRecovery], float]] = {
    "force_N": lambda fit: fit.force,
    "torque_Nm": lambda fit: fit.torque,
    "inertia_kg_mm2": lambda fit: fit.errors.inertia,
    "mass_kg": lambda fit: fit.errors.mass,
    "com_mm": lambda fit: fit.errors.centre,
    "seeds": lambda fit: float(fit.seeds),
}
