"""Recover the published parameters from synthetic data: joints, inertia, then all together.

Phase 1: the four published problems, with all unknowns starting at absolute zero. Three functional
trials, each with the whole linkage (27 coordinates of 20 control points) and the parameters of its
joint; then gait with 17 parameters of the leg, the other 10 from the functional trials. One weight,
no prior, no bounds. Variable projection solves each motion fully for the current joint parameters;
for impossible ones (all zero) that motion leads to another minimum. From zero, control points and
joint parameters therefore step together (`descend_together`), with damping. Variable projection
finishes, as in any calibration.

Errors are those of the published Table I: sqrt(mean e^2) over the parameters of a joint, separately
for positions (mm) and orientations (deg). That definition gives the printed figures of Table I from
those of Table II.

Phase 2, inertial parameters from the pelvis residual, has the motion and joint parameters of phase
1 and the true ground reactions. Seeds are the true values, or each parameter times 1 + U(-0.5,
0.5), equal on both sides. `foot.com.sup`, which the paper prints although it is none of the 36, is
also drawn if the data have noise, and held. Data with noise get the published procedure. Without
noise the weight of the penalty falls at every re-seed (see `inertial_calibration`), because the
published procedure would need too many.

Errors of inertia are those of the published Table III: sqrt(mean e^2) over the two-sided model, 36
moments, 12 masses, 36 mass-centre coordinates; residuals over frames and the three components. That
gives Table III from Table IV.
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
from gaitcal.tracking.motion import SharedMotions, build_motion, track_coefficients
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem

LEG = params.list_leg_parameters(SIDE)
DAMPED = DescentSettings(first_damping=1e-3, keep_within=0.0, most_steps=60)
"""Every step has a new matrix: far from the minimum none can be used twice."""
SEED_RANGE = 0.5
"""Largest relative deviation of a random seed."""
RANDOM_SEEDS = 10
NOISELESS_DECAY = 0.1
"""Factor of the penalty's weight at every re-seed, without noise."""


def compute_rms(values: Array | Sequence[float]) -> float | None:
    """Compute the root mean square; None without values."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(array**2))) if array.size else None


def compute_joint_errors(
    estimate: params.Parameters, truth: params.Parameters, names: Sequence[str]
) -> Array:
    """Compute the errors of joint parameters.

    `names`: joint parameters. Returns: (n,) estimate minus truth, mm and deg.
    """
    index = _find_indices(names)
    out: Array = (estimate.joint[index] - truth.joint[index]) / params.JP_TO_SI[index]
    return out


def compute_joint_rms(errors: Array, names: Sequence[str]) -> tuple[float | None, float | None]:
    """Compute the RMS errors of positions and orientations.

    `errors`: (n,) mm and deg. `names`: joint parameters. Returns: `position, orientation` mm and
    deg; None if there are none.
    """
    kinds = [params.JOINT_PARAMETERS[k].kind for k in _find_indices(names)]
    position = np.array([kind is params.ParameterKind.POSITION for kind in kinds], dtype=bool)
    return compute_rms(errors[position]), compute_rms(errors[~position])


def _find_indices(names: Sequence[str]) -> list[int]:
    return [params.JP_INDEX[name] for name in names]


@dataclass(frozen=True, kw_only=True)
class JointRecovery:
    """Solution of one of the four problems."""

    names: tuple[str, ...]
    """Joint parameters of `errors`: those of the joint, or the 27 of the leg."""
    errors: Array
    """(n,) found minus true, mm and deg."""
    marker_mm: float
    """RMS distance of markers, mm."""
    largest_mm: float
    """Largest distance of any marker in any frame, mm."""
    cost: float
    """m^2."""
    steps: int
    """Steps together from zero, and evaluations of variable projection."""
    seconds: float
    """Of the processor, as the published times."""
    converged: bool
    parameters: params.Parameters
    """Of the linkage, with the solution."""
    coefficients: Array
    """(20, 27) m, rad."""
    cost_at_truth: float
    """m^2, with the true joint parameters and a fitted motion."""
    cost_from_truth: float
    """m^2, of the minimum of a search from the true values of the free parameters."""

    @property
    def position_mm(self) -> float:
        """RMS position error, mm."""
        return compute_joint_rms(self.errors, self.names)[0] or 0.0

    @property
    def orientation_deg(self) -> float | None:
        """RMS orientation error, deg; None for the hip."""
        return compute_joint_rms(self.errors, self.names)[1]


@cache
def build_true_model() -> SubjectModel:
    """Build the true model: the published nominal subject with its 41 tracking markers."""
    return published_model()


@cache
def build_true_motion(problem: str) -> motions.TrueMotion:
    """Build the true motion of one of `PROBLEMS`; functional trials have 1200 frames."""
    if problem == "full leg":
        return motions.simulate_gait()
    return motions.simulate_isolated_trial(f"{problem}_{SIDE}")


def list_free_parameters(problem: str) -> tuple[str, ...]:
    """List the joint parameters that one of `PROBLEMS` solves for."""
    if problem == "full leg":
        return params.list_gait_parameters(SIDE)
    return params.list_isolated_parameters(f"{problem}_{SIDE}")


def build_synthetic_problem(problem: str, noise: np.random.Generator | None) -> MotionProblem:
    """Build one of the four problems.

    `problem`: one of `PROBLEMS`. `noise`: of the marker noise; no noise if None. Returns: synthetic
    markers on the whole linkage, without priors.
    """
    model, motion = build_true_model(), build_true_motion(problem)
    markers = motions.compute_synthetic_markers(model.parameters, model.markers, motion.q)
    if noise is not None:
        markers = markers + motions.draw_marker_noise(
            motion.basis.time, len(model.markers.labels), noise
        )
    recording = Recording(
        source=problem, time=motion.basis.time, labels=model.markers.labels, markers=markers
    )
    rule = spline.ControlPointRule(fixed=motions.NODES)
    # As published: no prior on any coordinate.
    return replace(build_trial_problem(problem, model, recording, rule), priors=())


def _recover_joints(problems: Mapping[str, MotionProblem]) -> dict[str, JointRecovery]:
    """Solve all problems; gait holds its other parameters at the values of functional trials.

    `problems`: name -> problem, gait last. Returns: name -> solution.
    """
    out: dict[str, JointRecovery] = {}
    for problem, markers in problems.items():
        held = build_true_model().parameters
        for found in out.values() if problem == "full leg" else ():
            held = held.with_joint(found.names, found.parameters.joint[_find_indices(found.names)])
        out[problem] = solve(problem, markers, held)
    return out


def solve(problem: str, markers: MotionProblem, held: params.Parameters) -> JointRecovery:
    """Solve one problem from absolute zero.

    Parameters
    ----------
    problem : str
        One of `PROBLEMS`.
    markers : MotionProblem
        From `build_synthetic_problem`.
    held : Parameters
        With the joint parameters that are not free.

    Returns
    -------
    JointRecovery
    """
    free, truth = list_free_parameters(problem), build_true_model().parameters
    began = time.process_time()
    # Absolute zero: all coordinates and all errors of joint parameters.
    zero = np.zeros((markers.basis.control_points, len(markers.chain.coordinates)))
    p, coefficients, near = descend_together([markers], held, free, [zero], np.zeros(len(free)))
    fit = joint_estimate.JointSearch([markers], held.with_joint(free, p), free, coefficients).run()
    seconds = time.process_time() - began
    names = LEG if problem == "full leg" else free
    distance = build_motion(markers, fit.parameters, fit.coefficients[0]).errors.distance
    # The cost at the true parameters, with the motion that is best for them.
    at_truth = track_coefficients(
        markers, markers.build_body(truth), build_true_motion(problem).coefficients
    )
    from_truth = joint_estimate.JointSearch([markers], held, free, [at_truth.x]).run(
        truth.joint[_find_indices(free)]
    )
    return JointRecovery(
        names=names,
        errors=compute_joint_errors(fit.parameters, truth, names),
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


def descend_together(
    problems: Sequence[MotionProblem],
    parameters: params.Parameters,
    free: tuple[str, ...],
    starts: Sequence[Array],
    p: Array,
) -> tuple[Array, list[Array], Descent[Evaluation, banded.ArrowFactor]]:
    """Minimise over motions and joint parameters together, with damped steps.

    `parameters`: with the joint parameters that are not free. `free`: joint parameters to solve
    for. `starts`: control points of each motion to start from, m and rad. `p`: (np,) free joint
    parameters to start from, m and rad. Returns: (np,) joint parameters; control points of each
    motion; the search, with steps and convergence.
    """
    shared = SharedMotions(problems, parameters, free)
    end = descend(shared, shared.join_unknowns(p, starts), DAMPED)
    return *shared.split_unknowns(end.x), end


@dataclass(frozen=True)
class InertialErrors:
    """RMS errors over the two-sided model."""

    inertia: float
    """kg mm^2, of 36 principal moments."""
    mass: float
    """kg, of 12 masses."""
    centre: float
    """mm, of 36 coordinates of mass centres."""


def compute_inertial_rms(estimate: Array, truth: Array) -> InertialErrors:
    """Compute RMS errors of inertial parameters (84,), SI."""
    errors = params.view_as_table((estimate - truth) / params.IP_TO_SI)
    # Columns of a segment: mass, three coordinates of the mass centre, three moments of inertia.
    inertia, mass, centre = (
        float(np.sqrt(np.mean(errors[:, k] ** 2))) for k in (slice(4, 7), 0, slice(1, 4))
    )
    return InertialErrors(inertia, mass, centre)


def compute_symmetric_errors(estimate: Array, truth: Array) -> dict[str, float]:
    """Compute errors of the 36 symmetric parameters, and of `foot.com.sup`.

    `estimate`, `truth`: (84,) inertial parameters, SI. Returns: parameter -> mean error of both
    sides, kg, mm, kg mm^2.
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
    """Solution of phase 2."""

    force: float
    """N, RMS pelvis residual over frames and components."""
    torque: float
    """N·m, the same."""
    errors: InertialErrors
    each: dict[str, float]
    """Error of each of the 36 parameters and of `foot.com.sup`; kg, mm, kg mm^2."""
    total_mass: float
    """kg, error of the mass of the whole body."""
    seeds: int
    """Number of seeds until the residuals settled."""
    seconds: float
    """Of the processor, as the published times."""
    converged: bool
    """Whether the residuals settled."""
    physical: bool
    """Whether every body could exist; the published cost does not require it."""


@dataclass(frozen=True, kw_only=True)
class ThirdStep:
    """Residuals and marker errors before and after a fit of all parameters together."""

    force: tuple[float, float]
    """N."""
    torque: tuple[float, float]
    """N·m."""
    marker_mm: tuple[float, float]
    """RMS distance, mm."""
    position_mm: tuple[float, float]
    """RMS error of the positions among the free joint parameters, mm."""
    seconds: float
    converged: bool


@cache
def compute_true_wrench() -> Array:
    """Compute (208, 2, 6) ground reactions on the feet without residual of the true model."""
    return motions.compute_residual_free_wrench(
        build_true_model().parameters, build_true_motion("full leg")
    )


def assemble_gait_equations(
    parameters: params.Parameters,
    coefficients: Array,
    scale: inertial_calibration.TorqueScale = inertial_calibration.TorqueScale.BODY_HEIGHT,
) -> inertial_calibration.RootEquations:
    """Assemble the equations of the pelvis residual of the gait trial.

    `coefficients`: (20, 27) the motion, m and rad.
    """
    basis = build_true_motion("full leg").basis
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    valid = np.ones(len(q), dtype=bool)
    motion = inertial_calibration.LoadedMotion(
        state=(q, v, a), wrench=compute_true_wrench(), valid=valid
    )
    return inertial_calibration.assemble_root_equations(
        [motion],
        parameters,
        build_true_model().subject,
        scale,
        _measure_pelvis_width(build_true_model()),
    )


def _measure_pelvis_width(model: SubjectModel) -> float:
    """Measure the distance of the hip centres, m."""
    return float(np.linalg.norm(model.landmarks["hjc_r"][1] - model.landmarks["hjc_l"][1]))


def draw_random_seed(rng: np.random.Generator, *, with_held: bool) -> Array:
    """Draw a random seed of the inertial parameters.

    `with_held`: draw `foot.com.sup`, too. Returns: (84,) SI; the true values times 1 + U(-0.5,
    0.5), equal on both sides.
    """
    truth, which = build_true_model().parameters.inertial, params.make_symmetric_set()
    factors = rng.uniform(-SEED_RANGE, SEED_RANGE, len(which.names) + 1)
    seed = truth * (1.0 + which.selection @ factors[:-1])
    if with_held:
        for foot in ("foot_r", "foot_l"):
            seed[params.IP_INDEX[f"{foot}.com.sup"]] *= 1.0 + factors[-1]
    return seed


def _recover_inertia(
    equations: inertial_calibration.RootEquations,
    seed: Array,
    *,
    reseed: bool = True,
    decay: float = 1.0,
) -> InertialRecovery:
    """Minimise the published cost of phase 2 from a seed.

    `seed`: (84,) inertial parameters, SI. `reseed`: repeat from the solution until the residuals
    settle. `decay`: factor of the penalty's weight at every re-seed.
    """
    began, truth = time.process_time(), build_true_model().parameters.inertial
    # The cost of the paper: residual force and torque with a penalty on the change from the seed.
    fit = inertial_calibration.fit_published(
        equations, seed, params.make_symmetric_set(), reseed=reseed, decay=decay
    )
    return InertialRecovery(
        force=fit.rms_force,
        torque=fit.rms_moment,
        errors=compute_inertial_rms(fit.inertial, truth),
        each=compute_symmetric_errors(fit.inertial, truth),
        total_mass=float(params.view_as_table(fit.inertial - truth)[:, 0].sum()),
        seeds=fit.seeds,
        seconds=time.process_time() - began,
        converged=fit.converged,
        physical=bool(params.is_physical(fit.inertial).all()),
    )


def _recover_together(markers: MotionProblem, gait: JointRecovery) -> ThirdStep:
    """Fit joint and inertial parameters together, as the third step of `gaitcal calibrate`.

    It starts from phase 1 and physically consistent inertial parameters, because its chart holds no
    impossible bodies.

    `gait`: its solution of phase 1.
    """
    free, began = list_free_parameters("full leg"), time.process_time()
    equations = assemble_gait_equations(gait.parameters, gait.coefficients)
    # The third step begins with inertial parameters that fit the joints of phase 1.
    inertial = inertial_calibration.fit_consistent(
        equations, build_true_model().parameters.inertial, params.make_symmetric_set()
    )
    trial = combined.CombinedProblem(
        markers,
        gait.coefficients,
        compute_true_wrench(),
        np.ones(len(compute_true_wrench()), dtype=bool),
    )
    start = gait.parameters.with_inertial(inertial.inertial)
    fit = combined.fit_combined(
        [trial], start, free, params.make_symmetric_set(), build_true_model().subject
    )
    force, torque = assemble_gait_equations(fit.parameters, fit.coefficients[0]).compute_rms(
        fit.parameters.inertial
    )
    distance = build_motion(markers, fit.parameters, fit.coefficients[0]).errors.distance
    positions = [
        compute_joint_rms(compute_joint_errors(p, build_true_model().parameters, free), free)[0]
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

    joints: dict[str, JointRecovery]
    """By problem."""
    residual_before: tuple[float, float]
    """N, N·m: of the true inertial parameters with the joints and motion of phase 1."""
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
def recover_noiseless(seed: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Recover all parameters without noise.

    `seed`: of the random inertial seeds. `random_seeds`: their number.
    """
    return _recover(None, np.random.SeedSequence([seed, 0]), random_seeds)


@with_one_blas_thread
def recover_noisy_draw(seed: int, draw: int, random_seeds: int = RANDOM_SEEDS) -> SeedResult:
    """Recover all parameters with one draw of the noise.

    `seed`: of all draws. `draw`: number of the draw: 0, 1, ... `random_seeds`: number of random
    inertial seeds.
    """
    noise, seeds = make_generators(seed, draw)
    return _recover(noise, seeds, random_seeds)


def make_generators(
    seed: int, draw: int
) -> tuple[tuple[np.random.Generator, ...], np.random.SeedSequence]:
    """Make the random generators of one draw.

    `seed`: of all draws. `draw`: number of the draw: 0, 1, ... Returns: `noise` one for each
    problem; `seeds` of the random inertial seeds.
    """
    sequence = np.random.SeedSequence([seed, 1, draw])
    noise = tuple(np.random.default_rng(s) for s in sequence.spawn(len(PROBLEMS)))
    return noise, sequence.spawn(1)[0]


def recover_noisy_draws(
    seed: int, draws: int, jobs: int = -1, random_seeds: int = RANDOM_SEEDS
) -> list[SeedResult]:
    """Recover all parameters for many draws of the noise.

    Parameters
    ----------
    seed : int
        Of all draws.
    draws : int
        Their number.
    jobs : int
        Number of processes; -1: one for every core. The results do not depend on it.
    random_seeds : int
        Number of random inertial seeds of each draw.

    Returns
    -------
    list of SeedResult
        In order.
    """
    results: list[SeedResult] = Parallel(n_jobs=jobs)(
        delayed(recover_noisy_draw)(seed, draw, random_seeds) for draw in range(draws)
    )
    return results


def _recover(
    noise: Sequence[np.random.Generator] | None, seeds: np.random.SeedSequence, random_seeds: int
) -> SeedResult:
    """Run phases 1 to 3; `noise`: a generator for each of `PROBLEMS`, or None."""
    problems = {
        p: build_synthetic_problem(p, noise[k] if noise is not None else None)
        for k, p in enumerate(PROBLEMS)
    }
    joints = _recover_joints(problems)
    gait, truth = joints["full leg"], build_true_model().parameters.inertial
    equations = {
        scale: assemble_gait_equations(gait.parameters, gait.coefficients, scale)
        for scale in inertial_calibration.TorqueScale
    }
    # The paper divides torque by body height.
    by_height = equations[inertial_calibration.TorqueScale.BODY_HEIGHT]
    decay = 1.0 if noise is not None else NOISELESS_DECAY
    streams = map(np.random.default_rng, seeds.spawn(random_seeds))
    # Separate streams, so that more random seeds leave the first ones as they are.
    starts = [draw_random_seed(rng, with_held=noise is not None) for rng in streams]
    scales = {scale: _recover_inertia(scaled, truth) for scale, scaled in equations.items()}
    return SeedResult(
        joints=joints,
        residual_before=by_height.compute_rms(truth),
        correct=scales[inertial_calibration.TorqueScale.BODY_HEIGHT],
        single_pass=_recover_inertia(by_height, truth, reseed=False),
        random=tuple(_recover_inertia(by_height, start, decay=decay) for start in starts),
        scales=scales,
        third=_recover_together(problems["full leg"], gait) if noise is not None else None,
    )
