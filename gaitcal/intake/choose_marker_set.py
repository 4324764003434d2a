"""Rank marker sets by how well they explain the labels of recordings.

All built-in sets and those in the folder are ranked. A label counts for a set that contains it.
A label that differs only in separators, blanks or a prefix counts too, and is offered as a
`rename`; sets ignore capitals. `measure_label_coverage` is the one function that looks into a set.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

from gaitcal.errors import differ_by_side
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import REQUIRED, MarkerSet, list_built_in_sets, load_marker_set

if TYPE_CHECKING:
    from gaitcal.intake.label_proposal import LabelProposal

FEWEST_LABELS = 6
"""Markers of pelvis and legs that a recording must share with its set."""
NEARLY = 0.8
"""Share of the best set's common labels that another set must have to explain a recording, too."""
KNOWN_SHARE = 0.8
"""Share of known labels from which a set is certain."""
MOST_MISSING = 4
"""Required landmarks, of 11, that may lack markers in a set that is still offered."""


@dataclass(frozen=True, kw_only=True)
class LabelCoverage:
    """How well a marker set explains labels."""

    known: int
    """Number of labels of the recordings that the set contains."""
    left_over: tuple[str, ...]
    """Labels of the recordings that it does not contain."""
    missing: tuple[str, ...]
    """Required landmarks that no label gives."""
    leg_markers: int
    """Number of known labels on pelvis or legs."""
    single_marker_segments: int
    """Number of segments of pelvis and legs that are tracked by one marker only."""
    unused_markers: int
    """Number of tracked markers of the set that no recording has."""


@dataclass(frozen=True, kw_only=True)
class SetChoice:
    """A marker set, and the recordings that it explains."""

    marker_set: MarkerSet
    entry: str
    """As the study file names it: a built-in name, or the path of its file."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Label in the files -> label in the set."""
    coverage: LabelCoverage
    """Of the labels of its recordings together."""
    members: tuple[int, ...]
    """Numbers of the recordings that it explains."""
    clashes: tuple[str, ...] = ()
    """Labels that cannot be renamed because the name is taken."""
    people_prefixes: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    """Recording -> prefixes under which it has the same markers: those of several people."""
    sided_unknown: tuple[str, ...] = ()
    """Unknown labels of one side that not every recording has: perhaps landmarks of a static trial.
    """
    centres: tuple[str, ...] = ()
    """Labels of joint centres, which `rename` replaces by markers."""
    proposal: "LabelProposal | None" = None
    """Meaning of labels that no set explains, by position and movement; to be confirmed."""
    further_markers: "LabelProposal | None" = None
    """Markers that the set does not contain, on the segments that they move with."""

    @property
    def certain(self) -> bool:
        """Whether the set is beyond doubt.

        All landmarks have markers, most labels are known, and no unknown label of one side is in
        some recordings only, as landmarks of a static trial are.
        """
        coverage = self.coverage
        known = coverage.known / max(coverage.known + len(coverage.left_over), 1)
        doubted = coverage.missing or self.sided_unknown or self.centres
        return self.proposal is None and known >= KNOWN_SHARE and not doubted


def measure_label_coverage(
    marker_set: MarkerSet, labels: Iterable[str], computed: Iterable[str] = ()
) -> LabelCoverage:
    """Measure how well a set explains labels.

    Parameters
    ----------
    marker_set
        The set.
    labels
        Of the recordings, spelt as in the set.
    computed
        Labels of points that another program computed.

    Returns
    -------
    LabelCoverage
    """
    given = tuple(dict.fromkeys(labels))
    found = marker_set.coverage(given, tuple(dict.fromkeys(computed)))
    on_legs = {m for segment in LOWER_BODY for m in found.tracked.get(segment, ())}
    on_legs |= {m for name in REQUIRED for m in found.landmarks.get(name, ())}
    tracked = {m for group in found.tracked.values() for m in group}
    in_set = {m for group in marker_set.tracking.values() for m in group}
    counts = [len(found.tracked.get(segment, ())) for segment in LOWER_BODY]
    return LabelCoverage(
        known=len(given) - len(set(found.unknown)),
        left_over=found.unknown,
        missing=found.required_missing,
        leg_markers=len(on_legs),
        single_marker_segments=counts.count(1),
        unused_markers=len(in_set - tracked),
    )


def _list_candidate_sets(
    local_sets: Sequence[tuple[str, MarkerSet]],
) -> list[tuple[str, MarkerSet]]:
    """List entry in the study file and set: those of the folder first, then all built-in ones."""
    return [*local_sets, *_load_built_in_sets()]


@cache
def _load_built_in_sets() -> tuple[tuple[str, MarkerSet], ...]:
    """Load the built-in sets, once."""
    return tuple((name, load_marker_set(name)) for name in list_built_in_sets())


def rank_marker_sets(
    recordings: Sequence[tuple[str, ...]],
    local_sets: Sequence[tuple[str, MarkerSet]] = (),
    computed: Sequence[tuple[str, ...]] | None = None,
) -> list[SetChoice]:
    """Rank the marker sets that may explain recordings, best first.

    `recordings`: labels of each recording. `local_sets`: entry of the study file and set, of sets
    that are not built in. `computed`: labels of the computed points of each recording. Returns:
    empty if no set explains enough labels.
    """
    points = computed or [()] * len(recordings)
    sets = _list_candidate_sets(local_sets)
    spellings = [_find_respellings(marker_set, recordings) for _, marker_set in sets]
    # labels of each recording as each set spells them, and their markers of pelvis and legs
    spelt, legs = [], []
    for (_, marker_set), (rename, _) in zip(sets, spellings, strict=True):
        spelt.append([apply_renames(labels, rename) for labels in recordings])
        legs.append(_count_leg_markers(marker_set, spelt[-1], points))
    best = [max(counts) for counts in zip(*legs, strict=True)]
    choices: list[SetChoice] = []
    for (entry, marker_set), (rename, clashes), labels, counts in zip(
        sets, spellings, spelt, legs, strict=True
    ):
        # a recording is of every set that explains nearly as many labels as the best one
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
        in_members = {label for i in members for label in recordings[i]}
        prefixes = {i: find_person_prefixes(marker_set, recordings[i]) for i in members}
        choice = SetChoice(
            marker_set=marker_set,
            entry=entry,
            rename={old: new for old, new in rename.items() if old in in_members},
            coverage=found,
            members=members,
            clashes=clashes,
            sided_unknown=_list_sided_labels(found.left_over, [labels[i] for i in members]),
            people_prefixes={i: names for i, names in prefixes.items() if names},
        )
        choices.append(choice)
    return sorted(choices, key=_rank)


def _list_sided_labels(
    left_over: Sequence[str], recordings: Sequence[tuple[str, ...]]
) -> tuple[str, ...]:
    """List labels of both sides that some of the recordings have and others have not."""
    partial = [label for label in left_over if not all(label in labels for labels in recordings)]
    return tuple(
        label for label in partial if any(differ_by_side(label, other) for other in partial)
    )


def _count_leg_markers(
    marker_set: MarkerSet, recordings: Sequence[tuple[str, ...]], points: Sequence[tuple[str, ...]]
) -> list[int]:
    """Count the markers of pelvis and legs of each recording, as the set spells them."""
    accepted = _list_accepted_spellings(marker_set)

    # most recordings have the same labels
    @cache
    def count(labels: tuple[str, ...], computed: tuple[str, ...]) -> int:
        enough = sum(label.casefold() in accepted for label in labels) >= FEWEST_LABELS
        return measure_label_coverage(marker_set, labels, computed).leg_markers if enough else 0

    return [count(*key) for key in zip(recordings, points, strict=True)]


def _rank(choice: SetChoice) -> tuple[int | str, ...]:
    """Rank a set, smallest first.

    More recordings, fewer landmarks missing, a set of the folder, fewer segments with one marker,
    more known labels, fewer renamed labels and unused markers; of sets with the same labels the one
    that gives reasons for its weights.
    """
    coverage = choice.coverage
    return (
        -len(choice.members),
        len(coverage.missing),
        choice.entry in list_built_in_sets(),
        coverage.single_marker_segments,
        -coverage.known,
        len(choice.rename),
        coverage.unused_markers,
        -len(choice.marker_set.reasons),
        choice.entry,
    )


def apply_renames(labels: Iterable[str], rename: Mapping[str, str]) -> tuple[str, ...]:
    """Return labels as the set spells them.

    Parameters
    ----------
    labels
        Of a recording.
    rename
        Label in the files -> label in the set.

    Returns
    -------
    tuple of str
    """
    return tuple(rename.get(label, label) for label in labels)


def _find_respellings(
    marker_set: MarkerSet, recordings: Sequence[tuple[str, ...]]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Find labels that differ from a label of the set only in case, separators or a prefix.

    Of several spellings of one label the most frequent one is renamed. Of several prefixes in one
    recording only the one with most labels of the set is renamed: others are of another person.

    `recordings`: labels of each recording. Returns: `rename` label in the files -> label in the
    set; `clashes` labels that are not renamed because the name is taken.
    """
    accepted = _list_accepted_spellings(marker_set)
    by_key: dict[str, list[str]] = {}
    for label in marker_set.labels:
        for spelling in (label, *marker_set.aliases.get(label, ())):
            same = by_key.setdefault(_normalise_label(spelling), [])
            if label not in same:
                same.append(label)
    count = Counter(label for labels in recordings for label in labels)
    of_others: set[str] = set()
    for labels in recordings:
        of_others |= _list_other_people(marker_set, labels)
    rename: dict[str, str] = {}
    clashes = []
    for label, _ in sorted(count.items(), key=lambda item: (-item[1], item[0])):
        targets = by_key.get(_normalise_label(label), [])
        if len(targets) != 1 or label.casefold() in accepted or label in of_others:
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


def _list_other_people(marker_set: MarkerSet, labels: Sequence[str]) -> set[str]:
    """List labels of the set under all prefixes but the one with most of them."""
    out = set()
    for prefix, keys in _group_by_prefix(marker_set, labels)[1:]:
        for label in labels:
            if label.rpartition(":")[0] == prefix and _normalise_label(label) in keys:
                out.add(label)
    return out


def find_person_prefixes(marker_set: MarkerSet, labels: Sequence[str]) -> tuple[str, ...]:
    """Find prefixes under which labels of the set occur that occur under another prefix, too.

    `labels`: of one recording. Returns: empty for one person.
    """
    groups = _group_by_prefix(marker_set, labels)
    count = Counter(key for _, keys in groups for key in keys)
    return tuple(prefix for prefix, keys in groups if any(count[key] > 1 for key in keys))


def _group_by_prefix(marker_set: MarkerSet, labels: Sequence[str]) -> list[tuple[str, set[str]]]:
    """Group the set's labels by prefix: prefix and normalised labels, the largest group first."""
    known = {_normalise_label(label) for label in _list_accepted_spellings(marker_set)}
    out: dict[str, set[str]] = {}
    for label in labels:
        prefix, key = label.rpartition(":")[0], _normalise_label(label)
        if prefix and key in known:
            out.setdefault(prefix, set()).add(key)
    return sorted(out.items(), key=lambda item: (-len(item[1]), item[0]))


def _list_accepted_spellings(marker_set: MarkerSet) -> frozenset[str]:
    """List the spellings that the set accepts by itself, without capitals."""
    others = (other for group in marker_set.aliases.values() for other in group)
    return frozenset(label.casefold() for label in (*marker_set.labels, *others))


def _normalise_label(label: str) -> str:
    """Return a label without prefix, case and separators."""
    return re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].lower())


def rank_sets_of_recordings(
    recordings: Sequence[Recording], local_sets: Sequence[tuple[str, MarkerSet]]
) -> list[SetChoice]:
    """Rank the marker sets that may explain recordings.

    Parameters
    ----------
    recordings
        As they were read.
    local_sets
        Entry of the study file and set, of sets that are not built in.

    Returns
    -------
    list of SetChoice
        Best first; empty without recordings, or if no set explains them.
    """
    computed = [() if r.computed is None else r.computed.labels for r in recordings]
    return (
        rank_marker_sets([r.labels for r in recordings], local_sets, computed) if recordings else []
    )


def describe_unknown_labels(
    recordings: Sequence[Recording], local_sets: Sequence[tuple[str, MarkerSet]]
) -> str:
    """Describe which labels no marker set contains, and what the nearest set lacks.

    Parameters
    ----------
    recordings
        As they were read.
    local_sets
        Entry of the study file and set, of sets that are not built in.

    Returns
    -------
    str
    """
    labels = list(dict.fromkeys(label for r in recordings for label in r.labels))
    nearest, found = max(
        (
            (entry, measure_label_coverage(s, labels))
            for entry, s in _list_candidate_sets(local_sets)
        ),
        key=lambda pair: (pair[1].leg_markers, -len(pair[1].missing)),
    )
    missing = ", ".join(found.missing[:6]) + (", ..." if len(found.missing) > 6 else "")
    shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
    return (
        f"no marker set contains enough of the labels {shown}; the nearest, {nearest}, contains "
        f"{found.known} of {len(labels)}, and these landmarks are missing: {missing or 'none'}; "
        "describe your marker set in a TOML file in the folder (models/markersets has examples), "
        "or correct the labels by 'rename' in a study file"
    )
