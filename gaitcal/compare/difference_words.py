"""Differences between two sessions in words: `right knee flexion, largest in swing: 8.1 deg less ...`."""

from __future__ import annotations

from collections.abc import Sequence

from gaitcal.compare.difference import Difference
from gaitcal.compare.session import Common
from gaitcal.gait.variables import GROUND_REACTION, Kind, coordinate_of, kind_of
from gaitcal.gait.words import SIDE_WORDS, counted, parameter_words
from gaitcal.model.coordinates import coordinate_words

TOLD = 12
"""Variables that are told in words; the table has all."""
BY_CHANCE = 0.05
"""Of differences that are none, the part that exceeds a minimal detectable change of 95 %."""
_PARAMETERS = ("joint position", "joint orientation")


def lines_of(names: tuple[str, str], common: Common, found: Sequence[Difference]) -> tuple[str, ...]:
    """What differs, largest first: a sentence for each variable with the figure that is furthest beyond its error."""
    judged = [d for d in found if d.spread_known]
    legs = [d for d in judged if not d.beyond_legs]
    beyond = [d for d in legs if d.exceeds]
    lines = [f"{names[1]} against {names[0]}; {common.words}"]
    if not found:
        return (*lines, "nothing that both have can be compared")
    lines.append(
        f"{len(beyond)} of {counted(len(legs), 'difference')} exceed what these recordings could miss (95 %); "
        f"were none real, about {BY_CHANCE * len(legs):.0f} would"
    )
    told: dict[tuple[str, str], Difference] = {}
    for d in beyond:
        told.setdefault((d.side, d.name), d)
    lines += [f"{sentence(d)}{_others(d, beyond)}" for d in list(told.values())[:TOLD]]
    if len(told) > TOLD:
        lines.append(f"and {len(told) - TOLD} more variables: differences.csv")
    if upper := sum(d.exceeds and d.beyond_legs for d in judged):
        lines.append(
            f"{counted(upper, 'joint parameter')} of trunk and arms besides, whose error bars know nothing of a spine "
            "that bends and shoulders that slide: differences.csv"
        )
    if unknown := len(found) - len(judged):
        why = "one stride in each session does not tell how strides vary"
        lines.append(f"{counted(unknown, 'difference')} cannot be judged: {why}")
    return tuple(lines)


def sentence(d: Difference) -> str:
    """`right knee flexion, largest in swing: 8.1 deg less (52.3 against 60.4), 3.2 times what ... could miss`."""
    digits = 3 if d.unit == "m" or d.unit == "m/s" else 2 if d.unit == "s" else 1
    below = max(d.a, d.b) < 0.0  # of a negative moment, a larger number is less
    way = ("less negative" if below else "more") if d.difference > 0 else ("more negative" if below else "less")
    size = f"{abs(d.difference):.{digits}f} {d.unit} {way} ({d.b:.{digits}f} against {d.a:.{digits}f})"
    if d.mdc95 == 0.0:
        return f"{subject(d)}: {size}"
    return f"{subject(d)}: {size}, {d.times:.1f} times what these recordings could miss"


def subject(d: Difference) -> str:
    """`right knee flexion, largest in swing`; `left stance, % of the stride`; `right hip centre in the pelvis, up`."""
    side = f"{SIDE_WORDS[d.side]} " if d.side else ""
    if d.kind in _PARAMETERS:
        return f"{side}{parameter_words(d.name)}"
    if d.kind == "spatiotemporal":
        return f"{side}{d.name.removesuffix('_percent').replace('_', ' ')}"
    kind = kind_of(d.name)
    if d.name == GROUND_REACTION:
        return f"{side}vertical ground reaction, {d.measure}"
    coordinate = coordinate_of(d.name)
    words = coordinate_words(coordinate)
    title = words.title[:1].lower() + words.title[1:]
    title += {Kind.ANGLE: "", Kind.MOMENT: f" moment (+ {words.moment})", Kind.POWER: " power"}.get(kind, "")
    if coordinate.startswith(("pelvis", "lumbar")):
        return f"{title} in {side}strides, {d.measure}"
    return f"{side}{title}, {d.measure}"


def _others(d: Difference, beyond: Sequence[Difference]) -> str:
    """How many further figures of the same variable exceed."""
    same = sum((o.side, o.name) == (d.side, d.name) for o in beyond) - 1
    return f" ({same} more of its figures exceed)" if same else ""
