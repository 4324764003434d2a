"""All joint parameters of a person by the evidence of all trials: the legs with their skin, then trunk and arms.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory: neighbours neither
push nor are pushed. Gait is fitted by pelvis and legs. Every joint parameter that a trial can move is free; what the
markers do not tell stays where its prior holds it, with the prior's spread as its error. Trunk and arms, whose skin and
single spine joint make errors of another size, are fitted by themselves in gait, so that they do not hide the legs'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from gaitcal.calibration.evidence_part import EvidenceTrial, Part, phase_of, segments_of
from gaitcal.calibration.identifiability import LEG_JOINTS, beyond_bounds, in_words
from gaitcal.calibration.influence import Influence, nominal_influence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import estimate_joints, free_of
from gaitcal.calibration.joint_phases import JointCalibration
from gaitcal.calibration.joint_prior import leans_on_cohort, prior_of
from gaitcal.calibration.leg_evidence import JointAlone, joints_alone, legs_of, plain_legs, with_quiet_joints, with_skin
from gaitcal.calibration.skin_evidence import skin_in_words
from gaitcal.calibration.turned_arms import told, turned_arms, without_arms
from gaitcal.cores import beside
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Kind
from gaitcal.model.linkage import LOWER_BODY, SEGMENTS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))
LEARNT = 0.9
"""A parameter whose standard error is more than this part of its prior's is not determined by the trials."""


def calibrate_by_evidence(
    trials: Sequence[EvidenceTrial],
    nominal: Parameters,
    standing: TrialProblem,
    settings: JointSettings,
    sides: Sequence[str],
) -> JointCalibration:
    """Joint parameters of the legs of `sides`, of the trunk and of the arms.

    `standing`: the whole body in the static trial, where every marker is in its place.
    """
    learnt = settings.learnt
    with beside(partial(_besides, trials, nominal, sides, learnt)) as besides:
        plain = plain_legs(trials, nominal, sides, learnt)
        skin = None if plain is None else with_skin(plain, trials, nominal, standing, learnt)
        upper, alone = besides()
    parts = [] if upper is None else [upper]
    if plain is not None and skin is not None:
        if quiet := [joint for joint in alone if plain.quiet(joint)]:
            plain = with_quiet_joints(plain, quiet, nominal, learnt)
            skin = with_skin(plain, trials, nominal, standing, learnt)
        parts.insert(0, legs_of(plain, skin))
    return _calibration(parts, nominal, settings)


def _besides(
    trials: Sequence[EvidenceTrial], nominal: Parameters, sides: Sequence[str], learnt: JointPrior | None
) -> tuple[Part | None, list[JointAlone]]:
    """What does not wait for the legs."""
    return _trunk_and_arms(trials, nominal, learnt), joints_alone(trials, nominal, sides)


def _trunk_and_arms(trials: Sequence[EvidenceTrial], nominal: Parameters, learnt: JointPrior | None) -> Part | None:
    """Gait by itself above the pelvis; None where nothing is free."""
    walks = [t for t in trials if t.joint is None]
    parts = [segments_of(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers once more: what they do here has a name of its own among the sources of error
    problems = [replace(part, name=f"{part.name}, trunk and arms") for part in parts]
    free = free_of(problems, UPPER_PARAMETERS)
    if not free:
        return None
    trunk, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    if turned := turned_arms(problems, trunk.nodes, nominal):
        free = without_arms(free, turned)
        trunk, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    phase = phase_of("joint parameters of trunk and arms", walks, [t.name for t in walks], trunk)
    return Part(free=free, parameters=trunk.parameters, errors=errors, phase=phase, findings=told(turned))


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


def _calibration(parts: Sequence[Part], nominal: Parameters, settings: JointSettings) -> JointCalibration:
    """All parts together."""
    influence = nominal_influence()
    for part in parts:
        influence = _joined(influence, part.errors)
    free = tuple(name for part in parts for name in part.free)
    parameters = nominal
    for part in parts:
        parameters = parameters.with_joint(part.free, part.parameters.joint[[JP_INDEX[n] for n in part.free]])
    expected = np.sqrt(np.diag(prior_of(free, settings.learnt)[1]))
    errors, spread = influence.standard_errors, dict(zip(free, expected, strict=True))
    unseen = tuple(n for n in free if errors[n] > LEARNT * spread[n])
    unseen_legs = [n for n in unseen if n.startswith(LEG_JOINTS)]
    leaning = leans_on_cohort(unseen_legs, settings.learnt)
    beyond = tuple(
        n for n in free if abs(parameters.joint[JP_INDEX[n]] - nominal.joint[JP_INDEX[n]]) > _bound(n, settings)
    )
    sizes = {pair: size for part in parts for pair, size in part.skin.believed.sizes.items()}
    hidden = frozenset(segment for part in parts for segment in part.skin.believed.hidden)
    return JointCalibration(
        parameters=parameters,
        phases=tuple(part.phase for part in parts),
        free=free,
        influence=influence,
        unidentifiable=unseen,
        findings=(
            *(finding for part in parts for finding in part.findings),
            *in_words(
                unseen_legs,
                (),
                f"held near {'what the cohort has' if leaning else 'nominal values'}",
                parts[0].turned if parts else {},
            ),
            *beyond_bounds(beyond),
        ),
        notes=(*(settings.learnt.notes if settings.learnt else ()), *skin_in_words(sizes, hidden)),
        at_bound=beyond,
        skin=sizes,
        tissue={name: tissue for part in parts for name, tissue in part.tissue.items()},
    )


def _bound(name: str, settings: JointSettings) -> float:
    position = JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION
    return settings.position_bound if position else settings.orientation_bound
