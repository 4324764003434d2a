"""How far a calibration can be trusted: standard errors of joint axes and masses, and of the joint
torques.

    python scripts/examples/02_uncertainty.py OUT
        a synthetic person: the errors that were made, beside the standard errors that say how large
        they should be
    python scripts/examples/02_uncertainty.py OUT STUDY.toml
        your own study: standard errors alone

The static trial alone fixes some parameters; they have no standard error. OUT/parameters.csv holds
the whole table.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

import gaitcal as gc


def parameters(calibration: gc.Calibration, truth: Path | None) -> pd.DataFrame:
    """Fitted parameters with standard errors; where the truth is known, also the true values."""
    table = gc.parameter_table(calibration)
    fitted = table[(table["status"] == "fitted") & table["standard_error"].notna()].set_index(
        "name"
    )
    if truth is not None:
        fitted["true"] = pd.read_csv(truth).set_index("name")["value"]
    return fitted


def torque_errors(calibration: gc.Calibration) -> pd.DataFrame:
    """Per gait trial and joint: RMS torque and median standard error over valid frames, % of body
    weight x height.
    """
    scale, rows = 100.0 / calibration.model.subject.bwh, []
    for trial in calibration.trials:
        if trial.loads is None or trial.loads.errors is None:
            continue
        valid = trial.loads.reactions.valid
        for k, name in enumerate(gc.COORDINATES):
            if name.startswith("pelvis"):
                continue
            torque, error = trial.loads.final.tau[valid, k], trial.loads.errors.tau[valid, k]
            rows.append(
                (trial.name, name, scale * np.sqrt(np.mean(torque**2)), scale * np.nanmedian(error))
            )
    return pd.DataFrame(rows, columns=["trial", "torque", "rms_bwh", "standard_error_bwh"])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("study", type=Path, nargs="?")
    chosen = parser.parse_args(arguments)
    study = chosen.study or gc.synthesize(chosen.out / "subject", seed=1, noise=True, perturb=True)
    calibration = gc.calibrate(gc.Study.load(study))
    table = parameters(calibration, None if chosen.study else study.parent / "truth.csv")
    chosen.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(chosen.out / "parameters.csv")
    columns = [
        "unit",
        "nominal",
        "fitted",
        "standard_error",
        *(["true"] if "true" in table else []),
    ]
    print(table[columns].round(2).to_string())
    if "true" in table:
        joints = table[table["kind"].str.startswith("joint")]
        ratio = (joints["fitted"] - joints["true"]).abs() / joints["standard_error"]
        print(
            f"joint parameters within 2 standard errors of the truth: {int((ratio < 2).sum())} of "
            f"{len(ratio)}"
        )
    if calibration.unidentifiable:
        print(f"these trials cannot determine: {', '.join(calibration.unidentifiable)}")
    print(torque_errors(calibration).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
