"""Soft tissue as columns of a trial: gradient and matrix against differences, displacement against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.motion.banded import BandFactor
from gaitcal.motion.soft_tissue import SegmentTissue, SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import Array, assert_derivative, central_differences, perturbed_parameters, random_trial

FREE = ("hip_r.pelvis.ant", "hip_r.thigh.sup", "knee_r.thigh.front")
SEGMENTS = ("pelvis", "thigh_r", "shank_r")
SECOND_ORDER = 1e-6
"""Relative: what central differences leave."""


def trial_with_tissue(seed: int) -> tuple[TrialProblem, Array, Array]:
    """A trial off its minimum with two regressors on thigh and shank, its nodes, and z."""
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, free=FREE, segments=SEGMENTS, frames=20, nodes=7)
    groups = tuple(
        SegmentTissue(s, markers, ("hip_flexion_r", "knee_angle_r"), rng.normal(size=(2, 20)))
        for s, markers in problem.data.placed.groups
        if s > 0
    )
    problem = replace(problem, tissue=SoftTissue(groups, problem.labels))
    weight = rng.uniform(0.0, 1.0, problem.data.weight.shape)
    problem = problem.with_weight(weight).with_measured(
        problem.data.measured + rng.normal(0, 0.01, (len(weight), 3, 20))
    )
    assert problem.tissue is not None
    return problem, nodes, rng.normal(0, 0.01, len(problem.tissue.keys))


def test_gradient_and_matrix_are_those_of_the_displaced_markers() -> None:
    problem, nodes, z = trial_with_tissue(3)
    parameters = perturbed_parameters(np.random.default_rng(3))
    p = problem.values(parameters)

    def residual(x: Array) -> Array:
        n, values, tissue = np.split(x, [nodes.size, nodes.size + len(FREE)])
        moved = parameters.with_joint(FREE, values)
        at = problem.displaced(tissue)
        gap = at.positions(n.reshape(nodes.shape), at.constants(moved)) - at.data.measured
        return (np.sqrt(at.data.weight)[:, None] * gap).ravel()

    x = np.concatenate([nodes.ravel(), p, z])
    at = problem.displaced(z)
    equations = at.equations(nodes, at.constants(parameters))
    slope, r = central_differences(residual, x), residual(x)
    np.testing.assert_allclose(equations.cost, r @ r, rtol=1e-12)
    gradient = np.concatenate([equations.node_gradient.ravel(), equations.parameter_gradient])
    np.testing.assert_allclose(gradient, slope.T @ r, atol=SECOND_ORDER * np.abs(gradient).max())
    dense = slope.T @ slope
    corner = np.vstack([equations.mixed, equations.parameters])
    np.testing.assert_allclose(corner, dense[:, nodes.size :], atol=SECOND_ORDER * np.abs(dense).max())
    band = BandFactor(equations.band).solve(dense[: nodes.size, : nodes.size])
    np.testing.assert_allclose(band, np.eye(nodes.size), atol=1e-4)
    assert_derivative(2.0 * gradient[None], lambda y: np.array([residual(y) @ residual(y)]), x, relative=SECOND_ORDER)


def test_a_marker_goes_along_the_axes_of_its_segment() -> None:
    problem, nodes, z = trial_with_tissue(4)
    tissue = problem.tissue
    assert tissue is not None
    shift, by_hand = tissue.shift(z), np.zeros((len(problem.labels), 3, 20))
    for key, value in zip(tissue.keys, z, strict=True):
        name, label, axis = key.split("/")
        m = problem.labels.index(label)
        group = next(g for g in tissue.groups if g.markers.start <= m < g.markers.stop)
        by_hand[m, "xyz".index(axis)] += value * group.regressors[group.names.index(name)]
    np.testing.assert_allclose(shift, by_hand, atol=1e-15)
    constants = problem.constants(perturbed_parameters(np.random.default_rng(4)))
    moved = problem.displaced(z).positions(nodes, constants) - problem.positions(nodes, constants)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.linalg.norm(shift, axis=1), atol=1e-12)


def test_a_part_of_a_trial_has_its_markers_alone() -> None:
    rng = np.random.default_rng(5)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters)
    part = problem.part("thigh_r", ("thigh_r", "shank_r"))
    assert part.chain.segments == ("thigh_r", "shank_r")
    assert part.labels == tuple(
        label
        for label, s in zip(problem.labels, problem.data.segment, strict=True)
        if problem.chain.segments[s] in ("thigh_r", "shank_r")
    )
    for k, label in enumerate(part.labels):
        m = problem.labels.index(label)
        np.testing.assert_array_equal(part.data.measured[k], problem.data.measured[m])
        np.testing.assert_array_equal(part.data.local[k], problem.data.local[m])
        assert part.chain.segments[part.data.segment[k]] == problem.chain.segments[problem.data.segment[m]]
