"""Joint parameters of the legs by the evidence of all trials: first plain, then with quiet joints and with skin.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory; gait by pelvis and
legs. Joints of a walk that are far quieter by themselves take part by themselves, too; then skin is added where the
markers' deformation tells of it, or where nothing shows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.evidence_part import EvidenceTrial, Part, phase_of, segments_of
from gaitcal.calibration.identifiability import LEG_JOINTS, small_turns, turns_of
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints, free_of, skin_prior
from gaitcal.calibration.noise_search import noise_of_joints
from gaitcal.calibration.skin_evidence import NO_SKIN_FOUND, SkinFound, skin_sizes
from gaitcal.calibration.skin_movement import only, skin_columns
from gaitcal.cores import ahead, each
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.model.linkage import ISOLATED_JOINTS, LOWER_BODY, joint_segments
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.start import starting_coordinates
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
QUIET = 0.25
"""Part of the legs' noise below which a joint takes part by itself: what it then says twice is at most a
sixteenth, and a few parameters more than samples do not pass for quiet."""


_Piece = tuple[EvidenceTrial, TrialProblem]
"""A walk, and one of its joints alone."""


@dataclass(frozen=True, kw_only=True)
class PlainLegs:
    """The legs fitted without skin."""

    used: tuple[EvidenceTrial, ...]
    """Those that take part; a walk once more for each joint of it that takes part by itself."""
    problems: tuple[TrialProblem, ...]
    """The part of each that is fitted."""
    whole: int
    """How many of them are trials as they are; joints of a walk by themselves come after."""
    free: tuple[str, ...]
    estimate: JointEstimate
    errors: Influence


@dataclass(frozen=True, kw_only=True)
class _LegsWithSkin:
    estimate: JointEstimate
    errors: Influence
    skin: SkinFound = NO_SKIN_FOUND
    tissue: Mapping[str, SoftTissue]


def plain_legs(
    trials: Sequence[EvidenceTrial], nominal: Parameters, sides: Sequence[str], learnt: JointPrior | None
) -> PlainLegs | None:
    """Isolated trials of `sides` and gait together, skin being still; None where nothing is free."""
    used = tuple(t for t in trials if t.joint is None or t.joint[-1] in sides)
    problems = tuple(t.fitted if t.joint else segments_of(t.fitted, LOWER_BODY, nominal) for t in used)
    free = free_of(problems, tuple(n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides))
    if not free:
        return None
    estimate, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    return PlainLegs(used=used, problems=problems, whole=len(problems), free=free, estimate=estimate, errors=errors)


def legs_with_skin(
    plain: PlainLegs,
    trials: Sequence[EvidenceTrial],
    nominal: Parameters,
    standing: TrialProblem,
    learnt: JointPrior | None,
) -> Part:
    """The same with the joints that are quiet by themselves, and with the skin that there is evidence of, or that
    nothing shows.
    """
    angles = _angles_by_trial(plain, trials, standing)
    quiet, unless_quiet = ahead(
        lambda: _quiet_joints(plain, nominal), lambda: _with_skin(plain, trials, angles, nominal, learnt)
    )
    if quiet:
        plain = _with_quiet_joints(plain, quiet, nominal, learnt)
        found = _with_skin(plain, trials, _angles_by_trial(plain, trials, standing), nominal, learnt)
    else:
        found = unless_quiet()
    estimate = found.estimate
    pieces = list(zip(plain.used, plain.problems, estimate.nodes, strict=True))
    turns = [small_turns(problem, nodes, t.joint) for t, problem, nodes in pieces if t.joint]
    alike = pieces[: plain.whole]
    return Part(
        free=plain.free,
        parameters=estimate.parameters,
        errors=_and_skin(found.errors, found.skin),
        phase=phase_of(
            "joint parameters of the legs", plain.used, [p.name for p in plain.problems], plain.estimate, estimate
        ),
        findings=tuple(dict.fromkeys(finding for of_trial in turns for finding in of_trial)),
        turned=turns_of([p for _, p, _ in alike], [n for _, _, n in alike], [t.joint for t, _, _ in alike]),
        skin=found.skin,
        tissue=found.tissue,
    )


def _with_quiet_joints(
    plain: PlainLegs, quiet: Sequence[_Piece], nominal: Parameters, learnt: JointPrior | None
) -> PlainLegs:
    used = (*plain.used, *(t for t, _ in quiet))
    problems = (*plain.problems, *(p for _, p in quiet))
    estimate, errors = estimate_joints(problems, nominal, plain.free, learnt=learnt)
    return replace(plain, used=used, problems=problems, estimate=estimate, errors=errors)


def _with_skin(
    plain: PlainLegs,
    trials: Sequence[EvidenceTrial],
    angles: Mapping[str, Mapping[str, Array]],
    nominal: Parameters,
    learnt: JointPrior | None,
) -> _LegsWithSkin:
    """A fit from the plain one with skin that moves with `angles`, where there is any."""
    free, first = plain.free, plain.estimate
    pairs = zip(plain.used, plain.problems, strict=True)
    columns = [replace(problem, tissue=skin_columns(problem, angles[t.name])) for t, problem in pairs]
    believed = skin_sizes(columns[: plain.whole])  # markers of a joint alone are those of its trial
    sizes = believed.sizes
    if not sizes:
        return _LegsWithSkin(estimate=first, errors=plain.errors, tissue={})
    own = [replace(p, tissue=only(p.tissue, p.chain.segments, sizes)) for p in columns]
    estimate, errors = estimate_joints(own, nominal, free, skin=skin_prior(own, sizes), start=first, learnt=learnt)
    tissue = {t.name: only(skin_columns(t.body, angles[t.name]), t.body.chain.segments, sizes) for t in trials}
    return _LegsWithSkin(
        estimate=estimate,
        errors=errors,
        skin=SkinFound(believed, estimate.keys, estimate.skin),
        tissue={name: moving for name, moving in tissue.items() if moving is not None},
    )


def _quiet_joints(plain: PlainLegs, nominal: Parameters) -> list[_Piece]:
    """Joints of gait trials that follow their markers far better by themselves than the legs as a whole do.

    Where one joint is not what the model has (a knee that rolls), its misfit is the noise of all legs, and pushes their
    other joints. Those that are quiet by themselves take part by themselves, too.
    """
    legs = {p.name: nu for p, nu in zip(plain.problems, plain.estimate.noise, strict=True)}
    pieces = [
        (walk, replace(segments_of(walk.fitted, joint_segments(joint), nominal), name=f"{walk.name}, {joint} alone"))
        for walk in plain.used
        for joint in ISOLATED_JOINTS
        if walk.joint is None and _shows(walk.fitted, joint)
    ]
    free = free_of([piece for _, piece in pieces], plain.estimate.free)
    if not free:
        return []
    alone = noise_of_joints([piece for _, piece in pieces], nominal, free, plain.estimate.parameters)
    return [(walk, piece) for (walk, piece), nu in zip(pieces, alone, strict=True) if nu < QUIET * legs[walk.name]]


def _shows(problem: TrialProblem, joint: str) -> bool:
    """Whether both segments at the ends of a joint show three markers with weight."""
    pulling = (problem.data.weight > 0).any(axis=1)
    shown = [problem.chain.segments[s] for s in problem.data.segment[pulling]]
    ends = joint_segments(joint)
    return all(shown.count(segment) >= FEWEST_MARKERS for segment in (ends[0], ends[-1]))


def _angles_by_trial(
    plain: PlainLegs, trials: Sequence[EvidenceTrial], standing: TrialProblem
) -> dict[str, dict[str, Array]]:
    """Trial -> coordinate -> (nf,) rad, at the plain joint parameters."""
    told = each(lambda t: _angles(t.body, plain.estimate.parameters, standing), trials)
    return {t.name: angles for t, angles in zip(trials, told, strict=True)}


def _angles(body: TrialProblem, parameters: Parameters, standing: TrialProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad from the static posture, of those that a marker of the trial shows."""
    still = starting_coordinates(standing.chain, standing.constants(parameters), standing.data).mean(axis=0)
    posture = dict(zip(standing.chain.coordinates, still, strict=True))
    q = tracked_motion(body, parameters).q
    names = zip(body.chain.coordinates, q.T, body.active, strict=True)
    return {name: values - posture[name] for name, values, active in names if active and name in posture}


def _and_skin(errors: Influence, found: SkinFound) -> Influence:
    """Motions are tracked with markers in their places: the skin found is an error of theirs, all of it."""
    if not found.keys:
        return errors
    column = np.zeros((len(errors.free), 1))
    column[[errors.free.index(key) for key in found.keys], 0] = found.values
    return Influence(errors.free, np.hstack([errors.parameters, column]), (*errors.clusters, "skin/found"))
