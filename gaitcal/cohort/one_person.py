"""One person of a cohort, from the folder of recordings to the result folder: what `gaitcal calibrate FOLDER` does,
with nobody to ask.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.cohort.people import CohortPerson, is_folder, no_folder
from gaitcal.errors import InputError
from gaitcal.faults.study import check_study
from gaitcal.faults.verdict import stopping
from gaitcal.findings import STUDY
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.result_folder import ResultKind, require_room, sha256_of
from gaitcal.results.calibration import write_results
from gaitcal.session.calibrate import calibrate
from gaitcal.session.draft import (
    Draft,
    draft_notes,
    draft_text,
    files_of,
    missing_words,
    own_study,
    settings_text,
    study_of,
)
from gaitcal.session.drafting import draft_of, rejected_forces, without_faulty_trials
from gaitcal.session.folder import read_folder
from gaitcal.study.joint_prior import require_joint_prior, with_cohort_priors
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, input_files
from gaitcal.study.study_file import load_study_file

ANYWAY = 0.005
"""Relative difference of a study file's mass or height from what else is said of the person, from which it is told."""


@dataclass(frozen=True, kw_only=True)
class CommonSettings:
    """What is the same for everyone of a cohort."""

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    """Of it, what was said; a study file of a person's own comes before."""
    normal: Path | None = None
    """File of normal bands."""
    priors: Path | None = None
    """`priors.json` of a cohort, on which joint parameters lean."""

    @property
    def said(self) -> dict[str, object]:
        """The settings that were said."""
        return {name: getattr(self.calibration, name) for name in sorted(self.calibration.model_fields_set)}


class PersonError(InputError):
    """Why a person has no result, and what to do."""

    def __init__(self, cause: str, action: str = "", *, code: Code) -> None:
        super().__init__(cause, code=code)
        self.action = " ".join(action.split())


def calibrate_person(person: CohortPerson, out: Path, common: CommonSettings) -> None:
    """Calibrate a person and write the result folder `out`; a refused verdict is a result, too.

    Raises
    ------
    InputError
        No study follows from the folder, or the checks find an error: a `PersonError` says what to do.
    """
    if not is_folder(person.folder):
        raise PersonError(
            no_folder(person), "put the recordings there, or take the person out of the list", code=Code.FOLDER
        )
    folder = read_folder(person.folder)
    own = own_study(folder)
    drafted = None
    if own is not None:
        inputs, study = input_files(load_study_file(own), own), Study.load(own)
    else:
        drafted = _ready(draft_of(folder, person.told))
        inputs, study = files_of(drafted), study_of(drafted)
    del folder  # the recordings of all files, also of those that are not used
    require_room(out, ResultKind.CALIBRATION, inputs)
    of_all = {name: value for name, value in common.said.items() if name not in study.settings.model_fields_set}
    study = replace(study, settings=study.settings.model_copy(update=of_all))
    require_joint_prior(study.settings, study.source)
    if common.priors is not None and study.joint_prior is None:
        study = with_cohort_priors(study, common.priors)
    findings = check_study(study)
    if drafted is not None:
        study, findings, faulty = without_faulty_trials(study, findings)
        drafted = drafted.without(faulty)
        findings = (*findings, *rejected_forces(drafted))
    if errors := stopping(findings, study.walks):
        first = errors[0]
        place = "" if first.where == STUDY else f"trial '{first.where}': "
        more = f" (and {len(errors) - 1} more errors)" if len(errors) > 1 else ""
        cause, action = f"{place}{first.topic}: {first.evidence}{more}", "gaitcal check shows all of it"
        raise PersonError(cause, first.cure or action, code=first.code)
    calibration = calibrate(study, checked=findings)
    notes = draft_notes(drafted) if drafted is not None else _contradictions(person, study, common)
    calibration = replace(calibration, notes=(*notes, *calibration.notes))
    normal = common.normal
    made_with = {} if normal is None else {"normal": normal.name, "normal_sha256": sha256_of(normal)}
    bands = None if normal is None else read_normal_bands(normal)
    settings = settings_text(common.calibration, common.priors, out)
    text = None if drafted is None else draft_text(drafted, out) + settings
    write_results(calibration, out, made_with, drafted=text, normal=bands)


def _ready(draft: Draft) -> Draft:
    """The draft; PersonError where it cannot be run."""
    if draft.fault or draft.problem:
        cause, put, action = (draft.fault or draft.problem).partition(": put each")
        action = f"{put[2:]}{action}" if action else "gaitcal init on this folder shows every file"
        raise PersonError(cause, action, code=Code.FOLDER)
    if draft.missing:
        fields = ", ".join(draft.missing)
        raise PersonError(missing_words(draft), f"give {fields} in people.csv or cohort.toml", code=Code.WHO_IT_IS)
    return draft


def _contradictions(person: CohortPerson, study: Study, common: CommonSettings) -> tuple[str, ...]:
    """What was said of a person whose own study file says otherwise, and is used."""
    said = (("mass_kg", person.told.mass, study.subject.mass), ("height_m", person.told.height, study.subject.height))
    found = [
        f"{field} = {other:g} was said for the cohort; the study file's {value:g} is used"
        for field, other, value in said
        if other is not None and abs(other / value - 1) > ANYWAY
    ]
    own = study.joint_prior
    if own is not None and common.priors is not None and own.sha256 != sha256_of(common.priors):
        found.append(f"priors = {common.priors.name} was said for the cohort; the study file's {own.file} is used")
    return tuple(found)
