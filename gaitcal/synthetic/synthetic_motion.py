"""Known motions of the built-in subject, and what is measured of them: markers with noise, and
ground reactions.

Motions are the gait of `walk.py` and the six isolated trials. They are quintic splines, sampled:
the true motion lies in a spline space exactly, so that a noiseless reproduction can be exact. A
person whose axes lie elsewhere in the same body looks, standing and walking, as the nominal one
does: its motion is the one in which its markers come nearest to those of the nominal person (the
same angles about other axes would make another body).

Noise, per marker coordinate and trial: A sin(omega t + phi), A ~ U(0, 10 mm), omega ~ U(0, 25
rad/s), phi ~ U(0, 2 pi) (Reinbolt et al. 2007, after Cheze et al. 1995), from the generator that
the caller gives.

The total wrench of the ground is what the motion asks for (root inverse dynamics), so that the true
pelvis residual is zero. It is divided between the feet in four steps, each exact:

1. The vertical load goes from foot to foot by a quintic ramp, in which the swinging foot has none.
2. Each foot's centre of pressure rolls from heel to toe. The load on both has its centre where the
   motion wants it: the rest, some millimetres, is met by the ramp along the line between the feet,
   and by moving both centres across it.
3. The forces of both feet meet in one point above the middle of the body, as those of walking
   people do (Maus et al. 2010, Nature Communications 1:70), so that the front foot brakes while the
   rear one drives.
4. The free moment is divided like the load: forces that meet above the centre add none to it.
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
from gaitcal.tracking.spline import NodeRule, SplineBasis, build_spline_basis, convert_to_bspline
from gaitcal.tracking.trial_problem import build_trial_problem

RATE = 200.0  # Frames per second of all published trials
GAIT_FRAMES = 208  # Of the published study: one stride, right heel strike first
WALK_STRIDES = (
    -0.2,
    1.8,
)  # Phases of the walk of a synthetic recording: a whole stride of each foot
ISOLATED_FRAMES = 1200
NODES = 20  # Of a published trial
WALK_NODES = 35
"""Of a walk of two strides: knots as far apart as in the published gait. The splines of a published
trial are among those of so many nodes."""

HIP_ROTATIONS_DEG = ((20.0, 30.0), (-15.0, 20.0))
"""Mean and amplitude, degrees, of hip flexion in the first and adduction in the second half of the
hip trial.
"""
KNEE_ROTATION_DEG = (45.0, 40.0)
ANKLE_ROTATION_DEG = (-8.0, 24.0)
SUBTALAR_AMPLITUDE_DEG = 18.0
ISOLATED_HZ = {"hip": 2.0 / 3.0, "knee": 0.5, "ankle": 0.5}
NOISE_AMPLITUDE = 0.010  # m
NOISE_OMEGA = 25.0  # rad/s
FOOT_MARKER_WEIGHT = (
    4.0  # Weight of the feet's markers: legs of unequal length stand on one floor all the same
)
MEETING_HEIGHT = 0.7  # Of body height: where the lines of both forces meet


@with_one_blas_thread
def compute_synthetic_markers(parameters: Parameters, markers: MarkerPlacement, q: Array) -> Array:
    """(nf, nm, 3) m, markers of the linkage at coordinates (nf, nq), in the order of
    `markers.labels`.
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
    """(nf, nm, 3) m of continuous noise: one sinusoid per marker coordinate."""
    a = rng.uniform(0.0, amplitude, (markers, 3))
    omega = rng.uniform(0.0, NOISE_OMEGA, (markers, 3))
    phi = rng.uniform(0.0, 2 * np.pi, (markers, 3))
    out: Array = a * np.sin(omega * time[:, None, None] + phi)
    return out


def is_nominal(parameters: Parameters) -> bool:
    """Whether all joint parameters are those of the nominal person."""
    return bool(np.array_equal(parameters.joint, published_model().parameters.joint))


def fit_to_nominal_markers(parameters: Parameters, basis: SplineBasis, q: Array) -> Array:
    """(nn, nq) coefficients: in this motion a person's markers are nearest to the nominal person's
    at q (nf, nq).
    """
    nominal = published_model(static_only=True)
    seen = compute_synthetic_markers(nominal.parameters, nominal.markers, q)
    recording = Recording(
        source="nominal", time=basis.time, labels=nominal.markers.labels, markers=seen
    )
    weight = np.where(
        [s.startswith("foot") for s in nominal.markers.segments], FOOT_MARKER_WEIGHT, 1.0
    )
    person = replace(
        nominal, parameters=parameters, markers=replace(nominal.markers, weight=weight)
    )
    problem = build_trial_problem("nominal", person, recording, NodeRule(fixed=basis.nodes))
    coefficients: Array = track_motion(problem, parameters).coefficients
    return coefficients


@dataclass(frozen=True)
class TrueMotion:
    """A motion that lies in the spline space."""

    basis: SplineBasis
    coefficients: Array  # (nn, nq) m, rad
    phase: Array | None = None  # (nf,) of a gait: strides since a right heel strike
    ground: Ground | None = None  # What carries it; None: no force is known

    @property
    def q(self) -> Array:
        """(nf, nq)."""
        return self.basis.evaluate(self.coefficients)


@cache
@with_one_blas_thread
def simulate_gait() -> TrueMotion:
    """The published gait of the nominal subject: one stride, right heel strike first, 208 frames at
    200 Hz.

    It is like that stride of a longer walk, whose ends are elsewhere: at an end nothing holds
    accelerations.
    """
    parameters = published_model().parameters
    time, longer = np.arange(GAIT_FRAMES) / RATE, simulate_two_strides(parameters)
    spline, stride = (
        convert_to_bspline(longer.basis, longer.coefficients),
        time - WALK_STRIDES[0] * GAIT_CYCLE,
    )
    return _simulate_walk(
        parameters, time, 0.0, NODES, TargetMotion(spline(stride), spline(stride, 2), spread=0.2)
    )


@with_one_blas_thread
def simulate_two_strides(parameters: Parameters) -> TrueMotion:
    """A walk of a person with these parameters in which both feet have a whole stride: 415 frames
    at 200 Hz.
    """
    begin, end = WALK_STRIDES
    time = np.arange(round((end - begin) * GAIT_CYCLE * RATE) + 1) / RATE
    curves = compute_nominal_curves(begin + time / GAIT_CYCLE)
    if not is_nominal(parameters):
        basis = build_spline_basis(time, WALK_NODES)
        coefficients = fit_to_nominal_markers(parameters, basis, curves.q)
        curves = TargetMotion(basis.evaluate(coefficients), basis.evaluate(coefficients, 2))
    return _simulate_walk(parameters, time, begin, WALK_NODES, curves)


def _simulate_walk(
    parameters: Parameters, time: Array, begin: float, nodes: int, meant: TargetMotion
) -> TrueMotion:
    """A walk of a person with these parameters like another; `begin`: its phase, in strides, at
    time 0.
    """
    basis, phase = build_spline_basis(time, nodes), begin + time / GAIT_CYCLE
    ground = make_walking_ground(phase)
    return TrueMotion(basis, fit_carried_motion(parameters, basis, ground, meant), phase, ground)


@with_one_blas_thread
def simulate_isolated_trial(joint: str, standing: Array | None = None) -> TrueMotion:
    """An isolated trial of `hip_r` ... `ankle_l`: 1200 frames at 200 Hz; the rest of the body
    nearly still.
    """
    kind, side = joint.split("_")
    time = np.arange(ISOLATED_FRAMES) / RATE
    q = np.tile(make_standing_pose() if standing is None else standing, (ISOLATED_FRAMES, 1))
    cycle = 2 * np.pi * ISOLATED_HZ[kind] * time

    def put(name: str, degrees: Array) -> None:
        q[:, COORDINATE_INDEX[f"{name}_{side}"]] += np.deg2rad(degrees)

    if kind == "hip":
        half = time[-1] / 2
        windows = (
            np.sin(np.pi * np.clip((time - start) / half, 0.0, 1.0)) ** 2 for start in (0.0, half)
        )
        for name, (mean, amplitude), window in zip(
            ("hip_flexion", "hip_adduction"), HIP_ROTATIONS_DEG, windows, strict=True
        ):
            put(name, window * (mean + amplitude * np.sin(cycle)))
    elif kind == "knee":
        put("knee_angle", KNEE_ROTATION_DEG[0] + KNEE_ROTATION_DEG[1] * np.sin(cycle))
        put("hip_flexion", np.full(len(time), 30.0))
    else:
        put("ankle_angle", ANKLE_ROTATION_DEG[0] + ANKLE_ROTATION_DEG[1] * np.sin(cycle))
        put("subtalar_angle", SUBTALAR_AMPLITUDE_DEG * np.cos(cycle))
    sway = 0.004 * np.sin(2 * np.pi * 0.3 * time)
    q[:, COORDINATE_INDEX["pelvis_tx"]] += sway
    q[:, COORDINATE_INDEX["pelvis_tz"]] += 0.5 * sway
    q[:, COORDINATE_INDEX["pelvis_tilt"]] += np.deg2rad(1.0) * np.sin(2 * np.pi * 0.25 * time)
    return _fit_spline(time, q)


def make_standing_pose(parameters: Parameters | None = None) -> Array:
    """(nq,) upright, arms slightly away from the body; of a person with other joint parameters,
    what looks so.
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
    """Quiet standing."""
    time = np.arange(frames) / RATE
    return _fit_spline(
        time, np.tile(make_standing_pose() if standing is None else standing, (frames, 1))
    )


def _fit_spline(time: Array, q: Array) -> TrueMotion:
    basis = build_spline_basis(time, NODES)
    return TrueMotion(basis, basis.fit(q))


@dataclass(frozen=True)
class GroundOnFeet:
    """Ground reactions on the right and the left foot."""

    wrench: Array  # (nf, 2, 6) N, N·m about the laboratory origin
    centre: Array
    """(nf, 2, 3) m, centre of pressure on the floor, y = 0; in swing where the foot struck last or
    will strike.
    """
    load_share: Array  # (nf, 2) of the vertical force; they sum to 1


@with_one_blas_thread
def compute_residual_free_wrench(parameters: Parameters, motion: TrueMotion) -> Array:
    """(nf, 2, 6) wrenches on right and left foot about the laboratory origin that leave no pelvis
    residual in gait.
    """
    return compute_ground_on_feet(parameters, motion).wrench


@with_one_blas_thread
def compute_ground_on_feet(parameters: Parameters, motion: TrueMotion) -> GroundOnFeet:
    """The ground reactions of a motion of a person with these parameters; a seat bears what no foot
    does.

    Raises ValueError: Nothing is said of the ground.
    """
    ground = motion.ground
    if ground is None:
        raise ValueError("nothing is said of the ground that carries this motion")
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    total = compute_pelvis_residual(
        q, Dynamics(parameters).compute_forces(q, v, a, np.zeros((len(q), 2, 6)))
    )
    force, moment = total[:, :3], total[:, 3:] + np.cross(q[:, :3], total[:, :3])
    carried = np.asarray(ground.share.any(axis=1))
    up = np.where(carried, force[:, 1], 1.0)
    middle = np.stack(
        [moment[:, 2] / up, np.zeros(len(up)), -moment[:, 0] / up], axis=1
    )  # no tipping moment there
    free = moment[:, 1] - np.cross(middle, force)[:, 1]
    # shares of the load and centres of pressure, whose weighted mean is the middle
    share, rolling = ground.share, compute_feet(parameters, q).along(ground.part, ground.level)[0]
    seated = 1.0 - share.sum(axis=1)
    height = np.einsum("fk,fk->f", share, ground.level) + seated * ground.seat[:, 1]
    middle += height[:, None] * force / up[:, None]
    missed = middle - np.einsum("fk,fki->fi", share, rolling) - seated[:, None] * ground.seat
    apart = rolling[:, 0] - rolling[:, 1]
    both = (
        16.0 * (share[:, 0] * share[:, 1]) ** 2
    )  # 1 where the feet share alike, and 0, also in its rate, at the ends
    moved = both * np.einsum("fi,fi->f", missed, apart) / np.einsum("fi,fi->f", apart, apart)
    centre = rolling + (missed - moved[:, None] * apart)[:, None]
    share = share + np.stack([moved, -moved], axis=1)
    # forces that meet above the middle
    meeting = middle + MEETING_HEIGHT * published_model().subject.height * force / up[:, None]
    wrench = np.zeros((len(force), len(FEET), 6))
    for foot in range(len(FEET)):
        line = (meeting - centre[:, foot]) / (meeting - middle)[:, 1:2]
        wrench[:, foot, :3] = (share[:, foot] * up)[:, None] * line
        wrench[:, foot, 3:] = np.cross(centre[:, foot], wrench[:, foot, :3])
        wrench[:, foot, 4] += share[:, foot] * free
    return GroundOnFeet(np.where(carried[:, None, None], wrench, 0.0), centre, share)
