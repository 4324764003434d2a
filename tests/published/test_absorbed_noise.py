"""What a motion absorbs of the noise: against a dense projection, and against what fits really leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import gait_parameters
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.published.claims import Verdict
from gaitcal.published.joint_recovery import solve_from_zero, synthetic_problem, true_model, true_motion
from gaitcal.published.noise_sensitivity import Absorbed, absorbed, absorbed_claims, absorbed_squares, any_motion_share
from gaitcal.published.protocol import PROBLEMS, table_one
from gaitcal.synthetic.motion import marker_noise
from tests.derivatives import Array

LEG = ("pelvis", "thigh_l", "shank_l", "talus_l", "foot_l")
STEP = 1e-6


def dense_squares(problem: TrialProblem, nodes: Array, free: tuple[str, ...], noise: Array) -> float:
    """|P n|^2 by a least-squares solution with every column of J written out, by central differences."""
    truth = true_model().parameters

    def column(by_node: Array, by_value: Array) -> Array:
        values = problem.with_free(free).values(truth)
        ends = [
            problem.positions(nodes + s * by_node, problem.constants(truth.with_joint(free, values + s * by_value)))
            for s in (STEP, -STEP)
        ]
        return (ends[0] - ends[1]).ravel() / (2 * STEP)

    units = np.eye(nodes.size + len(free))
    columns = [column(u[: nodes.size].reshape(nodes.shape), u[nodes.size :]) for u in units]
    matrix, _ = np.linalg.qr(np.column_stack(columns))
    return float(np.square(matrix.T @ noise.ravel()).sum())


@pytest.mark.parametrize("free", [(), gait_parameters("l")])
def test_a_dense_projection_gives_the_same(free: tuple[str, ...]) -> None:
    problem = synthetic_problem("full leg", None).part("pelvis", LEG)
    whole, motion = synthetic_problem("full leg", None).chain.coordinates, true_motion("full leg")
    nodes = motion.nodes[:, [whole.index(name) for name in problem.chain.coordinates]]
    noise = marker_noise(problem.basis.time, len(problem.labels), np.random.default_rng(0)).transpose(1, 2, 0)
    (ours,) = absorbed_squares(problem.with_free(free), true_model().parameters, nodes, [noise])
    assert ours == pytest.approx(dense_squares(problem, nodes, free, noise), rel=1e-6)
    assert (
        any_motion_share(problem, true_model().parameters, nodes) == len(problem.chain.coordinates) / noise[..., 0].size
    )


def test_coordinates_absorb_at_most_their_part_of_the_marker_coordinates() -> None:
    found = absorbed("full leg", 0, draws=40)
    assert found.any_motion == pytest.approx(len(COORDINATES) / 123)
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
    found = solve_from_zero("hip", noisy, truth)
    opened = exact.with_free(found.names)
    (absorbed_part,) = absorbed_squares(opened, truth, true_motion("hip").nodes, [noise])
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
