"""Every real person of the data folder, in one list (`recordings.toml`), and the studies that follow."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from gaitcal import Study
from gaitcal.cli.console import Console
from gaitcal.cli.folder import options_of, study_or_draft
from gaitcal.io.toml import tomllib
from gaitcal.session.draft import study_of
from gaitcal.study.study_file import Joint, Markers, StudyFile, SubjectTable, TrialTable
from gaitcal.study.study_trial import Role

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
        return tuple(w for k in every if (k in self.told) is told for w in (f"--{k}", str(getattr(self, k))))

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
        """What writes a study that names these files: static and isolated trials, and the walk of that name or the
        only one.
        """
        stems = {Path(file).stem: file for file in self.files}
        static = next(file for stem, file in stems.items() if stem.endswith("static"))
        forces = next((file for file in self.files if file.endswith(".mot")), None)
        walks = {stem: file for stem, file in stems.items() if file not in (static, forces) and stem not in JOINTS}

        def make(folder: Path) -> Path:
            trials = [TrialTable(name="static", role="static", file=data() / static)]
            trials += [TrialTable(name=j, role="joint", joint=j, file=data() / stems[j]) for j in joints]
            if walks:
                file = walks[walk] if walk else next(iter(walks.values()))
                given = data() / forces if forces else None
                trials.append(TrialTable(name=WALK, role="gait", file=data() / file, forces=given))
            table = SubjectTable(name="person", mass_kg=self.mass, height_m=self.height, sex=self.sex)  # type: ignore[arg-type]
            chosen = Markers(set=self.markers.replace("{data}", str(data())).replace("{here}", str(HERE)), rename={})
            path = folder / "study.toml"
            study = StudyFile(subject=table, markers=chosen, trial=tuple(trials))
            path.write_text(study.to_toml(), encoding="utf-8")
            return path

        return make


def data() -> Path:
    """The folder of real recordings; SystemExit where the environment does not name it."""
    named = os.environ.get("GAITCAL_DATA")
    if not named:
        raise SystemExit("real recordings are needed: set the environment variable GAITCAL_DATA to their folder")
    return Path(named).resolve()


def _everybody() -> dict[str, Person]:
    rows = tomllib.loads((HERE / "recordings.toml").read_text(encoding="utf-8")).items()
    listed = ("files", "told")
    return {n: Person(name=n, **{k: tuple(v) if k in listed else v for k, v in row.items()}) for n, row in rows}


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
    """Where copies of recordings lie as long as the process does: curves are read from them again."""
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
    options = options_of(person.mass, person.height, person.sex, None)
    draft = study_or_draft(folder, options, Console(quiet=True, verbose=False))
    return Study.load(draft) if isinstance(draft, Path) else study_of(draft)


def changed(study: Study, settings: Mapping[str, object]) -> Study:
    told = study.settings.model_dump(exclude_unset=True) | dict(settings)
    return replace(study, settings=type(study.settings).model_validate(told))


def only(study: Study, *names: str) -> Study:
    """The static trial and these, or trials of these roles."""
    chosen = (t for t in study.trials if t.role is Role.STATIC or t.name in names or t.role.value in names)
    return replace(study, trials=tuple(chosen))
