"""Phase 2 from correct and random seeds, the falling penalty, and the third step."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration.inertial_calibration import RootEquations, fit_published
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.model.parameters import IP_INDEX, IP_NAMES, MASSIVE_SEGMENTS, dynamic_jacobian, symmetric_set
from gaitcal.published.inertial_recovery import (
    SEED_RANGE,
    SeedResult,
    gait_equations,
    random_seed,
    recover_inertia,
    true_wrench,
)
from gaitcal.published.joint_recovery import true_model, true_motion

RESIDUAL = 1e-9
"""N, N·m: asked for; the paper reached 8e-10 and 2e-10 from the correct seed."""
INERTIA = 1e-6
"""kg mm^2."""
SEEN = 31
"""Of 36 directions: what the pelvis residual of this gait tells of the symmetric parameters."""


@pytest.fixture(scope="module")
def equations() -> RootEquations:
    return gait_equations(true_model().parameters, true_motion("full leg").nodes)


def test_correct_seed_without_noise_is_exact(clean: SeedResult) -> None:
    found = clean.correct
    assert max(found.force, found.torque) < RESIDUAL
    assert found.errors.inertia < INERTIA
    assert max(found.errors.mass, found.errors.centre, abs(found.total_mass)) < INERTIA


def test_random_seeds_without_noise_leave_no_residual(clean: SeedResult) -> None:
    assert len(clean.random) == 2
    for found in clean.random:
        assert found.converged
        assert max(found.force, found.torque) < RESIDUAL
        assert found.errors.inertia > 1.0, "the seed was not random"


def test_published_procedure_creeps_from_random_seeds(equations: RootEquations) -> None:
    """Why the penalty falls: to the letter, 200 re-seeds leave residuals that are not zero, and it says so."""
    seed = random_seed(np.random.default_rng(0), with_held=False)
    fit = fit_published(equations, seed, symmetric_set())
    assert max(fit.rms_force, fit.rms_moment) > 1e-3
    assert not fit.converged
    assert "still change" in fit.message


def test_falling_penalty_keeps_the_fixed_points(equations: RootEquations) -> None:
    """Its solution is a fixed point of the published procedure: re-seeded there, nothing moves."""
    seed = random_seed(np.random.default_rng(1), with_held=False)
    solution = fit_published(equations, seed, symmetric_set(), decay=0.1)
    again = fit_published(equations, solution.inertial, symmetric_set())
    assert again.seeds == 1
    assert again.inertial == pytest.approx(solution.inertial, rel=1e-9, abs=1e-12)
    assert solution.seeds > 2


def test_no_decay_is_the_published_procedure(draws: list[SeedResult]) -> None:
    gait = draws[0].joints["full leg"]
    noisy, truth = gait_equations(gait.parameters, gait.nodes), true_model().parameters.inertial
    one = fit_published(noisy, truth, symmetric_set(), reseed=False)
    two = fit_published(noisy, one.inertial, symmetric_set(), reseed=False)
    by_hand = [recover_inertia(noisy, truth).seeds, draws[0].correct.seeds]
    assert by_hand[0] == by_hand[1] > 2
    assert draws[0].correct.force < two.rms_force < one.rms_force < draws[0].residual_before[0]


def test_pelvis_residual_sees_31_of_36_directions(equations: RootEquations) -> None:
    s, truth = symmetric_set().selection, true_model().parameters.inertial
    blocks = np.einsum("rsd,sdk->rsk", equations.factor.reshape(-1, len(MASSIVE_SEGMENTS), 10), dynamic_jacobian(truth))
    values = np.linalg.svd(
        blocks.reshape(-1, len(IP_NAMES)) @ s * (s.T @ truth / (s * s).sum(axis=0)), compute_uv=False
    )
    assert (values > 1e-10 * values[0]).sum() == SEEN
    assert values[SEEN] < 1e-13


def test_true_model_has_no_residual() -> None:
    motion, parameters = true_motion("full leg"), true_model().parameters
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    assert np.abs(pelvis_residual(q, Dynamics(parameters).forces(q, v, a, true_wrench()))).max() < RESIDUAL


@pytest.mark.parametrize("with_held", [False, True])
def test_random_seeds(with_held: bool) -> None:
    truth, which = true_model().parameters.inertial, symmetric_set()
    seeds = np.array([random_seed(np.random.default_rng(k), with_held=with_held) for k in range(200)])
    moved = truth != 0.0
    ratio = seeds[:, moved] / truth[moved] - 1.0
    assert np.abs(ratio).max() <= SEED_RANGE
    free = which.selection.any(axis=1)[moved]
    assert np.abs(ratio[:, free]).max(axis=0).min() > 0.9 * SEED_RANGE
    right, left = (seeds[:, IP_INDEX[f"thigh_{side}.com.sup"]] for side in "rl")
    assert np.array_equal(right, left)
    held = seeds[:, IP_INDEX["foot_l.com.sup"]]
    assert (np.ptp(held) > 0) == with_held
    assert not seeds[:, IP_INDEX["thigh_l.com.ant"]].any()


def test_third_step_lowers_both_residuals(draws: list[SeedResult]) -> None:
    for draw in draws:
        assert draw.third is not None
        assert draw.third.converged
        assert draw.third.force[1] < 0.6 * draw.third.force[0]
        assert draw.third.torque[1] < 0.6 * draw.third.torque[0]
        assert draw.third.marker_mm[0] == draw.joints["full leg"].marker_mm
        assert 1.0 < draw.third.marker_mm[1] / draw.third.marker_mm[0] < 1.1
