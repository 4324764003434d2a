"""Walks of a drafted study without torques though a table of forces lies beside them: no part of a whole result."""

from __future__ import annotations

from pathlib import PurePath

from gaitcal.codes import Code
from gaitcal.findings import Finding, Severity
from gaitcal.session.draft import Draft
from gaitcal.session.folder import FileKind
from gaitcal.session.force_files import names_alike


def rejected_forces(draft: Draft) -> tuple[Finding, ...]:
    """A warning for each walk without forces whose name a table of forces bears that is nobody's."""
    tables = [row for row in draft.left_out if row.kind == FileKind.FORCES.value]
    walks = {t.file.path.stem: t for t in draft.trials if t.role == "gait"}
    out = []
    for row in tables:
        stem = max(walks, key=lambda name: names_alike(name, PurePath(row.name).stem), default="")
        trial = walks.get(stem)
        if trial is None or trial.forces is not None or (trial.file.recording and trial.file.recording.plates):
            continue
        warning = Finding(
            severity=Severity.WARNING,
            topic="forces",
            where=trial.name,
            found=f"{row.name} is not used: {row.reason}",
            cause="no forces, no torques",
            cure="find the forces of this walk; or take the table out of the folder, if angles are wanted",
            code=Code.FORCES_NOT_USED,
        )
        out.append(warning)
    return tuple(out)
