"""What an attack is, the clean studies that are attacked, and what a run says.

Clean studies are short: a static trial, a walk named `walk`, and an isolated trial or two, of made people and real
ones, men, women and a child, with and without medial markers, force plates and a trunk.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

from gaitcal import Calibration, Recording, Study, synthesize
from gaitcal.faults.verdict import Judgement
from gaitcal.findings import Finding, Severity
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Joint, load_study_file
from gaitcal.study.study_trial import Trial
from scripts.validation.recordings import CHILDREN, EVERYBODY, JOINTS, WALK

StudyChange: TypeAlias = Callable[[Study], Study]
"""The study with its data spoilt. May raise what reading spoilt files raises."""
FileChange: TypeAlias = Callable[[Path], None]
"""Spoils the files of a study in the folder of its `study.toml`, in place."""


class Kind(str, Enum):
    """What is spoilt."""

    STATIC = "static trial"
    WALK = "markers of the walk"
    ISOLATED = "isolated trial"
    FORCES = "forces"
    SUBJECT = "subject"
    STUDY = "study"
    FILE = "file"


class Ending(str, Enum):
    """How an attack ended, the best first."""

    REFUSED = "refused"
    """An error stops the run."""
    NAMED = "named"
    """A new message names the cause."""
    HARMLESS = "harmless"
    """Nothing new is said, and every result holds within the error bars of its own run."""
    ALARMED = "alarmed"
    """Something new is said, and the cause is not named."""
    SILENT = "silent"
    """Nothing new is said, and a result moved by more than its own error bar."""
    CRASH = "crash"
    """An exception that no user should see."""


@dataclass(frozen=True, kw_only=True)
class Attack:
    """One corruption of one clean study."""

    name: str
    base: str
    kind: Kind
    change: StudyChange | FileChange
    named: tuple[str, ...]
    """Regular expressions, letter case ignored, that one new message must match, all of them, to name the cause. `{x}`
    in them stands for the labels of landmark, segment or marker x in the marker set of the base (`markers.pattern`)."""
    other_frames: tuple[str, ...] = ()
    """Trials whose frames are no longer those of the clean run: not compared frame by frame."""
    of_files: bool = False
    """Whether `change` spoils files."""
    quick: bool = False
    """Whether it belongs to the part that runs as a test."""

    @property
    def title(self) -> str:
        """Unique in the corpus."""
        return f"{self.base}: {self.kind.value}: {self.name}"


@dataclass(frozen=True, kw_only=True)
class Result:
    """How one attack ended."""

    attack: str
    """Its title."""
    kind: Kind
    ending: Ending
    messages: tuple[str, ...] = ()
    """What was said that is new, or the error."""
    moved: float | None = None
    """Largest movement of a result, in error bars; None where no result was made or none can be compared."""
    where: str = ""
    """Which result that is, and how far in its own unit."""
    seconds: float = 0.0
    cause_told: bool = True
    """Whether the error of a refused study names the cause."""


SEED = 1
"""Of the synthetic person."""
SYNTHETIC = "synthetic"


@dataclass(frozen=True, kw_only=True)
class Base:
    """A clean study, as files."""

    name: str
    make: Callable[[Path], Path]
    """Writes the study file into a folder and returns it."""

    @property
    def study(self) -> Study:
        """The study, read once in each process."""
        return loaded(self.name)


@lru_cache(maxsize=16)
def loaded(name: str) -> Study:
    """The clean study of that name."""
    base = EVERY[name]
    with tempfile.TemporaryDirectory() as folder:
        return Study.load(base.make(Path(folder)))


def _synthesized(seed: int, *, noise: bool, perturb: bool, joints: tuple[str, ...] = ()) -> Callable[[Path], Path]:
    """As `gaitcal synthesize` writes it, with the default settings of a user's own study; all joints, or these."""

    def make(folder: Path) -> Path:
        path = synthesize(folder / "study", seed=seed, noise=noise, perturb=perturb)
        study = load_study_file(path)
        trials = tuple(
            t.model_copy(update={"name": WALK if t.name == "gait" else t.name})
            for t in study.trials
            if not joints or t.joint is None or t.joint in joints
        )
        content = study.model_copy(update={"trials": trials, "calibration": CalibrationSettings(), "truth": None})
        path.write_text(content.to_toml(path.parent), encoding="utf-8")
        return path

    return make


def with_recording(study: Study, name: str, recording: Recording) -> Study:
    """The study with another recording of one trial."""

    def changed(trial: Trial) -> Trial:
        return replace(trial, recording=recording) if trial.name == name else trial

    return replace(study, trials=tuple(changed(t) for t in study.trials))


def _recorded(name: str, person: str = "", walk: str = "", joints: tuple[Joint, ...] = (), **told: object) -> Base:
    """Of a person of `recordings.toml`, told otherwise in some things."""
    somebody = replace(EVERYBODY[person or name], **told)  # type: ignore[arg-type]
    return Base(name=name, make=somebody.recorded(walk, joints))


_ALL = (
    _recorded("subject01"),
    Base(name=SYNTHETIC, make=_synthesized(SEED, noise=True, perturb=True, joints=("hip_r", "knee_r"))),
    _recorded("pig"),
    _recorded("kad", sex="female"),
    _recorded("multi", walk="walk03"),
    _recorded("child", "HC002D", "straight", sex="male"),
    _recorded("uf3", joints=("hip_r", "knee_r")),
    _recorded("p01"),
    _recorded("p18"),
    _recorded("functional", joints=("hip_r", "knee_r"), mass=66.0, height=1.72),
)
BASES = {base.name: base for base in _ALL}
"""Those that are attacked."""
_MORE = (
    Base(name="synthetic exact", make=_synthesized(1, noise=False, perturb=False)),
    *(Base(name=f"synthetic {seed}", make=_synthesized(seed, noise=True, perturb=True)) for seed in (2, 3)),
    *(_recorded(f"multi {walk}", "multi", walk) for walk in ("walk04", "walk05", "walk06", "walk07")),
    *(
        _recorded(f"child {child} {walk}", child, walk, sex="male")
        for child in CHILDREN
        for walk in ("straight", "turn")
        if (child, walk) != ("HC002D", "straight")
    ),
    _recorded("uf3 whole", "uf3", joints=JOINTS),
)
EVERY = BASES | {base.name: base for base in _MORE}
"""With those that are only looked at as they are."""


def errors_of(findings: Sequence[Finding]) -> tuple[str, ...]:
    """The errors among what the checks found: they stop the run."""
    return tuple(f"{f.where}: {f.topic}: {f.evidence}; {f.cure}" for f in findings if f.severity is Severity.ERROR)


def refusal(calibration: Calibration) -> tuple[str, ...]:
    """Why a finished calibration is refused; empty where it is not."""
    verdict = calibration.verdict
    if verdict.judgement is not Judgement.REFUSED:
        return ()
    return tuple(reason.line for reason in verdict.reasons if reason.severity is Severity.ERROR)


def warned(calibration: Calibration) -> tuple[str, ...]:
    """Everything that is said to a user who gets a result: facts that need no action do not count."""
    late = [f"phase {p.name} did not converge: {p.message}" for p in calibration.phases if not p.converged]
    return (*(reason.line for reason in calibration.verdict.reasons), *late)


def bare(message: str) -> str:
    """A message without its numbers: another number is no new message."""
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", message))


def new(messages: Iterable[str], clean: Iterable[str]) -> tuple[str, ...]:
    """The messages that the clean run does not have."""
    known = {bare(message) for message in clean}
    return tuple(message for message in dict.fromkeys(messages) if bare(message) not in known)


CATCH_ALL = re.compile(r"look at plate positions, force sign and clock|held near nominal values")
"""Sentences that list every possible cause, or that speak of trials which the study has not: they name nothing."""


def names_cause(message: str, patterns: Sequence[str]) -> bool:
    """Whether a message matches all of the patterns."""
    return not CATCH_ALL.search(message) and all(re.search(pattern, message, re.IGNORECASE) for pattern in patterns)
