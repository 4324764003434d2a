"""A foot strike or off, with what told it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from gaitcal.io.labels import FootEvent


class EventSource(Enum):
    """What tells an event, the first that there is."""

    FILE = "file"
    """The recording's own list of events, where it fits forces and motion."""
    PLATES = "plates"
    """A force plate becomes loaded, or unloaded."""
    MOTION = "motion"
    """The foot comes to rest, or leaves (`gait/swing.py`)."""


@dataclass(frozen=True)
class GaitEvent(FootEvent):
    """One foot meets or leaves the ground, and how this is known."""

    source: EventSource


SOURCE_WORDS = {
    EventSource.FILE: "the file's events",
    EventSource.PLATES: "force plates",
    EventSource.MOTION: "the motion of the feet",
}


def source_words(sources: Iterable[EventSource]) -> str:
    """`force plates and the motion of the feet`: each source once, the best first; empty without sources."""
    found = set(sources)
    return " and ".join(words for source, words in SOURCE_WORDS.items() if source in found)
