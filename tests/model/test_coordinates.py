"""The table of coordinates: one row for each angle of the linkage, and what others read from it."""

from __future__ import annotations

from gaitcal.gait.conventions import Convention, Signs
from gaitcal.model.coordinates import (
    COORDINATE_TABLE,
    GROUPS,
    JOINT_TABLE,
    LEG_COORDINATES,
    LOCKED,
    TRANSLATION_RANGES,
    group_of,
    is_of_leg,
    split_side,
    with_side,
)
from gaitcal.model.linkage import COORDINATES, JOINTS, REACTIONS, SEGMENT_TABLE, SEGMENTS, is_translation, segment_kind


def bases(names: tuple[str, ...]) -> tuple[str, ...]:
    """Each once, without its side."""
    return tuple(dict.fromkeys(split_side(name)[0] for name in names))


def test_every_angle_has_its_row_in_the_order_of_the_linkage() -> None:
    angles = tuple(name for name in COORDINATES if not is_translation(name))
    assert tuple(name for name in COORDINATE_TABLE if name not in LOCKED) == bases(angles)
    assert bases(REACTIONS) == LOCKED and set(LOCKED) <= set(COORDINATE_TABLE)
    assert set(TRANSLATION_RANGES) == set(COORDINATES) - set(angles)


def test_every_joint_and_segment_has_its_row() -> None:
    assert tuple(JOINT_TABLE) == bases(tuple(joint.name for joint in JOINTS))
    assert {segment_kind(segment).name for segment in SEGMENTS} == set(SEGMENT_TABLE)


def test_rows_say_what_pages_and_files_need() -> None:
    for row in COORDINATE_TABLE.values():
        assert row.group in GROUPS and row.title and row.angle and row.moment
        assert (row.usual[0] < row.usual[1]) != (row.name in LOCKED), row.name
        assert row.clinical is None or row.group == "pelvis", "only pelvis angles differ with clinical signs"
        for side in "rl":
            assert group_of(with_side(row.name, side)) == row.group
    assert [name for name in COORDINATE_TABLE if is_of_leg(name)] == list(LEG_COORDINATES)


def test_clinical_signs_turn_moments_of_legs_and_nothing_else() -> None:
    clinical = Convention(signs=Signs.CLINICAL)
    for row in COORDINATE_TABLE.values():
        if row.senses:
            told = clinical.positive_moment(row.name)
            assert told == f"internal, {row.senses[1 if row.name in LEG_COORDINATES else 0]}"
