"""Real walks without one of their plates: no frame is valid in which that plate bore a part of the foot."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from gaitcal import Study
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.faults import plates
from gaitcal.faults.foot_on_plate import feet_of
from gaitcal.faults.study import check_study, evidence_of
from gaitcal.findings import Severity
from gaitcal.io.force_plate import resample_wrench
from gaitcal.io.recording import Recording
from gaitcal.motion.motion import tracked_motion
from gaitcal.session.session import measured_reactions, prepare_trial
from gaitcal.study.study import nominal_of
from gaitcal.study.study_trial import Role

MATTERS = 0.05
"""Of body weight. A strike or off of the file may miss the first or last frame in which a plate reads."""
ASTRIDE = ("multi", "multi walk06")
"""A heel, and toes, that hang over from the next plate."""


@pytest.fixture
def study_of(data_dir: Path) -> Callable[[str], Study]:
    loaded: Callable[[str], Study] = import_module("scripts.validation.attacks.bases").loaded
    return loaded


def without(recording: Recording, name: str) -> Recording:
    return replace(recording, plates=tuple(plate for plate in recording.plates if plate.name != name))


@pytest.mark.parametrize(
    "name", [*ASTRIDE, *(pytest.param(n, marks=pytest.mark.slow) for n in ("child", "kad", "pig"))]
)
def test_what_a_missing_plate_bore_is_not_valid(study_of: Callable[[str], Study], name: str) -> None:
    study = study_of(name)
    model = nominal_of(study)
    prepared = prepare_trial(next(t for t in study.trials if t.role is Role.GAIT), model, study.settings)
    motion = tracked_motion(prepared.body, model.parameters)
    recording = prepared.recording

    def reactions(of: Recording) -> GroundReactions:
        return measured_reactions(replace(prepared, recording=of), model, model.parameters, motion, study.settings)

    asked = False
    for plate in recording.plates:
        bore = np.nan_to_num(resample_wrench(plate, motion.time))[:, 1] > MATTERS * model.subject.weight
        bore[1:-1] &= bore[:-2] & bore[2:]
        own = reactions(replace(recording, plates=(plate,))).loaded & bore[:, None]
        if own.any(axis=0).all():
            continue  # two feet on it, one after the other: which bore how much is not known
        asked |= bool(own.any())
        assert not (own & reactions(without(recording, plate.name)).valid_legs).any()
    assert asked


def test_a_missing_plate_accuses_no_mass(study_of: Callable[[str], Study]) -> None:
    """The heel of a foot stands on it while the rest of the foot is on the next one."""
    study = study_of("multi")
    spoilt = tuple(replace(t, recording=without(t.recording, "2")) if t.role is Role.GAIT else t for t in study.trials)
    study = replace(study, trials=spoilt)
    found = check_study(study)
    assert not [f for f in found if f.topic == "body mass" and f.severity is not Severity.INFO]


def test_a_body_is_not_weighed_while_a_heel_stands_beside_the_plate_that_it_is_about_to_load(
    study_of: Callable[[str], Study],
) -> None:
    """A heel bears 315 N of 525 on the plate that is missing, 40 ms before the next plate reads."""
    study = study_of("multi")
    model = nominal_of(study)
    spoilt = tuple(replace(t, recording=without(t.recording, "2")) for t in study.trials if t.role is Role.GAIT)
    missed, whole = (
        evidence_of(replace(study, trials=(study.static, *t)), model)[-1] for t in (spoilt, study.trials[1:])
    )
    early = (missed.recording.time > 2.325) & (missed.recording.time < 2.365)
    for trial, weighed in ((missed, False), (whole, True)):
        feet = feet_of(trial)
        assert feet is not None and plates._all_on_plates(trial, feet)[early].any() == weighed
