"""The clean studies that are attacked.

They are short: a static trial, a walk named `walk`, and an isolated trial or two, of made people and real ones, men,
women and a child, with and without medial markers, force plates and a trunk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

from gaitcal import Study, synthesize
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Joint, load_study_file
from scripts.validation.recordings import CHILDREN, EVERYBODY, JOINTS, WALK

Make: TypeAlias = Callable[[Path], Path]
"""Writes the study file of a clean study into a folder and returns it."""
SYNTHETIC = "synthetic"


def _synthesized(seed: int, *, exact: bool = False, joints: tuple[str, ...] = JOINTS) -> Make:
    """As `gaitcal synthesize` writes it, with the default settings of a user's own study and these isolated trials."""

    def make(folder: Path) -> Path:
        path = synthesize(folder / "study", seed=seed, noise=not exact, perturb=not exact)
        study = load_study_file(path)
        trials = tuple(
            t.model_copy(update={"name": WALK if t.name == "gait" else t.name})
            for t in study.trials
            if t.joint is None or t.joint in joints
        )
        content = study.model_copy(update={"trials": trials, "calibration": CalibrationSettings(), "truth": None})
        path.write_text(content.to_toml(path.parent), encoding="utf-8")
        return path

    return make


def _recorded(person: str, walk: str = "", joints: tuple[Joint, ...] = (), **told: object) -> Make:
    """Of a person of `recordings.toml`, told otherwise in some things."""
    return replace(EVERYBODY[person], **told).recorded(walk, joints)  # type: ignore[arg-type]


BASES: dict[str, Make] = {
    "subject01": _recorded("subject01"),
    SYNTHETIC: _synthesized(1, joints=("hip_r", "knee_r")),
    "pig": _recorded("pig"),
    "kad": _recorded("kad", sex="female"),
    "multi": _recorded("multi", "walk03"),
    "child": _recorded("HC002D", "straight", sex="male"),
    "uf3": _recorded("uf3", joints=("hip_r", "knee_r")),
    "p01": _recorded("p01"),
    "p18": _recorded("p18"),
    "functional": _recorded("functional", joints=("hip_r", "knee_r"), mass=66.0, height=1.72),
}
"""Those that are attacked."""
EVERY: dict[str, Make] = {
    **BASES,
    "synthetic exact": _synthesized(1, exact=True),
    **{f"synthetic {seed}": _synthesized(seed) for seed in (2, 3)},
    **{f"multi walk0{k}": _recorded("multi", f"walk0{k}") for k in (4, 5, 6, 7)},
    **{
        f"child {child} {walk}": _recorded(child, walk, sex="male")
        for child in CHILDREN
        for walk in ("straight", "turn")
        if (child, walk) != ("HC002D", "straight")
    },
    "uf3 whole": _recorded("uf3", joints=JOINTS),
}
"""With those that are only looked at as they are."""


@lru_cache(maxsize=16)
def loaded(name: str) -> Study:
    """The clean study of that name, read once in each process."""
    with tempfile.TemporaryDirectory() as folder:
        return Study.load(EVERY[name](Path(folder)))
