"""A trial of a calibration, analysed once more as a further trial: the same angles and standard errors."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal import Study, calibrate
from gaitcal.session import trial_result
from tests.real_studies import study_text

KINDS = {"walk": ("gait", ""), "published walk": ("gait", 'protocol = "published"'), "activity": ("motion", "")}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_trial_of_the_calibration_is_tracked_as_in_it(kind: str, data_dir: Path, tmp_path: Path) -> None:
    role, protocol = KINDS[kind]
    text = study_text("subject01", data_dir.resolve(), f'ip = "none"\n{protocol}')
    (tmp_path / "study.toml").write_text(text.replace('role = "gait"', f'role = "{role}"'), encoding="utf-8")
    found = calibrate(Study.load(tmp_path / "study.toml"))
    own = found.trial("walk")
    raw = next(trial for trial in found.study.trials if trial.name == "walk")
    again = trial_result.analyse(found.model, raw, found.study.settings, found.uncertainty, {})
    np.testing.assert_allclose(again.body.q, own.body.q, atol=1e-7)
    assert own.coordinate_errors is not None and again.coordinate_errors is not None
    ratio = np.median(again.coordinate_errors, axis=0) / np.median(own.coordinate_errors, axis=0)
    assert np.nanmax(np.abs(np.log(ratio))) < 0.05
