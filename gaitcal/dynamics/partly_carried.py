"""Feet that plates measure in part only, or together with the other foot: frames in which no torque of a leg is known.

**Beside.** What of a sole rests beside all plates presses on the floor, and no plate tells how much. Two things speak
for a loss that matters, each by itself:

- more than a tenth of the half that rests, heel or toes, lies there (`MOST_BESIDE`). In a walk with 39 mm of the heel
  beside (9 % of the sole) they bear 60 % of the body as the other foot leaves the ground and 20 % in mid-stance, with
  the centre of pressure of what is measured far ahead. Where the plates read nothing yet, or no more, all that the foot
  bears may be on any part of it that lies beside;
- the centre of pressure comes near to what lies beside (`REACH_ALONG`, `REACH_ACROSS`). A heel whose marker is 26 mm
  beside the plate, 3 % of the sole, loses 12 % while the centre of pressure is within 40 mm of the edge, and nothing to
  speak of afterwards.

A foot bears a little before it is seen to rest, and after: as much of it is lost there as in the next resting frame.

Forces measured elsewhere play no part: these figures come from walks whose body's acceleration was asked afterwards.

**Shared.** A plate under both feet tells the sum of them: neither leg is known. Where the corners of a plate are not
known, the centre of pressure says whether the other foot stands on it too: it leaves the sole then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import LANDING, LEAVING, FootPoints, SoleCells, near, sole_of
from gaitcal.dynamics.plate_errors import outline_known
from gaitcal.dynamics.plate_steps import SIDE_WORDS, Step, meeting
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import LOADED_N, centre_on_ground
from gaitcal.io.intervals import runs
from gaitcal.io.recording import ForcePlate
from gaitcal.model.linkage import SIDES

MOST_BESIDE = 0.10
"""Of the area of a half of the sole: 17 mm of a heel."""
REACH_ALONG, REACH_ACROSS = 0.04, 0.02
"""m along and across the foot within which the pressure is spread round its centre."""
OFF_SOLE_M = 0.03
"""A centre of pressure further from the sole is not of this foot alone."""
OFTEN = 0.1
"""Share of the frames in which it must be, as the centre of a small load is noise."""


def beside_plates(
    steps: Sequence[Step], plates: Sequence[ForcePlate], time: Array, feet: FootPoints, loaded: BoolArray
) -> tuple[BoolArray, list[Finding]]:
    """(nf, 2) frames in which a foot rests partly beside its plates, and what to say of them.

    Parameters
    ----------
    plates : all that may carry a foot; those with an outline are one surface.
    loaded : (nf, 2) a plate carries the foot.
    """
    partly, findings = np.zeros_like(loaded), []
    surface = [plate for plate in plates if outline_known(plate, LOADED_N)]
    down: BoolArray = loaded | feet.resting
    for foot in range(loaded.shape[1]):
        for contact in runs(down[:, foot]):
            carriers = meeting(steps, foot, contact)
            if not carriers:
                continue
            unknown = [step for step in carriers if not outline_known(step.plate, LOADED_N)]
            if unknown:
                findings += [_no_outline(step) for step in unknown if step.plate.corners is not None]
                continue
            sole = sole_of(feet, foot, contact)
            beside = sole.beside(surface)
            lost = _bears_beside(sole, beside, loaded[contact, foot]) | _reached(sole, beside, carriers, contact)
            if lost.any():
                around = _around(lost, contact, time)
                partly[:, foot] |= around
                share = float(sole.share_of(beside)[lost].max())
                findings.append(_beside(carriers, foot, time[around], share))
    return partly, findings


def _bears_beside(sole: SoleCells, beside: BoolArray, loaded: BoolArray) -> BoolArray:
    """(nf,) what rests beside the plates may bear much, judged by motion; before and after resting as next to it."""
    resting = beside & sole.resting
    lost = (sole.share_of_halves(resting) > MOST_BESIDE).any(axis=1)
    lost |= resting.any(axis=1) & ~loaded  # all that the foot bears may be there
    down = np.flatnonzero(sole.resting.any(axis=1))
    if len(down):
        lost[: down[0]], lost[down[-1] + 1 :] = lost[down[0]], lost[down[-1]]
    return np.asarray(lost)


def _around(lost: BoolArray, contact: slice, time: Array) -> BoolArray:
    """(nf,) lost frames of a contact (its own), and those around it in which the foot may bear already, or still."""
    out = np.zeros(len(time), dtype=bool)
    out[contact] = lost
    if lost[0]:
        out |= (time < time[contact.start]) & (time > time[contact.start] - LANDING)
    if lost[-1]:
        out |= (time >= time[contact.stop - 1]) & (time < time[contact.stop - 1] + LEAVING)
    return out


def _reached(sole: SoleCells, beside: BoolArray, carriers: Sequence[Step], frames: slice) -> BoolArray:
    """(nf,) the centre of pressure comes near to a part of the sole that lies beside the plates."""
    wrench = np.sum([_own(step, frames) for step in carriers], axis=0)
    pressed = wrench[:, 1] > LOADED_N
    corners = [step.plate.corners for step in carriers if step.plate.corners is not None]
    centre = np.full((len(wrench), 3), np.nan)
    centre[pressed] = centre_on_ground(wrench[pressed], float(np.mean([c[:, 1].mean() for c in corners])))
    along, across = sole.offsets(centre)
    with np.errstate(invalid="ignore"):
        reached = beside & (along < REACH_ALONG) & (across < REACH_ACROSS)
    return np.asarray(reached.any(axis=1))


def _own(step: Step, frames: slice) -> Array:
    """(n, 6) the wrench of a step in `frames`, zero outside of it."""
    out = np.zeros((frames.stop - frames.start, 6))
    first, last = max(step.frames.start, frames.start), min(step.frames.stop, frames.stop)
    out[first - frames.start : last - frames.start] = step.wrench[first:last]
    return out


def shared_plates(
    steps: Sequence[Step], plates: Sequence[ForcePlate], time: Array, feet: FootPoints, on_floor: BoolArray
) -> tuple[BoolArray, list[Finding]]:
    """(nf,) frames in which one plate carries both feet, and what to say of them.

    Parameters
    ----------
    plates : all that may carry a foot.
    on_floor : (nf, 2) a foot is on the ground and no plate was given to it.
    """
    shared, findings = np.zeros(len(time), dtype=bool), []
    surface = [plate for plate in plates if outline_known(plate, LOADED_N)]
    for step in steps:
        other, frames = 1 - step.foot, step.frames
        if outline_known(step.plate, LOADED_N):
            sole = sole_of(feet, other, frames)
            here = (sole.share_of_halves(_only_on(step.plate, sole, surface)) > MOST_BESIDE).any(axis=1)
            both = np.zeros(len(time), dtype=bool)
            both[frames] = here
            both = near(both, time) & _within(frames, len(time))
        else:
            both = _within(frames, len(time)) & on_floor[:, other] & _leaves_sole(step, steps, feet, on_floor[:, other])
        if both.any():
            shared |= both
            findings.append(_shared(step, time[both]))
    return shared, findings


def _only_on(plate: ForcePlate, sole: SoleCells, surface: Sequence[ForcePlate]) -> BoolArray:
    """(nf, n) resting cells on this plate, and on no other one: an edge between two is not known to the millimetre."""
    others = [other for other in surface if other is not plate]
    return sole.resting & ~sole.beside([plate]) & sole.beside(others)


def _leaves_sole(step: Step, steps: Sequence[Step], feet: FootPoints, floor: BoolArray) -> bool:
    """Whether the centre of pressure is not under the foot alone while the other one stands somewhere."""
    frames = step.frames
    wrench = np.sum([_own(other, frames) for other in meeting(steps, step.foot, frames)], axis=0)
    chosen = floor[frames] & (wrench[:, 1] > LOADED_N)
    if not chosen.any():
        return False
    centre = centre_on_ground(wrench[chosen])
    cells = sole_of(feet, step.foot, frames).cells[chosen]
    away = np.linalg.norm((cells - centre[:, None])[:, :, [0, 2]], axis=2).min(axis=1)
    return bool(np.mean(away > OFF_SOLE_M) > OFTEN)


def _within(frames: slice, count: int) -> BoolArray:
    out = np.zeros(count, dtype=bool)
    out[frames] = True
    return out


def _note(code: Code, cause: str, found: str, leg: str = "") -> Finding:
    """A fact that frames that are not valid, or an outline that is not used, already answer."""
    return Finding(
        severity=Severity.INFO, topic="plate to foot", where="", cause=cause, found=found, cure="", leg=leg, code=code
    )


def _no_outline(step: Step) -> Finding:
    found = f"{step.words}: the centre of pressure leaves the plate's corners; corners not used"
    return _note(Code.PLATE_CORNERS, f"the corners of plate {step.plate.name} do not hold its forces", found)


def _beside(carriers: Sequence[Step], foot: int, times: Array, share: float) -> Finding:
    names = " and ".join(dict.fromkeys(step.plate.name for step in carriers))
    found = f"{100 * share:.0f} % of the sole of the {SIDE_WORDS[foot]} foot lie beside it; not valid for "
    found += f"this leg, {times[0]:.2f}-{times[-1]:.2f} s"
    return _note(Code.FOOT_BESIDE_PLATE, f"a foot rests partly beside plate {names}", found, SIDES[foot])


def _shared(step: Step, times: Array) -> Finding:
    found = f"plate {step.plate.name}, {times[0]:.2f}-{times[-1]:.2f} s: it carries both feet at once, and tells their "
    found += "sum; not valid for either leg"
    return _note(Code.BOTH_FEET, f"both feet are on plate {step.plate.name}", found)
