"""Folders of made-up recordings, without a study file."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.intake.draft_file import Draft
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.csv_recordings import write_forces_csv, write_markers_csv
from gaitcal.io.recording import Recording
from gaitcal.synthetic.synthetic_motion import (
    simulate_gait,
    simulate_isolated_trial,
    simulate_static_trial,
)
from tests.synthetic_studies import made_plates, made_recording

JOINTS = ("hip_r", "hip_l", "knee_r", "knee_l", "ankle_r", "ankle_l")
SAID = Options(mass=69.4, height=1.70, sex="male")


def recordings(*joints: str) -> dict[str, Recording]:
    """Standing, walking, and one joint moving alone, of one person."""
    out = {
        "static": made_recording(simulate_static_trial(), static=True),
        "walk": made_recording(simulate_gait()),
    }
    return out | {joint: made_recording(simulate_isolated_trial(joint)) for joint in joints}


def write(folder: Path, files: dict[str, Recording], *, forces: str = "") -> Path:
    """Recordings as CSV; `forces`: name of the walk's table of forces, if it is to have one."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, recording in files.items():
        write_markers_csv(folder / f"{name}.csv", recording)
    if forces:
        write_forces_csv(folder / f"{forces}.csv", made_plates(simulate_gait()))
    return folder


def draft(folder: Path, options: Options = SAID) -> Draft:
    """What follows from a folder."""
    return draft_folder(read_folder(folder), options)


def drafted(folder: Path, **changed: Recording) -> Draft:
    """What follows from standing, walking and other recordings, or some in their place."""
    return draft(write(folder / "person", recordings() | changed))


def roles(made: Draft) -> dict[str, str]:
    """File without ending -> role and joint."""
    return {t.file.path.stem: f"{t.role} {t.joint}".strip() for t in made.trials}


def other_person(recording: Recording, by: float = 1.08) -> Recording:
    """The same movement of a larger person."""
    return replace(recording, markers=by * recording.markers)


def squat() -> Recording:
    """Standing, while all but the feet goes down and up."""
    standing = recordings()["static"]
    time = np.arange(300) / 100.0
    markers = np.repeat(standing.markers.mean(axis=0)[None], 300, axis=0)
    down = 0.12 * (1 - np.cos(2 * np.pi * time))
    above = markers[0, :, 1] > 0.15
    markers[:, above, 1] -= down[:, None] * markers[:, above, 1]
    return replace(standing, time=time, markers=markers)
