"""Draft the study of a folder: marker set, session, roles, forces and subject.

If no study follows, the draft has the reason, in one line and for each file. Trials in which the
checks find an error are left out of a drafted study while others are sound.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import PurePath, PureWindowsPath

import numpy as np

from gaitcal.errors import Code, Finding, InputError, Severity
from gaitcal.intake import recordings_folder as folders
from gaitcal.intake.choose_marker_set import (
    MOST_MISSING,
    SetChoice,
    apply_renames,
    describe_unknown_labels,
    measure_label_coverage,
    rank_sets_of_recordings,
)
from gaitcal.intake.draft_file import FIRST_LABELS, Draft, DraftedTrial, FileRow, build_row
from gaitcal.intake.people_in_folder import Session, find_session, is_same_recording
from gaitcal.intake.subject_metadata import (
    Options,
    check_mass,
    collect_subject,
    list_doubtful_figures,
    weigh_standing,
    weigh_walking,
)
from gaitcal.intake.trial_movement import (
    MovementKind,
    RecordedMovement,
    check_units,
    classify_movement,
    detect_standing,
)
from gaitcal.io.labels import Facts
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import has_poses
from gaitcal.model import body_plan, linkage, nominal
from gaitcal.model.marker_set import SEGMENT_OF, MarkerSet, load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.quality.named_joint_centres import CENTRE, find_measured_markers
from gaitcal.study.study import Study


def _describe_several_people(
    files: Sequence[folders.FolderFile], people: Mapping[int, tuple[str, ...]]
) -> tuple[str, dict[str, str]]:
    """Describe that files contain the markers of several people.

    `people`: recording -> prefixes of its people. Returns: `message` in one line; `reasons` file ->
    its people.
    """
    reasons = {
        files[i].name: f"markers of {len(found)} people ({', '.join(found)})"
        for i, found in people.items()
    }
    name, reason = next(iter(reasons.items()))
    more = f", and in {len(reasons) - 1} more files" if len(reasons) > 1 else ""
    message = (
        f"{reason} in one file, {name}{more}: write the markers of each person to another file"
    )
    return message, reasons


def _refuse_folder(folder: folders.Folder, fault: str, reasons: Mapping[str, str]) -> Draft:
    """Make the draft of a folder from which no study follows.

    `fault`: why no study follows. `reasons`: file -> why it is not used.
    """
    rows = tuple(build_row(file, reason=reasons.get(file.name, "")) for file in folder.files)
    return Draft(folder=folder, choice=None, person={}, trials=(), rows=rows, fault=fault)


MOST_BELOW = 60
"""Largest number of recordings in subfolders that are read to find one person's session."""


def draft_folder(folder: folders.Folder, options: Options) -> Draft:
    """Draft the study of a folder; read its subfolders if it is not complete without them.

    Parameters
    ----------
    folder
        As it was read.
    options
        Options about the subject.

    Returns
    -------
    Draft
        With the recordings of the subfolders if these are of the same person and session.
    """
    draft = draft_study(folder, options)
    below = sum(count for _, count in folder.subfolders)
    if folder.deep or not 0 < below <= MOST_BELOW or (draft.moves and not draft.fault):
        return draft
    deep = draft_study(folders.read_folder(folder.path, deep=True), options)
    return draft if deep.fault or deep.has_other_people or not deep.moves else deep


def draft_study(folder: folders.Folder, options: Options) -> Draft:
    """Draft the study of a folder without its subfolders.

    Parameters
    ----------
    folder
        As it was read.
    options
        Options about the subject.

    Returns
    -------
    Draft
        If no study follows, `fault` is the reason.
    """
    files = folder.select_kind(folders.FileKind.RECORDING)
    recordings = [file.recording for file in files if file.recording is not None]
    if not recordings:
        return _refuse_folder(folder, folders.describe_empty_folder(folder), {})
    set_files = folder.select_kind(folders.FileKind.MARKER_SET)
    local_sets = [
        (str(file.path), file.marker_set)
        for file in set_files or folders.find_marker_sets_above(folder.path)
        if file.marker_set is not None
    ]
    choices = rank_sets_of_recordings(recordings, local_sets)
    if not choices:
        try:
            choices = [_propose_set(recordings, options)]
        except InputError as fault:
            unknown = describe_unknown_labels(recordings, local_sets)
            message = f"{unknown}; positions and movement do not identify the markers: {fault}"
            return _refuse_folder(folder, message, {})
    if choices[0].people_prefixes:
        return _refuse_folder(folder, *_describe_several_people(files, choices[0].people_prefixes))
    for choice in choices:
        found = _find_session_of_set(files, recordings, choice)
        if found is not None:
            choice, spelt, session = found
            choice = _place_unknown_markers(choice, spelt, session, options)
            draft = _Drafting(folder, files, choice, spelt, session, options).draft()
            others = [i for i in range(len(files)) if i not in session.members]
            problem = _describe_other_session(files, others, local_sets) or draft.problem
            return replace(draft, problem=problem) if draft.moves else draft
    return _refuse_without_static(folder, files, recordings, choices[0])


def _find_session_of_set(
    files: Sequence[folders.FolderFile], recordings: Sequence[Recording], choice: SetChoice
) -> tuple[SetChoice, dict[int, Recording], Session] | None:
    """Find the session of a set's recordings: the set, recordings with its labels, the session."""
    spelt = {i: _rename_recording(recordings[i], choice) for i in choice.members}
    # units first: in a wrong unit the person looks like another one, or moves
    faults = {i: check_units(recording, choice.marker_set) for i, recording in spelt.items()}
    units = {i: fault for i, fault in faults.items() if fault}
    stems = {i: file.path.stem for i, file in enumerate(files)}
    sound = {i: recording for i, recording in spelt.items() if i not in units}
    session = find_session(sound, stems, choice.marker_set)
    if session is None:
        return None
    measured = _replace_joint_centres(choice, recordings, sound, session)
    if measured is not choice:
        # again, with measured markers in place of joint centres
        choice = measured
        spelt = {i: _rename_recording(recordings[i], choice) for i in choice.members}
        sound = {i: recording for i, recording in spelt.items() if i not in units}
        session = find_session(sound, stems, choice.marker_set)
        if session is None:
            return None
    return choice, spelt, replace(session, others={**session.others, **units})


def _refuse_without_static(
    folder: folders.Folder,
    files: Sequence[folders.FolderFile],
    recordings: Sequence[Recording],
    choice: SetChoice,
) -> Draft:
    """Make the draft of a folder without a static trial: why each recording is none."""
    reasons, parts, scales = {}, [], []
    for i in choice.members:
        spelling = _rename_recording(recordings[i], choice)
        posture, why = detect_standing(spelling, choice.marker_set)
        unit = check_units(spelling, choice.marker_set)
        reason = unit or f"no upright standing: {why}"
        if unit:
            scales.append(f"{files[i].name}: {unit}")
        elif posture is not None:
            reason = (
                f"the person stands from {posture.start:.2f} to {posture.stop:.2f} s, but moves "
                "before or after"
            )
            parts.append(files[i].name)
        reasons[files[i].name] = f"of marker set {choice.entry}; {reason}"
    message = (
        "no static trial found: a recording is needed in which the person stands still, upright, "
        "on both feet"
    )
    if scales:
        message = scales[0] + (f" (and {len(scales) - 1} more)" if len(scales) > 1 else "")
    elif parts:
        message += (
            f"; the person stands in a part of {parts[0]}: name the file static, or write "
            'role = "static" for it'
        )
    return _refuse_folder(folder, f"{message} (marker set {choice.entry})", reasons)


def _propose_set(recordings: Sequence[Recording], options: Options) -> SetChoice:
    """Propose the set "landmarks" by position and movement; InputError if not possible."""
    # imported here: it needs two libraries that few folders need
    from gaitcal.intake.label_proposal import LANDMARK_SET, propose_labels

    proposal = propose_labels(recordings, _find_given_height(recordings, options))
    landmarks = load_marker_set(LANDMARK_SET)
    marker_set = landmarks.with_further(proposal.tracking).with_weights(proposal.weights)
    labels = [label for r in recordings for label in r.labels]
    found = measure_label_coverage(marker_set, apply_renames(labels, proposal.rename))
    if len(found.missing) > MOST_MISSING:
        raise InputError(
            f"no marker is at these landmarks: {', '.join(found.missing)}", code=Code.LANDMARKS
        )
    return SetChoice(
        marker_set=marker_set,
        entry=LANDMARK_SET,
        rename=proposal.rename,
        coverage=found,
        members=tuple(range(len(recordings))),
        proposal=proposal,
    )


def _find_given_height(recordings: Iterable[Recording], options: Options) -> float | None:
    """Return the height (m) that the user or a file gives."""
    return options.height or next((r.facts.height for r in recordings if r.facts.height), None)


def _replace_joint_centres(
    choice: SetChoice,
    recordings: Sequence[Recording],
    spelt: Mapping[int, Recording],
    session: Session,
) -> SetChoice:
    """Rename measured markers to those of the set if files use its labels for joint centres."""
    static = session.statics[0]
    moving = [spelt[i] for i in session.members if i != static]
    known = (
        choice.proposal is not None
        or not choice.coverage.left_over
        or choice.marker_set.noise is not None
    )
    if known:
        return choice
    # label of the set that names a joint centre -> label of the measured marker
    found = find_measured_markers(spelt[static], moving, choice.marker_set)
    if not found:
        return choice
    pairs = set[tuple[str, str]]()
    for i in choice.members:
        pairs |= set(zip(recordings[i].labels, spelt[i].labels, strict=True))
    centres = {old: new for old, new in pairs if new in found}
    rename = {old: new for old, new in choice.rename.items() if old not in centres}
    rename |= {old: f"{old}{CENTRE}" for old, new in centres.items() if old == new}
    rename |= {other: label for label, other in found.items()}
    labels = apply_renames([m for i in choice.members for m in recordings[i].labels], rename)
    return replace(
        choice,
        rename=rename,
        centres=tuple(centres),
        coverage=measure_label_coverage(choice.marker_set, labels),
    )


def _place_unknown_markers(
    choice: SetChoice, spelt: Mapping[int, Recording], session: Session, options: Options
) -> SetChoice:
    """Assign markers that the set does not contain to the segments they move with, if possible."""
    if choice.proposal is not None or not choice.coverage.left_over:
        return choice
    from gaitcal.intake.label_proposal import place_unknown_markers

    static = session.statics[0]
    moving = [spelt[i] for i in session.members if i != static]
    marker_set = choice.marker_set
    # segments of the markers that the set contains: on landmarks, on knee devices, tracked
    known: dict[str, str] = {}
    for name in marker_set.landmarks:
        for group in marker_set.options(name):
            known |= dict.fromkeys(group, SEGMENT_OF[name])
    for label, parts in marker_set.knee_device.items():
        known |= dict.fromkeys(parts, marker_set.segment_of[label])
    known |= marker_set.segment_of
    given = marker_set.coverage([m for r in spelt.values() for m in r.labels]).landmarks
    lacking = [
        n for n in marker_set.landmarks if n not in given and SEGMENT_OF[n] in linkage.LOWER_BODY
    ]
    try:
        found = place_unknown_markers(
            spelt[static], moving, known, lacking, _find_given_height(spelt.values(), options)
        )
    except InputError:
        return choice
    labels = apply_renames([label for r in spelt.values() for label in r.labels], choice.rename)
    further = choice.marker_set.with_further(found.tracking).with_weights(found.weights)
    return replace(
        choice,
        marker_set=further,
        coverage=measure_label_coverage(further, labels),
        further_markers=found,
    )


def _describe_other_session(
    files: Sequence[folders.FolderFile],
    remaining: Sequence[int],
    local_sets: Sequence[tuple[str, MarkerSet]],
) -> str:
    """Describe that the remaining recordings are a complete session; empty if they are not."""
    found = {}
    for i in remaining:
        recording = files[i].recording
        if recording is not None:
            found[i] = recording
    for choice in rank_sets_of_recordings(list(found.values()), local_sets):
        numbers = [list(found)[k] for k in choice.members]
        spelt = {i: _rename_recording(found[i], choice) for i in numbers}
        session = find_session(spelt, {i: files[i].path.stem for i in numbers}, choice.marker_set)
        if session is None:
            continue
        reference = session.postures[session.statics[0]].stance
        shown = (
            classify_movement(spelt[i], session.marker_set, session.postures.get(i), reference)
            for i in session.members
        )
        if any(
            found.kind in (MovementKind.WALKS, MovementKind.ONE_JOINT, MovementKind.MOVES)
            for found in shown
        ):
            names = ", ".join(files[i].name for i in session.members)
            return (
                f"two people, or two sessions, in one folder: {names} belong to the other one, "
                f"with the static trial {files[session.statics[0]].name}; put each into a "
                "separate folder"
            )
    return ""


def _rename_recording(recording: Recording, choice: SetChoice) -> Recording:
    """Return a recording with the labels of the set."""
    return choice.marker_set.renamed(
        replace(recording, labels=apply_renames(recording.labels, choice.rename))
    )


@dataclass(frozen=True)
class _Drafting:
    """Drafts the study when marker set and static trial are known; recordings by their number."""

    folder: folders.Folder
    files: tuple[folders.FolderFile, ...]
    choice: SetChoice
    spelt: Mapping[int, Recording]
    """With the labels of the set."""
    session: Session
    options: Options

    def draft(self) -> Draft:
        """Assign roles and forces, collect the facts about the subject, and list all files."""
        session = self.session
        reference = session.postures[session.statics[0]].stance
        moves = {
            i: classify_movement(
                self.spelt[i], session.marker_set, session.postures.get(i), reference
            )
            for i in session.members
        }
        # the first static trial may be one that is declared so and stands in a part only
        statics = [
            i
            for i in session.statics
            if moves[i].kind is MovementKind.STANDS or i == session.statics[0]
        ]
        out = dict(session.others)
        for i, j in self._find_copies(statics):
            out[i] = f"the same recording as {self.files[j].name}"
        statics = self._put_model_first([i for i in statics if i not in out])
        # segment poses of any movement give a static posture besides the trial itself
        made = [
            i
            for i in statics[:1]
            if has_poses(self.spelt[i].labels) and moves[i].kind is not MovementKind.STANDS
        ]
        statics = [i for i in statics if i not in made]
        roles = self._assign_roles(statics, moves, out)
        without_plates = {
            i: (self.files[i].path.stem, self.spelt[i])
            for i, (role, _) in roles.items()
            if role in ("gait", "motion") and not self.spelt[i].plates
        }
        forces, unpaired = folders.pair_forces(
            without_plates, self.choice.marker_set, self.folder.files
        )
        order = sorted(
            roles, key=lambda i: (_ORDER[roles[i][0]], statics.index(i) if i in statics else 0, i)
        )
        stems = [f"{self.files[i].path.stem}_upright" for i in made]
        names = folders.make_trial_names([*stems, *(self.files[i].path.stem for i in order)])
        trials = [
            DraftedTrial(
                name=name,
                role="static",
                joint="",
                file=self.files[i],
                forces=None,
                reason="no standing needed: upright posture from the axes of the segment poses",
                certain=True,
            )
            for i, name in zip(made, names[: len(made)], strict=True)
        ]
        trials += [
            self._build_trial(i, name, roles[i], moves.get(i), forces.get(i), statics)
            for i, name in zip(order, names[len(made) :], strict=True)
        ]
        plates = self._weigh_subject(statics)
        facts = self._sort_facts([*statics, *(i for i in order if i not in statics)])
        height = body_plan.estimate_height(session.postures[(made or statics)[0]].landmarks)
        walking = self._weigh_walks(roles, forces)
        person = collect_subject(self.folder.name, self.options, facts, plates, height, walking)
        if any(trial.role != "static" for trial in trials):
            problem = check_mass(person, self.options, plates)
        else:
            problem = self._describe_no_movement(out)
        number = {file.name: i for i, file in enumerate(self.files)}
        owner = {choice.file.name: self.files[i].name for i, choice in forces.items()}
        rows = [
            self._build_recording_row(number[file.name], roles, out, moves)
            if file.name in number
            else self._build_other_row(file, owner, unpaired)
            for file in self.folder.files
        ]
        return Draft(
            folder=self.folder,
            choice=self.choice,
            person=person,
            trials=tuple(trials),
            rows=tuple(rows),
            has_other_people=bool(session.others),
            problem=problem,
            doubts=list_doubtful_figures(facts),
        )

    def _assign_roles(
        self, statics: Sequence[int], moves: Mapping[int, RecordedMovement], out: dict[int, str]
    ) -> dict[int, tuple[str, str]]:
        """Assign role and joint to each recording; add to `out` why others are not used."""
        roles: dict[int, tuple[str, str]] = dict.fromkeys(statics, ("static", ""))
        for i, found in moves.items():
            if i in roles or i in out:
                continue
            if found.kind is MovementKind.WALKS:
                roles[i] = ("gait", "")
            elif found.kind is MovementKind.ONE_JOINT:
                roles[i] = ("joint", found.joint)
            elif found.kind is MovementKind.MOVES:
                roles[i] = ("motion", "")
            else:
                out[i] = (
                    f"{found.kind.value}: {found.evidence}; neither standing nor a movement of the "
                    "body or of one joint"
                )
        return roles

    def _weigh_walks(
        self, roles: Mapping[int, tuple[str, str]], forces: Mapping[int, folders.ForceChoice]
    ) -> tuple[str, float] | None:
        """Return the names of walks with whole strides on plates, and the median mass (kg)."""
        on_plates = {i: self.spelt[i].plates for i, (role, _) in roles.items() if role == "gait"}
        for i, choice in forces.items():
            if choice.file.forces:
                on_plates[i] = choice.file.forces.plates
        strides = {}
        for i, plates in on_plates.items():
            mass = weigh_walking(plates)
            if mass is not None:
                strides[self.files[i].name] = mass
        return (", ".join(strides), float(np.median(list(strides.values())))) if strides else None

    def _describe_no_movement(self, out: Mapping[int, str]) -> str:
        """Describe that no trial moves, and why moving recordings are not used."""
        why = [f"{self.files[i].name} is not used: {reason}" for i, reason in sorted(out.items())]
        more = f" (and {len(why) - 2} more)" if len(why) > 2 else ""
        used = "no recording that is used shows a movement"
        return "; ".join([used, *why[:2]]) + more

    def _find_copies(self, statics: Sequence[int]) -> list[tuple[int, int]]:
        """Find recordings that repeat another one: the copy and the one that is kept.

        Of several the one with plates is kept, then the longest.
        """

        def rank(i: int) -> tuple[object, ...]:
            recording = self.spelt[i]
            order = statics.index(i) if i in statics else 0
            coverage = measure_label_coverage(self.choice.marker_set, recording.labels)
            unknown = len(coverage.left_over)
            return (i not in statics, not recording.plates, -len(recording.time), unknown, order, i)

        kept: list[int] = []
        copies = []
        for i in sorted(self.session.members, key=rank):
            twin = next((j for j in kept if is_same_recording(self.spelt[i], self.spelt[j])), None)
            if twin is None:
                kept.append(i)
            else:
                copies.append((i, twin))
        return copies

    def _put_model_first(self, statics: list[int]) -> list[int]:
        """Put the first static trial that gives a model in front.

        If none does, the order stays: the study's other trials may complete it.
        """
        person = collect_subject("", self.options, self._sort_facts(statics), None)
        if len(statics) < 2 or "height_m" not in person:
            return statics
        subject = Subject("", 70.0, float(str(person["height_m"].value)), self.options.sex or "")
        for i in statics:
            with suppress(InputError):
                nominal.nominal_model(self.spelt[i], self.choice.marker_set, subject)
                return [i, *(j for j in statics if j != i)]
        return statics

    def _sort_facts(self, order: Sequence[int]) -> list[tuple[str, Facts]]:
        """List name and facts of the session's recordings, those in `order` first."""
        others = [i for i in self.session.members if i not in order]
        return [(self.files[i].name, self.spelt[i].facts) for i in (*order, *others)]

    def _weigh_subject(self, statics: Sequence[int]) -> tuple[str, float] | None:
        """Return the first static trial that stands on plates, and the mass (kg) by them."""
        for i in statics:
            mass = weigh_standing(self.spelt[i], self.choice.marker_set, self.session.postures[i])
            if mass is not None:
                return self.files[i].name, mass
        return None

    def _build_trial(
        self,
        i: int,
        name: str,
        role: tuple[str, str],
        found: RecordedMovement | None,
        forces: folders.ForceChoice | None,
        statics: Sequence[int],
    ) -> DraftedTrial:
        """Make the trial of a recording, with the reason for its role."""
        reason = "" if found is None else found.evidence
        certain = found is not None and found.certain
        if role[0] == "static":
            posture = self.session.postures[i]
            certain = posture.throughout
            if not certain:
                reason = (
                    f"named static, and the person stands from {posture.start:.2f} to "
                    f"{posture.stop:.2f} s"
                )
            elif len(statics) > 1:
                first = i == statics[0]
                reason += "; the best static trial" if first else "; must agree with the first one"
            extra = self.session.only_standing.get(i, ())
            if extra:
                names = ", ".join(extra[:4]) + (", ..." if len(extra) > 4 else "")
                reason += f"; has markers for the static trial only: {names}"
        else:
            conflict = folders.describe_name_conflict(self.files[i].path.stem, role)
            if conflict:
                reason, certain = f"{reason}; {conflict}", False
        return DraftedTrial(
            name=name,
            role=role[0],
            joint=role[1],
            file=self.files[i],
            forces=forces,
            reason=reason,
            certain=certain,
        )

    def _build_recording_row(
        self,
        i: int,
        roles: Mapping[int, tuple[str, str]],
        out: Mapping[int, str],
        moves: Mapping[int, RecordedMovement],
    ) -> FileRow:
        """Make the row of a recording."""
        file, choice = self.files[i], self.choice
        labels = file.recording.labels if file.recording is not None else ()
        found = measure_label_coverage(choice.marker_set, apply_renames(labels, choice.rename))
        counts = f"{found.known} of {len(labels)} known"
        if i not in self.spelt:
            more = " ..." if len(labels) > FIRST_LABELS else ""
            first = " ".join(labels[:FIRST_LABELS])
            reason = f"not of marker set {choice.entry}: labels {first}{more}"
            return build_row(file, labels=counts, reason=reason)
        shows, evidence = (moves[i].kind.value, moves[i].evidence) if i in moves else ("", "")
        used = " ".join(filter(None, roles.get(i, ())))
        return build_row(
            file, labels=counts, shows=shows, used=used, reason=out.get(i, "") or evidence
        )

    def _build_other_row(
        self, file: folders.FolderFile, owner: Mapping[str, str], unpaired: Mapping[str, str]
    ) -> FileRow:
        """Make the row of a file that is not a recording.

        `owner`: table of forces -> its recording; `unpaired`: table of forces -> why it has none.
        """
        if file.forces is not None:
            used = f"forces of {owner[file.name]}" if file.name in owner else ""
            return build_row(
                file, used=used, reason="" if used else unpaired.get(file.name, "no walk needs it")
            )
        if file.kind is folders.FileKind.EXTERNAL_LOADS:
            # a Windows path takes / and \ as separators
            table = PureWindowsPath(file.table_name).name
            if any(PureWindowsPath(name).name == table for name in owner):
                return build_row(file, used=f"description of the forces in {table}")
            return build_row(file, reason=f"describes {table}, which is not used")
        if file.kind is folders.FileKind.MARKER_SET:
            chosen = str(file.path) == self.choice.entry
            return build_row(
                file,
                used="marker set" * chosen,
                reason="" if chosen else "another set contains more labels",
            )
        uses = {
            folders.FileKind.CORNERS: "corners of the plates of the table of forces with its name",
            folders.FileKind.FACTS: "subject and events of the recording with its name",
            folders.FileKind.EVENTS: "foot events of the recordings that it names",
        }
        if file.kind in uses:
            return build_row(file, used=uses[file.kind])
        is_study = file.kind is folders.FileKind.STUDY
        return build_row(file, reason="a study file, which is not read" if is_study else "")


_ORDER = {"static": 0, "joint": 1, "gait": 2, "motion": 3}
"""Order of the trials by their role."""


def find_faulty_trials(study: Study, findings: Iterable[Finding]) -> dict[str, str]:
    """Find the trials to leave out of a study because the checks report an error in them.

    Nothing is left out if the first static trial or the study as a whole is concerned, or if no
    trial of a kind (walks; functional trials without walks) would be left. A folder holds all that
    was recorded, bad trials included; of a study file a trial is left out if its errors would stop
    the others.

    Parameters
    ----------
    study
        As it was read.
    findings
        Of the checks.

    Returns
    -------
    dict
        Trial -> error.
    """
    faulty: dict[str, str] = {}
    for f in findings:
        if f.severity is Severity.ERROR:
            remedy = f"; {f.cure}" if f.cure else ""
            faulty.setdefault(f.where, f"{f.topic}: {f.evidence}{remedy}")
    names = {trial.name for trial in study.trials}
    whole = set(study.walks) or {trial.name for trial in study.moving}
    if whole <= set(faulty) or not set(faulty) <= names - {study.static.name}:
        return {}
    return faulty


def list_faulty_notes(faulty: Mapping[str, str]) -> tuple[str, ...]:
    """List the trials that are left out, with their errors, as notes.

    Parameters
    ----------
    faulty
        Trial -> error.

    Returns
    -------
    tuple of str
    """
    return tuple(f"not used: trial '{name}': {error}" for name, error in faulty.items())


def find_rejected_forces(draft: Draft) -> tuple[Finding, ...]:
    """Find walks without forces although a table of forces has a similar name.

    Parameters
    ----------
    draft
        Of a folder.

    Returns
    -------
    tuple of Finding
        A warning for each such table.
    """
    walks = {t.file.path.stem: t for t in draft.trials if t.role in ("gait", "motion")}
    out = []
    tables = {file.name: file for file in draft.folder.select_kind(folders.FileKind.FORCES)}
    for row in (row for row in draft.left_out if row.kind == folders.FileKind.FORCES.value):
        # a table of a recording that is no walk concerns no walk
        partner = folders.find_partner(tables[row.name], draft.folder.files)
        if partner is not None and partner.path.stem not in walks:
            continue
        stem = PurePath(row.name).stem
        similarity = {name: folders.compare_names(name, stem) for name in walks}
        trial = walks.get(max(similarity, key=similarity.__getitem__, default=""))
        if trial is None or trial.forces is not None:
            continue
        if trial.file.recording and trial.file.recording.plates:
            continue
        warning = Finding(
            severity=Severity.WARNING,
            topic="forces",
            where=trial.name,
            found=f"{row.name} is not used: {row.reason}",
            cause="without forces there are no torques",
            cure="provide the forces of this walk, or remove the table if only angles are needed",
            code=Code.FORCES_NOT_USED,
        )
        out.append(warning)
    return tuple(out)
