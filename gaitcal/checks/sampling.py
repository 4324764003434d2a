"""Sampling: frame rates, filter cut-offs against Nyquist, time columns, clocks of markers and forces.

One recording given as two trials: it would count twice, and say nothing of the second trial.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from gaitcal.checks.evidence import Evidence, TrialEvidence
from gaitcal.checks.finding import Finding, error, info, warning
from gaitcal.motion.trial_problem import FEWEST_FRAMES, NodeRule, cutoff
from gaitcal.recording.axes import net_progression
from gaitcal.recording.recording import Recording
from gaitcal.study.study import Role

RATES = (20.0, 2000.0)
"""Hz, frame rates of motion capture."""
SLOW_GAIT = 50.0
"""Hz below which a heel strike falls between frames."""
STEADY_HZ = 4.0
"""Walking has content up to about this frequency; splines that pass less blunt it."""
SPEED_M_S = 4.5
"""Nobody walks faster; a faster one runs, or the clock is wrong."""
UNEVEN = 0.2


def rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the frame rate is one of motion capture."""
    time = trial.recording.time
    if not trial.is_static and len(time) < FEWEST_FRAMES:
        found = f"found {len(time)} frames; allowed: at least {FEWEST_FRAMES}"
        yield error("sampling", trial.name, found, "export the whole trial", trial.source)
    if len(time) < 2:
        return
    hz = trial.recording.rate
    if not RATES[0] <= hz <= RATES[1]:
        found = f"frames come at {hz:.4g} Hz; cameras have {RATES[0]:.0f} to {RATES[1]:.0f} Hz"
        cure = "is the time column in seconds?"
        if abs(hz - 1) < 1e-6:
            cure = "the time column counts frames: divide it by the frame rate"
        yield error("time", trial.name, found, cure, trial.source)
    elif trial.trial.role is Role.GAIT and hz < SLOW_GAIT:
        cure = "joint moments at heel strike will be blunted; record at 100 Hz"
        yield warning("sampling", trial.name, f"frames come at {hz:.4g} Hz", cure, trial.source)
    steps = np.diff(time)
    middle = float(np.median(steps))
    odd = np.abs(steps - middle) > UNEVEN * middle
    if odd.any():
        yield warning(
            "time",
            trial.name,
            f"{int(odd.sum())} time steps depart from {1e3 * middle:.3g} ms by more than {100 * UNEVEN:.0f} %, the "
            f"first at {time[int(np.argmax(odd))]:.3f} s ({1e3 * steps[odd].min():.3g} to "
            f"{1e3 * steps[odd].max():.3g} ms)",
            "frames are missing, or the time column was put together: export the trial again",
            trial.source,
        )


def speed(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body goes at a speed of walking, which a wrong clock spoils."""
    time = trial.recording.time
    if trial.trial.role is not Role.GAIT or len(time) < 2:
        return
    found = float(np.linalg.norm(net_progression(trial.recording))) / float(time[-1] - time[0])
    if found > SPEED_M_S:
        cure = "if the person did not run, the time column or the unit of length is wrong"
        yield warning("time", trial.name, f"the body moves at {found:.2f} m/s", cure, trial.source)


def header_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the time column of a TRC goes at the camera's rate that its header names."""
    named = _header_rates(Path(trial.source))
    hz = trial.recording.rate
    if not named or not np.isfinite(hz):
        return
    apart = {key: value for key, value in named.items() if abs(value - hz) > 0.01 * hz}
    if "CameraRate" in apart:
        agreed = "" if len(apart) == len(named) else ", as DataRate says"
        yield warning(
            "time",
            trial.name,
            f"time goes at {hz:.4g} Hz{agreed}; the header names {', '.join(f'{k} {v:g}' for k, v in apart.items())}",
            "if frames were not left out on export, the time column was invented: correct it (velocities and torques "
            "follow from it; joint axes do not)",
            trial.source,
        )


def _header_rates(path: Path) -> dict[str, float]:
    if path.suffix.lower() != ".trc":
        return {}
    try:
        with path.open(encoding="latin-1") as stream:
            lines = [stream.readline(10_000) for _ in range(6)]
    except OSError:
        return {}
    for keys, values in pairwise(lines):
        if "DataRate" in keys:
            pairs = zip(re.split(r"\s+", keys.strip()), re.split(r"\s+", values.strip()), strict=False)
            return {k: float(v) for k, v in pairs if k in ("DataRate", "CameraRate") and re.fullmatch(r"[\d.]*\d", v)}
    return {}


def rates_differ(evidence: Evidence) -> Iterator[Finding]:
    """Trials whose frame rate is not that of the others."""
    hz = {t.name: t.recording.rate for t in evidence.trials if len(t.recording.time) > 1}
    common = float(np.median(list(hz.values()))) if hz else 0.0
    odd = [f"{name} {rate_:.4g} Hz" for name, rate_ in hz.items() if abs(rate_ - common) > 0.01 * common]
    if odd and len(odd) < 0.5 * len(hz):
        found = f"most trials have {common:.4g} Hz, but {', '.join(odd)}"
        yield info("sampling", "study", found, "as it should be, if recorded or exported so")


def splines(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the splines of the motion suit the frames, and the filter the plates."""
    time = trial.recording.time
    if trial.is_static or len(time) < FEWEST_FRAMES:
        return
    settings = trial.settings
    nodes = NodeRule(settings.nodes_per_second, settings.nodes).nodes(time)
    passed = cutoff(time, nodes)
    if nodes > len(time):
        found = f"nodes = {nodes} for {len(time)} frames"
        yield error("sampling", trial.name, found, "fewer nodes than frames are needed", trial.source)
    elif passed < STEADY_HZ and trial.trial.role is Role.GAIT:
        yield warning(
            "sampling",
            trial.name,
            f"{nodes} spline nodes in {time[-1] - time[0]:.2f} s pass {passed:.1f} Hz; walking needs {STEADY_HZ:g} Hz",
            "leave nodes out of [calibration], or shorten the trial with time = [start, end]",
            trial.source,
        )
    chosen = settings.force_filter_hz if trial.trial.filter_hz is None else trial.trial.filter_hz
    hz = passed if chosen == "matched" else chosen
    if not isinstance(hz, float):
        return
    for plate in trial.recording.plates:
        sampled = 1.0 / float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 0.0
        if hz >= 0.5 * sampled:
            yield error(
                "sampling",
                trial.name,
                f"plate {plate.name}: forces are filtered at {hz:.3g} Hz and sampled at {sampled:.4g} Hz; allowed: "
                f"below half of that, {0.5 * sampled:.4g} Hz",
                'lower filter_hz, or set it to "none"',
                trial.source,
            )
    if trial.recording.plates and hz > 2.0 * passed:
        yield info(
            "sampling",
            trial.name,
            f"forces are filtered at {hz:.3g} Hz, the motion at {passed:.3g} Hz",
            'cut-offs that differ make false moments at impacts; "matched" makes them equal',
        )


def same_recording(evidence: Evidence) -> Iterator[Finding]:
    """Trials whose markers are the same in every frame, whatever their files are called.

    Parts of one long file, chosen by `time`, are trials of their own.
    """
    for one, other in combinations(evidence.trials, 2):
        if _same(one.recording, other.recording):
            yield error(
                "trials",
                other.name,
                f"holds the same {len(other.recording.time)} frames as trial '{one.name}' ({one.source})",
                "name the file of this trial, leave the trial out, or give each its part with time = [start, end]",
                other.source,
            )


def _same(one: Recording, other: Recording) -> bool:
    return (
        one.labels == other.labels
        and one.markers.shape == other.markers.shape
        and np.array_equal(one.markers, other.markers, equal_nan=True)
    )
