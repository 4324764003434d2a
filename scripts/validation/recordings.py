"""Every real person of the data folder, in one list (`recordings.toml`), and the studies that
follow.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

from gaitcal import Study, synthesize
from gaitcal.cli.console import Console
from gaitcal.cli.study_folder import check_person_options, find_or_draft_study
from gaitcal.intake.draft_file import build_study
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.io.toml import tomllib
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import (
    Joint,
    Markers,
    StudyFile,
    SubjectTable,
    TrialTable,
    load_study_file,
)
from gaitcal.study.study_trial import Role


def write_folder(
    folder: Path,
    recordings: Mapping[str, Recording],
    subject: tuple[str, float, float, str],
    settings: CalibrationSettings | None = None,
    plates: Mapping[str, str] | None = None,
) -> Path:
    """Write `static`, isolated trials named for their joints and gait trials as C3D files, and
    their study file.

    `subject`: name, kg, m, sex. `plates`: which foot is on which plate of the gait trials. Returns
    the study file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    trials = []
    for name, recording in recordings.items():
        write_c3d(folder / f"{name}.c3d", recording)
        role = "static" if name == "static" else "joint" if name in ISOLATED_JOINTS else "gait"
        more = (
            {"joint": name}
            if role == "joint"
            else {"plates": dict(plates)}
            if role == "gait" and plates
            else {}
        )
        trials.append(TrialTable(name=name, role=role, file=Path(f"{name}.c3d"), **more))  # type: ignore[arg-type]
    table = SubjectTable(**dict(zip(("name", "mass_kg", "height_m", "sex"), subject, strict=True)))  # type: ignore[arg-type]
    given = {} if settings is None else {"calibration": settings}
    study = StudyFile(subject=table, markers=Markers(set="published"), trial=tuple(trials), **given)  # type: ignore[arg-type]
    (folder / "study.toml").write_text(study.to_toml(), encoding="utf-8")
    return folder / "study.toml"


HERE = Path(__file__).resolve().parent
WALK = "walk"
"""Name of the gait trial of a study that names its files."""
JOINTS: tuple[Joint, ...] = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")


@dataclass(frozen=True, kw_only=True)
class Person:
    name: str
    mass: float
    """kg."""
    height: float
    """m."""
    sex: str
    files: tuple[str, ...]
    """Below the data folder."""
    markers: str
    """Marker set of a study that names its files."""
    told: tuple[str, ...] = ("sex",)
    drafted: bool = True
    """Whether a study follows from the bare folder."""

    def _words(self, told: bool) -> tuple[str, ...]:
        every = ("mass", "height", "sex")
        return tuple(
            w for k in every if (k in self.told) is told for w in (f"--{k}", str(getattr(self, k)))
        )

    @property
    def options(self) -> tuple[str, ...]:
        """What the command is told, as no file holds it."""
        return self._words(True)

    @property
    def facts(self) -> tuple[str, ...]:
        """What the files hold, but a variant may take away."""
        return self._words(False)

    def copy(self, folder: Path) -> None:
        for file in self.files:
            shutil.copyfile(data() / file, folder / Path(file).name)

    def recorded(self, walk: str = "", joints: Sequence[Joint] = ()) -> Callable[[Path], Path]:
        """What writes a study that names these files: static and isolated trials, and the walk of
        that name or the only one.
        """
        stems = {Path(file).stem: file for file in self.files}
        static = next(file for stem, file in stems.items() if stem.endswith("static"))
        forces = next((file for file in self.files if file.endswith(".mot")), None)
        walks = {
            stem: file
            for stem, file in stems.items()
            if file not in (static, forces) and stem not in JOINTS
        }

        def make(folder: Path) -> Path:
            trials = [TrialTable(name="static", role="static", file=data() / static)]
            trials += [
                TrialTable(name=j, role="joint", joint=j, file=data() / stems[j]) for j in joints
            ]
            if walks:
                file = walks[walk] if walk else next(iter(walks.values()))
                given = data() / forces if forces else None
                trials.append(TrialTable(name=WALK, role="gait", file=data() / file, forces=given))
            table = SubjectTable(
                name="person", mass_kg=self.mass, height_m=self.height, sex=self.sex
            )  # type: ignore[arg-type]
            chosen = Markers(
                set=self.markers.replace("{data}", str(data())).replace("{here}", str(HERE)),
                rename={},
            )
            path = folder / "study.toml"
            study = StudyFile(subject=table, markers=chosen, trial=tuple(trials))
            path.write_text(study.to_toml(), encoding="utf-8")
            return path

        return make


def data() -> Path:
    """The folder of real recordings; SystemExit where the environment does not name it."""
    named = os.environ.get("GAITCAL_DATA")
    if not named:
        raise SystemExit(
            "real recordings are needed: set the environment variable GAITCAL_DATA to their folder"
        )
    return Path(named).resolve()


def _everybody() -> dict[str, Person]:
    rows = tomllib.loads((HERE / "recordings.toml").read_text(encoding="utf-8")).items()
    listed = ("files", "told")
    return {
        n: Person(name=n, **{k: tuple(v) if k in listed else v for k, v in row.items()})
        for n, row in rows
    }


EVERYBODY = _everybody()
CLINICS = {name: person for name, person in EVERYBODY.items() if person.drafted}
"""Bare folders, from which a study follows."""
SIMULATED = ("p01", "p18")
"""People whose walk OpenSim made."""
PEOPLE = tuple(name for name in EVERYBODY if name not in ("multi2", *SIMULATED))
"""`multi2` is `multi` again."""
CHILDREN = tuple(name for name in EVERYBODY if name.startswith("HC"))


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Where copies of recordings lie as long as the process does: curves are read from
    them again.
    """
    return tempfile.TemporaryDirectory()


@lru_cache(maxsize=32)
def study_of_person(name: str) -> Study:
    """All recordings of a person, drafted from the bare folder; or the study file of that path."""
    if name not in PEOPLE:
        return Study.load(name)
    folder, person = Path(_folder().name) / name, EVERYBODY[name]
    folder.mkdir()
    if not person.drafted:
        return Study.load(person.recorded()(folder))
    person.copy(folder)
    options = check_person_options(person.mass, person.height, person.sex, None)
    draft = find_or_draft_study(folder, options, Console(quiet=True, verbose=False))
    return Study.load(draft) if isinstance(draft, Path) else build_study(draft)


def changed(study: Study, settings: Mapping[str, object]) -> Study:
    told = study.settings.model_dump(exclude_unset=True) | dict(settings)
    return replace(study, settings=type(study.settings).model_validate(told))


def only(study: Study, *names: str) -> Study:
    """The static trial and these, or trials of these roles."""
    chosen = (
        t for t in study.trials if t.role is Role.STATIC or t.name in names or t.role.value in names
    )
    return replace(study, trials=tuple(chosen))


Make: TypeAlias = Callable[[Path], Path]
"""Writes the study file of a clean study into a folder and returns it."""
SYNTHETIC = "synthetic"


def _synthesized(seed: int, *, exact: bool = False, joints: tuple[str, ...] = JOINTS) -> Make:
    """As `gaitcal synthesize` writes it, with the default settings of a user's own study and these
    isolated trials.
    """

    def make(folder: Path) -> Path:
        path = synthesize(folder / "study", seed=seed, noise=not exact, perturb=not exact)
        study = load_study_file(path)
        trials = tuple(
            t.model_copy(update={"name": WALK if t.name == "gait" else t.name})
            for t in study.trials
            if t.joint is None or t.joint in joints
        )
        content = study.model_copy(
            update={"trials": trials, "calibration": CalibrationSettings(), "truth": None}
        )
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
