"""A drafted study: what each file of a folder is taken for, the trials, the person, and what is missing.

Nothing is dropped without a word: every file of the folder is a row of `Draft.seen`, with what it is used as or why it
is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gaitcal.session.folder import Folder, FolderFile
from gaitcal.session.force_files import ForceChoice
from gaitcal.session.marker_sets import SetChoice
from gaitcal.session.person_facts import Known

NEEDED = {"mass_kg": "--mass", "height_m": "--height", "sex": "--sex"}
"""Fields of the person without which nothing can be calibrated, and the options that give them."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One file of the folder, as it was understood."""

    name: str
    kind: str
    frames: int | None = None
    labels: str = ""
    """How many of its labels the marker set knows."""
    shows: str = ""
    used: str = ""
    """As what; empty: not at all."""
    reason: str = ""
    """Why it is used so, or why it is not used."""


@dataclass(frozen=True, kw_only=True)
class DraftTrial:
    """One trial of the drafted study."""

    name: str
    role: str
    joint: str = ""
    file: FolderFile
    forces: ForceChoice | None = None
    reason: str
    certain: bool


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A folder as it was understood, and the study that follows."""

    folder: Folder
    choice: SetChoice | None
    """None: no marker set explains the labels."""
    person: Mapping[str, Known]
    trials: tuple[DraftTrial, ...]
    seen: tuple[Seen, ...]
    fault: str = ""
    """Why no study follows from the folder; empty where one does."""
    strangers: bool = False
    """Whether recordings of the same labels show another person, or another session."""
    problem: str = ""
    """Why the drafted study cannot be run as it is, apart from what is missing."""

    doubts: tuple[str, ...] = ()
    """What files say of the person that can be in no unit it should be in."""

    @property
    def moves(self) -> bool:
        """Whether a trial shows more than standing."""
        return any(trial.role != "static" for trial in self.trials)

    @property
    def missing(self) -> tuple[str, ...]:
        """Fields of the person that nobody tells, and that are needed."""
        return tuple(name for name in NEEDED if name not in self.person)

    @property
    def left_out(self) -> tuple[Seen, ...]:
        """Files that are not used."""
        return tuple(row for row in self.seen if not row.used)

    def without(self, trials: Mapping[str, str]) -> Draft:
        """The draft without these trials, name -> why."""
        out = {trial.file.name: trials[trial.name] for trial in self.trials if trial.name in trials}
        return replace(
            self,
            trials=tuple(trial for trial in self.trials if trial.name not in trials),
            seen=tuple(replace(row, used="", reason=out[row.name]) if row.name in out else row for row in self.seen),
        )
