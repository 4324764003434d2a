"""All joint parameters of a person by the evidence of all trials: the legs with their skin, then trunk and arms.

An isolated trial is fitted by its joint alone, whose proximal segment is free in the laboratory: neighbours neither
push nor are pushed. Gait is fitted by pelvis and legs. Every joint parameter that a trial can move is free; what the
markers do not tell stays where its prior holds it, with the prior's spread as its error. Trunk and arms, whose skin and
single spine joint make errors of another size, are fitted by themselves in gait, so that they do not hide the legs'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.identifiability import Turns, in_words, small_turns, turns_of
from gaitcal.calibration.influence import Influence, nominal_influence
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_estimate import JointEstimate, estimate_joints, free_of, skin_prior
from gaitcal.calibration.joint_noise import FEWEST_MARKERS
from gaitcal.calibration.joint_phases import JointCalibration, Phase
from gaitcal.calibration.joint_prior import prior_deviations
from gaitcal.calibration.skin_evidence import skin_sizes
from gaitcal.calibration.skin_movement import only, skin_columns
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Kind
from gaitcal.model.linkage import ISOLATED_JOINTS, LOWER_BODY, SEGMENTS, joint_segments
from gaitcal.model.parameters import Parameters
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.start import starting_coordinates
from gaitcal.motion.trial_problem import TrialProblem

UPPER_BODY = tuple(s for s in SEGMENTS if s == "pelvis" or s not in LOWER_BODY)
LEARNT = 0.9
"""A parameter whose standard error is more than this part of its prior's is not determined by the trials."""


@dataclass(frozen=True)
class EvidenceTrial:
    """A trial that takes part."""

    body: TrialProblem
    """The whole body."""
    fitted: TrialProblem
    """An isolated trial on the segments of its joint; gait on the whole body."""
    joint: str | None
    """The joint of an isolated trial; None for gait."""


@dataclass(frozen=True)
class SkinFound:
    """Skin that moves with joints, by the evidence of the legs' markers."""

    sizes: Mapping[tuple[str, str], float]
    """(segment, coordinate) -> size, of the spread that skin has (`skin_movement.py`)."""
    keys: tuple[str, ...]
    values: Array
    """(nz,) m/rad."""


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
    legs = tuple(n for n in JP_NAMES if n.split(".")[0].startswith(_LEG) and n.split(".")[0][-1] in sides)
    used = [t for t in trials if t.joint is None or t.joint[-1] in sides]
    problems = [t.fitted if t.joint else _part(t.fitted, LOWER_BODY, nominal) for t in used]
    free = free_of(problems, legs)
    phases: list[Phase] = []
    influence, warnings = nominal_influence(), list[str]()
    parameters, found = nominal, SkinFound({}, (), np.zeros(0))
    tissue: dict[str, SoftTissue] = {}
    turned: Turns = {}
    if free:
        plain, errors = estimate_joints(problems, nominal, free)
        whole = len(problems)
        quiet = _quiet_joints([t for t in used if t.joint is None], problems, plain, nominal)
        if quiet:
            used, problems = used + [t for t, _ in quiet], problems + [p for _, p in quiet]
            plain, errors = estimate_joints(problems, nominal, free)
        angles = {t.body.name: _angles(t.body, plain.parameters, standing) for t in trials}
        columns = [replace(p, tissue=skin_columns(p, angles[t.body.name])) for t, p in zip(used, problems, strict=True)]
        sizes = skin_sizes(columns[:whole])  # markers of a joint alone are those of its trial
        estimate = plain
        if sizes:
            own = [replace(p, tissue=only(p.tissue, p.chain.segments, sizes)) for p in columns]
            estimate, errors = estimate_joints(own, nominal, free, skin=skin_prior(own, sizes), start=plain)
            found = SkinFound(sizes, estimate.keys, estimate.skin)
            for t in trials:
                own_tissue = only(skin_columns(t.body, angles[t.body.name]), t.body.chain.segments, sizes)
                if own_tissue is not None:
                    tissue[t.body.name] = own_tissue
        phases.append(_phase("joint parameters of the legs", problems, plain, estimate))
        parameters, influence = estimate.parameters, _joined(influence, _with_skin(errors, found))
        for t, p, nodes in zip(used, problems, estimate.nodes, strict=True):
            warnings += small_turns(p, nodes, t.joint) if t.joint else ()
        turned = turns_of(problems[:whole], estimate.nodes[:whole], [t.joint for t in used[:whole]])
    upper = [_part(t.fitted, UPPER_BODY, nominal) for t in trials if t.joint is None]
    rest = free_of(upper, tuple(n for n in JP_NAMES if not n.split(".")[0].startswith(_LEG)))
    if rest:
        trunk, errors = estimate_joints(upper, parameters, rest)
        errors = Influence(errors.free, errors.parameters, tuple(f"{c} of trunk and arms" for c in errors.clusters))
        phases.append(_phase("joint parameters of trunk and arms", upper, trunk, trunk))
        parameters, influence = trunk.parameters, _joined(influence, errors)
    return _calibration(free + rest, parameters, nominal, influence, phases, warnings, settings, tissue, found, turned)


def _quiet_joints(
    walks: Sequence[EvidenceTrial], problems: Sequence[TrialProblem], plain: JointEstimate, nominal: Parameters
) -> list[tuple[EvidenceTrial, TrialProblem]]:
    """Joints of gait trials that follow their markers far better by themselves than the legs as a whole do.

    Where one joint is not what the model has (a knee that rolls), its misfit is the noise of all legs, and pushes their
    other joints. Those that are quiet by themselves take part by themselves, too.
    """
    legs = {p.name: nu for p, nu in zip(problems, plain.noise, strict=True)}
    pieces = [
        (walk, replace(_part(walk.fitted, joint_segments(joint), nominal), name=f"{walk.fitted.name}, {joint} alone"))
        for walk in walks
        for joint in ISOLATED_JOINTS
        if _shows(walk.fitted, joint)
    ]
    free = free_of([piece for _, piece in pieces], plain.free)
    if not free:
        return []
    alone, _ = estimate_joints([piece for _, piece in pieces], nominal, free)
    return [
        (walk, piece)
        for (walk, piece), nu in zip(pieces, alone.noise, strict=True)
        if nu < QUIET * legs[walk.fitted.name]
    ]


def _shows(problem: TrialProblem, joint: str) -> bool:
    """Whether both segments at the ends of a joint show three markers with weight."""
    pulling = np.flatnonzero((problem.data.weight > 0).any(axis=1))
    shown = [problem.chain.segments[s] for s in problem.data.segment[pulling]]
    ends = joint_segments(joint)
    return all(shown.count(segment) >= FEWEST_MARKERS for segment in (ends[0], ends[-1]))


def _part(body: TrialProblem, segments: tuple[str, ...], nominal: Parameters) -> TrialProblem:
    """Some segments of a whole body, the first free in the laboratory, with the same bandwidth."""
    part = body.part(segments[0], segments)
    return with_bandwidth(part, nominal, body.smoothing.cutoff_hz) if body.smoothing else part


QUIET = 0.25
"""Part of the legs' noise below which a joint takes part by itself: what it then says twice is at most a
sixteenth, and a few parameters more than samples do not pass for quiet."""
_LEG = ("hip", "knee", "talocrural", "subtalar")


def _angles(body: TrialProblem, parameters: Parameters, standing: TrialProblem) -> dict[str, Array]:
    """Coordinate -> (nf,) rad from the static posture, of those that a marker of the trial shows."""
    still = starting_coordinates(standing.chain, standing.constants(parameters), standing.data).mean(axis=0)
    posture = dict(zip(standing.chain.coordinates, still, strict=True))
    q = tracked_motion(body, parameters).q
    names = zip(body.chain.coordinates, q.T, body.active, strict=True)
    return {name: values - posture[name] for name, values, active in names if active and name in posture}


def _phase(name: str, problems: Sequence[TrialProblem], first: JointEstimate, last: JointEstimate) -> Phase:
    together = (first,) if first is last else (first, last)
    return Phase(
        name=name,
        trials=tuple(p.name for p in problems),
        parameters=len(last.free) + len(last.keys),
        iterations=sum(e.iterations for e in together),
        seconds=sum(e.seconds for e in together),
        converged=all(e.converged for e in together),
        message=last.message,
        noise={p.name: nu for p, nu in zip(problems, last.noise, strict=True)},
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


def _calibration(
    free: tuple[str, ...],
    parameters: Parameters,
    nominal: Parameters,
    influence: Influence,
    phases: Sequence[Phase],
    warnings: Sequence[str],
    settings: JointSettings,
    tissue: Mapping[str, SoftTissue],
    found: SkinFound,
    turned: Turns,
) -> JointCalibration:
    errors = influence.standard_errors
    spread = dict(zip(free, prior_deviations(free), strict=True))
    unseen = tuple(n for n in free if errors[n] > LEARNT * spread[n])
    beyond = tuple(
        n for n in free if abs(parameters.joint[JP_INDEX[n]] - nominal.joint[JP_INDEX[n]]) > _bound(n, settings)
    )
    return JointCalibration(
        parameters=parameters,
        phases=tuple(phases),
        free=free,
        influence=influence,
        unidentifiable=unseen,
        warnings=(
            *dict.fromkeys(warnings),
            *in_words([n for n in unseen if n.startswith(_LEG)], (), "held near nominal values", turned),
            *(f"{n} lies further from its nominal value than its bound: look at the static trial" for n in beyond),
        ),
        at_bound=beyond,
        skin=dict(found.sizes),
        skin_values=dict(zip(found.keys, found.values.tolist(), strict=True)),
        tissue=dict(tissue),
    )


def _bound(name: str, settings: JointSettings) -> float:
    position = JOINT_PARAMETERS[JP_INDEX[name]].kind is Kind.POSITION
    return settings.position_bound if position else settings.orientation_bound
