"""What follows from what, and the verdict: trustworthy, doubtful or refused, with its reasons.

What only follows from a fault that is told already is not told beside it (`without_consequences`):
one fault, one finding.

Findings of one cause become one reason, and the worst is told first. An error refuses, a warning
makes doubtful, a note does neither. What is wrong with the static trial, an isolated trial or the
study itself concerns every walk, since all stand on its model. What is wrong with one walk concerns
that one; where it is about markers, which took part in finding the joints, the others are in doubt.
What is wrong with one leg concerns that leg alone: where it is refused, so are its torques, and
those of pelvis and trunk, which need both; the walk is doubtful then, and refused where both legs
are.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.gait.moments import describe_joint
from gaitcal.model.linkage import SIDE_WORDS, SIDES

SHOWN = 3
"""Pieces of evidence that a reason gives; how many more there are is said."""
SPOILS = {
    "landmarks": ("static trial", "posture", "sides", "axes", "marker places"),
    "axes": ("sides", "exchanged", "heading", "plate to foot", "plates", "time", "joint"),
    "sides": ("exchanged", "heading", "plate to foot", "plates", "joint"),
}
"""Topic of an error whose cause is known -> topics of the same trial that it puts in disorder by
itself.
"""
SPOILS_BODY = ("units", "axes", "sides", "landmarks")
"""Topics of errors of a trial that put its whole body in disorder against the other trials'."""
FORCE_TOPICS = ("forces", "plates", "plate to foot", "body mass")
"""Topics of what is wrong with the forces of a walk, by which no joint was found."""
FORCES, JOINT_POSITIONS, BOUNDS, MARKERS_AFTER_FIT = (
    "forces",
    "joint places",
    "physical bounds",
    "markers after the fit",
)
"""Topics of the force diagnosis and of what a finished fit says."""
LEFT_OUT = "functional trials"
"""Topic of a functional trial that the joint parameters were found without."""
_UNEXPLAINED = (Code.UNEXPLAINED_RESIDUAL, Code.FORCES_CONTRADICT)
_LABEL = re.compile(r"'([^']+)'")


def has_effect_on_joints(topic: str) -> bool:
    """Whether a fault of one walk is in the joints as well."""
    return topic not in FORCE_TOPICS


def remove_consequences(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The findings without those that only follow from a warning or an error among them."""
    said = [f for f in findings if f.severity is not Severity.INFO]
    return tuple(f for f in findings if not any(_is_consequence(f, cause) for cause in said))


def _is_consequence(effect: Finding, cause: Finding) -> bool:
    """The graph: whether one finding only follows from another, which is no note."""
    here, error = cause.where == effect.where, cause.severity is Severity.ERROR
    if here and error and cause.cause and effect.topic in SPOILS.get(cause.topic, ()):
        return True
    # where markers do not tell how a leg moves, its motion asks for torques and forces that nobody
    # exerted
    lost_leg = here and error and bool(cause.leg) and has_effect_on_joints(cause.topic)
    lost_leg &= cause.topic not in (BOUNDS, MARKERS_AFTER_FIT)
    # a fault of the forces of this walk, or of all, is what motion and forces say against each
    # other
    of_forces = cause.topic == FORCES and cause.where in (effect.where, STUDY)
    if effect.code is Code.FORCES_CONTRADICT:
        return lost_leg or (of_forces and cause.code is not Code.FORCES_CONTRADICT)
    if effect.code is Code.UNEXPLAINED_RESIDUAL:
        another = cause.code is Code.FORCES_OF_ANOTHER and cause.where in (effect.where, STUDY)
        return lost_leg or another or (of_forces and cause.code not in _UNEXPLAINED)
    if effect.topic == BOUNDS:
        return lost_leg and (effect.code is Code.FORCES_OF_ANOTHER or cause.leg == effect.leg)
    if effect.topic == MARKERS_AFTER_FIT:  # of a marker that was named before the fit
        labels = set(_LABEL.findall(effect.cause))
        return (
            here
            and cause.topic != MARKERS_AFTER_FIT
            and not labels.isdisjoint(_LABEL.findall(cause.cause))
        )
    # joints of another body lie elsewhere, and one that lies where nobody has it is beyond its
    # bounds
    if effect.topic == JOINT_POSITIONS:
        return cause.code is Code.OTHER_BODY
    if effect.code is Code.JOINT_AT_BOUND:
        return (
            cause.topic == JOINT_POSITIONS
            and f" {describe_joint(effect.cause.split()[0])} " in cause.cause
        )
    return False


class Judgement(Enum):
    """How far a result can be believed."""

    TRUSTWORTHY = "trustworthy"
    DOUBTFUL = "doubtful"
    REFUSED = "refused"

    @classmethod
    def worst(cls, of: "Iterable[Judgement]") -> "Judgement":
        """The worst of some; trustworthy where there are none."""
        order = list(cls)
        return max(of, key=order.index, default=cls.TRUSTWORTHY)


_JUDGEMENT_OF_SEVERITY = {
    Severity.ERROR: Judgement.REFUSED,
    Severity.WARNING: Judgement.DOUBTFUL,
    Severity.INFO: Judgement.TRUSTWORTHY,
}


@dataclass(frozen=True, kw_only=True)
class Reason:
    """One cause for doubt: what is wrong, how that is known, what to do."""

    cause: str
    evidence: str
    action: str
    trials: tuple[str, ...]
    """Names of trials, the worst first; empty where it is about the study."""
    leg: str
    """`r` or `l`; empty where it is about both, or neither."""
    topic: str
    severity: Severity
    code: Code
    """Of the worst of its findings: `gaitcal explain` tells what it means."""

    @property
    def line(self) -> str:
        """In one line: where, what, evidence, what to do."""
        where = ", ".join(self.trials) or STUDY
        return f"{where}: {self.cause}: {self.evidence}" + (
            f"; {self.action}" if self.action else ""
        )


@dataclass(frozen=True, kw_only=True)
class WalkVerdict:
    """One walk, and its legs."""

    judgement: Judgement
    legs: Mapping[str, Judgement]
    """`r`, `l`."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How far a result can be believed, and why."""

    judgement: Judgement
    reasons: tuple[Reason, ...]
    """The worst first."""
    trials: Mapping[str, WalkVerdict]
    """Every walk."""
    forced: bool = False
    """Whether the user went on past errors."""

    @property
    def refused(self) -> tuple[str, ...]:
        """Names of the walks that are refused."""
        return tuple(
            name for name, trial in self.trials.items() if trial.judgement is Judgement.REFUSED
        )

    def refused_legs(self, walk: str) -> tuple[str, ...]:
        """The legs (`r`, `l`) of a walk that are refused; none of a trial that is not judged by
        itself.
        """
        trial = self.trials.get(walk)
        legs = {} if trial is None else trial.legs
        return tuple(side for side in SIDES if legs.get(side) is Judgement.REFUSED)

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        text = SENTENCES[self.judgement]
        parts = [*self.refused]
        for walk in self.trials:
            if walk not in self.refused:
                parts += [
                    f"the {SIDE_WORDS[side]} leg of {walk}" for side in self.refused_legs(walk)
                ]
        if self.judgement is not Judgement.REFUSED and parts:
            text += f" Refused: {', '.join(parts)}."
        return text + (" It was made with --force, past errors." if self.forced else "")


SENTENCES = {
    Judgement.TRUSTWORTHY: "No check found an error larger than the error bars.",
    Judgement.DOUBTFUL: "This result may be wrong by more than its error bars: look at the "
    "reasons.",
    Judgement.REFUSED: "This result is not to be used: no torque counts as valid, and no error bar "
    "is given.",
}


def judge(findings: Sequence[Finding], walks: Sequence[str], *, forced: bool = False) -> Verdict:
    """The verdict on a result with these findings.

    `walks`: names of the trials that are judged each by itself; findings of any other concern all
    of them. `forced`: whether errors of the checks were passed over.
    """
    shared = [f for f in findings if f.where not in walks]
    of_all = _judge_legs(shared)
    spoilt = {
        f.where
        for f in findings
        if f.where in walks and f.severity is Severity.ERROR and has_effect_on_joints(f.topic)
    }
    trials: dict[str, WalkVerdict] = {}
    for walk in walks:
        of_walk = _judge_legs([f for f in findings if f.where == walk])
        legs = {side: Judgement.worst((of_walk[side], of_all[side])) for side in SIDES}
        whole = Judgement.worst((of_walk[""], of_all[""]))
        legs = {side: Judgement.worst((leg, whole)) for side, leg in legs.items()}
        if spoilt - {walk}:
            legs = {side: Judgement.worst((leg, Judgement.DOUBTFUL)) for side, leg in legs.items()}
        trials[walk] = WalkVerdict(
            judgement=Judgement.worst((whole, _combine_legs(legs))), legs=legs
        )
    return Verdict(
        judgement=_judge_overall(of_all, trials),
        reasons=collect_reasons(findings),
        trials=trials,
        forced=forced,
    )


def select_stopping_errors(
    findings: Sequence[Finding], walks: Sequence[str]
) -> tuple[Finding, ...]:
    """The errors that leave nothing to compute, the first one first; none where every walk keeps a
    leg.

    Where an error bears a leg, and the other leg has none, the result tells of the other leg.
    """
    errors = tuple(f for f in findings if f.severity is Severity.ERROR)
    verdict = judge(errors, walks)
    return errors if verdict.refused or verdict.judgement is Judgement.REFUSED else ()


_TRUSTWORTHY = Judgement.TRUSTWORTHY


def _judge_legs(findings: Iterable[Finding]) -> dict[str, Judgement]:
    """The worst of the findings about each leg, and about neither (``""``)."""
    out = dict.fromkeys(("", *SIDES), _TRUSTWORTHY)
    for f in findings:
        leg = f.leg if f.leg in SIDES else ""
        out[leg] = Judgement.worst((out[leg], _JUDGEMENT_OF_SEVERITY[f.severity]))
    return out


def _combine_legs(legs: Mapping[str, Judgement]) -> Judgement:
    """Of two legs together: refused where both are, in doubt where one is."""
    worst = Judgement.worst(legs.values())
    if worst is Judgement.REFUSED and any(leg is not Judgement.REFUSED for leg in legs.values()):
        return Judgement.DOUBTFUL
    return worst


def _judge_overall(shared: Mapping[str, Judgement], trials: Mapping[str, WalkVerdict]) -> Judgement:
    """Refused where all is: a walk that is refused beside others that are not leaves doubt alone."""
    walks = [trial.judgement for trial in trials.values()]
    everything = [*shared.values(), *walks]
    nothing_left = (
        all(j is Judgement.REFUSED for j in walks)
        if walks
        else Judgement.REFUSED in shared.values()
    )
    if shared[""] is Judgement.REFUSED or nothing_left:
        return Judgement.REFUSED
    return _TRUSTWORTHY if all(j is _TRUSTWORTHY for j in everything) else Judgement.DOUBTFUL


def collect_reasons(findings: Iterable[Finding]) -> tuple[Reason, ...]:
    """One reason a cause, of errors and warnings, the worst first."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        if f.severity is not Severity.INFO:
            groups.setdefault((f.topic, f.cause or re.sub(r"[\d.,+-]+", "#", f.found)), []).append(
                f
            )
    for group in groups.values():
        group.sort(key=_rank)
    return tuple(
        _summarise_reason(group)
        for group in sorted(groups.values(), key=lambda group: _rank(group[0]))
    )


def _rank(finding: Finding) -> tuple[int, float]:
    return finding.severity.rank, -finding.weight


def _summarise_reason(group: Sequence[Finding]) -> Reason:
    first = group[0]
    trials = tuple(dict.fromkeys(f.where for f in group if f.where != STUDY))
    several = len(trials) > 1
    pieces = list(dict.fromkeys(f"{f.where}: {f.found}" if several else f.found for f in group))
    evidence = "; ".join(pieces[:SHOWN]) + (
        f"; and {len(pieces) - SHOWN} more" if len(pieces) > SHOWN else ""
    )
    legs: Collection[str] = {f.leg for f in group}
    return Reason(
        cause=first.cause or first.topic,
        evidence=evidence,
        action=first.cure,
        trials=trials,
        leg=first.leg if len(legs) == 1 else "",
        topic=first.topic,
        severity=first.severity,
        code=first.code,
    )
