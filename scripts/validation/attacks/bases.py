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
from scripts.validation.recordings import WALK, recorded

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


_ALL = (
    Base(
        name="subject01",
        make=recorded(
            (72.6, 1.803, "male"),
            "gait2354",
            ("subject01/subject01_walk1.trc", "subject01/subject01_walk1_grf.mot"),
            "subject01/subject01_static.trc",
        ),
    ),
    Base(name=SYNTHETIC, make=_synthesized(SEED, noise=True, perturb=True, joints=("hip_r", "knee_r"))),
    Base(
        name="pig",
        make=recorded((66.5, 1.79, "male"), "plug-in-gait", ("pig_c3d/gait.c3d", None), "pig_c3d/static.c3d"),
    ),
    Base(
        name="kad",
        make=recorded(
            (79.25, 1.624, "female"), "plug-in-gait", ("labs_c3d/kad/walk.c3d", None), "labs_c3d/kad/static.c3d"
        ),
    ),
    Base(
        name="multi",
        make=recorded(
            (53.5, 1.634, "female"), "plug-in-gait", ("labs_c3d/multi/walk03.c3d", None), "labs_c3d/multi/static.c3d"
        ),
    ),
    Base(
        name="child",
        make=recorded(
            (32.1, 1.45, "male"), "plug-in-gait", ("children/HC002D/straight.c3d", None), "children/HC002D/static.c3d"
        ),
    ),
    Base(
        name="uf3",
        make=recorded(
            (68.17, 1.70, "male"),
            "rcnl",
            ("uf3/gait.trc", None),
            "uf3/static.trc",
            {"hip_r": "uf3/hip_r.trc", "knee_r": "uf3/knee_r.trc"},
        ),
    ),
    *(
        Base(
            name=person,
            make=recorded(
                subject,
                "{data}/opensim_truth/markerset.toml",
                (f"opensim_truth/{person}/walk.trc", f"opensim_truth/{person}/grf.mot"),
                f"opensim_truth/{person}/static.trc",
            ),
        )
        for person, subject in (("p01", (72.84, 1.808, "male")), ("p18", (64.09, 1.775, "male")))
    ),
    Base(
        name="functional",
        make=recorded(
            (66.0, 1.72, "female"),
            "conventional73",
            None,
            "functional_c3d/static.c3d",
            {"hip_r": "functional_c3d/hip_r.c3d", "knee_r": "functional_c3d/knee_r.c3d"},
        ),
    ),
)
BASES = {base.name: base for base in _ALL}
"""Those that are attacked."""

CHILDREN = {"HC030A": (45.8, 1.48), "HC031A": (27.7, 1.33), "HC032A": (60.3, 1.58)}
"""Folder -> kg, m, as the files tell; the sex is not told."""
_JOINTS: tuple[Joint, ...] = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")

_MORE = (
    Base(name="synthetic exact", make=_synthesized(1, noise=False, perturb=False)),
    *(Base(name=f"synthetic {seed}", make=_synthesized(seed, noise=True, perturb=True)) for seed in (2, 3)),
    *(
        Base(
            name=f"multi {walk}",
            make=recorded(
                (53.5, 1.634, "female"),
                "plug-in-gait",
                (f"labs_c3d/multi/{walk}.c3d", None),
                "labs_c3d/multi/static.c3d",
            ),
        )
        for walk in ("walk04", "walk05", "walk06", "walk07")
    ),
    *(
        Base(
            name=f"child {child} {walk}",
            make=recorded(
                (mass, height, "male"),
                "plug-in-gait",
                (f"children/{child}/{walk}.c3d", None),
                f"children/{child}/static.c3d",
            ),
        )
        for child, (mass, height) in ({"HC002D": (32.1, 1.45)} | CHILDREN).items()
        for walk in ("straight", "turn")
        if (child, walk) != ("HC002D", "straight")
    ),
    Base(
        name="uf3 whole",
        make=recorded(
            (68.17, 1.70, "male"),
            "rcnl",
            ("uf3/gait.trc", None),
            "uf3/static.trc",
            {j: f"uf3/{j}.trc" for j in _JOINTS},
        ),
    ),
)
EVERY = BASES | {base.name: base for base in _MORE}
"""With those that are only looked at as they are."""
