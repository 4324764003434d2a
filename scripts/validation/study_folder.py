"""Folders of made-up recordings, each with the study file that a user would have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import Markers, StudyFile, SubjectTable, TrialTable


def write_folder(
    folder: Path,
    recordings: Mapping[str, Recording],
    subject: tuple[str, float, float, str],
    settings: CalibrationSettings | None = None,
    plates: Mapping[str, str] | None = None,
) -> Path:
    """Write `static`, isolated trials named for their joints and gait trials as C3D files, and their study file.

    `subject`: name, kg, m, sex. `plates`: which foot is on which plate of the gait trials. Returns the study file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    trials = []
    for name, recording in recordings.items():
        write_c3d(folder / f"{name}.c3d", recording)
        role = "static" if name == "static" else "joint" if name in ISOLATED_JOINTS else "gait"
        more = {"joint": name} if role == "joint" else {"plates": dict(plates)} if role == "gait" and plates else {}
        trials.append(TrialTable(name=name, role=role, file=Path(f"{name}.c3d"), **more))  # type: ignore[arg-type]
    table = SubjectTable(**dict(zip(("name", "mass_kg", "height_m", "sex"), subject, strict=True)))  # type: ignore[arg-type]
    given = {} if settings is None else {"calibration": settings}
    study = StudyFile(subject=table, markers=Markers(set="published"), trial=tuple(trials), **given)  # type: ignore[arg-type]
    (folder / "study.toml").write_text(study.to_toml(), encoding="utf-8")
    return folder / "study.toml"
