"""Learn the prior of joint parameters that a cohort supports, by cross-validation over people.

The anatomical prior of every deviation is N(0, 1) in its units (`learn_priors.py`). A part of that
variance (`COMMON`) is the same in all people along directions in which both sides deviate alike: an
error of the nominal model. More and more is learnt (`Learning`): nothing; the mean of people; their
spread along each direction that their recordings determine; all correlations; effects of size and
sex. People are divided into folds. A step is taken if people of a fold are more likely by what the
other folds give, by more than the standard error of that gain. A spread that is too narrow for
people left out is widened until it fits.

The recordings of person i have, of the n deviations y_i (`study/cohort_prior.py`), the likelihood

    log p(recordings | y) = r_i^T y - y^T S_i y / 2 + constant,
    S_i the information, r_i = S_i m_i,

where S_i may be singular: directions that recordings do not determine add nothing. People are y_i =
X_i w + u_i with u_i ~ N(0, Sigma) and w ~ N(0, W), W the part of the default prior that may be an
error of the nominal model in all of them. With P = Sigma^-1, L_i = (S_i + P)^-1, G_i = S_i - S_i
L_i S_i and g_i = r_i - S_i L_i r_i, and w integrated out (restricted likelihood; Laird and Ware
1982),

    w | all ~ N(A^-1 g, A^-1),      A = W^-1 + sum_i X_i^T G_i X_i,    g = sum_i X_i^T g_i,
    u_i | all:  mean L_i (r_i - S_i X_i w),  covariance L_i + L_i S_i X_i A^-1 X_i^T S_i L_i,
    2 log p = sum_i (r_i^T L_i r_i - log det(1 + Sigma S_i)) + g^T A^-1 g - log det(A W).

Sigma follows by expectation and maximisation (Dempster, Laird and Rubin 1977) from sum_i E[u_i
u_i^T] with its mirror image, under the prior of a `Structure`: with few people Sigma stays near its
first value, and along directions that no recordings determine it keeps it.
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

MOST_STEPS = 50
"""Largest number of steps of the iteration."""
RISE = 5e-3
"""Rise of the log likelihood of each person at which the iteration ends."""
COMMON = (0.5, 0.2, 0.05)
"""Parts of the default variance that may be the same in all people; the most likely is taken."""
BY_SIZE = 0.25
"""Prior variance of the effect of 10 cm of height, and of sex."""
FEWEST, FOLDS = 8, 8
"""Fewest people to learn from; number of folds."""
SURE_OF_AXES = 3.0
"""Number of people that the first spread counts for, while variances along axes are learnt."""
SURE_OF_ALL = 30.0
"""The same while correlations are learnt."""
WIDER = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
"""Factors by which the spread may be widened."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Likelihood of n deviations by the recordings of N people."""

    information: Array
    """(N, n, n) S."""
    right: Array
    """(N, n) r."""
    design: Array
    """(N, n, k) X."""

    def select(self, chosen: IntArray) -> "Evidence":
        """Select people by their indices."""
        return Evidence(
            information=self.information[chosen],
            right=self.right[chosen],
            design=self.design[chosen],
        )


@dataclass(frozen=True)
class Structure:
    """Form of Sigma and its prior, which counts for `weight` people with the spread `first`."""

    first: Array
    """(n, n) Sigma before any data."""
    weight: float = np.inf
    """Infinite: Sigma is not learnt."""
    directions: Array | None = None
    """(n, n) orthonormal columns along which people are independent; None: any spread."""

    def update_spread(self, moment: Array, people: int) -> Array:
        """Compute the most likely Sigma.

        `moment`: (n, n) sum_i E[u u^T], averaged with its mirror image. `people`: number of people
        in the sum. Returns: (n, n).
        """
        spread: Array = (self.weight * self.first + moment) / (self.weight + people)
        if self.directions is not None:
            along = np.einsum("ik,ij,jk->k", self.directions, spread, self.directions)
            spread = (self.directions * along) @ self.directions.T
        return spread

    def compute_log_prior(self, spread: Array) -> float:
        """Compute twice the log density of the prior of Sigma (n, n), up to a constant."""
        if np.isinf(self.weight):
            return 0.0
        ratio = np.linalg.solve(spread, self.first)
        return float(self.weight * (np.linalg.slogdet(ratio)[1] - np.trace(ratio)))


@dataclass(frozen=True, kw_only=True)
class Population:
    """Distribution of people."""

    effects: Array
    """(k,) w."""
    effect_covariance: Array
    """(k, k) covariance of w."""
    spread: Array
    """(n, n) Sigma."""

    def predict(self, design: Array) -> tuple[Array, Array]:
        """Predict the deviations of a further person.

        Parameters
        ----------
        design : (n, k) array
            X of the person.

        Returns
        -------
        mean : (n,) array
        covariance : (n, n) array
        """
        return design @ self.effects, self.spread + design @ self.effect_covariance @ design.T


@dataclass(frozen=True)
class Learnt:
    """A learnt population, with the course of its likelihood."""

    population: Population
    likelihoods: tuple[float, ...]
    """Twice the penalised log likelihood before each step."""


def learn(evidence: Evidence, effects: Array, reflected: Array, structure: Structure) -> Learnt:
    """Learn mean and spread of people.

    Parameters
    ----------
    evidence : Evidence
        Of N people.
    effects : (k,) array
        Prior variances W of the effects.
    reflected : (n, n) array
        The mirror between both sides (`cohort_prior.build_mirror`).
    structure : Structure
        Form and prior of the spread.

    Returns
    -------
    Learnt
    """
    information, right, design = evidence.information, evidence.right, evidence.design
    across, people = np.swapaxes(design, 1, 2), len(right)
    spread, likelihoods = structure.first, list[float]()
    while True:
        # L = (S + Sigma^-1)^-1, then S L, g = r - S L r and A.
        inverse = np.linalg.inv(information + np.linalg.inv(spread))
        weighted = information @ inverse
        score = right - np.einsum("nij,nj->ni", weighted, right)
        normal = np.diag(1.0 / effects) + (
            across @ (information - weighted @ information) @ design
        ).sum(axis=0)
        covariance = np.linalg.inv(normal)
        gradient = np.einsum("nik,ni->k", design, score)
        found = covariance @ gradient
        # Twice the log likelihood of all recordings.
        determinants = np.linalg.slogdet(np.eye(len(spread)) + spread @ information)[1]
        likelihood = (
            np.einsum("ni,nij,nj->", right, inverse, right, optimize=True) - determinants.sum()
        )
        likelihood += gradient @ found - np.linalg.slogdet(normal * effects)[1]
        likelihoods.append(float(likelihood) + structure.compute_log_prior(spread))
        ended = len(likelihoods) > 1 and likelihoods[-1] - likelihoods[-2] < RISE * people
        # A fixed spread needs one step only. Otherwise expectation maximisation ends when the
        # likelihood rises no further.
        if np.isinf(structure.weight) or not people or ended or len(likelihoods) > MOST_STEPS:
            population = Population(effects=found, effect_covariance=covariance, spread=spread)
            return Learnt(population, tuple(likelihoods))
        # Expected second moment of u: its mean, its covariance, and L S X times that of w.
        residual = right - np.einsum("nij,nj->ni", information, design @ found)
        mean = np.einsum("nij,nj->ni", inverse, residual)
        by_effects = np.swapaxes(weighted, 1, 2) @ design
        moment = inverse.sum(axis=0) + mean.T @ mean
        moment = moment + np.einsum(
            "nik,kl,njl->ij", by_effects, covariance, by_effects, optimize=True
        )
        spread = structure.update_spread(0.5 * (moment + reflected @ moment @ reflected.T), people)


def compute_log_density(information: Array, right: Array, mean: Array, covariance: Array) -> float:
    """Compute the log density of one person's recordings under a prior.

    Parameters
    ----------
    information : (n, n) array
        S of the recordings.
    right : (n,) array
        r of the recordings.
    mean, covariance : (n,) and (n, n) array
        Of the prior.

    Returns
    -------
    float
        Up to a constant of the recordings; 0 if they determine nothing.
    """
    residual = right - information @ mean
    inner = np.eye(len(right)) + covariance @ information
    explained = residual @ np.linalg.solve(inner, covariance @ residual)
    size = np.linalg.slogdet(inner)[1]
    return float(right @ mean - 0.5 * mean @ information @ mean + 0.5 * (explained - size))


@dataclass(frozen=True, kw_only=True)
class PartEvidence:
    """Likelihood of the n joint parameters of a part, in units of the anatomical prior."""

    information: Array
    """(n, n) S."""
    right: Array
    """(n,) r = S m."""


@dataclass(frozen=True, kw_only=True)
class PersonEvidence:
    """Likelihood of one person's joint parameters, from one session."""

    name: str
    person: Person
    recordings: frozenset[str]
    """SHA-256 of the recordings of all sessions."""
    parts: dict[str, PartEvidence]
    """By the names of `PARTS`."""

    @property
    def information_gain(self) -> float:
        """Logarithm of the factor by which the recordings reduce the volume of the prior."""
        gains = [
            np.linalg.slogdet(np.eye(len(part.right)) + part.information)[1]
            for part in self.parts.values()
        ]
        return float(sum(gains))


class Learning(Enum):
    """How much is learnt; the value is in files."""

    NOTHING = NOT_LEARNT
    OFFSET = "offset"
    SPREAD = "offset and spread"
    WHOLE = "offset, spread and correlations"


@dataclass(frozen=True, kw_only=True)
class PartPrior:
    """The learnt prior of one part of the body."""

    names: tuple[str, ...]
    learning: Learning
    by_size: bool
    wider: float
    """Factor of the covariance of a further person."""
    populations: tuple[Population, ...]
    """Of all people, then without each fold."""
    gain: tuple[float, float]
    """Mean rise of the log likelihood of a person left out over the default prior, and its standard
    error.
    """


@dataclass(frozen=True)
class _Candidate:
    """One candidate for the prior of a part, with the people that test it."""

    learning: Learning
    by_size: bool
    populations: tuple[Population, ...]
    evidence: Evidence
    folds: IntArray

    def compute_log_densities(self, wider: float = 1.0) -> Array:
        """Compute (N,) log density of each person by the population of the other folds."""
        evidence, out = self.evidence, []
        for i, fold in enumerate(self.folds):
            mean, covariance = self.populations[fold + 1].predict(evidence.design[i])
            out.append(
                compute_log_density(
                    evidence.information[i], evidence.right[i], mean, wider * covariance
                )
            )
        return np.array(out)

    def choose_better(self, other: "_Candidate") -> "_Candidate":
        """Choose the other one if people left out are more likely by it, and not by chance."""
        gain = other.compute_log_densities() - self.compute_log_densities()
        return other if gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)) else self


def assign_folds(names: Sequence[str]) -> IntArray:
    """Assign people to folds of equal size, in the order of their names.

    Parameters
    ----------
    names : sequence of str
        Of N people.

    Returns
    -------
    (N,) array of int
    """
    order = np.argsort(np.array(names, dtype=str), kind="stable")
    out = np.empty(len(names), dtype=np.intp)
    out[order] = np.arange(len(names)) % min(FOLDS, max(len(names), 1))
    return out


def get_height_range(people: Sequence[PersonEvidence]) -> tuple[float, float]:
    """Get the heights (m) of the smallest and the tallest person."""
    heights = [p.person.height for p in people]
    return min(heights), max(heights)


def learn_part(
    part: str,
    names: tuple[str, ...],
    people: Sequence[PersonEvidence],
    folds: IntArray,
    progress: Progress = silent,
) -> PartPrior:
    """Learn the prior of the joint parameters of a part of the body.

    Parameters
    ----------
    part : str
        Name of the part.
    names : tuple of str
        Its joint parameters.
    people : sequence of PersonEvidence
        To learn from, each person once.
    folds : (N,) array of int
        Fold of each person.
    progress : callable
        Called with a line of text at the beginning of each step.

    Returns
    -------
    PartPrior
    """
    # Candidates of growing freedom; a richer one must predict people better that it has not learnt
    # from.
    heights, parts = get_height_range(people), [person.parts[part] for person in people]

    def make_candidate(learning: Learning, *, by_size: bool = False) -> _Candidate:
        design = [build_design(names, p.person, heights, by_size=by_size) for p in people]
        evidence = Evidence(
            information=np.array([p.information for p in parts]),
            right=np.array([p.right for p in parts]),
            design=np.array(design),
        )
        # Fold -1 is empty: the first population is of all people.
        populations = tuple(
            _learn_population(evidence.select(np.flatnonzero(folds != k)), names, learning)
            for k in range(-1, max(folds) + 1)
        )
        return _Candidate(learning, by_size, populations, evidence, folds)

    nothing = best = make_candidate(Learning.NOTHING)
    if any(p.information.any() for p in parts):
        for learning in (Learning.OFFSET, Learning.SPREAD):
            progress(f"{part}: {learning.value}")
            best = best.choose_better(make_candidate(learning))
    if best is not nothing:
        progress(f"{part}: {Learning.WHOLE.value}")
        best = best.choose_better(make_candidate(Learning.WHOLE))
        progress(f"{part}: size and sex")
        best = best.choose_better(make_candidate(best.learning, by_size=True))
    # A prior that is too narrow for new people is widened by the factor that predicts them best.
    factors = WIDER if best is not nothing else (1.0,)
    widened = {wider: best.compute_log_densities(wider) for wider in factors}
    wider = max(widened, key=lambda factor: widened[factor].sum())
    gain = widened[wider] - nothing.compute_log_densities()
    return PartPrior(
        names=names,
        learning=best.learning,
        by_size=best.by_size,
        wider=wider,
        populations=best.populations,
        gain=(float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain)))),
    )


def _learn_population(evidence: Evidence, names: tuple[str, ...], learning: Learning) -> Population:
    """Learn the population of some people; the default prior if nothing is to be learnt."""
    count = evidence.design.shape[2]
    alike, opposite = build_sided_directions(names)
    if learning is Learning.NOTHING:
        nothing = np.zeros(count)
        return Population(
            effects=nothing, effect_covariance=np.diag(nothing), spread=np.eye(len(names))
        )
    reflected = build_mirror(names)
    # Axes are the eigenvectors of the information, so that directions that recordings determine
    # change nothing along those that they do not determine.
    information = evidence.information.sum(axis=0)
    information = 0.5 * (information + reflected @ information @ reflected.T)
    axes = np.hstack(
        [basis @ np.linalg.eigh(basis.T @ information @ basis)[1] for basis in (alike, opposite)]
    )

    def learn_with_common(common: float, spread: Array | None = None) -> Learnt:
        """Learn with a variance that is the same in all people; `spread` is kept if given."""
        effects = np.full(count, BY_SIZE)
        effects[: alike.shape[1]] = common
        # What people have in common is no longer a difference between them.
        individual = np.eye(len(names)) - common * alike @ alike.T
        if spread is not None or learning is Learning.OFFSET:
            fixed = Structure(individual if spread is None else spread)
            return learn(evidence, effects, reflected, fixed)
        found = learn(evidence, effects, reflected, Structure(individual, SURE_OF_AXES, axes))
        if learning is Learning.WHOLE:
            found = learn(
                evidence, effects, reflected, Structure(found.population.spread, SURE_OF_ALL)
            )
        return found

    first = learn_with_common(COMMON[0])

    def compute_likelihood(common: float) -> float:
        return learn_with_common(common, first.population.spread).likelihoods[-1]

    # Empirical Bayes: the common variance under which the recordings are most likely.
    likeliest = max(COMMON, key=compute_likelihood)
    if likeliest == COMMON[0]:
        return first.population
    return learn_with_common(likeliest).population
