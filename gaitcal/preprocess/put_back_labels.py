"""Put exchanged labels of a moving trial back, where both are right for most of the time."""

from dataclasses import replace

from gaitcal.preprocess.swapped_labels import SwappedLabels, restore_labels
from gaitcal.preprocess.trial_evidence import TrialEvidence

MOST_OF_A_PART = 0.5  # Share of the frames: of more, the labels are exchanged in the file


def put_back(trial: TrialEvidence) -> TrialEvidence:
    """The moving trial as it is fitted: labels that carry each other's marker for a part of it
    exchanged back.

    Three markers of a segment of which two are exchanged are a mirror image, and least squares
    turns the segment round; no weight can repair that. Exchanges are undone until none is left; the
    trial stays as it is where that cannot be done.
    """
    if trial.is_static:
        return trial
    mended, done = trial, list[SwappedLabels]()
    while found := mended.swapped_labels:
        if len(done) > len(trial.column) or not all(_is_partial(mended, one) for one in found):
            return trial
        mended = mended.with_recording(restore_labels(mended.recording, found))
        done += found
    return replace(mended, put_back=tuple(done)) if done else trial


def _is_partial(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Whether both labels are right for most of the time, so that their exchange for a part can be
    undone.
    """
    seen = max(int(trial.visible[:, trial.column[found.label]].sum()), 1)
    return found.mutual and found.sure and int(found.frames.sum()) <= MOST_OF_A_PART * seen
