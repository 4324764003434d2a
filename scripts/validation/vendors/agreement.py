"""How near one of our curves is to the vendor's, over the walks of a laboratory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.joint_kinetics import MomentFrame
from gaitcal.model.linkage import SIDES
from scripts.validation.vendors.curves import QUANTITIES, UNITS, Quantity, sign_of, unit_of
from scripts.validation.vendors.walks import Walk


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
