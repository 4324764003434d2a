"""Marker sets as data: what each marker of a laboratory's protocol is for, a landmark, a segment, a
weight.

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
    [noise]          how points err that are no markers on skin (`subject_model.PointNoise`)

`{S}` in a name stands for R and L, `{s}` for r and l, so that one line serves both sides.
`marker_set_text` writes a set as such a file again, so that a result can keep the one it was made
with.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from gaitcal.display import Displayed, shorten
from gaitcal.errors import Code, InputError, nearest
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
from gaitcal.model.linkage import LEG_SEGMENTS, MARKED_SEGMENTS, SIDES, of_side
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
    **{f"{name}_{side}": of_side(segment, side) for side in SIDES for segment, name in _SIDED},
}
"""Landmark -> the segment that it lies in."""
LANDMARKS: tuple[str, ...] = tuple(SEGMENT_OF)
"""All names a set may give a landmark. `elbow_lat` alone is enough for an elbow; `wrist` is its
centre; `knee_axis` is a point on the knee's flexion axis outwards of the lateral epicondyle, as a
knee alignment device shows it; `hjc` the centre of a hip, for `hip_centre = "given"`. Those of the
trunk's midline tell where it faces where acromia are missing, `c7` and `jugular_notch` also where
the shoulders are; `t10` may be any spinous process from T6 to T12."""
_INSTEAD = {
    "asis": "a marker on the anterior superior iliac spine",
    "sacrum": "a marker midway between the posterior superior iliac spines, or the list of the two "
    "on them",
    "knee_lat": "a marker on the lateral femoral epicondyle",
    "ankle_lat": "a marker on the lateral malleolus",
    "heel": "a marker on the back of the heel",
    "toe": "a marker on the tip of the foot or over the head of the second metatarsal",
}
REQUIRED: tuple[str, ...] = tuple(
    name for name in LANDMARKS if name == "sacrum" or name[:-2] in _INSTEAD
)
"""Landmarks without which there is no model; all others have a default or freeze their segment."""
PARTNER: dict[str, str] = {
    f"{one}_{side}": f"{other}_{side}"
    for side in SIDES
    for one, other in (("heel", "toe"), ("toe", "heel"))
}
"""Landmark of a foot -> the one from which it is guessed where no marker shows it."""
PELVIS_NEEDS = 3  # markers of the pelvis, from which the pose of the body starts
DEVICE_MARKERS = 3  # of a knee alignment device
NO_REASON = "weight of the study"  # stands as the reason of weights that a study gave without one
_GIRDLE = "the moving shoulder girdle, which the model lacks, carries the arm"
_OF_FURTHER = {
    "head": (0.05, "the back's three turns about one point are only a rough model of the spine"),
    "upper_arm": (0.02, _GIRDLE),
    "forearm_hand": (0.02, _GIRDLE),
}
"""Segment without its last word -> weight of further markers on it, and why it is not 1; as in the
built-in sets.
"""
_FOLLOWING = ("tracking", "static_only", "optional")  # tables segment -> markers


def missing_landmarks(given: Iterable[str]) -> tuple[str, ...]:
    """Required landmarks that are not among those given; of a foot, heel or toe is enough."""
    there = set(given)
    return tuple(name for name in REQUIRED if name not in there and PARTNER.get(name) not in there)


def instead_of(landmark: str) -> str:
    """What serves as a required landmark, for an error message."""
    return _INSTEAD.get(landmark) or _INSTEAD[landmark[:-2]]


@dataclass(frozen=True, kw_only=True, repr=False)
class MarkerSet(Displayed):
    """What the markers of a laboratory's protocol mean.

    A set may leave open what a person wears: landmarks with alternatives, markers that some wear
    and others do not, a device at the knee. `model/present_markers.py` makes of it the set of one
    static trial, in which nothing is open.
    """

    name: str
    """Of a built-in set, or the file of one's own without its ending."""
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
    """Segment -> further markers that some wear; tracked where there are, and missed by nobody."""
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
        """All that serves as a landmark, in order of preference; each is the markers whose mean it
        is.
        """
        return (self.landmarks[landmark], *self.alternatives.get(landmark, ()))

    def weight(self, label: str) -> float:
        """Weight of a marker."""
        return self.weights.get(label, 1.0)

    def with_weights(self, weights: Mapping[str, float]) -> "MarkerSet":
        """The same set with other weights for some markers."""
        return replace(self, weights={**self.weights, **weights}) if weights else self

    def with_further(
        self, markers: Mapping[str, Iterable[str]], source: Path = Path()
    ) -> "MarkerSet":
        """The same set with further markers, segment -> labels, that are tracked where a trial has
        them.

        InputError for a segment that markers cannot be on, and for a label that the set knows.
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
        weak = {label: _OF_FURTHER[kind] for label, kind in kinds.items() if kind in _OF_FURTHER}
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
        """The recording with the set's own spelling of every label; a note tells what was changed."""
        spelt = self._spelt(recording.labels)
        if spelt == recording.labels:
            return recording
        pairs = zip(recording.labels, spelt, strict=True)
        changes = ", ".join(f"{old} -> {new}" for old, new in pairs if old != new)
        return replace(recording, labels=spelt).with_notes(f"markers renamed: {changes}")

    def _spelt(self, labels: Iterable[str]) -> tuple[str, ...]:
        """Labels as the set spells them: by its aliases, and where only the case differs and one
        label is meant.
        """
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
        strangers = _by_letters(
            label for label in given if label not in known and label not in new_names
        )
        in_set = _by_letters(of_all)
        for label in of_all:
            same_in_file = strangers.get(label.casefold(), [])
            if label not in taken and len(same_in_file) == len(in_set[label.casefold()]) == 1:
                new_names[same_in_file[0]] = label
        return tuple(new_names.get(label, label) for label in given)

    def coverage(self, labels: Iterable[str], computed: Iterable[str] = ()) -> "Coverage":
        """What a file with these marker labels gives of the set; points that another program
        `computed` serve as landmarks only. A device at the knee counts as the lateral knee marker
        that it stands in for.
        """
        given = self._spelt(labels)
        known, seen, segment_of = set(self.labels), set(given), self.segment_of
        virtual = {label for label, parts in self.knee_device.items() if seen.issuperset(parts)}
        virtual |= set(computed) & {
            m for name in self.landmarks for group in self.options(name) for m in group
        }
        options = {
            name: [o for o in self.options(name) if (seen | virtual).issuperset(o)]
            for name in self.landmarks
        }
        landmarks = {name: there[0] for name, there in options.items() if there}
        tracked: dict[str, tuple[str, ...]] = {}
        for label in (*given, *sorted(virtual - seen)):
            if label in segment_of:
                tracked[segment_of[label]] = (*tracked.get(segment_of[label], ()), label)
        bare = [segment for segment in LEG_SEGMENTS if segment not in tracked]
        if len(tracked.get("pelvis", ())) < PELVIS_NEEDS:
            bare.insert(0, "pelvis")
        missing = missing_landmarks(landmarks)
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
    """What the labels of a file give of a marker set."""

    required_missing: tuple[
        str, ...
    ]  # landmarks without which there is no model, and that no marker of the file gives
    landmarks: Mapping[
        str, tuple[str, ...]
    ]  # that the file gives -> the markers whose mean each is, by preference
    tracked: Mapping[
        str, tuple[str, ...]
    ]  # segment -> markers of the file that follow it, of segments that have some
    bare: tuple[
        str, ...
    ]  # segments of pelvis and legs that nothing follows (pelvis: fewer than three markers)
    unknown: tuple[str, ...]  # markers of the file that the set does not know
    score: float
    """Share of the file's labels that the set knows, 0 to 1, and 1 more where the set is complete
    for the legs: so a complete set comes before any other. An incomplete one has that share times
    the share of landmarks it gives."""

    @property
    def complete(self) -> bool:
        """Whether a static trial with these labels makes a model of pelvis and legs."""
        return not self.required_missing and not self.bare


def _by_letters(labels: Iterable[str]) -> dict[str, list[str]]:
    """Labels by what they are without regard to case."""
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


def _as_options(value: object) -> object:
    if not isinstance(value, dict | list | str):
        raise ValueError(
            f"found {format_value(value)}; allowed: a list, [a, b], a marker, or {{ first_of = [...] }}"
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
    landmarks: dict[str, Annotated[_FirstOf, BeforeValidator(_as_options)]] = Field(
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


def built_in_sets() -> tuple[str, ...]:
    """Names of the marker sets that come with the package."""
    return tuple(sorted(path.stem for path in (find_models_folder() / "markersets").glob("*.toml")))


def load_marker_set(name_or_path: str | Path) -> MarkerSet:
    """A built-in marker set by its name, or a user's own by the path of its TOML file.

    Raises
    ------
    InputError
        Names the file, the entry, what was found and what is allowed.
    """
    text, known = str(name_or_path), built_in_sets()
    if text in known:
        return _read(find_models_folder() / "markersets" / f"{text}.toml", text)
    if (
        not isinstance(name_or_path, Path)
        and not text.lower().endswith(".toml")
        and "/" not in text
    ):
        message = (
            f"found {format_value(text)}; allowed: {', '.join(known)}, or the path of a TOML "
            f"file{nearest(text, known)}"
        )
        raise InputError(message, field="marker set", code=Code.MARKER_SET)
    return _read(Path(text), Path(text).stem)


def _read(path: Path, name: str) -> MarkerSet:
    def fault(text: str, where: str) -> InputError:
        return InputError(text, source=path, field=where, code=Code.MARKER_SET)

    file = read_validated(_File, path)
    base = MarkerSet(name="", description="", landmarks={}, tracking={})
    if file.extends is None:  # it must say all by itself
        for where in ("landmarks", "tracking"):
            if not getattr(file, where):
                raise fault("missing: a table", where)
    else:
        require_known(
            [file.extends],
            built_in_sets(),
            "built-in marker set",
            source=path,
            field="extends",
            listed=True,
        )
        if path == find_models_folder() / "markersets" / f"{file.extends}.toml":
            raise fault("found the set itself; allowed: another built-in set", "extends")
        base = load_marker_set(file.extends)

    def both_sides(where: str, table: Mapping[str, list[str]]) -> dict[str, tuple[str, ...]]:
        """The table with both sides written out: a sided name takes the labels of its side, any
        other those of both.
        """
        out: dict[str, tuple[str, ...]] = {}
        for pattern, labels in table.items():
            names = _sides(pattern)
            for i, name in enumerate(names):
                if name in out:
                    raise fault(f"'{name}' is given twice", where)
                # a label without a side stands once in `_sides`, and serves either side
                each = [
                    _sides(label) if len(names) == 1 else (_sides(label) * 2)[i : i + 1]
                    for label in labels
                ]
                out[name] = tuple(dict.fromkeys(label for both in each for label in both))
        return out

    options: dict[
        str, list[tuple[str, ...]]
    ] = {}  # landmark -> what serves as it, in order of preference
    for pattern, entry in file.landmarks.items():
        if twice := [name for name in _sides(pattern) if name in options]:
            raise fault(f"'{twice[0]}' is given twice", "landmarks")
        for labels in entry.first_of:
            for landmark, group in both_sides("landmarks", {pattern: labels}).items():
                options.setdefault(landmark, []).append(group)
    preferred = {name: given[0] for name, given in options.items()}
    others = {name: tuple(given[1:]) for name, given in options.items() if len(given) > 1}
    groups = {
        where: both_sides(where, getattr(file, where))
        for where in (*_FOLLOWING, "knee_device", "aliases")
    }
    require_known(preferred, LANDMARKS, "landmark", source=path, field="landmarks", listed=True)
    for where in _FOLLOWING:
        require_known(
            groups[where], MARKED_SEGMENTS, "segment", source=path, field=where, listed=True
        )
    for label, parts in groups["knee_device"].items():
        if len(parts) != DEVICE_MARKERS:
            allowed = "allowed: three, the one on the flexion axis first"
            raise fault(f"found {len(parts)} markers for '{label}'; {allowed}", "knee_device")
    weighed = {label: entry for pattern, entry in file.weights.items() for label in _sides(pattern)}
    made = MarkerSet(
        name=name,
        description=file.description,
        landmarks={**base.landmarks, **preferred},
        alternatives={n: o for n, o in base.alternatives.items() if n not in preferred} | others,
        tracking={**base.tracking, **groups["tracking"]},
        static_only={**base.static_only, **groups["static_only"]},
        optional={**base.optional, **groups["optional"]},
        knee_device={**base.knee_device, **groups["knee_device"]},
        weights={label: entry.weight for label, entry in weighed.items()},
        reasons={label: entry.reason for label, entry in weighed.items()},
        aliases=groups["aliases"],
        noise=file.noise or base.noise,
    )
    for landmark in missing_landmarks(made.landmarks):
        raise fault(f"'{landmark}' is missing: give {instead_of(landmark)}", "landmarks")
    segment_of: dict[str, str] = {}
    for label, segment in (
        (label, segment) for segment, followers in made.following for label in followers
    ):
        if label in segment_of:
            on = f"{segment_of[label]} and on {segment}; a marker is fixed in one segment"
            raise fault(f"marker '{label}' is on {on}", "tracking")
        segment_of[label] = segment
    require_known(made.weights, made.tracked, "tracked marker", source=path, field="weights")
    require_known(made.aliases, made.labels, "marker", source=path, field="aliases")
    known, tracked = set(made.labels), set(made.tracked)
    return replace(
        made,
        weights={label: w for label, w in base.weights.items() if label in tracked}
        | dict(made.weights),
        reasons={label: why for label, why in base.reasons.items() if label in tracked}
        | dict(made.reasons),
        aliases={label: names for label, names in base.aliases.items() if label in known}
        | dict(made.aliases),
    )


def _sides(pattern: str) -> tuple[str, ...]:
    """A name with `{S}` or `{s}` as those of the right and the left side; any other as itself."""
    both = tuple(pattern.replace("{S}", side.upper()).replace("{s}", side) for side in SIDES)
    return tuple(dict.fromkeys(both))


def marker_set_text(marker_set: MarkerSet) -> str:
    """TOML that `load_marker_set` reads back to the same set, both sides written out.

    Weights of markers that no segment follows are left out: they pull nothing.
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
            {name: of[0] if len(of) == 1 else {"first_of": of} for name, of in options.items()},
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
