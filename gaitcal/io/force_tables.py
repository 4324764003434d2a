"""Ground reactions in tables: which columns are which plate's, in all the ways in which programs
spell their names.

A name is taken apart into what it measures (force, point, moment), its axis, and the rest, which
says which plate:

    ground_force_vx   1_ground_force_px   ground_torque_x   1_ground_torque_y
    ground_force_r_vx   ground_force_1_pz   ground_moment_1_mx   R_ground_force_vx   FP1_fx   1_cop_x   left_grf_y
    ground_force_calcn_r_vx   Fx1   COPx_1   ground_force_vx_r   F1X   M1Z

Where all that is given of a moment is its vertical part, it is the free moment.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code
from gaitcal.io.axes import AXES, UP_TO_Y, Turn, force_axis, turn_plate
from gaitcal.io.force_plate import TURNED_ROUND, UP, pushes_down, turned_round
from gaitcal.io.recording import ForcePlate
from gaitcal.io.text_file import FileFault

NAME = re.compile(r"(?P<rest>.+?)_?(?P<letter>(?<=_)[vfpmt])?_?(?P<axis>[xyz])", re.IGNORECASE)
LETTERS = {"v": "force", "f": "force", "p": "point", "m": "moment", "t": "moment"}
WORDS = {
    "force": "force",
    "grf": "force",
    "point": "point",
    "cop": "point",
    "torque": "moment",
    "moment": "moment",
}
FIRST = {"f": "force", "p": "point", "m": "moment", "t": "moment"}  # Of F1X and the like
SUFFIX = re.compile(
    r"(?P<rest>.+[xyz])_?(?P<plate>\d+|(?<=_)[rl]|(?<=_)right|(?<=_)left)", re.IGNORECASE
)
"""Names that end with their plate: Fx1, COPx_1, ground_force_vx_r."""
FILLERS = frozenset(["ground", "reaction"])


@dataclass(frozen=True)
class Forces:
    """Ground reactions of one trial from a file of their own."""

    source: str
    plates: tuple[ForcePlate, ...]
    notes: tuple[str, ...] = ()
    turn: Turn = UP_TO_Y[1, 1]  # From the axes of the file to ours
    feet: Mapping[str, str] = field(default_factory=dict)
    """Plate -> "r" or "l", where the file says on which foot it acts."""


@dataclass
class PlateColumns:
    """Where the nine columns of one plate stand in a table."""

    columns: dict[str, dict[int, int]] = field(
        default_factory=lambda: {"force": {}, "point": {}, "moment": {}}
    )
    """Quantity -> axis 0..2 -> column."""
    names: list[str] = field(default_factory=list)

    def take(self, quantity: str, values: Array) -> Array | None:
        """(ns, 3) or None where the table has no such quantity."""
        columns = self.columns[quantity]
        return values[:, [columns[axis] for axis in range(3)]] if len(columns) == 3 else None


def find_plates(names: Sequence[str]) -> list[PlateColumns]:
    """The plates of a table with these column names, in order of first appearance; only those that
    have a force.
    """
    plates: dict[tuple[str, int], PlateColumns] = {}
    for column, name in enumerate(names):
        meaning = _meaning(name.strip())
        if meaning is None:
            continue
        quantity, axis, identity = meaning
        repeat = 0
        while axis in plates.setdefault((identity, repeat), PlateColumns()).columns[quantity]:
            repeat += 1
        plate = plates[identity, repeat]
        plate.columns[quantity][axis] = column
        plate.names.append(name)
    return [plate for plate in plates.values() if plate.columns["force"]]


def _meaning(name: str) -> tuple[str, int, str] | None:
    """What a column measures, along which axis 0..2, and of which plate; None where it says none of
    that.
    """
    moved = SUFFIX.fullmatch(name)
    for spelling in (name, f"_{name}", f"{moved['plate']}_{moved['rest']}" if moved else name):
        match = NAME.fullmatch(spelling)
        if match is None:
            continue
        tokens = re.findall(r"[a-z]+|\d+", match["rest"].lower())
        words = [WORDS[token] for token in tokens if token in WORDS]
        if not words and not match["letter"] and tokens and tokens[0] in FIRST:
            words, tokens = [FIRST[tokens[0]]], tokens[1:]
        quantity = LETTERS.get((match["letter"] or "").lower()) or (words[0] if words else None)
        if quantity is not None:
            identity = "_".join(
                token for token in tokens if token not in WORDS and token not in FILLERS
            )
            return quantity, "xyz".index(match["axis"].lower()), identity
    return None


def build_plate(
    name: str, time: Array, values: Array, found: PlateColumns
) -> tuple[ForcePlate, tuple[str, ...]]:
    """The plate of `found` columns in `values` (ns, columns), m, N, N·m, and notes; FileFault if
    incomplete.

    Rows without a force at either end of the table are not part of it.
    """
    field, names = f"plate {name}", ", ".join(found.names)
    force, point, moment = (
        found.take(quantity, values) for quantity in ("force", "point", "moment")
    )
    free = found.columns["moment"]
    vertical = None
    if force is not None and len(free) == 1:
        zero = np.zeros_like(force)
        loads = ForcePlate(
            name=name, time=time, force=np.nan_to_num(force), point=zero, moment=zero
        )
        vertical = force_axis([loads])
        if vertical in free:
            moment = np.zeros((len(values), 3))
            moment[:, vertical] = values[:, free[vertical]]
    for quantity, columns in found.columns.items():
        if columns and len(columns) < 3 and (quantity != "moment" or moment is None):
            axes = ", ".join("xyz"[axis] for axis in sorted(columns))
            raise FileFault(
                f"found only {axes} of the {quantity} (among {names}); x, y and z are needed", field
            )
    if force is None or point is None:
        raise FileFault(
            f"no point of application among {names}; columns like ground_force_px are needed", field
        )
    known = np.flatnonzero(np.isfinite(force).all(axis=1))
    if not len(known):
        raise FileFault("its force columns hold no numbers", field, Code.BAD_NUMBER)
    notes: tuple[str, ...] = ()
    if moment is None:
        moment = np.zeros((len(values), 3))
        notes += (f"Plate {name}: no moment columns; a free moment of zero was taken.",)
    span = slice(int(known[0]), int(known[-1]) + 1)
    time, force, point, moment = time[span], force[span], point[span], moment[span]
    idle = (force == 0).all(axis=1) & np.isnan(point).any(axis=1)
    if idle.any():
        point = np.where(idle[:, None], 0.0, point)
        moment = np.where(idle[:, None] & np.isnan(moment), 0.0, moment)
        notes += (
            f"Plate {name}: {int(idle.sum())} samples without force have no point; the origin was "
            "put there.",
        )
    return ForcePlate(name=name, time=time, force=force, point=point, moment=moment), notes


def standing(
    path: Path,
    plates: Sequence[ForcePlate],
    notes: tuple[str, ...],
    feet: Mapping[str, str] | None = None,
) -> Forces:
    """The forces of the file at `path`, with y up and acting on the body, and notes on what that
    took.

    The vertical is the axis along which the forces act under load; y where they do not tell it.
    """
    axis = force_axis(plates)
    turn = UP_TO_Y[1 if axis is None else axis, 1]
    if not turn.is_identity:
        notes += (
            f"Vertical axis of the forces is +{AXES[axis or 0]}, as they act along it; y is up "
            "here.",
        )
    ready = []
    for plate in plates:
        turned = turn_plate(plate, turn)
        if pushes_down(turned.force, UP):
            turned = turned_round(turned)
            notes += (f"Plate {plate.name}: {TURNED_ROUND}",)
        ready.append(turned)
    return Forces(str(path), tuple(ready), notes, turn, feet or {})


def on_one_time(plates: tuple[ForcePlate, ...]) -> tuple[Array, Array]:
    """Times (ns,) of a table of all plates, and its values (ns, 9 * plates): force, point, moment
    of each.

    A plate that begins later or ends sooner than another has NaN there. FileFault where plates are
    sampled at different times, as one table has one time column.
    """
    if not plates:
        raise FileFault("there are no force plates to write", code=Code.NOT_WRITABLE)
    time = np.unique(np.concatenate([plate.time for plate in plates]))
    values = np.full((len(time), 9 * len(plates)), np.nan)
    for number, plate in enumerate(plates):
        rows = np.searchsorted(time, plate.time)
        if rows[-1] - rows[0] + 1 != len(rows):
            message = "the plates are sampled at different times; a table needs the same for all"
            raise FileFault(message, code=Code.NOT_WRITABLE)
        values[rows, 9 * number : 9 * number + 9] = np.hstack(
            [plate.force, plate.point, plate.moment]
        )
    return time, values
