"""What motion and force plates of one trial say against each other at the pelvis, before any force
touched a parameter.

    r = required - X(p) sum_k w_k,          X(p) [F; M] = [F; M - p x F],   p the origin of the pelvis

`required` is the wrench at the pelvis that motion and nominal masses ask for, w_k the wrench of
plate k about the laboratory origin. Plates are filtered as the motion is, so that both hold the
same oscillations. Only the sum of the plates enters: which foot a plate is given to cannot be
judged here.

The pelvis residual of one or several trials in units of what clean recordings leave, inertial
errors marginalised.

    r = e + N eta,  eta ~ N(0, 1)      N: change of r with one standard deviation of each inertial parameter, which all
                                       trials of a person share
    e: first-order autoregressive in each of the six components of each trial, rho = exp(-dt / TAU),
    standard
       deviations BASELINE times body weight (forces) and body weight times height (moments)
    white(r)_i = (r_i - rho_i r_(i-1)) / (BASELINE sqrt(1 - rho_i^2))
    A = white(N) = U S V^T
    y = (I + A A^T)^(-1/2) white(r) = white(r) - U (1 - 1 / sqrt(1 + S^2)) U^T white(r)

so that |y|^2 = r^T cov(r)^(-1) r.

Which foot stands on a plate, told by time alone: forces that are at fault may put their load
anywhere.

A plate's loading and a foot's contact belong together where they last together for most of the time
that either does.
"""

from collections.abc import Sequence
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
    empty_reading,
    soles_of,
    under_feet,
)
from gaitcal.study.study_trial import Trial
from gaitcal.tracking.motion import Motion

TOGETHER = 0.5
"""Of the time that a plate's load and a foot's contact last together: the common part by which they
belong together.
"""
WALKING = (
    0.75,
    2.2,
)  # Body weights that the plates carry at most while somebody walks or runs slowly
FORCE_UNITS: dict[str, float] = {
    "N": 1.0,
    "kgf": 9.80665,
    "lbf": 4.4482216,
    "kN": 1000.0,
}  # N in a unit of force
# Frames nearer to each other say the same: motion and forces hold nothing above about 10 Hz
STEP_S = 0.02
MOST_FRAMES = 300  # Of one trial; a longer one is looked at in larger steps
FEWEST_FRAMES = 10  # Below a fifth of a second nothing can be told
GRID_S = 0.01  # Times at which a filtered plate is kept
LEAST_LOAD = (
    0.05  # Of the load of the heaviest plate: one that carries less in valid frames takes no part
)
MASS_SHARE, MOMENT_SHARE = 0.10, 0.20
"""Standard deviations of a segment's mass and moments of inertia, as shares: what tables of body
segments differ by.
"""
CENTRE_M = {"head_trunk": 0.025, "pelvis": 0.020, "thigh": 0.012, "foot": 0.008}
CENTRE_OTHER_M, CENTRE_HEIGHT_M = (
    0.010,
    1.75,
)  # m, standard deviations of a mass centre in a person of that height
BROKEN_S = 0.06  # Frames further apart know nothing of each other


def force_units(weight: float) -> dict[str, float]:
    """N in a unit that a file may give forces in; some programs divide them by the person's
    `weight` (N) or mass.
    """
    return FORCE_UNITS | {
        "N/kg": weight / GRAVITY,
        "body weights": weight,
        "% of body weight": weight / 100.0,
    }


def as_walked_on(
    plates: tuple[ForcePlate, ...], time: Array, weight: float
) -> tuple[ForcePlate, ...]:
    """The plates in newtons and without what they read while empty, by which feet can be told to
    stand; the same where they need neither.
    """
    loads = np.stack([np.nan_to_num(resample_wrench(plate, time))[:, 1] for plate in plates])
    most = float(loads.sum(axis=0).max()) / weight
    unit = 1.0
    if most < 0.5 * WALKING[0]:
        unit = next(
            (u for u in force_units(weight).values() if WALKING[0] < most * u < WALKING[1]), 1.0
        )
    empty = [unit * (empty_reading(plate, weight / unit) or 0.0) for plate in plates]
    if unit == 1.0 and max(abs(b) for b in empty) < LOADED_N:
        return plates
    return tuple(
        replace(
            plate, force=unit * plate.force - np.array([0.0, b, 0.0]), moment=unit * plate.moment
        )
        for plate, b in zip(plates, empty, strict=True)
    )


def standing_feet(plate: ForcePlate, time: Array, resting: BoolArray) -> IntArray:
    """(nf,) the foot that is down while the plate is loaded, by time alone: 0 right, 1 left, -1
    none.
    """
    out = np.full(len(time), -1)
    for loaded in find_runs(np.nan_to_num(resample_wrench(plate, time))[:, 1] > LOADED_N):
        if measure_duration(time, loaded) < foot_contact.MIN_LOADING_S:
            continue
        shares = [
            max((_common(loaded, down) for down in find_runs(resting[:, k])), default=0.0)
            for k in range(len(FEET))
        ]
        if max(shares) > TOGETHER:
            out[loaded] = int(np.argmax(shares))
    return out


def _common(one: slice, other: slice) -> float:
    """Part of the time that two stretches cover in which both last."""
    both = min(one.stop, other.stop) - max(one.start, other.start)
    return float(max(0, both) / (max(one.stop, other.stop) - min(one.start, other.start)))


def off_feet(
    plates: tuple[ForcePlate, ...], standing: IntArray, time: Array, feet: foot_contact.FootPoints
) -> bool:
    """Whether the load of a plate is not under the foot (plates, nf) that stands when it is loaded."""
    for plate, row in zip(plates, standing, strict=True):
        wrench = np.nan_to_num(resample_wrench(plate, time))
        for foot in range(len(FEET)):
            on = (row == foot) & (wrench[:, 1] > LOADED_N)
            if on.any():
                heel, toe = (path[on, foot][:, [0, 2]] for path in (feet.heel, feet.toe))
                away = foot_contact.compute_distance_to_line(
                    compute_centre_on_ground(wrench[on])[:, [0, 2]], heel, toe
                )
                if np.average(away, weights=wrench[on, 1]) > foot_contact.UNDER_FOOT_M:
                    return True
    return False


@dataclass(frozen=True, kw_only=True)
class ForceEvidence:
    """One gait trial at the k frames that a diagnosis looks at."""

    name: str
    room: Array  # (3, 3) turns the axes of the file, y up, into those of the trial, x forward
    time: Array  # (k,) s
    q: Array  # (k, 27) coordinates
    parameters: Parameters  # Joint parameters calibrated or not, inertial ones nominal
    pelvis: Array  # (k, 3) m, its origin
    required_wrench: Array  # (k, 6) N, N·m about the pelvis: what the motion asks for
    mass_centre: Array  # (k, 3) m, of the body, from the pelvis origin
    spread: Array
    """(k, 6, n) change of `required_wrench` with one standard deviation of each of n unknown
    inertial parameters.
    """
    # (k, 6, 2) change of `required_wrench` per m of the trunk's mass centre forward and to the
    # right
    trunk: Array
    trunk_seen: bool  # Whether markers determine how the trunk turns
    plates: tuple[PlateForces, ...]
    # (plates, k) the foot that stands when a plate is loaded, 0 right, 1 left, -1 none: by time
    # alone
    feet: IntArray
    soles: tuple[Sole, ...]  # Where the feet are that stand on the plates
    empty: tuple[
        float | None, ...
    ]  # N, what each plate reads while nobody is on it; None where somebody always is
    weight: float  # N, of the subject
    height: float  # m
    missing: float = (
        0.0  # Share of the samples of markers that the trial shows at all which are not there
    )
    doubtful: bool = False
    """Whether markers leave open how a leg moves: one alone follows a segment, or they contradict
    each other.
    """

    @property
    def weight_of_model(self) -> float:
        """N, of the model's segments together."""
        return float(self.parameters.mass * GRAVITY)

    @property
    def bwh(self) -> float:
        """N·m, body weight times height."""
        return self.weight * self.height

    @cached_property
    def wrenches(self) -> Array:
        """(plates, k, 6) about the laboratory origin, as measured."""
        return np.stack([plate.wrench for plate in self.plates])

    def residual(self, wrenches: Array, required_wrench: Array | None = None) -> Array:
        """(k, 6) what plates with wrenches (plates, k, 6) leave unexplained at the pelvis."""
        total = wrenches.sum(axis=0)
        about_pelvis = total[:, 3:] - cross(self.pelvis, total[:, :3])
        required = self.required_wrench if required_wrench is None else required_wrench
        out: Array = required - np.hstack([total[:, :3], about_pelvis])
        return out

    @cached_property
    def baseline(self) -> Array:
        """(n,) z of the same with the plates as measured."""
        return self.side_evidence(self.wrenches, np.zeros(len(self.plates)))

    def side_evidence(self, wrenches: Array, taken_away: Array) -> Array:
        """(n,) z of feet and empty plates for wrenches (plates, k, 6), offsets (plates,) N taken
        away.
        """
        heights = np.array([plate.middle[1] for plate in self.plates])
        feet = under_feet(wrenches, self.soles, heights, self.weight)
        known = [
            (b - x) / EMPTY_N for b, x in zip(self.empty, taken_away, strict=True) if b is not None
        ]
        return np.concatenate([feet, known])


def force_evidence(
    trial: Trial,
    recording: Recording,
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    reactions: GroundReactions,
) -> ForceEvidence | None:
    """The evidence of a whole-body motion over force plates; None where too few frames can be told.

    `trial`: as the study has it, in the axes of its file. `recording`: the same as tracked, turned
    so that x is forward. `parameters`: the motion's; their inertial parameters are those of tables,
    which no force has touched. `reactions`: of the same motion; their frames count unless forces so
    wrong that no foot fits them left too few.
    """
    weight, time = model.subject.weight, motion.time
    plates = tuple(plate for plate in recording.plates if trial.plates.get(plate.name) != "none")
    if not plates:
        return None
    plates_on_ground = as_walked_on(plates, time, weight)
    feet = np.array([standing_feet(plate, time, reactions.resting) for plate in plates_on_ground])
    frames = _chosen(time, reactions.valid)
    points = compute_foot_points(model, motion, parameters)
    if plates_on_ground is not plates or off_feet(plates_on_ground, feet, time, points):
        counts = [[int((row == k).sum()) for k in range(len(FEET))] for row in feet]
        by_time = {
            p.name: SIDES[int(np.argmax(n))]
            for p, n in zip(plates_on_ground, counts, strict=True)
            if any(n)
        }
        assigned = {**by_time, **trial.plates}
        for known in (
            plates_on_ground,
            tuple(replace(plate, corners=None) for plate in plates_on_ground),
        ):
            again = replace(recording, plates=known)
            retimed = compute_motion_reactions(
                model, parameters, motion, again, assigned, motion.cutoff_hz
            )
            frames = _chosen(time, retimed.valid)
            if len(frames) >= FEWEST_FRAMES:
                break
    if len(frames) < FEWEST_FRAMES:
        return None
    loads = [
        float(np.abs(np.nan_to_num(resample_wrench(p, time[frames]))[:, 1]).max()) for p in plates
    ]
    heavy = [i for i, load in enumerate(loads) if load > LEAST_LOAD * max(loads)]
    if not heavy:
        return None
    standing = feet[heavy][:, frames]
    soles = soles_of(standing, frames, points)
    gone = np.isnan(
        recording.markers[
            :, [k for k, m in enumerate(recording.labels) if m in model.markers.labels], 0
        ]
    )
    gone = gone[:, ~gone.all(axis=0)]
    q, v, a = motion.q[frames], motion.velocity[frames], motion.acceleration[frames]
    dynamics = Dynamics(parameters)
    required = compute_pelvis_residual(
        q, dynamics.compute_forces(q, v, a, np.zeros((len(q), len(FEET), 6)))
    )
    linkage = build_model(parameters)
    data = linkage.createData()
    spread, trunk = inertial_spread(
        dynamics.compute_root_regressor(q, v, a), parameters.inertial, model.subject.height
    )
    return ForceEvidence(
        name=trial.name,
        room=_room(trial.recording, recording),
        time=time[frames],
        q=q,
        parameters=parameters,
        pelvis=q[:, :3],
        required_wrench=required,
        mass_centre=np.array([pin.centerOfMass(linkage, data, row) for row in q]) - q[:, :3],
        spread=spread,
        trunk=trunk,
        trunk_seen=not any(name.startswith("lumbar") for name in motion.guessed),
        plates=tuple(
            _plate_forces(plates[i], motion, frames, [sole for sole in soles if sole.plate == k])
            for k, i in enumerate(heavy)
        ),
        feet=standing,
        soles=soles,
        empty=tuple(empty_reading(plates[i], weight) for i in heavy),
        weight=weight,
        height=model.subject.height,
        missing=float(gone.mean()) if gone.size else 0.0,
    )


def inertial_spread(regressor: Array, inertial: Array, height: float) -> tuple[Array, Array]:
    """Change of the pelvis' wrench with one standard deviation of the inertial parameters (84,),
    total mass held.

    Returns (k, 6, n) for n unknowns, and (k, 6, 2) per m of the trunk's mass centre forward and to
    the right; `regressor` (k, 6, 12, 10) as `Dynamics.compute_root_regressor` gives it.
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


def _room(measured: Recording, turned: Recording) -> Array:
    """(3, 3) the quarter turn about y from one recording to the other, which may lack markers that
    were far away.
    """
    shared = [label for label in turned.labels if label in measured.labels]
    columns = [[r.labels.index(label) for label in shared] for r in (measured, turned)]
    markers = [r.markers[:, own] for r, own in zip((measured, turned), columns, strict=True)]
    visible = np.isfinite(markers[0]).all(axis=2) & np.isfinite(markers[1]).all(axis=2)
    places = [m[visible] for m in markers]
    turns = [turn.apply(np.eye(3)).T for turn in QUARTER_ROTATIONS]
    return min(turns, key=lambda turn: float(np.abs(places[0] @ turn.T - places[1]).max()))


def _chosen(time: Array, valid: BoolArray) -> IntArray:
    """Valid frames at least `STEP_S` apart, evenly fewer where there are too many."""
    chosen: list[int] = []
    for frame in np.flatnonzero(valid):
        if not chosen or time[frame] - time[chosen[-1]] >= 0.99 * STEP_S:
            chosen.append(int(frame))
    every = -(-len(chosen) // MOST_FRAMES) if chosen else 1
    return np.array(chosen[::every], dtype=np.int64)


def _plate_forces(
    plate: ForcePlate, motion: Motion, frames: IntArray, soles: Sequence[Sole]
) -> PlateForces:
    """The plate filtered as the motion is; its middle that of its corners, or else, on the floor,
    of the feet on it.
    """
    hz = motion.cutoff_hz
    smooth = filter_plate(plate, hz) if is_filterable(plate, hz) else plate
    until = float(plate.time[0]), float(plate.time[-1])
    grid = np.linspace(*until, max(4, round((until[1] - until[0]) / GRID_S) + 1))
    path = CubicSpline(grid, np.nan_to_num(resample_wrench(smooth, grid)))
    corners = plate.corners
    place = corners.mean(axis=0) if corners is not None and np.isfinite(corners).all() else None
    middle = place
    if place is None and soles:
        x, z = np.concatenate([0.5 * (sole.heel + sole.toe) for sole in soles]).mean(axis=0)
        middle = np.array([x, 0.0, z])
    return PlateForces.of(plate.name, path, until, motion.time[frames], middle, place)


class ForceResidual:
    """Several trials of one person with the same force plates, or one."""

    def __init__(self, trials: Sequence[ForceEvidence]) -> None:
        self.trials = tuple(trials)
        self._rho = [_memory(trial.time) for trial in self.trials]
        spread = np.concatenate(
            [self._white(i, trial.spread) for i, trial in enumerate(self.trials)]
        )
        self._u, s, _ = np.linalg.svd(spread, full_matrices=False)
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
        ends = np.cumsum([6 * len(trial.time) for trial in self.trials])
        self._parts = [
            slice(int(end) - 6 * len(t.time), int(end))
            for end, t in zip(ends, self.trials, strict=True)
        ]

    def whitened(self, residuals: Sequence[Array]) -> Array:
        """(rows,) y of residuals (k, 6), one for each trial."""
        y = np.concatenate([self._white(i, r) for i, r in enumerate(residuals)])
        out: Array = y - self._u @ (self._shrink * (self._u.T @ y))
        return out

    def squares(self, y: Array) -> Array:
        """(trials,) sum of the squares of each trial's rows."""
        return np.array([float(y[part] @ y[part]) for part in self._parts])

    @property
    def rows(self) -> Array:
        """(trials,) how many rows each trial has."""
        return np.array([part.stop - part.start for part in self._parts])

    def _white(self, trial: int, r: Array) -> Array:
        """(6 k, ...) of (k, 6, ...)."""
        evidence = self.trials[trial]
        scale = expected_residual.BASELINE_RESIDUAL * np.repeat([evidence.weight, evidence.bwh], 3)
        r = r / scale.reshape((6,) + (1,) * (r.ndim - 2))
        rho = self._rho[trial].reshape((-1,) + (1,) * (r.ndim - 1))
        out = r.copy()
        out[1:] -= rho[1:] * r[:-1]
        white: Array = (out / np.sqrt(1.0 - rho**2)).reshape((-1,) + r.shape[2:])
        return white


def _memory(time: Array) -> Array:
    """(k,) correlation of each frame with the one before it."""
    step = np.diff(time)
    return np.concatenate(
        [[0.0], np.where(step < BROKEN_S, np.exp(-step / expected_residual.CORRELATION_S), 0.0)]
    )
