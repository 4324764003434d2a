"""Inertial parameters from the pelvis residual: phase 2 (Reinbolt et al. 2007, eq. 2).

    min_p  sum_frames { |F|^2 / BW^2 + |T|^2 / L^2 } + sum_n ((p_n - p'_n) / s_n)^2

F, T are the root wrench that no ground reaction explains, in laboratory axes about the pelvis
origin; L = BW * H (or another scale); p' is the seed. F and T are linear in the dynamic parameters
phi(p) = (m, m c, I_origin) of the bodies. A QR factorisation of their regressor compresses the rows
of all valid frames once to at most 121 rows. Their norm is that of the full residual exactly, and
the iteration needs no frames.

`published`: s_n = p'_n. The result is the next seed until the residuals change by less than 0.1 %.
The fixed points of this proximal-point iteration are those of the residual alone, for every weight
w of the penalty. Along a direction with singular value s of the scaled residual, each seed keeps w
/ (w + s^2) of the distance. With s^2 down to 1e-11 it stops before it arrives, which keeps weak
directions of measured data near the first seed. For data without noise, w is lowered at every seed
(`decay`): same fixed points, quickly reached.

`consistent`: every body stays physically possible, total mass and left-right symmetry are exact.
The variables x are 0 at the seed. Masses are shares of the seed's total, m_k = M m_k^0 exp(x) /
sum; mass centres are displaced by x; the second moments of mass about the mass centre, sum x_i^2,
are multiplied by exp(x). Moments of inertia are sums of two second moments each, so they are
positive and obey the triangle inequality: the pseudo-inertia stays positive definite (Wensing, Kim
and Slotine 2017; for fixed axes of a body, its log-Cholesky parameters are these logarithms). s_n
is the spread of people about the anthropometric table. The noise of F / BW and T / (BW L) is the
residual of the fit, by iteration (feasible generalised least squares), and at least the measurement
error. `inertial_evidence.py` is the default.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.joint_estimate import describe_ending
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model import parameters as params
from gaitcal.model.subject_model import Subject
from gaitcal.tracking.motion import Motion

RESEED_CHANGE = 1e-3
"""The published stop: RMS residuals change by less than 0.1 %."""
# re-seeds and repetitions before a fit counts as not converged
MOST_SEEDS = 200
NOISE_CHANGE = 1e-3
"""Relative change of the pelvis residual's noise at which the repetition stops."""


@dataclass(frozen=True, kw_only=True)
class ConsistentSettings:
    """Spread of people about the anthropometric table, and noise of a root wrench."""

    mass_spread: float = 0.10
    """Standard deviation of the logarithm of a segment's share of body mass."""
    foot_mass_spread: float = 0.30
    """The same of a foot, some 1 kg, which tables have bare: a shoe adds 0.3 to 0.4 kg.
    (Predictions from tables err by up to 40 % on some segment: Durkin and Dowling, J Biomech Eng
    125:515, 2003.)"""
    centre_spread: float = 0.010
    """m, standard deviation of a mass-centre coordinate."""
    foot_centre_spread: float = 0.015
    """The same of a foot. Its axes are defined by markers on heel and toe, which are 10 mm off the
    points of the table.
    """
    moment_spread: float = 0.15
    """Standard deviation of the logarithm of a second moment of mass."""
    more_of: Mapping[str, float] = field(default_factory=dict)
    """Parameter without its side (`thigh.mass`) -> standard deviation of its variable beside that
    of people: of a table that may not be this person's."""
    residual: float = 0.01
    """Least standard deviation of F / BW and T / (BW L) by errors of measurement and motion."""
    independent: float = 10.0
    """Frames per independent sample: neighbouring frames of a residual repeat each other."""


PEOPLE = ConsistentSettings()


class LogChart:
    """Chart of the IPs by variables x, 0 at the seed.

    Masses change by softmax, mass centres by displacement, second moments by a factor exp(x).
    """

    def __init__(self, seed: Array, which: params.InertialSet) -> None:
        if not params.is_physical(seed).all():
            raise ValueError(
                "the seed of a physically consistent calibration must itself be physically possible"
            )
        self.names, self.size = which.names, len(which.names)
        self.rows = params.view_as_table(seed)
        kinds = [name.split(".", 1)[1] for name in which.names]
        self.kind = np.array([{"mass": 0, "com": 1, "moi": 2}[k.split(".")[0]] for k in kinds])
        self.selection = which.selection
        self.unsided = tuple(name.replace("_r.", ".").replace("_l.", ".") for name in which.names)
        self.of_foot = np.array([name.startswith("foot") for name in which.names])
        moments = self.rows[:, 4:7]
        self.second = 0.5 * moments.sum(axis=1, keepdims=True) - moments
        """(12, 3) second moments of mass about the mass centre along each axis."""

    def compute_spread(self, settings: ConsistentSettings) -> Array:
        """Compute the prior standard deviation (n,) of each variable."""
        of_others = [settings.mass_spread, settings.centre_spread, settings.moment_spread]
        of_feet = [settings.foot_mass_spread, settings.foot_centre_spread, settings.moment_spread]
        of_people = np.where(
            self.of_foot, np.array(of_feet)[self.kind], np.array(of_others)[self.kind]
        )
        return np.hypot(of_people, [settings.more_of.get(name, 0.0) for name in self.unsided])

    def compute_inertial(self, x: Array) -> Array:
        """Compute the inertial parameters (84,), SI units, at the variables x (n,)."""
        changes = params.view_as_table(self.selection @ x)
        raw, second = self.rows[:, 0] * np.exp(changes[:, 0]), self.second * np.exp(changes[:, 4:7])
        out = np.empty(self.rows.shape)
        out[:, 0] = raw * (self.rows[:, 0].sum() / raw.sum())
        out[:, 1:4] = self.rows[:, 1:4] + changes[:, 1:4]
        out[:, 4:7] = second.sum(axis=1, keepdims=True) - second
        return out.ravel()

    def compute_jacobian(self, x: Array) -> Array:
        """Compute the derivative (84, n) of `compute_inertial` at x (n,)."""
        mass = params.view_as_table(self.compute_inertial(x))[:, 0]
        second = self.second * np.exp(params.view_as_table(self.selection @ x)[:, 4:7])
        by_change = np.zeros((*self.rows.shape, *self.rows.shape))
        by_change[:, 0, :, 0] = np.diag(mass) - np.outer(mass, mass / mass.sum())
        for s in range(len(self.rows)):
            by_change[s, 1:4, s, 1:4] = np.eye(3)
            by_change[s, 4:7, s, 4:7] = (1.0 - np.eye(3)) * second[s]
        return by_change.reshape(self.rows.size, -1) @ self.selection


class TorqueScale(Enum):
    """Length L/BW that normalises residual torques (three choices of the paper's discussion)."""

    BODY_HEIGHT = "bwh"
    PELVIS_WIDTH = "pelvis_width"
    MILLIMETRE = "1mm"


@dataclass(frozen=True, kw_only=True)
class RootEquations:
    """Root wrench of all valid frames, linear in the dynamic parameters, compressed."""

    factor: Array
    """(n, 120) rows of R."""
    target: Array
    """(n,) the ground reactions' part, Q^T w, in the same rows."""
    frames: int
    force_rows: Array
    """(n_f, 121) the same for force alone, unscaled (N), for reporting."""
    moment_rows: Array
    """(n_m, 121) the same for moment alone (N·m)."""

    def compute_rms(self, inertial: Array) -> tuple[float, float]:
        """Compute the RMS residual force (N) and moment (N·m) over frames and components.

        Parameters
        ----------
        inertial : (84,) array
            Inertial parameters, SI units.

        Returns
        -------
        tuple of float
            RMS force (N) and RMS moment (N·m).
        """
        phi = np.append(params.compute_dynamic_parameters(inertial).ravel(), 1.0)
        count = np.sqrt(3.0 * self.frames)
        force, moment = (
            np.linalg.norm(self.force_rows @ phi),
            np.linalg.norm(self.moment_rows @ phi),
        )
        return float(force / count), float(moment / count)


def compress_root_equations(
    regressor: Array, ground: Array, weight: float, length: float
) -> RootEquations:
    """Compress the root wrench of the valid frames.

    `regressor`: (nf, 6, 12, 10) result of `Dynamics.compute_root_regressor`. `ground`: (nf, 6)
    contribution of the ground reactions: force (N) and moment (N·m) about the pelvis origin.
    `weight`: body weight, N. `length`: torques are divided by weight * length, m. Returns: at most
    121 rows with the same norm.
    """
    nf = len(regressor)
    rows = np.concatenate([regressor.reshape(nf, 6, -1), ground[:, :, None]], axis=2)
    width = rows.shape[2]
    # triangular rows with the same norm in every direction
    parts = (part.reshape(3 * nf, width) for part in (rows[:, :3], rows[:, 3:]))
    force, moment = (np.asarray(np.linalg.qr(part, mode="r")) for part in parts)
    stacked = np.asarray(
        np.linalg.qr(np.vstack([force / weight, moment / (weight * length)]), mode="r")
    )
    return RootEquations(
        factor=stacked[:, :-1],
        target=stacked[:, -1],
        frames=nf,
        force_rows=force,
        moment_rows=moment,
    )


@dataclass(frozen=True, kw_only=True)
class LoadedMotion:
    """A motion with ground reactions on the feet."""

    state: tuple[Array, Array, Array]
    """(nf, 27) each: coordinates (m, rad), their rates and accelerations."""
    wrench: Array
    """(nf, 2, 6) about the laboratory origin."""
    valid: BoolArray
    """(nf,)."""

    @staticmethod
    def from_motion(motion: Motion, reactions: GroundReactions) -> "LoadedMotion":
        """Combine a tracked motion with its ground reactions.

        Parameters
        ----------
        motion : Motion
            The tracked motion.
        reactions : GroundReactions
            Ground reactions on the feet.

        Returns
        -------
        LoadedMotion
            States (m, rad and rates) and wrenches (N, N·m).
        """
        state = motion.q, motion.velocity, motion.acceleration
        return LoadedMotion(state=state, wrench=reactions.wrench, valid=reactions.valid)


def get_torque_length(subject: Subject, scale: TorqueScale, pelvis_width: float) -> float:
    """Get the length L (m) of a torque scale.

    Parameters
    ----------
    subject : Subject
        Height of the person.
    scale : TorqueScale
        The scale.
    pelvis_width : float
        Distance between the hip centres, m.

    Returns
    -------
    float
        m.
    """
    return {
        TorqueScale.BODY_HEIGHT: subject.height,
        TorqueScale.PELVIS_WIDTH: pelvis_width,
        TorqueScale.MILLIMETRE: 1e-3,
    }[scale]


def assemble_root_equations(
    motions: Sequence[LoadedMotion],
    parameters: params.Parameters,
    subject: Subject,
    scale: TorqueScale,
    pelvis_width: float,
) -> RootEquations:
    """Assemble the pelvis residual of all valid frames of all trials.

    Parameters
    ----------
    motions : sequence of LoadedMotion
        Motions with ground reactions.
    parameters : Parameters
        Joint parameters of the linkage.
    subject : Subject
        Weight and height of the person.
    scale : TorqueScale
        Length that normalises torques.
    pelvis_width : float
        Distance between the hip centres, m.

    Returns
    -------
    RootEquations
        Linear in the dynamic parameters.
    """
    length = get_torque_length(subject, scale, pelvis_width)
    dynamics = Dynamics(parameters)
    regressors, grounds = [], []
    for motion in motions:
        at = motion.valid
        q, v, a = (x[at] for x in motion.state)
        regressors.append(dynamics.compute_root_regressor(q, v, a))
        total = motion.wrench[at].sum(axis=1)
        about_pelvis = total[:, 3:] - np.cross(q[:, :3], total[:, :3])
        grounds.append(-np.hstack([total[:, :3], about_pelvis]))
    return compress_root_equations(
        np.concatenate(regressors), np.concatenate(grounds), subject.weight, length
    )


@dataclass(frozen=True, kw_only=True)
class InertialFit:
    """Result of a fit of inertial parameters."""

    names: tuple[str, ...]
    """Of the free variables."""
    inertial: Array
    """(84,) SI."""
    jacobian: Array
    """(84, n) of the IPs by the variables at the solution, for uncertainties."""
    residual_jacobian: Array
    """(rows, n) of residuals and penalties by the variables at the solution."""
    rms_force: float
    """N."""
    rms_moment: float
    """N·m."""
    seeds: int = 1
    """How often the result became the next seed (1: a single pass)."""
    iterations: int
    seconds: float
    converged: bool
    message: str
    statistical: bool = True
    """Whether residual rows are in standard deviations, so that a covariance follows; the published
    ones are not.
    """
    moved: bool = True
    """False: the values are the seed's, and the covariance is the spread of people about them."""


def fit_published(
    equations: RootEquations,
    seed: Array,
    which: params.InertialSet,
    *,
    reseed: bool = True,
    decay: float = 1.0,
) -> InertialFit:
    """Fit the published cost: relative penalties, re-seeded until the residuals are stationary.

    Parameters
    ----------
    equations : RootEquations
        The pelvis residual.
    seed : (84,) array
        Start values, also of the parameters that stay constant.
    which : InertialSet
        Free variables.
    reseed : bool
        Whether to repeat with the result as the next seed.
    decay : float
        Factor of the penalty's weight at every re-seed: 1 as published, 0.1 for data without noise.

    Returns
    -------
    InertialFit
        Without statistical meaning of its residual Jacobian.
    """
    began = time.perf_counter()
    inertial, centre = seed.copy(), seed
    s = which.selection
    norm = (s * s).sum(axis=0)

    def residual(x: Array, base: Array, scale: Array, prior: Array, root: float) -> Array:
        gap = (
            equations.factor @ params.compute_dynamic_parameters(base + s @ (x * scale)).ravel()
            + equations.target
        )
        return np.concatenate([gap, root * (x - prior / scale)])

    def jacobian(x: Array, base: Array, scale: Array, _prior: Array, root: float) -> Array:
        by_ip = differentiate_by_inertial(equations.factor, base + s @ (x * scale))
        return np.vstack([by_ip @ s * scale, root * np.eye(len(x))])

    rms, seeds, iterations, penalty, stopped = equations.compute_rms(inertial), 0, 0, 1.0, False
    while seeds < MOST_SEEDS and not stopped:
        prior, last = s.T @ centre / norm, rms
        scale = np.where(np.abs(prior) > 0, np.abs(prior), 1.0)
        base = inertial - s @ (s.T @ inertial / norm)
        given = base, scale, prior, float(np.sqrt(penalty))
        begin = s.T @ inertial / norm / scale
        result = least_squares(
            residual,
            begin,
            jac=jacobian,
            args=given,
            method="lm",
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
        )
        inertial = centre = base + s @ (result.x * scale)
        seeds, iterations, penalty = seeds + 1, iterations + int(result.nfev), penalty * decay
        rms = equations.compute_rms(inertial)
        settled = all(
            abs(new - old) <= RESEED_CHANGE * old or new < 1e-9
            for new, old in zip(rms, last, strict=True)
        )
        stopped = settled or not reseed
    return InertialFit(
        names=which.names,
        inertial=inertial,
        jacobian=s,
        residual_jacobian=jacobian(result.x, *given) / scale,
        rms_force=rms[0],
        rms_moment=rms[1],
        seeds=seeds,
        iterations=iterations,
        seconds=time.perf_counter() - began,
        converged=stopped and bool(result.status > 0),
        message=describe_ending(result)
        if stopped
        else f"the residuals still change after {MOST_SEEDS} seeds",
        statistical=False,
    )


def differentiate_by_inertial(factor: Array, inertial: Array) -> Array:
    """Differentiate factor @ dynamic parameters by the inertial parameters: (n, 84)."""
    blocks = factor.reshape(len(factor), -1, 10)
    return np.einsum("rsd,sdk->rsk", blocks, params.compute_dynamic_jacobian(inertial)).reshape(
        len(factor), len(params.IP_NAMES)
    )


def fit_consistent(
    equations: RootEquations,
    seed: Array,
    which: params.InertialSet,
    settings: ConsistentSettings = PEOPLE,
) -> InertialFit:
    """Fit physically possible inertias with the total mass of the seed.

    Parameters
    ----------
    equations : RootEquations
        The pelvis residual.
    seed : (84,) array
        Start values, SI units.
    which : InertialSet
        Free variables.
    settings : ConsistentSettings
        Spread of people, and noise.

    Returns
    -------
    InertialFit
        With the noise as the fit leaves it.
    """
    began = time.perf_counter()
    chart = LogChart(seed, which)
    x, noise, iterations = np.zeros(chart.size), settings.residual, 0
    for _ in range(MOST_SEEDS):
        weight = 1.0 / (noise * np.sqrt(settings.independent))
        result, slopes = fit_chart(equations, chart, chart.compute_spread(settings), weight, x)
        x, iterations = result.x, iterations + int(result.nfev)
        gap = (
            equations.factor @ params.compute_dynamic_parameters(chart.compute_inertial(x)).ravel()
            + equations.target
        )
        last, noise = (
            noise,
            max(settings.residual, float(np.linalg.norm(gap) / np.sqrt(6.0 * equations.frames))),
        )
        if abs(noise - last) < NOISE_CHANGE * last:
            break
    return replace(
        make_inertial_fit(equations, chart, result, slopes, began), iterations=iterations
    )


def make_inertial_fit(
    equations: RootEquations,
    chart: LogChart,
    result: OptimizeResult,
    slopes: Callable[[Array], Array],
    began: float,
) -> InertialFit:
    """Make the result of a search by `fit_chart` that began at a time of `perf_counter`."""
    inertial = chart.compute_inertial(result.x)
    rms_force, rms_moment = equations.compute_rms(inertial)
    return InertialFit(
        names=chart.names,
        inertial=inertial,
        jacobian=chart.compute_jacobian(result.x),
        residual_jacobian=slopes(result.x),
        rms_force=rms_force,
        rms_moment=rms_moment,
        iterations=int(result.nfev),
        seconds=time.perf_counter() - began,
        converged=bool(result.status > 0),
        message=describe_ending(result),
    )


def fit_chart(
    equations: RootEquations, chart: LogChart, spread: Array, weigh: float | Array, start: Array
) -> tuple[OptimizeResult, Callable[[Array], Array]]:
    """Minimise |weigh gap|^2 + |x / spread|^2 over the variables of a chart.

    Parameters
    ----------
    equations : RootEquations
        The pelvis residual.
    chart : LogChart
        Variables x.
    spread : (n,) array
        Prior standard deviations of x.
    weigh : float or (k, rows) array
        Weight of the gap.
    start : (n,) array
        Start of the search.

    Returns
    -------
    tuple
        SciPy's result, and a function for the Jacobian of the residual at x.
    """

    def residual(x: Array) -> Array:
        gap = (
            equations.factor @ params.compute_dynamic_parameters(chart.compute_inertial(x)).ravel()
            + equations.target
        )
        return np.concatenate([np.dot(weigh, gap), x / spread])

    def jacobian(x: Array) -> Array:
        by_x = differentiate_by_inertial(
            equations.factor, chart.compute_inertial(x)
        ) @ chart.compute_jacobian(x)
        return np.vstack([np.dot(weigh, by_x), np.diag(1.0 / spread)])

    return least_squares(
        residual, start, jac=jacobian, method="lm", ftol=1e-13, xtol=1e-13
    ), jacobian
