"""A drafted study: the files of a folder, trials, subject, missing fields, and its text.

Every file of the folder is a row of `Draft.rows`, with what it is used as or why it is not used. In
the text each line has its reason: `sure` if a file or the user states it or the figures are far
from every limit, `likely` if a figure is near one. A missing field is a comment that names the
field, so that reading the study reports it.
"""

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gaitcal.errors import Code, InputError, UsageError, find_similar_names
from gaitcal.intake import choose_marker_set, subject_metadata
from gaitcal.intake.recordings_folder import (
    FileKind,
    Folder,
    FolderFile,
    ForceChoice,
    is_study,
    read_folder,
)
from gaitcal.intake.subject_metadata import NO_OPTIONS, Options
from gaitcal.io.toml import format_toml_table, format_toml_value, read_toml
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import list_built_in_sets
from gaitcal.study import study_file, study_trial
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, read_marker_set

if TYPE_CHECKING:
    from gaitcal.intake.label_proposal import LabelProposal

NEEDED = {"mass_kg": "--mass KG", "height_m": "--height M"}
"""Fields of the subject that a calibration needs, and the options that give them."""


@dataclass(frozen=True, kw_only=True)
class FileRow:
    """One file of the folder, and what it is used as."""

    name: str
    kind: str
    frames: int | None = None
    labels: str = ""
    """How many of its labels the marker set contains."""
    shows: str = ""
    """The movement that it shows."""
    used: str = ""
    """What it is used as; empty: it is not used."""
    reason: str = ""
    """Why it is used so, or why it is not used."""


@dataclass(frozen=True, kw_only=True)
class DraftedTrial:
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
    """The files of a folder, and the study that follows from them."""

    folder: Folder
    choice: choose_marker_set.SetChoice | None
    """None: no marker set explains the labels."""
    person: Mapping[str, subject_metadata.KnownField]
    """Field of `[subject]` -> its value and reason."""
    trials: tuple[DraftedTrial, ...]
    rows: tuple[FileRow, ...]
    fault: str = ""
    """Why no study follows from the folder; empty if one does."""
    has_other_people: bool = False
    """Whether recordings with the same labels show another person or another session."""
    problem: str = ""
    """Why the drafted study cannot be run as it is, apart from missing fields."""
    doubts: tuple[str, ...] = ()
    """Figures of files about the subject that are in no plausible unit."""

    @property
    def moves(self) -> bool:
        """Whether a trial shows more than standing."""
        return any(trial.role != "static" for trial in self.trials)

    @property
    def missing(self) -> tuple[str, ...]:
        """Needed fields of the subject that are not given."""
        return tuple(name for name in NEEDED if name not in self.person)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Fields of the subject that are not given and replaced by estimates with wider errors."""
        height = ("height_m",) if "height_error_m" in self.person else ()
        return (*height, *(() if "sex" in self.person else ("sex",)))

    @property
    def left_out(self) -> tuple[FileRow, ...]:
        """Files that are not used."""
        return tuple(row for row in self.rows if not row.used)

    def drop_trials(self, trials: Mapping[str, str]) -> "Draft":
        """Return the draft without some trials.

        Parameters
        ----------
        trials
            Name of the trial -> why it is left out.

        Returns
        -------
        Draft
        """
        out = {trial.file.name: trials[trial.name] for trial in self.trials if trial.name in trials}
        rows = [
            replace(row, used="", reason=out[row.name]) if row.name in out else row
            for row in self.rows
        ]
        kept = tuple(trial for trial in self.trials if trial.name not in trials)
        return replace(self, trials=kept, rows=tuple(rows))


FIRST_LABELS = 8
"""Labels that are shown of a recording that no marker set explains."""


def build_row(
    file: FolderFile, *, labels: str = "", shows: str = "", used: str = "", reason: str = ""
) -> FileRow:
    """Make the row of a file.

    Parameters
    ----------
    file
        As it was read.
    labels, shows, used, reason
        See `FileRow`. Default of `labels`: the first labels of a recording; of `reason`: why the
        file cannot be used.

    Returns
    -------
    FileRow
    """
    frames = None if file.recording is None else len(file.recording.time)
    if file.recording is not None and not labels:
        labels = f"{len(file.recording.labels)}: {' '.join(file.recording.labels[:FIRST_LABELS])}"
    return FileRow(
        name=file.name,
        kind=file.kind.value,
        frames=frames,
        labels=labels,
        shows=shows,
        used=used,
        reason=reason or file.reason,
    )


STUDY = "study.toml"
WIDEST = 70
"""Characters of a line up to which its comment is on the same line; else it is above."""
MISSING = {"mass_kg": "body mass in kg", "height_m": "body height in m"}
"""What the user writes for a missing field. There is no default that could be kept by accident."""


def format_draft(draft: Draft, folder: Path | None) -> str:
    """Write the study as the text of a study file.

    Parameters
    ----------
    draft
        Of a folder from which a study follows.
    folder
        Folder of the study file, to which paths are relative; None: absolute paths.

    Returns
    -------
    str
        TOML.

    Raises
    ------
    InputError
        No study follows from the folder.
    """
    lines = [
        f"# Drafted from the folder '{draft.folder.name}'. Each line has its reason; check those "
        "marked 'likely'.",
        "",
        *_format_subject(draft),
        *_format_markers(draft, folder),
    ]
    for trial in draft.trials:
        lines += _format_trial(trial, folder)
    # without study files: one of them will be this text
    left = [row for row in draft.left_out if row.kind != FileKind.STUDY.value]
    if left:
        lines += [
            "# Not used:",
            *(
                f"#   {_join_lines(row.name)}: {_join_lines(row.reason or row.kind)}"
                for row in left
            ),
        ]
    return "\n".join(lines).rstrip() + "\n"


def format_settings(
    settings: CalibrationSettings, priors: Path | None = None, folder: Path | None = None
) -> str:
    """Write the calibration settings as the table of a study file.

    Parameters
    ----------
    settings
        Only settings that were given are written.
    priors
        File of priors, if there is one.
    folder
        Folder of the study file, to which its path is relative.

    Returns
    -------
    str
        TOML; empty without settings.
    """
    given = settings.model_dump(exclude_unset=True)
    if priors is not None:
        given["priors"] = _make_relative(priors, folder)
    return "\n" + format_toml_table("[calibration]", given) if given else ""


def _format_subject(draft: Draft) -> list[str]:
    """Write the table `[subject]`, missing fields as comments."""
    lines = ["[subject]"]
    for field in (
        "name",
        "session",
        "session_date",
        "mass_kg",
        "height_m",
        "height_error_m",
        "sex",
        "age_years",
    ):
        known = draft.person.get(field)
        if known is not None:
            lines += _format_line(field, known.value, known.reason, known.certain)
        elif field in MISSING:
            write = f"write {MISSING[field]}, and remove the first #"
            lines.append(
                f"# {field} =   # MISSING: not given in {_get_file_subject(draft)}; {write}"
            )
    for field in (
        "knee_width_mm",
        "ankle_width_mm",
        "leg_length_mm",
        "asis_distance_mm",
        "marker_diameter_mm",
    ):
        known = draft.person.get(field)
        if known is not None:
            lines += _format_line(field, known.value, known.reason, known.certain)
    if "sex" not in draft.person:
        lines.append(
            '# sex = "female"   # not given; masses are the mean of both tables, with wider errors'
        )
    if "age_years" not in draft.person:
        lines.append("# age_years =   # not given; mass tables and normative data depend on it")
    if "session_date" not in draft.person:
        lines.append(
            '# session_date = "YYYY-MM-DD"   # not given; with birth_date it gives the age'
        )
    lines.append(
        "# Optional, for reports and tables: birth_date, diagnosis, affected_side, aids, laboratory"
    )
    return [*lines, ""]


def _format_markers(draft: Draft, folder: Path | None) -> list[str]:
    """Write the table `[markers]`."""
    choice = draft.choice
    if choice is None:
        raise InputError(draft.fault, source=draft.folder.path, code=Code.FOLDER)
    found = choice.coverage
    reason = (
        f"contains {found.known} of {found.known + len(found.left_over)} labels of "
        f"{len(choice.members)} files"
    )
    reason += _describe_left_over(choice)
    if choice.clashes:
        reason += f"; not renamed because the name is taken: {', '.join(choice.clashes[:4])}"
    built_in = choice.entry in list_built_in_sets()
    if choice.proposal is not None:
        return [*_format_proposal(choice.proposal), ""]
    lines = [
        "[markers]",
        *_format_line(
            "set",
            choice.entry if built_in else _make_relative(Path(choice.entry), folder),
            reason,
            choice.certain,
        ),
    ]
    if choice.rename:
        reason = "differ only in case, separators or a prefix"
        if choice.centres:
            reason += (
                f"; or markers lateral to joint centres, named by: {', '.join(choice.centres)}"
            )
        lines += _format_line("rename", dict(sorted(choice.rename.items())), reason, False)
    if found.missing:
        lines.append(f"# Landmarks without markers: {', '.join(found.missing)}")
    if choice.further_markers is not None:
        lines += _format_followers(choice.further_markers)
    return [*lines, ""]


def _format_proposal(proposal: "LabelProposal") -> list[str]:
    """Write proposed labels with their evidence; uncertain ones as questions in comments."""
    lines = [
        "[markers]",
        f"# likely: no marker set contains the labels; {proposal.basis}",
        'set = "landmarks"',
        "# MISSING: check each line of rename and tracking; then write true",
        "confirmed = false",
        "[markers.rename]  # label in the files = landmark of the marker",
    ]
    for label, name in sorted(proposal.rename.items(), key=lambda item: item[1]):
        line = f"{format_toml_value({label: name})[1:-1].strip()}  # {proposal.evidence[label]}"
        question = (
            "; TO CONFIRM: if it is, remove the first #; else name its segment under "
            "markers.tracking"
        )
        lines.append(f"# {line}{question}" if label in proposal.asked else line)
    return lines + _format_followers(proposal)


def _format_followers(proposal: "LabelProposal") -> list[str]:
    """Write markers that move with segments, with their evidence, and labels that are not used."""
    lines = []
    if proposal.tracking:
        lines.append("[markers.tracking]  # segment = further markers that move with it")
    for segment, labels in proposal.tracking.items():
        lines.append(f"{segment} = [")
        lines += [
            f"    {format_toml_value(label)},  # {proposal.evidence[label]}" for label in labels
        ]
        lines.append("]")
    if proposal.weights:
        lines.append(
            "[markers.weights]  # 0: shown, not fitted: head, toes that bend, skin over knees"
        )
        lines += [
            f"{format_toml_value({label: weight})[1:-1].strip()}"
            for label, weight in proposal.weights.items()
        ]
    return lines + [
        f"# not used: {_join_lines(label)}: {why}" for label, why in proposal.unused.items()
    ]


def _describe_left_over(choice: choose_marker_set.SetChoice) -> str:
    """Describe labels that the set does not contain, and similar labels of the set.

    Returns: `; unknown: ...`; empty if the set contains all labels.
    """
    left = choice.coverage.left_over
    if not left:
        return ""
    more = f" and {len(left) - 8} more" if len(left) > 8 else ""
    meant = {label: find_similar_names(label, choice.marker_set.labels) for label in left[:8]}
    hints = ", ".join(f"{label} like {like[0]}" for label, like in meant.items() if like)
    question = f" (similar to labels of the set: {hints}; rename them if they are)" if hints else ""
    return f"; unknown: {', '.join(left[:8])}{more}{question}"


def _format_trial(trial: DraftedTrial, folder: Path | None) -> list[str]:
    """Write a table `[[trial]]`."""
    lines = ["[[trial]]", f"name = {format_toml_value(trial.name)}  # after the file"]
    lines += _format_line("role", trial.role, trial.reason, trial.certain)
    if trial.joint:
        lines.append(
            f"joint = {format_toml_value(trial.joint)}  # the joint that rotates most, see role"
        )
    recording = trial.file.recording
    frames = "" if recording is None else f"{len(recording.time)} frames at {recording.rate:.4g} Hz"
    plates = 0 if recording is None else len(recording.plates)
    if trial.role in ("gait", "motion"):
        if plates:
            frames += f", {plates} force plates"
        elif not trial.forces:
            frames += ", no forces: angles, no torques"
    lines.append(f"file = {format_toml_value(_make_relative(trial.file.path, folder))}  # {frames}")
    if trial.forces is not None:
        lines += _format_line(
            "forces",
            _make_relative(trial.forces.file.path, folder),
            trial.forces.reason,
            trial.forces.certain,
        )
    return [*lines, ""]


def _format_line(field: str, value: object, reason: str, certain: bool) -> list[str]:
    """Write `field = value  # sure: reason`; the comment is above a long line."""
    comment = f"# {'sure' if certain else 'likely'}: {_join_lines(reason)}"
    text = _format_assignment(field, value)
    return [f"{text}  {comment}"] if len(text) <= WIDEST else [comment, text]


def _format_assignment(field: str, value: object) -> str:
    """Write `field = value`; values of both sides as an inline table."""
    if isinstance(value, Mapping) and set(value) <= set(SIDES):
        return f"{field} = {{ {', '.join(f'{side} = {v:g}' for side, v in value.items())} }}"
    return f"{field} = {format_toml_value(value)}"


def _join_lines(text: str) -> str:
    """Return a text in one line, without control characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _make_relative(path: Path, folder: Path | None) -> Path:
    """Return a path relative to a folder; absolute without one."""
    absolute = path.parent.resolve() / path.name
    if folder is None:
        return absolute
    try:
        return Path(os.path.relpath(absolute, folder.resolve()))
    except ValueError:
        # another drive
        return absolute


def describe_missing_fields(draft: Draft) -> str:
    """Describe the needed fields that are not given.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    str
    """
    doubts = f" ({'; '.join(draft.doubts[:2])})" if draft.doubts else ""
    fields = ", ".join(f"subject.{field}" for field in draft.missing)
    verb = "is" if len(draft.missing) == 1 else "are"
    return f"{fields} {verb} not given in {_get_file_subject(draft)}{doubts}"


def _get_file_subject(draft: Draft) -> str:
    """Return which files do not give a field: those of another person may."""
    return "any file that is used" if draft.has_other_people else "any file"


def list_missing_options(draft: Draft) -> str:
    """List the command options for the missing fields.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    str
        Separated by blanks.
    """
    return " ".join(NEEDED[field] for field in draft.missing)


def _describe_unconfirmed_labels(draft: Draft) -> str:
    """Describe that the meaning of labels is only proposed, and what to do.

    Returns: empty if a marker set explains the labels.
    """
    if draft.choice is None or draft.choice.proposal is None:
        return ""
    labels = list(draft.choice.proposal.evidence)
    shown = ", ".join(labels[:4]) + (", ..." if len(labels) > 4 else "")
    return (
        f"no marker set contains the labels {shown}; a proposal of what each marker is must be "
        f"confirmed: 'gaitcal init {draft.folder.path}' writes it"
    )


def build_study(draft: Draft, *, proposed: bool = False) -> Study:
    """Build the drafted study with its recordings, without a study file on disk.

    Parameters
    ----------
    draft
        Of a folder.
    proposed
        Also if the meaning of the labels is only proposed.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        No study follows from the folder, a needed field is missing, or an error of `Study.load`.
    """
    path = draft.folder.path / STUDY
    if draft.fault:
        raise InputError(draft.fault, source=draft.folder.path, code=Code.FOLDER)
    unconfirmed = "" if proposed else _describe_unconfirmed_labels(draft)
    if unconfirmed:
        raise InputError(unconfirmed, source=draft.folder.path, code=Code.UNKNOWN_LABEL)
    if draft.missing:
        message = f"{describe_missing_fields(draft)}: give {list_missing_options(draft)}"
        raise InputError(message, source=draft.folder.path, code=Code.WHO_IT_IS)
    if draft.choice is not None and draft.choice.proposal is not None:
        answered = replace(draft.choice.proposal, asked=frozenset())
        draft = replace(draft, choice=replace(draft.choice, proposal=answered))
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / STUDY
        written.write_text(format_draft(draft, None), encoding="utf-8")
        file = study_file.load_study_file(written)
    marker_set = read_marker_set(file, path, proposed=True)
    trials = tuple(
        study_trial.read_trial(trial, file.markers.rename, marker_set) for trial in file.trials
    )
    study = Study.assemble(file, marker_set, trials, path)
    # the study file itself is not among the inputs: it does not exist
    inputs = {name: sha256 for name, sha256 in study.inputs.items() if name != STUDY}
    return replace(study, files=tuple(f for f in study.files if f != path), inputs=inputs)


LIKELY = "likely, please check: "
MOST_RENAMED = 12
"""Renamed labels that are printed."""


def describe_marker_set(draft: Draft) -> str:
    """Describe the marker set, how many labels it contains, and those it does not.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    str
        Empty without a set.
    """
    choice = draft.choice
    if choice is None:
        return ""
    if choice.proposal is not None:
        count = len(choice.proposal.rename) + sum(map(len, choice.proposal.tracking.values()))
        return (
            f"{LIKELY}no marker set contains the labels; proposed for {count} markers: "
            f"{choice.proposal.basis}"
        )
    found = choice.coverage
    known = f"contains {found.known} of {found.known + len(found.left_over)} labels"
    pairs = [f"{old} = {new}" for old, new in sorted(choice.rename.items())]
    more = f" and {len(pairs) - MOST_RENAMED} more" if len(pairs) > MOST_RENAMED else ""
    known += f"; renamed: {', '.join(pairs[:MOST_RENAMED])}{more}" if pairs else ""
    if choice.centres:
        known += f"; joint centres, not markers: {', '.join(choice.centres)}"
    return (
        f"{'' if choice.certain else LIKELY}marker set: {choice.entry}, "
        f"{known}{_describe_left_over(choice)}"
    )


def list_uncertain_choices(draft: Draft) -> tuple[str, ...]:
    """List what is only likely, and which files are not used.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    tuple of str
        One line each.
    """
    out = []
    for trial in draft.trials:
        role = f"{trial.role} {trial.joint}".strip()
        if not trial.certain:
            out.append(f"{LIKELY}{trial.name} as {role}: {trial.reason}")
        if trial.forces is not None and not trial.forces.certain:
            out.append(
                f"{LIKELY}{trial.forces.file.name} as forces of {trial.name}: {trial.forces.reason}"
            )
    for field, known in draft.person.items():
        if field != "name" and not known.certain:
            out.append(f"{LIKELY}{_format_assignment(field, known.value)}: {known.reason}")
    if "sex" not in draft.person and not draft.missing:
        out.append(
            f"{LIKELY}sex: not given in any file; masses are the mean of women's and men's tables "
            "(give it with --sex)"
        )
    if "age_years" not in draft.person and not draft.missing:
        out.append(
            "age: not given in any file; no normative data, and masses of adults (give it with "
            "--age YEARS)"
        )
    if draft.choice is not None and draft.choice.further_markers is not None:
        out += _list_further_markers(draft.choice.further_markers)
    return (*out, *(f"not used: {row.name}: {row.reason or row.kind}" for row in draft.left_out))


def _list_further_markers(further: "LabelProposal") -> list[str]:
    """List the unknown markers that are assigned to segments, and those that are not used."""
    out = []
    if further.tracking:
        groups = "; ".join(
            f"{', '.join(group)} with {segment}" for segment, group in further.tracking.items()
        )
        out.append(f"{LIKELY}unknown markers are assigned to segments by their movement: {groups}")
    if further.unused:
        by_reason: dict[str, list[str]] = {}
        for label, why in further.unused.items():
            by_reason.setdefault(why, []).append(label)
        groups = "; ".join(f"{', '.join(group)} ({why})" for why, group in by_reason.items())
        out.append(f"labels not used: {groups}")
    return out


def list_draft_notes(draft: Draft) -> tuple[str, ...]:
    """List how the study was drafted, as notes of a result.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    tuple of str
    """
    lines = (line for line in (describe_marker_set(draft), *list_uncertain_choices(draft)) if line)
    return tuple(f"Drafted from the folder: {line}" for line in lines)


def find_study_in_folder(folder: Folder) -> Path | None:
    """Find the study file in a folder.

    Parameters
    ----------
    folder
        As it was read.

    Returns
    -------
    Path or None
        None without one.

    Raises
    ------
    InputError
        There are several.
    """
    found = [f.path for f in folder.files if f.kind is FileKind.STUDY or f.name == STUDY]
    if len(found) > 1:
        names = ", ".join(p.name for p in found)
        message = f"{len(found)} study files in the folder: {names}; give one of them instead"
        raise InputError(message, source=folder.path, code=Code.FOLDER)
    return found[0] if found else None


def list_study_files(folder: Path) -> tuple[Path, ...]:
    """List the study files in a folder without reading its recordings.

    Parameters
    ----------
    folder
        Its path.

    Returns
    -------
    tuple of Path
    """
    return tuple(
        p
        for p in sorted(folder.iterdir())
        if p.suffix.lower() == ".toml" and p.is_file() and _is_study(p)
    )


def _is_study(path: Path) -> bool:
    """Return whether a visible TOML file is a study."""
    if path.name[0] in ".~":
        return False
    try:
        return path.name == STUDY or is_study(read_toml(path))
    except InputError:
        return False


def list_files(draft: Draft) -> tuple[Path, ...]:
    """List the files that a drafted study reads.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    tuple of Path
    """
    marker_sets = []
    if draft.choice and draft.choice.entry.endswith(".toml"):
        marker_sets = [Path(draft.choice.entry)]
    forces = [trial.forces.file.path for trial in draft.trials if trial.forces]
    return (*(trial.file.path for trial in draft.trials), *forces, *marker_sets)


def find_study_source(path: Path, person: Options) -> Path | Folder:
    """Find the study file of a path; without one read the folder.

    Parameters
    ----------
    path
        Of a study file or a folder.
    person
        Options about the subject.

    Returns
    -------
    Path or Folder

    Raises
    ------
    UsageError
        Options about the subject are given although there is a study file.
    InputError
        The folder has several study files.
    """
    study = path
    if path.is_dir():
        folder = read_folder(path)
        in_folder = find_study_in_folder(folder)
        if in_folder is None:
            return folder
        study = in_folder
    if person != NO_OPTIONS:
        message = "mass, height, sex and age are for folders without a study file; write them there"
        raise UsageError(message, source=study)
    return study


def require_runnable(draft: Draft, source: Path) -> None:
    """Raise an error if a drafted study cannot be run.

    Parameters
    ----------
    draft
        Of a folder.
    source
        The folder.

    Raises
    ------
    InputError
        For the first reason.
    """
    if draft.fault:
        raise InputError(draft.fault, source=source, code=Code.FOLDER)
    if message := _describe_unconfirmed_labels(draft):
        raise InputError(message, source=source, code=Code.UNKNOWN_LABEL)
    if draft.problem:
        raise InputError(draft.problem, source=source, code=Code.FOLDER)
    if draft.missing:
        message = f"{describe_missing_fields(draft)}: give {list_missing_options(draft)}"
        raise InputError(message, source=source, code=Code.WHO_IT_IS)
