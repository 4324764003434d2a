"""Findings on the forces of a session: what explains that they disagree with the motion, or that nothing does.

A fault is an error where it moves a torque of a leg by more than its error bar can hold (`HOLDS`, RMS); below that it
is a warning.

Measured by `python -m scripts.validation force_faults --seed 7`, 378 faults in 18 walks of ten people, 3 synthetic:
right cause first 303, in the set 10, another plate 3, wrong 7, nothing told 55; sizes found over true ones 1.00 (10 to
90 %: 0.86 to 1.10), 125 of 144 within 20 %; nothing told of the clean walks. Found from, in 80 % of cases: clock 17 ms;
place 64 mm; tilt 2, of one plate 3, of markers 4 deg; yaw 6 deg; gain of all 11, vertical 6, horizontal 20 %, of one
plate 18 to 60 %; offset 20 N; free moment 2.3 times, its sign seldom; signs, axes, units, exchanged plates always or
nearly so. Taken for each other: gain and vertical gain; one plate and all; exchanged axes, horizontal gain and yaw.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gaitcal.codes import Code
from gaitcal.dynamics.expected_residual import ExpectedResidual
from gaitcal.faults.force_causes import Kind
from gaitcal.faults.force_choice import Named, Unexplained, choose
from gaitcal.faults.force_evidence import ForceEvidence
from gaitcal.faults.force_torques import HOLDS, torque_change
from gaitcal.faults.force_words import CODES, told
from gaitcal.findings import STUDY, Finding, Severity

TOPIC = "forces"


@dataclass(frozen=True, kw_only=True)
class ForceDiagnosis:
    """What is wrong with the forces of a session."""

    findings: tuple[Finding, ...] = ()
    faulty: frozenset[str] = frozenset()
    """Trials whose forces are at fault: they say nothing of masses."""


def force_findings(trials: Sequence[ForceEvidence]) -> ForceDiagnosis:
    """What explains that motion and forces of these gait trials of one person, over the same plates, disagree."""
    named, unexplained = choose(trials)
    findings = [finding for one in named for finding in _findings(one)]
    findings += [_unexplained(one) for one in unexplained]
    faulty = {t.name for one in named if one.fits[0].cause.kind is not Kind.TRUNK for t in one.trials}
    return ForceDiagnosis(
        findings=tuple(sorted(findings, key=lambda f: -f.weight)),
        faulty=frozenset(faulty | {one.trial.name for one in unexplained}),
    )


def _findings(named: Named) -> list[Finding]:
    """One finding; its rivals in its evidence."""
    best, *rivals = named.fits
    first = told(best, named.trials[0])
    torque, change = torque_change(named.trials, best)
    found = f"without that {100 * best.explained:.0f} % of the disagreement between motion and forces is gone"
    if torque:
        found += f"; it moves {torque} by {100 * change:.1f} % of body weight times height (RMS)"
    if rivals:
        words = [f"{told(fit, named.trials[0]).cause} ({100 * fit.explained:.0f} %)" for fit in rivals]
        found += f"; nearly as well it is explained by: {'; or '.join(words)}"
    where = named.trials[0].name
    if len(named.trials) > 1:
        where = STUDY
        found = f"in trials {', '.join(t.name for t in named.trials)} alike; {found}"
    weight = change / HOLDS
    return [
        Finding(
            severity=Severity.ERROR if weight > 1.0 else Severity.WARNING,
            topic=TOPIC,
            where=where,
            cause=first.cause,
            found=found,
            cure=first.cure,
            weight=weight,
            code=CODES[best.cause.kind],
        )
    ]


def beyond_expected(walk: str, residual: ExpectedResidual, trunk_seen: bool) -> Iterator[Finding]:
    """A pelvis residual that is larger than its errors explain, after the fit."""
    if residual.within:
        return
    force, moment = residual.force, residual.moment
    found = f"the pelvis residual is {force.rms:.0f} N and {moment.rms:.0f} N·m RMS, where its errors let expect "
    found += f"{force.expected:.0f} N and {moment.expected:.0f} N·m, and 1 walk in 1000 has more than "
    found += f"{force.limit:.0f} N or {moment.limit:.0f} N·m"
    yield _disagreement(walk, trunk_seen, found, residual.share)


def _unexplained(one: Unexplained) -> Finding:
    size = one.size**0.5
    found = f"the disagreement is {size:.1f} times the usual one"
    return _disagreement(one.trial.name, one.trial.trunk_seen, found, size / 2.0)


def _disagreement(walk: str, trunk_seen: bool, found: str, weight: float) -> Finding:
    cause = "motion and forces disagree at the pelvis, and no single fault of the forces explains it"
    cure = "look at the markers of pelvis and trunk, whether each foot was wholly on a plate, and mass_kg"
    if not trunk_seen:
        cause = "motion and forces disagree at the pelvis, and markers do not determine how the trunk turns"
        cure = "markers on the trunk (C7, sternum); else look at plates and mass_kg"
    return Finding(
        severity=Severity.WARNING,
        topic=TOPIC,
        where=walk,
        cause=cause,
        found=found,
        cure=cure,
        weight=weight,
        code=Code.UNEXPLAINED_RESIDUAL,
    )
