"""`python -m scripts.validation clinics`: its folders can be made and read, and its measure tells
torques apart.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal import read_recording
from scripts.validation.clinics.check import Ending, Outcome, difference, messages, run_case
from scripts.validation.clinics.variants import VARIANTS, cases
from scripts.validation.harness import results
from scripts.validation.recordings import CLINICS

QUICK = (
    "labels in lower case",
    "one sacral marker",
    "walkway along y",
    "markers only",
    "no toe markers",
    "metres",
)


def test_titles_are_unique_and_every_folder_known() -> None:
    titles = [(variant.name, clinic) for variant, clinic in cases()]
    assert len(set(titles)) == len(titles) > 60
    assert {clinic for _, clinic in titles} <= set(CLINICS)
    assert results("clinics", "--list", "--only", "kad") == {"folders": []}


@pytest.mark.parametrize("name", QUICK)
def test_a_variant_can_be_made_and_read(name: str, data_dir: Path, tmp_path: Path) -> None:
    variant = next(v for v in VARIANTS if v.name == name)
    clinic = CLINICS[variant.clinics[0]]
    clinic.copy(tmp_path)
    before = read_recording(tmp_path / "static.c3d")
    assert variant.make(tmp_path, clinic) == clinic.options
    after = read_recording(tmp_path / "static.c3d")
    assert len(after.time) == len(before.time)
    if name == "labels in lower case":
        assert set(after.labels) == {label.lower() for label in before.labels}
    elif name == "metres":
        np.testing.assert_allclose(after.markers, before.markers, atol=1e-6)
    elif name == "one sacral marker":
        assert "SACR" in after.labels and "RPSI" not in after.labels
    elif name == "no toe markers":
        assert set(before.labels) - set(after.labels) == {"RTOE", "LTOE"}


def _result(folder: Path, shift: float, cause: str = "") -> Path:
    time = np.arange(20) / 100
    table = pd.DataFrame({"time": time, "valid": 0, "valid_r": 1, "valid_l": 0})
    for name in ("hip_flexion_r", "hip_flexion_l"):
        table[name], table[f"{name}_se"], table[f"{name}_bwh"] = 10.0 + shift, 5.0, 1.0 + shift / 10
    (folder / "moments").mkdir(parents=True)
    table.to_csv(folder / "moments" / "walk.csv", index=False)
    reasons = [{"cause": cause}] if cause else []
    (folder / "summary.json").write_text(
        json.dumps({"verdict": "trustworthy", "reasons": reasons}), encoding="utf-8"
    )
    return folder


def test_torques_apart_are_measured_in_error_bars(tmp_path: Path) -> None:
    one, other = _result(tmp_path / "a", 0.0), _result(tmp_path / "b", 19.6, "a new cause")
    assert difference(one, one) == 0.0
    assert difference(one, other) == pytest.approx(2.0), "19.6 N·m of 1.96 times 5 N·m"
    assert messages(other) == {"a new cause"} and not messages(one)


@pytest.mark.slow
def test_a_bare_folder_reaches_torques(data_dir: Path, tmp_path: Path) -> None:
    clean = run_case("as it is", "kad", tmp_path, None)
    assert clean.ending is Ending.TORQUES, clean.line
    renamed: Outcome = run_case("names say nothing", "kad", tmp_path, clean)
    assert renamed.ending is Ending.TORQUES and renamed.ratio == pytest.approx(0.0, abs=0.01)


@pytest.mark.slow
def test_a_made_up_person_comes_twice(capsys: pytest.CaptureFixture[str]) -> None:
    results("sessions", "--parts", "made-up", "--people", "1")
    said = capsys.readouterr().out
    assert "joint positions, mm RMS: nominal" in said and "differences between sessions" in said
