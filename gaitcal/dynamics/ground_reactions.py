"""Ground reactions on each foot, and the frames in which they are valid for each leg.

The torques of a leg need the ground reaction of its foot: completely on plates that together carry
it, or in the air. They are not valid where the foot is on the ground without a plate, partly beside
its plates, on a plate with the other foot, or not under the centre of pressure. The other leg may
still be valid. Pelvis, trunk and the inertial fit need both feet at once. Contact with the ground
is detected by motion, or by events (`foot_contact.py`). The size of the forces is not used, so that
residuals remain an independent check. Where no marker of a leg segment is visible, its motion is an
interpolation: these frames are not valid for that leg, nor for the whole body.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.display import Displayed
from gaitcal.dynamics import inverse_dynamics, off_sole, plate_outline
from gaitcal.dynamics.foot_contact import (
    FOOT_BREADTH,
    RESTING_SPEED,
    FootContact,
    FootPoints,
    detect_floor_contact,
    estimate_belt_velocities,
    find_steps,
    mark_near,
)
from gaitcal.errors import Code, Finding, InputError, Severity
from gaitcal.io.force_plate import (
    LOADED_N,
    filter_plate,
    is_filterable,
    resample_wrench,
    split_wrench,
)
from gaitcal.io.labels import FootEvent
from gaitcal.io.recording import ForcePlate, Recording, find_runs, format_spans, measure_duration
from gaitcal.model import coordinates, kinematics
from gaitcal.model.linkage import COORDINATES, LEG_SEGMENTS, SIDE_WORDS, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.tracking.motion import Motion
from gaitcal.tracking.spline import DEGREE

if TYPE_CHECKING:
    import pandas as pd

_LEG_PREFIXES = tuple(
    dict.fromkeys(f"{name.split('_')[0]}_" for name in coordinates.LEG_COORDINATES)
)
"""Beginnings of the names of coordinates and torques of a leg."""
END_SPANS = 2
"""Knot spans at either end of a trial that are not valid, as their accelerations lack neighbours.
"""
FORCE_HZ = 50.0
"""Hz, default filter of the plates. RMS errors of leg torques on synthetic walks whose
truth is known, true model, mean of three seeds, N·m (50 Hz, filtered like the motion, not
filtered): impacts that shake the whole body 2.16, 5.06, 2.64; the same under skin movement 3.46,
10.19, 3.78; impacts of the feet 3.83, 4.25, 4.10; no impacts 1.52, 2.09, 1.66.
"""
END_CYCLES = 0.5
"""Periods of the cut-off at either end of a smoothed motion that are not valid, as its
accelerations have data on one side only.
"""
MAX_FORCE_MISMATCH = 0.25
"""Share of body weight: larger vertical residuals are reported, and kept. The largest of subject01
is 0.11."""
FALLING_SHARE = 0.5
"""Share of gravity: heel and toe that accelerate downwards by more are in the air."""
SITTING_DEG = 60.0
"""deg, lean of the thighs from the vertical. Standing: up to 10, crouching children up to 40."""
SEAT_LOAD = 0.05
"""Share of body weight that remains on a seat during rising; residuals are as large."""
FORCE_MISMATCH_CAUSE = "the plates' vertical force contradicts the body's acceleration"
MIN_MISMATCH_S = 0.05
"""s, shortest mismatch. A motion cannot show the impact of a heel, over in 10 to 20 ms (Whittle
1999)."""


@dataclass(frozen=True, kw_only=True, repr=False)
class GroundReactions(Displayed):
    """Ground reactions on the feet at the marker frames."""

    wrench: Array
    """(nf, 2, 6) [force N; moment N·m about the laboratory origin] on the right and left foot; 0
    where none.
    """
    valid: BoolArray
    """(nf,) whole body: each foot is completely on its plates or in the air, by its motion alone
    too, and a plate carries the body. Masses are fitted to these frames. Neither events of the file
    nor centres of pressure select them, as these would make a residual small by construction."""
    valid_legs: BoolArray
    """(nf, 2) right, left: the foot is completely on its plates, with the centre of pressure under
    it, or in the air."""
    loaded: BoolArray
    """(nf, 2) a plate carries the foot."""
    resting: BoolArray
    """(nf, 2) whether the foot rests on the ground, by its motion."""
    notes: tuple[str, ...]
    """Findings and assumptions, for the log."""
    steps: tuple[tuple[str, int, slice], ...] = ()
    """Loadings of plates and their feet: plate, foot (0 right, 1 left), frames."""
    findings: tuple[Finding, ...] = ()
    """Findings on these ground reactions and on frames left out, without the name of the trial."""
    seated: BoolArray | None = None
    """(nf,) a seat bears part of the body; None: nowhere."""

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the ground reactions as a table, a row a marker frame.

        Returns
        -------
        pandas.DataFrame
            `valid`, `valid_r`, `valid_l` (1 or 0), then, with the names of the `.mot` file, force
            `ground_force_r_vx` (N), point of application `ground_force_r_px` (m) and moment about
            it `ground_torque_r_x` (N·m) of the right and the left foot.
        """
        import pandas as pd

        flags = {"valid": self.valid, "valid_r": self.valid_r, "valid_l": self.valid_l}
        columns: dict[str, Array] = {name: flag.astype(int) for name, flag in flags.items()}
        for side, wrench in zip(SIDES, np.moveaxis(self.wrench, 1, 0), strict=True):
            point, torque = split_wrench(wrench)
            for i, axis in enumerate("xyz"):
                columns[f"ground_force_{side}_v{axis}"] = wrench[:, i]
                columns[f"ground_force_{side}_p{axis}"] = point[:, i]
                columns[f"ground_torque_{side}_{axis}"] = torque[:, i]
        return pd.DataFrame(columns)

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        rows = []
        for k, side in enumerate(("right foot", "left foot")):
            valid, loaded = int(self.valid_legs[:, k].sum()), int(self.loaded[:, k].sum())
            peak = float(self.wrench[:, k, 1].max(initial=0.0))
            rows.append(
                (
                    side,
                    f"on plates in {loaded} frames, largest {peak:.0f} N; torques valid in {valid}",
                )
            )
        rows.append(("whole body", f"valid in {int(self.valid.sum())} frames"))
        if self.warnings:
            rows.append(("warnings", str(len(self.warnings))))
        return f"Ground reactions: {len(self.valid)} frames", rows

    @property
    def warnings(self) -> tuple[str, ...]:
        """Findings that are warnings."""
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
        """Return the valid frames (nf,) of a coordinate or torque.

        Parameters
        ----------
        name
            `hip_flexion_r` is valid with its leg, pelvis, trunk and arms with the whole body.

        Returns
        -------
        (nf,) array of bool
        """
        side = get_leg(name)
        return self.valid_legs[:, SIDES.index(side)] if side else self.valid

    def without(self, legs: Sequence[str]) -> "GroundReactions":
        """Return them without valid frames of some legs and of the whole body.

        Parameters
        ----------
        legs
            `r`, `l`, or both.

        Returns
        -------
        GroundReactions
        """
        kept = np.array([side not in legs for side in SIDES])
        return replace(self, valid=self.valid & kept.all(), valid_legs=self.valid_legs & kept)


def get_leg(name: str) -> str:
    """Get the leg, `r` or `l`, of a coordinate or torque; empty for pelvis, trunk and arms."""
    return coordinates.split_side(name)[1] if name.startswith(_LEG_PREFIXES) else ""


def compute_foot_reactions(
    plates: Sequence[ForcePlate],
    time: Array,
    feet: FootPoints,
    *,
    cutoff: float | None,
    ends: float = 0.0,
    assigned: Mapping[str, str] | None = None,
    events: Sequence[FootEvent] = (),
) -> GroundReactions:
    """Assign plates to feet, filter their wrenches and resample them to the marker frames.

    Parameters
    ----------
    plates
        Force plates.
    time
        (nf,) s of the marker frames.
    feet
        Heels, toes and tips of both feet.
    cutoff
        Hz of the zero-lag low-pass filter on the wrenches; None: no filter.
    ends
        s at the beginning and end of the trial that are not valid, as accelerations lack
        neighbours.
    assigned
        Plate -> "r", "l" or "none", from the study; other plates by their centre of pressure.
    events
        Foot events of the file, for feet beside all plates; used where they agree with the plates.

    Returns
    -------
    GroundReactions
    """
    wrench, loaded = np.zeros((len(time), 2, 6)), np.zeros((len(time), 2), dtype=bool)
    notes, findings = list[str](), list[Finding]()
    known = np.full(len(time), bool(plates))
    used, steps = list[ForcePlate](), list[FootContact]()
    for plate in plates:
        raw = np.nan_to_num(resample_wrench(plate, time))
        filtered = (
            plate
            if cutoff is None or not is_filterable(plate, cutoff)
            else filter_plate(plate, cutoff)
        )
        smooth = resample_wrench(filtered, time)
        known &= np.isfinite(smooth).all(axis=1)
        side = (assigned or {}).get(plate.name)
        if side == "none":
            continue
        used.append(plate)
        found, unfit = find_steps(plate, raw, time, feet, side)
        findings += unfit
        for step in found:
            # The filter distributes the force of a loading over frames before and after it.
            wide = _widen(step.frames, raw[:, 1] > LOADED_N, time, cutoff)
            wrench[wide, step.foot] += np.nan_to_num(smooth[wide])
            loaded[step.frames, step.foot] = True
            how = "as assigned in the study file" if side else "by its centre of pressure"
            notes.append(f"{step.label}: {SIDE_WORDS[SIDES[step.foot]]} foot, {how}")
        steps += found
    resting = feet.resting
    # Contact with the floor: by events and motion, and by motion alone, which marks more frames.
    floor = detect_floor_contact(resting, loaded, time, events)
    floor_by_motion = detect_floor_contact(resting, loaded, time)
    partly, partial_findings = off_sole.find_partial_contact(steps, used, time, feet, loaded)
    shared, shared_findings = off_sole.find_shared_plates(steps, used, time, feet, floor_by_motion)
    off, off_findings = off_sole.find_off_sole_frames(steps, time, feet)
    # Frames with forces, without the ends of the trial.
    covered = time[known] if known.any() else time
    inner = known & (time >= covered[0] + ends) & (time <= covered[-1] - ends)
    legs = inner[:, None] & ~floor & ~partly & ~shared[:, None]
    return GroundReactions(
        wrench=wrench,
        valid=legs.all(axis=1) & loaded.any(axis=1) & ~floor_by_motion.any(axis=1),
        valid_legs=legs & ~off,
        loaded=loaded,
        resting=resting,
        notes=tuple(notes),
        steps=tuple((step.plate.name, step.foot, step.frames) for step in steps),
        findings=(*findings, *partial_findings, *shared_findings, *off_findings),
    )


def _widen(stretch: slice, pressed: BoolArray, time: Array, cutoff: float | None) -> slice:
    """Widen a loading by the tails of the filter, up to half way to the next loading."""
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


@with_one_blas_thread
def ground_reactions(
    model: SubjectModel,
    motion: Motion,
    recording: Recording,
    *,
    plates: Mapping[str, str] | None = None,
    cutoff_hz: float | Literal["matched"] | None = FORCE_HZ,
) -> GroundReactions:
    """Compute the ground reactions on the feet of a tracked motion from its force plates.

    `gaitcal.inverse_dynamics(model, motion, reactions.wrench)` uses them. A torque is meaningful
    where `reactions.valid_for(name)`: of a leg by its foot, of all others where `reactions.valid`.

    Parameters
    ----------
    model
        The person's model, with the parameters that the motion was tracked with.
    motion
        From `gaitcal.track`, all coordinates.
    recording
        The one that was tracked, in the same axes.
    plates
        Plate -> "r", "l" or "none"; the foot under the centre of pressure unless given.
    cutoff_hz
        Hz, zero-lag low-pass filter of the forces, left out where a plate is sampled at twice that
        or less. "matched": that of the motion; None: no filter.

    Returns
    -------
    GroundReactions

    Raises
    ------
    InputError
        The motion is of a part of the body only, or the recording has no plates or none of a name
        in `plates`.
    """
    if motion.coordinates != COORDINATES:
        message = (
            f"ground reactions need a motion of the whole body, with all {len(COORDINATES)} "
            "coordinates"
        )
        raise InputError(message, field="motion", code=Code.ARGUMENT)
    known = [plate.name for plate in recording.plates]
    if not known:
        raise InputError(
            "found no force plates", source=recording.source, field="plates", code=Code.ARGUMENT
        )
    for name in plates or {}:
        if name not in known:
            message = f"found '{name}'; allowed: {', '.join(known)}"
            raise InputError(message, source=recording.source, field="plates", code=Code.ARGUMENT)
    hz = motion.cutoff_hz if cutoff_hz == "matched" else cutoff_hz
    return compute_motion_reactions(model, model.parameters, motion, recording, plates or {}, hz)


def compute_motion_reactions(
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    recording: Recording,
    plates: Mapping[str, str],
    hz: float | None,
) -> GroundReactions:
    """Compute the ground reactions of a whole-body motion and check them.

    Parameters
    ----------
    model, parameters
        The person's model, and the parameters of the motion.
    motion
        Motion with all coordinates.
    recording
        Its recording.
    plates
        Plate -> "r", "l" or "none".
    hz
        Hz, low-pass filter of the forces; None: no filter.

    Returns
    -------
    GroundReactions
    """
    feet = compute_foot_points(model, motion, parameters)
    ends = END_SPANS * float(np.ptp(motion.basis.knots)) / (motion.basis.control_points - DEGREE)
    if motion.smoothed_hz is not None:
        ends = max(ends, END_CYCLES / motion.smoothed_hz)
    measured = compute_foot_reactions(
        recording.plates,
        motion.time,
        feet,
        cutoff=hz,
        ends=ends,
        assigned=plates,
        events=recording.events,
    )
    # Frames without markers of a leg segment are not valid.
    unobserved = find_unobserved_frames(motion)
    valid, legs = measured.valid.copy(), measured.valid_legs.copy()
    for segment, lost in unobserved.items():
        valid &= ~lost
        legs[:, SIDES.index(segment[-1])] &= ~lost
    ends_left_out = f"the first and last {ends:.2f} s are not valid: ends of the splines"
    # Vertical forces that contradict the motion: of a seat, or a fault.
    missing = _compute_missing_force(measured.wrench, parameters, motion)
    seated = mark_near(
        _detect_seated(missing, _detect_lying_thighs(motion, parameters)), motion.time
    )
    valid, legs = valid & ~seated, legs & ~seated[:, None]
    contradictions = [
        *_report_seat(seated, motion.time),
        *_report_force_mismatch(missing, valid, motion.time),
    ]
    return replace(
        measured,
        valid=valid,
        valid_legs=legs,
        seated=seated,
        notes=(*measured.notes, ends_left_out, _describe_filter(recording, hz)),
        findings=(*measured.findings, *_report_unobserved(unobserved, motion), *contradictions),
    )


def _describe_filter(recording: Recording, hz: float | None) -> str:
    """Describe the filter of the forces."""
    plain = [
        plate.name for plate in recording.plates if hz is not None and not is_filterable(plate, hz)
    ]
    if hz is None or len(plain) == len(recording.plates):
        return "forces not filtered" + (
            "" if hz is None else f": sampled at twice {hz:.4g} Hz or less"
        )
    but = f"; not those of plate {', '.join(plain)}, sampled at twice that or less" if plain else ""
    return f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order){but}"


def _compute_missing_force(wrench: Array, parameters: Parameters, motion: Motion) -> Array:
    """Compute the vertical force (nf,) that the plates lack, as share of body weight."""
    residual = inverse_dynamics.Dynamics(parameters).compute_residual_force(
        motion.q, motion.velocity, motion.acceleration, wrench
    )[:, 1]
    out: Array = residual / (parameters.mass * GRAVITY)
    return out


def _detect_lying_thighs(motion: Motion, parameters: Parameters) -> BoolArray:
    """Detect frames (nf,) in which both thighs lean further than in standing or walking."""
    axes, _ = kinematics.compute_body_poses(parameters, motion.q)
    upright = [axes[f"thigh_{side}"][1, 1] for side in SIDES]
    return np.asarray(np.max(upright, axis=0) < np.cos(np.deg2rad(SITTING_DEG)))


def _detect_seated(missing: Array, lying: BoolArray) -> BoolArray:
    """Detect frames (nf,) in which a seat carries part of the body.

    Marks runs where the missing vertical force exceeds its median without sitting, or `SEAT_LOAD`
    if that is less: even a small force far behind the feet makes a moment. A run counts if in some
    frame both thighs lean and more than `SEAT_LOAD` is missing, and in some frame more than
    `MAX_FORCE_MISMATCH`.
    """
    usual = float(np.median(missing[~lying])) if not lying.all() else 0.0
    out = np.zeros_like(lying)
    for run in find_runs(missing > min(usual, SEAT_LOAD)):
        sits = (lying[run] & (missing[run] > SEAT_LOAD)).any()
        out[run] = sits and missing[run].max() > MAX_FORCE_MISMATCH
    return out


def _report_seat(seated: BoolArray, time: Array) -> list[Finding]:
    """Report that a seat carries part of the body, and when."""
    found = (
        f"{format_spans(time, find_runs(seated))}: both thighs are nearly horizontal, and the "
        "plates under the feet carry less than body weight; the force of the seat is not known, so "
        "torques are not valid"
    )
    cause, note = "a seat bears part of the body", Severity.INFO
    seat = Finding(severity=note, topic="forces", cause=cause, found=found, code=Code.SEATED)
    return [seat] if seated.any() else []


def _report_force_mismatch(missing: Array, valid: BoolArray, time: Array) -> list[Finding]:
    """Report valid frames with a vertical force that contradicts the acceleration of the body.

    The frames stay valid: leaving them out would make every residual small by construction.
    """
    gap = np.abs(missing)
    mismatched = np.zeros_like(valid)
    for run in find_runs(valid & (gap > MAX_FORCE_MISMATCH), 2):
        mismatched[run] = measure_duration(time, run) >= MIN_MISMATCH_S
    if not mismatched.any():
        return []
    most = 100 * float(gap[mismatched].max())
    times = format_spans(time, find_runs(mismatched), most=len(mismatched))
    return [
        Finding(
            severity=Severity.WARNING,
            topic="forces",
            cause=FORCE_MISMATCH_CAUSE,
            found=f"{times}: it differs by up to {most:.0f} % of body weight",
            cure="is a foot partly off its plate, a contact not measured, or mass_kg wrong?",
            weight=most / (100 * MAX_FORCE_MISMATCH),
            code=Code.FORCES_CONTRADICT,
        )
    ]


def has_feet(model: SubjectModel) -> bool:
    """Check that the model has landmarks of heels and toes."""
    return {f"{end}_{side}" for end in ("heel", "toe") for side in SIDES} <= set(model.landmarks)


def compute_foot_points(model: SubjectModel, motion: Motion, parameters: Parameters) -> FootPoints:
    """Compute heel and toe of both feet over a whole-body motion.

    Parameters
    ----------
    model
        The person's model, with landmarks of heels and toes.
    motion
        Motion with all coordinates.
    parameters
        Parameters of the motion.

    Returns
    -------
    FootPoints
    """
    axes, origins = kinematics.compute_body_poses(parameters, motion.q)
    points = {}
    for end in ("heel", "toe"):
        local = {foot: model.landmarks[f"{end}_{foot[-1]}"][1] for foot in inverse_dynamics.FEET}
        points[end] = np.stack(
            [
                np.einsum("j,jif->fi", at, axes[foot]) + origins[foot].T
                for foot, at in local.items()
            ],
            axis=1,
        )
    velocity = {end: np.gradient(p, motion.time, axis=0) for end, p in points.items()}
    ground = estimate_belt_velocities(
        *(np.concatenate([ends["heel"], ends["toe"]], axis=1) for ends in (points, velocity))
    )
    speed = {end: np.linalg.norm(v - ground, axis=2) for end, v in velocity.items()}
    # In a jump feet are slow at the top, but do not rest: both ends fall.
    falls = [
        np.gradient(v[:, :, 1], motion.time, axis=0) < -FALLING_SHARE * GRAVITY
        for v in velocity.values()
    ]
    speed = {
        end: np.where(np.all(falls, axis=0), np.maximum(s, RESTING_SPEED), s)
        for end, s in speed.items()
    }
    return FootPoints(
        heel=points["heel"],
        toe=points["toe"],
        tip=plate_outline.compute_foot_tip(points["heel"], points["toe"], model.subject.height),
        heel_speed=speed["heel"],
        toe_speed=speed["toe"],
        width=FOOT_BREADTH * model.subject.height,
        ground=ground,
    )


def find_unobserved_frames(motion: Motion) -> dict[str, BoolArray]:
    """Find frames in which no marker with weight of a leg segment is visible.

    Returns
    -------
    dict
        Segment -> (nf,) array of bool; segments that are always visible are left out.
    """
    errors = motion.errors
    names = np.array(errors.segments, dtype=str)
    out: dict[str, BoolArray] = {}
    for segment in LEG_SEGMENTS:
        weighted = (names == segment) & (errors.weight > 0)
        visible = np.isfinite(errors.distance[:, weighted]).any(axis=1)
        if not visible.all():
            out[segment] = np.asarray(~visible)
    return out


def _report_unobserved(frames: Mapping[str, BoolArray], motion: Motion) -> list[Finding]:
    """Report unobserved segments, in one finding for those lost in the same frames."""
    lost_alike: dict[bytes, list[str]] = {}
    for segment, lost in frames.items():
        lost_alike.setdefault(lost.tobytes(), []).append(segment)
    findings = []
    for segments in lost_alike.values():
        lost, sides = frames[segments[0]], {segment[-1] for segment in segments}
        leg = sides.pop() if len(sides) == 1 else ""
        whole = bool(lost.all())
        if whole:
            found = f"no torque{' of this leg' if leg else ''} is valid"
        else:
            found = (
                f"{format_spans(motion.time, find_runs(lost))}: "
                f"{int(lost.sum())} frames are not valid"
            )
            found += " for this leg" if leg else ""
        findings.append(
            Finding(
                severity=Severity.WARNING if whole else Severity.INFO,
                topic="markers",
                cause=f"no marker of {', '.join(segments)} with weight is visible",
                found=found,
                cure="label them, or leave the trial out"
                if whole
                else "fill short gaps when labelling",
                leg=leg,
                code=Code.UNSEEN_SEGMENT,
            )
        )
    return findings
