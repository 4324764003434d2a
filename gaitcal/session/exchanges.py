"""Whether one exchange of labels tells why the markers of two recordings seem to be placed otherwise.

Tried are every two labels of pelvis and legs, and all labels of the right with those of the left. One that fits is no
other person: the recording stays in the study, and the checks tell what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

from gaitcal.errors import other_side
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.session.placing import ALL_APART_M, APART_M, Distances, apart_by_segment, worn_labels

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
