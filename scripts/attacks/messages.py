"""What a run says: the one place that knows where its messages stand."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from gaitcal import Calibration
from gaitcal.findings import Finding, Severity


def findings_said(findings: Sequence[Finding], severities: tuple[Severity, ...]) -> tuple[str, ...]:
    """Findings of these severities as a user reads them, without the file, whose name may hold any word."""
    return tuple(f"{f.where}: {f.topic}: {f.evidence}; {f.cure}" for f in findings if f.severity in severities)


def warned(findings: Sequence[Finding], calibration: Calibration | None = None) -> tuple[str, ...]:
    """Everything that is said to a user who gets a result: facts that need no action do not count."""
    said = findings_said(findings, (Severity.WARNING, Severity.ERROR))
    if calibration is None:
        return said
    late = () if calibration.converged else ("a phase did not converge: " + _late(calibration),)
    return (*said, *calibration.warnings, *late)


def _late(calibration: Calibration) -> str:
    return ", ".join(f"{phase.name} ({phase.message})" for phase in calibration.phases if not phase.converged)


def bare(message: str) -> str:
    """A message without its numbers: another number is no new message."""
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", message))


def new(messages: Iterable[str], clean: Iterable[str]) -> tuple[str, ...]:
    """The messages that the clean run does not have."""
    known = {bare(message) for message in clean}
    return tuple(message for message in dict.fromkeys(messages) if bare(message) not in known)


CATCH_ALL = re.compile(r"look at plate positions, force sign and clock|held near nominal values")
"""Sentences that list every possible cause, or that speak of trials which the study has not: they name nothing."""


def names_cause(message: str, patterns: Sequence[str]) -> bool:
    """Whether a message matches all of the patterns."""
    return not CATCH_ALL.search(message) and all(re.search(pattern, message, re.IGNORECASE) for pattern in patterns)
