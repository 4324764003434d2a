"""Single positions out of line with the frames beside them, and recordings with a seam.

Where frames were cut out, a frame stands twice, or two parts were joined, and the times run on over it, all markers
make one step at the same time that their paths before and after do not lead to. No marker is wrong there. With the H
frames on either side of a place between two frames, a marker leaves

    Q_one    sum of squares about one quintic through all of them
    Q_two    about a parabola through either half: as many coefficients, and a step between the halves

    gain = ln (Q_one + f) / (Q_two + f),    f = the squares of NOISE_M in the 2 H - 6 degrees of freedom of each axis

A seam is where the median gain of the markers is above ln 2 and the median step above half of what a marker moves in a
frame, and above what a velocity that breaks there makes of a step, as in landing: half of its change in a frame more.
The step d along the velocity v tells how many frames of length h are missing: n = d v / (v^2 h), -1 for one that stands
twice.

Markers that software held: a position repeated while others move, a coordinate that never changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.io.intervals import runs, spans

SPIKE_M = 0.02
SPIKE_ACCELERATION = 300.0
"""m/s^2: the smallest jump out of line, and the largest acceleration of a marker that is still on a body."""
HALF_WINDOW = 5
"""H. At 50 to 200 Hz 25 to 100 ms on either side, in which nothing of a walk but a foot's impact bends twice."""
NOISE_M = 0.0002
"""m, of cameras: what bends less cannot be told from it."""
GAIN = float(np.log(2.0))
"""One path leaves twice the squares of two. In 36 clean recordings of nine laboratories, walks, turns and isolated
trials, the median gain is at most 0.02; with one frame cut out of a walk or doubled anywhere, 1.2 to 4."""
STEP_FRAMES = 0.5
"""Of the movement in a frame: whole frames are lost or doubled, and half of one lies between none and one."""
FEWEST = 6
MOST_FRAMES = 20.0
"""Above that the velocity says nothing of where the body would be."""


def jump_limit(trial: TrialEvidence) -> float:
    """m, how far a marker may be out of line with the frames before and after."""
    return max(SPIKE_M, 0.5 * SPIKE_ACCELERATION / trial.recording.rate**2)


def spikes(trial: TrialEvidence) -> Iterator[Finding]:
    """Single positions that lie out of line with the frames before and after."""
    x = trial.recording.markers
    if len(x) < 3:
        return
    away = np.linalg.norm(x[1:-1] - 0.5 * (x[2:] + x[:-2]), axis=2)
    limit = jump_limit(trial)
    sides = np.nan_to_num(np.pad(away, ((1, 1), (0, 0))))
    peak = (sides[1:-1] >= sides[:-2]) & (sides[1:-1] >= sides[2:])  # a spike is out of line, and so are its neighbours
    peak[_beside_seams(trial)[1:-1]] = False
    labels, largest = [], 0.0
    for label in trial.present:
        column = trial.place[label]
        out = np.where(peak[:, column], np.nan_to_num(away[:, column]), 0.0)
        if (out > limit).any():
            labels.append(f"{label} ({int((out > limit).sum())} frames)")
            largest = max(largest, float(out.max()))
    if not labels:
        return
    found = f"positions up to {1e3 * largest:.0f} mm out of line with their neighbours: {listed(labels)}"
    if trial.is_static:
        yield trial.info(
            "jumps",
            found,
            "no harm done: of a static trial only the mean over its still window counts",
            code=Code.SPIKES,
        )
    else:
        yield trial.warning(
            "jumps",
            found,
            'label the trial again there, or set robust = "cauchy" under [calibration]',
            code=Code.SPIKES,
        )


@dataclass(frozen=True, kw_only=True)
class Seam:
    """A place between two frames across which the paths of most markers do not go on."""

    frame: int
    """The last one before it."""
    lost: float
    """Frames by which the body is further on: below 0 where it is further back."""


def seam(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether frames are missing and their times, too, one stands twice, or parts of recordings were joined."""
    found = seams(trial.recording.markers)
    if not found or trial.is_static:
        return
    where = listed([f"{trial.recording.time[one.frame]:.2f} s ({_frames(one.lost)})" for one in found])
    cure = "no harm done in a joint moved by itself: joint axes do not depend on the times"
    if trial.is_gait:
        cure = "velocities, accelerations and torques are wrong there, and the plates' clock after it: choose a part "
        cure += "with time = [start, end]"
    cause = "frames were cut out, or two parts joined"
    if all(-1.5 < one.lost < -0.5 for one in found):
        cause = "a frame stands in it twice"
    yield trial.finding(
        Severity.WARNING if trial.is_gait else Severity.INFO,
        "jumps",
        f"most markers jump at once at {where}",
        cure,
        cause=f"the recording has a seam: {cause}",
        code=Code.SEAM,
    )


def _frames(lost: float) -> str:
    count = f"{abs(lost):.1f} frames {'on' if lost > 0 else 'back'}"
    return count if abs(lost) < MOST_FRAMES else "far from the path before"


def seams(x: Array) -> list[Seam]:
    """Where the paths of markers x (nf, nm, 3) do not go on."""
    if len(x) < 2 * HALF_WINDOW:
        return []
    one, two, ends = _fits()
    floor = 3 * one.shape[1] * NOISE_M**2
    gain = np.log((_squares(x, one) + floor) / (_squares(x, two) + floor))
    seen = np.isfinite(gain).sum(axis=1) >= FEWEST
    typical = np.full(len(gain), -np.inf)
    typical[seen] = np.nanmedian(gain[seen], axis=1)
    out = []
    for run in runs(typical > GAIN):
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
def _fits() -> tuple[Array, Array, Array]:
    """(2 H, 2 H - 6) what a quintic leaves, and two parabolas; (2 H, 3) the step between these, their mean velocity
    and its change there, a frame.
    """
    t = np.arange(2 * HALF_WINDOW) - HALF_WINDOW + 0.5
    half = np.vander(t, 3)
    halves = np.zeros((len(t), 6))
    halves[:HALF_WINDOW, :3], halves[HALF_WINDOW:, 3:] = half[:HALF_WINDOW], half[HALF_WINDOW:]
    left = [np.linalg.qr(basis, mode="complete")[0][:, 6:] for basis in (np.vander(t, 6), halves)]
    before, after = np.split(np.linalg.pinv(halves), 2)
    ends = [after[2] - before[2], 0.5 * (after[1] + before[1]), after[1] - before[1]]
    return left[0], left[1], np.stack(ends, axis=1)


def _squares(x: Array, basis: Array) -> Array:
    """(nf - 2 H + 1, nm) sums of squares of x (nf, nm, 3) in the directions of a basis (2 H, n), from each frame on."""
    count = len(x) - len(basis) + 1
    out = np.zeros((count, x.shape[1]))
    for column in basis.T:
        part = sum(c * x[i : i + count] for i, c in enumerate(column))
        out += np.sum(part**2, axis=2)
    return out


def _beside_seams(trial: TrialEvidence) -> BoolArray:
    """(nf,) frames on either side of a seam."""
    out = np.zeros(len(trial.recording.time), dtype=bool)
    for one in seams(trial.recording.markers):
        out[max(one.frame - 1, 0) : one.frame + 3] = True
    return out


HALF = 0.5
"""Share of the markers."""
FROZEN_S = 0.1
"""A position repeated bit for bit for so long, while others move, is held by software."""
MOVED_M = 0.01
"""How far the others must have moved meanwhile: somebody who stands still repeats rounded positions honestly. As far
must a marker have moved in one coordinate for another, which never changes, to be odd."""


def frozen(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that repeat their position bit for bit while the others move."""
    x = trial.recording.markers
    if len(x) < 5:
        return
    same = (x[1:] == x[:-1]).all(axis=2)
    shortest = max(4, round(FROZEN_S * trial.recording.rate))
    labels, when = [], []
    for label in trial.present:
        held = [run for run in runs(same[:, trial.place[label]], shortest) if _others_move(x, run)]
        if held:
            labels.append(label)
            when += held
    if labels:
        yield trial.warning(
            "frozen",
            f"positions repeated bit for bit while others move: {listed(labels)} ({spans(trial.recording.time, when)})",
            "software held the last value over a gap: export gaps as gaps, or give the marker no weight",
            code=Code.FROZEN_MARKER,
        )


def _others_move(x: Array, run: slice) -> bool:
    """Whether most of the markers (nf, nm, 3) are elsewhere at the end of a run of steps than at its beginning."""
    moved = np.linalg.norm(x[run.stop] - x[run.start], axis=1)
    moved = moved[np.isfinite(moved)]
    return bool(len(moved)) and float(np.median(moved)) > MOVED_M


def flat(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers with a coordinate that never changes."""
    labels = []
    for label in trial.present:
        x = trial.path(label)[trial.seen[:, trial.place[label]]]
        if len(x) <= 10:
            continue
        way = np.ptp(x, axis=0)
        # A segment that is held still moves by rounding alone: there a coordinate without a change says nothing.
        if (way == 0).any() and way.max() > MOVED_M:
            labels.append(label)
    if 0 < len(labels) < HALF * len(trial.present):
        yield trial.warning(
            "frozen",
            f"one coordinate never changes: {listed(labels)}",
            "a column of the file is constant: export the trial again",
            code=Code.CONSTANT_COORDINATE,
        )
