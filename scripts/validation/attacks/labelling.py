"""Markers under each other's label, and markers that are not there."""

from __future__ import annotations

from dataclasses import replace

from gaitcal import MarkerSet, Recording
from scripts.validation.attacks.markers import WHOLE, Change, Part, columns, labels_of, put_columns


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
