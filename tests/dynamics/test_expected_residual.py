"""The limit of the pelvis residual, exceeded as seldom as it says, wider for what is known to be in
it; its size.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gaitcal.analysis.result import Loads, TrialResult
from gaitcal.arrays import Array
from gaitcal.dynamics import expected_residual as module
from gaitcal.dynamics.expected_residual import (
    BASELINE_RESIDUAL,
    CORRELATION_S,
    PELVIS,
    ExpectedResidual,
    ResidualLimits,
    compute_residual_limits,
    compute_residual_magnitudes,
    estimate_expected_residual,
)
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.measurement_errors import TorqueErrors
from gaitcal.io.recording import ForcePlate
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import read_published_parameters
from tests.fake_result import fake_calibration

WEIGHT = 70.0 * 9.81
VALID = np.array([False, True, True])
NOTHING = np.zeros((1, 3))


@lru_cache(maxsize=1)
def walk() -> TrialResult:
    """Standing on both feet: forces that do not change, so that nothing is faster than
    the motion.
    """
    trial = fake_calibration().trial("walk")
    wrench = np.zeros_like(trial.loads.reactions.wrench)
    wrench[:, :, 1] = 350.0
    return replace(
        trial, loads=replace(trial.loads, reactions=replace(trial.loads.reactions, wrench=wrench))
    )


def loads() -> Loads:
    found = walk().loads
    assert found is not None
    return found


def held(residual: Array, bar: Array, wrench: Array | None = None) -> ExpectedResidual:
    """Of residuals (nf, 6), with standard errors (6,)."""
    known = loads()
    tau = np.zeros((len(residual), len(COORDINATES)))
    tau[:, PELVIS] = bar
    moments = replace(known.final, residual_force=residual[:, :3], residual_moment=residual[:, 3:])
    reactions = known.reactions if wrench is None else replace(known.reactions, wrench=wrench)
    found = estimate_expected_residual(
        moments, TorqueErrors(tau, np.zeros((len(tau), 2))), reactions, walk().body, WEIGHT
    )
    assert found is not None
    return found


def usual() -> Array:
    return np.asarray(BASELINE_RESIDUAL * np.repeat([WEIGHT, loads().final.bwh], 3))


def test_without_errors_a_walk_is_expected_to_leave_what_walks_leave() -> None:
    frames = len(walk().body.time)
    found = held(np.zeros((frames, 6)), np.zeros(6))
    assert found.force.expected == pytest.approx(np.sqrt((usual()[:3] ** 2).mean()))
    assert found.moment.expected == pytest.approx(np.sqrt((usual()[3:] ** 2).mean()))
    found = held(np.ones((frames, 6)), np.full(6, 20.0))
    assert found.force.rms == pytest.approx(1.0)
    assert found.force.expected == pytest.approx(np.sqrt((usual()[:3] ** 2).mean() + 400.0))
    assert found.within and found.share < 0.1


def test_errors_of_translations_are_of_the_force_and_errors_of_turns_of_the_moment() -> None:
    assert [COORDINATES[k] for k in PELVIS[:3]] == ["pelvis_tx", "pelvis_ty", "pelvis_tz"]
    # the lateral axis of tilt comes last, as U has it forward, up and to the right
    assert [COORDINATES[k] for k in PELVIS[3:]] == ["pelvis_list", "pelvis_rotation", "pelvis_tilt"]


@pytest.mark.parametrize("bar", [0.0, 1.0, 4.0])
def test_the_limit_is_exceeded_as_seldom_as_it_says(
    bar: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors that last through a trial and others that forget themselves, mixed in any share."""
    monkeypatch.setattr(module, "FALSE_ALARM_RATE", share := 0.05)
    rng, time = np.random.default_rng(2), walk().body.time
    rho = np.exp(-np.median(np.diff(time)) / CORRELATION_S)
    drawn, trials = 0, 300
    for _ in range(trials):
        noise = rng.normal(size=(len(time), 6))
        for k in range(1, len(time)):
            noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
        drawn += not held(usual() * (noise + bar * rng.normal(size=6)), bar * usual()).force.within
    assert drawn / trials == pytest.approx(share, abs=0.04)


def test_what_plates_hold_above_the_motions_bandwidth_is_expected() -> None:
    frames, quiet = len(walk().body.time), np.zeros(6)
    still = held(np.zeros((frames, 6)), quiet)
    impact, push = (np.array(loads().reactions.wrench) for _ in range(2))
    impact[50:52, 0, 1] += 600.0
    push[:, 0, 1] += 200.0 * np.sin(2 * np.pi * 0.5 * walk().body.time)
    assert held(np.zeros((frames, 6)), quiet, impact).force.expected > 1.2 * still.force.expected
    assert held(np.zeros((frames, 6)), quiet, push).force.expected < 1.05 * still.force.expected


def test_nothing_is_held_without_errors_or_valid_frames() -> None:
    known = loads()
    nothing = replace(known.reactions, valid=np.zeros_like(known.reactions.valid))
    assert (
        estimate_expected_residual(known.final, known.errors, nothing, walk().body, WEIGHT) is None
    )
    unknown = known.errors.select(np.zeros(len(COORDINATES), dtype=bool))
    assert (
        estimate_expected_residual(known.final, unknown, known.reactions, walk().body, WEIGHT)
        is None
    )


def limits(pelvis_height: float, floor: float) -> ResidualLimits:
    """Standing with 300 N on each foot where it counts, over plates at the height `floor` (m)."""
    q = np.zeros((3, len(COORDINATES)))
    q[:, COORDINATES.index("pelvis_ty")] = pelvis_height
    wrench = np.zeros((3, 2, 6))
    wrench[:, :, 1] = np.array([900.0, 300.0, 250.0])[:, None]
    feet = np.ones((3, 2), dtype=bool)
    corners = np.array([[0.0, floor, 0.0], [1.0, floor, 0.0], [1.0, floor, 1.0], [0.0, floor, 1.0]])
    plate = ForcePlate(
        name="1", time=np.zeros(1), force=NOTHING, point=NOTHING, moment=NOTHING, corners=corners
    )
    reactions = GroundReactions(
        wrench=wrench, valid=VALID, valid_legs=feet, loaded=feet, resting=feet, notes=()
    )
    return compute_residual_limits(read_published_parameters(), q, reactions, [plate])


def test_limits_are_shares_of_the_peak_force_and_of_the_height_over_the_floor() -> None:
    on_floor, raised, higher = limits(1.0, 0.0), limits(1.0, 0.1), limits(1.2, 0.0)
    assert on_floor.peak_force == pytest.approx(600.0, rel=1e-12)
    assert on_floor.force == pytest.approx(30.0, rel=1e-12)
    assert on_floor.moment == pytest.approx(0.01 * 600.0 * on_floor.centre_height, rel=1e-12)
    assert raised.centre_height == pytest.approx(on_floor.centre_height - 0.1, abs=1e-12)
    assert higher.centre_height == pytest.approx(on_floor.centre_height + 0.2, abs=1e-12)


def test_size_of_a_residual_over_valid_frames() -> None:
    moments = replace(
        loads().final,
        residual_force=np.array([[90.0, 0, 0], [3, 4, 0], [0, 0, 1]]),
        residual_moment=np.array([[0.0, 0, 80], [0, 2, 0], [1, 2, 2]]),
    )
    size = compute_residual_magnitudes("nominal model", moments, VALID)
    np.testing.assert_allclose(size.force, [90, 5, 1])
    np.testing.assert_allclose(size.moment, [80, 2, 3])
    assert (size.peak_force, size.peak_moment) == pytest.approx((5.0, 3.0))
    assert (size.rms_force, size.rms_moment) == pytest.approx((np.sqrt(26 / 6), np.sqrt(13 / 6)))
