"""Priors on coefficients: derivatives, walls that nothing feels inside, and coordinates that no
marker determines.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.calibration.error_sources import (
    compute_coordinate_variances,
    compute_motion_sensitivity,
)
from gaitcal.calibration.joint_estimate import select_movable_parameters
from gaitcal.dynamics.measurement_errors import ErrorSource
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LUMBAR, MARKED_SEGMENTS, list_joint_coordinates
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_NAMES
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.synthetic.synthetic_motion import simulate_gait
from gaitcal.tracking.coordinate_prior import (
    JOINT_LIMITS_DEG,
    PRIOR_DEVIATION_DEG,
    CoordinatePrior,
    build_joint_limits,
    build_posture_prior,
    clip_to_joint_limits,
    compute_upright_trunk,
)
from gaitcal.tracking.motion import Motion, track, track_coefficients, track_motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.derivatives import (
    Array,
    assert_derivative,
    central_differences,
    noisy,
    perturbed_parameters,
    random_trial,
    started,
)
from tests.synthetic_studies import made_recording

MODEL = published_model()
BAND = 1e-6
"""Of the matrix' largest entry: central differences of the gradient."""


def far_away(rng: np.random.Generator) -> tuple[MotionProblem, Array]:
    """A trial with walls and a normal prior, and nodes beyond some of the walls."""
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, frames=30, nodes=7)
    coordinates = problem.chain.coordinates
    course = np.linspace(-0.3, 0.2, 30)[:, None]
    moving = CoordinatePrior(
        names=("lumbar_bending",),
        time=problem.basis.time,
        low=course,
        high=course,
        scale=np.array([0.1]),
    )
    priors = (
        build_joint_limits(coordinates, {"hip_rotation_l": 0.2}),
        build_posture_prior(("arm_add_r",), {"arm_add_r": 0.4}),
        moving,
    )
    coefficients = true.copy()
    for name in JOINT_LIMITS_DEG:
        coefficients[::2, coordinates.index(name)] += rng.choice([-1.0, 1.0]) * 1.5
    return replace(problem, priors=priors), coefficients


def test_cost_gradient_and_matrix_belong_together() -> None:
    problem, coefficients = far_away(np.random.default_rng(41))
    body = problem.build_body(perturbed_parameters(np.random.default_rng(41)))
    shape = coefficients.shape
    alone = [pull.evaluate(coefficients)[0] for pull in problem.coefficient_priors]
    assert min(alone) > 0.0
    cost, gradient = problem.compute_gradient(coefficients, body)
    equations = problem.assemble_equations(coefficients, body)
    assert equations.cost == pytest.approx(cost, rel=1e-12)
    assert problem.compute_cost(coefficients, body) == pytest.approx(cost, rel=1e-12)
    assert cost - problem.compute_marker_cost(coefficients, body) == pytest.approx(
        sum(alone), rel=1e-9
    )
    np.testing.assert_allclose(
        equations.node_gradient, gradient, atol=1e-12 * np.abs(gradient).max()
    )
    assert_derivative(
        2.0 * gradient.reshape(1, -1),
        lambda x: np.array([problem.compute_cost(x.reshape(shape), body)]),
        coefficients.ravel(),
    )
    plain = replace(problem, priors=())
    added = (equations.band - plain.assemble_equations(coefficients, body).band)[:, 0]

    def of_priors(x: Array) -> Array:
        own = x.reshape(shape)
        return np.asarray(sum(pull.evaluate(own)[1] for pull in problem.coefficient_priors)).ravel()

    numeric = central_differences(of_priors, coefficients.ravel())
    np.testing.assert_allclose(np.diag(added), numeric, atol=BAND * np.abs(numeric).max())


def test_a_share_of_the_cost_is_a_share_of_the_prior() -> None:
    problem, coefficients = far_away(np.random.default_rng(42))
    half = problem.scale_cost(0.5)
    for whole, part in zip(problem.coefficient_priors, half.coefficient_priors, strict=True):
        assert part.evaluate(coefficients)[0] == pytest.approx(
            0.5 * whole.evaluate(coefficients)[0], rel=1e-12
        )
    scores = [
        p.compute_scores(problem.basis, problem.chain.coordinates)
        for p in (problem.priors[1], half.priors[1])
    ]
    np.testing.assert_allclose(scores[1], 0.5 * scores[0], rtol=1e-12)


def test_a_part_keeps_what_is_known_of_its_own_coordinates() -> None:
    problem, _ = far_away(np.random.default_rng(43))
    part = problem.extract_part("shank_r", ("shank_r", "talus_r", "foot_r"))
    assert [prior.names for prior in part.priors] == [("ankle_angle_r", "subtalar_angle_r")]
    assert problem.extract_part("pelvis", ("pelvis", "head_trunk")).guessed == ("lumbar_bending",)


def test_inside_the_walls_not_a_digit_changes() -> None:
    problem = build_trial_problem(
        "walk", MODEL, made_recording(simulate_gait()), ControlPointRule()
    )
    assert set(problem.priors[0].names) == set(JOINT_LIMITS_DEG)
    problem = noisy(problem, np.random.default_rng(44), 0.003)
    with_walls, without = (
        track_motion(p, MODEL.parameters)
        for p in (problem, replace(problem, priors=problem.priors[1:]))
    )
    np.testing.assert_array_equal(with_walls.coefficients, without.coefficients)


def test_a_foot_that_no_marker_holds_stays_at_its_wall() -> None:
    """A foot marker on the wrong side, and a start a whole turn away: the joint ends near its wall,
    not at 370 deg.
    """
    walk = made_recording(simulate_gait())
    problem = build_trial_problem(
        "walk",
        MODEL,
        walk,
        ControlPointRule(),
        root="shank_r",
        segments=("shank_r", "talus_r", "foot_r"),
    )
    k = problem.chain.coordinates.index("subtalar_angle_r")
    body, start = started(problem, MODEL.parameters)
    weight = np.where((problem.data.segment == 2)[:, None], 0.0, problem.data.weight)
    (first, *_) = np.flatnonzero(problem.data.segment == 2)
    weight[first] = 1.0
    loose = problem.with_weight(weight)
    start[:, k] += np.deg2rad(370.0)
    ends = [track_coefficients(p, body, start).x for p in (loose, replace(loose, priors=()))]
    held, free = (np.rad2deg(np.abs(loose.basis.evaluate(x)[:, k]).max()) for x in ends)
    assert held < 60.0 and free > 180.0


def test_angles_start_within_the_walls() -> None:
    angles, known = np.deg2rad([[370.0], [-355.0], [170.0], [-30.0]]), np.ones(4, dtype=bool)
    told = clip_to_joint_limits(["subtalar_angle_r"], angles, known, determined=True)
    np.testing.assert_allclose(np.rad2deg(told), [[10.0], [5.0], [50.0], [-30.0]])
    assert not clip_to_joint_limits(["subtalar_angle_r"], angles, known, determined=False).any()
    np.testing.assert_array_equal(
        clip_to_joint_limits(["knee_angle_r"], angles, known, determined=False), angles
    )
    hips = ["hip_flexion_r", "hip_rotation_r"]
    both = clip_to_joint_limits(
        hips, np.deg2rad([[200.0, 370.0], [0.0, 60.0]]), known[:2], determined=False
    )
    assert np.rad2deg(both) == pytest.approx(np.array([[200, 10], [0, 50]]))


SEGMENT = dict(zip(MODEL.markers.labels, MODEL.markers.segments, strict=True))
TRUNK = tuple(label for label, s in SEGMENT.items() if s == "head_trunk")
ARMS = tuple(label for label, s in SEGMENT.items() if "arm" in s)
ARM_ANGLES = {f"{name}_{side}" for name in ("arm_flex", "arm_add", "elbow_flex") for side in "rl"}
UNSEEN = list_joint_coordinates(s for s in MARKED_SEGMENTS if s not in SEGMENT.values())
UPRIGHT_DEG = 0.1
"""A spline's fit of the pelvis's swing."""
FOLLOWED_RAD = 0.02
"""A prior of 5 deg against a marker 0.4 m away: it pulls by a few percent of how far the trunk is
from upright.
"""
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def walk() -> Recording:
    return made_recording(simulate_gait())


def hidden(recording: Recording, *labels: str, share: float = 1.0) -> Recording:
    """The recording with these markers not seen in the first `share` of its frames."""
    markers = recording.markers.copy()
    markers[: round(share * len(markers)), [recording.labels.index(label) for label in labels]] = (
        np.nan
    )
    return replace(recording, markers=markers)


def problem_of(recording: Recording) -> MotionProblem:
    return build_trial_problem("walk", MODEL, recording, ControlPointRule())


def test_a_trunk_without_markers_and_arms_with_them(walk: Recording) -> None:
    """What nothing shows is where it is known to be, whatever else is seen; three markers off one
    line need nothing.
    """

    def guessed(*labels: str, share: float = 1.0) -> set[str]:
        return set(problem_of(hidden(walk, *labels, share=share)).guessed)

    assert guessed() == guessed(*TRUNK, share=0.4) == {*UNSEEN}
    assert (
        guessed(*TRUNK, *ARMS)
        == guessed(*TRUNK, *ARMS, share=0.6)
        == {*LUMBAR, *ARM_ANGLES, *UNSEEN}
    )
    assert not guessed(*ARMS) & set(LUMBAR)
    assert guessed(*TRUNK) == {*LUMBAR, *UNSEEN}, "arms pull on a trunk, and do not determine it"


def test_one_marker_on_the_sternum_leaves_its_turn_about_the_line_to_the_hips_open(
    walk: Recording,
) -> None:
    sternum = next(label for label in TRUNK if "Sternum" in label)
    found = problem_of(hidden(walk, *(m for m in (*TRUNK, *ARMS) if m != sternum)))
    assert {"lumbar_bending", "lumbar_rotation"} <= set(found.guessed) and sternum in found.labels
    motion = track_motion(found, MODEL.parameters)
    k = motion.coordinates.index("lumbar_extension")
    assert np.abs(motion.q - simulate_gait().q)[:, k].max() < FOLLOWED_RAD


@pytest.mark.parametrize("kept", [1, 0])
def test_a_segment_of_one_marker_or_none_is_asked_too(walk: Recording, kept: int) -> None:
    """A foot: with one marker its inversion is open, and nothing else of the leg."""
    foot = [label for label, s in SEGMENT.items() if s == "foot_r"]
    problem = problem_of(hidden(walk, *foot[kept:]))
    assert (
        {"subtalar_angle_r"}
        <= set(problem.guessed)
        <= {"subtalar_angle_r", "ankle_angle_r", *UNSEEN}
    )
    assert not any(
        n.startswith("subtalar_r") for n in select_movable_parameters([problem], JP_NAMES)
    )
    assert any(
        n.startswith("subtalar_r")
        for n in select_movable_parameters([problem, problem_of(walk)], JP_NAMES)
    )


def _axes(motion: Motion) -> Array:
    """(nf, 3, 3) axes of the trunk in the laboratory."""
    q = {name: motion.q[:, k] for k, name in enumerate(motion.coordinates)}

    def turn(a: str, b: str, c: str) -> Array:
        angles = zip(q[a], q[b], q[c], strict=True)
        return np.array(
            [
                make_axis_rotation(2, x) @ make_axis_rotation(0, y) @ make_axis_rotation(1, z)
                for x, y, z in angles
            ]
        )

    return turn("pelvis_tilt", "pelvis_list", "pelvis_rotation") @ turn(*LUMBAR)


def test_a_trunk_that_nothing_shows_stays_upright_in_the_laboratory(walk: Recording) -> None:
    motion = track(MODEL, hidden(walk, *TRUNK, *ARMS))
    axes = _axes(motion)
    lean = np.rad2deg(np.arccos(np.clip(axes[:, 1, 1], -1.0, 1.0)))
    assert lean.max() < UPRIGHT_DEG
    pelvis = motion.q[:, [motion.coordinates.index("pelvis_tilt")]]
    assert np.rad2deg(np.ptp(pelvis)) > 1.0
    arms = [k for k, name in enumerate(motion.coordinates) if name in ARM_ANGLES]
    assert np.abs(motion.q[:, arms]).max() == 0.0


def test_it_turns_with_the_way_and_not_with_the_pelvis() -> None:
    time = np.arange(400) / 100.0
    standing = {"pelvis_tilt": -0.2, "lumbar_extension": 0.15, "lumbar_bending": 0.02}
    swing = 0.1 * np.sin(2 * np.pi * time)
    zero = np.zeros_like(time)
    still = compute_upright_trunk(time, np.stack([-0.2 + zero, zero, zero], axis=1), standing)
    np.testing.assert_allclose(
        still, np.broadcast_to([0.15, 0.02, 0.0], still.shape), atol=ROUNDING
    )
    # about the vertical the first turn of an upright pelvis is its rotation
    turned = compute_upright_trunk(time, np.stack([zero, zero, 0.5 * time], axis=1), {})
    np.testing.assert_allclose(turned, 0.0, atol=ROUNDING)
    middle = slice(100, 300)
    kept = compute_upright_trunk(time, np.stack([zero, zero, 0.5 * time + swing], axis=1), {})
    np.testing.assert_allclose(kept[middle, 2], -swing[middle], atol=0.1 * 0.1)


def test_its_uncertainty_is_that_of_the_prior(walk: Recording) -> None:
    problem = problem_of(hidden(walk, *TRUNK, *ARMS))
    motion = track_motion(problem, MODEL.parameters)
    moves = compute_motion_sensitivity(problem, motion.coefficients, MODEL.parameters, None)
    at = [k for k, source in enumerate(moves.trial_sources) if source is ErrorSource.POSTURE]
    moves = replace(
        moves,
        coefficients=moves.coefficients[:, at],
        trial_sources=(ErrorSource.POSTURE,) * len(at),
    )
    variance, _ = compute_coordinate_variances(problem, moves)
    for k, name in enumerate(motion.coordinates):
        expected = PRIOR_DEVIATION_DEG.get(name, 0.0) if name in problem.guessed else 0.0
        np.testing.assert_allclose(
            np.rad2deg(np.sqrt(variance[:, k])), expected, atol=1e-3, err_msg=name
        )
    twice = 2.0 * np.eye(len(motion.coordinates))[None, :2].repeat(len(motion.q), axis=0)
    more = compute_coordinate_variances(problem, moves, twice)[0]
    np.testing.assert_allclose(
        more[:, -2:], 4.0 * variance[:, :2], rtol=1e-9, err_msg="what depends on coordinates"
    )
    whole = problem_of(walk)
    seen = compute_motion_sensitivity(
        whole, track_motion(whole, MODEL.parameters).coefficients, MODEL.parameters, None
    )
    assert (ErrorSource.POSTURE in seen.trial_sources) == bool(UNSEEN)
