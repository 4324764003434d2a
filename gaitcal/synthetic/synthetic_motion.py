"""Motions of the built-in subject with known parameters, their markers and ground reactions.

Motions are the gait of `walk.py` and six functional trials. They are quintic splines, so that a fit
without noise can be exact. Angles about other joint axes would give another movement of the body.
Therefore a person with other axes gets the motion in which its markers are nearest to those of the
nominal person.

Noise of each marker coordinate and trial (Reinbolt et al. 2007, after Cheze et al. 1995):
A sin(omega t + phi), with A ~ U(0, 10 mm), omega ~ U(0, 25 rad/s), phi ~ U(0, 2 pi).

The total ground reaction follows from inverse dynamics, so that the true pelvis residual is zero.
It is distributed between the feet exactly:

1. The vertical load passes from foot to foot in a quintic ramp; a swinging foot has none.
2. Each centre of pressure rolls from heel to toe. The mean of both, weighted by load, must be the
   centre of pressure of the total. The difference of some millimetres is compensated along the line
   between the feet by the load shares, and across it by a displacement of both centres.
3. The forces of both feet meet in a point above the middle of the body, as in walking people (Maus
   et al. 2010, Nature Communications 1:70), so that the front foot brakes and the rear foot drives.
4. The free moment is divided like the load.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, compute_pelvis_residual
from gaitcal.io.recording import Recording
from gaitcal.model.chain import get_chain
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.walk import (
    GAIT_CYCLE,
    Ground,
    TargetMotion,
    compute_feet,
    compute_nominal_curves,
    fit_carried_motion,
    make_walking_ground,
)
from gaitcal.tracking.marker_residual import PlacedMarkers, compute_marker_positions
from gaitcal.tracking.motion import track_motion
from gaitcal.tracking.spline import (
    ControlPointRule,
    SplineBasis,
    build_spline_basis,
    convert_to_bspline,
)
from gaitcal.tracking.trial_problem import build_trial_problem

RATE = 200.0
"""Frames per second of all published trials."""
GAIT_FRAMES = 208
"""Frames of the published gait: one stride from right heel strike."""
WALK_STRIDES = (-0.2, 1.8)
"""First and last phase (strides) of a synthetic walk: one whole stride of each foot."""
ISOLATED_FRAMES = 1200
NODES = 20
"""Control points of a published trial."""
WALK_NODES = 35
"""Control points of a walk of two strides: the spacing of knots is that of the published gait."""

HIP_ROTATIONS_DEG = ((20.0, 30.0), (-15.0, 20.0))
"""Mean and amplitude of flexion in the first half of the hip trial, of adduction in the second."""
KNEE_ROTATION_DEG = (45.0, 40.0)
"""Mean and amplitude of knee flexion in the knee trial."""
ANKLE_ROTATION_DEG = (-8.0, 24.0)
"""Mean and amplitude of dorsiflexion in the ankle trial."""
SUBTALAR_AMPLITUDE_DEG = 18.0
ISOLATED_HZ = {"hip": 2.0 / 3.0, "knee": 0.5, "ankle": 0.5}
NOISE_AMPLITUDE = 0.010
"""m."""
NOISE_OMEGA = 25.0
"""rad/s."""
FOOT_MARKER_WEIGHT = 4.0
"""Weight of foot markers, so that legs of unequal length stand on the same floor."""
MEETING_HEIGHT = 0.7
"""Height at which the forces of both feet meet, as a share of body height."""


@with_one_blas_thread
def compute_synthetic_markers(parameters: Parameters, markers: MarkerPlacement, q: Array) -> Array:
    """Compute the markers of a linkage.

    Parameters
    ----------
    parameters
        Of the linkage.
    markers
        Markers with their positions in segments.
    q
        (nf, nq) coordinates, m and rad.

    Returns
    -------
    (nf, nm, 3) m in the laboratory, in the order of `markers.labels`.
    """
    chain = get_chain()
    segment = np.array([chain.segments.index(s) for s in markers.segments], dtype=np.intp)
    order = np.argsort(segment, kind="stable")
    in_order = PlacedMarkers(segment[order], markers.local[order])
    placed = compute_marker_positions(chain.body(parameters), in_order, q)
    out = np.empty((len(q), len(segment), 3))
    out[:, order] = placed.transpose(2, 0, 1)
    return out


def draw_marker_noise(
    time: Array, markers: int, rng: np.random.Generator, amplitude: float = NOISE_AMPLITUDE
) -> Array:
    """Draw continuous noise, one sinusoid for each marker coordinate.

    Parameters
    ----------
    time
        (nf,) s.
    markers
        Number of markers, nm.
    rng
        Source of randomness.
    amplitude
        Largest amplitude, m.

    Returns
    -------
    (nf, nm, 3) m.
    """
    a = rng.uniform(0.0, amplitude, (markers, 3))
    omega = rng.uniform(0.0, NOISE_OMEGA, (markers, 3))
    phi = rng.uniform(0.0, 2 * np.pi, (markers, 3))
    out: Array = a * np.sin(omega * time[:, None, None] + phi)
    return out


def is_nominal(parameters: Parameters) -> bool:
    """Whether all joint parameters are those of the nominal person."""
    return bool(np.array_equal(parameters.joint, published_model().parameters.joint))


def fit_to_nominal_markers(parameters: Parameters, basis: SplineBasis, q: Array) -> Array:
    """Fit the motion in which a person's markers are nearest to those of the nominal person.

    Parameters
    ----------
    parameters
        Of the person.
    basis
        Spline basis of the motion.
    q
        (nf, nq) coordinates of the nominal person, m and rad.

    Returns
    -------
    (nn, nq) control points, m and rad.
    """
    nominal = published_model(static_only=True)
    positions = compute_synthetic_markers(nominal.parameters, nominal.markers, q)
    recording = Recording(
        source="nominal", time=basis.time, labels=nominal.markers.labels, markers=positions
    )
    weight = np.where(
        [s.startswith("foot") for s in nominal.markers.segments], FOOT_MARKER_WEIGHT, 1.0
    )
    person = replace(
        nominal, parameters=parameters, markers=replace(nominal.markers, weight=weight)
    )
    problem = build_trial_problem(
        "nominal", person, recording, ControlPointRule(fixed=basis.control_points)
    )
    coefficients: Array = track_motion(problem, parameters).coefficients
    return coefficients


@dataclass(frozen=True)
class TrueMotion:
    """A motion that is exactly a spline."""

    basis: SplineBasis
    coefficients: Array
    """(nn, nq) control points, m and rad."""
    phase: Array | None = None
    """(nf,) of a gait: strides since a right heel strike."""
    ground: Ground | None = None
    """Support; None: ground reactions are not known."""

    @property
    def q(self) -> Array:
        """(nf, nq) coordinates, m and rad."""
        return self.basis.evaluate(self.coefficients)


@cache
@with_one_blas_thread
def simulate_gait() -> TrueMotion:
    """Simulate the published gait: one stride of the nominal subject, 208 frames at 200 Hz.

    It starts with a right heel strike. Its target is that stride of a longer walk, because
    accelerations are poorly determined at the ends of a spline.

    Returns
    -------
    TrueMotion
    """
    parameters = published_model().parameters
    time = np.arange(GAIT_FRAMES) / RATE
    walk = simulate_two_strides(parameters)
    spline = convert_to_bspline(walk.basis, walk.coefficients)
    walk_time = time - WALK_STRIDES[0] * GAIT_CYCLE
    target = TargetMotion(spline(walk_time), spline(walk_time, 2), spread=0.2)
    return _simulate_walk(parameters, time, 0.0, NODES, target)


@with_one_blas_thread
def simulate_two_strides(parameters: Parameters) -> TrueMotion:
    """Simulate a walk with a whole stride of each foot: 415 frames at 200 Hz."""
    begin, end = WALK_STRIDES
    time = np.arange(round((end - begin) * GAIT_CYCLE * RATE) + 1) / RATE
    curves = compute_nominal_curves(begin + time / GAIT_CYCLE)
    if not is_nominal(parameters):
        basis = build_spline_basis(time, WALK_NODES)
        coefficients = fit_to_nominal_markers(parameters, basis, curves.q)
        curves = TargetMotion(basis.evaluate(coefficients), basis.evaluate(coefficients, 2))
    return _simulate_walk(parameters, time, begin, WALK_NODES, curves)


def _simulate_walk(
    parameters: Parameters, time: Array, begin: float, nodes: int, target: TargetMotion
) -> TrueMotion:
    """Simulate a walk near the target; `begin` is the phase (strides) at time 0."""
    basis, phase = build_spline_basis(time, nodes), begin + time / GAIT_CYCLE
    ground = make_walking_ground(phase)
    return TrueMotion(basis, fit_carried_motion(parameters, basis, ground, target), phase, ground)


@with_one_blas_thread
def simulate_isolated_trial(joint: str, standing: Array | None = None) -> TrueMotion:
    """Simulate a functional trial: 1200 frames at 200 Hz, with the other joints nearly still.

    Parameters
    ----------
    joint
        `hip_r`, `knee_r`, `ankle_r`, `hip_l`, `knee_l` or `ankle_l`.
    standing
        (nq,) coordinates of the standing person, m and rad; of the nominal person unless given.

    Returns
    -------
    TrueMotion
    """
    kind, side = joint.split("_")
    time = np.arange(ISOLATED_FRAMES) / RATE
    q = np.tile(make_standing_pose() if standing is None else standing, (ISOLATED_FRAMES, 1))
    cycle = 2 * np.pi * ISOLATED_HZ[kind] * time

    def add_rotation(name: str, degrees: Array) -> None:
        q[:, COORDINATE_INDEX[f"{name}_{side}"]] += np.deg2rad(degrees)

    if kind == "hip":
        half = time[-1] / 2
        windows = (
            np.sin(np.pi * np.clip((time - start) / half, 0.0, 1.0)) ** 2 for start in (0.0, half)
        )
        for name, (mean, amplitude), window in zip(
            ("hip_flexion", "hip_adduction"), HIP_ROTATIONS_DEG, windows, strict=True
        ):
            add_rotation(name, window * (mean + amplitude * np.sin(cycle)))
    elif kind == "knee":
        add_rotation("knee_angle", KNEE_ROTATION_DEG[0] + KNEE_ROTATION_DEG[1] * np.sin(cycle))
        add_rotation("hip_flexion", np.full(len(time), 30.0))
    else:
        add_rotation("ankle_angle", ANKLE_ROTATION_DEG[0] + ANKLE_ROTATION_DEG[1] * np.sin(cycle))
        add_rotation("subtalar_angle", SUBTALAR_AMPLITUDE_DEG * np.cos(cycle))
    sway = 0.004 * np.sin(2 * np.pi * 0.3 * time)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += sway
    q[:, COORDINATE_INDEX["pelvis_tz"]] += 0.5 * sway
    q[:, COORDINATE_INDEX["pelvis_tilt"]] += np.deg2rad(1.0) * np.sin(2 * np.pi * 0.25 * time)
    return _fit_spline(time, q)


def make_standing_pose(parameters: Parameters | None = None) -> Array:
    """Make the upright posture with arms slightly away from the body.

    Parameters
    ----------
    parameters
        Of a person whose markers are then nearest to the nominal person's; the nominal person
        unless given.

    Returns
    -------
    (nq,) coordinates, m and rad.
    """
    q = np.zeros(len(COORDINATES))
    q[COORDINATE_INDEX["pelvis_ty"]] = 0.95
    for side in ("r", "l"):
        q[COORDINATE_INDEX[f"arm_add_{side}"]] = np.deg2rad(-12.0)
        q[COORDINATE_INDEX[f"elbow_flex_{side}"]] = np.deg2rad(10.0)
    if parameters is None or is_nominal(parameters):
        return q
    basis = build_spline_basis(np.arange(12) / 200.0, 6)
    mean: Array = basis.evaluate(
        fit_to_nominal_markers(parameters, basis, np.tile(q, (12, 1)))
    ).mean(axis=0)
    return mean


@with_one_blas_thread
def simulate_static_trial(frames: int = 100, standing: Array | None = None) -> TrueMotion:
    """Simulate quiet standing at 200 Hz.

    Parameters
    ----------
    frames
        Number of frames.
    standing
        (nq,) coordinates, m and rad; of the nominal person unless given.

    Returns
    -------
    TrueMotion
    """
    time = np.arange(frames) / RATE
    return _fit_spline(
        time, np.tile(make_standing_pose() if standing is None else standing, (frames, 1))
    )


def _fit_spline(time: Array, q: Array) -> TrueMotion:
    """Fit a spline with the control points of a published trial to coordinates (nf, nq)."""
    basis = build_spline_basis(time, NODES)
    return TrueMotion(basis, basis.fit(q))


@dataclass(frozen=True)
class GroundOnFeet:
    """Ground reactions on the right and the left foot."""

    wrench: Array
    """(nf, 2, 6) N, N·m about the laboratory origin."""
    centre: Array
    """(nf, 2, 3) m, centre of pressure on the floor; in swing that of the last or next contact."""
    load_share: Array
    """(nf, 2) shares of the vertical force; they sum to 1."""


@with_one_blas_thread
def compute_residual_free_wrench(parameters: Parameters, motion: TrueMotion) -> Array:
    """Compute the wrenches on both feet with which a gait has no pelvis residual.

    Parameters
    ----------
    parameters
        Of the person.
    motion
        Motion with known ground.

    Returns
    -------
    (nf, 2, 6) N, N·m on the right and the left foot, about the laboratory origin.
    """
    return compute_ground_on_feet(parameters, motion).wrench


@with_one_blas_thread
def compute_ground_on_feet(parameters: Parameters, motion: TrueMotion) -> GroundOnFeet:
    """Compute the ground reactions of a motion; a seat bears the load that the feet do not.

    Parameters
    ----------
    parameters
        Of the person.
    motion
        Motion with known ground.

    Returns
    -------
    GroundOnFeet

    Raises
    ------
    ValueError
        The ground of the motion is not known.
    """
    ground = motion.ground
    if ground is None:
        raise ValueError("the ground of this motion is not known")
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    total = compute_pelvis_residual(
        q, Dynamics(parameters).compute_forces(q, v, a, np.zeros((len(q), 2, 6)))
    )
    force, moment = total[:, :3], total[:, 3:] + np.cross(q[:, :3], total[:, :3])
    carried = np.asarray(ground.share.any(axis=1))
    up = np.where(carried, force[:, 1], 1.0)
    # About the point `middle` the total has no horizontal moment.
    middle = np.stack([moment[:, 2] / up, np.zeros(len(up)), -moment[:, 0] / up], axis=1)
    free = moment[:, 1] - np.cross(middle, force)[:, 1]
    # Load shares and centres of pressure, whose weighted mean must be `middle`
    share, feet = ground.share, compute_feet(parameters, q)
    rolling = feet.interpolate_sole(ground.part, ground.level)[0]
    seated = 1.0 - share.sum(axis=1)
    height = np.einsum("fk,fk->f", share, ground.level) + seated * ground.seat[:, 1]
    middle += height[:, None] * force / up[:, None]
    missing = middle - np.einsum("fk,fki->fi", share, rolling) - seated[:, None] * ground.seat
    between = rolling[:, 0] - rolling[:, 1]
    # 1 if both feet have the same load; 0 with zero slope if one foot has none
    both = 16.0 * (share[:, 0] * share[:, 1]) ** 2
    shift = both * np.einsum("fi,fi->f", missing, between)
    shift /= np.einsum("fi,fi->f", between, between)
    centre = rolling + (missing - shift[:, None] * between)[:, None]
    share = share + np.stack([shift, -shift], axis=1)
    # Forces of both feet meet at a point above `middle`.
    meeting = middle + MEETING_HEIGHT * published_model().subject.height * force / up[:, None]
    wrench = np.zeros((len(force), len(FEET), 6))
    for foot in range(len(FEET)):
        line = (meeting - centre[:, foot]) / (meeting - middle)[:, 1:2]
        wrench[:, foot, :3] = (share[:, foot] * up)[:, None] * line
        wrench[:, foot, 3:] = np.cross(centre[:, foot], wrench[:, foot, :3])
        wrench[:, foot, 4] += share[:, foot] * free
    return GroundOnFeet(np.where(carried[:, None, None], wrench, 0.0), centre, share)
