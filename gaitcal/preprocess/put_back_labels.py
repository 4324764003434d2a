"""Put back labels of a moving trial that are swapped for a part of it."""

from dataclasses import replace

from gaitcal.preprocess.swapped_labels import SwappedLabels, restore_labels
from gaitcal.preprocess.trial_evidence import TrialEvidence

MOST_OF_A_PART = 0.5
"""Largest share of the frames of a swap that is put back; beyond it the file's labels are wrong."""


def restore_swapped_labels(trial: TrialEvidence) -> TrialEvidence:
    """Restore the swapped labels of a moving trial.

    Three markers of a segment of which two are swapped are a mirror image: least squares would
    rotate the segment, and no weight repairs that. Swaps are undone until none is left. The trial
    is returned unchanged if one of them cannot be undone.

    Parameters
    ----------
    trial
        A static trial is returned as it is.

    Returns
    -------
    TrialEvidence
        `restored_swaps` lists the swapped labels.
    """
    if trial.is_static:
        return trial
    restored, done = trial, list[SwappedLabels]()
    while found := restored.swapped_labels:
        if len(done) > len(trial.column) or not all(_is_partial(restored, one) for one in found):
            return trial
        restored = restored.with_recording(restore_labels(restored.recording, found))
        done += found
    return replace(restored, restored_swaps=tuple(done)) if done else trial


def _is_partial(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Return whether both labels are right most of the time, so that the swap can be undone."""
    visible_count = max(int(trial.visible[:, trial.column[found.label]].sum()), 1)
    return found.mutual and found.sure and int(found.frames.sum()) <= MOST_OF_A_PART * visible_count
