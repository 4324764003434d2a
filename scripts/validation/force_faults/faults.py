"""Single faults of force plates, as files and laboratories have them, put into a recording as it was read.

A fault of the force keeps what a table holds beside it, the centre of pressure and the free moment, or what channels
hold, the moments about the middle of the plate. What the reader would do with the file is done after it: a force that
points down is turned round.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gaitcal.recording.force_plate import LOADED_N, UP, plate_from_moment, pushes_down, turned_round
from gaitcal.recording.recording import ForcePlate, Recording
from gaitcal.verdict.force_causes import Kind
from gaitcal.verdict.force_standing import FORCE_UNITS

Array = NDArray[np.float64]
Change = Callable[[ForcePlate], ForcePlate]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault, in all plates or in one."""

    kind: Kind
    row: str
    """Of the table."""
    words: str
    plate: int | None
    """Index of the plate; None: all."""
    size: tuple[float, ...] = ()
    """True size in the units of `told_size`; of a tilt and a place the vector."""
    unit: str = ""
    change: Callable[[Recording], Recording]


def middle(plate: ForcePlate) -> Array:
    """(3,) m of the surface: of the corners, or of the centres of pressure weighed by the load."""
    if plate.corners is not None:
        return plate.corners.mean(axis=0)
    load = np.where(plate.force[:, 1] > LOADED_N, plate.force[:, 1], 0.0)
    return np.average(plate.point, axis=0, weights=load + 1e-9)


def with_force(plate: ForcePlate, force: Array, *, moments: bool, factor: float = 1.0, free: float = 1.0) -> ForcePlate:
    """Another force; the moments about the middle are kept (times `factor`), or the centre and the free moment."""
    if not moments:
        return replace(plate, force=force, moment=free * plate.moment)
    about = plate.moment + np.cross(plate.point - middle(plate), plate.force)
    return plate_from_moment(plate.name, plate.time, force, factor * about, middle(plate), UP, plate.corners)


def placed(plate: ForcePlate, turn: Array, about: Array, shift: Array) -> ForcePlate:
    """The plate turned about a point and moved, with its corners."""
    corners = None if plate.corners is None else about + (plate.corners - about) @ turn.T + shift
    point = about + (plate.point - about) @ turn.T + shift
    return replace(plate, force=plate.force @ turn.T, point=point, moment=plate.moment @ turn.T, corners=corners)


def later(plate: ForcePlate, seconds: float) -> ForcePlate:
    """Everything so much later on the same time axis."""
    wrench = np.nan_to_num(plate.wrench())
    moved = np.stack([np.interp(plate.time - seconds, plate.time, column) for column in wrench.T], axis=1)
    centre = middle(plate)
    moment = moved[:, 3:] - np.cross(centre, moved[:, :3])
    return plate_from_moment(plate.name, plate.time, moved[:, :3], moment, centre, UP, plate.corners)


def on_plates(change: Change, plate: int | None) -> Callable[[Recording], Recording]:
    def apply(recording: Recording) -> Recording:
        plates = [change(p) if plate is None or i == plate else p for i, p in enumerate(recording.plates)]
        return replace(recording, plates=tuple(turned_round(p) if pushes_down(p.force, UP) else p for p in plates))

    return apply


def turn_about(axis: Sequence[float], degrees: float) -> Array:
    return Rotation.from_rotvec(np.deg2rad(degrees) * np.asarray(axis) / np.linalg.norm(axis)).as_matrix()


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either_sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def level_vector(rng: np.random.Generator) -> Array:
    """(3,) a direction in the floor."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


def clock(rng: np.random.Generator, plate: int | None) -> Fault:
    s = either_sign(rng) * log_uniform(rng, 0.01, 0.15)
    return Fault(
        kind=Kind.CLOCK, row="clock", words=f"{1e3 * s:+.0f} ms", plate=None, size=(s,),
        change=on_plates(lambda p: later(p, s), None),
    )  # fmt: skip


def place(rng: np.random.Generator, plate: int | None) -> Fault:
    shift = log_uniform(rng, 0.01, 0.2) * level_vector(rng)
    return Fault(
        kind=Kind.PLACE, row="place", words=f"{1e3 * np.linalg.norm(shift):.0f} mm", plate=plate,
        size=(shift[0], shift[2]), change=on_plates(lambda p: placed(p, np.eye(3), np.zeros(3), shift), plate),
    )  # fmt: skip


def yaw(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees = either_sign(rng) * log_uniform(rng, 2.0, 180.0)
    turn = turn_about([0, 1, 0], degrees)
    return Fault(
        kind=Kind.YAW, row="yaw", words=f"{degrees:+.0f} deg", plate=plate, size=(np.deg2rad(degrees),),
        change=on_plates(lambda p: placed(p, turn, middle(p), np.zeros(3)), plate),
    )  # fmt: skip


def tilt(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees, axis = log_uniform(rng, 1.0, 15.0), level_vector(rng)
    turn = turn_about(axis, degrees)
    return Fault(
        kind=Kind.TILT, row="tilt", words=f"{degrees:.1f} deg", plate=plate,
        size=tuple(np.deg2rad(degrees) * axis[[0, 2]]),
        change=on_plates(lambda p: placed(p, turn, np.zeros(3) if plate is None else middle(p), np.zeros(3)), plate),
    )  # fmt: skip


def markers_tilted(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees, axis = log_uniform(rng, 1.0, 10.0), level_vector(rng)
    turn = turn_about(axis, degrees)
    return Fault(
        kind=Kind.MARKERS_TILTED, row="markers tilted", words=f"{degrees:.1f} deg", plate=None,
        size=tuple(np.deg2rad(degrees) * axis[[0, 2]]),
        change=lambda recording: replace(recording, markers=recording.markers @ turn.T),
    )  # fmt: skip


def _gain(kind: Kind, axes: Array, low: float, high: float) -> Callable[[np.random.Generator, int | None], Fault]:
    def make(rng: np.random.Generator, plate: int | None) -> Fault:
        factor = 1.0 + either_sign(rng) * log_uniform(rng, low, high)
        factor = factor if factor > 0.05 else 1.0 / (2.0 - factor)
        moments = bool(rng.integers(2))
        by = 1.0 + (factor - 1.0) * axes
        free = factor if axes.all() and not moments else 1.0
        kept = "moments" if moments else "centre"
        return Fault(
            kind=kind, row=kind.value, words=f"x {factor:.3g}, {kept} kept", plate=plate, size=(factor,),
            change=on_plates(lambda p: with_force(p, by * p.force, moments=moments, free=free), plate),
        )  # fmt: skip

    return make


def free_moment(rng: np.random.Generator, plate: int | None) -> Fault:
    factor = float(rng.choice([-1.0, log_uniform(rng, 2.0, 30.0)]))
    return Fault(
        kind=Kind.FREE_MOMENT, row="free moment", words=f"x {factor:.3g}", plate=plate, size=(factor,),
        change=on_plates(lambda p: replace(p, moment=factor * p.moment), plate),
    )  # fmt: skip


def offset(rng: np.random.Generator, plate: int | None) -> Fault:
    newtons = either_sign(rng) * log_uniform(rng, 10.0, 150.0)
    push = np.array([0.0, newtons, 0.0])
    return Fault(
        kind=Kind.OFFSET, row="offset", words=f"{newtons:+.0f} N", plate=plate, size=(newtons,),
        change=on_plates(lambda p: with_force(p, p.force + push, moments=True), plate),
    )  # fmt: skip


def _sign(kind: Kind, signs: Sequence[float]) -> Callable[[np.random.Generator, int | None], Fault]:
    def make(rng: np.random.Generator, plate: int | None) -> Fault:
        moments = bool(rng.integers(2))
        return Fault(
            kind=kind, row=kind.value, words=f"{'moments' if moments else 'centre'} kept", plate=plate,
            change=on_plates(lambda p: with_force(p, p.force * np.asarray(signs), moments=moments), plate),
        )  # fmt: skip

    return make


def axes(rng: np.random.Generator, plate: int | None) -> Fault:
    moments = bool(rng.integers(2))
    return Fault(
        kind=Kind.AXES, row="axes exchanged", words=f"{'moments' if moments else 'centre'} kept", plate=plate,
        change=on_plates(lambda p: with_force(p, p.force[:, ::-1], moments=moments), plate),
    )  # fmt: skip


def force_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    unit = str(rng.choice([u for u in FORCE_UNITS if u != "N"]))
    way = str(rng.choice(["alone", "with free moment", "moments kept"]))
    share = 1.0 / FORCE_UNITS[unit]
    free = share if way == "with free moment" else 1.0
    return Fault(
        kind=Kind.FORCE_UNIT, row="unit of force", words=f"{unit}, {way}", plate=None, unit=unit,
        change=on_plates(lambda p: with_force(p, share * p.force, moments=way == "moments kept", free=free), None),
    )  # fmt: skip


def moment_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    whole = bool(rng.integers(2))
    return Fault(
        kind=Kind.MOMENT_UNIT, row="unit of moment", words="moments in N·mm" if whole else "free moment in N·mm",
        plate=None, change=on_plates(lambda p: with_force(p, p.force, moments=whole, factor=1e3, free=1e3), None),
    )  # fmt: skip


def centre_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    unit, factor = (("mm", 1e3), ("cm", 1e2))[int(rng.integers(2))]
    return Fault(
        kind=Kind.CENTRE_UNIT, row="unit of the centre of pressure", words=unit, plate=None, unit=unit,
        change=on_plates(lambda p: replace(p, point=factor * p.point), None),
    )  # fmt: skip


def exchanged(rng: np.random.Generator, plate: int | None) -> Fault:
    """The first two plates lie where the other is said to be."""

    def change(recording: Recording) -> Recording:
        one, other, *rest = recording.plates
        way = middle(other) - middle(one)
        moved = (placed(one, np.eye(3), np.zeros(3), way), placed(other, np.eye(3), np.zeros(3), -way))
        return replace(recording, plates=(*moved, *rest))

    return Fault(kind=Kind.EXCHANGED, row="plates exchanged", words="1 and 2", plate=None, change=change)


HORIZONTAL, VERTICAL, EVERY = np.array([1.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.ones(3)
FAULTS: tuple[Callable[[np.random.Generator, int | None], Fault], ...] = (
    clock,
    place,
    yaw,
    tilt,
    markers_tilted,
    _gain(Kind.GAIN, EVERY, 0.05, 1.0),
    _gain(Kind.VERTICAL_GAIN, VERTICAL, 0.05, 0.6),
    _gain(Kind.HORIZONTAL_GAIN, HORIZONTAL, 0.15, 1.5),
    free_moment,
    offset,
    _sign(Kind.SIGN_FORE_AFT, (-1, 1, 1)),
    _sign(Kind.SIGN_SIDEWAYS, (1, 1, -1)),
    _sign(Kind.SIGN_VERTICAL, (1, -1, 1)),
    axes,
    force_unit,
    moment_unit,
    centre_unit,
    exchanged,
)
"""One for each row of the table, drawn with sizes log-uniform: (generator, index of the plate or None)."""
