"""Joint parameters: exact recovery, the reduced problem against a dense reference, bounds, priors,
nested sets.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from gaitcal.calibration import reduced_problem
from gaitcal.calibration import reduced_problem as open_motion
from gaitcal.calibration.joint_estimate import JointFit, JointSearch, JointSettings
from gaitcal.calibration.reduced_problem import ReducedProblem
from gaitcal.calibration.soft_tissue_artefact import TissuePrior
from gaitcal.calibration.tissue_elimination import EliminatedKind, split_by_kind
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JP_INDEX,
    Parameters,
    list_gait_parameters,
    list_isolated_parameters,
    read_published_parameters,
)
from gaitcal.synthetic.synthetic_motion import (
    compute_synthetic_markers,
    draw_marker_noise,
    simulate_gait,
)
from gaitcal.tracking import trial_problem
from gaitcal.tracking.banded import BandFactor, eliminate
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.soft_tissue import SegmentTissue, SoftTissue, build_rigid_pattern
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.derivatives import (
    Array,
    central_differences,
    noisy,
    perturbed_parameters,
    random_trial,
    started,
)

KNEE = list_isolated_parameters("knee_r")
PART = ("thigh_r", "shank_r")


def knee_trial(seed: int, noise: float = 0.0, frames: int = 60) -> tuple[MotionProblem, Parameters]:
    """A trial of thigh and shank with true parameters of its own, and those."""
    rng = np.random.default_rng(seed)
    truth = perturbed_parameters(rng)
    problem, _ = random_trial(
        rng, truth, frames=frames, nodes=8, root="thigh_r", segments=PART, per_segment=5
    )
    return noisy(problem, rng, noise), truth


def fit(
    problem: MotionProblem, start: Parameters, free: tuple[str, ...], **settings: float
) -> JointFit:
    return JointSearch(
        [problem], start, free, [started(problem, start)[1]], JointSettings(**settings)
    ).run()


def values(parameters: Parameters, names: tuple[str, ...]) -> Array:
    return parameters.joint[[JP_INDEX[name] for name in names]]


def soft_knee_trial(seed: int, names: tuple[str, ...], segments: tuple[str, ...]) -> MotionProblem:
    """A trial of the knee, with columns on the markers of some segments."""
    problem, _ = knee_trial(seed, noise=0.004, frames=30)
    rng, local = np.random.default_rng(seed), problem.data.local
    groups = tuple(
        SegmentTissue(
            segment=s,
            carrier=problem.chain.segments[s],
            markers=markers,
            pattern=build_rigid_pattern(local[markers] - local[markers].mean(axis=0)),
            names=names,
            regressors=rng.normal(size=(len(names), 30)),
            expected=np.zeros((len(names), markers.stop - markers.start, 3)),
            covariance=np.zeros((len(names), 6, 6)),
            by_marker=np.zeros((len(names), 0, 0)),
        )
        for s, markers in problem.data.placed.groups
        if problem.chain.segments[s] in segments
    )
    return replace(problem, tissue=SoftTissue(groups))


def test_the_compressed_problem_is_the_whole_one_with_priors_and_two_kinds_of_soft_tissue() -> None:
    """Three trials that count differently, two of a kind that share some columns of soft tissue,
    against all their rows: cost, gradient and Gauss-Newton matrix with motions and soft tissue
    eliminated, and what is left of these.
    """
    start, rng, shares = read_published_parameters(), np.random.default_rng(5), (4.0, 0.5, 2.0)
    trials = [
        soft_knee_trial(3, ("gait/a", "gait/b"), PART),
        soft_knee_trial(4, ("squat/a",), PART[1:]),
        soft_knee_trial(6, ("gait/b",), PART[1:]),
    ]
    of_kind = trials[0].unknowns, trials[1].unknowns
    assert set(trials[2].unknowns) < set(of_kind[0])
    keys, count = (*of_kind[0], *of_kind[1]), len(KNEE)
    roots = [
        rng.normal(0, 0.003, (len(own), len(own))) + 0.01 * np.eye(len(own)) for own in of_kind
    ]
    mean = rng.normal(0, 0.002, len(keys))
    prior = TissuePrior(keys, block_diag(*(root @ root.T for root in roots)), mean)
    whiten = block_diag(*(np.linalg.inv(root) for root in roots))
    rows, centre = rng.normal(0, 0.2, (count, count)), rng.normal(0, 0.01, count)
    reduced = ReducedProblem(
        trials,
        start,
        KNEE,
        [started(problem, start)[1] for problem in trials],
        DescentSettings(gain=1e-14),
        prior=rows,
        centre=centre,
        tissue=prior,
        kinds=("gait", "squat", "gait"),
    )
    reduced.weigh(shares)
    p = values(start, KNEE) + rng.normal(0, 0.005, count)
    state = reduced.settle(p)
    f, jacobian, size = reduced.compute_residual(p), reduced.compute_jacobian(p), count + len(keys)
    assert len(f) == count + 1, "SciPy sees joint parameters alone"

    def residual(x: Array) -> Array:
        z, at = x[count:size], size
        out = [rows @ (x[:count] - centre), whiten @ (z - mean)]
        for problem, share, trial in zip(trials, shares, state.trials, strict=True):
            coefficients = x[at : at + trial.coefficients.size].reshape(trial.coefficients.shape)
            here = problem.displace(z[[keys.index(key) for key in problem.unknowns]])
            model = here.compute_positions(
                coefficients, here.build_body(start.with_joint(KNEE, x[:count]))
            )
            out.append(np.sqrt(share) * (model - here.data.measured).ravel())
            at += coefficients.size
        return np.concatenate(out)

    z = np.concatenate([kind.z for kind in state.kinds])
    x = np.concatenate([p, z, *(trial.coefficients.ravel() for trial in state.trials)])
    r, slope = residual(x), central_differences(residual, x)
    inner = slope[:, count:].T @ slope[:, count:]
    along = np.linalg.solve(inner, slope[:, count:].T @ np.column_stack([slope[:, :count], r]))
    left = slope[:, :count] - slope[:, count:] @ along[:, :-1]
    assert f @ f == pytest.approx(r @ r, rel=1e-9)
    unit = np.sqrt(np.diag(np.linalg.inv(inner)))
    assert np.abs(along[:, -1] / unit).max() < 2e-3, "soft tissue and motions are at their minimum"
    matrix, pull = left.T @ left, left.T @ r
    np.testing.assert_allclose(jacobian.T @ jacobian, matrix, rtol=0, atol=1e-6 * matrix.max())
    np.testing.assert_allclose(jacobian.T @ f, pull, rtol=0, atol=1e-6 * np.abs(pull).max())


def soft_knee_problem(noise: float = 0.02) -> tuple[ReducedProblem, Array]:
    """Two kinds of task with large errors, whose residuals curve, and a prior of all; and
    a point.
    """
    rng, start = np.random.default_rng(9), read_published_parameters()
    kinds = ("gait", "squat")
    trials = [
        noisy(soft_knee_trial(seed, (f"{kind}/a",), PART), rng, noise)
        for seed, kind in zip((3, 4), kinds, strict=True)
    ]
    keys = (*trials[0].unknowns, *trials[1].unknowns)
    reduced = ReducedProblem(
        trials,
        start,
        KNEE,
        [started(problem, start)[1] for problem in trials],
        DescentSettings(gain=1e-14),
        prior=0.1 * np.eye(len(KNEE)),
        centre=values(start, KNEE),
        tissue=TissuePrior(keys, 0.01**2 * np.eye(len(keys)), np.zeros(len(keys))),
        kinds=kinds,
    )
    return reduced, values(start, KNEE) + rng.normal(0, 0.005, len(KNEE))


def test_newtons_reduced_matrix_is_the_derivative_of_the_reduced_gradient() -> None:
    """Motions and soft tissue of two kinds follow the joint parameters."""
    reduced, p = soft_knee_problem()
    second = central_differences(lambda x: reduced.settle(x).gradient, p, 1e-5)
    plain = reduced.settle(p).hessian
    reduced.state = reduced.best = None
    reduced.settle(p)
    reduced.curved = True
    # so near that only the matrices are formed anew
    curved = reduced.at(p + 1e-9).hessian
    np.testing.assert_allclose(curved, second, rtol=0, atol=1e-4 * np.abs(second).max())
    assert np.abs(plain - second).max() > 1e-2 * np.abs(second).max()


def test_a_saddle_has_no_direction_flatter_than_the_prior() -> None:
    reduced, p = soft_knee_problem()
    state, rng = reduced.settle(p), np.random.default_rng(1)
    matrix = rng.normal(size=state.hessian.shape)
    reduced.state = reduced.best = state = replace(state, hessian=matrix + matrix.T)
    jacobian, f = reduced.compute_jacobian(p), reduced.compute_residual(p)
    unit = np.linalg.inv(reduced.prior)
    curvature = np.linalg.eigvalsh(unit.T @ jacobian.T @ jacobian @ unit)
    given = np.linalg.eigvalsh(unit.T @ (state.hessian + reduced.prior.T @ reduced.prior) @ unit)
    assert given.min() < -1.0
    np.testing.assert_allclose(curvature, np.sort(np.maximum(np.abs(given), 1.0)), rtol=1e-9)
    pull = reduced.prior.T @ reduced.prior @ (p - reduced.centre)
    np.testing.assert_allclose(
        jacobian.T @ f, state.gradient + pull, atol=1e-9 * np.abs(pull).max()
    )


def test_columns_of_soft_tissue_are_added_once_for_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many steps its motion takes, which the band alone determines."""
    reduced, p = soft_knee_problem()
    reduced.at(p)
    p = p + 0.05
    factors, columns = list[int](), list[int]()
    factor, add = reduced_problem.OpenMatrix.factor, trial_problem.add_tissue_columns
    monkeypatch.setattr(
        reduced_problem.OpenMatrix, "factor", lambda *a: (factors.append(1), factor(*a))[1]
    )
    monkeypatch.setattr(
        trial_problem, "add_tissue_columns", lambda *a, **k: (columns.append(1), add(*a, **k))[1]
    )
    kind = reduced._solve_kind(0, p, *reduced._predict_tissue(0, p))
    assert len(columns) == 1 < len(factors)
    monkeypatch.undo()
    lazy = kind.trials[0].matrices
    problem, body = reduced._place_trial(0, lazy.values)[1], reduced.bodies[0]
    body = body.with_free(reduced.get_parameters(p))
    whole = eliminate(problem.assemble_equations(lazy.coefficients, body))
    np.testing.assert_array_equal(lazy.eliminated.hessian, whole.hessian)
    np.testing.assert_array_equal(lazy.eliminated.halfway, whole.halfway)


def test_soft_tissue_has_the_same_columns_whether_joints_are_free_or_not() -> None:
    problem, start = soft_knee_trial(3, ("gait/a",), PART), read_published_parameters()
    coefficients = started(problem, start)[1]
    opened, closed = problem.with_free(KNEE), problem.with_free(())
    whole, part = (
        one.assemble_equations(coefficients, one.build_body(start)) for one in (opened, closed)
    )
    tissue = slice(len(KNEE), None)
    assert part.mixed.shape == (coefficients.size, len(problem.tissue.keys))
    np.testing.assert_allclose(part.mixed, whole.mixed[:, tissue], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        part.parameters, whole.parameters[tissue, tissue], rtol=0, atol=1e-12
    )


def test_the_promise_of_a_step_is_that_of_the_compressed_problem() -> None:
    """And of the soft tissue that is left at the point where the step begins."""
    reduced, p = soft_knee_problem()
    best = reduced.at(p)
    step = np.linspace(-1e-3, 2e-3, len(p))
    f, jacobian = reduced.compute_residual(p), reduced.compute_jacobian(p)
    along = jacobian @ step
    step *= -float(f @ along) / float(along @ along)
    after = f + jacobian @ step
    promised = float(f @ f - after @ after) + sum(kind.reduction for kind in best.kinds)
    assert reduced._promise_reduction(p + step) == pytest.approx(promised, rel=1e-6)
    uphill = sum(kind.reduction for kind in best.kinds)
    assert reduced._promise_reduction(p - step) == pytest.approx(uphill, rel=1e-12)


@pytest.mark.parametrize(("left", "fewest", "most"), [(0.0, 0.0, 1e-12), (1.0, 1.0, 1.1)])
def test_soft_tissue_whose_steps_are_far_too_long_still_comes_to_its_minimum(
    left: float, fewest: float, most: float
) -> None:
    """The cost is z^2 and its matrix a sixteenth of the true one: half a step raises the
    cost, too. What may be left to gain is left.
    """
    reduced, p = soft_knee_problem()
    count, curvature = len(p), 0.06
    prior = reduced.tissue[0]

    def state_at(z: Array) -> reduced_problem.KindState:
        half_gradient, root = z, np.sqrt(curvature) * np.eye(len(z))
        tissue = EliminatedKind(
            prior=prior,
            z=z,
            root=root,
            halfway=np.zeros((len(z), count)),
            forward=half_gradient / np.sqrt(curvature),
            cost=float(z @ z),
            hessian=np.eye(count),
            gradient=np.zeros(count),
        )
        return reduced_problem.KindState((), tissue)

    reduced._solve_kind = lambda k, p, z, near, *, keep=False: state_at(z)  # type: ignore[method-assign]
    start = np.linspace(0.1, 0.2, len(prior.mean))
    enough = left * state_at(start).tissue.reduction
    found = reduced._minimise_tissue(0, p, state_at(start), enough).tissue
    assert fewest <= found.cost / float(start @ start) < most


def test_soft_tissue_at_a_rejected_step_is_solved_to_a_share_of_what_the_step_promised() -> None:
    """Of each kind, so that together they leave no more; the fit ends where it ends if nothing is
    left.
    """

    def run(most: float) -> tuple[JointFit, list[tuple[int, float, float]]]:
        """At most `most` m^2 are left; also kind, what was to be left, and what was promised."""
        reduced, p = soft_knee_problem()
        asked, minimise = list[tuple[int, float, float]](), reduced._minimise_tissue

        def spy(
            k: int, p: Array, here: reduced_problem.KindState, *left: float
        ) -> reduced_problem.KindState:
            asked.extend((k, part, reduced._promise_reduction(p)) for part in left)
            return minimise(k, p, here, *(min(part, most) for part in left))

        reduced._minimise_tissue = spy  # type: ignore[method-assign]
        rigid = [replace(problem, tissue=None) for problem in reduced.open]
        search = JointSearch(rigid, reduced.parameters, KNEE, reduced.starts)
        search.problem = reduced
        return search.run(p + np.random.default_rng(4).normal(0, 0.3, len(p))), asked

    found, asked = run(np.inf)
    promises = {promised for *_, promised in asked}
    assert promises and sorted(asked) == [
        (k, reduced_problem.TISSUE_SHARE * promised / 2, promised)
        for k in (0, 1)
        for promised in sorted(promises)
    ]
    whole, _ = run(0.0)
    information = whole.state.hessian + 0.1**2 * np.eye(len(KNEE))
    error = 0.02 * np.sqrt(np.diag(np.linalg.inv(information)))
    assert (np.abs(found.values - whole.values)[: len(KNEE)] < 1e-2 * error).all()


def test_kinds_that_share_soft_tissue_are_refused() -> None:
    trials = [soft_knee_trial(seed, ("gait/a",), PART) for seed in (3, 4)]
    keys = trials[0].unknowns
    prior = TissuePrior(keys, np.eye(len(keys)), np.zeros(len(keys)))
    with pytest.raises(ValueError, match="share"):
        split_by_kind(prior, [trial.unknowns for trial in trials])


def test_the_cost_told_is_that_where_the_last_step_leads() -> None:
    """Two millimetres further, where motions are not sought to the end: that step gains 4e-5 of the
    cost.
    """
    problem, truth = knee_trial(6, noise=0.002)
    reduced = ReducedProblem(
        [problem], truth, KNEE, [started(problem, truth)[1]], DescentSettings()
    )
    reduced.at(p := values(truth, KNEE))
    (trial,) = reduced.at(p := p + np.random.default_rng(6).normal(0, 0.002, len(p))).trials
    there = problem.compute_cost(trial.coefficients, problem.build_body(truth.with_joint(KNEE, p)))
    assert trial.cost == pytest.approx(there, rel=1e-6)


def test_bounds_are_about_the_nominal_values_wherever_the_fit_starts() -> None:
    """An earlier phase moved the parameter by 8 mm; what is left of 10 mm is 2 mm, though the truth
    is further off.
    """
    problem, truth = knee_trial(5)
    name = ("knee_r.thigh.sup",)
    true = float(values(truth, name)[0])
    nominal, present = (truth.with_joint(name, np.array([true + off])) for off in (0.030, 0.022))
    _, coefficients = started(problem, present)
    settings = JointSettings(position_bound=0.010, orientation_bound=0.1)
    found = JointSearch([problem], present, name, [coefficients], settings, nominal=nominal).run()
    assert found.values[0] == pytest.approx(true + 0.020, abs=1e-4)
    assert found.at_bound == name
    wide = replace(settings, position_bound=0.1)
    assert (
        JointSearch([problem], present, name, [coefficients], wide, nominal=nominal).run().at_bound
        == ()
    )


def test_trials_weighed_anew_go_on_to_the_fit_of_scaled_costs() -> None:
    """Trials of people with different knees, so that their weights tell; the search goes on from
    the even weights.
    """
    shares, start = (9.0, 0.5), read_published_parameters()
    expected = values(start, KNEE), np.eye(len(KNEE))
    trials = [knee_trial(seed, noise=0.002)[0] for seed in (3, 4)]
    starts = [started(problem, start)[1] for problem in trials]
    search = JointSearch(trials, start, KNEE, starts, expected=expected)
    even = search.run_to_tolerance(1e-7)
    search.problem.weigh(shares)
    found = search.run()
    scaled = [problem.scale_cost(share) for problem, share in zip(trials, shares, strict=True)]
    wanted = JointSearch(scaled, start, KNEE, starts, expected=expected).run()
    assert np.abs(even.p - wanted.values).max() > 1e-3
    np.testing.assert_allclose(found.values, wanted.values, rtol=0, atol=2e-5)
    tolerance = 1e-4 * np.abs(wanted.state.hessian).max()
    np.testing.assert_allclose(found.state.hessian, wanted.state.hessian, rtol=0, atol=tolerance)


def test_matrices_kept_on_the_way_are_formed_anew_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, truth = knee_trial(9, noise=0.004)
    start = truth.with_joint(KNEE, values(read_published_parameters(), KNEE))
    used: list[int] = []
    plain = open_motion.OpenMotion.evaluate
    monkeypatch.setattr(
        open_motion.OpenMotion, "evaluate", lambda *a: (used.append(1), plain(*a))[1]
    )
    kept = fit(problem, start, KNEE)
    assert used
    opened = problem.with_free(KNEE)
    equations = opened.assemble_equations(kept.coefficients[0], opened.build_body(kept.parameters))
    solved = BandFactor(equations.band).solve(np.asfortranarray(equations.mixed))
    whole = equations.parameters - equations.mixed.T @ solved
    np.testing.assert_allclose(kept.state.hessian, whole, rtol=0, atol=1e-5 * np.abs(whole).max())
    assert kept.state.trials[0].matrices.is_near(kept.values, kept.coefficients[0])
    np.testing.assert_array_equal(kept.state.trials[0].matrices.values, kept.values)
    monkeypatch.setattr(open_motion, "KEPT_WITHIN", 0.0)
    monkeypatch.setattr(
        reduced_problem, "CORRECTOR", replace(reduced_problem.CORRECTOR, keep_within=0.0)
    )
    fresh = fit(problem, start, KNEE)
    np.testing.assert_allclose(kept.values, fresh.values, rtol=0, atol=2e-5)
    assert kept.state.cost == pytest.approx(fresh.state.cost, rel=1e-9)


def test_a_refused_step_leads_nowhere() -> None:
    """Half the published subject's joint parameters from gait alone: it hardly shows some of them,
    so that steps are long and some refused. The motions they folded must not be where the next ones
    start.
    """
    model, motion = published_model(), simulate_gait()
    markers = compute_synthetic_markers(model.parameters, model.markers, motion.q)
    noisy = markers + draw_marker_noise(
        motion.basis.time, markers.shape[1], np.random.default_rng(1)
    )
    recording = Recording(
        source="gait", time=motion.basis.time, labels=model.markers.labels, markers=noisy
    )
    problem = build_trial_problem("gait", model, recording, ControlPointRule(fixed=20))
    few = (*list_gait_parameters("r"), *list_gait_parameters("l"))
    many = tuple(
        n
        for joint in ("hip", "knee", "ankle")
        for side in "rl"
        for n in list_isolated_parameters(f"{joint}_{side}")
    )
    assert set(few) < set(many)
    costs = [
        fit(problem, model.parameters, free, most_evaluations=60).state.cost for free in (few, many)
    ]
    assert costs[1] < costs[0]
