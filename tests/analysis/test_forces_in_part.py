"""Forces that cover a part of a walk: torques there, angles everywhere."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.commands import run


@pytest.mark.slow
def test_a_walk_has_torques_where_it_has_forces(data_dir: Path, tmp_path: Path) -> None:
    """44 % of the walk: dropped before, and 53 of its 66 frames valid now."""
    folder = data_dir / "cases/forces_for_a_part"
    done = run(
        "calibrate",
        folder,
        "--out",
        tmp_path / "result",
        "--mass",
        "72.6",
        "--height",
        "1.803",
        "-q",
    )
    assert done.exit_code == 0
    moments = pd.read_csv(tmp_path / "result/moments/subject01_walk1.csv", comment="#")
    assert len(moments) == 151, "the whole walk"
    for column in ("valid", "valid_r", "valid_l"):
        time = moments["time"][moments[column] == 1]
        assert len(time) > 40 and time.min() > 0.5 and time.max() < 1.6
    motion = pd.read_csv(tmp_path / "result/motion/subject01_walk1.csv", comment="#")
    assert len(motion) == 151 and np.isfinite(motion["knee_angle_r"]).all()
