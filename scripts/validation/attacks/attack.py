"""What an attack is, and how it may end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TypeAlias

from gaitcal import Study

StudyChange: TypeAlias = Callable[[Study], Study]
"""The study with its data spoilt. May raise what reading spoilt files raises."""
FileChange: TypeAlias = Callable[[Path], None]
"""Spoils the files of a study in the folder of its `study.toml`, in place."""


class Kind(str, Enum):
    """What is spoilt."""

    STATIC = "static trial"
    WALK = "markers of the walk"
    ISOLATED = "isolated trial"
    FORCES = "forces"
    SUBJECT = "subject"
    STUDY = "study"
    FILE = "file"


class Ending(str, Enum):
    """How an attack ended, the best first."""

    REFUSED = "refused"
    """An error stops the run."""
    NAMED = "named"
    """A new message names the cause."""
    HARMLESS = "harmless"
    """Nothing new is said, and every result holds within the error bars of its own run."""
    ALARMED = "alarmed"
    """Something new is said, and the cause is not named."""
    SILENT = "silent"
    """Nothing new is said, and a result moved by more than its own error bar."""
    CRASH = "crash"
    """An exception that no user should see."""


@dataclass(frozen=True, kw_only=True)
class Attack:
    """One corruption of one clean study."""

    name: str
    base: str
    kind: Kind
    change: StudyChange | FileChange
    named: tuple[str, ...]
    """Regular expressions, letter case ignored, that one new message must match, all of them, to name the cause. `{x}`
    in them stands for the labels of landmark, segment or marker x in the marker set of the base (`markers.pattern`)."""
    other_frames: tuple[str, ...] = ()
    """Trials whose frames are no longer those of the clean run: not compared frame by frame."""
    of_files: bool = False
    """Whether `change` spoils files."""
    quick: bool = False
    """Whether it belongs to the part that runs as a test."""

    @property
    def title(self) -> str:
        """Unique in the corpus."""
        return f"{self.base}: {self.kind.value}: {self.name}"


@dataclass(frozen=True, kw_only=True)
class Result:
    """How one attack ended."""

    attack: str
    """Its title."""
    kind: Kind
    ending: Ending
    messages: tuple[str, ...] = ()
    """What was said that is new, or the error."""
    moved: float | None = None
    """Largest movement of a result, in error bars; None where no result was made or none can be compared."""
    where: str = ""
    """Which result that is, and how far in its own unit."""
    seconds: float = 0.0
    cause_told: bool = True
    """Whether the error of a refused study names the cause."""
