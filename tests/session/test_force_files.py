"""Whose forces a table holds, and whether they belong to the times of the markers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import InputError, Severity
from gaitcal.io.csv import write_forces_csv
from gaitcal.session.drafting import rejected_forces
from gaitcal.study.study import Study
from gaitcal.synthetic.motion import gait_motion
from tests.session.folders import draft, recordings, write
from tests.synthetic_studies import made_plates, write_synthetic_study

FAR = np.array([3.0, 0.0, 0.0])


def test_the_feet_decide_and_not_the_names(tmp_path: Path) -> None:
    """Two walks at the same times, 3 m apart, and names that lie."""
    files, plates = recordings(), made_plates(gait_motion())
    there = replace(files["walk"], markers=files["walk"].markers[::-1] * [1.0, 1.0, -1.0] + FAR)
    folder = write(tmp_path / "person", {**files, "walk2": _sides_exchanged(there)})
    write_forces_csv(folder / "walk2_grf.csv", plates)
    made = draft(folder)
    forces = {t.name: t.forces for t in made.trials if t.role == "gait"}
    walk = forces["walk"]
    assert walk is not None and walk.file.name == "walk2_grf.csv"
    assert not walk.certain and walk.reason.endswith("though its name says walk2")
    assert forces["walk2"] is None


def test_forces_of_nobody_are_told(tmp_path: Path) -> None:
    plates = tuple(replace(p, point=p.point + FAR) for p in made_plates(gait_motion()))
    folder = write(tmp_path / "person", recordings())
    write_forces_csv(folder / "walk_grf.csv", plates)
    made = draft(folder)
    assert all(t.forces is None for t in made.trials)
    (row,) = (row for row in made.left_out if row.name == "walk_grf.csv")
    assert "m from the feet of walk" in row.reason
    (warning,) = rejected_forces(made)
    assert warning.severity is Severity.WARNING and warning.where == "walk"
    assert warning.evidence.startswith("no forces, no torques: walk_grf.csv is not used: its centres of pressure are")
    (folder / "walk_grf.csv").unlink()
    assert rejected_forces(draft(folder)) == (), "a folder without forces is asked for angles"


def test_forces_that_cover_a_part_cut_the_trial(tmp_path: Path) -> None:
    plates = made_plates(gait_motion())
    part = tuple(replace(p, **{k: getattr(p, k)[40:] for k in ("time", "force", "point", "moment")}) for p in plates)
    folder = write(tmp_path / "person", recordings())
    write_forces_csv(folder / "walk_grf.csv", part)
    made = draft(folder)
    forces = made.trials[-1].forces
    assert abs(forces.time[0] - plates[0].time[40]) < 0.01
    late = tuple(replace(p, time=p.time + 100.0) for p in plates)
    write_forces_csv(folder / "walk_grf.csv", late)
    assert draft(folder).trials[-1].forces is None


def test_forces_with_their_time_in_milliseconds_are_refused(tmp_path: Path) -> None:
    path = write_synthetic_study(tmp_path / "study")
    plates = made_plates(gait_motion())
    write_forces_csv(path.parent / "walk_forces.csv", [replace(p, time=1e3 * p.time) for p in plates])
    with pytest.raises(InputError, match=r"another unit \(ms\?\); both must be in s"):
        Study.load(path)
    write_forces_csv(path.parent / "walk_forces.csv", plates)
    Study.load(path)


def _sides_exchanged(recording):  # type: ignore[no-untyped-def]
    """A mirrored recording with the labels of the other side, so that it is a person again."""
    swap = {"R.": "L.", "L.": "R."}
    return replace(recording, labels=tuple(swap.get(m[:2], m[:2]) + m[2:] for m in recording.labels))
