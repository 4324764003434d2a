"""How well a marker set explains the labels of a file: which landmarks, which segments, what is left over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gaitcal.model.landmark_names import REQUIRED, missing_landmarks
from gaitcal.model.linkage import LEG_SEGMENTS

if TYPE_CHECKING:
    from gaitcal.model.marker_set import MarkerSet

PELVIS_NEEDS = 3
"""Markers of the pelvis, from which the pose of the body starts."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """What the labels of a file give of a marker set."""

    required_missing: tuple[str, ...]
    """Landmarks without which there is no model, and which no marker of the file gives."""
    landmarks: Mapping[str, tuple[str, ...]]
    """Landmark that the file gives -> the markers whose mean it is, by the set's preference."""
    tracked: Mapping[str, tuple[str, ...]]
    """Segment -> markers of the file that follow it; without segments that have none."""
    bare: tuple[str, ...]
    """Segments of pelvis and legs that nothing follows (pelvis: fewer than three markers)."""
    unknown: tuple[str, ...]
    """Markers of the file that the set does not know."""
    score: float
    """Share of the file's labels that the set knows, 0 to 1, and 1 more where the set is complete for the legs: so a
    complete set comes before any other. An incomplete one has that share times the share of landmarks it gives."""

    @property
    def complete(self) -> bool:
        """Whether a static trial with these labels makes a model of pelvis and legs."""
        return not self.required_missing and not self.bare


def coverage_of(marker_set: MarkerSet, labels: Iterable[str], computed: Iterable[str] = ()) -> Coverage:
    """What `labels`, spelt as the set does, give of it; points that another program `computed` serve as landmarks only.

    A device at the knee counts as the lateral knee marker that it stands in for.
    """
    given = tuple(labels)
    known = set(marker_set.labels)
    seen = set(given)
    virtual = {label for label, parts in marker_set.knee_device.items() if seen.issuperset(parts)}
    virtual |= set(computed) & {m for name in marker_set.landmarks for group in marker_set.options(name) for m in group}
    landmarks = {}
    for name in marker_set.landmarks:
        option = next((group for group in marker_set.options(name) if (seen | virtual).issuperset(group)), None)
        if option is not None:
            landmarks[name] = option
    segment_of = marker_set.segment_of
    tracked: dict[str, tuple[str, ...]] = {}
    for label in (*given, *sorted(virtual - seen)):
        if label in segment_of:
            tracked[segment_of[label]] = (*tracked.get(segment_of[label], ()), label)
    bare = [segment for segment in LEG_SEGMENTS if segment != "pelvis" and segment not in tracked]
    if len(tracked.get("pelvis", ())) < PELVIS_NEEDS:
        bare.insert(0, "pelvis")
    missing = missing_landmarks(landmarks)
    share = sum(label in known for label in given) / len(given) if given else 0.0
    whole = not missing and not bare
    return Coverage(
        required_missing=missing,
        landmarks=landmarks,
        tracked=tracked,
        bare=tuple(bare),
        unknown=tuple(label for label in given if label not in known),
        score=1.0 + share if whole else share * (1.0 - len(missing) / len(REQUIRED)),
    )
