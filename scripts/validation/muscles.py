"""Do muscles of an OpenSim model get their moment arms back, and do error bars of moment arms hold?

    muscles [--parts back,people,drawn,same] [--draws 25] [--models 20] [--noise MM] [--only REGEX]
    [--osim FILE ...]

Two people that OpenSim simulated walk once (`opensim_truth`). In their models the joints of the
legs are put 10 to 20 mm off, across their axes, as nothing tells where along it a hinge is;
`gaitcal export --into` brings them back by what calibration finds.

back      without noise, by the walk, and by isolated trials of hip, knee and ankle, too: the
          largest errors of moment arms, and whether they are as large as their standard deviations
          say
people    with marker noise as published (one sinusoid a marker coordinate), in the static trial,
          too. Each draw of noise has standard deviations of its own, of so many drawn models.
          Wanted: its 95 % intervals, Student's, hold 90 to 99 % of the true moment arms of the
          right leg, in two postures of each coordinate. Both people are scaled from one pelvis,
          whose hips lie 15 mm farther in and 13 to 24 mm lower than regressions from people have
          them: with much noise arms of hip adduction are off by that in every draw
drawn     the same with a prior of which these people are a draw (`people/simulated.py`): what
          intervals must hold
same      of these models and those of `--osim`: an export of the joints that are in place leaves
          every byte, and moment arms bit by bit in 1000 postures; joints put off come back; seconds
          of an export and of a draw

In part `same` the person has the very joints of the model: segment frames are its body frames (the
talus has one of its own), and the person stands with all coordinates of the model zero. A line of
the model's joint becomes joint parameters as `gaitcal/model/linkage.py` defines them. Needs the
`opensim` package.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.stats import t as student

from gaitcal import calibrate
from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.export.opensim.joint_transfer import transfer_joints
from gaitcal.export.opensim.osim_correspondence import Hinge, LegJoint, find_leg_joints
from gaitcal.export.opensim.osim_reader import (
    FramePlacement,
    build_peer_model,
    read_document,
    read_osim,
)
from gaitcal.export.opensim.osim_writer import get_joint_frames
from gaitcal.export.opensim.peer_model import Axis, PeerModel
from gaitcal.export.opensim.transfer_account import (
    MusclePath,
    compute_muscle_paths,
    list_leg_ranges,
)
from gaitcal.model.linkage import JOINTS, SIDES, ZERO_ANGLES
from gaitcal.model.parameters import Parameters, read_published_parameters
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.segment_frames import Frame
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from gaitcal.results.saved_result import select_moving_frames
from gaitcal.synthetic.synthetic_motion import draw_marker_noise
from scripts.validation.harness import judged, matching, option, rms, say, side_by_side
from scripts.validation.people.simulated import prior_about_truth
from scripts.validation.recordings import only
from scripts.validation.truth.people import KnownJoints, isolated_person, leg_parameters

JOINT = {joint.name: joint for joint in JOINTS}
FREE_POINTS = 4
"""Markers of a segment, where those of the model are not to be used."""


def person_of(peer: PeerModel, *, markers: bool = True) -> SubjectModel:
    """A person whose legs are those of the model, and who wears its markers (or others, that it
    does not have).
    """
    parameters, posture = read_published_parameters(), dict[str, float]()
    legs = {leg.ours: leg.theirs for leg in find_leg_joints(peer)}
    bodies = {"pelvis": legs["hip_r"].parent}
    for side in SIDES:
        bodies |= {
            f"thigh_{side}": legs[f"hip_{side}"].child,
            f"shank_{side}": legs[f"knee_{side}"].child,
        }
        bodies[f"foot_{side}"] = legs[f"subtalar_{side}"].child
        values, angles, standing = _leg(peer, side, bodies, parameters)
        zero = parameters.zero_angles.copy()
        for name, value in angles.items():
            zero[ZERO_ANGLES.index(name)] = value
        parameters = Parameters(
            parameters.with_joint(tuple(values), np.array(list(values.values()))).joint,
            parameters.inertial,
            zero,
        )
        posture |= standing
    placed = list(_markers(peer, bodies) if markers else _free_points(bodies))
    labels, segments, local = zip(*placed, strict=True)
    placement = MarkerPlacement(labels, segments, np.array(local), np.ones(len(labels)))
    who = Subject("truth", 70.0, 1.75, "male")
    return SubjectModel(
        subject=who, parameters=parameters, nominal=parameters, markers=placement, posture=posture
    )


def _hinge(leg: LegJoint) -> Hinge:
    if leg.hinge is None:
        raise InputError(f"{leg.theirs.name} is no hinge; allowed: a hinge as {leg.ours}")
    return leg.hinge


def _leg(
    peer: PeerModel, side: str, bodies: dict[str, str], base: Parameters
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Joint parameters, zero angles and standing coordinates of one leg; the laboratory is the
    pelvis.
    """
    s = 1.0 if side == "r" else -1.0
    legs = {
        leg.ours.partition("_")[0]: leg
        for leg in find_leg_joints(peer)
        if leg.ours.endswith(f"_{side}")
    }
    hip, knee, hinge = legs["hip"].theirs, legs["knee"].theirs, _hinge(legs["knee"])
    shank, foot = bodies[f"shank_{side}"], bodies[f"foot_{side}"]
    of_thigh = peer.compute_joint_pose(hip, {})
    # the pose of the shank is that of the hinge: it does not roll
    of_knee = peer.compute_body_pose(knee.parent, bodies[f"thigh_{side}"]) * hinge.compute_pose(
        hinge.measure_angle(peer.compute_joint_pose(knee, {}))
    )
    of_shank, of_foot = of_thigh * of_knee, peer.compute_body_pose(foot, shank)

    def axis(joint: str) -> Axis:
        line, parent = _hinge(legs[joint]).in_parent, legs[joint].theirs.parent
        below = bodies[f"thigh_{side}"] if joint == "knee" else shank
        found = Axis(line.translation, line.rotation[:, 2]).transform(
            peer.compute_body_pose(parent, below)
        )
        return found.transform(of_thigh if joint == "knee" else of_shank)

    poses = {"pelvis": pin.SE3.Identity(), f"thigh_{side}": of_thigh, f"shank_{side}": of_shank}
    poses[f"foot_{side}"] = of_shank * of_foot
    ours = {"knee": "knee", "talocrural": "ankle", "subtalar": "subtalar"}
    lines = {f"{name}_{side}": axis(joint) for joint, name in ours.items()}
    centres = {f"hip_{side}": (of_thigh * hip.in_child).translation}
    jp = leg_parameters(
        KnownJoints(centres=centres, proximal=lines, distal=lines),
        {name: Frame(pose.rotation, pose.translation) for name, pose in poses.items()},
        side,
    )
    joints = base.with_joint(tuple(jp), np.array(list(jp.values()))).joint

    def frames(joint: str, **zero: float) -> tuple[pin.SE3, pin.SE3]:
        angles = base.zero_angles.copy()
        for name, value in zero.items():
            angles[ZERO_ANGLES.index(f"{name}_{side}.zero")] = value
        found = get_joint_frames(
            JOINT[f"{joint}_{side}"], Parameters(joints, base.inertial, angles)
        )
        return found.in_parent, found.in_child

    r = of_thigh.rotation  # Rz(flexion) Rx(s adduction) Ry(s rotation)
    in_parent, in_child = frames("knee")
    bent = (in_parent.actInv(of_knee) * in_child).rotation
    standing = {
        f"hip_flexion_{side}": float(np.arctan2(-r[0, 1], r[1, 1])),
        f"hip_adduction_{side}": s * float(np.arcsin(r[2, 1])),
        f"hip_rotation_{side}": s * float(np.arctan2(-r[2, 0], r[2, 2])),
        f"knee_angle_{side}": float(np.arctan2(-bent[1, 0], bent[0, 0])),
    }
    # y of the talus lies along the common perpendicular of both axes of the ankle
    back = of_shank.inverse()
    z = lines[f"ankle_{side}"].transform(back).direct_along(2).direction
    x = lines[f"subtalar_{side}"].transform(back).direct_along(0).direction
    in_parent, _ = frames("talocrural", talocrural=0.0)
    y = in_parent.rotation.T @ np.cross(z, x)
    ankle = float(np.arctan2(-y[0], y[1]))
    talus = in_parent * pin.SE3(make_axis_rotation(2, ankle), np.zeros(3))
    in_parent, in_child = frames("subtalar", talocrural=ankle, subtalar=0.0)
    rest = ((talus * in_parent).actInv(of_foot) * in_child).rotation
    zero = {
        f"talocrural_{side}.zero": ankle,
        f"subtalar_{side}.zero": float(np.arctan2(rest[2, 1], rest[1, 1])),
    }
    return jp, zero, standing


def _markers(peer: PeerModel, bodies: dict[str, str]) -> Iterator[tuple[str, str, Array]]:
    """Those that the model has on these bodies, or on what hangs on them."""
    for label, (carrier, position) in peer.markers.items():
        for segment, body in reversed(bodies.items()):
            if peer.is_below(carrier, body):
                yield label, segment, peer.compute_body_pose(carrier, body).act(position)
                break


def _free_points(bodies: dict[str, str]) -> Iterator[tuple[str, str, Array]]:
    rng = np.random.default_rng(0)
    for segment in bodies:
        for k in range(FREE_POINTS):
            yield f"{segment} {k}", segment, 0.1 * rng.normal(size=3)


SHARED = ("--jobs", "--only", "--json", "--seed", "--cache")
OWN = {
    "--draws": option(25, "of noise, a person"),
    "--models": option(20, "drawn models of each, for standard deviations"),
    "--noise": option(10.0, "largest amplitude of marker noise, mm"),
    "--osim": option([], "a model more in part same; may be repeated", type=Path),
}
MODELS = {"p01": "subject01.osim", "p18": "subject18.osim"}
OFF = (0.010, 0.020)
"""m, how far joints are put from their place."""
WANTED = (90.0, 99.0)
"""%, of true moment arms within intervals of 95 %."""
VALUES = (4, 8)
"""Of the thirteen values of a coordinate's range."""
POSTURES = 1000
"""Of a model whose joints are in place."""
CROSSES = 1e-9
"""m, a moment arm about what a muscle crosses."""
TRIALS = {"a walk": ("gait",), "a walk and isolated trials": ("gait", "joint")}
"""Words -> roles."""
Arms = Mapping[tuple[str, str], MusclePath]


def disturbed(source: Path, out: Path, *, across: bool = False, deg: float = 0.0) -> Path:
    """The model with all joints of the legs 10 to 20 mm (and some degrees) off; `across`: hinges
    across their axes.
    """
    rng = np.random.default_rng(3)
    document = read_document(source)
    places = {}
    for leg in find_leg_joints(build_peer_model(document)):
        for end, frame in (("parent", leg.theirs.in_parent), ("child", leg.theirs.in_child)):
            way = rng.normal(size=3)
            if across and leg.hinge is not None:
                axis = (leg.hinge.in_parent if end == "parent" else leg.hinge.in_child).rotation[
                    :, 2
                ]
                way -= axis * (axis @ way)
            way *= rng.uniform(*OFF) / np.linalg.norm(way)
            turn = pin.exp3(np.deg2rad(deg) * rng.normal(size=3))
            places[leg.theirs.name, end] = FramePlacement(
                frame.translation + way, frame.rotation @ turn if deg else None
            )
    out.write_bytes(document.apply_changes(places))
    return out


@dataclass(frozen=True, kw_only=True)
class Draw:
    """One calibration: of every moment arm, in two postures."""

    coordinates: tuple[str, ...]
    muscles: tuple[str, ...]
    errors: Array
    """(n, 2) m."""
    largest: Array
    """(n,) m, the true moment arm that is largest in size."""
    deviations: Array
    """(n, 2) m."""


def draw(
    person: str,
    seed: int | None,
    noise: float,
    models: int,
    cache: Path,
    drawn: bool = False,
    roles: tuple[str, ...] = ("gait",),
) -> Draw:
    """`seed`: of the noise (m), None: without; `drawn`: the person is a draw from the prior;
    `roles`: of its trials.
    """
    data = Path(os.environ["GAITCAL_DATA"]).resolve() / "opensim_truth"
    made = isolated_person(person, data, cache, with_gait=True)
    study = only(made.study, *roles)
    rng = np.random.default_rng(seed or 0)
    if seed is not None:
        recordings = [t.recording for t in study.trials]
        noisy = [
            replace(
                r, markers=r.markers + draw_marker_noise(r.time, r.markers.shape[1], rng, noise)
            )
            for r in recordings
        ]
        study = replace(
            study,
            trials=tuple(replace(t, recording=r) for t, r in zip(study.trials, noisy, strict=True)),
        )
    if drawn:
        study, _ = prior_about_truth(made, study, rng)
    found = calibrate(study)
    recorded = select_moving_frames(
        [t.calibrated.q for t in found.trials if t.joint is None]
    )  # others: of one joint alone
    source = data / person / MODELS[person]
    with tempfile.TemporaryDirectory() as name:
        wrong, back = (
            disturbed(source, Path(name) / "wrong.osim", across=True),
            Path(name) / "m.osim",
        )
        done = transfer_joints(
            found.model,
            wrong,
            errors=found.uncertainty.joint,
            prior=study.joint_prior,
            recorded=recorded,
            marker_set=study.marker_set,
        )
        values_of = {
            c: values[list(VALUES)]
            for c, values in list_leg_ranges(done.legs).items()
            if c.endswith("_r")
        }

        def arms(content: bytes) -> Arms:
            back.write_bytes(content)
            return compute_muscle_paths(back, values_of)

        truth, now = arms(source.read_bytes()), arms(done.content)
        others = [arms(done.draw(rng)) for _ in range(models)]
    keys = [key for key in truth if all(key in other for other in (now, *others))]
    return Draw(
        muscles=tuple(muscle for muscle, _ in keys),
        coordinates=tuple(coordinate for _, coordinate in keys),
        errors=np.array([now[key].arm - truth[key].arm for key in keys]),
        largest=np.array([np.abs(truth[key].arm).max() for key in keys]),
        deviations=np.array([[other[key].arm for key in keys] for other in others]).std(
            axis=0, ddof=1
        ),
    )


def back(chosen: argparse.Namespace) -> dict[str, float]:
    """Errors without noise, in mm and relative to the largest moment arm of the muscle about the
    coordinate.
    """
    out = {}
    for person, (words, roles) in product(matching(chosen.only, MODELS), TRIALS.items()):
        found = draw(person, None, 0.0, chosen.models, chosen.cache, roles=roles)
        say(
            f"{person}, {words}: arms back to 1 % of their largest; errors over SD, RMS; the "
            "worst, mm"
        )
        for coordinate in dict.fromkeys(found.coordinates):
            of = [k for k, c in enumerate(found.coordinates) if c == coordinate]
            error = np.abs(found.errors[of]).max(axis=1)
            good = int((error / found.largest[of] < 0.01).sum())
            worst = [of[k] for k in np.argsort(-error)[:3]]
            off, sizes = (1e3 * np.abs(x).max(axis=1) for x in (found.errors, found.deviations))
            told = (f"{found.muscles[k]} {off[k]:.2f} (SD {sizes[k]:.2f})" for k in worst)
            z = rms(found.errors[of] / found.deviations[of])
            say(f"  {coordinate:20}{good:4} of {len(of):3}{z:6.2f}: {', '.join(told)}")
            out[f"{person}, {words}: {coordinate}"] = 100.0 * good / len(of)
    return out


def held(drawn: bool, chosen: argparse.Namespace) -> dict[str, float]:
    """Share of true moment arms within their intervals, %, by coordinate."""
    seeds = [
        int(s.generate_state(1)[0]) for s in np.random.SeedSequence(chosen.seed).spawn(chosen.draws)
    ]
    tasks = [
        partial(draw, person, seed, 1e-3 * chosen.noise, chosen.models, chosen.cache, drawn)
        for person in matching(chosen.only, MODELS)
        for seed in seeds
    ]
    width = float(student.ppf(0.975, chosen.models - 1))
    rows: dict[str, list[Array]] = {}
    for found in side_by_side(tasks, chosen.jobs):
        for name, error, deviation in zip(
            found.coordinates, found.errors, found.deviations, strict=True
        ):
            for of in (name, "all"):
                rows.setdefault(of, []).append(np.stack([error, deviation], axis=1))
    say(f"{len(tasks)} draws of noise up to {chosen.noise:g} mm, {chosen.models} models each")
    say(f"{'':20}{'inside, %':>12}{'error, mm':>12}{'SD, mm':>10}")
    out = {}
    for name, pairs in rows.items():
        error, deviation = np.concatenate(pairs).T
        out[name] = 100.0 * float(np.mean(np.abs(error) <= width * deviation))
        say(f"{name:20}{out[name]:12.1f}{1e3 * rms(error):12.2f}{1e3 * rms(deviation):10.2f}")
    judged(
        "95 % intervals of moment arms hold",
        f"{out['all']:.1f} %",
        "90 to 99 %",
        met=_holds(out["all"]),
    )
    return out


def _holds(share: float) -> bool:
    return WANTED[0] <= share <= WANTED[1]


def same(chosen: argparse.Namespace) -> dict[str, float]:
    """A row for every model: 1 where bytes and moment arms are the same, else 0."""
    data = Path(os.environ["GAITCAL_DATA"]).resolve()
    known = [data / "opensim_truth" / person / file for person, file in MODELS.items()]
    known += [
        data / "subject01/reference/subject01_simbody.osim",
        data / "uf3/reference/scaled.osim",
    ]
    say(
        f"{'model':40}{'bytes':>7}{'arms':>6}{'muscles':>9}"
        f"{'back, mm':>10}{'export, s':>11}{'draw, s':>9}"
    )
    files = [*known, *chosen.osim]
    tasks = [partial(_same, file) for file in files]
    out = {}
    for file, (words, good) in zip(files, side_by_side(tasks, chosen.jobs), strict=True):
        say(f"{file.name:40}{words}")
        out[file.name] = float(good)
    return out


def _same(file: Path) -> tuple[str, bool]:
    try:
        peer = read_osim(file)
        person = person_of(peer)
        start = time.perf_counter()
        done = transfer_joints(person, file)
        seconds = time.perf_counter() - start
    except InputError as error:
        return f"  {error}", False
    with tempfile.TemporaryDirectory() as name:
        other = Path(name) / "other.osim"
        wrong = transfer_joints(person, disturbed(file, other, across=True))
        start = time.perf_counter()
        wrong.draw(np.random.default_rng(0))
        of_draw = time.perf_counter() - start
        other.write_bytes(wrong.content)
        apart = max(_apart(done.legs, find_leg_joints(read_osim(other))))
        other.write_bytes(done.content)
        pairs = list(
            zip(
                _arms_in_postures(file, done.legs), _arms_in_postures(other, done.legs), strict=True
            )
        )
    bytes_same, arms_same = (
        done.content == file.read_bytes(),
        all(np.array_equal(a, b) for a, b in pairs),
    )
    words = (
        f"{bytes_same!s:>7}{arms_same!s:>6}{len(pairs[0][0]):9}"
        f"{1e3 * apart:10.4f}{seconds:11.2f}{of_draw:9.2f}"
    )
    return words, bytes_same and arms_same


def _apart(was: tuple[LegJoint, ...], now: tuple[LegJoint, ...]) -> Iterator[float]:
    """m, from joints in their bodies to where they are now; not of the talus, which lies
    anywhere.
    """
    for a, b in zip(was, now, strict=True):
        gap = b.theirs.in_child.translation - a.theirs.in_child.translation
        if a.hinge is not None:
            axis = a.hinge.in_child.rotation[:, 2]
            gap = gap - axis * (axis @ gap)
        if not a.ours.startswith("talocrural"):
            yield float(np.linalg.norm(gap))


def _arms_in_postures(file: Path, legs: tuple[LegJoint, ...]) -> Iterator[Array]:
    """(n,) m, of muscles that cross one coordinate of the legs after the other, the others anywhere
    in their ranges.
    """
    import opensim  # type: ignore[import-untyped,import-not-found,unused-ignore]

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Off")
    rng, ranges = np.random.default_rng(0), list_leg_ranges(legs)
    model = opensim.Model(str(file))
    state, names = model.initSystem(), list(ranges)
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    crossing = dict[int, list[Any]]()
    for k in range(POSTURES):
        for coordinate, values in zip(coordinates, ranges.values(), strict=True):
            coordinate.setValue(state, rng.uniform(values[0], values[-1]), False)
        model.assemble(state)
        model.realizePosition(state)
        which = k % len(coordinates)
        asked = crossing.get(which, muscles)
        arms = np.array([m.computeMomentArm(state, coordinates[which]) for m in asked])
        crossing[which] = [m for m, arm in zip(asked, arms, strict=True) if abs(arm) > CROSSES]
        yield arms


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, float]]] = {
    "back": back,
    "people": partial(held, False),
    "drawn": partial(held, True),
    "same": same,
}


def passed(found: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether intervals of 95 % hold as many as they should, where people are a draw from the
    prior.
    """
    return all(_holds(found["drawn"]["all"]) for _ in {"drawn"} & set(found)) and all(
        found.get("same", {}).values()
    )
