"""What a run says: the one place that knows where its messages stand."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from gaitcal import Calibration
from gaitcal.faults.verdict import Judgement
from gaitcal.findings import Finding, Severity


def errors_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """The errors among what the checks found: they stop the run."""
    return tuple(f"{f.where}: {f.topic}: {f.evidence}; {f.cure}" for f in findings if f.severity is Severity.ERROR)


def refusal(calibration: Calibration) -> tuple[str, ...]:
    """Why a finished calibration is refused; empty where it is not."""
    verdict = calibration.verdict
    if verdict.judgement is not Judgement.REFUSED:
        return ()
    return tuple(reason.line for reason in verdict.reasons if reason.severity is Severity.ERROR)


def warned(calibration: Calibration) -> tuple[str, ...]:
    """Everything that is said to a user who gets a result: facts that need no action do not count."""
    late = [f"phase {p.name} did not converge: {p.message}" for p in calibration.phases if not p.converged]
    return (*(reason.line for reason in calibration.verdict.reasons), *late)


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
