"""One draw: its random numbers, torques of the legs, re-fit and record, against slow references."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.model.linkage import COORDINATES, LOWER_BODY, list_joints_above
from gaitcal.model.parameters import IP_NAMES, Parameters
from gaitcal.montecarlo.case import MonteCarloCase, make_nominal_case
from gaitcal.montecarlo.draw import (
    COLUMNS,
    LEG_TORQUES,
    Disturbance,
    FootPose,
    MonteCarloContext,
    compute_leg_torques,
    draw,
    draw_disturbance,
    move_wrenches,
    name_marker_column,
    name_torque_column,
    refit,
)
from gaitcal.montecarlo.protocol import MonteCarloSettings, ParameterChoice, ReactionFrame, Varied
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import Array, from_band, perturbed_parameters

TORQUE = 1e-9
"""N·m: rounding of sums of a few thousand N at lever arms of metres."""


def whole_body(context: MonteCarloContext, parameters: Parameters, coefficients: Array) -> Array:
    q, v, a = (context.basis.evaluate(coefficients, k) for k in range(3))
    forces = Dynamics(parameters).compute_forces(q, v, a, context.case.wrench)
    return forces[:, [FORCES.index(name) for name in LEG_TORQUES]]


def test_a_disturbed_model_has_the_torques_of_a_model_built_anew(
    context: MonteCarloContext,
) -> None:
    rng = np.random.default_rng(6)
    for _ in range(3):
        parameters = perturbed_parameters(rng)
        parameters = parameters.with_inertial(
            parameters.inertial * rng.uniform(0.8, 1.2, len(IP_NAMES))
        )
        coefficients = context.case.coefficients + rng.normal(
            0, 0.02, context.case.coefficients.shape
        )
        laboratory, _ = compute_leg_torques(
            parameters, context.basis, coefficients, context.case.wrench, context.feet
        )
        np.testing.assert_allclose(
            laboratory, whole_body(context, parameters, coefficients), rtol=0, atol=TORQUE
        )


def test_a_carried_wrench_is_constant_in_the_foot() -> None:
    rng = np.random.default_rng(7)

    def pose() -> FootPose:
        return np.linalg.qr(rng.normal(size=(5, 2, 3, 3)))[0], rng.normal(size=(5, 2, 3))

    def in_foot(wrench: Array, at: FootPose) -> Array:
        force = wrench[..., :3]
        moment = wrench[..., 3:] - np.cross(at[1], force)
        return np.concatenate(
            [(at[0] @ part[..., None])[..., 0] for part in (force, moment)], axis=2
        )

    wrench, before, after = rng.normal(size=(5, 2, 6)), pose(), pose()
    np.testing.assert_allclose(
        in_foot(move_wrenches(wrench, before, after), after), in_foot(wrench, before), atol=1e-12
    )


def test_moving_the_whole_person_matters_to_wrenches_of_the_laboratory_only(
    context: MonteCarloContext,
) -> None:
    """10 mm forward with the person: carried wrenches come along, so that no torque changes."""
    case = context.case
    coefficients = case.coefficients.copy()
    coefficients[:, COORDINATES.index("pelvis_tx")] += 0.010
    laboratory, carried = compute_leg_torques(
        case.parameters, context.basis, coefficients, case.wrench, context.feet
    )
    np.testing.assert_allclose(carried, context.torques, rtol=0, atol=TORQUE)
    flexion = LEG_TORQUES.index("hip_flexion_l")
    assert (
        np.abs(laboratory - context.torques)[:, flexion].max()
        > 0.009 * np.abs(case.wrench[:, 1, 1]).max()
    )


ERROR = 1e-9
"""%BW*H and mm."""


def recorded(values: np.ndarray, frame: ReactionFrame, measure: str) -> np.ndarray:
    return np.array(
        [
            values[COLUMNS.index(name_torque_column(torque, frame, measure))]
            for torque in LEG_TORQUES
        ]
    )


@pytest.mark.parametrize("varied", list(Varied))
def test_record_of_a_draw_against_whole_body_dynamics(
    context: MonteCarloContext, varied: Varied
) -> None:
    case, change = context.case, draw_disturbance(context, varied, 75, 2)
    found = draw(context, varied, 75, 2)
    parameters, data = case.parameters, context.data
    if change.joint is not None:
        parameters = parameters.with_joint(context.names, context.joint_values + change.joint)
    if change.inertial is not None:
        factor = 1 + context.inertial_set.selection @ change.inertial
        parameters = parameters.with_inertial(parameters.inertial * factor)
    if change.noise is not None:
        data = replace(data, measured=data.measured + change.noise)
    problem = MotionProblem(
        name="reference",
        chain=context.problem.chain,
        basis=context.basis,
        data=data,
        labels=context.problem.labels,
    )
    body = problem.build_body(parameters)
    coefficients = case.coefficients
    for _ in range(60):  # plain Newton from the undisturbed motion, with a fresh matrix every time
        matrix = from_band(problem.assemble_equations(coefficients, body).band)
        step = np.linalg.solve(matrix, problem.compute_gradient(coefficients, body)[1].ravel())
        coefficients = coefficients - step.reshape(coefficients.shape)
        if np.abs(step).max() < 1e-8:
            break
    error = (
        100 * (whole_body(context, parameters, coefficients) - context.torques) / case.subject.bwh
    )
    # the re-fit ends at steps of 1e-6 m or rad: some 1e-5 %BW*H
    within = {"rtol": 0, "atol": 2e-5}
    np.testing.assert_allclose(
        recorded(found.values, ReactionFrame.LAB, "rms"), np.sqrt((error**2).mean(0)), **within
    )
    np.testing.assert_allclose(
        recorded(found.values, ReactionFrame.LAB, "mean"), error.mean(0), **within
    )
    apart = 1e3 * np.linalg.norm(
        problem.compute_positions(coefficients, body) - data.measured, axis=1
    )
    left = [
        i
        for i, label in enumerate(context.problem.labels)
        if label.startswith("L.") and _on_leg(context, i)
    ]
    for measure, wanted in (
        ("rms", np.sqrt((apart[left] ** 2).mean())),
        ("mean", apart[left].mean()),
    ):
        assert found.values[COLUMNS.index(name_marker_column("l", measure))] == pytest.approx(
            wanted, abs=1e-4
        )
    assert found.failure == ""


def _on_leg(context: MonteCarloContext, marker: int) -> bool:
    segment = context.problem.chain.segments[context.data.segment[marker]]
    return segment in LOWER_BODY[1:]


def test_only_valid_frames_count(case: MonteCarloCase) -> None:
    valid = np.zeros(len(case.time), dtype=bool)
    valid[60:90] = True
    some = MonteCarloContext(replace(case, valid=valid), MonteCarloSettings())
    change = draw_disturbance(some, Varied.IP, 100, 0)
    factor = 1 + some.inertial_set.selection @ change.inertial
    parameters = case.parameters.with_inertial(case.parameters.inertial * factor)
    error = (
        100
        * (whole_body(some, parameters, case.coefficients) - some.torques)[60:90]
        / case.subject.bwh
    )
    found = recorded(draw(some, Varied.IP, 100, 0).values, ReactionFrame.LAB, "mean")
    np.testing.assert_allclose(found, error.mean(axis=0), rtol=0, atol=ERROR)


def test_a_draw_without_result_is_recorded_too(
    context: MonteCarloContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*args: object) -> None:
        raise np.linalg.LinAlgError("no factor")

    monkeypatch.setattr("gaitcal.montecarlo.draw.refit", broken)
    found = draw(context, Varied.JP, 100, 0)
    assert found.failure == "LinAlgError: no factor"
    assert np.isnan(found.values).all()


@pytest.mark.parametrize("choice", [ParameterChoice.GAIT, ParameterChoice.ALL])
def test_other_choices_of_parameters(
    case: MonteCarloCase, context: MonteCarloContext, choice: ParameterChoice
) -> None:
    """Back and arms move markers but are no part of a leg: alone they change leg torques only
    through the pelvis.
    """
    some = MonteCarloContext(case, MonteCarloSettings(parameters=choice))
    found = draw(some, Varied.JP, 25, 0)
    assert found.failure == ""
    both = (found, draw(context, Varied.JP, 25, 0))
    changed, by_published = (recorded(d.values, ReactionFrame.LAB, "rms") > 0 for d in both)
    assert changed.any() and (changed == by_published).all()
    moved = np.abs(some.sensitivity).max(axis=(0, 1))
    carrying = {
        joint.name for segment in case.markers.segments for joint in list_joints_above(segment)
    }
    assert (moved > 0).sum() == sum(name.split(".")[0] in carrying for name in choice.names)


@cache
def context_of(settings: MonteCarloSettings) -> MonteCarloContext:
    return MonteCarloContext(make_nominal_case(), settings)


def sample(
    varied: Varied, level: int, number: int, settings: MonteCarloSettings | None = None
) -> Disturbance:
    return draw_disturbance(context_of(settings or MonteCarloSettings()), varied, level, number)


def test_each_set_disturbs_what_it_names() -> None:
    found = {v: sample(v, 100, 0) for v in Varied}
    changed = {
        v: (d.joint is not None, d.inertial is not None, d.noise is not None)
        for v, d in found.items()
    }
    assert changed == {
        Varied.JP: (True, False, False),
        Varied.IP: (False, True, False),
        Varied.BOTH: (True, True, False),
        Varied.NOISE: (False, False, True),
    }


def test_bounds_are_published_and_configurable() -> None:
    bounds = MonteCarloSettings().joint_bounds
    assert sorted(set(bounds.tolist())) == pytest.approx([0.010, np.deg2rad(10.0)])
    doubled = MonteCarloSettings(position_mm=20.0, orientation_deg=20.0)
    np.testing.assert_allclose(doubled.joint_bounds, 2 * bounds)
    fifty = sample(Varied.IP, 100, 3, MonteCarloSettings(inertial_percent=50.0)).inertial
    np.testing.assert_allclose(fifty, 5 * sample(Varied.IP, 100, 3).inertial)


def test_noise_is_the_published_sinusoid() -> None:
    noise = np.stack([sample(Varied.NOISE, 50, k).noise for k in range(20)])
    assert noise.shape == (20, 41, 3, 208) and 0.0045 < np.abs(noise).max() <= 0.005


def test_a_stream_depends_on_seed_set_level_and_number() -> None:
    first = sample(Varied.JP, 100, 7).joint
    np.testing.assert_array_equal(first, sample(Varied.JP, 100, 7).joint)
    for other in (
        sample(Varied.JP, 100, 8).joint,
        sample(Varied.BOTH, 100, 7).joint,
        sample(Varied.JP, 100, 7, MonteCarloSettings(seed=1)).joint,
        2 * sample(Varied.JP, 50, 7).joint,
    ):
        assert not np.isclose(first, other).any()


NODES = 3e-7
"""m, rad: the last step of a re-fit is below 1e-6, what is left a fraction of it."""


@pytest.mark.parametrize("level", [25, 100])
def test_same_minimum_as_tracking(context: MonteCarloContext, level: int) -> None:
    """Tracking, started at the re-fit and given many small steps, stays there; and the cost is no
    higher from afar.
    """
    for number in range(4):
        change = draw_disturbance(context, Varied.JP, level, number)
        assert change.joint is not None
        parameters = context.case.parameters.with_joint(
            context.names, context.joint_values + change.joint
        )
        body = context.problem.build_body(parameters)
        start = context.case.coefficients + context.sensitivity @ change.joint
        found = refit(context.problem, body, start, MonteCarloSettings())
        assert found.failure == ""
        tight = DescentSettings(gain=0.0, most_steps=60)
        kept = track_coefficients(context.problem, body, found.coefficients, tight)
        assert np.abs(kept.x - found.coefficients).max() < NODES
        afar = track_coefficients(
            context.problem, body, context.case.coefficients, DescentSettings(gain=1e-12)
        )
        assert context.problem.compute_cost(found.coefficients, body) <= afar.cost * (1 + 1e-9)


def test_the_predictor_is_the_slope_of_the_motion(context: MonteCarloContext) -> None:
    change = (
        1e-4
        * context.settings.joint_bounds
        * np.random.default_rng(3).uniform(-1, 1, len(context.names))
    )
    parameters = context.case.parameters.with_joint(context.names, context.joint_values + change)
    problem, settings = context.problem, MonteCarloSettings(refit_tolerance=1e-10)
    now, was = (
        refit(problem, problem.build_body(p), context.case.coefficients, settings).coefficients
        for p in (parameters, context.case.parameters)
    )
    moved = now - was
    np.testing.assert_allclose(
        context.sensitivity @ change, moved, rtol=0, atol=2e-3 * np.abs(moved).max()
    )


def test_a_refit_that_is_cut_short_says_so(context: MonteCarloContext) -> None:
    change = draw_disturbance(context, Varied.NOISE, 100, 1)
    noisy = context.problem.with_measured(context.data.measured + change.noise)
    body = context.problem.build_body(context.case.parameters)
    found = refit(
        noisy, body, context.case.coefficients, MonteCarloSettings(refit_most_evaluations=2)
    )
    assert "2 evaluations" in found.failure
    lost = context.problem.with_measured(np.full_like(context.data.measured, np.nan))
    assert refit(lost, body, context.case.coefficients, MonteCarloSettings()).failure
