"""Sensitivities: p values, trials of another length, absorbed noise; draws stopped early, other centres."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.linkage import LEGS
from gaitcal.model.parameters import gait_parameters
from gaitcal.motion.trial_problem import MotionProblem
from gaitcal.published.case import MonteCarloCase, nominal_case
from gaitcal.published.claims import Claim, Verdict
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
from gaitcal.published.noise_sensitivity import (
    RATES,
    Absorbed,
    LengthDraws,
    Place,
    absorbed,
    absorbed_claims,
    absorbed_squares,
    any_motion_share,
    joint_p,
    low_p,
    place,
    trial_length_claims,
    trial_length_rows,
    trial_lengths,
)
from gaitcal.published.protocol import PROBLEMS, MonteCarloSettings, ReactionFrame, Varied, table_one
from gaitcal.published.recovery import solve, synthetic_problem, true_model, true_motion
from gaitcal.synthetic.motion import marker_noise, synthetic_markers
from tests.derivatives import Array, central_differences
from tests.published.test_claims import AS_PUBLISHED, disturbed_table

DRAWS, FIGURES, REPEATS = 24, 12, 6000


def test_p_of_a_further_draw_is_uniform_whatever_the_distribution() -> None:
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(FIGURES, FIGURES))
    ps = []
    for _ in range(REPEATS):
        figures = np.exp(rng.standard_t(3, size=(DRAWS + 1, FIGURES)) @ mixing)  # heavy tails, correlated
        ps.append(joint_p(figures[:-1], figures[-1]))
    counts = np.bincount(np.rint((DRAWS + 1) * np.array(ps)).astype(int), minlength=DRAWS + 2)[1:]
    expected = REPEATS / (DRAWS + 1)
    assert counts.sum() == REPEATS
    # chi^2 of 24 degrees of freedom: above 60 in 1 of 15 000 cases, were the seed another
    assert ((counts - expected) ** 2 / expected).sum() < 60.0


def test_a_figure_against_the_correlation_is_no_ordinary_draw() -> None:
    rng = np.random.default_rng(2)
    common = rng.normal(size=(100, 1))
    draws = np.exp(common + 0.1 * rng.normal(size=(100, 3)))
    assert joint_p(draws, np.exp([1.0, 1.0, 1.0])) > 0.1
    assert joint_p(draws, np.exp([1.0, 1.0, -1.0])) == pytest.approx(1 / 101)
    assert joint_p(draws, np.ones(3)) > 0.9


def test_too_few_draws_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    assert np.isnan(joint_p(rng.lognormal(size=(19, 3)), np.full(3, 1e6)))
    assert joint_p(rng.lognormal(size=(20, 3)), np.full(3, 1e6)) == pytest.approx(1 / 21)
    assert np.isnan(joint_p(rng.lognormal(size=(30, 30)), np.ones(30)))
    assert np.isnan(low_p(rng.lognormal(size=(19, 3)), np.zeros(3)))
    places = [Place(np.nan, np.nan), Place(0.03, 0.009), Place(0.03, 0.011), Place(0.07, 0.011), Place(0.07, 0.009)]
    verdicts = [found.verdict for found in places]
    assert verdicts == [Verdict.NOT_RUN, Verdict.FAILS, Verdict.UNDECIDED, Verdict.UNDECIDED, Verdict.HOLDS]


def test_a_rank_sum_is_low_where_every_figure_is() -> None:
    rng = np.random.default_rng(5)
    draws = rng.lognormal(size=(200, 7))
    assert low_p(draws, np.full(7, np.exp(-1.0))) < 0.02 < joint_p(draws, np.full(7, np.exp(-1.0)))
    assert low_p(draws, np.full(7, np.exp(1.0))) > 0.98
    ps = [low_p(*np.split(rng.lognormal(size=(40, 5)), [39])) for _ in range(2000)]
    assert np.mean(np.array(ps) <= 0.1) == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize(("test", "size"), [(joint_p, 1.2), (low_p, 0.8)])
def test_the_error_is_that_of_other_draws(test: Callable[[Array, Array], float], size: float) -> None:
    rng = np.random.default_rng(6)
    printed = np.exp(-np.full(5, size))
    places = [place(test, rng.lognormal(size=(120, 5)), printed) for _ in range(25)]
    scatter = np.std([found.p for found in places])
    assert 0.5 < np.mean([found.error for found in places]) / scatter < 2.0


@pytest.fixture(scope="module")
def lengths() -> list[LengthDraws]:
    return trial_lengths(0, 2, jobs=1)


@pytest.mark.slow
def test_rows_and_claims(lengths: list[LengthDraws]) -> None:
    rows = trial_length_rows(lengths)
    assert len({(r.row, r.column) for r in rows}) == len(rows) == 2 * (4 + 7 + 2)
    (few,) = trial_length_claims(lengths)
    assert few.verdict is Verdict.NOT_RUN  # two draws tell nothing
    (not_run,) = trial_length_claims(None)
    assert (not_run.verdict, not_run.claim) == (Verdict.NOT_RUN, few.claim)


class _Fixed(LengthDraws):
    """Draws of the seven figures, without the searches behind them."""

    def values(self, problem: str, key: str) -> np.ndarray:
        rng = np.random.default_rng([PROBLEMS.index(problem), len(key)])
        printed = table_one("synthetic_with_noise", key)[problem] or 0.0
        return (self.rate / RATES[1]) * printed * rng.lognormal(size=200)


def test_the_claim_follows_the_rank_sum_and_tells_both_p_with_errors() -> None:
    def claim(first: float, last: float) -> Claim:
        return trial_length_claims([_Fixed(RATES[1] * first, [{}] * 200), _Fixed(RATES[1] * last, [{}] * 200)])[0]

    verdicts = [claim(*sizes).verdict for sizes in ((3.0, 1.0), (1.0, 1.0), (3.0, 3.0))]
    assert verdicts == [Verdict.HOLDS, Verdict.FAILS, Verdict.FAILS]
    told = claim(3.0, 1.0).ours
    assert told.count("low rank sum p = ") == told.count("distance p = ") == 2
    assert told.count(" +- ") == 4
    assert "ordinary" not in told + claim(3.0, 1.0).claim
    low = _Fixed(3 * RATES[1], [{}] * 200)
    assert low.low.p < 0.02 < low.joint.p  # low in every row, and not far in any


LEG = ("pelvis", "thigh_l", "shank_l", "talus_l", "foot_l")


def dense_squares(problem: MotionProblem, coefficients: Array, free: tuple[str, ...], noise: Array) -> float:
    """|P n|^2 by a least-squares solution with every column of J written out, by central differences."""
    truth = true_model().parameters
    values = problem.with_free(free).values(truth)

    def positions(x: Array) -> Array:
        nodes, parameters = np.split(x, [coefficients.size])
        body = problem.body(truth.with_joint(free, parameters))
        return problem.positions(nodes.reshape(coefficients.shape), body)

    matrix, _ = np.linalg.qr(central_differences(positions, np.append(coefficients, values)))
    return float(np.square(matrix.T @ noise.ravel()).sum())


@pytest.mark.parametrize("free", [(), gait_parameters("l")])
def test_a_dense_projection_gives_the_same(free: tuple[str, ...]) -> None:
    problem = synthetic_problem("full leg", None).part("pelvis", LEG)
    whole, motion = synthetic_problem("full leg", None).chain.coordinates, true_motion("full leg")
    coefficients = motion.coefficients[:, [whole.index(name) for name in problem.chain.coordinates]]
    noise = marker_noise(problem.basis.time, len(problem.labels), np.random.default_rng(0)).transpose(1, 2, 0)
    (ours,) = absorbed_squares(problem.with_free(free), true_model().parameters, coefficients, [noise])
    assert ours == pytest.approx(dense_squares(problem, coefficients, free, noise), rel=1e-6)
    share = any_motion_share(problem, true_model().parameters, coefficients)
    assert share == len(problem.chain.coordinates) / noise[..., 0].size


def test_coordinates_absorb_at_most_their_part_of_the_marker_coordinates() -> None:
    found = absorbed("full leg", 0, draws=40)
    problem = synthetic_problem("full leg", None)
    frame = problem.frame_hessians(true_motion("full leg").q, problem.body(true_model().parameters))[0]
    assert found.any_motion == pytest.approx((frame.diagonal() > 0).sum() / 123)  # a segment without markers tells none
    assert found.motion <= found.any_motion + 3 * found.standard_error
    assert found.motion < found.whole < found.motion + 0.05
    # 20 nodes follow half a second of noise below 4 Hz, but not six seconds
    assert found.motion > 0.9 * found.any_motion
    assert absorbed("hip", 0, draws=5).motion < 0.6 * found.any_motion


def test_a_fit_leaves_what_is_told() -> None:
    exact = synthetic_problem("hip", None)
    noisy = synthetic_problem("hip", np.random.default_rng(5))
    noise = noisy.data.measured - exact.data.measured
    truth = true_model().parameters
    found = solve("hip", noisy, truth, compare=False)
    opened = exact.with_free(found.names)
    (absorbed_part,) = absorbed_squares(opened, truth, true_motion("hip").coefficients, [noise])
    assert found.cost == pytest.approx(float((noise**2).sum()) - absorbed_part, rel=5e-3)


def test_claim_follows_the_figures() -> None:
    printed = [table_one("synthetic_with_noise", "marker_distance_mm")[p] or 0.0 for p in PROBLEMS]
    rng = np.random.default_rng(6)

    def shares(around: list[float]) -> dict[str, Absorbed]:
        one = Absorbed(41, 27 / 123, 0.2, 0.22, 0.001, np.zeros(0))
        return {p: replace(one, left_mm=m + 0.3 * rng.normal(size=60)) for p, m in zip(PROBLEMS, around, strict=True)}

    (near,), (far,) = absorbed_claims(shares(printed)), absorbed_claims(shares([m + 1.5 for m in printed]))
    assert (near.verdict, far.verdict) == (Verdict.HOLDS, Verdict.FAILS)
    assert "on average, to first order, a motion of 27 coordinates alone absorbs at most 22 % of the noise" in far.ours
    assert "free joint parameters add to it: hip 22.0, knee 22.0" in far.ours
    assert "6.2 of 7.07 mm" in far.ours
    (not_run,) = absorbed_claims(None)
    assert (not_run.verdict, not_run.claim) == (Verdict.NOT_RUN, far.claim)


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
    q = context.basis.evaluate(case.coefficients)
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
        ended = rows[varied.value, iteration.value, CONVERGED]
        np.testing.assert_array_equal(ended, draw(context, varied, 50, 0).values)
    newton = rows[varied.value, Iteration.GAUSS_NEWTON.value, 10]
    np.testing.assert_allclose(newton, rows[varied.value, Iteration.GAUSS_NEWTON.value, CONVERGED], atol=1e-3)


def test_steepest_descent_goes_to_the_lowest_point_of_its_line(context: MonteCarloContext) -> None:
    model = disturbed_model(context, disturb(context, Varied.NOISE, 25, NUMBER))
    start, end = path(context, model, Iteration.STEEPEST_DESCENT, (0, 1))
    along = [model.problem.marker_cost(start + part * (end - start), model.body) for part in (0.95, 1.0, 1.05)]
    assert along[1] < min(along[0], along[2])


KEYS = [(iteration, count) for iteration in Iteration for count in iteration.counts]
SOME = [(i, count) for i, count in KEYS if count == 2 or (i is Iteration.GAUSS_NEWTON and count in (0, 1, CONVERGED))]
TWICE = {torque: 2 * value for torque, value in AS_PUBLISHED.items()}


def _stopped(like_printed: tuple[Iteration, int] | None, markers: tuple[Iteration, int] | None) -> StoppedRefits:
    """Torques as printed after one number of iterations, and marker errors as printed after one."""
    errors = {key: AS_PUBLISHED if key == like_printed else TWICE for key in SOME}
    millimetres = {key: 28.0 if key == markers else 12.0 for key in SOME}
    return StoppedRefits({key: disturbed_table(errors[key], jp_mm=millimetres[key]) for key in SOME}, 40)


def test_both_at_once() -> None:
    second = (Iteration.GAUSS_NEWTON, 2)
    for claim in refit_claims(_stopped(second, second)):
        assert claim.verdict is Verdict.HOLDS
        assert "both at once: Gauss-Newton 2." in claim.ours


@pytest.mark.slow
def test_one_after_the_other_is_not_at_once() -> None:
    for claim in refit_claims(_stopped((Iteration.GAUSS_NEWTON, 2), (Iteration.STEEPEST_DESCENT, 2))):
        assert claim.verdict is Verdict.FAILS
        assert "(0, 1, 2, 3, 5, 10 of Gauss-Newton; 0, 1, 2, 3, 5, 10, 30 of steepest descent; the end)" in claim.claim
        assert "marker errors: steepest descent 2; printed torque errors: Gauss-Newton 2; both" in claim.ours
        assert "both at once: at none of those tried." in claim.ours
        assert "; steepest descent 2: 6.0 mm" not in claim.ours and "; steepest descent 2: 14.0 mm" in claim.ours
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
    wrench += np.array([[1.0], [-1.0]]) * [30.0, 0.0, 0.0, 12.0, -3.0, 20.0]
    wrench[5] = 0.0  # a frame without ground
    shared = with_shared_centre(replace(case, wrench=wrench)).wrench
    np.testing.assert_allclose(shared.sum(axis=1), wrench.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(shared[:, :, VERTICAL], wrench[:, :, VERTICAL], atol=1e-9)
    both = (shared[:, :, VERTICAL] > 20.0).all(axis=1)
    assert both.sum() > 10 and not shared[5].any()
    per_newton = shared[both] / shared[both][:, :, [VERTICAL]]
    np.testing.assert_allclose(per_newton[:, 0], per_newton[:, 1], atol=1e-9)
    again = with_shared_centre(replace(case, wrench=shared)).wrench
    np.testing.assert_allclose(again, shared, atol=1e-9)


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


def test_draws_are_those_of_the_study() -> None:
    found = pressure_centres(0, 2, jobs=1)
    again = pressure_centres(0, 2, jobs=1)
    for centre in (OWN, SHARED):
        for frame in ReactionFrame:
            np.testing.assert_array_equal(found.drawn[centre][frame], again.drawn[centre][frame])
            changed = found.drawn[centre][frame] > 0
            np.testing.assert_array_equal(changed.all(axis=0), changed.any(axis=0))
            assert changed.any()
    rows = pressure_centre_rows(found)
    assert len({(r.row, r.column) for r in rows}) == len(rows) == 2 * 2 * len(TORQUES)
    knee = next(r for r in rows if r.column == "knee flexion" and OWN in r.row and "carried" in r.row)
    expected = found.errors(OWN, ReactionFrame.FOOT)[TORQUES.index("knee_angle")]
    assert (knee.published, knee.ours) == (0.92, pytest.approx(expected))
