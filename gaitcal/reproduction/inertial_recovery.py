"""Phases 2 and 3 on synthetic data: inertial parameters from the pelvis residual, then everything together.

Phase 2 has the motion and joint parameters of phase 1 and the true ground reactions. Seeds are the true values, or each
parameter times 1 + U(-0.5, 0.5), left as right; `foot.com.sup`, which the paper prints though it is none of the 36, is
drawn too where the data have noise, and held. Data with noise get the published procedure to the letter. Without
noise the penalty's weight falls at every re-seed (see `inertial_calibration`): the published procedure would creep.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.combined import JointStepTrial, joint_step
from gaitcal.calibration.inertial_calibration import (
    RootEquations,
    TorqueScale,
    fit_consistent,
    fit_published,
)
from gaitcal.calibration.inertial_equations import LoadedMotion, equations_of
from gaitcal.model.inertial_parameters import IP_INDEX, is_physical, symmetric_set, table
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import motion_of
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.reproduction.error_measures import (
    InertialErrors,
    inertial_rms,
    joint_errors,
    joint_rms,
    symmetric_errors,
)
from gaitcal.reproduction.joint_recovery import JointRecovery, free_parameters, subject, true_motion
from gaitcal.synthetic.measurements import residual_free_wrench

Array = NDArray[np.float64]

SEED_RANGE = 0.5
RANDOM_SEEDS = 10
NOISELESS_DECAY = 0.1


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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
    return residual_free_wrench(subject().parameters, true_motion("full leg"))


def gait_equations(parameters: Parameters, nodes: Array, scale: TorqueScale = TorqueScale.BODY_HEIGHT) -> RootEquations:
    """The pelvis residual of the gait trial for joint parameters and nodes (20, 27)."""
    basis = true_motion("full leg").basis
    q, v, a = (basis.evaluate(nodes, k) for k in range(3))
    motion = LoadedMotion("gait", q, v, a, true_wrench(), np.ones(len(q), dtype=bool))
    hips = [subject().landmarks[f"hjc_{side}"][1] for side in ("r", "l")]
    width = float(np.linalg.norm(hips[0] - hips[1]))
    return equations_of([motion], parameters, subject().subject, scale, width)


def random_seed(rng: np.random.Generator, *, with_held: bool) -> Array:
    """(84,) the true inertial parameters, each of the 36 (with `with_held` also `foot.com.sup`) up to 50 % off."""
    truth, which = subject().parameters.inertial, symmetric_set()
    factors = rng.uniform(-SEED_RANGE, SEED_RANGE, len(which.names) + 1)
    seed = truth * (1.0 + which.selection @ factors[:-1])
    if with_held:
        for foot in ("foot_r", "foot_l"):
            seed[IP_INDEX[f"{foot}.com.sup"]] *= 1.0 + factors[-1]
    return seed


def recover_inertia(
    equations: RootEquations, seed: Array, *, reseed: bool = True, decay: float = 1.0
) -> InertialRecovery:
    """The published cost from a seed (84,)."""
    began, truth = time.process_time(), subject().parameters.inertial
    fit = fit_published(equations, seed, symmetric_set(), reseed=reseed, decay=decay)
    return InertialRecovery(
        fit.rms_force,
        fit.rms_moment,
        inertial_rms(fit.inertial, truth),
        symmetric_errors(fit.inertial, truth),
        float(table(fit.inertial - truth)[:, 0].sum()),
        fit.seeds,
        time.process_time() - began,
        fit.converged,
        bool(is_physical(fit.inertial).all()),
    )


def third_step(markers: TrialProblem, gait: JointRecovery) -> ThirdStep:
    """The third step of `gaitcal calibrate`, after phase 1 and physically consistent inertial parameters.

    Before: phases 1 and 2, as the third step finds them. Bodies must be possible, hence `fit_consistent`.
    """
    free, began = free_parameters("full leg"), time.process_time()
    equations = gait_equations(gait.parameters, gait.nodes)
    inertial = fit_consistent(equations, subject().parameters.inertial, symmetric_set())
    trial = JointStepTrial(markers, gait.nodes, true_wrench(), np.ones(len(true_wrench()), dtype=bool))
    start = gait.parameters.with_inertial(inertial.inertial)
    fit = joint_step([trial], start, free, symmetric_set(), subject().subject)
    force, torque = gait_equations(fit.parameters, fit.nodes[0]).rms(fit.parameters.inertial)
    distance = motion_of(markers, fit.parameters, fit.nodes[0]).errors.distance
    return ThirdStep(
        (inertial.rms_force, force),
        (inertial.rms_moment, torque),
        (gait.marker_mm, 1e3 * float(np.sqrt(np.mean(distance**2)))),
        (_position_error(gait.parameters, free), _position_error(fit.parameters, free)),
        time.process_time() - began,
        fit.converged,
    )


def _position_error(found: Parameters, free: tuple[str, ...]) -> float:
    return joint_rms(joint_errors(found, subject().parameters, free), free)[0] or 0.0
