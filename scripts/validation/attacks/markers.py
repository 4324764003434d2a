"""Which markers an attack means, in any marker set, and which trials it spoils.

A key is a landmark (`knee_lat_r`), a segment (`thigh_r`: all its markers), one of a segment's (`thigh_r[0]`), or a
label.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

from gaitcal import MarkerSet, Recording, Study
from gaitcal.arrays import Array
from scripts.validation.attacks.attack import StudyChange
from scripts.validation.attacks.bases import WALK, with_recording

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
