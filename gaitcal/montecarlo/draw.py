"""Compute one draw: disturb model or markers, fit the motion again, compare the leg torques.

A draw is a pure function of the context (case and settings), its set, its level and its number.
Every draw has a separate `numpy.random.Generator`, spawned from the seed by (set, level, number),
so that draws can be computed in any order and anywhere. Disturbances are uniform within the bounds;
noise is one sinusoid per marker coordinate (method, sections 5 and 6).

The motion follows the joint parameters by

    dN/dp = -H_qq^-1 H_qp,

which is exact if the markers fit exactly, as in the undisturbed case: it is the start of every
re-fit. Torques are linear in the dynamic parameters phi of the segments, by the regressor Y:
inertial parameters alone change them by Y (phi - phi_0), without a re-fit.

Torques of a leg (`dynamics/inverse_dynamics.py`) are those of pelvis and legs alone, with the
ground reaction in either frame. In the laboratory the wrench w stays as it was measured. Carried
with the foot it moves as the foot frame does, to (R, o) from the undisturbed (R0, o0) at the same
instant:

    force' = R R0^T force,      moment' = R R0^T (moment - o0 x force) + o x force'.
"""

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, IntArray
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

TORQUES = LEG_COORDINATES
"""The torques of a leg, without the side; that of knee adduction is a reaction."""
TORQUE_LABELS = {
    name: COORDINATE_TABLE[name].title[:1].lower() + COORDINATE_TABLE[name].title[1:]
    for name in TORQUES
}
"""Torque -> its title within a sentence."""
LEG_TORQUES: tuple[str, ...] = tuple(f"{name}_{side}" for side in SIDES for name in TORQUES)
"""Both legs: the order of every axis of torques."""
LEG_SEGMENTS: tuple[str, ...] = LOWER_BODY[1:]
MEASURES = ("rms", "mean")


def _find_torques_of_foot(foot: str) -> IntArray:
    """Find the indices in `LEG_TORQUES` of the torques that a wrench on this foot changes."""
    names = set[str]()
    for joint in list_joints_above(foot):
        names |= {element.name for element in list_joint_elements(joint, reactions=True)}
    return np.array([k for k, name in enumerate(LEG_TORQUES) if name in names])


TORQUES_OF_FOOT = tuple(_find_torques_of_foot(foot) for foot in FEET)
"""Indices of the torques that the wrench on the right foot changes, and of the left."""

FootPose = tuple[Array, Array]
"""(nf, 2, 3, 3) axes of both feet in the laboratory, one per row, and (nf, 2, 3) m, their origins.
"""
_LEG_FORCES = np.array([FORCES.index(name) for name in LEG_TORQUES])


def _build_leg_dynamics(parameters: Parameters) -> Dynamics:
    """Build the dynamics of pelvis and legs; segments above do not change torques of the legs."""
    return Dynamics(parameters, segments=LOWER_BODY)


def _compute_foot_poses(placed: Kinematics) -> FootPose:
    """Compute the poses of both feet.

    `placed`: poses of a chain with both feet over all frames.
    """
    feet = [placed.chain.segments.index(foot) for foot in FEET]
    both = placed.segments_by_frame[:, feet]
    return both[:, :, :3], both[:, :, 3]


def compute_leg_torques(
    parameters: Parameters,
    basis: spline.SplineBasis,
    coefficients: Array,
    wrench: Array,
    undisturbed: FootPose,
) -> tuple[Array, Array]:
    """Compute the torques of both legs with the ground reactions in either frame.

    `coefficients`: (nn, 27) the motion, m and rad. `wrench`: (nf, 2, 6) ground reactions on the
    feet in the undisturbed case, N and N·m about the laboratory origin. `undisturbed`: poses of the
    feet in the undisturbed case. Returns: `laboratory, foot` (nf, 14) N·m, with the wrenches
    constant in the laboratory, and carried with the feet.
    """
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    dynamics = _build_leg_dynamics(parameters)
    placed = dynamics.place(q)
    forces = [dynamics.forces_of.index(name) for name in LEG_TORQUES]
    variables = [placed.chain.variables.index(name) for name in LEG_TORQUES]
    # Inertia, gravity and velocity terms once; ground reactions differ by frame of reference.
    without_load = dynamics.compute_forces(q, v, a)[:, forces]
    columns = placed.columns_by_frame[:, variables]

    def subtract_loads(wrenches: Array) -> Array:
        tau = without_load.copy()
        for foot, joints in enumerate(TORQUES_OF_FOOT):
            tau[:, joints] -= (columns[:, joints] @ wrenches[:, foot, :, None])[..., 0]
        return tau

    # In the frame of the foot, the measured wrench follows the disturbed foot: the insole measures.
    with_feet = move_wrenches(wrench, undisturbed, _compute_foot_poses(placed))
    return subtract_loads(wrench), subtract_loads(with_feet)


def move_wrenches(wrench: Array, before: FootPose, after: FootPose) -> Array:
    """Move wrenches with the feet from one pose to another.

    `wrench`: (nf, 2, 6) N and N·m about the laboratory origin. Returns: (nf, 2, 6) N and N·m about
    the laboratory origin.
    """
    force = wrench[..., :3]
    local = before[0] @ np.stack([force, wrench[..., 3:] - np.cross(before[1], force)], axis=3)
    force, moment = np.moveaxis(after[0].swapaxes(2, 3) @ local, 3, 0)
    return np.concatenate([force, moment + np.cross(after[1], force)], axis=2)


class MonteCarloContext:
    """A case with what all its draws need."""

    @with_one_blas_thread
    def __init__(self, case: MonteCarloCase, settings: MonteCarloSettings) -> None:
        """Prepare a case for draws.

        Parameters
        ----------
        case : MonteCarloCase
            The undisturbed case.
        settings : MonteCarloSettings
            Seed and bounds.
        """
        self.case, self.settings = case, settings
        self.names = settings.parameters.names
        """Joint parameters that vary."""
        self.joint_values = case.parameters.joint[[JP_INDEX[name] for name in self.names]]
        """(np,) undisturbed values of these, m and rad."""
        self.inertial_set = make_symmetric_set()
        self.problem = _build_undisturbed_problem(case)
        """The undisturbed motion fits the markers of this problem exactly."""
        self.basis, self.data = self.problem.basis, self.problem.data
        body = self.problem.build_body(case.parameters)
        self.undisturbed_factor = banded.BandFactor(
            self.problem.assemble_equations(case.coefficients, body).band
        )
        """Factor of the Gauss-Newton matrix at the undisturbed motion and linkage."""
        self.sensitivity = np.zeros((*case.coefficients.shape, len(self.names)))
        """(nn, nq, np) derivative of the control points by the joint parameters that vary; zero for
        those that move no marker.
        """
        # Implicit function theorem at the undisturbed minimum: dc/dp = -H_cc^-1 H_cp.
        opened = self.problem.with_free(self.names)
        equations = opened.assemble_equations(case.coefficients, opened.build_body(case.parameters))
        solved = -banded.BandFactor(equations.band).solve(equations.mixed)
        moving = [self.names.index(name) for name in opened.chain.free]
        self.sensitivity[:, :, moving] = solved.reshape(*case.coefficients.shape, len(moving))
        states = [self.basis.evaluate(case.coefficients, k) for k in range(3)]
        # Torques are linear in the dynamic parameters, so one regressor serves all draws of masses.
        rows = Dynamics(case.parameters).compute_regressor(*states)[:, _LEG_FORCES]
        self.regressor = rows.reshape(len(case.time) * len(LEG_TORQUES), -1)
        """(nf * 14, 120) N·m by the dynamic parameters of the massive segments, in the frames of
        the segments.
        """
        # Poses that the feet have without any disturbance, to which wrenches in foot frames refer.
        self.feet = _compute_foot_poses(_build_leg_dynamics(case.parameters).place(states[0]))
        self.torques, _ = compute_leg_torques(
            case.parameters, self.basis, case.coefficients, case.wrench, self.feet
        )
        """(nf, 14) N·m of the undisturbed case."""
        self.leg_markers = tuple(self._find_leg_markers(side) for side in SIDES)
        """Markers of the right and of the left leg: indices into the order of `data`."""

    def _find_leg_markers(self, side: str) -> IntArray:
        """Find the markers with weight on the segments of a leg."""
        segments = np.array([self.problem.chain.segments[s] for s in self.data.segment])
        of_leg = [segment for segment in LEG_SEGMENTS if segment.endswith(f"_{side}")]
        return np.flatnonzero(np.isin(segments, of_leg) & self.data.weight.any(axis=1))


def _build_undisturbed_problem(case: MonteCarloCase) -> MotionProblem:
    """Build the tracking problem of the markers that the model has in the motion of the case."""
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
        case.name, model, recording, spline.ControlPointRule(fixed=len(case.coefficients))
    )


@dataclass(frozen=True)
class Disturbance:
    """The changes of one draw; None for what its set does not vary."""

    joint: Array | None
    """(np,) m, rad, added to the joint parameters that vary."""
    inertial: Array | None
    """(36,) relative changes of the symmetric inertial parameters: 0.1 is ten per cent more."""
    noise: Array | None
    """(nm, 3, nf) m, added to the markers, in the order of the context's data."""


def draw_disturbance(
    context: MonteCarloContext, varied: Varied, level: int, number: int
) -> Disturbance:
    """Draw the disturbance of one draw at random.

    Parameters
    ----------
    context : MonteCarloContext
        The case.
    varied : Varied
        The set.
    level : int
        Per cent of the bounds.
    number : int
        Of the draw in this set and level: 0, 1, ...

    Returns
    -------
    Disturbance
        The same for the same arguments.
    """
    settings, part = context.settings, level / 100.0
    # Each draw has a separate random stream: results depend neither on order nor on workers.
    rng = np.random.default_rng(
        np.random.SeedSequence(settings.seed, spawn_key=(varied.key, level, number))
    )
    joint = inertial = noise = None
    if varied.joint:
        bounds = settings.joint_bounds
        # m and rad, uniform within the bounds of the settings times the level.
        joint = part * bounds * rng.uniform(-1.0, 1.0, len(bounds))
    if varied.inertial:
        names = context.inertial_set.names
        inertial = part * settings.inertial_percent / 100.0 * rng.uniform(-1.0, 1.0, len(names))
    if varied is Varied.NOISE:
        time, markers = context.case.time, len(context.data.segment)
        # Amplitudes in m; sine waves as in the published noise model.
        waves = draw_marker_noise(
            time - time[0], markers, rng, amplitude=part * 1e-3 * settings.noise_mm
        )
        noise = np.ascontiguousarray(waves.transpose(1, 2, 0))
    return Disturbance(joint, inertial, noise)


def name_torque_column(torque: str, frame: ReactionFrame, measure: str) -> str:
    """Name the column of a torque error (%BW*H).

    Parameters
    ----------
    torque : str
        One of `LEG_TORQUES`.
    frame : ReactionFrame
        Of the ground reactions.
    measure : str
        `rms` or `mean`.

    Returns
    -------
    str
        `hip_flexion_l.lab.rms`.
    """
    return f"{torque}.{frame.value}.{measure}"


def name_marker_column(side: str, measure: str) -> str:
    """Name the column of a marker distance (mm).

    Parameters
    ----------
    side : str
        `r` or `l`.
    measure : str
        `rms` or `mean`.

    Returns
    -------
    str
        `markers_l.rms`.
    """
    return f"markers_{side}.{measure}"


COLUMNS: tuple[str, ...] = (
    *(
        name_torque_column(t, frame, m)
        for frame in ReactionFrame
        for m in MEASURES
        for t in LEG_TORQUES
    ),
    *(name_marker_column(side, m) for m in MEASURES for side in SIDES),
)
"""Columns of a draw: torque errors in %BW*H (mean: signed), marker distances in mm."""


@dataclass(frozen=True)
class DrawResult:
    """The result of one draw."""

    values: Array
    """(60,) in the order of `COLUMNS`; NaN if the draw failed before a motion was found."""
    evaluations: int
    """Evaluations of the gradient in the re-fit; 0 without one."""
    failure: str
    """Why the motion could not be fitted, the values being those of the last motion tried; empty if
    it was fitted.
    """


@with_one_blas_thread
def draw(context: MonteCarloContext, varied: Varied, level: int, number: int) -> DrawResult:
    """Compute one draw.

    Parameters
    ----------
    context : MonteCarloContext
        The case.
    varied : Varied
        The set.
    level : int
        Per cent of the bounds.
    number : int
        Of the draw in this set and level: 0, 1, ...

    Returns
    -------
    DrawResult
        A draw that fails has the reason in `failure`.
    """
    change = draw_disturbance(context, varied, level, number)
    try:
        model = _build_disturbed_model(context, change)
        if varied is Varied.IP:
            # Inertial parameters move no marker: the motion stays, and torques are linear in them.
            phi = compute_dynamic_parameters(model.parameters.inertial)
            change_of_phi = phi - compute_dynamic_parameters(context.case.parameters.inertial)
            errors = (context.regressor @ change_of_phi.ravel()).reshape(-1, len(LEG_TORQUES))
            no_distance = np.zeros(context.data.weight.shape)
            return DrawResult(_record(context, (errors, errors), no_distance), 0, "")
        # Joints and noise change the motion that fits the markers best: track anew, then compute
        # torques.
        fitted = refit(model.problem, model.body, model.start, context.settings, model.factor)
        values = compute_errors(context, model, fitted.coefficients)
        return DrawResult(values, fitted.evaluations, fitted.failure)
    except (np.linalg.LinAlgError, FloatingPointError, ValueError) as error:
        return DrawResult(np.full(len(COLUMNS), np.nan), 0, f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Refit:
    """The result of a re-fit."""

    coefficients: Array
    """(nn, nq) m, rad."""
    evaluations: int
    """Steps, each with an evaluation of the gradient."""
    failure: str
    """Why it did not converge; empty if it did."""


def refit(
    problem: MotionProblem,
    body: LinkageModel,
    start: Array,
    settings: MonteCarloSettings,
    known: banded.BandFactor | None = None,
) -> Refit:
    """Minimise the weighted sum of squared marker distances over the coefficients.

    Parameters
    ----------
    problem : MotionProblem
        The markers to fit; no joint parameter is free.
    body : LinkageModel
        Of the disturbed linkage.
    start : (nn, nq) array
        Coefficients to start from, m and rad.
    settings : MonteCarloSettings
        With tolerance and largest number of steps.
    known : BandFactor, optional
        Factor of the Gauss-Newton matrix at `start`, which does not depend on the markers.

    Returns
    -------
    Refit

    Notes
    -----
    The iteration is that of tracking (`tracking/descent.py`), for many small problems of one kind:
    it starts with a Gauss-Newton factor, keeps it however long the steps are, and continues with
    Newton's steps when they no longer shrink tenfold. It ends by the size of the step, so that all
    draws are solved to the same accuracy.
    """
    # The start is near: one factor is kept throughout, and the size of the steps ends the search.
    rule = descent.DescentSettings(
        gain=0.0,
        shortest_step=settings.refit_tolerance,
        most_steps=settings.refit_most_evaluations,
        keep_within=np.inf,
        curved=True,
    )
    factor = known or banded.BandFactor(problem.assemble_equations(start, body).band)
    tracked = motion.track_coefficients(problem, body, start, rule, factor)
    if tracked.ending is descent.Ending.MOST_STEPS:
        return Refit(tracked.x, tracked.steps, f"{tracked.steps} evaluations did not settle it")
    return Refit(tracked.x, tracked.steps, "" if tracked.converged else tracked.ending.value)


@dataclass(frozen=True)
class DisturbedModel:
    """The case after a disturbance, before the fit of its motion."""

    parameters: Parameters
    problem: MotionProblem
    """The markers that the motion is fitted to."""
    body: LinkageModel
    start: Array
    """(nn, nq) m, rad: the motion to first order in the disturbance."""
    factor: banded.BandFactor | None
    """Of the Gauss-Newton matrix at the start; None if it must be formed."""


def _build_disturbed_model(context: MonteCarloContext, change: Disturbance) -> DisturbedModel:
    """Apply a disturbance to the case.

    `change`: from `draw_disturbance`.
    """
    case = context.case
    parameters, start, problem = case.parameters, case.coefficients, context.problem
    if change.joint is not None:
        parameters = parameters.with_joint(context.names, context.joint_values + change.joint)
        # First-order change of the motion, which saves most of the iterations.
        start = start + context.sensitivity @ change.joint
    if change.inertial is not None:
        # Relative changes, alike for right and left.
        factors = 1.0 + context.inertial_set.selection @ change.inertial
        parameters = parameters.with_inertial(case.parameters.inertial * factors)
    if change.noise is not None:
        problem = problem.with_measured(problem.data.measured + change.noise)
    # Noise leaves the matrix of the equations nearly as it is: its factor is reused.
    known = None if change.joint is not None else context.undisturbed_factor
    return DisturbedModel(parameters, problem, problem.build_body(parameters), start, known)


def compute_errors(context: MonteCarloContext, model: DisturbedModel, coefficients: Array) -> Array:
    """Compute the torque errors and marker distances of a disturbed model.

    Parameters
    ----------
    context : MonteCarloContext
        The case.
    model : DisturbedModel
        The disturbed model.
    coefficients : (nn, nq) array
        Its fitted motion, m and rad.

    Returns
    -------
    (60,) array
        In the order of `COLUMNS`.
    """
    positions = model.problem.compute_positions(coefficients, model.body)
    torques = compute_leg_torques(
        model.parameters, context.basis, coefficients, context.case.wrench, context.feet
    )
    errors = (torques[0] - context.torques, torques[1] - context.torques)
    difference = positions - model.problem.data.measured
    return _record(context, errors, np.sqrt((difference * difference).sum(axis=1)))


def _record(context: MonteCarloContext, errors: tuple[Array, Array], distance: Array) -> Array:
    """Compute (60,) from torque errors (nf, 14) N·m in both frames and distances (nm, nf) m."""
    valid, to_percent = context.case.valid, 100.0 / context.case.subject.bwh
    out: list[Array] = []
    for error in errors:
        kept = to_percent * error[valid]
        out += [np.sqrt((kept * kept).mean(axis=0)), kept.mean(axis=0)]
    of_legs = [1e3 * distance[markers] for markers in context.leg_markers]
    out.append(np.array([np.sqrt((d * d).mean()) if d.size else np.nan for d in of_legs]))
    out.append(np.array([d.mean() if d.size else np.nan for d in of_legs]))
    return np.concatenate(out)
