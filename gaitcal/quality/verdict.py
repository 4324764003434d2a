"""Consequences of findings, and the verdict: trustworthy, doubtful or refused, with its reasons.

A finding that only follows from another one is removed (`remove_consequences`): one fault, one
finding.

Findings of one cause become one reason, the worst first. An error leads to a refusal, a warning to
doubt, a note to neither. A fault of the static trial, a functional trial or the study concerns
every walk, as all use its model. A fault of one walk concerns that walk; if it is about markers,
which were used to find the joints, the other walks are doubtful. A fault of one leg concerns that
leg alone. If it is refused, so are its torques, and those of pelvis and trunk, which need both
legs; the walk is then doubtful, and refused if both legs are.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.gait.moments import describe_joint
from gaitcal.model.linkage import SIDE_WORDS, SIDES

SHOWN = 3
"""Number of pieces of evidence in a reason; the number of further ones is added."""
SPOILS = {
    "landmarks": ("static trial", "posture", "sides", "axes", "marker positions"),
    "axes": ("sides", "swapped labels", "heading", "plate to foot", "plates", "time", "joint"),
    "sides": ("swapped labels", "heading", "plate to foot", "plates", "joint"),
}
"""Topic of an error with known cause -> topics of the same trial that follow from it."""
SPOILS_BODY = ("units", "axes", "sides", "landmarks")
"""Topics of errors that make the whole body of a trial differ from that of other trials."""
FORCE_TOPICS = ("forces", "plates", "plate to foot", "body mass")
"""Topics of faults of forces, which were not used to find joints."""
FORCES, JOINT_POSITIONS, BOUNDS, MARKERS_AFTER_FIT = (
    "forces",
    "joint positions",
    "physical bounds",
    "markers after the fit",
)
"""Topics of the force diagnosis and of the post-fit checks."""
LEFT_OUT = "functional trials"
"""Topic of a functional trial that was left out of the joint fit."""
_UNEXPLAINED = (Code.UNEXPLAINED_RESIDUAL, Code.FORCES_CONTRADICT)
_LABEL = re.compile(r"'([^']+)'")


def has_effect_on_joints(topic: str) -> bool:
    """Return whether a fault of one walk affects the joint parameters.

    Parameters
    ----------
    topic
        Topic of a finding.

    Returns
    -------
    bool
    """
    return topic not in FORCE_TOPICS


def remove_consequences(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Remove findings that only follow from a warning or an error among them.

    Parameters
    ----------
    findings
        Of the checks and of the fit.

    Returns
    -------
    tuple of Finding
        In the same order.
    """
    causes = [f for f in findings if f.severity is not Severity.INFO]
    return tuple(f for f in findings if not any(_is_consequence(f, cause) for cause in causes))


def _is_consequence(effect: Finding, cause: Finding) -> bool:
    """Return whether a finding only follows from another one, which is not a note."""
    here, error = cause.where == effect.where, cause.severity is Severity.ERROR
    if here and error and cause.cause and effect.topic in SPOILS.get(cause.topic, ()):
        return True
    # the motion of a leg that markers do not determine requires torques and forces that were not
    # exerted
    lost_leg = here and error and bool(cause.leg) and has_effect_on_joints(cause.topic)
    lost_leg &= cause.topic not in (BOUNDS, MARKERS_AFTER_FIT)
    # a fault of the forces of this walk, or of all walks, makes motion and forces contradict
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
    # joints of another body are at unusual positions, and an unusual position is at a bound
    if effect.topic == JOINT_POSITIONS:
        return cause.code is Code.OTHER_BODY
    if effect.code is Code.JOINT_AT_BOUND:
        return (
            cause.topic == JOINT_POSITIONS
            and f" {describe_joint(effect.cause.split()[0])} " in cause.cause
        )
    return False


class Judgement(Enum):
    """Trust in a result, the best first."""

    TRUSTWORTHY = "trustworthy"
    DOUBTFUL = "doubtful"
    REFUSED = "refused"

    @classmethod
    def select_worst(cls, judgements: "Iterable[Judgement]") -> "Judgement":
        """Return the worst of some judgements; trustworthy if there are none."""
        order = list(cls)
        return max(judgements, key=order.index, default=cls.TRUSTWORTHY)


_JUDGEMENT_OF_SEVERITY = {
    Severity.ERROR: Judgement.REFUSED,
    Severity.WARNING: Judgement.DOUBTFUL,
    Severity.INFO: Judgement.TRUSTWORTHY,
}


@dataclass(frozen=True, kw_only=True)
class Reason:
    """One cause for doubt, with its evidence and remedy."""

    cause: str
    evidence: str
    action: str
    trials: tuple[str, ...]
    """Names of trials, the worst first; empty if it concerns the study."""
    leg: str
    """`r` or `l`; empty if it concerns both, or neither."""
    topic: str
    severity: Severity
    code: Code
    """Of the worst of its findings; `gaitcal explain` describes it."""

    @property
    def line(self) -> str:
        """Trials, cause, evidence and remedy in one line."""
        where = ", ".join(self.trials) or STUDY
        return f"{where}: {self.cause}: {self.evidence}" + (
            f"; {self.action}" if self.action else ""
        )


@dataclass(frozen=True, kw_only=True)
class WalkVerdict:
    """Judgement of one walk and of its legs."""

    judgement: Judgement
    legs: Mapping[str, Judgement]
    """`r`, `l`."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Trust in a result, and its reasons."""

    judgement: Judgement
    reasons: tuple[Reason, ...]
    """The worst first."""
    trials: Mapping[str, WalkVerdict]
    """Every walk."""
    forced: bool = False
    """Whether the user continued in spite of errors."""

    @property
    def refused(self) -> tuple[str, ...]:
        """Names of refused walks."""
        return tuple(
            name for name, trial in self.trials.items() if trial.judgement is Judgement.REFUSED
        )

    def list_refused_legs(self, walk: str) -> tuple[str, ...]:
        """List the refused legs of a walk.

        Parameters
        ----------
        walk
            Name of a trial.

        Returns
        -------
        tuple of str
            `r`, `l`; empty for a trial without a judgement.
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
                    f"the {SIDE_WORDS[side]} leg of {walk}" for side in self.list_refused_legs(walk)
                ]
        if self.judgement is not Judgement.REFUSED and parts:
            text += f" Refused: {', '.join(parts)}."
        return text + (" It was computed in spite of errors (--force)." if self.forced else "")


SENTENCES = {
    Judgement.TRUSTWORTHY: "No check found an error larger than the error bars.",
    Judgement.DOUBTFUL: "This result may be wrong by more than its error bars: check the reasons.",
    Judgement.REFUSED: "Do not use this result: no torque is valid, and error bars are not given.",
}


def judge(findings: Sequence[Finding], walks: Sequence[str], *, forced: bool = False) -> Verdict:
    """Judge a result by its findings.

    Parameters
    ----------
    findings
        Of the checks and of the fit.
    walks
        Names of the trials with a judgement each; findings of any other trial concern all of them.
    forced
        Whether the user continued in spite of errors.

    Returns
    -------
    Verdict
    """
    shared = [f for f in findings if f.where not in walks]
    of_all = _judge_legs(shared)
    # an error about markers of one walk makes the joints of all walks doubtful
    spoilt = {
        f.where
        for f in findings
        if f.where in walks and f.severity is Severity.ERROR and has_effect_on_joints(f.topic)
    }
    trials: dict[str, WalkVerdict] = {}
    for walk in walks:
        of_walk = _judge_legs([f for f in findings if f.where == walk])
        legs = {side: Judgement.select_worst((of_walk[side], of_all[side])) for side in SIDES}
        whole = Judgement.select_worst((of_walk[""], of_all[""]))
        legs = {side: Judgement.select_worst((leg, whole)) for side, leg in legs.items()}
        if spoilt - {walk}:
            legs = {
                side: Judgement.select_worst((leg, Judgement.DOUBTFUL))
                for side, leg in legs.items()
            }
        trials[walk] = WalkVerdict(
            judgement=Judgement.select_worst((whole, _combine_legs(legs))), legs=legs
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
    """Select the errors that leave nothing to compute.

    If an error concerns one leg and the other leg has none, results of the other leg remain.

    Parameters
    ----------
    findings
        Of the checks.
    walks
        Names of the walks.

    Returns
    -------
    tuple of Finding
        In the given order; empty if every walk keeps a leg.
    """
    errors = tuple(f for f in findings if f.severity is Severity.ERROR)
    verdict = judge(errors, walks)
    return errors if verdict.refused or verdict.judgement is Judgement.REFUSED else ()


_TRUSTWORTHY = Judgement.TRUSTWORTHY


def _judge_legs(findings: Iterable[Finding]) -> dict[str, Judgement]:
    """Judge each leg by the worst of its findings, and findings about neither (``""``)."""
    out = dict.fromkeys(("", *SIDES), _TRUSTWORTHY)
    for f in findings:
        leg = f.leg if f.leg in SIDES else ""
        out[leg] = Judgement.select_worst((out[leg], _JUDGEMENT_OF_SEVERITY[f.severity]))
    return out


def _combine_legs(legs: Mapping[str, Judgement]) -> Judgement:
    """Combine two legs: refused if both are, doubtful if one is."""
    worst = Judgement.select_worst(legs.values())
    if worst is Judgement.REFUSED and any(leg is not Judgement.REFUSED for leg in legs.values()):
        return Judgement.DOUBTFUL
    return worst


def _judge_overall(shared: Mapping[str, Judgement], trials: Mapping[str, WalkVerdict]) -> Judgement:
    """Judge the whole result: refused if all walks are, doubtful if some are."""
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
    """Collect one reason for each cause of errors and warnings.

    `findings`: of the checks and of the fit. Returns: the worst first.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        if f.severity is not Severity.INFO:
            groups.setdefault((f.topic, f.cause or re.sub(r"[\d.,+-]+", "#", f.found)), []).append(
                f
            )
    # the worst finding gives the cause, remedy and severity of its reason
    for group in groups.values():
        group.sort(key=_rank)
    return tuple(
        _summarise_reason(group)
        for group in sorted(groups.values(), key=lambda group: _rank(group[0]))
    )


def _rank(finding: Finding) -> tuple[int, float]:
    """Rank a finding by severity and weight, the worst first."""
    return finding.severity.rank, -finding.weight


def _summarise_reason(group: Sequence[Finding]) -> Reason:
    """Summarise findings of one cause, the worst first."""
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
