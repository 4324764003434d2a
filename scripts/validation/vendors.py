"""Are our angles, moments and powers those of the laboratory's own program, and are frames valid where they should be?

    vendors [--only kad,multi,children,pig]

Recordings of four laboratories hold Plug-in Gait's angles, moments and powers beside the markers (`GAITCAL_DATA` names
their folder). Every walk goes through the nominal model of its static trial. The table says of each joint, over all
walks of a laboratory: RMS difference of the angles in degrees (raw, and without the mean difference of each walk and
leg), their correlation; RMS difference of the moments in N·m/kg in stance, over frames that are valid for the whole
body, for the leg, and for the leg alone ("new": a leg's frames that the whole body's rule leaves out); that of the
powers in W/kg. The vendor is no truth: it takes a force that a plate measures only in part for the whole. But frames
that are new may not be worse than others. Then the moments again, ours along the axes of our coordinates, of either
segment and of the joint coordinate system: Plug-in Gait tells them in the distal segment unless it is told otherwise.
Then, by the file's own foot strikes and offs: how many strides are valid throughout, by either rule, and how much of
the stances in which a plate carries the foot.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.joint_moments import VECTOR_FRAMES, MomentFrame
from gaitcal.model.linkage import SIDES
from scripts.validation.harness import matching, say
from scripts.validation.vendor_walks import (
    IN_FRAMES,
    LABS,
    QUANTITIES,
    UNITS,
    Quantity,
    Walk,
    sign_of,
    unit_of,
    walks_of,
)


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """One quantity of one laboratory."""

    quantity: Quantity
    sign: float
    """The vendor's is multiplied by it."""
    correlation: float
    rms: dict[str, float]
    """`raw` and `even` (without offset) of an angle; `whole`, `leg`, `new`, `swing too` of a moment or power."""
    frames: dict[str, int]
    """Of each."""


def agreement(
    quantity: Quantity, walks: Sequence[Walk], unit: str, frame: MomentFrame = MomentFrame.COORDINATES
) -> Agreement:
    """How near ours are to theirs over the walks of a laboratory, whose moments are in `unit`; ours in a frame."""
    pairs = {(w.name, side): w.pair(quantity, side, frame) for w in walks for side in SIDES}
    factor = {w.name: UNITS[unit](w.mass) if quantity.is_moment else 1.0 for w in walks}
    sign = sign_of(*(np.concatenate(values) for values in zip(*pairs.values(), strict=True)))
    parts: dict[str, list[Array]] = {}
    both: list[tuple[Array, Array]] = []
    for walk in walks:
        for foot, side in enumerate(SIDES):
            ours, theirs = pairs[walk.name, side]
            theirs = sign * factor[walk.name] * theirs
            known = np.isfinite(theirs)
            gap = ours - theirs
            for name, frames in _frames(quantity, walk, foot).items():
                chosen = gap[known & frames]
                even = chosen - chosen.mean() if name == "even" and len(chosen) else chosen
                parts.setdefault(name, []).append(even)
                if name in ("raw", "leg"):
                    both.append((ours[known & frames], theirs[known & frames]))
    one, other = (np.concatenate(values) for values in zip(*both, strict=True))
    rows = {name: np.concatenate(values) for name, values in parts.items()}
    return Agreement(
        quantity=quantity,
        sign=sign,
        correlation=float(np.corrcoef(one, other)[0, 1]) if len(one) > 1 else float("nan"),
        rms={name: float(np.sqrt(np.mean(v**2))) if len(v) else float("nan") for name, v in rows.items()},
        frames={name: len(values) for name, values in rows.items()},
    )


def unit_of_walks(walks: Sequence[Walk]) -> str:
    """The unit of a laboratory's moments, by the ankle's."""
    ankle = next(q for q in QUANTITIES if q.is_moment and q.ours == "ankle_angle")
    pairs = [walk.pair(ankle, side) for walk in walks for side in SIDES]
    return unit_of([ours for ours, _ in pairs], [theirs for _, theirs in pairs], walks[0].mass)


def _frames(quantity: Quantity, walk: Walk, foot: int) -> dict[str, BoolArray]:
    reactions = walk.reactions
    if not (quantity.is_moment or quantity.is_power):
        every = np.ones(len(reactions.valid), dtype=bool)
        return {"raw": every, "even": every}
    leg = reactions.valid_legs[:, foot] & reactions.loaded[:, foot]
    every = reactions.valid_legs[:, foot]
    return {"whole": leg & reactions.valid, "leg": leg, "new": leg & ~reactions.valid, "swing too": every}


SHARED = ("--only",)


@dataclass(frozen=True, kw_only=True)
class Counted:
    """Strides and stances of a laboratory by the file's events."""

    strides: int
    stepped: int
    """Of these, those whose stance a plate carries."""
    whole: int
    """Valid throughout, for the whole body."""
    leg: int
    """Valid throughout, for the leg."""
    stance: int
    """Frames of stances that a plate carries."""
    stance_whole: int
    stance_leg: int


def counted(walks: Sequence[Walk]) -> Counted:
    """Strides and stances of some walks."""
    strides = stepped = whole = leg = stance = stance_whole = stance_leg = 0
    for walk in walks:
        reactions = walk.reactions
        valid = {side: reactions.valid_legs[:, k] for k, side in enumerate(SIDES)}
        loaded = {side: reactions.loaded[:, k] for k, side in enumerate(SIDES)}
        for side, frames in walk.strides():
            strides += 1
            stepped += bool(loaded[side][frames].any())
            whole += bool(reactions.valid[frames].all())
            leg += bool(valid[side][frames].all())
        for side, frames in walk.stances():
            if loaded[side][frames].any():
                stance += int(frames.sum())
                stance_whole += int(reactions.valid[frames].sum())
                stance_leg += int(valid[side][frames].sum())
    return Counted(
        strides=strides,
        stepped=stepped,
        whole=whole,
        leg=leg,
        stance=stance,
        stance_whole=stance_whole,
        stance_leg=stance_leg,
    )


def report(lab: str, walks: Sequence[Walk]) -> list[str]:
    """The lines of one laboratory."""
    ankle = next(q for q in QUANTITIES if q.is_moment and q.ours == "ankle_angle")
    unit = unit_of_walks(walks)
    found = [agreement(quantity, walks, unit) for quantity in QUANTITIES]
    signs = "external" if next(a for a in found if a.quantity is ankle).sign > 0 else "internal, extension positive"
    lines = [f"{lab}: {len(walks)} walks; moments in {unit}, {signs}"]
    lines.append(f"  {'angle':24}{'sign':>5}{'raw deg':>10}{'even deg':>10}{'r':>8}")
    for a in (a for a in found if not (a.quantity.is_moment or a.quantity.is_power)):
        lines.append(
            f"  {a.quantity.words:24}{a.sign:5.0f}{a.rms['raw']:10.1f}{a.rms['even']:10.1f}{a.correlation:8.3f}"
        )
    lines.append(f"  {'moment, N·m/kg':24}{'sign':>5}{'whole':>10}{'leg':>10}{'new':>10}{'r':>8}   frames")
    for kind in ("moment", "power"):
        if kind == "power":
            lines.append(f"  {'power, W/kg':24}{'sign':>5}{'whole':>10}{'leg':>10}{'new':>10}{'r':>8}   frames")
        for a in (a for a in found if a.quantity.words.endswith(kind)):
            values = "".join(f"{a.rms[name]:10.3f}" for name in ("whole", "leg", "new"))
            frames = ", ".join(str(a.frames[name]) for name in ("whole", "leg", "new"))
            lines.append(f"  {a.quantity.words:24}{a.sign:5.0f}{values}{a.correlation:8.3f}   {frames}")
    lines += in_frames(walks, unit)
    c = counted(walks)
    by = "valid {} by the whole body's rule, {} by the leg's"
    strides, stances = by.format(c.whole, c.leg), by.format(c.stance_whole, c.stance_leg)
    lines.append(f"  strides by events: {c.strides}, {c.stepped} with a stance on a plate; throughout {strides}")
    lines.append(f"  frames of stances on a plate: {c.stance}; {stances}")
    return lines


def in_frames(walks: Sequence[Walk], unit: str) -> list[str]:
    """Moments of the leg's valid frames, ours along the axes of every frame: RMS difference (N·m/kg), correlation."""
    frames = (MomentFrame.COORDINATES, *VECTOR_FRAMES)
    lines = [f"  {'frame: RMS N·m/kg, r':24}" + "".join(f"{frame.key:>18}" for frame in frames)]
    for quantity in IN_FRAMES:
        cells = []
        for frame in frames:
            told = frame is not MomentFrame.COORDINATES or quantity in QUANTITIES
            a = agreement(quantity, walks, unit, frame) if told else None
            cells.append(f"{'':18}" if a is None else f"{a.rms['leg']:10.3f}{a.correlation:8.3f}")
        lines.append(f"  {quantity.words.removesuffix(' moment'):24}{''.join(cells)}")
    return lines


def add_options(parser: argparse.ArgumentParser) -> None:
    """None of its own."""


def run(chosen: argparse.Namespace) -> None:
    """Print the table of each laboratory."""
    for lab in matching(chosen.only, LABS):
        say(*report(lab, walks_of(lab)))
