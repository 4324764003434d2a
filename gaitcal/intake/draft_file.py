"""A drafted study: what each file of a folder is taken for, the trials, the person, what is
missing, and its text.

Every file of the folder is a row of `Draft.seen`, with what it is used as or why it is not. In the
text every line has its reason: `sure` where a file or the user says so, or figures are far from
every limit; `likely` by figures near one. What nobody says stands as a comment that names the
field, so that reading the study ends with its name.
"""

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gaitcal.errors import Code, InputError, UsageError, alike
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
"""Fields of the person without which nothing can be calibrated, and the options that give them."""


@dataclass(frozen=True, kw_only=True)
class FileRow:
    """One file of the folder, as it was understood."""

    name: str
    kind: str
    frames: int | None = None
    labels: str = ""  # How many of its labels the marker set knows
    shows: str = ""
    used: str = ""  # As what; empty: not at all
    reason: str = ""  # Why it is used so, or why it is not used


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
    """A folder as it was understood, and the study that follows."""

    folder: Folder
    choice: choose_marker_set.SetChoice | None  # None: no marker set explains the labels
    person: Mapping[str, subject_metadata.KnownField]
    trials: tuple[DraftedTrial, ...]
    rows: tuple[FileRow, ...]
    fault: str = ""  # Why no study follows from the folder; empty where one does
    has_other_people: bool = (
        False  # Whether recordings of the same labels show another person, or another session
    )
    problem: str = ""  # Why the drafted study cannot be run as it is, apart from what is missing

    doubts: tuple[
        str, ...
    ] = ()  # What files say of the person that can be in no unit it should be in

    @property
    def moves(self) -> bool:
        """Whether a trial shows more than standing."""
        return any(trial.role != "static" for trial in self.trials)

    @property
    def missing(self) -> tuple[str, ...]:
        """Fields of the person that nobody tells, and that are needed."""
        return tuple(name for name in NEEDED if name not in self.person)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Fields of the person that nobody tells, and that do without, at the price of wider
        errors.
        """
        height = ("height_m",) if "height_error_m" in self.person else ()
        return (*height, *(() if "sex" in self.person else ("sex",)))

    @property
    def left_out(self) -> tuple[FileRow, ...]:
        """Files that are not used."""
        return tuple(row for row in self.rows if not row.used)

    def drop_trials(self, trials: Mapping[str, str]) -> "Draft":
        """The draft without these trials, name -> why."""
        out = {trial.file.name: trials[trial.name] for trial in self.trials if trial.name in trials}
        return replace(
            self,
            trials=tuple(trial for trial in self.trials if trial.name not in trials),
            rows=tuple(
                replace(row, used="", reason=out[row.name]) if row.name in out else row
                for row in self.rows
            ),
        )


FIRST_LABELS = 8  # Shown of a recording that no marker set explains


def build_row(
    file: FolderFile, *, labels: str = "", shows: str = "", used: str = "", reason: str = ""
) -> FileRow:
    """A file as it was read, and what became of it."""
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
WIDEST = 70  # Characters of a line up to which its comment stands beside it; else above
MISSING = {"mass_kg": "body mass in kg", "height_m": "body height in m"}
"""What is to be written where nobody says it; no value that could be taken over without a thought.
"""


def format_draft(draft: Draft, folder: Path | None) -> str:
    """The study as the text of a study file, paths relative to `folder`; absolute with None."""
    lines = [
        f"# Drafted from the folder '{draft.folder.name}'. Each line says what told it; look at "
        "what is 'likely'.",
        "",
        *_format_subject(draft),
        *_format_markers(draft, folder),
    ]
    for trial in draft.trials:
        lines += _format_trial(trial, folder)
    left = [
        row for row in draft.left_out if row.kind != FileKind.STUDY.value
    ]  # one of them is this text, later
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
    """What is said of how to calibrate, as the table of a study file in `folder`; empty where
    nothing is.
    """
    said = settings.model_dump(exclude_unset=True) | (
        {} if priors is None else {"priors": _make_relative(priors, folder)}
    )
    return "\n" + format_toml_table("[calibration]", said) if said else ""


def _format_subject(draft: Draft) -> list[str]:
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
            write = f"write {MISSING[field]}, and take the first # away"
            lines.append(f"# {field} =   # MISSING: {_get_file_subject(draft)} says it; {write}")
    for field in (
        "knee_width_mm",
        "ankle_width_mm",
        "leg_length_mm",
        "asis_distance_mm",
        "marker_diameter_mm",
    ):
        if (known := draft.person.get(field)) is not None:
            lines += _format_line(field, known.value, known.reason, known.certain)
    if "sex" not in draft.person:
        lines.append(
            '# sex = "female"   # no file says it; without it the mean of both tables counts, with '
            "its error"
        )
    if "age_years" not in draft.person:
        lines.append(
            "# age_years =   # no file says it; tables of masses and norms of gait go by it"
        )
    if "session_date" not in draft.person:
        lines.append(
            '# session_date = "YYYY-MM-DD"   # no file says it; with birth_date it gives the age'
        )
    lines.append(
        "# For reports and tables, where wanted: birth_date, diagnosis, affected_side, aids, "
        "laboratory"
    )
    return [*lines, ""]


def _format_markers(draft: Draft, folder: Path | None) -> list[str]:
    choice = draft.choice
    if choice is None:
        raise InputError(draft.fault, source=draft.folder.path, code=Code.FOLDER)
    found = choice.coverage
    reason = (
        f"knows {found.known} of {found.known + len(found.left_over)} labels of "
        f"{len(choice.members)} files"
    )
    reason += describe_left_over(choice)
    if choice.clashes:
        reason += f"; not renamed, as the name is taken: {', '.join(choice.clashes[:4])}"
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
                f"; or lie outwards of joint centres, which these name: {', '.join(choice.centres)}"
            )
        lines += _format_line("rename", dict(sorted(choice.rename.items())), reason, False)
    if found.missing:
        lines.append(f"# No marker of the files gives: {', '.join(found.missing)}")
    if choice.further_markers is not None:
        lines += _format_followers(choice.further_markers)
    return [*lines, ""]


def _format_proposal(proposal: "LabelProposal") -> list[str]:
    """What labels mean that say nothing, each with its evidence, to be confirmed; what is asked is
    a comment.
    """
    lines = [
        "[markers]",
        f"# likely: no marker set knows the labels; {proposal.basis}",
        'set = "landmarks"',
        "# MISSING: a person's look at each line of rename and tracking; then write true",
        "confirmed = false",
        "[markers.rename]  # label in the files = what the marker lies on",
    ]
    for label, name in sorted(proposal.rename.items(), key=lambda item: item[1]):
        line = f"{format_toml_value({label: name})[1:-1].strip()}  # {proposal.evidence[label]}"
        question = (
            "; ASKED: is it? Then take the first # away; else name its segment under "
            "markers.tracking"
        )
        lines.append(f"# {line}{question}" if label in proposal.asked else line)
    return lines + _format_followers(proposal)


def _format_followers(proposal: "LabelProposal") -> list[str]:
    """Markers that move with segments, each with its evidence, and labels that are nowhere."""
    lines = (
        ["[markers.tracking]  # segment = further markers that move with it"]
        if proposal.tracking
        else []
    )
    for segment, labels in proposal.tracking.items():
        lines.append(f"{segment} = [")
        lines += [
            f"    {format_toml_value(label)},  # {proposal.evidence[label]}" for label in labels
        ]
        lines.append("]")
    if proposal.weights:
        lines.append(
            "[markers.weights]  # 0: shown only; the neck moves the head, the toes bend, skin "
            "glides over knees"
        )
        lines += [
            f"{format_toml_value({label: weight})[1:-1].strip()}"
            for label, weight in proposal.weights.items()
        ]
    return lines + [
        f"# not used: {_join_lines(label)}: {why}" for label, why in proposal.unused.items()
    ]


def describe_left_over(choice: choose_marker_set.SetChoice) -> str:
    """`; left over: ...`, and which labels of the set they look like; empty where the set knows all
    labels.
    """
    left = choice.coverage.left_over
    if not left:
        return ""
    more = f" and {len(left) - 8} more" if len(left) > 8 else ""
    meant = {label: alike(label, choice.marker_set.labels) for label in left[:8]}
    hints = ", ".join(f"{label} like {like[0]}" for label, like in meant.items() if like)
    return f"; left over: {', '.join(left[:8])}{more}" + (
        f" ({hints}: rename them if they are)" if hints else ""
    )


def _format_trial(trial: DraftedTrial, folder: Path | None) -> list[str]:
    lines = ["[[trial]]", f"name = {format_toml_value(trial.name)}  # after the file"]
    lines += _format_line("role", trial.role, trial.reason, trial.certain)
    if trial.joint:
        lines.append(
            f"joint = {format_toml_value(trial.joint)}  # the one that turns most, see role"
        )
    recording = trial.file.recording
    frames = "" if recording is None else f"{len(recording.time)} frames at {recording.rate:.4g} Hz"
    plates = 0 if recording is None else len(recording.plates)
    if trial.role in ("gait", "motion"):
        frames += (
            f", {plates} plates of its own"
            if plates
            else ""
            if trial.forces
            else ", no forces: angles, no torques"
        )
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
    """`field = value  # sure: reason`, the comment above where the line would be long."""
    comment = f"# {'sure' if certain else 'likely'}: {_join_lines(reason)}"
    text = _format_assignment(field, value)
    return [f"{text}  {comment}"] if len(text) <= WIDEST else [comment, text]


def _format_assignment(field: str, value: object) -> str:
    if isinstance(value, Mapping) and set(value) <= set(SIDES):
        return f"{field} = {{ {', '.join(f'{side} = {v:g}' for side, v in value.items())} }}"
    return f"{field} = {format_toml_value(value)}"


def _join_lines(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _make_relative(path: Path, folder: Path | None) -> Path:
    whole = path.parent.resolve() / path.name
    if folder is None:
        return whole
    try:
        return Path(os.path.relpath(whole, folder.resolve()))
    except ValueError:  # another drive
        return whole


def describe_missing_fields(draft: Draft) -> str:
    """What nobody tells."""
    doubts = f" ({'; '.join(draft.doubts[:2])})" if draft.doubts else ""
    return (
        f"{_get_file_subject(draft)} says "
        + ", ".join(f"subject.{field}" for field in draft.missing)
        + doubts
    )


def _get_file_subject(draft: Draft) -> str:
    """Who says nothing; a file of another person may say something."""
    return "no file that is used" if draft.has_other_people else "no file"


def list_missing_options(draft: Draft) -> str:
    """The options that tell it."""
    return " ".join(NEEDED[field] for field in draft.missing)


def describe_unconfirmed_labels(draft: Draft) -> str:
    """That labels mean only what was proposed, and what to do; empty where they are names."""
    if draft.choice is None or draft.choice.proposal is None:
        return ""
    labels = list(draft.choice.proposal.evidence)
    shown = ", ".join(labels[:4]) + (", ..." if len(labels) > 4 else "")
    return (
        f"no marker set knows the labels {shown}; what each marker is can be proposed, and has to "
        "be confirmed: "
        f"'gaitcal init {draft.folder.path}' writes the proposal"
    )


def build_study(draft: Draft, *, proposed: bool = False) -> Study:
    """The drafted study with its recordings, without a study file on disk; `proposed`: also where
    what the labels mean is proposed only.

    Raises InputError: No study follows from the folder; something is missing; or as of
    `Study.load`.
    """
    path = draft.folder.path / STUDY
    if draft.fault:
        raise InputError(draft.fault, source=draft.folder.path, code=Code.FOLDER)
    if not proposed and (words := describe_unconfirmed_labels(draft)):
        raise InputError(words, source=draft.folder.path, code=Code.UNKNOWN_LABEL)
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
    inputs = {
        name: sha256 for name, sha256 in study.inputs.items() if name != STUDY
    }  # there is no such file
    return replace(study, files=tuple(f for f in study.files if f != path), inputs=inputs)


LIKELY = "likely, to be looked at: "
MOST_RENAMED = 12  # Labels that are printed


def describe_marker_set(draft: Draft) -> str:
    """The marker set, how many labels it knows, and those it does not; empty without a set."""
    choice = draft.choice
    if choice is None:
        return ""
    if choice.proposal is not None:
        of = len(choice.proposal.rename) + sum(map(len, choice.proposal.tracking.values()))
        return (
            f"{LIKELY}no marker set knows the labels; proposed for {of} markers: "
            f"{choice.proposal.basis}"
        )
    found = choice.coverage
    known = f"knows {found.known} of {found.known + len(found.left_over)} labels"
    pairs = [f"{old} = {new}" for old, new in sorted(choice.rename.items())]
    more = f" and {len(pairs) - MOST_RENAMED} more" if len(pairs) > MOST_RENAMED else ""
    known += f"; renamed: {', '.join(pairs[:MOST_RENAMED])}{more}" if pairs else ""
    if choice.centres:
        known += f"; joint centres, not markers: {', '.join(choice.centres)}"
    return (
        f"{'' if choice.certain else LIKELY}marker set: {choice.entry}, "
        f"{known}{describe_left_over(choice)}"
    )


def list_uncertain_choices(draft: Draft) -> tuple[str, ...]:
    """What is likely only, and which files are not used."""
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
            "(--sex gives it)"
        )
    if "age_years" not in draft.person and not draft.missing:
        out.append(
            "age: not given in any file; no norms of gait, and masses of adults (--age YEARS gives it)"
        )
    further = None if draft.choice is None else draft.choice.further_markers
    if further is not None and further.tracking:
        words = "; ".join(
            f"{', '.join(group)} with {segment}" for segment, group in further.tracking.items()
        )
        out.append(
            f"{LIKELY}markers that the set does not know follow what they move with: {words}"
        )
    if further is not None and further.unused:
        by_reason: dict[str, list[str]] = {}
        for label, why in further.unused.items():
            by_reason.setdefault(why, []).append(label)
        out.append(
            "labels not used: "
            + "; ".join(f"{', '.join(group)} ({why})" for why, group in by_reason.items())
        )
    return (*out, *(f"not used: {row.name}: {row.reason or row.kind}" for row in draft.left_out))


def list_draft_notes(draft: Draft) -> tuple[str, ...]:
    """How the study was drafted, as notes of a result."""
    told = (line for line in (describe_marker_set(draft), *list_uncertain_choices(draft)) if line)
    return tuple(f"Drafted from the folder: {line}" for line in told)


def find_study_in_folder(folder: Folder) -> Path | None:
    """The study file that lies in a folder; None where none does. InputError for several."""
    own = [f.path for f in folder.files if f.kind is FileKind.STUDY or f.name == STUDY]
    if len(own) > 1:
        names = ", ".join(p.name for p in own)
        message = f"holds {len(own)} study files: {names}; name one of them instead of the folder"
        raise InputError(message, source=folder.path, code=Code.FOLDER)
    return own[0] if own else None


def list_study_files(folder: Path) -> tuple[Path, ...]:
    """The study files in a folder, found without reading its recordings."""
    return tuple(
        p
        for p in sorted(folder.iterdir())
        if p.suffix.lower() == ".toml" and p.is_file() and _is_study(p)
    )


def _is_study(path: Path) -> bool:
    if path.name[0] in ".~":
        return False
    try:
        return path.name == STUDY or is_study(read_toml(path))
    except InputError:
        return False


def list_files(draft: Draft) -> tuple[Path, ...]:
    """The files that a drafted study reads."""
    own = (
        [Path(draft.choice.entry)] if draft.choice and draft.choice.entry.endswith(".toml") else []
    )
    forces = [trial.forces.file.path for trial in draft.trials if trial.forces]
    return (*(trial.file.path for trial in draft.trials), *forces, *own)


def find_study_source(path: Path, person: Options) -> Path | Folder:
    """Find the study file of a path, the file itself or the one in the folder; without one read the
    folder.

    Raises
    ------
    UsageError
        Mass, height, sex or age are given beside a study file, which has them.
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
    """Raise InputError for the first thing that keeps a drafted study from being run."""
    if draft.fault:
        raise InputError(draft.fault, source=source, code=Code.FOLDER)
    if message := describe_unconfirmed_labels(draft):
        raise InputError(message, source=source, code=Code.UNKNOWN_LABEL)
    if draft.problem:
        raise InputError(draft.problem, source=source, code=Code.FOLDER)
    if draft.missing:
        message = f"{describe_missing_fields(draft)}: give {list_missing_options(draft)}"
        raise InputError(message, source=source, code=Code.WHO_IT_IS)
