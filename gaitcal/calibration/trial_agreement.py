"""Agreement of trials: how many independent trials count, and disagreement of kinds of task.

Trials of one task repeat their errors. With g_t and H_t the reduced gradients and matrices by the
joint parameters p at the common estimate, in units of each trial's noise, K trials have independent
errors if

    chi^2 = sum_t g_t^T H_t^-1 g_t - (sum g_t)^T (sum H_t)^-1 (sum g_t)

has (K - 1) n degrees of freedom, over the n directions that they determine. If the share s of that
is smaller, they have 1 - s of their variance in common: together they count as
K / (s + K (1 - s)) trials, f = s + K (1 - s).

Kinds of task may disagree more than their errors allow: a cluster was put on again for one, or soft
tissue is not linear. With the same chi^2 between kinds, the soft tissue of each eliminated,
b^2 = max(chi^2 / degrees of freedom, 1) is the factor by which all variances are too small (Birge,
Phys Rev 40:207, 1932); the estimate stays.
"""

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.reduced_problem import ReducedState

# Information of trials over that of the prior from which they determine a direction
DETERMINED = 4.0


def count_effective_trials(
    kinds: Sequence[str],
    columns: Sequence[IntArray],
    state: ReducedState,
    noise: Sequence[float],
    precision: Array,
) -> dict[str, float]:
    """Compute f of each kind of task with several trials.

    Parameters
    ----------
    kinds : sequence of str
        Kind of task of each trial.
    columns : sequence of (nx_t,) array
        Unknowns of each trial among all; those below np are joint parameters.
    state : ReducedState
        All trials at the common estimate.
    noise : sequence of float
        Noise of each trial, m.
    precision : (np, np) array
        Precision of the joint parameters before any trial.

    Returns
    -------
    dict of str to float
        Kind -> f; none for kinds with one trial.
    """
    out, count = dict[str, float](), len(precision)
    for kind in dict.fromkeys(kinds):
        members = [k for k, task in enumerate(kinds) if task == kind]
        if len(members) < 2:
            continue
        scores, informations = [], []
        for k in members:
            trial, places = state.trials[k], columns[k]
            joint = places < count
            score = np.zeros(count)
            score[places[joint]] = trial.reduced_gradient[joint] / noise[k] ** 2
            scores.append(score)
            informations.append(
                _place_block(
                    trial.hessian[np.ix_(joint, joint)] / noise[k] ** 2, places[joint], count
                )
            )
        share = _estimate_independent_share(scores, informations, precision)
        out[kind] = share + len(members) * (1.0 - share)
    return out


def _estimate_independent_share(
    scores: Sequence[Array], informations: Sequence[Array], precision: Array
) -> float:
    """Estimate s of K scores (n,) with matrices (n, n): chi^2 per degree of freedom, at most 1."""
    root = np.linalg.inv(np.linalg.cholesky(precision)).T
    values, vectors = np.linalg.eigh(root.T @ sum(informations) @ root)
    base = root @ vectors[:, values > DETERMINED]
    if not base.shape[1]:
        return 1.0
    total, chi2 = base.T @ sum(scores), 0.0
    for score, information in zip(scores, informations, strict=True):
        part, along = base.T @ information @ base, base.T @ score
        part += 1e-9 * np.trace(part) / len(part) * np.eye(len(part))
        chi2 += float(along @ np.linalg.solve(part, along))
    chi2 -= float(total @ np.linalg.solve(base.T @ sum(informations) @ base, total))
    return float(min(chi2 / ((len(scores) - 1) * base.shape[1]), 1.0))


def compute_birge_ratio(state: ReducedState, precision: Array) -> float:
    """Compute the factor b by which kinds of task disagree.

    Parameters
    ----------
    state : ReducedState
        All kinds at the common estimate.
    precision : (np, np) array
        Precision of the joint parameters before any trial.

    Returns
    -------
    float
        At least 1.
    """
    root = np.linalg.inv(np.linalg.cholesky(precision)).T

    def spread(score: Array, information: Array) -> Array:
        """Chi^2 and its degrees of freedom, of the directions that are determined."""
        values, vectors = np.linalg.eigh(root.T @ information @ root)
        known = values > DETERMINED
        return np.array(
            [(((root @ vectors[:, known]).T @ score) ** 2 / values[known]).sum(), known.sum()]
        )

    kept = [spread(kind.gradient, kind.hessian) for kind in state.kinds]
    chi2, degrees = np.sum(kept, axis=0) - spread(state.gradient, state.hessian)
    return float(np.sqrt(max(chi2 / degrees, 1.0))) if degrees else 1.0


def _place_block(part: Array, places: IntArray, size: int) -> Array:
    """Place a block at some rows and columns of a zero matrix (size, size)."""
    out = np.zeros((size, size))
    out[np.ix_(places, places)] = part
    return out
