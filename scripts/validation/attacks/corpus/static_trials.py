"""Attacks on the static trial."""

from __future__ import annotations

from scripts.validation.attacks.attack import Kind
from scripts.validation.attacks.corpus.words import EXCHANGED, MIRROR, MOVED, PERSON, POSE, STILL, Row, rows
from scripts.validation.attacks.markers import (
    displaced,
    exchanged,
    in_static,
    mirrored_cluster,
    removed,
    rotated_labels,
    sides_exchanged,
    slid,
    turned,
)
from scripts.validation.attacks.trajectories import (
    axes,
    cropped,
    knees_bending,
    knees_bent,
    noisy,
    of_marker,
    scaled,
    static_of,
)

LANDMARKS = (
    # landmark, segment that carries it, mm (forward, up, right), bases
    ("knee_lat_r", "thigh_r", (10, 0, 0), "subject01 synthetic p01"),
    ("knee_lat_r", "thigh_r", (20, 0, 0), "synthetic"),
    ("knee_lat_r", "thigh_r", (0, 30, 0), "subject01 multi"),
    ("knee_lat_l", "thigh_l", (30, 0, 0), "pig child uf3"),
    ("knee_lat_r", "thigh_r", (-40, 0, 0), "functional kad"),
    ("knee_med_r", "thigh_r", (40, 0, 0), "p01 subject01"),
    ("knee_med_l", "thigh_l", (0, 0, -30), "synthetic p18"),
    ("ankle_lat_r", "shank_r", (30, 0, 0), "child synthetic"),
    ("ankle_lat_l", "shank_l", (0, 40, 0), "p18 pig"),
    ("ankle_med_l", "shank_l", (0, 20, 0), "subject01"),
    ("ankle_med_r", "shank_r", (-30, 0, 0), "uf3"),
    ("asis_r", "pelvis", (0, 30, 0), "subject01 p18"),
    ("asis_l", "pelvis", (0, 0, 30), "pig synthetic"),
    ("asis_r", "pelvis", (40, 0, 0), "kad uf3"),
    ("asis_l", "pelvis", (0, -20, 0), "child"),
    ("sacrum", "pelvis", (0, 40, 0), "synthetic"),
    ("sacrum", "pelvis", (0, 0, 30), "uf3"),
    ("heel_r", "foot_r", (0, 30, 0), "subject01 kad"),
    ("toe_l", "foot_l", (-40, 0, 0), "synthetic pig"),
    ("toe_r", "foot_r", (0, 0, 30), "p01"),
    ("thigh_r[1]", "thigh_r", (0, 40, 0), "subject01 synthetic"),
    ("shank_l[0]", "shank_l", (30, 0, 0), "uf3 child"),
)
UNITS_WORDS = r"unit|millimet|\bmm\b|\bcm\b|inch|metres|tall"
JOINT_WORDS = {
    "knee": "knee",
    "ankle": "ankle|malleol",
    "asis": "asis|pelvi",
    "sacrum": "sacr|pelvi",
    "heel": "heel",
    "toe": "toe",
}


def landmark(key: str) -> str:
    """Words for a landmark: its labels, or the joint with its side."""
    name, _, side = key.rpartition("_")
    words = JOINT_WORDS.get((name or key).split("_")[0])
    if words is None:
        return f"{{{key}}}"
    side_word = {"r": "right", "l": "left"}.get(side)
    if side_word is None:
        return f"{{{key}}}|{words}"
    return f"{{{key}}}|({side_word}|both).*({words})|({words}).*({side_word}|both)"


def attacks() -> Row:
    """Every attack on a static trial."""
    row = rows(Kind.STATIC)
    knees = "knee|{knee_lat_r}|{knee_lat_l}"
    with_medial = "subject01 synthetic p01 p18 uf3 functional"
    yield from row(
        "medial knee labels left with right",
        with_medial,
        in_static(exchanged("knee_med_r", "knee_med_l")),
        knees,
        f"{EXCHANGED}|width|wide",
        quick="synthetic",
    )
    yield from row(
        "lateral knee labels left with right",
        "subject01 pig child",
        in_static(exchanged("knee_lat_r", "knee_lat_l")),
        knees,
        f"{EXCHANGED}|width|wide",
        quick="subject01",
    )
    yield from row(
        "both knee labels left with right",
        "subject01 synthetic p18",
        in_static(exchanged("knee_med_r", "knee_med_l"), exchanged("knee_lat_r", "knee_lat_l")),
        knees,
        EXCHANGED,
    )
    for side, bases in (("r", "subject01 synthetic p01 functional"), ("l", "uf3")):
        yield from row(
            f"knee medial with lateral, {side}",
            bases,
            in_static(exchanged(f"knee_med_{side}", f"knee_lat_{side}")),
            landmark(f"knee_med_{side}"),
            f"{EXCHANGED}|lateral|width",
        )
    yield from row(
        "ankle medial with lateral, r",
        "subject01 child p18",
        in_static(exchanged("ankle_med_r", "ankle_lat_r")),
        landmark("ankle_med_r"),
        f"{EXCHANGED}|lateral|width",
    )
    yield from row(
        "medial ankle labels left with right",
        "synthetic p01",
        in_static(exchanged("ankle_med_r", "ankle_med_l")),
        "ankle|{ankle_med_r}",
        f"{EXCHANGED}|width|wide",
    )
    yield from row(
        "knee with ankle label, l",
        "pig subject01",
        in_static(exchanged("knee_lat_l", "ankle_lat_l")),
        "{knee_lat_l}|{ankle_lat_l}|thigh|shank|knee",
        f"{EXCHANGED}|length|{MOVED}",
    )
    for key, segment, mm, bases in LANDMARKS:
        words = f"{key} {max(mm, key=abs):+d} mm {('forward', 'up', 'right')[[bool(x) for x in mm].index(True)]}"
        yield from row(words, bases, in_static(displaced(segment, key, mm)), landmark(key), MOVED)
    yield from row("of another person", "p01", static_of("p18"), "static", PERSON)
    yield from row("of another person", "p18", static_of("p01"), "static", PERSON)
    yield from row("of another person", "multi", static_of("kad"), "static", PERSON)
    yield from row("of another person", "kad", static_of("multi"), "static", PERSON)
    yield from row("x 1.03", "subject01 synthetic pig p01 uf3", in_static(scaled(1.03)), "static", f"{PERSON}|{MOVED}")
    yield from row("x 0.97", "subject01 synthetic child p18", in_static(scaled(0.97)), "static", f"{PERSON}|{MOVED}")
    yield from row("x 1.10", "subject01 pig", in_static(scaled(1.10)), "static", f"{PERSON}|{MOVED}")
    yield from row("in centimetres", "subject01", in_static(scaled(100.0)), UNITS_WORDS)
    yield from row("knees bent 30 deg", "subject01 synthetic pig p01", in_static(knees_bent(30.0)), "static|knee", POSE)
    yield from row("right knee bent 25 deg", "subject01 child", in_static(knees_bent(25.0, "r")), "right|knee", POSE)
    yield from row("going down and up", "subject01 synthetic", in_static(knees_bending(30.0)), "static|moves", STILL)
    yield from row(
        "z mirrored", "subject01 synthetic pig child", in_static(axes((0, 1, 2), (1, 1, -1))), MIRROR, quick="subject01"
    )
    yield from row(
        "y and z exchanged", "synthetic", in_static(axes((0, 2, 1))), "upright|vertical|axis|axes|lies|stand"
    )
    yield from row("facing the other way", "subject01 p01", in_static(axes((0, 1, 2), (-1, 1, -1))), "facing|direction")
    yield from row(
        "ASIS left with right",
        "subject01 synthetic pig child",
        in_static(exchanged("asis_r", "asis_l")),
        "asis|{asis_r}|pelvis|left|facing",
        f"{EXCHANGED}|{MIRROR}|backwards",
        quick="synthetic",
    )
    yield from row(
        "heel with toe, r",
        "subject01 synthetic pig p01",
        in_static(exchanged("heel_r", "toe_r")),
        "heel|toe|{heel_r}|{toe_r}|foot",
        f"{EXCHANGED}|backwards|heading|behind|direction",
        quick="synthetic",
    )
    yield from row(
        "heel with toe, both",
        "uf3",
        in_static(exchanged("heel_r", "toe_r"), exchanged("heel_l", "toe_l")),
        "heel|toe|foot|feet|facing",
        f"{EXCHANGED}|backwards|heading|behind|direction",
    )
    for name, bases in (("foot", "subject01 synthetic pig"), ("thigh", "subject01 uf3"), ("shank", "p01 child")):
        yield from row(
            f"{name} labels left with right",
            bases,
            in_static(sides_exchanged(name)),
            rf"{name}|leg|{{{name}_r}}|{{{name}_l}}",
            f"{EXCHANGED}|{MIRROR}",
        )
    yield from row(
        "all labels left with right",
        "subject01 child pig",
        in_static(sides_exchanged()),
        f"{EXCHANGED}|{MIRROR}|backwards|facing",
    )
    yield from row(
        "thigh labels one on",
        "subject01 synthetic p01",
        in_static(rotated_labels("thigh_r")),
        "thigh|{thigh_r}",
        f"{EXCHANGED}|{MOVED}",
    )
    yield from row(
        "thigh with shank marker",
        "synthetic uf3",
        in_static(exchanged("thigh_l[1]", "shank_l[1]")),
        "{thigh_l}|{shank_l}",
        f"{EXCHANGED}|{MOVED}",
        quick="synthetic",
    )
    yield from row(
        "thigh cluster slid 25 mm up",
        "subject01 p01",
        in_static(slid("thigh_l", (0, 25, 0))),
        "thigh|{thigh_l}|knee|hip",
        MOVED,
    )
    yield from row(
        "shank cluster turned 15 deg",
        "p18 synthetic",
        in_static(turned("shank_r", 15.0)),
        "shank|{shank_r}|knee|ankle",
        f"{MOVED}|turn",
    )
    yield from row(
        "thigh cluster mirrored",
        "uf3 subject01",
        in_static(mirrored_cluster("thigh_r")),
        "thigh|{thigh_r}",
        f"{EXCHANGED}|{MOVED}|handed",
    )
    yield from row(
        "no medial markers",
        "subject01 synthetic p01",
        in_static(removed("knee_med_r", "knee_med_l", "ankle_med_r", "ankle_med_l")),
        "medial|{knee_med_r}|{ankle_med_r}",
    )
    yield from row("no right knee marker", "subject01 pig", in_static(removed("knee_lat_r")), "{knee_lat_r}|knee")
    yield from row("no heel marker", "subject01", in_static(removed("heel_l")), "{heel_l}|heel")
    yield from row("three frames", "subject01 p18", in_static(cropped((0.0, 0.01))), "short|frames|seconds|length")
    yield from row("a tenth of it", "pig uf3", in_static(cropped((0.4, 0.5))), "short|frames|seconds|length")
    yield from row("noise of 10 mm", "subject01 pig", in_static(noisy(10.0)), "noise|still|scatter|jump|moves")
    yield from row(
        "knee 2 m away",
        "synthetic",
        in_static(of_marker("knee_lat_r", lambda x, t: x + [2.0, 0.0, 0.0])),
        landmark("knee_lat_r"),
    )
