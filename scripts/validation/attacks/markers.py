"""Attacks on single markers: which an attack means in any marker set, and which trials it spoils; labels exchanged or
missing; markers that sit elsewhere on their segment than the static trial says.

A key is a landmark (`knee_lat_r`), a segment (`thigh_r`: all its markers), one of a segment's (`thigh_r[0]`), or a
label. Displacements are along the body's axes: (forward, up, right) of the pelvis in the first whole frame, carried on
by the segment.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording, Study
from gaitcal.arrays import Array
from scripts.validation.attacks.attack import WALK, StudyChange, with_recording
from scripts.validation.truth.rigid import rigid_motion

Change: TypeAlias = Callable[[Recording, MarkerSet], Recording]
"""A recording spoilt; the marker set tells which label is what."""
Part: TypeAlias = tuple[float, float]
"""Start and end, as shares of the trial."""

WHOLE: Part = (0.0, 1.0)
MM = 1e-3
NEIGHBOUR = {"thigh": "pelvis", "shank": "foot", "foot": "shank", "pelvis": "thigh"}
"""Segment whose markers help to tell the turn of one that has fewer than three."""
SEED = 7


def labels_of(markers: MarkerSet, key: str) -> tuple[str, ...]:
    """The labels that a key stands for."""
    if key in markers.landmarks:
        return markers.landmarks[key]
    name, _, index = key.rstrip("]").partition("[")
    if name in markers.tracking:
        group = (*markers.tracking[name], *markers.static_only.get(name, ()))
        return (markers.tracking[name][int(index)],) if index else tuple(dict.fromkeys(group))
    return (key,)


def pattern(words: str, markers: MarkerSet) -> str:
    """The regular expression `words` with each `{key}` put as any of its labels."""

    def labels(found: re.Match[str]) -> str:
        return "(?:" + "|".join(re.escape(label) for label in labels_of(markers, found[1])) + ")"

    return re.sub(r"\{([^}]*)\}", labels, words)


def in_trial(name: str, *changes: Change) -> StudyChange:
    """The study with one recording spoilt."""

    def change(study: Study) -> Study:
        recording = next(trial.recording for trial in study.trials if trial.name == name)
        for spoil in changes:
            recording = spoil(recording, study.marker_set)
        return with_recording(study, name, recording)

    return change


def in_static(*changes: Change) -> StudyChange:
    """The study with its static trial spoilt."""
    return in_trial("static", *changes)


def in_walk(*changes: Change) -> StudyChange:
    """The study with its walk spoilt."""
    return in_trial(WALK, *changes)


def in_moving(*changes: Change) -> StudyChange:
    """The study with every trial but the static one spoilt."""

    def change(study: Study) -> Study:
        for trial in study.moving:
            study = in_trial(trial.name, *changes)(study)
        return study

    return change


def in_every(*changes: Change) -> StudyChange:
    """The study with every trial spoilt."""

    def change(study: Study) -> Study:
        for trial in study.trials:
            study = in_trial(trial.name, *changes)(study)
        return study

    return change


def columns(recording: Recording, markers: MarkerSet, key: str) -> list[int]:
    """Columns of the markers of a key that the recording has."""
    found = [recording.labels.index(label) for label in labels_of(markers, key) if label in recording.labels]
    if not found:
        raise KeyError(f"the recording has no marker for '{key}'")
    return found


def frames(recording: Recording, part: Part) -> slice:
    """The frames of a part of the trial."""
    count = len(recording.time)
    return slice(round(part[0] * count), round(part[1] * count))


def put(recording: Recording, at: Sequence[int], part: Part, values: Array) -> Recording:
    """The recording with other positions (nf, nm, 3) of some columns in a part of the trial."""
    markers = recording.markers.copy()
    where = frames(recording, part)
    markers[where, at] = values[where]
    return replace(recording, markers=markers)


def put_columns(recording: Recording, source: Sequence[int], target: Sequence[int], part: Part) -> Recording:
    """The recording with the columns `source` under the labels of `target` in a part of the trial."""
    markers = recording.markers.copy()
    where = frames(recording, part)
    markers[where, target] = recording.markers[where][:, source]
    return replace(recording, markers=markers)


def exchanged(a: str, b: str, part: Part = WHOLE) -> Change:
    """Two markers, or two segments' or landmarks' markers one by one, under each other's label."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        i, j = columns(recording, markers, a), columns(recording, markers, b)
        count = min(len(i), len(j))
        return put_columns(recording, [*j[:count], *i[:count]], [*i[:count], *j[:count]], part)

    return spoil


def sides_exchanged(*segments: str, part: Part = WHOLE) -> Change:
    """Left labels on the right and right ones on the left; of these segments (`thigh`, ...), or of all."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        names = segments or ("thigh", "shank", "foot", "upper_arm", "forearm_hand", "asis")
        pairs: dict[int, int] = {}
        for name in names:
            try:
                right, left = (columns(recording, markers, f"{name}_{side}") for side in "rl")
            except KeyError:
                continue
            pairs |= dict(zip(right, left, strict=False)) | dict(zip(left, right, strict=False))
        return put_columns(recording, list(pairs.values()), list(pairs), part)

    return spoil


def rotated_labels(segment: str, part: Part = WHOLE) -> Change:
    """Each marker of a segment under the label of the next."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = columns(recording, markers, segment)
        return put_columns(recording, [*at[1:], at[0]], at, part)

    return spoil


def removed(*keys: str) -> Change:
    """Markers that the file does not have."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        gone = {label for key in keys for label in labels_of(markers, key)}
        kept = [i for i, label in enumerate(recording.labels) if label not in gone]
        labels = tuple(recording.labels[i] for i in kept)
        return replace(recording, labels=labels, markers=recording.markers[:, kept])

    return spoil


def body_axes(recording: Recording, markers: MarkerSet, frame: int) -> Array:
    """(3, 3) columns forward, up, right of the pelvis in a frame, horizontal."""
    right, left = (recording.markers[frame, columns(recording, markers, f"asis_{side}")].mean(axis=0) for side in "rl")
    across = (right - left) * [1.0, 0.0, 1.0]
    across /= np.linalg.norm(across)
    up = np.array([0.0, 1.0, 0.0])
    return np.column_stack([np.cross(up, across), up, across])


def segment_frames(recording: Recording, markers: MarkerSet, segment: str) -> tuple[Array, Array]:
    """(nf, 3, 3) body axes carried along by a segment, and (nf, 3) the middle of its markers."""
    own = columns(recording, markers, segment)
    helped = own
    if len(own) < 3:
        name, _, side = segment.partition("_")
        other = NEIGHBOUR[name] if NEIGHBOUR[name] == "pelvis" else f"{NEIGHBOUR[name]}_{side}"
        helped = [*own, *columns(recording, markers, other)]
    asis = [*columns(recording, markers, "asis_r"), *columns(recording, markers, "asis_l")]
    whole = np.isfinite(recording.markers[:, helped]).all(axis=(1, 2))
    first = int(np.flatnonzero(whole & np.isfinite(recording.markers[:, asis]).all(axis=(1, 2)))[0])
    turns, _ = rigid_motion(recording.markers[first, helped], recording.markers[whole][:, helped])
    carried = turns @ body_axes(recording, markers, first)
    seen = np.flatnonzero(whole)
    nearest = np.abs(np.arange(len(whole))[:, None] - seen).argmin(axis=1)
    with np.errstate(all="ignore"):
        middle = recording.markers[seen][:, own].mean(axis=1)
    return carried[nearest], middle[nearest]


def transformed(segment: str, change: Callable[[Array], Array], only: str | None = None, part: Part = WHOLE) -> Change:
    """Markers of a segment moved within it: `change` of (nf, nm, 3) m along forward, up, right from their middle."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        axes, middle = segment_frames(recording, markers, segment)
        at = columns(recording, markers, only or segment)
        local = np.einsum("fji,fmj->fmi", axes, recording.markers[:, at] - middle[:, None])
        moved = np.einsum("fij,fmj->fmi", axes, change(local)) + middle[:, None]
        return put(recording, at, part, moved)

    return spoil


def displaced(segment: str, only: str, mm: tuple[float, float, float], part: Part = WHOLE) -> Change:
    """One marker (or landmark) of a segment elsewhere on it, by mm forward, up, right."""
    return transformed(segment, lambda local: local + MM * np.array(mm), only, part)


def slid(segment: str, mm: tuple[float, float, float], part: Part = WHOLE) -> Change:
    """All markers of a segment displaced together."""
    return transformed(segment, lambda local: local + MM * np.array(mm), None, part)


def turned(segment: str, degrees: float, axis: str = "y", part: Part = WHOLE) -> Change:
    """All markers of a segment turned together about their middle: x forward, y up, z right."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return transformed(segment, lambda local: local @ turn.T, None, part)


def mirrored_cluster(segment: str, part: Part = WHOLE) -> Change:
    """The markers of a segment as on the other side of its middle: a cluster of the other handedness."""
    return transformed(segment, lambda local: local * [1.0, 1.0, -1.0], None, part)
