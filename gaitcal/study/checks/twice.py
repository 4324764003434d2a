"""One recording given as two trials: it would count twice, and say nothing of the second trial."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from gaitcal.recording.recording import Recording
from gaitcal.study.checks.evidence import Evidence
from gaitcal.study.checks.finding import Finding, error


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
