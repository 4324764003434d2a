"""Forces that do not belong to the times of the markers are told on reading."""

from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io.csv import write_forces_csv
from gaitcal.study.study import Study
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_plates, write_synthetic_study


def test_forces_with_their_time_in_milliseconds_are_refused(tmp_path: Path) -> None:
    path = write_synthetic_study(tmp_path / "study")
    plates = made_plates(gait_motion())
    write_forces_csv(path.parent / "walk_forces.csv", [replace(p, time=1e3 * p.time) for p in plates])
    with pytest.raises(InputError, match=r"another unit \(ms\?\); both must be in s"):
        Study.load(path)
    write_forces_csv(path.parent / "walk_forces.csv", plates)
    Study.load(path)
