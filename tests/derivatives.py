"""The one finite-difference checker that every analytic derivative meets, and the random linkages
they are tried on.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, LinkageModel
from gaitcal.model.coordinates import split_side
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_NAMES,
    ParameterKind,
    Parameters,
    read_published_parameters,
)
from gaitcal.tracking.marker_residual import MarkerData, PlacedMarkers, compute_marker_positions
from gaitcal.tracking.spline import build_spline_basis
from gaitcal.tracking.start import find_start_coefficients
from gaitcal.tracking.trial_problem import MotionProblem

Array = NDArray[np.float64]
PUBLISHED_JOINTS = ("hip", "knee", "talocrural", "subtalar", "back", "shoulder", "elbow")
"""Of the linkage of Reinbolt et al. 2007, without sides."""


def central_differences(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """(outputs, inputs) derivative of `function` at x."""
    columns = []
    for k in range(len(x)):
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] -= step
        columns.append((np.ravel(function(up)) - np.ravel(function(down))) / (2 * step))
    return np.stack(columns, axis=1)


def assert_derivative(
    analytic: Array,
    function: Callable[[Array], Array],
    x: Array,
    *,
    relative: float = 1e-6,
    step: float = 1e-6,
) -> None:
    """Fail unless `analytic` is the derivative of `function` at x, relative to its
    largest entry.
    """
    numeric = central_differences(function, x, step)
    assert analytic.shape == numeric.shape
    np.testing.assert_allclose(
        analytic, numeric, rtol=0, atol=relative * max(1.0, float(np.abs(numeric).max()))
    )


def perturbed_parameters(
    rng: np.random.Generator, position: float = 0.01, angle: float = 0.17
) -> Parameters:
    """The published subject with all joint parameters moved at random (m, rad).

    Parameters of joints that somebody added draw from a generator of their own: a seed means the
    same person still.
    """
    base = read_published_parameters()
    reach = np.array(
        [position if p.kind is ParameterKind.POSITION else angle for p in JOINT_PARAMETERS]
    )
    published = np.array([split_side(p.joint)[0] in PUBLISHED_JOINTS for p in JOINT_PARAMETERS])
    moved = np.random.default_rng(0).uniform(-1, 1, len(reach))
    moved[published] = rng.uniform(-1, 1, published.sum())
    return base.with_joint(JP_NAMES, base.joint + moved * reach)


def random_trial(
    rng: np.random.Generator,
    parameters: Parameters,
    *,
    free: tuple[str, ...] = (),
    frames: int = 60,
    nodes: int = 8,
    per_segment: int = 4,
    root: str = "pelvis",
    segments: tuple[str, ...] | None = None,
) -> tuple[MotionProblem, Array]:
    """A trial whose markers are exactly those of a random smooth motion, and the nodes of that
    motion.
    """
    chain = Chain(root, free=free) if segments is None else Chain(root, segments, free)
    massive = [i for i, s in enumerate(chain.segments) if not s.startswith("talus")]
    segment = np.repeat(np.array(massive, dtype=np.intp), per_segment)
    local = rng.normal(0, 0.1, (len(segment), 3))
    basis = build_spline_basis(np.arange(frames) / 100.0, nodes)
    true = np.cumsum(rng.normal(0, 0.08, (nodes, len(chain.coordinates))), axis=0)
    placed = PlacedMarkers(segment, local)
    x = compute_marker_positions(chain.body(parameters), placed, basis.evaluate(true))
    data = MarkerData(placed, x, np.ones((len(segment), frames)))
    labels = tuple(f"m{i}" for i in range(len(segment)))
    return MotionProblem(name="random", chain=chain, basis=basis, data=data, labels=labels), true


def seeded_trial(
    seed: int, **shape: Any
) -> tuple[np.random.Generator, Parameters, MotionProblem, Array]:
    """A generator of that seed, the person and the trial that it draws (`random_trial`), and the
    trial's true nodes.
    """
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng)
    return rng, parameters, *random_trial(rng, parameters, **shape)


def random_state(rng: np.random.Generator, frames: int) -> tuple[Array, Array, Array, Array]:
    """Coordinates (nf, nq), their derivatives, and wrenches of the ground on the feet (nf, 2, 6) N
    and N·m.
    """
    q, v, a = (rng.normal(0, scale, (frames, len(COORDINATES))) for scale in (0.4, 2.0, 9.0))
    return q, v, a, rng.normal(0, 300, (frames, 2, 6))


def noisy(problem: MotionProblem, rng: np.random.Generator, size: float = 0.005) -> MotionProblem:
    """The trial with noise of so many m on each marker coordinate."""
    measured = problem.data.measured
    return problem.with_measured(measured + rng.normal(0, size, measured.shape))


def with_gaps(problem: MotionProblem, rng: np.random.Generator) -> MotionProblem:
    """The trial with weights that change, and a fifth of the positions missing."""
    shape = problem.data.weight.shape
    return problem.with_weight(rng.uniform(0.2, 2.0, shape) * (rng.random(shape) > 0.2))


def without_segments(
    problem: MotionProblem, *segments: str, frames: slice = slice(None)
) -> MotionProblem:
    """The trial with no marker of some segments seen in some frames."""
    weight = problem.data.weight.copy()
    weight[
        np.isin(problem.data.segment, [problem.chain.segments.index(s) for s in segments]), frames
    ] = 0.0
    return problem.with_weight(weight)


def started(problem: MotionProblem, parameters: Parameters) -> tuple[LinkageModel, Array]:
    """Constants of the linkage and the nodes where tracking starts."""
    body = problem.build_body(parameters)
    return body, find_start_coefficients(body, problem.data, problem.basis)


def from_band(band: Array) -> Array:
    """The symmetric matrix of a transposed lower band."""
    out = np.zeros((len(band), len(band)))
    for d in range(band.shape[1]):
        values = band[: len(band) - d, d]
        out += np.diag(values, -d) + (np.diag(values, d) if d else 0.0)
    return out


def assert_covariance(found: Array, expected: Array, atol: float = 1e-4) -> None:
    """Fail unless two covariances agree in units of the expected standard deviations."""
    unit = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / unit, expected / unit, rtol=0, atol=atol)
