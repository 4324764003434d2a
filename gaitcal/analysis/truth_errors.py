"""Errors of a calibration against a known truth, and whether its standard errors cover them.

An error e with standard error s is *within* if |e| <= 1.96 s, which holds for 95 of 100 correct
intervals.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray

INTERVAL = 1.96
"""Standard errors on either side of a value that contain the truth in 95 of 100 cases."""


@dataclass(frozen=True, kw_only=True)
class ParameterTruth:
    """One parameter, in the unit of `parameters.csv`."""

    name: str
    kind: str
    """As in `parameters.csv`: `joint position`, `mass`, ..."""
    unit: str
    truth: float
    nominal: float
    fitted: float
    error_bar: float | None
    """Standard error; None if not available."""
    status: str
    """`fitted`, `fixed` or `unidentifiable`."""

    @property
    def error(self) -> float:
        """Fitted minus true."""
        return self.fitted - self.truth

    @property
    def nominal_error(self) -> float:
        """Nominal minus true."""
        return self.nominal - self.truth

    @property
    def z(self) -> float | None:
        """Error divided by its standard error; None without one."""
        return self.error / self.error_bar if self.error_bar else None


@dataclass(frozen=True, kw_only=True)
class CurveTruth:
    """One coordinate (deg, m) or generalised force (N·m, N) of one trial, with the true one."""

    name: str
    truth: Array
    """(nf,) at the frames of the result; NaN outside the true curve."""
    fitted: Array
    """(nf,) of the result."""
    nominal: Array
    """(nf,) with the nominal model; NaN if it has no such coordinate."""
    error_bar: Array | None
    """(nf,) standard error."""
    counts: BoolArray
    """(nf,) valid frames: those of a force, all of a coordinate."""

    @property
    def compared(self) -> BoolArray:
        """(nf,) valid frames with a true value."""
        out: BoolArray = self.counts & np.isfinite(self.truth)
        return out

    @property
    def rms(self) -> float | None:
        """RMS error; None if no frame is compared."""
        return _compute_rms((self.fitted - self.truth)[self.compared])

    @property
    def nominal_rms(self) -> float | None:
        """RMS error of the nominal model."""
        return _compute_rms((self.nominal - self.truth)[self.compared])

    @property
    def within(self) -> BoolArray:
        """(n,) whether the truth lies within, of compared frames with a standard error."""
        if self.error_bar is None:
            return np.zeros(0, dtype=bool)
        kept = self.compared & np.isfinite(self.error_bar)
        out: BoolArray = np.abs(self.fitted - self.truth)[kept] <= INTERVAL * self.error_bar[kept]
        return out

    @property
    def share_within(self) -> float | None:
        """Part (0 to 1) of the frames with the truth within; None without standard errors."""
        return float(self.within.mean()) if len(self.within) else None


@dataclass(frozen=True)
class CurveTruths:
    """The curves of one trial, with the true ones."""

    time: Array
    """(nf,) s, of the result."""
    coordinates: Mapping[str, CurveTruth] = field(default_factory=dict)
    """Coordinate -> its curve."""
    forces: Mapping[str, CurveTruth] = field(default_factory=dict)
    """Generalised force -> its curve."""


@dataclass(frozen=True, kw_only=True)
class FeatureTruth:
    """One joint centre (mm) or axis (mm, deg): one number for all of its parameters."""

    joint: str
    """`hip_r`."""
    part: str
    """`centre`, `axis_place` or `axis_direction`."""
    label: str
    """Without the side: `Hip centre in the pelvis`."""
    unit: str
    nominal: float
    """Distance or angle between nominal and true."""
    fitted: float
    """Distance or angle between calibrated and true."""
    within: tuple[bool, ...]
    """Whether the truth lies within, of each parameter with a standard error."""

    @property
    def side(self) -> str:
        """`r` or `l`."""
        return self.joint[-1]


@dataclass(frozen=True, kw_only=True)
class TruthErrors:
    """Errors of a calibration against the truth."""

    parameters: tuple[ParameterTruth, ...]
    """Parameters with a true value, in the order of `parameters.csv`."""
    features: tuple[FeatureTruth, ...]
    """Joint centres and axes of the legs whose parameters are all in the truth, and any of them
    fitted.
    """
    trials: Mapping[str, CurveTruths]
    """Trials with true curves, in the order of the result."""
    not_compared: Mapping[str, str] = field(default_factory=dict)
    """Trial -> why none, or not all, of its curves are compared."""

    def get_curves(self, trial: str) -> CurveTruths:
        """Get the curves of a trial.

        Parameters
        ----------
        trial : str
            Its name.

        Returns
        -------
        CurveTruths
            Empty without true curves.
        """
        return self.trials.get(trial, CurveTruths(np.zeros(0)))

    def select_sought(self, kind: str) -> tuple[ParameterTruth, ...]:
        """Select fitted parameters, and those that the trials do not determine.

        `kind`: beginning of the kind: `joint position`, `joint`, ...
        """
        return tuple(p for p in self.parameters if p.status != "fixed" and p.kind.startswith(kind))


def _compute_rms(errors: Array) -> float | None:
    if not len(errors) or not np.isfinite(errors).all():
        return None
    return float(np.sqrt(np.mean(errors**2)))
