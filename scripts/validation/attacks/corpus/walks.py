"""Attacks on the markers of the walk."""

from __future__ import annotations

from gaitcal import Study
from scripts.validation.attacks.attack import WALK, Kind, StudyChange, loaded, with_recording
from scripts.validation.attacks.corpus.words import (
    EXCHANGED,
    MIRROR,
    MOVED,
    PERSON,
    RATE,
    STUCK,
    TILT,
    UNITS,
    Row,
    rows,
)
from scripts.validation.attacks.markers import (
    WHOLE,
    displaced,
    in_moving,
    in_walk,
    mirrored_cluster,
    removed,
    slid,
    turned,
)
from scripts.validation.attacks.trajectories import (
    axes,
    backwards,
    delayed,
    drifting,
    frame_lost,
    frame_twice,
    frames_dropped,
    frozen,
    ghost,
    hardly_moving,
    interpolated,
    lost,
    low_passed,
    noisy,
    of_marker,
    other_rate,
    scaled,
    spline_filled,
    tilted,
)

HALF = (0.5, 1.0)
DISPLACED = (
    # marker, segment, mm (forward, up, right), part, bases
    ("heel_r", "foot_r", (0, 10, 0), WHOLE, "subject01 synthetic p01"),
    ("heel_r", "foot_r", (0, 25, 0), WHOLE, "subject01 synthetic pig"),
    ("heel_l", "foot_l", (0, 30, 0), HALF, "p01 child"),
    ("toe_l", "foot_l", (-20, 0, 0), WHOLE, "uf3 kad"),
    ("thigh_r[1]", "thigh_r", (0, 25, 0), WHOLE, "subject01 synthetic uf3"),
    ("thigh_l[0]", "thigh_l", (30, 0, 0), WHOLE, "pig multi p18"),
    ("thigh_r[1]", "thigh_r", (0, 30, 0), HALF, "subject01 synthetic"),
    ("thigh_r[2]", "thigh_r", (40, 0, 0), WHOLE, "p01"),
    ("knee_lat_r", "thigh_r", (30, 0, 0), HALF, "pig kad"),
    ("knee_lat_l", "thigh_l", (20, 0, 0), WHOLE, "child"),
    ("shank_r[0]", "shank_r", (0, 30, 0), WHOLE, "synthetic p01 child"),
    ("shank_l[1]", "shank_l", (25, 0, 0), HALF, "uf3 subject01"),
    ("asis_r", "pelvis", (0, 30, 0), WHOLE, "subject01 p18 synthetic"),
    ("asis_l", "pelvis", (0, -20, 0), HALF, "pig"),
    ("sacrum", "pelvis", (0, 30, 0), WHOLE, "subject01 uf3"),
)


def another_walk(base: str) -> StudyChange:
    """The walk of another person who wears the same marker set, forces and all."""

    def change(study: Study) -> Study:
        other = next(trial.recording for trial in loaded(base).trials if trial.name == WALK)
        return with_recording(study, WALK, other)

    return change


JOINTS_OF = {"thigh": "hip|knee", "shank": "knee|ankle", "foot": "ankle"}


def cluster(segment: str) -> str:
    """Words for the markers of a segment: it, its labels, or a joint at its ends, where the next segment may be it."""
    name, _, side = segment.partition("_")
    word = {"r": "right", "l": "left"}[side]
    return f"{segment}|{{{segment}}}|{word} ({name}|{JOINTS_OF[name]})"


def attacks() -> Row:
    """Every attack on a walk."""
    row = rows(Kind.WALK)
    for key, segment, mm, part, bases in DISPLACED:
        when = "" if part is WHOLE else ", from half on"
        words = f"{key} {max(mm, key=abs):+d} mm {('forward', 'up', 'right')[[bool(x) for x in mm].index(True)]}{when}"
        yield from row(words, bases, in_walk(displaced(segment, key, mm, part)), f"{{{key}}}", MOVED)
    for segment, bases in (("thigh_r", "subject01 synthetic p01"), ("shank_l", "uf3 p18"), ("foot_r", "subject01")):
        yield from row(
            f"{segment} cluster slid 20 mm up", bases, in_walk(slid(segment, (0, 20, 0))), cluster(segment), MOVED
        )
    for mm, bases in (
        ((0, 30, 0), "subject01 synthetic pig"),
        ((40, 0, 0), "synthetic kad"),
        ((0, 0, 30), "multi p01"),
    ):
        axis = ("forward", "up", "right")[[bool(x) for x in mm].index(True)]
        yield from row(
            f"pelvis markers slid {max(mm)} mm {axis}",
            bases,
            in_walk(slid("pelvis", mm)),
            "pelvi|{pelvis}|hip|thigh|trunk|lumbar",
            MOVED,
        )
    for segment, bases in (("thigh_r", "subject01 synthetic uf3 p18"), ("shank_l", "p01 child")):
        yield from row(
            f"{segment} cluster turned 12 deg", bases, in_walk(turned(segment, 12.0)), cluster(segment), f"{MOVED}|turn"
        )
    for segment, bases in (("thigh_r", "subject01 synthetic uf3"), ("shank_l", "subject01 p01")):
        yield from row(
            f"{segment} cluster mirrored",
            bases,
            in_walk(mirrored_cluster(segment)),
            cluster(segment),
            f"{EXCHANGED}|{MOVED}",
            quick="synthetic",
        )
    yield from row(
        "heel frozen for a fifth",
        "subject01 p01",
        in_walk(frozen("heel_r", (0.4, 0.6))),
        "{heel_r}",
        STUCK,
        quick="subject01",
    )
    yield from row(
        "thigh marker frozen from half on",
        "synthetic child",
        in_walk(frozen("thigh_r[1]", HALF)),
        "{thigh_r[1]}",
        STUCK,
    )
    yield from row("ASIS frozen", "pig", in_walk(frozen("asis_r", (0.2, 0.4))), "{asis_r}", STUCK)
    yield from row(
        "heel interpolated over a quarter",
        "subject01 synthetic pig p01",
        in_walk(interpolated("heel_r", (0.35, 0.6))),
        "{heel_r}",
        STUCK,
    )
    yield from row(
        "heel filled by a spline over a fifth",
        "subject01 p18",
        in_walk(spline_filled("heel_l", (0.4, 0.6))),
        "{heel_l}",
        f"{STUCK}|{MOVED}",
    )
    yield from row(
        "shank marker filled by a spline",
        "synthetic uf3",
        in_walk(spline_filled("shank_r[1]", (0.3, 0.5))),
        "{shank_r[1]}",
        f"{STUCK}|{MOVED}",
    )
    yield from row(
        "heel low-passed at 2 Hz",
        "subject01 synthetic",
        in_walk(low_passed("heel_r", 2.0)),
        "{heel_r}",
        "smooth|filter|slow|shape|off|mm",
    )
    yield from row(
        "all low-passed at 2 Hz",
        "subject01 synthetic p01",
        in_walk(*(low_passed(s, 2.0) for s in SEGMENTS)),
        "smooth|filter|bandwidth|slow|low-pass|Hz",
    )
    yield from row(
        "right foot 50 ms late",
        "subject01 synthetic pig",
        in_walk(delayed("foot_r", 0.05)),
        "foot|{foot_r}",
        rf"\blate\b|delay|\btime\b|clock|\bms\b|{MOVED}",
    )
    yield from row(
        "one thigh marker 40 ms late",
        "p01 uf3",
        in_walk(delayed("thigh_r[1]", 0.04)),
        "{thigh_r[1]}",
        rf"\blate\b|delay|\btime\b|clock|\bms\b|{MOVED}",
    )
    yield from row(
        "frames dropped",
        "subject01 synthetic pig child",
        in_walk(frames_dropped((0.45, 0.55))),
        r"jump|frames|\btime\b|clock|gap|missing|\blate\b|early",
    )
    for share, count, bases in (
        (0.5, 1, "subject01 synthetic pig kad multi child p01 uf3"),
        (0.3, 1, "subject01 synthetic p18"),
        (0.7, 2, "pig kad"),
    ):
        yield from row(
            f"{count} frame lost at {share:g}, times numbered on",
            bases,
            in_walk(frame_lost(share, count)),
            r"frame|clock|seam|jump|\btime\b|\blate\b|early",
        )
    yield from row(
        "one frame twice",
        "subject01 synthetic kad multi",
        in_walk(frame_twice(0.5)),
        r"frame|clock|seam|jump|\btime\b|twice|frozen|repeat",
    )
    for factor, bases in ((2.0, "subject01 synthetic pig uf3"), (0.5, "p01")):
        yield from row(f"{factor:g} times the frame rate in the header", bases, in_walk(other_rate(factor)), RATE)
    for word, factor, bases in (
        ("millimetres", 1000.0, "subject01"),
        ("centimetres", 100.0, "pig"),
        ("inches", 39.37, "synthetic"),
        ("mm taken as m", 0.001, "p01"),
    ):
        yield from row(word, bases, in_walk(scaled(factor)), UNITS, quick="subject01" if factor == 1000 else "")
    for factor, bases in ((1.03, "subject01 synthetic pig"), (0.95, "uf3 p01"), (1.10, "subject01")):
        yield from row(f"x {factor:g}", bases, in_walk(scaled(factor)), "walk|static", PERSON)
    yield from row("another person's walk", "p01", another_walk("p18"), "walk|static", PERSON)
    yield from row("another person's walk", "kad", another_walk("multi"), "walk|static", PERSON)
    yield from row(
        "y and z exchanged", "subject01 pig", in_walk(axes((0, 2, 1))), "upright|vertical|axis|axes|lies|stand"
    )
    yield from row("z mirrored", "subject01 synthetic pig", in_walk(axes((0, 1, 2), (1, 1, -1))), MIRROR)
    yield from row("x mirrored", "uf3 p18", in_walk(axes((0, 1, 2), (-1, 1, 1))), f"{MIRROR}|backwards")
    yield from row(
        "turned round, forces not",
        "subject01 p01",
        in_walk(axes((0, 1, 2), (-1, 1, -1))),
        "plate|force",
        "beside|turned|axes|foot|yaw|no foot|place",
    )
    yield from row("turned round, no forces", "uf3", in_walk(axes((0, 1, 2), (-1, 1, -1))), "direction|facing")
    yield from row("z mirrored in every moving trial", "uf3 synthetic", in_moving(axes((0, 1, 2), (1, 1, -1))), MIRROR)
    yield from row(
        "thigh marker 2 m away",
        "subject01 synthetic child",
        in_walk(of_marker("thigh_r[0]", lambda x, t: x + [0.0, 2.0, 0.0])),
        "{thigh_r[0]}",
        f"{MOVED}| m ",
        quick="subject01",
    )
    yield from row(
        "ASIS 1 m away for a while",
        "p01 pig",
        in_walk(of_marker("asis_l", lambda x, t: x + [1.0, 0.0, 0.0], (0.5, 0.6))),
        "{asis_l}",
        f"{MOVED}| m ",
    )
    yield from row(
        "heel ghost 100 mm off for a tenth",
        "subject01 pig",
        in_walk(ghost("heel_r", (0, 100, 60), (0.5, 0.6))),
        "{heel_r}",
        f"{STUCK}|{MOVED}",
    )
    yield from row(
        "shank ghost 60 mm off",
        "synthetic p18",
        in_walk(ghost("shank_l[1]", (60, 0, 0), (0.2, 0.3))),
        "{shank_l[1]}",
        f"{STUCK}|{MOVED}",
    )
    yield from row("noise of 20 mm", "subject01 pig", in_walk(noisy(20.0)), "noise|scatter|jump|out of line")
    yield from row(
        "one marker with noise of 20 mm",
        "p01 synthetic",
        in_walk(noisy(20.0, "shank_r[0]")),
        "{shank_r[0]}",
        "noise|scatter|jump|out of line|mm",
    )
    yield from row(
        "thigh marker creeping 40 mm",
        "subject01 synthetic",
        in_walk(drifting("thigh_r[1]", (0, -40, 0))),
        "{thigh_r[1]}",
        f"drift|creep|{MOVED}",
    )
    yield from row(
        "shank marker creeping 30 mm",
        "uf3 p18",
        in_walk(drifting("shank_l[0]", (0, -30, 0))),
        "{shank_l[0]}",
        f"drift|creep|{MOVED}",
    )
    yield from row("no heel", "subject01 synthetic", in_walk(removed("heel_r")), "{heel_r}")
    yield from row(
        "one thigh marker lost for half", "synthetic p01", in_walk(lost("thigh_r[0]", HALF)), "{thigh_r[0]}|thigh"
    )
    yield from row(
        "pelvis not seen for a third", "pig subject01", in_walk(lost("pelvis", (0.3, 0.6))), "pelvis|{asis_r}"
    )
    yield from row("thigh not seen at all", "p01 subject01", in_walk(lost("thigh_l", WHOLE)), "thigh|{thigh_l}")
    yield from row("backwards in time", "subject01 uf3", in_walk(backwards), r"backwards|direction|\btime\b")
    yield from row("tilted 5 deg against the plates", "subject01 synthetic", in_walk(tilted(5.0)), f"{TILT}|beside")
    yield from row("hardly moving", "subject01 uf3", in_walk(hardly_moving(0.02)), "walk", "still|mov|stand|step|speed")
    yield from row("facing away: walks backwards", "pig", in_walk(backwards), r"backwards|direction|\btime\b|clock")


SEGMENTS = ("pelvis", *(f"{segment}_{side}" for segment in ("thigh", "shank", "foot") for side in "rl"), "head_trunk")
