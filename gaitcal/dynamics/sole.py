"""The sole of a foot as cells of equal length, seen from above, and the part of it that lies beside force plates.

The sole begins a little before the heel marker, which sits on the back of the heel, and ends at the tip of the foot; it
is as wide as Winter (2009) gives the foot, less at heel and toes. A cell counts by its area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import RESTING, FootPoints
from gaitcal.dynamics.plate_outline import outside
from gaitcal.io.recording import ForcePlate

FOOT_BREADTH = 0.055
"""Of body height (Winter 2009)."""
HEEL_M = 0.015
"""From the middle of a marker on the back of the heel to where the sole meets the ground: half a marker, and the
rounding of the heel."""
SHAPE = ((0.0, 0.15, 0.35, 0.7, 0.9, 1.0), (0.4, 0.65, 0.65, 1.0, 0.85, 0.45))
"""How far from heel to tip, and how wide there, of the greatest width."""
LENGTHWISE, ACROSS = 15, 5
"""Cells."""
GAP_M = 0.01
"""Plates no further apart than this touch, and what lies as near to a plate is on it: markers tell no less."""


@dataclass(frozen=True, kw_only=True)
class SoleCells:
    """One foot in some frames."""

    cells: Array
    """(nf, n, 3) m, middles of the cells."""
    share: Array
    """(n,) of the sole's area; they sum to 1."""
    resting: BoolArray
    """(nf, n) the half of the sole to which a cell belongs is on the ground, as heel or toe moves with it."""
    rear: BoolArray
    """(n,) cells of the half that belongs to the heel; the others belong to the toes."""
    forward: Array
    """(nf, 2) unit vectors from heel to tip, x and z of the laboratory."""

    def beside(self, plates: Sequence[ForcePlate]) -> BoolArray:
        """(nf, n) cells beside all of these plates, which have corners; those that touch are one surface."""
        if not plates:
            return np.ones(self.cells.shape[:2], dtype=bool)
        away = outside(plates, self.cells.reshape(-1, 3)).reshape(self.cells.shape[:2])
        return np.asarray(away > GAP_M)

    def share_of(self, chosen: BoolArray) -> Array:
        """(nf,) share of the sole's area in the chosen cells (nf, n)."""
        out: Array = chosen @ self.share
        return out

    def share_of_halves(self, chosen: BoolArray) -> Array:
        """(nf, 2) share of the heel's half, and of the toes', in the chosen cells (nf, n).

        A heel is a small part of a sole, and bears the whole body where it alone rests.
        """
        halves = np.stack([self.rear, ~self.rear], axis=1) * self.share[:, None]
        out: Array = chosen @ (halves / halves.sum(axis=0))
        return out

    def offsets(self, point: Array) -> tuple[Array, Array]:
        """(nf, n) m along the foot and (nf, n) m across it, from points (nf, 3) to the cells, not negative."""
        apart = (self.cells - point[:, None])[:, :, [0, 2]]
        across = np.stack([-self.forward[:, 1], self.forward[:, 0]], axis=1)
        along, beside = (np.abs(np.einsum("fnk,fk->fn", apart, axis)) for axis in (self.forward, across))
        return along, beside


def sole_of(feet: FootPoints, foot: int, frames: slice) -> SoleCells:
    """The sole of a foot (0 right, 1 left)."""
    heel, tip = feet.heel[frames, foot], feet.tip[frames, foot]
    line = (tip - heel)[:, [0, 2]]
    length = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
    forward = line / length[:, None]
    part = (np.arange(LENGTHWISE) + 0.5) / LENGTHWISE
    width = feet.width * np.interp(part, *SHAPE)
    aside = (np.arange(ACROSS) + 0.5) / ACROSS - 0.5
    begin = np.minimum(HEEL_M, 0.5 * length)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    along, across = np.repeat(ahead, ACROSS, axis=1), np.outer(width, aside).ravel()
    cells = np.empty((len(heel), LENGTHWISE * ACROSS, 3))
    cells[:, :, 0] = heel[:, None, 0] + along * forward[:, None, 0] - across * forward[:, None, 1]
    cells[:, :, 2] = heel[:, None, 2] + along * forward[:, None, 1] + across * forward[:, None, 0]
    cells[:, :, 1] = heel[:, None, 1] + along / length[:, None] * (tip - heel)[:, None, 1]
    area = np.repeat(np.interp(part, *SHAPE), ACROSS)
    rear = np.repeat(part < 0.5, ACROSS)
    heel_rests, toe_rests = (speed[frames, foot] < RESTING for speed in (feet.heel_speed, feet.toe_speed))
    resting = np.where(rear, heel_rests[:, None], toe_rests[:, None])
    return SoleCells(cells=cells, share=area / area.sum(), resting=resting, rear=rear, forward=forward)
