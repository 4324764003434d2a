"""How near the truth does the main job come, through files, and do its error bars hold?

    python scripts/check_recovery.py [--people 8] [--seed 0] [--settings synthesized|default|gait-only]

Synthetic people, wrong in every joint and inertial parameter by up to 10 mm, 10 deg and 10 %, with the published marker
noise, are written as C3D files (`gaitcal synthesize --noise --perturb`), read and calibrated as any other study: with
the settings that `synthesize` writes, with gaitcal's defaults, or with the defaults and the gait trial alone.

Printed: RMS error of the fitted joint parameters before (nominal) and after, median over people; and how often 68 % and
95 % intervals cover the truth: joint parameters by joint, inertial parameters by kind, joint torques in valid frames.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.person.calibrate import calibrate
from gaitcal.person.result import Calibration
from gaitcal.person.tables import parameter_table
from gaitcal.study.study import Role, Study
from gaitcal.synthetic.measurements import residual_free_wrench
from gaitcal.synthetic.subject import synthesize, true_gait

JOINTS = ("hip", "knee", "talocrural", "subtalar")
UNITS = {"joint position": "mm", "joint orientation": "deg"}
LEVELS = {"68 %": 1.0, "95 %": 1.96}
DEFAULTS = {"mode": "sequential", "nodes": None, "force_filter_hz": 50.0}
SETTINGS = ("synthesized", "default", "gait-only")


@dataclass(frozen=True)
class Person:
    """What came of one person."""

    parameters: pd.DataFrame
    """Fitted parameters by name: kind, joint, errors of the nominal and fitted values, `z` in standard errors."""
    torques: np.ndarray
    """(n, 23) errors of joint torques and knee reactions in standard errors, valid frames."""


def person(seed: int, settings: str) -> Person:
    """Make, write, read, calibrate and compare one person."""
    with tempfile.TemporaryDirectory() as folder:
        file = synthesize(Path(folder) / "study", seed=seed, noise=True, perturb=True)
        truth = pd.read_csv(file.parent / "truth.csv").set_index("name")["value"]
        study = Study.load(file)
        if settings != "synthesized":
            study = replace(study, settings=study.settings.model_copy(update=DEFAULTS))
        if settings == "gait-only":
            study = replace(study, trials=tuple(t for t in study.trials if t.role is not Role.JOINT))
        calibration = calibrate(study)
    table = parameter_table(calibration).set_index("name")
    table = table[table["status"] == "fitted"]
    true = truth.loc[table.index]
    table = table.assign(before=table["nominal"] - true, after=table["fitted"] - true)
    table = table.assign(z=table["after"] / table["standard_error"], joint=table.index.str.split("_").str[0])
    return Person(table, torque_errors(calibration, seed))


def torque_errors(calibration: Calibration, seed: int) -> np.ndarray:
    """(n, 23) errors of a person's gait torques in their standard errors."""
    parameters, motion = true_gait(seed)
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    true = Dynamics(parameters).forces(q, v, a, residual_free_wrench(parameters, motion))
    loads = calibration.trial("gait").loads
    if loads is None or loads.errors is None:
        raise RuntimeError("the gait trial has no torques with standard errors")
    gap = np.hstack([loads.final.tau, loads.final.knee_adduction]) - true
    error = np.hstack([loads.errors.tau, loads.errors.knee_adduction])
    out: np.ndarray = (gap / error)[loads.reactions.valid][:, 6:]
    return out


def coverage(z: np.ndarray) -> str:
    """Share of errors within each interval, %."""
    return "  ".join(f"{100.0 * np.mean(np.abs(z) < width):5.1f} in {name}" for name, width in LEVELS.items())


def lines(people: list[Person]) -> Iterator[str]:
    """The report."""
    yield "joint parameters: RMS error, nominal -> calibrated (median over people), and coverage"
    for joint in JOINTS:
        for kind, unit in UNITS.items():
            rows = [p.parameters[(p.parameters["kind"] == kind) & (p.parameters["joint"] == joint)] for p in people]
            rows = [r for r in rows if len(r)]
            if not rows:
                continue
            rms = np.array([[np.sqrt((r[when] ** 2).mean()) for when in ("before", "after")] for r in rows])
            before, after = np.median(rms, axis=0)
            z = pd.concat([r["z"] for r in rows]).to_numpy()
            yield f"{joint:11}{kind.split()[1]:13}{before:6.2f} ->{after:6.2f} {unit:4}{coverage(z)}  ({len(z)} values)"
    yield "inertial parameters: coverage"
    for kind in ("mass", "mass centre", "moment of inertia"):
        z = pd.concat([p.parameters[p.parameters["kind"] == kind]["z"] for p in people]).to_numpy()
        yield f"{kind:39}{coverage(z)}  ({len(z)} values)"
    yield "joint torques of valid frames: coverage"
    z = np.concatenate([p.torques for p in people])
    yield f"{'all':39}{coverage(z)}"
    for name, column in zip((*COORDINATES[6:], *REACTIONS), z.T, strict=True):
        yield f"{name:39}{coverage(column)}"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0, help="of the first person")
    parser.add_argument("--settings", choices=SETTINGS, default="default")
    chosen = parser.parse_args(arguments)
    people = [person(seed, chosen.settings) for seed in range(chosen.seed, chosen.seed + chosen.people)]
    print("\n".join(lines(people)))


if __name__ == "__main__":
    main()
