"""One draw: what it records, against slow references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.linkage import LOWER_BODY
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.draw import COLUMNS, LEG_TORQUES, MonteCarloContext, disturb, draw, marker_column, torque_column
from gaitcal.published.protocol import MonteCarloSettings, ParameterChoice, ReactionFrame, RefitSettings, Varied
from tests.motion.test_marker_equations import dense
from tests.published.test_leg_torques import whole_body

ERROR = 1e-9
"""%BW*H and mm."""


def recorded(values: np.ndarray, frame: ReactionFrame, measure: str) -> np.ndarray:
    return np.array([values[COLUMNS.index(torque_column(torque, frame, measure))] for torque in LEG_TORQUES])


@pytest.mark.parametrize("varied", list(Varied))
def test_record_of_a_draw_against_whole_body_dynamics(context: MonteCarloContext, varied: Varied) -> None:
    case, change = context.case, disturb(context, varied, 75, 2)
    found = draw(context, varied, 75, 2)
    parameters, data = case.parameters, context.data
    if change.joint is not None:
        parameters = parameters.with_joint(context.names, context.joint_values + change.joint)
    if change.inertial is not None:
        factor = 1 + context.inertial_set.selection @ change.inertial
        parameters = parameters.with_inertial(parameters.inertial * factor)
    if change.noise is not None:
        data = replace(data, measured=data.measured + change.noise)
    problem = TrialProblem(
        name="reference", chain=context.problem.chain, basis=context.basis, data=data, labels=context.problem.labels
    )
    constants = problem.constants(parameters)
    nodes = case.nodes
    for _ in range(60):  # plain Newton from the undisturbed motion, with a fresh matrix every time
        matrix = dense(problem.equations(nodes, constants))
        step = np.linalg.solve(matrix, problem.gradient(nodes, constants)[1].ravel())
        nodes = nodes - step.reshape(nodes.shape)
        if np.abs(step).max() < 1e-8:
            break
    error = 100 * (whole_body(context, parameters, nodes) - context.torques) / case.subject.bwh
    # the re-fit ends at steps of 1e-6 m or rad: some 1e-5 %BW*H
    within = {"rtol": 0, "atol": 2e-5}
    np.testing.assert_allclose(recorded(found.values, ReactionFrame.LAB, "rms"), np.sqrt((error**2).mean(0)), **within)
    np.testing.assert_allclose(recorded(found.values, ReactionFrame.LAB, "mean"), error.mean(0), **within)
    apart = 1e3 * np.linalg.norm(problem.positions(nodes, constants) - data.measured, axis=1)
    left = [i for i, label in enumerate(context.problem.labels) if label.startswith("L.") and _on_leg(context, i)]
    assert found.values[COLUMNS.index(marker_column("l", "rms"))] == pytest.approx(
        np.sqrt((apart[left] ** 2).mean()), abs=1e-4
    )
    assert found.values[COLUMNS.index(marker_column("l", "mean"))] == pytest.approx(apart[left].mean(), abs=1e-4)
    assert found.failure == ""


def _on_leg(context: MonteCarloContext, marker: int) -> bool:
    segment = context.problem.chain.segments[context.data.segment[marker]]
    return segment in LOWER_BODY[1:]


def test_inertial_draws_need_no_refit_and_move_no_marker(context: MonteCarloContext) -> None:
    found = draw(context, Varied.IP, 100, 5)
    assert found.evaluations == 0
    assert found.values[-4:].tolist() == [0.0] * 4
    laboratory, foot = (recorded(found.values, frame, "rms") for frame in ReactionFrame)
    np.testing.assert_array_equal(laboratory, foot)
    assert (laboratory > 0).all()


def test_draws_do_not_depend_on_each_other(context: MonteCarloContext, case: MonteCarloCase) -> None:
    cells = [(varied, 100, k) for varied in Varied for k in range(2)]
    forward = {cell: draw(context, *cell).values for cell in cells}
    fresh = MonteCarloContext(case, MonteCarloSettings())
    for cell in reversed(cells):
        np.testing.assert_array_equal(draw(fresh, *cell).values, forward[cell])


def test_only_valid_frames_count(case: MonteCarloCase) -> None:
    valid = np.zeros(len(case.time), dtype=bool)
    valid[60:90] = True
    some = MonteCarloContext(replace(case, valid=valid), MonteCarloSettings())
    change = disturb(some, Varied.IP, 100, 0)
    factor = 1 + some.inertial_set.selection @ change.inertial
    parameters = case.parameters.with_inertial(case.parameters.inertial * factor)
    error = 100 * (whole_body(some, parameters, case.nodes) - some.torques)[60:90] / case.subject.bwh
    found = recorded(draw(some, Varied.IP, 100, 0).values, ReactionFrame.LAB, "mean")
    np.testing.assert_allclose(found, error.mean(axis=0), rtol=0, atol=ERROR)


def test_a_draw_that_fails_is_recorded_with_its_reason(case: MonteCarloCase) -> None:
    hasty = MonteCarloContext(case, MonteCarloSettings(refit=RefitSettings(most_evaluations=2)))
    found = draw(hasty, Varied.JP, 100, 0)
    assert "did not settle" in found.failure
    assert np.isfinite(found.values).all()  # those of the last motion tried


def test_a_draw_without_result_is_recorded_too(context: MonteCarloContext, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: object) -> None:
        raise np.linalg.LinAlgError("no factor")

    monkeypatch.setattr("gaitcal.published.draw.refit", broken)
    found = draw(context, Varied.JP, 100, 0)
    assert found.failure == "LinAlgError: no factor"
    assert np.isnan(found.values).all()


@pytest.mark.parametrize("choice", [ParameterChoice.GAIT, ParameterChoice.ALL])
def test_other_choices_of_parameters(case: MonteCarloCase, choice: ParameterChoice) -> None:
    """Back and arms move markers but are no part of a leg: alone they change leg torques only through the pelvis."""
    some = MonteCarloContext(case, MonteCarloSettings(parameters=choice))
    found = draw(some, Varied.JP, 25, 0)
    assert found.failure == ""
    assert (recorded(found.values, ReactionFrame.LAB, "rms") > 0).all()
    moved = np.abs(some.sensitivity).max(axis=(0, 1))
    assert (moved > 0).sum() == len(choice.names)
