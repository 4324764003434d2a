"""The standard error of a difference between two sessions, and the least difference that they could not have missed.

Of a figure with the mean m_s over the n_s strides of session s, d = m_B - m_A,

    se^2 = t^2 v (1 / n_A + 1 / n_B) + c^2,        mdc95 = 1.96 se.

v is the variance between strides, pooled (Student's two-sample test): of this figure in both sessions and, where these
give fewer than `ENOUGH` degrees of freedom, in both legs; t widens it for being known from few strides, by the 97.5 %
point of Student's distribution against that of the normal one. Measurement error of the single stride is in v. c is
what the errors c_A, c_B that all strides of a session share leave in the difference:

    one model            c = |c_A - c_B|                      one error, and as large as the posture makes it in each
    one static trial     c^2 = (f_A - f_B)^2 + (c_A^2 - f_A^2) + (c_B^2 - f_B^2),     f: axes and masses
    a static trial each  c^2 = c_A^2 + c_B^2
    and shared joints    c^2 = (j_A - j_B)^2 + f_A^2 + f_B^2,      j^2 = c^2 - f^2

Errors of the joint parameters that two calibrations on one static trial share through its nominal joints, and of the
same force plates, are taken as independent here: c is then rather too large. How a person walks differently on another
day is no error of a recording, and in none of these figures: two sessions do not tell it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gaitcal.arrays import Array
from gaitcal.compare.session import Common

MDC = 1.96
"""Standard errors: the normal distribution's 97.5 % point."""
ENOUGH = 8
"""Degrees of freedom from which the leg's own strides tell their spread."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How strides vary."""

    variance: Array
    """(m,) v; NaN where no session has two strides."""
    freedom: Array
    """(m,) degrees of freedom."""


def pooled(groups: Sequence[Array]) -> Spread:
    """Of strides in groups (n, m), each about its own mean."""
    squares = np.array([_squares(group) for group in groups])
    freedom = np.array([np.maximum(np.isfinite(group).sum(axis=0) - 1, 0) for group in groups]).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return Spread(variance=np.where(freedom > 0, squares.sum(axis=0) / freedom, np.nan), freedom=freedom)


def spread_of(here: Sequence[Array], other_leg: Sequence[Array]) -> Spread:
    """Of this leg's strides in both sessions; of both legs' where those are few."""
    alone = pooled(here)
    if not other_leg:
        return alone
    both = pooled([*here, *other_leg])
    few = alone.freedom < ENOUGH
    return Spread(
        variance=np.where(few, both.variance, alone.variance), freedom=np.where(few, both.freedom, alone.freedom)
    )


def stride_part(spread: Spread, n_a: Array, n_b: Array) -> Array:
    """(m,) variance of the difference of two means by strides; NaN where nothing tells how they vary."""
    factor = np.where(spread.freedom > 0, student.ppf(0.975, np.maximum(spread.freedom, 1)) / MDC, np.nan)
    both = (n_a > 0) & (n_b > 0)
    each = np.where(both, 1.0 / np.maximum(n_a, 1) + 1.0 / np.maximum(n_b, 1), np.nan)
    out: Array = factor**2 * spread.variance * each
    return out


def shared_variance(common: Common, shared: tuple[Array, Array], frames: tuple[Array, Array]) -> Array:
    """c^2 of errors (m,) that all strides of session A and of session B share."""
    a, b = shared
    if common in (Common.MODEL, Common.SHARED_FRAMES):
        return np.asarray((a - b) ** 2)
    if common is Common.SHARED_JOINTS:
        (f_a, f_b), (j_a, j_b) = frames, (np.sqrt(a**2 - frames[0] ** 2), np.sqrt(b**2 - frames[1] ** 2))
        return np.asarray((j_a - j_b) ** 2 + f_a**2 + f_b**2)
    if common is Common.STATIC:
        f_a, f_b = frames
        return np.asarray((f_a - f_b) ** 2 + (a**2 - f_a**2) + (b**2 - f_b**2))
    return np.asarray(a**2 + b**2)


def _squares(values: Array) -> Array:
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, values, 0.0).sum(axis=0) / count
    out: Array = np.where(known, (values - mean) ** 2, 0.0).sum(axis=0)
    return out
