"""Phases of joint-parameter calibration: parameters and trials of each, and their combination.

A phase fits some joint parameters to some trials by `joint_estimate.py`. Earlier knowledge is its
prior, and its result is the start of the next phase. Two protocols are lists of phases:

default    Legs with soft tissue and priors of anatomy, functional trials and gait together. A
           functional (isolated) trial is fitted by its joint alone. The proximal segment is free in
           the laboratory, so that an uncalibrated neighbour joint has no influence. Gait is fitted
           by pelvis and legs. Every joint parameter that a trial can determine is free. Then trunk
           and arms in gait separately: their soft tissue and single spine joint have errors of
           another size.
published  Reinbolt et al. 2007: equal weights, bounds, and no prior, or a weak one whose posterior
           after each phase is the prior of the next. Soft tissue is not fitted; it is a source of
           error (`joint_estimate.py`), and widens that posterior. Sequential: functional trials are
           fitted as above and gait by the whole linkage. Simultaneous: every trial is fitted by
           pelvis and legs with all joints free, so that each trial contributes to neighbour joints
           too.

Without a prior, a phase fixes parameters that its trials do not determine, and fits the others
again (`identifiability.py`). With a prior, such parameters stay near its mean, with its spread as
error.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaitcal.calibration import identifiability, joint_prior, soft_tissue_artefact
from gaitcal.calibration.error_sources import ErrorSources, make_nominal_errors
from gaitcal.calibration.joint_estimate import (
    BY_EVIDENCE,
    JointEstimate,
    JointSettings,
    Tasks,
    estimate_joints,
    select_movable_parameters,
    select_parameters_in_linkage,
)
from gaitcal.errors import Finding
from gaitcal.model.linkage import ISOLATED_JOINTS, LEG_JOINTS, LOWER_BODY, SEGMENTS
from gaitcal.model.parameters import JP_INDEX, JP_NAMES, Parameters, list_isolated_parameters
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.normal_prior import JointPrior
from gaitcal.tracking.bandwidth import apply_bandwidth
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.trial_problem import MotionProblem

LEARNT = 0.9
"""Ratio of a parameter's standard error to its prior's; above it the trials do not determine it."""
UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))


@dataclass(frozen=True)
class JointProblem:
    """A trial of a joint calibration."""

    body: MotionProblem
    """The whole body."""
    fitted: MotionProblem
    """The segments that a phase fits: of an isolated trial its joint alone, or pelvis and legs; of
    gait the whole body, or pelvis and legs."""
    joint: str | None
    """The joint of an isolated trial; None for the whole body."""
    activity: str = ""
    """Activity of a whole-body trial that is no walk: its skin moves as in no other trial."""

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.body.name

    @property
    def kind(self) -> str:
        """Kind of task: a joint, gait, or an activity with a prefix of its kind."""
        return self.joint or (
            f"{soft_tissue_artefact.ACTIVITY}{self.activity}"
            if self.activity
            else soft_tissue_artefact.GAIT
        )


@dataclass(frozen=True, kw_only=True)
class PhaseSummary:
    """Summary of one phase of a calibration."""

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
    """Result of all phases together."""

    parameters: Parameters
    phases: tuple[PhaseSummary, ...]
    free: tuple[str, ...]
    """Every joint parameter that was fitted."""
    errors: ErrorSources
    """Errors of all joint parameters by source, fitted or not."""
    unidentifiable: tuple[str, ...]
    """Free parameters that the trials do not determine; they keep their nominal value or that of
    the prior."""
    findings: tuple[Finding, ...]
    """Findings on the fit, and on parameters that these trials do not determine."""
    at_bound: tuple[str, ...] = ()
    """Fitted parameters on their bound, or beyond."""
    notes: tuple[str, ...] = ()
    """Notes that need no action."""
    reached: Mapping[str, Parameters] = field(default_factory=dict)
    """Trial -> the parameters at the end of its phase, where a later one moves them again."""
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of its soft tissue on the markers of the whole body."""
    artefact: soft_tissue_artefact.FoundTissue = soft_tissue_artefact.NO_FOUND_TISSUE
    """Where the markers of all trials are against their bones."""


def get_parameters_for_trial(
    joint: JointCalibration | None, trial: str, final: Parameters
) -> Parameters:
    """Get the joint parameters at the end of the phase of a trial.

    Parameters
    ----------
    joint : JointCalibration or None
        Result of the calibration.
    trial : str
        Name of the trial.
    final : Parameters
        Returned if no later phase changes the parameters of this trial.

    Returns
    -------
    parameters : Parameters
        SI units.
    """
    return final if joint is None else joint.reached.get(trial, final)


@dataclass(frozen=True, kw_only=True)
class PhasePlan:
    """Trials and free parameters of a phase."""

    name: str
    tasks: Tasks
    free: tuple[str, ...]
    recordings: tuple[str, ...]
    """Name of each trial, whatever its problem is called."""
    tissue: soft_tissue_artefact.TissuePrior = soft_tissue_artefact.NO_TISSUE
    """Of the columns that its problems have."""

    def with_tissue(self, soft: soft_tissue_artefact.TaskTissue) -> "PhasePlan":
        """Return the same phase with soft tissue on its markers."""
        names = iter(self.recordings)
        tasks = {}
        for kind, problems in self.tasks.items():
            with_columns = []
            for problem in problems:
                columns = soft.make_columns(next(names), problem)
                with_columns.append(replace(problem, tissue=columns))
            tasks[kind] = tuple(with_columns)
        plan = replace(self, tasks=tasks)
        return replace(plan, tissue=soft.assemble_prior(plan.problems))

    @property
    def problems(self) -> list[MotionProblem]:
        """Trials of all tasks."""
        return [problem for problems in self.tasks.values() for problem in problems]

    @property
    def joints(self) -> list[str | None]:
        """Joint of each functional trial; None for the whole body."""
        return [
            kind if kind in ISOLATED_JOINTS else None
            for kind, problems in self.tasks.items()
            for _ in problems
        ]


@dataclass(frozen=True, kw_only=True)
class PhaseResult:
    """Result of the fit of a phase."""

    estimate: JointEstimate
    errors: ErrorSources
    summary: PhaseSummary
    frozen: tuple[str, ...] = ()
    """Joint parameters that were to be fitted and are not observable from these trials."""
    turned: identifiability.RangesOfMotion = field(default_factory=dict)
    """Ranges of motion of the joints in functional (single-joint) trials."""
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()


def fit_phase(
    plan: PhasePlan,
    nominal: Parameters,
    settings: JointSettings,
    present: Parameters | None = None,
    known: ErrorSources | None = None,
) -> PhaseResult:
    """Fit one phase.

    `nominal`: centre of the prior and of the bounds. `present`: start of the search; `nominal` if
    not given. `known`: errors before the phase (`estimate_joints`). Returns: estimate, errors and
    findings.
    """
    fit = partial(
        estimate_joints,
        plan.tasks,
        nominal,
        settings=settings,
        tissue=plan.tissue,
        present=present,
        known=known,
    )
    estimate, errors = fit(plan.free)
    turned = identifiability.measure_ranges_of_motion(
        plan.problems, estimate.coefficients, plan.joints
    )
    frozen: tuple[str, ...] = ()
    if settings.prior is None:
        (alone,) = plan.tasks if len(plan.tasks) == 1 else (soft_tissue_artefact.GAIT,)
        unmoved = (
            ()
            if alone not in ISOLATED_JOINTS
            else identifiability.find_unmoved_parameters(plan.free, alone, turned[alone])
        )
        frozen = identifiability.find_unobservable_parameters(
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
        for finding in identifiability.report_small_ranges(problem, coefficients, joint)
    )
    weighed = settings.equal_weights and settings.prior is not None
    summary = PhaseSummary(
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
    return PhaseResult(
        estimate=estimate,
        errors=errors,
        summary=summary,
        frozen=frozen,
        turned=turned,
        findings=tuple(small),
    )


def plan_sequential_phases(
    trials: Sequence[JointProblem], gait: Mapping[str, tuple[str, ...]]
) -> list[PhasePlan]:
    """Plan a phase for each functional joint (6, 9 or 12 parameters), then one for the gait trials.

    Parameters
    ----------
    trials : sequence of JointProblem
        All trials.
    gait : mapping of str to tuple of str
        Side -> joint parameters that gait may determine; its keys are the legs to calibrate.

    Returns
    -------
    list of PhasePlan
        Phases with free parameters.
    """
    phases = []
    for joint in ISOLATED_JOINTS:
        if joint[-1] not in gait:
            continue
        of_joint = [trial for trial in trials if trial.joint == joint]
        phases.append(_make_phase(f"joint:{joint}", of_joint, list_isolated_parameters(joint)))
    free = tuple(name for names in gait.values() for name in names)
    phases.append(
        _make_phase(soft_tissue_artefact.GAIT, [t for t in trials if t.joint is None], free)
    )
    return [phase for phase in phases if phase.free]


def plan_simultaneous_phases(
    trials: Sequence[JointProblem], gait: Mapping[str, tuple[str, ...]]
) -> list[PhasePlan]:
    """Plan one phase of all trials.

    Parameters
    ----------
    trials : sequence of JointProblem
        All trials.
    gait : mapping of str to tuple of str
        As in `plan_sequential_phases`.

    Returns
    -------
    list of PhasePlan
        One phase, or none if nothing is free.
    """
    used = [trial for trial in trials if trial.joint is None or trial.joint[-1] in gait]
    of_gait = {name for names in gait.values() for name in names}
    wanted = set[str]()
    for trial in used:
        wanted |= of_gait if trial.joint is None else set(list_isolated_parameters(trial.joint))
    order = list[str]()
    for joint in ISOLATED_JOINTS:
        order += list_isolated_parameters(joint)
    phase = _make_phase("all joints", used, tuple(name for name in order if name in wanted))
    return [phase] if phase.free else []


def _make_phase(name: str, trials: Sequence[JointProblem], wanted: tuple[str, ...]) -> PhasePlan:
    """Make a phase of some trials, with those of the wanted parameters in their linkages."""
    tasks = dict[str, tuple[MotionProblem, ...]]()
    recordings, problems = list[str](), list[MotionProblem]()
    # Trials in the order of their kinds, each where its first trial is.
    for kind in dict.fromkeys(trial.kind for trial in trials):
        of_kind = [trial for trial in trials if trial.kind == kind]
        tasks[kind] = tuple(trial.fitted for trial in of_kind)
        recordings += [trial.name for trial in of_kind]
        problems += tasks[kind]
    free = select_parameters_in_linkage(problems, wanted)
    return PhasePlan(name=name, tasks=tasks, free=free, recordings=tuple(recordings))


def calibrate_in_phases(
    phases: Sequence[PhasePlan], nominal: Parameters, settings: JointSettings
) -> JointCalibration:
    """Fit one phase after the other; the posterior of each is the prior of the next.

    Parameters
    ----------
    phases : sequence of PhasePlan
        The protocol.
    nominal : Parameters
        Centre of the prior and of the bounds.
    settings : JointSettings
        Settings, and the prior of the first phase.

    Returns
    -------
    JointCalibration
        All phases together.
    """
    present, known, following = nominal, make_nominal_errors(), settings
    done: list[PhaseResult] = []
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
    whole = _assemble_calibration(done, nominal, settings, known, problems)
    reached = {name: phase.estimate.parameters for phase in done for name in phase.summary.trials}
    return replace(whole, reached=reached)


def calibrate_by_evidence(
    trials: Sequence[JointProblem],
    nominal: Parameters,
    settings: JointSettings,
    sides: Sequence[str],
) -> JointCalibration:
    """Calibrate the joints of the legs of `sides`, of the trunk and of the arms (default protocol).

    Parameters
    ----------
    trials : sequence of JointProblem
        All trials.
    nominal : Parameters
        Centre of the prior.
    settings : JointSettings
        Prior; parameters beyond its bounds are reported.
    sides : sequence of str
        Legs to calibrate.

    Returns
    -------
    JointCalibration
        Parameters, errors, soft tissue and findings.
    """
    # The prior limits the search instead of bounds.
    search = replace(BY_EVIDENCE, prior=settings.prior)
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    kinds = list(dict.fromkeys(t.kind for t in used))
    legs = [
        replace(t, fitted=t.fitted if t.joint else take_segments(t.fitted, LOWER_BODY, nominal))
        for t in sorted(used, key=lambda t: kinds.index(t.kind))
    ]
    free = select_movable_parameters(
        [t.fitted for t in legs], [n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides]
    )
    done, tissue = list[PhaseResult](), dict[str, SoftTissue]()
    artefact = soft_tissue_artefact.NO_FOUND_TISSUE
    with ThreadPoolExecutor(1) as pool:
        upper = pool.submit(with_one_blas_thread(_fit_trunk_and_arms), trials, nominal, search)
        if free:
            soft = soft_tissue_artefact.prepare_task_tissue(
                {t.name: t.kind for t in legs}, {t.name: t.fitted for t in legs}, nominal
            )
            plan = replace(
                _make_phase("joint parameters of the legs", legs, ()), free=free
            ).with_tissue(soft)
            found = fit_phase(plan, nominal, search)
            errors = _with_untracked_tissue(found)
            done.append(
                replace(found, errors=errors, notes=_describe_tissue(soft.scales, found.estimate))
            )
            tissue = soft.make_body_columns({t.name: t.body for t in legs}, plan.tissue.keys)
            artefact = soft.make_found_tissue(found.estimate.keys, found.estimate.tissue)
    done += upper.result()
    known = make_nominal_errors(prior=settings.prior)
    calibration = _assemble_calibration(done, nominal, settings, known, [t.fitted for t in legs])
    return replace(calibration, tissue=tissue, artefact=artefact)


def _with_untracked_tissue(phase: PhaseResult) -> ErrorSources:
    """Add the found soft tissue that motions are tracked without as an error of these."""
    estimate, errors = phase.estimate, phase.errors
    if not estimate.keys:
        return errors
    tracked = [soft_tissue_artefact.is_from_bones(key) for key in estimate.keys]
    column = np.zeros((len(errors.names), 1))
    column[len(estimate.free) : len(estimate.free) + len(tracked), 0] = np.where(
        tracked, 0.0, estimate.tissue
    )
    return ErrorSources(
        errors.names, np.hstack([errors.effects, column]), (*errors.sources, "skin/found")
    )


def _describe_tissue(
    scales: Mapping[str, soft_tissue_artefact.SoftTissueScale], estimate: JointEstimate
) -> tuple[str, ...]:
    """Describe the found soft tissue, and how far repeated trials repeat their errors."""
    named = {
        "functional (single-joint) trials" if kind in ISOLATED_JOINTS else kind: scale
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
        "soft tissue moves markers with the adjacent joints; size relative to that of people in "
        f"such a task: {sizes}; joint parameters were fitted together with it"
    ]
    out += [
        f"errors of the {kind} trials are correlated: each counts as one of {repeated:.1f} equal "
        "trials"
        for kind, repeated in estimate.effective_trials.items()
        if repeated > 1.05
    ]
    if estimate.birge_ratio > 1.05:
        out.append(
            "functional (single-joint) trials and gait disagree: error bars are "
            f"{estimate.birge_ratio:.1f} times those of noise alone"
        )
    return tuple(out)


def take_segments(
    body: MotionProblem, segments: tuple[str, ...], nominal: Parameters
) -> MotionProblem:
    """Take some segments of a whole body, with the same bandwidth.

    Parameters
    ----------
    body : MotionProblem
        A trial of the whole body.
    segments : tuple of str
        Segments of the part, the base first.
    nominal : Parameters
        Parameters for the bandwidth.

    Returns
    -------
    MotionProblem
        The part.
    """
    part = body.extract_part(segments[0], segments)
    return apply_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part


def _fit_trunk_and_arms(
    trials: Sequence[JointProblem], nominal: Parameters, settings: JointSettings
) -> list[PhaseResult]:
    """Fit gait separately above the pelvis; empty if nothing is free."""
    walks = [t for t in trials if t.joint is None]
    parts = [take_segments(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers take part again: their effects here have a separate source name
    problems = tuple(replace(part, name=f"{part.name}, trunk and arms") for part in parts)
    plan = PhasePlan(
        name="joint parameters of trunk and arms",
        tasks={soft_tissue_artefact.GAIT: problems},
        free=select_movable_parameters(problems, UPPER_PARAMETERS),
        recordings=tuple(t.name for t in walks),
    )
    if not plan.free:
        return []
    found = fit_phase(plan, nominal, settings)
    if turned := identifiability.detect_ambiguous_arms(
        problems, found.estimate.coefficients, nominal
    ):
        found = fit_phase(
            replace(plan, free=identifiability.exclude_arms(plan.free, turned)), nominal, settings
        )
    return [replace(found, findings=identifiability.report_ambiguous_arms(turned))]


def _assemble_calibration(
    done: Sequence[PhaseResult],
    nominal: Parameters,
    settings: JointSettings,
    known: ErrorSources,
    problems: Sequence[MotionProblem],
) -> JointCalibration:
    """Assemble all phases.

    `settings`: prior before any trial; parameters on its bounds or beyond are reported. `known`
    are errors of all joint parameters; phases replace those of their parameters. The markers of
    `problems` show whether the static trial is of this body.
    """
    prior = settings.prior
    parameters, spread, bounded = nominal, dict[str, float](), dict[str, None]()
    for phase in done:
        estimate, free = phase.estimate, phase.estimate.free
        parameters = parameters.with_joint(
            free, estimate.parameters.joint[[JP_INDEX[name] for name in free]]
        )
        spread |= dict(zip(free, np.sqrt(np.diag(estimate.covariance)).tolist(), strict=False))
        bounded |= dict.fromkeys(estimate.at_bound)
        known = known.replace_errors(phase.errors)
    free, distance = tuple(spread), np.abs(parameters.joint - nominal.joint)
    bounded |= dict.fromkeys(n for n in free if distance[JP_INDEX[n]] > settings.get_bound(n))
    if prior is None:
        undetermined, kept = (
            tuple(n for phase in done for n in phase.frozen if n not in spread),
            "kept at nominal values",
        )
    else:
        before = np.sqrt(np.diag(joint_prior.select_prior(free, prior)[1]))
        undetermined = tuple(
            n for n, deviation in zip(free, before, strict=True) if spread[n] > LEARNT * deviation
        )
        of_legs = [n for n in undetermined if n.startswith(LEG_JOINTS)]
        kept = f"held near {prior.describe_fallback(of_legs) or 'nominal values'}"
    turned = {joint: angles for phase in done for joint, angles in phase.turned.items()}
    return JointCalibration(
        parameters=parameters,
        phases=tuple(phase.summary for phase in done),
        free=free,
        errors=known,
        unidentifiable=undetermined,
        findings=(
            *(finding for phase in done for finding in phase.findings),
            *identifiability.report_undetermined(
                [n for n in undetermined if n.startswith(LEG_JOINTS)], kept, turned
            ),
            *identifiability.report_bounds(
                tuple(bounded),
                same_body=bool(bounded) and identifiability.is_same_placement(problems),
            ),
        ),
        at_bound=tuple(bounded),
        notes=(*(prior.notes if prior else ()), *(note for phase in done for note in phase.notes)),
    )
