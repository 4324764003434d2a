"""Sensitivities of the study: re-fits stopped on the way, and one centre of pressure for both feet."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gaitcal.model.linkage import LEGS
from gaitcal.published.case import MonteCarloCase, nominal_case
from gaitcal.published.claims import Verdict
from gaitcal.published.draw import COLUMNS, TORQUES, MonteCarloContext, disturb, disturbed_model, draw
from gaitcal.published.draw_sensitivity import (
    CONVERGED,
    OWN,
    SETS,
    SHARED,
    VERTICAL,
    Iteration,
    PressureCentres,
    StoppedRefits,
    iteration_frame,
    path,
    pressure_centre_claims,
    pressure_centre_rows,
    pressure_centres,
    refit_claims,
    refit_rows,
    stopped_refits,
    unfinished_draws,
    with_shared_centre,
)
from gaitcal.published.protocol import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.synthetic.motion import synthetic_markers
from tests.published.test_disturbance_claims import AS_PUBLISHED, disturbed_table

NUMBER = 3
MARKERS = COLUMNS.index("markers_l.rms")
ALL_TORQUES = slice(0, COLUMNS.index("markers_r.rms"))


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
    size = 1e3 * np.sqrt((noise[context.leg_markers[1]] ** 2).sum(axis=1).mean())
    still = rows["noise", iteration.value, 0]
    assert still[MARKERS] == pytest.approx(size, rel=1e-9)
    np.testing.assert_allclose(still[ALL_TORQUES], 0.0, atol=1e-9)


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


def test_steepest_descent_goes_to_the_lowest_point_of_its_line(context: MonteCarloContext) -> None:
    model = disturbed_model(context, disturb(context, Varied.NOISE, 25, NUMBER))
    start, end = path(context, model, Iteration.STEEPEST_DESCENT, (0, 1))
    along = [model.problem.marker_cost(start + part * (end - start), model.constants) for part in (0.95, 1.0, 1.05)]
    assert along[1] < min(along[0], along[2])


KEYS = [(iteration, count) for iteration in Iteration for count in iteration.counts]
SOME = [(i, count) for i, count in KEYS if count == 2 or (i is Iteration.GAUSS_NEWTON and count in (0, 1, CONVERGED))]
TWICE = {torque: 2 * value for torque, value in AS_PUBLISHED.items()}


def _stopped(like_printed: tuple[Iteration, int] | None, markers: tuple[Iteration, int] | None) -> StoppedRefits:
    """Torques as printed after one number of iterations, and marker errors as printed after one."""
    tables = {
        key: disturbed_table(AS_PUBLISHED if key == like_printed else TWICE, jp_mm=28.0 if key == markers else 12.0)
        for key in SOME
    }
    return StoppedRefits(tables, 40)


def test_both_at_once() -> None:
    second = (Iteration.GAUSS_NEWTON, 2)
    for claim in refit_claims(_stopped(second, second)):
        assert claim.verdict is Verdict.HOLDS
        assert "both at once: Gauss-Newton 2." in claim.ours


@pytest.mark.slow
def test_one_after_the_other_is_not_at_once() -> None:
    for claim in refit_claims(_stopped((Iteration.GAUSS_NEWTON, 2), (Iteration.STEEPEST_DESCENT, 2))):
        assert claim.verdict is Verdict.FAILS
        assert "marker errors: steepest descent 2; printed torque errors: Gauss-Newton 2; both" in claim.ours
        assert "both at once: at none of those tried." in claim.ours
        assert "(0, 1, 2, 3, 5, 10 of Gauss-Newton; 0, 1, 2, 3, 5, 10, 30 of steepest descent; the end)" in claim.claim
        assert "; steepest descent 2: 6.0 mm" not in claim.ours
        assert "; steepest descent 2: 14.0 mm" in claim.ours
    assert {c.verdict for c in refit_claims(None)} == {Verdict.NOT_RUN}
    assert [c.claim for c in refit_claims(None)] == [c.claim for c in refit_claims(_stopped(None, None))]


@pytest.fixture(scope="module")
def stopped() -> StoppedRefits:
    return stopped_refits(0, 1, jobs=1)


@pytest.mark.slow
def test_files_and_rows(stopped: StoppedRefits) -> None:
    frame = iteration_frame(stopped)
    ours = frame[frame["iteration"] != "printed"]
    assert len(ours) == len(KEYS) * 2 * 4
    assert len(frame) == len(ours) + 3
    at = frame.set_index(["set", "level", "iteration", "iterations"])
    table = stopped.tables[Iteration.GAUSS_NEWTON, 1]
    rows = table[(table["set"] == "jp") & (table["level"] == 75) & (table["measure"] == "rms")]
    for column, quantity, grf in (("markers_mm", "markers_l", ""), ("knee_angle.foot", "knee_angle_l", "foot")):
        wanted = rows[(rows["quantity"] == quantity) & (rows["grf"] == grf)]["average"]
        assert at.loc[("jp", 75, "Gauss-Newton", "1"), column] == pytest.approx(wanted.item(), abs=1e-5)
    printed = {(r.row, r.column): r for r in refit_rows(stopped)}
    assert len(printed) == (len(KEYS) - 1) * (2 + 3 * len(ReactionFrame))
    first = printed["Monte Carlo, JP 50 %: Gauss-Newton, 0 iterations", "marker distance RMS"]
    assert first.published == 14.0
    assert first.ours == pytest.approx(at.loc[("jp", 50, "Gauss-Newton", "0"), "markers_mm"], abs=1e-5)
    end = printed["Monte Carlo, JP 100 %: re-fit to the end", "hip flexion, carried with the foot"]
    assert end.published == 4.14
    assert end.ours == pytest.approx(at.loc[("jp", 100, "Gauss-Newton", "converged"), "hip_flexion.foot"], abs=1e-5)


def test_the_sum_stays_and_the_centres_meet() -> None:
    case = nominal_case()
    wrench = case.wrench.copy()
    # Whatever the built-in person's are: forces of the feet that do not lie on one line.
    apart = np.array([0.0, 0.0, 0.0, 12.0, -3.0, 20.0])
    wrench[:, 0] += apart
    wrench[:, 1] -= apart
    wrench[:, 0, 0] += 30.0
    wrench[:, 1, 0] -= 30.0
    shared = with_shared_centre(replace(case, wrench=wrench)).wrench
    np.testing.assert_allclose(shared.sum(axis=1), wrench.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(shared[:, :, VERTICAL], wrench[:, :, VERTICAL], atol=1e-9)
    both = (shared[:, :, VERTICAL] > 20.0).all(axis=1)
    assert both.sum() > 10
    per_newton = shared[both] / shared[both][:, :, [VERTICAL]]
    np.testing.assert_allclose(per_newton[:, 0], per_newton[:, 1], atol=1e-9)
    again = with_shared_centre(replace(case, wrench=shared)).wrench
    np.testing.assert_allclose(again, shared, atol=1e-9)


def test_a_frame_without_ground_is_divided_evenly() -> None:
    case = nominal_case()
    wrench = case.wrench.copy()
    wrench[5] = 0.0
    assert not with_shared_centre(replace(case, wrench=wrench)).wrench[5].any()


def _centres(change: float, scatter: float = 0.0) -> PressureCentres:
    """Errors of 20 draws; with one centre the printed ones are so much larger, and the subtalar one twice as large."""
    rng = np.random.default_rng(0)
    own = rng.lognormal(size=(20, len(TORQUES)))
    shared = own * (1.0 + change + scatter * rng.normal(size=own.shape))
    shared[:, TORQUES.index("subtalar_angle")] = 2.0 * own[:, TORQUES.index("subtalar_angle")]
    return PressureCentres({c: dict.fromkeys(ReactionFrame, e) for c, e in ((OWN, own), (SHARED, shared))})


def test_claims_follow_the_size_of_the_difference_and_not_its_sign() -> None:
    for sign in (1, -1):
        assert {c.verdict for c in pressure_centre_claims(_centres(0.01 * sign))} == {Verdict.HOLDS}
        assert {c.verdict for c in pressure_centre_claims(_centres(0.2 * sign))} == {Verdict.FAILS}
    assert {c.verdict for c in pressure_centre_claims(_centres(0.04, scatter=0.2))} == {Verdict.UNDECIDED}
    claim, _ = pressure_centre_claims(_centres(0.01, scatter=0.05))
    assert claim.claim.startswith("it makes no difference")
    assert claim.ours.count(" +- ") == 3
    assert "hindfoot inversion" in claim.ours.split("changes most")[0].rsplit("torques", 1)[1]
    assert claim.ours.endswith("-50 %")
    assert [c.verdict for c in pressure_centre_claims(None)] == [Verdict.NOT_RUN] * 2


def test_the_error_is_that_of_pairs() -> None:
    centres = _centres(0.0, scatter=0.01)
    apart = centres.drawn[OWN][ReactionFrame.LAB] - centres.drawn[SHARED][ReactionFrame.LAB]
    change, error = centres.difference(ReactionFrame.LAB)
    np.testing.assert_allclose(change, apart.mean(axis=0))
    np.testing.assert_allclose(error, stats.sem(apart, axis=0))


def test_draws_are_those_of_the_study() -> None:
    found = pressure_centres(0, 2, jobs=1)
    again = pressure_centres(0, 2, jobs=1)
    for centre in (OWN, SHARED):
        for frame in ReactionFrame:
            np.testing.assert_array_equal(found.drawn[centre][frame], again.drawn[centre][frame])
            assert (found.drawn[centre][frame] > 0).all()
    rows = pressure_centre_rows(found)
    assert len({(r.row, r.column) for r in rows}) == len(rows) == 2 * 2 * 7
    knee = next(r for r in rows if r.column == "knee flexion" and OWN in r.row and "carried" in r.row)
    expected = found.errors(OWN, ReactionFrame.FOOT)[TORQUES.index("knee_angle")]
    assert (knee.published, knee.ours) == (0.92, pytest.approx(expected))
