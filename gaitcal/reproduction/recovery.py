"""The published parameters recovered from synthetic data: joints, inertia, then everything
together.

Phase 1: the four published problems, everything starting at absolute zero. Three isolated trials,
each with the whole linkage (27 coordinates of 20 nodes) and the parameters of its joint; then gait
with 17 parameters of the leg, the other 10 where the isolated trials left them. One weight, no
prior, no bounds. Variable projection solves each motion fully for the joint parameters of the
moment; where those are absurd (all zero) that motion folds up and leads into a valley of its own.
From zero, nodes and joint parameters therefore step together (`step_together`): damped, they move
both a little. Variable projection, as in any calibration, finishes.

Errors are summed up as in the published Table I: sqrt(mean e^2) over the joint's parameters,
positions (mm) and orientations (deg) apart. That definition gives the printed figures of Table I
from those of Table II.

Phase 2, inertial parameters from the pelvis residual, has the motion and joint parameters of phase
1 and the true ground reactions. Seeds are the true values, or each parameter times 1 + U(-0.5,
0.5), left as right; `foot.com.sup`, which the paper prints though it is none of the 36, is drawn
too where the data have noise, and held. Data with noise get the published procedure to the letter.
Without noise the penalty's weight falls at every re-seed (see `inertial_calibration`): the
published procedure would creep.

Those of inertia as in the published Table III: sqrt(mean e^2) over the two-sided model, 36 moments,
12 masses, 36 mass-centre coordinates; residuals over frames and the three components. That gives
Table III from Table IV.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from joblib import Parallel, delayed

from gaitcal.arrays import Array
from gaitcal.calibration import combined, inertial_calibration, joint_estimate
from gaitcal.io.recording import Recording
from gaitcal.model import parameters as params
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.montecarlo.protocol import PROBLEMS, SIDE
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic import synthetic_motion as motions
from gaitcal.tracking import banded, spline
from gaitcal.tracking.descent import Descent, DescentSettings, Evaluation, descend
from gaitcal.tracking.motion import SharedMotions, build_motion, track_nodes
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem

LEG = params.list_leg_parameters(SIDE)
DAMPED = DescentSettings(first_damping=1e-3, keep_within=0.0, most_steps=60)
"""Every step on its own matrix: far away none serves twice."""


def rms(values: Array | Sequence[float]) -> float | None:
    """Root mean square; None of nothing."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(array**2))) if array.size else None


def joint_errors(
    estimate: params.Parameters, truth: params.Parameters, names: Sequence[str]
) -> Array:
    """(n,) estimate - true, mm and deg."""
    index = _index(names)
    out: Array = (estimate.joint[index] - truth.joint[index]) / params.JP_TO_SI[index]
    return out


def joint_rms(errors: Array, names: Sequence[str]) -> tuple[float | None, float | None]:
    """RMS of position errors (mm) and of orientation errors (deg); None where a joint has none."""
    position = np.array(
        [params.JOINT_PARAMETERS[k].kind is params.ParameterKind.POSITION for k in _index(names)],
        dtype=bool,
    )
    return rms(errors[position]), rms(errors[~position])


def _index(names: Sequence[str]) -> list[int]:
    return [params.JP_INDEX[name] for name in names]


@dataclass(frozen=True, kw_only=True)
class JointRecovery:
    """One of the four problems, solved."""

    names: tuple[str, ...]  # The joint parameters whose errors count: the joint's, or the leg's 27
    errors: Array  # (n,) found - true, mm and deg
    marker_mm: float  # RMS distance of markers, mm
    largest_mm: float  # Largest distance of any marker in any frame, mm
    cost: float  # m^2
    steps: int  # From zero: steps of the far start and evaluations of the end game
    seconds: float  # Of the processor, as the published times
    converged: bool
    parameters: params.Parameters  # All of the linkage, with what was found
    coefficients: Array  # (20, 27) m, rad
    cost_at_truth: float
    """m^2: with the true joint parameters, the motion fitted."""
    cost_from_truth: float
    """m^2: of the minimum found when the search starts at the true values of the free parameters.
    """

    @property
    def position_mm(self) -> float:
        """RMS position error, mm."""
        return joint_rms(self.errors, self.names)[0] or 0.0

    @property
    def orientation_deg(self) -> float | None:
        """RMS orientation error, deg; None for the hip, which has none."""
        return joint_rms(self.errors, self.names)[1]


@cache
def true_model() -> SubjectModel:
    """The truth: the published nominal subject with its 41 tracking markers."""
    return published_model()


@cache
def true_motion(problem: str) -> motions.TrueMotion:
    """Return the true motion of one of `PROBLEMS`; isolated trials have 1200 frames."""
    return (
        motions.simulate_gait()
        if problem == "full leg"
        else motions.simulate_isolated_trial(f"{problem}_{SIDE}")
    )


def free_parameters(problem: str) -> tuple[str, ...]:
    """What one of `PROBLEMS` solves for."""
    return (
        params.list_gait_parameters(SIDE)
        if problem == "full leg"
        else params.list_isolated_parameters(f"{problem}_{SIDE}")
    )


def synthetic_problem(problem: str, noise: np.random.Generator | None) -> MotionProblem:
    """One of `PROBLEMS` as markers on the whole linkage, with noise or without."""
    model, motion = true_model(), true_motion(problem)
    markers = motions.compute_synthetic_markers(model.parameters, model.markers, motion.q)
    if noise is not None:
        markers = markers + motions.draw_marker_noise(
            motion.basis.time, len(model.markers.labels), noise
        )
    recording = Recording(
        source=problem, time=motion.basis.time, labels=model.markers.labels, markers=markers
    )
    # as published: markers alone, no prior on any coordinate
    return replace(
        build_trial_problem(problem, model, recording, spline.NodeRule(fixed=motions.NODES)),
        priors=(),
    )


def recover_joints(problems: Mapping[str, MotionProblem]) -> dict[str, JointRecovery]:
    """Solve all; gait starts from what the isolated trials found for the parameters that it leaves
    alone.
    """
    out: dict[str, JointRecovery] = {}
    for problem, markers in problems.items():
        held = true_model().parameters
        for found in out.values() if problem == "full leg" else ():
            held = held.with_joint(found.names, found.parameters.joint[_index(found.names)])
        out[problem] = solve(problem, markers, held)
    return out


def solve(problem: str, markers: MotionProblem, held: params.Parameters) -> JointRecovery:
    """One problem from absolute zero; `held` gives the joint parameters that are not free."""
    free, truth = free_parameters(problem), true_model().parameters
    began = time.process_time()
    zero = np.zeros((markers.basis.nodes, len(markers.chain.coordinates)))
    p, coefficients, near = step_together([markers], held, free, [zero], np.zeros(len(free)))
    fit = joint_estimate.JointSearch([markers], held.with_joint(free, p), free, coefficients).run()
    seconds = time.process_time() - began
    names = LEG if problem == "full leg" else free
    distance = build_motion(markers, fit.parameters, fit.coefficients[0]).errors.distance
    at_truth = track_nodes(markers, markers.build_body(truth), true_motion(problem).coefficients)
    from_truth = joint_estimate.JointSearch([markers], held, free, [at_truth.x]).run(
        truth.joint[_index(free)]
    )
    return JointRecovery(
        names=names,
        errors=joint_errors(fit.parameters, truth, names),
        marker_mm=1e3 * float(np.sqrt(np.mean(distance**2))),
        largest_mm=1e3 * float(distance.max()),
        cost=fit.state.cost,
        steps=near.steps + fit.iterations,
        seconds=seconds,
        converged=near.converged and fit.converged,
        parameters=fit.parameters,
        coefficients=fit.coefficients[0],
        cost_at_truth=at_truth.cost,
        cost_from_truth=from_truth.state.cost,
    )


def step_together(
    problems: Sequence[MotionProblem],
    parameters: params.Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    p: Array,
) -> tuple[Array, list[Array], Descent[Evaluation, banded.ArrowFactor]]:
    """Bring motions and joint parameters `free` down together, from nodes `starts` (each (nn, nq))
    and `p` (np,): where both end, and how.
    """
    shared = SharedMotions(problems, parameters, free)
    end = descend(shared, shared.join_unknowns(p, starts), DAMPED)
    return *shared.split_unknowns(end.x), end


SEED_RANGE = 0.5
RANDOM_SEEDS = 10
NOISELESS_DECAY = 0.1


@dataclass(frozen=True)
class InertialErrors:
    """RMS errors over the two-sided model."""

    inertia: float  # kg mm^2, 36 principal moments
    mass: float  # kg, 12 masses
    centre: float  # mm, 36 coordinates of mass centres


def inertial_rms(estimate: Array, truth: Array) -> InertialErrors:
    """Errors of inertial parameters (84,), SI."""
    errors = params.view_as_table((estimate - truth) / params.IP_TO_SI)
    return InertialErrors(
        *(float(np.sqrt(np.mean(errors[:, k] ** 2))) for k in (slice(4, 7), 0, slice(1, 4)))
    )


def symmetric_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Errors of the 36 symmetric parameters (mean of both sides), and of `foot.com.sup`; kg, mm, kg
    mm^2.
    """
    which = params.make_symmetric_set()
    errors = (estimate - truth) / params.IP_TO_SI
    values = which.selection.T @ errors / (which.selection**2).sum(axis=0)
    out = dict(zip(which.names, values.tolist(), strict=True))
    feet = [k for k, segment in enumerate(params.MASSIVE_SEGMENTS) if segment.startswith("foot")]
    out["foot.com.sup"] = float(params.view_as_table(errors)[feet, 2].mean())
    return out


@dataclass(frozen=True, kw_only=True)
class InertialRecovery:
    """A solution of phase 2."""

    force: float  # N, RMS pelvis residual over frames and components
    torque: float  # N·m
    errors: InertialErrors
    each: dict[
        str, float
    ]  # Error of each of the 36 parameters and of `foot.com.sup`; kg, mm, kg mm^2
    total_mass: float  # kg, error of the whole body's mass
    seeds: int
    seconds: float  # Of the processor, as the published times
    converged: bool  # Whether the residuals settled
    physical: bool  # Whether every body could exist; the published cost does not ask for it


@dataclass(frozen=True, kw_only=True)
class ThirdStep:
    """What joint and inertial parameters and motion together do to residuals and markers, from
    phases 1 and 2.
    """

    force: tuple[float, float]  # N before and after
    torque: tuple[float, float]  # N·m before and after
    marker_mm: tuple[float, float]  # RMS distance before and after
    position_mm: tuple[
        float, float
    ]  # RMS error of the positions among the free joint parameters, before and after
    seconds: float
    converged: bool


@cache
def true_wrench() -> Array:
    """(208, 2, 6) ground reactions on the feet that leave the true model no residual."""
    return motions.compute_residual_free_wrench(true_model().parameters, true_motion("full leg"))


def gait_equations(
    parameters: params.Parameters,
    coefficients: Array,
    scale: inertial_calibration.TorqueScale = inertial_calibration.TorqueScale.BODY_HEIGHT,
) -> inertial_calibration.RootEquations:
    """The pelvis residual of the gait trial for joint parameters and nodes (20, 27)."""
    basis = true_motion("full leg").basis
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    valid = np.ones(len(q), dtype=bool)
    motion = inertial_calibration.LoadedMotion(state=(q, v, a), wrench=true_wrench(), valid=valid)
    return inertial_calibration.assemble_root_equations(
        [motion], parameters, true_model().subject, scale, pelvis_width(true_model())
    )


def pelvis_width(model: SubjectModel) -> float:
    """Distance of the hip centres, m."""
    return float(np.linalg.norm(model.landmarks["hjc_r"][1] - model.landmarks["hjc_l"][1]))


def random_seed(rng: np.random.Generator, *, with_held: bool) -> Array:
    """(84,) the true inertial parameters, each of the 36 (with `with_held` also `foot.com.sup`) up
    to 50 % off.
    """
    truth, which = true_model().parameters.inertial, params.make_symmetric_set()
    factors = rng.uniform(-SEED_RANGE, SEED_RANGE, len(which.names) + 1)
    seed = truth * (1.0 + which.selection @ factors[:-1])
    if with_held:
        for foot in ("foot_r", "foot_l"):
            seed[params.IP_INDEX[f"{foot}.com.sup"]] *= 1.0 + factors[-1]
    return seed


def recover_inertia(
    equations: inertial_calibration.RootEquations,
    seed: Array,
    *,
    reseed: bool = True,
    decay: float = 1.0,
) -> InertialRecovery:
    """The published cost from a seed (84,)."""
    began, truth = time.process_time(), true_model().parameters.inertial
    fit = inertial_calibration.fit_published(
        equations, seed, params.make_symmetric_set(), reseed=reseed, decay=decay
    )
    return InertialRecovery(
        force=fit.rms_force,
        torque=fit.rms_moment,
        errors=inertial_rms(fit.inertial, truth),
        each=symmetric_errors(fit.inertial, truth),
        total_mass=float(params.view_as_table(fit.inertial - truth)[:, 0].sum()),
        seeds=fit.seeds,
        seconds=time.process_time() - began,
        converged=fit.converged,
        physical=bool(params.is_physical(fit.inertial).all()),
    )


def third_step(markers: MotionProblem, gait: JointRecovery) -> ThirdStep:
    """The third step of `gaitcal calibrate`, after phase 1 and physically consistent inertial
    parameters.

    Before: phases 1 and 2, as the third step finds them. Bodies must be possible, hence
    `fit_consistent`.
    """
    free, began = free_parameters("full leg"), time.process_time()
    equations = gait_equations(gait.parameters, gait.coefficients)
    inertial = inertial_calibration.fit_consistent(
        equations, true_model().parameters.inertial, params.make_symmetric_set()
    )
    trial = combined.CombinedProblem(
        markers, gait.coefficients, true_wrench(), np.ones(len(true_wrench()), dtype=bool)
    )
    start = gait.parameters.with_inertial(inertial.inertial)
    fit = combined.fit_combined(
        [trial], start, free, params.make_symmetric_set(), true_model().subject
    )
    force, torque = gait_equations(fit.parameters, fit.coefficients[0]).compute_rms(
        fit.parameters.inertial
    )
    distance = build_motion(markers, fit.parameters, fit.coefficients[0]).errors.distance
    positions = [
        joint_rms(joint_errors(p, true_model().parameters, free), free)[0] or 0.0
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

    joints: dict[str, JointRecovery]  # By problem
    residual_before: tuple[
        float, float
    ]  # N, N·m: true inertial parameters with the joints and motion of phase 1
    correct: InertialRecovery  # Phase 2 from the correct seed
    single_pass: InertialRecovery  # The same without re-seeding
    random: tuple[InertialRecovery, ...]  # Phase 2 from random seeds
    scales: dict[inertial_calibration.TorqueScale, InertialRecovery]
    """Phase 2 from the correct seed, for each normalisation of torques."""
    third: ThirdStep | None  # Only with noise


@with_one_blas_thread
def noiseless(seed: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Everything without noise; random inertial seeds from `seed`."""
    return _run(None, np.random.SeedSequence([seed, 0]), random_seeds)


@with_one_blas_thread
def noisy_draw(seed: int, draw: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Everything with the noise of one draw (0, 1, ...) under `seed`."""
    noise, seeds = generators(seed, draw)
    return _run(noise, seeds, random_seeds)


def generators(
    seed: int, draw: int
) -> tuple[tuple[np.random.Generator, ...], np.random.SeedSequence]:
    """The noise of each problem, and what random inertial seeds come from, for one draw (0, 1, ...)
    under `seed`.
    """
    sequence = np.random.SeedSequence([seed, 1, draw])
    return tuple(np.random.default_rng(s) for s in sequence.spawn(len(PROBLEMS))), sequence.spawn(
        1
    )[0]


def noisy_draws(
    seed: int, draws: int, jobs: int = -1, random_seeds: int = RANDOM_SEEDS
) -> list[SeedResult]:
    """Draws 0 to `draws` - 1 under `seed`, in order, whatever the number of processes (-1: one for
    every core).
    """
    results: list[SeedResult] = Parallel(n_jobs=jobs)(
        delayed(noisy_draw)(seed, draw, random_seeds) for draw in range(draws)
    )
    return results


def _run(
    noise: Sequence[np.random.Generator] | None, seeds: np.random.SeedSequence, random_seeds: int
) -> SeedResult:
    """Phases 1 to 3; `noise`: a generator for each of `PROBLEMS`, or none."""
    problems = {
        p: synthetic_problem(p, noise[k] if noise is not None else None)
        for k, p in enumerate(PROBLEMS)
    }
    joints = recover_joints(problems)
    gait, truth = joints["full leg"], true_model().parameters.inertial
    equations = {
        scale: gait_equations(gait.parameters, gait.coefficients, scale)
        for scale in inertial_calibration.TorqueScale
    }
    by_height = equations[inertial_calibration.TorqueScale.BODY_HEIGHT]
    decay = 1.0 if noise is not None else NOISELESS_DECAY
    streams = map(np.random.default_rng, seeds.spawn(random_seeds))
    starts = [random_seed(rng, with_held=noise is not None) for rng in streams]
    scales = {scale: recover_inertia(scaled, truth) for scale, scaled in equations.items()}
    return SeedResult(
        joints=joints,
        residual_before=by_height.compute_rms(truth),
        correct=scales[inertial_calibration.TorqueScale.BODY_HEIGHT],
        single_pass=recover_inertia(by_height, truth, reseed=False),
        random=tuple(recover_inertia(by_height, start, decay=decay) for start in starts),
        scales=scales,
        third=third_step(problems["full leg"], gait) if noise is not None else None,
    )
