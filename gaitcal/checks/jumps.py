"""Single positions out of line with the frames beside them, and recordings with a seam.

Where frames were cut out, or two parts joined, and the times closed over it, most markers of the body make one step at
the same time that is many times their steps before and after. No marker is wrong there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.checks.evidence import TrialEvidence
from gaitcal.codes import Code
from gaitcal.findings import Finding, Severity, listed

SPIKE_M = 0.02
SPIKE_ACCELERATION = 300.0
"""m/s^2: the smallest jump out of line, and the largest acceleration of a marker that is still on a body."""
SEAM = 4.0
"""A step so many times those beside it."""
SEAM_M = 0.004
"""The smallest step that shows it."""
SHOWN_BY = 0.6
"""Share of the markers seen that must make such a step."""
FEWEST = 6


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


def seam(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether frames are missing and their times, too, or parts of recordings were joined."""
    found = seams(trial.recording.markers)
    if not found or trial.is_static:
        return
    where = listed([f"{trial.recording.time[frame]:.2f} s" for frame in found])
    cure = "no harm done in a joint moved by itself: joint axes do not depend on the times"
    if trial.is_gait:
        cure = "velocities, accelerations and torques are wrong there: choose a part with time = [start, end]"
    yield trial.finding(
        Severity.WARNING if trial.is_gait else Severity.INFO,
        "jumps",
        f"most markers jump at once at {where}",
        cure,
        cause="the recording has a seam: frames were cut out, or two parts joined",
        code=Code.SEAM,
    )


def seams(x: Array) -> list[int]:
    """Frames of markers x (nf, nm, 3) before a seam."""
    if len(x) < 4:
        return []
    length = np.linalg.norm(np.diff(x, axis=0), axis=2)
    with np.errstate(invalid="ignore"):
        jumping = (length[1:-1] > SEAM_M) & (length[1:-1] > SEAM * np.maximum(length[:-2], length[2:]))
    seen = np.isfinite(length[1:-1]).sum(axis=1)
    out: list[int] = (np.flatnonzero(jumping.sum(axis=1) >= np.maximum(FEWEST, SHOWN_BY * seen)) + 1).tolist()
    return out


def _beside_seams(trial: TrialEvidence) -> BoolArray:
    """(nf,) frames on either side of a seam."""
    out = np.zeros(len(trial.recording.time), dtype=bool)
    for frame in seams(trial.recording.markers):
        out[max(frame - 1, 0) : frame + 3] = True
    return out
