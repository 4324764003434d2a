"""From a folder as it was read to the study that follows: marker set, session, roles, forces,
person.

Where none follows: why, in one line and file by file. Trials in which the checks find an error,
while others are sound, are left out of a drafted study.
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


def describe_several_people(
    files: Sequence[folders.FolderFile], people: Mapping[int, tuple[str, ...]]
) -> tuple[str, dict[str, str]]:
    """That files hold the markers of several people, in one line, and file -> of whom."""
    told = {
        files[i].name: f"markers of {len(found)} people ({', '.join(found)})"
        for i, found in people.items()
    }
    name, words = next(iter(told.items()))
    more = f", and {len(told) - 1} more files too" if len(told) > 1 else ""
    return (
        f"{words} in one file, {name}{more}: write each person's markers into a file of their own",
        told,
    )


def refuse_folder(folder: folders.Folder, fault: str, told: Mapping[str, str]) -> Draft:
    """What was seen of a folder from which no study follows."""
    seen = tuple(build_row(file, reason=told.get(file.name, "")) for file in folder.files)
    return Draft(folder=folder, choice=None, person={}, trials=(), rows=seen, fault=fault)


MOST_BELOW = (
    60  # Recordings in subfolders that are read to see whether they are of one person's session
)


def draft_folder(folder: folders.Folder, options: Options) -> Draft:
    """The study of a folder; its subfolders are looked into where it is not whole without them and
    they are of one person.
    """
    draft = draft_study(folder, options)
    below = sum(count for _, count in folder.subfolders)
    if folder.deep or not 0 < below <= MOST_BELOW or (draft.moves and not draft.fault):
        return draft
    deep = draft_study(folders.read_folder(folder.path, deep=True), options)
    return draft if deep.fault or deep.has_other_people or not deep.moves else deep


def draft_study(folder: folders.Folder, options: Options) -> Draft:
    """The study that follows from a folder; where none does, what was seen and `fault`."""
    files = folder.select_kind(folders.FileKind.RECORDING)
    recordings = [file.recording for file in files if file.recording is not None]
    if not recordings:
        return refuse_folder(folder, folders.describe_empty_folder(folder), {})
    own = [
        (str(f.path), f.marker_set)
        for f in folder.select_kind(folders.FileKind.MARKER_SET)
        or folders.find_marker_sets_above(folder.path)
        if f.marker_set is not None
    ]
    choices = rank_sets_of_recordings(recordings, own)
    if not choices:
        try:
            choices = [_propose_set(recordings, options)]
        except InputError as fault:
            return refuse_folder(
                folder,
                f"{describe_unknown_labels(recordings, own)}; nor do places and movement tell them: {fault}",
                {},
            )
    if choices[0].people_prefixes:
        return refuse_folder(folder, *describe_several_people(files, choices[0].people_prefixes))
    for choice in choices:
        spelt = {i: _rename_recording(recordings[i], choice) for i in choice.members}
        # before anything else is looked for: in another unit everybody is another person, or moves
        units = {i: wrong for i, r in spelt.items() if (wrong := check_units(r, choice.marker_set))}
        sound = {i: r for i, r in spelt.items() if i not in units}
        session = find_session(sound, {i: files[i].path.stem for i in sound}, choice.marker_set)
        if (
            session is not None
            and (measured := _replace_joint_centres(choice, recordings, sound, session))
            is not choice
        ):
            choice = measured
            spelt = {i: _rename_recording(recordings[i], choice) for i in choice.members}
            sound = {i: r for i, r in spelt.items() if i not in units}
            session = find_session(sound, {i: files[i].path.stem for i in sound}, choice.marker_set)
        if session is not None:
            session = replace(session, others={**session.others, **units})
            choice = _place_unknown_markers(choice, spelt, session, options)
            draft = _Drafting(folder, files, choice, spelt, session, options).draft()
            other = _describe_other_session(
                files, [i for i in range(len(files)) if i not in session.members], own
            )
            return replace(draft, problem=other or draft.problem) if draft.moves else draft
    told, parts, scales = {}, [], []
    for i in choices[0].members:
        spelling = _rename_recording(recordings[i], choices[0])
        posture, why = detect_standing(spelling, choices[0].marker_set)
        unit = check_units(spelling, choices[0].marker_set)
        nobody = unit or f"nobody stands in it: {why}"
        if unit:
            scales.append(f"{files[i].name}: {unit}")
        elif posture is not None:
            nobody = (
                f"somebody stands from {posture.start:.2f} to {posture.stop:.2f} s, but moves "
                "otherwise"
            )
            parts.append(files[i].name)
        told[files[i].name] = f"of marker set {choices[0].entry}; {nobody}"
    message = (
        "in no recording does the person only stand still, upright, on both feet: a static trial "
        "is needed"
    )
    if scales:
        message = scales[0] + (f" (and {len(scales) - 1} more)" if len(scales) > 1 else "")
    elif parts:
        message += (
            f"; in {parts[0]} somebody stands for a part: call the file static, or write role = "
            '"static" for it'
        )
    return refuse_folder(folder, f"{message} (marker set {choices[0].entry})", told)


def _propose_set(recordings: Sequence[Recording], options: Options) -> SetChoice:
    """The set "landmarks", labels as places and movement propose them; InputError where they tell
    too little.
    """
    from gaitcal.intake.label_proposal import (
        LANDMARK_SET,
        propose_labels,
    )  # with two libraries that few folders need

    proposal = propose_labels(recordings, _find_given_height(recordings, options))
    marker_set = (
        load_marker_set(LANDMARK_SET).with_further(proposal.tracking).with_weights(proposal.weights)
    )
    found = measure_label_coverage(
        marker_set,
        apply_renames([label for r in recordings for label in r.labels], proposal.rename),
    )
    if len(found.missing) > MOST_MISSING:
        raise InputError(
            f"no marker lies where these are: {', '.join(found.missing)}", code=Code.LANDMARKS
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
    """m, as the user or a file says."""
    return options.height or next((r.facts.height for r in recordings if r.facts.height), None)


def _replace_joint_centres(
    choice: SetChoice,
    recordings: Sequence[Recording],
    spelt: Mapping[int, Recording],
    session: Session,
) -> SetChoice:
    """The set with measured markers where files name joint centres as it names lateral markers."""
    static = session.statics[0]
    moving = [spelt[i] for i in session.members if i != static]
    known = (
        choice.proposal is not None
        or not choice.coverage.left_over
        or choice.marker_set.noise is not None
    )
    if known or not (found := find_measured_markers(spelt[static], moving, choice.marker_set)):
        return choice
    pairs = {
        pair
        for i in choice.members
        for pair in zip(recordings[i].labels, spelt[i].labels, strict=True)
    }
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
    """The set with markers that it does not know on the segments that they move with, where that
    can be told.
    """
    if choice.proposal is not None or not choice.coverage.left_over:
        return choice
    from gaitcal.intake.label_proposal import place_unknown_markers

    static = session.statics[0]
    moving = [spelt[i] for i in session.members if i != static]
    marker_set, rods = choice.marker_set, choice.marker_set.knee_device
    known = {
        m: SEGMENT_OF[n]
        for n in marker_set.landmarks
        for group in marker_set.options(n)
        for m in group
    }
    known |= {
        m: marker_set.segment_of[label] for label, parts in rods.items() for m in parts
    } | marker_set.segment_of
    given = marker_set.measure_coverage([m for r in spelt.values() for m in r.labels]).landmarks
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
    files: Sequence[folders.FolderFile], rest: Sequence[int], own: Sequence[tuple[str, MarkerSet]]
) -> str:
    """That recordings which are left over show a whole session of their own; empty where they do
    not.
    """
    found = {i: recording for i in rest if (recording := files[i].recording) is not None}
    for choice in rank_sets_of_recordings(list(found.values()), own):
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
                f"two people, or two sessions, lie in one folder; {names} are the other one, "
                "static trial "
                f"{files[session.statics[0]].name}: put each into a folder of its own"
            )
    return ""


def _rename_recording(recording: Recording, choice: SetChoice) -> Recording:
    """A recording with the labels of the set."""
    return choice.marker_set.rename_labels(
        replace(recording, labels=apply_renames(recording.labels, choice.rename))
    )


@dataclass(frozen=True)
class _Drafting:
    """What a draft is made of, once marker set and static trial are found; recordings by their
    number.
    """

    folder: folders.Folder
    files: tuple[folders.FolderFile, ...]
    choice: SetChoice
    spelt: Mapping[int, Recording]  # With the labels of the set
    session: Session
    options: Options

    def draft(self) -> Draft:
        """Roles, forces and person."""
        session = self.session
        reference = session.postures[session.statics[0]].stance
        moves = {
            i: classify_movement(
                self.spelt[i], session.marker_set, session.postures.get(i), reference
            )
            for i in session.members
        }
        # of what does not only stand, the first static trial is one that is declared so, of which a
        # part stands
        statics = [
            i
            for i in session.statics
            if moves[i].kind is MovementKind.STANDS or i == session.statics[0]
        ]
        out = dict(session.others) | {
            i: f"the same recording as {self.files[j].name}" for i, j in self._find_copies(statics)
        }
        statics = self._put_model_first([i for i in statics if i not in out])
        # segment poses make a standing posture of any movement, which is a trial beside it
        made = [
            i
            for i in statics[:1]
            if has_poses(self.spelt[i].labels) and moves[i].kind is not MovementKind.STANDS
        ]
        statics = [i for i in statics if i not in made]
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
                    f"{found.kind.value}: {found.evidence}; neither standing nor moving the body "
                    "or one joint"
                )
        walks = {
            i: (self.files[i].path.stem, self.spelt[i])
            for i, (role, _) in roles.items()
            if role in ("gait", "motion") and not self.spelt[i].plates
        }
        forces, unpaired = folders.pair_forces(walks, self.choice.marker_set, self.folder.files)
        order = sorted(
            roles, key=lambda i: (_ORDER[roles[i][0]], statics.index(i) if i in statics else 0, i)
        )
        stems = [self.files[i].path.stem for i in order]
        first, *names = folders.make_trial_names(
            [f"{self.files[i].path.stem}_upright" for i in made] + stems
        )
        names = names if made else [first, *names]
        upright = tuple(
            DraftedTrial(
                name=first,
                role="static",
                joint="",
                file=self.files[i],
                forces=None,
                reason="nobody has to stand: the segments of its poses with their axes in line",
                certain=True,
            )
            for i in made
        )
        trials = upright + tuple(
            self._build_trial(i, name, roles[i], moves.get(i), forces.get(i), statics)
            for i, name in zip(order, names, strict=True)
        )
        plates = self._weigh_subject(statics)
        facts = self._sort_facts([*statics, *(i for i in order if i not in statics)])
        tall = body_plan.estimate_height(session.postures[(made or statics)[0]].landmarks)
        on_plates = {i: self.spelt[i].plates for i, (role, _) in roles.items() if role == "gait"}
        on_plates |= {
            i: choice.file.forces.plates for i, choice in forces.items() if choice.file.forces
        }
        strides = {
            self.files[i].name: kg
            for i, of in on_plates.items()
            if (kg := weigh_walking(of)) is not None
        }
        walking = (
            (", ".join(strides), float(np.median(list(strides.values())))) if strides else None
        )
        person = collect_subject(self.folder.name, self.options, facts, plates, tall, walking)
        moving = any(trial.role != "static" for trial in trials)
        number = {file.name: i for i, file in enumerate(self.files)}
        owner = {choice.file.name: self.files[i].name for i, choice in forces.items()}
        seen = tuple(
            self._build_recording_row(number[file.name], roles, out, moves)
            if file.name in number
            else self._build_other_row(file, owner, unpaired)
            for file in self.folder.files
        )
        return Draft(
            folder=self.folder,
            choice=self.choice,
            person=person,
            trials=trials,
            rows=seen,
            has_other_people=bool(session.others),
            problem=check_mass(person, self.options, plates)
            if moving
            else self._describe_no_movement(out),
            doubts=list_doubtful_figures(facts),
        )

    def _describe_no_movement(self, out: Mapping[int, str]) -> str:
        """That no trial moves, and why the recordings are left out that may."""
        why = [f"{self.files[i].name} is not used: {reason}" for i, reason in sorted(out.items())]
        more = f" (and {len(why) - 2} more)" if len(why) > 2 else ""
        used = "no recording that is used shows somebody moving"
        return "; ".join([used, *why[:2]]) + more

    def _find_copies(self, statics: Sequence[int]) -> list[tuple[int, int]]:
        """Recordings that are another one again, and which; the one with plates is kept, then the
        longest.
        """

        def worth(i: int) -> tuple[object, ...]:
            recording = self.spelt[i]
            rank = statics.index(i) if i in statics else 0
            strange = len(
                measure_label_coverage(self.choice.marker_set, recording.labels).left_over
            )
            return (i not in statics, not recording.plates, -len(recording.time), strange, rank, i)

        kept: list[int] = []
        copies = []
        for i in sorted(self.session.members, key=worth):
            twin = next((j for j in kept if is_same_recording(self.spelt[i], self.spelt[j])), None)
            if twin is None:
                kept.append(i)
            else:
                copies.append((i, twin))
        return copies

    def _put_model_first(self, statics: list[int]) -> list[int]:
        """Static trials, one that gives a model by itself first; where none does, the study's other
        trials may help.
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
        rest = [i for i in self.session.members if i not in order]
        return [(self.files[i].name, self.spelt[i].facts) for i in (*order, *rest)]

    def _weigh_subject(self, statics: Sequence[int]) -> tuple[str, float] | None:
        """Static trial, and the mass (kg) that plates weigh in it."""
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
        reason = "" if found is None else found.evidence
        certain = found is not None and found.certain
        if role[0] == "static":
            posture = self.session.postures[i]
            certain = posture.throughout
            if not certain:
                reason = (
                    f"the file is called static, and from {posture.start:.2f} to "
                    f"{posture.stop:.2f} s somebody stands"
                )
            elif len(statics) > 1:
                reason += (
                    "; the best static trial"
                    if i == statics[0]
                    else "; has to agree with the first"
                )
            if extra := self.session.only_standing.get(i, ()):
                reason += (
                    f"; has {', '.join(extra[:4])}{', ...' if len(extra) > 4 else ''}, worn for "
                    "standing only"
                )
        elif said := folders.describe_name_conflict(self.files[i].path.stem, role):
            reason, certain = f"{reason}; {said}", False
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
        file, choice = self.files[i], self.choice
        labels = file.recording.labels if file.recording is not None else ()
        found = measure_label_coverage(choice.marker_set, apply_renames(labels, choice.rename))
        counts = f"{found.known} of {len(labels)} known"
        if i not in self.spelt:
            more = " ..." if len(labels) > FIRST_LABELS else ""
            reason = (
                f"not of marker set {choice.entry}: has {' '.join(labels[:FIRST_LABELS])}{more}"
            )
            return build_row(file, labels=counts, reason=reason)
        shows, evidence = (moves[i].kind.value, moves[i].evidence) if i in moves else ("", "")
        used = " ".join(filter(None, roles.get(i, ())))
        return build_row(
            file, labels=counts, shows=shows, used=used, reason=out.get(i, "") or evidence
        )

    def _build_other_row(
        self, file: folders.FolderFile, owner: Mapping[str, str], unpaired: Mapping[str, str]
    ) -> FileRow:
        """A row of a file that is no recording; `owner`: table of forces -> recording, `unpaired`:
        -> why none.
        """
        if file.forces is not None:
            used = f"forces of {owner[file.name]}" if file.name in owner else ""
            return build_row(
                file, used=used, reason="" if used else unpaired.get(file.name, "no walk needs it")
            )
        if file.kind is folders.FileKind.EXTERNAL_LOADS:
            table = PureWindowsPath(file.table_name).name  # takes / and \ alike
            if any(PureWindowsPath(name).name == table for name in owner):
                return build_row(file, used=f"says that {table} holds forces")
            return build_row(file, reason=f"names {table}, which is not used")
        if file.kind is folders.FileKind.MARKER_SET:
            chosen = str(file.path) == self.choice.entry
            return build_row(
                file,
                used="marker set" * chosen,
                reason="" if chosen else "another set knows more labels",
            )
        if file.kind is folders.FileKind.CORNERS:
            return build_row(file, used="corners of the plates in the table of forces beside it")
        if file.kind is folders.FileKind.FACTS:
            return build_row(
                file, used="what the file of the recording beside it said of person and events"
            )
        if file.kind is folders.FileKind.EVENTS:
            return build_row(file, used="foot events of the recordings that it names")
        return build_row(
            file,
            reason="a study file; it is not looked into"
            if file.kind is folders.FileKind.STUDY
            else "",
        )


_ORDER = {"static": 0, "joint": 1, "gait": 2, "motion": 3}


def find_faulty_trials(study: Study, findings: Iterable[Finding]) -> dict[str, str]:
    """Choose the trials to leave out of a study, as an error speaks against them.

    Nothing is left out where the first static trial, or the study as a whole, is at fault, or where
    no trial of a kind (walks, or isolated trials without walks) would be left. A folder holds what
    was recorded, bad takes too; of a study file a trial is left out where its errors would stop the
    others.

    Parameters
    ----------
    study
        As it was read.
    findings
        What the checks found in it.

    Returns
    -------
    dict
        Trial -> error.
    """
    faulty: dict[str, str] = {}
    for f in findings:
        if f.severity is Severity.ERROR:
            faulty.setdefault(
                f.where, f"{f.topic}: {f.evidence}" + (f"; {f.cure}" if f.cure else "")
            )
    names = {trial.name for trial in study.trials}
    whole = set(study.walks) or {trial.name for trial in study.moving}
    if whole <= set(faulty) or not set(faulty) <= names - {study.static.name}:
        return {}
    return faulty


def list_faulty_notes(faulty: Mapping[str, str]) -> tuple[str, ...]:
    """That trials are left out, and why (trial -> error)."""
    return tuple(f"not used: trial '{name}': {error}" for name, error in faulty.items())


def find_rejected_forces(draft: Draft) -> tuple[Finding, ...]:
    """A warning for each walk without forces whose name a table of forces bears that is nobody's."""
    walks = {t.file.path.stem: t for t in draft.trials if t.role in ("gait", "motion")}
    out = []
    tables = {file.name: file for file in draft.folder.select_kind(folders.FileKind.FORCES)}
    for row in (row for row in draft.left_out if row.kind == folders.FileKind.FORCES.value):
        partner = folders.find_partner(tables[row.name], draft.folder.files)
        if partner is not None and partner.path.stem not in walks:
            continue
        trial = walks.get(
            max(
                walks,
                key=lambda name: folders.compare_names(name, PurePath(row.name).stem),
                default="",
            )
        )
        if (
            trial is None
            or trial.forces is not None
            or (trial.file.recording and trial.file.recording.plates)
        ):
            continue
        warning = Finding(
            severity=Severity.WARNING,
            topic="forces",
            where=trial.name,
            found=f"{row.name} is not used: {row.reason}",
            cause="no forces, no torques",
            cure="find the forces of this walk; or take the table out of the folder, if angles are "
            "wanted",
            code=Code.FORCES_NOT_USED,
        )
        out.append(warning)
    return tuple(out)
