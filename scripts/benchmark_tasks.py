"""The tasks that `benchmark.py` times: the published subject's gait and isolated trials, with the published noise."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from gaitcal.calibration.inertial_calibration import TorqueScale, fit_consistent, fit_published
from gaitcal.calibration.inertial_phase import LoadedMotion, equations_of
from gaitcal.calibration.joint_calibration import calibrate_joints
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.build import build_model
from gaitcal.model.inertial_parameters import symmetric_set
from gaitcal.model.joint_parameters import JP_NAMES, gait_parameters, isolated_parameters
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.linkage import SEGMENTS, joint_segments
from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import track
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_data import NodeRule, trial_problem
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.recording import Recording
from gaitcal.study.synthetic_data import ground_reactions, marker_noise, synthetic_markers
from gaitcal.study.synthetic_motion import TrueMotion, gait_motion, isolated_motion

NODES = NodeRule(fixed=20)
GAIT_JPS = (*gait_parameters("r"), *gait_parameters("l"))
CYCLE = 1.035


@dataclass(frozen=True)
class Timing:
    """One figure: a task, and what to say beside it."""

    name: str
    task: Callable[[], object]
    note: str | Callable[[], str] = ""
    runs: int | None = None


@cache
def recording(trial: str, frames: int | None = None) -> Recording:
    """Noisy markers of the published subject; a trial longer than recorded repeats itself."""
    motion = gait_motion() if trial == "gait" else isolated_motion(trial)
    model = published_model()
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    time = motion.basis.time
    if frames is not None and frames > len(time):
        back_and_forth = np.concatenate([markers, markers[-2:0:-1]])
        markers = np.resize(back_and_forth, (frames, *markers.shape[1:]))
        time = np.arange(frames) / 200.0
    noise = marker_noise(time, markers.shape[1], np.random.default_rng(1))
    return Recording(trial, time, model.markers.labels, markers + noise)


def problem(
    trial: str, free: tuple[str, ...] = (), *, joint_only: bool = False, rule: NodeRule = NODES
) -> TrialProblem:
    """The trial as a least-squares problem, whole body or the segments of its joint."""
    segments = joint_segments(trial) if joint_only else SEGMENTS
    found = trial_problem(trial, published_model(), recording(trial), rule, root=segments[0], segments=segments)
    return found.with_free(free)


def calibrated(p: TrialProblem, free: tuple[str, ...]) -> object:
    """Joint parameters and motion from rigid fits."""
    parameters = published_model().parameters
    start = starting_nodes(p.chain, p.with_free(()).constants(parameters), p.data, p.basis)
    return calibrate_joints([p], parameters, free, [start])


def lower_bound(p: TrialProblem, iterations: int) -> Callable[[], object]:
    """One forward kinematics and one CRBA per frame and iteration, and nothing else."""
    model = build_model(published_model().parameters)
    data = model.createData()
    q = gait_motion().q if len(p.basis.time) == len(gait_motion().basis.time) else np.zeros((len(p.basis.time), 27))

    def run() -> None:
        for _ in range(iterations):
            for row in q:
                pin.forwardKinematics(model, data, row)
                pin.crba(model, data, row, pin.Convention.WORLD)

    return run


def section_track() -> list[Timing]:
    """Motion of a 208-frame, 27-coordinate gait trial from rest."""
    p, model = problem("gait"), published_model()
    constants = p.constants(model.parameters)
    steps = track_nodes(p, constants, starting_nodes(p.chain, constants, p.data, p.basis)).steps
    plain = _plain(p, ())
    return [
        Timing("gaitcal", lambda: track(model, recording("gait"), rule=NODES), f"{steps} steps, 208 frames"),
        Timing("lower bound: FK + CRBA per frame and step", lower_bound(p, steps + 1)),
        Timing("SciPy least_squares, sparse analytic Jacobian", lambda: plain("analytic"), runs=1),
        Timing("SciPy least_squares, finite differences", lambda: plain("2-point"), runs=1),
        *_opensim_ik(),
    ]


def section_calibrate_gait() -> list[Timing]:
    """The same and 34 joint parameters."""
    p = problem("gait")
    plain = _plain(p, GAIT_JPS)
    return [
        Timing("gaitcal, 34 JPs", lambda: calibrated(p, GAIT_JPS)),
        Timing("SciPy least_squares, sparse analytic Jacobian", lambda: plain("analytic"), runs=1),
        *_opensim_ik(),
    ]


def _isolated(joint: str) -> Callable[[], list[Timing]]:
    def section() -> list[Timing]:
        free = isolated_parameters(joint)
        alone, whole = problem(joint, joint_only=True), problem(joint)
        return [
            Timing(f"gaitcal, {len(free)} JPs, segments of the joint", lambda: calibrated(alone, free)),
            Timing(f"gaitcal, {len(free)} JPs, whole body", lambda: calibrated(whole, free)),
        ]

    return section


def section_ip() -> list[Timing]:
    """36 inertial parameters from a noisy gait trial."""
    model, motion = published_model(), gait_motion()
    wrench = ground_reactions(model.parameters, motion, CYCLE)
    tracked = track(model, recording("gait"), rule=NODES)
    loaded = LoadedMotion(
        "gait", tracked.q, tracked.velocity, tracked.acceleration, wrench, np.ones(len(tracked.time), bool)
    )

    def run(fit: Callable[..., object]) -> object:
        equations = equations_of([loaded], model.parameters, model.subject, TorqueScale.BODY_HEIGHT, 0.176)
        return fit(equations, model.parameters.inertial, symmetric_set())

    return [
        Timing("gaitcal, physically consistent", lambda: run(fit_consistent)),
        Timing("gaitcal, published cost with re-seeding", lambda: run(fit_published)),
    ]


def section_inverse_dynamics() -> list[Timing]:
    """Generalised forces of 208 frames."""
    model, motion = published_model(), gait_motion()
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    wrench = ground_reactions(model.parameters, motion, CYCLE)
    bare, data = build_model(model.parameters), build_model(model.parameters).createData()

    def rnea() -> None:
        for row in zip(q, v, a, strict=True):
            pin.rnea(bare, data, *row)

    return [
        Timing("gaitcal", lambda: Dynamics(model.parameters).forces(q, v, a, wrench), "208 frames"),
        Timing("lower bound: bare RNEA", rnea),
        *_opensim_id(q, v, a),
    ]


def section_startup() -> list[Timing]:
    """The command line and the import, each in its own process."""

    def run(*command: str) -> Callable[[], object]:
        return lambda: subprocess.run([sys.executable, *command], check=True, capture_output=True)

    return [
        Timing("gaitcal --help", run("-m", "gaitcal.cli", "--help")),
        Timing("import gaitcal", run("-c", "import gaitcal")),
        Timing("python alone", run("-c", "pass")),
    ]


def section_scaling() -> list[Timing]:
    """Frames (15 spans a second), joint parameters, trials."""
    model, rule = published_model(), NodeRule(per_second=15.0)
    out = []
    for frames in (200, 1000, 5000, 25_000, 100_000):
        whole = recording("gait", frames)
        cut = replace(whole, time=whole.time[:frames], markers=whole.markers[:frames])
        runs = 1 if frames > 10_000 else 3
        out.append(Timing(f"track {frames} frames", lambda r=cut: track(model, r, rule=rule), runs=runs))
    p = problem("gait")
    for count in (6, 17, 34, 54, 98):
        free = JP_NAMES if count == 98 else _first(count)
        out.append(Timing(f"calibrate gait, {count} JPs", lambda f=free: calibrated(p, f), runs=3))
    start = starting_nodes(p.chain, p.constants(model.parameters), p.data, p.basis)
    for count in (1, 2, 4, 8, 16, 32):
        trials = [replace(p, name=f"gait {k}") for k in range(count)]
        out.append(
            Timing(
                f"calibrate {count} gait trials together, 17 JPs",
                lambda t=trials: calibrate_joints(t, model.parameters, gait_parameters("r"), [start] * len(t)),
                runs=3,
            )
        )
    return out


def _first(count: int) -> tuple[str, ...]:
    legs = {6: isolated_parameters("hip_r"), 17: gait_parameters("r"), 34: GAIT_JPS}
    if count in legs:
        return legs[count]
    return tuple(name for j in ("hip", "knee", "ankle") for s in "rl" for name in isolated_parameters(f"{j}_{s}"))


def _plain(p: TrialProblem, free: tuple[str, ...]) -> Callable[[str], object]:
    """The textbook way: all residuals and all unknowns in one `least_squares`."""
    model = published_model()
    opened = p.with_free(free)
    nn, nq, size = p.basis.nodes, len(p.chain.coordinates), p.basis.nodes * len(p.chain.coordinates)
    constants = opened.constants(model.parameters)
    start = starting_nodes(p.chain, p.with_free(()).constants(model.parameters), p.data, p.basis)
    x0 = np.concatenate([start.ravel(), opened.values(model.parameters)])
    columns = (p.basis.first[:, None, None] + np.arange(6)[:, None]) * nq + np.arange(nq)

    def at(x: np.ndarray) -> tuple[np.ndarray, object]:
        return x[:size].reshape(nn, nq), opened.constants(model.parameters.with_joint(opened.chain.free, x[size:]))

    def residual(x: np.ndarray) -> np.ndarray:
        nodes, here = at(x)
        return (opened.positions(nodes, here) - p.data.measured).ravel()

    def sparse(x: np.ndarray) -> csr_array:
        nodes, here = at(x)
        return _marker_jacobian(opened, nodes, here, columns)

    pattern = sparse(x0) != 0

    def run(kind: str) -> object:
        if kind == "analytic":
            return least_squares(residual, x0, jac=sparse, tr_solver="lsmr", ftol=1e-8, xtol=1e-8)
        return least_squares(residual, x0, jac="2-point", jac_sparsity=pattern, tr_solver="lsmr", ftol=1e-8, xtol=1e-8)

    del constants
    return run


def _marker_jacobian(p: TrialProblem, nodes: np.ndarray, constants: object, columns: np.ndarray) -> csr_array:
    q = p.basis.evaluate(nodes)
    nf, nq, nm = len(q), q.shape[1], len(p.data.segment)
    spatial = jacobian(p.chain, constants, forward(p.chain, constants, q))  # type: ignore[arg-type]
    x = p.positions(nodes, constants)  # type: ignore[arg-type]
    rows, cols, values = [], [], []
    frame = np.arange(nf)
    for m, segment in enumerate(p.data.segment):
        moved = p.chain.support[:, segment][:, None, None]
        velocity = (spatial[:, :3] + np.cross(spatial[:, 3:], x[m][None], axis=1)) * moved
        for i in range(3):
            row = (m * 3 + i) * nf + frame
            block = p.basis.value[:, :, None] * velocity[:nq, i].T[:, None, :]
            rows.append(np.broadcast_to(row[:, None, None], block.shape).ravel())
            cols.append(columns.ravel())
            values.append(block.ravel())
            for k in range(len(p.chain.free)):
                rows.append(row)
                cols.append(np.full(nf, nodes.size + k))
                values.append(velocity[nq + k, i])
    shape = (3 * nm * nf, nodes.size + len(p.chain.free))
    out = csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=shape)
    out.eliminate_zeros()
    return out


def _opensim_ik() -> list[Timing]:
    from benchmark_opensim import inverse_kinematics

    return inverse_kinematics(published_model(), recording("gait"), Path(tempfile.mkdtemp()))


def _opensim_id(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[Timing]:
    from benchmark_opensim import inverse_dynamics

    return inverse_dynamics(published_model(), q, v, a, Path(tempfile.mkdtemp()))


SECTIONS: dict[str, Callable[[], list[Timing]]] = {
    "track": section_track,
    "calibrate-gait": section_calibrate_gait,
    "calibrate-hip": _isolated("hip_l"),
    "calibrate-knee": _isolated("knee_l"),
    "calibrate-ankle": _isolated("ankle_l"),
    "ip": section_ip,
    "inverse-dynamics": section_inverse_dynamics,
    "startup": section_startup,
    "scaling": section_scaling,
}

__all__ = ["SECTIONS", "Timing", "TrueMotion"]
