"""One figure of a benchmark, and the trials that are timed: the published subject's gait and isolated trials, with the
published noise.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gaitcal.calibration.joint_calibration import JointFit, JointSearch
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SEGMENTS, joint_segments
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import gait_parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import MotionProblem, trial_problem
from gaitcal.synthetic.motion import gait_motion, isolated_motion, marker_noise, synthetic_markers

NODES = NodeRule(fixed=20)
GAIT_JPS = (*gait_parameters("r"), *gait_parameters("l"))


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
    """What to divide the seconds by where a series is compared: iterations, where their number differs."""
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
    """Noisy markers of the published subject, the first frames; a trial longer than recorded goes back and forth."""
    motion = gait_motion() if trial == "gait" else isolated_motion(trial)
    model = subject()
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    time = motion.basis.time
    if frames is not None and frames > len(time):
        markers = np.resize(np.concatenate([markers, markers[-2:0:-1]]), (frames, *markers.shape[1:]))
        time = np.arange(frames) / 200.0
    markers = markers + marker_noise(time, markers.shape[1], np.random.default_rng(seed))
    return Recording(source=trial, time=time[:frames], labels=model.markers.labels, markers=markers[:frames])


def problem(
    trial: str, *, joint_only: bool = False, rule: NodeRule = NODES, frames: int | None = None, seed: int = 1
) -> MotionProblem:
    """The trial (or its first frames) as a least-squares problem, whole body or the segments of its joint."""
    segments = joint_segments(trial) if joint_only else SEGMENTS
    return trial_problem(trial, subject(), recording(trial, frames, seed), rule, root=segments[0], segments=segments)


def start_of(p: MotionProblem) -> np.ndarray:
    """(nn, nq) coefficients from rigid fits."""
    return starting_nodes(p.chain, p.with_free(()).constants(subject().parameters), p.data, p.basis)


def calibrated(p: MotionProblem, free: tuple[str, ...]) -> JointFit:
    """Joint parameters and motion from rigid fits."""
    return JointSearch([p], subject().parameters, free, [start_of(p)]).run()
