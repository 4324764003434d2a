"""The knee alignment device: where the knee marker would be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.io.formats import read_recording
from gaitcal.model.landmarks import corner, is_device
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.present_markers import complete_static

ROUNDING = 1e-12
"""m; a corner of a body of rods is found to rounding."""
MODELLED_MM = 0.1
"""mm; Vicon's program puts its own knee marker there to this, frame by frame."""
ROD = 0.095


def rods(seed: int) -> tuple[Array, Array]:
    """The corner (1, 3) and the ends (3, 1, 3) of three rods that point away from the origin, whichever way turned."""
    rng = np.random.default_rng(seed)
    at = rng.normal(size=3)
    at = 0.3 * at / np.linalg.norm(at)
    towards = Rotation.align_vectors([at], [np.ones(3)])[0] * Rotation.from_rotvec(0.3 * rng.normal(size=3))
    return at[None], at + ROD * towards.as_matrix().T[:, None]


@pytest.mark.parametrize("seed", range(8))
def test_the_corner_is_where_the_rods_meet(seed: int) -> None:
    at, ends = rods(seed)
    np.testing.assert_allclose(corner(*ends, inwards=-at), at, atol=ROUNDING)
    assert is_device(*ends)


@pytest.mark.parametrize("up", [0.0, 40.0])
def test_the_device_of_a_right_knee_points_to_the_left_one(up: float) -> None:
    """Rods that point outwards and upwards, as they may: the pelvis then lies beyond them, and the knee does not."""
    spread = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.ones(3)])[0]
    raised = Rotation.from_euler("x", -up, degrees=True)
    ends = ROD * (raised * spread).as_matrix().T[:, None]
    found = corner(*ends, inwards=np.array([[0.0, 0.0, -0.24]]))
    np.testing.assert_allclose(found, np.zeros((1, 3)), atol=ROUNDING)
    wrong = corner(*ends, inwards=np.array([[0.0, 0.0, 0.24]]))
    assert wrong is not None
    assert np.linalg.norm(wrong) > 0.08
    witness = corner(*ends, inwards=np.array([[0.0, 0.0, 0.24]]), modelled=np.full((1, 3), 1e-3))
    np.testing.assert_allclose(witness, np.zeros((1, 3)), atol=ROUNDING)
    assert corner(*ends) is None


def test_other_markers_are_no_device() -> None:
    _, ends = rods(0)
    assert not is_device(ends[0], ends[1], ends[2] + 0.1)
    assert not is_device(*(3.0 * ends))
    assert not is_device(*np.full_like(ends, np.nan))


@pytest.mark.parametrize("lab", ["kad", "multi"])
def test_it_is_where_the_vendors_program_has_it(lab: str, data_dir: Path) -> None:
    static = read_recording(data_dir / "labs_c3d" / lab / "static.c3d")
    whole = complete_static(static, load_marker_set("plug-in-gait"))
    assert static.computed is not None
    for label in ("RKNE", "LKNE"):
        theirs = static.computed.points[:, static.computed.labels.index(label)]
        ours = whole.markers[:, whole.labels.index(label)]
        apart = 1e3 * np.linalg.norm(ours - theirs, axis=1)
        assert np.nanmedian(apart) < MODELLED_MM
    assert any("RKNE" in note and "knee alignment device" in note for note in whole.notes)
