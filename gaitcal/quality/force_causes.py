"""What can be wrong with ground reactions, each cause with how a fault of a given size is undone.

Coefficients x are 0 where there is no fault; where they are a vector they are one in the room, (x,
z), and reach `OnePlate` as (3,) in the axes of the trial. For a *linear* cause the undone wrenches
are affine in x, as they are for places and for the inverse of a gain: f = g f_true, f_true = (1 +
x) f, g = 1 / (1 + x).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.quality.force_evidence import ForceEvidence, force_units
from gaitcal.quality.plate_forces import PlateForces, joined, rotation

LATE_S = tuple((float(s),) for s in np.arange(-0.32, 0.33, 0.04))
TURNS = tuple(
    (float(a),) for a in np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0])
)
NO_WALKS_FREE_MOMENT, NO_WALKS_CENTRE_M = 0.3, 5.0
"""A moment of 0.3 of body weight times height, and a centre of pressure 5 m away: no walk has it,
and only then are units of length asked for. A free moment is about 0.003 of body weight times
height."""
OTHER_UNIT_SHARE = 0.5  # Of body weight: plates that carry less at most may be in another unit


class ForceFault(Enum):
    """What is wrong."""

    CLOCK = "clock"
    PLACE = "place"
    YAW = "yaw"
    TILT = "tilt"
    MARKERS_TILTED = "markers tilted"
    GAIN = "gain"
    VERTICAL_GAIN = "vertical gain"
    HORIZONTAL_GAIN = "horizontal gain"
    FORE_AFT_GAIN = "fore-aft gain"
    SIDEWAYS_GAIN = "sideways gain"
    FREE_MOMENT = "free moment"
    OFFSET = "offset"
    SIGN_FORE_AFT = "sign of the fore-aft force"
    SIGN_SIDEWAYS = "sign of the sideways force"
    SIGN_HORIZONTAL = "sign of both horizontal forces"
    SIGN_VERTICAL = "sign of the vertical force"
    AXES = "axes exchanged"
    FORCE_UNIT = "unit of force"
    MOMENT_UNIT = "unit of moment"
    CENTRE_UNIT = "unit of the centre of pressure"
    EXCHANGED = "plates exchanged"
    TRUNK = "trunk"


class Corrected(NamedTuple):
    """A trial as it would be without the fault."""

    wrenches: Array  # (plates, k, 6)
    required_wrench: Array | None = None  # (k, 6) where the fault is not one of the plates
    offsets: Array | None = None  # (plates,) N taken away from the vertical force throughout


Undo: TypeAlias = Callable[[ForceEvidence, Array], Corrected]
OnePlate: TypeAlias = Callable[[PlateForces, Array], Array]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One thing that may be wrong, alone."""

    kind: ForceFault
    plates: tuple[str, ...] = ()  # Names of the plates that it is about; none: all
    undo: Undo
    parameters: int = 0  # How many coefficients it has
    starts: tuple[tuple[float, ...], ...] = ()
    """Where the coefficients of a cause that is not linear are sought from; none: it is linear."""
    by_side_evidence: bool = False
    """Whether its size is sought by the side evidence as well (`plate_forces.py`), which is linear
    in it.
    """
    unit: str = ""  # The unit that the file has, for causes about units

    @property
    def key(self) -> tuple[ForceFault, tuple[str, ...], str]:
        """Causes with the same key are told alike, whatever the file kept."""
        return self.kind, self.plates, self.unit


def _of_force(change: OnePlate) -> tuple[OnePlate, OnePlate]:
    """A change of the force that keeps the centre of pressure, and one that keeps the moments."""
    return (lambda p, x: p.centre_kept(change(p, x)), lambda p, x: p.moments_kept(change(p, x)))


def _gain(*axes: float) -> tuple[OnePlate, OnePlate]:
    return _of_force(lambda p, x: p.force * (1.0 + x[0] * np.array(axes)))


def _sign(*axes: float) -> tuple[OnePlate, OnePlate]:
    return _of_force(lambda p, x: p.force * axes)


LINEAR: tuple[tuple[ForceFault, int, tuple[OnePlate, ...]], ...] = (
    (ForceFault.PLACE, 2, (lambda p, x: p.moved(-x),)),
    (
        ForceFault.GAIN,
        1,
        (lambda p, x: (1.0 + x[0]) * p.wrench, lambda p, x: p.moments_kept((1.0 + x[0]) * p.force)),
    ),
    (ForceFault.VERTICAL_GAIN, 1, _gain(0.0, 1.0, 0.0)),
    (ForceFault.HORIZONTAL_GAIN, 1, _gain(1.0, 0.0, 1.0)),
    (ForceFault.FORE_AFT_GAIN, 1, _gain(1.0, 0.0, 0.0)),
    (ForceFault.SIDEWAYS_GAIN, 1, _gain(0.0, 0.0, 1.0)),
    (ForceFault.FREE_MOMENT, 1, (lambda p, x: p.centre_kept(p.force, (1.0 + x[0]) * p.free),)),
    (ForceFault.SIGN_FORE_AFT, 0, _sign(-1.0, 1.0, 1.0)),
    (ForceFault.SIGN_SIDEWAYS, 0, _sign(1.0, 1.0, -1.0)),
    (ForceFault.SIGN_HORIZONTAL, 0, _sign(-1.0, 1.0, -1.0)),
    # on reading, a force that points down is turned round as a whole: only the vertical column was
    # wrong
    (
        ForceFault.SIGN_VERTICAL,
        0,
        (
            lambda p, x: p.centre_kept(p.force * [-1.0, 1.0, -1.0], -p.free),
            lambda p, x: p.moments_kept(p.force * [-1.0, 1.0, -1.0], -1.0),
        ),
    ),
    (
        ForceFault.AXES,
        0,
        (
            *_of_force(lambda p, x: p.force[:, ::-1]),
            lambda p, x: p.centre_kept(p.force[:, ::-1] * [1.0, 1.0, -1.0]),
            lambda p, x: p.centre_kept(p.force[:, ::-1] * [-1.0, 1.0, 1.0]),
        ),
    ),
)
"""Kind, number of coefficients, (plate, coefficients) -> (k, 6) wrench without the fault, in one
way or another.
"""


def causes_of(trials: Sequence[ForceEvidence]) -> Iterator[Cause]:
    """All causes that are worth trying on trials with the same plates."""
    names = tuple(dict.fromkeys(plate.name for trial in trials for plate in trial.plates))
    yield Cause(kind=ForceFault.CLOCK, undo=_later, parameters=1, starts=LATE_S)
    yield Cause(kind=ForceFault.TRUNK, undo=_other_trunk, parameters=2)
    for which in ((), *((name,) for name in names if len(names) > 1)):
        on = partial(_on_plates, which)
        for kind, parameters, changes in LINEAR:
            for change in changes:
                undo, place = on(change), kind is ForceFault.PLACE
                yield Cause(
                    kind=kind,
                    plates=which,
                    undo=undo,
                    parameters=parameters,
                    by_side_evidence=place,
                )
        yield Cause(
            kind=ForceFault.YAW,
            plates=which,
            undo=on(lambda p, x: p.turned(_yaw(x))),
            parameters=1,
            starts=TURNS,
        )
        offset = _without_offset(which)
        yield Cause(
            kind=ForceFault.OFFSET, plates=which, undo=offset, parameters=1, by_side_evidence=True
        )
        tilted = on(_tilted if which else lambda p, x: p.turned_in_the_room(rotation(-x)))
        yield Cause(
            kind=ForceFault.TILT, plates=which, undo=tilted, parameters=2, starts=((0.0, 0.0),)
        )
    on = partial(_on_plates, ())
    yield Cause(
        kind=ForceFault.YAW,
        undo=on(lambda p, x: p.turned_in_the_room(_yaw(x))),
        parameters=1,
        starts=TURNS,
    )
    # column x of force, point and moment holds z, and the other way round
    columns = on(lambda p, x: joined(p.force[:, ::-1], p.centre[:, ::-1], p.free[:, ::-1]))
    yield Cause(kind=ForceFault.AXES, undo=columns)
    yield Cause(
        kind=ForceFault.MARKERS_TILTED, undo=_markers_upright, parameters=2, starts=((0.0, 0.0),)
    )
    for one, other in combinations(names, 2):
        yield Cause(kind=ForceFault.EXCHANGED, plates=(one, other), undo=_exchanged(one, other))
    yield from _units(trials)


def _units(trials: Sequence[ForceEvidence]) -> Iterator[Cause]:
    """Units that the files may be in, where a glance at their numbers allows it."""
    on = partial(_on_plates, ())
    most = max(float(trial.wrenches[:, :, 1].sum(axis=0).max()) / trial.weight for trial in trials)
    for unit, newtons in force_units(trials[0].weight).items() if most < OTHER_UNIT_SHARE else ():
        for change in _in_unit(newtons) if newtons != 1.0 else ():
            yield Cause(kind=ForceFault.FORCE_UNIT, undo=on(change), unit=unit)
    pairs = [(trial, plate) for trial in trials for plate in trial.plates]
    free = max(float(np.abs(plate.free).max()) / trial.bwh for trial, plate in pairs)
    away = max(float(np.abs(plate.centre[:, [0, 2]]).max()) for _, plate in pairs)
    if free > NO_WALKS_FREE_MOMENT:
        yield Cause(
            kind=ForceFault.MOMENT_UNIT, undo=on(lambda p, x: p.centre_kept(p.force, 1e-3 * p.free))
        )
    if free > NO_WALKS_FREE_MOMENT or away > NO_WALKS_CENTRE_M:
        yield Cause(
            kind=ForceFault.MOMENT_UNIT, undo=on(lambda p, x: p.moments_kept(p.force, 1e-3))
        )
    if away > NO_WALKS_CENTRE_M:
        for unit, change in (
            ("mm", lambda p, x: p.nearer(1e-3)),
            ("cm", lambda p, x: p.nearer(1e-2)),
        ):
            yield Cause(kind=ForceFault.CENTRE_UNIT, undo=on(change), unit=unit)


def _in_unit(newtons: float) -> tuple[OnePlate, ...]:
    """Forces alone in another unit; with their free moments; with the moments of the channels left
    as they are.
    """
    return (
        lambda p, x: p.centre_kept(newtons * p.force),
        lambda p, x: newtons * p.wrench,
        lambda p, x: p.moments_kept(newtons * p.force),
    )


def _on_plates(which: tuple[str, ...], change: OnePlate) -> Undo:
    """`change` on the plates named, or on all."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        if len(x) > 1:
            x = trial.room[:, [0, 2]] @ x
        chosen = [change(p, x) if not which or p.name in which else p.wrench for p in trial.plates]
        return Corrected(np.stack(chosen))

    return undo


def _without_offset(which: tuple[str, ...]) -> Undo:
    """x[0] N less on each of the plates, in their middle."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        less = np.array(
            [float(x[0]) if not which or p.name in which else 0.0 for p in trial.plates]
        )
        wrenches = [
            p.moments_kept(p.force - [0.0, n, 0.0]) for p, n in zip(trial.plates, less, strict=True)
        ]
        return Corrected(np.stack(wrenches), None, less)

    return undo


def _later(trial: ForceEvidence, x: Array) -> Corrected:
    """Forces that come x[0] s late are those of a later moment."""
    return Corrected(np.stack([plate.later(trial.time + x[0]) for plate in trial.plates]))


def _other_trunk(trial: ForceEvidence, x: Array) -> Corrected:
    """The trunk's mass centre lies x m (forward, right) from where the model has it."""
    return Corrected(trial.wrenches, trial.required_wrench + trial.trunk @ x)


def _yaw(x: Array) -> Array:
    return rotation(np.array([0.0, -x[0], 0.0]))


def _tilted(plate: PlateForces, x: Array) -> Array:
    return plate.turned(rotation(-x))


def _markers_upright(trial: ForceEvidence, x: Array) -> Corrected:
    """Markers tilted by x rad about x and z: seen from them, plates and weight are tilted the same
    way.
    """
    turn = rotation(trial.room[:, [0, 2]] @ x)
    up = np.array([0.0, trial.weight_of_model, 0.0])
    lean = turn @ up - up
    leaning = np.hstack([np.tile(lean, (len(trial.time), 1)), cross(trial.mass_centre, lean)])
    plates = [plate.turned_in_the_room(turn) for plate in trial.plates]
    return Corrected(np.stack(plates), trial.required_wrench + leaning)


def _exchanged(one: str, other: str) -> Undo:
    """Each of two plates lies where the other is said to be."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        at = {plate.name: plate.place for plate in trial.plates}
        if one not in at or other not in at:
            return Corrected(trial.wrenches)
        way = {one: at[other] - at[one], other: at[one] - at[other]}
        return Corrected(np.stack([p.moved(way.get(p.name, np.zeros(3))) for p in trial.plates]))

    return undo
