"""The files of a reproduction: tables, claims and draws as CSV, a README, the manifest."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from gaitcal.io.ownership import MANIFEST
from gaitcal.io.package_data import package_version
from gaitcal.published.claims import Claim
from gaitcal.published.inertial_recovery import InertialRecovery
from gaitcal.published.noise_seed import SeedResult
from gaitcal.published.refit_end import iteration_frame
from gaitcal.published.reproduce import Reproduction
from gaitcal.published.tables import TableRow

TABLE_COLUMNS = ("table", "row", "column", "published", "ours", "unit", "note")
CLAIM_COLUMNS = ("kind", "claim", "published", "ours", "verdict")
DIGITS = 6
"""Significant digits of figures."""


def write_tables(reproduction: Reproduction, folder: Path) -> None:
    """Write everything into an empty folder, as `atomic_directory` gives."""
    tables = {
        "tables": table_frame(reproduction.tables),
        "claims": claim_frame(reproduction.claims),
        "draws": draw_frame(reproduction.noisy),
        "times": table_frame(reproduction.times),
        "montecarlo": reproduction.disturbances,
        "iterations": iteration_frame(found.stopped) if (found := reproduction.sensitivities) else None,
    }
    for name, frame in tables.items():
        if frame is not None:
            frame.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    shutil.copyfile(Path(__file__).with_name("tables_readme.txt"), folder / "README.txt")
    settings = reproduction.settings
    versions = {name: package_version(name) for name in ("gaitcal", "pin", "numpy", "scipy")}
    manifest = {
        "gaitcal": versions["gaitcal"],
        "versions": versions | {"python": platform.python_version()},
        "settings": {
            "noise_seeds": settings.noise_seeds,
            "seed": settings.seed,
            "draws": settings.draws,
            "sensitivities": settings.sensitivities and asdict(settings.sensitivities),
            "real_people": settings.data is not None,
        },
    }
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")


def table_frame(rows: Iterable[TableRow]) -> pd.DataFrame:
    """`tables.csv`: a figure that does not exist is empty."""

    def shown(value: str | float | None) -> str:
        return value if isinstance(value, str) else "" if value is None else f"{value:.{DIGITS}g}"

    values = [[shown(getattr(row, column)) for column in TABLE_COLUMNS] for row in rows]
    return pd.DataFrame(values, columns=list(TABLE_COLUMNS))


def claim_frame(claims: Iterable[Claim]) -> pd.DataFrame:
    """`claims.csv`."""
    rows = [(c.kind.value, c.claim, c.published, c.ours, c.verdict.value) for c in claims]
    return pd.DataFrame(rows, columns=list(CLAIM_COLUMNS))


def draw_frame(draws: Sequence[SeedResult]) -> pd.DataFrame:
    """One row per draw of the noise: the figures of Tables I and III."""
    return pd.DataFrame([{"draw": k, **_figures(draw)} for k, draw in enumerate(draws)])


def _figures(draw: SeedResult) -> dict[str, object]:
    row: dict[str, object] = {}
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
    seeds = {"correct_seed": (draw.correct,), "single_pass": (draw.single_pass,), "random_seeds": draw.random}
    for name, fits in seeds.items():
        figures = pd.DataFrame([_inertial_figures(fit) for fit in fits]).mean()
        row |= {f"{name}_{key}": value for key, value in figures.items()}
    if draw.third is not None:
        row["third_step_force_N"] = draw.third.force[1]
        row["third_step_torque_Nm"] = draw.third.torque[1]
        row["third_step_marker_mm"] = draw.third.marker_mm[1]
    return row


def _inertial_figures(fit: InertialRecovery) -> dict[str, float]:
    return {
        "force_N": fit.force,
        "torque_Nm": fit.torque,
        "inertia_kg_mm2": fit.errors.inertia,
        "mass_kg": fit.errors.mass,
        "com_mm": fit.errors.centre,
        "seeds": float(fit.seeds),
    }
