"""A trial of a calibration, analysed once more as a further trial: the same angles and standard
errors.
"""

from pathlib import Path

import numpy as np
import pytest

from gaitcal import Study, calibrate
from gaitcal.analysis import trial_result
from tests.real_studies import study_text

PUBLISHED = 'protocol = "published"'
KINDS = {
    "walk": ("gait", "", False),
    "published walk": ("gait", PUBLISHED, False),
    "activity": ("motion", "", False),
    "one of two": ("gait", "", True),
}
"""Role, settings, and whether another part of the recording is a trial of its own."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_trial_of_the_calibration_is_tracked_as_in_it(
    kind: str, data_dir: Path, tmp_path: Path
) -> None:
    role, settings, has_other = KINDS[kind]
    text = study_text("subject01", data_dir.resolve(), f'ip = "none"\n{settings}')
    text = text.replace('role = "gait"', f'role = "{role}"')
    before, walk, after = text.partition('name = "walk"')
    table, end, rest = after.partition("\n\n")
    first, other = (f"{table}\ntime = {part}" for part in ("[0.0, 1.4]", "[1.4, 2.5]"))
    more = f'\n\n[[trial]]\nname = "other"{other}' if has_other else ""
    text = f"{before}{walk}{first}{more}{end}{rest}"
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    found = calibrate(Study.load(tmp_path / "study.toml"), checked=())
    own = found.trial("walk")
    raw = next(trial for trial in found.study.trials if trial.name == "walk")
    again = trial_result.analyse(found.model, raw, found.study.settings, found.uncertainty, {})
    # of two, how markers deform is observed in both together, and then in one alone
    np.testing.assert_allclose(again.body.q, own.body.q, atol=1e-3 if has_other else 1e-7)
    assert own.coordinate_errors is not None and again.coordinate_errors is not None
    ratio = np.median(again.coordinate_errors, axis=0) / np.median(own.coordinate_errors, axis=0)
    assert np.nanmax(np.abs(np.log(ratio))) < 0.05
