"""What a task is compared with: SciPy on the plain problem, the bare Pinocchio calls that it cannot
avoid, and OpenSim on our exported model and the same markers, in this process; nothing where it is
not installed.

OpenSim's inverse kinematics solves one frame after the other, each from the last, with the accuracy
that its own tool has by default (1e-5), the weights of our marker set, and no coordinate tasks. It
has no splines; so its marker RMS is to be that of our own fit with a node for every frame, which is
told beside it.

One figure of a benchmark, and the trials that are timed: the published subject's gait and isolated
trials, with the published noise.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_array

from gaitcal.calibration.joint_estimate import JointFit, JointSearch
from gaitcal.export.opensim.osim_writer import write_osim
from gaitcal.io.opensim_files import write_trc
from gaitcal.io.recording import Recording
from gaitcal.model.chain import LinkageModel, build_model
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, SEGMENTS, list_joint_segments
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import list_gait_parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.synthetic.synthetic_motion import (
    compute_synthetic_markers,
    draw_marker_noise,
    simulate_gait,
    simulate_isolated_trial,
)
from gaitcal.tracking.banded import NormalEquations
from gaitcal.tracking.motion import track, track_coefficients
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.start import find_start_coefficients
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem

NODES = ControlPointRule(fixed=20)
GAIT_JPS = (*list_gait_parameters("r"), *list_gait_parameters("l"))


@dataclass(frozen=True)
class Figure:
    """Seconds of a task, or an amount that it returns."""

    name: str
    task: Callable[[], object]
    note: str | Callable[[float], str] = ""
    """What to say beside it; may depend on the seconds it took."""
    runs: int | None = None
    """Timed runs, if not as many as asked for. A single one has no warm-up before it."""
    series: str = ""
    """Figures of one series differ in size alone."""
    size: float = 0.0
    share: Callable[[], float] | None = None
    """What to divide the seconds by where a series is compared: iterations, where their number
    differs.
    """
    unit: str = "s"
    """Of another one, the task returns the amount, which is measured once."""


def temporary_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="gaitcal-benchmark-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def subject() -> SubjectModel:
    return published_model()


@cache
def recording(trial: str, frames: int | None = None, seed: int = 1) -> Recording:
    """Noisy markers of the published subject, the first frames; a trial longer than recorded goes
    back and forth.
    """
    motion = simulate_gait() if trial == "gait" else simulate_isolated_trial(trial)
    model = subject()
    markers = compute_synthetic_markers(model.parameters, model.markers, motion.q)
    time = motion.basis.time
    if frames is not None and frames > len(time):
        markers = np.resize(
            np.concatenate([markers, markers[-2:0:-1]]), (frames, *markers.shape[1:])
        )
        time = np.arange(frames) / 200.0
    markers = markers + draw_marker_noise(time, markers.shape[1], np.random.default_rng(seed))
    return Recording(
        source=trial, time=time[:frames], labels=model.markers.labels, markers=markers[:frames]
    )


def problem(
    trial: str,
    *,
    joint_only: bool = False,
    rule: ControlPointRule = NODES,
    frames: int | None = None,
    seed: int = 1,
) -> MotionProblem:
    """The trial (or its first frames) as a least-squares problem, whole body or the segments of its
    joint.
    """
    segments = list_joint_segments(trial) if joint_only else SEGMENTS
    return build_trial_problem(
        trial, subject(), recording(trial, frames, seed), rule, root=segments[0], segments=segments
    )


def start_of(p: MotionProblem) -> np.ndarray:
    """(nn, nq) coefficients from rigid fits."""
    return find_start_coefficients(
        p.with_free(()).build_body(subject().parameters), p.data, p.basis
    )


def calibrated(p: MotionProblem, free: tuple[str, ...]) -> JointFit:
    """Joint parameters and motion from rigid fits."""
    return JointSearch([p], subject().parameters, free, [start_of(p)]).run()


ACCURACY = 1e-5


class Counted(MotionProblem):
    def equations(
        self, coefficients: np.ndarray, body: LinkageModel, *, curved: bool = False
    ) -> NormalEquations:
        self.counts["matrices"] += 1
        return super().equations(coefficients, body, curved=curved)

    def gradient(self, coefficients: np.ndarray, body: LinkageModel) -> tuple[float, np.ndarray]:
        self.counts["gradients"] += 1
        return super().gradient(coefficients, body)

    @property
    def counts(self) -> dict[str, int]:
        """Passes over all frames so far."""
        return self.__dict__.setdefault("_counts", {"matrices": 0, "gradients": 0})


def passes(p: MotionProblem) -> tuple[int, int]:
    """Passes over all frames that tracking makes: with and without the matrix."""
    counted = Counted(**{field.name: getattr(p, field.name) for field in fields(p)})
    track_coefficients(counted, p.build_body(subject().parameters), start_of(p))
    return counted.counts["matrices"], counted.counts["gradients"]


def lower_bound(matrices: int, gradients: int) -> Callable[[], object]:
    """One forward kinematics per frame and pass, one CRBA where the matrix is formed, and nothing
    else.
    """
    model = build_model(subject().parameters)
    data = model.createData()
    q = simulate_gait().q

    def run() -> None:
        for k in range(matrices + gradients):
            for row in q:
                pin.forwardKinematics(model, data, row)
                if k < matrices:
                    pin.crba(model, data, row, pin.Convention.WORLD)

    return run


def plain_least_squares(
    p: MotionProblem, free: tuple[str, ...], *, analytic: bool, evaluations: int | None = None
) -> Callable[[], OptimizeResult]:
    """The textbook way: all residuals and all unknowns in one `least_squares`, with the sparse
    analytic Jacobian or with finite differences of the same pattern; at most so many evaluations of
    the residuals.
    """
    model = subject()
    opened = p.with_free(free)
    nn, nq, size = (
        p.basis.control_points,
        len(p.chain.coordinates),
        p.basis.control_points * len(p.chain.coordinates),
    )
    x0 = np.concatenate([start_of(p).ravel(), opened.get_values(model.parameters)])
    columns = (p.basis.first[:, None, None] + np.arange(6)[:, None]) * nq + np.arange(nq)

    def at(x: np.ndarray) -> tuple[np.ndarray, LinkageModel]:
        return x[:size].reshape(nn, nq), opened.build_body(
            model.parameters.with_joint(opened.chain.free, x[size:])
        )

    def residual(x: np.ndarray) -> np.ndarray:
        coefficients, here = at(x)
        return (
            np.sqrt(p.data.weight)[:, None]
            * (opened.compute_positions(coefficients, here) - p.data.measured)
        ).ravel()

    def sparse(x: np.ndarray) -> csr_array:
        coefficients, here = at(x)
        return _marker_jacobian(opened, coefficients, here, columns)

    settings = {"tr_solver": "lsmr", "ftol": 1e-8, "xtol": 1e-8, "max_nfev": evaluations}
    if analytic:
        return lambda: least_squares(residual, x0, jac=sparse, **settings)
    pattern = sparse(x0) != 0
    return lambda: least_squares(residual, x0, jac="2-point", jac_sparsity=pattern, **settings)


def _marker_jacobian(
    p: MotionProblem, coefficients: np.ndarray, body: LinkageModel, columns: np.ndarray
) -> csr_array:
    q = p.basis.evaluate(coefficients)
    nf, nq, nm = len(q), q.shape[1], len(p.data.segment)
    spatial = Kinematics(body, q).columns
    x = p.compute_positions(coefficients, body)
    rows, cols, values = [], [], []
    frame = np.arange(nf)
    for m, segment in enumerate(p.data.segment):
        moved = p.chain.support[:, segment][:, None, None]
        velocity = (spatial[:, :3] + np.cross(spatial[:, 3:], x[m][None], axis=1)) * moved
        velocity = velocity * np.sqrt(p.data.weight[m])
        for i in range(3):
            row = (m * 3 + i) * nf + frame
            block = p.basis.value[:, :, None] * velocity[:nq, i].T[:, None, :]
            rows.append(np.broadcast_to(row[:, None, None], block.shape).ravel())
            cols.append(columns.ravel())
            values.append(block.ravel())
            for k in range(len(p.chain.free)):
                rows.append(row)
                cols.append(np.full(nf, coefficients.size + k))
                values.append(velocity[nq + k, i])
    shape = (3 * nm * nf, coefficients.size + len(p.chain.free))
    out = csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=shape
    )
    out.eliminate_zeros()
    return out


def _opensim() -> Any:
    try:
        import opensim
    except ImportError:
        return None
    opensim.Logger.setLevelString("Off")
    return opensim


def _peer(opensim: Any, model: SubjectModel, folder: Path) -> Any:
    write_osim(model, folder / "model.osim")
    peer = opensim.Model(str(folder / "model.osim"))
    peer.initSystem()
    return peer


def inverse_kinematics(model: SubjectModel, recording: Recording) -> list[Figure]:
    """OpenSim's inverse kinematics solver over all frames, without its file reading and writing."""
    opensim = _opensim()
    if opensim is None:
        return []
    folder = temporary_folder()
    write_trc(folder / "markers.trc", recording)
    peer = _peer(opensim, model, folder)
    weight_of = dict(zip(model.markers.labels, model.markers.weight, strict=True))
    weights = opensim.SetMarkerWeights()
    for label in recording.labels:
        weights.cloneAndAppend(opensim.MarkerWeight(label, float(weight_of[label])))
    reference = opensim.MarkersReference(str(folder / "markers.trc"), weights)
    coordinates = opensim.SimTKArrayCoordinateReference()

    def run(squares: list[float] | None = None) -> None:
        state = peer.initSystem()
        solver = opensim.InverseKinematicsSolver(peer, reference, coordinates)
        solver.setAccuracy(ACCURACY)
        for k, t in enumerate(recording.time):
            state.setTime(float(t))
            if k == 0:
                solver.assemble(state)
            else:
                solver.track(state)
            if squares is not None:
                found = opensim.SimTKArrayDouble()
                solver.computeCurrentSquaredMarkerErrors(found)
                squares += [found.getElt(i) for i in range(found.size())]

    squares: list[float] = []
    run(squares)
    theirs = 1e3 * float(np.sqrt(np.mean(squares)))
    ours = 1e3 * (
        track(model, recording, rule=ControlPointRule(fixed=len(recording.time))).errors.rms()
        or np.nan
    )
    note = (
        f"{len(recording.time)} frames, marker RMS {theirs:.3f} mm (ours with a node a frame "
        f"{ours:.3f} mm)"
    )
    return [Figure(f"OpenSim inverse kinematics, accuracy {ACCURACY:g}", run, note)]


def inverse_dynamics(
    model: SubjectModel, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> list[Figure]:
    """OpenSim's inverse dynamics solver, frame by frame."""
    opensim = _opensim()
    if opensim is None:
        return []
    peer = _peer(opensim, model, temporary_folder())

    def run() -> None:
        state = peer.initSystem()  # held here: OpenSim's objects do not keep their model alive
        coordinates = peer.getCoordinateSet()
        place = [
            COORDINATES.index(coordinates.get(i).getName()) for i in range(coordinates.getSize())
        ]
        solver = opensim.InverseDynamicsSolver(peer)
        for f in range(len(q)):
            for i, k in enumerate(place):
                coordinates.get(i).setValue(state, float(q[f, k]), False)
                coordinates.get(i).setSpeedValue(state, float(v[f, k]))
            solver.solve(state, opensim.Vector.createFromMat(a[f, place]))

    return [
        Figure("OpenSim inverse dynamics solver", run, f"{len(q)} frames, without ground reactions")
    ]
