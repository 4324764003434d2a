"""Phases 1 to 3 on synthetic data: exact without noise; definitions of errors that give the printed figures."""

import numpy as np
import pytest

from gaitcal.calibration.inertial_calibration import RootEquations, fit_published
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import (
    IP_INDEX,
    IP_NAMES,
    IP_TO_SI,
    JP_INDEX,
    JP_TO_SI,
    MASSIVE_SEGMENTS,
    Parameters,
    dynamic_jacobian,
    leg_parameters,
    published_subject,
    symmetric_set,
)
from gaitcal.published.inertial_recovery import (
    SEED_RANGE,
    SeedResult,
    gait_equations,
    generators,
    inertial_rms,
    noisy_draws,
    random_seed,
    symmetric_errors,
)
from gaitcal.published.joint_recovery import (
    LEG,
    free_parameters,
    joint_errors,
    joint_rms,
    synthetic_problem,
    true_model,
    true_motion,
)
from gaitcal.published.protocol import PROBLEMS, table_four, table_one, table_three, table_two
from gaitcal.published.reproduce import draw_frame
from tests.published.conftest import FEW_SEEDS

MARKER_MM = 1e-9
"""What is asked for; the paper reached 1e-8 to 2e-6."""
PARAMETER = 1e-6
"""deg, mm."""
NODES = 1e-9
"""m, rad."""


@pytest.mark.parametrize("problem", PROBLEMS)
def test_exact_without_noise(clean: SeedResult, problem: str) -> None:
    found = clean.joints[problem]
    assert found.converged
    assert found.marker_mm < MARKER_MM
    assert np.abs(found.errors).max() < PARAMETER
    assert found.nodes == pytest.approx(true_motion(problem).nodes, abs=NODES)


def test_problems_are_the_published_ones(clean: SeedResult) -> None:
    assert [len(free_parameters(p)) for p in PROBLEMS] == [6, 9, 12, 17]
    assert [len(clean.joints[p].names) for p in PROBLEMS] == [6, 9, 12, len(leg_parameters("l"))]
    for problem in PROBLEMS:
        markers = synthetic_problem(problem, None)
        assert markers.data.measured.shape == (41, 3, 208 if problem == "full leg" else 1200)
        assert (markers.basis.nodes, len(markers.chain.coordinates)) == (20, len(COORDINATES))
        assert set(np.unique(markers.data.weight)) == {1.0}


def test_noise_moves_the_minimum_below_the_truth(draws: list[SeedResult]) -> None:
    for draw in draws:
        for problem in PROBLEMS[:3]:
            found = draw.joints[problem]
            assert found.converged
            assert found.cost < found.cost_at_truth
            assert 4.0 < found.marker_mm < 9.0
            assert found.marker_mm < found.largest_mm
            assert found.marker_mm == pytest.approx(1e3 * np.sqrt(found.cost / (41 * 1200)))


def test_gait_keeps_what_isolated_trials_found(draws: list[SeedResult]) -> None:
    joints = draws[0].joints
    leg = dict(zip(LEG, joints["full leg"].errors, strict=True))
    for problem in PROBLEMS[:3]:
        for name, error in zip(joints[problem].names, joints[problem].errors, strict=True):
            assert (leg[name] == pytest.approx(error, abs=1e-9)) == (name not in free_parameters("full leg"))


def test_the_right_leg_stays_true(draws: list[SeedResult]) -> None:
    found, truth = draws[0].joints["full leg"].parameters.joint, true_model().parameters.joint
    others = [i for name, i in JP_INDEX.items() if name not in LEG]
    assert np.array_equal(found[others], truth[others])


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


def test_pelvis_residual_sees_31_of_36_directions(equations: RootEquations) -> None:
    s, truth = symmetric_set().selection, true_model().parameters.inertial
    blocks = np.einsum("rsd,sdk->rsk", equations.factor.reshape(-1, len(MASSIVE_SEGMENTS), 10), dynamic_jacobian(truth))
    values = np.linalg.svd(
        blocks.reshape(-1, len(IP_NAMES)) @ s * (s.T @ truth / (s * s).sum(axis=0)), compute_uv=False
    )
    assert (values > 1e-10 * values[0]).sum() == SEEN
    assert values[SEEN] < 1e-13


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
        assert draw.third.converged
        assert draw.third.force[1] < 0.6 * draw.third.force[0]
        assert draw.third.torque[1] < 0.6 * draw.third.torque[0]
        assert draw.third.marker_mm[0] == draw.joints["full leg"].marker_mm
        assert 1.0 < draw.third.marker_mm[1] / draw.third.marker_mm[0] < 1.1


@pytest.mark.slow
def test_processes_do_not_matter(draws: list[SeedResult]) -> None:
    again = noisy_draws(0, 2, jobs=2, random_seeds=FEW_SEEDS)
    assert draw_frame(again).equals(draw_frame(draws))
    for one, other in zip(again, draws, strict=True):
        assert np.array_equal(one.joints["full leg"].nodes, other.joints["full leg"].nodes)
        assert [r.each for r in one.random] == [r.each for r in other.random]


def test_draws_and_seeds_differ(draws: list[SeedResult]) -> None:
    assert not np.allclose(draws[0].joints["hip"].errors, draws[1].joints["hip"].errors)
    markers = [
        synthetic_problem("full leg", rng).data.measured
        for seed, draw in ((0, 0), (0, 1), (1, 0))
        for rng in generators(seed, draw)[0]
    ]
    assert len({m.tobytes() for m in markers}) == 3 * len(PROBLEMS)
    masses = [[r.each["thigh.mass"] for r in d.random] for d in draws]
    assert len({*masses[0], *masses[1]}) == 2 * FEW_SEEDS


ROUNDING = 0.01
"""The paper prints two decimals, the ankle's 3.377 deg as 3.37."""


@pytest.mark.parametrize("problem", PROBLEMS)
def test_table_two_gives_table_one(problem: str) -> None:
    joints = {"hip": ("hip",), "knee": ("knee",), "ankle": ("talocrural", "subtalar")}
    rows = [r for r in table_two() if problem == "full leg" or r.name.startswith(joints[problem])]
    errors = np.array([(r.full_leg if problem == "full leg" else r.single_joint)[0] for r in rows])
    position, orientation = joint_rms(errors, [r.name for r in rows])
    assert position == pytest.approx(table_one("synthetic_with_noise", "position_mm")[problem], abs=ROUNDING)
    expected = table_one("synthetic_with_noise", "orientation_deg")[problem]
    assert (orientation is None) == (expected is None)
    if expected is not None:
        assert orientation == pytest.approx(expected, abs=ROUNDING)


def test_table_four_gives_table_three() -> None:
    which, truth = symmetric_set(), published_subject().inertial
    printed = {r.name: r.correct_seed for r in table_four()}
    found = truth + IP_TO_SI * (which.selection @ np.array([printed[name] for name in which.names]))
    errors = inertial_rms(found, truth)
    _, _, inertia, mass, centre = table_three("synthetic_with_noise_correct_seed")
    assert errors.inertia == pytest.approx(inertia, rel=2e-3)
    assert errors.mass == pytest.approx(mass, abs=ROUNDING)
    assert errors.centre == pytest.approx(centre, abs=0.02)
    back = symmetric_errors(found, truth)
    assert back["foot.com.sup"] == 0.0
    assert {name: back[name] for name in which.names} == pytest.approx({n: printed[n] for n in which.names}, abs=1e-6)


def test_errors_are_found_minus_true_in_printed_units() -> None:
    truth = published_subject()
    found = Parameters(truth.joint + JP_TO_SI, truth.inertial, truth.zero_angles)
    assert joint_errors(found, truth, leg_parameters("l")) == pytest.approx(np.ones(len(leg_parameters("l"))))
    one = truth.inertial.copy()
    one[IP_NAMES.index("foot_l.com.sup")] += 3e-3
    assert symmetric_errors(one, truth.inertial)["foot.com.sup"] == pytest.approx(1.5)
