"""Phases 2 and 3 on synthetic data: inertial parameters from the pelvis residual, then everything together.

Phase 2 has the motion and joint parameters of phase 1 and the true ground reactions. Seeds are the true values, or each
parameter times 1 + U(-0.5, 0.5), left as right; `foot.com.sup`, which the paper prints though it is none of the 36, is
drawn too where the data have noise, and held. Data with noise get the published procedure to the letter. Without
noise the penalty's weight falls at every re-seed (see `inertial_calibration`): the published procedure would creep.

Errors are summed up as in the published Table III: sqrt(mean e^2) over the two-sided model, 36 moments, 12 masses, 36
mass-centre coordinates; residuals over frames and the three components. That gives Table III from Table IV.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.calibration import inertial_calibration
from gaitcal.calibration.combined import CombinedProblem, combined_fit
from gaitcal.model.parameters import IP_INDEX, IP_TO_SI, MASSIVE_SEGMENTS, Parameters, is_physical, symmetric_set, table
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import motion_of
from gaitcal.motion.trial_problem import MotionProblem
from gaitcal.published import joint_recovery
from gaitcal.published.protocol import PROBLEMS
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.motion import residual_free_wrench

SEED_RANGE = 0.5
RANDOM_SEEDS = 10
NOISELESS_DECAY = 0.1


@dataclass(frozen=True)
class InertialErrors:
    """RMS errors over the two-sided model."""

    inertia: float
    """kg mm^2, 36 principal moments."""
    mass: float
    """kg, 12 masses."""
    centre: float
    """mm, 36 coordinates of mass centres."""


def inertial_rms(estimate: Array, truth: Array) -> InertialErrors:
    """Errors of inertial parameters (84,), SI."""
    errors = table((estimate - truth) / IP_TO_SI)
    return InertialErrors(*(float(np.sqrt(np.mean(errors[:, k] ** 2))) for k in (slice(4, 7), 0, slice(1, 4))))


def symmetric_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Errors of the 36 symmetric parameters (mean of both sides), and of `foot.com.sup`; kg, mm, kg mm^2."""
    which = symmetric_set()
    errors = (estimate - truth) / IP_TO_SI
    values = which.selection.T @ errors / (which.selection**2).sum(axis=0)
    out = dict(zip(which.names, values.tolist(), strict=True))
    feet = [k for k, segment in enumerate(MASSIVE_SEGMENTS) if segment.startswith("foot")]
    out["foot.com.sup"] = float(table(errors)[feet, 2].mean())
    return out


@dataclass(frozen=True, kw_only=True)
class InertialRecovery:
    """A solution of phase 2."""

    force: float
    """N, RMS pelvis residual over frames and components."""
    torque: float
    """N·m."""
    errors: InertialErrors
    each: dict[str, float]
    """Error of each of the 36 parameters and of `foot.com.sup`; kg, mm, kg mm^2."""
    total_mass: float
    """kg, error of the whole body's mass."""
    seeds: int
    seconds: float
    """Of the processor, as the published times."""
    converged: bool
    """Whether the residuals settled."""
    physical: bool
    """Whether every body could exist; the published cost does not ask for it."""


@dataclass(frozen=True, kw_only=True)
class ThirdStep:
    """What joint and inertial parameters and motion together do to residuals and markers, from phases 1 and 2."""

    force: tuple[float, float]
    """N before and after."""
    torque: tuple[float, float]
    """N·m before and after."""
    marker_mm: tuple[float, float]
    """RMS distance before and after."""
    position_mm: tuple[float, float]
    """RMS error of the positions among the free joint parameters, before and after."""
    seconds: float
    converged: bool


@cache
def true_wrench() -> Array:
    """(208, 2, 6) ground reactions on the feet that leave the true model no residual."""
    return residual_free_wrench(joint_recovery.true_model().parameters, joint_recovery.true_motion("full leg"))


def gait_equations(
    parameters: Parameters,
    coefficients: Array,
    scale: inertial_calibration.TorqueScale = inertial_calibration.TorqueScale.BODY_HEIGHT,
) -> inertial_calibration.RootEquations:
    """The pelvis residual of the gait trial for joint parameters and nodes (20, 27)."""
    basis = joint_recovery.true_motion("full leg").basis
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    valid = np.ones(len(q), dtype=bool)
    motion = inertial_calibration.LoadedMotion(state=(q, v, a), wrench=true_wrench(), valid=valid)
    return inertial_calibration.equations_of(
        [motion], parameters, joint_recovery.true_model().subject, scale, pelvis_width(joint_recovery.true_model())
    )


def pelvis_width(model: SubjectModel) -> float:
    """Distance of the hip centres, m."""
    return float(np.linalg.norm(model.landmarks["hjc_r"][1] - model.landmarks["hjc_l"][1]))


def random_seed(rng: np.random.Generator, *, with_held: bool) -> Array:
    """(84,) the true inertial parameters, each of the 36 (with `with_held` also `foot.com.sup`) up to 50 % off."""
    truth, which = joint_recovery.true_model().parameters.inertial, symmetric_set()
    factors = rng.uniform(-SEED_RANGE, SEED_RANGE, len(which.names) + 1)
    seed = truth * (1.0 + which.selection @ factors[:-1])
    if with_held:
        for foot in ("foot_r", "foot_l"):
            seed[IP_INDEX[f"{foot}.com.sup"]] *= 1.0 + factors[-1]
    return seed


def recover_inertia(
    equations: inertial_calibration.RootEquations, seed: Array, *, reseed: bool = True, decay: float = 1.0
) -> InertialRecovery:
    """The published cost from a seed (84,)."""
    began, truth = time.process_time(), joint_recovery.true_model().parameters.inertial
    fit = inertial_calibration.fit_published(equations, seed, symmetric_set(), reseed=reseed, decay=decay)
    return InertialRecovery(
        force=fit.rms_force,
        torque=fit.rms_moment,
        errors=inertial_rms(fit.inertial, truth),
        each=symmetric_errors(fit.inertial, truth),
        total_mass=float(table(fit.inertial - truth)[:, 0].sum()),
        seeds=fit.seeds,
        seconds=time.process_time() - began,
        converged=fit.converged,
        physical=bool(is_physical(fit.inertial).all()),
    )


def third_step(markers: MotionProblem, gait: joint_recovery.JointRecovery) -> ThirdStep:
    """The third step of `gaitcal calibrate`, after phase 1 and physically consistent inertial parameters.

    Before: phases 1 and 2, as the third step finds them. Bodies must be possible, hence `fit_consistent`.
    """
    free, began = joint_recovery.free_parameters("full leg"), time.process_time()
    equations = gait_equations(gait.parameters, gait.coefficients)
    inertial = inertial_calibration.fit_consistent(
        equations, joint_recovery.true_model().parameters.inertial, symmetric_set()
    )
    trial = CombinedProblem(markers, gait.coefficients, true_wrench(), np.ones(len(true_wrench()), dtype=bool))
    start = gait.parameters.with_inertial(inertial.inertial)
    fit = combined_fit([trial], start, free, symmetric_set(), joint_recovery.true_model().subject)
    force, torque = gait_equations(fit.parameters, fit.coefficients[0]).rms(fit.parameters.inertial)
    distance = motion_of(markers, fit.parameters, fit.coefficients[0]).errors.distance
    positions = [
        joint_recovery.joint_rms(joint_recovery.joint_errors(p, joint_recovery.true_model().parameters, free), free)[0]
        or 0.0
        for p in (start, fit.parameters)
    ]
    return ThirdStep(
        force=(inertial.rms_force, force),
        torque=(inertial.rms_moment, torque),
        marker_mm=(gait.marker_mm, 1e3 * float(np.sqrt(np.mean(distance**2)))),
        position_mm=(positions[0], positions[1]),
        seconds=time.process_time() - began,
        converged=fit.converged,
    )


@dataclass(frozen=True, kw_only=True)
class SeedResult:
    """Phases 1 to 3 for one draw of the noise."""

    joints: dict[str, joint_recovery.JointRecovery]
    """By problem."""
    residual_before: tuple[float, float]
    """N, N·m: true inertial parameters with the joints and motion of phase 1."""
    correct: InertialRecovery
    """Phase 2 from the correct seed."""
    single_pass: InertialRecovery
    """The same without re-seeding."""
    random: tuple[InertialRecovery, ...]
    """Phase 2 from random seeds."""
    scales: dict[inertial_calibration.TorqueScale, InertialRecovery]
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
    results: list[SeedResult] = Parallel(n_jobs=jobs)(
        delayed(noisy_draw)(seed, draw, random_seeds) for draw in range(draws)
    )
    return results


def _run(noise: Sequence[np.random.Generator] | None, seeds: np.random.SeedSequence, random_seeds: int) -> SeedResult:
    """Phases 1 to 3; `noise`: a generator for each of `PROBLEMS`, or none."""
    problems = {
        p: joint_recovery.synthetic_problem(p, noise[k] if noise is not None else None) for k, p in enumerate(PROBLEMS)
    }
    joints = joint_recovery.recover_joints(problems)
    gait, truth = joints["full leg"], joint_recovery.true_model().parameters.inertial
    equations = {
        scale: gait_equations(gait.parameters, gait.coefficients, scale) for scale in inertial_calibration.TorqueScale
    }
    by_height = equations[inertial_calibration.TorqueScale.BODY_HEIGHT]
    decay = 1.0 if noise is not None else NOISELESS_DECAY
    streams = map(np.random.default_rng, seeds.spawn(random_seeds))
    starts = [random_seed(rng, with_held=noise is not None) for rng in streams]
    scales = {scale: recover_inertia(scaled, truth) for scale, scaled in equations.items()}
    return SeedResult(
        joints=joints,
        residual_before=by_height.rms(truth),
        correct=scales[inertial_calibration.TorqueScale.BODY_HEIGHT],
        single_pass=recover_inertia(by_height, truth, reseed=False),
        random=tuple(recover_inertia(by_height, start, decay=decay) for start in starts),
        scales=scales,
        third=third_step(problems["full leg"], gait) if noise is not None else None,
    )
