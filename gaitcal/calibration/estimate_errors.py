"""Errors of a joint estimate by source: markers of each trial, priors, fixed parameters.

With H the Hessian at the end, motions eliminated, and S_t the part of trial t, the errors of (p, z)
are

    -H^-1 ( sum_t b S_t^1/2 n_t  -  Sigma_p^-1 F_p e_p  -  Sigma_z^-1 F_z e_z ),

    n, e_p, e_z independent, variance 1:

F F^T = Sigma, the columns of F_p being causes (`joint_prior.py`): columns of an `ErrorSources` by
source, markers of each trial, nominal values, soft tissue (`error_sources.py`). Their squares sum
to H^-1.

What is uncertain and not fitted, k, is considered (Schmidt-Kalman): joint parameters that are kept,
and z if it stays zero. With S_pk of the same trials with k open, and errors R_k R_k^T of k, it
makes errors -H^-1 S_pk R_k. Residuals do not show these errors: soft tissue that moves in
proportion to a joint angle has the same effect as a joint in another position.
"""

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.reduced_problem import NULL, ReducedProblem
from gaitcal.calibration.tissue_elimination import Arrow
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.tracking.banded import eliminate
from gaitcal.tracking.trial_problem import MotionProblem


def list_columns(problem: ReducedProblem, arrow: Arrow) -> list[IntArray]:
    """List the indices of each trial's unknowns among those of all kinds.

    Parameters
    ----------
    problem : ReducedProblem
        All trials.
    arrow : Arrow
        Matrix of all kinds: joint parameters first, then the soft tissue, kind by kind.

    Returns
    -------
    list of (nx_t,) array
        One for each trial.
    """
    count = len(problem.free)
    out = [np.zeros(0, dtype=np.intp)] * len(problem.columns)
    for members, places in zip(problem.members, arrow.places, strict=True):
        every = np.concatenate([np.arange(count), places])
        for t in members:
            out[t] = every[problem.columns[t]]
    return out


def compute_covariance(
    arrow: Arrow, parts: Sequence[Array], columns: Sequence[IntArray], sizes: Sequence[float]
) -> Array:
    """Compute the covariance (np, np) of joint parameters by priors and by the noise of trials.

    Parameters
    ----------
    arrow : Arrow
        H at the estimate.
    parts : sequence of (nx_t, nx_t) array
        S_t of each trial.
    columns : sequence of (nx_t,) array
        From `list_columns`.
    sizes : sequence of float
        Noise of each trial over the noise that it was weighed by.

    Returns
    -------
    (np, np) array
        m^2, rad^2.

    Notes
    -----
    The rows of H^-1 of joint parameters are C [1, -F_1^T, -F_2^T, ...], with their covariance C and
    the sensitivity F_k of z_k.
    """
    along = np.vstack([np.eye(len(arrow.precision)), *(-kind.sensitivity for kind in arrow.kinds)])
    spread = arrow.precision.copy()
    for kind in arrow.kinds:
        spread += kind.sensitivity.T @ kind.prior.precision @ kind.sensitivity
    for part, places, size in zip(parts, columns, sizes, strict=True):
        spread += size**2 * (along[places].T @ part @ along[places])
    covariance = arrow.covariance @ spread @ arrow.covariance
    return np.asarray(0.5 * (covariance + covariance.T), float)


def compute_scores(
    trials: Sequence[str],
    unknowns: tuple[str, ...],
    parts: Sequence[Array],
    columns: Sequence[IntArray],
    sizes: Sequence[float],
) -> ErrorSources:
    """Compute b S_t^1/2 n_t of every trial, in independent columns of variance 1.

    Parameters
    ----------
    trials : sequence of str
        Names of the trials.
    unknowns : tuple of str
        Joint parameters, then soft tissue.
    parts, columns, sizes
        As in `compute_covariance`.

    Returns
    -------
    ErrorSources
        Half gradients by the unknowns; each column is a source `markers/TRIAL/number`.
    """
    scores, sources = [], []
    for name, part, places, size in zip(trials, parts, columns, sizes, strict=True):
        values, vectors = np.linalg.eigh(part)
        kept = values > NULL * max(float(values.max(initial=0.0)), 1e-300)
        of_trial = np.zeros((len(unknowns), int(kept.sum())))
        of_trial[places] = vectors[:, kept] * np.sqrt(values[kept]) * size
        scores.append(of_trial)
        sources += [f"markers/{name}/{k}" for k in range(of_trial.shape[1])]
    return ErrorSources(unknowns, np.hstack(scores), tuple(sources))


def compute_coupling(
    problems: Sequence[MotionProblem],
    parameters: Parameters,
    values: Array,
    coefficients: Sequence[Array],
    unknowns: tuple[str, ...],
    considered: tuple[str, ...],
    noise: Sequence[float],
) -> Array:
    """Compute S_pk (np + nz, nk): effect of errors of fixed unknowns on the scores of fitted ones.

    Parameters
    ----------
    problems : sequence of MotionProblem
        The trials, with the columns of soft tissue even if it was not fitted.
    parameters : Parameters
        At the estimate.
    values : (np + nz,) array
        Of the fitted unknowns, m and rad.
    coefficients : sequence of (nn, nq) array
        Motion of each trial.
    unknowns, considered : tuple of str
        Fitted and fixed ones. Fixed ones that no trial depends on have no effect.
    noise : sequence of float
        Noise that each trial was weighed by, m.

    Returns
    -------
    (np + nz, nk) array
        Half second derivatives of the weighted cost.
    """
    if not considered:
        return np.zeros((len(unknowns), 0))
    names, found = (*unknowns, *considered), dict(zip(unknowns, values.tolist(), strict=True))
    out = np.zeros((len(names), len(names)))
    joints = tuple(name for name in names if name in JP_INDEX)
    for problem, motion, nu in zip(problems, coefficients, noise, strict=True):
        opened = problem.with_free(joints)
        z = [found.get(name, 0.0) for name in opened.unknowns[opened.joint_parameters :]]
        moved = opened.displace(np.array(z)) if z else opened
        of_trial = eliminate(moved.assemble_equations(motion, moved.build_body(parameters)))
        places = moved.locate_in(names)
        out[np.ix_(places, places)] += of_trial.hessian / nu**2
    return out[: len(unknowns), len(unknowns) :]
