"""All joint parameters of a person by the evidence of all trials: the legs with their soft tissue, then trunk and arms.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory: neighbours neither
push nor are pushed. Gait is fitted by pelvis and legs. Every joint parameter that a trial can move is free; what the
markers do not tell stays where its prior holds it, with the prior's spread as its error. Trunk and arms, whose skin and
single spine joint make errors of another size, are fitted by themselves in gait, so that they do not hide the legs'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.calibration.combined import arm_ambiguity, told, without_arms
from gaitcal.calibration.error_sources import ErrorSources, nominal_influence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import JointEstimate, TaskTrials, free_of
from gaitcal.calibration.joint_phases import (
    FittedPhase,
    JointCalibration,
    JointPhase,
    JointTrial,
    PhaseSettings,
    calibration_of,
    fit_phase,
)
from gaitcal.calibration.joint_prior import ANATOMY, GAIT, LEAST_SQUARES, task_tissue
from gaitcal.calibration.soft_tissue_artefact import SoftTissueScale
from gaitcal.model.linkage import LEG_JOINTS, LOWER_BODY, SEGMENTS
from gaitcal.model.parameters import JP_NAMES, Parameters
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))


@dataclass(frozen=True)
class _Legs:
    """What the fit of the legs gives besides."""

    phase: FittedPhase
    tissue: Mapping[str, SoftTissue]
    """Trial -> the columns of its soft tissue on the markers of the whole body."""
    notes: tuple[str, ...]


def calibrate_by_evidence(
    trials: Sequence[JointTrial],
    nominal: Parameters,
    bounds: JointSettings,
    sides: Sequence[str],
    prior: JointPrior = ANATOMY,
) -> JointCalibration:
    """Joint parameters of the legs of `sides`, of the trunk and of the arms; those beyond `bounds` are told."""
    how = PhaseSettings(prior=prior)
    legs = _legs(trials, nominal, sides, how)
    upper = _trunk_and_arms(trials, nominal, how)
    done = [phase for phase in (None if legs is None else legs.phase, upper) if phase is not None]
    whole = calibration_of(done, nominal, prior, bounds, nominal_influence(prior=prior))
    return whole if legs is None else replace(whole, notes=(*whole.notes, *legs.notes), tissue=legs.tissue)


def _legs(trials: Sequence[JointTrial], nominal: Parameters, sides: Sequence[str], how: PhaseSettings) -> _Legs | None:
    """Isolated trials of `sides` and gait together; None where nothing is free."""
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    kinds = list(dict.fromkeys(t.kind for t in used))
    used.sort(key=lambda t: kinds.index(t.kind))
    still = {t.name: t.fitted if t.joint else segments_of(t.fitted, LOWER_BODY, nominal) for t in used}
    free = free_of(list(still.values()), [n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides])
    if not free:
        return None
    soft = task_tissue({t.name: t.kind for t in used}, still, nominal)
    tasks = tuple(TaskTrials(kind, tuple(still[t.name] for t in used if t.kind == kind)) for kind in kinds)
    plan = JointPhase(
        name="joint parameters of the legs", tasks=tasks, free=free, recordings=tuple(t.name for t in used)
    ).with_tissue(soft)
    phase = fit_phase(plan, nominal, how)
    return _Legs(
        phase=replace(phase, errors=_with_found_tissue(phase.errors, phase.estimate)),
        tissue=soft.of_bodies({t.name: t.body for t in used}, plan.tissue.keys),
        notes=_in_words(soft.scales, phase.estimate),
    )


def _with_found_tissue(errors: ErrorSources, estimate: JointEstimate) -> ErrorSources:
    """Motions are tracked with markers in their places: the soft tissue found is an error of theirs, all of it."""
    if not estimate.keys:
        return errors
    column = np.zeros((len(errors.free), 1))
    column[len(estimate.free) :, 0] = estimate.tissue
    return ErrorSources(errors.free, np.hstack([errors.parameters, column]), (*errors.clusters, "skin/found"))


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


def _trunk_and_arms(trials: Sequence[JointTrial], nominal: Parameters, how: PhaseSettings) -> FittedPhase | None:
    """Gait by itself above the pelvis; None where nothing is free."""
    walks = [t for t in trials if t.joint is None]
    parts = [segments_of(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers once more: what they do here has a name of its own among the sources of error
    task = TaskTrials(GAIT, tuple(replace(part, name=f"{part.name}, trunk and arms") for part in parts))
    plan = JointPhase(
        name="joint parameters of trunk and arms",
        tasks=(task,),
        free=free_of(task.problems, UPPER_PARAMETERS),
        recordings=tuple(t.name for t in walks),
    )
    if not plan.free:
        return None
    found = fit_phase(plan, nominal, how)
    if turned := arm_ambiguity(task.problems, found.estimate.nodes, nominal):
        found = fit_phase(replace(plan, free=without_arms(plan.free, turned)), nominal, how)
    return replace(found, findings=told(turned))
