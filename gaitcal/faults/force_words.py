"""Causes in words: what is wrong and how large it is, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.force_causes import Kind
from gaitcal.faults.force_choice import told_size
from gaitcal.faults.force_evidence import ForceEvidence
from gaitcal.faults.force_fits import ForceFit


class Told(NamedTuple):
    """A cause in words."""

    cause: str
    """What is wrong, in a clause of its own."""
    cure: str


def told(fit: ForceFit, trial: ForceEvidence) -> Told:
    """One cause, its directions those of the walk of `trial`."""
    return WORDS[fit.cause.kind](fit, trial)


def _of(fit: ForceFit) -> str:
    names = fit.cause.plates
    return f"plate {names[0]}" if names else "all plates"


def _subject(fit: ForceFit, thing: str) -> str:
    return f"{thing} of {_of(fit)}"


def _along_walk(fit: ForceFit, trial: ForceEvidence) -> Array:
    """(2,) forward and to the right, of a vector in the room."""
    out: Array = (trial.room[:, [0, 2]] @ fit.x)[[0, 2]]
    return out


def _way(vector: Array) -> str:
    """`31 mm too far forward and 12 mm too far to the right`, without what is small beside the other."""
    words = []
    for value, names in zip(1e3 * vector, (("forward", "back"), ("to the right", "to the left")), strict=True):
        if abs(value) > 0.25e3 * np.abs(vector).max():
            words.append(f"{abs(value):.0f} mm too far {names[0] if value > 0 else names[1]}")
    return " and ".join(words)


def _clock(fit: ForceFit, trial: ForceEvidence) -> Told:
    ms = 1e3 * float(fit.x[0])
    return Told(
        f"the forces come {abs(ms):.0f} ms {'late' if ms > 0 else 'early'}",
        f"make the times of the forces {abs(ms):.0f} ms {'smaller' if ms > 0 else 'larger'}, and look for the delay "
        "between cameras and plates",
    )


def _place(fit: ForceFit, trial: ForceEvidence) -> Told:
    verb = "lie" if not fit.cause.plates else "lies"
    return Told(
        f"{_of(fit)} {verb} {_way(_along_walk(fit, trial))} (seen along '{trial.name}')",
        "correct the corners of the plates (or the points of application), or the origin of the markers",
    )


def _yaw(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg((fit.x[0] + np.pi) % (2 * np.pi) - np.pi))
    verb = "are" if not fit.cause.plates else "is"
    return Told(
        f"{_of(fit)} {verb} turned by {abs(degrees):.0f} deg about the vertical "
        f"({'anticlockwise' if degrees > 0 else 'clockwise'}, seen from above)",
        "correct the corners of the plates and their order, or the axes of the forces",
    )


def _tilt(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg(np.linalg.norm(fit.x)))
    verb = "are" if not fit.cause.plates else "is"
    return Told(
        f"{_of(fit)} {verb} tilted by {degrees:.1f} deg against the floor of the markers",
        "correct the corners of the plates, or calibrate the cameras again with the wand level on the plates",
    )


def _markers_tilted(fit: ForceFit, trial: ForceEvidence) -> Told:
    degrees = float(np.rad2deg(np.linalg.norm(fit.x)))
    return Told(
        f"the markers are tilted by {degrees:.1f} deg against the vertical and the plates",
        "calibrate the cameras again with the wand level on the plates",
    )


def _factor(thing: str, cure: str) -> Callable[[ForceFit, ForceEvidence], Told]:
    def words(fit: ForceFit, trial: ForceEvidence) -> Told:
        factor = float(told_size(fit)[0])
        percent = 100.0 * (factor - 1.0)
        if abs(percent) < 80.0:
            size = f"is {abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"
        else:
            size = f"is {factor:.3g} times what it should be"
        or_mass = " (or mass_kg is wrong by the same share)" if _is_mass(fit) else ""
        return Told(f"{_subject(fit, thing)} {size}{or_mass}", f"correct mass_kg, or {cure}" if or_mass else cure)

    return words


def _is_mass(fit: ForceFit) -> bool:
    """The gain of all plates cannot be told from the mass of the person."""
    return fit.cause.kind is Kind.GAIN and not fit.cause.plates


def _free_moment(fit: ForceFit, trial: ForceEvidence) -> Told:
    needed = 1.0 + float(fit.x[0])
    cure = "check unit and sign of the moment about the vertical, and about which point it is given"
    if needed < -0.3:
        return Told(f"the {_subject(fit, 'free moment')} has the wrong sign", cure)
    if abs(needed) < 0.05:
        return Told(f"the {_subject(fit, 'free moment')} is far too large, or not one of this trial", cure)
    size = 1.0 / needed
    return Told(f"the {_subject(fit, 'free moment')} is {size:.2g} times what it should be", cure)


def _offset(fit: ForceFit, trial: ForceEvidence) -> Told:
    newtons = float(fit.x[0])
    many = "each of all plates" if not fit.cause.plates else _of(fit)
    return Told(
        f"the vertical force of {many} is {abs(newtons):.0f} N too {'large' if newtons > 0 else 'small'} throughout",
        "take away what the empty plate reads",
    )


def _plain(cause: str, cure: str) -> Callable[[ForceFit, ForceEvidence], Told]:
    """`{of}` in the cause: the plates."""
    return lambda fit, trial: Told(cause.format(of=_of(fit), unit=fit.cause.unit), cure.format(unit=fit.cause.unit))


def _exchanged(fit: ForceFit, trial: ForceEvidence) -> Told:
    one, other = fit.cause.plates
    return Told(
        f"plates {one} and {other} have changed places", "exchange their corners, or their channels (columns of forces)"
    )


def _trunk(fit: ForceFit, trial: ForceEvidence) -> Told:
    forward, right = 1e3 * fit.x
    words = []
    for value, names in ((forward, ("forward of", "behind")), (right, ("to the right of", "to the left of"))):
        if abs(value) > 0.25 * max(abs(forward), abs(right)):
            words.append(f"{abs(value):.0f} mm {names[0] if value > 0 else names[1]}")
    seen = "markers on the trunk show it upright" if trial.trunk_seen else "markers do not determine how it turns"
    return Told(
        f"the trunk's weight lies {' and '.join(words)} where the model has it ({seen})",
        "a static trial that stands upright, and markers on the trunk (C7, sternum) in all trials",
    )


SIGN = "turn the sign of that column of the forces"
CHANNELS = "correct the gain (calibration matrix, amplifier) of the plate"
WORDS: Mapping[Kind, Callable[[ForceFit, ForceEvidence], Told]] = {
    Kind.CLOCK: _clock,
    Kind.PLACE: _place,
    Kind.YAW: _yaw,
    Kind.TILT: _tilt,
    Kind.MARKERS_TILTED: _markers_tilted,
    Kind.GAIN: _factor("the force", CHANNELS),
    Kind.VERTICAL_GAIN: _factor("the vertical force", CHANNELS),
    Kind.HORIZONTAL_GAIN: _factor("the horizontal force", CHANNELS),
    Kind.FORE_AFT_GAIN: _factor("the fore-aft force", CHANNELS),
    Kind.SIDEWAYS_GAIN: _factor("the sideways force", CHANNELS),
    Kind.FREE_MOMENT: _free_moment,
    Kind.OFFSET: _offset,
    Kind.SIGN_FORE_AFT: _plain("the fore-aft force of {of} has the wrong sign", SIGN),
    Kind.SIGN_SIDEWAYS: _plain("the sideways force of {of} has the wrong sign", SIGN),
    Kind.SIGN_HORIZONTAL: _plain("both horizontal forces of {of} have the wrong sign", SIGN),
    Kind.SIGN_VERTICAL: _plain("the vertical force of {of} alone has the wrong sign", SIGN),
    Kind.AXES: _plain(
        "the horizontal axes of {of} are exchanged", "exchange the columns (channels) of the horizontal forces"
    ),
    Kind.FORCE_UNIT: _plain("the forces are in {unit}, not in N", "give forces in N"),
    Kind.MOMENT_UNIT: _plain("the moments of the plates are in N·mm, not in N·m", "divide the moments by 1000"),
    Kind.CENTRE_UNIT: _plain("the centre of pressure is in {unit}, not in m", "give points of application in m"),
    Kind.EXCHANGED: _exchanged,
    Kind.TRUNK: _trunk,
}
CODES: Mapping[Kind, Code] = {
    Kind.CLOCK: Code.CLOCKS_DIFFER,
    Kind.PLACE: Code.PLATES_ELSEWHERE,
    Kind.YAW: Code.PLATE_AXES,
    Kind.AXES: Code.PLATE_AXES,
    **dict.fromkeys((Kind.TILT, Kind.MARKERS_TILTED), Code.TILTED),
    **dict.fromkeys((Kind.GAIN, Kind.VERTICAL_GAIN, Kind.HORIZONTAL_GAIN), Code.FORCE_GAIN),
    **dict.fromkeys((Kind.FORE_AFT_GAIN, Kind.SIDEWAYS_GAIN), Code.FORCE_GAIN),
    Kind.FREE_MOMENT: Code.FREE_MOMENT,
    Kind.OFFSET: Code.PLATE_OFFSET,
    **dict.fromkeys((Kind.SIGN_FORE_AFT, Kind.SIGN_SIDEWAYS), Code.FORCE_SIGN),
    **dict.fromkeys((Kind.SIGN_HORIZONTAL, Kind.SIGN_VERTICAL), Code.FORCE_SIGN),
    **dict.fromkeys((Kind.FORCE_UNIT, Kind.MOMENT_UNIT, Kind.CENTRE_UNIT), Code.FORCE_UNIT),
    Kind.EXCHANGED: Code.PLATES_EXCHANGED,
    Kind.TRUNK: Code.TRUNK_WEIGHT,
}
