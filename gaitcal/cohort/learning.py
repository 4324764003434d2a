"""Which prior of joint parameters a cohort supports, decided by people who were left out.

Anatomy's prior says N(0, 1) of every deviation in its own units (`learn_priors.py`). Of that
variance a part (`COMMON`) is the same in all people along directions in which both sides deviate
alike: an error of the nominal model. From there on more and more is learnt (`Learning`): nothing;
where people are on average; how far they spread along each direction that their recordings show;
how all of it goes together; whether it goes with size and sex. People are dealt into folds; each
step is taken if people of a fold are likelier by what the other folds teach, by more than the
standard error of that gain. Spreads that still turn out too narrow for people left out are widened
until they fit.

Mean and spread of the joint parameters of people, of each of whom recordings tell something.

The recordings of person i say of the n deviations y_i (`study/cohort_prior.py`), priors left out,

    log p(recordings | y) = r_i^T y - y^T S_i y / 2 + constant,     S_i the information, r_i = S_i m_i,

of which S_i may be singular: what recordings do not show counts for nothing. People are y_i = X_i w
+ u_i with u_i ~ N(0, Sigma) and w ~ N(0, W), W the part of the default prior that may be an error
of the nominal model in all of them. With P = Sigma^-1, L_i = (S_i + P)^-1, G_i = S_i - S_i L_i S_i
and g_i = r_i - S_i L_i r_i, and w integrated out (restricted likelihood; Laird and Ware 1982),

    w | all ~ N(A^-1 g, A^-1),      A = W^-1 + sum_i X_i^T G_i X_i,    g = sum_i X_i^T g_i,
    u_i | all:  mean L_i (r_i - S_i X_i w),  covariance L_i + L_i S_i X_i A^-1 X_i^T S_i L_i,
    2 log p = sum_i (r_i^T L_i r_i - log det(1 + Sigma S_i)) + g^T A^-1 g - log det(A W).

Sigma follows by expectation and maximisation (Dempster, Laird and Rubin 1977), sum_i E[u_i u_i^T]
with its mirror image going into a `Structure`, which has a prior of its own: with few people Sigma
stays near what it begins with, and along directions that nobody's recordings show it stays there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.runtime import Progress, silent
from gaitcal.study.cohort_prior import (
    NOT_LEARNT,
    Person,
    build_design,
    build_mirror,
    build_sided_directions,
)

MOST_STEPS, RISE = (
    50,
    5e-3,
)  # Of the iteration, and rise of the log likelihood of each person at which it ends
COMMON = (0.5, 0.2, 0.05)
"""Of the default variance, the part that is the same in all people; the likeliest of them is taken.
"""
BY_SIZE = 0.25  # Variance of what goes with 10 cm of height, and with sex, before anybody is known
FEWEST, FOLDS = 8, 8
SURE_OF_AXES, SURE_OF_ALL = 3.0, 30.0  # People as many as whom the first spread counts
WIDER = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the recordings of N people say of n deviations."""

    information: Array  # (N, n, n) S
    right: Array  # (N, n) r
    design: Array  # (N, n, k) X

    def of(self, chosen: IntArray) -> "Evidence":
        """Some of the people."""
        return Evidence(
            information=self.information[chosen],
            right=self.right[chosen],
            design=self.design[chosen],
        )


@dataclass(frozen=True)
class Structure:
    """What Sigma may be, and its prior: as sure as `weight` people who spread by `first`."""

    first: Array  # (n, n) Sigma before anybody is known
    weight: float = np.inf  # Infinite: nothing is learnt of it
    directions: Array | None = (
        None  # (n, n) orthonormal columns along which people are independent; None: any spread
    )

    def updated(self, moment: Array, people: int) -> Array:
        """(n, n) the likeliest Sigma for sum_i E[u u^T] = `moment`, its mirror image among it."""
        spread: Array = (self.weight * self.first + moment) / (self.weight + people)
        if self.directions is not None:
            along = np.einsum("ik,ij,jk->k", self.directions, spread, self.directions)
            spread = (self.directions * along) @ self.directions.T
        return spread

    def penalty(self, spread: Array) -> float:
        """Twice the log density of the prior, but for what is the same in all priors of as much
        weight.
        """
        if np.isinf(self.weight):
            return 0.0
        ratio = np.linalg.solve(spread, self.first)
        return float(self.weight * (np.linalg.slogdet(ratio)[1] - np.trace(ratio)))


@dataclass(frozen=True, kw_only=True)
class Population:
    """What people are like."""

    effects: Array  # (k,) w
    effect_covariance: Array  # (k, k) how well it is known
    spread: Array  # (n, n) Sigma

    def expected(self, design: Array) -> tuple[Array, Array]:
        """(n,) and (n, n): mean and covariance of a person who is not among those it was learnt of."""
        return design @ self.effects, self.spread + design @ self.effect_covariance @ design.T


@dataclass(frozen=True)
class Learnt:
    """A population, and how likely people were on the way to it."""

    population: Population
    rises: tuple[float, ...]  # Twice the penalised log likelihood before each step


def learn(evidence: Evidence, effects: Array, reflected: Array, structure: Structure) -> Learnt:
    """Mean and spread of people.

    `effects`: (k,) variances W of the effects before anybody is known.
    `reflected`: (n, n) the mirror (`joint_prior.mirror`).
    `structure`: what the spread may be.
    """
    information, right, design = evidence.information, evidence.right, evidence.design
    across, people = np.swapaxes(design, 1, 2), len(right)
    spread, rises = structure.first, list[float]()
    while True:
        inverse = np.linalg.inv(information + np.linalg.inv(spread))  # L
        pulled = information @ inverse  # S L
        score = right - np.einsum("nij,nj->ni", pulled, right)
        normal = np.diag(1.0 / effects) + (
            across @ (information - pulled @ information) @ design
        ).sum(axis=0)
        covariance = np.linalg.inv(normal)
        gradient = np.einsum("nik,ni->k", design, score)
        found = covariance @ gradient
        determinants = np.linalg.slogdet(np.eye(len(spread)) + spread @ information)[1]
        likelihood = (
            np.einsum("ni,nij,nj->", right, inverse, right, optimize=True) - determinants.sum()
        )
        likelihood += gradient @ found - np.linalg.slogdet(normal * effects)[1]
        rises.append(float(likelihood) + structure.penalty(spread))
        ended = len(rises) > 1 and rises[-1] - rises[-2] < RISE * people
        if np.isinf(structure.weight) or not people or ended or len(rises) > MOST_STEPS:
            return Learnt(
                Population(effects=found, effect_covariance=covariance, spread=spread), tuple(rises)
            )
        left = right - np.einsum("nij,nj->ni", information, design @ found)
        mean = np.einsum("nij,nj->ni", inverse, left)
        carried = np.swapaxes(pulled, 1, 2) @ design  # L S X
        moment = inverse.sum(axis=0) + mean.T @ mean
        moment = moment + np.einsum("nik,kl,njl->ij", carried, covariance, carried, optimize=True)
        spread = structure.updated(0.5 * (moment + reflected @ moment @ reflected.T), people)


def log_density(information: Array, right: Array, mean: Array, covariance: Array) -> float:
    """Log p of one person's recordings if deviations are N(mean, covariance); 0 for recordings that
    say nothing.
    """
    left = right - information @ mean
    inner = np.eye(len(right)) + covariance @ information
    explained = left @ np.linalg.solve(inner, covariance @ left)
    size = np.linalg.slogdet(inner)[1]
    return float(right @ mean - 0.5 * mean @ information @ mean + 0.5 * (explained - size))


@dataclass(frozen=True, kw_only=True)
class PartEvidence:
    """Of the n joint parameters of a part, in units of anatomy's prior: of y."""

    information: Array  # (n, n) S
    right: Array  # (n,) S m


@dataclass(frozen=True, kw_only=True)
class PersonEvidence:
    """One person, from one session."""

    name: str
    person: Person
    recordings: frozenset[str]  # SHA-256 of all of them, of every session
    parts: dict[str, PartEvidence]  # By the names of `PARTS`

    @property
    def seen(self) -> float:
        """How much the recordings tell: how far the prior is narrowed, in units of its volume's
        logarithm.
        """
        return float(
            sum(
                np.linalg.slogdet(np.eye(len(p.right)) + p.information)[1]
                for p in self.parts.values()
            )
        )


class Learning(Enum):
    """How much is learnt; `value`: in files."""

    NOTHING = NOT_LEARNT
    OFFSET = "offset"
    SPREAD = "offset and spread"
    WHOLE = "offset, spread and correlations"


@dataclass(frozen=True, kw_only=True)
class PartPrior:
    """What a cohort teaches of one part of the body."""

    names: tuple[str, ...]
    learning: Learning
    by_size: bool
    wider: float  # Factor of the covariance of a new person
    populations: tuple[Population, ...]  # Of everybody, then without each fold
    gain: tuple[float, float]
    """Mean rise of the log likelihood of a person left out against the default prior, and its
    standard error.
    """


@dataclass(frozen=True)
class _Tried:
    """How much is learnt in one way, and how likely people are by it."""

    learning: Learning
    by_size: bool
    populations: tuple[Population, ...]
    evidence: Evidence
    folds: IntArray

    def densities(self, wider: float = 1.0) -> Array:
        """(N,) log density of each person by the others' population."""
        out = []
        for i, fold in enumerate(self.folds):
            mean, covariance = self.populations[fold + 1].expected(self.evidence.design[i])
            out.append(
                log_density(
                    self.evidence.information[i], self.evidence.right[i], mean, wider * covariance
                )
            )
        return np.array(out)

    def or_better(self, other: "_Tried") -> "_Tried":
        """The other one if people left out are likelier by it, and not by chance."""
        gain = other.densities() - self.densities()
        return other if gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)) else self


def folds_of(names: Sequence[str]) -> IntArray:
    """(N,) the fold of each person: dealt out in the order of their names, so that all are as
    large.
    """
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
    progress: Progress = silent,
) -> PartPrior:
    """What people teach of the joint parameters `names` of a part of the body."""
    heights, parts = heights_of(people), [person.parts[part] for person in people]

    def tried(learning: Learning, *, by_size: bool = False) -> _Tried:
        evidence = Evidence(
            information=np.array([p.information for p in parts]),
            right=np.array([p.right for p in parts]),
            design=np.array(
                [build_design(names, p.person, heights, by_size=by_size) for p in people]
            ),
        )
        populations = tuple(
            _population(evidence.of(np.flatnonzero(folds != k)), names, learning)
            for k in range(-1, max(folds) + 1)
        )
        return _Tried(learning, by_size, populations, evidence, folds)

    nothing = best = tried(Learning.NOTHING)
    if any(p.information.any() for p in parts):
        for learning in (Learning.OFFSET, Learning.SPREAD):
            progress(f"{part}: {learning.value}")
            best = best.or_better(tried(learning))
    if best is not nothing:
        progress(f"{part}: {Learning.WHOLE.value}")
        best = best.or_better(tried(Learning.WHOLE))
        progress(f"{part}: size and sex")
        best = best.or_better(tried(best.learning, by_size=True))
    widened = {wider: best.densities(wider) for wider in (WIDER if best is not nothing else (1.0,))}
    wider = max(widened, key=lambda factor: widened[factor].sum())
    gain = widened[wider] - nothing.densities()
    return PartPrior(
        names=names,
        learning=best.learning,
        by_size=best.by_size,
        wider=wider,
        populations=best.populations,
        gain=(float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain)))),
    )


def _population(evidence: Evidence, names: tuple[str, ...], learning: Learning) -> Population:
    """What these people teach; where nothing is learnt, the default prior."""
    count = evidence.design.shape[2]
    alike, opposite = build_sided_directions(names)
    if learning is Learning.NOTHING:
        nothing = np.zeros(count)
        return Population(
            effects=nothing, effect_covariance=np.diag(nothing), spread=np.eye(len(names))
        )
    reflected = build_mirror(names)
    # Axes go by how well recordings show them, so that what is seen tells nothing of what is not.
    seen = evidence.information.sum(axis=0)
    seen = 0.5 * (seen + reflected @ seen @ reflected.T)
    axes = np.hstack(
        [basis @ np.linalg.eigh(basis.T @ seen @ basis)[1] for basis in (alike, opposite)]
    )

    def learnt(common: float, spread: Array | None = None) -> Learnt:
        """Where the variance `common` is that of all people alike; `spread`: only how likely that
        is, given it.
        """
        effects = np.full(count, BY_SIZE)
        effects[: alike.shape[1]] = common
        rest = np.eye(len(names)) - common * alike @ alike.T
        if spread is not None or learning is Learning.OFFSET:
            return learn(
                evidence, effects, reflected, Structure(rest if spread is None else spread)
            )
        found = learn(evidence, effects, reflected, Structure(rest, SURE_OF_AXES, axes))
        if learning is Learning.WHOLE:
            found = learn(
                evidence, effects, reflected, Structure(found.population.spread, SURE_OF_ALL)
            )
        return found

    first = learnt(COMMON[0])
    likeliest = max(COMMON, key=lambda common: learnt(common, first.population.spread).rises[-1])
    return (first if likeliest == COMMON[0] else learnt(likeliest)).population
