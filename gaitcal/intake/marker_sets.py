"""Which marker set the labels of the files are: every built-in set, and those that lie in the folder, is scored.

A label counts for a set where the set knows it; by another spelling (case, dots, blanks, a prefix) it counts too, and
is offered as a `rename`. `coverage` is the one function that looks into a set.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import REQUIRED, MarkerSet, built_in_sets, load_marker_set

FEWEST_LABELS = 6
"""Markers of pelvis and legs that a file shares with a set of which it is."""
NEARLY = 0.8
"""A file is of a set where it shares at least so many of the labels that it shares with the set that fits it best."""
MOST_MISSING = 4
"""Required landmarks without markers, of 11, with which a set is still offered, for a person to look at."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """How well a marker set explains labels."""

    known: tuple[str, ...]
    """Labels of the files that the set knows, in its spelling."""
    left_over: tuple[str, ...]
    """Labels of the files that it does not know."""
    missing: tuple[str, ...]
    """Required landmarks that none of the labels gives."""
    legs: int
    """How many of the known labels are on pelvis or legs."""
    unused: int
    """How many labels of the set are in no file."""


@dataclass(frozen=True, kw_only=True)
class SetChoice:
    """The marker set of a folder, and the recordings that are of it."""

    marker_set: MarkerSet
    entry: str
    """As the study names it: a built-in name, or the path of its file."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Label in the files -> label in the set."""
    coverage: Coverage
    """Of the labels of its recordings together."""
    members: tuple[int, ...]
    """Which recordings are of this set."""
    clashes: tuple[str, ...] = ()
    """Labels that could be renamed but for another one of the same name."""


def coverage(marker_set: MarkerSet, labels: Iterable[str]) -> Coverage:
    """How well a set explains labels, spelt as in the set."""
    given = list(dict.fromkeys(labels))
    alias = {other: label for label, others in marker_set.aliases.items() for other in others}
    spelt = [alias.get(label, label) if label not in marker_set.labels else label for label in given]
    in_set, present = set(marker_set.labels), set(spelt)
    landmarks = marker_set.landmarks
    on_legs = {m for m, segment in marker_set.segment_of.items() if segment in LOWER_BODY}
    on_legs |= {m for name in REQUIRED for m in landmarks.get(name, ())}
    known = tuple(label for label in spelt if label in in_set)
    return Coverage(
        known=known,
        left_over=tuple(old for old, label in zip(given, spelt, strict=True) if label not in in_set),
        missing=tuple(name for name in REQUIRED if not set(landmarks.get(name, ("",))) <= present),
        legs=len(set(known) & on_legs),
        unused=len(in_set - present),
    )


def candidates(own: Sequence[tuple[str, MarkerSet]]) -> list[tuple[str, MarkerSet]]:
    """Entry of the study file and set: those of the folder first, then all built-in ones."""
    return [*own, *((name, load_marker_set(name)) for name in built_in_sets())]


def choose_set(recordings: Sequence[tuple[str, ...]], own: Sequence[tuple[str, MarkerSet]]) -> list[SetChoice]:
    """The marker sets that recordings with these labels may be of, the best first; empty where none fits."""
    sets = candidates(own)
    spellings = [spelt_otherwise(marker_set, recordings) for _, marker_set in sets]
    legs = [
        [coverage(s, respelt(labels, rename)).legs for labels in recordings]
        for (_, s), (rename, _) in zip(sets, spellings, strict=True)
    ]
    best = [max(counts) for counts in zip(*legs, strict=True)]
    choices: list[SetChoice] = []
    for (entry, marker_set), (rename, clashes), counts in zip(sets, spellings, legs, strict=True):
        members = tuple(i for i, n in enumerate(counts) if n >= max(FEWEST_LABELS, NEARLY * best[i]))
        union = [label for i in members for label in respelt(recordings[i], rename)]
        found = coverage(marker_set, union)
        if not members or len(found.missing) > MOST_MISSING:
            continue
        used = {old: new for old, new in rename.items() if any(old in recordings[i] for i in members)}
        choice = SetChoice(
            marker_set=marker_set, entry=entry, rename=used, coverage=found, members=members, clashes=clashes
        )
        choices.append(choice)
    return sorted(choices, key=_rank)


def _rank(choice: SetChoice) -> tuple[int | str, ...]:
    """Smallest first: more recordings, fewer landmarks missing, more labels explained, fewer of the set unused; a set
    of one's own before a built-in one; of sets with the same labels the one that gives reasons for its weights.
    """
    found = choice.coverage
    built_in = choice.entry in built_in_sets()
    return (
        -len(choice.members),
        len(found.missing),
        -len(found.known),
        len(choice.rename),
        found.unused,
        built_in,
        -len(choice.marker_set.reasons),
        choice.entry,
    )


def respelt(labels: Iterable[str], rename: Mapping[str, str]) -> tuple[str, ...]:
    """Labels as the set spells them."""
    return tuple(rename.get(label, label) for label in labels)


def spelt_otherwise(
    marker_set: MarkerSet, recordings: Sequence[tuple[str, ...]]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Label in the files -> label of the set that differs from it in case, separators or a prefix only; and labels
    that would become one that is taken. Of several spellings of one label the most frequent is renamed.
    """
    exact = set(marker_set.labels) | {other for others in marker_set.aliases.values() for other in others}
    by_key: dict[str, list[str]] = {}
    for label in marker_set.labels:
        by_key.setdefault(_key(label), []).append(label)
    count = Counter(label for labels in recordings for label in labels)
    rename: dict[str, str] = {}
    clashes = []
    for label, _ in sorted(count.items(), key=lambda item: (-item[1], item[0])):
        targets = by_key.get(_key(label), [])
        if label in exact or len(targets) != 1:
            continue
        taken = any(label in labels and targets[0] in labels for labels in recordings)
        if taken or targets[0] in rename.values():
            clashes.append(label)
        else:
            rename[label] = targets[0]
    return rename, tuple(clashes)


def _key(label: str) -> str:
    """What is left of a label without prefix, case and separators."""
    return re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].lower())
