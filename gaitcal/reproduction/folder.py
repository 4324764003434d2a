"""The files of a reproduction."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.files.ownership import MANIFEST
from gaitcal.reproduction.inertial_recovery import InertialRecovery
from gaitcal.reproduction.noise_seed import SeedResult
from gaitcal.reproduction.reproduce import Reproduction
from gaitcal.reproduction.rows import claim_frame, table_frame

README = """The published study (Reinbolt, Haftka, Chmielewski and Fregly, IEEE TBME 54(5), 2007), reproduced.

tables.csv      every printed figure of Tables I to IV and of the discussion, with ours beside it
claims.csv      the conclusions of the paper, put to the test: holds, does not hold, not run, not testable
draws.csv       the figures behind the medians: one row for each draw of the noise
times.csv       seconds for each problem beside the published ones; these differ from run to run
montecarlo.csv  with --draws only: distributions of the torque errors of disturbed models
manifest.json   settings and versions

Reading tables.csv
  synthetic     a known linkage moves, its markers are computed, and the method has to find the linkage again
  without noise exact up to rounding; one run
  with noise    `ours` is the median over draws of the noise, the note tells their range and where the published figure
                lies. The paper drew its noise once, so its figures are single draws.
  experimental  the printed figure; the trial was not published, so there is none of ours
  subject01, uf3 other people, shown where a folder of real recordings is given by GAITCAL_DATA
Errors are found minus true. Joint parameters: RMS over the joint's own. Inertial parameters: RMS over the two-sided
model (12 masses, 36 mass-centre coordinates, 36 moments). Residuals: RMS over frames and three components.

All nodes of the motion and all joint parameters that are solved for start at absolute zero, as in the paper.
Inertial parameters with noise: the published procedure, re-seeded until the residuals change by less than 0.1 %.
Without noise and from random seeds that procedure creeps; there the weight of its penalty falls at every re-seed,
which leaves the solutions where they are.

Where noise makes ours differ from the printed figures
  One draw of the noise may be lucky: place a printed figure in the range, not beside the median.
  Marker distance: the printed ones are lower. Neither the marker set nor the frame rate is given in the paper; fewer
  markers or shorter trials leave less of the noise unfitted.
  Joint parameters: noise slower than the trial shifts a marker for good, and with it the joint. Noise up to 25 Hz,
  where the paper writes 25 rad/s, would give position and ankle errors of about the printed size, and markers that
  are met even less well.
  Inertial parameters: errors grow with the number of re-seeds until the residuals settle, 10 to 100 here.
"""


def write_tables(found: Reproduction, folder: Path) -> None:
    """Write everything into an empty folder, as `atomic_directory` gives."""
    _csv(table_frame(found.tables), folder / "tables.csv")
    _csv(claim_frame(found.claims), folder / "claims.csv")
    _csv(draw_frame(found.noisy), folder / "draws.csv")
    _csv(table_frame(found.times), folder / "times.csv")
    if found.disturbances is not None:
        _csv(found.disturbances, folder / "montecarlo.csv")
    (folder / "README.txt").write_text(README, encoding="utf-8")
    (folder / MANIFEST).write_text(_manifest(found), encoding="utf-8")


def _csv(frame: pd.DataFrame, path: Path) -> None:
    frame.to_csv(path, index=False, lineterminator="\n")


def _manifest(found: Reproduction) -> str:
    names = ("gaitcal", "pin", "numpy", "scipy")
    settings = found.settings
    content = {
        "gaitcal": _version("gaitcal"),
        "versions": {name: _version(name) for name in names} | {"python": platform.python_version()},
        "settings": {
            "noise_seeds": settings.noise_seeds,
            "seed": settings.seed,
            "draws": settings.draws,
            "real_people": settings.data is not None,
        },
    }
    return json.dumps(content, indent=1) + "\n"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def draw_frame(draws: Sequence[SeedResult]) -> pd.DataFrame:
    """One row per draw of the noise: the figures of Tables I and III."""
    return pd.DataFrame([{"draw": k, **_row(draw)} for k, draw in enumerate(draws)])


def _row(draw: SeedResult) -> dict[str, object]:
    row: dict[str, object] = {}
    for problem, found in draw.joints.items():
        key = problem.replace(" ", "_")
        row[f"{key}_marker_mm"] = found.marker_mm
        row[f"{key}_largest_marker_mm"] = found.largest_mm
        row[f"{key}_position_mm"] = found.position_mm
        if found.orientation_deg is not None:
            row[f"{key}_orientation_deg"] = found.orientation_deg
        row[f"{key}_steps"] = found.steps
        row[f"{key}_converged"] = found.converged
    row["true_ip_force_N"], row["true_ip_torque_Nm"] = draw.residual_before
    for name, fit in (("correct_seed", draw.correct), ("single_pass", draw.single_pass)):
        row |= {f"{name}_{key}": value for key, value in _inertial(fit).items()}
    cases = [_inertial(fit) for fit in draw.random]
    for key in cases[0]:
        row[f"random_seeds_{key}"] = float(np.mean([case[key] for case in cases]))
    if draw.third is not None:
        row["third_step_force_N"] = draw.third.force[1]
        row["third_step_torque_Nm"] = draw.third.torque[1]
        row["third_step_marker_mm"] = draw.third.marker_mm[1]
    return row


def _inertial(fit: InertialRecovery) -> dict[str, float]:
    return {
        "force_N": fit.force,
        "torque_Nm": fit.torque,
        "inertia_kg_mm2": fit.errors.inertia,
        "mass_kg": fit.errors.mass,
        "com_mm": fit.errors.centre,
        "seeds": float(fit.seeds),
    }
