"""Lengths: the unit of the file, the scale of a trial against the static one, height against the markers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding

SIZE = (0.05, 4.0)
"""Size of the cloud of markers, in body heights, outside which the unit of length must be wrong. One shank with its
foot measures 0.3."""
SCALE = (0.8, 1.25)
"""Lengths within segments against those of the static trial: outside, unit or camera calibration must be wrong."""
SCALE_DOUBTED = 0.04
"""Departure of the same ratio from one that skin movement does not explain."""
HIP_HEIGHT = (0.48, 0.58)
"""Height of the ASIS above the lateral malleoli, in body heights; five grown people stand between 0.516 and 0.539."""
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.4}


def size(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the cloud of markers has the size of a body."""
    height, found = trial.subject.height, cloud_size(trial)
    if found is None or SIZE[0] * height < found < SIZE[1] * height:
        return
    likely = next((name for name, unit in UNITS.items() if 0.15 * height < found / unit < 2.5 * height), None)
    if likely:
        cure = f"it would be {found / UNITS[likely]:.3g} m if the numbers were {likely}: declare their unit"
        if likely == "millimetres":
            cure = f"it would be {found / 1e3:.3g} m if the numbers were mm: declare mm, or divide by 1000"
    else:
        cure = "check the unit of length that the file declares"
    allowed = f"{SIZE[0] * height:.2g} to {SIZE[1] * height:.2g} m"
    yield trial.error("units", f"the markers span {found:.4g} m; allowed: {allowed}", cure, code=Code.UNIT_OF_LENGTH)


def cloud_size(trial: TrialEvidence) -> float | None:
    """m, diagonal of the box around the markers of the set, median over frames; None where too few are seen."""
    columns = [trial.place[m] for m in trial.marker_set.labels if m in trial.place]
    frames = np.flatnonzero(trial.seen[:, columns].sum(axis=1) >= 3)
    if not len(frames):
        return None
    some = frames[:: max(1, len(frames) // 200)]
    x = trial.recording.markers[some][:, columns]
    box = np.nanmax(x, axis=1) - np.nanmin(x, axis=1)
    return float(np.median(np.linalg.norm(box, axis=1)))


def scale(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether lengths within segments are those of the static trial."""
    if trial.is_static:
        return
    ratios = np.array(list(_ratios(trial)))
    if not len(ratios):
        return
    ratio = float(np.median(ratios))
    words = f"lengths between markers of one segment are {ratio:.3g} times those of the static trial"
    if not SCALE[0] <= ratio <= SCALE[1]:
        cure = "check the unit of length of both files, and that both show the same person"
        if 500 < ratio < 2000:
            cure = "the numbers are mm where the static trial has m: declare mm, or divide by 1000"
        yield trial.error("units", words, cure, code=Code.UNIT_OF_LENGTH)
    elif abs(ratio - 1) > SCALE_DOUBTED and len(ratios) >= 6:
        cure = "were the cameras calibrated anew, or markers put on again, between the two?"
        yield trial.warning("units", words, cure, code=Code.OTHER_SCALE)


def _ratios(trial: TrialEvidence) -> Iterator[float]:
    """Median distance of every pair of markers with weight in a segment, over that in the static posture."""
    for labels, local in trial.templates.values():
        for i, a in enumerate(labels):
            for j in range(i):
                length = float(np.linalg.norm(local[i] - local[j]))
                if length < 0.03 or not trial.weight(a) or not trial.weight(labels[j]):
                    continue
                apart = trial.path(a) - trial.path(labels[j])
                distance = np.linalg.norm(apart, axis=1)
                distance = distance[np.isfinite(distance)]
                if len(distance):
                    yield float(np.median(distance)) / length


def hip_height(trial: TrialEvidence) -> float | None:
    """m, median height of the ASIS above the lateral malleoli."""
    paths = [trial.landmark(f"{name}_{side}") for name in ("asis", "ankle_lat") for side in "rl"]
    if any(path is None for path in paths):
        return None
    up = np.array([path[:, 1] for path in paths if path is not None])
    difference = 0.5 * (up[0] + up[1] - up[2] - up[3])
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if len(difference) else None
