"""Axes that are wrong by a little: against a linkage whose axes are turned, bodies and joints
staying in place.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.joint_kinetics import HELD
from gaitcal.dynamics.measurement_errors import PALPATED_DEG, AxisErrors
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, JOINTS, SEGMENTS
from gaitcal.model.parameters import IP_INDEX, JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.tracking.marker_residual import PlacedMarkers, compute_marker_positions
from tests.derivatives import Array, perturbed_parameters

TURN, STEP_S = 1e-4, 1e-3
"""rad, and s between the frames that velocities and accelerations are taken from."""
ROUNDING = 1e-4
"""Relative to the largest: accelerations are second differences of angles over 1 ms."""
NOTHING = 1e-9
"""N·m, of some hundred."""
CHAIN = Chain()


def body() -> Parameters:
    """A person whose segments have the same moment about every axis: it needs no turning
    with them.
    """
    parameters = perturbed_parameters(np.random.default_rng(1))
    inertial = parameters.inertial.copy()
    for name, k in IP_INDEX.items():
        if ".moi." in name:
            inertial[k] = inertial[IP_INDEX[name.rsplit(".", 1)[0] + ".lat"]]
    return parameters.with_inertial(inertial)


def pivot(parameters: Parameters, segment: str) -> Array:
    """(3,) m the point about which axes turn: the next hinge that is told in its plane z = 0 alone,
    else the origin.
    """
    own = [p for p in JOINT_PARAMETERS if p.segment == segment and p.kind is ParameterKind.POSITION]
    for joint in JOINTS:
        places = [JP_INDEX[p.name] for p in own if p.joint == joint.name]
        if joint.parent == segment and len(places) == 2:  # ant and sup
            return np.append(parameters.joint[places], 0.0)
    return np.zeros(3)


def with_axes_turned(parameters: Parameters, segment: str, turn: Array) -> Parameters:
    """The same joints and mass centres, told in axes of a segment that are turned by `turn` (3,)
    rad in them.
    """
    back, fixed = Rotation.from_rotvec(-turn).as_matrix(), pivot(parameters, segment)
    joint, inertial = parameters.joint.copy(), parameters.inertial.copy()
    own = [p for p in JOINT_PARAMETERS if p.segment == segment]
    for prefix in {p.name.rsplit(".", 1)[0] for p in own}:
        at = {
            p.name.rsplit(".", 1)[1]: JP_INDEX[p.name]
            for p in own
            if p.name.startswith(f"{prefix}.")
        }
        if "lat" in at:
            places = [at[d] for d in ("ant", "sup", "lat")]
            joint[places] = fixed + back @ (joint[places] - fixed)
        if "front" in at and "trans" in at:  # Rx(front) Ry(trans), the hinge along z
            turned = Rotation.from_euler("X", joint[at["front"]]) * Rotation.from_euler(
                "Y", joint[at["trans"]]
            )
            x, y, z = back @ turned.as_matrix()[:, 2]
            joint[at["trans"]], joint[at["front"]] = np.arcsin(x), np.arctan2(-y, z)
        elif "sag" in at:  # Ry(trans) Rz(sag), the hinge along x
            turned = Rotation.from_euler("Y", joint[at["trans"]]) * Rotation.from_euler(
                "Z", joint[at["sag"]]
            )
            x, y, z = back @ turned.as_matrix()[:, 0]
            joint[at["sag"]], joint[at["trans"]] = np.arcsin(y), np.arctan2(-z, x)
    places = [IP_INDEX[f"{segment}.com.{d}"] for d in ("ant", "sup", "lat")]
    inertial[places] = fixed + back @ (inertial[places] - fixed)
    return parameters.with_joint(tuple(JP_INDEX), joint).with_inertial(inertial)


def followed(parameters: Parameters, placed: PlacedMarkers, seen: Array, q: Array) -> Array:
    """(nf, 27) the posture whose markers are where they are seen (nm, 3, nf), from a
    start near it.
    """
    body = CHAIN.body(parameters)
    for _ in range(5):
        x = compute_marker_positions(body, placed, q)
        spatial = Kinematics(body, q).columns
        step = np.empty_like(q)
        for f in range(len(q)):
            velocity = spatial[None, :, :3, f] + np.cross(spatial[None, :, 3:, f], x[:, None, :, f])
            velocity *= CHAIN.support[:, placed.segment].T[:, :, None]
            slope = velocity.transpose(0, 2, 1).reshape(-1, q.shape[1])
            step[f] = np.linalg.lstsq(slope, (seen - x)[:, :, f].ravel(), rcond=None)[0]
        q = q + step
    return q


@pytest.mark.parametrize(
    "segment", ["pelvis", "thigh_r", "thigh_l", "shank_l", "foot_r", "head_trunk", "upper_arm_r"]
)
def test_moves_are_those_of_a_linkage_told_in_turned_axes(segment: str) -> None:
    rng = np.random.default_rng(2)
    parameters = body()
    q, v, a = (rng.normal(0, s, (1, len(COORDINATES))) for s in (0.3, 1.0, 5.0))
    wrench = rng.normal(0, 300, (1, 2, 6))
    carrying = [k for k, name in enumerate(CHAIN.segments) if not name.startswith("talus")]
    segments = np.repeat(np.array(carrying, dtype=np.intp), 4)
    local = rng.normal(0, 0.1, (len(segments), 3))
    times = STEP_S * np.array([[-1.0], [0.0], [1.0]])
    posture = q + times * v + 0.5 * times**2 * a
    seen = compute_marker_positions(CHAIN.body(parameters), PlacedMarkers(segments, local), posture)

    def told(turn: Array) -> tuple[Array, Array]:
        again = with_axes_turned(parameters, segment, turn)
        own = segments == CHAIN.segments.index(segment)
        fixed = pivot(parameters, segment)
        turned = np.where(
            own[:, None], fixed + (local - fixed) @ Rotation.from_rotvec(turn).as_matrix(), local
        )
        before, at, after = followed(again, PlacedMarkers(segments, turned), seen, posture)
        moved = (
            at[None],
            (after - before)[None] / (2 * STEP_S),
            (after - 2 * at + before)[None] / STEP_S**2,
        )
        return at, Dynamics(again).compute_forces(*moved, wrench)[0]

    errors = AxisErrors(parameters)
    coordinates, torques = (
        errors.compute_coordinate_sensitivities(q)[0],
        errors.compute_torque_sensitivities(
            q, Dynamics(parameters, HELD).compute_forces(q, v, a, wrench)
        )[0],
    )
    kind = segment.removesuffix("_r").removesuffix("_l")
    for axis in range(3):
        column, size = errors.columns.index((segment, axis)), np.deg2rad(PALPATED_DEG[kind][axis])
        (up_q, up), (down_q, down) = told(TURN * np.eye(3)[axis]), told(-TURN * np.eye(3)[axis])
        expected_q, expected = (up_q - down_q) / (2 * TURN), (up - down) / (2 * TURN)
        scale = np.abs(Dynamics(parameters).compute_forces(q, v, a, wrench)).max()
        np.testing.assert_allclose(coordinates[:, column] / size, expected_q, atol=ROUNDING)
        np.testing.assert_allclose(torques[:, column] / size, expected, atol=ROUNDING * scale)


def test_hinges_keep_their_torque_and_hips_do_not() -> None:
    rng = np.random.default_rng(3)
    q, v, a = (
        rng.normal(0, s, (700, len(COORDINATES))) for s in (0.3, 1.0, 5.0)
    )  # more than a block of frames
    errors = AxisErrors(body())
    forces = Dynamics(body(), HELD).compute_forces(q, v, a, rng.normal(0, 300, (700, 2, 6)))
    size = np.abs(errors.compute_torque_sensitivities(q, forces)).max(axis=(0, 2))
    moved = {name for name, largest in zip(FORCES, size, strict=True) if largest > NOTHING}
    triples = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_adduction")
    assert moved == {
        *(f"{name}_{side}" for name in triples for side in "rl"),
        *("lumbar_extension", "lumbar_bending", "lumbar_rotation"),
        *("pelvis_list", "pelvis_rotation"),  # tilt is about an axis of the laboratory
    }
    squares = (errors.compute_coordinate_sensitivities(q) ** 2).sum(axis=2)
    np.testing.assert_allclose(errors.compute_coordinate_errors(q), np.sqrt(squares), rtol=1e-12)
    seen = {
        name for name, largest in zip(COORDINATES, squares.max(axis=0), strict=True) if largest > 0
    }
    assert seen == {name for name in COORDINATES if not name.endswith(("_tx", "_ty", "_tz"))}


def test_only_what_is_wrong_moves_anything() -> None:
    errors = AxisErrors(body(), {"thigh": (0.0, 2.0, 0.0)})
    assert list(dict.fromkeys(segment for segment, _ in errors.columns)) == ["thigh_r", "thigh_l"]
    assert AxisErrors(body(), {"thigh": (0, 0, 0), "thigh_l": (1.0, 0, 0)}).columns[0] == (
        "thigh_l",
        0,
    ), "one side"
    one = np.zeros((1, len(COORDINATES)))
    moves = errors.compute_coordinate_sensitivities(one)[0]
    # standing, the thigh's own length is the axis of hip rotation, and of nothing else
    rotation = moves[COORDINATES.index("hip_rotation_r")]
    assert np.rad2deg(np.abs(rotation).max()) == pytest.approx(2.0)
    assert set(PALPATED_DEG) == {s.removesuffix("_r").removesuffix("_l") for s in SEGMENTS} - {
        "talus"
    }
