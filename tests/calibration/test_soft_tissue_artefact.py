"""Soft tissue by the task: its regressors, rigid columns instead of every marker, and the scale of
a person.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from gaitcal.calibration import soft_tissue_artefact
from gaitcal.calibration.joint_prior import select_prior
from gaitcal.calibration.soft_tissue_artefact import (
    LOG_SPREAD,
    SCALES,
    SEGMENT_SPREAD,
    SIZES,
    SQUARES,
    ObservedDeformation,
    SoftTissueScale,
    assemble_tissue_prior,
    collect_deformations,
    compute_cluster_tissue,
    compute_task_regressors,
    estimate_soft_tissue_scale,
    list_adjacent_coordinates,
    make_tissue_columns,
)
from gaitcal.calibration.soft_tissue_table import (
    THIGH_M,
    evaluate_place_functions,
    load_people_table,
)
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.parameters import Parameters, list_isolated_parameters
from gaitcal.tracking.banded import eliminate
from gaitcal.tracking.rigid import fit_rigid
from gaitcal.tracking.soft_tissue import (
    MIN_ANGLE_SPREAD_RAD,
    SegmentTissue,
    SoftTissue,
    build_rigid_pattern,
)
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import Array, assert_covariance, perturbed_parameters, random_trial, started
from tests.soft_tissue import marker_covariance

HIP = list_isolated_parameters("hip_r")
SEGMENTS = ("pelvis", "thigh_r")
KIND = "gait"
EXACT = 1e-8
"""Relative: what rounding leaves of dense equations."""
FLOOR = 2e-7
"""Relative: what 1e-13 of its largest entry, added to the matrix of the nodes, leaves of a step."""
NOISE = 5e-4
"""m, white, of every marker coordinate."""
Moves = Mapping[tuple[str, str], Array]
"""(segment, regressor) -> (3 nm,) m, what its markers do."""


def person(
    seed: int, moves: Moves, *, squares: bool = False, frames: int = 200, noise: float = NOISE
) -> list[MotionProblem]:
    """Two trials of pelvis and thigh, with every column that their soft tissue may have."""
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng)
    first, coefficients = random_trial(rng, parameters, segments=SEGMENTS, frames=frames, nodes=9)
    motions = (coefficients, coefficients[::-1] + rng.normal(0, 0.1, coefficients.shape))
    angles = [
        dict(zip(first.chain.coordinates, first.basis.evaluate(n).T, strict=True)) for n in motions
    ]
    trials = []
    for k, (motion, psi) in enumerate(
        zip(motions, compute_task_regressors(angles, squares=True), strict=True)
    ):
        shift = np.zeros(first.data.measured.shape)
        for s, markers in first.data.placed.groups:
            for (segment, name), z in moves.items():
                if segment == first.chain.segments[s]:
                    shift[markers] += z.reshape(-1, 3, 1) * psi[name]
        seen = first.shift_markers(shift).compute_positions(motion, first.build_body(parameters))
        trial = first.with_measured(seen + rng.normal(0, noise, seen.shape))
        used = (
            psi
            if squares
            else {name: values for name, values in psi.items() if not name.endswith(SQUARES)}
        )
        trials.append(
            replace(
                trial,
                name=f"walk {k}",
                tissue=make_tissue_columns(trial, KIND, used, parameters, table={}),
            )
        )
    return trials


def places(seed: int) -> dict[str, Array]:
    """Segment -> (nm, 3) m."""
    return places_of(person(seed, {})[0])


def places_of(problem: MotionProblem) -> dict[str, Array]:
    return {
        problem.chain.segments[s]: problem.data.local[markers]
        for s, markers in problem.data.placed.groups
    }


def drawn(
    seed: int, size: float, segments: Sequence[str] = SEGMENTS, ending: str = ""
) -> dict[tuple[str, str], Array]:
    """What markers of some segments do with every angle beside them, of `size` times the spread of
    people.
    """
    rng = np.random.default_rng([seed, 1])
    return {
        (segment, name + ending): size
        * rng.multivariate_normal(np.zeros(3 * len(local)), marker_covariance(segment, local))
        for segment, local in places(seed).items()
        if segment in segments
        for name in list_adjacent_coordinates(segment)
        if name.endswith("_r") and name.startswith("hip")
    }


def groups_of(problem: MotionProblem) -> tuple[SegmentTissue, ...]:
    return problem.tissue.groups


def test_soft_tissue_moves_with_the_joints_at_both_ends_of_its_segment() -> None:
    assert list_adjacent_coordinates("thigh_r") == (
        "hip_flexion_r",
        "hip_adduction_r",
        "hip_rotation_r",
        "knee_angle_r",
    )
    assert list_adjacent_coordinates("shank_l") == (
        "knee_angle_l",
        "ankle_angle_l",
        "subtalar_angle_l",
    )  # the talus carries no skin
    assert list_adjacent_coordinates("foot_r")[:2] == ("ankle_angle_r", "subtalar_angle_r")
    assert set(list_adjacent_coordinates("pelvis")) == {
        f"hip_{m}_{s}" for m in ("flexion", "adduction", "rotation") for s in "rl"
    }


def test_regressors_are_angles_from_the_static_posture_by_their_rms_over_all_trials_of_a_kind() -> (
    None
):
    rng = np.random.default_rng(1)
    flexion, still = (
        [rng.normal(0.3, 0.4, 50), rng.normal(0.5, 0.2, 80)],
        rng.normal(0.1, 0.2 * MIN_ANGLE_SPREAD_RAD, 80),
    )
    posture = {"flexion": 0.2}
    first, second = compute_task_regressors(
        [{"flexion": flexion[0]}, {"flexion": flexion[1], "still": still}], posture, squares=True
    )
    assert set(first) == {"flexion", "flexion" + SQUARES} and {"still", "still" + SQUARES} < set(
        second
    )
    every = np.concatenate([first["flexion"], second["flexion"]])
    size = np.sqrt(np.mean((np.concatenate(flexion) - 0.2) ** 2))
    np.testing.assert_allclose(first["flexion"], (flexion[0] - 0.2) / size)
    np.testing.assert_allclose(second["still"], still / np.sqrt(np.mean(still**2)))
    bend = np.concatenate([first["flexion" + SQUARES], second["flexion" + SQUARES]])
    np.testing.assert_allclose(every @ bend, 0.0, atol=1e-9 * len(every))
    slope = np.linalg.lstsq(every[:, None], every**2 - bend, rcond=None)[0]
    np.testing.assert_allclose(bend, every**2 - slope * every)


def test_knee_flexion_counts_in_radians_and_its_bend_in_the_task() -> None:
    angle = np.random.default_rng(2).normal(0.5, 0.3, 90)
    (psi,) = compute_task_regressors([{"knee_angle_l": angle}], {"knee_angle_l": 0.1}, squares=True)
    np.testing.assert_allclose(psi["knee_angle_l"], angle - 0.1)
    relative = (angle - 0.1) / np.sqrt(np.mean((angle - 0.1) ** 2))
    np.testing.assert_allclose(
        psi["knee_angle_l" + SQUARES], relative**2 - np.mean(relative**3) * relative
    )
    assert set(compute_task_regressors([{"knee_angle_l": angle}])[0]) == {"knee_angle_l"}


def velocities(
    problem: MotionProblem, coefficients: Array, parameters: Parameters
) -> tuple[Array, Array]:
    """(3 nm nf, nn nq + np) derivatives of the markers by nodes and joint parameters, and R (nm, 3,
    3, nf).
    """
    body, q = problem.build_body(parameters), problem.basis.evaluate(coefficients)
    placed, nq = Kinematics(body, q), coefficients.shape[1]
    spatial, x = placed.columns, problem.compute_positions(coefficients, body)
    slope = np.zeros((*x.shape, len(spatial)))
    for m, segment in enumerate(problem.data.segment):
        moved = problem.chain.support[:, segment][:, None, None] * (
            spatial[:, :3] + np.cross(spatial[:, 3:], x[m][None], axis=1)
        )
        slope[m] = moved.transpose(1, 2, 0)
    by_nodes = slope[..., None, :nq] * problem.basis.matrices[0].toarray()[:, :, None]
    flat = np.concatenate([by_nodes.reshape(*x.shape, -1), slope[..., nq:]], axis=-1).reshape(
        x.size, -1
    )
    axes = placed.axes[problem.data.segment]
    return flat, axes.transpose(0, 2, 1, 3)


def test_six_columns_a_segment_leave_the_joints_where_columns_of_every_marker_do() -> None:
    """A dense model of three numbers a marker and regressor against six a segment: the same
    posterior of the joints.
    """
    seed, scale = 3, SoftTissueScale(0.6, 0.2)
    parameters = perturbed_parameters(np.random.default_rng(seed))
    (problem, _) = person(seed, drawn(seed, 1.0), squares=True, frames=30, noise=0.004)
    problem = problem.with_free(HIP)
    _, coefficients = started(problem, parameters)
    precision = np.linalg.inv(select_prior(HIP, None)[1])
    prior = assemble_tissue_prior([problem], {KIND: scale})
    eliminated = eliminate(
        equations := problem.assemble_equations(coefficients, problem.build_body(parameters))
    )
    hessian = eliminated.hessian / NOISE**2 + block_diag(precision, np.linalg.inv(prior.covariance))
    pull = (
        eliminated.reduce_gradient(equations.node_gradient, equations.parameter_gradient) / NOISE**2
    )
    found, count = np.linalg.inv(hessian), len(HIP)

    slope, axes = velocities(problem, coefficients, parameters)
    columns, weights = [slope], [np.zeros((slope.shape[1] - count,) * 2), precision]
    for group in groups_of(problem):
        covariance = marker_covariance(group.carrier, problem.data.local[group.markers])
        for name, psi in zip(group.names, group.regressors, strict=True):
            moved = np.zeros((*problem.data.measured.shape, len(problem.labels), 3))
            for m in range(group.markers.start, group.markers.stop):
                moved[m, :, :, m] = (axes[m] * psi).transpose(0, 2, 1)
            columns.append(moved[..., group.markers, :].reshape(len(slope), -1))
            weights.append(
                np.linalg.inv(
                    (scale.squares if name.endswith(SQUARES) else scale.linear) * covariance
                )
            )
    whole = np.hstack(columns)
    gap = (
        problem.compute_positions(coefficients, problem.build_body(parameters))
        - problem.data.measured
    ).ravel()
    dense = np.linalg.inv(whole.T @ whole / NOISE**2 + block_diag(*weights))
    own = slice(slope.shape[1] - count, slope.shape[1])
    assert_covariance(found[:count, :count], dense[own, own], atol=EXACT)
    step, wanted = (found @ pull)[:count], (dense @ (whole.T @ gap) / NOISE**2)[own]
    np.testing.assert_allclose(step, wanted, rtol=0, atol=FLOOR * np.abs(wanted).max())


def of_kind(problem: MotionProblem, kind: str) -> MotionProblem:
    """The same trial as one of another kind of task."""
    columns = (
        column for g in groups_of(problem) for column in zip(g.names, g.regressors, strict=True)
    )
    regressors = {name.split("/")[-1]: psi for name, psi in columns}
    nominal = perturbed_parameters(np.random.default_rng(0))
    return replace(
        problem, tissue=make_tissue_columns(problem, kind, regressors, nominal, table={})
    )


def dense_density(
    trials: Sequence[MotionProblem], segment: str, variances: Sequence[Mapping[bool, float]]
) -> Array:
    """Log p of what the rigid fits of a segment leave of its markers; `variances` of linear
    columns, and of squares.
    """
    parts, psis, local = [], [], places_of(trials[0])[segment]
    rigid = build_rigid_pattern(local - local.mean(axis=0)).reshape(-1, 6)
    free = np.linalg.svd(rigid)[0][:, 6:]
    for problem in trials:
        (group,) = [g for g in groups_of(problem) if g.carrier == segment]
        data, frames = problem.data, problem.data.weight.shape[1]
        fit = fit_rigid(local, data.measured[group.markers], data.weight[group.markers])
        error = (
            np.einsum("fij,mif->mjf", fit.rotation, data.measured[group.markers] - fit.origin.T)
            - local[:, :, None]
        )
        changing = np.linalg.svd(np.ones((frames, 1)))[0][
            :, 1:
        ]  # where a marker lies is not how it moves
        parts.append(changing.T @ error.reshape(-1, frames).T @ free)
        psis.append(group.regressors @ changing)
        names = group.names
    left, shape, out = np.concatenate(parts), free.T @ marker_covariance(segment, local) @ free, []
    bends, every = np.array([name.endswith(SQUARES) for name in names]), np.hstack(psis)
    blocks = {
        bent: np.kron(every[bends == bent].T @ every[bends == bent], shape)
        for bent in (False, True)
    }
    for variance in variances:
        covariance = NOISE**2 * np.eye(left.size) + sum(
            variance[bent] * block for bent, block in blocks.items()
        )
        root = np.linalg.cholesky(covariance)
        out.append(
            -0.5 * np.sum(np.linalg.solve(root, left.ravel()) ** 2) - np.log(np.diag(root)).sum()
        )
    return np.array(out)


@pytest.mark.parametrize(("ending", "kinds"), [("", 1), (SQUARES, 1), ("", 2)])
def test_the_scale_is_that_of_the_dense_marginal_likelihood_of_all_segments(
    ending: str, kinds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Integrated over ln s_j of each segment, then over ln s; that of squares with linear columns
    as large as may be, and with even odds that there are none. Trials of one kind of task share
    their columns, those of two have their own.
    """
    monkeypatch.setattr(soft_tissue_artefact, "_estimate_noise", lambda *_: NOISE)
    moves = drawn(6, 0.05, ("pelvis",), ending) | drawn(6, 0.3, ("thigh_r",), ending)
    trials = person(6, moves, squares=True, frames=16)
    if kinds == 2:
        trials[1] = of_kind(trials[1], "hip_r")
    apart = [trials] if kinds == 1 else [[problem] for problem in trials]
    s = np.geomspace(SCALES[0], SCALES[-1], 161)
    prior = np.exp(-0.5 * (np.log(s) / LOG_SPREAD) ** 2)
    segments = np.array([np.exp(-0.5 * (np.log(s / middle) / SEGMENT_SPREAD) ** 2) for middle in s])
    segments /= segments.sum(axis=1, keepdims=True)

    def posterior(linear: Array, squares: Array) -> Array:
        """(s,) prior times p of what all segments show, over p at the first of the variances, which
        is none.
        """
        out = prior.copy()
        variances = [{False: x, True: y} for x, y in zip(linear, squares, strict=True)]
        for segment in SEGMENTS:
            none, *log = np.sum([dense_density(own, segment, variances) for own in apart], axis=0)
            out *= segments @ np.exp(np.array(log) - none)
        return out

    found, square = estimate_soft_tissue_scale(trials), np.append(0.0, s**2)
    weight = posterior(square, 0.0 * square)
    assert found.linear == pytest.approx(
        weight @ s**2 / weight.sum(), rel=0.01
    )  # sums over 41 values of s, and 161
    weight = posterior(np.full_like(square, SCALES[-1] ** 2), square)
    assert found.squares == pytest.approx(weight @ s**2 / (weight.sum() + prior.sum()), rel=0.01)


def test_a_cluster_that_slides_as_a_whole_borrows_the_scale_of_one_that_deforms() -> None:
    pelvis = places(8)["pelvis"]
    slide = build_rigid_pattern(pelvis - pelvis.mean(axis=0)).reshape(-1, 6) @ [
        0.0,
        0.004,
        0.004,
        0.0,
        0.0,
        0.0,
    ]
    sliding = {("pelvis", "hip_adduction_r"): slide}
    still, alone, pooled = (
        estimate_soft_tissue_scale(person(8, moves)).linear
        for moves in ({}, sliding, sliding | drawn(8, 1.0, ("thigh_r",)))
    )
    assert alone == pytest.approx(still, rel=0.05), "what moves together shows no deformation"
    assert pooled > 10 * alone
    trials = person(8, sliding)
    prior = assemble_tissue_prior(trials, {KIND: SoftTissueScale(pooled)})
    at = [
        k for k, key in enumerate(prior.keys) if key.startswith(f"{KIND}/hip_adduction_r/pelvis/")
    ]
    (group,) = [g for g in groups_of(trials[0]) if g.carrier == "pelvis"]
    own = prior.covariance[np.ix_(at, at)]
    np.testing.assert_allclose(
        own, pooled * group.covariance[group.names.index(f"{KIND}/hip_adduction_r")]
    )
    assert own[1, 1] > pooled * SIZES["pelvis"].shift ** 2


def test_one_soft_segment_softens_the_others_less_than_one_scale_for_all_would(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, all_soft = person(8, drawn(8, 1.0, ("thigh_r",))), person(8, drawn(8, 1.0))
    differing, alike = (
        estimate_soft_tissue_scale(one).linear,
        estimate_soft_tissue_scale(all_soft).linear,
    )
    monkeypatch.setattr(soft_tissue_artefact, "SEGMENT_SPREAD", 1e-6)
    assert differing < 0.4 * estimate_soft_tissue_scale(one).linear
    assert alike > estimate_soft_tissue_scale(all_soft).linear, (
        "where all are soft, nothing is taken off"
    )


def test_segments_whose_joints_an_activity_may_leave_at_rest_calm_no_other() -> None:
    """An angle that only seems to move, by errors of others, goes with no deformation: as if the
    skin were none.
    """
    one, all_soft = person(8, drawn(8, 1.0, ("thigh_r",))), person(8, drawn(8, 1.0))
    walks, activity = (
        estimate_soft_tissue_scale(one, possibly_still=still).linear for still in (False, True)
    )
    everything = estimate_soft_tissue_scale(all_soft).linear
    assert walks < 0.2 * everything and 0.5 * everything < activity < 2.0 * everything
    assert estimate_soft_tissue_scale(all_soft, possibly_still=True).linear == pytest.approx(
        everything, rel=0.1
    )


@pytest.mark.parametrize("seen", [0.01, 0.0])
def test_a_marker_that_is_seldom_seen_hides_nothing(seen: float) -> None:
    """A fourth marker of the thigh, seen in two frames or never: the other three tell."""
    trials = []
    for problem in person(9, drawn(9, 1.0, ("thigh_r",))):
        weight = problem.data.weight.copy()
        weight[-1, int(seen * weight.shape[1]) :] = 0.0
        trials.append(problem.with_weight(weight))
    assert 0.3 < np.sqrt(estimate_soft_tissue_scale(trials).linear) < 2.0


def test_the_prior_joins_the_columns_of_a_segment_over_trials_and_parts_those_of_kinds() -> None:
    first, second = person(1, {}, squares=True)
    other = of_kind(second, "hip_r")
    scales = {KIND: SoftTissueScale(0.4, 0.1), "hip_r": SoftTissueScale(0.2, 0.3)}
    alike, apart = (
        assemble_tissue_prior([first, second], scales),
        assemble_tissue_prior([first, other], scales),
    )
    count = len(alike.keys)
    assert (
        len(set(apart.keys)) == len(apart.keys) == 2 * count == 2 * 2 * 6 * 6
    )  # segments, regressors, components
    np.testing.assert_array_equal(apart.covariance[:count, :count], alike.covariance)
    assert not apart.covariance[:count, count:].any()
    for key, variance in zip(apart.keys, np.diag(apart.covariance), strict=True):
        kind, name, segment, _ = key.split("/")
        there = np.diag(alike.covariance)[alike.keys.index(key.replace(kind, KIND, 1))]
        of_kind_, of_gait = (
            scale.squares if name.endswith(SQUARES) else scale.linear
            for scale in (scales[kind], scales[KIND])
        )
        assert variance == pytest.approx(there * of_kind_ / of_gait), segment


def test_an_angle_that_hardly_moves_moves_the_skin_as_little() -> None:
    still = np.random.default_rng(3).normal(0.0, 0.2 * MIN_ANGLE_SPREAD_RAD, 60)
    (psi,) = compute_task_regressors([{"hip_adduction_r": still}])
    np.testing.assert_allclose(psi["hip_adduction_r"], still / MIN_ANGLE_SPREAD_RAD)


def knee_skin(side: str, softness: float = 1.0) -> tuple[SegmentTissue, MotionProblem, Parameters]:
    """The thigh of a leg whose knee bends, with gaitcal's own table."""
    rng = np.random.default_rng(5)
    parameters = perturbed_parameters(rng, 0.0, 0.0)
    segments = (f"thigh_{side}", f"shank_{side}")
    problem, _ = random_trial(rng, parameters, segments=segments, frames=40, nodes=8)
    regressors = {f"knee_angle_{side}": rng.normal(size=40)}
    tissue = make_tissue_columns(problem, KIND, regressors, parameters, softness=softness)
    assert tissue is not None
    return tissue.groups[0], problem, parameters


def test_the_expected_artefact_is_the_table_at_the_markers_mirrored_on_the_left() -> None:
    field = load_people_table()["thigh"]
    for side, mirror in (("r", [1.0, 1.0, 1.0]), ("l", [1.0, 1.0, -1.0])):
        group, problem, parameters = knee_skin(side)
        knee = parameters.centre(f"knee_{side}", f"thigh_{side}")
        length = np.linalg.norm(knee)
        functions = evaluate_place_functions(
            (problem.data.local[group.markers] - knee) * mirror / length, gait=True
        )
        wanted = length / THIGH_M * field.compute_mean(functions) * mirror
        np.testing.assert_allclose(group.expected[0], wanted, atol=1e-15)
        small = replace(group, regressors=1e-6 * group.regressors)
        still = group.softness * np.einsum("mi,f->mif", wanted, small.regressors[0])
        moved = problem_tissue(small).compute_shift(np.zeros(6), len(problem.labels))[group.markers]
        np.testing.assert_allclose(moved, still, atol=1e-12)


def problem_tissue(group: SegmentTissue) -> SoftTissue:
    return SoftTissue((group,))


def test_the_rigid_covariance_is_the_markers_own_projected_on_shifts_and_turns() -> None:
    group, _, _ = knee_skin("l")
    flat = group.pattern.reshape(-1, 6)
    inverse = np.linalg.pinv(flat)
    np.testing.assert_allclose(
        group.covariance[0], inverse @ group.by_marker[0] @ inverse.T, rtol=1e-6, atol=1e-12
    )


def test_an_artefact_that_is_not_fitted_is_uncertain_by_its_mean_too() -> None:
    scale = SoftTissueScale(0.8, 0.0, 0.7, 0.6)
    mean, unit = np.arange(1.0, 7.0), np.eye(6)
    fitted, left_out = (
        scale.compute_covariance("knee_angle_r", unit, mean, by) for by in (0.7, 0.0)
    )
    np.testing.assert_allclose(fitted, 0.8 * unit + (0.6 * 1.49 - 0.49) * np.outer(mean, mean))
    np.testing.assert_allclose(left_out, 0.8 * unit + 0.6 * 1.49 * np.outer(mean, mean))


def deformed(move: Array) -> tuple[MotionProblem, ObservedDeformation]:
    """The thigh and shank of a leg that follows its linkage, but for what markers of the thigh do
    per radian.
    """
    rng = np.random.default_rng(11)
    parameters = perturbed_parameters(rng, 0.0, 0.0)
    problem, coefficients = random_trial(
        rng, parameters, segments=("thigh_r", "shank_r"), frames=40, nodes=8
    )
    (psi,) = compute_task_regressors([{"knee_angle_r": rng.normal(0.0, 0.5, 40)}])
    tissue = make_tissue_columns(problem, KIND, psi, parameters)
    assert tissue is not None
    thigh = next(group for group in tissue.groups if group.carrier == "thigh_r")
    shift = np.zeros((len(problem.labels), 3, 40))
    shift[thigh.markers] = move[:, :, None] * thigh.regressors[0]
    measured = problem.shift_markers(shift).compute_positions(
        coefficients, problem.build_body(parameters)
    )
    problem = replace(
        problem.with_data(replace(problem.data, measured=measured)), tissue=SoftTissue((thigh,))
    )
    (observed,) = collect_deformations([problem]).values()
    return problem, observed


def deformation_of(seed: int) -> tuple[Array, Array]:
    """What markers of the thigh do against each other, (nm, 3) m per radian, and B."""
    _, observed = deformed(np.zeros((thigh_markers(), 3)))
    move = np.random.default_rng(seed).normal(0.0, 0.004, (thigh_markers(), 3))
    flat = observed.pattern.reshape(-1, 6)
    return move - (flat @ np.linalg.pinv(flat) @ move.ravel()).reshape(move.shape), observed.pattern


def thigh_markers() -> int:
    group, _, _ = knee_skin("r")
    return len(group.pattern)


def test_markers_deform_as_they_are_observed_to_and_not_as_others_do() -> None:
    wanted, _ = deformation_of(3)
    _, observed = deformed(wanted)
    found = compute_cluster_tissue(observed, SoftTissueScale(1.0, 0.0, 1.0, 1.0))
    others = observed.expected[0].reshape(wanted.shape)
    assert np.abs(found.deformation[0] - wanted).max() < 5e-4 < 0.1 * np.abs(others).max()


def test_a_cluster_that_moves_as_a_whole_shows_nothing_of_it() -> None:
    wanted, pattern = deformation_of(3)
    scale = SoftTissueScale(1.0, 0.0, 1.0, 1.0)
    sliding = pattern @ np.array([1.0, -2.0, 0.5, 0.01, 0.0, -0.02]) * 2e-3
    found, alike = (
        compute_cluster_tissue(deformed(move)[1], scale) for move in (wanted, wanted + sliding)
    )
    np.testing.assert_allclose(found.deformation, alike.deformation, atol=5e-5)
    np.testing.assert_allclose(found.mean, alike.mean, atol=3e-5)
    np.testing.assert_allclose(found.covariance, alike.covariance, rtol=0.05, atol=1e-8)


def test_deformation_narrows_what_a_cluster_does_as_a_whole_by_what_both_have_in_common() -> None:
    _, observed = deformed(deformation_of(3)[0])
    scale, nothing = SoftTissueScale(0.8, 0.0, 0.9, 0.9), 0.0 * observed.information
    before = compute_cluster_tissue(replace(observed, information=nothing, right=nothing[0]), scale)
    after = compute_cluster_tissue(observed, scale)
    assert not before.mean.any()
    mean = np.linalg.pinv(observed.pattern.reshape(-1, 6)) @ observed.expected[0]
    unit = observed.rigid_covariance[0]
    np.testing.assert_allclose(
        before.covariance, scale.compute_covariance("knee_angle_r", unit, mean, 0.9), rtol=1e-9
    )
    assert np.linalg.eigvalsh(before.covariance - after.covariance).min() > -1e-12
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0


def test_a_pair_shows_how_its_distance_changes() -> None:
    problem, _ = deformed(np.zeros((thigh_markers(), 3)))
    (thigh,) = problem.tissue.groups if problem.tissue else ()
    kept = np.arange(thigh.markers.start, thigh.markers.start + 2)
    local = problem.data.local[kept]
    line = (local[1] - local[0]) / np.linalg.norm(local[1] - local[0])
    move = np.zeros((thigh_markers(), 3))
    move[1] = 0.010 * line
    problem, _ = deformed(move)
    weight = problem.data.weight.copy()
    weight[[k for k in range(len(weight)) if k not in kept]] = 0.0
    (observed,) = collect_deformations([problem.with_weight(weight)]).values()
    values, vectors = np.linalg.eigh(observed.information)
    assert values[-1] > 0.0 and values[-2] < 1e-9 * values[-1]
    along = np.zeros_like(move)
    along[:2] = np.sqrt(0.5) * np.array([-line, line])
    assert abs(vectors[:, -1] @ along.ravel()) == pytest.approx(1.0)
    assert vectors[:, -1] @ observed.right / values[-1] * (
        vectors[:, -1] @ along.ravel()
    ) == pytest.approx(0.010 * np.sqrt(0.5), rel=0.02)


def test_the_prior_of_a_trial_is_that_of_its_observed_clusters() -> None:
    problem, observed = deformed(deformation_of(3)[0])
    scale = SoftTissueScale(1.0, 0.0, 1.0, 1.0)
    which = KIND, ("thigh_r", tuple(problem.labels[problem.tissue.groups[0].markers]))  # type: ignore[union-attr]
    prior = assemble_tissue_prior(
        [problem], {KIND: scale}, {which: compute_cluster_tissue(observed, scale)}
    )
    plain = assemble_tissue_prior([problem], {KIND: scale})
    assert prior.keys == plain.keys
    assert prior.mean.any() and not plain.mean.any()
    assert (np.diag(prior.covariance) <= np.diag(plain.covariance) * (1 + 1e-9)).all()


def test_pinned_markers_do_not_move() -> None:
    group, problem, parameters = knee_skin("r")
    psi = {"knee_angle_r": group.regressors[0]}
    both, one = (
        make_tissue_columns(problem, KIND, psi, parameters, pinned=pinned)
        for pinned in ((), ("thigh_r",))
    )
    assert both is not None and one is not None
    assert [g.carrier for g in both.groups] == ["thigh_r", "shank_r"]
    assert [g.carrier for g in one.groups] == ["shank_r"]


def test_a_trial_that_shows_no_deformation_has_its_regressors_in_that_of_others() -> None:
    """Two trials of the same markers, one of which sees a single marker of them and an
    angle more.
    """
    shown, _ = deformed(deformation_of(3)[0])
    assert shown.tissue is not None
    (group,) = shown.tissue.groups
    weight = shown.data.weight.copy()
    weight[group.markers.start + 1 : group.markers.stop] = 0.0
    more = replace(
        group,
        names=(*group.names, f"{KIND}/hip_flexion_r"),
        regressors=np.vstack([group.regressors, np.ones(40)]),
        expected=np.concatenate([group.expected, 0.0 * group.expected]),
        covariance=np.concatenate([group.covariance, group.covariance]),
        by_marker=np.concatenate([group.by_marker, group.by_marker]),
    )
    blind = replace(shown.with_weight(weight), name="blind", tissue=SoftTissue((more,)))
    assert not collect_deformations([blind])
    (alone,), (both,) = (
        collect_deformations(trials).values() for trials in ([shown], [shown, blind])
    )
    assert both.names == more.names
    count = len(alone.right)
    np.testing.assert_array_equal(both.information[:count, :count], alone.information)
    assert not both.information[count:].any()
    scale = SoftTissueScale(1.0, 0.0, 1.0, 1.0)
    one, two = compute_cluster_tissue(alone, scale), compute_cluster_tissue(both, scale)
    np.testing.assert_allclose(two.deformation[0], one.deformation[0], atol=1e-12)
    assert not two.deformation[1].any()
    which = KIND, ("thigh_r", tuple(shown.labels[group.markers]))
    prior = assemble_tissue_prior([shown, blind], {KIND: scale}, {which: two})
    assert len(prior.keys) == len(two.mean)
    np.testing.assert_allclose(prior.covariance, two.covariance, atol=1e-15)


def test_pairs_say_nothing_of_how_soft_a_person_is() -> None:
    problem, _ = deformed(deformation_of(3)[0])
    (group,) = problem.tissue.groups if problem.tissue else ()
    weight = problem.data.weight.copy()
    weight[group.markers.start + 2 : group.markers.stop] = 0.0
    pair = problem.with_weight(weight)
    assert [observed.markers for observed in collect_deformations([pair]).values()] == [2]
    assert estimate_soft_tissue_scale([pair]) == estimate_soft_tissue_scale([])
    assert estimate_soft_tissue_scale([problem]) != estimate_soft_tissue_scale([])
