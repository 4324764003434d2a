"""Every attack, by what is spoilt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from scripts.validation.attacks.attack import Attack
from scripts.validation.attacks.corpus import (
    files,
    force_faults,
    isolated_trials,
    mislabelled_walks,
    static_trials,
    studies,
    subjects,
    walks,
)


def corpus() -> tuple[Attack, ...]:
    """All attacks on all bases, each title once."""
    groups = (static_trials, walks, mislabelled_walks, isolated_trials, force_faults, subjects, studies, files)
    every = tuple(attack for group in groups for attack in group.attacks())
    doubled = [title for title, count in Counter(a.title for a in every).items() if count > 1]
    if doubled:
        raise ValueError(f"two attacks have one title: {', '.join(doubled)}")
    return every


def once_each(attacks: tuple[Attack, ...]) -> Iterator[Attack]:
    """Each attack on one of its bases: the first, the second, ... in turn, so that all bases have their share."""
    rows: dict[tuple[str, str], list[Attack]] = {}
    for attack in attacks:
        rows.setdefault((attack.kind, attack.name), []).append(attack)
    for turn, row in enumerate(rows.values()):
        yield row[turn % len(row)]
