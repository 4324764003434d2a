"""One estimate of all joint parameters: every trial, every parameter that a trial can move, the skin, and the motions.

    min  sum_t C_t(p, z, N_t) / nu_t^2  +  |(p - p_0) / sigma|^2  +  z^T Sigma^-1 z

C_t is the marker cost of trial t (a joint alone, or pelvis and legs for gait), N_t its motion, p the joint parameters
about p_0, their nominal values, sigma^2 the default prior's variance or p_0 and sigma^2 those that a cohort expects
(`joint_prior.py`), z the skin's movement where there is evidence of it
(`skin_evidence.py`), nu_t the noise of the trial's independent samples (`joint_noise.py`). Trials meet by their full
information, each in units of its own noise. Without skin the motions are eliminated (`reduced_problem.py`), which
follows the narrow valleys of ankles; skin is then found by steps of `descend` on the arrow of `motion/arrow.py`.

With H the Hessian at the end, motions eliminated, and S_t the part of trial t, the errors of (p, z) are

    -H^-1 ( sum_t S_t^1/2 n_t  -  sigma^-1 e_p  -  Sigma^-1/2 e_z ),      n, e_p, e_z independent, variance 1:

columns of an `Influence` by source: markers of each trial, nominal values, skin. Their squares sum to H^-1.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.noise_search import NearJoints, expected_joints, near_joints
from gaitcal.calibration.reduced_problem import NULL
from gaitcal.calibration.skin_movement import unit_covariance
from gaitcal.model.parameters import Parameters
from gaitcal.motion.arrow import ArrowEquations, ArrowFactor, SharedPrior, SharedTrials
from gaitcal.motion.descent import DescentSettings, descend
from gaitcal.motion.minimised import Evaluation
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.motion.undetermined import joints_left_open
from gaitcal.study.joint_prior import JointPrior

WITH_SKIN = DescentSettings(gain=1e-6, keep_within=0.0, goes_further=True, most_steps=60)
"""Costs are squares of standard errors here: what is then left to gain moves nothing by a fiftieth of its own."""


@dataclass(frozen=True, kw_only=True)
class JointEstimate:
    """Joint parameters, skin and motions found together."""

    free: tuple[str, ...]
    """Joint parameters."""
    keys: tuple[str, ...]
    """Columns of the skin, `coordinate/marker/axis`."""
    values: Array
    """(np + nz,) m, rad; m/rad."""
    parameters: Parameters
    nodes: tuple[Array, ...]
    """Per trial (nn, nq)."""
    noise: tuple[float, ...]
    """m, nu of every trial."""
    served: float
    """Parameters that the markers determined, rather than the priors: trace of H^-1 sum S_t."""
    iterations: int
    seconds: float
    converged: bool
    message: str

    @property
    def skin(self) -> Array:
        """(nz,) m/rad."""
        return self.values[len(self.free) :]


@dataclass(frozen=True)
class SkinPrior:
    """The columns of the skin that have evidence, and how large they may be."""

    keys: tuple[str, ...]
    covariance: Array
    """(nz, nz) m^2/rad^2."""


NO_SKIN = SkinPrior((), np.zeros((0, 0)))


def skin_prior(trials: Sequence[TrialProblem], sizes: Mapping[tuple[str, str], float]) -> SkinPrior:
    """The prior of the columns that trials have, for sizes by (segment, coordinate)."""
    keys: list[str] = []
    blocks: list[Array] = []
    for problem in trials:
        for group in problem.tissue.groups if problem.tissue else ():
            segment, labels = problem.chain.segments[group.segment], problem.labels[group.markers]
            unit = unit_covariance(segment, problem.data.local[group.markers])
            for name in group.names:
                own = [f"{name}/{label}/{axis}" for label in labels for axis in "xyz"]
                if not set(own) <= set(keys):
                    new = [k for k, key in enumerate(own) if key not in keys]
                    keys += [own[k] for k in new]
                    blocks.append(sizes[segment, name] ** 2 * unit[np.ix_(new, new)])
    return SkinPrior(tuple(keys), block_diag(*blocks) if blocks else np.zeros((0, 0)))


class _MarkersAndPriors(SharedTrials):
    """The cost by x = (joint parameters, skin, nodes of each trial)."""

    def __init__(
        self,
        problems: Sequence[TrialProblem],
        nominal: Parameters,
        free: tuple[str, ...],
        skin: SkinPrior,
        noise: Sequence[float],
        learnt: JointPrior | None,
    ) -> None:
        super().__init__(problems, nominal, free, skin.keys)
        self.share = [1.0 / nu**2 for nu in noise]
        self.nothing_left = 0.0
        expected, own = expected_joints(nominal, free, learnt)
        self.centre = np.concatenate([expected, np.zeros(len(skin.keys))])
        self.precision = block_diag(own, np.linalg.inv(skin.covariance)) if skin.keys else own

    def at(self, x: Array) -> tuple[list[TrialProblem], Parameters, Array, list[Array]]:
        """The trials with their skin, the linkage, (p, z) and the nodes at x."""
        theta, nodes = self.parted(x)
        moved = self.parameters.with_joint(self.free, theta[: len(self.free)])
        trials = [
            problem.displaced(theta[places[len(problem.chain.free) :]])
            for problem, places in zip(self.open, self.columns, strict=True)
        ]
        return trials, moved, theta, nodes

    def evaluate(self, x: Array) -> Evaluation:
        return self.linearise(x, curved=False).evaluation

    def linearise(self, x: Array, *, curved: bool) -> ArrowEquations:
        trials, moved, theta, nodes = self.at(x)
        equations = [
            problem.equations(n, problem.constants(moved)).scaled(share)
            for problem, n, share in zip(trials, nodes, self.share, strict=True)
        ]
        off = theta - self.centre
        pull = self.precision @ off
        return ArrowEquations(equations, self.columns, self.size, SharedPrior(float(off @ pull), pull, self.precision))

    def factor(self, x: Array) -> ArrowFactor:
        """The matrix at x with the motions eliminated."""
        return self.linearise(x, curved=False).factor(0.0)

    def placed(self, hessians: Sequence[Array]) -> list[Array]:
        """Per trial S_t among all (np + nz) unknowns, from those of its own (np_t, np_t)."""
        out = []
        for hessian, places in zip(hessians, self.columns, strict=True):
            whole = np.zeros((self.size, self.size))
            whole[np.ix_(places, places)] = hessian
            out.append(whole)
        return out


def free_of(problems: Sequence[TrialProblem], wanted: Sequence[str]) -> tuple[str, ...]:
    """The joint parameters of `wanted` that some trial can move: their joint lies between segments that it shows, and
    its markers determine the joint's angles.
    """
    passed = set()
    for problem in problems:
        opened = problem.with_free(tuple(wanted))
        shown = np.zeros(len(opened.chain.segments), dtype=bool)
        shown[opened.data.segment[(opened.data.weight > 0).any(axis=1)]] = True
        count = len(opened.chain.coordinates)
        beyond = opened.chain.support[count:] * shown
        before = (1.0 - opened.chain.support[count:]) * shown
        found = {name for name, b, a in zip(opened.chain.free, before, beyond, strict=True) if a.any() and b.any()}
        passed |= {name for name in found if name.split(".")[0] not in joints_left_open(problem.guessed)}
    return tuple(name for name in wanted if name in passed)


def estimate_joints(
    problems: Sequence[TrialProblem],
    nominal: Parameters,
    free: tuple[str, ...],
    *,
    skin: SkinPrior = NO_SKIN,
    near: NearJoints | None = None,
    learnt: JointPrior | None = None,
) -> tuple[JointEstimate, Influence]:
    """Fit the joint parameters `free` and the skin to all trials together, and tell their errors by source.

    Parameters
    ----------
    problems : trials with the soft tissue that `skin` is the prior of; without any where that has no columns.
    nominal : centre of the prior, and values of all that is not free.
    near : the same trials without skin, not far from the end; found here unless given. Its noise is kept: skin that is
        free explains noise, too.
    learnt : prior of a cohort, about `nominal`; the default prior unless given.
    """
    began = time.perf_counter()
    found_here = near is None
    near = near or near_joints([replace(p, tissue=None) for p in problems], nominal, free, learnt)
    noise, seconds = near.noise, 0.0 if found_here else near.seconds
    shared = _MarkersAndPriors(problems, nominal, free, skin, noise, learnt)
    if skin.keys:
        theta = np.concatenate([near.state.p, np.zeros(len(skin.keys))])
        end = descend(shared, shared.joined(theta, [trial.nodes for trial in near.state.trials]), WITH_SKIN)
        theta, nodes = shared.parted(end.x)
        parts = shared.placed([trial.hessian for trial in (end.factor or shared.factor(end.x)).trials])
        steps, converged, message = end.steps, end.converged, end.ending.value
    else:
        fit = near.search.run()
        theta, nodes = fit.values, list(fit.nodes)
        left = zip(shared.share, fit.state.trials, strict=True)
        parts = shared.placed([share * trial.matrices.hessian for share, trial in left])
        steps, converged, message = fit.iterations, fit.converged, fit.message
    inverse = np.linalg.inv(sum(parts) + shared.precision)
    estimate = JointEstimate(
        free=free,
        keys=skin.keys,
        values=theta,
        parameters=nominal.with_joint(free, theta[: len(free)]),
        nodes=tuple(nodes),
        noise=noise,
        served=float(np.trace(inverse @ sum(parts))),
        iterations=near.evaluations + steps,
        seconds=seconds + time.perf_counter() - began,
        converged=converged,
        message=message,
    )
    return estimate, _influence([p.name for p in problems], estimate, shared, parts, inverse)


def _influence(
    names: Sequence[str], estimate: JointEstimate, shared: _MarkersAndPriors, parts: Sequence[Array], inverse: Array
) -> Influence:
    """The errors of (p, z) by source."""
    columns, sources = [], []
    for name, part in zip(names, parts, strict=True):
        values, vectors = np.linalg.eigh(part)
        kept = values > NULL * max(float(values[-1]), 1e-300)
        columns.append(inverse @ (vectors[:, kept] * np.sqrt(values[kept])))
        sources += [f"markers/{name}/{k}" for k in range(int(kept.sum()))]
    count = len(estimate.free)
    columns.append(inverse[:, :count] @ np.linalg.cholesky(shared.precision[:count, :count]))
    sources += [f"nominal/{name}" for name in estimate.free]
    if estimate.keys:
        columns.append(inverse[:, count:] @ np.linalg.cholesky(shared.precision[count:, count:]))
        sources += [f"skin/{key}" for key in estimate.keys]
    return Influence((*estimate.free, *estimate.keys), np.hstack(columns), tuple(sources))
