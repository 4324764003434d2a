"""How near a calibration came to the truth, where it is known: errors, and whether the standard
errors cover them.

A curve or parameter e with standard error s is *within* where |e| <= 1.96 s: of true 95 % intervals
95 of 100 are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray

INTERVAL = 1.96
"""Standard errors on either side of a value that hold the truth in 95 of 100 cases."""


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
    """Standard error; None where there is none."""
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
        """Error in standard errors; None without one."""
        return self.error / self.error_bar if self.error_bar else None


@dataclass(frozen=True, kw_only=True)
class CurveTruth:
    """One coordinate (deg, m) or generalised force (N·m, N) of one trial."""

    name: str
    truth: Array
    """(nf,) at the frames of the result; NaN where the truth has none."""
    fitted: Array
    """(nf,)."""
    nominal: Array
    """(nf,) with the nominal model; NaN where it has none."""
    error_bar: Array | None
    """(nf,) standard error."""
    counts: BoolArray
    """(nf,) frames in which the result counts: the valid ones of a force, all of a coordinate."""

    @property
    def compared(self) -> BoolArray:
        """(nf,) frames that count and have a truth."""
        out: BoolArray = self.counts & np.isfinite(self.truth)
        return out

    @property
    def rms(self) -> float | None:
        """RMS error; None where no frame is compared."""
        return _rms((self.fitted - self.truth)[self.compared])

    @property
    def nominal_rms(self) -> float | None:
        """The same of the nominal model."""
        return _rms((self.nominal - self.truth)[self.compared])

    @property
    def within(self) -> BoolArray:
        """(n,) of compared frames with a standard error: whether the truth lies within."""
        if self.error_bar is None:
            return np.zeros(0, dtype=bool)
        kept = self.compared & np.isfinite(self.error_bar)
        out: BoolArray = np.abs(self.fitted - self.truth)[kept] <= INTERVAL * self.error_bar[kept]
        return out

    @property
    def share_within(self) -> float | None:
        """Part of the frames (0 to 1) in which the truth lies within; None without standard errors."""
        return float(self.within.mean()) if len(self.within) else None


@dataclass(frozen=True)
class CurveTruths:
    """The curves of one trial beside the true ones."""

    time: Array
    """(nf,) s, of the result."""
    coordinates: Mapping[str, CurveTruth] = field(default_factory=dict)
    forces: Mapping[str, CurveTruth] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FeatureTruth:
    """One joint centre (mm) or axis (deg), one number for all of its parameters."""

    joint: str
    """`hip_r`."""
    part: str
    """`centre`, `axis_place` or `axis_direction`."""
    words: str
    """Without the side: `Hip centre in the pelvis`."""
    unit: str
    nominal: float
    """Distance or angle between nominal and true."""
    fitted: float
    """Between calibrated and true."""
    within: tuple[bool, ...]
    """Of its parameters with a standard error: whether the truth lies within 1.96 of it."""

    @property
    def side(self) -> str:
        """`r` or `l`."""
        return self.joint[-1]


@dataclass(frozen=True, kw_only=True)
class TruthErrors:
    """A calibration against the truth."""

    parameters: tuple[ParameterTruth, ...]
    """That the truth has, in the order of `parameters.csv`."""
    features: tuple[FeatureTruth, ...]
    """Joint centres and axes of the legs whose parameters are all in the truth, and any of them
    fitted.
    """
    trials: Mapping[str, CurveTruths]
    """Trials of which true curves are known, in the order of the result."""
    not_compared: Mapping[str, str] = field(default_factory=dict)
    """Trial -> why none, or not all, of its curves are held against true ones."""

    def of(self, trial: str) -> CurveTruths:
        """The curves of a trial; none where none are known."""
        return self.trials.get(trial, CurveTruths(np.zeros(0)))

    def sought(self, kind: str) -> tuple[ParameterTruth, ...]:
        """The same, and those that the trials do not determine, which stay where their prior holds
        them.
        """
        return tuple(p for p in self.parameters if p.status != "fixed" and p.kind.startswith(kind))

    def fitted(self, kind: str) -> tuple[ParameterTruth, ...]:
        """Fitted parameters whose kind begins so (`joint position`, `joint`, ...)."""
        return tuple(p for p in self.parameters if p.status == "fitted" and p.kind.startswith(kind))


def _rms(errors: Array) -> float | None:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) and np.isfinite(errors).all() else None
