"""Movements that are no walk: carried by the ground; seen for what they are; their torques found
from the recording.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gaitcal.dynamics.ground_reactions import ground_reactions
from gaitcal.dynamics.inverse_dynamics import Dynamics, compute_pelvis_residual, inverse_dynamics
from gaitcal.gait.events import find_activity_events, find_trial_events
from gaitcal.gait.strides import list_strides
from gaitcal.intake.trial_movement import MovementKind, classify_movement, detect_standing
from gaitcal.model.coordinates import LEG_COORDINATES
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES
from gaitcal.model.marker_set import load_marker_set
from gaitcal.study.study_file import load_study_file
from gaitcal.synthetic import subject
from gaitcal.synthetic.movements import Activity, SyntheticMovement
from gaitcal.synthetic.movements import simulate_movement as made_up
from gaitcal.synthetic.subject import (
    make_synthetic_model,
    place_foothold_plates,
    place_on_floor,
    record_motion,
)
from gaitcal.synthetic.synthetic_motion import (
    compute_ground_on_feet,
    make_standing_pose,
    simulate_static_trial,
)
from gaitcal.tracking.motion import track
from tests.commands import gaitcal

FLYING_N = 10.0
"""Of a body in flight that weighs 680 N."""
TORQUE_NM = {Activity.JUMP: 3.0, Activity.RUN: 5.5}
"""RMS over valid frames and joints: what the knots of the tracked motion make of a landing (2.7,
5.0); else 1.
"""
REPEATS = {Activity.SQUAT: 2, Activity.SIT_TO_STAND: 1, Activity.JUMP: 1}
"""From rest to rest, of both legs."""
PHASES = {
    Activity.SQUAT: ("lowering", "rising"),
    Activity.SIT_TO_STAND: ("rising", "lowering"),
    Activity.JUMP: ("lowering", "push-off", "flight", "landing", "rising"),
}
LEAST_STRIDES = 1
LEFT_ON_SEAT = 0.1
"""Of body weight, where torques count again."""


def test_command_writes_a_trial_of_each_movement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stands = simulate_static_trial(standing=make_standing_pose())
    monkeypatch.setattr(subject, "ISOLATED_JOINTS", ())
    monkeypatch.setattr("gaitcal.synthetic.synthetic_motion.simulate_two_strides", lambda _: stands)
    monkeypatch.setattr(subject, "simulate_movement", lambda *_: SyntheticMovement(motion=stands))
    words = (
        "synthesize",
        "--out",
        str(tmp_path / "person"),
        "--movement",
        "sit-to-stand",
        "--movement",
    )
    refused = gaitcal(*words, "stars")
    assert refused.returncode == 2 and "sit-to-stand, jump, run, stairs" in refused.stderr
    done = gaitcal(*words, "stairs")
    assert done.returncode == 0, done.stderr
    trials = {
        trial.name: trial.role for trial in load_study_file(tmp_path / "person/study.toml").trials
    }
    assert trials == {
        "static": "static",
        "gait": "gait",
        "sit_to_stand": "motion",
        "stairs": "motion",
    }
    assert (tmp_path / "person/truth/stairs_motion.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("activity", Activity)
def test_torques_of_an_activity(activity: Activity) -> None:
    model = make_synthetic_model(np.random.default_rng(), perturb=False)
    found = made_up(activity, model.parameters)
    motion, ground = found.motion, compute_ground_on_feet(model.parameters, found.motion)
    state = [motion.basis.evaluate(motion.coefficients, k) for k in range(3)]
    truth = Dynamics(model.parameters).compute_forces(*state, ground.wrench)
    up, share = ground.wrench[:, :, 1], ground.load_share.sum(axis=1)
    flies, sits = share == 0, (share > 0) & (share < 1.0 - 1e-9)
    assert up.min() > -FLYING_N and flies.any() == (activity in (Activity.JUMP, Activity.RUN))
    residual = np.abs(compute_pelvis_residual(state[0], truth)).max(axis=1)
    assert residual[flies].max(initial=0.0) < FLYING_N and residual[~flies & ~sits].max() < 1e-6
    assert sits.any() == (activity is Activity.SIT_TO_STAND)

    recording = record_motion(
        activity.value,
        motion,
        model,
        model.markers.labels,
        place_foothold_plates(found, ground.wrench),
    )
    marker_set = load_marker_set("published")
    still = place_on_floor(model, simulate_static_trial(standing=make_standing_pose()))
    posture, _ = detect_standing(
        record_motion("static", still, model, model.markers.labels), marker_set
    )
    assert posture is not None
    shown = classify_movement(recording, posture.marker_set, None, posture.stance)
    assert shown.kind is MovementKind.MOVES and shown.certain

    tracked = track(model, recording)
    reactions = ground_reactions(model, tracked, recording)
    assert not reactions.warnings
    assert reactions.has_torques and (1.0 - share)[reactions.valid & ~flies].max() < LEFT_ON_SEAT
    moments = inverse_dynamics(model, tracked, reactions.wrench)
    wrong = [
        (moments.tau - truth[:, : moments.tau.shape[1]])[
            reactions.valid_for(name), COORDINATE_INDEX[name]
        ]
        for name in (f"{base}_{side}" for base in LEG_COORDINATES for side in SIDES)
        if name in COORDINATE_INDEX
    ]
    assert np.sqrt(np.mean(np.concatenate(wrong) ** 2)) < TORQUE_NM.get(activity, 1.0)

    events = find_activity_events(tracked, find_trial_events(model, tracked, reactions, recording))
    cycles = list_strides(events)
    if activity in REPEATS:
        assert [len(cycles[side]) for side in SIDES] == [
            REPEATS[activity]
        ] * 2 and not events.events
        assert {tuple(name for name, _ in cycle.parts) for cycle in events.repeats} == {
            PHASES[activity]
        }
    else:
        assert min(len(of) for of in cycles.values()) >= LEAST_STRIDES and not events.repeats
