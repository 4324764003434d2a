"""Check frames and their times: rates, time columns, seams, outlying positions, splines, filters.

A seam is where frames are missing, a frame is duplicated, or two parts are joined, while the times
continue: all markers make one step that their paths do not lead to. From the H frames on either
side of it, a marker has

    Q_one    sum of squares about one quintic through all of them
    Q_two    about a parabola through either half: as many coefficients, and a step between the
             halves

    gain = ln (Q_one + f) / (Q_two + f),
    f = the squares of NOISE_M in the 2 H - 6 degrees of freedom of each axis

A seam has a median gain of the markers above ln 2. Its median step exceeds half of a marker's
movement in a frame plus the effect of a sudden change of velocity, as in landing: half of that
change in a frame. The step d along the velocity v gives the number n of missing frames of length h:
n = d v / (v^2 h), -1 for a duplicated frame.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity, join_names
from gaitcal.io.force_plate import is_filterable
from gaitcal.io.recording import find_runs
from gaitcal.io.text_file import UNEVEN_STEP_SHARE
from gaitcal.preprocess.clean_trial import compute_jump_limit
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.tracking.spline import HALF_POWER, NODES_PER_SECOND, ControlPointRule, compute_cutoff
from gaitcal.tracking.trial_problem import FEWEST_TRACKED_FRAMES

RATES = (20.0, 2000.0)  # Hz, frame rates of motion capture
SLOW_GAIT = 50.0  # Hz below which a heel strike falls between frames
STEADY_HZ = 4.0  # Walking has content up to about this frequency; splines that pass less blunt it
SPEED_M_S = 4.5  # Faster than any walk: the person runs, or the time column is wrong
OTHER_RATE = 2.5
"""Ratio of frame rates from which a time column is doubted: laboratories record at 50 and 100, or
100 and 200 Hz."""
HALF_WINDOW = 5
"""H. At 50 to 200 Hz 25 to 100 ms on either side, in which no path of a walk has two inflections,
except at a foot's impact."""
NOISE_M = 0.0002  # m, noise of cameras
SEAM_GAIN = float(np.log(2.0))
"""One path has twice the squares of two. In 36 clean recordings of nine laboratories, walks, turns
and functional trials, the median gain is at most 0.02; with one frame of a walk missing or
duplicated anywhere, 1.2 to 4."""
STEP_FRAMES = 0.5
"""Part of the movement in a frame: whole frames are missing or duplicated, and half a frame is
between none and one."""
FEWEST_MARKERS = 6
FAR_FRAMES = 20.0  # Beyond this, the velocity does not predict the position of the body


def check_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Check the number of frames, the frame rate and the regularity of times.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        Errors for short trials and impossible rates; warnings for slow and irregular frames.
    """
    time = trial.recording.time
    if not trial.is_static and len(time) < FEWEST_TRACKED_FRAMES:
        found = f"found {len(time)} frames; allowed: at least {FEWEST_TRACKED_FRAMES}"
        cause = "the trial is too short"
        yield trial.error(
            "sampling", found, "export the whole trial", cause=cause, code=Code.SHORT_TRIAL
        )
    if len(time) < 2:
        return
    hz = trial.recording.rate
    if not RATES[0] <= hz <= RATES[1]:
        found = f"frame rate {hz:.4g} Hz; allowed: {RATES[0]:.0f} to {RATES[1]:.0f} Hz"
        cure, cause = "convert the time column to seconds", "the time column is not in seconds"
        if abs(hz - 1) < 1e-6:
            cure = "the time column counts frames: divide it by the frame rate"
        yield trial.error("time", found, cure, cause=cause, code=Code.TIME_UNIT)
    elif trial.is_gait and hz < SLOW_GAIT:
        found, cause = f"frame rate {hz:.4g} Hz", "the frame rate is low for walking"
        cure = "peaks of joint moments at heel strike are reduced; record at 100 Hz"
        yield trial.warning("sampling", found, cure, cause=cause, code=Code.SLOW_FRAMES)
    steps = np.diff(time)
    middle = float(np.median(steps))
    # a single missing frame doubles one step
    odd = np.abs(steps - middle) > UNEVEN_STEP_SHARE * middle
    if odd.any():
        found = (
            f"{int(odd.sum())} time steps differ from {1e3 * middle:.3g} ms by more than "
            f"{100 * UNEVEN_STEP_SHARE:.0f} %, the "
        )
        found += f"first at {time[int(np.argmax(odd))]:.3f} s ({1e3 * steps[odd].min():.3g} to "
        found += f"{1e3 * steps[odd].max():.3g} ms)"
        cure = "frames are missing, or the time column was composed: export the trial again"
        yield trial.warning(
            "time", found, cure, cause="the time steps are irregular", code=Code.UNEVEN_TIME
        )


def check_speed(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the body moves at a walking speed, which a wrong time column changes.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One warning, or nothing.
    """
    time = trial.recording.time
    if not trial.is_gait or len(time) < 2:
        return
    speed = float(np.linalg.norm(trial.progression)) / float(time[-1] - time[0])  # m/s
    if speed > SPEED_M_S:
        found, cause = f"the body moves at {speed:.2f} m/s", "the speed is too high for walking"
        cure = "if the person did not run, correct the time column or the unit of length"
        yield trial.warning("time", found, cure, cause=cause, code=Code.TOO_FAST)


def check_header_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Compare the time column of a TRC file with the frame rates of its header.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        One warning or note, or nothing.
    """
    named = _read_header_rates(Path(trial.source))
    hz = trial.recording.rate
    if not named or not np.isfinite(hz):
        return
    different = {key: value for key, value in named.items() if abs(value - hz) > 0.01 * hz}
    if "CameraRate" in different:
        agreed = "" if len(different) == len(named) else ", as DataRate"
        yield trial.make_finding(
            Severity.INFO if trial.is_isolated or trial.is_static else Severity.WARNING,
            "time",
            f"the time column has {hz:.4g} Hz{agreed}; the header has "
            f"{', '.join(f'{k} {v:g}' for k, v in different.items())}",
            "if no frames were skipped on export, correct the time column (velocities and torques "
            "depend on it, joint axes do not)",
            cause="the frame rates of header and time column differ",
            code=Code.HEADER_RATE,
        )


def _read_header_rates(path: Path) -> dict[str, float]:
    """Read DataRate and CameraRate (Hz) from the header of a TRC file."""
    if path.suffix.lower() != ".trc":
        return {}
    try:
        with path.open(encoding="latin-1") as stream:
            lines = [stream.readline(10_000) for _ in range(6)]
    except OSError:
        return {}
    for keys, values in pairwise(lines):
        if "DataRate" in keys:
            pairs = zip(
                re.split(r"\s+", keys.strip()), re.split(r"\s+", values.strip()), strict=False
            )
            out: dict[str, float] = {}
            for k, v in pairs:
                if k in ("DataRate", "CameraRate") and re.fullmatch(r"[\d.]*\d", v):
                    out[k] = float(v)
            return out
    return {}


def check_bandwidth(trial: TrialEvidence) -> Iterator[Finding]:
    """Check that the splines suit the frames, and the filter the plates.

    Parameters
    ----------
    trial
        A moving trial; static ones are not checked.

    Yields
    ------
    Finding
        Errors, warnings and notes.
    """
    time = trial.recording.time
    if trial.is_static or len(time) < FEWEST_TRACKED_FRAMES:
        return
    settings = trial.settings
    passed, source = _compute_bandwidth(settings, time)
    if settings.nodes is not None and settings.nodes > len(time):
        found = f"nodes = {settings.nodes} for {len(time)} frames"
        cure = "set fewer nodes than frames"
        yield trial.error(
            "sampling", found, cure, cause="there are too many spline nodes", code=Code.MANY_NODES
        )
    elif passed is not None and passed < STEADY_HZ and trial.is_gait:
        found = (
            f"{source} in {time[-1] - time[0]:.2f} s have a bandwidth of {passed:.1f} Hz; walking "
            f"needs {STEADY_HZ:g} Hz"
        )
        cure = "remove nodes, nodes_per_second and bandwidth_hz from [calibration]"
        cause = "the settings smooth the motion too much"
        yield trial.warning("sampling", found, cure, cause=cause, code=Code.SMOOTHED_TOO_MUCH)
    chosen = settings.force_filter_hz if trial.trial.filter_hz is None else trial.trial.filter_hz
    if not isinstance(chosen, float):
        return
    by_default = chosen == CalibrationSettings.model_fields["force_filter_hz"].default
    for plate in trial.recording.plates:
        if is_filterable(plate, chosen):
            continue
        name = f"plate {plate.name}"
        sampled = 1.0 / float(np.median(np.diff(plate.time))) if len(plate.time) > 1 else 0.0
        if by_default:
            found = (
                f"{name}: forces sampled at {sampled:.4g} Hz contain nothing above {chosen:.3g} Hz"
            )
            yield trial.info("sampling", found, "they are not filtered", code=Code.FORCE_FILTER)
        else:
            found = (
                f"{name}: filter_hz = {chosen:.3g} Hz, sampled at {sampled:.4g} Hz; allowed: below "
                f"half of that, {0.5 * sampled:.4g} Hz"
            )
            cause = f"the filter does not suit {name}"
            cure = 'lower filter_hz, or set it to "none"'
            yield trial.error("sampling", found, cure, cause=cause, code=Code.FORCE_FILTER)


def _compute_bandwidth(settings: CalibrationSettings, time: Array) -> tuple[float | None, str]:
    """Compute the bandwidth (Hz, -3 dB) of the motion and its source; None if the data decide."""
    if settings.nodes is not None or settings.nodes_per_second is not None:
        nodes = ControlPointRule(
            settings.nodes_per_second or NODES_PER_SECOND, settings.nodes
        ).count_control_points(time)
        return compute_cutoff(time, nodes), f"{nodes} spline nodes"
    if settings.bandwidth_hz == AUTOMATIC:
        return None, ""
    return HALF_POWER * float(
        settings.bandwidth_hz
    ), f"bandwidth_hz = {settings.bandwidth_hz:g}: splines"


def check_equal_rates(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Report trials whose frame rate differs from that of the others.

    Parameters
    ----------
    trials
        All trials of the study.

    Yields
    ------
    Finding
        One warning or note, or nothing.
    """
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
            found=f"most have {common:.4g} Hz, but "
            f"{', '.join(f'{name} {rate:.4g} Hz' for name, rate in odd.items())}",
            cure="check their time columns"
            if far
            else "no action if they were recorded or exported so",
            code=Code.RATES_DIFFER,
        )


def check_duplicate_recordings(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Report trials whose markers are the same in every frame, as one would count twice.

    Different parts of one long file, chosen by `time`, are different trials.

    Parameters
    ----------
    trials
        All trials of the study.

    Yields
    ------
    Finding
        One error for each duplicate.
    """
    for one, other in combinations(trials, 2):
        a, b = one.recording, other.recording
        if a.labels != b.labels or not np.array_equal(a.markers[:1], b.markers[:1], equal_nan=True):
            continue  # one frame is compared fast, and separates most pairs
        if np.array_equal(a.markers, b.markers, equal_nan=True):
            found = f"the same {len(b.time)} frames as trial '{one.name}' ({one.source})"
            cure = (
                "correct the file of this trial, leave the trial out, or give each its part with "
                "time = [start, end]"
            )
            yield other.error("trials", found, cure, code=Code.SAME_RECORDING)


def check_spikes(trial: TrialEvidence) -> Iterator[Finding]:
    """Report single positions that are far from the frames before and after.

    Parameters
    ----------
    trial
        The trial.

    Yields
    ------
    Finding
        A note on positions that were left out; a warning (static trial: a note) on others.
    """
    x, fitted = trial.recording.markers, set(trial.as_fitted.present)
    gone = {label: spikes for label, spikes in trial.trial.spikes.items() if label in fitted}
    if gone:
        farthest = max(m for _, m in gone.values())
        found = (
            f"single positions up to {1e3 * farthest:.0f} mm off their neighbours are left out: "
            f"{join_names([f'{label} ({n} frames)' for label, (n, _) in gone.items()])}"
        )
        yield trial.info("jumps", found, "no action needed", code=Code.SPIKES)
    if len(x) < 3:
        return
    away = np.linalg.norm(x[1:-1] - 0.5 * (x[2:] + x[:-2]), axis=2)
    limit = compute_jump_limit(trial.recording, trial.marker_set.noise)
    sides = np.nan_to_num(np.pad(away, ((1, 1), (0, 0))))
    # a spike also displaces the interpolation of its neighbours: only the largest one counts
    peak = (sides[1:-1] >= sides[:-2]) & (sides[1:-1] >= sides[2:])
    is_spike = peak & (away > limit)
    present = [label for label in trial.as_fitted.present if is_spike[:, trial.column[label]].any()]
    if not present:
        return
    for one in find_seams(x):  # frames on either side of a seam are reported there
        is_spike[max(one.frame - 2, 0) : one.frame + 2] = False
    labels, largest = [], 0.0
    for label in present:
        column = trial.column[label]
        if count := int(is_spike[:, column].sum()):
            labels.append(f"{label} ({count} frames)")
            largest = max(largest, float(away[is_spike[:, column], column].max()))
    if not labels:
        return
    severity = Severity.WARNING
    cure = 'relabel the trial there, or set robust = "cauchy" under [calibration]'
    if trial.is_static:
        severity = Severity.INFO
        cure = "no effect: only the mean over the still window of a static trial is used"
    found = f"positions up to {1e3 * largest:.0f} mm off their neighbours: {join_names(labels)}"
    yield trial.make_finding(severity, "jumps", found, cure, code=Code.SPIKES)


@dataclass(frozen=True, kw_only=True)
class Seam:
    """A position between two frames across which the paths of most markers are discontinuous."""

    frame: int  # The last one before it
    lost: float  # Frames by which the body is ahead; negative if it is behind

    @property
    def description(self) -> str:
        """Distance ahead or behind."""
        count = f"{abs(self.lost):.1f} frames {'ahead' if self.lost > 0 else 'behind'}"
        return count if abs(self.lost) < FAR_FRAMES else "far from the path before"


def check_seams(trial: TrialEvidence) -> Iterator[Finding]:
    """Report seams: missing frames, duplicated frames or joined parts, over which times continue.

    Parameters
    ----------
    trial
        A moving trial; static ones are not checked.

    Yields
    ------
    Finding
        One warning (functional trial: a note), or nothing.
    """
    found = find_seams(trial.recording.markers)
    if not found or trial.is_static:
        return
    where = join_names(
        [f"{trial.recording.time[one.frame]:.2f} s ({one.description})" for one in found]
    )
    cure = "no effect in a functional trial: joint axes do not depend on the times"
    if trial.is_whole_body:
        cure = (
            "velocities, accelerations and torques are wrong there, and the synchronisation with "
            "plates after it: choose a part with time = [start, end]"
        )
    twice = all(-1.5 < one.lost < -0.5 for one in found)
    cause = "a frame is duplicated" if twice else "frames are missing, or two parts were joined"
    yield trial.make_finding(
        Severity.WARNING if trial.is_whole_body else Severity.INFO,
        "jumps",
        f"most markers jump at once at {where}",
        cure,
        cause=f"the recording has a seam: {cause}",
        code=Code.SEAM,
    )


def find_seams(x: Array) -> list[Seam]:
    """Find seams in the paths of markers.

    `x`: (nf, nm, 3) m; NaN where not visible. Returns: in the order of frames.
    """
    if len(x) < 2 * HALF_WINDOW:
        return []
    one, two, ends = _build_projections()
    floor = 3 * one.shape[1] * NOISE_M**2
    gain = np.log((_sum_squares(x, one) + floor) / (_sum_squares(x, two) + floor))
    seen = np.isfinite(gain).sum(axis=1) >= FEWEST_MARKERS
    # the median over markers: a seam affects most of them, a spike one
    typical = np.full(len(gain), -np.inf)
    typical[seen] = np.nanmedian(gain[seen], axis=1)
    out = []
    for run in find_runs(typical > SEAM_GAIN):
        k = run.start + int(np.argmax(typical[run]))
        if typical[k] < typical[max(k - HALF_WINDOW, 0) : k + HALF_WINDOW + 1].max():
            continue  # a larger one is near
        step, velocity, change = np.einsum("wi,wmc->imc", ends, x[k : k + 2 * HALF_WINDOW])
        size, speed, stopping = (np.linalg.norm(v, axis=1) for v in (step, velocity, change))
        # the step must exceed half a frame's movement and the effect of a sudden stop
        if np.nanmedian(size - STEP_FRAMES * speed - 0.5 * stopping) > 0:
            lost = np.nansum(step * velocity) / np.nansum(velocity**2)
            out.append(Seam(frame=k + HALF_WINDOW - 1, lost=float(lost)))
    return out


@lru_cache(maxsize=1)
def _build_projections() -> tuple[Array, Array, Array]:
    """Build the residual projections of a quintic and of two parabolas, and the end functionals.

    Returns (2 H, 2 H - 6) twice, and (2 H, 3): step between the parabolas, their mean velocity and
    its change there, per frame.
    """
    t = np.arange(2 * HALF_WINDOW) - HALF_WINDOW + 0.5
    half = np.vander(t, 3)
    halves = np.zeros((len(t), 6))
    halves[:HALF_WINDOW, :3], halves[HALF_WINDOW:, 3:] = half[:HALF_WINDOW], half[HALF_WINDOW:]
    left = [np.linalg.qr(basis, mode="complete")[0][:, 6:] for basis in (np.vander(t, 6), halves)]
    # the parabolas' values and slopes at the middle, as functionals of the data
    before, after = np.split(np.linalg.pinv(halves), 2)
    ends = [after[2] - before[2], 0.5 * (after[1] + before[1]), after[1] - before[1]]
    return left[0], left[1], np.stack(ends, axis=1)


def _sum_squares(x: Array, basis: Array) -> Array:
    """Sum squares of x (nf, nm, 3) in the directions of a basis (2 H, n): (nf - 2 H + 1, nm)."""
    count = len(x) - len(basis) + 1
    out = np.zeros((count, x.shape[1]))
    for column in basis.T:
        part = sum(c * x[i : i + count] for i, c in enumerate(column))
        out += np.sum(part**2, axis=2)
    return out
