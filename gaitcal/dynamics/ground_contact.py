"""What the ground does to each foot, and in which frames that is known for each leg.

A leg's torques need its own foot: on the ground wholly on plates that together carry it, or in the air. Where a foot is
down and no plate carries it, where it rests partly beside its plates, where a plate carries both feet, or where the
centre of pressure is not under it, the torques of that leg are not valid; those of the other leg may be. Pelvis, trunk
and the fit of masses need both feet at once. Whether a foot is down at all is told by its motion, or by events
(`foot_contact.py`). The size of the forces plays no part in this: residuals stay a check.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints, on_the_floor
from gaitcal.dynamics.off_sole import off_sole_frames
from gaitcal.dynamics.partly_carried import beside_plates, shared_plates
from gaitcal.dynamics.plate_steps import SIDE_WORDS, Step, steps_on
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import LOADED_N, filter_plate, filterable, resample_wrench
from gaitcal.io.labels import FootEvent
from gaitcal.io.recording import ForcePlate
from gaitcal.model.coordinates import LEG_COORDINATES
from gaitcal.model.linkage import SIDES

_OF_LEG = tuple(dict.fromkeys(f"{name.split('_')[0]}_" for name in LEG_COORDINATES))
"""How the names of what belongs to a leg begin."""
SPLINE_ENDS = 2
"""Knot spans at either end of a trial whose accelerations nothing before or after supports; not valid."""


@dataclass(frozen=True, kw_only=True)
class GroundReactions:
    """Ground reactions on the feet at the marker frames."""

    wrench: Array
    """(nf, 2, 6) [force N; moment N·m about the laboratory origin] on the right and left foot; 0 where none."""
    valid: BoolArray
    """(nf,) whole body: each foot is wholly on plates of its own or in the air, by its motion alone, too, and a plate
    carries the body. Masses are fitted to these frames: no event that somebody set decides on them, and no centre of
    pressure, which would make a residual small by construction."""
    valid_legs: BoolArray
    """(nf, 2) right, left: that foot is on the ground wholly on plates of its own, with the centre of pressure under
    it, or in the air."""
    loaded: BoolArray
    """(nf, 2) a plate carries the foot."""
    resting: BoolArray
    """(nf, 2) the foot is down, judged by its motion."""
    notes: tuple[str, ...]
    """What was found and assumed."""
    findings: tuple[Finding, ...] = ()
    """What speaks against these ground reactions, and frames that they leave out; without the name of their trial."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against these ground reactions, in words."""
        return tuple(f.evidence for f in self.findings if f.severity is not Severity.INFO)

    @property
    def valid_r(self) -> BoolArray:
        """(nf,) of the right leg."""
        return np.asarray(self.valid_legs[:, 0])

    @property
    def valid_l(self) -> BoolArray:
        """(nf,) of the left leg."""
        return np.asarray(self.valid_legs[:, 1])

    @property
    def has_torques(self) -> bool:
        """Whether a leg is valid in some frame in which a plate carries it."""
        return bool((self.valid_legs & self.loaded).any())

    def valid_for(self, name: str) -> BoolArray:
        """(nf,) of a coordinate or torque: `hip_flexion_r` as its leg, what belongs to no leg as the whole body."""
        side = leg_of(name)
        return self.valid_legs[:, SIDES.index(side)] if side else self.valid

    def without(self, legs: Sequence[str]) -> GroundReactions:
        """The same with no valid frame of some legs (`r`, `l`), and so none of the whole body."""
        kept = np.array([side not in legs for side in SIDES])
        return replace(self, valid=self.valid & kept.all(), valid_legs=self.valid_legs & kept)


def leg_of(name: str) -> str:
    """`r` or `l` of a coordinate or torque of a leg; empty for pelvis, trunk and arms."""
    return name[-1] if name.startswith(_OF_LEG) and name[-2:-1] == "_" and name[-1] in SIDES else ""


def ground_reactions_on_feet(
    plates: Sequence[ForcePlate],
    time: Array,
    feet: FootPoints,
    *,
    cutoff: float | None,
    ends: float = 0.0,
    assigned: Mapping[str, str] | None = None,
    events: Sequence[FootEvent] = (),
) -> GroundReactions:
    """Assign plates to feet, filter their wrenches and bring them to the marker frames.

    Parameters
    ----------
    time : (nf,) s of the marker frames.
    cutoff : Hz of the zero-lag low-pass filter on the wrenches; None: none.
    ends : s at the beginning and end of the trial that are not valid, as accelerations are not supported there.
    assigned : plate name -> "r", "l" or "none", from the study; the rest is found.
    events : of the file, for feet beside all plates; used where they agree with the plates.
    """
    wrench, loaded = np.zeros((len(time), 2, 6)), np.zeros((len(time), 2), dtype=bool)
    notes: list[str] = []
    findings: list[Finding] = []
    known = np.full(len(time), bool(plates))
    steps: list[Step] = []
    for plate in plates:
        raw = np.nan_to_num(resample_wrench(plate, time))
        smooth = resample_wrench(_filtered(plate, cutoff), time)
        known &= np.isfinite(smooth).all(axis=1)
        side = (assigned or {}).get(plate.name)
        if side == "none":
            continue
        found, unfit = steps_on(plate, raw, time, feet, side)
        findings += unfit
        for step in found:
            wide = _widen(step.frames, raw[:, 1] > LOADED_N, time, cutoff)
            wrench[wide, step.foot] += np.nan_to_num(smooth[wide])
            loaded[step.frames, step.foot] = True
            how = "as the study says" if side else "by its centre of pressure"
            notes.append(f"{step.words}: {SIDE_WORDS[step.foot]} foot, {how}")
        steps += found
    resting = feet.resting
    floor, at_most = (on_the_floor(resting, loaded, time, told) for told in (events, ()))
    used = [plate for plate in plates if (assigned or {}).get(plate.name) != "none"]
    partly, beside = beside_plates(steps, used, time, feet, loaded)
    shared, both = shared_plates(steps, used, time, feet, at_most)
    off, unlike = off_sole_frames(steps, time, feet)
    inner = known & (time >= time[0] + ends) & (time <= time[-1] - ends)
    legs = inner[:, None] & ~floor & ~partly & ~shared[:, None]
    return GroundReactions(
        wrench=wrench,
        valid=legs.all(axis=1) & loaded.any(axis=1) & ~at_most.any(axis=1),
        valid_legs=legs & ~off,
        loaded=loaded,
        resting=resting,
        notes=tuple(notes),
        findings=(*findings, *beside, *both, *unlike),
    )


def _filtered(plate: ForcePlate, cutoff: float | None) -> ForcePlate:
    """The plate filtered, where its sampling holds anything above `cutoff`."""
    return plate if cutoff is None or not filterable(plate, cutoff) else filter_plate(plate, cutoff)


def _widen(stretch: slice, pressed: BoolArray, time: Array, cutoff: float | None) -> slice:
    """A stretch with the tails that the filter makes, up to half way to the plate's next loading."""
    if cutoff is None:
        return stretch
    tail = 1.0 / cutoff
    before = np.flatnonzero(pressed[: stretch.start])
    after = np.flatnonzero(pressed[stretch.stop :])
    low = 0 if not len(before) else (int(before[-1]) + stretch.start) // 2 + 1
    high = len(time) if not len(after) else (stretch.stop + int(after[0]) + stretch.stop) // 2
    start = int(np.searchsorted(time, time[stretch.start] - tail))
    stop = int(np.searchsorted(time, time[stretch.stop - 1] + tail)) + 1
    return slice(max(start, low), min(stop, high))
