"""The static trial of a study with the markers that it lost and other trials show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gaitcal.model.rebuilt_markers import Rebuilding, rebuild_lost
from gaitcal.model.strays import without_strays
from gaitcal.runtime import remembered

if TYPE_CHECKING:
    from gaitcal.study.study import Study


@remembered
def completed_static(study: Study) -> Rebuilding:
    """The first static trial, without markers metres away, and with what the study's other trials give back to it."""
    segment_of = study.marker_set.segment_of
    static, _ = without_strays(study.static.recording, segment_of)
    others = [(t.name, without_strays(t.recording, segment_of)[0]) for t in (*study.further_statics, *study.moving)]
    return rebuild_lost(static, study.marker_set.with_weights(study.weights), others, study.static.name)
