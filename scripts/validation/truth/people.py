"""The people whose truth OpenSim knows: their studies and joints. Trials are made once, into a cache folder.

Joint parameters of known joints, told in the segment frames of the static trial.

Frames are those in which the nominal model places its markers. A ball joint is a point in both segments. A hinge's
axis z in the segment above or below is Rx(front) Ry(trans) z; it is told at its point of lateral position zero in the
thigh, and at the same point of the shank. Talocrural and subtalar axis are told at their common perpendicular, from
which also come the talus's parameters: the distance of the two axes, and the angle by which they miss a right one. The
subtalar axis x in the foot is Ry(trans) Rz(sag) x.
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
from gaitcal.export.peer_model import Axis
from gaitcal.io.opensim_files import read_table
from gaitcal.model.segment_frames import Frame, rigid_motions
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.synthetic.truth import common_perpendicular
from scripts.validation.truth.opensim_trials import ISOLATED, TRIALS, make_trials

CENTRES = {"hip": "HJC", "knee": "KJC", "ankle": "AJC"}
"""Joint -> ending of the label of its centre."""


@dataclass(frozen=True, kw_only=True)
class IsolatedPerson:
    """A person's isolated trials, and the joints in the laboratory of the static trial."""

    study: Study
    centres: Mapping[str, Array]
    """`hip_r`, ... -> (3,) m."""
    proximal: Mapping[str, Axis]
    """`knee_r`, `ankle_r`, `subtalar_r`, ... -> axis, as the segment above carries it to the static pose."""
    distal: Mapping[str, Axis]
    """The same, as the segment below carries it."""


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
    """(nf, 2, 6) N, N·m about the laboratory origin: what OpenSim's inverse dynamics had on right and left foot."""


def made(person: str, data: Path, cache: Path) -> Path:
    """The folder with the trials of a person, made by OpenSim if they are not there yet; SystemExit without it."""
    folder, source = cache / person, data / person
    if not all((folder / name).exists() for name in (*(f"{trial}.trc" for trial in TRIALS), "truth.json")):
        print(f"{person}: OpenSim moves the joints one after the other, which takes some minutes", flush=True)
        try:
            make_trials(next(source.glob("*.osim")), source / "coordinates.sto", folder)
        except ImportError as missing:
            raise SystemExit("isolated trials need OpenSim (extra `peers`), or a --cache that has them") from missing
    return folder


@lru_cache(maxsize=4)
def isolated_person(person: str, data: Path, cache: Path, with_gait: bool = False) -> IsolatedPerson:
    """Static and isolated trials, without noise; with the walk too where asked for."""
    folder = made(person, data, cache)
    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    recorded = load_study_file(data / person / "study.toml")
    walk = (TrialTable(name="gait", role="gait", file=folder / "gait.trc"),) if with_gait else ()
    static = TrialTable(name="static", role="static", file=folder / "static.trc")
    trials = tuple(TrialTable(name=j, role="joint", joint=j, file=folder / f"{j}.trc") for j in ISOLATED)  # type: ignore[arg-type]
    study = _loaded(recorded.model_copy(update={"trials": (static, *trials, *walk)}))

    def lines(end: str) -> dict[str, Axis]:
        axes = truth["axes"].items()
        return {joint: Axis(np.array(ends[end]["point"]), np.array(ends[end]["axis"])) for joint, ends in axes}

    centres = {joint: np.array(point) for joint, point in truth["static"].items()}
    return IsolatedPerson(study=study, centres=centres, proximal=lines("proximal"), distal=lines("distal"))


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
    joints = {f"{joint}_{side}": side.upper() + end for joint, end in CENTRES.items() for side in "rl"}
    tracks = {joint: known.markers[:, column[label]] for joint, label in joints.items()}
    time = walk.recording.time
    centres = {name: at_times(time, known.time, track) for name, track in tracks.items()}
    table = read_table(data / person / "id.sto")
    grf, ground = read_table(data / person / "grf.mot"), []
    for side in "rl":
        columns = (f"ground_{kind.format(s=side)}" for kind in ("force_{s}_v", "force_{s}_p", "torque_{s}_"))
        force, point, free = (np.column_stack([grf.column(name + axis) for axis in "xyz"]) for name in columns)
        ground.append(at_times(time, grf.time, np.hstack([force, free + np.cross(point, force)])))
    moments = {n.removesuffix("_moment"): table.column(n) for n in table.names if n.endswith("_moment")}
    return WalkingPerson(
        study=study,
        centres=centres,
        static_hips={f"hip_{side}": _static_point(study, known, tracks[f"hip_{side}"]) for side in "rl"},
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
    rotation, origin = rigid_motions(rest, known.markers[:, [known.labels.index(label) for label in labels]])
    back: Array = np.einsum("fji,fj->fi", rotation, track - origin)
    return np.asarray(back.mean(axis=0))


EXACT_PLATES = {"place_mm": 0.0, "turn_deg": 0.0, "gain_percent": 0.0, "clock_ms": 0.0}
"""Ground reactions of people that another program made, or we."""


def with_settings(study: Study, changes: Mapping[str, object]) -> Study:
    """The study with gaitcal's default settings, but for these and for force plates, which are exact here."""
    return replace(study, settings=type(study.settings).model_validate({"plate_error": EXACT_PLATES} | dict(changes)))


DIRECTIONS = ("ant", "sup", "lat")


def line_in(frame: Frame, line: Axis) -> Axis:
    """A line of the laboratory in a segment's frame."""
    return line.moved(pin.SE3(frame.rotation, frame.origin).inverse())


def static_frames(nominal: SubjectModel, static: Recording) -> dict[str, Frame]:
    """Segment -> pose, of segments that carry three markers or more in the static trial."""
    seen = dict(zip(static.labels, np.nanmean(static.markers, axis=0), strict=True))
    frames = {}
    markers = nominal.markers
    placed = list(zip(markers.labels, markers.segments, markers.local, strict=True))
    for segment in dict.fromkeys(markers.segments):
        carried = [(label, local) for label, s, local in placed if s == segment and label in seen]
        if len(carried) >= 3:
            local, measured = np.array([x for _, x in carried]), np.array([seen[label] for label, _ in carried])
            rotation, origin = rigid_motions(local, measured[None])
            frames[segment] = Frame(rotation[0], origin[0])
    return frames


def hip_parameters(frames: Mapping[str, Frame], side: str, centre: Array) -> dict[str, float]:
    """The six of a hip (m) whose centre (3,) is known."""
    return {
        **point_parameters(f"hip_{side}.pelvis", frames["pelvis"].local(centre)),
        **point_parameters(f"hip_{side}.thigh", frames[f"thigh_{side}"].local(centre)),
    }


def leg_parameters(person: IsolatedPerson, frames: Mapping[str, Frame], side: str) -> dict[str, float]:
    thigh, shank, foot = (frames[f"{name}_{side}"] for name in ("thigh", "shank", "foot"))
    out = hip_parameters(frames, side, person.centres[f"hip_{side}"])
    above = line_in(thigh, person.proximal[f"knee_{side}"]).pointing(2)
    below = line_in(shank, person.distal[f"knee_{side}"]).pointing(2)
    slide = -above.point[2] / above.direction[2]
    out |= point_parameters(f"knee_{side}.thigh", above.point + slide * above.direction, "ant sup")
    out |= point_parameters(f"knee_{side}.shank", below.point + slide * below.direction)
    out |= z_parameters(f"knee_{side}.thigh", above.direction) | z_parameters(f"knee_{side}.shank", below.direction)
    z = line_in(shank, person.proximal[f"ankle_{side}"]).pointing(2)
    # the subtalar axis as the talus carries it, which at rest is where the shank has it
    x = line_in(shank, person.proximal[f"subtalar_{side}"]).pointing(0)
    on_z, on_x = common_perpendicular(z.direction, z.point, x.direction, x.point)
    up = np.cross(z.direction, x.direction)
    out |= point_parameters(f"talocrural_{side}.shank", on_z) | z_parameters(f"talocrural_{side}.shank", z.direction)
    out[f"subtalar_{side}.talus.sup"] = float((on_x - on_z) @ up / np.linalg.norm(up))
    out[f"subtalar_{side}.talus.trans"] = float(-np.arcsin(z.direction @ x.direction))
    line = line_in(foot, person.distal[f"subtalar_{side}"]).pointing(0)
    slide = (on_x - x.point) @ x.direction
    out |= point_parameters(f"subtalar_{side}.foot", line.point + slide * line.direction)
    return out | x_parameters(f"subtalar_{side}.foot", line.direction)


def point_parameters(prefix: str, point: Array, which: str = "ant sup lat") -> dict[str, float]:
    """Coordinates of a point (m) by parameter."""
    return {f"{prefix}.{d}": float(point[DIRECTIONS.index(d)]) for d in which.split()}


def z_parameters(prefix: str, z: Array) -> dict[str, float]:
    """Angles (rad) of Rx(front) Ry(trans) whose z axis is given."""
    return {f"{prefix}.front": float(np.arctan2(-z[1], z[2])), f"{prefix}.trans": float(np.arcsin(z[0]))}


def x_parameters(prefix: str, x: Array) -> dict[str, float]:
    """Angles (rad) of Ry(trans) Rz(sag) whose x axis is given."""
    return {f"{prefix}.trans": float(np.arctan2(-x[2], x[0])), f"{prefix}.sag": float(np.arcsin(x[1]))}


def z_axis(front: float, trans: float) -> Array:
    """(3,) the z axis of Rx(front) Ry(trans)."""
    return np.array([np.sin(trans), -np.sin(front) * np.cos(trans), np.cos(front) * np.cos(trans)])


def x_axis(trans: float, sag: float) -> Array:
    """(3,) the x axis of Ry(trans) Rz(sag)."""
    return np.array([np.cos(trans) * np.cos(sag), np.sin(sag), -np.sin(trans) * np.cos(sag)])
