"""Attacks on ground reactions."""

from __future__ import annotations

from scripts.validation.attacks import plates as p
from scripts.validation.attacks.attack import Kind
from scripts.validation.attacks.corpus.words import (
    CLIPPED,
    CLOCK,
    CROSSED,
    ELSEWHERE,
    FOOT,
    FREE,
    GAIN,
    NOTHING,
    OFFSET,
    PLACE,
    POINT,
    SIGN,
    SMOOTH,
    TILT,
    UNMEASURED,
    YAW,
    Row,
    rows,
)

AXES = ("forward", "vertical", "sideways")
KGF, LBF = 1.0 / 9.80665, 1.0 / 4.4482216
SIGN_WORDS = rf"{SIGN}|axes|turned"


def attacks() -> Row:
    """Every attack on forces."""
    row = rows(Kind.FORCES)
    for axis, bases in ((0, "subject01 synthetic p01"), (1, "subject01 synthetic"), (2, "subject01 synthetic pig")):
        yield from row(f"{AXES[axis]} force of wrong sign", bases, p.plates(p.signed(axis)), SIGN_WORDS)
    for axis, bases in ((0, "synthetic multi"), (2, "subject01 p18")):
        yield from row(f"{AXES[axis]} channel of wrong sign", bases, p.plates(p.channel_signed(axis)), SIGN_WORDS)
    yield from row(
        "moment channel about x of wrong sign",
        "synthetic child",
        p.plates(p.channel_signed(3)),
        f"{SIGN_WORDS}|{POINT}",
    )
    yield from row("forward force of one plate of wrong sign", "subject01", p.plates(p.signed(0), 1), SIGN_WORDS)
    for factor, bases in (
        (0.5, "subject01 synthetic pig"),
        (0.9, "subject01 synthetic"),
        (1.1, "subject01 p01"),
        (1.2, "synthetic child"),
        (2.0, "subject01 pig"),
    ):
        yield from row(
            f"gain {factor:g}", bases, p.plates(p.gain(factor)), GAIN, quick="subject01" if factor == 0.5 else ""
        )
    yield from row("gain 1.3 of one plate", "subject01 synthetic p18", p.plates(p.gain(1.3), 1), GAIN)
    yield from row("gain 0.7 of the forward force", "subject01 synthetic", p.plates(p.axis_gain(0, 0.7)), GAIN)
    yield from row("kgf", "subject01 synthetic child", p.plates(p.gain(KGF)), f"{GAIN}|kgf|kilogram", quick="synthetic")
    yield from row("lbf", "subject01 multi", p.plates(p.gain(LBF)), f"{GAIN}|lbf|pound")
    yield from row("kN", "p01", p.plates(p.gain(0.001)), f"{GAIN}|kN|{NOTHING}")
    yield from row("free moment in N·mm", "subject01 synthetic pig", p.plates(p.free_moment(1000.0)), FREE)
    yield from row(
        "free moment of wrong sign",
        "subject01 synthetic p01 pig kad multi child p18",
        p.plates(p.free_moment(-1.0)),
        FREE,
    )
    for ms, bases in (
        (20, "subject01 synthetic"),
        (-20, "p01"),
        (50, "subject01 synthetic pig p01"),
        (-50, "subject01 child"),
        (100, "subject01 multi"),
        (-100, "synthetic p18"),
    ):
        yield from row(f"{ms:+d} ms", bases, p.plates(p.late(1e-3 * ms)), CLOCK)
    yield from row("clock 5 % fast", "subject01 synthetic", p.plates(p.other_clock(1.05)), CLOCK)
    for mm, bases in (
        ((10, 0, 0), "subject01 synthetic"),
        ((20, 0, 0), "subject01 p01 kad"),
        ((0, 0, 20), "synthetic subject01 pig"),
        ((-30, 0, 0), "kad p18"),
        ((0, 0, 30), "child multi"),
        ((40, 0, 0), "subject01 synthetic pig"),
        ((0, 0, -40), "p01 p18"),
        ((80, 0, 0), "subject01 child"),
        ((0, 0, 80), "synthetic multi"),
    ):
        yield from row(f"plates shifted {mm[0]} mm in x, {mm[2]} in z", bases, p.plates(p.moved(mm)), PLACE)
    yield from row("one plate shifted 40 mm in x", "subject01 synthetic", p.plates(p.moved((40, 0, 0)), 1), PLACE)
    yield from row(
        "plates 50 mm too high", "subject01 pig", p.plates(p.moved((0, 50, 0))), f"{PLACE}|high|height|level"
    )
    for degrees, bases in (
        (2.0, "kad pig"),
        (5.0, "subject01 synthetic kad multi child p01"),
        (90.0, "subject01 synthetic pig"),
        (180.0, "subject01 p01"),
    ):
        yield from row(f"plates turned {degrees:g} deg about the vertical", bases, p.plates(p.turned(degrees)), YAW)
    yield from row("one plate turned 5 deg about the vertical", "pig p18", p.plates(p.turned(5.0), 1), YAW)
    yield from row("room of the plates turned 3 deg", "subject01 multi", p.room_turned(3.0, "y"), f"{YAW}|{PLACE}")
    yield from row("one plate turned 180 deg", "synthetic child", p.plates(p.turned(180.0), 1), f"{YAW}|{POINT}")
    yield from row("plates tilted 5 deg", "subject01 synthetic", p.plates(p.turned(5.0, "x")), TILT)
    yield from row("room of the plates tilted 5 deg", "p01 synthetic", p.room_turned(5.0, "z"), TILT)
    yield from row(
        "forward and sideways force exchanged", "subject01 synthetic", p.plates(p.axes_exchanged), f"exchang|swap|{YAW}"
    )
    yield from row("cables exchanged", "subject01 synthetic pig", p.cables_exchanged, f"{CROSSED}|{POINT}")
    yield from row("centres of pressure exchanged", "subject01 p18", p.points_exchanged, f"{CROSSED}|{POINT}")
    yield from row(
        "feet declared the wrong way round", "subject01 synthetic p01", p.assigned({"1": "l", "2": "r"}), FOOT
    )
    yield from row("first plate declared as no foot's", "subject01 synthetic", p.assigned({"1": "none"}), "plate|foot")
    yield from row("offset 20 N", "subject01 pig", p.plates(p.offset((0, 20, 0))), OFFSET)
    yield from row("offset 50 N", "subject01 synthetic", p.plates(p.offset((0, 50, 0))), OFFSET)
    yield from row("sideways offset 30 N", "synthetic p01", p.plates(p.offset((0, 0, 30))), OFFSET)
    yield from row("drift of 60 N", "subject01 synthetic", p.plates(p.drifting(60.0)), f"drift|{OFFSET}")
    yield from row(
        "saturated at 80 %", "subject01 synthetic child", p.plates(p.saturated(0.8)), CLIPPED, quick="subject01"
    )
    yield from row("low-passed at 5 Hz", "subject01 synthetic pig", p.plates(p.low_passed(5.0)), SMOOTH)
    yield from row(
        "centre of pressure in mm", "subject01 p01", p.plates(p.points_scaled(1000.0)), POINT, quick="subject01"
    )
    yield from row("centre of pressure in cm", "synthetic", p.plates(p.points_scaled(100.0)), POINT)
    yield from row("centre of pressure held", "subject01 synthetic", p.plates(p.points_held), f"{POINT}|constant|held")
    yield from row("zeros", "subject01 synthetic pig", p.plates(p.empty), NOTHING, quick="synthetic")
    yield from row("of another person's walk", "p01", p.of_another_walk("p18"), ELSEWHERE)
    yield from row("of another person's walk", "subject01", p.of_another_walk("p01"), ELSEWHERE)
    yield from row("without the second plate", "subject01 synthetic pig", p.missing(2), UNMEASURED)
    yield from row(
        "a fifth of each contact cut out", "subject01 synthetic pig", p.plates(p.cut((0.4, 0.6))), UNMEASURED
    )
    yield from row("the end of each contact cut off", "subject01 synthetic", p.plates(p.cut((0.75, 1.0))), UNMEASURED)
    yield from row(
        "forward channel dead",
        "subject01 synthetic",
        p.plates(p.dead_channel(0)),
        "zero|dead|constant|no forward|forward force|horizontal",
    )
