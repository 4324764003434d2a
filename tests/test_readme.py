"""The README's Python blocks run as they stand."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.recording import write_c3d
from gaitcal.results.cycles import write_cycles
from gaitcal.synthetic.motion import gait_motion
from tests.fake_result import fake_calibration
from tests.synthetic_studies import made_plates, made_recording, write_synthetic_study

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.slow
def test_the_python_blocks_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the folder of a study, with another walk as C3D beside it."""
    write_synthetic_study(tmp_path)
    walk = gait_motion()
    corners = np.array([[-1.0, 0.0, -1.0], [3.0, 0.0, -1.0], [3.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])  # C3D asks for some
    plates = tuple(replace(plate, corners=corners) for plate in made_plates(walk))
    write_c3d(tmp_path / "walk2.c3d", replace(made_recording(walk), plates=plates))
    first, with_pandas, with_xarray = re.findall(
        r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.M | re.S
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(first, str(README), "exec"), names)
    assert "(208, 27)" in capsys.readouterr().out
    assert {"ground", "moments", "motion"} <= set(names)
    assert (tmp_path / "result" / "report.html").exists()
    people = fake_calibration()  # whose walk has whole strides
    write_cycles(tmp_path / "result" / "cycles.csv", people.model, people.trials)
    exec(compile(with_pandas, str(README), "exec"), names)
    knee = names["knee"]
    assert isinstance(knee, pd.DataFrame) and knee.shape == (101, 2)
    if find_spec("xarray"):
        exec(compile(with_xarray, str(README), "exec"), names)
        assert "xarray.DataArray" in capsys.readouterr().out
