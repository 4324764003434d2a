"""The README's Python block runs as it stands."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.recording import write_c3d
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_plates, made_recording, write_synthetic_study

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_the_python_block_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the folder of a study, with another walk as C3D beside it."""
    write_synthetic_study(tmp_path)
    walk = gait_motion()
    corners = np.array([[-1.0, 0.0, -1.0], [3.0, 0.0, -1.0], [3.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])  # C3D asks for some
    plates = tuple(replace(plate, corners=corners) for plate in made_plates(walk))
    write_c3d(tmp_path / "walk2.c3d", replace(made_recording(walk), plates=plates))
    (block,) = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.M | re.S)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(block, str(README), "exec"), names)
    assert "(208, 27)" in capsys.readouterr().out
    assert {"ground", "moments", "motion"} <= set(names)
    assert (tmp_path / "result" / "report.html").exists()
