"""Checks and torques assign plates to feet by the same rule."""

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.foot_contact import find_steps
from gaitcal.io.force_plate import resample_wrench
from gaitcal.io.recording import ForcePlate
from gaitcal.preprocess.plate_contacts import Feet, find_plate_contacts

TIME = np.arange(0.0, 2.0, 0.01)
RIGHT_LEAVES_S, LEFT_STANDS_S = 1.7, 1.75
SPEED = 3.0
"""m/s of a foot in swing."""
HEIGHT_M = 1.75


def place_feet() -> Feet:
    """The right foot stands and leaves, then the left one stands, 0.3 m further on."""
    right = np.where(TIME < RIGHT_LEAVES_S, 0.0, SPEED * (TIME - RIGHT_LEAVES_S))
    left = 0.3 + np.where(TIME < LEFT_STANDS_S, SPEED * (TIME - LEFT_STANDS_S), 0.0)

    def landmark(name: str) -> Array:
        x, z = (right, 0.1) if name.endswith("_r") else (left, -0.1)
        ahead = 0.1 if name.startswith("toe") else -0.1
        return np.column_stack([x + ahead, np.full(len(TIME), 0.05), np.full(len(TIME), z)])

    return Feet(TIME, landmark)


def make_plate() -> ForcePlate:
    """One loading without a gap, its centre of pressure under the foot that stands."""
    is_right = (TIME < RIGHT_LEAVES_S)[:, None]
    point = np.where(is_right, [0.0, 0.0, 0.1], [0.3, 0.0, -0.1])
    force = np.tile([0.0, 700.0, 0.0], (len(TIME), 1))
    return ForcePlate(name="1", time=TIME, force=force, point=point, moment=np.zeros_like(force))


def test_a_loading_by_two_feet_in_succession_is_two_contacts_for_checks_and_torques() -> None:
    feet, plate = place_feet(), make_plate()
    contacts = find_plate_contacts(feet, (plate,), HEIGHT_M)
    points = feet.build_points(HEIGHT_M)
    steps, findings = find_steps(plate, resample_wrench(plate, TIME), TIME, points, None)
    assert not findings
    assert [step.foot for step in steps] == [0, 1]
    assert [(c.foot, c.frames) for c in contacts] == [(s.foot, s.frames) for s in steps]
    for contact in contacts:
        assert contact.under_foot and contact.distance < 0.05
