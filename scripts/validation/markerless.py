"""How near the truth are joints and torques of recordings without markers, and do their error bars hold?

    markerless [--parts poses,...] [--people 3] [--seed 0]

Made-up people (joints and masses drawn as `synthesize --perturb` does) walk two strides; what a markerless program
would write of that is calibrated, with plates beside it and no static trial. Parts:

poses        a pose for each segment, origins at the joints; each errs by 5 mm and 2 degrees along each axis, for 0.1 s
             at a time (Gaussian)
white        the same, every frame by itself
biased       the same as `poses`, and each pose 10 mm and 4 degrees beside its segment along each axis, constant
points       key points: joints, heels and toes, shoulders, elbows and wrists; each errs by 15 mm along each axis, for
             0.1 s at a time
points_off   the same, and each 15 mm beside its place along each axis, constant

Printed, of all people together: RMS distance of joint centres from where they are (mean over the walk, mm), and of
torques over valid frames the RMS error, the RMS of the standard errors (N·m) and how often bars of 95 % cover.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from gaitcal import Study, calibrate
from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.io.csv import write_forces_csv, write_markers_csv
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import points_of_poses
from gaitcal.model.chain import Chain, forward, segment_poses
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.session.result import Calibration
from gaitcal.synthetic.motion import TrueMotion, residual_free_wrench
from gaitcal.synthetic.subject import plates_under, true_gait
from scripts.validation.error_bars import rms
from scripts.validation.harness import say

SHARED = ("--seed",)
Poses = Mapping[str, tuple[Array, Array]]
"""Segment, as Theia calls it -> (nf, 3, 3) axes forward, up, right, and (nf, 3) m origin."""
AXES = np.eye(3)[:, [2, 0, 1]]
"""Columns: the file's x, y, z of a segment, right, forward and up as Theia's are, in forward, up, right."""
TOES, HAND = 0.19, 0.25
"""m, along the foot from its heel marker, and along the forearm from the elbow."""
STUDY = """
[subject]
name = "{name}"
mass_kg = {mass:.4f}
height_m = 1.70
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
forces = "walk_forces.csv"
plates = {{ 1 = "r", 2 = "l" }}
[calibration]
force_filter_hz = "none"
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
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, q))
    frames = {name: (axes[i].transpose(2, 1, 0), origins[i].T) for i, name in enumerate(chain.segments)}

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
        out |= {f"{s}_{name}": (frames[segment][0], origin) for name, (segment, origin) in at.items()}
    return out | {"torso": (frames["head_trunk"][0], 0.5 * (out["r_uarm"][1] + out["l_uarm"][1]))}


def slow(rng: np.random.Generator, time: Array, memory: float) -> Array:
    """(nf, 3) of variance one, that keep for some s what they are."""
    frames = memory / float(np.median(np.diff(time)))
    spare = int(8 * frames)
    noise = rng.standard_normal((len(time) + 2 * spare, 3))
    if frames:
        noise = gaussian_filter1d(noise, frames, axis=0) * np.sqrt(2.0 * np.sqrt(np.pi) * frames)
    return np.asarray(noise[spare : len(noise) - spare])


def poses_recording(seed: int, errors: Errors, parameters: Parameters, motion: TrueMotion) -> Recording:
    """The points of the poses that a program would write."""
    rng, time, labels, out = np.random.default_rng(seed), motion.basis.time, [], []
    for name, (axes, origin) in body_poses(parameters, motion.q).items():
        place, turn = errors.constant
        off, beside = Rotation.from_rotvec(turn * rng.standard_normal(3)), place * rng.standard_normal(3)
        shaken = Rotation.from_rotvec(errors.turn * slow(rng, time, errors.memory)).as_matrix()
        pose = np.tile(np.eye(4), (len(time), 1, 1))
        pose[:, :3, :3] = shaken @ axes @ off.as_matrix() @ AXES
        pose[:, :3, 3] = origin + axes @ beside + errors.place * slow(rng, time, errors.memory)
        labels.append(f"{name}_4X4")
        out.append(pose)
    names, markers, notes = points_of_poses(labels, np.stack(out, axis=1))
    return Recording(source="made up", time=time, labels=names, markers=markers, notes=notes)


KEY_POINTS = {"Hip": "thigh", "Knee": "shank", "Ankle": "foot", "Shoulder": "uarm", "Elbow": "larm", "Wrist": "hand"}
"""Key point -> the segment at whose origin it lies."""
TOE_POINTS = {"BigToe": (0.0, 0.0, -0.03), "SmallToe": (-0.03, 0.0, 0.05), "Heel": (-TOES, 0.0, 0.0)}
"""Key point of the right foot -> m, from the origin of the toes."""


def points_recording(seed: int, errors: Errors, parameters: Parameters, motion: TrueMotion) -> Recording:
    """The key points that a program would write."""
    rng, time, out = np.random.default_rng(seed), motion.basis.time, dict[str, Array]()
    poses = body_poses(parameters, motion.q)
    for side in SIDES:
        away = {name: (segment, np.zeros(3)) for name, segment in KEY_POINTS.items()}
        mirrored = np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
        away |= {name: ("toes", np.array(local) * mirrored) for name, local in TOE_POINTS.items()}
        for name, (segment, local) in away.items():
            axes, origin = poses[f"{side}_{segment}"]
            beside = local + errors.constant[0] * rng.standard_normal(3)
            out[f"{side.upper()}{name}"] = origin + axes @ beside + errors.place * slow(rng, time, errors.memory)
    return Recording(source="made up", time=time, labels=tuple(out), markers=np.stack(list(out.values()), axis=1))


@dataclass(frozen=True)
class Outcome:
    """One person."""

    trusted: str
    """The verdict."""
    centres: Mapping[str, Array]
    """Joint -> (2,) m, distance of right and left from the truth."""
    errors: Array
    """(nf, 29) N·m of generalised forces, in valid frames."""
    bars: Array
    """(nf, 29) their standard errors."""


def outcome(folder: Path, seed: int, errors: Errors, *, points: bool) -> Outcome:
    """A person written to a folder, calibrated and held against the truth; `points`: key points in place of poses."""
    parameters, motion = true_gait(seed)
    wrench = residual_free_wrench(parameters, motion)
    made = points_recording if points else poses_recording
    write_markers_csv(folder / "walk.csv", made(seed, errors, parameters, motion))
    write_forces_csv(folder / "walk_forces.csv", plates_under(motion, wrench))
    words = STUDY.format(name=f"person {seed}", mass=parameters.mass, marker_set="key-points" if points else "poses")
    (folder / "study.toml").write_text(words, encoding="utf-8")
    return against(calibrate(Study.load(folder / "study.toml")), parameters, motion, wrench)


def against(found: Calibration, parameters: Parameters, motion: TrueMotion, wrench: Array) -> Outcome:
    """A calibrated walk against what was walked."""
    (walk,) = found.trials
    state = [motion.basis.evaluate(motion.coefficients, derivative) for derivative in range(3)]
    true = Dynamics(parameters).forces(*state, wrench)
    here, there = body_poses(found.model.parameters, walk.body.q), body_poses(parameters, motion.q)
    loads = walk.loads
    if loads is None or loads.errors is None:
        raise RuntimeError("no torques")
    valid = loads.reactions.valid
    own = np.hstack([loads.final.tau, loads.final.knee_adduction])
    names = {"hip": "thigh", "knee": "shank", "ankle": "foot"}
    apart = {
        joint: np.array([np.linalg.norm((here[f"{s}_{n}"][1] - there[f"{s}_{n}"][1]).mean(axis=0)) for s in SIDES])
        for joint, n in names.items()
    }
    return Outcome(found.verdict.judgement.value, apart, (own - true)[valid], loads.errors.every[valid])


TORQUES = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "knee_adduction", "ankle_angle")
PARTS: dict[str, Errors] = {
    "poses": Errors(),
    "white": Errors(memory=0.0),
    "biased": Errors(constant=(0.010, float(np.deg2rad(4.0)))),
    "points": Errors(place=0.015),
    "points_off": Errors(place=0.015, constant=(0.015, 0.0)),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of this member."""
    parser.add_argument("--people", type=int, default=3, help="made-up people of each part (default 3)")


def run(chosen: argparse.Namespace) -> dict[str, dict[str, object]]:
    """All parts."""
    return {part: report(part, PARTS[part], range(chosen.seed, chosen.seed + chosen.people)) for part in chosen.parts}


def report(part: str, errors: Errors, seeds: range) -> dict[str, object]:
    """Calibrate the people of one part, and print."""
    found: list[Outcome] = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            found.append(outcome(Path(folder), seed, errors, points=part.startswith("points")))
    centres = {joint: 1e3 * rms(np.concatenate([one.centres[joint] for one in found])) for joint in found[0].centres}
    say(f"{part}: {', '.join(one.trusted for one in found)}")
    say("  joint centres off by " + ", ".join(f"{joint} {size:.1f} mm" for joint, size in centres.items()))
    out: dict[str, object] = {"verdicts": [one.trusted for one in found], "centres_mm": centres}
    for torque in TORQUES:
        columns = [FORCES.index(f"{torque}_{side}") for side in SIDES]
        off, bars = (
            np.concatenate([getattr(one, name)[:, columns].ravel() for one in found]) for name in ("errors", "bars")
        )
        covered = float(np.mean(np.abs(off) <= 1.96 * bars))
        out[torque] = {"rms": rms(off), "se": rms(bars), "covered": covered}
        say(f"  {torque:14s} {rms(off):6.2f} N·m, standard error {rms(bars):6.2f}, covered {100 * covered:5.1f} %")
    return out
