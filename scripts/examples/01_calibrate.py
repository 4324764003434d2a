"""Calibrate a person: from recordings to a result folder with page, tables and models.

    python scripts/examples/01_calibrate.py OUT
        a synthetic person, whose C3D files go to OUT/subject
    python scripts/examples/01_calibrate.py OUT STUDY.toml
        your own study

Prints the marker error of every trial before and after calibration, and the least that rigid
segments can reach.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gaitcal as gc


def run(out: Path, study_file: Path | None) -> gc.Calibration:
    """The calibration, written into `out/result`."""
    path = study_file or gc.synthesize(out / "subject", seed=1, noise=True, perturb=True)
    calibration = gc.calibrate(gc.Study.load(path), print)
    gc.write_results(calibration, out / "result")
    return calibration


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("study", type=Path, nargs="?")
    chosen = parser.parse_args(arguments)
    calibration = run(chosen.out, chosen.study)
    print(
        f"{'trial':<12}{'nominal':>10}{'calibrated':>12}{'rigid floor':>13}   RMS marker error, mm"
    )
    for trial in calibration.trials:
        errors = (trial.nominal.errors, trial.calibrated.errors, trial.floor)
        before, after, floor = (1e3 * (e.rms() or 0.0) for e in errors)
        print(f"{trial.name:<12}{before:>10.2f}{after:>12.2f}{floor:>13.2f}")
    for warning in calibration.warnings:
        print(f"warning: {warning}")
    print(f"page: {chosen.out / 'result' / 'result.html'}")


if __name__ == "__main__":
    main()
