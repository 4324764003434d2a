"""Study files over the real recordings that GAITCAL_DATA names."""

from dataclasses import dataclass
from pathlib import Path

from gaitcal.study.study import Study


@dataclass(frozen=True)
class RealStudy:
    """One person's files."""

    mass: float
    height: float
    sex: str
    markers: str
    trials: tuple[str, ...]
    """Trial tables as text, `{d}` being the folder."""


def _trial(name: str, role: str, file: str, **more: str) -> str:
    lines = [f'name = "{name}"', f'role = "{role}"', f'file = "{{d}}/{file}"']
    lines += [f'{key} = "{value}"' for key, value in more.items()]
    return "[[trial]]\n" + "\n".join(lines) + "\n"


_JOINTS = tuple(f"{joint}_{side}" for joint in ("hip", "knee", "ankle") for side in "rl")

REAL = {
    "subject01": RealStudy(
        72.6,
        1.803,
        "male",
        "gait2354",
        (
            _trial("static", "static", "subject01_static.trc"),
            _trial("walk", "gait", "subject01_walk1.trc", forces="{d}/subject01_walk1_grf.mot"),
        ),
    ),
    "uf3": RealStudy(
        68.17,
        1.70,
        "male",
        "rcnl",
        (
            _trial("static", "static", "static.trc"),
            *(_trial(joint, "joint", f"{joint}.trc", joint=joint) for joint in _JOINTS),
            _trial("gait", "gait", "gait.trc"),
        ),
    ),
    "functional_c3d": RealStudy(
        66.0,
        1.72,
        "female",
        "conventional73",
        (
            _trial("static", "static", "static.c3d"),
            _trial("hip_r", "joint", "hip_r.c3d", joint="hip_r"),
            _trial("knee_r", "joint", "knee_r.c3d", joint="knee_r"),
        ),
    ),
    "pig_c3d": RealStudy(
        66.5,
        1.79,
        "male",
        "plug-in-gait",
        (_trial("static", "static", "static.c3d"), _trial("gait", "gait", "gait.c3d")),
    ),
}


def study_text(name: str, data: Path, calibration: str = "") -> str:
    """The study file of one of `REAL`, its recordings read in place; `calibration` are lines of
    that table.
    """
    study = REAL[name]
    subject = (
        f'name = "{name}"\nmass_kg = {study.mass}\nheight_m = {study.height}\nsex = "{study.sex}"\n'
    )
    tables = [f"[subject]\n{subject}", f'[markers]\nset = "{study.markers}"\n', *study.trials]
    if calibration:
        tables.append(f"[calibration]\n{calibration}\n")
    return "\n".join(tables).replace("{d}", (data / name).as_posix())


def write_study(name: str, data: Path, folder: Path, calibration: str = "") -> Path:
    """The same as a file in `folder`."""
    path = folder / "study.toml"
    path.write_text(study_text(name, data, calibration), encoding="utf-8")
    return path


def load_study(name: str, data: Path, folder: Path, calibration: str = "") -> Study:
    """The same, read."""
    return Study.load(write_study(name, data, folder, calibration))
