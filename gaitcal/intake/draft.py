"""The study that follows from a folder: roles of its recordings, their forces, the person, and what is not used.

Nothing is dropped without a word: every file of the folder is a row of `Draft.seen`, with what it is used as or why it
is not.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from gaitcal.errors import InputError
from gaitcal.intake.folder import FileKind, Folder, FolderFile, marker_sets_above
from gaitcal.intake.force_files import ForceChoice, pair_forces
from gaitcal.intake.marker_sets import SetChoice, choose_set, coverage, respelt
from gaitcal.intake.movement import Movement, Shows, movement
from gaitcal.intake.people import Session, session_of
from gaitcal.intake.person_facts import Known, Options, person_of, weighed
from gaitcal.intake.placing import same_recording
from gaitcal.model.nominal import nominal_model
from gaitcal.model.subject_model import Subject
from gaitcal.recording.metadata import Facts
from gaitcal.recording.recording import Recording

NEEDED = {"mass_kg": "--mass", "height_m": "--height", "sex": "--sex"}
"""Fields of the person without which nothing can be calibrated, and the options that give them."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One file of the folder, as it was understood."""

    name: str
    kind: str
    frames: int | None = None
    labels: str = ""
    """How many of its labels the marker set knows."""
    shows: str = ""
    used: str = ""
    """As what; empty: not at all."""
    reason: str = ""
    """Why it is used so, or why it is not used."""


@dataclass(frozen=True, kw_only=True)
class DraftTrial:
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
    choice: SetChoice | None
    """None: no marker set explains the labels."""
    person: Mapping[str, Known]
    trials: tuple[DraftTrial, ...]
    seen: tuple[Seen, ...]
    fault: str = ""
    """Why no study follows from the folder; empty where one does."""
    problem: str = ""
    """Why the drafted study cannot be run as it is, apart from what is missing."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Fields of the person that nobody tells, and that are needed."""
        return tuple(name for name in NEEDED if name not in self.person)

    @property
    def left_out(self) -> tuple[Seen, ...]:
        """Files that are not used."""
        return tuple(row for row in self.seen if not row.used)

    def without(self, trials: Mapping[str, str]) -> Draft:
        """The draft without these trials, name -> why."""
        out = {trial.file.name: trials[trial.name] for trial in self.trials if trial.name in trials}
        return replace(
            self,
            trials=tuple(trial for trial in self.trials if trial.name not in trials),
            seen=tuple(replace(row, used="", reason=out[row.name]) if row.name in out else row for row in self.seen),
        )


def draft_study(folder: Folder, options: Options) -> Draft:
    """The study that follows from a folder; where none does, what was seen and `fault`."""
    files = folder.of_kind(FileKind.RECORDING)
    recordings = [file.recording for file in files if file.recording is not None]
    if not recordings:
        return _refused(folder, _nothing_here(folder), {})
    own = [(str(f.path), f.marker_set) for f in _own_sets(folder) if f.marker_set is not None]
    choices = choose_set([r.labels for r in recordings], own)
    if not choices:
        return _refused(folder, _no_set(recordings, own), {})
    for choice in choices:
        spelt = {i: _spelt(recordings[i], choice) for i in choice.members}
        session = session_of(spelt, {i: files[i].path.stem for i in spelt}, choice.marker_set)
        if session is not None:
            return _Drafting(folder, files, choice, spelt, session, options).draft()
    told = {files[i].name: f"of marker set {choices[0].entry}; nobody stands in it" for i in choices[0].members}
    message = "in no recording does the person stand still, upright, on both feet: a static trial is needed"
    return _refused(folder, f"{message} (marker set {choices[0].entry})", told)


def _spelt(recording: Recording, choice: SetChoice) -> Recording:
    """A recording with the labels of the set."""
    return choice.marker_set.renamed(replace(recording, labels=respelt(recording.labels, choice.rename)))


def _own_sets(folder: Folder) -> tuple[FolderFile, ...]:
    return folder.of_kind(FileKind.MARKER_SET) or marker_sets_above(folder.path)


def _nothing_here(folder: Folder) -> str:
    if folder.subfolders:
        below = ", ".join(f"{name} ({count})" for name, count in folder.subfolders[:6])
        return f"holds no recording that can be read; folders in it do: {below}; name one of them, one person a folder"
    if not folder.files:
        return "is empty; .c3d, .trc or .csv files of one person are needed"
    return f"holds {len(folder.files)} files, but no recording that can be read (.c3d, .trc or .csv)"


def _no_set(recordings: Sequence[Recording], own: Sequence[tuple[str, object]]) -> str:
    labels = list(dict.fromkeys(label for r in recordings for label in r.labels))
    shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
    return (
        f"no marker set knows enough of the labels {shown}; name your own in a TOML file in the folder "
        "(models/markersets has examples), or put the labels right by 'rename' in a study file"
    )


def _refused(folder: Folder, fault: str, told: Mapping[str, str]) -> Draft:
    """What was seen of a folder from which no study follows."""
    seen = tuple(_row(file, reason=told.get(file.name, "")) for file in folder.files)
    return Draft(folder=folder, choice=None, person={}, trials=(), seen=seen, fault=fault)


def _row(file: FolderFile, *, labels: str = "", shows: str = "", used: str = "", reason: str = "") -> Seen:
    frames = None if file.recording is None else len(file.recording.time)
    if file.recording is not None and not labels:
        labels = f"{len(file.recording.labels)}: " + " ".join(file.recording.labels[:8])
    return Seen(
        name=file.name,
        kind=file.kind.value,
        frames=frames,
        labels=labels,
        shows=shows,
        used=used,
        reason=reason or file.reason,
    )


@dataclass(frozen=True)
class _Drafting:
    """What a draft is made of, once marker set and static trial are found."""

    folder: Folder
    files: tuple[FolderFile, ...]
    choice: SetChoice
    spelt: Mapping[int, Recording]
    """Recording -> with the labels of the set."""
    session: Session
    options: Options

    def draft(self) -> Draft:
        """Roles, forces and person."""
        out, moves = dict(self.session.others), self._movements()
        statics = [i for i in self.session.statics if self._is_static(i, moves)]
        for i, j in self._copies(statics):
            out[i] = f"the same recording as {self.files[j].name}"
        statics = [i for i in statics if i not in out]
        statics, problem = self._with_model(statics)
        roles: dict[int, tuple[str, str]] = dict.fromkeys(statics, ("static", ""))
        for i, found in moves.items():
            if i in roles or i in out:
                continue
            if found.shows is Shows.WALKS:
                roles[i] = ("gait", "")
            elif found.shows is Shows.ONE_JOINT:
                roles[i] = ("joint", found.joint)
            else:
                out[i] = f"{found.shows.value}: {found.evidence}; neither standing, walking, nor one joint alone"
        forces, unpaired = self._forces(roles)
        order = sorted(roles, key=lambda i: (_ORDER[roles[i][0]], statics.index(i) if i in statics else 0, i))
        names = _trial_names([self.files[i].path.stem for i in order])
        trials = tuple(
            self._trial(i, name, roles[i], moves.get(i), forces.get(i), statics)
            for i, name in zip(order, names, strict=True)
        )
        if all(trial.role == "static" for trial in trials):
            problem = problem or "no recording shows walking, or one joint that moves alone"
        person = self._person(statics, order)
        seen = self._seen(roles, out, moves, forces, unpaired)
        return Draft(folder=self.folder, choice=self.choice, person=person, trials=trials, seen=seen, problem=problem)

    def _movements(self) -> dict[int, Movement]:
        """Recording of the session -> what it shows."""
        reference = self.session.posture(self.session.statics[0]).stance
        return {
            i: movement(self.spelt[i], self.choice.marker_set, self.session.postures.get(i), reference)
            for i in self.session.members
        }

    def _is_static(self, i: int, moves: Mapping[int, Movement]) -> bool:
        """What only stands; without any such, the one recording that is declared as static, of which a part stands."""
        return moves[i].shows is Shows.STANDS or i == self.session.statics[0]

    def _copies(self, statics: Sequence[int]) -> list[tuple[int, int]]:
        """Recordings that are another one again, and which; one with plates is kept, then one with few strange labels."""

        def worth(i: int) -> tuple[object, ...]:
            recording = self.spelt[i]
            rank = statics.index(i) if i in statics else 0
            strange = len(coverage(self.choice.marker_set, recording.labels).left_over)
            return (not recording.plates, -len(recording.time), strange, rank, i)

        kept: list[int] = []
        copies = []
        for i in sorted(self.session.members, key=worth):
            twin = next((j for j in kept if same_recording(self.spelt[i], self.spelt[j])), None)
            if twin is None:
                kept.append(i)
            else:
                copies.append((i, twin))
        return copies

    def _with_model(self, statics: list[int]) -> tuple[list[int], str]:
        """Static trials, one that gives a model first; and why none does."""
        person = person_of("", self.options, self._facts(statics), None)
        mass, height = (
            float(str(person[f].value)) if f in person else d for f, d in (("mass_kg", 70.0), ("height_m", None))
        )
        if height is None:
            return statics, ""
        subject = Subject("", mass or 70.0, height, self.options.sex or "female")
        fault = ""
        for i in statics:
            try:
                nominal_model(self.spelt[i], self.choice.marker_set, subject)
            except InputError as error:
                fault = fault or str(error)
            else:
                return [i, *(j for j in statics if j != i)], ""
        return statics, fault

    def _facts(self, order: Sequence[int]) -> list[tuple[str, Facts]]:
        rest = [i for i in self.session.members if i not in order]
        return [(self.files[i].name, self.spelt[i].facts) for i in (*order, *rest)]

    def _person(self, statics: Sequence[int], order: Sequence[int]) -> dict[str, Known]:
        plates = None
        for i in statics:
            mass = weighed(self.spelt[i], self.choice.marker_set, self.session.posture(i))
            if mass is not None:
                plates = (self.files[i].name, mass)
                break
        return person_of(
            self.folder.name, self.options, self._facts([*statics, *(i for i in order if i not in statics)]), plates
        )

    def _forces(self, roles: Mapping[int, tuple[str, str]]) -> tuple[dict[int, ForceChoice], dict[str, str]]:
        """Forces of the walks that have no plates of their own."""
        wanted = {
            i: (self.files[i].path.stem, self.spelt[i])
            for i, (role, _) in roles.items()
            if role == "gait" and not self.spelt[i].plates
        }
        return pair_forces(wanted, self.choice.marker_set, self.folder.files)

    def _trial(
        self,
        i: int,
        name: str,
        role: tuple[str, str],
        found: Movement | None,
        forces: ForceChoice | None,
        statics: Sequence[int],
    ) -> DraftTrial:
        reason = "" if found is None else found.evidence
        certain = found is not None and found.certain
        if role[0] == "static":
            posture = self.session.posture(i)
            certain = posture.throughout
            if not certain:
                reason = (
                    f"the file is called static, and from {posture.start:.2f} to {posture.stop:.2f} s somebody stands"
                )
            elif len(statics) > 1:
                reason += "; the best static trial" if i == statics[0] else "; has to agree with the first"
            if extra := self.session.worn_standing(i):
                reason += f"; has {', '.join(extra[:4])}{', ...' if len(extra) > 4 else ''}, worn for standing only"
        elif said := _name_contradicts(self.files[i].path.stem, role):
            reason, certain = f"{reason}; {said}", False
        return DraftTrial(
            name=name, role=role[0], joint=role[1], file=self.files[i], forces=forces, reason=reason, certain=certain
        )

    def _seen(
        self,
        roles: Mapping[int, tuple[str, str]],
        out: Mapping[int, str],
        moves: Mapping[int, Movement],
        forces: Mapping[int, ForceChoice],
        unpaired: Mapping[str, str],
    ) -> tuple[Seen, ...]:
        """One row a file, in the order of the folder."""
        number = {file.name: i for i, file in enumerate(self.files)}
        owner = {choice.file.name: self.files[i].name for i, choice in forces.items()}
        rows = []
        for file in self.folder.files:
            if file.name in number:
                rows.append(self._seen_recording(file, number[file.name], roles, out, moves))
            elif file.kind is FileKind.FORCES:
                used = f"forces of {owner[file.name]}" if file.name in owner else ""
                rows.append(_row(file, used=used, reason="" if used else unpaired.get(file.name, "no walk needs it")))
            elif file.kind is FileKind.EXTERNAL_LOADS:
                table = os.path.basename(file.names.replace("\\", "/"))  # noqa: PTH119
                used = f"says that {table} holds forces" if table in owner else ""
                rows.append(_row(file, used=used, reason="" if used else f"names {table}, which is not used"))
            elif file.kind is FileKind.MARKER_SET:
                chosen = str(file.path) == self.choice.entry
                rows.append(
                    _row(file, used="marker set" * chosen, reason="" if chosen else "another set knows more labels")
                )
            elif file.kind is FileKind.CORNERS:
                rows.append(_row(file, used="corners of the plates in the table of forces beside it"))
            elif file.kind is FileKind.STUDY:
                rows.append(_row(file, reason="a study file; it is not looked into"))
            else:
                rows.append(_row(file))
        return tuple(rows)

    def _seen_recording(
        self,
        file: FolderFile,
        i: int,
        roles: Mapping[int, tuple[str, str]],
        out: Mapping[int, str],
        moves: Mapping[int, Movement],
    ) -> Seen:
        labels = file.recording.labels if file.recording is not None else ()
        found = coverage(self.choice.marker_set, respelt(labels, self.choice.rename))
        counts = f"{len(found.known)} of {len(labels)} known"
        if i not in self.spelt:
            reason = f"not of marker set {self.choice.entry}: has {' '.join(labels[:6])}{' ...' * (len(labels) > 6)}"
            return _row(file, labels=counts, reason=reason)
        shows = moves[i].shows.value if i in moves else ""
        used = " ".join(filter(None, roles.get(i, ())))
        reason = out.get(i, "") or (moves[i].evidence if i in moves else "")
        return _row(file, labels=counts, shows=shows, used=used, reason=reason)


_ORDER = {"static": 0, "joint": 1, "gait": 2}
_JOINT_WORD = re.compile(r"(hip|knee|ankle)(?![a-z]*cent)", re.IGNORECASE)


def _name_contradicts(stem: str, role: tuple[str, str]) -> str:
    """What a file's name says against its role; empty where it says nothing."""
    word = _JOINT_WORD.search(stem)
    if word is None:
        return ""
    name = word.group(1).lower()
    if role[0] == "joint" and role[1].startswith(name):
        return ""
    return f"though its name says {name}"


def _trial_names(stems: Sequence[str]) -> list[str]:
    """Names of trials from those of files: safe as file names, and each once whatever the case."""
    out: list[str] = []
    for stem in stems:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:60] or "trial"
        if re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)", plain, re.IGNORECASE):
            plain += "_"
        name, count = plain, 1
        while name.lower() in {other.lower() for other in out}:
            count += 1
            name = f"{plain}_{count}"
        out.append(name)
    return out
