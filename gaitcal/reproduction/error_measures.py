"""How errors are summed up in the published tables.

    Table I     sqrt(mean e^2) over the joint's parameters, positions (mm) and orientations (deg) apart
    Table III   sqrt(mean e^2) over the two-sided model: 36 moments, 12 masses, 36 mass-centre coordinates
    residuals   sqrt(mean e^2) over frames and the three components

These definitions reproduce the printed figures of Tables I and III from those of Tables II and IV.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.inertial_parameters import IP_TO_SI, MASSIVE_SEGMENTS, symmetric_set, table
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_TO_SI, Kind
from gaitcal.model.parameters import Parameters

Array = NDArray[np.float64]


def rms(values: Array | Sequence[float]) -> float | None:
    """Root mean square; None of nothing."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(array**2))) if array.size else None


def joint_errors(found: Parameters, truth: Parameters, names: Sequence[str]) -> Array:
    """(n,) found - true, mm and deg."""
    at = [JP_INDEX[name] for name in names]
    out: Array = (found.joint[at] - truth.joint[at]) / JP_TO_SI[at]
    return out


def joint_rms(errors: Array, names: Sequence[str]) -> tuple[float | None, float | None]:
    """RMS of position errors (mm) and of orientation errors (deg); None where a joint has none."""
    position = np.array([JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION for name in names], dtype=bool)
    return rms(errors[position]), rms(errors[~position])


@dataclass(frozen=True)
class InertialErrors:
    """RMS errors over the two-sided model."""

    inertia: float
    """kg mm^2, 36 principal moments."""
    mass: float
    """kg, 12 masses."""
    centre: float
    """mm, 36 coordinates of mass centres."""


def inertial_rms(found: Array, truth: Array) -> InertialErrors:
    """Errors of inertial parameters (84,), SI."""
    errors = table((found - truth) / IP_TO_SI)
    inertia, mass, centre = (float(np.sqrt(np.mean(errors[:, part] ** 2))) for part in (slice(4, 7), 0, slice(1, 4)))
    return InertialErrors(inertia, mass, centre)


def symmetric_errors(found: Array, truth: Array) -> dict[str, float]:
    """Errors of the 36 symmetric parameters (mean of both sides), and of `foot.com.sup`; kg, mm, kg mm^2."""
    which = symmetric_set()
    errors = (found - truth) / IP_TO_SI
    values = which.selection.T @ errors / (which.selection**2).sum(axis=0)
    out = dict(zip(which.names, values.tolist(), strict=True))
    feet = [k for k, segment in enumerate(MASSIVE_SEGMENTS) if segment.startswith("foot")]
    out["foot.com.sup"] = float(table(errors)[feet, 2].mean())
    return out
