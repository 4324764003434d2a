"""Distributions, convergence, linearised contributions of the parameters, and their figures."""

import numpy as np
import pandas as pd
import pytest

from gaitcal.model.parameters import list_leg_parameters
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.draw import (
    COLUMNS,
    LEG_TORQUES,
    TORQUES,
    MonteCarloContext,
    compute_leg_torques,
    name_torque_column,
    refit,
)
from gaitcal.montecarlo.draw_statistics import (
    TOLERANCE_PERCENT,
    compute_linear_agreement,
    compute_statistics,
    compute_variance_contributions,
    estimate_expected_errors,
    list_cells_with_failures,
    measure_settling,
    select_levels,
    select_unconverged,
)
from gaitcal.montecarlo.draw_study import monte_carlo
from gaitcal.montecarlo.protocol import Plan, ReactionFrame, Varied
from gaitcal.montecarlo.workers import Workers
from gaitcal.report.figures.monte_carlo_figures import draw_boxplots, draw_contributions

SCALE = {"jp": 1.0, "ip": 0.1, "both": np.hypot(1.0, 0.1), "noise": 0.1}


def made_up(
    draws: int = 400, levels: tuple[int, ...] = (25, 50, 100), sets: tuple[str, ...] = tuple(SCALE)
) -> pd.DataFrame:
    """Errors that grow with the level: RMS 0.01 x scale x level (foot twice that), markers 0.12 mm
    a per cent.
    """
    rng = np.random.default_rng(8)
    parts = []
    for name in sets:
        for level in levels:
            spread = rng.uniform(0.8, 1.2, (draws, 1))
            values = {}
            for column in COLUMNS:
                base = 0.01 * SCALE[name] * level * (2.0 if ".foot." in column else 1.0)
                if column.startswith("markers"):
                    base = 0.0 if name == "ip" else 0.12 * level * (0.5 if name == "noise" else 1.0)
                sign = (
                    rng.choice([-1.0, 1.0], draws)
                    if column.endswith(".mean") and "markers" not in column
                    else 1.0
                )
                values[column] = base * spread[:, 0] * sign
            keys = {
                "set": name,
                "level": level,
                "draw": np.arange(draws),
                "evaluations": 5,
                "failure": "",
            }
            parts.append(pd.DataFrame({**keys, **values}))
    return pd.concat(parts, ignore_index=True)


def test_distributions() -> None:
    draws = made_up()
    draws.loc[(draws["set"] == "jp") & (draws["draw"] < 3), "failure"] = "did not settle"
    draws.loc[draws["failure"] != "", list(COLUMNS)] = 1e6  # must not enter the distribution
    table = compute_statistics(draws)
    row = select_levels(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT).iloc[-1]
    good = draws[(draws["set"] == "jp") & (draws["level"] == 100) & (draws["failure"] == "")]
    values = good["knee_angle_l.foot.rms"].to_numpy()
    wanted = {"level": 100, "draws": 397, "failed": 3, "average": values.mean()}
    wanted |= {f"p{p}": np.percentile(values, p) for p in (10, 25, 50, 75, 90)}
    assert {name: row[name] for name in wanted} == pytest.approx(wanted)
    signed = select_levels(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT, "mean").iloc[-1]
    sizes = select_levels(table, Varied.JP, "knee_angle_l", ReactionFrame.FOOT, "abs_mean").iloc[-1]
    assert abs(signed["average"]) < 0.2 * sizes["average"]
    assert sizes["average"] == pytest.approx(good["knee_angle_l.foot.mean"].abs().mean())
    assert len(table) == 4 * 3 * (2 * len(LEG_TORQUES) * 3 + 4)


def test_settling_is_the_published_criterion() -> None:
    rng = np.random.default_rng(9)
    values = rng.uniform(0.5, 1.5, 1000)
    found = measure_settling(values)
    runs = [
        np.array([f(values[:n]) for n in range(900, 1001)])
        for f in (np.mean, lambda v: np.std(v) / np.mean(v))
    ]
    expected = [100 * np.abs(run / run[-1] - 1).max() for run in runs]
    assert found == pytest.approx(tuple(expected))
    assert max(found) <= TOLERANCE_PERCENT
    drifting = np.concatenate([values, 3.0 + values[:100]])
    assert max(measure_settling(drifting)) > TOLERANCE_PERCENT
    assert np.isnan(measure_settling(values[:10])).all()
    assert measure_settling(np.zeros(100)) == (0.0, 0.0)


def test_expectation_from_a_marker_distance() -> None:
    table = compute_statistics(made_up())
    jp, noise = estimate_expected_errors(table, 4.5)
    assert (jp.varied, noise.varied, jp.beyond) == (Varied.JP, Varied.NOISE, False)
    assert (jp.level, noise.level) == pytest.approx((4.5 / 0.12, 4.5 / 0.06), rel=0.02)
    knee = jp.torques[(jp.torques["torque"] == "knee_angle_l") & (jp.torques["grf"] == "lab")].iloc[
        0
    ]
    assert knee["average"] == pytest.approx(0.01 * jp.level, rel=0.02)
    assert knee["p10"] < knee["p50"] < knee["p90"]
    far_jp, far_noise = estimate_expected_errors(table, 9.0)
    assert (far_jp.beyond, far_noise.beyond, far_noise.level) == (False, True, 100.0)
    assert estimate_expected_errors(table, 0.0)[0].level == 0.0
    (below, _), first = (
        estimate_expected_errors(table, 1.5),
        select_levels(table, Varied.JP, "knee_angle_l", ReactionFrame.LAB).iloc[0],
    )
    knee = below.torques[
        (below.torques["torque"] == "knee_angle_l") & (below.torques["grf"] == "lab")
    ].iloc[0]
    assert below.level < first["level"]
    assert knee["average"] == pytest.approx(
        first["average"] * below.level / first["level"]
    )  # a line from nothing
    assert estimate_expected_errors(compute_statistics(made_up(sets=("ip",))), 4.0) == ()


@pytest.fixture(scope="module")
def draws(case: MonteCarloCase) -> pd.DataFrame:
    wanted = ((Varied.BOTH, 25, 60), (Varied.BOTH, 1, 10), (Varied.IP, 10, 10))
    plans = [Plan((varied,), (level,), count) for varied, level, count in wanted]
    return pd.concat([monte_carlo(case, plan=plan, workers=Workers()).draws for plan in plans])


@pytest.mark.slow
@pytest.mark.parametrize("frame", list(ReactionFrame))
def test_small_disturbances_are_linear(
    context: MonteCarloContext, draws: pd.DataFrame, frame: ReactionFrame
) -> None:
    assert compute_linear_agreement(context, draws, (Varied.BOTH, 1), frame).min() > 0.999
    assert compute_linear_agreement(context, draws, (Varied.IP, 10), frame).min() > 0.99


def test_contributions_sum_to_the_variance_of_the_draws(
    context: MonteCarloContext, draws: pd.DataFrame
) -> None:
    table = compute_variance_contributions(context)
    shares = table.groupby(["torque", "grf"])["share"].sum()
    np.testing.assert_allclose(shares, 100.0)
    squares = (table["rms"] ** 2).groupby([table["torque"], table["grf"]]).sum()
    of = draws[(draws["set"] == "both") & (draws["level"] == 25)]
    for frame in ReactionFrame:
        found = of[[name_torque_column(torque, frame, "rms") for torque in LEG_TORQUES]].to_numpy()
        ratio = (found**2).mean(axis=0) / (
            0.25**2 * np.array([squares[torque, frame.value] for torque in LEG_TORQUES])
        )
        assert np.abs(ratio - 1).max() < 0.45  # 60 draws tell a mean square to some 15 % (one SD)
        assert ratio.mean() == pytest.approx(1.0, abs=0.15)


def test_one_parameter_alone_causes_what_the_table_says(context: MonteCarloContext) -> None:
    """Nearly all of the knee's adduction error is told to come from the knee axis in the frontal
    plane: try it.
    """
    table = compute_variance_contributions(context)
    rows = table[(table["torque"] == "knee_adduction_l") & (table["grf"] == "lab")].set_index(
        "parameter"
    )
    assert rows["share"].idxmax() == "knee_l.thigh.front"
    case, k = context.case, context.names.index("knee_l.thigh.front")
    step = 0.05 * context.settings.joint_bounds[k]
    torques = []
    for sign in (1.0, -1.0):
        change = sign * step * (np.arange(len(context.names)) == k)
        parameters = case.parameters.with_joint(context.names, context.joint_values + change)
        body = context.problem.build_body(parameters)
        found = refit(context.problem, body, case.coefficients, context.settings)
        torques.append(
            compute_leg_torques(
                parameters, context.basis, found.coefficients, case.wrench, context.feet
            )[0]
        )
    slope = (torques[0] - torques[1])[:, LEG_TORQUES.index("knee_adduction_l")] / (2 * step)
    alone = (
        100
        / case.subject.bwh
        * np.sqrt((slope**2).mean())
        * context.settings.joint_bounds[k]
        / np.sqrt(3)
    )
    assert rows.loc["knee_l.thigh.front", "rms"] == pytest.approx(alone, rel=1e-3)


def test_boxes_are_the_percentiles() -> None:
    table = compute_statistics(made_up(draws=60))
    figure = draw_boxplots(table, ReactionFrame.FOOT)
    axes = np.array(figure.axes).reshape(len(TORQUES) + 1, 4)
    titles = "joint parameters (JP), inertial parameters (IP), JP and IP, marker noise (NP)"
    assert ", ".join(a.get_title() for a in axes[0]) == titles
    row = select_levels(table, Varied.NOISE, "knee_adduction_l", ReactionFrame.FOOT).iloc[1]
    cell = axes[TORQUES.index("knee_adduction"), 3]
    lines = [line.get_ydata() for line in cell.lines]
    heights = {round(float(y), 9) for data in lines for y in np.ravel(data)}
    wanted = {round(float(row[name]), 9) for name in ("p10", "p25", "p50", "p75", "p90", "average")}
    boxes = {round(float(y), 9) for patch in cell.patches for y in patch.get_path().vertices[:, 1]}
    assert wanted <= heights | boxes
    assert axes[-1, 0].get_ylabel() == "marker\ndistance, mm"
    assert [t.get_text() for t in axes[-1, 0].get_xticklabels()] == ["25", "50", "100"]
    assert axes[0, 0].get_ylim()[0] == 0.0


def test_contributions_are_written_into_the_cells(context: MonteCarloContext) -> None:
    contributions = compute_variance_contributions(context)
    figure = draw_contributions(contributions)
    rows = [t.get_text() for t in figure.axes[0].get_yticklabels()]
    assert len(rows) == len(list_leg_parameters("r")) + 2
    assert rows[0] == "hip: pelvis ant"
    texts = {
        (int(t.get_position()[0]), int(t.get_position()[1])): t.get_text()
        for t in figure.axes[0].texts
    }
    of = contributions[
        (contributions["torque"] == "knee_adduction_l") & (contributions["grf"] == "lab")
    ]
    share = of.set_index("parameter")["share"]["knee_l.thigh.front"]
    assert texts[4, rows.index("knee: thigh front")] == f"{share:.0f}"
    image = figure.axes[0].images[0].get_array()
    assert image is not None
    whole = (np.asarray(image) ** 2).sum(axis=0)
    np.testing.assert_allclose(whole[whole > 0], 100.0)


def test_unconverged_looks_at_every_torque() -> None:
    draws = made_up(1000)
    assert select_unconverged(compute_statistics(draws)).empty
    late = (draws["set"] == "both") & (draws["level"] == 50) & (draws["draw"] > 950)
    draws.loc[late, "ankle_angle_r.foot.rms"] *= 4
    found = select_unconverged(compute_statistics(draws))
    assert found[["set", "level", "quantity", "grf"]].to_numpy().tolist() == [
        ["both", 50, "ankle_angle_r", "foot"]
    ]


def test_draws_left_out_are_counted_by_cell() -> None:
    draws = made_up(10)
    assert list_cells_with_failures(compute_statistics(draws)).empty
    draws.loc[(draws["set"] == "jp") & (draws["level"] == 50) & (draws["draw"] < 3), "failure"] = (
        "did not settle"
    )
    assert list_cells_with_failures(compute_statistics(draws)).to_dict("records") == [
        {"set": "jp", "level": 50, "draws": 7, "failed": 3}
    ]
