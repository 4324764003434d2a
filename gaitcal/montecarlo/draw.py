"""One draw: disturb the model or the markers, fit the motion anew, compare the torques of both
legs.

A draw is a pure function of the context (case and settings), its set, its level and its number.
This is where the study's randomness enters: every draw has a `numpy.random.Generator` of its own,
spawned from the seed by (set, level, number), so that draws can be made in any order and anywhere.
Disturbances are uniform within the bounds; noise is one sinusoid per marker coordinate (method,
sections 5 and 6).

The motion follows the joint parameters by  dN/dp = -H_qq^-1 H_qp,  exact where the markers fit exactly, as they do in
the undisturbed case: it starts every re-fit. Torques are linear in the dynamic parameters phi of
the segments, by the regressor Y: inertial parameters alone change them by Y (phi - phi_0), without
a re-fit.

Torques of a leg (`dynamics/inverse_dynamics.py`) are those of pelvis and legs alone, with the
ground reaction in either frame. Fixed in the laboratory the wrench w stays as it was measured;
carried along with the foot it turns and moves as the foot frame did, by (R, o) from the undisturbed
(R0, o0) at the same instant:

    force' = R R0^T force,      moment' = R R0^T (moment - o0 x force) + o x force'.
"""

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics
from gaitcal.io.recording import Recording
from gaitcal.model.chain import LinkageModel
from gaitcal.model.coordinates import COORDINATE_TABLE, LEG_COORDINATES
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import LOWER_BODY, SIDES, list_joint_elements, list_joints_above
from gaitcal.model.parameters import (
    JP_INDEX,
    Parameters,
    compute_dynamic_parameters,
    make_symmetric_set,
)
from gaitcal.model.subject_model import SubjectModel
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.protocol import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.synthetic_motion import compute_synthetic_markers, draw_marker_noise
from gaitcal.tracking import banded, descent, motion, spline
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem

TORQUES = (
    LEG_COORDINATES  # The torques of a leg, without the side; the knee's adduction is a reaction
)
TORQUE_WORDS = {
    name: COORDINATE_TABLE[name].title[:1].lower() + COORDINATE_TABLE[name].title[1:]
    for name in TORQUES
}
LEG_TORQUES: tuple[str, ...] = tuple(f"{name}_{side}" for side in SIDES for name in TORQUES)
"""Both legs: the order of every axis of torques."""
OF_FOOT = tuple(
    np.array([k for k, name in enumerate(LEG_TORQUES) if name in carrying])
    for carrying in (
        {e.name for j in list_joints_above(foot) for e in list_joint_elements(j, reactions=True)}
        for foot in FEET
    )
)
"""Which of them the wrench on the right foot changes, and which the wrench on the left."""
LEG_SEGMENTS: tuple[str, ...] = LOWER_BODY[1:]


FootPose = tuple[Array, Array]
"""(nf, 2, 3, 3) axes of both feet in the laboratory, one a row, and (nf, 2, 3) m, their origins."""
_IN_BODY = np.array([FORCES.index(name) for name in LEG_TORQUES])


def leg_dynamics(parameters: Parameters) -> Dynamics:
    """Dynamics of pelvis and legs alone: nothing above the hips changes a leg's torques."""
    return Dynamics(parameters, segments=LOWER_BODY)


def pose_of_feet(placed: Kinematics) -> FootPose:
    """Where both feet are."""
    feet = [placed.chain.segments.index(foot) for foot in FEET]
    both = placed.segments_by_frame[:, feet]
    return both[:, :, :3], both[:, :, 3]


def leg_torques(
    parameters: Parameters,
    basis: spline.SplineBasis,
    coefficients: Array,
    wrench: Array,
    undisturbed: FootPose,
) -> tuple[Array, Array]:
    """(nf, 14) N·m with the wrenches (nf, 2, 6) fixed in the laboratory, and carried along with the
    feet.
    """
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    dynamics = leg_dynamics(parameters)
    placed = dynamics.place(q)
    unloaded = dynamics.compute_forces(q, v, a)[
        :, [dynamics.forces_of.index(name) for name in LEG_TORQUES]
    ]
    columns = placed.columns_by_frame[
        :, [placed.chain.variables.index(name) for name in LEG_TORQUES]
    ]

    def loaded(wrenches: Array) -> Array:
        tau = unloaded.copy()
        for foot, joints in enumerate(OF_FOOT):
            tau[:, joints] -= (columns[:, joints] @ wrenches[:, foot, :, None])[..., 0]
        return tau

    return loaded(wrench), loaded(carry(wrench, undisturbed, pose_of_feet(placed)))


def carry(wrench: Array, before: FootPose, after: FootPose) -> Array:
    """(nf, 2, 6) wrenches about the laboratory origin, carried along from one pose of the feet to
    another.
    """
    force = wrench[..., :3]
    local = before[0] @ np.stack([force, wrench[..., 3:] - np.cross(before[1], force)], axis=3)
    force, moment = np.moveaxis(after[0].swapaxes(2, 3) @ local, 3, 0)
    return np.concatenate([force, moment + np.cross(after[1], force)], axis=2)


class MonteCarloContext:
    """A case made ready for draws."""

    @with_one_blas_thread
    def __init__(self, case: MonteCarloCase, settings: MonteCarloSettings) -> None:
        self.case, self.settings = case, settings
        self.names = settings.parameters.names
        """Joint parameters that vary."""
        self.joint_values = case.parameters.joint[[JP_INDEX[name] for name in self.names]]
        """(np,) their undisturbed values, m and rad."""
        self.inertial_set = make_symmetric_set()
        self.problem = _undisturbed_problem(case)
        """The undisturbed motion fits its markers exactly."""
        self.basis, self.data = self.problem.basis, self.problem.data
        body = self.problem.build_body(case.parameters)
        self.undisturbed_factor = banded.BandFactor(
            self.problem.assemble_equations(case.coefficients, body).band
        )
        """Of the Gauss-Newton matrix at the undisturbed motion, with the undisturbed linkage."""
        self.sensitivity = np.zeros((*case.coefficients.shape, len(self.names)))
        """(nn, nq, np) change of the nodes by the joint parameters that vary; zero where these move
        no marker.
        """
        opened = self.problem.with_free(self.names)
        equations = opened.assemble_equations(case.coefficients, opened.build_body(case.parameters))
        solved = -banded.BandFactor(equations.band).solve(equations.mixed)
        moving = [self.names.index(name) for name in opened.chain.free]
        self.sensitivity[:, :, moving] = solved.reshape(*case.coefficients.shape, len(moving))
        states = [self.basis.evaluate(case.coefficients, k) for k in range(3)]
        rows = Dynamics(case.parameters).compute_regressor(*states)[:, _IN_BODY]
        self.regressor = rows.reshape(len(case.time) * len(LEG_TORQUES), -1)
        """(nf * 14, 120) N·m by the dynamic parameters of the massive segments, in their own
        frames.
        """
        self.feet = pose_of_feet(leg_dynamics(case.parameters).place(states[0]))
        self.torques, _ = leg_torques(
            case.parameters, self.basis, case.coefficients, case.wrench, self.feet
        )
        """(nf, 14) N·m of the undisturbed case."""
        segments = np.array([self.problem.chain.segments[s] for s in self.data.segment])
        pulling = self.data.weight.any(axis=1)
        self.leg_markers = tuple(
            np.flatnonzero(
                np.isin(segments, [s for s in LEG_SEGMENTS if s.endswith(f"_{side}")]) & pulling
            )
            for side in SIDES
        )
        """Markers of the right and of the left leg: indices into the order of `data`."""


def _undisturbed_problem(case: MonteCarloCase) -> MotionProblem:
    """The model's own markers in its own motion, as if they had been measured, in the case's spline
    space.
    """
    model = SubjectModel(
        subject=case.subject,
        parameters=case.parameters,
        nominal=case.parameters,
        markers=case.markers,
    )
    q = spline.build_spline_basis(case.time, len(case.coefficients)).evaluate(case.coefficients)
    markers = compute_synthetic_markers(case.parameters, case.markers, q)
    recording = Recording(
        source=case.name, time=case.time, labels=case.markers.labels, markers=markers
    )
    return build_trial_problem(
        case.name, model, recording, spline.NodeRule(fixed=len(case.coefficients))
    )


@dataclass(frozen=True)
class Disturbance:
    """What one draw changes; None where its set leaves something alone."""

    joint: Array | None  # (np,) m, rad added to the joint parameters that vary
    inertial: (
        Array | None
    )  # (36,) parts by which the symmetric inertial parameters change: 0.1 is ten per cent more
    noise: Array | None  # (nm, 3, nf) m added to the markers, in the order of the context's data


def disturb(context: MonteCarloContext, varied: Varied, level: int, number: int) -> Disturbance:
    """What draw `number` (0, 1, ...) of a set at a level (per cent of the bounds) changes."""
    settings, part = context.settings, level / 100.0
    rng = np.random.default_rng(
        np.random.SeedSequence(settings.seed, spawn_key=(varied.key, level, number))
    )
    joint = inertial = noise = None
    if varied.joint:
        bounds = settings.joint_bounds
        joint = part * bounds * rng.uniform(-1.0, 1.0, len(bounds))
    if varied.inertial:
        names = context.inertial_set.names
        inertial = part * settings.inertial_percent / 100.0 * rng.uniform(-1.0, 1.0, len(names))
    if varied is Varied.NOISE:
        time, markers = context.case.time, len(context.data.segment)
        waves = draw_marker_noise(
            time - time[0], markers, rng, amplitude=part * 1e-3 * settings.noise_mm
        )
        noise = np.ascontiguousarray(waves.transpose(1, 2, 0))
    return Disturbance(joint, inertial, noise)


def torque_column(torque: str, frame: ReactionFrame, measure: str) -> str:
    """Name of a torque error in tables: `hip_flexion_l.lab.rms`; measures `rms` and `mean`, %BW*H."""
    return f"{torque}.{frame.value}.{measure}"


def marker_column(side: str, measure: str) -> str:
    """Name of a marker distance in tables: `markers_l.rms`; measures `rms` and `mean`, mm."""
    return f"markers_{side}.{measure}"


MEASURES = ("rms", "mean")
COLUMNS: tuple[str, ...] = (
    *(torque_column(t, frame, m) for frame in ReactionFrame for m in MEASURES for t in LEG_TORQUES),
    *(marker_column(side, m) for m in MEASURES for side in SIDES),
)
"""What a draw records: torque errors in %BW*H (mean: signed), marker distances in mm."""


@dataclass(frozen=True)
class DrawResult:
    """The record of one draw."""

    # (60,) in the order of `COLUMNS`; NaN where the draw failed before there was anything to
    # measure
    values: Array
    evaluations: int  # Of the gradient in the re-fit; 0 without one
    failure: str
    """Why the motion could not be fitted; empty where it could. The values are then those of the
    last motion tried.
    """


@with_one_blas_thread
def draw(context: MonteCarloContext, varied: Varied, level: int, number: int) -> DrawResult:
    """Draw `number` (0, 1, ...) of a set at a level (per cent of the bounds)."""
    change = disturb(context, varied, level, number)
    try:
        model = disturbed_model(context, change)
        if varied is Varied.IP:  # moves no marker: the motion stays, and torques are linear
            inertial, undisturbed = (
                p.inertial for p in (model.parameters, context.case.parameters)
            )
            phi = compute_dynamic_parameters(inertial) - compute_dynamic_parameters(undisturbed)
            errors = (context.regressor @ phi.ravel()).reshape(-1, len(LEG_TORQUES))
            return DrawResult(
                _record(context, (errors, errors), np.zeros(context.data.weight.shape)), 0, ""
            )
        fitted = refit(model.problem, model.body, model.start, context.settings, model.factor)
        return DrawResult(
            errors_of(context, model, fitted.coefficients), fitted.evaluations, fitted.failure
        )
    except (np.linalg.LinAlgError, FloatingPointError, ValueError) as error:
        return DrawResult(np.full(len(COLUMNS), np.nan), 0, f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Refit:
    """The end of a re-fit."""

    coefficients: Array  # (nn, nq) m, rad
    evaluations: int  # Steps taken, each with an evaluation of the gradient
    failure: str  # Why it did not converge; empty where it did


def refit(
    problem: MotionProblem,
    body: LinkageModel,
    start: Array,
    settings: MonteCarloSettings,
    known: banded.BandFactor | None = None,
) -> Refit:
    """Minimise the weighted sum of squared marker distances over the coefficients, starting at
    `start` (nn, nq).

    The iteration is that of tracking (`tracking/descent.py`), made for many small problems of one
    kind: it starts on a Gauss-Newton factor, keeps it however long the steps are, and where they no
    longer shrink tenfold goes on with Newton's. The end is told by the size of the step, so that
    every draw is solved as far as every other.

    `problem`: the markers to fit; no joint parameter is free. `body`: of the disturbed linkage.
    `known`: the factor of the Gauss-Newton matrix at `start`, if there is one: it does not depend
    on the markers.
    """
    rule = descent.DescentSettings(
        gain=0.0,
        shortest_step=settings.refit_tolerance,
        most_steps=settings.refit_most_evaluations,
        keep_within=np.inf,
        curved=True,
    )
    factor = known or banded.BandFactor(problem.assemble_equations(start, body).band)
    tracked = motion.track_nodes(problem, body, start, rule, factor)
    if tracked.ending is descent.Ending.MOST_STEPS:
        return Refit(tracked.x, tracked.steps, f"{tracked.steps} evaluations did not settle it")
    return Refit(tracked.x, tracked.steps, "" if tracked.converged else tracked.ending.value)


@dataclass(frozen=True)
class DisturbedModel:
    """The case after a disturbance, its motion not yet fitted."""

    parameters: Parameters
    problem: MotionProblem  # The markers that the motion is to be fitted to
    body: LinkageModel
    start: Array  # (nn, nq) m, rad: the undisturbed motion and what it changes by to first order
    factor: (
        banded.BandFactor | None
    )  # Of the Gauss-Newton matrix at the start; None where it must be formed


def disturbed_model(context: MonteCarloContext, change: Disturbance) -> DisturbedModel:
    """What a draw changes, put into the case."""
    case = context.case
    parameters, start, problem = case.parameters, case.coefficients, context.problem
    if change.joint is not None:
        parameters = parameters.with_joint(context.names, context.joint_values + change.joint)
        start = start + context.sensitivity @ change.joint
    if change.inertial is not None:
        factors = 1.0 + context.inertial_set.selection @ change.inertial
        parameters = parameters.with_inertial(case.parameters.inertial * factors)
    if change.noise is not None:
        problem = problem.with_measured(problem.data.measured + change.noise)
    known = None if change.joint is not None else context.undisturbed_factor
    return DisturbedModel(parameters, problem, problem.build_body(parameters), start, known)


def errors_of(context: MonteCarloContext, model: DisturbedModel, coefficients: Array) -> Array:
    """(60,) in the order of `COLUMNS`: what a disturbed model in a motion (nn, nq) says wrongly."""
    placed = model.problem.compute_positions(coefficients, model.body)
    torques = leg_torques(
        model.parameters, context.basis, coefficients, context.case.wrench, context.feet
    )
    errors = (torques[0] - context.torques, torques[1] - context.torques)
    apart = placed - model.problem.data.measured
    return _record(context, errors, np.sqrt((apart * apart).sum(axis=1)))


def _record(context: MonteCarloContext, errors: tuple[Array, Array], distance: Array) -> Array:
    """(60,) from torque errors (nf, 14) N·m in both frames and marker distances (nm, nf) m."""
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    out: list[Array] = []
    for error in errors:
        kept = to_percent * error[valid]
        out += [np.sqrt((kept * kept).mean(axis=0)), kept.mean(axis=0)]
    of_legs = [1e3 * distance[markers] for markers in context.leg_markers]
    out.append(np.array([np.sqrt((d * d).mean()) if d.size else np.nan for d in of_legs]))
    out.append(np.array([d.mean() if d.size else np.nan for d in of_legs]))
    return np.concatenate(out)
