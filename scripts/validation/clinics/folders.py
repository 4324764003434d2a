"""The bare folders that variants start from, and what no file of them holds."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path


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
