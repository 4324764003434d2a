"""Up and forward, found from the data, by turns that round nothing."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from gaitcal.io.axes import (
    QUARTER_ROTATIONS,
    UP_TO_Y,
    AxisPermutation,
    Vertical,
    find_vertical,
    make_y_up,
    rotate_recording,
    rotate_to_progression,
)
from gaitcal.io.recording import Recording
from tests.io.recordings import body, loaded_body
from tests.messages import check_text

OTHERWISE = Vertical(2, 1, "nothing")


def matrix(turn: AxisPermutation) -> np.ndarray:
    return turn.apply(np.eye(3)).T


def inverse(turn: AxisPermutation) -> AxisPermutation:
    source = tuple(turn.source.index(i) for i in range(3))
    return AxisPermutation(source, tuple(turn.sign[i] for i in source))


def require_same(found: Recording, expected: Recording) -> None:
    """Bit for bit."""
    np.testing.assert_array_equal(found.markers, expected.markers)
    for a, b in zip(found.plates, expected.plates, strict=True):
        np.testing.assert_array_equal(a.wrench(), b.wrench())
        np.testing.assert_array_equal(a.corners, b.corners)


@pytest.mark.parametrize("turn", [*UP_TO_Y.values(), *QUARTER_ROTATIONS])
def test_turns_are_proper_rotations(turn: AxisPermutation) -> None:
    assert np.linalg.det(matrix(turn)) == pytest.approx(1.0)


@pytest.mark.parametrize("axis, sign", list(product(range(3), (-1, 1))))
@pytest.mark.parametrize("make", [loaded_body, body])
def test_any_vertical_is_found_and_undone_bit_for_bit(
    axis: int, sign: int, make: type[Recording]
) -> None:
    upright = make()
    tipped = rotate_recording(upright, inverse(UP_TO_Y[axis, sign]))
    found = find_vertical(tipped.markers, tipped.plates)
    assert (found.axis, found.sign) == (axis, sign)
    back = make_y_up(tipped, OTHERWISE)
    require_same(back, upright)
    assert bool(back.notes) == ((axis, sign) != (1, 1))


def test_a_body_below_the_origin_stands_on_its_plates() -> None:
    """An origin under the ceiling: all heights are negative, and up is still away from
    the plates.
    """
    walk = loaded_body()
    down = np.array([0.0, -3.0, 0.0])
    plates = tuple(replace(p, point=p.point + down, corners=p.corners + down) for p in walk.plates)
    found = find_vertical(walk.markers + down, plates)
    assert (found.axis, found.sign) == (1, 1)


def test_arms_held_out_do_not_make_the_body_wide() -> None:
    """From hand to hand is more than the height; the spread of the markers is still vertical."""
    heights = np.array([0.05, 0.05, 0.5, 0.5, 1.0, 1.0, 1.0, 1.4, 1.4, 1.7, 1.4, 1.4])
    across = np.array([0.1, -0.1, 0.1, -0.1, 0.13, -0.13, 0.0, 0.2, -0.2, 0.0, 0.95, -0.95])
    markers = np.column_stack([0 * heights, across, heights])[None]
    assert find_vertical(markers, ()).axis == 2


@pytest.mark.parametrize("turn", QUARTER_ROTATIONS)
def test_any_heading_becomes_x(turn: AxisPermutation) -> None:
    walk = loaded_body()
    turned = rotate_to_progression(rotate_recording(walk, inverse(turn)))
    require_same(turned, walk)
    assert bool(turned.notes) == (not turn.is_identity)


def test_standing_faces_where_it_is_told_or_stays() -> None:
    standing = body(speed=0.0)
    assert rotate_to_progression(standing) is standing
    turned = rotate_to_progression(standing, np.array([0.2, 0.9, -1.0]))
    np.testing.assert_array_equal(turned.markers[..., 0], -standing.markers[..., 2])
    check_text(turned.notes[-1])


def test_wrenches_turn_with_the_markers() -> None:
    """The moment of a force about the origin is a vector like any other."""
    walk = loaded_body()
    turned = rotate_recording(walk, QUARTER_ROTATIONS[1])
    rotation = matrix(QUARTER_ROTATIONS[1])
    wrench, expected = turned.plates[0].wrench(), walk.plates[0].wrench()
    np.testing.assert_allclose(wrench[:, :3], expected[:, :3] @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(wrench[:, 3:], expected[:, 3:] @ rotation.T, atol=1e-9)


@pytest.mark.parametrize("turn", QUARTER_ROTATIONS)
@pytest.mark.parametrize(
    ("degrees", "side"), [(9.0, ""), (12.0, "12 deg to the right"), (-30.0, "30 deg to the left")]
)
def test_a_walk_off_x_is_told(turn: AxisPermutation, degrees: float, side: str) -> None:
    """Z is to the right; the angle is that of the turned recording, whatever the file's axes."""
    standing = body(speed=0.0)
    way = np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
    walk = replace(standing, markers=standing.markers.copy())
    walk.markers[..., [0, 2]] += np.linspace(0, 1, 50)[:, None, None] * way
    notes = rotate_to_progression(rotate_recording(walk, inverse(turn))).notes
    about = [note for note in notes if "pelvis angles are relative to the laboratory's x" in note]
    assert len(about) == bool(side)
    assert all(side in note for note in about)
