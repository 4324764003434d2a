"""Five walks of one session, from C3D files to the mean curve, against a mean made straight from the table's text."""

import csv
import math
import statistics
from collections import defaultdict
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.results.calibration import write_results
from gaitcal.results.cycles import read_cycles
from gaitcal.results.stride_files import ENSEMBLE, SPATIOTEMPORAL
from gaitcal.session.calibrate import calibrate
from gaitcal.study.study import Study

WALKS = ("walk03", "walk04", "walk05", "walk06", "walk07")
ROUNDED = 2e-6
"""Both tables have six decimals."""


@pytest.mark.slow
def test_mean_curves_of_five_walks_are_those_of_the_table_of_strides(data_dir: Path, tmp_path: Path) -> None:
    files = [("static", "static"), *((name, "gait") for name in WALKS)]
    trials = [
        f'[[trial]]\nname = "{name}"\nrole = "{role}"\nfile = "{(data_dir / "labs_c3d/multi" / name).as_posix()}.c3d"\n'
        for name, role in files
    ]
    person = '[subject]\nname = "S4"\nmass_kg = 53.5\nheight_m = 1.634\nsex = "female"\nsession = "first"\n'
    settings = '[calibration]\njp = false\nip = "none"\n'
    study = tmp_path / "study.toml"
    study.write_text(person + '[markers]\nset = "plug-in-gait"\n' + "".join(trials) + settings, encoding="utf-8")
    out = write_results(calibrate(Study.load(study)), tmp_path / "result")

    lines = [line for line in (out / "cycles.csv").read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    samples: dict[tuple[str, str, int], list[float]] = defaultdict(list)
    for row in csv.DictReader(lines):
        assert (row["person"], row["session"]) == ("S4", "first")
        if row["valid"] == "1":
            samples[row["side"], row["variable"], int(row["percent"])].append(float(row["value"]))
    curves = pd.read_csv(out / ENSEMBLE, comment="#").set_index(["side", "variable", "percent"])
    assert len(curves) == 101 * len({key[:2] for key in curves.index})
    full = 0
    for (side, variable, percent), figures in curves.iterrows():  # type: ignore[misc]
        values = samples.get((side, variable, percent), [])
        assert figures["n"] == len(values) == figures["trials"]
        if len(values) > 1:
            assert figures["mean"] == pytest.approx(statistics.fmean(values), abs=ROUNDED)
            assert figures["sd"] == pytest.approx(statistics.stdev(values), abs=ROUNDED)
            assert math.isnan(figures["sd_within"])  # one stride in each walk
            full += len(values) == len(WALKS)
    assert full > 2000
    strides = read_cycles(out)
    assert (strides["se_stride"].fillna(0.0) <= strides["se"].fillna(0.0) + ROUNDED).all()
    steps = pd.read_csv(out / SPATIOTEMPORAL, comment="#")
    speed = steps[(steps["variable"] == "speed") & (steps["side"] == "r")]["value"]
    assert len(speed) == len(WALKS) and speed.mean() == pytest.approx(1.19, abs=0.02)
