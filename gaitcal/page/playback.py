"""A scene as JSON for the page: names as text, numbers packed as base64 of small integers.

Segments and markers are told from the pelvis, as 16-bit integers on the range that they cover in their trial (0.03 mm
on two metres, however far the person walks), a gap as -32768; the pelvis itself in 32-bit floats; quaternions in
1/32767. Frames go where all trials together would be more than the page may hold.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.knee_and_ankle import SIDE_WORDS
from gaitcal.page.body_fit import FittedMesh
from gaitcal.page.body_meshes import BodyMeshes, Mesh
from gaitcal.page.bones.bone_files import EXTRA
from gaitcal.page.bones.knee_axis import KneeAxis, knee_axes
from gaitcal.page.bones.knee_words import evidence_words, knee_brief, knee_words
from gaitcal.page.bones.placement import Landmarked, fitted_bones
from gaitcal.page.joint_marks import JointMark
from gaitcal.page.packing import FULL, base64_of, floats, lengths
from gaitcal.page.scene import Scene, TrialScene

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
