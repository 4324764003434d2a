"""Linearised torques against draws: exact for small disturbances, told honestly for large ones."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.study.monte_carlo.context import MonteCarloContext
from gaitcal.study.monte_carlo.draw import COLUMNS, disturb, draw, torque_column
from gaitcal.study.monte_carlo.leg_torques import LEG_TORQUES
from gaitcal.study.monte_carlo.refit import refit
from gaitcal.study.monte_carlo.settings import ReactionFrame, Varied
from gaitcal.study.monte_carlo.variance import LinearTorques, linear_torques, variance_contributions
from tests.derivatives import Array


@pytest.fixture(scope="module")
def linear(context: MonteCarloContext) -> LinearTorques:
    return linear_torques(context)


def agreement(
    context: MonteCarloContext, linear: LinearTorques, cell: tuple[Varied, int], frame: ReactionFrame, draws: int
) -> Array:
    """(14,) R^2 of the linearised RMS errors as a prediction of those of the draws."""
    columns = [COLUMNS.index(torque_column(torque, frame, "rms")) for torque in LEG_TORQUES]
    found, predicted = [], []
    for number in range(draws):
        change = disturb(context, *cell, number)
        error = np.zeros(context.torques.shape)
        if change.joint is not None:
            error = error + linear.by_joint[frame] @ change.joint
        if change.inertial is not None:
            error = error + linear.by_inertial @ change.inertial
        predicted.append(100 / context.case.subject.bwh * np.sqrt((error**2).mean(axis=0)))
        found.append(draw(context, *cell, number).values[columns])
    residual = ((np.array(found) - predicted) ** 2).sum(axis=0)
    return 1 - residual / ((np.array(found) - np.mean(found, axis=0)) ** 2).sum(axis=0)


@pytest.mark.parametrize("frame", list(ReactionFrame))
def test_small_disturbances_are_linear(context: MonteCarloContext, linear: LinearTorques, frame: ReactionFrame) -> None:
    assert agreement(context, linear, (Varied.BOTH, 1), frame, 20).min() > 0.999
    assert agreement(context, linear, (Varied.IP, 10), frame, 20).min() > 0.99


@pytest.mark.parametrize("frame", list(ReactionFrame))
def test_a_quarter_of_the_bounds_is_nearly_linear(
    context: MonteCarloContext, linear: LinearTorques, frame: ReactionFrame
) -> None:
    assert agreement(context, linear, (Varied.JP, 25), frame, 60).min() > 0.9


def test_contributions_sum_to_the_variance_of_the_draws(context: MonteCarloContext) -> None:
    table = variance_contributions(context)
    shares = table.groupby(["torque", "grf"])["share"].sum()
    np.testing.assert_allclose(shares, 100.0)
    squares = (table["rms"] ** 2).groupby([table["torque"], table["grf"]]).sum()
    draws = 60
    for frame in ReactionFrame:
        columns = [COLUMNS.index(torque_column(torque, frame, "rms")) for torque in LEG_TORQUES]
        found = np.array([draw(context, Varied.BOTH, 25, k).values[columns] for k in range(draws)])
        ratio = (found**2).mean(axis=0) / (0.25**2 * np.array([squares[torque, frame.value] for torque in LEG_TORQUES]))
        assert np.abs(ratio - 1).max() < 0.45  # 60 draws tell a mean square to some 15 % (one SD)
        assert ratio.mean() == pytest.approx(1.0, abs=0.15)


def test_one_parameter_alone_causes_what_the_table_says(context: MonteCarloContext) -> None:
    """Nearly all of the knee's adduction error is told to come from the knee axis in the frontal plane: try it."""
    table = variance_contributions(context)
    rows = table[(table["torque"] == "knee_adduction_l") & (table["grf"] == "lab")].set_index("parameter")
    assert rows["share"].idxmax() == "knee_l.thigh.front"
    case, k = context.case, context.names.index("knee_l.thigh.front")
    step = 0.05 * context.settings.joint_bounds[k]
    torques = []
    for sign in (1.0, -1.0):
        parameters = case.parameters.with_joint(
            context.names, context.joint_values + sign * step * (np.arange(54) == k)
        )
        constants = context.problem.constants(parameters)
        found = refit(context.equations, context.data, constants, case.nodes, context.settings.refit)
        legs = context.legs.disturb(parameters)
        torques.append(context.legs.torques(legs, context.basis, found.nodes, case.wrench, context.feet)[0])
    slope = (torques[0] - torques[1])[:, LEG_TORQUES.index("knee_adduction_l")] / (2 * step)
    alone = 100 / case.subject.bwh * np.sqrt((slope**2).mean()) * context.settings.joint_bounds[k] / np.sqrt(3)
    assert rows.loc["knee_l.thigh.front", "rms"] == pytest.approx(alone, rel=1e-3)
