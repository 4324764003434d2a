"""Linearised torques against draws: exact for small disturbances, told honestly for large ones."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitcal.published.case import MonteCarloCase
from gaitcal.published.draw import LEG_TORQUES, MonteCarloContext, refit, torque_column
from gaitcal.published.protocol import Plan, ReactionFrame, Varied
from gaitcal.published.statistics import linear_agreement, variance_contributions
from gaitcal.published.study import monte_carlo
from gaitcal.published.workers import ThisProcess


@pytest.fixture(scope="module")
def draws(case: MonteCarloCase) -> pd.DataFrame:
    wanted = {Varied.BOTH: (1, 25), Varied.IP: (10,), Varied.JP: (25,)}
    plans = [Plan((varied,), levels, 60) for varied, levels in wanted.items()]
    return pd.concat([monte_carlo(case, plan=plan, workers=ThisProcess()).draws for plan in plans])


@pytest.mark.slow
@pytest.mark.parametrize("frame", list(ReactionFrame))
def test_small_disturbances_are_linear(context: MonteCarloContext, draws: pd.DataFrame, frame: ReactionFrame) -> None:
    assert linear_agreement(context, draws, (Varied.BOTH, 1), frame).min() > 0.999
    assert linear_agreement(context, draws, (Varied.IP, 10), frame).min() > 0.99


@pytest.mark.parametrize("frame", list(ReactionFrame))
def test_a_quarter_of_the_bounds_is_nearly_linear(
    context: MonteCarloContext, draws: pd.DataFrame, frame: ReactionFrame
) -> None:
    assert linear_agreement(context, draws, (Varied.JP, 25), frame).min() > 0.9


def test_contributions_sum_to_the_variance_of_the_draws(context: MonteCarloContext, draws: pd.DataFrame) -> None:
    table = variance_contributions(context)
    shares = table.groupby(["torque", "grf"])["share"].sum()
    np.testing.assert_allclose(shares, 100.0)
    squares = (table["rms"] ** 2).groupby([table["torque"], table["grf"]]).sum()
    of = draws[(draws["set"] == "both") & (draws["level"] == 25)]
    for frame in ReactionFrame:
        found = of[[torque_column(torque, frame, "rms") for torque in LEG_TORQUES]].to_numpy()
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
            context.names, context.joint_values + sign * step * (np.arange(len(context.names)) == k)
        )
        constants = context.problem.constants(parameters)
        found = refit(context.problem, constants, case.nodes, context.settings.refit)
        legs = context.legs.disturb(parameters)
        torques.append(context.legs.torques(legs, context.basis, found.nodes, case.wrench, context.feet)[0])
    slope = (torques[0] - torques[1])[:, LEG_TORQUES.index("knee_adduction_l")] / (2 * step)
    alone = 100 / case.subject.bwh * np.sqrt((slope**2).mean()) * context.settings.joint_bounds[k] / np.sqrt(3)
    assert rows.loc["knee_l.thigh.front", "rms"] == pytest.approx(alone, rel=1e-3)
