"""What speaks against a finished calibration: one sentence for each trial that its own figures put in doubt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.model.parameters import Parameters
from gaitcal.person.residual_limits import FORCE_SHARE, MOMENT_SHARE, residual_limits, stages
from gaitcal.person.result import TrialResult

TOLD_M = 1e-4
"""m, by how much markers are met worse before it is told."""


def disagreements(results: Sequence[TrialResult], mode: str) -> Iterator[str]:
    """Trials whose markers the final model meets worse than the nominal one; `mode` as in the settings."""
    # The cure is told only where it is not what was done.
    cure = "" if mode == "simultaneous" else "; mode = 'simultaneous' weighs them together"
    for t in results:
        first, last = t.nominal.errors.rms(), t.final.errors.rms()
        if first is not None and last is not None and last > first + TOLD_M:
            yield (
                f"{t.name}: with the final model its markers are met worse ({1e3 * last:.1f} mm) than with the nominal "
                f"one ({1e3 * first:.1f} mm): the trials disagree{cure}"
            )


def large_residuals(results: Sequence[TrialResult], parameters: Parameters) -> Iterator[str]:
    """Trials whose pelvis residual, RMS of its magnitude over valid frames, is above the limits that people use."""
    for t in results:
        if t.loads is None or not (found := stages(t.loads)):
            continue
        valid, last = t.loads.reactions.valid, found[-1]
        limits = residual_limits(parameters, t, t.loads)
        force, moment = (float(np.sqrt(np.mean(values[valid] ** 2))) for values in (last.force, last.moment))
        told = []
        if force > limits.force:
            told.append(
                f"force {force:.0f} N RMS, limit {limits.force:.0f} N ({100 * FORCE_SHARE:g} % of the peak ground "
                f"reaction of {limits.peak_force:.0f} N)"
            )
        if moment > limits.moment:
            told.append(
                f"moment {moment:.1f} N·m RMS, limit {limits.moment:.1f} N·m ({100 * MOMENT_SHARE:g} % of that force "
                f"times the {limits.centre_height:.2f} m of the mass centre)"
            )
        if told:
            yield (
                f"{t.name}: motion, masses and ground reactions disagree at the pelvis: {'; '.join(told)}; look at "
                "plate positions, force sign and clock, mass_kg, and whether each foot was wholly on a plate"
            )
