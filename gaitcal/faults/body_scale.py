"""The size of the body in a trial against the static trial, from the sizes of all clusters together.

Skin and gaps change the size of one cluster by some per cent; the median of seven says more than any of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding

SCALE = (0.983, 1.011)
"""Median size of the clusters of a trial against the static trial: those of 20 people, all their
clean trials together, lie between 0.985 and 1.002."""
FEWEST_CLUSTERS = 6
MOST_MARGIN = 0.006
"""By which the scatter of the clusters' sizes about their median widens the limits, at most: two standard errors of it.
Halves of a clean walk with Plug-in Gait markers, two to four a segment, have a median of 0.980."""
CERTAIN = 0.012
"""Beyond these limits by so much it is another body or another calibration of the cameras."""


def scale_of(trial: TrialEvidence) -> float | None:
    """Median size of the trial's clusters; None with too few."""
    ratios = [cluster.size_ratio for cluster in trial.clusters.values()]
    return float(np.median(ratios)) if len(ratios) >= FEWEST_CLUSTERS else None


def margin_of(trial: TrialEvidence) -> float:
    """By how much the median size of the trial's clusters is uncertain, as they scatter about it: twice
    1.25 (1.48 median |r - median r|) / sqrt(n), the standard error of a median of n.
    """
    ratios = np.array([cluster.size_ratio for cluster in trial.clusters.values()])
    scatter = 1.48 * float(np.median(np.abs(ratios - np.median(ratios))))
    return min(MOST_MARGIN, 2.5 * scatter / float(np.sqrt(len(ratios))))


def odd_scale(trial: TrialEvidence) -> float | None:
    """The scale of a trial where it is not that of the static trial; scatter alone enlarges a cluster a little."""
    scale = scale_of(trial)
    if scale is None:
        return None
    margin = margin_of(trial)
    swollen = float(np.median([c.swelling for c in trial.clusters.values()]))
    return scale if not SCALE[0] - margin <= scale <= SCALE[1] + margin + swollen else None


def rescaled(trial: TrialEvidence) -> TrialEvidence:
    """The trial in the size of the static one, where it has another: what else is wrong can be seen then."""
    scale = odd_scale(trial)
    if scale is None:
        return trial
    recording = replace(trial.recording, markers=trial.recording.markers / scale)
    return replace(trial, trial=replace(trial.trial, recording=recording))


def body_scale(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether all trials show a body of one size."""
    scales = {t.name: (t, scale) for t in trials if not t.is_static and (scale := scale_of(t)) is not None}
    odd = [(t, scale) for t, scale in scales.values() if odd_scale(t) is not None]
    if not odd:
        return
    away = [max(SCALE[0] - scale, scale - SCALE[1]) for _, scale in odd]
    weight = 1.0 + max(away) / (1.0 - SCALE[0])
    sizes = ", ".join(f"{t.name} {scale:.3f}" for t, scale in odd)
    clusters = f"the clusters of all segments are {sizes} times as large as in the static trial (median); allowed: "
    clusters += f"{SCALE[0]:g} to {SCALE[1]:g}"
    if len(odd) == len(scales):
        static = next((t for t in trials if t.is_static), odd[0][0])
        tell = static.error if max(away) > CERTAIN else static.warning
        yield tell(
            "body size",
            clusters,
            "use the static trial of this person and session, with the calibration of the cameras of the other trials",
            cause="the static trial shows a body of another size than "
            + ("the moving trial" if len(odd) == 1 else "all moving trials"),
            weight=weight,
            code=Code.BODY_SIZE,
        )
        return
    for t, scale in odd:
        tell = t.error if max(SCALE[0] - scale, scale - SCALE[1]) > CERTAIN else t.warning
        yield tell(
            "body size",
            clusters,
            "use the trial of this person, exported with the calibration of the cameras of the others",
            cause="the trial shows a body of another size than the others",
            weight=weight,
            code=Code.BODY_SIZE,
        )
