"""The person of a study: what the study file says, and where it says nothing what the recordings' files do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gaitcal.model.subject_model import Subject
from gaitcal.recording.metadata import Facts
from gaitcal.recording.recording import Recording
from gaitcal.study.study_file import SubjectTable


def subject_of(table: SubjectTable, recordings: Sequence[Recording]) -> Subject:
    """The person as the study says, and, of what it does not say, as the files do: the first recording's before others.

    A file that names another person than the first one is not asked.
    """
    told = _told([recording.facts for recording in recordings])
    given_mm = table.marker_diameter_mm
    return Subject(
        table.name,
        table.mass_kg,
        table.height_m,
        table.sex,
        age=table.age_years,
        knee_width=told.knee_width | {side: 1e-3 * width for side, width in table.knee_width_mm.items()},
        ankle_width=told.ankle_width | {side: 1e-3 * width for side, width in table.ankle_width_mm.items()},
        asis_distance=told.asis_distance if table.asis_distance_mm is None else 1e-3 * table.asis_distance_mm,
        marker_diameter=told.marker_diameter if given_mm is None else 1e-3 * given_mm,
        session=table.session,
    )


def _told(facts: Sequence[Facts]) -> Facts:
    """Widths, distance between the ASIS and marker diameter: each from the first file that tells it and names the
    person of the first file.
    """
    out = Facts()
    for told in reversed([f for f in facts if f.name == facts[0].name]):
        out = replace(
            out,
            knee_width=out.knee_width | told.knee_width,
            ankle_width=out.ankle_width | told.ankle_width,
            asis_distance=told.asis_distance or out.asis_distance,
            marker_diameter=told.marker_diameter or out.marker_diameter,
        )
    return out
