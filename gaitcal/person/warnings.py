"""What speaks against a finished calibration: one sentence for each thing that its own figures put in doubt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.parameters import Parameters
from gaitcal.person.result import TrialResult
from gaitcal.study.settings import CalibrationSettings

WORSE_M = 1e-4
"""m, by how much markers are met worse before it is told."""


def calibration_warnings(
    settings: CalibrationSettings, joint: Sequence[str], results: Sequence[TrialResult], parameters: Parameters
) -> tuple[str, ...]:
    """All warnings of a calibration that ended with `parameters`, those of its joint parameters, `joint`, first."""
    warnings = [*joint, *(warning for t in results for warning in t.warnings)]
    loads = [t.loads for t in results if t.loads is not None]
    if loads and not any(load.reactions.valid.any() for load in loads):
        warnings.append("inertial parameters keep their nominal values: no trial has a valid frame")
    if bodies := impossible_bodies(parameters.inertial):
        left_out = "; the third step needs possible ones and was left out" if settings.joint_step else ""
        warnings.append(
            f"no real body has the inertial parameters found for {', '.join(bodies)}; ip = 'consistent' keeps every "
            f"body possible; torques have no standard errors then, and model.xml is not written{left_out}"
        )
    warnings += disagreements(results)
    return tuple(warnings)


def disagreements(results: Sequence[TrialResult]) -> Iterator[str]:
    """Trials whose markers the final model meets worse than the nominal one."""
    for t in results:
        first, last = t.nominal.errors.rms(), t.final.errors.rms()
        if first is not None and last is not None and last > first + WORSE_M:
            yield (
                f"{t.name}: with the final model its markers are met worse ({1e3 * last:.1f} mm) than with the nominal "
                f"one ({1e3 * first:.1f} mm): the trials disagree"
            )
