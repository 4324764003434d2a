"""Possible faults of ground reactions, each with a function that removes a fault of a given size.

Coefficients x are 0 without a fault. A vector of coefficients has laboratory components (x, z);
`OnePlate` receives it as (3,) in the axes of the trial. For a *linear* cause the corrected wrenches
are affine in x. That holds for positions and for the inverse of a gain: f = g f_true,
f_true = (1 + x) f, g = 1 / (1 + x).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.quality.force_evidence import ForceEvidence, list_force_units
from gaitcal.quality.plate_forces import PlateForces, assemble_wrench, build_rotation

TIME_OFFSET_STARTS_S = tuple((float(s),) for s in np.arange(-0.32, 0.33, 0.04))
YAW_STARTS_RAD = tuple(
    (float(a),) for a in np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0])
)
IMPOSSIBLE_FREE_MOMENT, IMPOSSIBLE_CENTRE_M = 0.3, 5.0
"""Free moment in body weights times height, and distance (m) of a centre of pressure, that no walk
has: only beyond these are other units of length tried. A free moment is about 0.003."""
OTHER_UNIT_SHARE = 0.5  # Of body weight: plates that carry less at most may be in another unit


class ForceFault(Enum):
    """Kinds of faults of forces, markers or the trunk model."""

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
    """A trial with a fault removed."""

    wrenches: Array  # (plates, k, 6)
    required_wrench: Array | None = None  # (k, 6) where the fault is not one of the plates
    offsets: Array | None = None  # (plates,) N taken away from the vertical force throughout


Undo: TypeAlias = Callable[[ForceEvidence, Array], Corrected]
OnePlate: TypeAlias = Callable[[PlateForces, Array], Array]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One possible fault, alone."""

    kind: ForceFault
    plates: tuple[str, ...] = ()  # Names of the plates concerned; empty: all
    undo: Undo
    parameters: int = 0  # Number of coefficients
    starts: tuple[tuple[float, ...], ...] = ()
    """Starting values of the coefficients of a nonlinear cause; empty: the cause is linear."""
    by_side_evidence: bool = False
    """Whether side evidence (`plate_forces.py`), which is linear in it, helps to find its size."""
    unit: str = ""  # The unit that the file has, for causes about units

    @property
    def key(self) -> tuple[ForceFault, tuple[str, ...], str]:
        """Key of the causes that are reported alike: kind, plates, unit."""
        return self.kind, self.plates, self.unit


def _keep_centre_or_moments(change: OnePlate) -> tuple[OnePlate, OnePlate]:
    """Return changes of the force that keep the centre of pressure, or the channels' moments."""
    return (lambda p, x: p.keep_centre(change(p, x)), lambda p, x: p.keep_moments(change(p, x)))


def _scale_force(*axes: float) -> tuple[OnePlate, OnePlate]:
    """Return changes that multiply the force by 1 + x, per axis."""
    return _keep_centre_or_moments(lambda p, x: p.force * (1.0 + x[0] * np.array(axes)))


def _flip_signs(*axes: float) -> tuple[OnePlate, OnePlate]:
    """Return changes that multiply the force by signs, per axis."""
    return _keep_centre_or_moments(lambda p, x: p.force * axes)


LINEAR: tuple[tuple[ForceFault, int, tuple[OnePlate, ...]], ...] = (
    (ForceFault.PLACE, 2, (lambda p, x: p.move(-x),)),
    (
        ForceFault.GAIN,
        1,
        (lambda p, x: (1.0 + x[0]) * p.wrench, lambda p, x: p.keep_moments((1.0 + x[0]) * p.force)),
    ),
    (ForceFault.VERTICAL_GAIN, 1, _scale_force(0.0, 1.0, 0.0)),
    (ForceFault.HORIZONTAL_GAIN, 1, _scale_force(1.0, 0.0, 1.0)),
    (ForceFault.FORE_AFT_GAIN, 1, _scale_force(1.0, 0.0, 0.0)),
    (ForceFault.SIDEWAYS_GAIN, 1, _scale_force(0.0, 0.0, 1.0)),
    (
        ForceFault.FREE_MOMENT,
        1,
        (lambda p, x: p.keep_centre(p.force, (1.0 + x[0]) * p.free_moment),),
    ),
    (ForceFault.SIGN_FORE_AFT, 0, _flip_signs(-1.0, 1.0, 1.0)),
    (ForceFault.SIGN_SIDEWAYS, 0, _flip_signs(1.0, 1.0, -1.0)),
    (ForceFault.SIGN_HORIZONTAL, 0, _flip_signs(-1.0, 1.0, -1.0)),
    # the reader reverses a force that points down as a whole, although only the vertical column was
    # wrong
    (
        ForceFault.SIGN_VERTICAL,
        0,
        (
            lambda p, x: p.keep_centre(p.force * [-1.0, 1.0, -1.0], -p.free_moment),
            lambda p, x: p.keep_moments(p.force * [-1.0, 1.0, -1.0], -1.0),
        ),
    ),
    (
        ForceFault.AXES,
        0,
        (
            *_keep_centre_or_moments(lambda p, x: p.force[:, ::-1]),
            lambda p, x: p.keep_centre(p.force[:, ::-1] * [1.0, 1.0, -1.0]),
            lambda p, x: p.keep_centre(p.force[:, ::-1] * [-1.0, 1.0, 1.0]),
        ),
    ),
)
"""Kind, number of coefficients, variants of (plate, coefficients) -> (k, 6) corrected wrench."""


def list_causes(trials: Sequence[ForceEvidence]) -> Iterator[Cause]:
    """Yield all causes to try on trials over the same plates.

    Parameters
    ----------
    trials
        Gait trials of one session.

    Yields
    ------
    Cause
        Of all plates and, if there are several, of each plate alone; units only if the numbers
        allow them.
    """
    names = tuple(dict.fromkeys(plate.name for trial in trials for plate in trial.plates))
    yield Cause(kind=ForceFault.CLOCK, undo=_shift_time, parameters=1, starts=TIME_OFFSET_STARTS_S)
    yield Cause(kind=ForceFault.TRUNK, undo=_move_trunk, parameters=2)
    for which in ((), *((name,) for name in names if len(names) > 1)):
        on = partial(_apply_to_plates, which)
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
            undo=on(lambda p, x: p.rotate_about_middle(_build_yaw(x))),
            parameters=1,
            starts=YAW_STARTS_RAD,
        )
        offset = _remove_offset(which)
        yield Cause(
            kind=ForceFault.OFFSET, plates=which, undo=offset, parameters=1, by_side_evidence=True
        )
        tilted = on(
            _rotate_plate if which else lambda p, x: p.rotate_about_origin(build_rotation(-x))
        )
        yield Cause(
            kind=ForceFault.TILT, plates=which, undo=tilted, parameters=2, starts=((0.0, 0.0),)
        )
    on = partial(_apply_to_plates, ())
    yield Cause(
        kind=ForceFault.YAW,
        undo=on(lambda p, x: p.rotate_about_origin(_build_yaw(x))),
        parameters=1,
        starts=YAW_STARTS_RAD,
    )
    # columns x and z of force, point and moment are swapped
    columns = on(
        lambda p, x: assemble_wrench(p.force[:, ::-1], p.centre[:, ::-1], p.free_moment[:, ::-1])
    )
    yield Cause(kind=ForceFault.AXES, undo=columns)
    yield Cause(
        kind=ForceFault.MARKERS_TILTED,
        undo=_correct_marker_tilt,
        parameters=2,
        starts=((0.0, 0.0),),
    )
    for one, other in combinations(names, 2):
        yield Cause(kind=ForceFault.EXCHANGED, plates=(one, other), undo=_swap_plates(one, other))
    yield from _list_unit_causes(trials)


def _list_unit_causes(trials: Sequence[ForceEvidence]) -> Iterator[Cause]:
    """Yield units that the files may be in, where the size of their numbers allows it."""
    on = partial(_apply_to_plates, ())
    most = max(float(trial.wrenches[:, :, 1].sum(axis=0).max()) / trial.weight for trial in trials)
    for unit, newtons in (
        list_force_units(trials[0].weight).items() if most < OTHER_UNIT_SHARE else ()
    ):
        for change in _convert_force_unit(newtons) if newtons != 1.0 else ():
            yield Cause(kind=ForceFault.FORCE_UNIT, undo=on(change), unit=unit)
    pairs = [(trial, plate) for trial in trials for plate in trial.plates]
    free = max(float(np.abs(plate.free_moment).max()) / trial.bwh for trial, plate in pairs)
    away = max(float(np.abs(plate.centre[:, [0, 2]]).max()) for _, plate in pairs)
    if free > IMPOSSIBLE_FREE_MOMENT:
        yield Cause(
            kind=ForceFault.MOMENT_UNIT,
            undo=on(lambda p, x: p.keep_centre(p.force, 1e-3 * p.free_moment)),
        )
    if free > IMPOSSIBLE_FREE_MOMENT or away > IMPOSSIBLE_CENTRE_M:
        yield Cause(
            kind=ForceFault.MOMENT_UNIT, undo=on(lambda p, x: p.keep_moments(p.force, 1e-3))
        )
    if away > IMPOSSIBLE_CENTRE_M:
        for unit, change in (
            ("mm", lambda p, x: p.scale_distance(1e-3)),
            ("cm", lambda p, x: p.scale_distance(1e-2)),
        ):
            yield Cause(kind=ForceFault.CENTRE_UNIT, undo=on(change), unit=unit)


def _convert_force_unit(newtons: float) -> tuple[OnePlate, ...]:
    """Return changes of force unit: force alone, with free moment, or with unchanged moments."""
    return (
        lambda p, x: p.keep_centre(newtons * p.force),
        lambda p, x: newtons * p.wrench,
        lambda p, x: p.keep_moments(newtons * p.force),
    )


def _apply_to_plates(which: tuple[str, ...], change: OnePlate) -> Undo:
    """Return an `Undo` that applies `change` to the plates `which`; empty: to all."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        # vectors are given in laboratory axes
        if len(x) > 1:
            x = trial.room[:, [0, 2]] @ x
        chosen = [change(p, x) if not which or p.name in which else p.wrench for p in trial.plates]
        return Corrected(np.stack(chosen))

    return undo


def _remove_offset(which: tuple[str, ...]) -> Undo:
    """Return an `Undo` that subtracts x[0] N in the middle of each of the plates `which`."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        less = np.array(
            [float(x[0]) if not which or p.name in which else 0.0 for p in trial.plates]
        )
        wrenches = [
            p.keep_moments(p.force - [0.0, n, 0.0]) for p, n in zip(trial.plates, less, strict=True)
        ]
        return Corrected(np.stack(wrenches), None, less)

    return undo


def _shift_time(trial: ForceEvidence, x: Array) -> Corrected:
    """Take the forces x[0] s later: the forces of the file are late by that."""
    return Corrected(np.stack([plate.evaluate(trial.time + x[0]) for plate in trial.plates]))


def _move_trunk(trial: ForceEvidence, x: Array) -> Corrected:
    """Move the trunk's mass centre by x m (forward, right)."""
    return Corrected(trial.wrenches, trial.required_wrench + trial.trunk @ x)


def _build_yaw(x: Array) -> Array:
    """Build the rotation (3, 3) by -x[0] rad about the vertical."""
    return build_rotation(np.array([0.0, -x[0], 0.0]))


def _rotate_plate(plate: PlateForces, x: Array) -> Array:
    """Rotate a plate by -x rad about its middle: wrench (k, 6)."""
    return plate.rotate_about_middle(build_rotation(-x))


def _correct_marker_tilt(trial: ForceEvidence, x: Array) -> Corrected:
    """Tilt plates and weight by x rad about x and z, as markers tilted by x show them."""
    turn = build_rotation(trial.room[:, [0, 2]] @ x)
    up = np.array([0.0, trial.weight_of_model, 0.0])
    # change of the weight's direction, acting at the mass centre
    lean = turn @ up - up
    leaning = np.hstack([np.tile(lean, (len(trial.time), 1)), cross(trial.mass_centre, lean)])
    plates = [plate.rotate_about_origin(turn) for plate in trial.plates]
    return Corrected(np.stack(plates), trial.required_wrench + leaning)


def _swap_plates(one: str, other: str) -> Undo:
    """Return an `Undo` that moves each of two plates to the position given for the other."""

    def undo(trial: ForceEvidence, x: Array) -> Corrected:
        at = {plate.name: plate.position for plate in trial.plates}
        if one not in at or other not in at:
            return Corrected(trial.wrenches)
        change = {one: at[other] - at[one], other: at[one] - at[other]}
        return Corrected(np.stack([p.move(change.get(p.name, np.zeros(3))) for p in trial.plates]))

    return undo
