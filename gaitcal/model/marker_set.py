"""Marker sets as data: which marker is which landmark, and which markers follow which segment.

A set is a TOML file, one of the built-in ones in `models/markersets/` or a user's own:

    description = "..."
    [landmarks]      name -> marker, or the list of markers whose mean it is
    [tracking]       segment -> markers fixed in it
    [static_only]    segment -> further markers of the static trial, tracked where a trial has them
    [weights]        marker -> { weight, reason } where the weight is not 1
    [aliases]        marker -> other spellings of its label in files

`{S}` in a name stands for R and L, `{s}` for r and l, so that one line serves both sides.

A marker set as the text of a marker set file, so that a result can keep the one it was made with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, ValidationError

from gaitcal.errors import InputError, nearest
from gaitcal.files.package_data import models_path
from gaitcal.files.toml import read_toml, toml_table, toml_value
from gaitcal.files.validation import Table, input_error, shown
from gaitcal.model.linkage import SEGMENTS, SIDES
from gaitcal.recording import Recording

_SIDED = (
    "asis",
    "knee_lat",
    "knee_med",
    "ankle_lat",
    "ankle_med",
    "heel",
    "toe",
    "acromion",
    "elbow_lat",
    "elbow_med",
    "wrist",
)
LANDMARKS: tuple[str, ...] = ("sacrum", *(f"{name}_{side}" for side in SIDES for name in _SIDED))
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its centre."""

_INSTEAD = {
    "asis": "a marker on the anterior superior iliac spine",
    "sacrum": "a marker midway between the posterior superior iliac spines, or the list of the two on them",
    "knee_lat": "a marker on the lateral femoral epicondyle",
    "ankle_lat": "a marker on the lateral malleolus",
    "heel": "a marker on the back of the heel",
    "toe": "a marker on the tip of the foot or over the head of the second metatarsal",
}
REQUIRED: tuple[str, ...] = tuple(
    name for name in LANDMARKS if name == "sacrum" or name.rsplit("_", 1)[0] in set(_INSTEAD)
)
"""Landmarks without which there is no model; all others have a default or freeze their segment."""


def instead_of(landmark: str) -> str:
    """What serves as a required landmark, for an error message."""
    return _INSTEAD.get(landmark) or _INSTEAD[landmark.rsplit("_", 1)[0]]


def _as_list(value: object) -> object:
    return [value] if isinstance(value, str) else value


_Labels = Annotated[list[str], BeforeValidator(_as_list), Field(min_length=1)]


class _Weight(Table):
    weight: float = Field(ge=0, description="how strongly the marker pulls, 0 or more; 0 only reports it")
    reason: str = Field(min_length=1, description="why the weight is not 1")


class _File(Table):
    description: str = Field(description="one line that tells the set")
    landmarks: dict[str, _Labels] = Field(description="a table, landmark = marker or list of markers")
    tracking: dict[str, _Labels] = Field(description="a table, segment = list of markers")
    static_only: dict[str, _Labels] = Field(default={}, description="a table, segment = list of markers")
    weights: dict[str, _Weight] = Field(default={}, description="a table, marker = { weight = ..., reason = ... }")
    aliases: dict[str, _Labels] = Field(default={}, description="a table, marker = list of other spellings")


@dataclass(frozen=True)
class MarkerSet:
    """What the markers of a laboratory's protocol mean."""

    name: str
    """Of a built-in set, or the file of one's own without its ending."""
    description: str
    """One line."""
    landmarks: Mapping[str, tuple[str, ...]]
    """Landmark -> the markers whose mean it is."""
    tracking: Mapping[str, tuple[str, ...]]
    """Segment -> markers fixed in it."""
    static_only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> further markers that are normally worn in the static trial only."""
    weights: Mapping[str, float] = field(default_factory=dict)
    """Marker -> weight, where it is not 1."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Marker -> why its weight is not 1."""
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Marker -> other spellings of its label."""

    @property
    def labels(self) -> tuple[str, ...]:
        """All markers of the set, each once."""
        groups = (*self.tracking.values(), *self.static_only.values(), *self.landmarks.values())
        return tuple(dict.fromkeys(label for group in groups for label in group))

    def weight(self, label: str) -> float:
        """Weight of a marker."""
        return self.weights.get(label, 1.0)

    def with_weights(self, weights: Mapping[str, float]) -> MarkerSet:
        """The same set with other weights for some markers."""
        return replace(self, weights={**self.weights, **weights}) if weights else self

    def renamed(self, recording: Recording) -> Recording:
        """The recording with the set's own spelling of every label; a note tells what was changed."""
        found = set(recording.labels)
        change = {
            other: label
            for label, others in self.aliases.items()
            if label not in found
            for other in others[::-1]
            if other in found
        }
        if not change:
            return recording
        told = ", ".join(f"{old} -> {new}" for old, new in change.items())
        renamed = replace(recording, labels=tuple(change.get(label, label) for label in recording.labels))
        return renamed.with_notes(f"markers renamed: {told}")


def built_in_sets() -> tuple[str, ...]:
    """Names of the marker sets that come with the package."""
    return tuple(sorted(path.stem for path in (models_path() / "markersets").glob("*.toml")))


def load_marker_set(name_or_path: str | Path) -> MarkerSet:
    """A built-in marker set by its name, or a user's own by the path of its TOML file.

    Raises
    ------
    InputError
        Names the file, the entry, what was found and what is allowed.
    """
    text = str(name_or_path)
    known = built_in_sets()
    if text in known:
        return _read(models_path() / "markersets" / f"{text}.toml", text)
    if not isinstance(name_or_path, Path) and not text.lower().endswith(".toml") and "/" not in text:
        raise InputError(
            f"found {shown(text)}; allowed: {', '.join(known)}, or the path of a TOML file{nearest(text, known)}",
            field="marker set",
        )
    return _read(Path(text), Path(text).stem)


def _read(path: Path, name: str) -> MarkerSet:
    content = read_toml(path)
    try:
        file = _File.model_validate(content)
    except ValidationError as error:
        raise input_error(error, _File, path) from None
    landmarks = _both_sides(file.landmarks, path, "landmarks")
    tracking = _both_sides(file.tracking, path, "tracking")
    static_only = _both_sides(file.static_only, path, "static_only")
    _check_names(landmarks, LANDMARKS, "landmark", path, "landmarks")
    massive = [s for s in SEGMENTS if not s.startswith("talus")]
    for table, where in ((tracking, "tracking"), (static_only, "static_only")):
        _check_names(table, massive, "segment", path, where)
    _check_required(landmarks, path)
    _check_once((*tracking.items(), *static_only.items()), path)
    weights: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for pattern, entry in file.weights.items():
        for label in _sides(pattern):
            weights[label], reasons[label] = entry.weight, entry.reason
    made = MarkerSet(
        name,
        file.description,
        landmarks,
        tracking,
        static_only,
        weights,
        reasons,
        _both_sides(file.aliases, path, "aliases"),
    )
    tracked = [label for group in (*tracking.values(), *static_only.values()) for label in group]
    _check_names(weights, tracked, "tracked marker", path, "weights")
    _check_names(made.aliases, made.labels, "marker", path, "aliases")
    return made


def _sides(pattern: str) -> tuple[str, ...]:
    both = tuple(pattern.replace("{S}", side.upper()).replace("{s}", side) for side in SIDES)
    return tuple(dict.fromkeys(both))


def _both_sides(table: Mapping[str, list[str]], path: Path, where: str) -> dict[str, tuple[str, ...]]:
    out: dict[str, tuple[str, ...]] = {}
    for pattern, labels in table.items():
        for i, name in enumerate(_sides(pattern)):
            if name in out:
                raise InputError(f"'{name}' is given twice", source=path, field=where)
            expanded = [_sides(label) for label in labels]
            sided = len(_sides(pattern)) > 1
            out[name] = tuple(
                dict.fromkeys(label for both in expanded for label in ((both * 2)[i : i + 1] if sided else both))
            )
    return out


def _check_names(found: Iterable[str], allowed: Iterable[str], kind: str, path: Path, where: str) -> None:
    known = list(allowed)
    for name in found:
        if name not in known:
            close = nearest(name, known)
            listed = f"; allowed: {', '.join(known)}" if kind in ("segment", "landmark") and not close else ""
            raise InputError(f"found {shown(name)}, which is no {kind}{close}{listed}", source=path, field=where)


def _check_required(landmarks: Mapping[str, tuple[str, ...]], path: Path) -> None:
    for name in REQUIRED:
        if name not in landmarks:
            raise InputError(f"'{name}' is missing: give {instead_of(name)}", source=path, field="landmarks")


def _check_once(groups: Iterable[tuple[str, tuple[str, ...]]], path: Path) -> None:
    segment_of: dict[str, str] = {}
    for segment, labels in groups:
        for label in labels:
            if label in segment_of:
                raise InputError(
                    f"marker '{label}' is on {segment_of[label]} and on {segment}; a marker is fixed in one segment",
                    source=path,
                    field="tracking",
                )
            segment_of[label] = segment


STUDY_S = "weight of the study"
"""Reason of weights that a study gave without one."""


def marker_set_text(marker_set: MarkerSet) -> str:
    """TOML that `load_marker_set` reads back to the same set, both sides written out.

    Weights of markers that no segment follows are left out: they pull nothing.
    """
    tables = [toml_table("", {"description": marker_set.description}).lstrip()]
    groups = {
        "landmarks": marker_set.landmarks,
        "tracking": marker_set.tracking,
        "static_only": marker_set.static_only,
        "aliases": marker_set.aliases,
    }
    tables += [toml_table(f"[{name}]", _quoted(group)) for name, group in groups.items()]
    tracked = {m for group in (marker_set.tracking, marker_set.static_only) for own in group.values() for m in own}
    weights = {
        label: {"weight": float(weight), "reason": marker_set.reasons.get(label, STUDY_S)}
        for label, weight in marker_set.weights.items()
        if label in tracked
    }
    return "\n".join([*tables, toml_table("[weights]", _quoted(weights))])


def _quoted(table: Mapping[str, object]) -> dict[str, object]:
    return {toml_value(name): list(v) if isinstance(v, tuple) else v for name, v in table.items()}
