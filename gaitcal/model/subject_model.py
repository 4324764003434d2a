"""One person's model: who, which parameters, which markers where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from gaitcal.arrays import Array
from gaitcal.model.build import GRAVITY
from gaitcal.model.parameters import Parameters


@dataclass(frozen=True)
class Subject:
    """The person."""

    name: str
    """Stands in every output; need not be the person's own."""
    mass: float
    """kg."""
    height: float
    """m."""
    sex: str
    """`male` or `female`: the column of the anthropometric table."""
    age: float | None = None
    """Years; None where not known."""
    knee_width: Mapping[str, float] = field(default_factory=dict)
    """Side -> m across the femoral epicondyles, where measured."""
    ankle_width: Mapping[str, float] = field(default_factory=dict)
    """Side -> m across the malleoli, where measured."""
    asis_distance: float | None = None
    """m between the two anterior superior iliac spines, where measured by hand."""
    marker_diameter: float | None = None
    """m; None where not known."""
    session: str = ""
    """A date or a label of the day of these recordings; empty where nobody says."""

    @property
    def weight(self) -> float:
        """Body weight, N."""
        return self.mass * GRAVITY

    @property
    def bwh(self) -> float:
        """Body weight times height, N·m: torques in %BW*H are 100 torque / bwh."""
        return self.weight * self.height


@dataclass(frozen=True)
class MarkerPlacement:
    """Tracking markers, fixed in their segments."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]
    """Name of the segment of each marker."""
    local: Array
    """(nm, 3) m, in the segment frame."""
    weight: Array
    """(nm,) >= 0; a marker with weight 0 is reported but does not pull."""


@dataclass(frozen=True, kw_only=True)
class SubjectModel:
    """A person's linkage model: nominal (from the static trial) or calibrated."""

    subject: Subject
    """The person."""
    parameters: Parameters
    """The values in use."""
    nominal: Parameters
    """The values before calibration, for comparison and as the centre of priors and bounds."""
    markers: MarkerPlacement
    """Where the tracking markers sit in their segments."""
    frozen: tuple[str, ...] = ()
    """Coordinates that no marker of the static trial moves with (no arms, no head): arms hang along the trunk, and the
    trunk stays upright (`motion/undetermined.py`)."""
    posture: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> rad in the static posture, the pelvis as if it faced along x; what is not there is zero."""
    landmarks: dict[str, tuple[str, Array]] = field(default_factory=dict)
    """Named points: segment and position (3,) m in its frame (`asis_r`, `hjc_r`, `knee_lat_r`, ...)."""
    notes: tuple[str, ...] = ()
    """What was assumed in making it; shown in every output."""

    @property
    def locked(self) -> tuple[str, ...]:
        """Those of `frozen` that are zero in every trial: a trunk that no marker shows turns against the pelvis."""
        return tuple(name for name in self.frozen if not name.startswith("lumbar"))

    def with_parameters(self, parameters: Parameters) -> SubjectModel:
        """The same person and markers with other parameters."""
        return replace(self, parameters=parameters)
