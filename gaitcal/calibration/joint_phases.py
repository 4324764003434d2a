"""The order of joint-parameter calibration: isolated trials joint by joint, then gait; or everything at once.

Sequential, an isolated trial is fitted by its joint alone: the proximal segment is free in the laboratory, so that an
uncalibrated neighbour joint has no say; gait trials are fitted by the whole linkage. Cumulative, gait adds to what the
isolated trials know: their reduced Gauss-Newton matrices stay in its cost, about their own solutions, each in units of
its own independent noise (`influence.py`). Simultaneous, every trial is fitted by pelvis and legs, whose joints are
all free: each trial then also says what it knows of its neighbours, and no nominal joint is left to pull.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.calibration.identifiability import (
    beyond_bounds,
    in_words,
    small_turns,
    turns_of,
    unmoved_parameters,
    unseen_parameters,
)
from gaitcal.calibration.influence import (
    LEAST_NOISE,
    Influence,
    MarkerEvidence,
    independent_noise,
    influence_of,
    marker_evidence,
    nominal_influence,
)
from gaitcal.calibration.joint_calibration import JointFit, JointSettings, calibrate_joints
from gaitcal.findings import Finding
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES, isolated_parameters
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import TrialProblem

PRIORS_OWN = 0.5
"""Where less than this part of the noise is found that priors were weighed against, they may have made most of it
themselves: it is looked for again after a fit with what was found."""


@dataclass(frozen=True)
class JointTrial:
    """A trial that takes part in joint calibration."""

    alone: TrialProblem
    """An isolated trial on the segments of its joint; gait on the whole body."""
    legs: TrialProblem
    """The trial on the pelvis and the leg that moves, or both legs for gait."""
    joint: str | None
    """The joint of an isolated trial; None for gait."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """One phase of a calibration, for the summary."""

    name: str
    trials: tuple[str, ...]
    parameters: int
    iterations: int
    seconds: float
    converged: bool
    message: str
    marker_noise: float | None = None
    """m, the independent noise that priors were weighed against; None where there were none."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Trial, or `trial, joint alone` -> m, the noise of its independent samples, where each has its own."""

    @property
    def status(self) -> str:
        """`converged` or `not converged`."""
        return "converged" if self.converged else "not converged"


@dataclass(frozen=True, kw_only=True)
class JointCalibration:
    """All phases together."""

    parameters: Parameters
    phases: tuple[Phase, ...]
    free: tuple[str, ...]
    """Every joint parameter that was fitted."""
    influence: Influence
    """Of every source of error on all joint parameters, fitted or not."""
    unidentifiable: tuple[str, ...]
    """Parameters that were to be fitted and that the trials cannot see; they keep their nominal value, or stay where
    their prior holds them."""
    findings: tuple[Finding, ...]
    """What speaks against it, and what these trials cannot see."""
    at_bound: tuple[str, ...] = ()
    """Fitted parameters on their bound, or beyond."""
    notes: tuple[str, ...] = ()
    """What the user should know and need not act upon."""
    fits: tuple[JointFit, ...] = ()
    """One a phase, where phases follow each other and trials keep the parameters of their own."""
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of its soft tissue on the markers of the whole body."""


class _Run:
    """Phases as they are done, one after the other."""

    def __init__(self, nominal: Parameters, settings: JointSettings) -> None:
        self.nominal, self.settings, self.parameters = nominal, settings, nominal
        self.phases: list[Phase] = []
        self.fits: list[JointFit] = []
        self.influence = nominal_influence()
        self.information = np.zeros((len(JP_NAMES), len(JP_NAMES)))
        """Per units of p: what the trials so far know of all joint parameters together, noise being 1."""
        self.unseen: list[str] = []
        self.turned: dict[str, dict[str, float]] = {}
        self.findings: list[Finding] = []

    def fit(
        self,
        name: str,
        problems: Sequence[TrialProblem],
        free: tuple[str, ...],
        joint: str | None = None,
        joints: Sequence[str | None] = (),
    ) -> JointFit:
        """One phase; `joint`: the one of isolated trials; `joints`: that of each, where they are several together."""
        attempts, unseen = self._attempts(problems, free, joint)
        fit = attempts[-1]
        self.turned |= turns_of(problems, fit.nodes, joints or [joint] * len(problems))
        seconds, iterations = sum(a.seconds for a in attempts), sum(a.iterations for a in attempts)
        if unseen:
            known = {n for earlier in self.fits for n in earlier.free}
            new = [n for n in unseen if n not in known]
            self.unseen += new
            self.findings += in_words(new, [p.name for p in problems], turned=self.turned)
        self.parameters = fit.parameters
        self.fits.append(fit)
        self.influence = influence_of(problems, fit, self.influence)
        at = [JP_INDEX[n] for n in fit.free]
        self.information[np.ix_(at, at)] += fit.state.hessian / fit.marker_noise**2
        trials = tuple(p.name for p in problems)
        noise = fit.marker_noise if self.settings.cumulative else None
        self.phases.append(
            Phase(
                name=name,
                trials=trials,
                parameters=len(fit.free),
                iterations=iterations,
                seconds=seconds,
                converged=fit.converged,
                message=fit.message,
                marker_noise=noise,
            )
        )
        return fit

    def _attempts(
        self, problems: Sequence[TrialProblem], free: tuple[str, ...], joint: str | None
    ) -> tuple[list[JointFit], tuple[str, ...]]:
        """Fit, freeze what the trials cannot see, and fit the rest again, priors weighed against the noise found."""
        attempts = [self._solve(problems, free, self.settings.marker_noise)]
        first = attempts[0]
        unmoved = unmoved_parameters(problems, first, joint) if joint else ()
        evidence = marker_evidence(problems, first)
        unseen = unseen_parameters(first.free, evidence, unmoved)
        if not unseen and not self.settings.cumulative:
            return attempts, unseen
        noise, seen = self._noise(first, evidence, unseen), tuple(n for n in first.free if n not in unseen)
        while True:
            before = attempts[-1].marker_noise
            attempts.append(self._solve(problems, seen, noise))
            if noise >= PRIORS_OWN * before or noise <= LEAST_NOISE:
                return attempts, unseen
            noise = self._noise(attempts[-1], marker_evidence(problems, attempts[-1]))

    def _noise(self, fit: JointFit, evidence: MarkerEvidence, unseen: Sequence[str] = ()) -> float:
        seen = [k for k, name in enumerate(fit.free) if name not in unseen]
        if not self.settings.cumulative or not seen:
            return self.settings.marker_noise
        deviation = self.settings.prior_deviation([fit.free[k] for k in seen])
        return independent_noise(fit.state.hessian, evidence, np.array(seen), deviation)

    def _solve(self, problems: Sequence[TrialProblem], free: tuple[str, ...], noise: float) -> JointFit:
        p, settings = self.parameters, replace(self.settings, marker_noise=noise)
        starts = [starting_nodes(t.chain, t.constants(p), t.data, t.basis) for t in problems]
        known = noise**2 * self.information if settings.cumulative else None
        return calibrate_joints(problems, p, free, starts, settings, nominal=self.nominal, information=known)

    def done(self) -> JointCalibration:
        """All phases together."""
        fitted = {name for fit in self.fits for name in fit.free}
        unseen = tuple(name for name in self.unseen if name not in fitted)
        bounds = tuple(dict.fromkeys(name for fit in self.fits for name in fit.at_bound))
        return JointCalibration(
            parameters=self.parameters,
            phases=tuple(self.phases),
            free=tuple(dict.fromkeys(name for fit in self.fits for name in fit.free)),
            influence=self.influence,
            unidentifiable=unseen,
            findings=(*dict.fromkeys(self.findings), *beyond_bounds(bounds)),
            at_bound=bounds,
            fits=tuple(self.fits),
        )


def calibrate_sequentially(
    trials: Sequence[JointTrial], nominal: Parameters, settings: JointSettings, gait: Mapping[str, tuple[str, ...]]
) -> JointCalibration:
    """Isolated trials each for its joint (6, 9 or 12 parameters), then the gait trials.

    `gait`: side -> joint parameters that gait may move; its keys are the legs to calibrate.
    """
    run = _Run(nominal, settings)
    for joint in ISOLATED_JOINTS:
        own = [trial.alone for trial in trials if trial.joint == joint]
        if own and joint[-1] in gait:
            fit = run.fit(f"joint:{joint}", own, isolated_parameters(joint), joint)
            for problem, nodes in zip(own, fit.nodes, strict=True):
                run.findings += small_turns(problem, nodes, joint)
    walks = [trial.alone for trial in trials if trial.joint is None]
    if walks:
        run.fit("gait", walks, tuple(name for names in gait.values() for name in names))
    return run.done()


def calibrate_simultaneously(
    trials: Sequence[JointTrial], nominal: Parameters, settings: JointSettings, gait: Mapping[str, tuple[str, ...]]
) -> JointCalibration:
    """All trials at once: every parameter that an isolated trial determines, and those of `gait` where there is gait.

    `gait`: side -> joint parameters that gait may move; its keys are the legs to calibrate.
    """
    wanted: set[str] = set()
    used = [trial for trial in trials if trial.joint is None or trial.joint[-1] in gait]
    for trial in used:
        if trial.joint is not None:
            wanted.update(isolated_parameters(trial.joint))
        else:
            wanted.update(name for names in gait.values() for name in names)
    order = [name for joint in ISOLATED_JOINTS for name in isolated_parameters(joint)]
    run = _Run(nominal, settings)
    if used:
        free = tuple(name for name in order if name in wanted)
        fit = run.fit("all joints", [t.legs for t in used], free, joints=[t.joint for t in used])
        for trial, nodes in zip(used, fit.nodes, strict=True):
            if trial.joint is not None:
                run.findings += small_turns(trial.legs, nodes, trial.joint)
    return run.done()
