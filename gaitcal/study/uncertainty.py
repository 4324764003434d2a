"""Standard errors of a calibration, collected over its phases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_phases import JointCalibration
from gaitcal.calibration.torque_errors import inertial_square_root
from gaitcal.model.inertial_parameters import IP_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Uncertainty:
    """How far the fitted parameters can be trusted."""

    joint: Influence | None
    """Influence of every marker coordinate on the joint parameters."""
    inertial: Array | None
    """(84, n) R with covariance R R^T of the inertial parameters."""

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter name -> standard error (SI) of every fitted parameter."""
        errors = dict(self.joint.standard_errors) if self.joint else {}
        if self.inertial is not None:
            each = np.sqrt((self.inertial**2).sum(axis=1))
            errors |= {name: float(e) for name, e in zip(IP_NAMES, each, strict=True) if e > 0}
        return errors


def uncertainty_of(joint: JointCalibration | None, inertial: InertialFit | None) -> Uncertainty:
    """Standard errors from the last phase that fitted each parameter."""
    influence = None if joint is None else joint_influence(joint)
    known = inertial is not None and inertial.statistical
    return Uncertainty(influence, inertial_square_root(inertial) if inertial is not None and known else None)


def joint_influence(joint: JointCalibration) -> Influence | None:
    """Influence on all joint parameters; a later phase's replaces an earlier one's.

    In a sequence of phases what an earlier phase fixed counts as exact in the later one.
    """
    parts = [part for part in joint.influences if part.free]
    if len(parts) <= 1:
        return parts[0] if parts else None
    free = tuple(dict.fromkeys(name for part in parts for name in part.free))
    clusters = tuple(dict.fromkeys(c for part in parts for c in part.clusters))
    out = np.zeros((len(free), len(clusters)))
    place = {c: k for k, c in enumerate(clusters)}
    for part in parts:
        rows = [free.index(name) for name in part.free]
        out[rows] = 0.0
        out[np.ix_(rows, [place[c] for c in part.clusters])] = part.parameters
    return Influence(free, out, clusters)
