"""Every real person of the data folder, in one list: which files, what no file holds, and the study that follows."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from gaitcal import Study
from gaitcal.commands.console import Talk
from gaitcal.commands.init import options_of, study_or_draft
from gaitcal.intake.draft_text import study_of
from gaitcal.study.study_file import Joint, Markers, StudyFile, SubjectTable, Trial
from gaitcal.study.study_trial import Role

WALK = "walk"
"""Name of the gait trial of a recorded study."""
SIMULATED = ("p01", "p18")
"""Folders of `opensim_truth`: people whose walk OpenSim made."""


@dataclass(frozen=True)
class Clinic:
    """One folder of recordings."""

    name: str
    files: tuple[str, ...]
    """Below the data folder."""
    options: tuple[str, ...]
    """What the command is told, as no file holds it."""
    facts: tuple[str, ...] = ()
    """Mass and height, where the files hold them but a variant takes them away."""

    def copy(self, folder: Path) -> None:
        """The files into an empty folder."""
        for file in self.files:
            shutil.copyfile(data() / file, folder / Path(file).name)


def data() -> Path:
    """The folder of real recordings; SystemExit where the environment does not name it."""
    named = os.environ.get("GAITCAL_DATA")
    if not named:
        raise SystemExit("real recordings are needed: set the environment variable GAITCAL_DATA to their folder")
    return Path(named).resolve()


def _child(name: str, sex: str, mass: str, height: str) -> Clinic:
    files = tuple(f"children/{name}/{file}.c3d" for file in ("static", "straight", "turn"))
    return Clinic(name, files, ("--sex", sex), ("--mass", mass, "--height", height))


CLINICS = {
    clinic.name: clinic
    for clinic in (
        Clinic(
            "pig", ("pig_c3d/static.c3d", "pig_c3d/gait.c3d"), ("--sex", "male"), ("--mass", "66.5", "--height", "1.79")
        ),
        Clinic(
            "kad",
            ("labs_c3d/kad/static.c3d", "labs_c3d/kad/walk.c3d"),
            ("--sex", "male"),
            ("--mass", "79.25", "--height", "1.624"),
        ),
        Clinic(
            "multi",
            ("labs_c3d/multi/static.c3d", *(f"labs_c3d/multi/walk0{k}.c3d" for k in (3, 4, 5, 6, 7))),
            ("--sex", "female"),
            ("--mass", "53.5", "--height", "1.634"),
        ),
        Clinic(
            "multi2",
            ("labs_c3d/multi/static.c3d", *(f"labs_c3d/multi/walk0{k}.c3d" for k in (3, 6))),
            ("--sex", "female"),
            ("--mass", "53.5", "--height", "1.634"),
        ),
        _child("HC002D", "female", "32.1", "1.45"),
        _child("HC030A", "male", "45.8", "1.48"),
        _child("HC031A", "female", "27.7", "1.33"),
        _child("HC032A", "male", "60.3", "1.58"),
        Clinic(
            "functional",
            ("functional_c3d/static.c3d", "functional_c3d/hip_r.c3d", "functional_c3d/knee_r.c3d"),
            ("--mass", "65", "--height", "1.68", "--sex", "female"),
        ),
        Clinic(
            "subject01",
            tuple(f"subject01/{f}" for f in ("subject01_static.trc", "subject01_walk1.trc", "subject01_walk1_grf.mot")),
            ("--mass", "72.6", "--height", "1.803", "--sex", "male"),
        ),
        Clinic(
            "uf3",
            tuple(
                f"uf3/{f}.trc" for f in ("static", "gait", "hip_r", "hip_l", "knee_r", "knee_l", "ankle_r", "ankle_l")
            ),
            ("--mass", "68.17", "--height", "1.70", "--sex", "male"),
        ),
    )
}


def recorded(
    subject: tuple[float, float, str],
    markers: str,
    walk: tuple[str, str | None] | None,
    static: str,
    joints: dict[Joint, str] | None = None,
    rename: dict[str, str] | None = None,
) -> Callable[[Path], Path]:
    """A study of files in the data folder."""

    def make(folder: Path) -> Path:
        mass, height, sex = subject
        trials = [Trial(name="static", role="static", file=data() / static)]
        trials += [Trial(name=j, role="joint", joint=j, file=data() / f) for j, f in (joints or {}).items()]
        if walk:
            forces = data() / walk[1] if walk[1] else None
            trials.append(Trial(name=WALK, role="gait", file=data() / walk[0], forces=forces))
        path = folder / "study.toml"
        chosen = markers.replace("{data}", str(data()))
        file = StudyFile(
            subject=SubjectTable(name="person", mass_kg=mass, height_m=height, sex=sex),  # type: ignore[arg-type]
            markers=Markers(set=chosen, rename=rename or {}),
            trial=tuple(trials),
        )
        path.write_text(file.to_toml(), encoding="utf-8")
        return path

    return make


_MARKER_SETS = Path(__file__).parent / "marker_sets"
OTHERS = {
    "one_frame": recorded(
        (67.0, 1.655, "male"),
        str(_MARKER_SETS / "one_frame.toml"),
        ("more_labs/one_frame_static/walk.c3d", None),
        "more_labs/one_frame_static/static.c3d",
    ),
    "mt_feet": recorded(
        (68.0, 1.65, "female"),  # nobody tells them: by force plates and markers
        str(_MARKER_SETS / "mt_feet.toml"),
        ("more_labs/mt_feet/walk.trc", "more_labs/mt_feet/walk_grf.mot"),
        "more_labs/mt_feet/static.trc",
    ),
}
"""People whose folders no study follows from."""
PEOPLE = (*(name for name in CLINICS if name != "multi2"), *OTHERS)
"""`multi2` is `multi` again."""
CHILDREN = ("HC002D", "HC030A", "HC031A", "HC032A")


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Where copies of recordings lie as long as the process does: curves are read from them again."""
    return tempfile.TemporaryDirectory()


@lru_cache(maxsize=32)
def study_of_person(name: str) -> Study:
    """All recordings of a person, drafted from the bare folder; or the study file of that path."""
    if name not in PEOPLE:
        return Study.load(name)
    folder = Path(_folder().name) / name
    folder.mkdir()
    if name in OTHERS:
        return Study.load(OTHERS[name](folder))
    person = CLINICS[name]
    words = (*person.options, *person.facts)
    told = dict(zip(words[::2], words[1::2], strict=True))
    person.copy(folder)
    options = options_of(float(told["--mass"]), float(told["--height"]), told.get("--sex"), None)
    draft = study_or_draft(folder, options, Talk(quiet=True, verbose=False))
    return Study.load(draft) if isinstance(draft, Path) else study_of(draft)


def changed(study: Study, settings: Mapping[str, object]) -> Study:
    """The study with these settings of `[calibration]`."""
    told = study.settings.model_dump(exclude_unset=True) | dict(settings)
    return replace(study, settings=type(study.settings).model_validate(told))


def only(study: Study, *names: str) -> Study:
    """The static trial and these, or trials of these roles."""
    chosen = (t for t in study.trials if t.role is Role.STATIC or t.name in names or t.role.value in names)
    return replace(study, trials=tuple(chosen))
