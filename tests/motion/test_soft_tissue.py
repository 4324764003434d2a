"""Soft tissue as columns of a trial: gradient and matrix against differences, displacement against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.model.chain import forward, segment_transforms
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.soft_tissue import COMPONENTS, SegmentTissue, SoftTissue, together
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
        SegmentTissue(
            segment=s,
            carrier=problem.chain.segments[s],
            markers=markers,
            pattern=together(problem.data.local[markers] - problem.data.local[markers].mean(axis=0)),
            names=("gait/hip_flexion_r", "gait/knee_angle_r"),
            regressors=rng.normal(size=(2, 20)),
        )
        for s, markers in problem.data.placed.groups
        if s > 0
    )
    problem = replace(problem, tissue=SoftTissue(groups))
    weight = rng.uniform(0.0, 1.0, problem.data.weight.shape)
    problem = problem.with_weight(weight).with_measured(
        problem.data.measured + rng.normal(0, 0.01, (len(weight), 3, 20))
    )
    z = rng.normal(size=(4, 6)) * np.repeat([0.01, 0.1], 3)  # m, rad: markers lie some 0.1 m from their middle
    return problem, nodes, z.ravel()


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
    cost, by_nodes, by_unknowns = at.both_gradients(nodes, at.constants(parameters))
    np.testing.assert_allclose(cost, equations.cost, rtol=1e-12)
    np.testing.assert_allclose(np.append(by_nodes, by_unknowns), gradient, rtol=0, atol=1e-12 * np.abs(gradient).max())
    assert_derivative(2.0 * gradient[None], lambda y: np.array([residual(y) @ residual(y)]), x, relative=SECOND_ORDER)


def test_markers_shift_and_turn_together_along_the_axes_of_their_segment() -> None:
    problem, nodes, z = trial_with_tissue(4)
    tissue = problem.tissue
    assert tissue is not None and len(tissue.keys) == len(set(tissue.keys)) == len(z)
    shift, by_hand = tissue.shift(z, len(problem.labels)), np.zeros((len(problem.labels), 3, 20))
    for key, value in zip(tissue.keys, z, strict=True):
        name, carrier, component = key.rpartition("/")[0].rpartition("/")[0], key.split("/")[-2], key.split("/")[-1]
        (group,) = [g for g in tissue.groups if g.carrier == carrier]
        axis = value * np.eye(3)[COMPONENTS.index(component) % 3]
        arms = problem.data.local[group.markers] - problem.data.local[group.markers].mean(axis=0)
        way = np.cross(axis, arms) if component.startswith("r") else np.broadcast_to(axis, arms.shape)
        by_hand[group.markers] += way[:, :, None] * group.regressors[group.names.index(name)]
    np.testing.assert_allclose(shift, by_hand, atol=1e-15)
    constants = problem.constants(perturbed_parameters(np.random.default_rng(4)))
    segments = segment_transforms(
        problem.chain, constants, forward(problem.chain, constants, problem.basis.evaluate(nodes))
    )
    moved = problem.displaced(z).positions(nodes, constants) - problem.positions(nodes, constants)
    in_laboratory = np.einsum("mjif,mjf->mif", segments[problem.data.segment, :3], shift)
    np.testing.assert_allclose(moved, in_laboratory, atol=1e-12)


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
