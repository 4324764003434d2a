"""Calibrations that are stubs, and runs of a cohort on them in this process."""

import csv
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.cohort.cohort_people import CohortPerson, find_people
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import Outcome, Task
from gaitcal.cohort.run_cohort import run_cohort
from gaitcal.gait import peaks as gait
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.peaks import PeakMean, make_peak_columns
from gaitcal.results.table_files import write_csv

MASS = 50.0


class Here:
    """Runs everyone in this process."""

    def __init__(self, *, backwards: bool = False) -> None:
        self.backwards = backwards

    def run(
        self,
        function: Callable[[Task], Outcome],
        tasks: Iterator[Task],
        lost: Callable[[Task, str], Outcome],
    ) -> Iterator[Outcome]:
        yield from map(function, list(tasks)[:: -1 if self.backwards else 1])


PEAKS = [
    PeakMean(
        activity="gait",
        peak=gait.PEAKS[name],
        side="r",
        n=2,
        strides=2,
        mean=mean,
        sd=1.0,
        se=se,
        percent=70.0,
    )
    for name, mean, se in (("knee_flexion_swing", 51.5, 2.0), ("knee_extension_moment", -40.0, 1.5))
]
"""As a result has them."""
SQUAT = replace(
    PEAKS[1], activity="squat", peak=gait.PHASE_PEAKS["in_rising_knee_extension_moment"]
)


def strides(person: str) -> pd.DataFrame:
    """Two strides of the right foot: a moment with one peak, of which one frame is not valid, and
    an angle.
    """
    percent = np.arange(101)
    same = {
        "person": person,
        "session": "",
        "trial": "walk",
        "side": "r",
        "percent": percent,
        "se": 2.0,
    }
    same |= {"se_stride": 1.0, "turn": 0.0, "activity": "gait", "phase": ""}
    parts = []
    for stride in (1, 2):
        for variable, value in (
            ("knee_angle", 30.0 + 20.0 * np.sin(2 * np.pi * percent / 100) + stride),
            ("knee_angle_moment", 40.0 * np.sin(2 * np.pi * percent / 100)),
            ("hip_flexion_moment", np.where(percent < 50, 1.0, np.nan)),
        ):
            columns = {"stride": stride, "variable": variable, "value": np.nan_to_num(value)}
            parts.append(pd.DataFrame({**same, **columns, "valid": np.isfinite(value).astype(int)}))
    return pd.concat(parts, ignore_index=True)[list(CYCLE_COLUMNS)]


def write_result(person: CohortPerson, out: Path, common: CommonSettings) -> None:
    """A result folder as a calibration leaves it, of what tables read alone."""
    out.mkdir(parents=True, exist_ok=True)
    table = strides(person.name)
    write_csv(table, out / "cycles.csv")
    write_csv(ensemble(table), out / "ensemble.csv")
    write_csv(make_peak_columns([*PEAKS, SQUAT]), out / "peaks.csv")
    walk = {
        "role": "gait",
        "frames": 100,
        "verdict_r": "trustworthy",
        "verdict_l": "refused",
        "valid_frames": 10,
        "rms_mm": {"nominal": 5.0, "calibrated": 3.0},
        "pelvis_residual": {
            "nominal": {"force_N": 30.0, "torque_Nm": 6.0},
            "jp": {"force_N": 20.0, "torque_Nm": 4.0},
        },
        "pelvis_residual_limit": {"force_N": 35.0, "torque_Nm": 9.0},
    }
    other = {**walk, "frames": 300, "rms_mm": {"nominal": 5.0, "calibrated": 1.0}}
    summary = {
        "status": "converged",
        "verdict": "doubtful",
        "trials": {"walk": walk, "again": other},
        "reasons": [{"cause": 'a "heel", moved', "action": "look"}],
        "spatiotemporal": {
            "speed": {"unit": "m/s", "r": {"mean": 1.25, "strides": 2, "trials": 1}}
        },
    }
    (out / "summary.json").write_text(json.dumps(summary))
    subject = {"name": person.name, "mass_kg": MASS, "height_m": 1.7, "sex": "female"}
    manifest = {"gaitcal": "0.2.0", "subject": subject, "settings": {}, "own_sha256": "1"}
    (out / "manifest.json").write_text(json.dumps(manifest))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def run(lab: Path, out: Path, *, retry: bool = False, backwards: bool = False) -> list[Outcome]:
    ended: list[Outcome] = []
    collect = lambda outcome, *_: ended.append(outcome)  # noqa: E731
    run_cohort(
        find_people(lab, out), out, engine=Here(backwards=backwards), retry=retry, report=collect
    )
    return ended


def of_a_process(mebibytes: float) -> Outcome:
    """What a process of this size tells, by its number."""
    return Outcome(name=str(os.getpid()), session="", place="", fingerprint="", mebibytes=mebibytes)
