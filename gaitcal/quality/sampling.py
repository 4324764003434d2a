"""Frames and their times: rates, time columns, seams, single positions out of line; splines and
filters that suit them.

A seam is where frames were cut out, a frame stands twice, or two parts were joined, and the times
run on over it: all markers make one step that their paths do not lead to. With the H frames on
either side of it, a marker leaves

    Q_one    sum of squares about one quintic through all of them
    Q_two    about a parabola through either half: as many coefficients, and a step between the halves

    gain = ln (Q_one + f) / (Q_two + f),    f = the squares of NOISE_M in the 2 H - 6 degrees of freedom of each axis

A seam is where the median gain of the markers is above ln 2 and the median step above half of what
a marker moves in a frame, and above what a velocity that breaks there makes of a step, as in
landing: half of its change in a frame more. The step d along the velocity v tells how many frames
of length h are missing: n = d v / (v^2 h), -1 for one that stands twice.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import STUDY, Code, Finding, Severity, listed
from gaitcal.io.force_plate import is_filterable
from gaitcal.io.recording import find_runs
from gaitcal.io.text_file import UNEVEN_STEP_SHARE
from gaitcal.preprocess.clean_trial import compute_jump_limit
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.tracking.spline import HALF_POWER, NODES_PER_SECOND, NodeRule, compute_cutoff
from gaitcal.tracking.trial_problem import FEWEST_FRAMES

RATES = (20.0, 2000.0)  # Hz, frame rates of motion capture
SLOW_GAIT = 50.0  # Hz below which a heel strike falls between frames
STEADY_HZ = 4.0  # Walking has content up to about this frequency; splines that pass less blunt it
SPEED_M_S = 4.5  # Nobody walks faster; a faster one runs, or the clock is wrong
OTHER_RATE = 2.5
"""Laboratories record at 50 and 100, or 100 and 200 Hz; a time column that is wrong may be wrong by
more.
"""
HALF_WINDOW = 5
"""H. At 50 to 200 Hz 25 to 100 ms on either side, in which nothing of a walk but a foot's impact
bends twice.
"""
NOISE_M = 0.0002  # m, of cameras: what bends less cannot be told from it
SEAM_GAIN = float(np.log(2.0))
"""One path leaves twice the squares of two. In 36 clean recordings of nine laboratories, walks,
turns and isolated trials, the median gain is at most 0.02; with one frame cut out of a walk or
doubled anywhere, 1.2 to 4."""
STEP_FRAMES = 0.5
"""Of the movement in a frame: whole frames are lost or doubled, and half of one lies between none
and one.
"""
FEWEST_MARKERS = 6
FAR_FRAMES = 20.0  # Above that the velocity says nothing of where the body would be


def check_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the frame rate is one of motion capture."""
    time = trial.recording.time
    if not trial.is_static and len(time) < FEWEST_FRAMES:
        found, cause = (
            f"found {len(time)} frames; allowed: at least {FEWEST_FRAMES}",
            "the trial is too short",
        )
        yield trial.error(
            "sampling", found, "export the whole trial", cause=cause, code=Code.SHORT_TRIAL
        )
    if len(time) < 2:
        return
    hz = trial.recording.rate
    if not RATES[0] <= hz <= RATES[1]:
        found = f"frames come at {hz:.4g} Hz; cameras have {RATES[0]:.0f} to {RATES[1]:.0f} Hz"
        cure, cause = "is the time column in seconds?", "the time column is not in seconds"
        if abs(hz - 1) < 1e-6:
            cure = "the time column counts frames: divide it by the frame rate"
        yield trial.error("time", found, cure, cause=cause, code=Code.TIME_UNIT)
    elif trial.is_gait and hz < SLOW_GAIT:
        cure, cause = (
            "joint moments at heel strike will be blunted; record at 100 Hz",
            "frames come slowly for walking",
        )
        yield trial.warning(
            "sampling", f"frames come at {hz:.4g} Hz", cure, cause=cause, code=Code.SLOW_FRAMES
        )
    steps = np.diff(time)
    middle = float(np.median(steps))
    odd = np.abs(steps - middle) > UNEVEN_STEP_SHARE * middle
    if odd.any():
        found = (
            f"{int(odd.sum())} time steps depart from {1e3 * middle:.3g} ms by more than "
            f"{100 * UNEVEN_STEP_SHARE:.0f} %, the "
        )
        found += f"first at {time[int(np.argmax(odd))]:.3f} s ({1e3 * steps[odd].min():.3g} to "
        found += f"{1e3 * steps[odd].max():.3g} ms)"
        cure = "frames are missing, or the time column was put together: export the trial again"
        yield trial.warning(
            "time", found, cure, cause="time steps are not even", code=Code.UNEVEN_TIME
        )


def check_speed(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body goes at a speed of walking, which a wrong clock spoils."""
    time = trial.recording.time
    if not trial.is_gait or len(time) < 2:
        return
    speed = float(np.linalg.norm(trial.progression)) / float(time[-1] - time[0])
    if speed > SPEED_M_S:
        found, cause = f"the body moves at {speed:.2f} m/s", "nobody walks so fast"
        cure = "if the person did not run, the time column or the unit of length is wrong"
        yield trial.warning("time", found, cure, cause=cause, code=Code.TOO_FAST)


def check_header_rate(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the time column of a TRC goes at the camera's rate that its header names."""
    named = _read_header_rates(Path(trial.source))
    hz = trial.recording.rate
    if not named or not np.isfinite(hz):
        return
    apart = {key: value for key, value in named.items() if abs(value - hz) > 0.01 * hz}
    if "CameraRate" in apart:
        agreed = "" if len(apart) == len(named) else ", as DataRate says"
        yield trial.make_finding(
            Severity.INFO if trial.is_isolated or trial.is_static else Severity.WARNING,
            "time",
            f"time goes at {hz:.4g} Hz{agreed}; the header names "
            f"{', '.join(f'{k} {v:g}' for k, v in apart.items())}",
            "if frames were not left out on export, the time column was invented: correct it "
            "(velocities and torques "
            "follow from it; joint axes do not)",
            cause="the header and the time column name different frame rates",
            code=Code.HEADER_RATE,
        )


def _read_header_rates(path: Path) -> dict[str, float]:
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
            return {
                k: float(v)
                for k, v in pairs
                if k in ("DataRate", "CameraRate") and re.fullmatch(r"[\d.]*\d", v)
            }
    return {}


def check_bandwidth(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the splines of the motion suit the frames, and the filter the plates."""
    time = trial.recording.time
    if trial.is_static or len(time) < FEWEST_FRAMES:
        return
    settings = trial.settings
    passed, of_what = _compute_bandwidth(settings, time)
    if settings.nodes is not None and settings.nodes > len(time):
        found, cure = (
            f"nodes = {settings.nodes} for {len(time)} frames",
            "fewer nodes than frames are needed",
        )
        yield trial.error(
            "sampling", found, cure, cause="there are too many spline nodes", code=Code.MANY_NODES
        )
    elif passed is not None and passed < STEADY_HZ and trial.is_gait:
        found = (
            f"{of_what} in {time[-1] - time[0]:.2f} s pass {passed:.1f} Hz; walking needs "
            f"{STEADY_HZ:g} Hz"
        )
        cure = "leave nodes, nodes_per_second and bandwidth_hz out of [calibration]"
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
            found = f"{name}: forces sampled at {sampled:.4g} Hz hold nothing above {chosen:.3g} Hz"
            yield trial.info("sampling", found, "they are not filtered", code=Code.FORCE_FILTER)
        else:
            found = (
                f"{name}: forces are filtered at {chosen:.3g} Hz and sampled at {sampled:.4g} Hz; "
                "allowed: "
            )
            found += f"below half of that, {0.5 * sampled:.4g} Hz"
            cause, cure = f"the filter does not suit {name}", 'lower filter_hz, or set it to "none"'
            yield trial.error("sampling", found, cure, cause=cause, code=Code.FORCE_FILTER)


def _compute_bandwidth(settings: CalibrationSettings, time: Array) -> tuple[float | None, str]:
    """Hz that the motion passes (-3 dB), and of what; None where the data are to choose."""
    if settings.nodes is not None or settings.nodes_per_second is not None:
        nodes = NodeRule(settings.nodes_per_second or NODES_PER_SECOND, settings.nodes).count_nodes(
            time
        )
        return compute_cutoff(time, nodes), f"{nodes} spline nodes"
    if settings.bandwidth_hz == AUTOMATIC:
        return None, ""
    return HALF_POWER * float(
        settings.bandwidth_hz
    ), f"bandwidth_hz = {settings.bandwidth_hz:g}: splines"


def check_equal_rates(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
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
            found=f"most have {common:.4g} Hz, but "
            f"{', '.join(f'{name} {rate:.4g} Hz' for name, rate in odd.items())}",
            cure="look whether their time columns are right"
            if far
            else "as it should be, if recorded or exported so",
            code=Code.RATES_DIFFER,
        )


def check_duplicate_recordings(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Trials whose markers are the same in every frame, whatever their files are called: one would
    count twice.

    Parts of one long file, chosen by `time`, are trials of their own.
    """
    for one, other in combinations(trials, 2):
        a, b = one.recording, other.recording
        if a.labels != b.labels or not np.array_equal(a.markers[:1], b.markers[:1], equal_nan=True):
            continue  # one frame is soon compared, and tells most apart
        if np.array_equal(a.markers, b.markers, equal_nan=True):
            found = f"holds the same {len(b.time)} frames as trial '{one.name}' ({one.source})"
            cure = (
                "name the file of this trial, leave the trial out, or give each its part with time "
                "= [start, end]"
            )
            yield other.error("trials", found, cure, code=Code.SAME_RECORDING)


def check_spikes(trial: TrialEvidence) -> Iterator[Finding]:
    """Single positions out of line with the frames before and after: those that were left out, and
    the rest.
    """
    x, fitted = trial.recording.markers, set(trial.as_fitted.present)
    if gone := {label: spikes for label, spikes in trial.trial.spikes.items() if label in fitted}:
        found = (
            f"single positions up to {1e3 * max(m for _, m in gone.values()):.0f} mm out of line "
            "with their "
        )
        found += (
            "neighbours are left out: "
            f"{listed([f'{label} ({n} frames)' for label, (n, _) in gone.items()])}"
        )
        yield trial.info(
            "jumps", found, "nothing: their paths go on without them", code=Code.SPIKES
        )
    if len(x) < 3:
        return
    away = np.linalg.norm(x[1:-1] - 0.5 * (x[2:] + x[:-2]), axis=2)
    limit = compute_jump_limit(trial.recording, trial.marker_set.noise)
    sides = np.nan_to_num(np.pad(away, ((1, 1), (0, 0))))
    peak = (sides[1:-1] >= sides[:-2]) & (
        sides[1:-1] >= sides[2:]
    )  # a spike is out of line, and so are its neighbours
    for one in find_seams(x):  # the frames on either side of a seam
        peak[max(one.frame - 2, 0) : one.frame + 2] = False
    labels, largest = [], 0.0
    for label in trial.as_fitted.present:
        column = trial.column[label]
        out = np.where(peak[:, column], np.nan_to_num(away[:, column]), 0.0)
        if (out > limit).any():
            labels.append(f"{label} ({int((out > limit).sum())} frames)")
            largest = max(largest, float(out.max()))
    if not labels:
        return
    severity, cure = (
        Severity.WARNING,
        'label the trial again there, or set robust = "cauchy" under [calibration]',
    )
    if trial.is_static:
        severity, cure = (
            Severity.INFO,
            "no harm done: of a static trial only the mean over its still window counts",
        )
    found = (
        f"positions up to {1e3 * largest:.0f} mm out of line with their neighbours: "
        f"{listed(labels)}"
    )
    yield trial.make_finding(severity, "jumps", found, cure, code=Code.SPIKES)


@dataclass(frozen=True, kw_only=True)
class Seam:
    """A place between two frames across which the paths of most markers do not go on."""

    frame: int  # The last one before it
    lost: float  # Frames by which the body is further on: below 0 where it is further back

    @property
    def words(self) -> str:
        """How far on or back."""
        count = f"{abs(self.lost):.1f} frames {'on' if self.lost > 0 else 'back'}"
        return count if abs(self.lost) < FAR_FRAMES else "far from the path before"


def check_seams(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether frames are missing and their times, too, one stands twice, or parts of recordings
    were joined.
    """
    found = find_seams(trial.recording.markers)
    if not found or trial.is_static:
        return
    where = listed([f"{trial.recording.time[one.frame]:.2f} s ({one.words})" for one in found])
    cure = "no harm done in a joint moved by itself: joint axes do not depend on the times"
    if trial.is_whole_body:
        cure = (
            "velocities, accelerations and torques are wrong there, and the plates' clock after "
            "it: choose a part "
        )
        cure += "with time = [start, end]"
    twice = all(-1.5 < one.lost < -0.5 for one in found)
    cause = "a frame stands in it twice" if twice else "frames were cut out, or two parts joined"
    yield trial.make_finding(
        Severity.WARNING if trial.is_whole_body else Severity.INFO,
        "jumps",
        f"most markers jump at once at {where}",
        cure,
        cause=f"the recording has a seam: {cause}",
        code=Code.SEAM,
    )


def find_seams(x: Array) -> list[Seam]:
    """Where the paths of markers x (nf, nm, 3) do not go on."""
    if len(x) < 2 * HALF_WINDOW:
        return []
    one, two, ends = _build_projections()
    floor = 3 * one.shape[1] * NOISE_M**2
    gain = np.log((_sum_squares(x, one) + floor) / (_sum_squares(x, two) + floor))
    seen = np.isfinite(gain).sum(axis=1) >= FEWEST_MARKERS
    typical = np.full(len(gain), -np.inf)
    typical[seen] = np.nanmedian(gain[seen], axis=1)
    out = []
    for run in find_runs(typical > SEAM_GAIN):
        k = run.start + int(np.argmax(typical[run]))
        if typical[k] < typical[max(k - HALF_WINDOW, 0) : k + HALF_WINDOW + 1].max():
            continue  # beside a larger one
        step, velocity, change = np.einsum("wi,wmc->imc", ends, x[k : k + 2 * HALF_WINDOW])
        size, speed, stopping = (np.linalg.norm(v, axis=1) for v in (step, velocity, change))
        if np.nanmedian(size - STEP_FRAMES * speed - 0.5 * stopping) > 0:
            lost = np.nansum(step * velocity) / np.nansum(velocity**2)
            out.append(Seam(frame=k + HALF_WINDOW - 1, lost=float(lost)))
    return out


@lru_cache(maxsize=1)
def _build_projections() -> tuple[Array, Array, Array]:
    """(2 H, 2 H - 6) what a quintic leaves, and two parabolas; (2 H, 3) the step between these,
    their mean velocity and its change there, a frame.
    """
    t = np.arange(2 * HALF_WINDOW) - HALF_WINDOW + 0.5
    half = np.vander(t, 3)
    halves = np.zeros((len(t), 6))
    halves[:HALF_WINDOW, :3], halves[HALF_WINDOW:, 3:] = half[:HALF_WINDOW], half[HALF_WINDOW:]
    left = [np.linalg.qr(basis, mode="complete")[0][:, 6:] for basis in (np.vander(t, 6), halves)]
    before, after = np.split(np.linalg.pinv(halves), 2)
    ends = [after[2] - before[2], 0.5 * (after[1] + before[1]), after[1] - before[1]]
    return left[0], left[1], np.stack(ends, axis=1)


def _sum_squares(x: Array, basis: Array) -> Array:
    """(nf - 2 H + 1, nm) sums of squares of x (nf, nm, 3) in the directions of a basis (2 H, n),
    from each frame on.
    """
    count = len(x) - len(basis) + 1
    out = np.zeros((count, x.shape[1]))
    for column in basis.T:
        part = sum(c * x[i : i + count] for i, c in enumerate(column))
        out += np.sum(part**2, axis=2)
    return out
