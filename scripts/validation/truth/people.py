"""The people whose truth OpenSim knows: their studies and joints. Trials are made once, into a
cache folder.

Joint parameters of known joints, told in the segment frames of the static trial.

Frames are those in which the nominal model places its markers. A ball joint is a point in both
segments. A hinge's axis z in the segment above or below is Rx(front) Ry(trans) z; it is told at its
point of lateral position zero in the thigh, and at the same point of the shank. Talocrural and
subtalar axis are told at their common perpendicular, from which also come the talus's parameters:
the distance of the two axes, and the angle by which they miss a right one. The subtalar axis x in
the foot is Ry(trans) Rz(sag) x.

A person simulated by OpenSim moves one joint after the other: markers, and the truth about the
joints.

From the model and the coordinates of a walk, OpenSim's own kinematics make, without noise, the
markers of a static trial, six isolated trials (hip, knee, ankle of both legs; 6 s at 200 frames/s)
and the walk, and with them `truth.json` (m, laboratory of the static trial): the joint centres, and
each hinge's axis as the screw between 5 deg below and above the middle of its isolated trial. That
line is told twice, carried to the static pose by the body above (`proximal`) and by the body below
(`distal`) the joint. For a hinge both agree; OpenSim's knee rolls and slides, and no hinge meets it
everywhere. The two points are the same, half-way. Needs `opensim`; two minutes a person.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from gaitcal import Recording, Study, SubjectModel, read_recording
from gaitcal.arrays import Array
from gaitcal.export.opensim.peer_model import Axis, find_displacement_axis
from gaitcal.io.opensim_files import read_table, write_trc
from gaitcal.model.segment_frames import Frame, fit_rigid_motions
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.synthetic.synthetic_truth import compute_common_perpendicular

RATE, SECONDS, STANDING = 200.0, 6.0, 1.0
HERTZ = 0.6
"""Of the isolated movements."""
PELVIS_HEIGHT = 0.95
"""m."""
ISOLATED = tuple(f"{joint}_{side}" for side in "rl" for joint in ("hip", "knee", "ankle"))
TRIALS = ("static", *ISOLATED, "gait")
HINGES = {
    "knee": ("knee_angle", 45.0),
    "ankle": ("ankle_angle", -8.0),
    "subtalar": ("subtalar_angle", 0.0),
}
"""OpenSim's joint -> its coordinate, and the middle of its isolated trial, deg."""
JOINTS = tuple(f"{joint}_{side}" for side in "rl" for joint in ("hip", *HINGES))
STEP = 5.0
"""deg to either side of the middle."""
VIRTUAL = ("HJC", "KJC", "AJC", "EJC", "SJC", "WJC")
"""Endings of labels that are joint centres, not markers."""
LEFT_AT_ZERO = ("beta", "mtp", "arm_rot")
"""Parts of coordinates' names that the linkage has no like of: patella, toes, turn of the upper
arm.
"""


class Simulation:
    """An OpenSim model that is put into one posture after the other."""

    def __init__(self, model: Path) -> None:
        import opensim

        opensim.Logger.setLevelString("Off")
        self._opensim = opensim
        self.model = opensim.Model(str(model))
        self.state = self.model.initSystem()
        self.mass = float(self.model.getTotalMass(self.state))
        coordinates = self.model.getCoordinateSet()
        self._coordinates = {
            c.getName(): c for c in (coordinates.get(i) for i in range(coordinates.getSize()))
        }
        joints = self.model.getJointSet()
        named = {
            joints.get(i).getName().replace("walker_", ""): joints.get(i)
            for i in range(joints.getSize())
        }
        self._joints = {name: named[name] for name in JOINTS}
        markers = self.model.getMarkerSet()
        every = [markers.get(i) for i in range(markers.getSize())]
        self._markers = {m.getName(): m for m in every if not m.getName().endswith(VIRTUAL)}
        self.labels = tuple(self._markers)
        self.standing = {
            name: PELVIS_HEIGHT if name == "pelvis_ty" else 0.0
            for name, c in self._coordinates.items()
            if not (
                c.getLocked(self.state)
                or c.isConstrained(self.state)
                or any(p in name for p in LEFT_AT_ZERO)
            )
        }
        """Coordinate -> value (m, rad) of every coordinate that moves."""

    def put(self, posture: dict[str, float]) -> None:
        for name, value in posture.items():
            self._coordinates[name].setValue(self.state, float(value), False)
        self.model.assemble(self.state)
        self.model.realizePosition(self.state)

    def positions(self) -> Array:
        """(nm, 3) m, of the markers."""
        return np.array(
            [_vector(m.getLocationInGround(self.state)) for m in self._markers.values()]
        )

    def centres(self) -> Array:
        """(nj, 3) m, of `JOINTS`."""
        return np.array(
            [
                _vector(j.getParentFrame().getPositionInGround(self.state))
                for j in self._joints.values()
            ]
        )

    def bodies(self, joint: str) -> tuple[pin.SE3, pin.SE3]:
        """Poses of the bodies above and below a joint."""
        frames = self._joints[joint].getParentFrame(), self._joints[joint].getChildFrame()
        above, below = (_pose(f.findBaseFrame().getTransformInGround(self.state)) for f in frames)
        return above, below

    def is_angle(self, coordinate: str) -> bool:
        """Whether a coordinate is told in degrees where a file is."""
        return bool(
            self._coordinates[coordinate].getMotionType() == self._opensim.Coordinate.Rotational
        )


def _vector(v: Any) -> Array:
    return np.array([v.get(i) for i in range(3)])


def _pose(transform: Any) -> pin.SE3:
    r = transform.R()
    return pin.SE3(
        np.array([[r.get(i, j) for j in range(3)] for i in range(3)]), _vector(transform.p())
    )


def smooth_step(x: Array, start: float, end: float) -> Array:
    """From 0 to 1 with continuous acceleration."""
    u = np.clip((x - start) / (end - start), 0.0, 1.0)
    out: Array = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return out


def isolated_motion(trial: str, time: Array) -> dict[str, Array]:
    """Coordinate -> (nf,) rad, of the coordinates that an isolated trial moves or holds away from
    zero.
    """
    joint, side = trial.split("_")
    wave, other = np.sin(2 * np.pi * HERTZ * time), np.cos(2 * np.pi * HERTZ * time)
    if joint == "hip":  # flexion, then abduction
        w = smooth_step(time, 2.75, 3.25)
        abduction = -15.0 - 20.0 * np.sin(2 * np.pi * HERTZ * (time - 3.0))
        degrees = {
            "hip_flexion": (1 - w) * (20.0 + 30.0 * wave) + w * 5.0,
            "hip_adduction": w * abduction,
        }
    elif joint == "knee":
        degrees = {"hip_flexion": 40.0 + 0.0 * time, "knee_angle": HINGES["knee"][1] + 40.0 * wave}
    else:
        bent = {"hip_flexion": 30.0 + 0.0 * time, "knee_angle": 40.0 + 0.0 * time}
        degrees = {
            **bent,
            "ankle_angle": HINGES["ankle"][1] + 24.0 * wave,
            "subtalar_angle": 18.0 * other,
        }
    return {f"{name}_{side}": np.deg2rad(value) for name, value in degrees.items()}


def make_trials(model: Path, coordinates: Path, folder: Path, rate: float = RATE) -> None:
    """Write `NAME.trc` of every trial at `rate` frames/s, and `truth.json`, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    person = Simulation(model)
    walk_time, walk = walk_motion(person, coordinates, rate)
    time = np.arange(0.0, SECONDS, 1.0 / rate)
    centres = {}
    for name in TRIALS:
        t = {"static": time[time < STANDING], "gait": walk_time}.get(name, time)
        moving = walk if name == "gait" else {} if name == "static" else isolated_motion(name, t)
        markers, found = (
            np.empty((len(t), len(person.labels), 3)),
            np.empty((len(t), len(JOINTS), 3)),
        )
        for f in range(len(t)):
            person.put({**person.standing, **{c: v[f] for c, v in moving.items()}})
            markers[f], found[f] = person.positions(), person.centres()
        write_trc(
            folder / f"{name}.trc",
            Recording(source=name, time=t, labels=person.labels, markers=markers),
        )
        centres[name] = dict(zip(JOINTS, found.swapaxes(0, 1).tolist(), strict=True))
    truth = {
        "static": {joint: track[0] for joint, track in centres["static"].items()},
        "axes": {
            f"{joint}_{side}": true_axis(person, joint, side) for side in "rl" for joint in HINGES
        },
        "gait": centres["gait"],
        "mass": person.mass,
    }
    (folder / "truth.json").write_text(json.dumps(truth) + "\n", encoding="utf-8")


def walk_motion(person: Simulation, file: Path, rate: float) -> tuple[Array, dict[str, Array]]:
    """Time (nf,) s, and coordinate -> (nf,) m, rad, at `rate` frames/s."""
    table = read_table(file)
    time = np.arange(table.time[0], table.time[-1], 1.0 / rate)
    out = {}
    for name, values in zip(table.names, table.values.T, strict=True):
        if name in person.standing:
            out[name] = np.interp(
                time,
                table.time,
                np.deg2rad(values) if table.in_degrees and person.is_angle(name) else values,
            )
    return time, out


def true_axis(person: Simulation, joint: str, side: str) -> dict[str, dict[str, list[float]]]:
    """The axis of a hinge in the static pose, as the bodies above and below carry it."""
    coordinate, middle = HINGES[joint]

    def between(degrees: float) -> pin.SE3:
        person.put({**person.standing, f"{coordinate}_{side}": np.deg2rad(degrees)})
        above, below = person.bodies(f"{joint}_{side}")
        return above.actInv(below)

    ends = between(middle - STEP), between(middle + STEP)
    line = find_displacement_axis(*ends)
    if line is None:
        raise RuntimeError(f"{joint}_{side} does not turn")
    # seen from below the screw is the same line at both ends, but for what it slides along itself
    points = [end.actInv(line.point) for end in ends]
    below = Axis(np.mean(points, axis=0), ends[0].rotation.T @ line.direction)
    person.put(person.standing)
    above_pose, below_pose = person.bodies(f"{joint}_{side}")
    lines = {"proximal": line.transform(above_pose), "distal": below.transform(below_pose)}
    return {
        end: {"point": x.point.tolist(), "axis": x.direction.tolist()} for end, x in lines.items()
    }


CENTRES = {"hip": "HJC", "knee": "KJC", "ankle": "AJC"}
"""Joint -> ending of the label of its centre."""


@dataclass(frozen=True, kw_only=True)
class KnownJoints:
    """The joints of a person in the laboratory of the static trial."""

    centres: Mapping[str, Array]
    """`hip_r`, ... -> (3,) m."""
    proximal: Mapping[str, Axis]
    """`knee_r`, `ankle_r`, `subtalar_r`, ... -> axis, as the segment above carries it to the static
    pose.
    """
    distal: Mapping[str, Axis]
    """The same, as the segment below carries it."""


@dataclass(frozen=True, kw_only=True)
class IsolatedPerson(KnownJoints):
    """With the isolated trials."""

    study: Study


@dataclass(frozen=True, kw_only=True)
class WalkingPerson:
    """A person's recorded walk, and where the joints are in it."""

    study: Study
    centres: Mapping[str, Array]
    """`hip_r`, `knee_r`, `ankle_r`, ... -> (nf, 3) m in every frame of the walk, laboratory."""
    static_hips: Mapping[str, Array]
    """`hip_r`, `hip_l` -> (3,) m in the static trial."""
    torques: Mapping[str, Array]
    """OpenSim's name of a coordinate -> (nf,) N·m at the frames of the walk."""
    forces: Array
    """(nf, 2, 6) N, N·m about the laboratory origin: what OpenSim's inverse dynamics had on right
    and left foot.
    """


def made(person: str, data: Path, cache: Path) -> Path:
    """The folder with the trials of a person, made by OpenSim if they are not there yet; SystemExit
    without it.
    """
    folder, source = cache / person, data / person
    if not all(
        (folder / name).exists() for name in (*(f"{trial}.trc" for trial in TRIALS), "truth.json")
    ):
        print(
            f"{person}: OpenSim moves the joints one after the other, which takes some minutes",
            flush=True,
        )
        try:
            make_trials(next(source.glob("*.osim")), source / "coordinates.sto", folder)
        except ImportError as missing:
            raise SystemExit(
                "isolated trials need OpenSim (extra `peers`), or a --cache that has them"
            ) from missing
    return folder


@lru_cache(maxsize=4)
def isolated_person(
    person: str, data: Path, cache: Path, with_gait: bool = False
) -> IsolatedPerson:
    """Static and isolated trials, without noise; with the walk too where asked for."""
    folder = made(person, data, cache)
    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    recorded = load_study_file(data / person / "study.toml")
    walk = (TrialTable(name="gait", role="gait", file=folder / "gait.trc"),) if with_gait else ()
    static = TrialTable(name="static", role="static", file=folder / "static.trc")
    trials = tuple(
        TrialTable(name=j, role="joint", joint=j, file=folder / f"{j}.trc") for j in ISOLATED
    )  # type: ignore[arg-type]
    study = _loaded(recorded.model_copy(update={"trials": (static, *trials, *walk)}))

    def lines(end: str) -> dict[str, Axis]:
        axes = truth["axes"].items()
        return {
            joint: Axis(np.array(ends[end]["point"]), np.array(ends[end]["axis"]))
            for joint, ends in axes
        }

    centres = {joint: np.array(point) for joint, point in truth["static"].items()}
    return IsolatedPerson(
        study=study, centres=centres, proximal=lines("proximal"), distal=lines("distal")
    )


def _loaded(file: StudyFile) -> Study:
    """A study of these files, through a study file as any other."""
    absolute = tuple(t.model_copy(update={"file": t.file.resolve()}) for t in file.trials)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(file.model_copy(update={"trials": absolute}).to_toml(), encoding="utf-8")
        return Study.load(path)


@lru_cache(maxsize=4)
def walking_person(person: str, data: Path) -> WalkingPerson:
    """The recorded walk, without noise."""
    study = Study.load(data / person / "study.toml")
    (walk,) = study.moving
    known = read_recording(data / person / "walk_with_joint_centres.trc")
    column = {label: i for i, label in enumerate(known.labels)}
    joints = {
        f"{joint}_{side}": side.upper() + end for joint, end in CENTRES.items() for side in "rl"
    }
    tracks = {joint: known.markers[:, column[label]] for joint, label in joints.items()}
    time = walk.recording.time
    centres = {name: at_times(time, known.time, track) for name, track in tracks.items()}
    table = read_table(data / person / "id.sto")
    grf, ground = read_table(data / person / "grf.mot"), []
    for side in "rl":
        columns = (
            f"ground_{kind.format(s=side)}"
            for kind in ("force_{s}_v", "force_{s}_p", "torque_{s}_")
        )
        force, point, free = (
            np.column_stack([grf.get_column(name + axis) for axis in "xyz"]) for name in columns
        )
        ground.append(at_times(time, grf.time, np.hstack([force, free + np.cross(point, force)])))
    moments = {
        n.removesuffix("_moment"): table.get_column(n) for n in table.names if n.endswith("_moment")
    }
    return WalkingPerson(
        study=study,
        centres=centres,
        static_hips={
            f"hip_{side}": _static_point(study, known, tracks[f"hip_{side}"]) for side in "rl"
        },
        torques={name: np.interp(time, table.time, values) for name, values in moments.items()},
        forces=np.stack(ground, axis=1),
    )


def at_times(time: Array, known: Array, values: Array) -> Array:
    """(nf, k) linear between the known times."""
    return np.column_stack([np.interp(time, known, column) for column in values.T])


def _static_point(study: Study, known: Recording, track: Array) -> Array:
    """Where a point that the pelvis carries through the walk is in the static trial."""
    static = study.static.recording
    labels = study.marker_set.tracking["pelvis"]
    rest = static.markers.mean(axis=0)[[static.labels.index(label) for label in labels]]
    rotation, origin = fit_rigid_motions(
        rest, known.markers[:, [known.labels.index(label) for label in labels]]
    )
    back: Array = np.einsum("fji,fj->fi", rotation, track - origin)
    return np.asarray(back.mean(axis=0))


EXACT_PLATES = {"place_mm": 0.0, "turn_deg": 0.0, "gain_percent": 0.0, "clock_ms": 0.0}
"""Ground reactions of people that another program made, or we."""


def with_settings(study: Study, changes: Mapping[str, object]) -> Study:
    """The study with gaitcal's default settings, but for these and for force plates, which are
    exact here.
    """
    return replace(
        study,
        settings=type(study.settings).model_validate({"plate_error": EXACT_PLATES} | dict(changes)),
    )


DIRECTIONS = ("ant", "sup", "lat")


def line_in(frame: Frame, line: Axis) -> Axis:
    """A line of the laboratory in a segment's frame."""
    return line.transform(pin.SE3(frame.rotation, frame.origin).inverse())


def static_frames(nominal: SubjectModel, static: Recording) -> dict[str, Frame]:
    """Segment -> pose, of segments that carry three markers or more in the static trial."""
    seen = dict(zip(static.labels, np.nanmean(static.markers, axis=0), strict=True))
    frames = {}
    markers = nominal.markers
    placed = list(zip(markers.labels, markers.segments, markers.local, strict=True))
    for segment in dict.fromkeys(markers.segments):
        carried = [(label, local) for label, s, local in placed if s == segment and label in seen]
        if len(carried) >= 3:
            local, measured = (
                np.array([x for _, x in carried]),
                np.array([seen[label] for label, _ in carried]),
            )
            rotation, origin = fit_rigid_motions(local, measured[None])
            frames[segment] = Frame(rotation[0], origin[0])
    return frames


def hip_parameters(frames: Mapping[str, Frame], side: str, centre: Array) -> dict[str, float]:
    """The six of a hip (m) whose centre (3,) is known."""
    return {
        **point_parameters(f"hip_{side}.pelvis", frames["pelvis"].local(centre)),
        **point_parameters(f"hip_{side}.thigh", frames[f"thigh_{side}"].local(centre)),
    }


def leg_parameters(person: KnownJoints, frames: Mapping[str, Frame], side: str) -> dict[str, float]:
    thigh, shank, foot = (frames[f"{name}_{side}"] for name in ("thigh", "shank", "foot"))
    out = hip_parameters(frames, side, person.centres[f"hip_{side}"])
    above = line_in(thigh, person.proximal[f"knee_{side}"]).direct_along(2)
    below = line_in(shank, person.distal[f"knee_{side}"]).direct_along(2)
    slide = -above.point[2] / above.direction[2]
    out |= point_parameters(f"knee_{side}.thigh", above.point + slide * above.direction, "ant sup")
    out |= point_parameters(f"knee_{side}.shank", below.point + slide * below.direction)
    out |= z_parameters(f"knee_{side}.thigh", above.direction) | z_parameters(
        f"knee_{side}.shank", below.direction
    )
    z = line_in(shank, person.proximal[f"ankle_{side}"]).direct_along(2)
    # the subtalar axis as the talus carries it, which at rest is where the shank has it
    x = line_in(shank, person.proximal[f"subtalar_{side}"]).direct_along(0)
    on_z, on_x = compute_common_perpendicular(z.direction, z.point, x.direction, x.point)
    up = np.cross(z.direction, x.direction)
    out |= point_parameters(f"talocrural_{side}.shank", on_z) | z_parameters(
        f"talocrural_{side}.shank", z.direction
    )
    out[f"subtalar_{side}.talus.sup"] = float((on_x - on_z) @ up / np.linalg.norm(up))
    out[f"subtalar_{side}.talus.trans"] = float(-np.arcsin(z.direction @ x.direction))
    line = line_in(foot, person.distal[f"subtalar_{side}"]).direct_along(0)
    slide = (on_x - x.point) @ x.direction
    out |= point_parameters(f"subtalar_{side}.foot", line.point + slide * line.direction)
    return out | x_parameters(f"subtalar_{side}.foot", line.direction)


def point_parameters(prefix: str, point: Array, which: str = "ant sup lat") -> dict[str, float]:
    """Coordinates of a point (m) by parameter."""
    return {f"{prefix}.{d}": float(point[DIRECTIONS.index(d)]) for d in which.split()}


def z_parameters(prefix: str, z: Array) -> dict[str, float]:
    """Angles (rad) of Rx(front) Ry(trans) whose z axis is given."""
    return {
        f"{prefix}.front": float(np.arctan2(-z[1], z[2])),
        f"{prefix}.trans": float(np.arcsin(z[0])),
    }


def x_parameters(prefix: str, x: Array) -> dict[str, float]:
    """Angles (rad) of Ry(trans) Rz(sag) whose x axis is given."""
    return {
        f"{prefix}.trans": float(np.arctan2(-x[2], x[0])),
        f"{prefix}.sag": float(np.arcsin(x[1])),
    }


def z_axis(front: float, trans: float) -> Array:
    """(3,) the z axis of Rx(front) Ry(trans)."""
    return np.array([np.sin(trans), -np.sin(front) * np.cos(trans), np.cos(front) * np.cos(trans)])


def x_axis(trans: float, sag: float) -> Array:
    """(3,) the x axis of Ry(trans) Rz(sag)."""
    return np.array([np.cos(trans) * np.cos(sag), np.sin(sag), -np.sin(trans) * np.cos(sag)])
