"""Mass whose motion markers leave open: told as the cause of the pelvis residual, and no reason to
change masses.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration
from gaitcal.errors import Severity
from gaitcal.model.linkage import COORDINATES
from gaitcal.quality.verdict import Judgement
from gaitcal.study.study import Study
from tests.messages import check_text
from tests.quality.spoilt import with_trial, without

THORAX = ("C7", "T10", "CLAV", "STRN", "RSHO", "LSHO", "RBAK")
LEG_NM = 0.5
"""N·m RMS: the pelvis is followed a little differently where no trunk pulls on it."""


@pytest.fixture(scope="module")
def both(real_study: Callable[[str], Study]) -> tuple[Calibration, Calibration]:
    """A real walk, and the same whose cameras never saw the thorax; nominal joint parameters."""
    study = real_study("pig_c3d")
    study = replace(study, settings=study.settings.model_copy(update={"jp": False}))
    return calibrate(study, checked=()), calibrate(
        with_trial(study, "gait", without(*THORAX)), checked=()
    )


def test_masses_are_not_fitted_to_what_no_marker_shows(
    both: tuple[Calibration, Calibration],
) -> None:
    whole, blind = both
    assert not blind.inertial.moved
    np.testing.assert_array_equal(
        blind.model.parameters.inertial, blind.nominal.parameters.inertial
    )
    check_text(blind.inertial.message, 39)
    assert "do not determine" not in whole.inertial.message


def test_the_cause_of_the_residual_is_told_and_doubts_nothing(
    both: tuple[Calibration, Calibration],
) -> None:
    whole, blind = both
    (told,) = [f for f in blind.findings if f.topic == "pelvis residual"]
    assert told.severity is Severity.INFO
    assert not [f for f in whole.findings if f.topic == "pelvis residual"]
    check_text(blind.notes)
    assert any("lumbar_rotation" in note for note in blind.notes)
    check_text(blind.notes)
    assert blind.verdict.judgement is not Judgement.REFUSED


def test_leg_torques_do_not_depend_on_it(both: tuple[Calibration, Calibration]) -> None:
    legs = [
        i
        for i, name in enumerate(COORDINATES)
        if name.startswith(("hip", "knee", "ankle", "subtalar"))
    ]
    loads = [c.trial("gait").loads for c in both]
    valid = loads[0].reactions.valid & loads[1].reactions.valid
    change = (loads[1].nominal.tau - loads[0].nominal.tau)[valid][:, legs]
    assert np.sqrt((change**2).mean()) < LEG_NM
