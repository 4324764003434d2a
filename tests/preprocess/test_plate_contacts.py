"""Checks and torques assign plates to feet by the same rule."""

from dataclasses import replace

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


def test_a_contact_on_a_belt_under_both_feet_lasts_while_one_foot_stands_alone() -> None:
    """Every 0.6 s the other foot stands, 0.1 s longer than that with both; torques divide the whole
    loading.
    """
    turn, both_s = 0.6, 0.1
    time = np.arange(0.0, 4 * turn - 0.005, 0.01)
    right, left = (
        np.interp((time + before + both_s) % (2 * turn), [turn + both_s, 2 * turn], [0.0, 0.8])
        + 0.8 * ((time + before + both_s) // (2 * turn))
        for before in (0.0, turn)
    )

    def landmark(name: str) -> Array:
        x, z = (right, 0.2) if name.endswith("_r") else (left, -0.2)
        ahead = 0.1 if name.startswith("toe") else -0.1
        return np.column_stack([x + ahead, np.full(len(time), 0.05), np.full(len(time), z)])

    feet, is_left = Feet(time, landmark), (time + 0.005) // turn % 2
    to_other = np.clip(((time + 0.005) % turn - (turn - both_s)) / both_s, 0.0, 1.0)
    to_other[time > 3 * turn] = 0.0
    part = np.abs(is_left - to_other)
    point = np.column_stack([right + part * (left - right), 0.0 * time, 0.2 - 0.4 * part])
    force = np.tile([0.0, 700.0, 0.0], (len(time), 1))
    belt = ForcePlate(name="1", time=time, force=force, point=point, moment=0.0 * force)
    contacts = find_plate_contacts(feet, (belt,), HEIGHT_M)
    wrench = resample_wrench(belt, time)
    steps, _ = find_steps(belt, wrench, time, feet.build_points(HEIGHT_M), None)
    assert [c.foot for c in contacts] == [s.foot for s in steps] == [0, 1, 0, 1]
    assert sum(len(s.load) for s in steps) == len(time)
    for contact in contacts:
        assert len(contact.load) > 20
        assert not feet.resting[contact.frames, 1 - contact.foot].any()
        np.testing.assert_allclose(contact.point[:, 2], (0.2, -0.2)[contact.foot], atol=1e-12)


def test_the_foot_on_a_raised_plate_is_found_at_the_height_of_its_surface() -> None:
    """The force on the right foot leans so that it meets the floor under the left one, 0.2 m
    beside.
    """
    height = 0.3

    def landmark(name: str) -> Array:
        ahead, aside = 0.1 if "toe" in name else -0.1, 0.1 if name.endswith("_r") else -0.1
        return np.tile([ahead, height, aside], (len(TIME), 1))

    plate, feet = make_plate(), Feet(TIME, landmark)
    raised = replace(
        plate,
        force=plate.force + [0.0, 0.0, 700.0 * 0.2 / height],
        point=np.tile([0.0, height, 0.1], (len(TIME), 1)),
    )
    (contact,) = find_plate_contacts(feet, (raised,), HEIGHT_M)
    points = feet.build_points(HEIGHT_M)
    (step,), findings = find_steps(raised, resample_wrench(raised, TIME), TIME, points, None)
    assert not findings
    assert contact.foot == step.foot == 0
    np.testing.assert_allclose((contact.distance, contact.other_distance), (0.0, 0.2), atol=1e-9)
