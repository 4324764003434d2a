"""Single faults of force plates, as files and laboratories have them, put into a recording as it
was read.

A fault of the force keeps what a table holds beside it, the centre of pressure and the free moment,
or what channels hold, the moments about the middle of the plate. What the reader would do with the
file is done after it: a force that points down is turned round.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.io.force_plate import (
    LOADED_N,
    UP,
    build_plate_from_moment,
    is_reaction_on_plate,
    reverse_wrench,
)
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.quality.force_causes import ForceFault
from gaitcal.quality.force_evidence import FORCE_UNITS

Change = Callable[[ForcePlate], ForcePlate]


@dataclass(frozen=True, kw_only=True)
class Fault:
    kind: ForceFault
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


def with_force(
    plate: ForcePlate, force: Array, *, moments: bool, factor: float = 1.0, free: float = 1.0
) -> ForcePlate:
    """Another force; the moments about the middle are kept (times `factor`), or the centre and the
    free moment.
    """
    if not moments:
        return replace(plate, force=force, moment=free * plate.moment)
    about = plate.moment + np.cross(plate.point - middle(plate), plate.force)
    return build_plate_from_moment(
        plate.name, plate.time, force, factor * about, middle(plate), UP, plate.corners
    )


def placed(plate: ForcePlate, turn: Array, about: Array, shift: Array) -> ForcePlate:
    """The plate turned about a point and moved, with its corners."""
    corners = None if plate.corners is None else about + (plate.corners - about) @ turn.T + shift
    point = about + (plate.point - about) @ turn.T + shift
    return replace(
        plate,
        force=plate.force @ turn.T,
        point=point,
        moment=plate.moment @ turn.T,
        corners=corners,
    )


def later(plate: ForcePlate, seconds: float) -> ForcePlate:
    time, wrench = plate.time, np.nan_to_num(plate.wrench())
    force, about = np.hsplit(
        np.stack([np.interp(time - seconds, time, c) for c in wrench.T], axis=1), 2
    )
    moment = about - np.cross(middle(plate), force)
    return build_plate_from_moment(
        plate.name, time, force, moment, middle(plate), UP, plate.corners
    )


def on_plates(change: Change, plate: int | None) -> Callable[[Recording], Recording]:
    def apply(recording: Recording) -> Recording:
        plates = [
            change(p) if plate is None or i == plate else p for i, p in enumerate(recording.plates)
        ]
        return replace(
            recording,
            plates=tuple(
                reverse_wrench(p) if is_reaction_on_plate(p.force, UP) else p for p in plates
            ),
        )

    return apply


def turn_about(axis: Sequence[float], degrees: float) -> Array:
    return Rotation.from_rotvec(
        np.deg2rad(degrees) * np.asarray(axis) / np.linalg.norm(axis)
    ).as_matrix()


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either_sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def level_vector(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


def _fault(
    kind: ForceFault, words: str, plate: int | None, change: Change, size: tuple[float, ...] = ()
) -> Fault:
    return Fault(
        kind=kind,
        row=kind.value,
        words=words,
        plate=plate,
        size=size,
        change=on_plates(change, plate),
    )


def clock(rng: np.random.Generator, plate: int | None) -> Fault:
    s = either_sign(rng) * log_uniform(rng, 0.01, 0.15)
    return _fault(ForceFault.CLOCK, f"{1e3 * s:+.0f} ms", None, lambda p: later(p, s), (s,))


def place(rng: np.random.Generator, plate: int | None) -> Fault:
    shift = log_uniform(rng, 0.01, 0.2) * level_vector(rng)
    words, size = f"{1e3 * np.linalg.norm(shift):.0f} mm", (shift[0], shift[2])
    return _fault(
        ForceFault.PLACE, words, plate, lambda p: placed(p, np.eye(3), np.zeros(3), shift), size
    )


def yaw(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees = either_sign(rng) * log_uniform(rng, 2.0, 180.0)
    turn, size = turn_about([0, 1, 0], degrees), (np.deg2rad(degrees),)
    return _fault(
        ForceFault.YAW,
        f"{degrees:+.0f} deg",
        plate,
        lambda p: placed(p, turn, middle(p), np.zeros(3)),
        size,
    )


def tilt(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees, axis = log_uniform(rng, 1.0, 15.0), level_vector(rng)
    turn, size = turn_about(axis, degrees), tuple(np.deg2rad(degrees) * axis[[0, 2]])

    def change(p: ForcePlate) -> ForcePlate:
        return placed(p, turn, np.zeros(3) if plate is None else middle(p), np.zeros(3))

    return _fault(ForceFault.TILT, f"{degrees:.1f} deg", plate, change, size)


def markers_tilted(rng: np.random.Generator, plate: int | None) -> Fault:
    degrees, axis = log_uniform(rng, 1.0, 10.0), level_vector(rng)
    turn, size = turn_about(axis, degrees), tuple(np.deg2rad(degrees) * axis[[0, 2]])
    plain = _fault(ForceFault.MARKERS_TILTED, f"{degrees:.1f} deg", None, lambda p: p, size)
    return replace(
        plain, change=lambda recording: replace(recording, markers=recording.markers @ turn.T)
    )


def _gain(
    kind: ForceFault, axes: Array, low: float, high: float
) -> Callable[[np.random.Generator, int | None], Fault]:
    def make(rng: np.random.Generator, plate: int | None) -> Fault:
        factor = 1.0 + either_sign(rng) * log_uniform(rng, low, high)
        factor = factor if factor > 0.05 else 1.0 / (2.0 - factor)
        moments = bool(rng.integers(2))
        by = 1.0 + (factor - 1.0) * axes
        free = factor if axes.all() and not moments else 1.0
        words = f"x {factor:.3g}, {'moments' if moments else 'centre'} kept"
        return _fault(
            kind,
            words,
            plate,
            lambda p: with_force(p, by * p.force, moments=moments, free=free),
            (factor,),
        )

    return make


def free_moment(rng: np.random.Generator, plate: int | None) -> Fault:
    factor = float(rng.choice([-1.0, log_uniform(rng, 2.0, 30.0)]))
    words = f"x {factor:.3g}"
    return _fault(
        ForceFault.FREE_MOMENT,
        words,
        plate,
        lambda p: replace(p, moment=factor * p.moment),
        (factor,),
    )


def offset(rng: np.random.Generator, plate: int | None) -> Fault:
    newtons = either_sign(rng) * log_uniform(rng, 10.0, 150.0)
    push = np.array([0.0, newtons, 0.0])
    words = f"{newtons:+.0f} N"
    return _fault(
        ForceFault.OFFSET,
        words,
        plate,
        lambda p: with_force(p, p.force + push, moments=True),
        (newtons,),
    )


def _turned_force(
    kind: ForceFault, change: Callable[[Array], Array]
) -> Callable[[np.random.Generator, int | None], Fault]:
    """Signs or axes of the force; the moments, or the centre of pressure, are kept."""

    def make(rng: np.random.Generator, plate: int | None) -> Fault:
        moments = bool(rng.integers(2))
        words = f"{'moments' if moments else 'centre'} kept"
        return _fault(kind, words, plate, lambda p: with_force(p, change(p.force), moments=moments))

    return make


def force_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    unit = str(rng.choice([u for u in FORCE_UNITS if u != "N"]))
    way = str(rng.choice(["alone", "with free moment", "moments kept"]))
    share = 1.0 / FORCE_UNITS[unit]
    free = share if way == "with free moment" else 1.0

    def change(p: ForcePlate) -> ForcePlate:
        return with_force(p, share * p.force, moments=way == "moments kept", free=free)

    return replace(_fault(ForceFault.FORCE_UNIT, f"{unit}, {way}", None, change), unit=unit)


def moment_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    whole = bool(rng.integers(2))
    words = "moments in N·mm" if whole else "free moment in N·mm"
    return _fault(
        ForceFault.MOMENT_UNIT,
        words,
        None,
        lambda p: with_force(p, p.force, moments=whole, factor=1e3, free=1e3),
    )


def centre_unit(rng: np.random.Generator, plate: int | None) -> Fault:
    unit, factor = (("mm", 1e3), ("cm", 1e2))[int(rng.integers(2))]
    return replace(
        _fault(ForceFault.CENTRE_UNIT, unit, None, lambda p: replace(p, point=factor * p.point)),
        unit=unit,
    )


def exchanged(rng: np.random.Generator, plate: int | None) -> Fault:
    """The first two plates lie where the other is said to be."""

    def change(recording: Recording) -> Recording:
        one, other, *rest = recording.plates
        way = middle(other) - middle(one)
        moved = (
            placed(one, np.eye(3), np.zeros(3), way),
            placed(other, np.eye(3), np.zeros(3), -way),
        )
        return replace(recording, plates=(*moved, *rest))

    return replace(_fault(ForceFault.EXCHANGED, "1 and 2", None, lambda p: p), change=change)


HORIZONTAL, VERTICAL, EVERY = np.array([1.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.ones(3)
FAULTS: tuple[Callable[[np.random.Generator, int | None], Fault], ...] = (
    clock,
    place,
    yaw,
    tilt,
    markers_tilted,
    _gain(ForceFault.GAIN, EVERY, 0.05, 1.0),
    _gain(ForceFault.VERTICAL_GAIN, VERTICAL, 0.05, 0.6),
    _gain(ForceFault.HORIZONTAL_GAIN, HORIZONTAL, 0.15, 1.5),
    free_moment,
    offset,
    _turned_force(ForceFault.SIGN_FORE_AFT, lambda f: f * np.array([-1, 1, 1])),
    _turned_force(ForceFault.SIGN_SIDEWAYS, lambda f: f * np.array([1, 1, -1])),
    _turned_force(ForceFault.SIGN_VERTICAL, lambda f: f * np.array([1, -1, 1])),
    _turned_force(ForceFault.AXES, lambda f: f[:, ::-1]),
    force_unit,
    moment_unit,
    centre_unit,
    exchanged,
)
"""One for each row of the table, drawn with sizes log-uniform: (generator, index of the plate or
None).
"""
