"""What a file says beside its samples: about the person, the moments at which feet meet the ground, computed points."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from gaitcal.arrays import Array


class FootMoment(Enum):
    """What a foot does at an event."""

    STRIKE = "foot strike"
    OFF = "foot off"


@dataclass(frozen=True)
class FootEvent:
    """One foot meets or leaves the ground."""

    moment: FootMoment
    side: str
    """`r` or `l`."""
    time: float
    """s, on the clock of the recording."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What a file says about the person; None, or no entry for a side, where it says nothing."""

    name: str | None = None
    mass: float | None = None
    """kg."""
    height: float | None = None
    """m."""
    marker_set: str | None = None
    """As the laboratory calls its own."""
    marker_diameter: float | None = None
    """m."""
    asis_distance: float | None = None
    """m, between the two anterior superior iliac spines."""
    knee_width: dict[str, float] = field(default_factory=dict)
    """Side -> m, across the femoral epicondyles."""
    ankle_width: dict[str, float] = field(default_factory=dict)
    """Side -> m, across the malleoli."""
    leg_length: dict[str, float] = field(default_factory=dict)
    """Side -> m, from the anterior superior iliac spine to the medial malleolus."""
    static_plantarflexion: dict[str, float] = field(default_factory=dict)
    """Side -> rad, from the line ankle centre to toe marker up to the foot's long axis (`StaticPlantFlex`)."""
    doubtful: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    """Fact, as `height` or `knee_width_r` -> what the file says that cannot be in its units, in words, and what it is
    in the only other unit that makes sense of it; None where several do, or none."""
    is_static: bool | None = None
    """Whether the file calls itself a static trial."""


@dataclass(frozen=True)
class ComputedPoints:
    """Points that another program computed: joint centres, modelled markers. Not measured, and in no fit."""

    labels: tuple[str, ...]
    points: Array
    """(nf, np, 3) m, at the frames of the recording and in its axes; NaN where not known."""
