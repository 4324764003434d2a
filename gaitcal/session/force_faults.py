"""Which trials of a study have forces that are at fault: asked before any force moves a parameter.

It is the residual after the joint parameters and with nominal masses that tells: inertial parameters, and joint ones
fitted with them, take a fault of the forces up (a clock 66 ms late leaves 96 N before and 7 N after).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.faults.force_diagnosis import ForceDiagnosis, force_findings
from gaitcal.faults.force_evidence import force_evidence
from gaitcal.faults.one_marker import TOPIC as ONE_MARKER
from gaitcal.faults.verdict import touches_model
from gaitcal.findings import Finding, Severity
from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.session.prepare import PreparedTrial


def spoilt_motions(checked: Sequence[Finding]) -> frozenset[str]:
    """Trials whose markers do not tell how a leg moves: their motion asks for forces that nobody exerted."""
    return frozenset(f.where for f in checked if f.leg and f.severity is Severity.ERROR and touches_model(f.topic))


def diagnose_forces(
    trials: Sequence[PreparedTrial],
    model: SubjectModel,
    parameters: Parameters,
    motions: Mapping[str, Motion],
    reactions: Mapping[str, GroundReactions],
    checked: Sequence[Finding] = (),
) -> ForceDiagnosis:
    """What is wrong with the forces of the trials that have `reactions`, by motions with `parameters`.

    Inertial parameters are those of `model.nominal`, whatever `parameters` has. What the checks said of the markers
    tells whose motion is doubtful.
    """
    doubtful = spoilt_motions(checked) | {f.where for f in checked if f.topic == ONE_MARKER and f.cause}
    parameters = parameters.with_inertial(model.nominal.inertial)
    if impossible_bodies(parameters.inertial):
        return ForceDiagnosis()
    evidence = (
        force_evidence(t.trial, t.recording, model, parameters, motions[t.name], reactions[t.name])
        for t in trials
        if t.name in reactions
    )
    return force_findings([replace(one, doubtful=one.name in doubtful) for one in evidence if one is not None])


def left_out_of_masses(trials: Sequence[PreparedTrial], faulty: Collection[str], spoilt: Collection[str]) -> list[str]:
    """Notes on the trials that say nothing of masses."""
    words = {
        "forces at fault say nothing of masses": [t.name for t in trials if t.name in faulty],
        "a leg that its markers do not show says nothing of masses": [
            t.name for t in trials if t.joint is None and t.name in spoilt and t.name not in faulty
        ],
    }
    return [f"inertial parameters: {why}; left out: {', '.join(names)}" for why, names in words.items() if names]
