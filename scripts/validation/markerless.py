"""How near the truth are joints and torques of recordings without markers, and do their error bars
hold?

    markerless [--parts poses,...] [--people 3] [--seed 0]

Made-up people (joints and masses drawn as `synthesize --perturb` does) walk two strides; what a
markerless program would write of that is calibrated, with plates beside it and no static trial.
Parts whose name begins with `opensim` have the people whom OpenSim knows (p01, p18), each with as
many draws of errors: their knees are no hinges, their masses are not ours, and the truth is
OpenSim's inverse dynamics. Parts:

poses        a pose for each segment, origins at the joints; each errs by 5 mm and 2 degrees along
             each axis, for 0.1 s at a time (Gaussian)
white        the same, every frame by itself
biased       the same as `poses`, and each pose 10 mm and 4 degrees beside its segment along each
             axis, constant
points       key points: joints, heels and toes, shoulders, elbows and wrists; each errs by 15 mm
             along each axis, for 0.1 s at a time
points_off   the same, and each 15 mm beside its place along each axis, constant
opensim_...  `poses`, `biased`, `points` and `points_off` of people whom OpenSim knows

Printed, of all people together: RMS distance of joint centres from where they are (mean over the
walk, mm), and of torques over valid frames the RMS error, the RMS of the standard errors (N·m) and
how often bars of 95 % cover.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from gaitcal import Study, calibrate, read_recording
from gaitcal.analysis.result import Calibration
from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.io.csv_recordings import write_forces_csv, write_markers_csv
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import compute_pose_points
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.segment_frames import fit_rigid_motions
from gaitcal.synthetic.subject import make_true_gait, place_long_plates
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench
from scripts.validation.harness import option, rms, say
from scripts.validation.recordings import SIMULATED, data
from scripts.validation.truth.check import whole_turn
from scripts.validation.truth.people import WalkingPerson, at_times, walking_person

SHARED = ("--seed",)
OWN = {"--people": option(3, "made-up people, or draws of errors")}
Poses = Mapping[str, tuple[Array, Array]]
"""Segment, as Theia calls it -> (nf, 3, 3) axes forward, up, right, and (nf, 3) m origin."""
AXES = np.eye(3)[:, [2, 0, 1]]
"""Columns: the file's x, y, z of a segment, right, forward and up as Theia's are, in forward, up,
right.
"""
TOES, HAND = 0.19, 0.25
"""m, along the foot from its heel marker, and along the forearm from the elbow."""
STUDY = """
[subject]
name = "walker"
mass_kg = {mass:.4f}
height_m = {height:.3f}
sex = "male"
[markers]
set = "{marker_set}"
[[trial]]
name = "standing"
role = "static"
file = "walk.csv"
[[trial]]
name = "walk"
role = "gait"
file = "walk.csv"
{forces}
[calibration]
force_filter_hz = "none"
plate_error = {{ place_mm = 0.0, turn_deg = 0.0, gain_percent = 0.0, clock_ms = 0.0 }}
"""


@dataclass(frozen=True)
class Errors:
    """Of each pose, along each axis."""

    place: float = 0.005
    """m."""
    turn: float = float(np.deg2rad(2.0))
    """rad."""
    memory: float = 0.1
    """s; 0: every frame by itself."""
    constant: tuple[float, float] = (0.0, 0.0)
    """m, rad."""


def body_poses(parameters: Parameters, q: Array) -> Poses:
    """The segments of a person at coordinates (nf, nq), with their origins at the joints."""
    chain = Chain()
    body = chain.body(parameters)
    placed = Kinematics(body, q, columns=False)
    axes, origins = placed.axes, placed.origins
    frames = {
        name: (axes[i].transpose(2, 1, 0), origins[i].T) for i, name in enumerate(chain.segments)
    }

    def point(segment: str, local: Array | list[float]) -> Array:
        return np.asarray(frames[segment][1] + frames[segment][0] @ np.asarray(local))

    def joint(name: str, segment: str) -> Array:
        places = [JP_INDEX.get(f"{name}.{direction}") for direction in ("ant", "sup", "lat")]
        return point(segment, [0.0 if k is None else float(parameters.joint[k]) for k in places])

    out = {"pelvis": frames["pelvis"]}
    for s in SIDES:
        at = {
            "thigh": (f"thigh_{s}", joint(f"hip_{s}.pelvis", "pelvis")),
            "shank": (f"shank_{s}", joint(f"knee_{s}.thigh", f"thigh_{s}")),
            "foot": (f"foot_{s}", joint(f"talocrural_{s}.shank", f"shank_{s}")),
            "toes": (f"foot_{s}", point(f"foot_{s}", [TOES, 0.0, 0.0])),
            "uarm": (f"upper_arm_{s}", joint(f"shoulder_{s}.trunk", "head_trunk")),
            "larm": (f"forearm_hand_{s}", joint(f"elbow_{s}.forearm", f"forearm_hand_{s}")),
            "hand": (f"forearm_hand_{s}", point(f"forearm_hand_{s}", [0.0, -HAND, 0.0])),
        }
        out |= {
            f"{s}_{name}": (frames[segment][0], origin) for name, (segment, origin) in at.items()
        }
    return out | {"torso": (frames["head_trunk"][0], 0.5 * (out["r_uarm"][1] + out["l_uarm"][1]))}


def slow(rng: np.random.Generator, time: Array, memory: float) -> Array:
    """(nf, 3) of variance one, that keep for some s what they are."""
    frames = memory / float(np.median(np.diff(time)))
    spare = int(8 * frames)
    noise = rng.standard_normal((len(time) + 2 * spare, 3))
    if frames:
        noise = gaussian_filter1d(noise, frames, axis=0) * np.sqrt(2.0 * np.sqrt(np.pi) * frames)
    return np.asarray(noise[spare : len(noise) - spare])


def opensim_poses(person: WalkingPerson, walk: Recording) -> Poses:
    """Of a person whom OpenSim knows; axes as they stand in the static trial, where all are the
    laboratory's.
    """
    stands = person.study.static.recording
    static = dict(zip(stands.labels, stands.markers.mean(axis=0), strict=True))
    at = dict(zip(walk.labels, walk.markers.transpose(1, 0, 2), strict=True))

    def axes(*labels: str) -> Array:
        return fit_rigid_motions(
            np.array([static[m] for m in labels]), np.stack([at[m] for m in labels], axis=1)
        )[0]

    out = {"pelvis": (axes("RASI", "LASI", "RPSI", "LPSI"), 0.5 * (at["RHJC"] + at["LHJC"]))}
    out["torso"] = axes("CLAV", "C7", "RACR", "LACR"), 0.5 * (at["RSJC"] + at["LSJC"])
    for s in SIDES:
        own = {
            "thigh": ("HJC", "TH1 TH2 TH3 LFC"),
            "shank": ("KJC", "TB1 TB2 TB3 LMAL"),
            "foot": ("AJC", "CAL TOE MT5"),
            "toes": ("TOE", "CAL TOE MT5"),
            "uarm": ("SJC", "UA1 UA2 UA3 LEL"),
            "larm": ("EJC", "FAsuperior FAradius FAulna"),
            "hand": ("FAradius", "FAsuperior FAradius FAulna"),
        }
        for name, (origin, labels) in own.items():
            out[f"{s}_{name}"] = (
                axes(*(s.upper() + label for label in labels.split())),
                at[s.upper() + origin],
            )
    return out


def poses_recording(seed: int, errors: Errors, poses: Poses, time: Array) -> Recording:
    rng, labels, out = np.random.default_rng(seed), [], []
    for name, (axes, origin) in poses.items():
        place, turn = errors.constant
        off, beside = (
            Rotation.from_rotvec(turn * rng.standard_normal(3)),
            place * rng.standard_normal(3),
        )
        shaken = Rotation.from_rotvec(errors.turn * slow(rng, time, errors.memory)).as_matrix()
        pose = np.tile(np.eye(4), (len(time), 1, 1))
        pose[:, :3, :3] = shaken @ axes @ off.as_matrix() @ AXES
        pose[:, :3, 3] = origin + axes @ beside + errors.place * slow(rng, time, errors.memory)
        labels.append(f"{name}_4X4")
        out.append(pose)
    names, markers, notes = compute_pose_points(labels, np.stack(out, axis=1))
    return Recording(source="made up", time=time, labels=names, markers=markers, notes=notes)


KEY_POINTS = {
    "Hip": "thigh",
    "Knee": "shank",
    "Ankle": "foot",
    "Shoulder": "uarm",
    "Elbow": "larm",
    "Wrist": "hand",
}
"""Key point -> the segment at whose origin it lies."""
TOE_POINTS = {
    "BigToe": (0.0, 0.0, -0.03),
    "SmallToe": (-0.03, 0.0, 0.05),
    "Heel": (-TOES, 0.0, 0.0),
}
"""Key point of the right foot -> m, from the origin of the toes."""


def points_recording(seed: int, errors: Errors, poses: Poses, time: Array) -> Recording:
    rng, out = np.random.default_rng(seed), dict[str, Array]()
    for side in SIDES:
        away = {name: (segment, np.zeros(3)) for name, segment in KEY_POINTS.items()}
        mirrored = np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
        away |= {name: ("toes", np.array(local) * mirrored) for name, local in TOE_POINTS.items()}
        for name, (segment, local) in away.items():
            axes, origin = poses[f"{side}_{segment}"]
            beside = local + errors.constant[0] * rng.standard_normal(3)
            out[f"{side.upper()}{name}"] = (
                origin + axes @ beside + errors.place * slow(rng, time, errors.memory)
            )
    return Recording(
        source="made up", time=time, labels=tuple(out), markers=np.stack(list(out.values()), axis=1)
    )


@dataclass(frozen=True)
class Walk:
    poses: Poses
    time: Array
    mass: float
    height: float
    forces: str
    """Lines of the study file."""
    torques: Mapping[str, Array]
    """Generalised force -> (nf,) N·m."""


def made_up(seed: int, folder: Path) -> Walk:
    """A made-up person's, with forces in the folder."""
    parameters, motion = make_true_gait(seed)
    wrench = compute_residual_free_wrench(parameters, motion)
    write_forces_csv(folder / "walk_forces.csv", place_long_plates(motion, wrench))
    forces = 'forces = "walk_forces.csv"\nplates = { 1 = "r", 2 = "l" }'
    state = [motion.basis.evaluate(motion.coefficients, derivative) for derivative in range(3)]
    torques = dict(zip(FORCES, Dynamics(parameters).compute_forces(*state, wrench).T, strict=True))
    return Walk(
        body_poses(parameters, motion.q), motion.basis.time, parameters.mass, 1.70, forces, torques
    )


def of_opensim(name: str) -> Walk:
    folder = data() / "opensim_truth"
    person = walking_person(name, folder)
    known = read_recording(folder / name / "walk_with_joint_centres.trc")
    subject, forces = person.study.subject, f"forces = '{folder / name / 'grf.mot'}'"
    own = {
        torque: np.interp(known.time, person.study.moving[0].recording.time, tau)
        for torque, tau in person.torques.items()
    }
    return Walk(opensim_poses(person, known), known.time, subject.mass, subject.height, forces, own)


@dataclass(frozen=True)
class Outcome:
    trusted: str
    """The verdict."""
    centres: Mapping[str, Array]
    """Joint -> (2,) m, distance of right and left from the truth."""
    torques: Mapping[str, tuple[Array, Array]]
    """Torque -> (n,) N·m errors of both legs in valid frames, and their standard errors."""


def outcome(folder: Path, seed: int, errors: Errors, walk: Walk, *, points: bool) -> Outcome:
    """A walk written to a folder, calibrated and held against the truth; `points`: key points in
    place of poses.
    """
    made, marker_set = (points_recording, "key-points") if points else (poses_recording, "poses")
    write_markers_csv(folder / "walk.csv", made(seed, errors, walk.poses, walk.time))
    words = STUDY.format(
        mass=walk.mass, height=walk.height, marker_set=marker_set, forces=walk.forces
    )
    (folder / "study.toml").write_text(words, encoding="utf-8")
    return against(calibrate(Study.load(folder / "study.toml")), walk)


def against(found: Calibration, true: Walk) -> Outcome:
    (walk,), (recorded,) = found.trials, found.study.moving
    here = body_poses(found.model.parameters, walk.body.q)
    rotation, origin = whole_turn(recorded.recording.markers, walk.recording.markers)
    loads = walk.loads
    if loads is None or loads.errors is None:
        raise RuntimeError("no torques")

    def apart(segment: str) -> float:
        there = at_times(walk.body.time, true.time, true.poses[segment][1] @ rotation.T + origin)
        return float(np.linalg.norm((here[segment][1] - there).mean(axis=0)))

    def torque(name: str) -> tuple[Array, Array]:
        columns = [FORCES.index(f"{name}_{side}") for side in SIDES]
        known = [
            np.interp(walk.body.time, true.time, true.torques[f"{name}_{side}"]) for side in SIDES
        ]
        own = np.hstack([loads.final.tau, loads.final.knee_adduction])[
            :, columns
        ] - np.column_stack(known)
        valid = loads.reactions.valid
        return own[valid].ravel(), loads.errors.all_forces[valid][:, columns].ravel()

    names = {"hip": "thigh", "knee": "shank", "ankle": "foot"}
    centres = {
        joint: np.array([apart(f"{s}_{name}") for s in SIDES]) for joint, name in names.items()
    }
    known = [name for name in TORQUES if f"{name}_r" in true.torques]
    return Outcome(found.verdict.judgement.value, centres, {name: torque(name) for name in known})


TORQUES = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "knee_adduction",
    "ankle_angle",
)
ERRORS: dict[str, Errors] = {
    "poses": Errors(),
    "white": Errors(memory=0.0),
    "biased": Errors(constant=(0.010, float(np.deg2rad(4.0)))),
    "points": Errors(place=0.015),
    "points_off": Errors(place=0.015, constant=(0.015, 0.0)),
}
OPENSIM = "opensim_"
OF_OPENSIM = {OPENSIM + part: errors for part, errors in ERRORS.items() if part != "white"}
USUAL_PARTS = tuple(ERRORS)
"""The others need GAITCAL_DATA."""


def report(part: str, chosen: argparse.Namespace) -> dict[str, object]:
    found: list[Outcome] = []
    points = part.removeprefix(OPENSIM).startswith("points")
    for seed in range(chosen.seed, chosen.seed + chosen.people):
        for person in SIMULATED if part.startswith(OPENSIM) else ("",):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                walk = of_opensim(person) if person else made_up(seed, folder)
                found.append(
                    outcome(folder, seed, (ERRORS | OF_OPENSIM)[part], walk, points=points)
                )
    centres = {
        joint: 1e3 * rms(np.concatenate([one.centres[joint] for one in found]))
        for joint in found[0].centres
    }
    say(f"{part}: {', '.join(one.trusted for one in found)}")
    say(
        "  joint centres off by "
        + ", ".join(f"{joint} {size:.1f} mm" for joint, size in centres.items())
    )
    out: dict[str, object] = {"verdicts": [one.trusted for one in found], "centres_mm": centres}
    for torque in found[0].torques:
        off, bars = (np.concatenate([one.torques[torque][k] for one in found]) for k in range(2))
        covered = float(np.mean(np.abs(off) <= 1.96 * bars))
        out[torque] = {"rms": rms(off), "se": rms(bars), "covered": covered}
        say(
            f"  {torque:14s} {rms(off):6.2f} N·m, standard error {rms(bars):6.2f}, covered "
            f"{100 * covered:5.1f} %"
        )
    return out


PARTS = {part: partial(report, part) for part in ERRORS | OF_OPENSIM}
