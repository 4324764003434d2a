"""The tasks that `python -m scripts.tools.benchmark` times: parts of a fit, and whole programs.

How time and memory grow: with frames (15 spans a second), joint parameters and trials.

Memory: the published subject walks on and on, with 1 mm of noise; a child process tracks that with
the default splines (20 spans a second) and tells its peak. Limit: 1.5 GiB for 100 000 frames,
libraries included.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.calibration.inertial_calibration import (
    LoadedMotion,
    TorqueScale,
    assemble_root_equations,
    fit_consistent,
    fit_published,
)
from gaitcal.calibration.joint_estimate import JointFit, JointSearch
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.io.recording import Recording
from gaitcal.model.chain import build_model
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JP_NAMES,
    list_gait_parameters,
    list_isolated_parameters,
    make_symmetric_set,
)
from gaitcal.montecarlo.case import make_nominal_case
from gaitcal.montecarlo.draw_study import monte_carlo
from gaitcal.montecarlo.protocol import Plan
from gaitcal.montecarlo.workers import LocalProcesses, Workers
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from gaitcal.synthetic.synthetic_motion import (
    compute_residual_free_wrench,
    compute_synthetic_markers,
    simulate_gait,
)
from gaitcal.tracking.banded import BandFactor
from gaitcal.tracking.bandwidth import DenseMotion, apply_bandwidth
from gaitcal.tracking.motion import build_motion, track, track_motion
from gaitcal.tracking.spline import ControlPointRule
from scripts.tools.benchmark.references import (
    GAIT_JPS,
    NODES,
    Figure,
    calibrated,
    inverse_dynamics,
    inverse_kinematics,
    lower_bound,
    passes,
    plain_least_squares,
    problem,
    recording,
    start_of,
    subject,
    temporary_folder,
)

FRAMES = (200, 1000, 5000, 25_000, 100_000)
MEMORY_FRAMES = (5000, 25_000, 100_000)
TRIALS = (1, 2, 4, 8, 16, 32)
RULE = ControlPointRule(per_second=15.0)
GIB, LIMIT_GIB = 2.0**30, 1.5


def section_scaling() -> list[Figure]:
    return [*_frames(), *_memory(), *_parameters(), *_trials()]


def _frames() -> list[Figure]:
    def of(frames: int) -> Figure:
        cut, runs = recording("gait", frames), 1 if frames > 10_000 else 3
        task = partial(track, subject(), cut, rule=RULE)
        return Figure(
            f"track {frames} frames",
            task,
            f"{runs} run{'s' * (runs > 1)}",
            runs,
            "time, frames",
            frames,
        )

    return [of(frames) for frames in FRAMES]


def _memory() -> list[Figure]:
    """Peak of a child process that tracks, beyond what it took before it had a recording."""

    def beyond(frames: int) -> float:
        used = usage(frames, 100.0)
        return used["peak_gib"] - used["libraries_gib"]

    note = f"beyond the libraries; 20 spans a second; limit {LIMIT_GIB:g} with them"
    return [
        Figure(
            f"memory to track {n} frames at 100 Hz",
            partial(beyond, n),
            note,
            series="memory, frames",
            size=n,
            unit="GiB",
        )
        for n in MEMORY_FRAMES
    ]


def long_recording(frames: int, rate: float) -> Recording:
    """Walking without end: every cycle goes on where the last one ended."""
    model, motion = published_model(), simulate_gait()
    q = motion.q[:: max(1, round(200.0 / rate))]
    cycles = -(-frames // len(q))
    markers = compute_synthetic_markers(model.parameters, model.markers, q)
    way = np.arange(cycles) * float(q[-1, 0] - q[0, 0])
    out = np.tile(markers, (cycles, 1, 1))[:frames]
    out[..., 0] += np.repeat(way, len(q))[:frames, None]
    out += np.random.default_rng(0).normal(0, 0.001, out.shape)
    return Recording(
        source="made up", time=np.arange(frames) / rate, labels=model.markers.labels, markers=out
    )


def peak_gib() -> float:
    """Largest memory of this process so far.

    On Linux from /proc: what `getrusage` tells is at least what the process that started this one
    had then.
    """
    status = Path("/proc/self/status")
    if status.exists():
        peak = next(
            line
            for line in status.read_text(encoding="ascii").splitlines()
            if line.startswith("VmHWM")
        )
        return int(peak.split()[1]) * 1024 / GIB
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / GIB


def measured(frames: int, rate: float) -> dict[str, float]:
    """Make and track in this process; GiB before there was a recording, and at most, and the RMS
    marker distance.
    """
    libraries = peak_gib()
    motion = track(published_model(), long_recording(frames, rate), rule=ControlPointRule())
    return {
        "libraries_gib": libraries,
        "peak_gib": peak_gib(),
        "rms_mm": 1e3 * (motion.errors.rms() or float("nan")),
    }


def usage(frames: int, rate: float) -> dict[str, float]:
    """The same in a process of its own, whose peak is that of this run alone."""
    command = [sys.executable, "-m", "scripts.tools.benchmark.tasks", str(frames), str(rate)]
    found: dict[str, float] = json.loads(
        subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    )
    return found


def _parameters() -> list[Figure]:
    p = problem("gait")
    legs = tuple(
        name
        for j in ("hip", "knee", "ankle")
        for s in "rl"
        for name in list_isolated_parameters(f"{j}_{s}")
    )
    sets = (list_isolated_parameters("hip_r"), list_gait_parameters("r"), GAIT_JPS, legs, JP_NAMES)

    def of(free: tuple[str, ...]) -> Figure:
        said = f"{calibrated(p, free).iterations} outer iterations; 3 runs"
        return Figure(
            f"calibrate gait, {len(free)} JPs", partial(calibrated, p, free), said, runs=3
        )

    return [of(free) for free in sets]


def _trials() -> list[Figure]:
    parameters, free = subject().parameters, list_gait_parameters("r")

    def of(number: int) -> Figure:
        trials = [problem("gait", seed=k + 1) for k in range(number)]
        starts = [start_of(p) for p in trials]
        task: Callable[[], JointFit] = lambda: JointSearch(trials, parameters, free, starts).run()  # noqa: E731
        iterations = task().iterations
        name = f"calibrate {number} gait trial{'s' * (number > 1)} together, 17 JPs"
        said, series = f"{iterations} outer iterations; 3 runs", "time an outer iteration, trials"
        return Figure(name, task, said, 3, series, number, lambda: iterations)

    return [of(number) for number in TRIALS]


SHORT_FRAMES, SHORT_NODES = 52, ControlPointRule(fixed=9)
"""A quarter of the gait trial and of its spans: what finite differences are tried on."""
SHORT_EVALUATIONS = 5
TWENTY = ControlPointRule(per_second=20.0)
"""What every trial had before its markers chose."""


def section_track() -> list[Figure]:
    p, model = problem("gait"), subject()
    with_matrix, without = passes(p)
    said = f"208 frames, {with_matrix} passes with the matrix and {without} without"
    return [
        Figure("gaitcal", lambda: track(model, recording("gait"), rule=NODES), said),
        *_parts_of_track(),
        Figure(
            "lower bound: Pinocchio, FK a pass, CRBA a matrix", lower_bound(with_matrix, without)
        ),
        *inverse_kinematics(model, recording("gait")),
        *_plain(()),
    ]


def _parts_of_track() -> list[Figure]:
    p, parameters = problem("gait"), subject().parameters
    body, coefficients = p.build_body(parameters), start_of(p)
    band = p.assemble_equations(coefficients, body).band
    return [
        Figure("  of it: trial set up", lambda: problem("gait")),
        Figure("  of it: start from rigid fits", lambda: start_of(p)),
        Figure("  of it: a pass with the matrix", lambda: p.assemble_equations(coefficients, body)),
        Figure("  of it: a pass without", lambda: p.compute_gradient(coefficients, body)),
        Figure("  of it: a factorisation", lambda: BandFactor(band)),
        Figure(
            "  of it: distances of all markers", lambda: build_motion(p, parameters, coefficients)
        ),
    ]


def section_calibrate_gait() -> list[Figure]:
    """The same and 34 joint parameters."""
    p = problem("gait")
    said = f"{calibrated(p, GAIT_JPS).iterations} outer iterations"
    return [
        Figure("gaitcal, 34 JPs", lambda: calibrated(p, GAIT_JPS), said),
        *inverse_kinematics(subject(), recording("gait")),
        *_plain(GAIT_JPS),
    ]


def _plain(free: tuple[str, ...]) -> list[Figure]:
    whole, part = problem("gait"), problem("gait", rule=SHORT_NODES, frames=SHORT_FRAMES)
    short = plain_least_squares(part, free, analytic=False, evaluations=SHORT_EVALUATIONS)
    taken: list[int] = []

    def analytic() -> None:
        taken.append(int(plain_least_squares(whole, free, analytic=True)().nfev))

    def extrapolated(seconds: float) -> str:
        all_of_it = seconds * (208 / SHORT_FRAMES) * (taken[-1] / SHORT_EVALUATIONS)
        return (
            f"1 run of {SHORT_EVALUATIONS} evaluations; 208 frames and {taken[-1]}, in proportion: "
            f"{all_of_it:.0f} s"
        )

    sparse, differences = "sparse analytic Jacobian", f"finite differences, {SHORT_FRAMES} frames"
    return [
        Figure(
            f"SciPy least_squares, {sparse}",
            analytic,
            lambda _: f"1 run, {taken[-1]} evaluations",
            1,
        ),
        Figure(f"SciPy least_squares, {differences}", short, extrapolated, 1),
    ]


def _isolated(joint: str) -> Callable[[], list[Figure]]:
    def section() -> list[Figure]:
        free = list_isolated_parameters(joint)
        alone, whole = problem(joint, joint_only=True), problem(joint)
        return [
            Figure(
                f"gaitcal, {len(free)} JPs, segments of the joint",
                lambda: calibrated(alone, free),
                "1200 frames",
            ),
            Figure(
                f"gaitcal, {len(free)} JPs, whole body",
                lambda: calibrated(whole, free),
                "1200 frames",
            ),
        ]

    return section


def section_ip() -> list[Figure]:
    """36 inertial parameters from a noisy gait trial."""
    model, motion = subject(), simulate_gait()
    wrench = compute_residual_free_wrench(model.parameters, motion)
    t = track(model, recording("gait"), rule=NODES)
    valid = np.ones(len(t.time), bool)
    loaded = LoadedMotion(state=(t.q, t.velocity, t.acceleration), wrench=wrench, valid=valid)

    def run(fit: Callable[..., object]) -> object:
        equations = assemble_root_equations(
            [loaded], model.parameters, model.subject, TorqueScale.BODY_HEIGHT, 0.176
        )
        return fit(equations, model.parameters.inertial, make_symmetric_set())

    return [
        Figure("gaitcal, physically consistent", lambda: run(fit_consistent)),
        Figure("gaitcal, published cost with re-seeding", lambda: run(fit_published)),
    ]


def section_bandwidth() -> list[Figure]:
    """What a bandwidth costs that the markers choose; the choice is wanted in eight tracks of 20
    nodes a second.
    """
    model, seen, p = subject(), recording("gait"), problem("gait")
    parameters = model.parameters
    hz = DenseMotion(p, parameters).choose_cutoff()
    smoothed = apply_bandwidth(p, parameters, hz)
    choice = "choice of the bandwidth by the markers"
    return [
        Figure(
            f"track, {TWENTY.per_second:g} nodes a second", lambda: track(model, seen, rule=TWENTY)
        ),
        Figure(choice, lambda: DenseMotion(p, parameters).choose_cutoff(), f"{hz:.1f} Hz"),
        Figure(
            "track with it",
            lambda: track_motion(smoothed, parameters),
            f"{smoothed.basis.control_points} nodes",
        ),
    ]


def section_inverse_dynamics() -> list[Figure]:
    """Generalised forces of 208 frames."""
    model, motion = subject(), simulate_gait()
    q, v, a = (motion.basis.evaluate(motion.coefficients, k) for k in range(3))
    wrench = compute_residual_free_wrench(model.parameters, motion)
    bare = build_model(model.parameters)
    data = bare.createData()

    def rnea() -> None:
        for row in zip(q, v, a, strict=True):
            pin.rnea(bare, data, *row)

    return [
        Figure(
            "gaitcal",
            lambda: Dynamics(model.parameters).compute_forces(q, v, a, wrench),
            "208 frames",
        ),
        Figure("lower bound: bare RNEA", rnea),
        *inverse_dynamics(model, q, v, a),
    ]


DRAWS = Plan(levels=(100,), draws=100)
IMPORTS = (
    "import gaitcal.cli.calibrate_command, gaitcal.analysis.calibrate, "
    "gaitcal.pipeline.write_results"
)
"""The second and third beside reading and checking."""


def _python(*arguments: object) -> Callable[[], object]:
    command = [sys.executable, *map(str, arguments)]
    # A user's Python keeps compiled modules; without them every run compiles gaitcal first.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return lambda: subprocess.run(command, check=True, capture_output=True, env=environment)


def _gaitcal(*words: object) -> Callable[[], object]:
    return _python("-m", "gaitcal.cli", *words)


def _study() -> Path:
    folder = temporary_folder()
    _gaitcal("synthesize", "-q", "--out", folder / "study")()
    return folder / "study" / "study.toml"


def section_startup() -> list[Figure]:
    """The command line and the import, each in its own process."""
    return [
        Figure("gaitcal --help", _gaitcal("--help")),
        Figure("import gaitcal", _python("-c", "import gaitcal")),
        Figure("import of what calibrate needs", _python("-c", IMPORTS), "below 0.9 s"),
        Figure("python alone", _python("-c", "pass")),
    ]


def section_checks() -> list[Figure]:
    """All checks of the demo's seven trials, files read before; wanted below a second."""
    study = Study.load(_study())
    return [
        Figure(
            "check_study",
            lambda: check_study(study),
            "7 moving trials and the static one, 7408 frames",
        )
    ]


def section_calibrate_study() -> list[Figure]:
    """`gaitcal calibrate` on the demo's synthetic study: files read, everything fitted, all results
    written.
    """
    study = _study()
    results = (study.with_name(f"result{k}") for k in count())
    said = (
        "7 trials, 7408 frames: check, JP, IP, dynamics, error bars, page, exports; its own process"
    )
    drawn = "one stride of each foot, a file a variable; 1 run"
    return [
        Figure(
            "gaitcal calibrate study.toml",
            lambda: _gaitcal("calibrate", "-q", study, "--out", next(results))(),
            said,
        ),
        Figure("gaitcal check study.toml", _gaitcal("check", "-q", study), "its own process"),
        Figure(
            "gaitcal figures result",
            _gaitcal("figures", "-q", study.with_name("result0")),
            drawn,
            runs=1,
        ),
    ]


def section_calibrate_walk() -> list[Figure]:
    """`gaitcal calibrate` and `check` on the folder of one real walk; nothing where GAITCAL_DATA
    has none.
    """
    walk = Path(os.environ.get("GAITCAL_DATA", "")) / "subject01"
    if not walk.is_dir():
        return []
    person = ("-q", walk, "--mass", "72.6", "--height", "1.8", "--sex", "male")
    said = (
        "one walk over two plates, 151 frames: draft, check, JP, IP, dynamics, error bars, page, "
        "exports"
    )
    out = temporary_folder() / "result"
    return [
        Figure("gaitcal calibrate subject01", _gaitcal("calibrate", *person, "--out", out), said),
        Figure("gaitcal check subject01", _gaitcal("check", *person), "wanted below a second"),
        Figure("  of both: imports for calibrate", _python("-c", IMPORTS), "below 0.9 s"),
        Figure("  of both: imports for check", _python("-c", "import gaitcal.cli.study_folder")),
    ]


def section_montecarlo() -> list[Figure]:
    """Draws of the Monte Carlo study: every set at its highest level, nothing kept on disk."""
    case = make_nominal_case()

    def of(name: str, workers: Workers, more: str = "") -> Figure:
        def note(seconds: float) -> str:
            return f"{DRAWS.total} draws, {DRAWS.total / seconds:.0f} a second{more}; 3 runs"

        return Figure(name, lambda: monte_carlo(case, plan=DRAWS, workers=workers), note, runs=3)

    return [
        of("this process", Workers()),
        of("two worker processes", LocalProcesses(2), ", their start included"),
    ]


SECTIONS: dict[str, Callable[[], list[Figure]]] = {
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


if __name__ == "__main__":
    print(json.dumps(measured(int(sys.argv[1]), float(sys.argv[2]))))
