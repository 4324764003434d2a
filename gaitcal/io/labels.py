"""Marker names: which of a file's labels are markers, and how they are spelt inside.

A C3D file's POINT list may hold, besides markers, everything a vendor's pipeline computed: angles, moments, powers,
joint centres, four points for each segment's axes. None of these was measured; none may be fitted.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

UNLABELLED = re.compile(r"\*\d*|")
"""Trajectories the operator did not name: `*12` (Vicon) and blanks."""

NUMBER = re.compile(r"[LR]?[A-Z]\w*(Angles?|Moments?|Forces?|Powers?|GRF|ProgressAngles)")
"""Names of computed points that hold three numbers of another kind than places."""
COMPUTED = re.compile(
    r"Cent(re|er)OfMass\w*"
    rf"|{NUMBER.pattern}"
    r"|[LR]?(HJC|KJC|AJC|SJC|EJC|WJC)"
)
"""Names that vendors give to computed points; used besides the file's own lists."""

SEGMENT_POINT = re.compile(r"(?P<stem>[A-Z][A-Z0-9]{2}|\w+_M?)(?P<point>[OALP])")
"""Segment axes: origin, anterior, lateral, proximal, as PELO PELA PELL PELP (Vicon) or Pelvis_MO _MA _ML _MP. Only
where all four are there."""


def clean(label: str) -> str:
    """The label without outer blanks; control characters and broken encodings become `?`."""
    text = label.encode("utf-8", "replace").decode("utf-8").strip()
    return "".join("?" if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") else c for c in text)


def common_prefix(labels: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """`Subj:` where every label begins so, else the empty string; and a note that it is taken off, if any."""
    heads = {label.partition(":")[0] if ":" in label else "" for label in labels}
    head = heads.pop() if len(heads) == 1 else ""
    prefix = head + ":" if head and all(len(label) > len(head) + 1 for label in labels) else ""
    return prefix, (f"Prefix '{prefix}' taken off the marker names.",) if prefix else ()


def unique(labels: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Labels with every repetition numbered, `X`, `X#2`, `X#3`, and a note that tells the new names, if any."""
    given = list(labels)
    spellings = set(given)
    names: list[str] = []
    used: set[str] = set()
    renamed: list[str] = []
    for label in given:
        name, count = label, 1
        while name in used or (count > 1 and name in spellings):
            count += 1
            name = f"{label}#{count}"
        used.add(name)
        names.append(name)
        if name != label:
            renamed.append(name)
    notes = (f"Marker names that occur more than once were numbered: {', '.join(renamed)}.",) if renamed else ()
    return tuple(names), notes


def is_unlabelled(label: str) -> bool:
    """True for trajectories without a name."""
    return UNLABELLED.fullmatch(label) is not None


def is_number(label: str) -> bool:
    """True for computed points that are no places by their spelling: angles, moments, forces, powers."""
    return NUMBER.fullmatch(label) is not None


def axes_points(labels: Sequence[str]) -> set[str]:
    """Those of `labels` that are the four points of a segment's axes."""
    matches = {label: SEGMENT_POINT.fullmatch(label) for label in labels}
    points: dict[str, set[str]] = {}
    for match in matches.values():
        if match:
            points.setdefault(match["stem"], set()).add(match["point"])
    whole = {stem for stem, found in points.items() if len(found) == 4}
    return {label for label, match in matches.items() if match and match["stem"] in whole}


def computed_points(labels: Sequence[str]) -> set[str]:
    """Those of `labels` that name computed points, judged by their spelling."""
    return axes_points(labels) | {label for label in labels if COMPUTED.fullmatch(label)}
