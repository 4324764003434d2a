"""All joint parameters of a person by the evidence of all trials: the legs with their skin, then trunk and arms.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory: neighbours neither
push nor are pushed. Gait is fitted by pelvis and legs. Every joint parameter that a trial can move is free; what the
markers do not tell stays where its prior holds it, with the prior's spread as its error. Trunk and arms, whose skin and
single spine joint make errors of another size, are fitted by themselves in gait, so that they do not hide the legs'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.identifiability import LEG_JOINTS, Turns, beyond_bounds, in_words, small_turns, turns_of
from gaitcal.calibration.influence import Influence, nominal_influence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints, free_of, skin_prior
from gaitcal.calibration.joint_phases import JointCalibration, Phase
from gaitcal.calibration.joint_prior import leans_on_cohort, prior_of
from gaitcal.calibration.noise_search import noise_of_joints
from gaitcal.calibration.skin_evidence import NO_SKIN_FOUND, SkinFound, skin_in_words, skin_sizes
from gaitcal.calibration.skin_movement import only, skin_columns
from gaitcal.calibration.turned_arms import told, turned_arms, without_arms
from gaitcal.cores import all_of
from gaitcal.findings import Finding
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Kind
from gaitcal.model.linkage import ISOLATED_JOINTS, LOWER_BODY, SEGMENTS, joint_segments
from gaitcal.model.parameters import Parameters
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.start import starting_coordinates
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.joint_prior import JointPrior

UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEG_PARAMETERS = tuple(n for n in JP_NAMES if n.startswith(LEG_JOINTS))
UPPER_PARAMETERS = tuple(n for n in JP_NAMES if not n.startswith(LEG_JOINTS))
LEARNT = 0.9
"""A parameter whose standard error is more than this part of its prior's is not determined by the trials."""
QUIET = 0.25
"""Part of the legs' noise below which a joint takes part by itself: what it then says twice is at most a
sixteenth, and a few parameters more than samples do not pass for quiet."""


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


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What the fit of one part of the body gives."""

    free: tuple[str, ...]
    parameters: Parameters
    errors: Influence
    """Of `free`."""
    phase: Phase
    findings: tuple[Finding, ...] = ()
    turned: Turns = field(default_factory=dict)
    """How far isolated trials move their joints."""
    skin: SkinFound = NO_SKIN_FOUND
    tissue: Mapping[str, SoftTissue] = field(default_factory=dict)
    """Trial -> the columns of that skin on the markers of the whole body."""


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
    parts = all_of(
        lambda: _legs(trials, nominal, standing, sides, settings.learnt),
        lambda: _trunk_and_arms(trials, nominal, settings.learnt),
    )
    return _calibration([part for part in parts if part is not None], nominal, settings)


def _legs(
    trials: Sequence[EvidenceTrial],
    nominal: Parameters,
    standing: TrialProblem,
    sides: Sequence[str],
    learnt: JointPrior | None,
) -> _Part | None:
    """Isolated trials of `sides` and gait, with the skin that there is evidence of, or that nothing shows;
    None where nothing is free.
    """
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    problems = [t.fitted if t.joint else _segments(t.fitted, LOWER_BODY, nominal) for t in used]
    free = free_of(problems, tuple(n for n in LEG_PARAMETERS if n.split(".")[0][-1] in sides))
    if not free:
        return None
    plain, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    whole = len(problems)
    quiet = _quiet_joints([t for t in used if t.joint is None], problems, plain, nominal)
    if quiet:
        used, problems = used + [t for t, _ in quiet], problems + [p for _, p in quiet]
        plain, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    angles = {t.name: _angles(t.body, plain.parameters, standing) for t in trials}
    columns = [replace(p, tissue=skin_columns(p, angles[t.name])) for t, p in zip(used, problems, strict=True)]
    believed = skin_sizes(columns[:whole])  # markers of a joint alone are those of its trial
    sizes = believed.sizes
    estimate, skin, tissue = plain, NO_SKIN_FOUND, dict[str, SoftTissue]()
    if sizes:
        own = [replace(p, tissue=only(p.tissue, p.chain.segments, sizes)) for p in columns]
        estimate, errors = estimate_joints(own, nominal, free, skin=skin_prior(own, sizes), start=plain, learnt=learnt)
        skin = SkinFound(believed, estimate.keys, estimate.skin)
        for t in trials:
            moving = only(skin_columns(t.body, angles[t.name]), t.body.chain.segments, sizes)
            if moving is not None:
                tissue[t.name] = moving
    turns = [small_turns(p, n, t.joint) for t, p, n in zip(used, problems, estimate.nodes, strict=True) if t.joint]
    return _Part(
        free=free,
        parameters=estimate.parameters,
        errors=_with_skin(errors, skin),
        phase=_phase("joint parameters of the legs", used, [p.name for p in problems], plain, estimate),
        findings=tuple(dict.fromkeys(finding for of_trial in turns for finding in of_trial)),
        turned=turns_of(problems[:whole], estimate.nodes[:whole], [t.joint for t in used[:whole]]),
        skin=skin,
        tissue=tissue,
    )


def _trunk_and_arms(trials: Sequence[EvidenceTrial], nominal: Parameters, learnt: JointPrior | None) -> _Part | None:
    """Gait by itself above the pelvis; None where nothing is free."""
    walks = [t for t in trials if t.joint is None]
    parts = [_segments(t.fitted, UPPER_BODY, nominal) for t in walks]
    # the pelvis' markers once more: what they do here has a name of its own among the sources of error
    problems = [replace(part, name=f"{part.name}, trunk and arms") for part in parts]
    free = free_of(problems, UPPER_PARAMETERS)
    if not free:
        return None
    trunk, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    if turned := turned_arms(problems, trunk.nodes, nominal):
        free = without_arms(free, turned)
        trunk, errors = estimate_joints(problems, nominal, free, learnt=learnt)
    phase = _phase("joint parameters of trunk and arms", walks, [t.name for t in walks], trunk, trunk)
    return _Part(free=free, parameters=trunk.parameters, errors=errors, phase=phase, findings=told(turned))


def _quiet_joints(
    walks: Sequence[EvidenceTrial], problems: Sequence[TrialProblem], plain: JointEstimate, nominal: Parameters
) -> list[tuple[EvidenceTrial, TrialProblem]]:
    """Joints of gait trials that follow their markers far better by themselves than the legs as a whole do.

    Where one joint is not what the model has (a knee that rolls), its misfit is the noise of all legs, and pushes their
    other joints. Those that are quiet by themselves take part by themselves, too.
    """
    legs = {p.name: nu for p, nu in zip(problems, plain.noise, strict=True)}
    pieces = [
        (walk, replace(_segments(walk.fitted, joint_segments(joint), nominal), name=f"{walk.name}, {joint} alone"))
        for walk in walks
        for joint in ISOLATED_JOINTS
        if _shows(walk.fitted, joint)
    ]
    free = free_of([piece for _, piece in pieces], plain.free)
    if not free:
        return []
    alone = noise_of_joints([piece for _, piece in pieces], nominal, free, plain.parameters)
    return [(walk, piece) for (walk, piece), nu in zip(pieces, alone, strict=True) if nu < QUIET * legs[walk.name]]


def _shows(problem: TrialProblem, joint: str) -> bool:
    """Whether both segments at the ends of a joint show three markers with weight."""
    pulling = (problem.data.weight > 0).any(axis=1)
    shown = [problem.chain.segments[s] for s in problem.data.segment[pulling]]
    ends = joint_segments(joint)
    return all(shown.count(segment) >= FEWEST_MARKERS for segment in (ends[0], ends[-1]))


def _segments(body: TrialProblem, segments: tuple[str, ...], nominal: Parameters) -> TrialProblem:
    """Some segments of a whole body, the first free in the laboratory, with the same bandwidth."""
    part = body.part(segments[0], segments)
    return with_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part


def _angles(body: TrialProblem, parameters: Parameters, standing: TrialProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad from the static posture, of those that a marker of the trial shows."""
    still = starting_coordinates(standing.chain, standing.constants(parameters), standing.data).mean(axis=0)
    posture = dict(zip(standing.chain.coordinates, still, strict=True))
    q = tracked_motion(body, parameters).q
    names = zip(body.chain.coordinates, q.T, body.active, strict=True)
    return {name: values - posture[name] for name, values, active in names if active and name in posture}


def _phase(
    name: str, trials: Sequence[EvidenceTrial], pieces: Sequence[str], first: JointEstimate, last: JointEstimate
) -> Phase:
    """`pieces`: what the noise of each of the `trials` is told as; a joint of a walk alone is not the walk."""
    together = (first,) if first is last else (first, last)
    return Phase(
        name=name,
        trials=tuple(dict.fromkeys(t.name for t in trials)),
        parameters=len(last.free) + len(last.keys),
        iterations=sum(e.iterations for e in together),
        seconds=sum(e.seconds for e in together),
        converged=all(e.converged for e in together),
        message=last.message,
        noise=dict(zip(pieces, last.noise, strict=True)),
    )


def _with_skin(errors: Influence, found: SkinFound) -> Influence:
    """Motions are tracked with markers in their places: the skin found is an error of theirs, all of it."""
    if not found.keys:
        return errors
    column = np.zeros((len(errors.free), 1))
    column[[errors.free.index(key) for key in found.keys], 0] = found.values
    return Influence(errors.free, np.hstack([errors.parameters, column]), (*errors.clusters, "skin/found"))


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
