"""Reference for a peer's answers: our mechanics, and random states."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.model.chain import build_model
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import IP_NAMES, JP_NAMES, JP_TO_SI, is_physical
from gaitcal.model.subject_model import SubjectModel

Array = NDArray[np.float64]

FORCE_TOLERANCE = 1e-6
"""N, N·m: what the exports promise."""
POSITION_TOLERANCE = 1e-9
"""m: likewise."""
PRINTED = 1e-6
"""N, N·m: OpenSim's tool writes eight decimals; accelerations come from its own splines on both
sides.
"""
IK_TOLERANCE = 0.2e-3
"""m: likewise promised, RMS over markers of the distance between OpenSim's pose and our per-frame
optimum.
"""
FEET = ("foot_r", "foot_l")
SEEDS = range(4)
STATES = 8
"""Random states per model."""


@dataclass(frozen=True)
class State:
    q: Array
    v: Array
    a: Array
    wrenches: Array
    """(2, 6) force and moment about the laboratory origin on the right and left foot."""


def random_states(seed: int, count: int = STATES, still: tuple[str, ...] = ()) -> list[State]:
    """States far beyond what people do; coordinates in `still` stay at rest at zero."""
    rng = np.random.default_rng([seed, 1])
    moving = np.array([name not in still for name in COORDINATES], float)
    return [
        State(
            0.8 * rng.normal(size=len(COORDINATES)) * moving,
            4.0 * rng.normal(size=len(COORDINATES)) * moving,
            40.0 * rng.normal(size=len(COORDINATES)) * moving,
            rng.normal(size=(2, 6)) * [500, 800, 500, 300, 300, 300],
        )
        for _ in range(count)
    ]


def perturbed(model: SubjectModel, seed: int) -> SubjectModel:
    """All JPs within 10 mm and 10 degrees, all IPs within 10 %, left and right apart; seed 0: as it
    is.
    """
    if seed == 0:
        return model
    rng = np.random.default_rng([seed, 2])
    joint = model.parameters.joint + rng.uniform(-10, 10, len(JP_NAMES)) * JP_TO_SI
    inertial = model.parameters.inertial.copy()
    while True:
        inertial = model.parameters.inertial * rng.uniform(0.9, 1.1, len(IP_NAMES))
        if is_physical(inertial).all():
            break
    return model.with_parameters(replace(model.parameters, joint=joint, inertial=inertial))


def our_forces(model: SubjectModel, state: State) -> Array:
    """(27,) generalised forces: RNEA minus what the ground contributes."""
    linkage = build_model(model.parameters)
    data = linkage.createData()
    tau = pin.rnea(linkage, data, state.q, state.v, state.a).copy()
    pin.computeJointJacobians(linkage, data, state.q)
    for foot, wrench in zip(FEET, state.wrenches, strict=True):
        joint = linkage.frames[linkage.getFrameId(foot)].parentJoint
        tau -= pin.getJointJacobian(linkage, data, joint, pin.ReferenceFrame.WORLD).T @ wrench
    return tau


def our_markers(model: SubjectModel, q: Array) -> Array:
    """(nm, 3) m."""
    linkage = build_model(model.parameters)
    data = linkage.createData()
    pin.framesForwardKinematics(linkage, data, q)
    placed = zip(model.markers.segments, model.markers.local, strict=True)
    return np.array([data.oMf[linkage.getFrameId(segment)].act(local) for segment, local in placed])
