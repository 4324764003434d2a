"""Do different recordings of a person agree? Hip centres by isolated trials alone and by gait alone, truth unknown.

    python scripts/check_agreement.py STUDY

The study needs gait and isolated trials of at least one hip. Both halves are calibrated as studies of their own. They
share the static trial and nothing else, but also their priors: hips that no trial tells would agree. Told are, in
pelvis and in thigh, how far apart both centres are in mm, and each of their coordinates in standard errors of the
difference. At the end all trials together: what every trial leaves between markers and model, as a ratio to its joint
floor, what each joint by itself could reach.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import gaitcal
from gaitcal import Calibration, InputError, Study
from gaitcal.arrays import Array
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.study.study_trial import Role

DIRECTIONS = ("ant", "sup", "lat")
NEAR = 2.0
"""Standard errors of the difference."""


@dataclass(frozen=True, kw_only=True)
class HipGap:
    """One hip centre in one segment, as two calibrations have it."""

    hip: str
    segment: str
    gap: Array
    """(3,) m, gait less isolated trials: ant, sup, lat."""
    error: Array
    """(3,) m, standard error of the gap, both calibrations taken to be independent."""

    @property
    def distance(self) -> float:
        """How far apart, m."""
        return float(np.linalg.norm(self.gap))

    @property
    def standardised(self) -> Array:
        """(3,) in standard errors."""
        return self.gap / self.error


def halves(study: Study) -> tuple[Study, Study]:
    """The study with isolated trials alone, and with gait alone."""
    for role in (Role.JOINT, Role.GAIT):
        if not any(trial.role is role for trial in study.moving):
            raise InputError("found no such trial; allowed: a study with both roles", field=f"role = '{role.value}'")
    isolated, gait = (
        replace(study, trials=tuple(t for t in study.trials if t.role is not left_out))
        for left_out in (Role.GAIT, Role.JOINT)
    )
    return isolated, gait


def hip_gaps(isolated: Calibration, gait: Calibration) -> list[HipGap]:
    """Every hip that both calibrations fitted, in pelvis and thigh."""
    out = []
    for hip in ("hip_r", "hip_l"):
        for segment in ("pelvis", "thigh"):
            names = [f"{hip}.{segment}.{direction}" for direction in DIRECTIONS]
            if all(name in c.standard_errors for name in names for c in (isolated, gait)):
                place = [JP_INDEX[name] for name in names]
                errors = [[c.standard_errors[name] for name in names] for c in (isolated, gait)]
                gap = gait.model.parameters.joint[place] - isolated.model.parameters.joint[place]
                out.append(HipGap(hip=hip, segment=segment, gap=gap, error=np.hypot(*errors)))
    return out


def floor_ratios(calibration: Calibration) -> dict[str, float]:
    """Trial -> RMS marker distance with the final model over that of its joint floor."""
    out = {}
    for trial in calibration.trials:
        final, floor = trial.final.errors.rms(), trial.joint_floor_mm()
        if final is not None and floor:
            out[trial.name] = 1e3 * final / floor
    return out


def lines(gaps: list[HipGap], ratios: dict[str, float]) -> Iterator[str]:
    """The report."""
    yield "hip centre by gait, less that by isolated trials: mm apart, and ant, sup, lat in mm (standard errors)"
    for g in gaps:
        told = "".join(f"{1e3 * d:8.1f} ({z:+.1f})" for d, z in zip(g.gap, g.standardised, strict=True))
        yield f"{g.hip:6} in {g.segment:7}{1e3 * g.distance:7.1f}  {told}"
    every = np.abs([z for g in gaps for z in g.standardised])
    if len(every):
        near = int((every < NEAR).sum())
        yield f"{near} of {len(every)} coordinates within {NEAR:g} standard errors, the largest {every.max():.1f}"
    yield "all trials together: final marker error over joint floor"
    yield from (f"{name:16}{ratio:6.2f}" for name, ratio in ratios.items())


def main(arguments: list[str] | None = None) -> tuple[list[HipGap], dict[str, float]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path, metavar="STUDY", help="a study file")
    study = Study.load(parser.parse_args(arguments).study)
    isolated, gait = (gaitcal.calibrate(half) for half in halves(study))
    gaps, ratios = hip_gaps(isolated, gait), floor_ratios(gaitcal.calibrate(study))
    print("\n".join(lines(gaps, ratios)))
    return gaps, ratios


if __name__ == "__main__":
    main()
