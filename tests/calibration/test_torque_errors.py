"""What sources of error make of a motion, its torques, powers and moments: sums of squares of
finite differences.

Their size is in `test_joint_estimate.py`.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration import error_sources, torque_errors
from gaitcal.calibration.error_sources import (
    LEVERAGE_CAP,
    ErrorSources,
    MotionSensitivity,
    classify_source,
    compute_coordinate_errors,
    compute_marker_scores,
    compute_motion_sensitivity,
    make_nominal_errors,
)
from gaitcal.calibration.torque_errors import ForceErrors
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.joint_kinetics import (
    COMPONENTS,
    HELD,
    POWERS,
    VECTOR_FRAMES,
    MomentFrame,
    compute_kinetic_values,
    power_of,
)
from gaitcal.dynamics.measurement_errors import AxisErrors, ErrorSource, PlateErrors
from gaitcal.model.parameters import IP_NAMES, JP_INDEX, Parameters, list_gait_parameters
from gaitcal.model.subject_model import PointNoise
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.marker_residual import MarkerData, compute_marker_positions
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.spline import build_smoothing
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import (
    Array,
    central_differences,
    noisy,
    perturbed_parameters,
    random_trial,
    seeded_trial,
    started,
    without_segments,
)

DIFFERENCES = 1e-5
"""Relative to the largest error: what central differences can tell."""
STEP = 1e-4
"""Of one standard deviation; the forces are cubic at most in the inertial parameters."""
UNMOVED = 0.05
"""Of what axes do to the power of one coordinate: rates are told from frames 10 ms apart."""
NOISE = 1e-5
"""m, so small that what Gauss-Newton leaves out does not show."""
LINEAR = 2e-3
"""Relative to the largest change: what is left of that, and of the solvers' tolerances."""
FREE = list_gait_parameters("r")
FRAMES = 10


def test_errors_are_what_every_source_moves_by_itself() -> None:
    """Squares summed over marker coordinates, with joint parameters and motion, over inertial
    parameters and plates. Torque and rate of a source move together: the errors of a power are not
    those of its factors.
    """
    rng, parameters, problem, coefficients = seeded_trial(51, frames=FRAMES, nodes=6)
    wrench = rng.normal(0, 300, (FRAMES, 2, 6))
    free = problem.with_free(FREE).chain.free
    own, others = 3, 2
    moves = MotionSensitivity(
        shift=rng.normal(0, 0.005, (len(free), others)),
        coefficients=rng.normal(0, 0.01, (coefficients.size, own)),
        sensitivity=rng.normal(0, 1.0, (coefficients.size, len(free))),
        trial_sources=(ErrorSource.MOTION,) * own,
        shared_sources=(ErrorSource.JOINT_MARKERS, ErrorSource.SKIN),
    )
    spread = 0.1 * parameters.inertial[:, None] * rng.normal(size=(len(IP_NAMES), 2))
    start = parameters.joint[[JP_INDEX[name] for name in free]]
    plates = PlateErrors(position=0.003, gain=0.01, time_offset=0.002)

    def change(by_nodes: Array, by_joint: Array, by_inertial: Array, by_wrench: Array) -> Array:
        """(nf, forces + powers + moments)."""

        def values(step: float) -> Array:
            moved = parameters.with_joint(free, start + step * by_joint)
            moved = moved.with_inertial(parameters.inertial + step * by_inertial)
            state = [problem.basis.evaluate(coefficients + step * by_nodes, k) for k in range(3)]
            forces = Dynamics(moved).compute_forces(*state, wrench + step * by_wrench)
            power, moment = compute_kinetic_values(moved, *state, wrench + step * by_wrench)
            return np.hstack([forces, power, moment.reshape(FRAMES, -1)])

        return (values(STEP) - values(-STEP)) / (2 * STEP)

    rates = np.gradient(wrench, problem.basis.time, axis=0)
    still, fixed, rigid, measured = (
        np.zeros(n) for n in (coefficients.shape, len(free), len(IP_NAMES), wrench.shape)
    )
    changes = {
        ErrorSource.MOTION: [
            change(n.reshape(still.shape), fixed, rigid, measured) for n in moves.coefficients.T
        ],
        ErrorSource.INERTIA: [change(still, fixed, column, measured) for column in spread.T],
        ErrorSource.PLATES: [
            change(still, fixed, rigid, other) for other in plate_changes(wrench, rates)
        ],
    }
    for source, shift in zip(moves.shared_sources, moves.shift.T, strict=True):
        changes[source] = [
            change(-(moves.sensitivity @ shift).reshape(coefficients.shape), shift, rigid, measured)
        ]
    variances = {
        source: (np.array(columns) ** 2).sum(axis=0) for source, columns in changes.items()
    }
    dense = np.sqrt(sum(variances.values()))
    known = ErrorSources(free, moves.shift, tuple(f"source {k}" for k in range(others)))
    found = ForceErrors(
        problem, coefficients, parameters, wrench, known, spread, moves, plates
    ).compute_errors()
    power, moment = found.kinetics.power, found.kinetics.moment.reshape(FRAMES, -1)
    ends = np.cumsum([found.all_forces.shape[1], power.shape[1]])
    for part, errors in zip(
        np.split(dense, ends, axis=1), (found.all_forces, power, moment), strict=True
    ):
        np.testing.assert_allclose(errors, part, rtol=0, atol=DIFFERENCES * part.max())
    assert set(found.by_source) == set(variances)
    torques = slice(len(FORCES))
    for source, variance in variances.items():
        tolerance = DIFFERENCES * dense[:, torques].max() ** 2
        np.testing.assert_allclose(
            found.by_source[source], variance[:, torques], atol=tolerance, err_msg=source.key
        )
    of_inertia = np.sqrt(variances[ErrorSource.INERTIA])[:, torques]
    assert np.mean(of_inertia > 0.05 * dense[:, torques]) > 0.5  # so that its absence would show
    own_power = np.sqrt(variances[ErrorSource.MOTION])[:, len(FORCES) : len(FORCES) + len(POWERS)]
    np.testing.assert_allclose(
        found.kinetics.from_markers.power, own_power, rtol=0, atol=DIFFERENCES * own_power.max()
    )

    columns = np.hstack([moves.coefficients, moves.sensitivity @ moves.shift]).T.reshape(
        -1, *coefficients.shape
    )
    coordinates = np.sqrt(sum(problem.basis.evaluate(column) ** 2 for column in columns))
    np.testing.assert_allclose(compute_coordinate_errors(problem, moves), coordinates, rtol=1e-10)


def plate_changes(wrench: Array, rates: Array) -> Iterator[Array]:
    """What one standard deviation of 3 mm, 1 % and 2 ms each makes of the wrenches."""
    yield 0.002 * rates
    for foot in range(2):
        for axis in (None, *np.eye(3)):
            out = np.zeros_like(wrench)
            if axis is None:
                out[:, foot] = 0.01 * wrench[:, foot]
            else:
                out[:, foot, 3:] = np.cross(0.003 * axis, wrench[:, foot, :3])
            yield out


def test_directions_of_axes_add_to_torques_and_to_coordinates_that_markers_move() -> None:
    rng, parameters, problem, coefficients = seeded_trial(53, frames=14, nodes=7)
    problem = without_segments(problem, "forearm_hand_r", "forearm_hand_l")
    wrench, known, axes = (
        rng.normal(0, 300, (14, 2, 6)),
        make_nominal_errors(FREE),
        AxisErrors(parameters),
    )
    exact, moved = (
        ForceErrors(problem, coefficients, parameters, wrench, known, axes=a).compute_errors()
        for a in (None, axes)
    )
    assert set(moved.by_source) == {*exact.by_source, ErrorSource.FRAMES}
    for source, variance in exact.by_source.items():
        np.testing.assert_array_equal(moved.by_source[source], variance)
    q, v, a = (problem.basis.evaluate(coefficients, k) for k in range(3))
    forces = Dynamics(parameters, HELD).compute_forces(q, v, a, wrench)
    expected = (axes.compute_torque_sensitivities(q, forces) ** 2).sum(axis=2)
    np.testing.assert_allclose(moved.by_source[ErrorSource.FRAMES], expected, rtol=1e-9, atol=1e-12)
    moves, turned = (
        compute_motion_sensitivity(problem, coefficients, parameters, known),
        axes.compute_coordinate_errors(q),
    )
    plain, whole = (
        compute_coordinate_errors(problem, moves),
        compute_coordinate_errors(problem, moves, turned),
    )
    held = ~problem.active
    assert held.any()
    np.testing.assert_array_equal(whole[:, held], plain[:, held])
    np.testing.assert_allclose(whole[:, ~held], np.hypot(plain, turned)[:, ~held], rtol=1e-12)


def test_directions_of_axes_move_components_but_not_what_a_whole_joint_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Hips and back: power is moment times angular velocity, whatever the axes; their torques'
    errors are those of the vector along the joint's axes. A hinge stays where it is. Blocks of
    frames change nothing.
    """
    rng, parameters, problem, coefficients = seeded_trial(53, frames=80, nodes=9)
    wrench, known, axes = (
        rng.normal(0, 300, (80, 2, 6)),
        make_nominal_errors(FREE),
        AxisErrors(parameters),
    )
    exact, turned = (
        ForceErrors(problem, coefficients, parameters, wrench, known, None, axes=a).compute_errors()
        for a in (None, axes)
    )
    assert exact.kinetics is not None and turned.kinetics is not None
    inner = slice(2, -2)  # rates of the moves are differences between frames, one-sided at the ends

    def added(name: str) -> float:
        before, after = (
            power_of(errors, name)[inner] ** 2
            for errors in (exact.kinetics, turned.kinetics)
            if errors
        )
        return float(np.sqrt(np.mean(after - before)))

    for joint, coordinate in (
        ("hip_r", "hip_rotation_r"),
        ("hip_l", "hip_adduction_l"),
        ("lumbar", "lumbar_bending"),
    ):
        assert added(joint) < UNMOVED * added(coordinate), joint
    for hinge in ("knee_l", "ankle_r", "elbow_r"):
        assert added(hinge) < UNMOVED * added("hip_rotation_r"), hinge
    jcs = turned.kinetics.moment[:, VECTOR_FRAMES.index(MomentFrame.JCS)]
    for k, name in enumerate(COMPONENTS):
        if name.startswith(("hip", "lumbar")):
            np.testing.assert_allclose(
                jcs[:, k], turned.all_forces[:, FORCES.index(name)], rtol=1e-7, err_msg=name
            )
    moves = compute_motion_sensitivity(problem, coefficients, parameters, known)
    coordinates = compute_coordinate_errors(problem, moves)
    monkeypatch.setattr(error_sources, "BLOCK", 7)
    monkeypatch.setattr(torque_errors, "LARGEST_BYTES", 1 << 19)
    np.testing.assert_allclose(compute_coordinate_errors(problem, moves), coordinates, rtol=1e-9)
    parted = ForceErrors(problem, coefficients, parameters, wrench, known, None, axes=axes)
    assert len(parted.parts) > 1
    in_parts = parted.compute_errors().kinetics
    np.testing.assert_allclose(in_parts.power, turned.kinetics.power, rtol=1e-9)
    np.testing.assert_allclose(in_parts.moment, turned.kinetics.moment, rtol=1e-9)


def leverages(problem: MotionProblem, parameters: Parameters, coefficients: Array) -> Array:
    """(nm, 3, nf) of each marker coordinate in its frame's own least-squares problem; Jacobian by
    differences.
    """
    q, body, data = (
        problem.basis.evaluate(coefficients),
        problem.build_body(parameters),
        problem.data,
    )
    out = np.empty(data.measured.shape)
    for f in range(len(q)):
        one = data.select_frames(slice(f, f + 1))

        def placed(x: Array, one: MarkerData = one) -> Array:
            return compute_marker_positions(body, one.placed, x[None])

        slope = np.sqrt(np.repeat(one.weight[:, 0], 3))[:, None] * central_differences(placed, q[f])
        out[:, :, f] = np.diag(slope @ np.linalg.pinv(slope)).reshape(-1, 3)
    return out


def test_the_motion_moves_with_a_marker_coordinate_and_with_the_joint_parameters() -> None:
    """`compute_motion_sensitivity` of a whole body with its joint parameters known: the motion
    tracked again.
    """
    rng, parameters, problem, _ = seeded_trial(23, frames=30, nodes=7)
    problem = noisy(problem, rng, NOISE)
    source = ErrorSources(FREE, 1e-6 * rng.normal(size=(len(FREE), 1)), ("nominal/all",))

    def motion(problem: MotionProblem, parameters: Parameters) -> Array:
        return track_coefficients(
            problem, *started(problem, parameters), DescentSettings(gain=1e-15)
        ).x

    coefficients = motion(problem, parameters)
    moves = compute_motion_sensitivity(problem, coefficients, parameters, source)
    residual = (
        problem.compute_positions(coefficients, problem.build_body(parameters))
        - problem.data.measured
    )
    inflated = residual / (
        1.0 - np.clip(leverages(problem, parameters, coefficients), 0.0, LEVERAGE_CAP)
    )
    for m, axis in ((0, 1), (17, 2)):
        measured = problem.data.measured.copy()
        measured[m, axis] -= inflated[m, axis]
        moved = (motion(problem.with_measured(measured), parameters) - coefficients).ravel()
        column = moves.coefficients[:, 3 * m + axis]
        np.testing.assert_allclose(column, moved, rtol=0, atol=LINEAR * float(np.abs(moved).max()))
    at = parameters.joint[[JP_INDEX[name] for name in FREE]]
    shifted = parameters.with_joint(FREE, at + source.effects[:, 0])
    moved = motion(problem, shifted) - coefficients
    change = -moves.sensitivity @ moves.shift[:, -1]
    sign = np.sign(change @ moved.ravel())  # only the square of what a source does is kept
    np.testing.assert_allclose(
        sign * change, moved.ravel(), rtol=0, atol=LINEAR * float(np.abs(moved).max())
    )


def test_columns_of_an_influence_belong_to_sources_by_their_names() -> None:
    """Trials may be called anything: `skin/R.Knee/x` is a marker coordinate of a trial
    called skin.
    """
    cases = {
        "markers/walk/3": ErrorSource.JOINT_MARKERS,
        "hip_r/R.Knee/x": ErrorSource.JOINT_MARKERS,
        "skin/R.Knee/x": ErrorSource.JOINT_MARKERS,
        "nominal/R.Knee/z": ErrorSource.JOINT_MARKERS,
        "bandwidth/R.Knee/z": ErrorSource.JOINT_MARKERS,
        "nominal/hip_r.pelvis.ant": ErrorSource.JOINT_NOMINAL,
        "skin/gait/knee_angle_r/shank_r/tx": ErrorSource.SKIN,
        "skin/gait/knee_angle_r^2/shank_r/rz": ErrorSource.SKIN,
        "bandwidth/walk": ErrorSource.BANDWIDTH,
        "posture/walk/12": ErrorSource.POSTURE,
        "posture/R.Knee/x": ErrorSource.JOINT_MARKERS,
    }
    assert {name: classify_source(name) for name in cases} == cases


def test_sources_of_an_influence_stay_apart_when_they_are_compressed() -> None:
    """Many columns of one source become few with the same covariance."""
    rng, parameters, problem, coefficients = seeded_trial(53, frames=14, nodes=7)
    names = problem.with_free(FREE).chain.free
    clusters = [
        *(f"markers/other/{k}" for k in range(90)),
        *(f"nominal/{name}" for name in names),
        "skin/gait/knee_angle_r/shank_r/tx",
    ]
    influence = ErrorSources(
        names, rng.normal(0, 0.01, (len(names), len(clusters))), tuple(clusters)
    )
    moves = compute_motion_sensitivity(problem, coefficients, parameters, influence)
    for source in (ErrorSource.JOINT_MARKERS, ErrorSource.JOINT_NOMINAL, ErrorSource.SKIN):
        before = influence.effects[
            :, [k for k, name in enumerate(clusters) if classify_source(name) is source]
        ]
        after = moves.shift[:, [k for k, name in enumerate(moves.shared_sources) if name is source]]
        np.testing.assert_allclose(
            after @ after.T, before @ before.T, rtol=0, atol=1e-12 * before.size
        )
        assert after.shape[1] <= len(names)
    assert set(moves.trial_sources) == {ErrorSource.MOTION}


def test_a_source_of_columns_that_do_not_follow_each_other_is_summed() -> None:
    """By hand: 1 + 4 + 25 of the joints, 9 of the skin, 16 of the markers."""
    joints, skin, motion = ErrorSource.JOINT_MARKERS, ErrorSource.SKIN, ErrorSource.MOTION
    moves = MotionSensitivity(
        shift=np.zeros((0, 4)),
        coefficients=np.zeros((0, 1)),
        sensitivity=np.zeros((0, 0)),
        trial_sources=(motion,),
        shared_sources=(joints, joints, skin, joints),
    )
    found = moves.sum_by_source(np.array([[[4.0, 1.0, 2.0, 3.0, 5.0]]]))
    assert {source: variance.item() for source, variance in found.items()} == {
        motion: 16.0,
        joints: 30.0,
        skin: 9.0,
    }


PARAMETERS = perturbed_parameters(np.random.default_rng(81))
HZ, LOG_STEP = 22.0, 1e-3
FIRST_ORDER = 0.05
"""Gauss-Newton's matrix against Newton's, where residuals are small."""


def solved(problem: MotionProblem, start: Array, parameters: Parameters = PARAMETERS) -> Array:
    return track_coefficients(
        problem, problem.build_body(parameters), start, DescentSettings(gain=1e-15)
    ).x


def smoothed_trial() -> tuple[MotionProblem, Array]:
    """Markers without noise, smoothed a little."""
    problem, true = random_trial(np.random.default_rng(82), PARAMETERS, frames=50, nodes=12)
    problem = replace(
        problem, smoothing=build_smoothing(problem.basis, 4.0 * np.eye(true.shape[1]), HZ)
    )
    return problem, solved(problem, true)


def test_the_source_is_what_more_of_the_penalty_would_do() -> None:
    problem, coefficients = smoothed_trial()
    scores = compute_marker_scores(problem, coefficients, PARAMETERS, None)
    plain = compute_marker_scores(replace(problem, smoothing=None), coefficients, PARAMETERS, None)
    assert scores.clusters == (*plain.clusters, "bandwidth/random")
    stiffer = replace(problem.smoothing, coupling=(1 + LOG_STEP) * problem.smoothing.coupling)
    change = (solved(replace(problem, smoothing=stiffer), coefficients) - coefficients) / LOG_STEP
    source = scores.coefficients[:, -1].reshape(coefficients.shape)
    np.testing.assert_allclose(source, change, rtol=0, atol=FIRST_ORDER * np.abs(change).max())
    assert np.abs(change).max() > 1e-5


def test_the_source_widens_error_bars() -> None:
    problem, coefficients = smoothed_trial()
    problem = noisy(problem, np.random.default_rng(83), 1e-4)
    moves = compute_motion_sensitivity(problem, solved(problem, coefficients), PARAMETERS, None)
    without = replace(
        moves, coefficients=moves.coefficients[:, :-1], trial_sources=moves.trial_sources[:-1]
    )
    wide, narrow = (compute_coordinate_errors(problem, m) for m in (moves, without))
    bias = problem.basis.evaluate(moves.coefficients[:, -1].reshape(coefficients.shape))
    np.testing.assert_allclose(wide**2, narrow**2 + bias**2, rtol=1e-9)
    assert (wide > 1.05 * narrow).mean() > 0.2


def test_a_key_point_of_two_segments_errs_once() -> None:
    """Its coordinates make the errors of both, together."""
    _, parameters, problem, coefficients = seeded_trial(52, frames=FRAMES, nodes=6)
    measured = problem.data.measured.copy()
    measured[1] = measured[0]
    alone = problem.with_measured(measured)
    same = replace(
        alone,
        noise=PointNoise(size_mm=1e-6, memory_s=0.1, joints=1.0, hinges=1.0, reason="made up"),
    )
    apart, once = (
        compute_marker_scores(p, coefficients, parameters, None).coefficients for p in (alone, same)
    )
    np.testing.assert_allclose(
        once[:, :3], apart[:, :3] + apart[:, 3:6], atol=1e-9 * np.abs(apart).max()
    )
    assert not once[:, 3:6].any()
    np.testing.assert_allclose(once[:, 6:], apart[:, 6:])
