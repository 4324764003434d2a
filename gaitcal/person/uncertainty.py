"""Standard errors of a calibration, collected over its phases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.influence import Influence, nominal_influence
from gaitcal.calibration.joint_phases import JointCalibration
from gaitcal.calibration.torque_errors import inertial_square_root
from gaitcal.model.inertial_parameters import IP_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Uncertainty:
    """How far the fitted parameters can be trusted."""

    joint: Influence | None
    """Influence of every source of error on the joint parameters, fitted or not; None: they count as exact."""
    inertial: Array | None
    """(84, n) R with covariance R R^T of the inertial parameters."""

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Parameter name -> standard error (SI) of joint parameters, fitted or nominal, and fitted inertial ones."""
        errors = dict(self.joint.standard_errors) if self.joint else {}
        if self.inertial is not None:
            each = np.sqrt((self.inertial**2).sum(axis=1))
            errors |= {name: float(e) for name, e in zip(IP_NAMES, each, strict=True) if e > 0}
        return errors


def uncertainty_of(joint: JointCalibration | None, inertial: InertialFit | None) -> Uncertainty:
    """Errors of all joint parameters, nominal ones as far as nobody calibrated them, and of the inertial ones."""
    influence = nominal_influence() if joint is None else joint.influence
    known = inertial is not None and inertial.statistical
    return Uncertainty(influence, inertial_square_root(inertial) if inertial is not None and known else None)
