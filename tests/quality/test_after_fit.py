"""Post-fit checks: physical limits, leg by leg, and markers whose residuals have structure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from gaitcal.analysis.calibrate import find_impossible_functional_trials
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.errors import Code, Finding, Severity
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.quality.after_fit import (
    ANGLES_DEG,
    SPEEDS_DEG_S,
    TORQUES_PERCENT_BWH,
    TrackedMarkers,
    check_angle_changes,
    check_physical_limits,
    check_tracked_markers,
)
from gaitcal.quality.verdict import Judgement, judge
from gaitcal.synthetic.synthetic_motion import simulate_gait
from gaitcal.tracking.motion import MarkerErrors, Motion
from tests.messages import check_finding

Array = NDArray[np.float64]

WEIGHT, HEIGHT = 700.0, 1.75


def walking() -> Motion:
    true = simulate_gait()
    errors = MarkerErrors(
        ("R.Heel",), ("foot_r",), np.ones(1), np.full((len(true.basis.time), 1), 0.01)
    )
    shape = {"basis": true.basis, "coefficients": true.coefficients, "errors": errors}
    return Motion(name="walk", coordinates=COORDINATES, converged=True, **shape)  # type: ignore[arg-type]


def loads(walk: Motion) -> Moments:
    """Every torque at half of its limit."""
    n, bwh = len(walk.time), WEIGHT * HEIGHT
    tau = np.zeros((n, len(COORDINATES)))
    for name, limit in TORQUES_PERCENT_BWH.items():
        for k in (COORDINATE_INDEX.get(f"{name}_{side}") for side in "rl"):
            if k is not None:
                tau[:, k] = 0.005 * limit * bwh
    still = np.zeros((n, 3))
    return Moments(
        coordinates=COORDINATES,
        time=walk.time,
        tau=tau,
        knee_adduction=np.zeros((n, 2)),
        residual_force=still + 0.05 * WEIGHT,
        residual_moment=still + 0.01 * bwh,
        bwh=bwh,
    )


def all_of(walk: Motion) -> NDArray[np.bool_]:
    return np.ones(len(walk.time), dtype=bool)


def shifted(motion: Motion, coordinate: str, degrees: float) -> Motion:
    coefficients = motion.coefficients.copy()
    coefficients[:, COORDINATE_INDEX[coordinate]] += np.deg2rad(degrees)
    return replace(motion, coefficients=coefficients)


def test_walking_is_within_physical_limits() -> None:
    walk = walking()
    assert check_physical_limits(walk, WEIGHT, loads(walk), all_of(walk)) == ()


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("name", ANGLES_DEG)
def test_an_angle_beyond_anatomy_is_refused(name: str, side: str) -> None:
    low, high = ANGLES_DEG[name]
    for degrees in (high + 80.0, low - 80.0):
        (found,) = check_physical_limits(shifted(walking(), f"{name}_{side}", degrees), WEIGHT)
        assert found.severity is Severity.ERROR and found.leg == side
        assert f"{name}_{side}" in found.found
        check_finding(found, Code.IMPOSSIBLE_LEG, Severity.ERROR, f"{low:.0f}", f"{high:.0f}")


def test_a_jump_of_an_angle_is_refused() -> None:
    walk = walking()
    coefficients = walk.coefficients.copy()
    coefficients[len(coefficients) // 2, COORDINATE_INDEX["knee_angle_l"]] += np.deg2rad(600.0)
    (found,) = check_physical_limits(replace(walk, coefficients=coefficients), WEIGHT)
    check_finding(found, Code.IMPOSSIBLE_LEG, Severity.ERROR, "knee_angle_l", leg="l")


def bent(walk: Motion, node: int, degrees: float) -> Motion:
    coefficients = walk.coefficients.copy()
    coefficients[node, COORDINATE_INDEX["knee_angle_l"]] += np.deg2rad(degrees)
    return replace(walk, coefficients=coefficients)


@pytest.mark.parametrize("node", [0, -1])
def test_speed_at_the_ends_of_splines_is_no_finding(node: int) -> None:
    """One control point more by 60 deg at an end is a speed beyond the limit there, and none in the
    middle.
    """
    walk = bent(walking(), node, 60.0)
    at = COORDINATE_INDEX["knee_angle_l"]
    assert np.abs(np.rad2deg(walk.velocity[:, at])).max() > SPEEDS_DEG_S["knee_angle"]
    assert check_physical_limits(walk, WEIGHT) == ()


@pytest.mark.parametrize("name", TORQUES_PERCENT_BWH)
def test_a_torque_beyond_sprinting_is_refused_in_valid_frames_only(name: str) -> None:
    walk = walking()
    moments, valid = loads(walk), all_of(walk)
    torque, k = moments.tau, COORDINATE_INDEX.get(f"{name}_r", 0)
    if name == "knee_adduction":
        torque = moments.knee_adduction
    torque[30, k] = -0.011 * TORQUES_PERCENT_BWH[name] * moments.bwh
    (found,) = check_physical_limits(walk, WEIGHT, moments, valid)
    check_finding(found, Code.IMPOSSIBLE_LEG, Severity.ERROR, name, leg="r")
    assert f"({walk.time[30]:.2f}-" in found.found
    valid[30] = False
    assert check_physical_limits(walk, WEIGHT, moments, valid) == ()


def test_a_residual_of_many_body_weights_is_refused() -> None:
    walk = walking()
    moments = replace(loads(walk), residual_force=np.full((len(walk.time), 3), 10.0 * WEIGHT))
    (found,) = check_physical_limits(walk, WEIGHT, moments, all_of(walk))
    check_finding(found, Code.FORCES_OF_ANOTHER, Severity.ERROR, 1732, leg="")


def test_a_marker_far_from_the_model_is_refused() -> None:
    walk = walking()
    far = replace(walk.errors, distance=np.full((len(walk.time), 1), 0.3))
    (found,) = check_physical_limits(replace(walk, errors=far), WEIGHT)
    check_finding(found, Code.IMPOSSIBLE_LEG, Severity.ERROR, "R.Heel", 300)
    light = replace(far, weight=np.full(1, 0.02))
    assert check_physical_limits(replace(walk, errors=light), WEIGHT) == ()


def test_large_changes_are_notes_and_very_large_ones_warnings() -> None:
    walk = walking()
    assert list(check_angle_changes(walk, shifted(walk, "ankle_angle_r", 5.0))) == []
    (note,) = check_angle_changes(walk, shifted(walk, "subtalar_angle_r", 23.0))
    check_finding(note, Code.ANGLES_MOVED, Severity.INFO, "subtalar_angle_r", 23)
    (warning,) = check_angle_changes(walk, shifted(walk, "subtalar_angle_r", -60.0))
    assert warning.severity is Severity.WARNING


LABELS = ("R.Heel", "R.Toe", "R.Mid", "R.Elbow", "R.Wrist")
SEGMENTS = ("foot_r", "foot_r", "foot_r", "upper_arm_r", "forearm_hand_r")


def tracked(seed: int = 0) -> TrackedMarkers:
    """Markers with 8 mm of slow soft tissue motion, 80 mm on the arm, as after a fit."""
    rng = np.random.default_rng(seed)
    time = np.arange(200) / 100.0
    model = np.cumsum(rng.normal(size=(1, 5, 3)), axis=0) + 1.3 * time[:, None, None] * [
        1.0,
        0.0,
        0.0,
    ]
    model = model + 0.2 * np.sin(5.0 * time)[:, None, None] * rng.normal(size=(5, 3))
    waves = np.sin(rng.uniform(2, 9, (5, 3)) * time[:, None, None] + rng.uniform(0, 6, (5, 3)))
    size = np.array([8.0, 8.0, 8.0, 20.0, 20.0])[:, None] * 1e-3
    off = np.array([0.0, 0.0, 0.0, 0.06, 0.08])[:, None] * [1.0, 0.0, 0.0]
    return TrackedMarkers(
        name="walk",
        time=time,
        labels=LABELS,
        segments=SEGMENTS,
        weight=np.array([1.0, 1.0, 1.0, 0.02, 0.02]),
        measured=model + size * waves + off,
        model=model,
    )


def changed(markers: TrackedMarkers, k: int, frames: slice, path: Array) -> TrackedMarkers:
    measured = markers.measured.copy()
    measured[frames, k] = path
    return replace(markers, measured=measured)


@pytest.mark.parametrize("seed", range(6))
def test_slow_soft_tissue_and_arms_are_not_reported(seed: int) -> None:
    assert check_tracked_markers(tracked(seed)) == ()


@pytest.mark.parametrize("k", [0, 2, 3, 4])
@pytest.mark.parametrize("seed", range(3))
def test_displaced_marker_is_named_with_its_time(seed: int, k: int) -> None:
    sound = tracked(seed)
    start = int(np.random.default_rng(seed).integers(20, 150))
    frames = slice(start, start + 30)
    (found,) = check_tracked_markers(
        changed(sound, k, frames, sound.measured[frames, k] + [0.0, 0.15, 0.1])
    )
    check_finding(found, Code.MARKER_AWAY, f"{LABELS[k]}")
    assert f"({sound.time[start]:.2f}-" in found.found
    assert found.severity is (Severity.ERROR if k < 3 else Severity.WARNING)
    assert found.leg == ("r" if k < 3 else "")


def test_constant_and_straight_paths_are_interpolated() -> None:
    sound = tracked(1)
    frames = slice(60, 100)
    for end in (60, 100):
        line = sound.measured[60, 1] + np.linspace(0, 1, 40)[:, None] * (
            sound.measured[end, 1] - sound.measured[60, 1]
        )
        line = line + [0.0, 0.06, 0.0]
        (found,) = check_tracked_markers(changed(sound, 1, frames, line))
        check_finding(found, Code.MARKER_AWAY, Severity.ERROR, "R.Toe")


def test_swapped_markers_give_one_finding() -> None:
    sound = tracked(2)
    frames = slice(80, 121)
    swapped = changed(sound, 0, frames, sound.measured[frames, 4])
    swapped = changed(swapped, 4, frames, sound.measured[frames, 0])
    (found,) = check_tracked_markers(swapped)
    assert "'R.Heel'" in found.cause and "'R.Wrist'" in found.cause
    check_finding(found, Code.EXCHANGED_LABELS, Severity.ERROR)


def test_marker_displaced_throughout() -> None:
    sound = tracked(3)
    (found,) = check_tracked_markers(
        changed(sound, 2, slice(None), sound.measured[:, 2] + [0.0, 0.0, 0.09])
    )
    check_finding(found, Code.MARKER_OFF_STATIC, Severity.ERROR, "R.Mid", "foot_r")
    check_finding(found, Code.MARKER_OFF_STATIC, Severity.ERROR, 0.0, 1.99)


def test_markers_without_weight_are_skipped() -> None:
    sound = tracked(4)
    spoilt = changed(sound, 0, slice(50, 90), sound.measured[50:90, 0] + [0.0, 0.15, 0.0])
    assert len(check_tracked_markers(spoilt)) == 1
    assert (
        check_tracked_markers(replace(spoilt, weight=sound.weight * [0.0, 1.0, 1.0, 1.0, 1.0]))
        == ()
    )


def test_impossible_functional_trial_is_left_out_with_a_warning_without_leg() -> None:
    walk, other = walking(), bent(walking(), len(walking().coefficients) // 2, 600.0)
    trials = [
        SimpleNamespace(name="hip_l", joint="hip_l", motion=other),
        SimpleNamespace(name="hip_r", joint="hip_r", motion=walk),
        SimpleNamespace(name="walk", joint=None, motion=other),
    ]
    person = SimpleNamespace(subject=SimpleNamespace(weight=WEIGHT))

    def found(trials: list[SimpleNamespace], joint: object) -> dict[str, Finding]:
        return find_impossible_functional_trials(
            SimpleNamespace(joint=joint, trials=trials, model=person)
        )  # type: ignore[arg-type]

    (name, finding), *others = found(trials, "fitted").items()
    assert (name, finding.severity, finding.leg, others) == ("hip_l", Severity.WARNING, "", [])
    verdict = judge([finding], ["walk"])
    assert verdict.judgement is Judgement.DOUBTFUL and not verdict.list_refused_legs("walk")
    assert found(trials, None) == {} == found(trials[:1], "fitted"), (
        "nothing to fit, or nothing left"
    )
