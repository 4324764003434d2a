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
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.io.intervals import runs

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
    for one in seams(x):  # the frames on either side of a seam
        peak[max(one.frame - 2, 0) : one.frame + 2] = False
    labels, largest = [], 0.0
    for label in trial.present:
        column = trial.place[label]
        out = np.where(peak[:, column], np.nan_to_num(away[:, column]), 0.0)
        if (out > limit).any():
            labels.append(f"{label} ({int((out > limit).sum())} frames)")
            largest = max(largest, float(out.max()))
    if not labels:
        return
    severity, cure = Severity.WARNING, 'label the trial again there, or set robust = "cauchy" under [calibration]'
    if trial.is_static:
        severity, cure = Severity.INFO, "no harm done: of a static trial only the mean over its still window counts"
    found = f"positions up to {1e3 * largest:.0f} mm out of line with their neighbours: {listed(labels)}"
    yield trial.finding(severity, "jumps", found, cure, code=Code.SPIKES)


@dataclass(frozen=True, kw_only=True)
class Seam:
    """A place between two frames across which the paths of most markers do not go on."""

    frame: int
    """The last one before it."""
    lost: float
    """Frames by which the body is further on: below 0 where it is further back."""

    @property
    def words(self) -> str:
        """How far on or back."""
        count = f"{abs(self.lost):.1f} frames {'on' if self.lost > 0 else 'back'}"
        return count if abs(self.lost) < MOST_FRAMES else "far from the path before"


def seam(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether frames are missing and their times, too, one stands twice, or parts of recordings were joined."""
    found = seams(trial.recording.markers)
    if not found or trial.is_static:
        return
    where = listed([f"{trial.recording.time[one.frame]:.2f} s ({one.words})" for one in found])
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
