"""What force plates err by, as torques of wrenches so changed; and the shares of sources."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.dynamics.axis_errors import ErrorSource, TorqueErrors
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.plate_errors import PlateErrors, wrench_errors, wrench_rates
from gaitcal.io.force_plate import LOADED_N, centre_on_ground
from gaitcal.study.settings import PlateErrorTable
from gaitcal.synthetic.motion import gait_motion, residual_free_wrench
from tests.derivatives import Array, perturbed_parameters

LINEAR = 1e-9
"""Forces are linear in wrenches: rounding."""
DRAWS = 400
SAMPLING = 0.15
"""Four standard deviations of a standard deviation from so many draws, 1 / sqrt(2 n) each."""


def walk() -> tuple[Dynamics, tuple[Array, Array, Array], Array, Array]:
    parameters, motion = perturbed_parameters(np.random.default_rng(61)), gait_motion()
    state = tuple(motion.basis.evaluate(motion.nodes, k) for k in range(3))
    return Dynamics(parameters), state, residual_free_wrench(parameters, motion), motion.basis.time  # type: ignore[return-value]


def turned(wrench: Array, angle: float) -> Array:
    """(nf, 6) a plate turned about the vertical through each centre of pressure, where one stands."""
    out = wrench.copy()
    on = wrench[:, 1] > LOADED_N
    point, rotation = centre_on_ground(wrench[on]), Rotation.from_rotvec([0.0, angle, 0.0])
    free = wrench[on, 3:] - np.cross(point, wrench[on, :3])
    out[on, :3] = rotation.apply(wrench[on, :3])
    out[on, 3:] = np.cross(point, out[on, :3]) + rotation.apply(free)
    return out


def errors_of(dynamics: Dynamics, q: Array, wrench: Array, time: Array, errors: PlateErrors) -> Array:
    """(nf, 29) standard errors of torques."""
    columns = dynamics.of_ground(q, wrench_errors(wrench, wrench_rates(time, wrench), errors))
    out: Array = np.sqrt((columns**2).sum(axis=2))
    return out


def test_the_ground_s_part_is_what_forces_with_and_without_it_differ_by() -> None:
    dynamics, (q, v, a), wrench, _ = walk()
    with_it, without = (dynamics.forces(q, v, a, w) for w in (wrench, np.zeros_like(wrench)))
    part = dynamics.of_ground(q, wrench[..., None])[..., 0]
    np.testing.assert_allclose(part, with_it - without, rtol=0, atol=LINEAR * np.abs(part).max())
    assert np.abs(part).max() > 10.0


@pytest.mark.parametrize("which", ["place", "gain", "turn", "clock"])
def test_each_part_is_the_scatter_of_torques_of_plates_that_err_so(which: str) -> None:
    """Plates drawn at random, their wrenches changed as a laboratory would: moved, louder, turned, a little late."""
    dynamics, (q, v, a), wrench, time = walk()
    size = {"place": 0.004, "gain": 0.02, "turn": 0.02, "clock": 0.0005}[which]
    errors = PlateErrors(**{"place": 0.0, "gain": 0.0, "clock": 0.0, which: size})
    expected = errors_of(dynamics, q, wrench, time, errors)
    rng = np.random.default_rng(62)
    true = dynamics.forces(q, v, a, wrench)
    squares = np.zeros_like(true)
    for _ in range(DRAWS):
        other = wrench.copy()
        if which == "clock":
            late = rng.normal(0.0, size)
            for foot in range(2):
                for k in range(6):
                    other[:, foot, k] = np.interp(time + late, time, wrench[:, foot, k])
        for foot in range(2):
            if which == "gain":
                other[:, foot] *= 1.0 + rng.normal(0.0, size)
            elif which == "place":
                other[:, foot, 3:] += np.cross(rng.normal(0.0, size, 3), wrench[:, foot, :3])
            elif which == "turn":
                other[:, foot] = turned(wrench[:, foot], rng.normal(0.0, size))
        squares += (dynamics.forces(q, v, a, other) - true) ** 2
    seen = np.sqrt(squares / DRAWS)
    inner = slice(2, -2)  # at the ends of a trial a clock reaches beyond it
    large = expected[inner] > 0.2 * expected[inner].max(axis=0)
    np.testing.assert_allclose(seen[inner][large], expected[inner][large], rtol=2 * SAMPLING)
    assert np.median(seen[inner][large] / expected[inner][large]) == pytest.approx(1.0, rel=SAMPLING)


def test_sizes_are_those_of_the_study_in_SI() -> None:
    errors = PlateErrors.of(PlateErrorTable(place_mm=3.0, turn_deg=2.0, gain_percent=2.0, clock_ms=5.0))
    assert (errors.place, errors.gain, errors.clock) == pytest.approx((0.003, 0.02, 0.005))
    assert errors.turn == pytest.approx(np.deg2rad(2.0))
    assert errors.any
    assert not PlateErrors.of(PlateErrorTable(place_mm=0.0, turn_deg=0.0, gain_percent=0.0, clock_ms=0.0)).any


def test_shares_are_parts_of_the_variance_over_valid_frames() -> None:
    rng = np.random.default_rng(63)
    by_source = {
        s: rng.uniform(0.0, 2.0, (30, len(FORCES)))
        for s in (ErrorSource.MOTION, ErrorSource.INERTIA, ErrorSource.PLATES)
    }
    by_source[ErrorSource.SKIN] = np.zeros((30, len(FORCES)))
    errors, valid = TorqueErrors.of(by_source), rng.uniform(size=30) > 0.3
    np.testing.assert_allclose(errors.every**2, sum(by_source.values()), rtol=1e-12)
    shares = errors.shares(len(FORCES) - 1, valid)
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-12)
    assert ErrorSource.SKIN not in shares, "absent, never 0"
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    total = (errors.knee_adduction[valid, 1] ** 2).sum()
    assert shares[ErrorSource.PLATES] == pytest.approx(by_source[ErrorSource.PLATES][valid, -1].sum() / total)
    assert errors.shares(3, np.zeros(30, dtype=bool)) == {}
