"""Marker sets: landmarks, segment and weight of each marker of a laboratory's protocol.

A set is a TOML file, one of the built-in ones in `models/markersets/` or a user's:

    description = "..."
    extends = "..."  a built-in set, whose entries are used if the file does not have them
    [landmarks]      name -> marker, or the list of markers whose mean it is, or the first of
                     several of these that a person wears: { first_of = [["RPSI", "LPSI"], "SACR"] }
    [tracking]       segment -> markers fixed in it
    [static_only]    segment -> further markers of the static trial, tracked where a trial has them
    [optional]       segment -> further markers that some wear, tracked where there are
    [knee_device]    lateral knee marker -> the three markers of the device that stands in for it in
                     the static trial
    [weights]        marker -> { weight, reason } where the weight is not 1
    [aliases]        marker -> other spellings of its label in files
    [noise]          errors of points that are no markers on skin (`subject_model.PointNoise`)

`{S}` in a name stands for R and L, `{s}` for r and l, so that one line serves both sides.
`format_marker_set` writes a set as such a file again, so that a result can keep its marker set.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from gaitcal.display import Displayed, shorten
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.io.recording import Recording
from gaitcal.io.toml import (
    Table,
    find_models_folder,
    format_toml_table,
    format_toml_value,
    format_value,
    read_validated,
    require_known,
)
from gaitcal.model.linkage import LEG_SEGMENTS, MARKED_SEGMENTS, SIDES, add_side
from gaitcal.model.subject_model import PointNoise

_LANDMARKS_OF = (
    ("pelvis", "asis"),
    ("thigh", "knee_lat knee_med knee_axis"),
    ("shank", "ankle_lat ankle_med"),
    ("foot", "heel toe"),
    ("head_trunk", "acromion"),
    ("upper_arm", "elbow_lat elbow_med"),
    ("forearm_hand", "wrist"),
    ("pelvis", "hjc"),
)
_SIDED = [(segment, name) for segment, names in _LANDMARKS_OF for name in names.split()]
SEGMENT_OF: dict[str, str] = {
    "sacrum": "pelvis",
    **dict.fromkeys(("c7", "t10", "jugular_notch", "xiphoid"), "head_trunk"),
    **{f"{name}_{side}": add_side(segment, side) for side in SIDES for segment, name in _SIDED},
}
"""Landmark -> the segment that it lies in."""
LANDMARKS: tuple[str, ...] = tuple(SEGMENT_OF)
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its
centre; `knee_axis` is a point on the knee's flexion axis outwards of the lateral epicondyle, as a
knee alignment device shows it; `hjc` the centre of a hip, for `hip_centre = "given"`. Those of the
trunk's midline define its direction if acromia are missing, `c7` and `jugular_notch` also where
the shoulders are; `t10` may be any spinous process from T6 to T12."""
_SUBSTITUTES = {
    "asis": "a marker on the anterior superior iliac spine",
    "sacrum": "a marker midway between the posterior superior iliac spines, or the list of the two "
    "on them",
    "knee_lat": "a marker on the lateral femoral epicondyle",
    "ankle_lat": "a marker on the lateral malleolus",
    "heel": "a marker on the back of the heel",
    "toe": "a marker on the tip of the foot or over the head of the second metatarsal",
}
REQUIRED: tuple[str, ...] = tuple(
    name for name in LANDMARKS if name == "sacrum" or name[:-2] in _SUBSTITUTES
)
"""Landmarks without which there is no model; all others have a default or freeze their segment."""
PARTNER: dict[str, str] = {
    f"{one}_{side}": f"{other}_{side}"
    for side in SIDES
    for one, other in (("heel", "toe"), ("toe", "heel"))
}
"""Landmark of a foot -> the one from which it is guessed where no marker shows it."""
# markers of the pelvis, from which the pose of the body starts
PELVIS_NEEDS = 3
DEVICE_MARKERS = 3  # of a knee alignment device
NO_REASON = "weight of the study"  # stands as the reason of weights that a study gave without one
_GIRDLE = "the moving shoulder girdle, which the model lacks, carries the arm"
_FURTHER_WEIGHTS = {
    "head": (0.05, "the back's three turns about one point are only a rough model of the spine"),
    "upper_arm": (0.02, _GIRDLE),
    "forearm_hand": (0.02, _GIRDLE),
}
"""Segment without its last word -> weight of further markers on it, and why it is not 1; as in the
built-in sets.
"""
_FOLLOWER_TABLES = ("tracking", "static_only", "optional")  # tables segment -> markers


def _find_missing_landmarks(given: Iterable[str]) -> tuple[str, ...]:
    """Find required landmarks that are not given; of a foot, heel or toe is enough."""
    there = set(given)
    return tuple(name for name in REQUIRED if name not in there and PARTNER.get(name) not in there)


def describe_substitute(landmark: str) -> str:
    """Describe what may serve as a required landmark, for an error message."""
    return _SUBSTITUTES.get(landmark) or _SUBSTITUTES[landmark[:-2]]


@dataclass(frozen=True, kw_only=True, repr=False)
class MarkerSet(Displayed):
    """Meaning of the markers of a laboratory's protocol.

    A set may have alternatives: landmarks with several options, markers that only some people wear,
    a device at the knee. `model/present_markers.py` makes the set of one static trial from it,
    without alternatives.
    """

    name: str
    """Name of a built-in set, or of a user's file without its ending."""
    description: str
    """One line."""
    landmarks: Mapping[str, tuple[str, ...]]
    """Landmark -> the markers whose mean it is; where there are alternatives, the preferred ones.
    """
    tracking: Mapping[str, tuple[str, ...]]
    """Segment -> markers fixed in it."""
    static_only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> further markers that are normally worn in the static trial only."""
    optional: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> further markers that some people wear; tracked if present, never missing."""
    alternatives: Mapping[str, tuple[tuple[str, ...], ...]] = field(default_factory=dict)
    """Landmark -> what serves instead of `landmarks`, in order of preference."""
    knee_device: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Lateral knee marker -> the three markers of a knee alignment device that stands in for it in
    the static trial, the one on the flexion axis first."""
    weights: Mapping[str, float] = field(default_factory=dict)
    """Marker -> weight, where it is not 1."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Marker -> why its weight is not 1."""
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Marker -> other spellings of its label."""
    noise: PointNoise | None = None
    """Of points that are no markers; None of markers, which skin moves."""
    devices: tuple[str, ...] = field(default=(), compare=False)
    """Markers of knee alignment devices that the set knows, and whose part in the static trial is
    done.
    """
    notes: tuple[str, ...] = ()
    """What was chosen among alternatives, one sentence each; empty in a set as its file has it."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        followed = [f"{segment} {len(labels)}" for segment, labels in self.tracking.items()]
        rows = [
            ("description", self.description),
            ("landmarks", f"{len(self.landmarks)}, of {len(self.labels)} markers"),
            ("tracked markers", shorten(followed, 7)),
        ]
        if self.weights:
            rows.append(("weights not 1", shorten(list(self.weights))))
        return f"Marker set {self.name}", rows

    @property
    def labels(self) -> tuple[str, ...]:
        """All markers of the set, each once."""
        options = (option for options in self.alternatives.values() for option in options)
        groups = (self.tracked, *self.landmarks.values(), *options, *self.knee_device.values())
        return tuple(dict.fromkeys(label for group in groups for label in group))

    @property
    def following(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Segments and the markers that follow them, also those that are not always worn."""
        return (*self.tracking.items(), *self.static_only.items(), *self.optional.items())

    @property
    def tracked(self) -> tuple[str, ...]:
        """The markers that follow a segment, also those that are not always worn."""
        return tuple(label for _, labels in self.following for label in labels)

    @property
    def segment_of(self) -> dict[str, str]:
        """Label -> the segment that it follows."""
        return {label: segment for segment, labels in self.following for label in labels}

    def options(self, landmark: str) -> tuple[tuple[str, ...], ...]:
        """List the options of a landmark by preference; each is the markers whose mean it is."""
        return (self.landmarks[landmark], *self.alternatives.get(landmark, ()))

    def weight(self, label: str) -> float:
        """Return the weight of a marker; 1 if the set gives none."""
        return self.weights.get(label, 1.0)

    def with_weights(self, weights: Mapping[str, float]) -> "MarkerSet":
        """Return the same set with other weights for some markers."""
        return replace(self, weights={**self.weights, **weights}) if weights else self

    def with_further(
        self, markers: Mapping[str, Iterable[str]], source: Path = Path()
    ) -> "MarkerSet":
        """Return the same set with further markers, tracked in the trials that have them.

        Parameters
        ----------
        markers : mapping of str to iterable of str
            Segment -> labels.
        source : Path
            File to name in an error message.

        Returns
        -------
        MarkerSet
            Further markers on head and arms have small weights, with their reasons.

        Raises
        ------
        InputError
            Markers cannot be on a segment, or the set already has a label.
        """
        require_known(
            markers,
            MARKED_SEGMENTS,
            "segment",
            source=source,
            field="markers.tracking",
            listed=True,
        )
        known, segments = set(self.labels), self.segment_of
        further = {segment: tuple(labels) for segment, labels in markers.items()}
        for segment, labels in further.items():
            for label in labels:
                if label in known:
                    on = f"on {segments[label]}" if label in segments else "as a landmark"
                    message = f"found '{label}' on {segment}; the marker set has it {on}"
                    raise InputError(
                        message, source=source, field="markers.tracking", code=Code.MARKER_SET
                    )
                known.add(label)
                segments[label] = segment
        kinds = {
            label: segment.rsplit("_", 1)[0]
            for segment, labels in further.items()
            for label in labels
        }
        weak = {
            label: _FURTHER_WEIGHTS[kind]
            for label, kind in kinds.items()
            if kind in _FURTHER_WEIGHTS
        }
        return replace(
            self,
            optional={
                s: (*self.optional.get(s, ()), *further.get(s, ()))
                for s in {**self.optional, **further}
            },
            weights={**self.weights, **{label: weight for label, (weight, _) in weak.items()}},
            reasons={**self.reasons, **{label: why for label, (_, why) in weak.items()}},
        )

    def renamed(self, recording: Recording) -> Recording:
        """Rename the labels of a recording to the set's spelling.

        Parameters
        ----------
        recording : Recording
            Its labels may be aliases, or differ in case.

        Returns
        -------
        Recording
            The same object if nothing changes; else with a note that lists the changes.
        """
        spelt = self._spell_labels(recording.labels)
        if spelt == recording.labels:
            return recording
        pairs = zip(recording.labels, spelt, strict=True)
        changes = ", ".join(f"{old} -> {new}" for old, new in pairs if old != new)
        return replace(recording, labels=spelt).with_notes(f"markers renamed: {changes}")

    def _spell_labels(self, labels: Iterable[str]) -> tuple[str, ...]:
        """Spell labels as the set does: by its aliases, or where only the case differs."""
        given, of_all = tuple(labels), self.labels
        in_file, known = set(given), set(of_all)
        new_names: dict[str, str] = {}
        for label, others in self.aliases.items():
            letters = {other.casefold() for other in others}
            there = [other for other in others if other in in_file]
            there += [
                other for other in given if other not in known and other.casefold() in letters
            ]
            if there and label not in in_file:
                new_names[there[0]] = label
        taken = in_file | set(new_names.values())
        strangers = _group_by_casefold(
            label for label in given if label not in known and label not in new_names
        )
        in_set = _group_by_casefold(of_all)
        for label in of_all:
            same_in_file = strangers.get(label.casefold(), [])
            if label not in taken and len(same_in_file) == len(in_set[label.casefold()]) == 1:
                new_names[same_in_file[0]] = label
        return tuple(new_names.get(label, label) for label in given)

    def coverage(self, labels: Iterable[str], computed: Iterable[str] = ()) -> "Coverage":
        """Measure how much of the set a file with these labels has.

        Parameters
        ----------
        labels : iterable of str
            Marker labels of the file. A complete knee device counts as the lateral knee marker.
        computed : iterable of str
            Points that another program computed; they count as landmarks only.

        Returns
        -------
        Coverage
            Landmarks, followed segments, and a score.
        """
        given = self._spell_labels(labels)
        known, present, segment_of = set(self.labels), set(given), self.segment_of
        virtual = {label for label, parts in self.knee_device.items() if present.issuperset(parts)}
        virtual |= set(computed) & {
            m for name in self.landmarks for group in self.options(name) for m in group
        }
        # of each landmark, the preferred option whose markers are all there
        landmarks: dict[str, tuple[str, ...]] = {}
        for name in self.landmarks:
            for option in self.options(name):
                if (present | virtual).issuperset(option):
                    landmarks[name] = option
                    break
        tracked: dict[str, tuple[str, ...]] = {}
        for label in (*given, *sorted(virtual - present)):
            if label in segment_of:
                tracked[segment_of[label]] = (*tracked.get(segment_of[label], ()), label)
        bare = [segment for segment in LEG_SEGMENTS if segment not in tracked]
        if len(tracked.get("pelvis", ())) < PELVIS_NEEDS:
            bare.insert(0, "pelvis")
        missing = _find_missing_landmarks(landmarks)
        share = sum(label in known for label in given) / len(given) if given else 0.0
        return Coverage(
            required_missing=missing,
            landmarks=landmarks,
            tracked=tracked,
            bare=tuple(bare),
            unknown=tuple(label for label in given if label not in known),
            score=share * (1.0 - len(missing) / len(REQUIRED)) if missing or bare else 1.0 + share,
        )


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Part of a marker set that the labels of a file have."""

    # landmarks without which there is no model, and that no marker of the file gives
    required_missing: tuple[str, ...]
    # that the file gives -> the markers whose mean each is, by preference
    landmarks: Mapping[str, tuple[str, ...]]
    # segment -> markers of the file that follow it, of segments that have some
    tracked: Mapping[str, tuple[str, ...]]
    # segments of pelvis and legs that nothing follows (pelvis: fewer than three markers)
    bare: tuple[str, ...]
    unknown: tuple[str, ...]  # markers of the file that the set does not know
    score: float
    """Share of the file's labels that the set knows, 0 to 1, and 1 more where the set is complete
    for the legs: so a complete set comes before any other. An incomplete one has that share times
    the share of landmarks it gives."""

    @property
    def complete(self) -> bool:
        """Whether a static trial with these labels makes a model of pelvis and legs."""
        return not self.required_missing and not self.bare


def _group_by_casefold(labels: Iterable[str]) -> dict[str, list[str]]:
    """Group labels that are equal without regard to case."""
    out: dict[str, list[str]] = {}
    for label in labels:
        out.setdefault(label.casefold(), []).append(label)
    return out


_Labels = Annotated[
    list[str],
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    Field(min_length=1),
]


class _FirstOf(Table):
    first_of: list[_Labels] = Field(
        min_length=1, description="a list of markers, or of lists of them"
    )


def _convert_to_options(value: object) -> object:
    if not isinstance(value, dict | list | str):
        raise ValueError(
            f"found {format_value(value)}; allowed: a list, [a, b], a marker, or {{ first_of = "
            f"[...] }}"
        )
    return value if isinstance(value, dict) else {"first_of": [value]}


class _Weight(Table):
    weight: float = Field(
        ge=0, description="how strongly the marker pulls, 0 or more; 0 only reports it"
    )
    reason: str = Field(min_length=1, description="why the weight is not 1")


class _File(Table):
    description: str = Field(description="one line that tells the set")
    extends: str | None = Field(default=None, description="the name of a built-in marker set")
    landmarks: dict[str, Annotated[_FirstOf, BeforeValidator(_convert_to_options)]] = Field(
        default={}, description="a table, landmark = marker or list of markers"
    )
    tracking: dict[str, _Labels] = Field(
        default={}, description="a table, segment = list of markers"
    )
    static_only: dict[str, _Labels] = Field(
        default={}, description="a table, segment = list of markers"
    )
    optional: dict[str, _Labels] = Field(
        default={}, description="a table, segment = list of markers"
    )
    knee_device: dict[str, _Labels] = Field(
        default={}, description="a table, marker = list of three markers"
    )
    weights: dict[str, _Weight] = Field(
        default={}, description="a table, marker = { weight = ..., reason = ... }"
    )
    aliases: dict[str, _Labels] = Field(
        default={}, description="a table, marker = list of other spellings"
    )
    noise: PointNoise | None = Field(
        default=None, description="a table, of points that are no markers on skin"
    )


def list_built_in_sets() -> tuple[str, ...]:
    """List the names of the marker sets in the package."""
    return tuple(sorted(path.stem for path in (find_models_folder() / "markersets").glob("*.toml")))


def load_marker_set(name_or_path: str | Path) -> MarkerSet:
    """Load a built-in marker set by its name, or a user's set by the path of its TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a built-in set, or path of a TOML file.

    Returns
    -------
    MarkerSet
        With both sides written out.

    Raises
    ------
    InputError
        Names the file, the entry, what was found and what is allowed.
    """
    text, known = str(name_or_path), list_built_in_sets()
    if text in known:
        return _read_marker_set(find_models_folder() / "markersets" / f"{text}.toml", text)
    if (
        not isinstance(name_or_path, Path)
        and not text.lower().endswith(".toml")
        and "/" not in text
    ):
        message = (
            f"found {format_value(text)}; allowed: {', '.join(known)}, or the path of a TOML "
            f"file{suggest_name(text, known)}"
        )
        raise InputError(message, field="marker set", code=Code.MARKER_SET)
    return _read_marker_set(Path(text), Path(text).stem)


def _fault(path: Path, text: str, where: str) -> InputError:
    """Make the error of a marker set file."""
    return InputError(text, source=path, field=where, code=Code.MARKER_SET)


def _read_marker_set(path: Path, name: str) -> MarkerSet:
    """Read and check the file of a marker set."""
    file = read_validated(_File, path)
    base = _load_base(file, path)
    options = _expand_options(file, path)
    preferred = {landmark: given[0] for landmark, given in options.items()}
    others = {landmark: tuple(given[1:]) for landmark, given in options.items() if len(given) > 1}
    groups = {
        where: _expand_table(getattr(file, where), path, where)
        for where in (*_FOLLOWER_TABLES, "knee_device", "aliases")
    }
    require_known(preferred, LANDMARKS, "landmark", source=path, field="landmarks", listed=True)
    for where in _FOLLOWER_TABLES:
        require_known(
            groups[where], MARKED_SEGMENTS, "segment", source=path, field=where, listed=True
        )
    for label, parts in groups["knee_device"].items():
        if len(parts) != DEVICE_MARKERS:
            allowed = "allowed: three, the one on the flexion axis first"
            raise _fault(
                path, f"found {len(parts)} markers for '{label}'; {allowed}", "knee_device"
            )
    weights: dict[str, _Weight] = {}
    for pattern, entry in file.weights.items():
        weights |= dict.fromkeys(_expand_sides(pattern), entry)
    made = MarkerSet(
        name=name,
        description=file.description,
        landmarks={**base.landmarks, **preferred},
        alternatives={n: o for n, o in base.alternatives.items() if n not in preferred} | others,
        tracking={**base.tracking, **groups["tracking"]},
        static_only={**base.static_only, **groups["static_only"]},
        optional={**base.optional, **groups["optional"]},
        knee_device={**base.knee_device, **groups["knee_device"]},
        weights={label: entry.weight for label, entry in weights.items()},
        reasons={label: entry.reason for label, entry in weights.items()},
        aliases=groups["aliases"],
        noise=file.noise or base.noise,
    )
    _check_markers(made, path)
    known, tracked = set(made.labels), set(made.tracked)
    # entries of the base set are kept for the markers that this set still has
    return replace(
        made,
        weights={label: w for label, w in base.weights.items() if label in tracked}
        | dict(made.weights),
        reasons={label: why for label, why in base.reasons.items() if label in tracked}
        | dict(made.reasons),
        aliases={label: names for label, names in base.aliases.items() if label in known}
        | dict(made.aliases),
    )


def _load_base(file: _File, path: Path) -> MarkerSet:
    """Load the set that a file extends; empty if it extends none."""
    if file.extends is None:
        # without a base the file must have the required tables
        for where in ("landmarks", "tracking"):
            if not getattr(file, where):
                raise _fault(path, "missing: a table", where)
        return MarkerSet(name="", description="", landmarks={}, tracking={})
    require_known(
        [file.extends],
        list_built_in_sets(),
        "built-in marker set",
        source=path,
        field="extends",
        listed=True,
    )
    if path == find_models_folder() / "markersets" / f"{file.extends}.toml":
        raise _fault(path, "found the set itself; allowed: another built-in set", "extends")
    return load_marker_set(file.extends)


def _expand_table(
    table: Mapping[str, list[str]], path: Path, where: str
) -> dict[str, tuple[str, ...]]:
    """Expand a table to both sides.

    A sided name has the labels of its side, any other name those of both sides.
    """
    out: dict[str, tuple[str, ...]] = {}
    for pattern, labels in table.items():
        names = _expand_sides(pattern)
        for i, name in enumerate(names):
            if name in out:
                raise _fault(path, f"'{name}' is given twice", where)
            expanded: list[str] = []
            for label in labels:
                sides = _expand_sides(label)
                if len(names) == 1:
                    expanded += sides
                else:
                    # a label without sides serves both
                    expanded.append(sides[i] if len(sides) > 1 else sides[0])
            out[name] = tuple(dict.fromkeys(expanded))
    return out


def _expand_options(file: _File, path: Path) -> dict[str, list[tuple[str, ...]]]:
    """Expand the landmarks to both sides: landmark -> its options, in order of preference."""
    options: dict[str, list[tuple[str, ...]]] = {}
    for pattern, entry in file.landmarks.items():
        if twice := [name for name in _expand_sides(pattern) if name in options]:
            raise _fault(path, f"'{twice[0]}' is given twice", "landmarks")
        for labels in entry.first_of:
            for landmark, group in _expand_table({pattern: labels}, path, "landmarks").items():
                options.setdefault(landmark, []).append(group)
    return options


def _check_markers(made: MarkerSet, path: Path) -> None:
    """Check that no landmark is missing and that each marker is on one segment."""
    for landmark in _find_missing_landmarks(made.landmarks):
        raise _fault(
            path, f"'{landmark}' is missing: give {describe_substitute(landmark)}", "landmarks"
        )
    segment_of: dict[str, str] = {}
    for segment, followers in made.following:
        for label in followers:
            if label in segment_of:
                on = f"{segment_of[label]} and on {segment}; a marker is fixed in one segment"
                raise _fault(path, f"marker '{label}' is on {on}", "tracking")
            segment_of[label] = segment
    require_known(made.weights, made.tracked, "tracked marker", source=path, field="weights")
    require_known(made.aliases, made.labels, "marker", source=path, field="aliases")


def _expand_sides(pattern: str) -> tuple[str, ...]:
    """Expand `{S}` or `{s}` in a name to the right and the left side; any other name stays."""
    both = tuple(pattern.replace("{S}", side.upper()).replace("{s}", side) for side in SIDES)
    return tuple(dict.fromkeys(both))


def format_marker_set(marker_set: MarkerSet) -> str:
    """Format a marker set as TOML that `load_marker_set` reads back to the same set.

    Parameters
    ----------
    marker_set : MarkerSet
        Weights of markers that follow no segment are left out: they have no effect.

    Returns
    -------
    str
        Text of the file, both sides written out.
    """

    def table(name: str, content: Mapping[str, object]) -> str:
        entries = {
            format_toml_value(n): list(v) if isinstance(v, tuple) else v for n, v in content.items()
        }
        return format_toml_table(f"[{name}]", entries)

    options = {
        name: [list(group) for group in marker_set.options(name)] for name in marker_set.landmarks
    }
    weights = {
        label: {"weight": float(weight), "reason": marker_set.reasons.get(label, NO_REASON)}
        for label, weight in marker_set.weights.items()
        if label in marker_set.tracked
    }
    tables = [
        format_toml_table("", {"description": marker_set.description}).lstrip(),
        table(
            "landmarks",
            {
                name: groups[0] if len(groups) == 1 else {"first_of": groups}
                for name, groups in options.items()
            },
        ),
        table("tracking", marker_set.tracking),
        table("static_only", marker_set.static_only),
        *(
            table(name, group)
            for name in ("optional", "knee_device")
            if (group := getattr(marker_set, name))
        ),
        table("aliases", marker_set.aliases),
        table("weights", weights),
        *([table("noise", marker_set.noise.model_dump())] if marker_set.noise else []),
    ]
    return "\n".join(tables)
