"""Save a scene as `.npz`, and dump it as JSON for the page.

The file needs no pickle, and is not compressed, as coordinates hardly get smaller. Its array
`scene` contains JSON text (UTF-8) with all names and single numbers; every other array has the name
of its field, `trial0/origins`, `joints/fitted_axis`, ...

In the page, positions of segments and markers are relative to the pelvis, as 16-bit integers over
their range in the trial (0.03 mm on two metres), with `GAP` for a gap. The pelvis is stored in
32-bit floats, quaternions in 1/`LARGEST`. Frames are omitted if all trials together are too large.
"""

import io
import json
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io.atomic import write_atomically
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.report.page import bone_files, bone_landmarks, bone_placement
from gaitcal.report.page.body_meshes import MESHES, BodyMeshes, FittedMesh, Mesh
from gaitcal.report.page.plain_data import (
    LARGEST,
    dump_script_json,
    encode_base64,
    pack_floats,
    pack_lengths,
)
from gaitcal.report.page.scene import JointMark, MotionScene, Scene

VERSION = 1
MOST_BYTES = 9_000_000
"""Packed playback data of all trials of a page together: 12 MB as base64, of the 25 MB that it may
have.
"""
# From the pelvis: a marker beyond is no marker of this person, and would coarsen all others
MARKER_RANGE_M = 20.0

_DAMAGE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError,
    EOFError, SyntaxError,
    MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What NumPy, zipfile and zlib raise on files that are not what they seem."""
_BODY = "garments"  # What files of this version call the body meshes
_LANDMARKS = "landmarks/"
EARLY = 0.005  # s: a later first frame is reported as not the begin of the recording
_JOINT_ARRAYS = (
    "nominal_centre", "fitted_centre", "nominal_axis", "fitted_axis", "centre_spread",
    "axis_spread",
)  # fmt: skip


def _list_trial_shapes(
    frames: int, segments: int, markers: int
) -> dict[str, tuple[int | None, ...]]:
    """List array of a `MotionScene` -> its shape; None: any."""
    return {
        "time": (frames,),
        "origins": (frames, segments, 3),
        "turns": (frames, segments, 4),
        "tracked": (segments,),
        "measured": (frames, markers, 3),
        "forces": (frames, 2, 3),
        "pressure_centres": (frames, 2, 3),
        "valid": (frames,),
        "valid_legs": (frames, 2),
        "plates": (None, 4, 3),
    }


_TRIAL_ARRAYS = tuple(_list_trial_shapes(0, 0, 0))


def save_scene(scene: Scene, path: Path | str) -> None:
    """Write a scene, whole or not at all.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {"marker_places": scene.marker_places}
    for i, trial in enumerate(scene.trials):
        # Numbers are arrays, everything else is one JSON text.
        arrays |= {f"trial{i}/{name}": getattr(trial, name) for name in _TRIAL_ARRAYS}
    for name in _JOINT_ARRAYS:
        arrays[f"joints/{name}"] = np.array([getattr(joint, name) for joint in scene.joints])
    arrays[f"{_BODY}/place"] = np.array([fitted.place for fitted in scene.body])
    text = {
        "version": VERSION,
        "subject": scene.subject,
        "mass": scene.mass,
        "height": scene.height,
        "labels": scene.labels,
        "marker_segments": scene.marker_segments,
        "segments": scene.segments,
        "joints": [[j.joint, j.segment, j.fitted] for j in scene.joints],
        _BODY: [[fitted.mesh, fitted.segment] for fitted in scene.body],
        "trials": [[t.name, t.role, t.recorded, t.stride] for t in scene.trials],
        "knees": {side: evidence.name for side, evidence in scene.landmarks.knees.items()},
    }
    arrays |= {f"{_LANDMARKS}{name}": point for name, point in scene.landmarks.points.items()}
    arrays["scene"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    with write_atomically(path) as target, target.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def load_scene(path: Path | str) -> Scene:
    """Read a scene that `save_scene` wrote.

    Raises
    ------
    InputError
        The file is missing, or is not a scene.
    """
    path = Path(path)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
            return _parse_scene(arrays)
    except FileNotFoundError:
        raise InputError(
            "no such file; `gaitcal calibrate` writes it", source=path, code=Code.NO_RESULT
        ) from None
    except _DAMAGE as error:
        message = f"is no scene of gaitcal, or is damaged ({type(error).__name__})"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT) from error


def _parse_scene(arrays: Any) -> Scene:
    text = json.loads(arrays["scene"].tobytes().decode())
    if text["version"] != VERSION:
        raise ValueError(text["version"])
    trials = tuple(
        MotionScene(
            name=str(name),
            role=str(role),
            recorded=int(recorded),
            stride=int(stride),
            **{field: arrays[f"trial{i}/{field}"] for field in _TRIAL_ARRAYS},
        )
        for i, (name, role, recorded, stride) in enumerate(text["trials"])
    )
    joints = {name: arrays[f"joints/{name}"] for name in _JOINT_ARRAYS}
    places = arrays[f"{_BODY}/place"]
    scene = Scene(
        subject=str(text["subject"]),
        mass=float(text["mass"]),
        height=float(text["height"]),
        labels=tuple(map(str, text["labels"])),
        marker_segments=tuple(map(str, text["marker_segments"])),
        marker_places=arrays["marker_places"],
        joints=tuple(
            JointMark(
                joint=str(joint),
                segment=str(segment),
                fitted=bool(fitted),
                **{n: v[k] for n, v in joints.items()},
            )
            for k, (joint, segment, fitted) in enumerate(text["joints"])
        ),
        body=tuple(FittedMesh(str(m), str(s), places[k]) for k, (m, s) in enumerate(text[_BODY])),
        trials=trials,
        segments=tuple(map(str, text["segments"])),
        landmarks=bone_landmarks.PersonLandmarks(
            {
                n.removeprefix(_LANDMARKS): arrays[n]
                for n in arrays.files
                if n.startswith(_LANDMARKS)
            },
            {
                str(side): bone_landmarks.KneeEvidence[evidence]
                for side, evidence in text["knees"].items()
            },
        ),
    )
    _check(scene)
    return scene


def _check(scene: Scene) -> None:
    """Raise ValueError if the sizes of a scene disagree."""
    segments, markers = len(scene.segments), len(scene.labels)
    used = {
        *scene.marker_segments,
        *(j.segment for j in scene.joints),
        *(mesh.segment for mesh in scene.body),
    }
    fits = (
        used <= set(scene.segments)
        and scene.marker_places.shape == (markers, 3)
        and len(scene.marker_segments) == markers
        and all(fitted.mesh in MESHES and fitted.place.shape == (3, 4) for fitted in scene.body)
        and scene.landmarks.complete
        and all(len(trial.time) > 0 for trial in scene.trials)
    )
    # A file that was cut or edited must not reach the page.
    for trial in scene.trials:
        for name, shape in _list_trial_shapes(len(trial.time), segments, markers).items():
            found = getattr(trial, name).shape
            fits = (
                fits
                and len(found) == len(shape)
                and all(n in (m, None) for m, n in zip(found, shape, strict=True))
            )
    if not fits:
        raise ValueError("sizes")


def dump_scene_json(
    scene: Scene, shapes: BodyMeshes, bones: bone_placement.Landmarked | None = None
) -> str:
    """Dump a scene as JSON that may be placed inside a `<script>` element.

    `bones`: shown inside the body; None if none are installed.
    """
    step = _compute_thinning(scene)
    used = sorted({fitted.mesh for fitted in scene.body})
    content = {
        "subject": scene.subject,
        "mass": scene.mass,
        "height": scene.height,
        "segments": scene.segments,
        "markers": {
            "labels": scene.labels,
            "segments": [scene.segments.index(s) for s in scene.marker_segments],
            "places": pack_floats(scene.marker_places),
        },
        "joints": [_pack_joint(scene, joint) for joint in scene.joints],
        "meshes": {name: _pack_mesh(shapes.meshes[name]) for name in used},
        "capsules": sorted(set(used) & set(shapes.replaced)),
        "body": [_pack_fitted_mesh(scene, fitted) for fitted in scene.body],
        "bones": _pack_bones(scene, bones),
        "trials": [_pack_trial(scene, trial, step) for trial in scene.trials],
    }
    return dump_script_json(content)


def report_thinned_frames(scene: Scene) -> tuple[str, ...]:
    """Report every trial of which the page shows only some frames."""
    step = _compute_thinning(scene)
    strides = ((trial, trial.stride * step) for trial in scene.trials)
    return tuple(
        f"{trial.name}: the page shows {-(-trial.recorded // stride)} of {trial.recorded} frames, "
        f"one in {stride}; "
        "poses between are interpolated"
        for trial, stride in strides
        if stride > 1
    )


def _compute_thinning(scene: Scene) -> int:
    """Compute the common frame step at which all trials fit the page."""
    bytes_a_frame = 14 * len(scene.segments) + 6 * len(scene.labels) + 64
    total = sum(len(trial.time) for trial in scene.trials) * bytes_a_frame
    return max(1, -(-total // MOST_BYTES))


def _pack_trial(scene: Scene, trial: MotionScene, thin: int) -> dict[str, Any]:
    kept = slice(None, None, thin)
    time = trial.time[kept] - trial.time[0]
    pelvis = trial.origins[kept, :1]
    measured = trial.measured[kept] - pelvis
    # Positions relative to the pelvis, in 16 bits: markers far away are faults of the camera
    # system.
    measured[~(np.abs(measured) < MARKER_RANGE_M).all(axis=2)] = np.nan
    return {
        "name": trial.name,
        "role": trial.role,
        "recorded": trial.recorded,
        "stride": trial.stride * thin,
        "about": _describe_trial(scene, trial, time, trial.stride * thin),
        "time": pack_floats(time),
        "pelvis": pack_floats(pelvis),
        "origins": pack_lengths(trial.origins[kept] - pelvis),
        "turns": encode_base64(np.rint(trial.turns[kept] * LARGEST).astype("<i2")),
        "tracked": [bool(t) for t in trial.tracked],
        "measured": pack_lengths(measured),
        "forces": pack_floats(trial.forces[kept]),
        "centres": pack_floats(trial.pressure_centres[kept]),
        "hasForces": trial.has_forces,
        "valid": {
            side: _find_spans(time, trial.valid_legs[kept, k]) for k, side in enumerate(SIDES)
        },
        "plates": pack_floats(trial.plates),
    }


def _describe_trial(scene: Scene, trial: MotionScene, time: Array, stride: int) -> str:
    """Describe a trial in a few lines; `time`: s, of the frames in the page, one in `stride`."""
    frames = f"{trial.recorded:,}".replace(",", "\u202f") + (
        " frame" if trial.recorded == 1 else " frames"
    )
    rate = f" at {(len(time) - 1) / time[-1] * stride:.0f} Hz" if time[-1] > 0 else ""
    lines = [f"{trial.name} \u00b7 {frames}{rate}", f"{scene.mass:.1f} kg, {scene.height:.2f} m"]
    if trial.time[0] > EARLY:
        lines.append(f"begins at {trial.time[0]:.2f} s of the recording")
    if stride > 1:
        # 11th, 12th and 13th are exceptions.
        ending = (
            "th"
            if stride % 100 in (11, 12, 13)
            else {1: "st", 2: "nd", 3: "rd"}.get(stride % 10, "th")
        )
        which = {2: "second", 3: "third"}.get(stride, f"{stride}{ending}")
        lines.append(f"every {which} frame is in this page; poses between are interpolated")
    return "\n".join(lines)


def _find_spans(time: Array, valid: NDArray[np.bool_]) -> list[list[float]]:
    """Find begin and end, s, of each run of valid frames."""
    edges = np.diff(np.r_[0, valid.astype(int), 0])
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [[float(time[a]), float(time[b])] for a, b in zip(begins, ends, strict=True)]


def _describe_joint(joint: JointMark) -> tuple[str, str]:
    """Return the title of a joint and its description in the picture."""
    name, _, side = joint.joint.partition("_")
    title = f"{SIDE_WORDS[side]} {name} joint" if side in SIDE_WORDS else f"{name} joint"
    if not joint.fitted:
        return title, f"{title}\nnot fitted: nominal"
    moved = float(np.linalg.norm(joint.fitted_centre - joint.nominal_centre))
    text = f"{title}\ncentre moved {1000 * moved:.1f} mm"
    if np.isfinite(joint.nominal_axis).all() and np.isfinite(joint.fitted_axis).all():
        cosine = min(1.0, float(joint.fitted_axis @ joint.nominal_axis))
        text += f", axis rotated {np.degrees(np.arccos(cosine)):.1f}\u00b0"
    if np.isfinite(joint.centre_spread).all():
        text += (
            f"\nstandard error of the centre {1000 * np.linalg.norm(joint.centre_spread):.1f} mm"
        )
    return title, text


def _pack_joint(scene: Scene, joint: JointMark) -> dict[str, Any]:
    places = {
        f"{first}{second.capitalize()}": _list_numbers(getattr(joint, f"{first}_{second}"))
        for first, second in (name.split("_") for name in _JOINT_ARRAYS)
    }
    segment = scene.segments.index(joint.segment)
    title, text = _describe_joint(joint)
    words = {"joint": joint.joint, "title": title, "text": text}
    return {**words, "segment": segment, "fitted": joint.fitted, **places}


def _pack_bones(scene: Scene, bones: bone_placement.Landmarked | None) -> dict[str, Any]:
    """Pack the bones in their segments with the knee axes, or the reason why there are none."""
    if bones is None:
        return {
            "why": f"not installed: pip install 'gaitcal[{bone_files.EXTRA}]', then gaitcal view"
        }
    placed = bone_placement.fit_bones(bones, scene.landmarks, scene.height)
    return {
        "why": None,
        "source": bones.bones.source,
        "meshes": {
            name: _pack_mesh(bones.bones.reduce_bone(name))
            for name in sorted({bone.mesh for bone in placed})
        },
        "placed": [_pack_fitted_mesh(scene, bone) for bone in placed],
        "knees": [
            {
                "joint": f"knee_{knee.side}",
                "title": f"{SIDE_WORDS[knee.side].capitalize()} knee",
                "words": bone_placement.describe_knee(knee),
                "segment": scene.segments.index(f"thigh_{knee.side}"),
                "centres": [_list_numbers(centre) for centre in knee.centres],
                "radii": _list_numbers(knee.radii),
                "across": _list_numbers(knee.across),
            }
            for knee in bone_placement.measure_knee_axes(bones, scene.landmarks, scene.joints)
        ],
    }


def _pack_fitted_mesh(scene: Scene, fitted: FittedMesh) -> dict[str, Any]:
    place = [float(x) for x in fitted.place.ravel()]
    return {"mesh": fitted.mesh, "segment": scene.segments.index(fitted.segment), "place": place}


def _pack_mesh(mesh: Mesh) -> dict[str, Any]:
    return {
        "vertices": pack_lengths(mesh.vertices),
        "triangles": encode_base64(mesh.triangles.astype("<u2")),
    }


def _list_numbers(values: Array) -> list[float] | None:
    """List numbers; None if any is missing."""
    return [float(x) for x in values.ravel()] if np.isfinite(values).all() else None
