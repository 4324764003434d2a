"""How near the truth, and do the error bars hold? One table over people, kinds of error and seeds.

    truth [--parts gait,isolated,functional,synthetic] [--only p01,p18] [--seeds 6] [--jobs 2]
    [--kinds none,linear,...]
        [--set key=value ...]

gait        people of `opensim_truth`, walk and static trial: joint centres, torques against
            OpenSim's own
isolated    the same people's six isolated trials, made by OpenSim once (extra `peers`): joint
            centres and axes, beside SCoRE and SARA
functional  the same people's walk alone, and with a trial of each hip that is isolated, or is any
            motion: hip centres
synthetic   people of our own linkage through C3D files, as `gaitcal synthesize --noise --perturb`
            writes them
recovery    the same, every joint and inertial parameter by itself (`truth/made_up.py`); `--know`
            says what is known
published   the published subject with the published noise, `--seeds` draws of it
            (`truth/made_up.py`): how many intervals of joint parameters, coordinates, torques,
            powers and moment vectors hold the truth

Markers are moved as `truth/skin.py` tells: not at all (`none`; one fit a person), by the published
waves, by skin that follows the joints or its own time. `before` is the nominal model, `peer` SCoRE
or SARA (RMS), `SE` the RMS of the standard errors, then how many intervals of 68 and 95 % held the
truth (a fixed parameter has none, which holds nothing) of how many. Settings are gaitcal's defaults
but for `--set`, as `[calibration]` has them.

Joint centres of a walk are compared in the laboratory, frame by frame, after the turn that the
calibration gave the recording: the hip as a point; knee and ankle as points too, and across their
axes, along which a hinge tells nothing. The hip is also compared in pelvis and thigh, as parameters
with error bars. Torques are compared, in valid frames, with OpenSim's inverse dynamics of its own
model on its own motion, whose masses are not ours and whose knee is no hinge. It laid up to 8 N,
more across the floor than into it, on feet in mid-swing, which no plate bears: the torques that
these make are taken off the truth.

SCoRE and SARA find joint centres and axes from two clusters of markers alone, to stand beside ours.
(R_i, p_i) and (S_i, q_i) are the poses of the two segments in frame i; c and d a point's
coordinates in them.

    SCoRE   minimises sum |R_i c + p_i - S_i d - q_i|^2 over (c, d): the point that both
            segments carry most alike (Ehrig, Taylor, Duda and Heller, J Biomech 39:2798-2809, 2006)
    SARA    where both segments turn about one axis, these equations (R_i  -S_i) (c; d) = q_i - p_i
            do not see (n; m), that axis in either: the right singular vector of the least singular
            value. The least-norm solution across it is a point of the axis (Ehrig, Taylor, Duda and
            Heller, J Biomech 40:2150-2157, 2007)
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal import COORDINATES, Calibration, Motion, Study
from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.export.opensim.peer_model import Axis
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import compute_coordinate_axes
from gaitcal.model.parameters import Parameters
from gaitcal.model.segment_frames import Frame, fit_rigid_motions
from gaitcal.study.study_trial import Role
from scripts.validation.harness import (
    Bars,
    bars,
    matching,
    option,
    rms,
    say,
    side_by_side,
    words_of,
)
from scripts.validation.recordings import SIMULATED, data
from scripts.validation.truth import made_up, report
from scripts.validation.truth.people import (
    DIRECTIONS,
    IsolatedPerson,
    WalkingPerson,
    at_times,
    hip_parameters,
    isolated_person,
    leg_parameters,
    line_in,
    made,
    static_frames,
    walking_person,
    with_settings,
    x_axis,
    z_axis,
)
from scripts.validation.truth.report import (
    Figure,
    Fitted,
    Gathered,
    Outcome,
    fitted_parameters,
    timed_fit,
)
from scripts.validation.truth.skin import FIVE, OF_PEOPLE, Kind, beside, disturbed


def angle(one: Array, other: Array) -> float:
    """Angle (deg, 0 to 90) of two directions, whichever way either of them points."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), abs(one @ other))))


def across(vectors: Array, direction: Array) -> Array:
    """The part of vectors (..., 3) at right angles to unit vectors (..., 3)."""
    out: Array = vectors - (vectors * direction).sum(axis=-1, keepdims=True) * direction
    return out


Poses = tuple[Array, Array]
"""(nf, 3, 3) and (nf, 3) m."""


def score(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    """The joint's centre (3,) m in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    both = np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], dtype=np.float64)
    return both[:3], both[3:]


def sara(proximal: Poses, distal: Poses) -> tuple[Axis, Axis]:
    """The joint's axis in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    both = vt[:-1].T @ ((u[:, :-1].T @ right) / s[:-1])
    n, m = vt[-1, :3], vt[-1, 3:]
    return Axis(both[:3], n / np.linalg.norm(n)), Axis(both[3:], m / np.linalg.norm(m))


def _equations(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    matrix = np.concatenate([proximal[0], -distal[0]], axis=2).reshape(-1, 6)
    return matrix, (distal[1] - proximal[1]).ravel()


JOINT_OF = {"hip": "hip_flexion", "knee": "knee_angle", "ankle": "ankle_angle"}
"""Joint -> the coordinate whose axis passes through its centre."""
TORQUES = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "ankle_angle",
    "subtalar_angle",
)


def gait(
    name: str, kind: Kind, seed: int, size_mm: float, changes: Mapping[str, object], data: Path
) -> Outcome:
    person = walking_person(name, data)
    study = disturbed(with_settings(person.study, changes), kind, size_mm, seed)
    fit = timed_fit(study)
    return fit.outcome("gait", kind.value, name, seed, compare_gait(fit.calibration, person, study))


def compare_gait(
    calibration: Calibration, person: WalkingPerson, study: Study
) -> dict[str, Figure]:
    (walk,) = study.moving
    trial = calibration.trial(walk.name)
    rotation, origin = whole_turn(walk.recording.markers, trial.recording.markers)
    gathered = Gathered()
    models = {
        "error": (calibration.model.parameters, trial.body),
        "before": (calibration.nominal.parameters, trial.nominal),
    }
    for when, (parameters, motion) in models.items():
        for joint, (centre, axis) in joint_tracks(parameters, motion).items():
            known = at_times(
                motion.time, walk.recording.time, person.centres[joint] @ rotation.T + origin
            )
            gap, name = 1e3 * (centre - known), joint.split("_")[0]
            gathered.put(f"{name} in laboratory, mm", **{when: rms(np.linalg.norm(gap, axis=1))})
            if name != "hip":
                gathered.put(
                    f"{name} across axis, mm",
                    **{when: rms(np.linalg.norm(across(gap, axis), axis=1))},
                )
    frames = static_frames(calibration.nominal, study.static.recording)
    for side in "rl":
        truth = hip_parameters(frames, side, person.static_hips[f"hip_{side}"])
        gathered.hip(fitted_parameters(calibration, truth), side)
    return gathered.figures() | torque_figures(calibration, person, walk.name, rotation, origin)


def whole_turn(before: Array, after: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and origin (3,) by which all markers (nf, nm, 3) of a recording
    were turned.
    """
    pairs = np.isfinite(before).all(axis=2) & np.isfinite(after).all(axis=2)
    if pairs.sum() < 3:
        return np.eye(3), np.zeros(3)
    rotation, origin = fit_rigid_motions(before[pairs], after[pairs][None])
    return rotation[0], origin[0]


def joint_tracks(parameters: Parameters, motion: Motion) -> dict[str, tuple[Array, Array]]:
    """`hip_r`, ... -> centre (nf, 3) m and axis of flexion (nf, 3), laboratory, of a whole-body
    motion.
    """
    chain = Chain()
    order = [motion.coordinates.index(name) for name in chain.coordinates]
    axes, points = compute_coordinate_axes(chain.body(parameters), motion.q[:, order])
    at = {
        f"{joint}_{s}": chain.coordinates.index(f"{name}_{s}")
        for joint, name in JOINT_OF.items()
        for s in "rl"
    }
    sign = {"hip": 1.0, "knee": -1.0, "ankle": 1.0}  # of z, about which a knee extends
    return {joint: (points[:, k], sign[joint[:-2]] * axes[:, k]) for joint, k in at.items()}


def torque_figures(
    calibration: Calibration, person: WalkingPerson, walk: str, rotation: Array, origin: Array
) -> dict[str, Figure]:
    """RMS error of each joint's torque over valid frames and both legs, and all of them together.

    `rotation`, `origin`: by which the recording was turned, as `whole_turn` has them.
    """
    loads = calibration.trial(walk).loads
    if loads is None:
        raise RuntimeError(f"the trial {walk} has no torques")
    recorded = next(t.recording.time for t in calibration.study.trials if t.name == walk)
    valid, body = loads.reactions.valid, calibration.trial(walk).body
    force, moment = (person.forces[..., part] @ rotation.T for part in (slice(3), slice(3, 6)))
    ground = np.concatenate([force, moment + np.cross(origin, force)], axis=2).reshape(
        len(recorded), -1
    )
    more = at_times(body.time, recorded, ground).reshape(-1, 2, 6) - loads.reactions.wrench
    airborne = more * ~loads.reactions.loaded[:, :, None]
    dynamics = Dynamics(calibration.model.parameters)
    of_airborne = dynamics.compute_ground_forces(dynamics.place(body.q), airborne[..., None])[
        ..., 0
    ]
    gaps: dict[str, list[Array]] = {}
    earlier: dict[str, list[Array]] = {}
    held: dict[str, Bars] = {}
    for torque in TORQUES:
        for side in "rl":
            name = f"{torque}_{side}"
            column = COORDINATES.index(name)
            true = (
                np.interp(loads.final.time, recorded, person.torques[name]) - of_airborne[:, column]
            )[valid]
            gap = loads.final.tau[valid, column] - true
            error = (
                np.full(len(gap), np.nan)
                if loads.errors is None
                else loads.errors.tau[valid, column]
            )
            gaps.setdefault(torque, []).append(gap)
            earlier.setdefault(torque, []).append(loads.nominal.tau[valid, column] - true)
            held[torque] = held.get(torque, Bars()) + bars(gap, error)
    figures = {
        f"torque {t}, N·m": Figure(error=rms(gaps[t]), before=rms(earlier[t]), bars=held[t])
        for t in TORQUES
    }
    every = Figure(
        error=rms(list(gaps.values())),
        before=rms(list(earlier.values())),
        bars=sum(held.values(), Bars()),
    )
    return {"torques of legs, N·m": every, **figures}


AXES = {
    "knee axis in thigh": ("knee_{s}.thigh", "thigh_{s}", "proximal", "knee_{s}"),
    "knee axis in shank": ("knee_{s}.shank", "shank_{s}", "distal", "knee_{s}"),
    "talocrural axis": ("talocrural_{s}.shank", "shank_{s}", "proximal", "ankle_{s}"),
    "subtalar axis": ("subtalar_{s}.foot", "foot_{s}", "distal", "subtalar_{s}"),
}
"""Figure -> parameters, segment, and the true axis, `{s}` being the side."""


def isolated(
    name: str,
    kind: Kind,
    seed: int,
    size_mm: float,
    changes: Mapping[str, object],
    data: Path,
    cache: Path,
    walk: bool,
) -> Outcome:
    person = isolated_person(name, data, cache, walk)
    study = disturbed(with_settings(person.study, changes), kind, size_mm, seed)
    fit = timed_fit(study)
    return fit.outcome(
        "isolated", kind.value, name, seed, compare_isolated(fit.calibration, person, study)
    )


class HipTrials(Enum):
    """What a walk has beside it, in part `functional`."""

    NONE = "walk alone"
    ISOLATED = "and hips as role = joint"
    MOTION = "and hips as role = motion"


def functional(
    name: str,
    kind: Kind,
    seed: int,
    size_mm: float,
    changes: Mapping[str, object],
    data: Path,
    cache: Path,
    of: HipTrials,
) -> Outcome:
    """Part `functional`: a walk without plates, alone or with the same trial of each hip in one
    role or the other.
    """
    person = isolated_person(name, data, cache, with_gait=True)
    study = disturbed(with_settings(person.study, changes), kind, size_mm, seed)
    hips = [
        trial
        for trial in study.trials
        if of is not HipTrials.NONE and (trial.joint or "").startswith("hip")
    ]
    if of is HipTrials.MOTION:
        hips = [replace(trial, role=Role.MOTION, joint=None) for trial in hips]
    walk = next(trial for trial in study.trials if trial.name == "gait")
    fit = timed_fit(replace(study, trials=(study.static, walk, *hips)))
    frames, gathered = static_frames(fit.calibration.nominal, study.static.recording), Gathered()
    for side in "rl":
        truth = hip_parameters(frames, side, person.centres[f"hip_{side}"])
        gathered.hip(fitted_parameters(fit.calibration, truth), side)
    return fit.outcome("functional", of.value, name, seed, gathered.figures())


def compare_isolated(
    calibration: Calibration, person: IsolatedPerson, study: Study
) -> dict[str, Figure]:
    frames = static_frames(calibration.nominal, study.static.recording)
    gathered = Gathered()
    for side in "rl":
        fitted = fitted_parameters(calibration, leg_parameters(person, frames, side))
        gathered.hip(fitted, side)
        for end, peer in zip(("pelvis", "thigh"), score(*poses(study, f"hip_{side}")), strict=True):
            gathered.put(
                f"hip in {end}, mm",
                peer=1e3 * float(np.linalg.norm(peer - person.centres[f"hip_{side}"])),
            )
        for figure in AXES:
            _axis(gathered, figure, fitted, person, frames, study, side)
        for unit, parameter in (("mm", "sup"), ("deg", "trans")):
            gathered.single(
                f"subtalar in talus, {unit}", f"subtalar_{side}.talus.{parameter}", fitted, unit
            )
    return gathered.figures()


def _axis(
    gathered: Gathered,
    figure: str,
    fitted: Fitted,
    person: IsolatedPerson,
    frames: Mapping[str, Frame],
    study: Study,
    side: str,
) -> None:
    prefix, segment, end, joint = (word.format(s=side) for word in AXES[figure])
    lab = {"proximal": person.proximal, "distal": person.distal}[end][joint]
    true = line_in(frames[segment], lab)
    for when, values in fitted.times:
        found = line_of(prefix, values)
        gathered.put(f"{figure}, deg", **{when: angle(true.direction, found.direction)})
        gathered.put(f"{figure}, mm", **{when: 1e3 * true.measure_distance(found.point)})
    if joint.startswith("knee"):
        peer = sara(*poses(study, joint))[0 if end == "proximal" else 1]
        gathered.put(f"{figure}, deg", peer=angle(lab.direction, peer.direction))
        gathered.put(f"{figure}, mm", peer=1e3 * peer_distance(lab, peer, frames[segment]))
    own = [n for n in fitted.truth if n.startswith(f"{prefix}.")]
    for unit, words in (("deg", ("front", "trans", "sag")), ("mm", DIRECTIONS)):
        gathered.add_bars(
            f"{figure}, {unit}", fitted.bars([n for n in own if n.endswith(words)], unit)
        )


def peer_distance(true: Axis, found: Axis, frame: Frame) -> float:
    """Distance (m) of two lines where the found one meets the segment's plane of lateral position
    zero, as ours is.
    """
    lateral = frame.rotation[:, 2]
    slide = (frame.origin - found.point) @ lateral / (found.direction @ lateral)
    return true.measure_distance(found.point + slide * found.direction)


def line_of(prefix: str, values: Mapping[str, float]) -> Axis:
    """The axis that joint parameters (m, rad) tell in their segment."""
    point = np.array([values.get(f"{prefix}.{d}", 0.0) for d in DIRECTIONS])
    if f"{prefix}.sag" in values:
        return Axis(point, x_axis(values[f"{prefix}.trans"], values[f"{prefix}.sag"]))
    return Axis(point, z_axis(values[f"{prefix}.front"], values[f"{prefix}.trans"]))


def poses(study: Study, joint: str) -> tuple[Poses, Poses]:
    """Poses of the clusters above and below a joint along its isolated trial, from their places in
    the static trial.
    """
    static = study.static.recording
    recording = next(t.recording for t in study.moving if t.joint == joint)
    rest = dict(zip(static.labels, static.markers.mean(axis=0), strict=True))

    def pose(segment: str) -> Poses:
        labels = study.marker_set.tracking[segment]
        columns = [recording.labels.index(label) for label in labels]
        return fit_rigid_motions(
            np.array([rest[label] for label in labels]), recording.markers[:, columns]
        )

    above, below = beside(joint)
    return pose(above), pose(below)


SHARED = ("--jobs", "--only", "--seed", "--set", "--cache", "--json")
PARTS = ("gait", "isolated", "synthetic", "functional", "recovery", "published")
USUAL_PARTS = PARTS[:3]
"""The last two have tables of their own; the one before them takes ten minutes."""
OWN = {
    "--kinds": words_of(Kind),
    "--seeds": option(6, "of each kind of movement and person"),
    "--synthetic-people": option(9, "of our own linkage", metavar="N"),
    "--know": option(
        "default", "part recovery", choices=[setting.value for setting in made_up.Settings]
    ),
    "--size": option(
        float, "of the movement, instead of each part's own; of the published noise", metavar="MM"
    ),
    "--with-gait": option(False, "part isolated: the walk, without plates, as well"),
}
KINDS = {
    "gait": (Kind.NONE, Kind.SINUSOIDS, Kind.MIXTURE, Kind.PEOPLE),
    "isolated": (Kind.NONE, *FIVE, Kind.MIXTURE, Kind.PEOPLE),
    "functional": (Kind.PEOPLE,),
}
"""What is tried unless `--kinds` says otherwise."""
WAVES_MM, GAIT_SKIN_MM, SKIN_MM = 10.0, 10.0, 15.0
"""Sizes of the published waves, and of skin movement in the parts `gait` and `isolated`."""


def tasks(chosen: argparse.Namespace, synthetic: range) -> list[Callable[[], Outcome]]:
    """Every fit of the parts with a common table, as a function that makes it."""
    out: list[Callable[[], Outcome]] = []
    folder = data() / "opensim_truth" if set(chosen.parts) & set(KINDS) else None
    for part in (part for part in chosen.parts if part in KINDS):
        for person in matching(chosen.only, SIMULATED):
            if part != "gait":
                made(person, folder, chosen.cache)
            for kind in chosen.kinds or KINDS[part]:
                skin = SKIN_MM if part != "gait" or kind in OF_PEOPLE else GAIT_SKIN_MM
                size = chosen.size or (WAVES_MM if kind is Kind.SINUSOIDS else skin)
                for seed in range(
                    chosen.seed, chosen.seed + (1 if kind is Kind.NONE else chosen.seeds)
                ):
                    common = (person, kind, seed, size, chosen.settings, folder)
                    if part == "gait":
                        out.append(partial(gait, *common))
                    elif part == "functional":
                        out += [partial(functional, *common, chosen.cache, of) for of in HipTrials]
                    else:
                        out.append(partial(isolated, *common, chosen.cache, chosen.with_gait))
    if "synthetic" in chosen.parts:
        out += [partial(made_up.outcome, seed, chosen.settings) for seed in synthetic]
    return out


def run(chosen: argparse.Namespace) -> list[Outcome]:
    synthetic = range(chosen.seed, chosen.seed + chosen.synthetic_people)
    if "recovery" in chosen.parts:
        settings = made_up.Settings(chosen.know)
        people = [
            partial(made_up.synthetic_person, seed, settings, chosen.settings) for seed in synthetic
        ]
        say(*made_up.lines(list(side_by_side(people, chosen.jobs))))
    if "published" in chosen.parts:
        say(
            *made_up.published_lines(
                made_up.draws(
                    chosen.seeds, 1e-3 * (chosen.size or WAVES_MM), chosen.seed, chosen.jobs
                )
            )
        )
    outcomes = list(side_by_side(tasks(chosen, synthetic), chosen.jobs))
    if outcomes:
        if chosen.set:
            say(f"settings: {', '.join(chosen.set)}")
        say(*report.lines(outcomes))
    return outcomes
