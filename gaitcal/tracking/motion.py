"""Tracking of one or several trials, and the resulting motion with its marker distances.

Two problems for `descend`: one trial with fixed joint parameters, whose x are the spline
coefficients and whose matrix is a band; and several trials with shared joint parameters, whose
matrix is an arrow (`banded.py`). Undamped Gauss-Newton steps from rigid fits nearly always
converge; markers that stay far from the model need Newton's method.

Robust tracking reduces the weights of outliers, sample by sample. Instead of  sum w |r|^2  the cost
is  s^2 sum rho(u),  u = sqrt(w) |r| / s,  with |r| the distance of a marker from the model. Its
minimum is that of least squares with weights w f(u), f = rho'(u) / (2 u), iterated until the
weights settle (Holland and Welsch 1977):

    Huber    f = min(1, k / u)            convex, one minimum; outliers keep a constant force
    Cauchy   f = 1 / (1 + (u / c)^2)      outliers lose their force; started from Huber's solution,
                                          as there may be several minima

k and c keep 95 % efficiency if the three coordinates of a residual are Gaussian. The scale s of one
coordinate is 1.4826 times the median absolute deviation of the coordinates from zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray, compute_rms
from gaitcal.display import Displayed, describe_time, shorten
from gaitcal.io.recording import Recording
from gaitcal.model.chain import LinkageModel
from gaitcal.model.linkage import FILE_COORDINATES, is_translation
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.tracking.banded import ArrowEquations, BandFactor
from gaitcal.tracking.descent import Descent, DescentSettings, Evaluation, descend
from gaitcal.tracking.rigid import compute_rigid_distances
from gaitcal.tracking.spline import (
    HALF_POWER,
    ControlPointRule,
    SplineBasis,
    compute_cutoff,
    compute_frame_rate,
)
from gaitcal.tracking.start import find_start_coefficients
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem

if TYPE_CHECKING:
    import pandas as pd

LARGE_MATRIX_BYTES = 2**27
"""Bytes of a normal matrix above which only one is held at a time: about 20 000 frames."""
NEGLIGIBLE_RMS_M = 1e-14
"""m, RMS residual below which a fit is exact."""


def track_coefficients(
    problem: MotionProblem,
    body: LinkageModel,
    start: Array,
    settings: DescentSettings | None = None,
    known: BandFactor | None = None,
) -> Descent[Evaluation, BandFactor]:
    """Minimise the weighted sum of squared marker distances over the coefficients.

    Parameters
    ----------
    problem
        The trial.
    body
        Its linkage, with fixed joint parameters.
    start
        (nn, nq) coefficients at the start.
    settings
        Tolerances.
    known
        Factor of a matrix that serves at `start`, if there is one. It does not depend on the
        measured positions.

    Returns
    -------
    Descent
        x: (nn, nq) coefficients, m and rad. The factor is not kept.
    """
    end = descend(_Tracking(problem, body), start.ravel(), settings or DescentSettings(), known)
    # a large factor makes room
    return replace(end, x=end.x.reshape(start.shape), factor=None)


class _Tracking:
    """Marker cost of a trial as a function of its coefficients; joint parameters are fixed."""

    def __init__(self, problem: MotionProblem, body: LinkageModel) -> None:
        self.problem, self.body = problem, body
        self.nothing_left = NEGLIGIBLE_RMS_M**2 * float(problem.data.weight.sum())
        self.has_curvature = not problem.chain.free

    def coefficients(self, x: Array) -> Array:
        return x.reshape(self.problem.basis.control_points, -1)

    def evaluate(self, x: Array) -> Evaluation:
        cost, gradient = self.problem.compute_gradient(self.coefficients(x), self.body)
        return Evaluation(cost, gradient.ravel())

    def linearise(self, x: Array, *, curved: bool) -> "_TrackingMatrix":
        return _TrackingMatrix(self, x, curved)


class _TrackingMatrix:
    """Normal equations at some coefficients. A large matrix is factorised in place."""

    def __init__(self, tracking: _Tracking, x: Array, curved: bool) -> None:
        self._form = partial(
            tracking.problem.assemble_motion_equations,
            tracking.coefficients(x),
            tracking.body,
            curved=curved,
        )
        equations = self._form()
        self.evaluation = Evaluation(equations.cost, equations.node_gradient.ravel())
        self._band: Array | None = equations.band
        self.spent = equations.band.nbytes > LARGE_MATRIX_BYTES

    def factor(self, damping: float) -> BandFactor:
        band = self._form().band if self._band is None else self._band
        if not self.spent:
            return BandFactor(band, damping)
        self._band = None
        try:
            return BandFactor(band, damping, overwrite=True)
        except np.linalg.LinAlgError:
            # with a copy: a larger floor may do
            return BandFactor(self._form().band, damping)


class SharedMotions:
    """Marker cost of several trials by x = (joint parameters, coefficients of each trial).

    A problem for `descend`.
    """

    has_curvature = False

    def __init__(
        self, problems: Sequence[MotionProblem], parameters: Parameters, free: tuple[str, ...]
    ) -> None:
        self.parameters, self.free, self.size = parameters, free, len(free)
        self.open = [problem.with_free(free) for problem in problems]
        self.columns = [problem.locate_in(free) for problem in self.open]
        self.nothing_left = NEGLIGIBLE_RMS_M**2 * sum(
            float(problem.data.weight.sum()) for problem in self.open
        )

    def join_unknowns(self, p: Array, coefficients: Sequence[Array]) -> Array:
        """Join parameters (np,) and coefficients (nn, nq) of each trial into x."""
        return np.concatenate([p, *(of_trial.ravel() for of_trial in coefficients)])

    def split_unknowns(self, x: Array) -> tuple[Array, list[Array]]:
        """Split x into joint parameters and coefficients.

        Parameters
        ----------
        x
            (n,) all unknowns.

        Returns
        -------
        (np,) array
            Joint parameters.
        list of (nn, nq) arrays
            Coefficients of each trial.
        """
        sizes = [
            self.size,
            *(
                problem.basis.control_points * len(problem.chain.coordinates)
                for problem in self.open
            ),
        ]
        p, *coefficients = np.split(x, np.cumsum(sizes)[:-1])
        return p, [
            flat.reshape(problem.basis.control_points, -1)
            for flat, problem in zip(coefficients, self.open, strict=True)
        ]

    def evaluate(self, x: Array) -> Evaluation:
        """Compute cost (m^2) and half gradient."""
        return self.linearise(x, curved=False).evaluation

    def linearise(self, x: Array, *, curved: bool) -> ArrowEquations:
        """Compute cost, half gradient and arrow matrix."""
        p, coefficients = self.split_unknowns(x)
        moved = self.parameters.with_joint(self.free, p)
        trials = [
            problem.assemble_equations(n, problem.build_body(moved))
            for problem, n in zip(self.open, coefficients, strict=True)
        ]
        return ArrowEquations(trials, self.columns, self.size)


@dataclass(frozen=True, repr=False)
class MarkerErrors(Displayed):
    """Distances between measured and model markers."""

    labels: tuple[str, ...]
    segments: tuple[str, ...]
    weight: Array  # (nm,) of each marker in the fit (its largest over the frames)
    distance: Array  # (nf, nm) m; NaN where a marker is not visible

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        rms, largest = self.rms(), self.find_largest()
        rows = [] if rms is None else [("RMS", f"{1e3 * rms:.1f} mm")]
        if largest is not None:
            rows.append(("largest", f"{1e3 * largest[0]:.0f} mm ({largest[1]})"))
        return f"Distances of {len(self.labels)} markers, {len(self.distance)} frames", rows

    def rms(self, *segments: str) -> float | None:
        """Compute the RMS distance over markers with weight.

        Parameters
        ----------
        *segments
            Segments to include; all unless given.

        Returns
        -------
        float or None
            m; None where there is no such marker.
        """
        kept = self.select_observed(*segments)
        if not kept.any():
            return None
        return float(compute_rms(self.distance[:, kept]))

    def compute_rms_by_frame(self) -> Array:
        """Compute the RMS distance (nf,) m over markers with weight; NaN where none is visible."""
        return compute_rms(self.distance[:, self.weight > 0], axis=1)

    def compute_rms_by_marker(self) -> Array:
        """Compute the RMS distance (nm,) m of each marker; NaN if it is never visible."""
        return compute_rms(self.distance, axis=0)

    def select_observed(self, *segments: str) -> BoolArray:
        """Select the markers with weight that were observed in any frame.

        Parameters
        ----------
        *segments
            Segments to include; all unless given.

        Returns
        -------
        (nm,) array of bool
        """
        visible = np.isfinite(self.distance).any(axis=0)
        here = np.array([not segments or s in segments for s in self.segments], dtype=bool)
        return (self.weight > 0) & visible & here

    def find_largest(self) -> tuple[float, str] | None:
        """Find the largest distance over markers with weight.

        Returns
        -------
        tuple of (float, str) or None
            m, and the label of the marker; None without such a marker.
        """
        kept = np.flatnonzero(self.select_observed())
        if not len(kept):
            return None
        peaks = np.nanmax(self.distance[:, kept], axis=0)
        return float(peaks.max()), self.labels[kept[int(peaks.argmax())]]


def select_static_offsets(relative_to: Mapping[str, float] | None) -> dict[str, float]:
    """Select the joint angles of the static posture that relative angles leave out.

    Parameters
    ----------
    relative_to
        Coordinate -> rad in the static posture; None: no angles.

    Returns
    -------
    dict
        Coordinate -> rad, without those of the pelvis, which stay anatomical.
    """
    return {
        name: angle for name, angle in (relative_to or {}).items() if not name.startswith("pelvis")
    }


@dataclass(frozen=True, kw_only=True, repr=False)
class Motion(Displayed):
    """Coordinates of one trial as splines, with its marker distances."""

    name: str
    """Of the trial or file."""
    coordinates: tuple[str, ...]
    """Names of the columns: the 27, or those of the part that was tracked."""
    basis: SplineBasis
    """Quintic B-splines at the frames of the trial."""
    coefficients: Array
    """(nn, nq) m, rad."""
    errors: MarkerErrors
    """Distance of every marker in every frame."""
    converged: bool
    """Whether tracking reached its tolerance."""
    smoothed_hz: float | None = None
    """Half of an oscillation at it passed the penalty; None: the nodes alone limit the motion."""
    guessed: tuple[str, ...] = ()
    """Coordinates that the markers do not determine, and a prior holds."""

    def columns(
        self, errors: Array | None = None, relative_to: Mapping[str, float] | None = None
    ) -> dict[str, Array]:
        """Collect the columns of the motion's CSV file.

        Parameters
        ----------
        errors
            (nf, nq) m, rad: standard errors of the coordinates.
        relative_to
            Coordinate -> rad in the static posture, subtracted from joint angles; None: angles are
            anatomical.

        Returns
        -------
        `time` (s), then every coordinate (deg, m), its `_velocity` and `_acceleration` and, with
        `errors`, its standard error `_se`.
        """
        names = [name for name in FILE_COORDINATES if name in self.coordinates]
        static = select_static_offsets(relative_to)
        parts = {"": self.q, "_velocity": self.velocity, "_acceleration": self.acceleration}
        parts[""] = self.q - np.array([static.get(name, 0.0) for name in self.coordinates])
        if errors is not None:
            parts["_se"] = errors
        columns = {"time": self.time}
        for suffix, values in parts.items():
            for name in names:
                scale = 1.0 if is_translation(name) else 180.0 / np.pi
                columns[name + suffix] = values[:, self.coordinates.index(name)] * scale
        return columns

    def to_dataframe(self, relative_to: Mapping[str, float] | None = None) -> "pd.DataFrame":
        """Return the motion as a table, as in `motion/TRIAL.csv` but without standard errors.

        Parameters
        ----------
        relative_to
            Coordinate -> rad in the static posture, subtracted from joint angles; None: angles are
            anatomical.

        Returns
        -------
        pandas.DataFrame
            `time` (s), then every coordinate (deg, m), its `_velocity` and its `_acceleration`.
        """
        import pandas as pd

        return pd.DataFrame(self.columns(relative_to=relative_to))

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        time, rms, largest = self.time, self.errors.rms(), self.errors.find_largest()
        met = "no marker" if rms is None else f"RMS {1e3 * rms:.1f} mm"
        if largest is not None:
            met += f", largest {1e3 * largest[0]:.0f} mm ({largest[1]})"
        rows = [
            (
                "time",
                describe_time(
                    len(time),
                    compute_frame_rate(self.basis),
                    float(np.ptp(time)) if len(time) else 0.0,
                ),
            ),
            ("coordinates", f"{len(self.coordinates)}: {shorten(self.coordinates)}"),
            ("markers", f"{len(self.errors.labels)}, distance {met}"),
            ("bandwidth", f"{self.cutoff_hz:.1f} Hz (-3 dB)"),
        ]
        if not self.converged:
            rows.append(("converged", "no"))
        if self.guessed:
            rows.append(("from the prior", shorten(self.guessed)))
        return f"Motion of {self.name}", rows[:5]

    @property
    def cutoff_hz(self) -> float:
        """Hz at which 71 % (-3 dB) of an oscillation is in the motion."""
        return (
            compute_cutoff(self.time, self.basis.control_points)
            if self.smoothed_hz is None
            else HALF_POWER * self.smoothed_hz
        )

    @property
    def time(self) -> Array:
        """(nf,) s."""
        return self.basis.time

    @property
    def q(self) -> Array:
        """(nf, nq) coordinates, m and rad."""
        return self.basis.evaluate(self.coefficients)

    @property
    def velocity(self) -> Array:
        """(nf, nq) m/s, rad/s."""
        return self.basis.evaluate(self.coefficients, 1)

    @property
    def acceleration(self) -> Array:
        """(nf, nq) m/s^2, rad/s^2."""
        return self.basis.evaluate(self.coefficients, 2)


def build_motion(
    problem: MotionProblem, parameters: Parameters, coefficients: Array, *, converged: bool = True
) -> Motion:
    """Build the motion of given coefficients, with the distances of every marker.

    Parameters
    ----------
    problem
        The trial.
    parameters
        Joint parameters of the model.
    coefficients
        (nn, nq) m, rad.
    converged
        Whether tracking reached its tolerance.

    Returns
    -------
    Motion
    """
    positions = problem.compute_positions(coefficients, problem.build_body(parameters))
    distance = np.linalg.norm(positions - problem.data.measured, axis=1).T
    return Motion(
        name=problem.name,
        coordinates=problem.chain.coordinates,
        basis=problem.basis,
        coefficients=coefficients,
        errors=_build_marker_errors(problem, distance),
        converged=converged,
        smoothed_hz=problem.smoothing.cutoff_hz if problem.smoothing else None,
        guessed=problem.guessed,
    )


def track_motion(
    problem: MotionProblem, parameters: Parameters, settings: DescentSettings | None = None
) -> Motion:
    """Track one trial from rigid fits.

    Parameters
    ----------
    problem
        The trial.
    parameters
        Joint parameters of the model.
    settings
        Tolerances.

    Returns
    -------
    Motion
    """
    body = problem.build_body(parameters)
    start = find_start_coefficients(body, problem.data, problem.basis)
    tracked = track_coefficients(problem, body, start, settings)
    again = problem.follow_pelvis(tracked.x)
    # what an undetermined trunk does hangs on the pelvis, which is known now
    if again is not problem:
        tracked = track_coefficients(again, body, tracked.x, settings)
    return build_motion(problem, parameters, tracked.x, converged=tracked.converged)


def compute_rigid_floor(problem: MotionProblem) -> MarkerErrors:
    """Compute marker distances when each segment follows its markers, without joints.

    Returns
    -------
    MarkerErrors
        No linkage of these segments can do better.
    """
    data = problem.data
    distance = np.full((data.weight.shape[1], len(problem.labels)), np.nan)
    for s in np.unique(data.segment).tolist():
        on = np.flatnonzero(data.segment == s)
        local = data.local[on] if data.shift is None else data.local[on, :, None] + data.shift[on]
        distance[:, on] = compute_rigid_distances(local, data.measured[on], data.weight[on]).T
    return _build_marker_errors(problem, distance)


def _build_marker_errors(problem: MotionProblem, distance: Array) -> MarkerErrors:
    data = problem.data
    missing = ~data.measured.any(axis=1).T
    segments = tuple(problem.chain.segments[s] for s in data.segment)
    return MarkerErrors(
        problem.labels, segments, data.weight.max(axis=1), np.where(missing, np.nan, distance)
    )


@with_one_blas_thread
def track(
    model: SubjectModel, recording: Recording, *, rule: ControlPointRule | None = None
) -> Motion:
    """Track the markers of a recording with a person's model.

    27 quintic splines bring the model's markers nearest to the measured ones, over all frames at
    once.

    Parameters
    ----------
    model
        The person's model, nominal or calibrated.
    recording
        Markers in m, y up; gaps are NaN and get no weight.
    rule
        Number of spline coefficients; 20 spans a second unless given (`NODES_PER_SECOND`).

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        Too few markers of a segment are visible, or the recording is too short.
    """
    problem = build_trial_problem(recording.source, model, recording, rule or ControlPointRule())
    return track_motion(problem, model.parameters)


HUBER_K = 1.7
"""k of the Huber loss, for 95 % efficiency."""
CAUCHY_C = 2.8
"""c of the Cauchy loss, for 95 % efficiency."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian in units of its median absolute deviation."""
MIN_SCALE_M = 0.0005
"""m, least scale: residuals of half a millimetre are measurement noise, however good the fit."""
SETTLED_CHANGE = 0.02
"""Largest change of a factor at which the iteration ends."""
MOST_ROUNDS = 30
"""Largest number of reweighting rounds."""
FIRST_ROUNDS = 4
"""Rounds of the Huber loss before those of the Cauchy loss."""
OUTLIER_FACTOR = 0.25
"""Factor below which a sample is practically left out: beyond sqrt(3) c scales for Cauchy, 4 k for
Huber."""


class Loss(Enum):
    """Loss function of the residuals."""

    HUBER = "huber"
    CAUCHY = "cauchy"

    def compute_factor(self, u: Array) -> Array:
        """Compute f(u) in (0, 1]: the share of its weight that a sample `u` scales away keeps."""
        if self is Loss.HUBER:
            return np.minimum(1.0, HUBER_K / np.maximum(u, 1e-300))
        return 1.0 / (1.0 + (u / CAUCHY_C) ** 2)


@dataclass(frozen=True, kw_only=True)
class RobustTracking:
    """Result of robust tracking."""

    problem: MotionProblem  # with the weights w f(u)
    factor: Array  # (nm, nf) f(u); 1 where a marker is not visible or has no weight
    scale: float  # m, s
    tracked: Descent[Evaluation, BandFactor]

    @property
    def outliers(self) -> BoolArray:
        """(nm, nf) samples that are practically left out."""
        return np.less(self.factor, OUTLIER_FACTOR)


def estimate_residual_scale(standardised: Array) -> float:
    """Estimate the scale s of residual coordinates.

    Parameters
    ----------
    standardised
        (n, 3) m, sqrt(w) r of the samples with weight.

    Returns
    -------
    float
        m, at least `MIN_SCALE_M`.
    """
    if not len(standardised):
        return MIN_SCALE_M
    return max(MAD_TO_SIGMA * float(np.median(np.abs(standardised))), MIN_SCALE_M)


def track_robustly(
    problem: MotionProblem, parameters: Parameters, loss: Loss, factor: Array | None = None
) -> RobustTracking:
    """Track one trial from rigid fits under a robust loss.

    Parameters
    ----------
    problem
        The trial, with the weights of the marker set.
    parameters
        Joint parameters of the model.
    loss
        Huber or Cauchy.
    factor
        (nm, nf) factors of the weights at the start, if similar ones are known already.

    Returns
    -------
    RobustTracking
    """
    body, weight = problem.build_body(parameters), problem.data.weight
    used, begun = weight > 0, 0 if factor is None else FIRST_ROUNDS
    present = np.ones_like(weight) if factor is None else factor
    weighted = problem.with_weight(weight * present)
    coefficients = find_start_coefficients(body, weighted.data, problem.basis)
    tracked = track_coefficients(weighted, body, coefficients)
    scale, settled, count = MIN_SCALE_M, False, 0
    while count < MOST_ROUNDS and not settled:
        shape = Loss.HUBER if begun + count < FIRST_ROUNDS else loss
        residual = problem.compute_positions(tracked.x, body) - problem.data.measured
        standardised = np.sqrt(weight)[:, None] * residual
        scale = estimate_residual_scale(standardised.transpose(0, 2, 1)[used])
        changed = np.where(
            used, shape.compute_factor(np.linalg.norm(standardised, axis=1) / scale), 1.0
        )
        settled = (
            shape is loss and float(np.abs(changed - present).max(initial=0.0)) < SETTLED_CHANGE
        )
        present = changed
        weighted = problem.with_weight(weight * present)
        tracked = track_coefficients(weighted, body, tracked.x)
        count += 1
    return RobustTracking(problem=weighted, factor=present, scale=scale, tracked=tracked)
