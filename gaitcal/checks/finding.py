"""What a check says: how bad it is, where, what was found, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gaitcal.errors import InputError


class Severity(Enum):
    """How bad a finding is."""

    ERROR = "error"
    """A calibration of this would be wrong, or impossible."""
    WARNING = "warning"
    """It may be right, and somebody should look."""
    INFO = "info"
    """Good to know."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that a check found."""

    severity: Severity
    topic: str
    """What it is about, in a word or two: `units`, `labels`, `gaps`, ..."""
    where: str
    """Name of the trial, or `study`."""
    found: str
    """What was found, with numbers."""
    cure: str
    """What to do; empty where there is nothing to do."""
    source: str = ""
    """The file at fault."""

    @property
    def line(self) -> str:
        """The finding in one line: file, trial, what was found, what to do."""
        place = self.where if self.where == "study" else f"trial '{self.where}'"
        parts = [part for part in (self.source, place, self.topic) if part]
        return f"{': '.join(parts)}: {self.found}" + (f"; {self.cure}" if self.cure else "")

    @classmethod
    def of_fault(cls, fault: InputError, where: str, source: str, topic: str) -> Finding:
        """An InputError as a finding; its text already tells what is allowed."""
        text = str(fault).removeprefix(f"{source}: ")
        return cls(severity=Severity.ERROR, topic=topic, where=where, found=text, cure="", source=source)


def listed(names: list[str], most: int = 6) -> str:
    """The first few names of a list, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
