"""One fault in one study: what is told of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.faults.force_causes import Kind
from gaitcal.faults.force_choice import ForceFit, Named, choose, told_size
from gaitcal.faults.force_evidence import ForceEvidence
from scripts.validation.force_faults.faults import FAULTS, Fault
from scripts.validation.force_faults.people import Person

ONE_PLATE = 0.4
"""Share of faults of one plate alone, where a fault can be of one."""
ONE_TRIAL = 0.5
"""Share of faults in one trial alone, in sessions of several."""


class Outcome(Enum):
    """How a fault was met."""

    FIRST = "first"
    IN_SET = "in set"
    OTHER_PLATE = "other plate"
    WRONG = "wrong"
    NONE = "none"
    NO_FRAMES = "no frames"
    """No frame of the trial can be judged; nothing is valid."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One fault and how it was met."""

    person: str
    trials: tuple[str, ...]
    fault: Fault
    scope: str
    outcome: Outcome
    told: str
    ratio: float | None
    """Size found over true size, where it was named first."""
    causes: int
    """How many were told."""


def cases(everybody: list[Person], count: int, seed: int, *, track: bool) -> Iterator[Case]:
    """`count` faults, every kind in turn, in people drawn at random."""
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        yield case(everybody[int(rng.integers(len(everybody)))], i, rng, track=track)


def case(person: Person, number: int, rng: np.random.Generator, *, track: bool) -> Case:
    """The fault of that number in one or all trials of a person."""
    make = FAULTS[number % len(FAULTS)]
    alone = len(person.trials) > 1 and rng.random() < ONE_TRIAL
    struck = [int(rng.integers(len(person.trials)))] if alone else list(range(len(person.trials)))
    loaded = [p.name for p in person.clean[struck[0]].plates]
    names = [p.name for p in person.trials[struck[0]].recording.plates]
    plate = names.index(str(rng.choice(loaded))) if rng.random() < ONE_PLATE else None
    fault = _seen_along_the_walk(make(rng, plate), person.clean[struck[0]])
    evidence: list[ForceEvidence | None] = list(person.clean)
    for i in struck:
        evidence[i] = person.evidence(i, fault.change, track=track)
    found, _ = choose([e for e in evidence if e is not None])
    about = [n for n in found if {t.name for t in n.trials} & {person.trials[i].name for i in struck}]
    wrongly = [n for n in found if n not in about]
    outcome, best = _outcome(fault, about, wrongly, person, struck, names)
    if outcome is Outcome.NONE and all(evidence[i] is None for i in struck):
        outcome = Outcome.NO_FRAMES
    named = [f"{n.fits[0].cause.kind.value} {','.join(n.fits[0].cause.plates)}" for n in found]
    return Case(
        person=person.name,
        trials=tuple(person.trials[i].name for i in struck),
        fault=fault,
        scope="all" if fault.plate is None else "one",
        outcome=outcome,
        told="; ".join(named),
        ratio=None if outcome is not Outcome.FIRST or best is None else ratio(fault, best, person, struck[0]),
        causes=max((len(n.fits) for n in about), default=0),
    )


def _seen_along_the_walk(fault: Fault, trial: ForceEvidence) -> Fault:
    """Columns x and z of a file are sideways and fore-aft where the walk goes along z."""
    other = {Kind.SIGN_FORE_AFT: Kind.SIGN_SIDEWAYS, Kind.SIGN_SIDEWAYS: Kind.SIGN_FORE_AFT}
    along_z = abs(trial.room[0, 0]) < 0.5
    return replace(fault, kind=other[fault.kind]) if along_z and fault.kind in other else fault


def _outcome(
    fault: Fault, about: list[Named], wrongly: list[Named], person: Person, struck: list[int], names: list[str]
) -> tuple[Outcome, ForceFit | None]:
    """Of the findings on the struck trials; a finding on another trial is wrong."""
    if wrongly:
        return Outcome.WRONG, None
    if not about:
        return Outcome.NONE, None
    of_plate = () if fault.plate is None else (names[fault.plate],)
    single = all(len(person.clean[i].plates) == 1 for i in struck)

    def same(fit: ForceFit) -> bool:
        plates = fit.cause.plates
        if fault.kind is Kind.EXCHANGED:
            return fit.cause.kind is Kind.EXCHANGED
        return fit.cause.kind is fault.kind and (plates == of_plate or (single and not plates))

    firsts = [n.fits[0] for n in about]
    if all(same(fit) and fit.cause.unit == fault.unit for fit in firsts):
        return Outcome.FIRST, firsts[0]
    if all(any(same(fit) for fit in n.fits) for n in about):
        return Outcome.IN_SET, None
    if all(n.fits[0].cause.kind is fault.kind for n in about):
        return Outcome.OTHER_PLATE, None
    return Outcome.WRONG, None


def ratio(fault: Fault, fit: ForceFit, person: Person, trial: int) -> float | None:
    """Size found over true size; of a factor, of its logarithm's distance from 1; vectors along the true one."""
    if not fault.size:
        return None
    true, found = np.array(fault.size), told_size(fit)
    if len(true) > 1:
        return float(found @ true / (true @ true))
    if fault.kind is Kind.YAW:
        found = (found + np.pi) % (2 * np.pi) - np.pi
        return float(found[0] / true[0]) if abs(true[0]) < 3.0 else float(abs(found[0]) / abs(true[0]))
    if fault.kind is Kind.FREE_MOMENT:  # what has to be taken away, as the rest of a large factor is not seen
        return float(-fit.x[0] / (1.0 - 1.0 / true[0]))
    return float(found[0] / true[0])
