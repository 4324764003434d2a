"""Joint moments as vectors and powers: against Newton and Euler's equations written out from the
segments' poses, the torques of the model, the energy of the body, and finite differences.
"""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.dynamics.derivatives import compute_force_derivatives
from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics
from gaitcal.dynamics.joint_kinetics import (
    COMPONENTS,
    HELD,
    NET_JOINTS,
    POWER_JOINTS,
    POWERS,
    VECTOR_FRAMES,
    JointKinetics,
    KineticErrors,
    MomentFrame,
    component_of,
    compute_kinetic_values,
    differentiate_moments,
    power_of,
)
from gaitcal.export.opensim.osim_writer import list_joint_frames
from gaitcal.model.chain import build_linkage
from gaitcal.model.linkage import COORDINATES, JOINT_OF_CHILD
from gaitcal.model.parameters import (
    JP_INDEX,
    MASSIVE_SEGMENTS,
    Parameters,
    list_gait_parameters,
    list_leg_parameters,
    view_as_table,
)
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_state
from tests.messages import refuses

PARAMETERS = perturbed_parameters(np.random.default_rng(71))
STEP_S = 1e-4
"""s between the poses that velocities and accelerations are taken from."""
DIFFERENCES = 2e-3
"""N·m, of up to 3000: second differences of poses of a body of 70 kg over `STEP_S`."""
ROUNDING = 1e-8
"""N·m, W: sums of a few thousand."""
GRAVITY = np.array([0.0, -9.81, 0.0])


def state() -> tuple[Array, Array, Array, Array]:
    return random_state(np.random.default_rng(5), 3)


class Segments:
    """Rotation and place of every segment in the laboratory about one instant, from Pinocchio's
    forward kinematics.
    """

    def __init__(self, parameters: Parameters, q: Array, v: Array, a: Array) -> None:
        linkage = build_linkage(parameters)
        data = linkage.model.createData()
        self.pose: list[dict[str, pin.SE3]] = []
        for t in (-STEP_S, 0.0, STEP_S):
            pin.framesForwardKinematics(linkage.model, data, q + t * v + 0.5 * t * t * a)
            names = linkage.chain.segments
            self.pose.append(
                {name: data.oMf[linkage.model.getFrameId(name)].copy() for name in names}
            )

    def place(self, segment: str, point: Array) -> Array:
        return np.asarray(self.pose[1][segment].act(point))

    def acceleration(self, segment: str, point: Array) -> Array:
        before, now, after = (pose[segment].act(point) for pose in self.pose)
        return np.asarray((after - 2.0 * now + before) / STEP_S**2)

    def turning(self, segment: str) -> tuple[Array, Array]:
        """Angular velocity and acceleration, laboratory."""
        r = [pose[segment].rotation for pose in self.pose]
        first, second = (
            Rotation.from_matrix(r[k + 1] @ r[k].T).as_rotvec() / STEP_S for k in range(2)
        )
        return 0.5 * (first + second), (second - first) / STEP_S


def beyond(segment: str) -> set[str]:
    """A segment and all that hang on it."""
    return {
        s for s in MASSIVE_SEGMENTS if s == segment or (s in JOINT_OF_CHILD and hangs(s, segment))
    }


def hangs(segment: str, on: str) -> bool:
    above = JOINT_OF_CHILD[segment].parent
    return above == on or (above in JOINT_OF_CHILD and hangs(above, on))


def newton_euler(
    parameters: Parameters, segments: Segments, distal: str, centre: Array, wrench: Array
) -> Array:
    """(3,) N·m: what the proximal segment must do about `centre` to what lies beyond, and the
    ground does not.
    """
    moment = np.zeros(3)
    for name, row in zip(MASSIVE_SEGMENTS, view_as_table(parameters.inertial), strict=True):
        if name in beyond(distal):
            mass, com, inertia = row[0], row[1:4], np.diag(row[4:7])
            rotation = segments.pose[1][name].rotation
            w, alpha = segments.turning(name)
            about = rotation @ inertia @ rotation.T
            lever = segments.place(name, com) - centre
            force = mass * (segments.acceleration(name, com) - GRAVITY)
            moment += about @ alpha + np.cross(w, about @ w) + np.cross(lever, force)
    for k, foot in enumerate(FEET):
        if foot in beyond(distal):
            moment -= wrench[k, 3:] - np.cross(centre, wrench[k, :3])
    return moment


def test_moments_are_those_of_newton_and_euler_in_every_frame() -> None:
    q, v, a, wrench = state()
    _, found = compute_kinetic_values(PARAMETERS, q, v, a, wrench)
    frames = {joint.name: joint for joint in list_joint_frames(PARAMETERS)}
    for f in range(len(q)):
        segments = Segments(PARAMETERS, q[f], v[f], a[f])
        for joint in NET_JOINTS:
            kind = joint.name.replace("ankle", "talocrural").replace("lumbar", "back")
            distal = joint.distal
            centre = segments.place(joint.proximal, frames[kind].in_parent.translation)
            moment = newton_euler(PARAMETERS, segments, distal, centre, wrench[f])
            above, below = (segments.pose[1][name].rotation for name in (joint.proximal, distal))
            floating = np.cross(below[:, 1], above[:, 2])
            jcs = np.stack([above[:, 2], floating / np.linalg.norm(floating), below[:, 1]])
            anatomical = {
                MomentFrame.PROXIMAL: above.T[[2, 0, 1]],
                MomentFrame.DISTAL: below.T[[2, 0, 1]],
            }
            axes = anatomical | {MomentFrame.JCS: jcs}
            side = -1.0 if joint.name.endswith("_l") else 1.0
            flexion = -1.0 if joint.name.startswith("knee") else 1.0
            columns = [COMPONENTS.index(name) for name in joint.components]
            for k, frame in enumerate(VECTOR_FRAMES):
                expected = np.array([flexion, side, side]) * (axes[frame] @ moment)
                np.testing.assert_allclose(
                    found[f, k, columns], expected, rtol=0, atol=DIFFERENCES, err_msg=joint.name
                )


def test_powers_of_all_joints_change_the_energy_of_the_body() -> None:
    """With what the pelvis residual and the ground do: the ankle, whose hinges do not meet, too."""
    q, v, a, wrench = state()
    power, _ = compute_kinetic_values(PARAMETERS, q, v, a, wrench)
    tau = Dynamics(PARAMETERS).compute_forces(q, v, a, wrench)
    linkage = build_linkage(PARAMETERS)
    data = linkage.model.createData()
    for f in range(len(q)):
        before, after = (
            pin.computeMechanicalEnergy(
                linkage.model, data, q[f] + t * v[f] + 0.5 * t * t * a[f], v[f] + t * a[f]
            )
            for t in (-STEP_S, STEP_S)
        )
        ground = 0.0
        pin.forwardKinematics(linkage.model, data, q[f], v[f])
        for k, foot in enumerate(FEET):
            joint = int(linkage.chain.segment_joint[linkage.chain.segments.index(foot)])
            ground += float(data.oMi[joint].act(data.v[joint]).vector @ wrench[f, k])
        pelvis = float(tau[f, :6] @ v[f, :6])
        joints = sum(power[f, POWERS.index(name)] for name in POWER_JOINTS)
        rate = (after - before) / (2 * STEP_S)
        assert joints + pelvis + ground == pytest.approx(rate, rel=1e-5, abs=1e-2)


def test_powers_of_coordinates_sum_to_those_of_their_joint() -> None:
    q, v, a, wrench = state()
    power, _ = compute_kinetic_values(PARAMETERS, q, v, a, wrench)
    tau = Dynamics(PARAMETERS).compute_forces(q, v, a, wrench)
    kinetics = JointKinetics(time=np.arange(3.0), power=power, moment=np.zeros((3, 3, 21)))
    for joint, own in POWER_JOINTS.items():
        parts = [tau[:, COORDINATES.index(name)] * v[:, COORDINATES.index(name)] for name in own]
        np.testing.assert_allclose(power_of(kinetics, joint), sum(parts), atol=ROUNDING)
        if len(own) > 1:
            for name, part in zip(own, parts, strict=True):
                np.testing.assert_allclose(power_of(kinetics, name), part, atol=ROUNDING)
    assert {name for own in POWER_JOINTS.values() for name in own} == set(COORDINATES[6:])
    with refuses(ValueError, "hip", "hip_r"):
        power_of(kinetics, "hip")
    with refuses(ValueError):
        component_of(kinetics, "hip_flexion_r", MomentFrame.COORDINATES)


def test_slopes_of_moments_by_finite_differences() -> None:
    """By coordinates and joint parameters, those among the turns too, with the forces that they
    change.
    """
    free = (
        *list_leg_parameters("l"),
        *list_gait_parameters("r")[:5],
        "back.trunk.sup",
        "back.pelvis.ant",
    )
    q, v, a, wrench = (x[:1] for x in state())

    def values(q: Array, parameters: Parameters) -> Array:
        dynamics = Dynamics(parameters, HELD)
        return np.asarray(
            differentiate_moments(
                dynamics.place(q), dynamics.compute_forces(q, v, a, wrench)
            ).values[0]
        )

    forces = Dynamics(PARAMETERS, HELD).compute_forces(q, v, a, wrench)
    by_state = compute_force_derivatives(PARAMETERS, free, q, v, a, wrench, HELD)
    found = differentiate_moments(Dynamics(PARAMETERS, HELD, free).place(q), forces, free)
    through = found.by_force[0]
    by_position = through @ by_state.by_position[0] + found.by_position[0]
    assert_derivative(by_position, lambda x: values(x[None], PARAMETERS), q[0])
    by_parameter = through @ by_state.by_parameter[0] + found.by_parameter[0]
    start = PARAMETERS.joint[[JP_INDEX[name] for name in by_state.free]]
    assert_derivative(
        by_parameter,
        lambda x: values(q, PARAMETERS.with_joint(by_state.free, x)),
        start,
        relative=3e-6,
    )


def test_forces_held_still_report_themselves_and_change_no_other() -> None:
    q, v, a, wrench = state()
    plain, held = (
        Dynamics(PARAMETERS).compute_forces(q, v, a, wrench),
        Dynamics(PARAMETERS, HELD).compute_forces(q, v, a, wrench),
    )
    assert held.shape == (3, len(FORCES) + len(HELD))
    np.testing.assert_allclose(held[:, : len(FORCES)], plain, atol=ROUNDING)
    some = compute_force_derivatives(PARAMETERS, ("hip_r.pelvis.ant",), q, v, a, wrench, HELD)
    few = compute_force_derivatives(PARAMETERS, ("hip_r.pelvis.ant",), q, v, a, wrench)
    assert some.free == few.free == ("hip_r.pelvis.ant",)
    np.testing.assert_allclose(some.by_parameter[:, : len(FORCES)], few.by_parameter, atol=1e-6)


def test_a_refused_leg_has_no_error_bars_and_the_other_keeps_its_own() -> None:
    power, moment = np.ones((2, len(POWERS))), np.ones((2, len(VECTOR_FRAMES), len(COMPONENTS)))
    errors = KineticErrors(power, moment, KineticErrors(power, moment))
    kept = np.array([get_leg(name) == "l" for name in COORDINATES])
    for some in (errors.select(kept), errors.select(kept).from_markers):
        assert some is not None
        assert (
            np.isfinite(power_of(some, "ankle_l")).all()
            and np.isfinite(power_of(some, "hip_flexion_l")).all()
        )
        assert (
            np.isnan(power_of(some, "ankle_r")).all() and np.isnan(power_of(some, "lumbar")).all()
        )
        for frame in VECTOR_FRAMES:
            assert np.isfinite(component_of(some, "knee_rotation_l", frame)).all()
            assert np.isnan(component_of(some, "knee_rotation_r", frame)).all()
