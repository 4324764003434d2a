"""What each marker of a laboratory's protocol is for: a landmark, a segment that it follows, a weight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from gaitcal.io.recording import Recording
from gaitcal.model.marker_coverage import Coverage, coverage_of


@dataclass(frozen=True, kw_only=True)
class MarkerSet:
    """What the markers of a laboratory's protocol mean.

    A set may leave open what a person wears: landmarks with alternatives, markers that some wear and others do not, a
    device at the knee. `model/worn_markers.py` makes of it the set of one static trial, in which nothing is open.
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
