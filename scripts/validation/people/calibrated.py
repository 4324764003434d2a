"""Whole calibrations of real people: fit of their trials, pelvis residuals, and moments beside the hospital's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

import gaitcal
from gaitcal import Calibration
from gaitcal.session.result import Stage
from scripts.validation.recordings import changed, study_of_person
from scripts.validation.vendors.agreement import agreement, unit_of_walks
from scripts.validation.vendors.curves import QUANTITIES
from scripts.validation.vendors.walks import LABS, Walk, calibrated_walk

STAGES = {"nominal": Stage.NOMINAL, "hips": Stage.JP, "final": Stage.JP_IP}
"""Column -> model."""
Settings = tuple[tuple[str, object], ...]


@lru_cache(maxsize=32)
def calibrated(person: str, settings: Settings) -> Calibration:
    """All recordings of a person together."""
    return gaitcal.calibrate(changed(study_of_person(person), dict(settings)))


def fit_lines(people: Sequence[str], settings: Settings, out: dict[str, float]) -> Iterator[str]:
    """Marker distance of each trial over its floors, pelvis residual over valid frames; figures into `out`."""
    yield (
        f"{'RMS marker distance, mm':32}{'nominal':>8}{'final':>7}{'rigid':>7}{'ratio':>7}{'to joint floor':>16}"
        f"{'pelvis residual':>20}   verdict"
    )
    for person in people:
        calibration = calibrated(person, settings)
        for trial in calibration.trials:
            nominal, _, rigid = trial.rms_mm()
            final, floor = 1e3 * (trial.final.errors.rms() or np.nan), trial.joint_floor_mm() or np.nan
            ratio = final / (rigid or np.nan)
            out[f"{person} {trial.name}: over rigid floor"] = float(ratio)
            residual = ""
            if trial.loads is not None and trial.loads.residuals:
                last = trial.loads.residuals[-1]
                residual = f"{last.rms_force:8.0f} N{last.rms_moment:6.1f} N·m"
                out[f"{person} {trial.name}: residual N"] = last.rms_force
                out[f"{person} {trial.name}: residual N·m"] = last.rms_moment
            yield (
                f"{person + ' ' + trial.name:32}{nominal or np.nan:8.1f}{final:7.2f}{rigid or np.nan:7.2f}{ratio:7.2f}"
                f"{final / floor:16.2f}{residual:>20}   {calibration.verdict.judgement.value}"
            )


def moment_lines(people: Sequence[str], settings: Settings, out: dict[str, float]) -> Iterator[str]:
    """RMS difference of moments (N·m/kg) to the vendor's, with the models of each stage: in stance; in swing too."""
    for lab, of_lab in LABS.items():
        members = [person for person in of_lab if person in people]
        walks = {words: list(_walks(members, settings, stage)) for words, stage in STAGES.items()}
        if not all(walks.values()):
            continue
        unit = unit_of_walks(walks["nominal"])
        yield f"{lab}: moments less the vendor's, N·m/kg RMS: {', '.join(STAGES)} in stance; the same, swing too"
        for quantity in (q for q in QUANTITIES if q.is_moment):
            found = {words: agreement(quantity, of, unit) for words, of in walks.items()}
            columns = ["".join(f"{a.rms[f]:8.3f}" for a in found.values()) for f in ("leg", "swing too")]
            yield f"  {quantity.words:24}{'   '.join(columns)}"
            out |= {f"{lab} {quantity.words}, {words}": a.rms["leg"] for words, a in found.items()}


def _walks(people: Sequence[str], settings: Settings, stage: Stage) -> Iterator[Walk]:
    for person in people:
        calibration = calibrated(person, settings)
        for trial in calibration.trials:
            walk = calibrated_walk(calibration, trial.name, stage)
            if walk is not None:
                yield walk
