"""Soft tissue and what a knee does besides flexing, as variables of a trial: derivatives, and
joints found so.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_estimate import BY_EVIDENCE, Tasks, estimate_joints
from gaitcal.calibration.joint_prior import select_prior
from gaitcal.calibration.soft_tissue_artefact import (
    CUBE_SHARE,
    SECONDARY_SIZES,
    TissuePrior,
    make_secondary_prior,
)
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import SECONDARY
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.tracking.banded import BandFactor
from gaitcal.tracking.soft_tissue import (
    COMPONENTS,
    MIN_ANGLE_SPREAD_RAD,
    SegmentTissue,
    SoftTissue,
    build_rigid_pattern,
    build_secondary_columns,
)
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import Array, central_differences, noisy, perturbed_parameters, seeded_trial

FREE = ("hip_r.pelvis.ant", "hip_r.thigh.sup", "knee_r.thigh.front")
SEGMENTS = ("pelvis", "thigh_r", "shank_r")
SECOND_ORDER = 1e-6
"""Relative: what central differences leave."""


def trial_with_tissue(seed: int) -> tuple[MotionProblem, Array, Array]:
    """A trial off its minimum with two regressors on thigh and shank, its nodes, and z."""
    rng, _, problem, coefficients = seeded_trial(
        seed, free=FREE, segments=SEGMENTS, frames=20, nodes=7
    )
    groups = tuple(
        SegmentTissue(
            segment=s,
            carrier=problem.chain.segments[s],
            markers=markers,
            pattern=build_rigid_pattern(
                problem.data.local[markers] - problem.data.local[markers].mean(axis=0)
            ),
            names=("gait/hip_flexion_r", "gait/knee_angle_r"),
            regressors=rng.normal(size=(2, 20)),
            expected=rng.normal(0, 0.01, (2, markers.stop - markers.start, 3)),
            covariance=np.zeros((2, 6, 6)),
            by_marker=np.zeros((2, 0, 0)),
            softness=0.7,
        )
        for s, markers in problem.data.placed.groups
        if s > 0
    )
    problem = replace(problem, tissue=SoftTissue(groups))
    weight = rng.uniform(0.0, 1.0, problem.data.weight.shape)
    problem = noisy(problem.with_weight(weight), rng, 0.01)
    z = rng.normal(size=(4, 6)) * np.repeat(
        [0.01, 0.1], 3
    )  # m, rad: markers lie some 0.1 m from their middle
    return problem, coefficients, z.ravel()


def test_markers_shift_and_turn_together_along_the_axes_of_their_segment() -> None:
    problem, coefficients, z = trial_with_tissue(4)
    tissue = problem.tissue
    assert tissue is not None and len(tissue.keys) == len(set(tissue.keys)) == len(z)
    shift, by_hand = (
        tissue.compute_shift(z, len(problem.labels)),
        np.zeros((len(problem.labels), 3, 20)),
    )
    for key, value in zip(tissue.keys, z, strict=True):
        name, carrier, component = (
            key.rpartition("/")[0].rpartition("/")[0],
            key.split("/")[-2],
            key.split("/")[-1],
        )
        (group,) = [g for g in tissue.groups if g.carrier == carrier]
        axis = value * np.eye(3)[COMPONENTS.index(component) % 3]
        arms = problem.data.local[group.markers] - problem.data.local[group.markers].mean(axis=0)
        way = (
            np.cross(axis, arms) if component.startswith("r") else np.broadcast_to(axis, arms.shape)
        )
        by_hand[group.markers] += way[:, :, None] * group.regressors[group.names.index(name)]
    for group in tissue.groups:
        by_hand[group.markers] += group.displacement
    np.testing.assert_allclose(shift, by_hand, atol=1e-15)
    body = problem.build_body(perturbed_parameters(np.random.default_rng(4)))
    segments = Kinematics(body, problem.basis.evaluate(coefficients)).segments
    moved = problem.displace(z).compute_positions(coefficients, body) - problem.compute_positions(
        coefficients, body
    )
    in_laboratory = np.einsum("mjif,mjf->mif", segments[problem.data.segment, :3], shift)
    np.testing.assert_allclose(moved, in_laboratory, atol=1e-12)


def test_what_is_expected_turns_a_cluster_and_deforms_it_in_its_own_axes() -> None:
    """A turn by half a radian changes no distance between markers; what they do by
    themselves does.
    """
    problem, _, _ = trial_with_tissue(4)
    assert problem.tissue is not None
    group = problem.tissue.groups[0]
    place = problem.data.local[group.markers]
    rigid = np.array([0.01, -0.02, 0.005, 0.3, -0.2, 0.4])
    deformation = np.random.default_rng(2).normal(0.0, 0.003, (2, *place.shape))
    turning = replace(group, expected=np.array([group.pattern @ rigid, 0.0 * place]), softness=1.0)
    stiff = place[:, :, None] + replace(turning, deformation=0.0 * deformation).displacement
    soft = place[:, :, None] + replace(turning, deformation=deformation).displacement
    still = place[:, :, None] + np.einsum("rmi,rf->mif", deformation, group.regressors)
    for moved, wanted in ((stiff, np.broadcast_to(place[:, :, None], stiff.shape)), (soft, still)):
        np.testing.assert_allclose(distances(moved), distances(wanted), atol=1e-12)
    small = replace(turning, regressors=1e-5 * group.regressors)
    along = np.einsum("rmi,rf->mif", turning.expected, small.regressors)
    np.testing.assert_allclose(small.displacement, along, atol=1e-10)


def distances(places: Array) -> Array:
    """(nm, nm, nf) m between markers (nm, 3, nf)."""
    return np.asarray(np.linalg.norm(places[:, None] - places, axis=2))


def test_a_part_of_a_trial_has_its_markers_alone() -> None:
    _, _, problem, _ = seeded_trial(5)
    part = problem.extract_part("thigh_r", ("thigh_r", "shank_r"))
    assert part.chain.segments == ("thigh_r", "shank_r")
    segments = [problem.chain.segments[s] for s in problem.data.segment]
    own = [m for m, s in enumerate(segments) if s in part.chain.segments]
    assert part.labels == tuple(problem.labels[m] for m in own)
    assert [part.chain.segments[s] for s in part.data.segment] == [segments[m] for m in own]
    np.testing.assert_array_equal(part.data.measured, problem.data.measured[own])
    np.testing.assert_array_equal(part.data.local, problem.data.local[own])


LEG_FREE = ("hip_r.thigh.sup", "knee_r.thigh.trans", "knee_r.shank.ant", "talocrural_r.shank.front")
LEG = ("pelvis", "thigh_r", "shank_r", "talus_r", "foot_r")


def leg_trial(seed: int, frames: int, nodes: int) -> tuple[MotionProblem, Array, Array]:
    """A leg whose knee does more than flex, its nodes, and the angle of the knee."""
    _, _, problem, true = seeded_trial(seed, segments=LEG, frames=frames, nodes=nodes)
    angle = problem.basis.evaluate(true)[:, problem.chain.coordinates.index("knee_angle_r")]
    (columns,) = build_secondary_columns("gait", [{"knee_angle_r": angle}])
    return replace(problem, tissue=SoftTissue((), columns)), true, angle


def drawn(rng: np.random.Generator, prior: TissuePrior) -> Array:
    return rng.normal(size=len(prior.keys)) * np.sqrt(np.diag(prior.covariance))


def test_gradient_and_matrix_with_soft_tissue_beside_are_those_of_the_markers() -> None:
    rng = np.random.default_rng(1)
    problem, coefficients, _ = leg_trial(1, 20, 7)
    shank = next(
        (s, m) for s, m in problem.data.placed.groups if problem.chain.segments[s] == "shank_r"
    )
    group = SegmentTissue(
        segment=shank[0],
        carrier="shank_r",
        markers=shank[1],
        pattern=build_rigid_pattern(problem.data.local[shank[1]]),
        names=("gait/knee_angle_r",),
        regressors=rng.normal(size=(1, 20)),
        expected=rng.normal(0, 0.01, (1, shank[1].stop - shank[1].start, 3)),
        covariance=np.zeros((1, 6, 6)),
        by_marker=np.zeros((1, 0, 0)),
    )
    problem = replace(problem, tissue=SoftTissue((group,), problem.secondary))
    problem = noisy(
        problem.with_weight(rng.uniform(0, 1, problem.data.weight.shape)), rng, 0.01
    ).with_free(LEG_FREE)
    assert len(problem.unknowns) == len(set(problem.unknowns)) == len(LEG_FREE) + 8 + 6
    parameters = perturbed_parameters(np.random.default_rng(1))
    z = 0.1 * rng.normal(
        size=14
    )  # far more than any knee does, so that what is of second order counts

    def residual(x: Array) -> Array:
        n, values, z = np.split(x, [coefficients.size, coefficients.size + len(LEG_FREE)])
        at = problem.displace(z)
        gap = at.compute_positions(
            n.reshape(coefficients.shape), at.build_body(parameters.with_joint(LEG_FREE, values))
        )
        return (np.sqrt(at.data.weight)[:, None] * (gap - at.data.measured)).ravel()

    x = np.concatenate([coefficients.ravel(), parameters.joint[[JP_INDEX[n] for n in LEG_FREE]], z])
    at = problem.displace(z)
    equations = at.assemble_equations(coefficients, at.build_body(parameters))
    slope, r = central_differences(residual, x), residual(x)
    dense, gradient = slope.T @ slope, slope.T @ r
    found = np.concatenate([equations.node_gradient.ravel(), equations.parameter_gradient])
    np.testing.assert_allclose(found, gradient, atol=SECOND_ORDER * np.abs(gradient).max())
    corner = np.vstack([equations.mixed, equations.parameters])
    np.testing.assert_allclose(
        corner, dense[:, coefficients.size :], atol=SECOND_ORDER * np.abs(dense).max()
    )
    band = BandFactor(equations.band).solve(dense[: coefficients.size, : coefficients.size])
    np.testing.assert_allclose(band, np.eye(coefficients.size), atol=1e-4)
    _, by_nodes, by_unknowns = at.compute_gradients(coefficients, at.build_body(parameters))
    np.testing.assert_allclose(
        np.append(by_nodes, by_unknowns), found, rtol=0, atol=1e-12 * np.abs(found).max()
    )

    def gradient_at(x: Array) -> Array:
        n, values, z = np.split(x, [coefficients.size, coefficients.size + len(LEG_FREE)])
        here, moved = problem.displace(z), parameters.with_joint(LEG_FREE, values)
        _, by_nodes, by_unknowns = here.compute_gradients(
            n.reshape(coefficients.shape), here.build_body(moved)
        )
        return np.append(by_nodes, by_unknowns)

    # Newton's matrix of all unknowns: the derivative of the gradient
    curved = at.assemble_equations(coefficients, at.build_body(parameters), curved=True)
    whole = np.vstack([curved.mixed, curved.parameters])
    second = central_differences(gradient_at, x)[:, coefficients.size :]
    np.testing.assert_allclose(whole, second, atol=SECOND_ORDER * np.abs(second).max())
    left_out = np.abs(whole - corner).max(axis=0) / np.abs(whole).max(axis=0)
    assert np.median(left_out) > 100 * SECOND_ORDER, "Gauss-Newton's differs by far more"


def test_bends_are_what_no_hinge_makes_of_the_angle() -> None:
    rng = np.random.default_rng(2)
    angles = [{"knee_angle_r": rng.uniform(0.0, 1.2, n)} for n in (60, 90)] + [
        {"hip_flexion_r": np.ones(5)}
    ]
    columns = build_secondary_columns("gait", angles)
    assert columns[0].keys == columns[1].keys and not columns[2].keys
    assert len(columns[0].keys) == 2 * len(SECONDARY["knee_angle_r"])
    phi = np.concatenate([a["knee_angle_r"] for a in angles[:2]])
    square, cube = (
        np.concatenate([c.regressors["knee_angle_r"][k] for c in columns[:2]]) for k in range(2)
    )
    powers = np.vander(phi, 4, increasing=True)
    for bend, lower in ((square, powers[:, :2]), (cube, powers[:, :3])):
        assert (
            np.abs(lower.T @ bend).max() < 1e-9 * len(phi) and abs(np.mean(bend**2) - 1.0) < 1e-12
        )
    both = np.column_stack([square, cube])
    np.testing.assert_allclose(
        both, powers @ np.linalg.lstsq(powers, both, rcond=None)[0], atol=1e-9
    )
    assert np.mean(square * phi**2) > 0 < np.mean(cube * phi**3)
    still = build_secondary_columns(
        "gait", [{"knee_angle_r": 0.1 * MIN_ANGLE_SPREAD_RAD * rng.normal(size=200)}]
    )
    assert np.abs(still[0].regressors["knee_angle_r"]).max() < 0.1


def test_of_few_frames_there_are_no_bends() -> None:
    """A video that was stopped at once; a long trial of the same kind gives it its own again."""
    for frames in range(1, 4):
        angle = {"knee_angle_r": np.linspace(0.0, 1.0, frames)}
        (few,) = build_secondary_columns("gait", [angle])
        assert np.array_equal(few.regressors["knee_angle_r"], np.zeros((2, frames)))
        assert len(few.names) == len(few.keys) > 0
        beside, _ = build_secondary_columns(
            "gait", [angle, {"knee_angle_r": np.linspace(-0.3, 1.2, 50)}]
        )
        assert np.abs(beside.regressors["knee_angle_r"]).max() > 0.1


def test_joints_are_found_where_the_knee_is_no_hinge() -> None:
    """Without these motions the ankle takes the misfit of the knee."""
    rng = np.random.default_rng(3)
    problem, true, _ = leg_trial(3, 240, 14)
    truth = perturbed_parameters(np.random.default_rng(3))
    prior = make_secondary_prior([problem])
    sizes = dict(zip(prior.keys, np.sqrt(np.diag(prior.covariance)), strict=True))
    wanted = {
        f"gait/knee_angle_r/{bend}/knee_r.secondary.{name}": share * size
        for bend, share in (("^2", 1.0), ("^3", CUBE_SHARE))
        for name, size in SECONDARY_SIZES.items()
    }
    assert sizes == pytest.approx(wanted)
    z = drawn(rng, prior)
    at = problem.displace(z)
    seen = problem.with_measured(at.compute_positions(true, at.build_body(truth)))
    free = tuple(
        n for n in JP_NAMES if n.split(".")[0] in ("hip_r", "knee_r", "talocrural_r", "subtalar_r")
    )
    mean, covariance = select_prior(free, None)
    index = [JP_INDEX[n] for n in free]
    start = truth.with_joint(free, truth.joint[index] - rng.multivariate_normal(mean, covariance))
    error, score = {}, {}
    for name, task, tissue in (("hinge", replace(seen, tissue=None), None), ("knee", seen, prior)):
        estimate, errors = estimate_joints(
            {"gait": (task,)}, start, free, **({"tissue": tissue} if tissue else {})
        )
        gap = estimate.parameters.joint[index] - truth.joint[index]
        error[name] = float(np.abs(gap).max())
        score[name] = float(np.abs(gap / [errors.standard_errors[n] for n in free]).max())
        if tissue:
            np.testing.assert_allclose(
                estimate.tissue, z, atol=0.1 * np.sqrt(np.diag(prior.covariance)).max()
            )
    assert error["knee"] < 0.2 * error["hinge"] and score["knee"] < 4.0


def test_a_hip_that_stays_and_a_knee_taken_for_a_hinge_move_the_fit_as_its_errors_say() -> None:
    """By fits again: with the hip elsewhere, secondary motions fitted; and with markers where these
    have them, not.
    """
    rng = np.random.default_rng(3)
    problem, true, _ = leg_trial(3, 120, 10)
    truth, prior = perturbed_parameters(np.random.default_rng(3)), make_secondary_prior([problem])
    noise, sizes = (
        rng.normal(0, 0.002, problem.data.measured.shape),
        np.sqrt(np.diag(prior.covariance)),
    )

    def seen(z: Array) -> Tasks:
        at = problem.displace(z)
        return {
            "gait": (
                problem.with_measured(at.compute_positions(true, at.build_body(truth)) + noise),
            )
        }

    free = tuple(n for n in JP_NAMES if n.split(".")[0] in ("knee_r", "talocrural_r"))
    kept, step, z = "hip_r.thigh.sup", 1e-4, 0.05 * drawn(rng, prior)
    known = ErrorSources((kept,), np.array([[step]]), (f"nominal/{kept}",))
    elsewhere = truth.with_joint((kept,), truth.joint[[JP_INDEX[kept]]] + step)
    for fits, other_tasks, other in ((True, seen(0 * z), elsewhere), (False, seen(z), truth)):
        settings = replace(BY_EVIDENCE, fits_tissue=fits)
        fit = partial(estimate_joints, free=free, settings=settings, tissue=prior, known=known)
        here, errors = fit(seen(0 * z), truth)
        there, _ = fit(other_tasks, other)
        rows = errors.effects[: len(here.values)]
        predicted = (
            rows[:, errors.sources.index(f"nominal/{kept}")]
            if fits
            else -here.tissue_errors @ (z / sizes)
        )
        unit = np.array([errors.standard_errors[name] for name in (*free, *here.keys)])
        moved = there.values - here.values
        assert np.abs(moved / unit).max() > 0.01
        np.testing.assert_allclose(
            moved / unit, predicted / unit, atol=0.1 * np.abs(moved / unit).max()
        )
