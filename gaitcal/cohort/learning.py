"""Which prior of joint parameters a cohort supports, decided by people who were left out.

Anatomy's prior says N(0, 1) of every deviation in its own units (`person_evidence.py`). Of that variance a part
(`COMMON`) is the same in all people along directions in which both sides deviate alike: an error of the nominal model.
From there on more and more is learnt (`Learning`): nothing; where people are on average; how far they spread along each
direction that their recordings show; how all of it goes together; whether it goes with size and sex. People are dealt
into folds; each step is taken if people of a fold are likelier by what the other folds teach, by more than the standard
error of that gain. Spreads that still turn out too narrow for people left out are widened until they fit.

Mean and spread of the joint parameters of people, of each of whom recordings tell something.

The recordings of person i say of the n deviations y_i (`study/joint_prior.py`), priors left out,

    log p(recordings | y) = r_i^T y - y^T S_i y / 2 + constant,     S_i the information, r_i = S_i m_i,

of which S_i may be singular: what recordings do not show counts for nothing. People are y_i = X_i w + u_i with
u_i ~ N(0, Sigma) and w ~ N(0, W), W the part of the default prior that may be an error of the nominal model in all of
them. With P = Sigma^-1, L_i = (S_i + P)^-1, G_i = S_i - S_i L_i S_i and g_i = r_i - S_i L_i r_i, and w integrated out
(restricted likelihood; Laird and Ware 1982),

    w | all ~ N(A^-1 g, A^-1),      A = W^-1 + sum_i X_i^T G_i X_i,    g = sum_i X_i^T g_i,
    u_i | all:  mean L_i (r_i - S_i X_i w),  covariance L_i + L_i S_i X_i A^-1 X_i^T S_i L_i,
    2 log p = sum_i (r_i^T L_i r_i - log det(1 + Sigma S_i)) + g^T A^-1 g - log det(A W).

Sigma follows by expectation and maximisation (Dempster, Laird and Rubin 1977), sum_i E[u_i u_i^T] with its mirror image
going into a `Structure`, which has a prior of its own: with few people Sigma stays near what it begins with, and along
directions that nobody's recordings show it stays there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.cohort.person_evidence import PersonEvidence
from gaitcal.study.joint_prior import UNLEARNT, design, mirror, sided_directions

MOST_STEPS, RISE = 50, 5e-3
"""Of the iteration, and rise of the log likelihood of each person at which it ends."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the recordings of N people say of n deviations."""

    information: Array
    """(N, n, n) S."""
    right: Array
    """(N, n) r."""
    design: Array
    """(N, n, k) X."""

    def of(self, chosen: IntArray) -> Evidence:
        """Some of the people."""
        return Evidence(information=self.information[chosen], right=self.right[chosen], design=self.design[chosen])


class Structure(Protocol):
    """What spreads may be, and their prior."""

    def first(self) -> Array:
        """(n, n) Sigma before anybody is known."""
        ...

    def updated(self, moment: Array, people: int) -> Array:
        """(n, n) the likeliest Sigma for sum_i E[u u^T] = `moment`, its mirror image among it."""
        ...

    def penalty(self, spread: Array) -> float:
        """Twice the log density of the prior, but for what is the same in all priors of as much weight."""
        ...


@dataclass(frozen=True)
class Known:
    """A spread that nothing is learnt of."""

    spread: Array

    def first(self) -> Array:
        """As of `Structure`."""
        return self.spread

    def updated(self, moment: Array, people: int) -> Array:
        """As of `Structure`."""
        return self.spread

    def penalty(self, spread: Array) -> float:
        """As of `Structure`."""
        return 0.0


@dataclass(frozen=True)
class Axes:
    """Independent along given directions, of each a variance: as sure as `weight` people who had the first ones."""

    directions: Array
    """(n, n) orthonormal columns."""
    variances: Array
    """(n,) before anybody is known."""
    weight: float

    def first(self) -> Array:
        """As of `Structure`."""
        out: Array = (self.directions * self.variances) @ self.directions.T
        return out

    def updated(self, moment: Array, people: int) -> Array:
        """As of `Structure`."""
        seen = np.einsum("ik,ij,jk->k", self.directions, moment, self.directions)
        learnt = (self.weight * self.variances + seen) / (self.weight + people)
        out: Array = (self.directions * learnt) @ self.directions.T
        return out

    def penalty(self, spread: Array) -> float:
        """As of `Structure`."""
        learnt = np.einsum("ik,ij,jk->k", self.directions, spread, self.directions)
        ratio = self.variances / learnt
        return float(self.weight * (np.log(ratio) - ratio).sum())


@dataclass(frozen=True)
class Whole:
    """Any spread: as sure as `weight` people who spread by `target`."""

    target: Array
    weight: float

    def first(self) -> Array:
        """As of `Structure`."""
        return self.target

    def updated(self, moment: Array, people: int) -> Array:
        """As of `Structure`."""
        out: Array = (self.weight * self.target + moment) / (self.weight + people)
        return out

    def penalty(self, spread: Array) -> float:
        """As of `Structure`."""
        ratio = np.linalg.solve(spread, self.target)
        return float(self.weight * (np.linalg.slogdet(ratio)[1] - np.trace(ratio)))


@dataclass(frozen=True, kw_only=True)
class Population:
    """What people are like."""

    effects: Array
    """(k,) w."""
    effect_covariance: Array
    """(k, k) how well it is known."""
    spread: Array
    """(n, n) Sigma."""

    def expected(self, design: Array) -> tuple[Array, Array]:
        """(n,) and (n, n): mean and covariance of a person who is not among those it was learnt of."""
        return design @ self.effects, self.spread + design @ self.effect_covariance @ design.T


@dataclass(frozen=True)
class Learnt:
    """A population, and how likely people were on the way to it."""

    population: Population
    rises: tuple[float, ...]
    """Twice the penalised log likelihood before each step."""


def learn(evidence: Evidence, effects: Array, reflected: Array, structure: Structure) -> Learnt:
    """Mean and spread of people.

    Parameters
    ----------
    effects : (k,) variances W of the effects before anybody is known.
    reflected : (n, n) the mirror (`joint_prior.mirror`).
    structure : what the spread may be.
    """
    spread, told = structure.first(), list[float]()
    people = len(evidence.right)
    while True:
        step = _expected(evidence, effects, spread)
        told.append(step.likelihood + structure.penalty(spread))
        ended = len(told) > 1 and told[-1] - told[-2] < RISE * people
        if isinstance(structure, Known) or not people or ended or len(told) > MOST_STEPS:
            found = Population(effects=step.effects, effect_covariance=step.covariance, spread=spread)
            return Learnt(found, tuple(told))
        moment = 0.5 * (step.moment + reflected @ step.moment @ reflected.T)
        spread = structure.updated(moment, people)


@dataclass(frozen=True, kw_only=True)
class _Expected:
    effects: Array
    covariance: Array
    moment: Array
    likelihood: float


def _expected(evidence: Evidence, effects: Array, spread: Array) -> _Expected:
    """Effects and the sum of E[u u^T] for a spread, and how likely it is."""
    information, right, design = evidence.information, evidence.right, evidence.design
    inverse = np.linalg.inv(information + np.linalg.inv(spread))
    pulled = information @ inverse  # S L
    own = information - pulled @ information
    score = right - np.einsum("nij,nj->ni", pulled, right)
    across = np.swapaxes(design, 1, 2)
    normal = np.diag(1.0 / effects) + (across @ own @ design).sum(axis=0)
    covariance = np.linalg.inv(normal)
    gradient = np.einsum("nik,ni->k", design, score)
    found = covariance @ gradient
    left = right - np.einsum("nij,nj->ni", information, design @ found)
    mean = np.einsum("nij,nj->ni", inverse, left)
    carried = np.swapaxes(pulled, 1, 2) @ design  # L S X
    moment = inverse.sum(axis=0) + mean.T @ mean
    moment = moment + np.einsum("nik,kl,njl->ij", carried, covariance, carried, optimize=True)
    determinants = np.linalg.slogdet(np.eye(len(spread)) + spread @ information)[1]
    likelihood = np.einsum("ni,nij,nj->", right, inverse, right, optimize=True) - determinants.sum()
    likelihood += gradient @ found - np.linalg.slogdet(normal * effects)[1]
    return _Expected(effects=found, covariance=covariance, moment=moment, likelihood=float(likelihood))


def log_density(information: Array, right: Array, mean: Array, covariance: Array) -> float:
    """Log p of one person's recordings if deviations are N(mean, covariance); 0 for recordings that say nothing."""
    left = right - information @ mean
    inner = np.eye(len(right)) + covariance @ information
    explained = left @ np.linalg.solve(inner, covariance @ left)
    size = np.linalg.slogdet(inner)[1]
    return float(right @ mean - 0.5 * mean @ information @ mean + 0.5 * (explained - size))


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
