"""A walk that the ground can carry: the nominal gait, changed for one person as little as the
ground asks for.

The nominal gait is the coordinates of one person over the gait cycle, as six harmonics each
(`models/nominal_subject.json`, derived from OpenSim's Gait2392 `subject01`, CC BY 3.0). Feet strike
with the heel and leave with the toes: the centre of pressure goes along the line from heel to toe
marker, quickly over the heel and slowly under the forefoot, as in walking people (Perry 1992). The
left foot does the same half a stride later.

Motion and masses alone say which force the ground exerts in all, and about which point of the
floor, its centre of pressure, it has no tipping moment. A person walks where that point lies under
the foot that stands, or between both feet; curves that were measured on somebody else and smoothed
do not. So the nodes of the motion are moved, by least squares, until

- the total ground reaction has its centre where the load of the feet rolls, and hardly a moment
  about the vertical,
- it rises and falls, brakes and drives as that of walking people does,
- heel and ball rest where they stand, and the feet go where the nominal person's feet go,
- angles and accelerations stay near the curves.

What each may deviate by is a standard deviation below. The result is no fit to moments of anybody:
joint torques are what they then are. It holds for any linkage; the nominal person's angles change
by 0.3 to 1 degree (RMS).
"""

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from gaitcal.arrays import Array
from gaitcal.dynamics import inverse_dynamics, measurement_errors
from gaitcal.dynamics.derivatives import compute_root_residual
from gaitcal.io.toml import find_models_folder
from gaitcal.model import coordinates, nominal, subject_model
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES, SIDES, is_translation
from gaitcal.model.parameters import Parameters
from gaitcal.tracking.spline import ORDER, SplineBasis

GAIT_CYCLE = 1.035  # s, `cycle_s` of the nominal gait
STANCE = (
    0.62  # Share of a stride in which a foot is on the ground; double support is 0.12 of it, twice
)
DOUBLE_SUPPORT = STANCE - 0.5
POINTS = ("Heel", "Toe.Tip", "Toe.Lat", "Toe.Med")
"""Markers of a foot; the second ends the line along which its load rolls, the last two are at the
ball of the foot.
"""
ROLL = ((0.0, 0.12, 0.3, 0.55, 0.8, 1.0), (0.10, 0.28, 0.42, 0.58, 0.72, 0.86))
"""Part of stance, and where the centre of pressure is then between the back of the heel and the tip
of the foot.
"""
HEEL_RESTS, BALL_RESTS, SETTLING = (0.01, 0.35), (0.1, 0.54), 0.06
"""Phases of the foot's own stride between which heel and ball do not move, and the time to come to
rest and leave.
"""
CENTRE_OF_PRESSURE_M = 0.006
"""m, of the centre of pressure from where the load rolls; times body weight, of every moment about
that point.
"""
FORCE_SPREAD = np.array(
    [0.10, 0.03, 0.01]
)  # Body weights, of the total force from that of walking people
FORCE_PHASE_LAG = (
    0.076 - 0.5 * DOUBLE_SUPPORT
)  # Strides by which the usual force comes later in the recording that it is from
ANGLE, ARM_ANGLE, PLACE_M = np.deg2rad(2.0), np.deg2rad(4.0), 0.01
ANGULAR_ACCELERATION, ACCELERATION = (
    25.0,
    2.0,
)  # rad/s^2, m/s^2: without these the ends of a spline swing
FOOT_PLACE_M = 0.02
FOOT_SPEED = 0.03  # m/s, of a resting point
CLEARANCE = 0.02  # m between the floor and the lowest foot marker of the nominal person
SMALLEST_STEP = 1e-3  # m or rad, largest change of a node in the last step
MAX_STEPS = 30


@dataclass(frozen=True)
class FeetOnGround:
    """Points of both feet of one linkage in some frames."""

    points: Array  # (nf, 2, 4, 3) m, of the right and the left foot, in the order of `POINTS`
    slopes: Array  # (nf, 2, 4, 3, nq) their derivatives by the coordinates

    def along(self, part: Array, level: Array | float = 0.0) -> tuple[Array, Array]:
        """Points on the ground (nf, 2, 3) m, at parts (nf, 2) of the way from heel to tip, and
        their derivatives.

        `level`: (nf, 2) m, height of the ground.
        """
        share = (part * _compute_foot_length_ratio())[..., None]
        of = [(1.0 - share) * self.points[:, :, 0] + share * self.points[:, :, 1]]
        share = share[..., None]
        of.append((1.0 - share) * self.slopes[:, :, 0] + share * self.slopes[:, :, 1])
        of[0][:, :, 1], of[1][:, :, 1] = level, 0.0
        return of[0], of[1]


def compute_feet(parameters: Parameters, q: Array) -> FeetOnGround:
    """Where the points of the feet are at coordinates (nf, nq)."""
    chain = get_chain()
    placed = Kinematics(chain.body(parameters), q)
    axes, origins = placed.axes, placed.origins
    columns = placed.columns.transpose(2, 1, 0)  # (nf, 6, nq)
    points = np.empty((len(q), len(inverse_dynamics.FEET), len(POINTS), 3))
    slopes = np.zeros((*points.shape, q.shape[1]))
    for foot, segment in enumerate(inverse_dynamics.FEET):
        k = chain.segments.index(segment)
        moved = np.flatnonzero(chain.support[:, k])
        for n, local in enumerate(_get_local_points()[foot]):
            place = np.einsum("j,jif->fi", local, axes[k]) + origins[k].T
            turned = np.cross(columns[:, 3:, moved], place[:, :, None], axis=1)
            points[:, foot, n] = place
            slopes[:, foot, n][:, :, moved] = columns[:, :3, moved] + turned
    return FeetOnGround(points, slopes)


def compute_foot_phases(phase: Array) -> Array:
    """(nf, 2) phase of the right and the left foot's own stride, 0 to 1 from its strike on."""
    return np.stack([phase % 1.0, (phase - 0.5) % 1.0], axis=1)


def compute_rolled_part(phase: Array) -> Array:
    """(nf, 2) part of the way from heel to tip to which the load of each foot has rolled; in swing
    it stays.
    """
    part: Array = PchipInterpolator(*ROLL)(np.minimum(compute_foot_phases(phase) / STANCE, 1.0))
    return part


def compute_right_share(phase: Array) -> Array:
    """(nf,) share of the right foot in the vertical load over the gait cycle (0: right heel
    strike).
    """
    own = phase % 1.0
    rise, fall = (
        compute_ramp(own / DOUBLE_SUPPORT),
        1.0 - compute_ramp((own - 0.5) / DOUBLE_SUPPORT),
    )
    return np.where(
        own < DOUBLE_SUPPORT, rise, np.where(own < 0.5, 1.0, np.where(own < STANCE, fall, 0.0))
    )


def compute_rest_weights(phase: Array) -> Array:
    """(nf, 2, 4) how much of the points of the feet stands still on the ground: 0 to 1, smooth in
    time.
    """
    own = compute_foot_phases(phase)
    heel, ball = (
        compute_ramp((own - begin) / SETTLING)
        * (1.0 - compute_ramp((own - end + SETTLING) / SETTLING))
        for begin, end in (HEEL_RESTS, BALL_RESTS)
    )
    out = np.zeros((len(phase), len(inverse_dynamics.FEET), len(POINTS)))
    out[:, :, 0], out[:, :, 2], out[:, :, 3] = heel, ball, ball
    return out


@cache
def _get_local_points() -> Array:
    """(2, 4, 3) m, points of the right and the left foot in their segments: those of every built-in
    person.
    """
    markers = nominal.published_model().markers
    rows = [[markers.labels.index(f"{side.upper()}.{name}") for name in POINTS] for side in SIDES]
    out: Array = markers.local[rows]
    return out


@cache
def _compute_foot_length_ratio() -> float:
    """The length of a foot, as a part of the distance from its heel to its toe marker."""
    heel, toe = _get_local_points()[0, :2]
    marked = float(np.linalg.norm(toe - heel))
    return max(
        1.0, measurement_errors.FOOT_LENGTH * nominal.published_model().subject.height / marked
    )


def compute_ramp(x: Array) -> Array:
    """From 0 at x = 0 to 1 at x = 1, with no velocity nor acceleration at the ends."""
    x = np.clip(x, 0.0, 1.0)
    out: Array = x**3 * (10.0 + x * (-15.0 + 6.0 * x))
    return out


@cache
def _load_nominal_gait() -> dict[str, Any]:
    content = json.loads(
        (find_models_folder() / "nominal_subject.json").read_text(encoding="utf-8")
    )
    gait: dict[str, Any] = content["nominal_gait"]
    return gait


def compute_gait_curves(phase: Array) -> tuple[Array, Array]:
    """Coordinates (nf, nq) m, rad, at phases (nf,) in strides, 0: right heel strike; and their
    accelerations.
    """
    data = _load_nominal_gait()
    q, acceleration = np.empty((2, len(phase), len(COORDINATES)))
    for i, name in enumerate(COORDINATES):
        harmonics = data["curves"][coordinates.split_side(name)[0]]
        a, b = (np.array(harmonics[part], dtype=float) for part in "ab")
        angle = (
            2 * np.pi * np.outer(phase + (0.5 if name.endswith("_l") else 0.0), np.arange(len(a)))
        )
        omega = 2 * np.pi * np.arange(len(a)) / GAIT_CYCLE
        for out, factor in ((q, np.ones(len(a))), (acceleration, -(omega**2))):
            values = np.cos(angle) @ (factor * a) + np.sin(angle) @ (factor * b)
            out[:, i] = values if harmonics["unit"] == "m" else np.deg2rad(values)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += data["stride_m"] * phase
    return q, acceleration


_Rows = tuple[Array, dict[int, Array]]
"""Residuals (nf, n) of every frame in units of their standard deviations, and their derivatives
(nf, n, nq) by the coordinates, 0, their velocities, 1, or accelerations, 2."""


@dataclass(frozen=True)
class TargetMotion:
    """The motion that a walk is to be like."""

    q: Array  # (nf, nq) m, rad
    acceleration: Array  # (nf, nq) m/s^2, rad/s^2
    spread: float = (
        1.0  # Of how far from it the walk may be: less where the ground carries it already
    )


@dataclass(frozen=True, kw_only=True)
class Ground:
    """What the ground does in the frames of a motion, and where the feet are on it."""

    footsteps: Array  # (nf, 2, 4, 3) m, where the points of the feet should be
    held: Array  # (nf, 2, 4) how much of that is asked for: 0 to 1
    resting: Array  # (nf, 2, 4) how much of the points stands still: 0 to 1
    share: Array  # (nf, 2) of the vertical load on each foot; 0 in flight
    part: Array  # (nf, 2) of the way from heel to tip to which the load has rolled
    level: Array  # (nf, 2) m, height of the ground under each foot
    # (nf, 3) m, where a seat bears what the feet do not: it counts where their shares do not sum to
    # 1
    seat: Array
    force: Array  # (nf, 3) body weights, of the total force
    # (nf, 3) body weights, by which the force may be another; infinite where nothing is known of it
    spread: Array


def make_walking_ground(phase: Array) -> Ground:
    """The floor under a walk, where the nominal person's feet go; `phase`: (nf,) strides since a
    right heel strike.
    """
    footsteps, right = (
        compute_feet(nominal.published_model().parameters, compute_nominal_curves(phase).q).points,
        compute_right_share(phase),
    )
    nf = len(phase)
    return Ground(
        footsteps=footsteps,
        held=np.ones((nf, len(inverse_dynamics.FEET), len(POINTS))),
        resting=compute_rest_weights(phase),
        share=np.stack([right, 1.0 - right], axis=1),
        part=compute_rolled_part(phase),
        level=np.zeros((nf, len(inverse_dynamics.FEET))),
        seat=np.zeros((nf, 3)),
        force=_compute_typical_force(phase),
        spread=np.tile(FORCE_SPREAD, (nf, 1)),
    )


def fit_carried_motion(
    parameters: Parameters, basis: SplineBasis, ground: Ground, meant: TargetMotion
) -> Array:
    """(nn, nq) m, rad: nodes of a motion of the person with these parameters that the ground
    carries.
    """
    coefficients = basis.fit(meant.q)
    for _ in range(MAX_STEPS):
        step = _solve_step(
            basis,
            [
                *_build_ground_rows(parameters, basis, coefficients, ground),
                *_build_target_rows(basis, coefficients, meant),
            ],
        )
        coefficients += step
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return coefficients


def compute_nominal_curves(phase: Array) -> TargetMotion:
    """The nominal gait with the nominal person's feet on the floor, y = 0."""
    q, acceleration = compute_gait_curves(phase)
    q[:, COORDINATES.index("pelvis_ty")] += _compute_floor_shift()
    return TargetMotion(q, acceleration)


@cache
def _compute_floor_shift() -> float:
    heights = compute_feet(
        nominal.published_model().parameters, compute_gait_curves(np.arange(0.0, 1.0, 0.005))[0]
    ).points[..., 1]
    return CLEARANCE - float(heights.min())


def _build_ground_rows(
    parameters: Parameters, basis: SplineBasis, coefficients: Array, ground: Ground
) -> list[_Rows]:
    """What the ground asks for: balance, a force like that of people, feet that stand where they
    stand.
    """
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    feet, (nf, nq) = compute_feet(parameters, q), q.shape
    still, held = ground.resting[..., None] / FOOT_SPEED, ground.held[..., None]
    speed = np.einsum("fknic,fc->fkni", feet.slopes, v)
    places = (
        ((feet.points - ground.footsteps) / FOOT_PLACE_M * held).reshape(nf, -1),
        (feet.slopes / FOOT_PLACE_M * held[..., None]).reshape(nf, -1, nq),
    )
    # how the slopes change with the posture is left out: resting points hardly move
    rests = (speed * still).reshape(nf, -1), (feet.slopes * still[..., None]).reshape(nf, -1, nq)
    return [
        *_build_force_rows(parameters, (q, v, a), ground, feet),
        (places[0], {0: places[1]}),
        (rests[0], {1: rests[1]}),
    ]


def _build_force_rows(
    parameters: Parameters, state: tuple[Array, Array, Array], ground: Ground, feet: FeetOnGround
) -> list[_Rows]:
    """The total ground reaction: its moment about where the load rolls, and its force."""
    q, weight = state[0], parameters.mass * subject_model.GRAVITY
    total = compute_root_residual(parameters, (), *state, np.zeros((len(q), 2, 6)))
    force, moment = total.value[:, :3], total.value[:, 3:]
    share = ground.share[:, :, None]
    points, slopes = feet.along(ground.part, ground.level)
    seated = 1.0 - share.sum(axis=1)
    arm = (
        q[:, :3] - (share[:, 0] * points[:, 0] + share[:, 1] * points[:, 1]) - seated * ground.seat
    )
    by_arm = -(share[:, 0, :, None] * slopes[:, 0] + share[:, 1, :, None] * slopes[:, 1])
    by_arm[:, :, :3] += np.eye(3)
    tipping, pushing = {}, {}
    for order, by in enumerate((total.by_position, total.by_velocity, total.by_acceleration)):
        tipping[order] = (by[:, 3:] + np.cross(arm[:, :, None], by[:, :3], axis=1)) / (
            CENTRE_OF_PRESSURE_M * weight
        )
        pushing[order] = by[:, :3] / (ground.spread * weight)[:, :, None]
    tipping[0] += np.cross(by_arm, force[:, :, None], axis=1) / (CENTRE_OF_PRESSURE_M * weight)
    return [
        ((moment + np.cross(arm, force)) / (CENTRE_OF_PRESSURE_M * weight), tipping),
        ((force / weight - ground.force) / ground.spread, pushing),
    ]


def _compute_typical_force(phase: Array) -> Array:
    """(nf, 3) body weights, what the ground does to both feet of a walking person in all.

    The first two harmonics that symmetry leaves of OpenSim's `subject01` (the recording from which
    the curves come): forward and up once and twice a step, sideways once and three times a stride.
    Its load passes from one foot to the other at 0.076 of a stride, here it does in the middle of
    double support.
    """
    step, stride = 4 * np.pi * (phase + FORCE_PHASE_LAG), 2 * np.pi * (phase + FORCE_PHASE_LAG)
    return np.stack(
        [
            0.109 * np.cos(step)
            - 0.033 * np.sin(step)
            + 0.055 * np.cos(2 * step)
            + 0.027 * np.sin(2 * step),
            1.0 + 0.147 * np.cos(step) + 0.111 * np.sin(step),
            0.043 * np.cos(stride) - 0.058 * np.sin(stride) + 0.033 * np.cos(3 * stride),
        ],
        axis=1,
    )


def _build_target_rows(basis: SplineBasis, coefficients: Array, meant: TargetMotion) -> list[_Rows]:
    """Coordinates and accelerations as meant."""
    slides = np.array([is_translation(name) for name in COORDINATES])
    arms = np.array([coordinates.group_of(name) == "arm" for name in COORDINATES])
    place = meant.spread * np.where(slides, PLACE_M, np.where(arms, ARM_ANGLE, ANGLE))
    acceleration = meant.spread * np.where(slides, ACCELERATION, ANGULAR_ACCELERATION)
    rows: list[_Rows] = []
    for order, wanted, scale in ((0, meant.q, place), (2, meant.acceleration, acceleration)):
        slope = np.broadcast_to(np.diag(1.0 / scale), (len(basis.time), len(scale), len(scale)))
        rows.append(((basis.evaluate(coefficients, order) - wanted) / scale, {order: slope}))
    return rows


def _solve_step(basis: SplineBasis, rows: list[_Rows]) -> Array:
    """(nn, nq) the Gauss-Newton step: the nodes of a frame are six, so that the normal equations
    are a band.
    """
    nq, nf = len(COORDINATES), len(basis.time)
    width = ORDER * nq
    value = np.concatenate([values for values, _ in rows], axis=1)
    by_node = np.zeros((nf, value.shape[1], ORDER, nq))
    first = 0
    for values, derivatives in rows:
        part = slice(first, first + values.shape[1])
        first = part.stop
        for order, by in derivatives.items():
            weights = (basis.value, basis.rate, basis.acceleration)[order]
            by_node[:, part] += weights[:, None, :, None] * by[:, :, None, :]
    slopes = by_node.reshape(nf, -1, width)
    band, right = np.zeros((width, basis.nodes * nq)), np.zeros(basis.nodes * nq)
    for node, frames in basis.spans:
        matrix = slopes[frames].reshape(-1, width)
        product, begin = matrix.T @ matrix, node * nq
        for d in range(width):
            band[d, begin : begin + width - d] += np.diagonal(product, -d)
        right[begin : begin + width] -= matrix.T @ value[frames].ravel()
    step: Array = solveh_banded(band, right, lower=True)
    return step.reshape(basis.nodes, nq)
