"""Which marker set the labels of the files are: every built-in set, and those that lie in the
folder, is scored.

A label counts for a set where the set knows it; by another spelling (dots, blanks, a prefix) it
counts too, and is offered as a `rename`; capitals a set forgives by itself. `explained` is the one
function that looks into a set.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

from gaitcal.errors import other_side
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import REQUIRED, MarkerSet, list_built_in_sets, load_marker_set

if TYPE_CHECKING:
    from gaitcal.intake.label_proposal import LabelProposal

FEWEST_LABELS = 6  # Markers of pelvis and legs that a file shares with a set of which it is
NEARLY = 0.8
"""A file is of a set where it shares at least so many of the labels that it shares with the set
that fits it best.
"""
KNOWN_SHARE = 0.8  # Share of the labels that a set knows from which it is beyond doubt
MOST_MISSING = 4
"""Required landmarks without markers, of 11, with which a set is still offered, for a person to
look at.
"""


@dataclass(frozen=True, kw_only=True)
class LabelCoverage:
    """How well a marker set explains labels."""

    known: int  # How many labels of the files the set knows
    left_over: tuple[str, ...]  # Labels of the files that it does not know
    missing: tuple[str, ...]  # Required landmarks that none of the labels gives
    leg_markers: int  # How many of the known labels are on pelvis or legs
    single_marker_segments: (
        int  # How many segments of pelvis and legs are followed by one marker only
    )
    unused_markers: int  # How many markers that the set tracks are in no file


@dataclass(frozen=True, kw_only=True)
class SetChoice:
    """The marker set of a folder, and the recordings that are of it."""

    marker_set: MarkerSet
    entry: str  # As the study names it: a built-in name, or the path of its file
    rename: Mapping[str, str] = field(
        default_factory=dict
    )  # Label in the files -> label in the set
    coverage: LabelCoverage  # Of the labels of its recordings together
    members: tuple[int, ...]  # Which recordings are of this set
    clashes: tuple[
        str, ...
    ] = ()  # Labels that could be renamed but for another one of the same name
    people_prefixes: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    """Recording -> prefixes under which it has the same markers more than once: those of several
    people.
    """
    sided_unknown: tuple[str, ...] = ()
    """Labels left over that name a side and that not every recording has: of a static trial,
    landmarks it may be.
    """

    centres: tuple[
        str, ...
    ] = ()  # Labels in the files that name joint centres, in whose places `rename` puts markers
    proposal: "LabelProposal | None" = None
    """What the labels mean by places and movement, where no set knows them; nobody has confirmed
    it.
    """

    further_markers: "LabelProposal | None" = (
        None  # What moves with the segments besides the markers that the set knows
    )

    @property
    def certain(self) -> bool:
        """Whether nothing speaks against the set: all landmarks there, most labels known, none left
        over that only some recordings have on one side of the body, as landmarks of a static trial
        are.
        """
        found = self.coverage
        known = found.known / max(found.known + len(found.left_over), 1)
        doubted = found.missing or self.sided_unknown or self.centres
        return self.proposal is None and known >= KNOWN_SHARE and not doubted


def measure_label_coverage(
    marker_set: MarkerSet, labels: Iterable[str], computed: Iterable[str] = ()
) -> LabelCoverage:
    """How well a set explains labels, spelt as in the set, and those of points that another program
    computed.
    """
    given = tuple(dict.fromkeys(labels))
    told = marker_set.measure_coverage(given, tuple(dict.fromkeys(computed)))
    unknown = set(told.unknown)
    on_legs = {m for segment in LOWER_BODY for m in told.tracked.get(segment, ())}
    on_legs |= {m for name in REQUIRED for m in told.landmarks.get(name, ())}
    tracked = {m for labels in told.tracked.values() for m in labels}
    return LabelCoverage(
        known=len(given) - len(unknown),
        left_over=told.unknown,
        missing=told.required_missing,
        leg_markers=len(on_legs),
        single_marker_segments=sum(
            len(told.tracked.get(segment, ())) == 1 for segment in LOWER_BODY
        ),
        unused_markers=len({m for group in marker_set.tracking.values() for m in group} - tracked),
    )


def list_candidate_sets(own: Sequence[tuple[str, MarkerSet]]) -> list[tuple[str, MarkerSet]]:
    """Entry of the study file and set: those of the folder first, then all built-in ones."""
    return [*own, *_load_built_in_sets()]


@cache
def _load_built_in_sets() -> tuple[tuple[str, MarkerSet], ...]:
    """Read once: they come with the package."""
    return tuple((name, load_marker_set(name)) for name in list_built_in_sets())


def rank_marker_sets(
    recordings: Sequence[tuple[str, ...]],
    own: Sequence[tuple[str, MarkerSet]] = (),
    computed: Sequence[tuple[str, ...]] | None = None,
) -> list[SetChoice]:
    """The marker sets that recordings with these labels may be of, the best first; empty where none
    fits.

    `own`: entry of the study file and set, of sets that are not built in; `computed`: labels of the
    computed points of each recording.
    """
    points = computed or [()] * len(recordings)
    sets = list_candidate_sets(own)
    spellings = [find_respellings(marker_set, recordings) for _, marker_set in sets]
    spelt = [[apply_renames(labels, rename) for labels in recordings] for rename, _ in spellings]
    legs = [
        _count_leg_markers(s, labels, points) for (_, s), labels in zip(sets, spelt, strict=True)
    ]
    best = [max(counts) for counts in zip(*legs, strict=True)]
    choices: list[SetChoice] = []
    for (entry, marker_set), (rename, clashes), labels, counts in zip(
        sets, spellings, spelt, legs, strict=True
    ):
        members = tuple(
            i for i, n in enumerate(counts) if n >= max(FEWEST_LABELS, NEARLY * best[i])
        )
        found = measure_label_coverage(
            marker_set,
            [m for i in members for m in labels[i]],
            [m for i in members for m in points[i]],
        )
        if not members or len(found.missing) > MOST_MISSING:
            continue
        # labels left over that some recordings have and others not, once for each side
        some = [label for label in found.left_over if not all(label in labels[i] for i in members)]
        choice = SetChoice(
            marker_set=marker_set,
            entry=entry,
            rename={
                old: new
                for old, new in rename.items()
                if any(old in recordings[i] for i in members)
            },
            coverage=found,
            members=members,
            clashes=clashes,
            sided_unknown=tuple(
                label for label in some if any(other_side(label, other) for other in some)
            ),
            people_prefixes={
                i: prefixes
                for i in members
                if (prefixes := find_person_prefixes(marker_set, recordings[i]))
            },
        )
        choices.append(choice)
    return sorted(choices, key=_rank)


def _count_leg_markers(
    marker_set: MarkerSet, recordings: Sequence[tuple[str, ...]], points: Sequence[tuple[str, ...]]
) -> list[int]:
    """How many markers of pelvis and legs each recording has, as the set spells them; most have the
    same labels.
    """
    forgiven = _list_accepted_spellings(marker_set)

    @cache
    def count(labels: tuple[str, ...], computed: tuple[str, ...]) -> int:
        some = sum(label.casefold() in forgiven for label in labels) >= FEWEST_LABELS
        return measure_label_coverage(marker_set, labels, computed).leg_markers if some else 0

    return [count(*key) for key in zip(recordings, points, strict=True)]


def _rank(choice: SetChoice) -> tuple[int | str, ...]:
    """Smallest first: more recordings, fewer landmarks missing, a set of one's own, fewer segments
    with one marker, more labels explained, fewer of the set unused; of sets with the same labels
    the one that gives reasons for its weights.
    """
    found = choice.coverage
    return (
        -len(choice.members),
        len(found.missing),
        choice.entry in list_built_in_sets(),
        found.single_marker_segments,
        -found.known,
        len(choice.rename),
        found.unused_markers,
        -len(choice.marker_set.reasons),
        choice.entry,
    )


def apply_renames(labels: Iterable[str], rename: Mapping[str, str]) -> tuple[str, ...]:
    """Labels as the set spells them."""
    return tuple(rename.get(label, label) for label in labels)


def find_respellings(
    marker_set: MarkerSet, recordings: Sequence[tuple[str, ...]]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Label in the files -> label of the set that differs from it in case, separators or a prefix
    only; and labels that would become one that is taken. Of several spellings of one label the most
    frequent is renamed. Of several prefixes in one recording only the one with most labels of the
    set: a body has one, another is somebody else's.
    """
    forgiven = _list_accepted_spellings(marker_set)
    by_key: dict[str, list[str]] = {}
    for label in marker_set.labels:
        for spelling in (label, *marker_set.aliases.get(label, ())):
            if label not in (same := by_key.setdefault(_normalise_label(spelling), [])):
                same.append(label)
    count = Counter(label for labels in recordings for label in labels)
    theirs = {
        label
        for labels in recordings
        for prefix, own in _group_by_prefix(marker_set, labels)[1:]
        for label in labels
        if label.rpartition(":")[0] == prefix and _normalise_label(label) in own
    }
    rename: dict[str, str] = {}
    clashes = []
    for label, _ in sorted(count.items(), key=lambda item: (-item[1], item[0])):
        targets = by_key.get(_normalise_label(label), [])
        if len(targets) != 1 or label.casefold() in forgiven or label in theirs:
            continue
        spelt = {form.casefold() for form in (targets[0], *marker_set.aliases.get(targets[0], ()))}
        taken = any(
            label in labels and not spelt.isdisjoint(map(str.casefold, labels))
            for labels in recordings
        )
        if taken or targets[0] in rename.values():
            clashes.append(label)
        else:
            rename[label] = targets[0]
    return rename, tuple(clashes)


def find_person_prefixes(marker_set: MarkerSet, labels: Sequence[str]) -> tuple[str, ...]:
    """Prefixes under which labels of the set occur that occur under another prefix, too; empty for
    one person.
    """
    groups = _group_by_prefix(marker_set, labels)
    return tuple(
        p for p, own in groups if any(own & other for prefix, other in groups if prefix != p)
    )


def _group_by_prefix(marker_set: MarkerSet, labels: Sequence[str]) -> list[tuple[str, set[str]]]:
    """Prefix -> keys of the set's labels that occur under it, the prefix with most of them first."""
    known = {_normalise_label(label) for label in _list_accepted_spellings(marker_set)}
    out: dict[str, set[str]] = {}
    for label in labels:
        if (prefix := label.rpartition(":")[0]) and (key := _normalise_label(label)) in known:
            out.setdefault(prefix, set()).add(key)
    return sorted(out.items(), key=lambda item: (-len(item[1]), item[0]))


def _list_accepted_spellings(marker_set: MarkerSet) -> frozenset[str]:
    """Spellings that the set knows by itself, without capitals."""
    others = (other for group in marker_set.aliases.values() for other in group)
    return frozenset(label.casefold() for label in (*marker_set.labels, *others))


def _normalise_label(label: str) -> str:
    """What is left of a label without prefix, case and separators."""
    return re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].lower())


def rank_sets_of_recordings(
    recordings: Sequence[Recording], own: Sequence[tuple[str, MarkerSet]]
) -> list[SetChoice]:
    """The marker sets that the recordings may be of; none of no recordings."""
    computed = [() if r.computed is None else r.computed.labels for r in recordings]
    return rank_marker_sets([r.labels for r in recordings], own, computed) if recordings else []


def describe_unknown_labels(
    recordings: Sequence[Recording], own: Sequence[tuple[str, MarkerSet]]
) -> str:
    """Which labels no marker set knows, and what the nearest set misses."""
    labels = list(dict.fromkeys(label for r in recordings for label in r.labels))
    nearest, found = max(
        ((entry, measure_label_coverage(s, labels)) for entry, s in list_candidate_sets(own)),
        key=lambda pair: (pair[1].leg_markers, -len(pair[1].missing)),
    )
    lacks = ", ".join(found.missing[:6]) + (", ..." if len(found.missing) > 6 else "")
    shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
    return (
        f"no marker set knows enough of the labels {shown}; the nearest, {nearest}, knows "
        f"{found.known} of "
        f"{len(labels)} and misses {lacks or 'nothing'}; name your own in a TOML file in the "
        "folder "
        "(models/markersets has examples), or put the labels right by 'rename' in a study file"
    )
