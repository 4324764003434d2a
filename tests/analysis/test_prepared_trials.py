"""A session: its trials are cleaned once, and each stage hands on a new state."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.calibrate import fit_inertia, track_trials
from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import _collect_possible_errors, prepare_calibration
from gaitcal.analysis.result import Stage
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.preprocess.static_disagreement import PossibleMove
from gaitcal.runtime import silent
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role
from tests.quality.spoilt import sound_study


@pytest.fixture
def study() -> Study:
    """Standing and a walk over plates, with nominal joint parameters."""
    sound = sound_study()
    kept = tuple(t for t in sound.trials if t.name in ("static", "walk"))
    return replace(
        sound, trials=kept, settings=CalibrationSettings(jp=False, nodes_per_second=10.0)
    )


def test_a_stage_changes_nothing_of_the_one_before(study: Study) -> None:
    prepared = prepare_calibration(preprocess_study(study))
    (walk,) = prepared.trials
    assert walk.stages == {} and walk.reactions is None
    moved = track_trials(fit_joints(prepared), silent)
    (tracked,) = moved.trials
    assert (
        list(tracked.stages) == [Stage.NOMINAL]
        and tracked.reactions is not None
        and tracked.scores is not None
    )
    loaded = fit_inertia(moved, silent)
    assert list(loaded.trials[0].stages) == [Stage.NOMINAL, Stage.JP_IP]
    assert (
        loaded.parameters is loaded.trials[0].parameters and loaded.uncertainty.inertial is not None
    )
    assert walk.stages == {} and list(tracked.stages) == [Stage.NOMINAL] and moved.inertial is None


def test_markers_that_moved_in_an_isolated_trial_leave_other_joints_alone(study: Study) -> None:
    """The thigh of a knee trial tells of the knee; that of a walk of the hip and the knee."""
    (walk,) = study.moving
    knee = replace(walk, name="knee", role=Role.JOINT, joint="knee_r")
    moves = {
        "knee": {"thigh_r": PossibleMove(np.full(3, 0.3), 0.02)},
        "walk": {"thigh_r": PossibleMove(np.full(3, 0.1), 0.01)},
    }
    both, alone = (
        _collect_possible_errors(moves, (knee, walk)),
        _collect_possible_errors(moves, (knee,)),
    )
    assert {name.split(".")[0] for name in alone} == {"knee_r"} and {
        n: both[n] for n in alone
    } == alone
    assert (
        both["hip_r.thigh.ant"] == 0.01
        and alone["knee_r.thigh.ant"] == 0.02
        and alone["knee_r.thigh.front"] == 0.3
    )
