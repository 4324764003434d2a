"""What an OpenSim model differs in from ours, in words: `their hip centres lie 42 mm behind ours (right 41, left 43)`.

Both sides are told together, by their mean; lateral differences and turns of the left side are mirrored first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gaitcal.compare.comparison import ComparisonRow
from gaitcal.model.linkage import SIDES

LEAST_MM, LEAST_DEG, LEAST_SHARE = 5.0, 3.0, 0.02
"""Differences that are worth a word: landmarks are not palpated nearer than this; of masses, the part of ours."""
_MM = {"ant": ("in front of", "behind"), "sup": ("above", "below"), "lat": ("further out than", "further in than")}
_POINTS = {
    "hip_{s} centre in pelvis": "hip centres",
    "knee_{s} axis in thigh_{s}": "knee axes, in the thigh,",
    "talocrural_{s} axis in shank_{s}": "ankle axes",
}
_TURNS = {
    "knee_{s} axis in thigh_{s}": "knee axes",
    "talocrural_{s} axis in shank_{s}": "ankle axes",
    "subtalar_{s} axis in foot_{s}": "subtalar axes",
}
_TURN_WORDS = {"front": "in the frontal plane", "trans": "in the transverse plane", "sag": "in the sagittal plane"}
_LENGTHS = {
    "thigh_{s} length, hip centre to knee centre": "thighs",
    "shank_{s} length, knee centre to talocrural centre": "shanks",
}


@dataclass(frozen=True)
class _Told:
    """One sentence, and how much it matters."""

    weight: float
    text: str


def osim_words(rows: Sequence[ComparisonRow]) -> tuple[str, ...]:
    """Sentences on what differs, the largest first; one that says so where nothing does."""
    apart = {row.quantity: row for row in rows}
    told = sorted([*_points(apart), *_turns(apart), *_lengths(apart), *_masses(apart)], key=lambda t: -t.weight)
    if told:
        return tuple(t.text for t in told)
    return (f"no centre differs by {LEAST_MM:g} mm, no axis by {LEAST_DEG:g} deg, no mass by {LEAST_SHARE:.0%}",)


def _points(apart: dict[str, ComparisonRow]) -> Iterator[_Told]:
    for pattern, title in _POINTS.items():
        for direction, (more, less) in _MM.items():
            sides = _of_sides(apart, f"{pattern}, {direction}", mirrored=direction == "lat")
            if sides and abs(mean := sum(sides.values()) / len(sides)) >= LEAST_MM:
                way = more if mean > 0 else less
                yield _Told(
                    abs(mean) / LEAST_MM, f"their {title} lie {abs(mean):.0f} mm {way} ours{_each(sides, mean)}"
                )


def _turns(apart: dict[str, ComparisonRow]) -> Iterator[_Told]:
    for pattern, title in _TURNS.items():
        for direction, plane in _TURN_WORDS.items():
            sides = _of_sides(apart, f"{pattern}, {direction}", mirrored=direction != "sag")
            if sides and abs(mean := sum(sides.values()) / len(sides)) >= LEAST_DEG:
                text = f"their {title} are turned by {abs(mean):.0f} deg {plane} against ours{_each(sides, mean)}"
                yield _Told(abs(mean) / LEAST_DEG, text)


def _lengths(apart: dict[str, ComparisonRow]) -> Iterator[_Told]:
    for pattern, title in _LENGTHS.items():
        sides = _of_sides(apart, pattern, mirrored=False)
        if sides and abs(mean := sum(sides.values()) / len(sides)) >= LEAST_MM:
            way = "longer" if mean > 0 else "shorter"
            yield _Told(
                abs(mean) / LEAST_MM, f"their {title} are {abs(mean):.0f} mm {way} than ours{_each(sides, mean)}"
            )


def _masses(apart: dict[str, ComparisonRow]) -> Iterator[_Told]:
    row = apart.get("total mass")
    if row is not None and abs(row.difference) >= LEAST_SHARE * row.ours:
        way = "more" if row.difference > 0 else "less"
        share = abs(row.difference) / max(row.ours, 1e-9) / LEAST_SHARE
        yield _Told(share, f"their body weighs {abs(row.difference):.1f} kg {way} than ours")


def _of_sides(apart: dict[str, ComparisonRow], pattern: str, *, mirrored: bool) -> dict[str, float]:
    """Side -> theirs - ours, of a left side as it would be on the right."""
    found = {side: apart.get(pattern.format(s=side)) for side in SIDES}
    return {
        side: -row.difference if mirrored and side == "l" else row.difference
        for side, row in found.items()
        if row is not None
    }


def _each(sides: dict[str, float], mean: float) -> str:
    """` (right 41, left 43)`; with a sign where the sides differ in it; nothing for one side."""
    if len(sides) < 2:
        return ""
    sign = 1.0 if mean > 0 else -1.0
    return f" (right {sign * sides['r']:.0f}, left {sign * sides['l']:.0f})"
