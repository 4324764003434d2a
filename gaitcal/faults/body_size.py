"""Size and axes of a trial: the unit of the file, the scale against the static trial, which way is up.

Skin and gaps change the size of one cluster by some per cent; the median of seven says more than any of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import SIDES

SCALE = (0.983, 1.011)
"""Median size of the clusters of a trial against the static trial: those of 20 people, all their
clean trials together, lie between 0.985 and 1.002."""
FEWEST_CLUSTERS = 6
MOST_MARGIN = 0.006
"""By which the scatter of the clusters' sizes about their median widens the limits, at most: two standard errors of it.
Halves of a clean walk with Plug-in Gait markers, two to four a segment, have a median of 0.980."""
CERTAIN = 0.012
"""Beyond these limits by so much it is another body or another calibration of the cameras."""
SIZE = (0.05, 4.0)
"""Size of the cloud of markers, in body heights, outside which the unit of length must be wrong. One shank with its
foot measures 0.3."""
LENGTHS_SCALE = (0.8, 1.25)
"""Lengths within segments against those of the static trial: outside, unit or camera calibration must be wrong."""
SCALE_DOUBTED = 0.04
"""Departure of the same ratio from one that skin movement does not explain."""
SHORTEST_M = 0.03
"""Markers nearer to each other do not tell a scale."""
HIP_HEIGHT = (0.48, 0.58)
"""Height of the ASIS above the lateral malleoli, in body heights; five grown people stand between 0.516 and 0.539."""
LEGS = ("thigh", "shank", "foot")
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.4}
TILT_DEG = 60.0
"""Largest tilt of the pelvis in standing and walking."""
LYING_DEG = 120.0
"""The same for an isolated trial, in which the person may lie on a bench, face up or down."""
HEAD_DOWN = 0.2
"""Share of body height by which knees, ankles and heels may be above the pelvis, as when a leg is raised lying."""


def scale_of(trial: TrialEvidence) -> float | None:
    """Median size of the trial's clusters; None with too few."""
    ratios = [cluster.size_ratio for cluster in trial.clusters.values()]
    return float(np.median(ratios)) if len(ratios) >= FEWEST_CLUSTERS else None


def odd_scale(trial: TrialEvidence) -> float | None:
    """The scale of a trial where it is not that of the static trial.

    It is uncertain by 2 (1.25 (1.48 median |r - median r|) / sqrt(n)), twice the standard error of a median of n sizes
    r, and scatter alone enlarges a cluster a little.
    """
    scale = scale_of(trial)
    if scale is None:
        return None
    ratios = np.array([cluster.size_ratio for cluster in trial.clusters.values()])
    scatter = 1.48 * float(np.median(np.abs(ratios - np.median(ratios))))
    margin = min(MOST_MARGIN, 2.5 * scatter / float(np.sqrt(len(ratios))))
    swollen = float(np.median([c.swelling for c in trial.clusters.values()]))
    return scale if not SCALE[0] - margin <= scale <= SCALE[1] + margin + swollen else None


def rescaled(trial: TrialEvidence) -> TrialEvidence:
    """The trial in the size of the static one, where it has another: what else is wrong can be seen then."""
    scale = odd_scale(trial)
    return trial if scale is None else trial.with_markers(trial.recording.markers / scale)


def body_scale(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether all trials show a body of one size."""
    scales = {t.name: (t, scale) for t in trials if not t.is_static and (scale := scale_of(t)) is not None}
    odd = [(t, scale) for t, scale in scales.values() if odd_scale(t) is not None]
    if not odd:
        return
    away = {t.name: max(SCALE[0] - scale, scale - SCALE[1]) for t, scale in odd}
    found = f"the clusters of all segments are {', '.join(f'{t.name} {scale:.3f}' for t, scale in odd)} times as large "
    found += f"as in the static trial (median); allowed: {SCALE[0]:g} to {SCALE[1]:g}"
    blamed = [(t, away[t.name]) for t, _ in odd]
    cause = "the trial shows a body of another size than the others"
    cure = "use the trial of this person, exported with the calibration of the cameras of the others"
    if len(odd) == len(scales):
        blamed = [(next((t for t in trials if t.is_static), odd[0][0]), max(away.values()))]
        cause = "the static trial shows a body of another size than "
        cause += "the moving trial" if len(odd) == 1 else "all moving trials"
        cure = "use the static trial of this person and session, with the calibration of the cameras of the other "
        cure += "trials"
    weight = 1.0 + max(away.values()) / (1.0 - SCALE[0])
    for t, by in blamed:
        severity = Severity.ERROR if by > CERTAIN else Severity.WARNING
        yield t.finding(severity, "body size", found, cure, cause=cause, weight=weight, code=Code.BODY_SIZE)


def size(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the cloud of markers has the size of a body."""
    height, found = trial.subject.height, cloud_size(trial)
    if found is None or SIZE[0] * height < found < SIZE[1] * height:
        return
    likely = next((name for name, unit in UNITS.items() if 0.15 * height < found / unit < 2.5 * height), None)
    cure = "check the unit of length that the file declares"
    if likely == "millimetres":
        cure = f"it would be {found / 1e3:.3g} m if the numbers were mm: declare mm, or divide by 1000"
    elif likely:
        cure = f"it would be {found / UNITS[likely]:.3g} m if the numbers were {likely}: declare their unit"
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
    ratios = [] if trial.is_static else list(_length_ratios(trial))
    if not ratios:
        return
    ratio = float(np.median(ratios))
    words = f"lengths between markers of one segment are {ratio:.3g} times those of the static trial"
    if not LENGTHS_SCALE[0] <= ratio <= LENGTHS_SCALE[1]:
        cure = "check the unit of length of both files, and that both show the same person"
        if 500 < ratio < 2000:
            cure = "the numbers are mm where the static trial has m: declare mm, or divide by 1000"
        yield trial.error("units", words, cure, code=Code.UNIT_OF_LENGTH)
    elif abs(ratio - 1) > SCALE_DOUBTED and len(ratios) >= 6:
        cure = "were the cameras calibrated anew, or markers put on again, between the two?"
        yield trial.warning("units", words, cure, code=Code.OTHER_SCALE)


def _length_ratios(trial: TrialEvidence) -> Iterator[float]:
    """Median distance of every pair of markers with weight in a segment, over that in the static posture."""
    for labels, local in trial.templates.values():
        for i, a in enumerate(labels):
            for j in range(i):
                length = float(np.linalg.norm(local[i] - local[j]))
                if length < SHORTEST_M or not trial.weight(a) or not trial.weight(labels[j]):
                    continue
                distance = np.linalg.norm(trial.path(a) - trial.path(labels[j]), axis=1)
                distance = distance[np.isfinite(distance)]
                if len(distance):
                    yield float(np.median(distance)) / length


def hip_height(trial: TrialEvidence) -> float | None:
    """m, median height of the ASIS above the lateral malleoli."""
    paths = [trial.landmark(f"{name}_{side}") for name in ("asis", "ankle_lat") for side in SIDES]
    if any(path is None for path in paths):
        return None
    up = np.array([path[:, 1] for path in paths if path is not None])
    difference = 0.5 * (up[0] + up[1] - up[2] - up[3])
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if len(difference) else None


def upright(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body is the right way up in the y-up axes that were made of the file's, in every kind of trial.

    A pelvis whose right and left are exchanged, by labels or by a mirrored axis, looks the same as itself turned about
    its forward axis: upside down. Where the feet are above it, the vertical is.
    """
    if trial.pelvis is None:
        return
    tilt = np.rad2deg(np.arccos(np.clip(trial.pelvis.rotation[trial.pelvis.determined][:, 1, 1], -1, 1)))
    allowed = LYING_DEG if trial.is_isolated else TILT_DEG
    middle, above = float(np.median(tilt)), _feet_above(trial)
    found = f"the pelvis is tilted by {middle:.0f} deg against the vertical found; allowed: {allowed:.0f} deg"
    cause, cure = "the body does not stand upright", "write the file with one of its axes vertical"
    if above is not None and above > HEAD_DOWN * trial.subject.height:
        cause, cure = "the vertical axis points down", "write the file with its vertical axis upwards"
        found = f"the legs are {above:.2f} m above the pelvis"
    elif middle <= allowed:
        return
    elif middle > LYING_DEG:
        cause = "right and left are exchanged: the labels (of the pelvis, or of all markers), or an axis is mirrored"
        cure = "exchange the labels of right and left in the file, or change the sign of the axis that was mirrored"
    yield trial.error("axes", found, cure, cause=cause, weight=10.0, code=Code.NOT_UPRIGHT)


def _feet_above(trial: TrialEvidence) -> float | None:
    """m, median height of knees, ankles or heels, or else of all markers of the legs, over the ASIS."""
    hips = [path[:, 1] for side in SIDES if (path := trial.landmark(f"asis_{side}")) is not None]
    ends = [f"{name}_{side}" for name in ("ankle_lat", "heel", "knee_lat") for side in SIDES]
    feet = [path[:, 1] for name in ends if (path := trial.landmark(name)) is not None]
    if not feet:
        legs = [m for s, labels in trial.marker_set.tracking.items() if s[:-2] in LEGS for m in labels]
        feet = list(trial.recording.markers[:, [trial.place[m] for m in legs if m in trial.place], 1].T)
    if not hips or not np.isfinite(feet).any():
        return None
    return float(np.nanmedian(np.array(feet)) - np.nanmedian(np.array(hips)))
