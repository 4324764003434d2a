"""How time and memory grow: with frames (15 spans a second), joint parameters and trials."""

from __future__ import annotations

from gaitcal.calibration.joint_calibration import JointSearch
from gaitcal.model.parameters import JP_NAMES, gait_parameters, isolated_parameters
from gaitcal.motion.motion import track
from gaitcal.motion.spline import NodeRule
from scripts.tools.benchmark import memory
from scripts.tools.benchmark.figure import Amount, Timing
from scripts.tools.benchmark.trials import GAIT_JPS, calibrated, first_frames, problem, recording, start_of, subject

FRAMES = (200, 1000, 5000, 25_000, 100_000)
MEMORY_FRAMES = (5000, 25_000, 100_000)
PARAMETERS = (6, 17, 34, 54, 98)
TRIALS = (1, 2, 4, 8, 16, 32)
RULE = NodeRule(per_second=15.0)


def section_scaling() -> list[Timing | Amount]:
    """All of them."""
    return [*_frames(), *_memory(), *_parameters(), *_trials()]


def _frames() -> list[Timing]:
    out = []
    for frames in FRAMES:
        cut = first_frames(recording("gait", frames), frames)
        runs = 1 if frames > 10_000 else 3
        out.append(
            Timing(
                f"track {frames} frames",
                lambda r=cut: track(subject(), r, rule=RULE),
                f"{runs} run{'s' * (runs > 1)}",
                runs,
                "time, frames",
                frames,
            )
        )
    return out


def _memory() -> list[Amount]:
    """Peak of a child process that tracks, beyond what it took before: libraries and the recording."""
    return [
        Amount(
            f"memory to track {frames} frames at 100 Hz",
            lambda n=frames: _peak(n),
            "GiB",
            f"beyond the libraries; 20 spans a second; limit {memory.LIMIT_GIB:g} with them",
            "memory, frames",
            frames,
        )
        for frames in MEMORY_FRAMES
    ]


def _peak(frames: int) -> float:
    used = memory.usage(frames, 100.0)
    return used.peak_gib - used.libraries_gib


def _parameters() -> list[Timing]:
    p, out = problem("gait"), []
    for number in PARAMETERS:
        free = JP_NAMES if number == len(JP_NAMES) else _first(number)
        iterations = calibrated(p, free).iterations
        said = f"{iterations} outer iterations; 3 runs"
        out.append(Timing(f"calibrate gait, {number} JPs", lambda f=free: calibrated(p, f), said, runs=3))
    return out


def _first(number: int) -> tuple[str, ...]:
    legs = {6: isolated_parameters("hip_r"), 17: gait_parameters("r"), 34: GAIT_JPS}
    if number in legs:
        return legs[number]
    return tuple(name for j in ("hip", "knee", "ankle") for s in "rl" for name in isolated_parameters(f"{j}_{s}"))


def _trials() -> list[Timing]:
    parameters, free, out = subject().parameters, gait_parameters("r"), []
    for number in TRIALS:
        trials = [problem("gait", seed=k + 1) for k in range(number)]
        starts = [start_of(p) for p in trials]

        def task(trials: list = trials, starts: list = starts) -> object:
            return JointSearch(trials, parameters, free, starts).run()

        iterations = JointSearch(trials, parameters, free, starts).run().iterations
        out.append(
            Timing(
                f"calibrate {number} gait trial{'s' * (number > 1)} together, 17 JPs",
                task,
                f"{iterations} outer iterations; 3 runs",
                3,
                "time an outer iteration, trials",
                number,
                lambda n=iterations: n,
            )
        )
    return out
