"""What only follows from a cause that is told already is not told beside it: one fault, one finding."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gaitcal.codes import Code
from gaitcal.dynamics.ground_reactions import CONTRADICTED
from gaitcal.faults.bounds import DISAGREE
from gaitcal.faults.bounds import TOPIC as BOUNDS
from gaitcal.faults.force_diagnosis import TOPIC as FORCES
from gaitcal.faults.joint_places import TOPIC as PLACES
from gaitcal.faults.marker_structure import TOPIC as MARKERS_AFTER
from gaitcal.faults.verdict import touches_model
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.gait.words import joint_words

_LABEL = re.compile(r"'([^']+)'")
_UNEXPLAINED = (Code.UNEXPLAINED_RESIDUAL, Code.FORCES_CONTRADICT)


def without_consequences(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The findings without vertical forces and residuals that a named fault of the forces explains, and without markers
    that are off after the fit and were named before it, nor what no body can do where markers do not tell how a leg
    moves. Joints of another body lie elsewhere, and one that lies where nobody has it is beyond its bounds, too.
    """
    said = [f for f in findings if f.severity is not Severity.INFO]
    at_fault = {f.where for f in said if f.topic == FORCES and f.cause != CONTRADICTED}
    explained = {f.where for f in said if f.cause == DISAGREE or (f.topic == FORCES and f.code not in _UNEXPLAINED)}
    errors = [f for f in said if f.leg and f.severity is Severity.ERROR]
    spoilt = {(f.where, f.leg) for f in errors if touches_model(f.topic) and f.topic not in (BOUNDS, MARKERS_AFTER)}
    astray = {where for where, _ in spoilt}
    named = {(f.where, label) for f in said if f.topic != MARKERS_AFTER for label in _LABEL.findall(f.cause)}

    another_body = any(f.code is Code.OTHER_BODY for f in said)
    odd_places = [f.cause for f in said if f.topic == PLACES]

    def follows(f: Finding) -> bool:
        if f.topic == PLACES:
            return another_body
        if f.code is Code.JOINT_AT_BOUND:
            return any(f" {joint_words(f.cause.split()[0])} " in cause for cause in odd_places)
        if f.cause == CONTRADICTED:
            return bool({f.where, STUDY} & at_fault) or f.where in astray
        if f.code is Code.UNEXPLAINED_RESIDUAL:
            return bool({f.where, STUDY} & explained) or f.where in astray
        if f.topic == BOUNDS:
            return (f.where, f.leg) in spoilt or (f.cause == DISAGREE and f.where in astray)
        if f.topic == MARKERS_AFTER:
            return any((f.where, label) in named for label in _LABEL.findall(f.cause))
        return False

    return tuple(f for f in findings if not follows(f))
