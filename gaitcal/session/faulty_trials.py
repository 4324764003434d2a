"""Trials of a drafted study in which the checks find an error, while others are sound: they are left out, and told.

Somebody who names a trial in a study file wants it, and is told to look at it; a folder holds what was recorded, bad
takes too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gaitcal.faults.study import check_study
from gaitcal.findings import Finding, Severity
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role


def without_faulty_trials(
    study: Study, findings: tuple[Finding, ...]
) -> tuple[Study, tuple[Finding, ...], dict[str, str]]:
    """The study without trials that an error speaks against, what the checks find then, and trial -> error.

    Nothing is left out where the first static trial, or the study as a whole, is at fault, or where no trial of a kind
    (walks, or isolated trials without walks) would be left.
    """
    errors = [f for f in findings if f.severity is Severity.ERROR]
    faulty = _told(errors)
    if not faulty or not _may_go(study, errors, set(faulty)):
        return study, findings, {}
    rest = replace(study, trials=tuple(t for t in study.trials if t.name not in faulty))
    return rest, check_study(rest), faulty


def _told(errors: Sequence[Finding]) -> dict[str, str]:
    out: dict[str, str] = {}
    for finding in errors:
        cure = f"; {finding.cure}" if finding.cure else ""
        out.setdefault(finding.where, f"{finding.topic}: {finding.evidence}{cure}")
    return out


def _may_go(study: Study, errors: Sequence[Finding], faulty: set[str]) -> bool:
    names = {trial.name for trial in study.trials}
    if not faulty <= names - {study.static.name}:
        return False
    kind = Role.GAIT if any(trial.role is Role.GAIT for trial in study.moving) else Role.JOINT
    return any(trial.role is kind and trial.name not in faulty for trial in study.moving)
