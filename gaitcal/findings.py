"""What is said of data and results: how bad it is, where, what is wrong, by what evidence, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gaitcal.codes import Code
from gaitcal.errors import InputError

STUDY = "study"
"""Where a finding is that belongs to no single trial."""


class Severity(Enum):
    """How bad a finding is."""

    ERROR = "error"
    """A result of this would be wrong, or impossible: it is refused."""
    WARNING = "warning"
    """It may be right, and somebody should look: the result is doubtful."""
    INFO = "info"
    """Good to know; nothing needs to be done."""

    @property
    def rank(self) -> int:
        """0 for the worst."""
        return list(Severity).index(self)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was found."""

    code: Code
    """Its kind: `gaitcal explain` tells what it means."""
    severity: Severity
    topic: str
    """What it is about, in a word or two: `units`, `labels`, `gaps`, ..."""
    where: str = ""
    """Name of the trial, or `study`; empty where whoever asks for it knows the trial."""
    found: str
    """The evidence: what was found, with numbers."""
    cure: str = ""
    """What to do; empty where there is nothing to do."""
    source: str = ""
    """The file at fault."""
    cause: str = ""
    """What is wrong, in a clause of its own ("the heel marker R_Heel left its place"); empty where the topic and the
    evidence say it. Findings of one cause are told once."""
    leg: str = ""
    """`r` or `l` where it concerns one leg alone."""
    weight: float = 1.0
    """How many times its own error bar a torque may be wrong by this, roughly: the worst is told first."""

    @property
    def evidence(self) -> str:
        """What was found, after what is wrong."""
        return f"{self.cause}: {self.found}" if self.cause else self.found

    @property
    def line(self) -> str:
        """The finding in one line: file, trial, what was found, what to do."""
        place = self.where if self.where == STUDY else f"trial '{self.where}'"
        parts = [part for part in (self.source, place, self.topic) if part]
        return f"{': '.join(parts)}: {self.evidence}" + (f"; {self.cure}" if self.cure else "")

    @classmethod
    def of_fault(cls, fault: InputError, where: str, source: str, topic: str) -> Finding:
        """An InputError as a finding; its text already tells what is allowed."""
        text = str(fault).removeprefix(f"{source}: ")
        return cls(code=fault.code, severity=Severity.ERROR, topic=topic, where=where, found=text, source=source)


def listed(names: list[str], most: int = 6) -> str:
    """The first few names of a list, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def note_of(finding: Finding) -> str:
    """A finding as a note of a result: it begins with the name of its trial, where it has one."""
    place = "" if finding.where in (STUDY, "") else f"{finding.where}: "
    return f"{place}{finding.evidence}" + (f"; {finding.cure}" if finding.cure else "")
