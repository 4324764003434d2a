"""Which foot a force plate carries, and in which frames every foot on the ground is on a plate.

A plate's loaded stretches are given to the foot under whose sole the centre of pressure lies, stretch by stretch,
unless the study says which foot it is; a foot on two plates gets the sum of both. Whether a foot is down at all is told
by its motion alone: its heel or its toe rests. Where a foot is down and no plate carries it, or where it rests partly
beside its plate, the ground reaction is not known and the frame is not valid. The size of the forces plays no part in
this: residuals stay a check.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.dynamics.plate_outline import OVERHANG_M, outline_known, outside
from gaitcal.findings import Finding, Severity
from gaitcal.recording import filter_plate, resample_wrench
from gaitcal.recording.filters import filterable
from gaitcal.recording.force_plate import LOADED_N, centre_on_ground
from gaitcal.recording.intervals import runs
from gaitcal.recording.recording import ForcePlate

SIDE_WORDS = ("right", "left")
RESTING = 0.4
"""m/s: a heel or toe slower than this is down; in swing both move faster, also in slow gait."""
EDGE = 0.08
"""s by which resting and true contact may differ at the beginning and end of a contact; on plates they differ by up to
0.04 s (`subject01`, `pig_c3d`)."""
UNDER_FOOT = 0.15
"""m: largest distance of the centre of pressure from the line heel-toe of the foot that it belongs to."""
SPLINE_ENDS = 2
"""Knot spans at either end of a trial whose accelerations nothing before or after supports; not valid."""
SHORTEST = 0.05
"""s: a shorter loading is a knock, not a step."""


@dataclass(frozen=True, kw_only=True)
class FootPoints:
    """Heel and toe of both feet, from the tracked model: order right, left."""

    heel: Array
    """(nf, 2, 3) m."""
    toe: Array
    """(nf, 2, 3) m."""
    tip: Array
    """(nf, 2, 3) m, the foremost point of the sole."""
    heel_speed: Array
    """(nf, 2) m/s, against the ground."""
    toe_speed: Array
    """(nf, 2) m/s, against the ground."""


@dataclass(frozen=True, kw_only=True)
class GroundReactions:
    """Ground reactions on the feet at the marker frames."""

    wrench: Array
    """(nf, 2, 6) [force N; moment N·m about the laboratory origin] on the right and left foot; 0 where none."""
    valid: BoolArray
    """(nf,) every foot on the ground is wholly on a plate."""
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


def ground_velocity(points: Array, velocity: Array) -> Array:
    """(3,) m/s, how the ground moves under feet with points and velocities (nf, n, 3): the median of the lowest one's.

    Zero on a floor, the belt's velocity on a treadmill; zero, too, where it is less than a resting foot's.
    """
    whole = np.isfinite(points).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
    if not whole.any():
        return np.zeros(3)
    lowest = points[whole, :, 1].argmin(axis=1)
    out: Array = np.median(velocity[whole, lowest], axis=0)
    return out if np.linalg.norm(out) > RESTING else np.zeros(3)


def ground_reactions_on_feet(
    plates: Sequence[ForcePlate],
    time: Array,
    feet: FootPoints,
    *,
    cutoff: float | None,
    ends: float = 0.0,
    assigned: Mapping[str, str] | None = None,
) -> GroundReactions:
    """Assign plates to feet, filter their wrenches and bring them to the marker frames.

    Parameters
    ----------
    time : (nf,) s of the marker frames.
    cutoff : Hz of the zero-lag low-pass filter on the wrenches; None: none.
    ends : s at the beginning and end of the trial that are not valid, as accelerations are not supported there.
    assigned : plate name -> "r", "l" or "none", from the study; the rest is found.
    """
    wrench, loaded = np.zeros((len(time), 2, 6)), np.zeros((len(time), 2), dtype=bool)
    notes: list[str] = []
    findings: list[Finding] = []
    covered = np.ones(len(time), dtype=bool)
    steps: list[_Step] = []
    for plate in plates:
        raw = np.nan_to_num(resample_wrench(plate, time))
        smooth = resample_wrench(_filtered(plate, cutoff), time)
        covered &= np.isfinite(smooth).all(axis=1)
        smooth = np.nan_to_num(smooth)
        pressed = raw[:, 1] > LOADED_N
        side = (assigned or {}).get(plate.name)
        if side == "none":
            continue
        for stretch in (run for run in runs(pressed) if time[run.stop - 1] - time[run.start] >= SHORTEST):
            span = f"plate {plate.name}, {time[stretch.start]:.2f}-{time[stretch.stop - 1]:.2f} s"
            foot = {"r": 0, "l": 1}.get(side) if side else _foot_under(raw, stretch, feet)
            if foot is None:
                findings.append(_under_neither(plate, span))
                continue
            wide = _widen(stretch, pressed, time, cutoff)
            wrench[wide, foot] += smooth[wide]
            loaded[stretch, foot] = True
            steps.append(_Step(foot, stretch, plate, span))
            how = "as the study says" if side else "by its centre of pressure"
            notes.append(f"{span}: {SIDE_WORDS[foot]} foot, {how}")
    resting = np.minimum(feet.heel_speed, feet.toe_speed) < RESTING
    unmeasured = near(resting & ~near(loaded, time), time)
    valid = covered & ~unmeasured.any(axis=1) & loaded.any(axis=1) if plates else np.zeros(len(time), dtype=bool)
    valid &= (time >= time[0] + ends) & (time <= time[-1] - ends)
    partly, beside = _beside_plates(steps, time, feet)
    return GroundReactions(
        wrench=wrench,
        valid=valid & ~partly,
        loaded=loaded,
        resting=resting,
        notes=tuple(notes),
        findings=(*findings, *beside),
    )


@dataclass(frozen=True)
class _Step:
    """One loading of one plate."""

    foot: int
    """0 right, 1 left."""
    frames: slice
    plate: ForcePlate
    words: str
    """Plate and time, for messages."""

    def meets(self, other: _Step) -> bool:
        """Whether both carry one foot in some of the same frames."""
        overlap = self.frames.start < other.frames.stop and other.frames.start < self.frames.stop
        return self.foot == other.foot and bool(overlap)


def _under_neither(plate: ForcePlate, span: str) -> Finding:
    return Finding(
        severity=Severity.WARNING,
        topic="plate to foot",
        where="",
        cause=f"the load on plate {plate.name} is under neither foot",
        found=f"{span}: its centre of pressure is further than {1e3 * UNDER_FOOT:.0f} mm from both feet; left out",
        cure="check the position of the plate (corners), the axes of the forces, and that they belong to this trial",
    )


def _beside_plates(steps: Sequence[_Step], time: Array, feet: FootPoints) -> tuple[BoolArray, list[Finding]]:
    """Frames in which an end of a loaded foot rests beside the plates that carry it, and what to say of them."""
    partly, findings = np.zeros(len(time), dtype=bool), []
    for step in steps:
        frames, foot = step.frames, step.foot
        carriers = [other.plate for other in steps if other.meets(step)]
        if not all(outline_known(plate, LOADED_N) for plate in carriers):
            if step.plate.corners is not None:
                found = f"{step.words}: the centre of pressure leaves the plate's corners; corners not used"
                findings.append(_note(f"the corners of plate {step.plate.name} do not hold its forces", found))
            continue
        for name, path, speed in (("heel", feet.heel, feet.heel_speed), ("toes", feet.tip, feet.toe_speed)):
            away = outside(carriers, path[frames, foot])
            beside = (speed[frames, foot] < RESTING) & (away > OVERHANG_M)
            if beside.any():
                partly[frames] |= beside
                first, last = time[frames][beside][[0, -1]]
                found = f"{step.words}: the {name} of the {SIDE_WORDS[foot]} foot rest up to "
                found += f"{1e3 * away[beside].max():.0f} mm beside the plate; not valid, {first:.2f}-{last:.2f} s"
                findings.append(_note(f"a foot rests partly beside plate {step.plate.name}", found))
    return partly, findings


def _note(cause: str, found: str) -> Finding:
    """A fact that frames that are not valid, or an outline that is not used, already answer."""
    return Finding(severity=Severity.INFO, topic="plate to foot", where="", cause=cause, found=found, cure="")


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


def _foot_under(wrench: Array, stretch: slice, feet: FootPoints) -> int | None:
    """The foot whose heel-toe line is nearest to the centre of pressure, weighed by the load."""
    load, centre = wrench[stretch, 1], centre_on_ground(wrench[stretch])[:, [0, 2]]
    heel, toe = feet.heel[stretch][:, :, [0, 2]], feet.toe[stretch][:, :, [0, 2]]
    distances = [np.average(distance_to_line(centre, heel[:, k], toe[:, k]), weights=load) for k in range(len(FEET))]
    best = int(np.argmin(distances))
    return best if distances[best] < UNDER_FOOT else None


def distance_to_line(point: Array, a: Array, b: Array) -> Array:
    """(n,) m, from points (n, 2) to the stretches from a to b (n, 2)."""
    along = b - a
    t = np.clip(np.sum((point - a) * along, axis=1) / np.maximum(np.sum(along * along, axis=1), 1e-12), 0.0, 1.0)
    out: Array = np.linalg.norm(a + t[:, None] * along - point, axis=1)
    return out


def near(marked: BoolArray, time: Array) -> BoolArray:
    """(nf,) or (nf, feet) frames within `EDGE` of a marked one, at `time` (nf,) s."""
    if marked.ndim > 1:
        return np.stack([near(column, time) for column in marked.T], axis=1)
    times = time[marked]
    if not len(times):
        return marked.copy()
    after = np.clip(np.searchsorted(times, time), min(1, len(times) - 1), len(times) - 1)
    gap = np.minimum(np.abs(time - times[after]), np.abs(time - times[np.maximum(after - 1, 0)]))
    out: BoolArray = marked | (gap <= EDGE)
    return out
