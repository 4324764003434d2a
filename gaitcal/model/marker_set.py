"""Marker sets as data: which marker is which landmark, and which markers follow which segment.

A set is a TOML file, one of the built-in ones in `models/markersets/` or a user's own:

    description = "..."
    [landmarks]      name -> marker, or the list of markers whose mean it is
    [tracking]       segment -> markers fixed in it
    [static_only]    segment -> further markers of the static trial, tracked where a trial has them
    [weights]        marker -> { weight, reason } where the weight is not 1
    [aliases]        marker -> other spellings of its label in files

`{S}` in a name stands for R and L, `{s}` for r and l, so that one line serves both sides. `marker_set_text` writes a
set as such a file again, so that a result can keep the one it was made with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from gaitcal.errors import InputError, nearest
from gaitcal.files.package_data import models_path
from gaitcal.files.toml import toml_table, toml_value
from gaitcal.files.validation import Table, read_validated, require_known, shown
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS
from gaitcal.model.linkage import SIDES
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
_OF_TRUNK = ("c7", "t10", "jugular_notch", "xiphoid")
LANDMARKS: tuple[str, ...] = ("sacrum", *_OF_TRUNK, *(f"{name}_{side}" for side in SIDES for name in _SIDED))
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its centre. Those of the
trunk's midline tell where it faces where acromia are missing, `c7` and `jugular_notch` also where the shoulders are;
`t10` may be any spinous process from T6 to T12."""

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


NO_REASON = "weight of the study"
"""Stands as the reason of weights that a study gave without one."""


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


@dataclass(frozen=True, kw_only=True)
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

    @property
    def tracked(self) -> tuple[str, ...]:
        """The markers that follow a segment, also those worn in the static trial only."""
        groups = (*self.tracking.values(), *self.static_only.values())
        return tuple(label for group in groups for label in group)

    @property
    def segment_of(self) -> dict[str, str]:
        """Label -> the segment that it follows."""
        groups = (*self.tracking.items(), *self.static_only.items())
        return {label: segment for segment, labels in groups for label in labels}

    def weight(self, label: str) -> float:
        """Weight of a marker."""
        return self.weights.get(label, 1.0)

    def with_weights(self, weights: Mapping[str, float]) -> MarkerSet:
        """The same set with other weights for some markers."""
        return replace(self, weights={**self.weights, **weights}) if weights else self

    def renamed(self, recording: Recording) -> Recording:
        """The recording with the set's own spelling of every label; a note tells what was changed."""
        in_file = set(recording.labels)
        new_names = {
            other: label
            for label, others in self.aliases.items()
            if label not in in_file
            for other in others[::-1]
            if other in in_file
        }
        if not new_names:
            return recording
        changes = ", ".join(f"{old} -> {new}" for old, new in new_names.items())
        renamed = replace(recording, labels=tuple(new_names.get(label, label) for label in recording.labels))
        return renamed.with_notes(f"markers renamed: {changes}")


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
    file = read_validated(_File, path)
    landmarks = _both_sides(file.landmarks, path, "landmarks")
    tracking = _both_sides(file.tracking, path, "tracking")
    static_only = _both_sides(file.static_only, path, "static_only")
    require_known(landmarks, LANDMARKS, "landmark", source=path, field="landmarks", listed=True)
    for table, where in ((tracking, "tracking"), (static_only, "static_only")):
        require_known(table, MASSIVE_SEGMENTS, "segment", source=path, field=where, listed=True)
    _check_required(landmarks, path)
    _check_once((*tracking.items(), *static_only.items()), path)
    weights: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for pattern, entry in file.weights.items():
        for label in _sides(pattern):
            weights[label], reasons[label] = entry.weight, entry.reason
    marker_set = MarkerSet(
        name=name,
        description=file.description,
        landmarks=landmarks,
        tracking=tracking,
        static_only=static_only,
        weights=weights,
        reasons=reasons,
        aliases=_both_sides(file.aliases, path, "aliases"),
    )
    require_known(weights, marker_set.tracked, "tracked marker", source=path, field="weights")
    require_known(marker_set.aliases, marker_set.labels, "marker", source=path, field="aliases")
    return marker_set


def _sides(pattern: str) -> tuple[str, ...]:
    """A name with `{S}` or `{s}` as those of the right and the left side; any other as itself."""
    both = tuple(pattern.replace("{S}", side.upper()).replace("{s}", side) for side in SIDES)
    return tuple(dict.fromkeys(both))


def _both_sides(table: Mapping[str, list[str]], path: Path, where: str) -> dict[str, tuple[str, ...]]:
    """A table with both sides written out: a sided name takes the labels of its side, any other those of both."""
    out: dict[str, tuple[str, ...]] = {}
    for pattern, labels in table.items():
        names = _sides(pattern)
        for i, name in enumerate(names):
            if name in out:
                raise InputError(f"'{name}' is given twice", source=path, field=where)
            # a label without a side stands once in `_sides`, and serves either side
            each = [_sides(label) if len(names) == 1 else (_sides(label) * 2)[i : i + 1] for label in labels]
            out[name] = tuple(dict.fromkeys(label for both in each for label in both))
    return out


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
    weights = {
        label: {"weight": float(weight), "reason": marker_set.reasons.get(label, NO_REASON)}
        for label, weight in marker_set.weights.items()
        if label in marker_set.tracked
    }
    return "\n".join([*tables, toml_table("[weights]", _quoted(weights))])


def _quoted(table: Mapping[str, object]) -> dict[str, object]:
    return {toml_value(name): list(v) if isinstance(v, tuple) else v for name, v in table.items()}
