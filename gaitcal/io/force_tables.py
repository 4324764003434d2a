"""Find and build the force plates of a table from its column names.

A column name is split into the quantity (force, point, moment), its axis, and the plate:

    ground_force_vx   1_ground_force_px   ground_torque_x   1_ground_torque_y
    ground_force_r_vx   ground_force_1_pz   ground_moment_1_mx   R_ground_force_vx
    FP1_fx   1_cop_x   left_grf_y
    ground_force_calcn_r_vx   Fx1   COPx_1   ground_force_vx_r   F1X   M1Z

If a moment has only its vertical component, it is the free moment.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code
from gaitcal.io.axes import AXES, UP_TO_Y, AxisPermutation, find_force_axis, rotate_plate
from gaitcal.io.force_plate import REVERSED_NOTE, UP, is_reaction_on_plate, reverse_wrench
from gaitcal.io.recording import ForcePlate
from gaitcal.io.text_file import FileFault

COLUMN_NAME = re.compile(
    r"(?P<rest>.+?)_?(?P<letter>(?<=_)[vfpmt])?_?(?P<axis>[xyz])", re.IGNORECASE
)
AXIS_LETTERS = {"v": "force", "f": "force", "p": "point", "m": "moment", "t": "moment"}
QUANTITY_WORDS = {
    "force": "force",
    "grf": "force",
    "point": "point",
    "cop": "point",
    "torque": "moment",
    "moment": "moment",
}
FIRST_LETTERS = {"f": "force", "p": "point", "m": "moment", "t": "moment"}  # Of F1X and the like
PLATE_SUFFIX = re.compile(
    r"(?P<rest>.+[xyz])_?(?P<plate>\d+|(?<=_)[rl]|(?<=_)right|(?<=_)left)", re.IGNORECASE
)
"""Names that end with their plate: Fx1, COPx_1, ground_force_vx_r."""
FILLERS = frozenset(["ground", "reaction"])


@dataclass(frozen=True)
class Forces:
    """Ground reactions of one trial from a separate file."""

    source: str
    plates: tuple[ForcePlate, ...]
    notes: tuple[str, ...] = ()
    rotation: AxisPermutation = UP_TO_Y[1, 1]  # From the axes of the file to ours
    feet: Mapping[str, str] = field(default_factory=dict)
    """Plate -> "r" or "l", if the file gives the foot on which it acts."""


@dataclass
class PlateColumns:
    """Positions of the nine columns of one plate in a table."""

    columns: dict[str, dict[int, int]] = field(
        default_factory=lambda: {"force": {}, "point": {}, "moment": {}}
    )
    """Quantity -> axis 0..2 -> column."""
    names: list[str] = field(default_factory=list)

    def get_values(self, quantity: str, values: Array) -> Array | None:
        """Get the (ns, 3) values of a quantity; None if the table lacks one of its columns."""
        columns = self.columns[quantity]
        return values[:, [columns[axis] for axis in range(3)]] if len(columns) == 3 else None


def find_plates(names: Sequence[str]) -> list[PlateColumns]:
    """Find the plates of a table by its column names.

    Parameters
    ----------
    names
        Column names after time.

    Returns
    -------
    list of PlateColumns
        Plates with a force, in order of first appearance.
    """
    plates: dict[tuple[str, int], PlateColumns] = {}
    for column, name in enumerate(names):
        meaning = _parse_column_name(name.strip())
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


def _parse_column_name(name: str) -> tuple[str, int, str] | None:
    """Parse a column name into quantity, axis 0..2 and plate; None if it is no force column."""
    moved = PLATE_SUFFIX.fullmatch(name)
    for spelling in (name, f"_{name}", f"{moved['plate']}_{moved['rest']}" if moved else name):
        match = COLUMN_NAME.fullmatch(spelling)
        if match is None:
            continue
        tokens = re.findall(r"[a-z]+|\d+", match["rest"].lower())
        quantities = [QUANTITY_WORDS[token] for token in tokens if token in QUANTITY_WORDS]
        # Of F1X and the like the first letter is the quantity
        if not quantities and not match["letter"] and tokens and tokens[0] in FIRST_LETTERS:
            quantities, tokens = [FIRST_LETTERS[tokens[0]]], tokens[1:]
        quantity = AXIS_LETTERS.get((match["letter"] or "").lower())
        if quantity is None and quantities:
            quantity = quantities[0]
        if quantity is not None:
            identity = "_".join(
                token for token in tokens if token not in QUANTITY_WORDS and token not in FILLERS
            )
            return quantity, "xyz".index(match["axis"].lower()), identity
    return None


def build_plate(
    name: str, time: Array, values: Array, found: PlateColumns
) -> tuple[ForcePlate, tuple[str, ...]]:
    """Build a plate from its columns; rows without a force at either end are left out.

    Parameters
    ----------
    time
        (ns,) s.
    values
        (ns, columns) m, N, N·m.
    found
        Columns of the plate.

    Returns
    -------
    plate, notes
        The plate in the axes of the table, and one sentence for each assumption.

    Raises
    ------
    FileFault
        A quantity is incomplete, or the force has no numbers.
    """
    field, names = f"plate {name}", ", ".join(found.names)
    force, point, moment = (
        found.get_values(quantity, values) for quantity in ("force", "point", "moment")
    )
    free = found.columns["moment"]
    vertical = None
    # A single moment column along the vertical is the free moment
    if force is not None and len(free) == 1:
        zero = np.zeros_like(force)
        loads = ForcePlate(
            name=name, time=time, force=np.nan_to_num(force), point=zero, moment=zero
        )
        vertical = find_force_axis([loads])
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


def orient_forces(
    path: Path,
    plates: Sequence[ForcePlate],
    notes: tuple[str, ...],
    feet: Mapping[str, str] | None = None,
) -> Forces:
    """Orient plates so that y is up and the force acts on the body.

    The vertical is the axis along which the forces act under load; y if they do not show it.

    Parameters
    ----------
    path
        File of the forces, for messages.
    plates
        Plates in the axes of the file.
    notes
        Notes of the reader.
    feet
        Plate -> "r" or "l", if the file gives it.

    Returns
    -------
    Forces
        With a note for each correction.
    """
    axis = find_force_axis(plates)
    rotation = UP_TO_Y[1 if axis is None else axis, 1]
    if not rotation.is_identity:
        notes += (
            f"Vertical axis of the forces is +{AXES[axis or 0]}, as they act along it; y is up "
            "here.",
        )
    ready = []
    for plate in plates:
        rotated = rotate_plate(plate, rotation)
        if is_reaction_on_plate(rotated.force, UP):
            rotated = reverse_wrench(rotated)
            notes += (f"Plate {plate.name}: {REVERSED_NOTE}",)
        ready.append(rotated)
    return Forces(str(path), tuple(ready), notes, rotation, feet or {})


def tabulate_plates(plates: tuple[ForcePlate, ...]) -> tuple[Array, Array]:
    """Put all plates in one table with one time column.

    Parameters
    ----------
    plates
        Plates to write.

    Returns
    -------
    time, values
        (ns,) s, and (ns, 9 * plates): force, point and moment of each, NaN outside its time.

    Raises
    ------
    FileFault
        There are no plates, or they are sampled at different times.
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
