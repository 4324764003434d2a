"""Which prior of joint parameters a cohort supports, decided by people who were left out.

Anatomy's prior says N(0, 1) of every deviation in its own units (`person_evidence.py`). Of that variance a part
(`COMMON`) is the same in all people along directions in which both sides deviate alike: an error of the nominal model.
From there on more and more is learnt (`Learning`): nothing; where people are on average; how far they spread along each
direction that their recordings show; how all of it goes together; whether it goes with size and sex. People are dealt
into folds; each step is taken if people of a fold are likelier by what the other folds teach, by more than the standard
error of that gain. Spreads that still turn out too narrow for people left out are widened until they fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.cohort.person_evidence import PersonEvidence
from gaitcal.cohort.random_effects import (
    Axes,
    Evidence,
    Known,
    Learnt,
    Population,
    Structure,
    Whole,
    learn,
    log_density,
)
from gaitcal.study.cohort_prior import UNLEARNT
from gaitcal.study.people_design import design, mirror, sided_directions

COMMON = (0.5, 0.2, 0.05)
"""Of the default variance, the part that is the same in all people; the likeliest of them is taken."""
BY_SIZE = 0.25
"""Variance of what goes with 10 cm of height, and with sex, before anybody is known."""
FEWEST, FOLDS = 8, 8
SURE_OF_AXES, SURE_OF_ALL = 3.0, 30.0
"""People as many as whom the first spread counts."""
WIDER = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)


class Learning(Enum):
    """How much is learnt; `value`: in files."""

    NOTHING = UNLEARNT
    OFFSET = "offset"
    SPREAD = "offset and spread"
    WHOLE = "offset, spread and correlations"


@dataclass(frozen=True, kw_only=True)
class PartPrior:
    """What a cohort teaches of one part of the body."""

    names: tuple[str, ...]
    learning: Learning
    by_size: bool
    wider: float
    """Factor of the covariance of a new person."""
    populations: tuple[Population, ...]
    """Of everybody, then without each fold."""
    gain: tuple[float, float]
    """Mean rise of the log likelihood of a person left out against the default prior, and its standard error."""


@dataclass(frozen=True)
class _Cohort:
    names: tuple[str, ...]
    people: Sequence[PersonEvidence]
    part: str
    folds: IntArray
    heights: tuple[float, float]

    def evidence(self, *, by_size: bool) -> Evidence:
        parts = [p.parts[self.part] for p in self.people]
        return Evidence(
            information=np.array([p.information for p in parts]),
            right=np.array([p.right for p in parts]),
            design=np.array([design(self.names, p.person, self.heights, by_size=by_size) for p in self.people]),
        )


@dataclass(frozen=True)
class _Way:
    """How a population is learnt."""

    learning: Learning
    by_size: bool = False


@dataclass(frozen=True)
class _Tried:
    way: _Way
    populations: tuple[Population, ...]
    evidence: Evidence
    densities: Array
    """(N,) log density of each person by the others' population."""


def folds_of(names: Sequence[str]) -> IntArray:
    """(N,) the fold of each person: dealt out in the order of their names, so that all are as large."""
    order = np.argsort(np.array(names, dtype=str), kind="stable")
    out = np.empty(len(names), dtype=np.intp)
    out[order] = np.arange(len(names)) % min(FOLDS, max(len(names), 1))
    return out


def heights_of(people: Sequence[PersonEvidence]) -> tuple[float, float]:
    """m: the smallest and the tallest."""
    heights = [p.person.height for p in people]
    return min(heights), max(heights)


def learn_part(
    part: str,
    names: tuple[str, ...],
    people: Sequence[PersonEvidence],
    folds: IntArray,
    told: Callable[[str], None] = lambda text: None,
) -> PartPrior:
    """What people teach of the joint parameters `names` of a part of the body."""
    cohort = _Cohort(names, people, part, folds, heights_of(people))
    nothing = best = _tried(cohort, _Way(Learning.NOTHING))
    told_of = any(person.parts[part].information.any() for person in people)
    for learning in (Learning.OFFSET, Learning.SPREAD) if told_of else ():
        told(f"{part}: {learning.value}")
        best = _better(best, _tried(cohort, _Way(learning)))
    if best is not nothing:
        told(f"{part}: {Learning.WHOLE.value}")
        best = _better(best, _tried(cohort, replace(best.way, learning=Learning.WHOLE)))
        told(f"{part}: size and sex")
        best = _better(best, _tried(cohort, replace(best.way, by_size=True)))
    wider, densities = _widened(best, folds)
    gain = densities - nothing.densities
    return PartPrior(
        names=names,
        learning=best.way.learning,
        by_size=best.way.by_size,
        wider=wider,
        populations=best.populations,
        gain=(float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain)))),
    )


def _better(one: _Tried, other: _Tried) -> _Tried:
    """The other one if people left out are likelier by it, and not by chance."""
    gain = other.densities - one.densities
    return other if gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)) else one


def _tried(cohort: _Cohort, way: _Way) -> _Tried:
    evidence, folds = cohort.evidence(by_size=way.by_size), cohort.folds
    populations = tuple(
        _population(evidence.of(np.flatnonzero(folds != k)), cohort.names, way) for k in range(-1, max(folds) + 1)
    )
    densities = np.array([_density(evidence, populations, folds, i) for i in range(len(folds))])
    return _Tried(way, populations, evidence, densities)


def _density(
    evidence: Evidence, populations: Sequence[Population], folds: IntArray, i: int, wider: float = 1.0
) -> float:
    mean, covariance = populations[folds[i] + 1].expected(evidence.design[i])
    return log_density(evidence.information[i], evidence.right[i], mean, wider * covariance)


def _widened(tried: _Tried, folds: IntArray) -> tuple[float, Array]:
    """The factor by which people left out are likeliest, and their log densities by it."""
    factors = WIDER if tried.way.learning is not Learning.NOTHING else (1.0,)
    found = [
        np.array([_density(tried.evidence, tried.populations, folds, i, wider) for i in range(len(folds))])
        for wider in factors
    ]
    k = int(np.argmax([densities.sum() for densities in found]))
    return factors[k], found[k]


def _population(evidence: Evidence, names: tuple[str, ...], way: _Way) -> Population:
    """What these people teach; of nobody, or where nothing is learnt, the default prior."""
    count = evidence.design.shape[2]
    alike, opposite = sided_directions(names)
    if way.learning is Learning.NOTHING:
        nothing = np.zeros(count)
        return Population(effects=nothing, effect_covariance=np.diag(nothing), spread=np.eye(len(names)))
    reflected = mirror(names)

    def learnt(common: float, spread: Array | None = None) -> Learnt:
        effects = np.full(count, BY_SIZE)
        effects[: alike.shape[1]] = common
        structure: Structure
        if spread is not None:
            structure = Known(spread)
        elif way.learning is Learning.OFFSET:
            structure = Known(np.eye(len(names)) - common * alike @ alike.T)
        else:
            structure = _axes(evidence, (alike, 1.0 - common), (opposite, 1.0), reflected)
        found = learn(evidence, effects, reflected, structure)
        if way.learning is Learning.WHOLE and spread is None:
            found = learn(evidence, effects, reflected, Whole(found.population.spread, SURE_OF_ALL))
        return found

    first = learnt(COMMON[0])
    likeliest = max(COMMON, key=lambda common: learnt(common, first.population.spread).rises[-1])
    return (first if likeliest == COMMON[0] else learnt(likeliest)).population


def _axes(evidence: Evidence, alike: tuple[Array, float], opposite: tuple[Array, float], reflected: Array) -> Axes:
    """Directions by how well people's recordings show them, so that what is seen tells nothing of what is not.

    `alike`, `opposite`: a basis, and the variance along each direction before anybody is known.
    """
    seen = evidence.information.sum(axis=0)
    seen = 0.5 * (seen + reflected @ seen @ reflected.T)
    bases = [(basis @ np.linalg.eigh(basis.T @ seen @ basis)[1], variance) for basis, variance in (alike, opposite)]
    variances = [np.full(basis.shape[1], variance) for basis, variance in bases]
    return Axes(np.hstack([basis for basis, _ in bases]), np.concatenate(variances), SURE_OF_AXES)
