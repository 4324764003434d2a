"""A walk of one person that obeys Newton's law: the nominal gait, changed as little as necessary.

The nominal gait is the coordinates of one person over the gait cycle, with six harmonics each
(`models/nominal_subject.json`, derived from OpenSim's Gait2392 `subject01`, CC BY 3.0). The centre
of pressure rolls from heel to toe, fast under the heel and slowly under the forefoot (Perry 1992).
The left side follows half a stride later.

Motion and masses determine the total ground reaction and the point of the floor about which it has
no horizontal moment, its centre of pressure. In a walk this point is under the standing foot or
between both feet; in smoothed curves of another person it is not. Therefore the control points x of
the motion minimise

    sum |r_k(x) / s_k|^2,

where the residuals r_k, each with its standard deviation s_k below, are

- the moment of the total ground reaction about the point to which the load has rolled,
- the total force less that of walking people,
- velocities of heel and ball while they rest, and positions of the feet less the nominal ones,
- coordinates and accelerations less the nominal ones.

It is solved by Gauss-Newton steps with a banded matrix. Joint torques are not fitted. It works for
any linkage; the nominal person's angles change by 0.3 to 1 degree (RMS).
"""

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from gaitcal.arrays import Array
from gaitcal.dynamics import inverse_dynamics, plate_outline
from gaitcal.dynamics.derivatives import compute_root_residual
from gaitcal.io.toml import find_models_folder
from gaitcal.model import coordinates, nominal, subject_model
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES, SIDES, is_translation
from gaitcal.model.parameters import Parameters
from gaitcal.tracking.spline import ORDER, SplineBasis

GAIT_CYCLE = 1.035
"""Duration of a stride (s): `cycle_s` of the nominal gait."""
STANCE = 0.62
"""Share of a stride in which a foot is on the ground."""
DOUBLE_SUPPORT = STANCE - 0.5
"""Share of a stride of each of the two phases of double support."""
POINTS = ("Heel", "Toe.Tip", "Toe.Lat", "Toe.Med")
"""Markers of a foot. The load rolls along the line from the first to the second; the last two are
at the ball."""
ROLL = ((0.0, 0.12, 0.3, 0.55, 0.8, 1.0), (0.10, 0.28, 0.42, 0.58, 0.72, 0.86))
"""Share of stance, and share of the way from the back of the heel to the tip of the foot at which
the centre of pressure is then."""
HEEL_REST, BALL_REST = (0.01, 0.35), (0.1, 0.54)
"""Phases of the foot's stride between which heel and ball do not move."""
REST_RAMP_PHASE = 0.06
"""Share of a stride in which a point comes to rest, and in which it starts to move."""
CLEARANCE = 0.02
"""Height (m) of the lowest foot marker of the nominal person above the floor."""
FORCE_PHASE_LAG = 0.076 - 0.5 * DOUBLE_SUPPORT
"""Strides by which the load of the recording passes to the other foot later than here."""

# Standard deviations of the residuals
CENTRE_OF_PRESSURE_M = 0.006
"""Of the centre of pressure; times body weight, of each moment about that point."""
FORCE_SPREAD = np.array([0.10, 0.03, 0.01])
"""Of the total force (forward, up, right), body weights."""
ANGLE, ARM_ANGLE, POSITION_M = np.deg2rad(2.0), np.deg2rad(4.0), 0.01
"""Of angles (rad), of the arms' angles (rad), and of the pelvis position (m)."""
ANGULAR_ACCELERATION, ACCELERATION = 25.0, 2.0
"""rad/s^2, m/s^2; without them splines oscillate at their ends."""
FOOT_POSITION_M = 0.02
FOOT_SPEED = 0.03
"""Of a resting point, m/s."""

SMALLEST_STEP = 1e-3
"""Largest change of a control point (m, rad) in the last step."""
MAX_STEPS = 30


@dataclass(frozen=True)
class FeetOnGround:
    """Points of both feet over time."""

    points: Array
    """(nf, 2, 4, 3) m, of the right and the left foot, in the order of `POINTS`."""
    jacobians: Array
    """(nf, 2, 4, 3, nq) derivatives of the points by the coordinates."""

    def interpolate_sole(self, part: Array, level: Array | float = 0.0) -> tuple[Array, Array]:
        """Interpolate points on the ground between heel and tip of each foot.

        Parameters
        ----------
        part
            (nf, 2) share of the way from heel to tip.
        level
            (nf, 2) m, height of the ground.

        Returns
        -------
        points : (nf, 2, 3) m
        jacobians : (nf, 2, 3, nq)
        """
        share = (part * _compute_foot_length_ratio())[..., None]
        points = (1.0 - share) * self.points[:, :, 0] + share * self.points[:, :, 1]
        share = share[..., None]
        jacobians = (1.0 - share) * self.jacobians[:, :, 0] + share * self.jacobians[:, :, 1]
        points[:, :, 1], jacobians[:, :, 1] = level, 0.0
        return points, jacobians


def compute_feet(parameters: Parameters, q: Array) -> FeetOnGround:
    """Compute the points of both feet and their Jacobians.

    Parameters
    ----------
    parameters
        Of the linkage.
    q
        (nf, nq) coordinates, m and rad.

    Returns
    -------
    FeetOnGround
        In the laboratory.
    """
    chain = get_chain()
    placed = Kinematics(chain.body(parameters), q)
    axes, origins = placed.axes, placed.origins
    columns = placed.columns.transpose(2, 1, 0)  # (nf, 6, nq)
    points = np.empty((len(q), len(inverse_dynamics.FEET), len(POINTS), 3))
    jacobians = np.zeros((*points.shape, q.shape[1]))
    for foot, segment in enumerate(inverse_dynamics.FEET):
        k = chain.segments.index(segment)
        moved = np.flatnonzero(chain.support[:, k])
        for n, local in enumerate(_get_local_points()[foot]):
            point = np.einsum("j,jif->fi", local, axes[k]) + origins[k].T
            rotated = np.cross(columns[:, 3:, moved], point[:, :, None], axis=1)
            points[:, foot, n] = point
            jacobians[:, foot, n][:, :, moved] = columns[:, :3, moved] + rotated
    return FeetOnGround(points, jacobians)


def compute_foot_phases(phase: Array) -> Array:
    """Compute (nf, 2) phases of the right and the left foot's stride, 0 to 1 from its strike."""
    return np.stack([phase % 1.0, (phase - 0.5) % 1.0], axis=1)


def _compute_rolled_part(phase: Array) -> Array:
    """Compute (nf, 2) the share of the way from heel to tip to which each load has rolled.

    In swing it is that of the end of stance.
    """
    part: Array = PchipInterpolator(*ROLL)(np.minimum(compute_foot_phases(phase) / STANCE, 1.0))
    return part


def _compute_right_share(phase: Array) -> Array:
    """Compute (nf,) the right foot's share of the vertical load; phase 0: right heel strike."""
    cycle = phase % 1.0
    rise = compute_ramp(cycle / DOUBLE_SUPPORT)
    fall = 1.0 - compute_ramp((cycle - 0.5) / DOUBLE_SUPPORT)
    return np.where(
        cycle < DOUBLE_SUPPORT,
        rise,
        np.where(cycle < 0.5, 1.0, np.where(cycle < STANCE, fall, 0.0)),
    )


def _compute_rest_weights(phase: Array) -> Array:
    """Compute (nf, 2, 4) how much each point of the feet rests: 0 to 1, smooth in time."""
    cycle = compute_foot_phases(phase)
    out = np.zeros((len(phase), len(inverse_dynamics.FEET), len(POINTS)))
    # Point 0 is the heel, points 2 and 3 are at the ball.
    for points, (begin, end) in (((0,), HEEL_REST), ((2, 3), BALL_REST)):
        comes = compute_ramp((cycle - begin) / REST_RAMP_PHASE)
        leaves = compute_ramp((cycle - end + REST_RAMP_PHASE) / REST_RAMP_PHASE)
        for point in points:
            out[:, :, point] = comes * (1.0 - leaves)
    return out


@cache
def _get_local_points() -> Array:
    """Get (2, 4, 3) m, points of the right and the left foot in their segments, of all subjects."""
    markers = nominal.published_model().markers
    labels = [f"{side.upper()}.{name}" for side in SIDES for name in POINTS]
    rows = [markers.labels.index(label) for label in labels]
    return np.asarray(markers.local[rows]).reshape(len(SIDES), len(POINTS), 3)


@cache
def _compute_foot_length_ratio() -> float:
    """Compute the ratio of the length of a foot to the distance of its heel and toe markers."""
    heel, toe = _get_local_points()[0, :2]
    distance = float(np.linalg.norm(toe - heel))
    foot_length = plate_outline.FOOT_LENGTH * nominal.published_model().subject.height
    return max(1.0, foot_length / distance)


def compute_ramp(x: Array) -> Array:
    """Compute a quintic ramp from 0 at x = 0 to 1 at x = 1, with zero slope and curvature there."""
    x = np.clip(x, 0.0, 1.0)
    out: Array = x**3 * (10.0 + x * (-15.0 + 6.0 * x))
    return out


@cache
def _load_nominal_gait() -> dict[str, Any]:
    """Load the harmonics of the nominal gait."""
    content = json.loads(
        (find_models_folder() / "nominal_subject.json").read_text(encoding="utf-8")
    )
    gait: dict[str, Any] = content["nominal_gait"]
    return gait


def compute_gait_curves(phase: Array) -> tuple[Array, Array]:
    """Compute coordinates and accelerations of the nominal gait.

    Parameters
    ----------
    phase
        (nf,) strides since a right heel strike.

    Returns
    -------
    q : (nf, nq) m, rad
    acceleration : (nf, nq) m/s^2, rad/s^2
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
        # The second derivative of each harmonic is -omega^2 times the harmonic.
        for out, factor in ((q, np.ones(len(a))), (acceleration, -(omega**2))):
            values = np.cos(angle) @ (factor * a) + np.sin(angle) @ (factor * b)
            out[:, i] = values if harmonics["unit"] == "m" else np.deg2rad(values)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += data["stride_m"] * phase
    return q, acceleration


_Rows = tuple[Array, dict[int, Array]]
"""Residuals (nf, n) of every frame, divided by their standard deviations, and their derivatives
(nf, n, nq) by coordinates (key 0), velocities (1) and accelerations (2)."""


@dataclass(frozen=True)
class TargetMotion:
    """The motion to which a fitted motion should be near."""

    q: Array
    """(nf, nq) m, rad."""
    acceleration: Array
    """(nf, nq) m/s^2, rad/s^2."""
    spread: float = 1.0
    """Factor of the standard deviations: less than 1 if the target nearly obeys Newton's law."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Support of a motion over time, and positions of the feet on it."""

    footsteps: Array
    """(nf, 2, 4, 3) m, target positions of the points of the feet."""
    held: Array
    """(nf, 2, 4) weight of these positions, 0 to 1."""
    resting: Array
    """(nf, 2, 4) how much each point rests, 0 to 1."""
    share: Array
    """(nf, 2) share of each foot in the vertical load; 0 in flight."""
    part: Array
    """(nf, 2) share of the way from heel to tip to which the load has rolled."""
    level: Array
    """(nf, 2) m, height of the ground under each foot."""
    seat: Array
    """(nf, 3) m, point at which a seat bears the load that the shares of the feet leave."""
    force: Array
    """(nf, 3) body weights, target of the total force."""
    spread: Array
    """(nf, 3) body weights, standard deviation of the total force; infinite: unknown force."""


def make_walking_ground(phase: Array) -> Ground:
    """Make the floor under a walk whose feet are those of the nominal person.

    Parameters
    ----------
    phase
        (nf,) strides since a right heel strike.

    Returns
    -------
    Ground
    """
    feet = compute_feet(nominal.published_model().parameters, compute_nominal_curves(phase).q)
    right = _compute_right_share(phase)
    nf = len(phase)
    return Ground(
        footsteps=feet.points,
        held=np.ones((nf, len(inverse_dynamics.FEET), len(POINTS))),
        resting=_compute_rest_weights(phase),
        share=np.stack([right, 1.0 - right], axis=1),
        part=_compute_rolled_part(phase),
        level=np.zeros((nf, len(inverse_dynamics.FEET))),
        seat=np.zeros((nf, 3)),
        force=_compute_typical_force(phase),
        spread=np.tile(FORCE_SPREAD, (nf, 1)),
    )


def fit_carried_motion(
    parameters: Parameters, basis: SplineBasis, ground: Ground, target: TargetMotion
) -> Array:
    """Fit a motion near the target for which the ground gives the total force.

    Parameters
    ----------
    parameters
        Of the person.
    basis
        Spline basis of the motion.
    ground
        Support in the frames of the basis.
    target
        Coordinates and accelerations in the frames of the basis.

    Returns
    -------
    (nn, nq) control points of the motion, m and rad.
    """
    coefficients = basis.fit(target.q)
    for _ in range(MAX_STEPS):
        rows = _build_ground_rows(parameters, basis, coefficients, ground)
        rows += _build_target_rows(basis, coefficients, target)
        step = _solve_step(basis, rows)
        coefficients += step
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return coefficients


def compute_nominal_curves(phase: Array) -> TargetMotion:
    """Compute the nominal gait at phases (nf,), strides, with the feet on the floor, y = 0."""
    q, acceleration = compute_gait_curves(phase)
    q[:, COORDINATES.index("pelvis_ty")] += _compute_floor_shift()
    return TargetMotion(q, acceleration)


@cache
def _compute_floor_shift() -> float:
    """Compute the vertical translation (m) that puts the nominal gait on the floor."""
    heights = compute_feet(
        nominal.published_model().parameters, compute_gait_curves(np.arange(0.0, 1.0, 0.005))[0]
    ).points[..., 1]
    return CLEARANCE - float(heights.min())


def _build_ground_rows(
    parameters: Parameters, basis: SplineBasis, coefficients: Array, ground: Ground
) -> list[_Rows]:
    """Build the residuals of the ground: moment and force, positions of feet, resting points."""
    q, v, a = (basis.evaluate(coefficients, k) for k in range(3))
    feet, (nf, nq) = compute_feet(parameters, q), q.shape
    still, held = ground.resting[..., None] / FOOT_SPEED, ground.held[..., None]
    speed = np.einsum("fknic,fc->fkni", feet.jacobians, v)
    position = ((feet.points - ground.footsteps) / FOOT_POSITION_M * held).reshape(nf, -1)
    by_position = (feet.jacobians / FOOT_POSITION_M * held[..., None]).reshape(nf, -1, nq)
    rest = (speed * still).reshape(nf, -1)
    # The derivative of the Jacobian is omitted: resting points hardly move.
    by_speed = (feet.jacobians * still[..., None]).reshape(nf, -1, nq)
    return [
        *_build_force_rows(parameters, (q, v, a), ground, feet),
        (position, {0: by_position}),
        (rest, {1: by_speed}),
    ]


def _build_force_rows(
    parameters: Parameters, state: tuple[Array, Array, Array], ground: Ground, feet: FeetOnGround
) -> list[_Rows]:
    """Build the residuals of the total ground reaction: moment about the loaded point, force."""
    q, weight = state[0], parameters.mass * subject_model.GRAVITY
    total = compute_root_residual(parameters, (), *state, np.zeros((len(q), 2, 6)))
    force, moment = total.value[:, :3], total.value[:, 3:]
    share = ground.share[:, :, None]
    points, jacobians = feet.interpolate_sole(ground.part, ground.level)
    seated = 1.0 - share.sum(axis=1)
    arm = (
        q[:, :3] - (share[:, 0] * points[:, 0] + share[:, 1] * points[:, 1]) - seated * ground.seat
    )
    by_arm = -(share[:, 0, :, None] * jacobians[:, 0] + share[:, 1, :, None] * jacobians[:, 1])
    by_arm[:, :, :3] += np.eye(3)
    by_moment, by_force = {}, {}
    for order, by in enumerate((total.by_position, total.by_velocity, total.by_acceleration)):
        by_moment[order] = (by[:, 3:] + np.cross(arm[:, :, None], by[:, :3], axis=1)) / (
            CENTRE_OF_PRESSURE_M * weight
        )
        by_force[order] = by[:, :3] / (ground.spread * weight)[:, :, None]
    by_moment[0] += np.cross(by_arm, force[:, :, None], axis=1) / (CENTRE_OF_PRESSURE_M * weight)
    return [
        ((moment + np.cross(arm, force)) / (CENTRE_OF_PRESSURE_M * weight), by_moment),
        ((force / weight - ground.force) / ground.spread, by_force),
    ]


def _compute_typical_force(phase: Array) -> Array:
    """Compute (nf, 3) the total ground reaction of a walking person, body weights.

    The first two harmonics that symmetry allows, of OpenSim's `subject01` (from whose recording the
    curves are): forward and up once and twice a step, sideways once and three times a stride. In
    the recording the load passes to the other foot at 0.076 of a stride, here in the middle of
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


def _build_target_rows(
    basis: SplineBasis, coefficients: Array, target: TargetMotion
) -> list[_Rows]:
    """Build the residuals of coordinates and accelerations against the target."""
    translations = np.array([is_translation(name) for name in COORDINATES])
    arms = np.array([coordinates.group_of(name) == "arm" for name in COORDINATES])
    angle = np.where(arms, ARM_ANGLE, ANGLE)
    position = target.spread * np.where(translations, POSITION_M, angle)
    acceleration = target.spread * np.where(translations, ACCELERATION, ANGULAR_ACCELERATION)
    rows: list[_Rows] = []
    for order, values, scale in ((0, target.q, position), (2, target.acceleration, acceleration)):
        shape = (len(basis.time), len(scale), len(scale))
        derivative = np.broadcast_to(np.diag(1.0 / scale), shape)
        residual = (basis.evaluate(coefficients, order) - values) / scale
        rows.append((residual, {order: derivative}))
    return rows


def _solve_step(basis: SplineBasis, rows: list[_Rows]) -> Array:
    """Solve the Gauss-Newton step (nn, nq); six control points a frame make the matrix banded."""
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
    jacobian = by_node.reshape(nf, -1, width)
    band, right = np.zeros((width, basis.control_points * nq)), np.zeros(basis.control_points * nq)
    for node, frames in basis.spans:
        matrix = jacobian[frames].reshape(-1, width)
        product, begin = matrix.T @ matrix, node * nq
        for d in range(width):
            band[d, begin : begin + width - d] += np.diagonal(product, -d)
        right[begin : begin + width] -= matrix.T @ value[frames].ravel()
    step: Array = solveh_banded(band, right, lower=True)
    return step.reshape(basis.control_points, nq)
