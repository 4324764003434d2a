"""Sampling: frame rates, time columns, and whether splines and filters suit them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.io.filters import filterable
from gaitcal.io.text_file import UNEVEN
from gaitcal.motion.spline import HALF_POWER, NODES_PER_SECOND, NodeRule, cutoff
from gaitcal.motion.trial_problem import FEWEST_FRAMES
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings

RATES = (20.0, 2000.0)
"""Hz, frame rates of motion capture."""
SLOW_GAIT = 50.0
"""Hz below which a heel strike falls between frames."""
STEADY_HZ = 4.0
"""Walking has content up to about this frequency; splines that pass less blunt it."""
SPEED_M_S = 4.5
"""Nobody walks faster; a faster one runs, or the clock is wrong."""
OTHER_RATE = 2.5
"""Laboratories record at 50 and 100, or 100 and 200 Hz; a time column that is wrong may be wrong by more."""


def rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the frame rate is one of motion capture."""
    time = trial.recording.time
    if not trial.is_static and len(time) < FEWEST_FRAMES:
        found = f"found {len(time)} frames; allowed: at least {FEWEST_FRAMES}"
        yield trial.error(
            "sampling", found, "export the whole trial", cause="the trial is too short", code=Code.SHORT_TRIAL
        )
    if len(time) < 2:
        return
    hz = trial.recording.rate
    if not RATES[0] <= hz <= RATES[1]:
        found = f"frames come at {hz:.4g} Hz; cameras have {RATES[0]:.0f} to {RATES[1]:.0f} Hz"
        cure = "is the time column in seconds?"
        if abs(hz - 1) < 1e-6:
            cure = "the time column counts frames: divide it by the frame rate"
        yield trial.error("time", found, cure, cause="the time column is not in seconds", code=Code.TIME_UNIT)
    elif trial.is_gait and hz < SLOW_GAIT:
        cure = "joint moments at heel strike will be blunted; record at 100 Hz"
        yield trial.warning(
            "sampling",
            f"frames come at {hz:.4g} Hz",
            cure,
            cause="frames come slowly for walking",
            code=Code.SLOW_FRAMES,
        )
    steps = np.diff(time)
    middle = float(np.median(steps))
    odd = np.abs(steps - middle) > UNEVEN * middle
    if odd.any():
        yield trial.warning(
            "time",
            f"{int(odd.sum())} time steps depart from {1e3 * middle:.3g} ms by more than {100 * UNEVEN:.0f} %, the "
            f"first at {time[int(np.argmax(odd))]:.3f} s ({1e3 * steps[odd].min():.3g} to "
            f"{1e3 * steps[odd].max():.3g} ms)",
            "frames are missing, or the time column was put together: export the trial again",
            cause="time steps are not even",
            code=Code.UNEVEN_TIME,
        )


def speed(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body goes at a speed of walking, which a wrong clock spoils."""
    time = trial.recording.time
    if not trial.is_gait or len(time) < 2:
        return
    found = float(np.linalg.norm(trial.way)) / float(time[-1] - time[0])
    if found > SPEED_M_S:
        cure = "if the person did not run, the time column or the unit of length is wrong"
        yield trial.warning(
            "time", f"the body moves at {found:.2f} m/s", cure, cause="nobody walks so fast", code=Code.TOO_FAST
        )


def header_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the time column of a TRC goes at the camera's rate that its header names."""
    named = _header_rates(Path(trial.source))
    hz = trial.recording.rate
    if not named or not np.isfinite(hz):
        return
    apart = {key: value for key, value in named.items() if abs(value - hz) > 0.01 * hz}
    if "CameraRate" in apart:
        agreed = "" if len(apart) == len(named) else ", as DataRate says"
        yield trial.finding(
            Severity.INFO if trial.is_isolated or trial.is_static else Severity.WARNING,
            "time",
            f"time goes at {hz:.4g} Hz{agreed}; the header names {', '.join(f'{k} {v:g}' for k, v in apart.items())}",
            "if frames were not left out on export, the time column was invented: correct it (velocities and torques "
            "follow from it; joint axes do not)",
            cause="the header and the time column name different frame rates",
            code=Code.HEADER_RATE,
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


def splines(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the splines of the motion suit the frames, and the filter the plates."""
    time = trial.recording.time
    if trial.is_static or len(time) < FEWEST_FRAMES:
        return
    settings = trial.settings
    passed, of_what = _passed(settings, time)
    if settings.nodes is not None and settings.nodes > len(time):
        found = f"nodes = {settings.nodes} for {len(time)} frames"
        cure = "fewer nodes than frames are needed"
        yield trial.error("sampling", found, cure, cause="there are too many spline nodes", code=Code.MANY_NODES)
    elif passed is not None and passed < STEADY_HZ and trial.is_gait:
        yield trial.warning(
            "sampling",
            f"{of_what} in {time[-1] - time[0]:.2f} s pass {passed:.1f} Hz; walking needs {STEADY_HZ:g} Hz",
            "leave nodes, nodes_per_second and bandwidth_hz out of [calibration]",
            cause="the settings smooth the motion too much",
            code=Code.SMOOTHED_TOO_MUCH,
        )
    chosen = settings.force_filter_hz if trial.trial.filter_hz is None else trial.trial.filter_hz
    if not isinstance(chosen, float):
        return
    by_default = chosen == CalibrationSettings.model_fields["force_filter_hz"].default
    for plate in trial.recording.plates:
        if filterable(plate, chosen):
            continue
        sampled = 1.0 / float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 0.0
        if by_default:
            found = f"plate {plate.name}: forces sampled at {sampled:.4g} Hz hold nothing above {chosen:.3g} Hz"
            yield trial.info("sampling", found, "they are not filtered", code=Code.FORCE_FILTER)
        else:
            yield trial.error(
                "sampling",
                f"plate {plate.name}: forces are filtered at {chosen:.3g} Hz and sampled at {sampled:.4g} Hz; allowed: "
                f"below half of that, {0.5 * sampled:.4g} Hz",
                'lower filter_hz, or set it to "none"',
                cause=f"the filter does not suit plate {plate.name}",
                code=Code.FORCE_FILTER,
            )


def _passed(settings: CalibrationSettings, time: Array) -> tuple[float | None, str]:
    """Hz that the motion passes (-3 dB), and of what; None where the data are to choose."""
    if settings.nodes is not None or settings.nodes_per_second is not None:
        nodes = NodeRule(settings.nodes_per_second or NODES_PER_SECOND, settings.nodes).nodes(time)
        return cutoff(time, nodes), f"{nodes} spline nodes"
    if settings.bandwidth_hz == AUTOMATIC:
        return None, ""
    return HALF_POWER * float(settings.bandwidth_hz), f"bandwidth_hz = {settings.bandwidth_hz:g}: splines"


def rates_differ(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Trials whose frame rate is not that of the others."""
    rates = {t.name: t.recording.rate for t in trials if len(t.recording.time) > 1}
    common = float(np.median(list(rates.values()))) if rates else 0.0
    odd = {name: rate for name, rate in rates.items() if abs(rate - common) > 0.01 * common}
    if odd and len(odd) < 0.5 * len(rates):
        far = any(not 1.0 / OTHER_RATE <= rate / common <= OTHER_RATE for rate in odd.values())
        yield Finding(
            severity=Severity.WARNING if far else Severity.INFO,
            topic="sampling",
            where=STUDY,
            cause="trials of one study have different frame rates",
            found=f"most have {common:.4g} Hz, but {', '.join(f'{name} {rate:.4g} Hz' for name, rate in odd.items())}",
            cure="look whether their time columns are right" if far else "as it should be, if recorded or exported so",
            code=Code.RATES_DIFFER,
        )


def same_recording(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Trials whose markers are the same in every frame, whatever their files are called: one would count twice.

    Parts of one long file, chosen by `time`, are trials of their own.
    """
    for one, other in combinations(trials, 2):
        a, b = one.recording, other.recording
        if a.labels != b.labels or not np.array_equal(a.markers[:1], b.markers[:1], equal_nan=True):
            continue  # one frame is soon compared, and tells most apart
        if np.array_equal(a.markers, b.markers, equal_nan=True):
            yield other.error(
                "trials",
                f"holds the same {len(b.time)} frames as trial '{one.name}' ({one.source})",
                "name the file of this trial, leave the trial out, or give each its part with time = [start, end]",
                code=Code.SAME_RECORDING,
            )
