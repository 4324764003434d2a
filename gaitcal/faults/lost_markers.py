"""Markers that the static trial lost: which were rebuilt from other trials, how well, and which were not."""

from __future__ import annotations

from collections.abc import Iterator

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, listed

LANDMARK_M = 0.008
"""Uncertainty from which a rebuilt landmark is doubted: palpated again they scatter by 6 to 21 mm
(Della Croce et al., Med Biol Eng Comput 37:155-161, 1999)."""


def rebuilt(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that stand in the model where other trials say that they were."""
    if trial.rebuilding is None or trial.model is None or not trial.rebuilding.markers:
        return
    markers = trial.rebuilding.markers
    doubted = [m for m in markers if m.landmarks and (m.uncertainty > LANDMARK_M or m.stranger)]
    for marker in doubted:
        yield trial.warning(
            "lost markers",
            marker.words,
            f'rename = {{ "{marker.stranger}" = "{marker.label}" }} under [markers], if it is the same'
            if marker.stranger
            else "look whether the angles of that segment are plausible; a static trial that shows it is better",
            cause=f"the static trial lost '{marker.label}', which makes {listed(list(marker.landmarks))}",
            weight=marker.uncertainty / LANDMARK_M,
            code=Code.REBUILT_MARKER,
        )
    rest = [marker.words for marker in markers if marker not in doubted]
    if rest:
        yield trial.info("lost markers", listed(rest), code=Code.REBUILT_MARKER)


def not_rebuilt(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that moving trials show and the static one does not, and that nothing places."""
    if trial.rebuilding is None or trial.model is None or not trial.rebuilding.left:
        return
    reasons = [f"'{label}': {why}" for label, why in trial.rebuilding.left.items()]
    yield trial.warning(
        "lost markers",
        f"not seen in this trial, seen in others, and left out of the model: {'; '.join(reasons)}",
        "name a static trial that shows them, or give them no weight",
        code=Code.MARKER_LEFT_OUT,
    )
