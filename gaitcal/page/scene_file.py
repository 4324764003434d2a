"""A scene as one `.npz` file, read back without pickle; not compressed, as coordinates hardly become fewer bytes.

The array `scene` holds a JSON text (UTF-8) with all names and single numbers; every other array has the name of its
field, `trial0/origins`, `joints/fitted_axis`, ...

A scene as JSON for the page: names as text, numbers packed as base64 of small integers.

Segments and markers are told from the pelvis, as 16-bit integers on the range that they cover in their trial (0.03 mm
on two metres, however far the person walks), a gap as -32768; the pelvis itself in 32-bit floats; quaternions in
1/32767. Frames go where all trials together would be more than the page may hold.
"""

from __future__ import annotations

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
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_file
from gaitcal.model.linkage import SIDE_WORDS
from gaitcal.page.body_meshes import MESHES, BodyMeshes, FittedMesh, Mesh
from gaitcal.page.bones.bone_files import EXTRA
from gaitcal.page.bones.bone_landmarks import KneeEvidence, PersonLandmarks
from gaitcal.page.bones.knee_axis import KneeAxis, evidence_words, knee_axes, knee_brief, knee_words
from gaitcal.page.bones.placement import Landmarked, fitted_bones
from gaitcal.page.packing import FULL, base64_of, floats, lengths
from gaitcal.page.scene import JointMark, Scene, TrialScene

VERSION = 1
_BODY = "garments"
"""What files of this version call the body meshes."""

_DAMAGE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError, EOFError, SyntaxError,
    MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What NumPy, zipfile and zlib raise on files that are not what they seem."""

_TRIAL_ARRAYS = (
    "time", "origins", "turns", "tracked", "measured", "forces", "pressure_centres", "valid", "valid_legs",
    "plates",
)  # fmt: skip
_JOINT_ARRAYS = (
    "nominal_centre", "fitted_centre", "nominal_axis", "fitted_axis", "centre_spread", "axis_spread",
)  # fmt: skip
_LANDMARKS = "landmarks/"


def save_scene(scene: Scene, path: Path | str) -> None:
    """Write a scene, whole or not at all.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {"marker_places": scene.marker_places}
    for i, trial in enumerate(scene.trials):
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
    }
    if scene.landmarks is not None:
        arrays |= {f"{_LANDMARKS}{name}": point for name, point in scene.landmarks.points.items()}
        text["knees"] = {side: evidence.name for side, evidence in scene.landmarks.knees.items()}
    arrays["scene"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    with atomic_file(path) as target, target.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def load_scene(path: Path | str) -> Scene:
    """Read a scene that `save_scene` wrote.

    Raises
    ------
    InputError
        No such file, or not a scene.
    """
    path = Path(path)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
            return _scene(arrays)
    except FileNotFoundError:
        raise InputError("no such file; `gaitcal calibrate` writes it", source=path, code=Code.NO_RESULT) from None
    except _DAMAGE as error:
        raise InputError(
            f"is no scene of gaitcal, or is damaged ({type(error).__name__})", source=path, code=Code.DAMAGED_RESULT
        ) from error


def _scene(arrays: Any) -> Scene:
    text = json.loads(arrays["scene"].tobytes().decode())
    if text["version"] != VERSION:
        raise ValueError(text["version"])
    trials = tuple(
        TrialScene(
            name=str(name),
            role=str(role),
            recorded=int(recorded),
            stride=int(stride),
            **{field: arrays[f"trial{i}/{field}"] for field in _TRIAL_ARRAYS if field != "valid_legs"},
            valid_legs=_valid_legs(arrays, i),
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
                joint=str(joint), segment=str(segment), fitted=bool(fitted), **{n: v[k] for n, v in joints.items()}
            )
            for k, (joint, segment, fitted) in enumerate(text["joints"])
        ),
        body=tuple(FittedMesh(str(m), str(s), places[k]) for k, (m, s) in enumerate(text[_BODY])),
        trials=trials,
        segments=tuple(map(str, text["segments"])),
        landmarks=_landmarks(arrays, text),
    )
    _check(scene)
    return scene


def _landmarks(arrays: Any, text: dict[str, Any]) -> PersonLandmarks | None:
    """None in earlier files, which hold no landmarks."""
    if "knees" not in text:
        return None
    names = [name for name in arrays.files if name.startswith(_LANDMARKS)]
    return PersonLandmarks(
        {name.removeprefix(_LANDMARKS): arrays[name] for name in names},
        {str(side): KneeEvidence[evidence] for side, evidence in text["knees"].items()},
    )


def _valid_legs(arrays: Any, trial: int) -> NDArray[np.bool_]:
    """(nf, 2); earlier files hold one column for both legs."""
    name = f"trial{trial}/valid_legs"
    legs: NDArray[np.bool_] = arrays[name] if name in arrays else np.stack([arrays[f"trial{trial}/valid"]] * 2, axis=1)
    return legs


def _check(scene: Scene) -> None:
    """ValueError where sizes do not fit together."""
    segments, markers = len(scene.segments), len(scene.labels)
    known = {*scene.marker_segments, *(j.segment for j in scene.joints), *(mesh.segment for mesh in scene.body)}
    fits = (
        known <= set(scene.segments)
        and scene.marker_places.shape == (markers, 3)
        and len(scene.marker_segments) == markers
        and all(fitted.mesh in MESHES and fitted.place.shape == (3, 4) for fitted in scene.body)
        and (scene.landmarks is None or scene.landmarks.complete)
    )
    for t in scene.trials:
        n = len(t.time)
        shapes = {
            "time": (n,),
            "origins": (n, segments, 3),
            "turns": (n, segments, 4),
            "tracked": (segments,),
            "measured": (n, markers, 3),
            "forces": (n, 2, 3),
            "pressure_centres": (n, 2, 3),
            "valid": (n,),
            "valid_legs": (n, 2),
            "plates": (len(t.plates), 4, 3),
        }
        fits = fits and n > 0 and all(getattr(t, name).shape == shape for name, shape in shapes.items())
    if not fits:
        raise ValueError("sizes")


MOST_BYTES = 9_000_000
"""Packed playback data of all trials of a page together: 12 MB as base64, of the 25 MB that it may have."""
FAR = 20.0
"""m from the pelvis: a marker beyond is no marker of this person, and would coarsen all others."""


def scene_json(scene: Scene, shapes: BodyMeshes, bones: Landmarked | None = None, most_bytes: int = MOST_BYTES) -> str:
    """The scene as JSON that may stand inside a `<script>` element whatever the names are: it holds no `<`.

    Parameters
    ----------
    bones : shown inside the body; None where none are installed.
    most_bytes : that its playback data may have.
    """
    thin = _thinning(scene, most_bytes)
    used = sorted({fitted.mesh for fitted in scene.body})
    content = {
        "subject": scene.subject,
        "mass": scene.mass,
        "height": scene.height,
        "segments": scene.segments,
        "markers": {
            "labels": scene.labels,
            "segments": [scene.segments.index(s) for s in scene.marker_segments],
            "places": floats(scene.marker_places),
        },
        "joints": [_joint(scene, joint) for joint in scene.joints],
        "meshes": {name: _mesh(shapes.meshes[name]) for name in used},
        "capsules": sorted(set(used) & set(shapes.replaced)),
        "body": [_fitted(scene, fitted) for fitted in scene.body],
        "bones": _bones(scene, bones),
        "trials": [_trial(trial, thin) for trial in scene.trials],
    }
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _bones(scene: Scene, bones: Landmarked | None) -> dict[str, Any]:
    """The bones in their segments, and where each knee axis passes them; or why there are none."""
    if bones is None:
        return {"why": f"not installed: pip install 'gaitcal[{EXTRA}]', then gaitcal view"}
    if scene.landmarks is None:
        return {"why": "not in this result: calibrate again with this version"}
    placed = fitted_bones(bones, scene.landmarks, scene.height)
    return {
        "why": None,
        "source": bones.bones.source,
        "meshes": {name: _mesh(bones.bones.shown(name)) for name in sorted({bone.mesh for bone in placed})},
        "placed": [_fitted(scene, bone) for bone in placed],
        "knees": [_knee(scene, knee) for knee in knee_axes(bones, scene.landmarks, scene.joints)],
    }


def _knee(scene: Scene, knee: KneeAxis) -> dict[str, Any]:
    """What is said of a knee, and the circles of its condyles."""
    return {
        "joint": f"knee_{knee.side}",
        "title": f"{SIDE_WORDS[knee.side].capitalize()} knee",
        "brief": knee_brief(knee),
        "axes": knee_words(knee),
        "stands": evidence_words(knee),
        "segment": scene.segments.index(f"thigh_{knee.side}"),
        "centres": [_numbers(centre) for centre in knee.centres],
        "radii": _numbers(knee.radii),
        "across": _numbers(knee.across),
    }


def left_out(scene: Scene, most_bytes: int = MOST_BYTES) -> tuple[str, ...]:
    """A sentence for every trial of which the page holds some frames only; empty where it holds all."""
    thin = _thinning(scene, most_bytes)
    strides = ((trial, trial.stride * thin) for trial in scene.trials)
    return tuple(
        f"{trial.name}: the page holds {-(-trial.recorded // stride)} of {trial.recorded} frames, one in {stride}; "
        "poses between are interpolated"
        for trial, stride in strides
        if stride > 1
    )


def _thinning(scene: Scene, most_bytes: int) -> int:
    """1, or which frames of every trial stay for all to have room: every second, third, ..."""
    bytes_a_frame = 14 * len(scene.segments) + 6 * len(scene.labels) + 64
    total = sum(len(trial.time) for trial in scene.trials) * bytes_a_frame
    return max(1, -(-total // most_bytes))


def _trial(trial: TrialScene, thin: int) -> dict[str, Any]:
    kept = slice(None, None, thin)
    pelvis = trial.origins[kept, :1]
    measured = trial.measured[kept] - pelvis
    measured[~(np.abs(measured) < FAR).all(axis=2)] = np.nan
    return {
        "name": trial.name,
        "role": trial.role,
        "recorded": trial.recorded,
        "stride": trial.stride * thin,
        "start": float(trial.time[0]),
        "time": floats(trial.time[kept] - trial.time[0]),
        "pelvis": floats(pelvis),
        "origins": lengths(trial.origins[kept] - pelvis),
        "turns": base64_of(np.rint(trial.turns[kept] * FULL).astype("<i2")),
        "tracked": [bool(t) for t in trial.tracked],
        "measured": lengths(measured),
        "forces": floats(trial.forces[kept]),
        "centres": floats(trial.pressure_centres[kept]),
        "hasForces": trial.has_forces,
        "validLegs": base64_of(trial.valid_legs[kept].astype("<u1")),
        "plates": floats(trial.plates),
    }


def _joint(scene: Scene, joint: JointMark) -> dict[str, Any]:
    return {
        "joint": joint.joint,
        "segment": scene.segments.index(joint.segment),
        "fitted": joint.fitted,
        "nominalCentre": _numbers(joint.nominal_centre),
        "fittedCentre": _numbers(joint.fitted_centre),
        "nominalAxis": _numbers(joint.nominal_axis),
        "fittedAxis": _numbers(joint.fitted_axis),
        "centreSpread": _numbers(joint.centre_spread),
        "axisSpread": _numbers(joint.axis_spread),
    }


def _fitted(scene: Scene, fitted: FittedMesh) -> dict[str, Any]:
    return {
        "mesh": fitted.mesh,
        "segment": scene.segments.index(fitted.segment),
        "place": [float(x) for x in fitted.place.ravel()],
    }


def _mesh(mesh: Mesh) -> dict[str, Any]:
    return {"vertices": lengths(mesh.vertices), "triangles": base64_of(mesh.triangles.astype("<u2"))}


def _numbers(values: Array) -> list[float] | None:
    """None where they do not exist."""
    return [float(x) for x in values.ravel()] if np.isfinite(values).all() else None
