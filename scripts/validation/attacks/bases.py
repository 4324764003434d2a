"""The clean studies that are attacked: short ones, a static trial, a walk named `walk`, and an isolated trial or two.

Made people and real ones, men, women and a child, with and without medial markers, force plates and a trunk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from gaitcal import Recording, Study, synthesize
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Joint, load_study_file
from gaitcal.study.study_trial import StudyTrial
from scripts.validation.recordings import CHILDREN, EVERYBODY, JOINTS, WALK

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

    def changed(trial: StudyTrial) -> StudyTrial:
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
