"""One trial of the page beside its body in motion: curves, events, strides, verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gaitcal.arrays import Array, BoolArray
from gaitcal.faults.verdict import TrialVerdict
from gaitcal.gait.cycles import GaitCycle, normalise, usable
from gaitcal.gait.gait_event import source_words
from gaitcal.gait.progression import PELVIS_ANGLES, turns
from gaitcal.gait.spatiotemporal import Stride
from gaitcal.gait.strides import strides_of
from gaitcal.gait.words import role_words
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.packing import base64_of, floats, lengths
from gaitcal.page.scene import MOST_FRAMES
from gaitcal.page.sections.sections import trial_sections
from gaitcal.page.sheet.trial_curves import curves_of, line_of, masks_of, packed_curves, pelvis_parts
from gaitcal.session.result import TrialResult
from gaitcal.session.stride_pelvis import pelvis_in_stride
from gaitcal.session.truth_errors import TrialTruth


def trial_sheet(
    model: SubjectModel,
    trial: TrialResult,
    *,
    verdict: TrialVerdict | None,
    relative_to: Mapping[str, float] | None = None,
    truth: TrialTruth | None = None,
) -> dict[str, Any]:
    """What the page tells of a trial; numbers packed as in `page/packing.py`.

    Parameters
    ----------
    verdict : None of a trial that is not judged by itself.
    relative_to, truth : as of `curves_of`.
    """
    time = trial.body.time
    every = max(1, -(-len(time) // MOST_FRAMES))
    curves = curves_of(model, trial, relative_to, truth)
    return {
        "name": trial.name,
        "role": role_words(trial.role, trial.joint),
        "joint": trial.joint,
        "refused": list(trial.refused_legs),
        "verdict": None if verdict is None else _verdict(verdict),
        "start": float(time[0]),
        "duration": float(time[-1] - time[0]),
        "frames": len(time),
        "every": every,
        "time": floats((time - time[0])[::every]),
        **packed_curves(curves, every),
        "events": [
            {
                "side": e.side,
                "kind": e.moment.value,
                "time": e.time - float(time[0]),
                "source": source_words([e.source]),
            }
            for e in trial.events.events
        ],
        "strides": _strides(trial, pelvis_parts(trial, truth), masks_of(curves)),
        "measures": [_measured(stride) for stride in trial.strides],
        "line": line_of(trial),
        "relative": relative_to is not None,
        "sections": trial_sections(model, trial),
    }


def _verdict(verdict: TrialVerdict) -> dict[str, str]:
    return {"judgement": verdict.judgement.value, **{side: of.value for side, of in verdict.legs.items()}}


def _strides(trial: TrialResult, rooms: Mapping[str, Array], masks: Sequence[BoolArray]) -> list[dict[str, Any]]:
    """Complete strides of both feet: s from the begin of the trial; `number`, pelvis and, of each mask of the curves,
    valid percents as in `cycles.csv`.
    """
    if trial.joint is not None:
        return []
    start = float(trial.body.time[0])
    measured = {(s.side, s.number): s for s in trial.strides}
    return [
        {
            "side": side,
            "number": number,
            "start": cycle.start - start,
            "stop": cycle.stop - start,
            "off": None if cycle.toe_off is None else cycle.toe_off - start,
            "turns": (own := measured.get((side, number))) is not None and turns(own.turn),
            "pelvis": _pelvis(trial, cycle, own, rooms),
            "valid": [base64_of(usable(trial.body.time, mask, cycle).astype("<u1")) for mask in masks],
        }
        for side in SIDES
        for number, cycle in enumerate(strides_of(trial.events)[side], start=1)
    ]


def _pelvis(
    trial: TrialResult, cycle: GaitCycle, stride: Stride | None, rooms: Mapping[str, Array]
) -> dict[str, dict[str, Any]]:
    """Pelvis angle -> each part of `pelvis_parts` over 0 to 100 %, against the line of this stride."""
    laid = {
        part: normalise(trial.body.time, pelvis_in_stride(trial, angles, cycle, stride), cycle)
        for part, angles in rooms.items()
    }
    return {name: {part: lengths(of[:, k]) for part, of in laid.items()} for k, name in enumerate(PELVIS_ANGLES)}


def _measured(stride: Stride) -> dict[str, Any]:
    """One row of `spatiotemporal.csv`, also of a stride of which the recording shows a part."""
    return {
        "side": stride.side,
        "number": stride.number,
        "turns": turns(stride.turn),
        "values": {name: float(value) for name, value in stride.measures.items()},
    }
