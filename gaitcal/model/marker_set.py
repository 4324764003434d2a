"""Marker sets as data: which marker is which landmark, and which markers follow which segment.

A set is a TOML file, one of the built-in ones in `models/markersets/` or a user's own:

    description = "..."
    extends = "..."  a built-in set, whose entries hold where the file says nothing of that name
    [landmarks]      name -> marker, or the list of markers whose mean it is, or the first of several of these that a
                     person wears: { first_of = [["RPSI", "LPSI"], "SACR"] }
    [tracking]       segment -> markers fixed in it
    [static_only]    segment -> further markers of the static trial, tracked where a trial has them
    [optional]       segment -> further markers that some wear, tracked where there are
    [knee_device]    lateral knee marker -> the three markers of the device that stands in for it in the static trial
    [weights]        marker -> { weight, reason } where the weight is not 1
    [aliases]        marker -> other spellings of its label in files

`{S}` in a name stands for R and L, `{s}` for r and l, so that one line serves both sides. `marker_set_text` writes a
set as such a file again, so that a result can keep the one it was made with.

What each marker of a laboratory's protocol is for: a landmark, a segment that it follows, a weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.recording import Recording
from gaitcal.io.toml import Table, models_path, read_validated, require_known, shown, toml_table, toml_value
from gaitcal.model.landmark_names import LANDMARKS, REQUIRED, instead_of, missing_landmarks
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_coverage import Coverage, coverage_of
from gaitcal.model.parameters import MASSIVE_SEGMENTS


@dataclass(frozen=True, kw_only=True)
class MarkerSet:
    """What the markers of a laboratory's protocol mean.

    A set may leave open what a person wears: landmarks with alternatives, markers that some wear and others do not, a
    device at the knee. `model/present_markers.py` makes of it the set of one static trial, in which nothing is open.
    """

    name: str
    """Of a built-in set, or the file of one's own without its ending."""
    description: str
    """One line."""
    landmarks: Mapping[str, tuple[str, ...]]
    """Landmark -> the markers whose mean it is; where there are alternatives, the preferred ones."""
    tracking: Mapping[str, tuple[str, ...]]
    """Segment -> markers fixed in it."""
    static_only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> further markers that are normally worn in the static trial only."""
    optional: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> further markers that some wear; tracked where there are, and missed by nobody."""
    alternatives: Mapping[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    """Landmark -> what serves instead of `landmarks`, in order of preference."""
    knee_device: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Lateral knee marker -> the three markers of a knee alignment device that stands in for it in the static trial,
    the one on the flexion axis first."""
    weights: Mapping[str, float] = field(default_factory=dict)
    """Marker -> weight, where it is not 1."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Marker -> why its weight is not 1."""
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Marker -> other spellings of its label."""
    devices: tuple[str, ...] = field(default=(), compare=False)
    """Markers of knee alignment devices that the set knows, and whose part in the static trial is done."""
    notes: tuple[str, ...] = ()
    """What was chosen among alternatives, one sentence each; empty in a set as its file has it."""

    @property
    def labels(self) -> tuple[str, ...]:
        """All markers of the set, each once."""
        groups = (
            *self.tracking.values(),
            *self.static_only.values(),
            *self.optional.values(),
            *self.landmarks.values(),
            *(option for options in self.alternatives.values() for option in options),
            *self.knee_device.values(),
        )
        return tuple(dict.fromkeys(label for group in groups for label in group))

    @property
    def tracked(self) -> tuple[str, ...]:
        """The markers that follow a segment, also those that are not always worn."""
        groups = (*self.tracking.values(), *self.static_only.values(), *self.optional.values())
        return tuple(label for group in groups for label in group)

    @property
    def segment_of(self) -> dict[str, str]:
        """Label -> the segment that it follows."""
        groups = (*self.tracking.items(), *self.static_only.items(), *self.optional.items())
        return {label: segment for segment, labels in groups for label in labels}

    def options(self, landmark: str) -> tuple[tuple[str, ...], ...]:
        """All that serves as a landmark, in order of preference; each is the markers whose mean it is."""
        return (self.landmarks[landmark], *self.alternatives.get(landmark, ()))

    def weight(self, label: str) -> float:
        """Weight of a marker."""
        return self.weights.get(label, 1.0)

    def with_weights(self, weights: Mapping[str, float]) -> MarkerSet:
        """The same set with other weights for some markers."""
        return replace(self, weights={**self.weights, **weights}) if weights else self

    def coverage(self, labels: Iterable[str], computed: Iterable[str] = ()) -> Coverage:
        """What a file with these marker labels, and these labels of computed points, gives of the set."""
        return coverage_of(self, self._spelt(labels), computed)

    def renamed(self, recording: Recording) -> Recording:
        """The recording with the set's own spelling of every label; a note tells what was changed."""
        spelt = self._spelt(recording.labels)
        if spelt == recording.labels:
            return recording
        pairs = zip(recording.labels, spelt, strict=True)
        changes = ", ".join(f"{old} -> {new}" for old, new in pairs if old != new)
        return replace(recording, labels=spelt).with_notes(f"markers renamed: {changes}")

    def _spelt(self, labels: Iterable[str]) -> tuple[str, ...]:
        """Labels as the set spells them: by its aliases, and where only the case differs and one label is meant."""
        given, of_all = tuple(labels), self.labels
        in_file, known = set(given), set(of_all)
        new_names: dict[str, str] = {}
        for label, others in self.aliases.items():
            there = [other for other in others if other in in_file]
            if there and label not in in_file:
                new_names[there[0]] = label
        taken = in_file | set(new_names.values())
        strangers = _by_letters(label for label in given if label not in known and label not in new_names)
        in_set = _by_letters(of_all)
        for label in of_all:
            same_in_file = strangers.get(label.casefold(), [])
            if label not in taken and len(same_in_file) == len(in_set[label.casefold()]) == 1:
                new_names[same_in_file[0]] = label
        return tuple(new_names.get(label, label) for label in given)


def _by_letters(labels: Iterable[str]) -> dict[str, list[str]]:
    """Labels by what they are without regard to case."""
    out: dict[str, list[str]] = {}
    for label in labels:
        out.setdefault(label.casefold(), []).append(label)
    return out


__all__ = [
    "LANDMARKS",
    "NO_REASON",
    "REQUIRED",
    "MarkerSet",
    "built_in_sets",
    "instead_of",
    "load_marker_set",
    "marker_set_text",
]

DEVICE_MARKERS = 3
"""Of a knee alignment device."""
NO_REASON = "weight of the study"
"""Stands as the reason of weights that a study gave without one."""


def _as_list(value: object) -> object:
    return [value] if isinstance(value, str) else value


_Labels = Annotated[list[str], BeforeValidator(_as_list), Field(min_length=1)]


class _FirstOf(Table):
    first_of: list[_Labels] = Field(min_length=1, description="a list of markers, or of lists of them")


def _as_options(value: object) -> object:
    if not isinstance(value, dict | list | str):
        raise ValueError(f"found {shown(value)}; allowed: a list, [a, b], a marker, or {{ first_of = [...] }}")
    return value if isinstance(value, dict) else {"first_of": [value]}


_Options = Annotated[_FirstOf, BeforeValidator(_as_options)]


class _Weight(Table):
    weight: float = Field(ge=0, description="how strongly the marker pulls, 0 or more; 0 only reports it")
    reason: str = Field(min_length=1, description="why the weight is not 1")


class _File(Table):
    description: str = Field(description="one line that tells the set")
    extends: str | None = Field(default=None, description="the name of a built-in marker set")
    landmarks: dict[str, _Options] = Field(default={}, description="a table, landmark = marker or list of markers")
    tracking: dict[str, _Labels] = Field(default={}, description="a table, segment = list of markers")
    static_only: dict[str, _Labels] = Field(default={}, description="a table, segment = list of markers")
    optional: dict[str, _Labels] = Field(default={}, description="a table, segment = list of markers")
    knee_device: dict[str, _Labels] = Field(default={}, description="a table, marker = list of three markers")
    weights: dict[str, _Weight] = Field(default={}, description="a table, marker = { weight = ..., reason = ... }")
    aliases: dict[str, _Labels] = Field(default={}, description="a table, marker = list of other spellings")


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
            code=Code.MARKER_SET,
        )
    return _read(Path(text), Path(text).stem)


def _read(path: Path, name: str) -> MarkerSet:
    file = read_validated(_File, path)
    base = _base(file, path)
    options = _landmark_options(file.landmarks, path)
    preferred = {name: given[0] for name, given in options.items()}
    others = {name: given[1:] for name, given in options.items() if len(given) > 1}
    groups = {
        where: _both_sides(table, path, where)
        for where, table in (
            ("tracking", file.tracking),
            ("static_only", file.static_only),
            ("optional", file.optional),
            ("knee_device", file.knee_device),
            ("aliases", file.aliases),
        )
    }
    require_known(preferred, LANDMARKS, "landmark", source=path, field="landmarks", listed=True)
    for where in ("tracking", "static_only", "optional"):
        require_known(groups[where], MASSIVE_SEGMENTS, "segment", source=path, field=where, listed=True)
    _check_device(groups["knee_device"], path)
    weights: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for pattern, entry in file.weights.items():
        for label in _sides(pattern):
            weights[label], reasons[label] = entry.weight, entry.reason
    own = MarkerSet(
        name=name,
        description=file.description,
        landmarks={**base.landmarks, **preferred},
        alternatives={n: o for n, o in base.alternatives.items() if n not in preferred} | others,
        tracking={**base.tracking, **groups["tracking"]},
        static_only={**base.static_only, **groups["static_only"]},
        optional={**base.optional, **groups["optional"]},
        knee_device={**base.knee_device, **groups["knee_device"]},
        weights=weights,
        reasons=reasons,
        aliases=groups["aliases"],
    )
    _check_required(own.landmarks, path)
    _check_once((*own.tracking.items(), *own.static_only.items(), *own.optional.items()), path)
    require_known(weights, own.tracked, "tracked marker", source=path, field="weights")
    require_known(own.aliases, own.labels, "marker", source=path, field="aliases")
    known, tracked = set(own.labels), set(own.tracked)
    return replace(
        own,
        weights={label: w for label, w in base.weights.items() if label in tracked} | weights,
        reasons={label: why for label, why in base.reasons.items() if label in tracked} | reasons,
        aliases={label: names for label, names in base.aliases.items() if label in known} | dict(own.aliases),
    )


_NOTHING = MarkerSet(name="", description="", landmarks={}, tracking={})


def _base(file: _File, path: Path) -> MarkerSet:
    """The set that the file extends; an empty one where it extends none, and then it must say all by itself."""
    if file.extends is None:
        for where, table in (("landmarks", file.landmarks), ("tracking", file.tracking)):
            if not table:
                raise InputError("missing: a table", source=path, field=where, code=Code.MARKER_SET)
        return _NOTHING
    known = built_in_sets()
    require_known([file.extends], known, "built-in marker set", source=path, field="extends", listed=True)
    if path == models_path() / "markersets" / f"{file.extends}.toml":
        raise InputError(
            "found the set itself; allowed: another built-in set", source=path, field="extends", code=Code.MARKER_SET
        )
    return load_marker_set(file.extends)


def _landmark_options(table: Mapping[str, _FirstOf], path: Path) -> dict[str, tuple[tuple[str, ...], ...]]:
    """Landmark -> what serves as it, in order of preference, both sides written out."""
    out: dict[str, list[tuple[str, ...]]] = {}
    for pattern, entry in table.items():
        names = _sides(pattern)
        for name in names:
            if name in out:
                raise InputError(f"'{name}' is given twice", source=path, field="landmarks", code=Code.MARKER_SET)
            out[name] = []
        for labels in entry.first_of:
            for name, group in _both_sides({pattern: labels}, path, "landmarks").items():
                out[name].append(group)
    return {name: tuple(groups) for name, groups in out.items()}


def _check_device(devices: Mapping[str, tuple[str, ...]], path: Path) -> None:
    for label, parts in devices.items():
        if len(parts) != DEVICE_MARKERS:
            raise InputError(
                f"found {len(parts)} markers for '{label}'; allowed: three, the one on the flexion axis first",
                source=path,
                field="knee_device",
                code=Code.MARKER_SET,
            )


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
                raise InputError(f"'{name}' is given twice", source=path, field=where, code=Code.MARKER_SET)
            # a label without a side stands once in `_sides`, and serves either side
            each = [_sides(label) if len(names) == 1 else (_sides(label) * 2)[i : i + 1] for label in labels]
            out[name] = tuple(dict.fromkeys(label for both in each for label in both))
    return out


def _check_required(landmarks: Mapping[str, tuple[str, ...]], path: Path) -> None:
    for name in missing_landmarks(landmarks):
        raise InputError(
            f"'{name}' is missing: give {instead_of(name)}", source=path, field="landmarks", code=Code.MARKER_SET
        )


def _check_once(groups: Iterable[tuple[str, tuple[str, ...]]], path: Path) -> None:
    segment_of: dict[str, str] = {}
    for segment, labels in groups:
        for label in labels:
            if label in segment_of:
                raise InputError(
                    f"marker '{label}' is on {segment_of[label]} and on {segment}; a marker is fixed in one segment",
                    source=path,
                    field="tracking",
                    code=Code.MARKER_SET,
                )
            segment_of[label] = segment


def marker_set_text(marker_set: MarkerSet) -> str:
    """TOML that `load_marker_set` reads back to the same set, both sides written out.

    Weights of markers that no segment follows are left out: they pull nothing.
    """
    tables = [toml_table("", {"description": marker_set.description}).lstrip()]
    groups = {
        "tracking": marker_set.tracking,
        "static_only": marker_set.static_only,
        "optional": marker_set.optional,
        "knee_device": marker_set.knee_device,
        "aliases": marker_set.aliases,
    }
    tables.append(toml_table("[landmarks]", {toml_value(n): _landmark(marker_set, n) for n in marker_set.landmarks}))
    always = ("tracking", "static_only", "aliases")
    tables += [toml_table(f"[{name}]", _quoted(group)) for name, group in groups.items() if group or name in always]
    weights = {
        label: {"weight": float(weight), "reason": marker_set.reasons.get(label, NO_REASON)}
        for label, weight in marker_set.weights.items()
        if label in marker_set.tracked
    }
    return "\n".join([*tables, toml_table("[weights]", _quoted(weights))])


def _landmark(marker_set: MarkerSet, name: str) -> object:
    """What serves as a landmark, as the file writes it."""
    options = [list(group) for group in marker_set.options(name)]
    return options[0] if len(options) == 1 else {"first_of": options}


def _quoted(table: Mapping[str, object]) -> dict[str, object]:
    return {toml_value(name): list(v) if isinstance(v, tuple) else v for name, v in table.items()}
