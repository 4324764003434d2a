"""Ground reactions in tables: which columns are which plate's, in all the ways in which programs spell their names.

A name is taken apart into what it measures (force, point, moment), its axis, and the rest, which says which plate:

    ground_force_vx   1_ground_force_px   ground_torque_x   1_ground_torque_y
    ground_force_r_vx   ground_force_1_pz   ground_moment_1_mx   R_ground_force_vx   FP1_fx   1_cop_x   left_grf_y
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.recording.force_plate import TURNED_ROUND, UP, pushes_down, turned_round
from gaitcal.recording.recording import ForcePlate

NAME = re.compile(r"(?P<rest>.+?)_?(?P<letter>(?<=_)[vfpmt])?_?(?P<axis>[xyz])", re.IGNORECASE)
LETTERS = {"v": "force", "f": "force", "p": "point", "m": "moment", "t": "moment"}
WORDS = {"force": "force", "grf": "force", "point": "point", "cop": "point", "torque": "moment", "moment": "moment"}
FILLERS = frozenset(["ground", "reaction"])


@dataclass(frozen=True)
class Forces:
    """Ground reactions of one trial from a file of their own."""

    source: str
    plates: tuple[ForcePlate, ...]
    notes: tuple[str, ...] = ()


@dataclass
class PlateColumns:
    """Where the nine columns of one plate stand in a table."""

    columns: dict[str, dict[int, int]] = field(default_factory=lambda: {"force": {}, "point": {}, "moment": {}})
    """Quantity -> axis 0..2 -> column."""
    names: list[str] = field(default_factory=list)

    def take(self, quantity: str, values: Array) -> Array | None:
        """(ns, 3) or None where the table has no such quantity."""
        columns = self.columns[quantity]
        return values[:, [columns[axis] for axis in range(3)]] if len(columns) == 3 else None


def find_plates(names: Sequence[str]) -> list[PlateColumns]:
    """The plates of a table with these column names, in order of first appearance; only those that have a force."""
    plates: dict[tuple[str, int], PlateColumns] = {}
    for column, name in enumerate(names):
        match = NAME.fullmatch(name.strip())
        if match is None:
            continue
        tokens = re.findall(r"[a-z]+|\d+", match["rest"].lower())
        words = [WORDS[token] for token in tokens if token in WORDS]
        letter = (match["letter"] or "").lower()
        quantity = LETTERS.get(letter) or (words[0] if words else None)
        if quantity is None:
            continue
        identity = "_".join(token for token in tokens if token not in WORDS and token not in FILLERS)
        axis = "xyz".index(match["axis"].lower())
        repeat = 0
        while axis in plates.setdefault((identity, repeat), PlateColumns()).columns[quantity]:
            repeat += 1
        plate = plates[identity, repeat]
        plate.columns[quantity][axis] = column
        plate.names.append(name)
    return [plate for plate in plates.values() if plate.columns["force"]]


def build_plate(
    name: str, time: Array, values: Array, found: PlateColumns, source: object
) -> tuple[ForcePlate, tuple[str, ...]]:
    """The plate of `found` columns in `values` (ns, columns), m, N, N·m, y up, and notes; InputError if incomplete.

    Rows without a force at either end of the table are not part of it.
    """
    for quantity, columns in found.columns.items():
        if columns and len(columns) < 3:
            axes = ", ".join("xyz"[axis] for axis in sorted(columns))
            raise InputError(
                f"found only {axes} of the {quantity} (among {', '.join(found.names)}); x, y and z are needed",
                source=source,
                field=f"plate {name}",
            )
    force = found.take("force", values)
    point = found.take("point", values)
    moment = found.take("moment", values)
    if force is None or point is None:
        raise InputError(
            f"no point of application among {', '.join(found.names)}; columns like ground_force_px are needed",
            source=source,
            field=f"plate {name}",
        )
    known = np.flatnonzero(np.isfinite(force).all(axis=1))
    if not len(known):
        raise InputError("its force columns hold no numbers", source=source, field=f"plate {name}")
    span = slice(int(known[0]), int(known[-1]) + 1)
    time, force, point = time[span], force[span], point[span]
    notes: tuple[str, ...] = ()
    if moment is None:
        moment = np.zeros_like(values[:, :3])
        notes += (f"Plate {name}: no moment columns; a free moment of zero was taken.",)
    moment = moment[span]
    idle = (force == 0).all(axis=1) & np.isnan(point).any(axis=1)
    if idle.any():
        point = np.where(idle[:, None], 0.0, point)
        moment = np.where(idle[:, None] & np.isnan(moment), 0.0, moment)
        notes += (f"Plate {name}: {int(idle.sum())} samples without force have no point; the origin was put there.",)
    plate = ForcePlate(name=name, time=time, force=force, point=point, moment=moment)
    if pushes_down(force, UP):
        plate = turned_round(plate)
        notes += (f"Plate {name}: {TURNED_ROUND}",)
    return plate, notes


def on_one_time(plates: tuple[ForcePlate, ...], target: Path) -> tuple[Array, Array]:
    """Times (ns,) of a table of all plates, and its values (ns, 9 * plates): force, point, moment of each.

    A plate that begins later or ends sooner than another has NaN there. InputError where plates are sampled at
    different times, as one table has one time column.
    """
    if not plates:
        raise InputError("there are no force plates to write", source=target)
    time = np.unique(np.concatenate([plate.time for plate in plates]))
    values = np.full((len(time), 9 * len(plates)), np.nan)
    for number, plate in enumerate(plates):
        rows = np.searchsorted(time, plate.time)
        if rows[-1] - rows[0] + 1 != len(rows):
            raise InputError("the plates are sampled at different times; a table needs the same for all", source=target)
        values[rows, 9 * number : 9 * number + 9] = np.hstack([plate.force, plate.point, plate.moment])
    return time, values
