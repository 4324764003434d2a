"""A scene as one `.npz` file, read back without pickle; not compressed, as coordinates hardly become fewer bytes.

The array `scene` holds a JSON text (UTF-8) with all names and single numbers; every other array has the name of its
field, `trial0/origins`, `joints/fitted_axis`, ...
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

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_file
from gaitcal.page.body_fit import MESHES, FittedMesh
from gaitcal.page.bones.person_landmarks import KneeEvidence, PersonLandmarks
from gaitcal.page.joint_marks import JointMark
from gaitcal.page.scene import Scene, TrialScene

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
