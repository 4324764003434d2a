"""Attacks on the labels of the walk."""

from __future__ import annotations

from scripts.validation.attacks.attack import Kind
from scripts.validation.attacks.corpus.words import EXCHANGED, MIRROR, MOVED, Row, rows
from scripts.validation.attacks.markers import WHOLE, exchanged, in_walk, rotated_labels, sides_exchanged


def attacks() -> Row:
    """Every exchange of labels in a walk."""
    row = rows(Kind.WALK)
    yield from row(
        "two thigh labels exchanged",
        "subject01 synthetic p01 uf3",
        in_walk(exchanged("thigh_r[0]", "thigh_r[1]")),
        "{thigh_r}",
        EXCHANGED,
        quick="subject01",
    )
    yield from row(
        "two thigh labels exchanged in a quarter",
        "subject01 synthetic p18",
        in_walk(exchanged("thigh_l[0]", "thigh_l[1]", (0.3, 0.55))),
        "{thigh_l}",
        EXCHANGED,
        quick="synthetic",
    )
    yield from row("shank labels one on", "synthetic uf3", in_walk(rotated_labels("shank_r")), "{shank_r}", EXCHANGED)
    yield from row(
        "thigh with shank marker, in part",
        "subject01 p01",
        in_walk(exchanged("thigh_r[1]", "shank_r[1]", (0.4, 0.6))),
        "{thigh_r}|{shank_r}",
        EXCHANGED,
    )
    yield from row(
        "thigh with shank marker",
        "synthetic child",
        in_walk(exchanged("thigh_l[1]", "shank_l[1]")),
        "{thigh_l}|{shank_l}",
        f"{EXCHANGED}|{MOVED}",
    )
    yield from row(
        "knee with ankle label, in part",
        "pig multi",
        in_walk(exchanged("knee_lat_r", "ankle_lat_r", (0.4, 0.6))),
        "{knee_lat_r}|{ankle_lat_r}",
        EXCHANGED,
    )
    yield from row(
        "heel with toe, r",
        "subject01 pig",
        in_walk(exchanged("heel_r", "toe_r")),
        "{heel_r}|{toe_r}|foot|feet",
        f"{EXCHANGED}|backwards|heading|{MOVED}",
    )
    yield from row(
        "left with right",
        "subject01 synthetic pig child",
        in_walk(sides_exchanged()),
        f"{EXCHANGED}|{MIRROR}|backwards|facing",
    )
    yield from row(
        "left with right, in part",
        "subject01 synthetic kad",
        in_walk(sides_exchanged("thigh", "shank", "foot", part=(0.4, 0.6))),
        f"{EXCHANGED}|{MIRROR}",
    )
    for name, part, bases in (
        ("foot", WHOLE, "subject01 pig"),
        ("thigh", WHOLE, "synthetic child"),
        ("thigh", (0.5, 0.7), "subject01 multi"),
        ("shank", (0.3, 0.6), "p01 uf3"),
    ):
        when = "" if part is WHOLE else ", in part"
        yield from row(
            f"{name} labels left with right{when}",
            bases,
            in_walk(sides_exchanged(name, part=part)),
            f"{{{name}_r}}|{{{name}_l}}|{name}",
            f"{EXCHANGED}|{MIRROR}",
        )
