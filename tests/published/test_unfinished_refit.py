"""Re-fits stopped on the way: nothing moves at first, markers come nearer with every step, the end is the study's."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from gaitcal.model.linkage import LEGS
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.draw import COLUMNS, MonteCarloContext, disturb, disturbed_model, draw
from gaitcal.published.draw_sensitivity import CONVERGED, SETS, Iteration, path, unfinished_draws
from gaitcal.published.protocol import MonteCarloSettings, Varied
from gaitcal.synthetic.motion import synthetic_markers

NUMBER = 3
MARKERS = COLUMNS.index("markers_l.rms")
TORQUES = slice(0, COLUMNS.index("markers_r.rms"))


@pytest.fixture(scope="module")
def rows(case: MonteCarloCase) -> dict[tuple[str, str, int], np.ndarray]:
    table = unfinished_draws(case, MonteCarloSettings(), 1, jobs=1, levels=(50,))
    assert (table["failure"] == "").all()
    keys = zip(table["set"], table["iteration"], table["iterations"], strict=True)
    return dict(zip(keys, table[list(COLUMNS)].to_numpy(), strict=True))


@pytest.mark.parametrize("iteration", Iteration)
def test_no_iteration_leaves_the_undisturbed_motion(
    context: MonteCarloContext, rows: dict[tuple[str, str, int], np.ndarray], iteration: Iteration
) -> None:
    case = context.case
    change = disturb(context, Varied.JP, 50, 0)
    assert change.joint is not None
    parameters = case.parameters.with_joint(context.names, context.joint_values + change.joint)
    q = context.basis.evaluate(case.nodes)
    apart = synthetic_markers(parameters, case.markers, q) - synthetic_markers(case.parameters, case.markers, q)
    leg = [segment in LEGS["l"] for segment in case.markers.segments]
    rms = 1e3 * np.sqrt((apart[:, leg] ** 2).sum(axis=2).mean())
    assert rows["jp", iteration.value, 0][MARKERS] == pytest.approx(rms, rel=1e-9)
    noise = disturb(context, Varied.NOISE, 50, 0).noise
    assert noise is not None
    size = 1e3 * np.sqrt((noise[context.leg_markers[1]] ** 2).sum(axis=1).mean())
    still = rows["noise", iteration.value, 0]
    assert still[MARKERS] == pytest.approx(size, rel=1e-9)
    np.testing.assert_allclose(still[TORQUES], 0.0, atol=1e-9)


@pytest.mark.parametrize("varied", SETS)
def test_the_end_is_the_draw_of_the_study(
    context: MonteCarloContext, rows: dict[tuple[str, str, int], np.ndarray], varied: Varied
) -> None:
    for iteration in Iteration:
        np.testing.assert_array_equal(
            rows[varied.value, iteration.value, CONVERGED], draw(context, varied, 50, 0).values
        )
    newton = rows[varied.value, Iteration.GAUSS_NEWTON.value, 10]
    np.testing.assert_allclose(newton, rows[varied.value, Iteration.GAUSS_NEWTON.value, CONVERGED], atol=1e-3)


@pytest.mark.parametrize("iteration", Iteration)
@pytest.mark.parametrize("varied", SETS)
def test_every_step_brings_the_markers_nearer(context: MonteCarloContext, varied: Varied, iteration: Iteration) -> None:
    model = disturbed_model(context, disturb(context, varied, 100, NUMBER))
    nodes = list(path(context, model, iteration, (0, 1, 2, 3, 5)))
    costs = [model.problem.marker_cost(n, model.constants) for n in nodes]
    assert nodes[0] is context.case.nodes
    assert all(b < a for a, b in pairwise(costs))
    (at_once,) = path(context, model, iteration, (2,))
    np.testing.assert_allclose(at_once, nodes[2], atol=1e-9)


def test_steepest_descent_goes_to_the_lowest_point_of_its_line(context: MonteCarloContext) -> None:
    model = disturbed_model(context, disturb(context, Varied.NOISE, 25, NUMBER))
    start, end = path(context, model, Iteration.STEEPEST_DESCENT, (0, 1))
    along = [model.problem.marker_cost(start + part * (end - start), model.constants) for part in (0.95, 1.0, 1.05)]
    assert along[1] < min(along[0], along[2])
