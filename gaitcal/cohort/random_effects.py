"""Mean and spread of the joint parameters of people, of each of whom recordings tell something.

The recordings of person i say of the n deviations y_i (`study/people_design.py`), priors left out,

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

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gaitcal.arrays import Array, IntArray

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
    reflected : (n, n) the mirror (`people_design.mirror`).
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
