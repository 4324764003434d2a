"""Limits of the pelvis residual, and its size, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.dynamics.expected_residual import ResidualLimits, residual_limits, residual_magnitudes
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.io.recording import ForcePlate
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import published_subject

VALID = np.array([False, True, True])
NOTHING = np.zeros((1, 3))


def limits(pelvis_height: float, floor: float) -> ResidualLimits:
    """Standing with 300 N on each foot where it counts, over plates at the height `floor` (m)."""
    q = np.zeros((3, len(COORDINATES)))
    q[:, COORDINATES.index("pelvis_ty")] = pelvis_height
    wrench = np.zeros((3, 2, 6))
    wrench[:, :, 1] = np.array([900.0, 300.0, 250.0])[:, None]
    feet = np.ones((3, 2), dtype=bool)
    corners = np.array([[0.0, floor, 0.0], [1.0, floor, 0.0], [1.0, floor, 1.0], [0.0, floor, 1.0]])
    plate = ForcePlate(name="1", time=np.zeros(1), force=NOTHING, point=NOTHING, moment=NOTHING, corners=corners)
    reactions = GroundReactions(wrench=wrench, valid=VALID, valid_legs=feet, loaded=feet, resting=feet, notes=())
    return residual_limits(published_subject(), q, reactions, [plate])


def test_limits_are_shares_of_the_peak_force_and_of_the_height_over_the_floor() -> None:
    on_floor, raised, higher = limits(1.0, 0.0), limits(1.0, 0.1), limits(1.2, 0.0)
    assert on_floor.peak_force == pytest.approx(600.0, rel=1e-12)
    assert on_floor.force == pytest.approx(30.0, rel=1e-12)
    assert on_floor.moment == pytest.approx(0.01 * 600.0 * on_floor.centre_height, rel=1e-12)
    assert raised.centre_height == pytest.approx(on_floor.centre_height - 0.1, abs=1e-12)
    assert higher.centre_height == pytest.approx(on_floor.centre_height + 0.2, abs=1e-12)


def test_size_of_a_residual_over_valid_frames() -> None:
    moments = Moments(
        coordinates=COORDINATES,
        time=np.arange(3.0),
        tau=np.zeros((3, len(COORDINATES))),
        knee_adduction=np.zeros((3, 2)),
        residual_force=np.array([[90.0, 0, 0], [3, 4, 0], [0, 0, 1]]),
        residual_moment=np.array([[0.0, 0, 80], [0, 2, 0], [1, 2, 2]]),
        bwh=1.0,
    )
    size = residual_magnitudes("nominal model", moments, VALID)
    np.testing.assert_allclose(size.force, [90, 5, 1])
    np.testing.assert_allclose(size.moment, [80, 2, 3])
    assert (size.peak_force, size.peak_moment) == pytest.approx((5.0, 3.0))
    assert (size.rms_force, size.rms_moment) == pytest.approx((np.sqrt(26 / 6), np.sqrt(13 / 6)))
