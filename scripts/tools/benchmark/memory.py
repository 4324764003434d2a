"""How much memory tracking a long recording takes: the published subject walks on and on, with 1 mm of noise.

A child process tracks with the default splines and tells its peak memory. Limit: 1.5 GiB for 100 000 frames.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import track
from gaitcal.motion.spline import NodeRule
from gaitcal.synthetic.motion import gait_motion, synthetic_markers

GIB = 2.0**30
LIMIT_GIB = 1.5


@dataclass(frozen=True)
class Usage:
    """What a run took."""

    frames: int
    rms_mm: float
    seconds: float
    peak_gib: float
    before_gib: float
    """Peak before tracking: libraries and the recording."""
    libraries_gib: float
    """Peak before there was a recording."""


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


def measured(frames: int, rate: float) -> Usage:
    """Make, track and measure in this process."""
    libraries = peak_gib()
    recording = long_recording(frames, rate)
    before = peak_gib()
    began = time.perf_counter()
    motion = track(published_model(), recording, rule=NodeRule())
    rms = motion.errors.rms() or float("nan")
    return Usage(frames, 1e3 * rms, time.perf_counter() - began, peak_gib(), before, libraries)


def usage(frames: int, rate: float) -> Usage:
    """The same in a process of its own, whose peak is that of this run alone."""
    command = [sys.executable, "-m", "scripts.tools.benchmark.memory", str(frames), str(rate)]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
    return Usage(**json.loads(done.stdout))


if __name__ == "__main__":
    print(json.dumps(asdict(measured(int(sys.argv[1]), float(sys.argv[2])))))
