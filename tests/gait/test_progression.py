"""The pelvis against the line of a stride: the same in whatever direction of the room somebody walks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gaitcal.gait.strides import AXES, TURNING, along_line, facing, turn_between, turns

TIME = np.arange(0.0, 2.0, 0.01)
WAVE = np.sin(2 * np.pi * TIME)
ANGLES = np.radians(np.stack([-12.0 + 2.0 * WAVE, 5.0 * WAVE, 8.0 * np.cos(2 * np.pi * TIME)], axis=1))
"""Of a pelvis that walks along x: tilted forward by 12 deg."""
EXACT = 1e-9


def turned(angles: np.ndarray, by: np.ndarray | float) -> np.ndarray:
    """The same pelvis in a room that is turned to the left."""
    out: np.ndarray = (Rotation.from_euler("y", np.reshape(by, (-1, 1))) * Rotation.from_euler(AXES, angles)).as_euler(
        AXES
    )
    return out


@given(st.floats(-np.pi, np.pi))
def test_angles_along_the_line_know_no_direction_of_the_room(by: float) -> None:
    inside = np.ones(len(TIME), dtype=bool)
    np.testing.assert_allclose(along_line(turned(ANGLES, by), by, inside), ANGLES, atol=EXACT)
    # walking backwards: the feet go the other way, the pelvis is the same
    np.testing.assert_allclose(along_line(turned(ANGLES, by), by + np.pi, inside), ANGLES, atol=EXACT)


def test_a_line_across_the_room_makes_a_tilt_a_list() -> None:
    """What was wrong with angles against the room: 12 deg of forward tilt are list of who walks to the left."""
    against_room = np.degrees(turned(ANGLES, np.pi / 2))
    assert abs(against_room[:, 1]).mean() > 10.0
    assert np.degrees(turned(ANGLES, 0.0))[:, 1].mean() == pytest.approx(0.0, abs=0.1)


def test_gait_itself_is_no_turn_and_a_turn_is_one_whichever_way() -> None:
    straight = facing(ANGLES)
    assert turn_between(TIME, straight, 0.3, 1.3) == pytest.approx(0.0, abs=0.01)
    for sign in (-1.0, 1.0):
        faced = facing(turned(ANGLES, sign * np.radians(200.0) * TIME))
        assert turn_between(TIME, faced, 0.3, 1.3) == pytest.approx(sign * 200.0, abs=0.5)
        assert turns(turn_between(TIME, faced, 0.3, 1.3))
    assert not turns(None) and not turns(TURNING) and turns(-TURNING - 0.1)
