"""Which trials of a study have forces that are at fault: asked before any force moves a parameter.

It is the residual after the joint parameters and with nominal masses that tells: inertial parameters, and joint ones
fitted with them, take a fault of the forces up (a clock 66 ms late leaves 96 N before and 7 N after).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.person.prepare import PreparedTrial
from gaitcal.verdict.force_diagnosis import ForceDiagnosis, force_findings
from gaitcal.verdict.force_evidence import force_evidence


def diagnose_forces(
    trials: Sequence[PreparedTrial],
    model: SubjectModel,
    parameters: Parameters,
    motions: Mapping[str, Motion],
    reactions: Mapping[str, GroundReactions],
) -> ForceDiagnosis:
    """What is wrong with the forces of the trials that have `reactions`, by motions with `parameters`.

    Inertial parameters are those of `model.nominal`, whatever `parameters` has.
    """
    parameters = parameters.with_inertial(model.nominal.inertial)
    if impossible_bodies(parameters.inertial):
        return ForceDiagnosis()
    evidence = (
        force_evidence(t.trial, t.recording, model, parameters, motions[t.name], reactions[t.name])
        for t in trials
        if t.name in reactions
    )
    return force_findings([one for one in evidence if one is not None])
