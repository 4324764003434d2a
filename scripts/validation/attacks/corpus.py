"""The table of attacks (`corpus.toml`), and the study that each makes of a clean one."""

from __future__ import annotations

import re
import shlex
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path

from gaitcal import MarkerSet, Study
from gaitcal.io.toml import tomllib
from gaitcal.study.study_file import load_study_file
from scripts.validation.attacks import spoil_markers, spoil_plates, spoil_studies
from scripts.validation.recordings import BASES, WALK, loaded


class Kind(str, Enum):
    STATIC = "static trial"
    WALK = "markers of the walk"
    ISOLATED = "isolated trial"
    FORCES = "forces"
    SUBJECT = "subject"
    STUDY = "study"
    FILE = "file"


class CorpusError(Exception):
    """An attack that cannot be made."""


@dataclass(frozen=True)
class Attack:
    name: str
    base: str
    kind: Kind
    where: str
    how: str
    named: tuple[str, ...]
    """Regular expressions, letter case ignored, that one new message must match, all of them, to
    name the cause. `{x}` in them stands for the labels of landmark, segment or marker x in the
    marker set of the base (`pattern`)."""
    quick: bool = False
    """Whether it belongs to the part that runs as a test."""

    @property
    def title(self) -> str:
        return f"{self.base}: {self.kind.value}: {self.name}"

    @property
    def other_frames(self) -> bool:
        """Whether the trial's frames are no longer those of the clean run, and are not compared one
        by one.
        """
        return self.kind is Kind.ISOLATED and self.how == "backwards"


JOINTS_OF = {"thigh": "hip|knee", "shank": "knee|ankle", "foot": "ankle"}
LANDMARKS = {
    "knee": "knee",
    "ankle": "ankle|malleol",
    "asis": "asis|pelvi",
    "heel": "heel",
    "toe": "toe",
}
SIDES = {"r": "right", "l": "left"}


def _cluster(segment: str) -> str:
    """Words for the markers of a segment: it, its labels, or a joint at its ends, where the next
    segment may be it.
    """
    name, _, side = segment.partition("_")
    return f"{segment}|{{{segment}}}|{SIDES[side]} ({name}|{JOINTS_OF[name]})"


def _landmark(key: str) -> str:
    """Words for a landmark: its labels, or the joint with its side."""
    name, _, side = key.rpartition("_")
    words, of = LANDMARKS[name.split("_")[0]], SIDES[side]
    return f"{{{key}}}|({of}|both).*({words})|({words}).*({of}|both)"


def corpus() -> tuple[Attack, ...]:
    """All attacks on all bases, each title once."""
    table = tomllib.loads((Path(__file__).parent / "corpus.toml").read_text(encoding="utf-8"))
    makers: dict[str, Callable[[str], str]] = {"cluster": _cluster, "landmark": _landmark}

    def expanded(words: str) -> str:
        words = re.sub(r"\{([A-Z]+)\}", lambda m: expanded(table["words"][m[1]]), words)
        return re.sub(r"\{(cluster|landmark) (\w+)\}", lambda m: makers[m[1]](m[2]), words)

    every = tuple(
        Attack(
            name,
            base.rstrip("*"),
            kind,
            where,
            how,
            tuple(map(expanded, named)),
            base.endswith("*"),
        )
        for kind in Kind
        for name, bases, where, how, *named in table["attacks"][kind.value]
        for base in bases.split()
    )
    doubled = [title for title, count in Counter(a.title for a in every).items() if count > 1]
    if doubled:
        raise CorpusError(f"two attacks have one title: {', '.join(doubled)}")
    return every


def once_each(attacks: tuple[Attack, ...]) -> Iterator[Attack]:
    """Each attack on one of its bases: the first, the second, ... in turn, so that all bases have
    their share.
    """
    rows: dict[tuple[str, str], list[Attack]] = {}
    for attack in attacks:
        rows.setdefault((attack.kind, attack.name), []).append(attack)
    for turn, row in enumerate(rows.values()):
        yield row[turn % len(row)]


@cache
def by_title() -> dict[str, Attack]:
    """An attack can be sent to another process by its title."""
    return {attack.title: attack for attack in corpus()}


def pattern(words: str, markers: MarkerSet) -> str:
    """The regular expression `words` with each `{key}` put as any of its labels."""

    def labels(found: re.Match[str]) -> str:
        return (
            "(?:"
            + "|".join(re.escape(label) for label in spoil_markers.labels_of(markers, found[1]))
            + ")"
        )

    return re.sub(r"\{([^}]*)\}", labels, words)


def spoilt(attack: Attack, folder: Path) -> Callable[[], Study]:
    """What reads the study after the attack; what the attack itself raises is a fault of the
    corpus.

    Raises
    ------
    CorpusError
        The attack itself fails.
    """
    try:
        if attack.kind is not Kind.FILE:
            study = loaded(attack.base)
            for name, words in _calls(attack.how):
                study = _changed(study, attack.where, name, words)
            return lambda: study
        path = with_files(BASES[attack.base](folder))
        (file,) = path.parent.glob(attack.where)
        for name, words in _calls(attack.how):
            getattr(spoil_studies, name)(file, *words)
    except Exception as fault:
        raise CorpusError(f"{attack.title}: the attack itself failed") from fault
    return lambda: Study.load(path)


def _calls(how: str) -> Iterator[tuple[str, list[object]]]:
    """`exchanged heel_r toe_r 0.4,0.6; ...`: names of functions, and what each is given."""
    for call in how.split("; "):
        name, *words = shlex.split(call)
        yield name, [_value(word) for word in words]


def _value(word: str) -> object:
    """A number, a tuple of numbers with commas between, or the word itself."""
    try:
        numbers = [float(part) if "." in part else int(part) for part in word.split(",")]
    except ValueError:
        return word
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def _changed(study: Study, where: str, name: str, words: list[object]) -> Study:
    """The study after one function of a `spoil_` module."""
    if where == "study":
        out: Study = getattr(spoil_studies, name)(study, *words)
        return out
    if where.startswith("plate"):
        function, walk = getattr(spoil_plates, name), spoil_studies.recording_of(study, WALK)
        struck = where.removeprefix("plate ")
        plates = (
            function(p, *words) if struck in ("plates", str(k)) else p
            for k, p in enumerate(walk.plates, 1)
        )
        return spoil_studies.with_trial(study, WALK, recording=replace(walk, plates=tuple(plates)))
    function, moving = getattr(spoil_markers, name), [t.name for t in study.moving]
    for trial in study.trials:
        if where in ("every", trial.name) or (where == "moving" and trial.name in moving):
            recording = function(trial.recording, study.marker_set, *words)
            study = spoil_studies.with_trial(study, trial.name, recording=recording)
    return study


def with_files(study: Path) -> Path:
    """The study file with all its recordings copied beside it, each under the name of its trial."""
    file = load_study_file(study)
    folder = study.parent
    trials = []
    for trial in file.trials:
        update: dict[str, Path] = {}
        for key, stem in (("file", trial.name), ("forces", f"{trial.name}_forces")):
            source: Path | None = getattr(trial, key)
            if source is not None:
                update[key] = folder / f"{stem}{source.suffix}"
                if source != update[key]:
                    shutil.copyfile(source, update[key])
        trials.append(trial.model_copy(update=update))
    study.write_text(
        file.model_copy(update={"trials": tuple(trials)}).to_toml(folder), encoding="utf-8"
    )
    return study
