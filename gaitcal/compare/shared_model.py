"""Joint parameters of a person from two sessions together, told in the segment frames of each.

Markers that are put on anew make other segment frames, so that the same joints have other parameters, theta_A and
theta_B. Each session's calibration (`calibration/joint_estimate.py`) says of its deviations d = theta - p0 from its
nominal joints: the estimate d^ with covariance C, in which the prior N(m0, P0) counts already. What its markers say
alone is S = C^-1 - P0^-1 (nothing negative), and S m = C^-1 d^ - P0^-1 m0, m being where the markers alone would have
it. Deviations x = d - m0 of a person in two sessions go together, but for where markers were put (Q, or P0 = F F^T
without what is the person's own, `parameter_differences.own_causes`):

    cov [x_A, x_B] = Pi = [P0, P0 - Q; P0 - Q, P0],    P0 - Q = F R R^T F^T (1 - 1e-9)    (R = 1 on one static trial),

    [x_A, x_B] = L^-1 [C_A^-1 x^_A, C_B^-1 x^_B],    L = diag(S_A, S_B) + Pi^-1,    covariance L^-1.

To first order that is one calibration of all trials with a static trial for each session: the trials' information meets
in full, and no trial is fitted again. It is about each session's own fit that the trials are taken as linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import prior_of, prior_root
from gaitcal.compare.difference import own_causes, told_parameters
from gaitcal.compare.stride_sets import Common, NotComparableError, Session
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.study.joint_prior import JointPrior

SAME = 1e-9  # What is the same in both sessions is it but for rounding
RANK = 1e-6  # Part of the largest standard error, in units of the prior, below which a direction would be known exactly


@dataclass(frozen=True, kw_only=True)
class JointKnowledge:
    """What one session knows of n joint parameters."""

    nominal: Array  # (n,) m, rad: p0
    fitted: Array  # (n,) m, rad
    covariance: Array  # (n, n) C


@dataclass(frozen=True, kw_only=True)
class SharedJoints:
    """Joint parameters of both sessions, from both."""

    names: tuple[str, ...]
    a: Array  # (n,) m, rad, in the frames of A
    b: Array  # (n,) the same in those of B
    influences: tuple[ErrorSources, ErrorSources]  # Their errors by source, of A and of B

    @property
    def errors(self) -> tuple[Array, Array]:
        """(n,) m, rad each: standard errors of A's and of B's."""
        one, other = (np.sqrt((i.parameters**2).sum(axis=1)) for i in self.influences)
        return one, other


def require_fit_to_share(a: Session, b: Session) -> None:
    """InputError where a session is refused, or its joint parameters were not calibrated by itself."""
    for session in (a, b):
        if session.verdict == "refused":
            raise NotComparableError("is refused: it has no say in a shared model", source=session.name)
        if session.leans_on_cohort:
            raise NotComparableError(
                "leans on priors of a cohort: calibrate it without to share a model", source=session.name
            )
        if session.influence is None:
            raise NotComparableError(
                "its joint parameters were not calibrated, which a shared model needs", source=session.name
            )
    (mean, spread), (other, wide) = (prior_of(JP_NAMES, session.prior) for session in (a, b))
    if (mean != other).any() or (spread != wide).any():
        raise NotComparableError(
            "their studies expect other joints ([calibration] joint_prior); calibrate both with one of them",
            source=f"{a.name}, {b.name}",
        )


def shared_joints(a: Session, b: Session, common: Common) -> SharedJoints:
    """The legs' joint parameters that both sessions told something of.

    Raises
    ------
    InputError
        A session is refused, its joint parameters were not calibrated, lean on a cohort, or had another prior.
    """
    require_fit_to_share(a, b)
    known = set(told_parameters(b.influence))
    names = tuple(n for n in told_parameters(a.influence) if n in known and n.startswith(LEG_JOINTS))
    if not names:
        raise NotComparableError("no joint parameter was fitted in both", source=f"{a.name}, {b.name}")
    return joined(names, knowledge(a, names), knowledge(b, names), common is Common.PERSON, a.prior)


def knowledge(session: Session, names: tuple[str, ...]) -> JointKnowledge:
    """What the result of a session says of `names`."""
    index = [JP_INDEX[name] for name in names]
    model, influence = session.model, session.influence
    if influence is None:
        raise NotComparableError("its joint parameters were not calibrated", source=session.name)
    rows = influence.parameters[[influence.free.index(name) for name in names]]
    sizes = np.linalg.svd(np.linalg.solve(prior_root(names, session.prior), rows), compute_uv=False)
    if rows.shape[1] < len(rows) or sizes[-1] <= RANK * sizes[0]:
        message = (
            "its joint errors are not those of the evidence of all trials (protocol = 'evidence'); calibrate again"
        )
        raise NotComparableError(message, source=session.name)
    return JointKnowledge(
        nominal=model.nominal.joint[index], fitted=model.parameters.joint[index], covariance=rows @ rows.T
    )


def joined(
    names: tuple[str, ...], a: JointKnowledge, b: JointKnowledge, placed_anew: bool, prior: JointPrior | None = None
) -> SharedJoints:
    """Both sessions' knowledge together.

    Parameters
    ----------
    placed_anew : each has a static trial of its own.
    prior : of both calibrations; anatomy's unless given.
    """
    count = len(names)
    mean, spread = prior_of(names, prior)
    root = prior_root(names, prior)
    own = root @ own_causes(names, prior) if placed_anew else root
    together = (1.0 - SAME) * (own @ own.T)
    precision = np.linalg.inv(np.block([[spread, together], [together, spread]]))
    roots = [_seen(root, k.covariance) for k in (a, b)]
    right = np.concatenate([np.linalg.solve(k.covariance, k.fitted - k.nominal - mean) for k in (a, b)])
    covariance = np.linalg.inv(block_diag(*(r @ r.T for r in roots)) + precision)
    moved = covariance @ right + np.tile(mean, 2)
    by_markers = covariance @ block_diag(*roots)
    by_nominal = covariance @ np.linalg.cholesky(precision)
    clusters = (
        *(f"markers/{session}/{k}" for session in ("A", "B") for k in range(count)),
        *(f"nominal/{name}" for name in names),
    )

    def errors_of(rows: slice) -> ErrorSources:
        compressed = np.asarray(np.linalg.qr(by_nominal[rows].T, mode="r")).T
        return ErrorSources(names, np.hstack([by_markers[rows], compressed]), clusters)

    halves = slice(0, count), slice(count, 2 * count)
    return SharedJoints(
        names=names,
        a=a.nominal + moved[halves[0]],
        b=b.nominal + moved[halves[1]],
        influences=(errors_of(halves[0]), errors_of(halves[1])),
    )


def _seen(root: Array, covariance: Array) -> Array:
    """(n, n) R with R R^T = C^-1 - (F F^T)^-1, nothing of it negative in units of the prior's root F."""
    values, vectors = np.linalg.eigh(root.T @ np.linalg.solve(covariance, root))
    out: Array = np.linalg.solve(root.T, vectors * np.sqrt(np.maximum(values - 1.0, 0.0)))
    return out
