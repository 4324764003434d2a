"""The tasks that `python -m scripts.tools.benchmark` times."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from gaitcal.calibration.inertial_calibration import (
    LoadedMotion,
    TorqueScale,
    equations_of,
    fit_consistent,
    fit_published,
)
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.parameters import isolated_parameters, symmetric_set
from gaitcal.model.subject_model import build_model
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.bandwidth import DenseMotion, with_bandwidth
from gaitcal.motion.motion import motion_of, track, tracked_motion
from gaitcal.motion.spline import NodeRule
from gaitcal.synthetic.motion import gait_motion, residual_free_wrench
from scripts.tools.benchmark.figure import (
    GAIT_JPS,
    NODES,
    Amount,
    Timing,
    calibrated,
    problem,
    recording,
    start_of,
    subject,
)
from scripts.tools.benchmark.programs import (
    section_calibrate_study,
    section_calibrate_walk,
    section_checks,
    section_montecarlo,
    section_startup,
)
from scripts.tools.benchmark.references import (
    inverse_dynamics,
    inverse_kinematics,
    lower_bound,
    passes,
    plain_least_squares,
)
from scripts.tools.benchmark.scaling import section_scaling

SHORT_FRAMES, SHORT_NODES = 52, NodeRule(fixed=9)
"""A quarter of the gait trial and of its spans: what finite differences are tried on."""
SHORT_EVALUATIONS = 5
TWENTY = NodeRule(per_second=20.0)
"""What every trial had before its markers chose."""


def section_track() -> list[Timing]:
    """Motion of a 208-frame, 27-coordinate gait trial from rest."""
    p, model = problem("gait"), subject()
    with_matrix, without = passes(p)
    said = f"208 frames, {with_matrix} passes with the matrix and {without} without"
    return [
        Timing("gaitcal", lambda: track(model, recording("gait"), rule=NODES), said),
        *_parts_of_track(),
        Timing("lower bound: Pinocchio, FK a pass, CRBA a matrix", lower_bound(with_matrix, without)),
        *inverse_kinematics(model, recording("gait")),
        *_plain(()),
    ]


def _parts_of_track() -> list[Timing]:
    """What the time of tracking is made of."""
    p, parameters = problem("gait"), subject().parameters
    constants, coefficients = p.constants(parameters), start_of(p)
    band = p.equations(coefficients, constants).band
    return [
        Timing("  of it: trial set up", lambda: problem("gait")),
        Timing("  of it: start from rigid fits", lambda: start_of(p)),
        Timing("  of it: a pass with the matrix", lambda: p.equations(coefficients, constants)),
        Timing("  of it: a pass without", lambda: p.gradient(coefficients, constants)),
        Timing("  of it: a factorisation", lambda: BandFactor(band)),
        Timing("  of it: distances of all markers", lambda: motion_of(p, parameters, coefficients)),
    ]


def section_calibrate_gait() -> list[Timing]:
    """The same and 34 joint parameters."""
    p = problem("gait")
    said = f"{calibrated(p, GAIT_JPS).iterations} outer iterations"
    return [
        Timing("gaitcal, 34 JPs", lambda: calibrated(p, GAIT_JPS), said),
        *inverse_kinematics(subject(), recording("gait")),
        *_plain(GAIT_JPS),
    ]


def _plain(free: tuple[str, ...]) -> list[Timing]:
    """SciPy on the plain problem; with finite differences on a part of it."""
    whole, part = problem("gait"), problem("gait", rule=SHORT_NODES, frames=SHORT_FRAMES)
    short = plain_least_squares(part, free, analytic=False, evaluations=SHORT_EVALUATIONS)
    taken: list[int] = []

    def analytic() -> None:
        taken.append(int(plain_least_squares(whole, free, analytic=True)().nfev))

    def extrapolated(seconds: float) -> str:
        all_of_it = seconds * (208 / SHORT_FRAMES) * (taken[-1] / SHORT_EVALUATIONS)
        return f"1 run of {SHORT_EVALUATIONS} evaluations; 208 frames and {taken[-1]}, in proportion: {all_of_it:.0f} s"

    sparse, differences = "sparse analytic Jacobian", f"finite differences, {SHORT_FRAMES} frames"
    return [
        Timing(f"SciPy least_squares, {sparse}", analytic, lambda _: f"1 run, {taken[-1]} evaluations", 1),
        Timing(f"SciPy least_squares, {differences}", short, extrapolated, 1),
    ]


def _isolated(joint: str) -> Callable[[], list[Timing]]:
    def section() -> list[Timing]:
        free = isolated_parameters(joint)
        alone, whole = problem(joint, joint_only=True), problem(joint)
        return [
            Timing(f"gaitcal, {len(free)} JPs, segments of the joint", lambda: calibrated(alone, free), "1200 frames"),
            Timing(f"gaitcal, {len(free)} JPs, whole body", lambda: calibrated(whole, free), "1200 frames"),
        ]

    return section


def section_ip() -> list[Timing]:
    """36 inertial parameters from a noisy gait trial."""
    model, motion = subject(), gait_motion()
    wrench = residual_free_wrench(model.parameters, motion)
    t = track(model, recording("gait"), rule=NODES)
    valid = np.ones(len(t.time), bool)
    loaded = LoadedMotion(state=(t.q, t.velocity, t.acceleration), wrench=wrench, valid=valid)

    def run(fit: Callable[..., object]) -> object:
        equations = equations_of([loaded], model.parameters, model.subject, TorqueScale.BODY_HEIGHT, 0.176)
        return fit(equations, model.parameters.inertial, symmetric_set())

    return [
        Timing("gaitcal, physically consistent", lambda: run(fit_consistent)),
        Timing("gaitcal, published cost with re-seeding", lambda: run(fit_published)),
    ]


def section_bandwidth() -> list[Timing]:
    """What a bandwidth costs that the markers choose; the choice is wanted in eight tracks of 20 nodes a second."""
    model, seen, p = subject(), recording("gait"), problem("gait")
    parameters = model.parameters
    hz = DenseMotion(p, parameters).by_markers()
    smoothed = with_bandwidth(p, parameters, hz)
    choice = "choice of the bandwidth by the markers"
    return [
        Timing(f"track, {TWENTY.per_second:g} nodes a second", lambda: track(model, seen, rule=TWENTY)),
        Timing(choice, lambda: DenseMotion(p, parameters).by_markers(), f"{hz:.1f} Hz"),
        Timing("track with it", lambda: tracked_motion(smoothed, parameters), f"{smoothed.basis.nodes} nodes"),
    ]


def section_inverse_dynamics() -> list[Timing]:
    """Generalised forces of 208 frames."""
    model, motion = subject(), gait_motion()
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    wrench = residual_free_wrench(model.parameters, motion)
    bare = build_model(model.parameters)
    data = bare.createData()

    def rnea() -> None:
        for row in zip(q, v, a, strict=True):
            pin.rnea(bare, data, *row)

    return [
        Timing("gaitcal", lambda: Dynamics(model.parameters).forces(q, v, a, wrench), "208 frames"),
        Timing("lower bound: bare RNEA", rnea),
        *inverse_dynamics(model, q, v, a),
    ]


SECTIONS: dict[str, Callable[[], list[Timing] | list[Timing | Amount]]] = {
    "track": section_track,
    "calibrate-gait": section_calibrate_gait,
    "calibrate-hip": _isolated("hip_l"),
    "calibrate-knee": _isolated("knee_l"),
    "calibrate-ankle": _isolated("ankle_l"),
    "bandwidth": section_bandwidth,
    "ip": section_ip,
    "inverse-dynamics": section_inverse_dynamics,
    "checks": section_checks,
    "calibrate-study": section_calibrate_study,
    "calibrate-walk": section_calibrate_walk,
    "montecarlo": section_montecarlo,
    "startup": section_startup,
    "scaling": section_scaling,
}
