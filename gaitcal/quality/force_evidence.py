"""Pelvis residual of motion and force plates before forces have changed a parameter; whitening.

    r = required - X(p) sum_k w_k,          X(p) [F; M] = [F; M - p x F],
    p the origin of the pelvis

`required` is the wrench at the pelvis that motion and nominal masses require, w_k the wrench of
plate k about the laboratory origin. Plates are filtered like the motion, so that both contain the
same frequencies. Only the sum of the plates enters: the assignment of plates to feet cannot be
checked here.

Whitened residual of one or several trials, in units of that of clean recordings, with inertial
errors marginalised:

    r = e + N eta,  eta ~ N(0, 1)      N: change of r with one standard deviation of each inertial
                                       parameter, which all trials of a person share
    e: first-order autoregressive in each of the six components of each trial, rho = exp(-dt / TAU),
       standard deviations BASELINE times body weight (forces) and body weight times height
       (moments)
    white(r)_i = (r_i - rho_i r_(i-1)) / (BASELINE sqrt(1 - rho_i^2))
    A = white(N) = U S V^T
    y = (I + A A^T)^(-1/2) white(r) = white(r) - U (1 - 1 / sqrt(1 + S^2)) U^T white(r)

so that |y|^2 = r^T cov(r)^(-1) r.

The foot on a plate is found by time alone, as faulty forces may have their load anywhere: a loading
of the plate and a contact of the foot match if they overlap for most of the time of either.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from gaitcal.arrays import Array, BoolArray, IntArray, cross
from gaitcal.dynamics import expected_residual, foot_contact
from gaitcal.dynamics.ground_reactions import (
    GroundReactions,
    compute_foot_points,
    compute_motion_reactions,
)
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, compute_pelvis_residual
from gaitcal.io.axes import QUARTER_ROTATIONS
from gaitcal.io.force_plate import (
    LOADED_N,
    compute_centre_on_ground,
    filter_plate,
    is_filterable,
    resample_wrench,
)
from gaitcal.io.recording import ForcePlate, Recording, find_runs, measure_duration
from gaitcal.model.chain import build_model
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import (
    MASSIVE_SEGMENTS,
    Parameters,
    compute_dynamic_jacobian,
    view_as_table,
)
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.quality.plate_forces import (
    EMPTY_N,
    PlateForces,
    Sole,
    compute_foot_evidence,
    estimate_empty_reading,
    list_soles,
)
from gaitcal.study.study_trial import Trial
from gaitcal.tracking.motion import Motion

OVERLAP = 0.5
"""Overlap of a plate's loading and a foot's contact, as a share of the time that they cover
together, from which they match."""
# Largest total load of the plates in walking or slow running, body weights
WALKING_LOAD = (0.75, 2.2)
FORCE_UNITS: dict[str, float] = {
    "N": 1.0,
    "kgf": 9.80665,
    "lbf": 4.4482216,
    "kN": 1000.0,
}  # N in a unit of force
# Least time between frames: motion and forces contain nothing above about 10 Hz
STEP_S = 0.02
MOST_FRAMES = 300  # Frames of one trial, at most; a longer one is sampled in larger steps
FEWEST_EVIDENCE_FRAMES = 10  # Less than a fifth of a second is not enough evidence
GRID_S = 0.01  # Sample time of a filtered plate's spline
# Plates that carry less than this share of the most loaded plate in valid frames are left out
LEAST_LOAD = 0.05
MASS_SHARE, MOMENT_SHARE = 0.10, 0.20
"""Standard deviations of a segment's mass and moments of inertia, as shares: differences between
anthropometric tables."""
CENTRE_M = {"head_trunk": 0.025, "pelvis": 0.020, "thigh": 0.012, "foot": 0.008}
"""Standard deviation (m) of a segment's mass centre in a person of height `CENTRE_HEIGHT_M`."""
CENTRE_OTHER_M = 0.010  # The same of other segments
CENTRE_HEIGHT_M = 1.75
SEPARATE_S = 0.06  # Frames further apart are uncorrelated


def list_force_units(weight: float) -> dict[str, float]:
    """List units of force.

    Parameters
    ----------
    weight
        Body weight, N; some programs divide forces by it or by the mass.

    Returns
    -------
    dict of str to float
        Unit -> N.
    """
    return FORCE_UNITS | {
        "N/kg": weight / GRAVITY,
        "body weights": weight,
        "% of body weight": weight / 100.0,
    }


def _normalise_plates(
    plates: tuple[ForcePlate, ...], time: Array, weight: float
) -> tuple[ForcePlate, ...]:
    """Return the plates in N and without their empty readings; unchanged if they need neither."""
    loads = np.stack([np.nan_to_num(resample_wrench(plate, time))[:, 1] for plate in plates])
    most = float(loads.sum(axis=0).max()) / weight
    # a total load far below body weight suggests another unit of force
    unit = 1.0
    if most < 0.5 * WALKING_LOAD[0]:
        unit = next(
            (
                u
                for u in list_force_units(weight).values()
                if WALKING_LOAD[0] < most * u < WALKING_LOAD[1]
            ),
            1.0,
        )
    empty = [unit * (estimate_empty_reading(plate, weight / unit) or 0.0) for plate in plates]
    if unit == 1.0 and max(abs(b) for b in empty) < LOADED_N:
        return plates
    return tuple(
        replace(
            plate, force=unit * plate.force - np.array([0.0, b, 0.0]), moment=unit * plate.moment
        )
        for plate, b in zip(plates, empty, strict=True)
    )


def _match_feet_by_time(plate: ForcePlate, time: Array, resting: BoolArray) -> IntArray:
    """Return the foot (nf,) in contact while the plate is loaded: 0 right, 1 left, -1 none."""
    out = np.full(len(time), -1)
    for loaded in find_runs(np.nan_to_num(resample_wrench(plate, time))[:, 1] > LOADED_N):
        if measure_duration(time, loaded) < foot_contact.MIN_LOADING_S:
            continue
        shares = []
        for foot in range(len(FEET)):
            overlaps = [_compute_overlap(loaded, down) for down in find_runs(resting[:, foot])]
            shares.append(max(overlaps, default=0.0))
        if max(shares) > OVERLAP:
            out[loaded] = int(np.argmax(shares))
    return out


def _compute_overlap(one: slice, other: slice) -> float:
    """Compute the overlap of two intervals as a share of the time that they cover together."""
    both = min(one.stop, other.stop) - max(one.start, other.start)
    return float(max(0, both) / (max(one.stop, other.stop) - min(one.start, other.start)))


def _is_off_feet(
    plates: tuple[ForcePlate, ...], standing: IntArray, time: Array, feet: foot_contact.FootPoints
) -> bool:
    """Return whether the load of a plate is not under the foot (plates, nf) that is in contact."""
    for plate, row in zip(plates, standing, strict=True):
        wrench = np.nan_to_num(resample_wrench(plate, time))
        height = foot_contact.get_surface_height(plate)
        for foot in range(len(FEET)):
            on = (row == foot) & (wrench[:, 1] > LOADED_N)
            if on.any():
                heel, toe = (path[on, foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                # distance from the line heel-toe, weighted by load
                away = foot_contact.compute_distance_to_line(
                    compute_centre_on_ground(wrench[on], height)[:, [0, 2]], heel, toe
                )
                if np.average(away, weights=wrench[on, 1]) > foot_contact.UNDER_FOOT_M:
                    return True
    return False


@dataclass(frozen=True, kw_only=True)
class ForceEvidence:
    """One gait trial at the k frames of a diagnosis."""

    name: str
    room: Array  # (3, 3) rotates the axes of the file, y up, into those of the trial, x forward
    time: Array  # (k,) s
    q: Array  # (k, 27) coordinates
    parameters: Parameters  # Joint parameters calibrated or not, inertial ones nominal
    pelvis: Array  # (k, 3) m, its origin
    required_wrench: Array  # (k, 6) N, N·m about the pelvis: required by the motion
    mass_centre: Array  # (k, 3) m, of the body, from the pelvis origin
    spread: Array
    """(k, 6, n) change of `required_wrench` with one standard deviation of each of n inertial
    parameters.
    """
    # (k, 6, 2) change of `required_wrench` per m of the trunk's mass centre forward and to the
    # right
    trunk: Array
    trunk_observed: bool  # Whether markers determine the rotation of the trunk
    plates: tuple[PlateForces, ...]
    # (plates, k) foot in contact while a plate is loaded, by time alone: 0 right, 1 left, -1 none
    feet: IntArray
    soles: tuple[Sole, ...]  # Positions of the feet on the plates
    empty: tuple[float | None, ...]  # N, reading of each empty plate; None if it is never empty
    weight: float  # N, of the subject
    height: float  # m
    missing: float = 0.0  # Share of missing samples, of the markers that are visible at all
    doubtful: bool = False
    """Whether markers leave the motion of a leg open: a segment with a single marker, or markers
    that contradict each other.
    """

    @property
    def weight_of_model(self) -> float:
        """Weight of all segments of the model, N."""
        return float(self.parameters.mass * GRAVITY)

    @property
    def bwh(self) -> float:
        """Body weight times height, N·m."""
        return self.weight * self.height

    @cached_property
    def wrenches(self) -> Array:
        """Measured wrenches (plates, k, 6) about the laboratory origin, N and N·m."""
        return np.stack([plate.wrench for plate in self.plates])

    def compute_residual(self, wrenches: Array, required_wrench: Array | None = None) -> Array:
        """Compute the pelvis residual for some plate wrenches.

        Parameters
        ----------
        wrenches
            (plates, k, 6) about the laboratory origin, N and N·m.
        required_wrench
            (k, 6) about the pelvis; None: `self.required_wrench`.

        Returns
        -------
        ndarray
            (k, 6) about the pelvis, N and N·m.
        """
        total = wrenches.sum(axis=0)
        about_pelvis = total[:, 3:] - cross(self.pelvis, total[:, :3])
        required = self.required_wrench if required_wrench is None else required_wrench
        out: Array = required - np.hstack([total[:, :3], about_pelvis])
        return out

    @cached_property
    def baseline(self) -> Array:
        """Side evidence z (n,) of the plates as measured."""
        return self.compute_side_evidence(self.wrenches, np.zeros(len(self.plates)))

    def compute_side_evidence(self, wrenches: Array, offsets: Array) -> Array:
        """Compute side evidence of feet and empty plates (`plate_forces.py`).

        Parameters
        ----------
        wrenches
            (plates, k, 6) about the laboratory origin.
        offsets
            (plates,) N, subtracted from the vertical forces.

        Returns
        -------
        ndarray
            (n,) z.
        """
        heights = np.array([plate.middle[1] for plate in self.plates])
        feet = compute_foot_evidence(wrenches, self.soles, heights, self.weight)
        known = [
            (b - x) / EMPTY_N for b, x in zip(self.empty, offsets, strict=True) if b is not None
        ]
        return np.concatenate([feet, known])


def build_force_evidence(
    trial: Trial,
    recording: Recording,
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    reactions: GroundReactions,
) -> ForceEvidence | None:
    """Build the evidence of a whole-body motion over force plates.

    Parameters
    ----------
    trial
        The trial of the study, in the axes of its file.
    recording
        The same as tracked, rotated so that x is forward.
    model
        Nominal model of the subject.
    parameters
        Parameters of the motion; inertial ones are those of tables, before any force was used.
    motion
        Motion of the whole body.
    reactions
        Ground reactions of this motion; their valid frames are used unless faulty forces leave
        too few.

    Returns
    -------
    ForceEvidence or None
        None without plates, or with too few usable frames.
    """
    weight, time = model.subject.weight, motion.time
    plates = tuple(plate for plate in recording.plates if trial.plates.get(plate.name) != "none")
    if not plates:
        return None
    plates_on_ground = _normalise_plates(plates, time, weight)
    feet = np.array(
        [_match_feet_by_time(plate, time, reactions.resting) for plate in plates_on_ground]
    )
    frames = _select_frames(time, reactions.valid)
    points = compute_foot_points(model, motion, parameters)
    # forces that are far from every foot, or in another unit, leave no valid frames
    if plates_on_ground is not plates or _is_off_feet(plates_on_ground, feet, time, points):
        assigned = {**_assign_plates_by_time(plates_on_ground, feet), **trial.plates}
        frames = _reselect_frames(recording, model, parameters, motion, plates_on_ground, assigned)
    if len(frames) < FEWEST_EVIDENCE_FRAMES:
        return None
    loads = [
        float(np.abs(np.nan_to_num(resample_wrench(p, time[frames]))[:, 1]).max()) for p in plates
    ]
    heavy = [i for i, load in enumerate(loads) if load > LEAST_LOAD * max(loads)]
    if not heavy:
        return None
    standing = feet[heavy][:, frames]
    soles = list_soles(standing, frames, points)
    q, v, a = motion.q[frames], motion.velocity[frames], motion.acceleration[frames]
    dynamics = Dynamics(parameters)
    required = compute_pelvis_residual(
        q, dynamics.compute_forces(q, v, a, np.zeros((len(q), len(FEET), 6)))
    )
    linkage = build_model(parameters)
    data = linkage.createData()
    spread, trunk = _compute_inertial_spread(
        dynamics.compute_root_regressor(q, v, a), parameters.inertial, model.subject.height
    )
    plate_forces = []
    for k, i in enumerate(heavy):
        on_plate = [sole for sole in soles if sole.plate == k]
        plate_forces.append(_build_plate_forces(plates[i], motion, frames, on_plate))
    return ForceEvidence(
        name=trial.name,
        room=_find_axes_rotation(trial.recording, recording),
        time=time[frames],
        q=q,
        parameters=parameters,
        pelvis=q[:, :3],
        required_wrench=required,
        mass_centre=np.array([pin.centerOfMass(linkage, data, row) for row in q]) - q[:, :3],
        spread=spread,
        trunk=trunk,
        trunk_observed=not any(name.startswith("lumbar") for name in motion.guessed),
        plates=tuple(plate_forces),
        feet=standing,
        soles=soles,
        empty=tuple(estimate_empty_reading(plates[i], weight) for i in heavy),
        weight=weight,
        height=model.subject.height,
        missing=_measure_missing_share(recording, model),
    )


def _assign_plates_by_time(plates: Sequence[ForcePlate], feet: IntArray) -> dict[str, str]:
    """Assign plates to sides by the foot (plates, nf) that is in contact most often."""
    out: dict[str, str] = {}
    for plate, row in zip(plates, feet, strict=True):
        counts = [int((row == k).sum()) for k in range(len(FEET))]
        if any(counts):
            out[plate.name] = SIDES[int(np.argmax(counts))]
    return out


def _reselect_frames(
    recording: Recording,
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    plates: tuple[ForcePlate, ...],
    assigned: Mapping[str, str],
) -> IntArray:
    """Select valid frames of plates with assigned feet; if too few, without the plates' corners."""
    frames = np.zeros(0, dtype=np.int64)
    for known in (plates, tuple(replace(plate, corners=None) for plate in plates)):
        reactions = compute_motion_reactions(
            model, parameters, motion, replace(recording, plates=known), assigned, motion.cutoff_hz
        )
        frames = _select_frames(motion.time, reactions.valid)
        if len(frames) >= FEWEST_EVIDENCE_FRAMES:
            break
    return frames


def _measure_missing_share(recording: Recording, model: SubjectModel) -> float:
    """Measure the share of missing samples of the model's markers that are visible at all."""
    columns = [k for k, m in enumerate(recording.labels) if m in model.markers.labels]
    missing = np.isnan(recording.markers[:, columns, 0])
    missing = missing[:, ~missing.all(axis=0)]
    return float(missing.mean()) if missing.size else 0.0


def _compute_inertial_spread(
    regressor: Array, inertial: Array, height: float
) -> tuple[Array, Array]:
    """Compute the change of the pelvis wrench with inertial errors, total mass held.

    `regressor`: (k, 6, 12, 10), from `Dynamics.compute_root_regressor`. `inertial`: (84,) inertial
    parameters. `height`: body height, m. Returns: (k, 6, n) change with one standard deviation of
    each of n unknowns; (k, 6, 2) change per m of the trunk's mass centre, forward and to the right.
    """
    by_parameter = np.einsum("ftsd,sdi->ftsi", regressor, compute_dynamic_jacobian(inertial))
    rows = view_as_table(inertial)
    variance = (MASS_SHARE * rows[:, 0]) ** 2
    # given their sum, independent masses have the covariance D - d d^T / sum d
    values, vectors = np.linalg.eigh(
        np.diag(variance) - np.outer(variance, variance) / variance.sum()
    )
    columns = [by_parameter[..., 0] @ (vectors * np.sqrt(np.clip(values, 0.0, None)))[:, 1:]]
    for i, segment in enumerate(MASSIVE_SEGMENTS):
        centre = CENTRE_M.get(segment.removesuffix("_r").removesuffix("_l"), CENTRE_OTHER_M)
        columns.append(by_parameter[:, :, i, 1:4] * centre * height / CENTRE_HEIGHT_M)
        columns.append(by_parameter[:, :, i, 4:7] * MOMENT_SHARE * rows[i, 4:7])
    trunk = by_parameter[:, :, MASSIVE_SEGMENTS.index("head_trunk"), [1, 3]]
    return np.concatenate(columns, axis=2), trunk


def _find_axes_rotation(measured: Recording, rotated: Recording) -> Array:
    """Find the quarter rotation (3, 3) about y from the measured recording to the rotated one.

    The latter may lack markers that were far from the body.
    """
    shared = [label for label in rotated.labels if label in measured.labels]
    markers = []
    for recording in (measured, rotated):
        columns = [recording.labels.index(label) for label in shared]
        markers.append(recording.markers[:, columns])
    # any common visible marker determines the rotation
    visible = np.isfinite(markers[0]).all(axis=2) & np.isfinite(markers[1]).all(axis=2)
    before, after = (m[visible] for m in markers)
    rotations = [rotation.apply(np.eye(3)).T for rotation in QUARTER_ROTATIONS]
    return min(rotations, key=lambda rotation: float(np.abs(before @ rotation.T - after).max()))


def _select_frames(time: Array, valid: BoolArray) -> IntArray:
    """Select valid frames at least `STEP_S` apart, evenly fewer if there are too many."""
    chosen: list[int] = []
    for frame in np.flatnonzero(valid):
        if not chosen or time[frame] - time[chosen[-1]] >= 0.99 * STEP_S:
            chosen.append(int(frame))
    # ceiling division
    every = -(-len(chosen) // MOST_FRAMES) if chosen else 1
    return np.array(chosen[::every], dtype=np.int64)


def _build_plate_forces(
    plate: ForcePlate, motion: Motion, frames: IntArray, soles: Sequence[Sole]
) -> PlateForces:
    """Filter a plate like the motion; without corners its middle is that of the feet on it."""
    hz = motion.cutoff_hz
    smooth = filter_plate(plate, hz) if is_filterable(plate, hz) else plate
    span = float(plate.time[0]), float(plate.time[-1])
    grid = np.linspace(*span, max(4, round((span[1] - span[0]) / GRID_S) + 1))
    spline = CubicSpline(grid, np.nan_to_num(resample_wrench(smooth, grid)))
    corners = plate.corners
    position = corners.mean(axis=0) if corners is not None and np.isfinite(corners).all() else None
    middle = position
    if position is None and soles:
        x, z = np.concatenate([0.5 * (sole.heel + sole.toe) for sole in soles]).mean(axis=0)
        middle = np.array([x, 0.0, z])
    return PlateForces.from_spline(plate.name, spline, span, motion.time[frames], middle, position)


class ForceResidual:
    """Whitened pelvis residual of trials of one person over the same force plates.

    Parameters
    ----------
    trials
        One or several trials; they share the inertial errors.
    """

    def __init__(self, trials: Sequence[ForceEvidence]) -> None:
        self.trials = tuple(trials)
        self._rho = [_compute_correlation(trial.time) for trial in self.trials]
        spread = np.concatenate(
            [self._whiten_trial(i, trial.spread) for i, trial in enumerate(self.trials)]
        )
        self._u, s, _ = np.linalg.svd(spread, full_matrices=False)
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
        ends = np.cumsum([6 * len(trial.time) for trial in self.trials])
        self._parts = [
            slice(int(end) - 6 * len(t.time), int(end))
            for end, t in zip(ends, self.trials, strict=True)
        ]

    def whiten(self, residuals: Sequence[Array]) -> Array:
        """Whiten residuals and marginalise the inertial errors.

        Parameters
        ----------
        residuals
            (k, 6) about the pelvis, one array for each trial.

        Returns
        -------
        ndarray
            (rows,) y, with |y|^2 = r^T cov(r)^(-1) r.
        """
        y = np.concatenate([self._whiten_trial(i, r) for i, r in enumerate(residuals)])
        out: Array = y - self._u @ (self._shrink * (self._u.T @ y))
        return out

    def sum_squares(self, y: Array) -> Array:
        """Sum the squares of whitened rows (rows,) of each trial: (trials,)."""
        return np.array([float(y[part] @ y[part]) for part in self._parts])

    @property
    def rows(self) -> Array:
        """Number of rows of each trial, (trials,)."""
        return np.array([part.stop - part.start for part in self._parts])

    def _whiten_trial(self, trial: int, r: Array) -> Array:
        """Scale and decorrelate the residuals of one trial: (6 k, ...) from (k, 6, ...)."""
        evidence = self.trials[trial]
        scale = expected_residual.BASELINE_RESIDUAL * np.repeat([evidence.weight, evidence.bwh], 3)
        r = r / scale.reshape((6,) + (1,) * (r.ndim - 2))
        # first-order autoregressive noise: subtract the predictable part of each frame
        rho = self._rho[trial].reshape((-1,) + (1,) * (r.ndim - 1))
        out = r.copy()
        out[1:] -= rho[1:] * r[:-1]
        white: Array = (out / np.sqrt(1.0 - rho**2)).reshape((-1,) + r.shape[2:])
        return white


def _compute_correlation(time: Array) -> Array:
    """Compute the correlation (k,) of each frame with the one before it."""
    step = np.diff(time)
    return np.concatenate(
        [[0.0], np.where(step < SEPARATE_S, np.exp(-step / expected_residual.CORRELATION_S), 0.0)]
    )
