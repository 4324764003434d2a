"""What an OpenSim model differs in from ours, in words: `their hip centres lie 42 mm behind ours (right 41, left 43)`.

Both sides are told together, by their mean; lateral differences and turns of the left side are mirrored first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from gaitcal.compare.comparison import ComparisonRow
from gaitcal.model.linkage import SIDES

LEAST_MM, LEAST_DEG, LEAST_SHARE = 5.0, 3.0, 0.02
"""Differences that are worth a word: landmarks are not palpated nearer than this; of masses, the part of ours."""
_MM = {"ant": ("in front of", "behind"), "sup": ("above", "below"), "lat": ("further out than", "further in than")}
_PLANES = {"front": "in the frontal plane", "trans": "in the transverse plane", "sag": "in the sagittal plane"}
_KNEE, _ANKLE = "knee_{s} axis in thigh_{s}", "talocrural_{s} axis in shank_{s}"
_POINTS = {"hip_{s} centre in pelvis": "hip centres", _KNEE: "knee axes, in the thigh,", _ANKLE: "ankle axes"}
_TURNS = {_KNEE: "knee axes", _ANKLE: "ankle axes", "subtalar_{s} axis in foot_{s}": "subtalar axes"}
_LENGTHS = {
    "thigh_{s} length, hip centre to knee centre": "thighs",
    "shank_{s} length, knee centre to talocrural centre": "shanks",
}


def osim_words(rows: Sequence[ComparisonRow]) -> tuple[str, ...]:
    """Sentences on what differs, the largest first; one that says so where nothing does."""
    told = sorted(_told({row.quantity: row for row in rows}), key=lambda of: -of[0])
    if told:
        return tuple(text for _, text in told)
    return (f"no centre differs by {LEAST_MM:g} mm, no axis by {LEAST_DEG:g} deg, no mass by {LEAST_SHARE:.0%}",)


def _told(rows: Mapping[str, ComparisonRow]) -> Iterator[tuple[float, str]]:
    """How much each difference matters, and its sentence."""

    def of_both(quantity: str, least: float, *, mirrored: bool = False) -> tuple[float, str] | None:
        """Mean of theirs - ours of both sides, a left side as it would be on the right, and what each side has."""
        found = {side: rows.get(quantity.format(s=side)) for side in SIDES}
        sides = {
            side: -row.difference if mirrored and side == "l" else row.difference
            for side, row in found.items()
            if row is not None
        }
        mean = sum(sides.values()) / len(sides) if sides else 0.0
        if abs(mean) < least:
            return None
        sign = 1.0 if mean > 0 else -1.0
        each = f" (right {sign * sides['r']:.0f}, left {sign * sides['l']:.0f})" if len(sides) == len(SIDES) else ""
        return mean, each

    for pattern, title in _POINTS.items():
        for direction, ways in _MM.items():
            if found := of_both(f"{pattern}, {direction}", LEAST_MM, mirrored=direction == "lat"):
                mean, each = found
                yield abs(mean) / LEAST_MM, f"their {title} lie {abs(mean):.0f} mm {ways[mean < 0]} ours{each}"
    for pattern, title in _TURNS.items():
        for direction, plane in _PLANES.items():
            if found := of_both(f"{pattern}, {direction}", LEAST_DEG, mirrored=direction != "sag"):
                mean, each = found
                text = f"their {title} are turned by {abs(mean):.0f} deg {plane} against ours{each}"
                yield abs(mean) / LEAST_DEG, text
    for pattern, title in _LENGTHS.items():
        if found := of_both(pattern, LEAST_MM):
            mean, each = found
            way = "longer" if mean > 0 else "shorter"
            yield abs(mean) / LEAST_MM, f"their {title} are {abs(mean):.0f} mm {way} than ours{each}"
    row = rows.get("total mass")
    if row is not None and abs(row.difference) >= LEAST_SHARE * row.ours:
        share = abs(row.difference) / max(row.ours, 1e-9) / LEAST_SHARE
        way = "more" if row.difference > 0 else "less"
        yield share, f"their body weighs {abs(row.difference):.1f} kg {way} than ours"
