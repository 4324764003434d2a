"""Force plates of all four types with every fault that real ones have; the filter of their
wrenches.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.errors import Code
from gaitcal.io.c3d.plates import compute_wrench
from gaitcal.io.force_plate import (
    build_plate_frame,
    compute_centre_on_ground,
    filter_low_pass,
    filter_plate,
    find_empty_samples,
    resample_wrench,
)
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from tests.io.recordings import CORNERS_MM, plate, standing_points_mm, write_raw_c3d
from tests.messages import check_text, refuses

FRAMES, RATIO = 100, 10
ARM = np.array([0.01, -0.02, -0.04])
"""m, from the sensor origin to the middle of the surface, in plate axes."""
A, B = 0.12, 0.2
"""m, half distances of a type-3 plate's sensors."""
FLOAT32 = 1e-6
"""Relative: C3D holds 32-bit floats."""
ROTATION = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]).T
"""Columns: the plate's axes in the z-up laboratory, after CORNERS_MM."""
Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


class Truth:
    """A step on the plate, in plate axes: z down, so the reaction is negative."""

    def __init__(self) -> None:
        samples = np.arange(FRAMES * RATIO)
        load = np.where((samples > 300) & (samples < 800), 600 + 100 * np.sin(samples / 50), 0.0)
        self.force = np.column_stack([0.1 * load, -0.05 * load, -load])
        self.point = np.column_stack(
            [0.05 * np.sin(samples / 90), 0.08 * np.cos(samples / 70), 0 * load]
        )
        self.free = 0.004 * load
        self.moment = np.cross(self.point, self.force)
        self.moment[:, 2] += self.free

    def sensor_channels(self, arm: np.ndarray) -> np.ndarray:
        """Fx..Mz (6, ns), N and N·mm, about the sensor origin."""
        return np.concatenate([self.force.T, 1e3 * (self.moment + np.cross(arm, self.force)).T])

    def laboratory_wrench(self) -> np.ndarray:
        """(ns, 6) about the laboratory origin, y up."""
        turn = Z_UP_TO_Y_UP @ ROTATION
        force = self.force @ turn.T
        centre = Z_UP_TO_Y_UP @ (CORNERS_MM.mean(axis=0) / 1e3)
        return np.hstack([force, self.moment @ turn.T + np.cross(centre, force)])


def read_plate(
    folder: Path,
    kind: int,
    channels: np.ndarray,
    origin_mm: np.ndarray,
    units: list[str] | None = None,
    points: np.ndarray | None = None,
    **more: Any,
) -> Recording:
    platform = {
        "USED": [1],
        "TYPE": [kind],
        "ZERO": [1, 0],
        "CORNERS": CORNERS_MM.T[:, :, None],
        "ORIGIN": np.asarray(origin_mm, dtype=float)[:, None],
        "CHANNEL": np.arange(1, len(channels) + 1)[:, None],
    }
    platform.update(more)
    units = units or ["N"] * 3 + ["Nmm"] * (len(channels) - 3)
    path = folder / "plate.c3d"
    labels = [f"M{i}" for i in range(8)]
    points = standing_points_mm(FRAMES) if points is None else points
    write_raw_c3d(
        path, points, labels, analogs=channels, ratio=RATIO, platform=platform, analog_units=units
    )
    return read_recording(path)


def require_truth(recording: Recording, truth: Truth) -> None:
    (plate,) = recording.plates
    expected = truth.laboratory_wrench()
    scale = np.abs(expected).max(axis=0)
    assert np.all(np.abs(plate.wrench() - expected) < FLOAT32 * np.maximum(scale, 100))
    loaded = truth.force[:, 2] < -100
    turn = Z_UP_TO_Y_UP @ ROTATION
    point = (CORNERS_MM.mean(axis=0) / 1e3) @ Z_UP_TO_Y_UP.T + truth.point @ turn.T
    np.testing.assert_allclose(plate.point[loaded], point[loaded], atol=1e-6)
    np.testing.assert_allclose(plate.moment[loaded, 1], -truth.free[loaded], atol=1e-4)
    np.testing.assert_allclose(plate.moment[loaded][:, [0, 2]], 0, atol=1e-4)
    assert np.all(plate.point[~loaded] == plate.point[0])  # the middle of the plate


def test_type_1_gives_centre_of_pressure_and_free_moment(tmp_path: Path) -> None:
    truth = Truth()
    noisy_when_empty = np.where(np.abs(truth.force[:, 2:]) > 0, truth.point, 1e4)
    channels = np.concatenate(
        [truth.force.T, 1e3 * noisy_when_empty[:, :2].T, 1e3 * truth.free[None]]
    )
    require_truth(
        read_plate(tmp_path, 1, channels, np.zeros(3), ["N", "N", "N", "mm", "mm", "Nmm"]), truth
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_type_2_takes_moments_from_the_sensor_origin_whatever_the_sign_of_origin(
    tmp_path: Path, sign: float
) -> None:
    truth = Truth()
    require_truth(read_plate(tmp_path, 2, truth.sensor_channels(ARM), sign * 1e3 * ARM), truth)


def test_type_2_with_moments_in_newton_metres(tmp_path: Path) -> None:
    truth = Truth()
    channels = truth.sensor_channels(ARM)
    channels[3:] /= 1e3
    require_truth(read_plate(tmp_path, 2, channels, 1e3 * ARM, ["N"] * 3 + ["Nm"] * 3), truth)


def test_type_3_adds_up_its_eight_sensors(tmp_path: Path) -> None:
    truth = Truth()
    arm = np.array([0.0, 0.0, ARM[2]])
    force, moment = truth.force.T, (truth.moment + np.cross(arm, truth.force)).T
    fx, fy, fz = force
    # Four corner forces of given sum and moments; shear split so that both directions give a part
    # of Mz.
    z = np.linalg.solve(
        np.array([[1, 1, 1, 1], [B, B, -B, -B], [-A, A, A, -A], [1, -1, 1, -1]], dtype=float),
        np.stack([fz, moment[0], moment[1], 0 * fz]),
    )
    dx, dy = 0.6 * moment[2] / B, 0.4 * moment[2] / A
    channels = np.stack([(fx - dx) / 2, (fx + dx) / 2, (fy + dy) / 2, (fy - dy) / 2, *z])
    recording = read_plate(
        tmp_path, 3, channels, np.array([1e3 * A, 1e3 * B, 1e3 * ARM[2]]), ["N"] * 8
    )
    require_truth(recording, truth)
    computed_force, computed_moment = compute_wrench(
        3, channels, np.array([A, B, ARM[2]]), 1.0, 1.0
    )
    np.testing.assert_allclose(computed_force, truth.force, atol=1e-9)
    np.testing.assert_allclose(computed_moment, truth.moment, atol=1e-9)


def test_type_4_multiplies_by_its_calibration_matrix(tmp_path: Path) -> None:
    truth = Truth()
    matrix = np.diag([500.0, 500, 1000, 8e5, 4e5, 4e5]) + np.arange(36).reshape(6, 6)
    volts = np.linalg.solve(matrix, truth.sensor_channels(ARM))
    recording = read_plate(tmp_path, 4, volts, 1e3 * ARM, ["V"] * 6, CAL_MATRIX=matrix[:, :, None])
    require_truth(recording, truth)


def test_origin_without_height_takes_the_sign_that_puts_feet_on_the_plate(tmp_path: Path) -> None:
    truth = Truth()
    arm = np.array([0.9, -0.3, 0.0])
    assert not any(
        "ORIGIN" in n for n in read_plate(tmp_path, 2, truth.sensor_channels(arm), 1e3 * arm).notes
    )
    recording = read_plate(tmp_path, 2, truth.sensor_channels(arm), -1e3 * arm)
    check_text(recording.notes)
    require_truth(recording, truth)


def test_a_force_that_points_down_is_turned_round_and_told(tmp_path: Path) -> None:
    truth = Truth()
    recording = read_plate(tmp_path, 2, -truth.sensor_channels(ARM), 1e3 * ARM)
    check_text(recording.notes)
    require_truth(recording, truth)


def test_the_offset_of_the_empty_plate_is_found_removed_and_told(tmp_path: Path) -> None:
    truth = Truth()
    offset = np.array([12.0, -8.0, 18.0, 500.0, -900.0, 300.0])
    noise = np.random.default_rng(3).normal(0, 0.5, (6, FRAMES * RATIO)) * [
        [1],
        [1],
        [1],
        [10],
        [10],
        [10],
    ]
    recording = read_plate(
        tmp_path, 2, truth.sensor_channels(ARM) + offset[:, None] + noise, 1e3 * ARM
    )
    check_text(recording.notes, 1)
    (plate,) = recording.plates
    away = plate.wrench() - truth.laboratory_wrench()
    assert np.abs(away[:, :3]).max() < 3  # N, six standard deviations
    middle = plate.corners.mean(axis=0)
    assert (
        np.abs(away[:, 3:] - np.cross(middle, away[:, :3])).max() < 0.2
    )  # N·m about the middle of the plate


BASELINE = np.array(
    [12.0, -18.0, -140.0, 3000.0, -2000.0, 500.0]
)  # N and N·mm, far beyond what plates should read


def walking_points_mm(first: int, last: int) -> np.ndarray:
    """Points that are over the plate in these frames, and 5 m beside it in the others."""
    points = standing_points_mm(FRAMES) + [0.0, 400.0, 0.0]
    points[:first, :, 0] -= 5000.0
    points[last:, :, 0] += 5000.0
    return points


@pytest.mark.parametrize("zero", [[1, 20], [1, 0], [1, 9999]])
@pytest.mark.parametrize(
    ("there", "found"),
    [((28, 82), True), ((0, FRAMES), False), ((90, 95), False), ((FRAMES, FRAMES), False)],
)
def test_a_steady_baseline_of_any_size_is_one_where_nobody_is_over_the_plate(
    tmp_path: Path, zero: list[int], there: tuple[int, int], found: bool
) -> None:
    """With ZERO or without. Not with somebody over it, whatever ZERO says: who sits still weighs as
    steadily. Nor where the plate is loaded while nobody is over it: then it lies elsewhere.
    """
    truth = Truth()
    channels = truth.sensor_channels(ARM) + BASELINE[:, None]
    recording = read_plate(
        tmp_path, 2, channels, 1e3 * ARM, points=walking_points_mm(*there), ZERO=zero
    )
    away = recording.plates[0].force[:, 1] + truth.force[:, 2]
    assert np.abs(away - (0.0 if found else 140.0)).max() < 1e-3
    assert any("never empty" in note for note in recording.notes) is not found


def test_the_baseline_of_a_real_walk_is_that_of_zero(data_dir: Path) -> None:
    """140 and 95 N: refused before, the same wrench as without now."""
    found, usual = (
        read_recording(data_dir / name / "gait.c3d").plates
        for name in ("cases/plate_zero", "pig_c3d")
    )
    for ours, theirs in zip(found, usual, strict=True):
        assert np.abs(ours.wrench() - theirs.wrench()).max() < 1e-3


@pytest.mark.parametrize("unit", ["", "Nmm", "Nm"])
@pytest.mark.parametrize("newton_metres", [True, False])
def test_the_unit_of_moments_is_that_with_which_the_centre_of_pressure_moves(
    tmp_path: Path, unit: str, newton_metres: bool
) -> None:
    """Named or not: in another unit it stays at the sensor's axis, or lies beyond the plate. A unit
    that the file names wrongly is a warning.
    """
    truth = Truth()
    channels = (
        truth.sensor_channels(ARM)
        * np.array([1.0] * 3 + [1e-3 if newton_metres else 1.0] * 3)[:, None]
    )
    recording = read_plate(tmp_path, 2, channels, 1e3 * ARM, ["N"] * 3 + [unit] * 3)
    require_truth(recording, truth)
    wrong = newton_metres if unit != "Nm" else not newton_metres
    assert any("its moments are in units of" in note for note in recording.notes) is wrong
    assert any("declares in its UNITS" in note for note in recording.notes) is (
        wrong and bool(unit)
    )


def test_centres_of_a_type_1_plate_in_metres_are_seen_to_be(tmp_path: Path) -> None:
    truth = Truth()
    channels = np.concatenate([truth.force.T, truth.point[:, :2].T, truth.free[None]])
    recording = read_plate(tmp_path, 1, channels, np.zeros(3), ["N"] * 3 + ["m"] * 2 + ["Nm"])
    loaded = truth.force[:, 2] < -50
    turn = Z_UP_TO_Y_UP @ ROTATION
    centre = Z_UP_TO_Y_UP @ (CORNERS_MM.mean(axis=0) / 1e3)
    np.testing.assert_allclose(
        recording.plates[0].point[loaded], (truth.point @ turn.T + centre)[loaded], atol=1e-5
    )


def test_moments_of_a_real_walk_in_newton_metres_without_a_unit(data_dir: Path) -> None:
    """Refused before, for a place of the plates; the same wrench as in N·mm now."""
    found, usual = (
        read_recording(data_dir / name / "gait.c3d").plates
        for name in ("cases/moments_in_nm", "pig_c3d")
    )
    for ours, theirs in zip(found, usual, strict=True):
        assert np.abs(ours.wrench() - theirs.wrench()).max() < 1e-4


def test_a_plate_never_empty_keeps_its_offset_and_says_so(tmp_path: Path) -> None:
    truth = Truth()
    truth.force[:] = [0.0, 0.0, -600.0]
    truth.moment[:] = 0
    recording = read_plate(tmp_path, 2, truth.sensor_channels(ARM), 1e3 * ARM)
    check_text(recording.notes)
    np.testing.assert_allclose(recording.plates[0].force[:, 1], 600, rtol=1e-6)
    truth = Truth()
    truth.moment += np.cross([0.0, 1.5, 0.0], truth.force)
    notes = read_plate(tmp_path, 2, truth.sensor_channels(ARM), 1e3 * ARM).notes
    check_text(notes)


@pytest.mark.parametrize(
    "change, reason",
    [
        ({"CORNERS": np.zeros((3, 4, 1))}, "sides measure"),
        ({"CORNERS": np.full((3, 4, 1), np.nan)}, "no finite numbers"),
        ({"CORNERS": np.random.default_rng(0).uniform(0, 900, (3, 4, 1))}, "no rectangle"),
        ({"CHANNEL": np.array([[1, 2, 3, 4, 5, 60]]).T}, "it uses channels"),
        ({"TYPE": [7]}, "its type is 7"),
    ],
)
def test_a_plate_that_cannot_be_placed_is_left_out_and_told(
    tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    recording = read_plate(tmp_path, 2, Truth().sensor_channels(ARM), 1e3 * ARM, **change)
    assert recording.plates == ()
    check_text(recording.notes, 1, reason)


def test_samples_without_numbers_at_the_end_are_cut_off(tmp_path: Path) -> None:
    channels = Truth().sensor_channels(ARM)
    channels[:, -37:] = np.nan
    (plate,) = read_plate(tmp_path, 2, channels, 1e3 * ARM).plates
    assert len(plate.time) == FRAMES * RATIO - 37
    assert np.isfinite(plate.wrench()).all()


def test_tilted_corners_give_a_proper_frame() -> None:
    tilted = CORNERS_MM / 1e3
    tilted[:2, 2] += 0.02
    frame = build_plate_frame(tilted)
    np.testing.assert_allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert frame.up[2] > 0.99


def test_empty_stretches_leave_out_landing_and_lift_off() -> None:
    vertical = np.concatenate(
        [np.full(500, 15.0), np.linspace(15, 700, 50), np.full(300, 700.0), np.full(30, 15.0)]
    )
    empty = find_empty_samples(vertical, 1000.0)
    assert empty[100]
    assert not empty[
        485:
    ].any()  # STEP_MARGIN_S before the step, the step, and a stretch shorter than QUIET_S


@pytest.mark.parametrize("height", [0.0, -0.3])
def test_centre_on_the_ground_is_where_force_and_free_moment_act(height: float) -> None:
    force, point, free = (
        np.array([40.0, 700.0, -90.0]),
        np.array([0.4, height, -0.2]),
        np.array([0.0, 7.0, 0.0]),
    )
    wrench = np.hstack([force, np.cross(point, force) + free])
    np.testing.assert_allclose(compute_centre_on_ground(wrench, height), point, atol=1e-15)


RATE = 1000.0
TIME = np.arange(4000) / RATE


def response(frequency: float, cutoff: float) -> complex:
    """Of the filter to a wave of that frequency, Hz."""
    wave = np.exp(2j * np.pi * frequency * TIME)
    out = filter_low_pass(np.column_stack([wave.real, wave.imag]), RATE, cutoff)
    return complex(np.mean(((out[:, 0] + 1j * out[:, 1]) / wave)[1500:2500]))


@pytest.mark.parametrize("cutoff", [6.0, 20.0, 400.0])
def test_three_decibels_at_the_stated_cutoff_after_both_passes_and_no_delay(cutoff: float) -> None:
    assert response(cutoff, cutoff) == pytest.approx(2**-0.5, abs=1e-6)


def test_fourth_order_slope() -> None:
    """24 dB an octave of the warped frequency tan(pi f / fs)."""
    octaves = np.log2(np.tan(np.pi * 0.16) / np.tan(np.pi * 0.08))
    fall = 20 * np.log10(abs(response(80.0, 10.0) / response(160.0, 10.0)))
    assert fall == pytest.approx(24 * octaves, rel=0.01)


@pytest.mark.parametrize("cutoff", [0.0, -5.0, 500.0, float("nan")])
def test_cutoffs_beyond_nyquist_are_refused(cutoff: float) -> None:
    with refuses(Code.FORCE_FILTER, 500, field="filter cut-off"):
        filter_low_pass(np.zeros((100, 1)), RATE, cutoff)


def test_stretches_between_gaps_are_filtered_each_alone() -> None:
    values = np.ones((300, 2))
    values[:100] = 5.0
    values[100:150, 0] = np.nan
    values[299] = np.nan
    out = filter_low_pass(values, RATE, 10.0)
    np.testing.assert_allclose(out[:100], 5.0)
    np.testing.assert_allclose(out[150:299], 1.0)
    assert np.isnan(out[100:150, 0]).all()


def test_the_wrench_about_the_origin_is_filtered_not_the_centre_of_pressure() -> None:
    raw = plate(TIME)
    smooth = filter_plate(raw, 15.0)
    np.testing.assert_allclose(
        smooth.wrench(), filter_low_pass(raw.wrench(), RATE, 15.0), atol=1e-9
    )
    loaded = smooth.force[:, 1] > 100
    np.testing.assert_allclose(smooth.point[loaded, 1], 0, atol=1e-12)
    np.testing.assert_allclose(smooth.moment[loaded][:, [0, 2]], 0, atol=1e-9)
    middle = raw.force[:, 1] > 500
    np.testing.assert_allclose(smooth.point[middle], raw.point[middle], atol=2e-3)


def test_the_height_of_the_points_is_kept_with_corners_or_without() -> None:
    with_corners = plate(TIME)
    with_corners = replace(with_corners, point=with_corners.point + [0.0, -0.0075, 0.0])
    raw = replace(with_corners, corners=None)
    smooth = filter_plate(raw, 15.0)
    np.testing.assert_array_equal(filter_plate(with_corners, 15.0).point, smooth.point)
    np.testing.assert_allclose(
        smooth.wrench(), filter_low_pass(raw.wrench(), RATE, 15.0), atol=1e-9
    )
    np.testing.assert_allclose(smooth.point[smooth.force[:, 1] > 100, 1], -0.0075, atol=1e-9)


def test_resampling_is_linear_inside_and_unknown_outside() -> None:
    raw = plate(TIME)
    wrench = raw.wrench()
    at = np.array([-0.01, 0.0, 1.0005, 3.999, 4.2])
    found = resample_wrench(raw, at)
    assert np.isnan(found[[0, 4]]).all()
    np.testing.assert_allclose(found[1], wrench[0])
    np.testing.assert_allclose(found[2], 0.5 * (wrench[1000] + wrench[1001]))
    np.testing.assert_allclose(found[3], wrench[3999])
