"""How time and memory grow: with frames (15 spans a second), joint parameters and trials.

Memory: the published subject walks on and on, with 1 mm of noise; a child process tracks that with the default splines
(20 spans a second) and tells its peak. Limit: 1.5 GiB for 100 000 frames, libraries included.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal.calibration.joint_calibration import JointFit, JointSearch
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_NAMES, gait_parameters, isolated_parameters
from gaitcal.motion.motion import track
from gaitcal.motion.spline import NodeRule
from gaitcal.synthetic.motion import gait_motion, synthetic_markers
from scripts.tools.benchmark.trials import GAIT_JPS, Figure, calibrated, problem, recording, start_of, subject

FRAMES = (200, 1000, 5000, 25_000, 100_000)
MEMORY_FRAMES = (5000, 25_000, 100_000)
TRIALS = (1, 2, 4, 8, 16, 32)
RULE = NodeRule(per_second=15.0)
GIB, LIMIT_GIB = 2.0**30, 1.5


def section_scaling() -> list[Figure]:
    return [*_frames(), *_memory(), *_parameters(), *_trials()]


def _frames() -> list[Figure]:
    def of(frames: int) -> Figure:
        cut, runs = recording("gait", frames), 1 if frames > 10_000 else 3
        task = partial(track, subject(), cut, rule=RULE)
        return Figure(f"track {frames} frames", task, f"{runs} run{'s' * (runs > 1)}", runs, "time, frames", frames)

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
    model, motion = published_model(), gait_motion()
    q = motion.q[:: max(1, round(200.0 / rate))]
    cycles = -(-frames // len(q))
    markers = synthetic_markers(model.parameters, model.markers, q)
    way = np.arange(cycles) * float(q[-1, 0] - q[0, 0])
    out = np.tile(markers, (cycles, 1, 1))[:frames]
    out[..., 0] += np.repeat(way, len(q))[:frames, None]
    out += np.random.default_rng(0).normal(0, 0.001, out.shape)
    return Recording(source="made up", time=np.arange(frames) / rate, labels=model.markers.labels, markers=out)


def peak_gib() -> float:
    """Largest memory of this process so far.

    On Linux from /proc: what `getrusage` tells is at least what the process that started this one had then.
    """
    status = Path("/proc/self/status")
    if status.exists():
        peak = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM"))
        return int(peak.split()[1]) * 1024 / GIB
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / GIB


def measured(frames: int, rate: float) -> dict[str, float]:
    """Make and track in this process; GiB before there was a recording, and at most, and the RMS marker distance."""
    libraries = peak_gib()
    motion = track(published_model(), long_recording(frames, rate), rule=NodeRule())
    return {"libraries_gib": libraries, "peak_gib": peak_gib(), "rms_mm": 1e3 * (motion.errors.rms() or float("nan"))}


def usage(frames: int, rate: float) -> dict[str, float]:
    """The same in a process of its own, whose peak is that of this run alone."""
    command = [sys.executable, "-m", "scripts.tools.benchmark.scaling", str(frames), str(rate)]
    found: dict[str, float] = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
    return found


def _parameters() -> list[Figure]:
    p = problem("gait")
    legs = tuple(name for j in ("hip", "knee", "ankle") for s in "rl" for name in isolated_parameters(f"{j}_{s}"))
    sets = (isolated_parameters("hip_r"), gait_parameters("r"), GAIT_JPS, legs, JP_NAMES)

    def of(free: tuple[str, ...]) -> Figure:
        said = f"{calibrated(p, free).iterations} outer iterations; 3 runs"
        return Figure(f"calibrate gait, {len(free)} JPs", partial(calibrated, p, free), said, runs=3)

    return [of(free) for free in sets]


def _trials() -> list[Figure]:
    parameters, free = subject().parameters, gait_parameters("r")

    def of(number: int) -> Figure:
        trials = [problem("gait", seed=k + 1) for k in range(number)]
        starts = [start_of(p) for p in trials]
        task: Callable[[], JointFit] = lambda: JointSearch(trials, parameters, free, starts).run()  # noqa: E731
        iterations = task().iterations
        name = f"calibrate {number} gait trial{'s' * (number > 1)} together, 17 JPs"
        said, series = f"{iterations} outer iterations; 3 runs", "time an outer iteration, trials"
        return Figure(name, task, said, 3, series, number, lambda: iterations)

    return [of(number) for number in TRIALS]


if __name__ == "__main__":
    print(json.dumps(measured(int(sys.argv[1]), float(sys.argv[2]))))
