"""Joint parameters of the legs by the evidence of all trials: first plain, then with quiet joints and with skin.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory; gait by pelvis and
legs. Joints of a walk that are far quieter by themselves take part by themselves, too; then skin is added where the
markers' deformation tells of it, or where nothing shows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.evidence_part import EvidenceTrial, Part, phase_of, segments_of
from gaitcal.calibration.identifiability import LEG_JOINTS, small_turns, turns_of
from gaitcal.calibration.influence import Influence
from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints, free_of, skin_prior
from gaitcal.calibration.noise_search import NearJoints, near_joints
from gaitcal.calibration.skin_evidence import NO_SKIN_FOUND, SkinFound, skin_sizes
from gaitcal.calibration.skin_movement import only, skin_columns
from gaitcal.cores import each
from gaitcal.model.joint_parameters import JP_NAMES
from gaitcal.model.linkage import ISOLATED_JOINTS, LOWER_BODY, joint_segments
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.start import starting_coordinates
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.records import dataclass
from gaitcal.study.joint_prior import JointPrior

LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
QUIET = 0.25
"""Part of the legs' noise below which a joint takes part by itself: what it then says twice is at most a
sixteenth, and a few parameters more than samples do not pass for quiet."""


@dataclass(frozen=True)
class JointAlone:
    """A joint of a walk fitted without the rest of the body."""

    walk: str
    """Name of the trial."""
    problem: TrialProblem
    noise: float
    """m, what it leaves."""


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
    near: NearJoints

    def quiet(self, joint: JointAlone) -> bool:
        """Whether a joint follows its markers far better by itself than the legs of the same walk as a whole do."""
        names = [t.name for t in self.used]
        return joint.noise < QUIET * self.near.noise[names.index(joint.walk)]


@dataclass(frozen=True, kw_only=True)
class LegsWithSkin:
    """The legs fitted with the skin that there is evidence of, or that nothing shows."""

    estimate: JointEstimate
    errors: Influence
    skin: SkinFound = NO_SKIN_FOUND
    tissue: Mapping[str, SoftTissue]
    """Trial -> the columns of that skin on the markers of the whole body."""


def plain_legs(
    trials: Sequence[EvidenceTrial], nominal: Parameters, sides: Sequence[str], learnt: JointPrior | None
) -> PlainLegs | None:
    """Isolated trials of `sides` and gait together, skin being still; None where nothing is free."""
    used = tuple(t for t in trials if t.joint is None or t.joint[-1] in sides)
    problems = tuple(t.fitted if t.joint else segments_of(t.fitted, LOWER_BODY, nominal) for t in used)
    free = free_of(problems, _parameters_of(sides))
    if not free:
        return None
    near = near_joints(problems, nominal, free, learnt)
    return PlainLegs(used=used, problems=problems, whole=len(problems), free=free, near=near)


def legs_of(plain: PlainLegs, found: LegsWithSkin) -> Part:
    """What the fit of the legs gives."""
    estimate = found.estimate
    pieces = list(zip(plain.used, plain.problems, estimate.nodes, strict=True))
    turns = [small_turns(problem, nodes, t.joint) for t, problem, nodes in pieces if t.joint]
    alike = pieces[: plain.whole]
    return Part(
        free=plain.free,
        parameters=estimate.parameters,
        errors=_and_skin(found.errors, found.skin),
        phase=phase_of("joint parameters of the legs", plain.used, [p.name for p in plain.problems], estimate),
        findings=tuple(dict.fromkeys(finding for of_trial in turns for finding in of_trial)),
        turned=turns_of([p for _, p, _ in alike], [n for _, _, n in alike], [t.joint for t, _, _ in alike]),
        skin=found.skin,
        tissue=found.tissue,
    )


def with_quiet_joints(
    plain: PlainLegs, quiet: Sequence[JointAlone], nominal: Parameters, learnt: JointPrior | None
) -> PlainLegs:
    """The same fit with some joints of walks once more, by themselves."""
    of_name = {t.name: t for t in plain.used}
    used = (*plain.used, *(of_name[joint.walk] for joint in quiet))
    problems = (*plain.problems, *(joint.problem for joint in quiet))
    near = near_joints(problems, nominal, plain.free, learnt)
    return replace(plain, used=used, problems=problems, near=near)


def with_skin(
    plain: PlainLegs,
    trials: Sequence[EvidenceTrial],
    nominal: Parameters,
    standing: TrialProblem,
    learnt: JointPrior | None,
) -> LegsWithSkin:
    """A fit from the plain one with skin, where there is any."""
    free, near = plain.free, plain.near
    parameters = nominal.with_joint(free, near.state.p)
    told = each(lambda t: _angles(t.body, parameters, standing), trials)
    angles = {t.name: of_trial for t, of_trial in zip(trials, told, strict=True)}
    pairs = zip(plain.used, plain.problems, strict=True)
    columns = [replace(problem, tissue=skin_columns(problem, angles[t.name])) for t, problem in pairs]
    believed = skin_sizes(columns[: plain.whole])  # markers of a joint alone are those of its trial
    sizes = believed.sizes
    if not sizes:
        estimate, errors = estimate_joints(plain.problems, nominal, free, near=near, learnt=learnt)
        return LegsWithSkin(estimate=estimate, errors=errors, tissue={})
    own = [replace(p, tissue=only(p.tissue, p.chain.segments, sizes)) for p in columns]
    estimate, errors = estimate_joints(own, nominal, free, skin=skin_prior(own, sizes), near=near, learnt=learnt)
    tissue = {t.name: only(skin_columns(t.body, angles[t.name]), t.body.chain.segments, sizes) for t in trials}
    return LegsWithSkin(
        estimate=estimate,
        errors=errors,
        skin=SkinFound(believed, estimate.keys, estimate.skin),
        tissue={name: moving for name, moving in tissue.items() if moving is not None},
    )


def joints_alone(trials: Sequence[EvidenceTrial], nominal: Parameters, sides: Sequence[str]) -> list[JointAlone]:
    """The joints of the legs of `sides` in walks, each by itself.

    Where one joint is not what the model has (a knee that rolls), its misfit is the noise of all legs, and pushes their
    other joints. Those that are far quieter by themselves take part by themselves, too.
    """
    pieces = [
        (t.name, replace(segments_of(t.fitted, joint_segments(joint), nominal), name=f"{t.name}, {joint} alone"))
        for t in trials
        for joint in ISOLATED_JOINTS
        if t.joint is None and _shows(t.fitted, joint)
    ]
    problems = [problem for _, problem in pieces]
    free = free_of(problems, _parameters_of(sides))
    if not free:
        return []
    noise = near_joints(problems, nominal, free).noise
    return [JointAlone(walk, problem, nu) for (walk, problem), nu in zip(pieces, noise, strict=True)]


def _parameters_of(sides: Sequence[str]) -> tuple[str, ...]:
    return tuple(n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides)


def _shows(problem: TrialProblem, joint: str) -> bool:
    """Whether both segments at the ends of a joint show three markers with weight."""
    pulling = (problem.data.weight > 0).any(axis=1)
    shown = [problem.chain.segments[s] for s in problem.data.segment[pulling]]
    ends = joint_segments(joint)
    return all(shown.count(segment) >= FEWEST_MARKERS for segment in (ends[0], ends[-1]))


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
