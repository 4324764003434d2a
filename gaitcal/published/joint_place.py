"""Whether several printed figures together are rejected as a draw of the noise: where they lie among draws of ours.

The printed figures x are one draw of the noise, or so the question goes. Added to n draws of ours they make n + 1
draws of which none differs from the others; then no measure of how odd a draw looks among all n + 1 has a preference
either, and

    p = (number of the n + 1 that look as odd as x, or odder) / (n + 1)

is uniform on 1 / (n + 1), ..., 1 whatever the distribution (a permutation test; conformal p value, Vovk, Gammerman and
Shafer 2005). Two measures:

- *distance* in any direction: the squared Mahalanobis distance from the mean of all n + 1, with the covariance of all.
  Figures are errors, positive and skewed: their logarithms are compared;
- *low rank sum*: the sum over the figures of the draw's rank among the n + 1. It asks one thing, whether all figures
  are low at once, and finds that with far fewer draws.

Other draws of ours would have given another p. Its standard error is that over bootstrap samples of the draws, or the
binomial one where that is larger (of a p so small that hardly a draw of ours is as odd, the bootstrap knows nothing).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from gaitcal.arrays import Array
from gaitcal.published.claims import Claim, Verdict

LIMIT = 0.05
"""p below which the figures are rejected as a draw."""
SURE = 2.0
"""Standard errors that p has to be away from the limit, or the answer is undecided."""
BOOTSTRAPS = 200
_SAME = 1e-9
"""Relative difference of distances that is rounding, and relative size of a direction that is none."""


@dataclass(frozen=True)
class Place:
    """Where printed figures lie among draws."""

    p: float
    """NaN: too few draws to tell."""
    error: float
    """Standard error of `p` from the number of draws."""

    @property
    def verdict(self) -> Verdict:
        """`HOLDS`: not rejected as a draw; that they are one does not follow."""
        if np.isnan(self.p):
            return Verdict.NOT_RUN
        if abs(self.p - LIMIT) < SURE * self.error:
            return Verdict.UNDECIDED
        return Verdict.HOLDS if self.p >= LIMIT else Verdict.FAILS

    @property
    def words(self) -> str:
        """`0.012 +- 0.006 (rejected)`."""
        told = {
            Verdict.NOT_RUN: "too few draws",
            Verdict.UNDECIDED: "too near the limit to tell",
            Verdict.HOLDS: "not rejected",
            Verdict.FAILS: "rejected",
        }
        return f"{self.p:.2g} +- {self.error:.1g} ({told[self.verdict]})"


def joint_place(draws: Array, printed: Array) -> Place:
    """By distance, of the printed figures (d,) among draws (n, d), all positive."""
    return _with_error(joint_p, draws, printed)


def low_place(draws: Array, printed: Array) -> Place:
    """By low rank sum, of the printed figures (d,) among draws (n, d)."""
    return _with_error(low_p, draws, printed)


def joint_p(draws: Array, printed: Array) -> float:
    """P by distance.

    NaN for so few draws that none could be below `LIMIT`, or n <= d, where every draw lies as far.
    """
    count, width = draws.shape
    if count <= width or _too_few(count):
        return float("nan")
    logs = np.log(np.vstack([draws, printed]))
    apart = logs - logs.mean(axis=0)
    # Of orthonormal columns that span `apart`, the length of each row is its Mahalanobis distance up to a factor.
    columns, size, _ = np.linalg.svd(apart, full_matrices=False)
    distance = (columns[:, size > _SAME * size[0]] ** 2).sum(axis=1)
    return float(np.mean(distance >= distance[-1] * (1.0 - _SAME)))


def low_p(draws: Array, printed: Array) -> float:
    """P by low rank sum, one-sided; NaN for so few draws that none could be below `LIMIT`."""
    if _too_few(len(draws)):
        return float("nan")
    sums = rankdata(np.vstack([draws, printed]), axis=0).sum(axis=1)
    return float(np.mean(sums <= sums[-1]))


def _too_few(count: int) -> bool:
    return 1.0 / (count + 1) >= LIMIT


def _with_error(test: Callable[[Array, Array], float], draws: Array, printed: Array) -> Place:
    p, count = test(draws, printed), len(draws)
    if np.isnan(p):
        return Place(p, p)
    rng = np.random.default_rng(0)
    others = [test(draws[rng.integers(count, size=count)], printed) for _ in range(BOOTSTRAPS)]
    return Place(p, max(float(np.std(others)), float(np.sqrt(p * (1.0 - p) / count))))


def not_rejected(claim: str, published: str, place: Place, words: str) -> Claim:
    """The claim that printed figures together are not rejected as a draw."""
    return Claim(claim, published, words, place.verdict)
