"""Read and check a study: subject, marker set, trials and settings of one calibration."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gaitcal.display import Displayed, shorten
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.io.csv_recordings import find_event_tables
from gaitcal.io.labels import GREATEST_AGE, Facts, compute_age
from gaitcal.io.opensim_files import find_loads_tables
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.io.result_folder import compute_sha256
from gaitcal.io.snapshot import Snapshot
from gaitcal.model import body_plan, landmarks
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import PatientRecord, Subject
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.cohort_prior import (
    CohortPriors,
    Person,
    hash_name,
    predict_prior,
    read_cohort_priors,
    require_joint_prior,
)
from gaitcal.study.declared_truth import (
    Truth,
    describe_landmark_mismatch,
    list_truth_files,
    read_truth,
)
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.study.study_file import StudyFile, SubjectTable, load_study_file
from gaitcal.study.study_trial import Role, Trial, read_trial

AGE_TOLERANCE_YEARS = 1.0
"""Years, from which an age and the dates contradict each other."""


def _add_height(
    table: SubjectTable, marker_set: MarkerSet, recordings: Sequence[Recording], path: Path
) -> tuple[SubjectTable, str]:
    """Add a height to the subject, with a note if neither the study nor a file gives one.

    It is then the mean of people with legs of that length, with their standard deviation.
    """
    declared = table.height_m or next(
        (f.height for f in _collect_facts(recordings) if f.height), None
    )
    if declared is not None:
        return table.model_copy(update={"height_m": declared}), ""
    fault = InputError(
        "missing, and the markers do not show it; give [subject] height_m",
        source=path,
        field="subject.height_m",
        code=Code.MISSING_FIELD,
    )
    try:
        standing = find_still_window(recordings[0], marker_set.labels).frames
        estimate = body_plan.estimate_height(
            landmarks.measure_static_posture(recordings[0], marker_set, standing).landmarks
        )
    except InputError as cause:
        raise fault from cause
    if estimate is None:
        raise fault
    height, error = round(estimate[0], 2), round(estimate[1], 3)
    note = f"height not given: {height:g} m, SD {error:g} m, estimated from the length of the legs"
    return table.model_copy(update={"height_m": height, "height_error_m": error}), note


def build_subject(table: SubjectTable, recordings: Sequence[Recording]) -> Subject:
    """Build the subject from the study file; missing values are those of the recordings.

    The first recording that has a value precedes others. Files that name another person than the
    first recording are not used.

    `table`: table `[subject]`, with a height. Returns: SI units.
    """
    facts = _collect_facts(recordings)
    knees, ankles, legs = dict[str, float](), dict[str, float](), dict[str, float]()
    for one in reversed(facts):
        knees |= one.knee_width
        ankles |= one.ankle_width
        legs |= one.leg_length
    asis = next((f.asis_distance for f in facts if f.asis_distance), None)
    diameter = next((f.marker_diameter for f in facts if f.marker_diameter), None)
    return Subject(
        table.name,
        table.mass_kg,
        table.height_m or 0.0,
        table.sex or "",
        height_error=table.height_error_m,
        age=_determine_age(table, facts)[0],
        knee_width=knees | {side: 1e-3 * width for side, width in table.knee_width_mm.items()},
        ankle_width=ankles | {side: 1e-3 * width for side, width in table.ankle_width_mm.items()},
        leg_length=legs | {side: 1e-3 * length for side, length in table.leg_length_mm.items()},
        asis_distance=asis if table.asis_distance_mm is None else 1e-3 * table.asis_distance_mm,
        marker_diameter=diameter
        if table.marker_diameter_mm is None
        else 1e-3 * table.marker_diameter_mm,
        session=table.session,
        record=_build_record(table, facts),
    )


def _collect_facts(recordings: Sequence[Recording]) -> list[Facts]:
    return [r.facts for r in recordings if r.facts.name == recordings[0].facts.name]


def _build_record(table: SubjectTable, facts: Sequence[Facts]) -> PatientRecord:
    """Build the patient record; the date of birth is only that of the study file."""
    declared = table.model_dump(include=set(vars(PatientRecord())), exclude_none=True)
    return PatientRecord(**{"session_date": _find_session_date(table, facts), **declared})


def _find_session_date(table: SubjectTable, facts: Sequence[Facts]) -> str:
    return table.session_date or next((f.session_date for f in facts if f.session_date), "")


def _determine_age(table: SubjectTable, facts: Sequence[Facts]) -> tuple[float | None, str]:
    """Determine the age (years) from the study or the dates, and a note on contradicting dates.

    Dates of files give tenths of a year, so that no birthday is disclosed. An impossible age from
    dates of files is not used; contradicting dates of the study raise InputError.
    """
    declared, then = table.age_years, _find_session_date(table, facts)
    age = compute_age(
        table.birth_date or next((f.birth_date for f in facts if f.birth_date), None), then
    )
    if age is None:
        return declared, ""
    agrees = declared is None or abs(declared - age) <= AGE_TOLERANCE_YEARS
    if table.birth_date and table.session_date:
        if age < 0.0 or not agrees:
            detail = (
                "" if age < 0.0 else f" and age_years = {declared:g}, which they make {age:.2f}"
            )
            message = (
                f"found {table.birth_date} before session_date = {then}{detail}; allowed: dates "
                "that agree"
            )
            raise InputError(message, field="subject.birth_date", code=Code.BAD_VALUE)
    elif not (agrees and 0.0 <= age <= GREATEST_AGE):
        counts = "no age is known" if declared is None else f"age_years = {declared:g} counts"
        return (
            declared,
            f"dates of birth and session, as files have them, make an age of {age:.1f} years: "
            f"{counts}",
        )
    return (round(age, 2 if table.birth_date else 1) if declared is None else declared), ""


@dataclass(frozen=True, kw_only=True, repr=False)
class Study(Displayed):
    """Subject, marker set, trials and settings of one calibration."""

    subject: Subject
    """The person."""
    marker_set: MarkerSet
    """Meaning of the labels: landmarks and segments."""
    trials: tuple[Trial, ...]
    """The static trials and all others, in the order of the study file."""
    settings: CalibrationSettings
    """Table `[calibration]` of the study file with defaults; `priors` by its name alone."""
    weights: Mapping[str, float]
    """Marker label -> weight, where the study overrides the marker set."""
    inputs: Mapping[str, str]
    """File -> SHA-256 of every input."""
    source: str = "study"
    """The study file, for messages."""
    files: tuple[Path, ...] = ()
    """Paths of every input; a result must not replace them."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Label in the files -> label in the marker set."""
    truth: Truth | None = None
    """Known truth of a synthetic subject, if the study file names it (`[truth]`)."""
    joint_prior: JointPrior | None = None
    """Prior of the joint parameters from a cohort (`priors.json`), if there is one."""
    loosened: Mapping[str, float] = field(default_factory=dict)
    """Joint parameter -> m, rad of further error, after a displaced cluster of its segment was
    restored.
    """

    @classmethod
    @with_one_blas_thread
    def load(cls, path: Path | str) -> "Study":
        """Read a study file and all its recordings.

        Parameters
        ----------
        path
            The file `study.toml`.

        Returns
        -------
        Study
            The study as declared; trials are not cleaned.

        Raises
        ------
        InputError
            One line: file, field, value found, allowed values.
        """
        path = Path(path)
        of_study = compute_sha256(path)
        file = load_study_file(path)
        # Hashes before and after reading: a file that changed meanwhile would be recorded wrongly.
        before = {f: compute_sha256(f) for f in list_input_files(file, path)} | {path: of_study}
        marker_set = read_marker_set(file, path)
        trials = tuple(read_trial(trial, file.markers.rename, marker_set) for trial in file.trials)
        study = cls.assemble(file, marker_set, trials, path)
        for name, f in study._named_files.items():
            if study.inputs[name] != before[f]:
                message = f"'{name}' changed while the study was read; run again"
                raise InputError(message, source=path, code=Code.CHANGED_FILE)
        return study

    @classmethod
    @with_one_blas_thread
    def assemble(
        cls, file: StudyFile, marker_set: MarkerSet, trials: tuple[Trial, ...], path: Path
    ) -> "Study":
        """Assemble a study from its file and its trials.

        Parameters
        ----------
        file
            Content of the study file.
        marker_set
            Its marker set.
        trials
            Trials from `read_trial`.
        path
            Path of the study file.

        Returns
        -------
        Study
            The study.

        Raises
        ------
        InputError
            The file names labels that no trial has, or values that contradict each other.
        """
        files = list_input_files(file, path)
        # Contradictions within the study file are reported before any computation.
        _require_labels(file, marker_set, trials, path)
        require_joint_prior(file.calibration, path)
        marker_set, trials = _adapt_marker_set(marker_set, trials)
        # The static trial first: its subject data take precedence over those of walks.
        recordings = [t.recording for t in sorted(trials, key=lambda t: t.role is not Role.STATIC)]
        person, height = _add_height(file.subject, marker_set, recordings, path)
        if notes := [
            note for note in (_determine_age(person, _collect_facts(recordings))[1], height) if note
        ]:
            first = recordings[0].with_notes(*notes)
            trials = tuple(
                replace(t, recording=first) if t.recording is recordings[0] else t for t in trials
            )
        study = cls(
            subject=build_subject(person, recordings),
            marker_set=marker_set,
            trials=trials,
            settings=file.calibration,
            weights=dict(file.markers.weights),
            inputs={
                name: compute_sha256(f) or "" for name, f in _name_files(files, path.parent).items()
            },
            source=str(path),
            files=files,
            rename=dict(file.markers.rename),
            truth=read_truth(
                file.truth,
                file.calibration,
                marker_set.name,
                [trial.name for trial in trials],
                path,
            ),
        )
        # The truth refers to the landmarks of one static trial.
        if (other := study.other_truth()) is not None:
            message = f"{other}; allowed: the same, or no [truth]"
            raise InputError(message, source=path, field="truth.landmarks", code=Code.TRUTH)
        return (
            study
            if file.calibration.priors is None
            else add_cohort_priors(study, file.calibration.priors)
        )

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        person, sex = self.subject, self.subject.sex or "sex not given"
        age = "" if person.age is None else f", {person.age:g} years"
        names = [f"{t.name} ({t.joint or t.role.value})" for t in self.trials]
        frames = sum(len(t.recording.time) for t in self.trials)
        rows = [
            ("subject", f"{person.name}: {sex}, {person.mass:.1f} kg, {person.height:.2f} m{age}"),
            (
                "marker set",
                f"{self.marker_set.name}, {len(self.marker_set.tracked)} tracked markers",
            ),
            ("trials", f"{len(names)}, {frames} frames: {shorten(names, 10)}"),
        ]
        return f"Study {Path(self.source).name}", rows

    def other_truth(self) -> str | None:
        """Describe why the truth belongs to another static trial; None if it agrees or there is
        none.
        """
        if self.truth is None or not any(trial.role is Role.STATIC for trial in self.trials):
            return None
        return describe_landmark_mismatch(
            self.truth.landmarks, self.static.recording, self.marker_set
        )

    @property
    def hip_centre(self) -> HipCentre:
        """Rule of the hip centres; with `auto`, segment poses give them."""
        if (
            self.settings.hip_centre == AUTOMATIC
            and self.marker_set.noise
            and "hjc_r" in self.marker_set.landmarks
        ):
            return HipCentre.GIVEN
        return HipCentre(self.settings.hip_rule)

    @property
    def static(self) -> Trial:
        """Static trial of which the model is made: the first."""
        return next(trial for trial in self.trials if trial.role is Role.STATIC)

    @property
    def further_statics(self) -> tuple[Trial, ...]:
        """Static trials that only have to agree with the first."""
        return tuple(trial for trial in self.trials if trial.role is Role.STATIC)[1:]

    @property
    def moving(self) -> tuple[Trial, ...]:
        """All trials in which the person moves."""
        return tuple(trial for trial in self.trials if trial.role is not Role.STATIC)

    @property
    def walks(self) -> tuple[str, ...]:
        """Names of the trials of the whole body: walks and other activities."""
        return tuple(trial.name for trial in self.moving if trial.role is not Role.JOINT)

    @property
    def _named_files(self) -> dict[str, Path]:
        return _name_files(self.files, Path(self.source).parent)

    @property
    def as_read(self) -> Snapshot:
        """Hashes of the inputs at the time they were read."""
        hashes = {str(f.resolve()): self.inputs[name] for name, f in self._named_files.items()}
        return Snapshot(Path(self.source).parent, hashes)

    def with_input(self, path: Path, sha256: str) -> "Study":
        """Return the study with one more input file, unless it is already one.

        Parameters
        ----------
        path
            The file.
        sha256
            Its SHA-256, hexadecimal.

        Returns
        -------
        Study
            The study with this input.
        """
        if path in self.files:
            return self
        more = replace(self, files=(*self.files, path))
        names = [name for name, f in more._named_files.items() if f == path]
        return replace(more, inputs={**self.inputs, **dict.fromkeys(names, sha256)})

    def input_names(self, trial: Trial) -> dict[str, str]:
        """Return the files of a trial (`file`, `forces`) by their names in `inputs`."""
        names = {f: name for name, f in self._named_files.items()}
        return {kind: names[f] for kind, f in trial.files.items() if f in names}

    def changed_inputs(self) -> tuple[str, ...]:
        """Find inputs that have changed since they were read, by their names in `inputs`."""
        return tuple(
            name
            for name, f in self._named_files.items()
            if self.inputs.get(name) != compute_sha256(f)
        )


def _adapt_marker_set(
    marker_set: MarkerSet, trials: tuple[Trial, ...]
) -> tuple[MarkerSet, tuple[Trial, ...]]:
    """Adapt the marker set to the first static trial, and complete the static trials."""
    whole = tuple(
        replace(t, recording=complete_static(t.recording, marker_set))
        if t.role is Role.STATIC
        else t
        for t in trials
    )
    static = next((trial for trial in whole if trial.role is Role.STATIC), None)
    if static is None:
        return marker_set, whole
    # Alternatives are chosen by labels of the static trial, unless moving trials need another one.
    elsewhere = {label for trial in whole for label in trial.recording.labels}
    return resolve_marker_set(marker_set, static.recording, elsewhere), whole


def list_input_files(file: StudyFile, path: Path) -> tuple[Path, ...]:
    """List all input files of a study.

    Parameters
    ----------
    file
        Content of the study file.
    path
        Path of the study file.

    Returns
    -------
    tuple of Path
        Study file, recordings, forces, events, individual marker set, priors and truth.
    """
    forces = (
        f
        for trial in file.trials
        if trial.forces
        for f in (trial.forces, *find_loads_tables(trial.forces))
    )
    events = (table for trial in file.trials for table in find_event_tables(trial.file))
    marker_set = [file.markers.set_path] if file.markers.set_path else []
    priors = [file.calibration.priors] if file.calibration.priors else []
    truth = list_truth_files(file.truth, [trial.name for trial in file.trials])
    return (
        path,
        *(trial.file for trial in file.trials),
        *forces,
        *events,
        *marker_set,
        *priors,
        *truth,
    )


def _name_files(files: Iterable[Path], folder: Path) -> dict[str, Path]:
    """Name files for the manifest: relative to the study's folder, or by file name elsewhere.

    If two files elsewhere have one name, the second has as much of its path as is needed. More of a
    path does not belong in a result that may be shared.
    """
    out: dict[str, Path] = {}
    for file in dict.fromkeys(files):
        whole = file.resolve()
        try:
            name = whole.relative_to(folder.resolve()).as_posix()
        except ValueError:
            # The shortest end of the path that no other file has.
            names = ("/".join(whole.parts[-k:]) for k in range(1, len(whole.parts) + 1))
            name = next((n for n in names if n not in out), str(whole))
        out.setdefault(name, file)
    return out


def read_marker_set(file: StudyFile, path: Path, *, proposed: bool = False) -> MarkerSet:
    """Read the marker set of a study file with its further markers.

    Parameters
    ----------
    file
        Content of the study file.
    path
        Path of the study file.
    proposed
        Whether proposed labels that nobody confirmed are accepted.

    Returns
    -------
    MarkerSet
        The marker set.

    Raises
    ------
    InputError
        Labels are not confirmed, or the marker set cannot be read.
    """
    if not (file.markers.confirmed or proposed):
        raise InputError(
            "found false: what the labels mean was proposed by places and movement; look through "
            "[markers.rename] and "
            "[markers.tracking], put right what is wrong, and write confirmed = true",
            source=path,
            field="markers.confirmed",
            code=Code.UNKNOWN_LABEL,
        )
    return load_marker_set(file.markers.set).with_further(file.markers.tracking, path)


def _require_labels(
    file: StudyFile, marker_set: MarkerSet, trials: Sequence[Trial], path: Path
) -> None:
    """Require weights of labels in the set, and renamed labels in the trials; else InputError."""

    def fault(message: str, field: str) -> InputError:
        return InputError(message, source=path, field=f"markers.{field}", code=Code.UNKNOWN_LABEL)

    # A misspelt label would otherwise be ignored in silence.
    known = set(marker_set.labels)
    for label in file.markers.weights:
        if label not in known:
            message = (
                f"found a weight for '{label}', which the marker set does not "
                f"know{suggest_name(label, known)}"
            )
            raise fault(message, "weights")
    present = {label for trial in trials for label in trial.file_labels}
    for old, new in file.markers.rename.items():
        if old not in present:
            raise fault(
                f"found '{old}' -> '{new}', but no trial has a marker "
                f"'{old}'{suggest_name(old, present)}",
                "rename",
            )


def add_cohort_priors(study: Study, path: Path) -> Study:
    """A study whose joint parameters lean on a cohort; the file counts among its inputs.

    Raises
    ------
    InputError
        The file holds no priors, or those of another marker set, nominal model or protocol.
    """
    sha256 = compute_sha256(path) or ""
    prior = replace(build_cohort_prior(read_cohort_priors(path), study, path), sha256=sha256)
    settings = study.settings.model_copy(update={"priors": Path(path.name)})
    return replace(study.with_input(path, sha256), settings=settings, joint_prior=prior)


def build_cohort_prior(priors: CohortPriors, study: Study, path: Path) -> JointPrior:
    """Build the prior of a study's subject from a cohort, without the fold of this person.

    `priors`: content of `priors.json`. `path`: its file, for messages. Returns: prior of the
    parameters that were learnt. Raises InputError: the priors are those of another marker set,
    nominal model or protocol.
    """
    settings, subject = study.settings, study.subject
    if not settings.takes_priors:
        message = "priors of a cohort need joint parameters fitted with protocol = 'evidence'"
        raise InputError(message, source=path, code=Code.PRIORS)
    # A cohort that measured nominal joints by other rules has another zero for its deviations.
    used = {
        "marker_set": study.marker_set.name,
        "hip_centre": settings.hip_rule,
        "ankle_zero": settings.ankle_rule,
    }
    for rule, value in used.items():
        if (learnt := getattr(priors, rule)) != value:
            message = (
                f"learnt with '{learnt}', and the study uses '{value}', whose nominal joints are "
                "others"
            )
            raise InputError(message, source=path, field=rule, code=Code.PRIORS)
    # A person of the cohort must not inform this person's prior if both are the same: the fold of
    # that person is left out, recognised by name or by identical recordings.
    name, recordings = hash_name(priors.cohort, subject.name), set(study.inputs.values())
    folds = (
        p.fold
        for p in priors.people
        if p.name_sha256 == name or recordings & set(p.recordings_sha256)
    )
    return predict_prior(
        priors, Person(height=subject.height, sex=subject.sex), path, next(folds, None)
    )
