"""All problems for one draw of the noise (or none): what is repeated over noise seeds.

Randomness enters by `generators` alone: the noise of each problem and the random inertial seeds have generators of
their own, spawned from the seed and the number of the draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from gaitcal.calibration.inertial_equations import TorqueScale
from gaitcal.published.inertial_recovery import (
    NOISELESS_DECAY,
    RANDOM_SEEDS,
    InertialRecovery,
    ThirdStep,
    gait_equations,
    random_seed,
    recover_inertia,
    third_step,
)
from gaitcal.published.joint_recovery import JointRecovery, recover_joints, synthetic_problem, true_model
from gaitcal.published.published import PROBLEMS
from gaitcal.runtime import with_one_blas_thread


@dataclass(frozen=True, kw_only=True)
class SeedResult:
    """Phases 1 to 3 for one draw of the noise."""

    joints: dict[str, JointRecovery]
    """By problem."""
    residual_before: tuple[float, float]
    """N, N·m: true inertial parameters with the joints and motion of phase 1."""
    correct: InertialRecovery
    """Phase 2 from the correct seed."""
    single_pass: InertialRecovery
    """The same without re-seeding."""
    random: tuple[InertialRecovery, ...]
    """Phase 2 from random seeds."""
    scales: dict[TorqueScale, InertialRecovery]
    """Phase 2 from the correct seed, for each normalisation of torques."""
    third: ThirdStep | None
    """Only with noise."""


@with_one_blas_thread
def noiseless(seed: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Everything without noise; random inertial seeds from `seed`."""
    return _run(None, np.random.SeedSequence([seed, 0]), random_seeds)


@with_one_blas_thread
def noisy_draw(seed: int, draw: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Everything with the noise of one draw (0, 1, ...) under `seed`."""
    noise, seeds = generators(seed, draw)
    return _run(noise, seeds, random_seeds)


def generators(seed: int, draw: int) -> tuple[tuple[np.random.Generator, ...], np.random.SeedSequence]:
    """The noise of each problem, and what random inertial seeds come from, for one draw (0, 1, ...) under `seed`."""
    sequence = np.random.SeedSequence([seed, 1, draw])
    return tuple(np.random.default_rng(s) for s in sequence.spawn(len(PROBLEMS))), sequence.spawn(1)[0]


def noisy_draws(seed: int, draws: int, jobs: int = -1, random_seeds: int = RANDOM_SEEDS) -> list[SeedResult]:
    """Draws 0 to `draws` - 1 under `seed`, in order, whatever the number of processes (-1: one for every core)."""
    if jobs == 1:
        return [noisy_draw(seed, draw, random_seeds) for draw in range(draws)]
    tasks = (delayed(noisy_draw)(seed, draw, random_seeds) for draw in range(draws))
    results: list[SeedResult] = Parallel(n_jobs=jobs)(tasks)
    return results


def _run(noise: Sequence[np.random.Generator] | None, seeds: np.random.SeedSequence, random_seeds: int) -> SeedResult:
    """Phases 1 to 3; `noise`: a generator for each of `PROBLEMS`, or none."""
    problems = {p: synthetic_problem(p, noise[k] if noise is not None else None) for k, p in enumerate(PROBLEMS)}
    joints = recover_joints(problems)
    gait, truth = joints["full leg"], true_model().parameters.inertial
    equations = {scale: gait_equations(gait.parameters, gait.nodes, scale) for scale in TorqueScale}
    usual = equations[TorqueScale.BODY_HEIGHT]
    decay = 1.0 if noise is not None else NOISELESS_DECAY
    streams = map(np.random.default_rng, seeds.spawn(random_seeds))
    starts = [random_seed(rng, with_held=noise is not None) for rng in streams]
    scales = {scale: recover_inertia(scaled, truth) for scale, scaled in equations.items()}
    return SeedResult(
        joints=joints,
        residual_before=usual.rms(truth),
        correct=scales[TorqueScale.BODY_HEIGHT],
        single_pass=recover_inertia(usual, truth, reseed=False),
        random=tuple(recover_inertia(usual, start, decay=decay) for start in starts),
        scales=scales,
        third=third_step(problems["full leg"], gait) if noise is not None else None,
    )
