"""A synthetic person's study as CSV files: standing, walking over two plates, moving one joint."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.io.csv_recordings import write_forces_csv, write_markers_csv
from gaitcal.io.force_plate import build_plate_from_moment
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_residual_free_wrench,
    compute_synthetic_markers,
    simulate_gait,
    simulate_isolated_trial,
    simulate_static_trial,
)

Array = NDArray[np.float64]

UP = np.array([0.0, 1.0, 0.0])

STUDY = """
[subject]
name = "synthetic"
mass_kg = 69.4
height_m = 1.70
sex = "male"

[markers]
set = "published"

[[trial]]
name = "static"
role = "static"
file = "static.csv"

[[trial]]
name = "walk"
role = "gait"
file = "walk.csv"
forces = "walk_forces.csv"
"""


AS_PUBLISHED = 'hip_centre = "bell"\nankle_zero = "markers"\n'
"""As the published subject was made, so that its nominal model is the truth."""


def made_recording(
    motion: TrueMotion, parameters: Parameters | None = None, *, static: bool = False
) -> Recording:
    """The published markers of a motion."""
    model = published_model(static_only=static)
    own = model.parameters if parameters is None else parameters
    markers = compute_synthetic_markers(own, model.markers, motion.q)
    return Recording(
        source="made up", time=motion.basis.time, labels=model.markers.labels, markers=markers
    )


def made_plates(
    motion: TrueMotion, parameters: Parameters | None = None
) -> tuple[ForcePlate, ForcePlate]:
    """A plate under each foot that carries what the motion asks for."""
    own = published_model().parameters if parameters is None else parameters
    wrench = compute_residual_free_wrench(own, motion)
    time, origin = motion.basis.time, np.zeros(3)
    right, left = (
        build_plate_from_moment(name, time, wrench[:, k, :3], wrench[:, k, 3:], origin, UP, None)
        for k, name in enumerate(("1", "2"))
    )
    return right, left


def write_synthetic_study(folder: Path, joints: Sequence[str] = (), more: str = "") -> Path:
    """Files and study file in `folder`; `more` is put at the end of the study file."""
    folder.mkdir(parents=True, exist_ok=True)
    write_markers_csv(folder / "static.csv", made_recording(simulate_static_trial(), static=True))
    walk = simulate_gait()
    write_markers_csv(folder / "walk.csv", made_recording(walk))
    write_forces_csv(folder / "walk_forces.csv", made_plates(walk))
    text = STUDY
    for joint in joints:
        write_markers_csv(folder / f"{joint}.csv", made_recording(simulate_isolated_trial(joint)))
        text += (
            f'\n[[trial]]\nname = "{joint}"\nrole = "joint"\njoint = "{joint}"\nfile = '
            f'"{joint}.csv"\n'
        )
    path = folder / "study.toml"
    table = "[calibration]\n"
    more = more if table in more else f"{more}\n{table}"
    path.write_text(text + more.replace(table, table + AS_PUBLISHED), encoding="utf-8")
    return path


def only(recording: Recording, kept: Callable[[str], bool]) -> Recording:
    """The recording with some of its markers."""
    at = [i for i, label in enumerate(recording.labels) if kept(label)]
    return replace(
        recording, labels=tuple(recording.labels[i] for i in at), markers=recording.markers[:, at]
    )
