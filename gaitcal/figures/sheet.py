"""A trial as the sheet of a result's page tells it (`page.json`), read back into what charts draw.

Curves of a sheet are packed as `page/packing.py` packs them: 16-bit integers k, value = low + step (k + 32767), with
-32768 where there is none; angles in deg, moments in N·m, powers in W.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.gait.cycles import FootEvents, GaitCycle, stances
from gaitcal.gait.strides import Layout
from gaitcal.model.coordinates import coordinate_words
from gaitcal.model.linkage import SIDES

GAP: Final = -32768
FULL: Final = 32767


def unpacked(packed: Mapping[str, Any]) -> Array:
    """(n,) values of a packed curve; NaN where there is none."""
    numbers = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").astype(np.float64)
    values: Array = packed["low"] + packed["step"] * (numbers + FULL)
    values[numbers == GAP] = np.nan
    return values


@dataclass(frozen=True)
class SheetCurve:
    """One variable of a trial, (nf,) each."""

    base: str
    side: str
    kind: str
    value: Array
    valid: BoolArray
    error: Array | None
    nominal: Array | None
    truth: Array | None

    @property
    def name(self) -> str:
        """`hip_flexion_r`."""
        return f"{self.base}_{self.side}" if self.side else self.base

    def masked(self, values: Array) -> Array:
        """`values` (nf,) with gaps where they do not count."""
        out: Array = np.where(self.valid, values, np.nan)
        return out


@dataclass(frozen=True)
class SheetRecording:
    """One trial of a sheet."""

    content: Mapping[str, Any]

    @property
    def name(self) -> str:
        """What it is called; data, not markup."""
        return str(self.content["name"])

    @property
    def isolated(self) -> bool:
        """Whether it shows one joint alone."""
        return self.content["joint"] is not None

    @cached_property
    def time(self) -> Array:
        """(nf,) s, in the clock of the recording, as files and `start` of a stride have it."""
        seconds = np.frombuffer(base64.b64decode(self.content["time"]), dtype="<f4").astype(np.float64)
        return np.asarray(seconds + float(self.content["start"]))

    @cached_property
    def curves(self) -> tuple[SheetCurve, ...]:
        """All of them."""
        masks = [np.frombuffer(base64.b64decode(mask), dtype="<u1") == 1 for mask in self.content["masks"]]

        def part(curve: Mapping[str, Any], key: str) -> Array | None:
            return None if curve[key] is None else unpacked(curve[key])

        return tuple(
            SheetCurve(
                curve["base"],
                curve["side"],
                curve["kind"],
                unpacked(curve["value"]),
                masks[curve["valid"]],
                *(part(curve, key) for key in ("se", "nominal", "truth")),
            )
            for curve in self.content["curves"]
        )

    def of(self, *kinds: str) -> list[SheetCurve]:
        """The curves of these kinds."""
        return [curve for curve in self.curves if curve.kind in kinds]

    @cached_property
    def layout(self) -> Layout:
        """Over the gait cycle where a foot has a complete one, else against time."""
        begin = float(self.content["start"])
        cycles: dict[str, tuple[GaitCycle, ...]] = {
            side: tuple(
                GaitCycle(begin + s["start"], begin + s["stop"], None if s["off"] is None else begin + s["off"])
                for s in self.content["strides"]
                if s["side"] == side and not s["turns"]
            )
            for side in SIDES
        }
        down = {side: stances(self._events(side), self.time) for side in SIDES}
        legs = np.stack([self._valid(side) for side in SIDES], axis=1)
        return Layout(self.time, self._valid(""), legs, down, cycles if any(cycles.values()) else {})

    def _events(self, side: str) -> FootEvents:
        """Kinds of events are told in words: `foot strike`, `foot off`."""
        begin = float(self.content["start"])
        strikes, offs = (
            np.array([begin + e["time"] for e in self.content["events"] if e["side"] == side and e["kind"].endswith(k)])
            for k in ("strike", "off")
        )
        return FootEvents(strikes, offs)

    def _valid(self, side: str) -> BoolArray:
        """(nf,) torques of a leg, or of the whole body, may be used; where there are none, angles."""
        for kind in ("moment", "angle"):
            for curve in self.of(kind):
                if curve.side == side and coordinate_words(curve.base).group != "arm":
                    return curve.valid
        return np.ones(len(self.time), dtype=bool)

    def limit(self) -> tuple[float, float] | None:
        """N and N·m: what is commonly asked of pelvis residuals, where a picture of the sheet draws it."""
        for block in _blocks(self.content.get("sections", {}).values()):
            limits = block.get("limits") or {}
            if "residual_force" in limits and "residual_moment" in limits:
                return float(limits["residual_force"]), float(limits["residual_moment"])
        return None


def _blocks(content: object) -> Iterator[Mapping[str, Any]]:
    """Every block, those inside others, too."""
    if isinstance(content, Mapping):
        if content.get("kind") == "curves":
            yield content
        content = list(content.values())
    if not isinstance(content, str | int | float | None):
        for part in content:  # type: ignore[attr-defined]
            yield from _blocks(part)
