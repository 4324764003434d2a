"""All joint parameters of a person by the evidence of all trials: the legs with their soft tissue, then trunk and arms.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory: neighbours neither
push nor are pushed. Gait is fitted by pelvis and legs. Every joint parameter that a trial can move is free; what the
markers do not tell stays where its prior holds it, with the prior's spread as its error. Trunk and arms, whose skin and
single spine joint make errors of another size, are fitted by themselves in gait, so that they do not hide the legs'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.identifiability import Turns, beyond_bounds, in_words, small_turns, turns_of
from gaitcal.calibration.influence import Influence, nominal_influence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import JointEstimate, TaskTrials, estimate_joints, free_of
from gaitcal.calibration.joint_phases import JointCalibration, Phase
from gaitcal.calibration.joint_prior import prior_of
from gaitcal.calibration.soft_tissue_artefact import (
    SQUARES,
    SoftTissueScale,
    soft_tissue_scale,
    task_regressors,
    tissue_of,
    tissue_prior,
)
from gaitcal.calibration.turned_arms import told, turned_arms, without_arms
from gaitcal.cores import beside, each
from gaitcal.findings import Finding
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Kind
from gaitcal.model.linkage import LEG_JOINTS, LOWER_BODY, SEGMENTS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))
GAIT = "gait"
"""Kind of task of a trial that is no isolated one; that of isolated trials has their joint's name."""
LEARNT = 0.9
"""A parameter whose standard error is more than this part of its prior's is not determined by the trials."""
LEAST_SQUARES = 0.01
"""E[s^2] below which columns of squares would move next to nothing: markers by a tenth of what people show."""


@dataclass(frozen=True)
class EvidenceTrial:
    """A trial that takes part."""

    body: TrialProblem
    """The whole body."""
    fitted: TrialProblem
    """An isolated trial on the segments of its joint; gait on the whole body."""
    joint: str | None
    """The joint of an isolated trial; None for gait."""

    @property
    def name(self) -> str:
        """Of the recording, whatever part of the body is fitted to it."""
        return self.body.name

    @property
    def kind(self) -> str:
        """Of task."""
        return self.joint or GAIT


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What the fit of one part of the body gives."""

    estimate: JointEstimate
    errors: Influence
    trials: tuple[EvidenceTrial, ...]
    name: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    turned: Turns = field(default_factory=dict)
    """How far isolated trials move their joints."""
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of its soft tissue on the markers of the whole body."""

    @property
    def free(self) -> tuple[str, ...]:
        return self.estimate.free

    @property
    def phase(self) -> Phase:
        names, estimate = [t.name for t in self.trials], self.estimate
        return Phase(
            name=self.name,
            trials=tuple(dict.fromkeys(names)),
            parameters=len(estimate.free) + len(estimate.keys),
            iterations=estimate.iterations,
            seconds=estimate.seconds,
            converged=estimate.converged,
            message=estimate.message,
            noise=dict(zip(names, estimate.noise, strict=True)),
        )


def calibrate_by_evidence(
    trials: Sequence[EvidenceTrial], nominal: Parameters, settings: JointSettings, sides: Sequence[str]
) -> JointCalibration:
    """Joint parameters of the legs of `sides`, of the trunk and of the arms."""
    with beside(partial(_trunk_and_arms, trials, nominal, settings.prior)) as trunk_and_arms:
        legs = _legs(trials, nominal, sides, settings.prior)
        upper = trunk_and_arms()
    return _calibration([part for part in (legs, upper) if part is not None], nominal, settings)


def _legs(
    trials: Sequence[EvidenceTrial], nominal: Parameters, sides: Sequence[str], before: JointPrior | None
) -> _Part | None:
    """Isolated trials of `sides` and gait together; None where nothing is free."""
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    kinds = list(dict.fromkeys(t.kind for t in used))
    used.sort(key=lambda t: kinds.index(t.kind))
    still = {t.name: t.fitted if t.joint else segments_of(t.fitted, LOWER_BODY, nominal) for t in used}
    free = free_of(list(still.values()), [n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides])
    if not free:
        return None
    regressors, scales = _artefact(used, still, nominal)
    tasks = [
        TaskTrials(kind, tuple(_with_tissue(still[t.name], kind, regressors[t.name]) for t in used if t.kind == kind))
        for kind in kinds
    ]
    problems = [problem for task in tasks for problem in task.problems]
    tissue_before = tissue_prior(problems, scales)
    estimate, errors = estimate_joints(tasks, nominal, free, tissue=tissue_before, prior=before)
    pieces = list(zip(used, problems, estimate.nodes, strict=True))
    small = [finding for t, problem, nodes in pieces if t.joint for finding in small_turns(problem, nodes, t.joint)]
    return _Part(
        estimate=estimate,
        errors=_with_found_tissue(errors, estimate),
        trials=tuple(used),
        name="joint parameters of the legs",
        findings=tuple(dict.fromkeys(small)),
        notes=_in_words(scales, estimate),
        turned=turns_of(problems, estimate.nodes, [t.joint for t in used]),
        tissue={
            t.name: columns
            for t in used
            if (columns := tissue_of(t.body, t.kind, regressors[t.name], tissue_before.keys)) is not None
        },
    )


def _artefact(
    trials: Sequence[EvidenceTrial], parts: Mapping[str, TrialProblem], nominal: Parameters
) -> tuple[dict[str, dict[str, Array]], dict[str, SoftTissueScale]]:
    """Trial -> coordinate -> (nf,) psi of the joints that its task moves, and kind of task -> how soft the person is
    there: in gait, and in all isolated trials alike.
    """
    angles = dict(zip(parts, each(partial(_angles, nominal), list(parts.values())), strict=True))
    regressors, scales = dict[str, dict[str, Array]](), dict[str, SoftTissueScale]()
    kinds = dict.fromkeys(t.kind for t in trials)
    for kind in kinds:
        names = [t.name for t in trials if t.kind == kind]
        regressors |= dict(zip(names, task_regressors([angles[n] for n in names], squares=True), strict=True))
    for alike in ([k for k in kinds if k == GAIT], [k for k in kinds if k != GAIT]):
        members = [t for t in trials if t.kind in alike]
        scale = soft_tissue_scale([_with_tissue(parts[t.name], t.kind, regressors[t.name]) for t in members])
        scales |= dict.fromkeys(alike, scale)
        if scale.squares < LEAST_SQUARES:
            for t in members:
                regressors[t.name] = {n: psi for n, psi in regressors[t.name].items() if not n.endswith(SQUARES)}
    return regressors, scales


def _angles(nominal: Parameters, part: TrialProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad, of those that a marker of the trial shows."""
    q = tracked_motion(part, nominal).q
    return {name: values for name, values, on in zip(part.chain.coordinates, q.T, part.active, strict=True) if on}


def _with_tissue(problem: TrialProblem, kind: str, regressors: Mapping[str, Array]) -> TrialProblem:
    return replace(problem, tissue=tissue_of(problem, kind, regressors))


def _with_found_tissue(errors: Influence, estimate: JointEstimate) -> Influence:
    """Motions are tracked with markers in their places: the soft tissue found is an error of theirs, all of it."""
    if not estimate.keys:
        return errors
    column = np.zeros((len(errors.free), 1))
    column[len(estimate.free) :, 0] = estimate.tissue
    return Influence(errors.free, np.hstack([errors.parameters, column]), (*errors.clusters, "skin/found"))


def _in_words(scales: Mapping[str, SoftTissueScale], estimate: JointEstimate) -> tuple[str, ...]:
    """What soft tissue was found, and how far repeated trials repeat their errors."""
    named = {GAIT if kind == GAIT else "isolated trials": scale for kind, scale in scales.items()}
    told = ", ".join(
        f"{kind} {np.sqrt(scale.linear):.2g}"
        + (f" (and {np.sqrt(scale.squares):.2g} with the squares of angles)" if scale.squares >= LEAST_SQUARES else "")
        for kind, scale in named.items()
    )
    out = [
        "soft tissue moves the markers with the joints beside them, by this much of what people show in such a task: "
        f"{told}; the joint parameters were fitted together with it"
    ]
    out += [
        f"the trials of {kind} repeat each other's errors: each counts as one of {repeated:.1f} that say the same"
        for kind, repeated in estimate.repeated.items()
        if repeated > 1.05
    ]
    return tuple(out)


def segments_of(body: TrialProblem, segments: tuple[str, ...], nominal: Parameters) -> TrialProblem:
    """Some segments of a whole body, the first free in the laboratory, with the same bandwidth."""
    part = body.part(segments[0], segments)
    return with_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part


def _trunk_and_arms(trials: Sequence[EvidenceTrial], nominal: Parameters, before: JointPrior | None) -> _Part | None:
    """Gait by itself above the pelvis; None where nothing is free."""
    walks = tuple(t for t in trials if t.joint is None)
    parts = [segments_of(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers once more: what they do here has a name of its own among the sources of error
    task = TaskTrials(GAIT, tuple(replace(part, name=f"{part.name}, trunk and arms") for part in parts))
    free = free_of(task.problems, UPPER_PARAMETERS)
    if not free:
        return None
    trunk, errors = estimate_joints([task], nominal, free, prior=before)
    if turned := turned_arms(task.problems, trunk.nodes, nominal):
        free = without_arms(free, turned)
        trunk, errors = estimate_joints([task], nominal, free, prior=before)
    return _Part(
        estimate=trunk, errors=errors, trials=walks, name="joint parameters of trunk and arms", findings=told(turned)
    )


def _joined(known: Influence, errors: Influence) -> Influence:
    """Errors that take the place of those known, of the parameters that they are of."""
    kept = [k for k, name in enumerate(known.free) if name not in errors.free]
    own = [c for c in range(len(known.clusters)) if known.parameters[kept, c].any()]
    rows = len(kept)
    parameters = np.zeros((rows + len(errors.free), len(own) + len(errors.clusters)))
    parameters[:rows, : len(own)] = known.parameters[np.ix_(kept, own)]
    parameters[rows:, len(own) :] = errors.parameters
    free = (*(known.free[k] for k in kept), *errors.free)
    return Influence(free, parameters, (*(known.clusters[c] for c in own), *errors.clusters))


def _calibration(parts: Sequence[_Part], nominal: Parameters, settings: JointSettings) -> JointCalibration:
    """All parts together."""
    influence = nominal_influence(prior=settings.prior)
    for part in parts:
        influence = _joined(influence, part.errors)
    free = tuple(name for part in parts for name in part.free)
    parameters = nominal
    for part in parts:
        fitted = part.estimate.parameters
        parameters = parameters.with_joint(part.free, fitted.joint[[JP_INDEX[n] for n in part.free]])
    expected = np.sqrt(np.diag(prior_of(free, settings.prior)[1]))
    errors, spread = influence.standard_errors, dict(zip(free, expected, strict=True))
    unseen = tuple(n for n in free if errors[n] > LEARNT * spread[n])
    unseen_legs = [n for n in unseen if n.startswith(LEG_JOINTS)]
    near = settings.prior.held_near(unseen_legs) if settings.prior else ""
    beyond = tuple(
        n for n in free if abs(parameters.joint[JP_INDEX[n]] - nominal.joint[JP_INDEX[n]]) > _bound(n, settings)
    )
    return JointCalibration(
        parameters=parameters,
        phases=tuple(part.phase for part in parts),
        free=free,
        influence=influence,
        unidentifiable=unseen,
        findings=(
            *(finding for part in parts for finding in part.findings),
            *in_words(unseen_legs, (), f"held near {near or 'nominal values'}", parts[0].turned if parts else {}),
            *beyond_bounds(beyond),
        ),
        notes=(*(settings.prior.notes if settings.prior else ()), *(note for part in parts for note in part.notes)),
        at_bound=beyond,
        tissue={name: tissue for part in parts for name, tissue in part.tissue.items()},
    )


def _bound(name: str, settings: JointSettings) -> float:
    position = JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION
    return settings.position_bound if position else settings.orientation_bound
