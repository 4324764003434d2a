"""Whether several printed figures together are an ordinary draw: where they lie among draws of the noise.

The printed figures x are one draw of the noise, or so the question goes. Added to n draws of ours they make n + 1
draws of which none differs from the others; the squared Mahalanobis distance of each from the mean of all n + 1, with
the covariance of all, then has no preference either, and

    p = (number of the n + 1 that lie as far from the mean as x, or farther) / (n + 1)

is uniform on 1 / (n + 1), ..., 1 whatever the distribution (a permutation test; conformal p value, Vovk, Gammerman and
Shafer 2005). Figures are errors, positive and skewed: their logarithms are compared.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.reproduction.claims import Claim, Verdict, tested

ORDINARY = 0.05
"""p from which on the figures count as an ordinary draw."""
_SAME = 1e-9
"""Relative difference of distances that is rounding, and relative size of a direction that is none."""


def joint_p(draws: Array, printed: Array) -> float:
    """P of the printed figures (d,) among draws (n, d), all positive.

    NaN for so few draws that none could be below `ORDINARY`, or n <= d, where every draw lies as far.
    """
    count, width = draws.shape
    if count <= width or 1.0 / (count + 1) >= ORDINARY:
        return float("nan")
    logs = np.log(np.vstack([draws, printed]))
    apart = logs - logs.mean(axis=0)
    # Of orthonormal columns that span `apart`, the length of each row is its Mahalanobis distance up to a factor.
    columns, size, _ = np.linalg.svd(apart, full_matrices=False)
    distance = (columns[:, size > _SAME * size[0]] ** 2).sum(axis=1)
    return float(np.mean(distance >= distance[-1] * (1.0 - _SAME)))


def ordinary(claim: str, published: str, p: float, words: str) -> Claim:
    """The claim that printed figures together are an ordinary draw, decided by their p."""
    if np.isnan(p):
        return Claim(claim, published, f"too few draws to tell: {words}", Verdict.NOT_RUN)
    return tested(claim, published, words, p >= ORDINARY)
