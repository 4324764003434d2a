"""One person's session in a folder: the static trials, and the recordings whose markers are placed as in them.

A folder may hold two people, or one person on two days. Each static trial gathers the recordings whose markers sit as
in itself; the largest such group is the session, and the others keep their reason.

Whether one exchange of labels tells why the markers of two recordings seem to be placed otherwise.

Tried are every two labels of pelvis and legs, and all labels of the right with those of the left. One that fits is no
other person: the recording stays in the study, and the checks tell what is wrong with it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

from gaitcal.errors import other_side
from gaitcal.io.recording import Recording
from gaitcal.model.marker_set import REQUIRED, MarkerSet
from gaitcal.session.movement import Standing, standing
from gaitcal.session.placing import (
    ALL_APART_M,
    APART_M,
    Distances,
    apart_by_segment,
    pair_distances,
    placed_otherwise,
    worn_labels,
)

WITHIN_M = 0.009
"""Second largest d_s of `placing` after the exchange: the largest of one person in one session."""
REMAINS = 0.5
"""Share of the largest d_s that may be left: the exchange has to tell the difference, not to share in it."""
SIDES_EXCHANGED = "left and right"


def exchange_told(one: Distances, other: Distances, marker_set: MarkerSet) -> str:
    """The exchange of labels in one of two recordings after which their markers sit alike; empty where none does.

    Parameters
    ----------
    one, other : of `pair_distances`.
    """
    present = apart_by_segment(one, other, marker_set)
    if len(present) < 2:
        return ""
    fits: list[tuple[float, str]] = []
    for words, exchange in _exchanges(marker_set, other):
        apart = sorted(apart_by_segment(one, _exchanged(other, exchange), marker_set).values(), reverse=True)
        median = sorted(apart)[len(apart) // 2]
        tight = apart[0] <= min(APART_M, REMAINS * max(present.values())) and apart[1] <= WITHIN_M
        if tight and median <= ALL_APART_M:
            fits.append((sum(apart), words))
    return min(fits)[1] if fits else ""


def _exchanges(marker_set: MarkerSet, distances: Distances) -> Iterator[tuple[str, Mapping[str, str]]]:
    labels = sorted({label for pair in distances for label in pair})
    of_sides = [(a, b) for a, b in combinations(labels, 2) if other_side(a, b)]
    if of_sides:
        yield SIDES_EXCHANGED, {old: new for a, b in of_sides for old, new in ((a, b), (b, a))}
    worn = {label for group in worn_labels(marker_set, labels).values() for label in group}
    for a, b in combinations([label for label in labels if label in worn], 2):
        yield f"{a} and {b}", {a: b, b: a}


def _exchanged(distances: Distances, exchange: Mapping[str, str]) -> Distances:
    """Distances as they are after the exchange."""
    return {frozenset(exchange.get(label, label) for label in pair): d for pair, d in distances.items()}


STATIC_WORD = re.compile(
    r"(static|stat(?![a-z])|(?<![a-z])cal(ib\w*)?(?![a-z])|stand|(?<![a-z])(st|sc)(?![a-z])|pose|neutral|anatom)", re.I
)
"""What files of static trials are called; weak evidence."""
CLEAR_WORD = re.compile(r"(static|(?<![a-z])cal(ib\w*)?(?![a-z])|neutral|anatom)", re.IGNORECASE)
"""The same, where no other word is meant."""
SHIFTS_M = 0.1
"""RMS distance from the mean place up to which a foot or the pelvis is merely restless: a step moves it by more."""


@dataclass(frozen=True, kw_only=True)
class Session:
    """The recordings of one person with the markers in the same places."""

    statics: tuple[int, ...]
    """Recordings that may be static trials, the best first."""
    members: tuple[int, ...]
    postures: Mapping[int, Standing]
    """Recording -> how the person stands in it, where that is seen."""
    only_standing: Mapping[int, tuple[str, ...]]
    """Static trial -> markers of it that no other recording has."""
    others: Mapping[int, str]
    """Recordings of the same labels that are not of this session, and why."""

    @property
    def worn(self) -> MarkerSet:
        """The marker set as the best static trial shows it worn."""
        return self.postures[self.statics[0]].worn

    def posture(self, i: int) -> Standing:
        """How the person stands in a static trial."""
        return self.postures[i]

    def worn_standing(self, i: int) -> tuple[str, ...]:
        """Markers of a static trial that no moving recording has."""
        return self.only_standing.get(i, ())


def session_of(recordings: Mapping[int, Recording], stems: Mapping[int, str], marker_set: MarkerSet) -> Session | None:
    """The largest session in recordings with the set's labels; None where nobody stands still.

    `stems`: file names without ending.
    """
    postures = {i: found for i, r in recordings.items() if (found := standing(r, marker_set)[0]) is not None}
    worn = _worn_standing(recordings, postures)
    only = _standing_only(recordings, stems, postures, worn)
    if not only:
        return None

    def rank(i: int) -> tuple[object, ...]:
        missing = sum(name not in postures[i].landmarks for name in REQUIRED)
        told = bool(recordings[i].facts.is_static)
        word = STATIC_WORD.search(stems[i]) is not None
        return (missing, not told, -len(worn[i]), not word, round(1e3 * postures[i].speed), stems[i].lower(), i)

    ranked = sorted(only, key=rank)
    distances = {i: pair_distances(r, marker_set) for i, r in recordings.items()}
    otherwise = {
        (i, j): "" if exchange_told(distances[i], distances[j], marker_set) else words
        for i in ranked
        for j in recordings
        if (words := placed_otherwise(distances[i], distances[j], marker_set))
    }
    groups = {i: [j for j in recordings if not otherwise.get((i, j))] for i in ranked}
    best = max(ranked, key=lambda i: (len(groups[i]), -ranked.index(i)))
    others = {}
    for j in recordings:
        if j not in groups[best]:
            own = next((i for i in ranked if i not in groups[best] and j in groups[i] and i != j), None)
            more = (
                f"; its static trial is {stems[own]}: put these into a folder of their own" if own is not None else ""
            )
            words = otherwise[best, j]
            others[j] = f"another person, or markers put on anew, against {stems[best]}: {words}{more}"
    return Session(
        statics=(best, *(i for i in ranked if i != best and i in groups[best])),
        members=tuple(groups[best]),
        postures=postures,
        only_standing=worn,
        others=others,
    )


def _standing_only(
    recordings: Mapping[int, Recording],
    stems: Mapping[int, str],
    postures: Mapping[int, Standing],
    worn: Mapping[int, tuple[str, ...]],
) -> list[int]:
    """Recordings that only stand; where there are none, those called static or with markers of their own, of which a
    part stands; then those in which somebody merely shifts.
    """
    tiers: tuple[Callable[[int], bool], ...] = (
        lambda i: postures[i].throughout,
        lambda i: bool(CLEAR_WORD.search(stems[i]) or recordings[i].facts.is_static or worn[i]),
        lambda i: postures[i].sway <= SHIFTS_M,
    )
    return next((found for tier in tiers if (found := [i for i in postures if tier(i)])), [])


def _worn_standing(recordings: Mapping[int, Recording], postures: Mapping[int, Standing]) -> dict[int, tuple[str, ...]]:
    """Standing recording -> its labels that no recording has in which the person moves."""
    moving = {m for i, r in recordings.items() if i not in postures or not postures[i].throughout for m in r.labels}
    if not moving:
        return dict.fromkeys(postures, ())
    return {i: tuple(m for m in recordings[i].labels if m not in moving) for i in postures}
