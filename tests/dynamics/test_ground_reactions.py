"""From force plates to torques in scripts: the same as in a calibration, and clear words for what cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gaitcal as gc
from gaitcal.recording import Recording
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_plates, made_recording

UNEXPLAINED_N = 5.0
"""RMS of the pelvis residual that filter and splines leave of data without noise; 2.4 N in a calibration."""


@pytest.fixture(scope="module")
def walk() -> Recording:
    motion = gait_motion()
    return replace(made_recording(motion), plates=made_plates(motion))


@pytest.fixture(scope="module")
def tracked(walk: Recording) -> gc.Motion:
    return gc.track(gc.published_model(), walk)


def test_plates_of_a_recording_give_torques(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    ground = gc.ground_reactions(model, tracked, walk)
    assert ground.wrench.shape == (len(walk.time), 2, 6)
    assert ground.valid.mean() > 0.5
    moments = gc.inverse_dynamics(model, tracked, ground.wrench)
    assert np.sqrt(np.mean(moments.residual_force[ground.valid] ** 2)) < UNEXPLAINED_N
    unfiltered = gc.ground_reactions(model, tracked, walk, cutoff_hz=None)
    assert any("not filtered" in note for note in unfiltered.notes)
    left = gc.ground_reactions(model, tracked, walk, plates={"1": "l", "2": "none"})
    assert not left.loaded[:, 0].any() and left.loaded[:, 1].any()


def test_what_cannot_be_is_one_clear_line(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    with pytest.raises(gc.InputError, match=r"forces: found tuple; allowed: an array .* gaitcal.ground_reactions"):
        gc.inverse_dynamics(model, tracked, walk.plates)  # type: ignore[arg-type]
    with pytest.raises(gc.InputError, match="found no force plates"):
        gc.ground_reactions(model, tracked, replace(walk, plates=()))
    with pytest.raises(gc.InputError, match="found '3'; allowed: 1, 2"):
        gc.ground_reactions(model, tracked, walk, plates={"3": "r"})
    with pytest.raises(gc.InputError, match="all 27 coordinates"):
        gc.ground_reactions(model, replace(tracked, coordinates=tracked.coordinates[:6]), walk)
