"""Part `recovery` of member `truth`, small: whole calibrations, through files, with error bars that hold."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal import Study, calibrate, parameter_table
from gaitcal.model.segment_frames import HipCentre
from gaitcal.study.study_trial import Role
from scripts.validation.truth import made_up
from scripts.validation.truth.people import EXACT_PLATES
from tests.kept import copied_person, kept_person

SEEDS = (3, 4, 5)
"""Three people: errors of one person go together, so that their coverage scatters by some 10 %."""


EXACT = {"segment_axes": "exact", "plate_error": EXACT_PLATES}


@pytest.mark.slow
@pytest.mark.parametrize("settings", ["exact", "gait-only"])
def test_intervals_of_whole_calibrations_cover_the_truth(
    settings: str, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Told that plates and palpated axes are exact: bars for what may be wrong with them are for others than these."""
    monkeypatch.setattr("scripts.validation.truth.made_up.synthesize", partial(copied_person, kept))
    people = [made_up.synthetic_person(seed, made_up.Settings(settings), EXACT) for seed in SEEDS]
    parameters = pd.concat([p.parameters for p in people])
    joint = parameters[parameters["kind"].str.startswith("joint")]["z"].dropna()
    torques = np.concatenate([p.torques.ravel() for p in people])
    powers, vectors = (
        np.concatenate([(gaps / errors).ravel() for gaps, errors in pairs])
        for pairs in ([p.powers for p in people], [p.vectors for p in people])
    )
    for z in (joint, torques, powers, vectors):
        # wide for these people, who vary less (within 10 mm, 10 deg, 10 %) than people of whom priors are
        assert 55.0 < 100.0 * np.mean(np.abs(z) < 1.0) < 92.0
        assert 100.0 * np.mean(np.abs(z) < 1.96) > 86.0
    report = list(made_up.lines(people))
    assert any(line.startswith("knee       position") and "in 95 %" in line for line in report)
    assert any(line.startswith("subtalar_angle_l") for line in report)


@pytest.mark.slow
@pytest.mark.parametrize("rule", [HipCentre.BELL, HipCentre.HARRINGTON])
def test_the_truth_is_told_in_the_frames_of_the_calibration(rule: HipCentre, kept: Path) -> None:
    """A thigh begins at the hip of the rule that a calibration uses."""
    study = Study.load(kept_person(kept, seed=3, perturb=True))
    study = replace(
        study,
        settings=study.settings.model_validate({"hip_centre": rule.value, "jp": False}),
        trials=tuple(trial for trial in study.trials if trial.role is not Role.JOINT),
    )
    nominal = parameter_table(calibrate(study)).set_index("name")["nominal"]
    truth = made_up.true_parameters(3, rule)
    # one hip joins two frames: its true place in the thigh, which begins at the nominal hip, is where it misses that
    for side in "rl":
        names = [f"hip_{side}.{{}}.{direction}" for direction in ("ant", "sup", "lat")]
        in_pelvis = [truth[n.format("pelvis")] - nominal[n.format("pelvis")] for n in names]
        in_thigh = [truth[n.format("thigh")] - nominal[n.format("thigh")] for n in names]
        np.testing.assert_allclose(np.linalg.norm(in_thigh), np.linalg.norm(in_pelvis), rtol=1e-3)
