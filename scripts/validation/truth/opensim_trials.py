"""A person simulated by OpenSim moves one joint after the other: markers, and the truth about the joints.

From the model and the coordinates of a walk, OpenSim's own kinematics make, without noise, the markers of a static
trial, six isolated trials (hip, knee, ankle of both legs; 6 s at 200 frames/s) and the walk, and with them
`truth.json` (m, laboratory of the static trial): the joint centres, and each hinge's axis as the screw between 5 deg
below and above the middle of its isolated trial. That line is told twice, carried to the static pose by the body above
(`proximal`) and by the body below (`distal`) the joint. For a hinge both agree; OpenSim's knee rolls and slides, and no
hinge meets it everywhere. The two points are the same, half-way. Needs `opensim`; two minutes a person.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.export.peer_model import Axis, displacement_axis
from gaitcal.io.opensim_files import read_table, write_trc
from gaitcal.io.recording import Recording

RATE, SECONDS, STANDING = 200.0, 6.0, 1.0
HERTZ = 0.6
"""Of the isolated movements."""
PELVIS_HEIGHT = 0.95
"""m."""
ISOLATED = tuple(f"{joint}_{side}" for side in "rl" for joint in ("hip", "knee", "ankle"))
TRIALS = ("static", *ISOLATED, "gait")
HINGES = {"knee": ("knee_angle", 45.0), "ankle": ("ankle_angle", -8.0), "subtalar": ("subtalar_angle", 0.0)}
"""OpenSim's joint -> its coordinate, and the middle of its isolated trial, deg."""
JOINTS = tuple(f"{joint}_{side}" for side in "rl" for joint in ("hip", *HINGES))
STEP = 5.0
"""deg to either side of the middle."""
VIRTUAL = ("HJC", "KJC", "AJC", "EJC", "SJC", "WJC")
"""Endings of labels that are joint centres, not markers."""
LEFT_AT_ZERO = ("beta", "mtp", "arm_rot")
"""Parts of coordinates' names that the linkage has no like of: patella, toes, turn of the upper arm."""


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
        self._coordinates = {c.getName(): c for c in (coordinates.get(i) for i in range(coordinates.getSize()))}
        joints = self.model.getJointSet()
        named = {joints.get(i).getName().replace("walker_", ""): joints.get(i) for i in range(joints.getSize())}
        self._joints = {name: named[name] for name in JOINTS}
        markers = self.model.getMarkerSet()
        every = [markers.get(i) for i in range(markers.getSize())]
        self._markers = {m.getName(): m for m in every if not m.getName().endswith(VIRTUAL)}
        self.labels = tuple(self._markers)
        self.standing = {
            name: PELVIS_HEIGHT if name == "pelvis_ty" else 0.0
            for name, c in self._coordinates.items()
            if not (c.getLocked(self.state) or c.isConstrained(self.state) or any(p in name for p in LEFT_AT_ZERO))
        }
        """Coordinate -> value (m, rad) of every coordinate that moves."""

    def put(self, posture: dict[str, float]) -> None:
        for name, value in posture.items():
            self._coordinates[name].setValue(self.state, float(value), False)
        self.model.assemble(self.state)
        self.model.realizePosition(self.state)

    def positions(self) -> Array:
        """(nm, 3) m, of the markers."""
        return np.array([_vector(m.getLocationInGround(self.state)) for m in self._markers.values()])

    def centres(self) -> Array:
        """(nj, 3) m, of `JOINTS`."""
        return np.array([_vector(j.getParentFrame().getPositionInGround(self.state)) for j in self._joints.values()])

    def bodies(self, joint: str) -> tuple[pin.SE3, pin.SE3]:
        """Poses of the bodies above and below a joint."""
        frames = self._joints[joint].getParentFrame(), self._joints[joint].getChildFrame()
        above, below = (_pose(f.findBaseFrame().getTransformInGround(self.state)) for f in frames)
        return above, below

    def is_angle(self, coordinate: str) -> bool:
        """Whether a coordinate is told in degrees where a file is."""
        return bool(self._coordinates[coordinate].getMotionType() == self._opensim.Coordinate.Rotational)


def _vector(v: Any) -> Array:
    return np.array([v.get(i) for i in range(3)])


def _pose(transform: Any) -> pin.SE3:
    r = transform.R()
    return pin.SE3(np.array([[r.get(i, j) for j in range(3)] for i in range(3)]), _vector(transform.p()))


def smooth_step(x: Array, start: float, end: float) -> Array:
    """From 0 to 1 with continuous acceleration."""
    u = np.clip((x - start) / (end - start), 0.0, 1.0)
    out: Array = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return out


def isolated_motion(trial: str, time: Array) -> dict[str, Array]:
    """Coordinate -> (nf,) rad, of the coordinates that an isolated trial moves or holds away from zero."""
    joint, side = trial.split("_")
    wave, other = np.sin(2 * np.pi * HERTZ * time), np.cos(2 * np.pi * HERTZ * time)
    if joint == "hip":  # flexion, then abduction
        w = smooth_step(time, 2.75, 3.25)
        abduction = -15.0 - 20.0 * np.sin(2 * np.pi * HERTZ * (time - 3.0))
        degrees = {"hip_flexion": (1 - w) * (20.0 + 30.0 * wave) + w * 5.0, "hip_adduction": w * abduction}
    elif joint == "knee":
        degrees = {"hip_flexion": 40.0 + 0.0 * time, "knee_angle": HINGES["knee"][1] + 40.0 * wave}
    else:
        bent = {"hip_flexion": 30.0 + 0.0 * time, "knee_angle": 40.0 + 0.0 * time}
        degrees = {**bent, "ankle_angle": HINGES["ankle"][1] + 24.0 * wave, "subtalar_angle": 18.0 * other}
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
        markers, found = np.empty((len(t), len(person.labels), 3)), np.empty((len(t), len(JOINTS), 3))
        for f in range(len(t)):
            person.put({**person.standing, **{c: v[f] for c, v in moving.items()}})
            markers[f], found[f] = person.positions(), person.centres()
        write_trc(folder / f"{name}.trc", Recording(source=name, time=t, labels=person.labels, markers=markers))
        centres[name] = dict(zip(JOINTS, found.swapaxes(0, 1).tolist(), strict=True))
    truth = {
        "static": {joint: track[0] for joint, track in centres["static"].items()},
        "axes": {f"{joint}_{side}": true_axis(person, joint, side) for side in "rl" for joint in HINGES},
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
                time, table.time, np.deg2rad(values) if table.in_degrees and person.is_angle(name) else values
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
    line = displacement_axis(*ends)
    if line is None:
        raise RuntimeError(f"{joint}_{side} does not turn")
    # seen from below the screw is the same line at both ends, but for what it slides along itself
    points = [end.actInv(line.point) for end in ends]
    below = Axis(np.mean(points, axis=0), ends[0].rotation.T @ line.direction)
    person.put(person.standing)
    above_pose, below_pose = person.bodies(f"{joint}_{side}")
    lines = {"proximal": line.moved(above_pose), "distal": below.moved(below_pose)}
    return {end: {"point": x.point.tolist(), "axis": x.direction.tolist()} for end, x in lines.items()}
