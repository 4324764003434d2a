"""A cohort of made-up people, each a small study: somebody stands for a moment and walks two strides at 100 Hz.

Person k has the joint and inertial parameters of body k modulo `bodies`, drawn within the published bounds, and
marker noise of its own; people.csv says the groups. The same numbers give the same files. 100 people take some 40 MB.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, Trial
from gaitcal.synthetic.motion import marker_noise, standing_pose, static_motion, two_strides
from gaitcal.synthetic.subject import EXACT_PLATES, on_the_floor, recording_of, synthetic_model

STANDING = 60
"""Frames."""
EVERY = 2
"""Frame of the walk, at 200 Hz, that is recorded."""
NOISE_M = 0.004
"""Largest amplitude of the noise of a marker: skin moves by more, and more of it would only take longer."""
GROUPS = ("walkers", "others")
SESSION = 1
"""Of the seed of the noise."""


@cache
def body(number: int) -> tuple[SubjectModel, Recording, Recording]:
    """Model, standing and walking of a made-up body, without noise."""
    model = synthetic_model(np.random.default_rng(number), perturb=True)
    standing = on_the_floor(model, static_motion(STANDING, standing_pose(model.parameters)))
    walk = recording_of("gait", two_strides(model.parameters), model, published_model().markers.labels)
    return model, recording_of("static", standing, model, model.markers.labels), _thinned(walk)


def _thinned(walk: Recording) -> Recording:
    plates = tuple(
        replace(plate, **{name: getattr(plate, name)[::EVERY] for name in ("time", "force", "point", "moment")})
        for plate in walk.plates
    )
    return replace(walk, time=walk.time[::EVERY], markers=walk.markers[::EVERY], plates=plates)


def write_person(folder: Path, number: int, bodies: int) -> None:
    """Write a person as a study folder."""
    model, standing, walk = body(number % bodies)
    rng = np.random.default_rng([number, SESSION])
    noisy = walk.markers + marker_noise(walk.time, len(walk.labels), rng, NOISE_M)
    folder.mkdir(parents=True, exist_ok=True)
    write_c3d(folder / "static.c3d", standing)
    write_c3d(folder / "gait.c3d", replace(walk, markers=noisy))
    subject = model.subject
    study = StudyFile(
        subject=SubjectTable(
            name=f"P{number:04d}", mass_kg=round(subject.mass, 3), height_m=subject.height, sex=subject.sex
        ),
        markers=Markers(set="published"),
        trial=(
            Trial(name="static", role="static", file=Path("static.c3d")),
            Trial(name="gait", role="gait", file=Path("gait.c3d"), plates={"1": "r", "2": "l"}),
        ),
        calibration=CalibrationSettings(force_filter_hz="none", plate_error=EXACT_PLATES),
    )
    (folder / "study.toml").write_text(study.to_toml(), encoding="utf-8")


def write_people(out: Path, numbers: Sequence[int], bodies: int = 20) -> None:
    """Write people of these numbers, and what `people.csv` says of them."""
    out.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        write_person(out / f"P{number:04d}", number, bodies)
    with (out / "people.csv").open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("person", "group"))
        table.writerows((f"P{number:04d}", GROUPS[number % len(GROUPS)]) for number in numbers)
