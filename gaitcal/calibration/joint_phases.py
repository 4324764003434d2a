"""Phases of joint-parameter calibration: what each fits, and what they come to together.

A phase fits some joint parameters to some trials by the one estimator (`joint_estimate.py`);
whatever it knew before is its prior, and what it finds is where the next one starts. Two protocols
are lists of phases:

default    the legs with soft tissue and priors of anatomy, isolated trials and gait together. An isolated trial is
           fitted by its joint alone, whose proximal segment is free in the laboratory, so that an
           uncalibrated neighbour joint has no say; gait by pelvis and legs. Every joint parameter
           that a trial can move is free. Then trunk and arms in gait by themselves, as their skin
           and single spine joint make errors of another size.
published  Reinbolt et al. 2007: equal weights, bounds, and no prior, or a weak one of which every phase makes a
           posterior, the prior of the next. Soft tissue is not fitted; it is a source of error
           (`joint_estimate.py`), and widens that posterior. Sequential, isolated trials are fitted
           as above and gait by the whole linkage. Simultaneous, every trial is fitted by pelvis and
           legs, whose joints are all free: each trial then also says what it knows of its
           neighbours, and no nominal joint is left to pull.

Without a prior, a phase freezes what its trials cannot see, and fits the rest again
(`identifiability.py`); with one, what the trials do not tell stays where the prior holds it, with
the prior's spread as its error.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaitcal.calibration import (
    identifiability,
    joint_calibration,
    joint_prior,
    soft_tissue_artefact,
)
from gaitcal.calibration.error_sources import ErrorSources, nominal_errors
from gaitcal.calibration.joint_estimate import (
    BY_EVIDENCE,
    JointEstimate,
    Tasks,
    estimate_joints,
    free_of,
)
from gaitcal.errors import Finding
from gaitcal.model.linkage import ISOLATED_JOINTS, LEG_JOINTS, LOWER_BODY, SEGMENTS
from gaitcal.model.parameters import JP_INDEX, JP_NAMES, Parameters, isolated_parameters
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.cohort_prior import JointPrior
from gaitcal.tracking.bandwidth import with_bandwidth
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.trial_problem import MotionProblem

LEARNT = 0.9
"""A parameter whose standard error is more than this part of its prior's is not determined by the
trials.
"""
UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))


@dataclass(frozen=True)
class JointProblem:
    """A trial that takes part."""

    body: MotionProblem
    """The whole body."""
    fitted: MotionProblem
    """The segments that a phase fits: of an isolated trial its joint alone, or pelvis and legs; of
    gait the whole body, or pelvis and legs."""
    joint: str | None
    """The joint of an isolated trial; None for the whole body."""
    activity: str = ""
    """What a trial of the whole body does that is no walk: its skin moves as in no other trial."""

    @property
    def name(self) -> str:
        """Of the recording, whatever part of the body is fitted to it."""
        return self.body.name

    @property
    def kind(self) -> str:
        """Of task; an activity has none of a walk's or a joint's, whatever its trial is called."""
        return self.joint or (
            f"{soft_tissue_artefact.ACTIVITY}{self.activity}"
            if self.activity
            else soft_tissue_artefact.GAIT
        )


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
    """m, the noise of all its trials, where a weak prior is weighed against that; None where there
    is none.
    """
    noise: Mapping[str, float] = field(default_factory=dict)
    """Trial -> m, the noise of its independent samples."""

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
    errors: ErrorSources
    """Errors of all joint parameters by source, fitted or not."""
    unidentifiable: tuple[str, ...]
    """Parameters that were to be fitted and that the trials cannot see; they keep their nominal
    value, or stay where their prior holds them."""
    findings: tuple[Finding, ...]
    """What speaks against it, and what these trials cannot see."""
    at_bound: tuple[str, ...] = ()
    """Fitted parameters on their bound, or beyond."""
    notes: tuple[str, ...] = ()
    """What the user should know and need not act upon."""
    reached: Mapping[str, Parameters] = field(default_factory=dict)
    """Trial -> the parameters at the end of its phase, where a later one moves them again."""
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of its soft tissue on the markers of the whole body."""
    artefact: soft_tissue_artefact.FoundTissue = soft_tissue_artefact.NO_FOUND_TISSUE
    """Where the markers of all trials are against their bones."""


def parameters_for(joint: JointCalibration | None, trial: str, final: Parameters) -> Parameters:
    """The joint parameters at the end of the phase that a trial took part in; `final` where no
    later one moves them.
    """
    return final if joint is None else joint.reached.get(trial, final)


@dataclass(frozen=True, kw_only=True)
class JointPhase:
    """What a phase fits."""

    name: str
    tasks: Tasks
    free: tuple[str, ...]
    recordings: tuple[str, ...]
    """Name of each trial, whatever its problem is called."""
    tissue: soft_tissue_artefact.TissuePrior = soft_tissue_artefact.NO_TISSUE
    """Of the columns that its problems have."""

    def with_tissue(self, soft: soft_tissue_artefact.TaskTissue) -> "JointPhase":
        """The same with what may move the markers against their bones."""
        names = iter(self.recordings)
        tasks = {
            kind: tuple(
                replace(problem, tissue=soft.of(next(names), problem)) for problem in problems
            )
            for kind, problems in self.tasks.items()
        }
        plan = replace(self, tasks=tasks)
        return replace(plan, tissue=soft.prior(plan.problems))

    @property
    def problems(self) -> list[MotionProblem]:
        """Of all tasks."""
        return [problem for problems in self.tasks.values() for problem in problems]

    @property
    def joints(self) -> list[str | None]:
        """Of each problem; None for the whole body."""
        return [
            kind if kind in ISOLATED_JOINTS else None
            for kind, problems in self.tasks.items()
            for _ in problems
        ]


@dataclass(frozen=True, kw_only=True)
class PhaseSettings:
    """How phases are fitted, and what is known before them."""

    search: joint_calibration.JointSettings = BY_EVIDENCE
    """Bounds and tolerances of the search."""
    prior: JointPrior | None
    """About nominal values; None: nothing is expected, and what trials cannot see is frozen."""
    equal_weights: bool = False
    """Whether all trials of a phase count as equally noisy."""
    fits_tissue: bool = True
    """Whether soft tissue is fitted; else it is a source of error alone."""


@dataclass(frozen=True, kw_only=True)
class FittedPhase:
    """What the fit of a phase gives."""

    estimate: JointEstimate
    errors: ErrorSources
    summary: Phase
    frozen: tuple[str, ...] = ()
    """Joint parameters that were to be fitted and that these trials cannot see."""
    turned: identifiability.Turns = field(default_factory=dict)
    """How far isolated trials move their joints."""
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()


def fit_phase(
    plan: JointPhase,
    nominal: Parameters,
    how: PhaseSettings,
    present: Parameters | None = None,
    known: ErrorSources | None = None,
) -> FittedPhase:
    """Fit one phase, from the parameters `present` with errors `known` (`estimate_joints`)."""
    fit = partial(
        estimate_joints,
        plan.tasks,
        nominal,
        tissue=plan.tissue,
        fits_tissue=how.fits_tissue,
        prior=how.prior,
        settings=how.search,
        equal_weights=how.equal_weights,
        present=present,
        known=known,
    )
    estimate, errors = fit(plan.free)
    turned = identifiability.turns_of(plan.problems, estimate.coefficients, plan.joints)
    frozen: tuple[str, ...] = ()
    if how.prior is None:
        (alone,) = plan.tasks if len(plan.tasks) == 1 else (soft_tissue_artefact.GAIT,)
        unmoved = (
            ()
            if alone not in ISOLATED_JOINTS
            else identifiability.unmoved_parameters(plan.free, alone, turned[alone])
        )
        frozen = identifiability.unseen_parameters(
            plan.free, estimate.covariance, estimate.information, unmoved
        )
    iterations, seconds = estimate.iterations, estimate.seconds
    if frozen:
        estimate, errors = fit(tuple(name for name in plan.free if name not in frozen))
        iterations, seconds = iterations + estimate.iterations, seconds + estimate.seconds
    small = dict.fromkeys(
        finding
        for problem, coefficients, joint in zip(
            plan.problems, estimate.coefficients, plan.joints, strict=True
        )
        if joint
        for finding in identifiability.small_turns(problem, coefficients, joint)
    )
    weighed = how.equal_weights and how.prior is not None
    summary = Phase(
        name=plan.name,
        trials=tuple(dict.fromkeys(plan.recordings)),
        parameters=len(estimate.values),
        iterations=iterations,
        seconds=seconds,
        converged=estimate.converged,
        message=estimate.message,
        marker_noise=float(np.sqrt(np.mean(np.square(estimate.noise)))) if weighed else None,
        noise=dict(zip(plan.recordings, estimate.noise, strict=True)),
    )
    return FittedPhase(
        estimate=estimate,
        errors=errors,
        summary=summary,
        frozen=frozen,
        turned=turned,
        findings=tuple(small),
    )


def sequential_phases(
    trials: Sequence[JointProblem], gait: Mapping[str, tuple[str, ...]]
) -> list[JointPhase]:
    """Isolated trials each for its joint (6, 9 or 12 parameters), then the gait trials.

    `gait`: side -> joint parameters that gait may move; its keys are the legs to calibrate (so
    below).
    """
    phases = [
        _phase(
            f"joint:{joint}", [t for t in trials if t.joint == joint], isolated_parameters(joint)
        )
        for joint in ISOLATED_JOINTS
        if joint[-1] in gait
    ]
    free = tuple(name for names in gait.values() for name in names)
    phases.append(_phase(soft_tissue_artefact.GAIT, [t for t in trials if t.joint is None], free))
    return [phase for phase in phases if phase.free]


def simultaneous_phases(
    trials: Sequence[JointProblem], gait: Mapping[str, tuple[str, ...]]
) -> list[JointPhase]:
    """All trials at once: every parameter that an isolated trial determines, and those of `gait` if
    there is gait.
    """
    used = [trial for trial in trials if trial.joint is None or trial.joint[-1] in gait]
    of_gait = {name for names in gait.values() for name in names}
    wanted = {
        name
        for t in used
        for name in (of_gait if t.joint is None else isolated_parameters(t.joint))
    }
    order = [name for joint in ISOLATED_JOINTS for name in isolated_parameters(joint)]
    phase = _phase("all joints", used, tuple(name for name in order if name in wanted))
    return [phase] if phase.free else []


def _phase(name: str, trials: Sequence[JointProblem], wanted: tuple[str, ...]) -> JointPhase:
    kinds = dict.fromkeys(t.kind for t in trials)
    tasks = {kind: tuple(t.fitted for t in trials if t.kind == kind) for kind in kinds}
    recordings = tuple(t.name for kind in kinds for t in trials if t.kind == kind)
    free = joint_calibration.passed(
        [problem for problems in tasks.values() for problem in problems], wanted
    )
    return JointPhase(name=name, tasks=tasks, free=free, recordings=recordings)


def calibrate_in_phases(
    phases: Sequence[JointPhase], nominal: Parameters, how: PhaseSettings
) -> JointCalibration:
    """One phase after the other, each from where the last one ended; what it knows is the prior of
    the next.
    """
    present, known, following = nominal, nominal_errors(), how
    done: list[FittedPhase] = []
    for plan in phases:
        found = fit_phase(plan, nominal, following, present, known)
        estimate, known = found.estimate, found.errors
        present = estimate.parameters
        if following.prior is not None:
            free, index = estimate.free, [JP_INDEX[name] for name in estimate.free]
            mean = present.joint[index] - nominal.joint[index]
            covariance = estimate.whole_covariance[: len(free), : len(free)]
            posterior = JointPrior(names=free, mean=mean, covariance=covariance)
            following = replace(following, prior=following.prior.update(posterior))
        done.append(found)
    problems = [problem for plan in phases for task in plan.tasks.values() for problem in task]
    whole = _calibration_of(done, nominal, how.prior, how.search, known, problems)
    reached = {name: phase.estimate.parameters for phase in done for name in phase.summary.trials}
    return replace(whole, reached=reached)


def calibrate_by_evidence(
    trials: Sequence[JointProblem],
    nominal: Parameters,
    bounds: joint_calibration.JointSettings,
    sides: Sequence[str],
    prior: JointPrior = joint_prior.ANATOMY,
) -> JointCalibration:
    """Joint parameters of the legs of `sides`, of the trunk and of the arms; those beyond `bounds`
    are told.
    """
    how = PhaseSettings(prior=prior)
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    kinds = list(dict.fromkeys(t.kind for t in used))
    legs = [
        replace(t, fitted=t.fitted if t.joint else segments_of(t.fitted, LOWER_BODY, nominal))
        for t in sorted(used, key=lambda t: kinds.index(t.kind))
    ]
    free = free_of(
        [t.fitted for t in legs], [n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides]
    )
    done, tissue = list[FittedPhase](), dict[str, SoftTissue]()
    artefact = soft_tissue_artefact.NO_FOUND_TISSUE
    with ThreadPoolExecutor(1) as pool:
        upper = pool.submit(with_one_blas_thread(_trunk_and_arms), trials, nominal, how)
        if free:
            soft = soft_tissue_artefact.task_tissue(
                {t.name: t.kind for t in legs}, {t.name: t.fitted for t in legs}, nominal
            )
            plan = replace(_phase("joint parameters of the legs", legs, ()), free=free).with_tissue(
                soft
            )
            found = fit_phase(plan, nominal, how)
            errors = _with_untracked_tissue(found)
            done.append(
                replace(found, errors=errors, notes=_tissue_notes(soft.scales, found.estimate))
            )
            tissue = soft.of_bodies({t.name: t.body for t in legs}, plan.tissue.keys)
            artefact = soft.found(found.estimate.keys, found.estimate.tissue)
    done += upper.result()
    known = nominal_errors(prior=prior)
    calibration = _calibration_of(done, nominal, prior, bounds, known, [t.fitted for t in legs])
    return replace(calibration, tissue=tissue, artefact=artefact)


def _with_untracked_tissue(phase: FittedPhase) -> ErrorSources:
    """Add the soft tissue with which motions are not tracked to their errors, all of what was
    found.
    """
    estimate, errors = phase.estimate, phase.errors
    if not estimate.keys:
        return errors
    tracked = [soft_tissue_artefact.is_from_bones(key) for key in estimate.keys]
    column = np.zeros((len(errors.free), 1))
    column[len(estimate.free) : len(estimate.free) + len(tracked), 0] = np.where(
        tracked, 0.0, estimate.tissue
    )
    return ErrorSources(
        errors.free, np.hstack([errors.parameters, column]), (*errors.clusters, "skin/found")
    )


def _tissue_notes(
    scales: Mapping[str, soft_tissue_artefact.SoftTissueScale], estimate: JointEstimate
) -> tuple[str, ...]:
    """What soft tissue was found, and how far repeated trials repeat their errors."""
    named = {
        "isolated trials" if kind in ISOLATED_JOINTS else kind: scale
        for kind, scale in scales.items()
    }
    sizes = ", ".join(
        f"{kind} {np.sqrt(scale.linear):.2g}"
        + (
            f" (and {np.sqrt(scale.squares):.2g} with the squares of angles)"
            if scale.squares >= soft_tissue_artefact.LEAST_SQUARES
            else ""
        )
        for kind, scale in named.items()
    )
    out = [
        "soft tissue moves the markers with the joints beside them, by this much of what people "
        "show in such a task: "
        f"{sizes}; the joint parameters were fitted together with it"
    ]
    out += [
        f"the trials of {kind} repeat each other's errors: each counts as one of {repeated:.1f} "
        "that say the same"
        for kind, repeated in estimate.repeated.items()
        if repeated > 1.05
    ]
    if estimate.apart > 1.05:
        out.append(
            f"isolated trials and gait disagree: error bars are {estimate.apart:.1f} times those "
            "of noise alone"
        )
    return tuple(out)


def segments_of(
    body: MotionProblem, segments: tuple[str, ...], nominal: Parameters
) -> MotionProblem:
    """Some segments of a whole body, the first free in the laboratory, with the same bandwidth."""
    part = body.part(segments[0], segments)
    return with_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part


def _trunk_and_arms(
    trials: Sequence[JointProblem], nominal: Parameters, how: PhaseSettings
) -> list[FittedPhase]:
    """Gait by itself above the pelvis; empty where nothing is free."""
    walks = [t for t in trials if t.joint is None]
    parts = [segments_of(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers once more: what they do here has a name of its own among the sources of
    # error
    problems = tuple(replace(part, name=f"{part.name}, trunk and arms") for part in parts)
    plan = JointPhase(
        name="joint parameters of trunk and arms",
        tasks={soft_tissue_artefact.GAIT: problems},
        free=free_of(problems, UPPER_PARAMETERS),
        recordings=tuple(t.name for t in walks),
    )
    if not plan.free:
        return []
    found = fit_phase(plan, nominal, how)
    if turned := identifiability.arm_ambiguity(problems, found.estimate.coefficients, nominal):
        found = fit_phase(
            replace(plan, free=identifiability.without_arms(plan.free, turned)), nominal, how
        )
    return [replace(found, findings=identifiability.ambiguous_arm_findings(turned))]


def _calibration_of(
    done: Sequence[FittedPhase],
    nominal: Parameters,
    prior: JointPrior | None,
    bounds: joint_calibration.JointSettings,
    known: ErrorSources,
    problems: Sequence[MotionProblem],
) -> JointCalibration:
    """All phases together. `prior`: before any trial; `bounds`: joint parameters on them, or
    beyond, are told; `known`: errors of all joint parameters, of which those of phases that know of
    no other take the place; `problems`: of all phases, whose markers show whether the static trial
    is of this body.
    """
    parameters, spread, bounded = nominal, dict[str, float](), dict[str, None]()
    for phase in done:
        estimate, free = phase.estimate, phase.estimate.free
        parameters = parameters.with_joint(
            free, estimate.parameters.joint[[JP_INDEX[name] for name in free]]
        )
        spread |= dict(zip(free, np.sqrt(np.diag(estimate.covariance)).tolist(), strict=False))
        bounded |= dict.fromkeys(estimate.at_bound)
        known = known.updated(phase.errors)
    free, apart = tuple(spread), np.abs(parameters.joint - nominal.joint)
    bounded |= dict.fromkeys(n for n in free if apart[JP_INDEX[n]] > bounds.bound(n))
    if prior is None:
        unseen, kept = (
            tuple(n for phase in done for n in phase.frozen if n not in spread),
            "kept at nominal values",
        )
    else:
        before = np.sqrt(np.diag(joint_prior.prior_of(free, prior)[1]))
        unseen = tuple(
            n for n, deviation in zip(free, before, strict=True) if spread[n] > LEARNT * deviation
        )
        kept = (
            "held near "
            f"{prior.describe_fallback([n for n in unseen if n.startswith(LEG_JOINTS)]) or 'nominal values'}"
        )
    turned = {joint: angles for phase in done for joint, angles in phase.turned.items()}
    return JointCalibration(
        parameters=parameters,
        phases=tuple(phase.summary for phase in done),
        free=free,
        errors=known,
        unidentifiable=unseen,
        findings=(
            *(finding for phase in done for finding in phase.findings),
            *identifiability.in_words(
                [n for n in unseen if n.startswith(LEG_JOINTS)], kept, turned
            ),
            *identifiability.beyond_bounds(
                tuple(bounded),
                same_body=bool(bounded) and identifiability.worn_as_standing(problems),
            ),
        ),
        at_bound=tuple(bounded),
        notes=(*(prior.notes if prior else ()), *(note for phase in done for note in phase.notes)),
    )
