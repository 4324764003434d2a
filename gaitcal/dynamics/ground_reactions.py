"""What the ground does to each foot, and in which frames that is known for each leg.

A leg's torques need its own foot: on the ground wholly on plates that together carry it, or in the
air. Where a foot is down and no plate carries it, where it rests partly beside its plates, where a
plate carries both feet, or where the centre of pressure is not under it, the torques of that leg
are not valid; those of the other leg may be. Pelvis, trunk and the fit of masses need both feet at
once. Whether a foot is down at all is told by its motion, or by events (`foot_contact.py`). The
size of the forces plays no part in this: residuals stay a check. Where a leg segment shows no
marker its motion is a guess of the splines: these frames are not valid for that leg, nor for the
whole body.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.display import Displayed
from gaitcal.dynamics import inverse_dynamics, measurement_errors, off_sole
from gaitcal.dynamics.foot_contact import (
    FOOT_BREADTH,
    RESTING,
    FootContact,
    FootPoints,
    belts,
    near,
    on_the_floor,
    steps_on,
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

_OF_LEG = tuple(dict.fromkeys(f"{name.split('_')[0]}_" for name in coordinates.LEG_COORDINATES))
"""How the names of what belongs to a leg begin."""
# Knot spans at either end of a trial whose accelerations nothing before or after supports; not
# valid
SPLINE_ENDS = 2
FORCE_HZ = 50.0
"""Filter of the plates unless told otherwise. RMS errors of leg torques on synthetic walks whose
truth is known, true model, mean of three seeds, N·m (50 Hz, filtered like the motion, not
filtered): impacts that shake the whole body 2.16, 5.06, 2.64; the same under skin movement 3.46,
10.19, 3.78; impacts of the feet 3.83, 4.25, 4.10; no impacts 1.52, 2.09, 1.66.
"""
SMOOTHED_ENDS = 0.5
"""Oscillations at f at either end of a smoothed motion whose accelerations lean on one side only;
not valid.
"""
# Of body weight: vertical residuals above this are told, and left in; subject01's largest is 0.11
CONTRADICTION = 0.25
# Of gravity, by which heel and toe of a foot accelerate downwards together that is in the air
FALLING = 0.5
# Lean of the thighs from the vertical; standing: up to 10 degrees, crouching children up to 40
SITTING_DEG = 60.0
# Of body weight: what is left of it on the seat that somebody rises from; residuals are as large
SEAT = 0.05
CONTRADICTED = "the plates' vertical force is not what the motion asks for"
CONTRADICTION_S = 0.05
"""s that they must last: the impact of a heel, over in 10 to 20 ms (Whittle 1999), is more than a
motion can show.
"""


@dataclass(frozen=True, kw_only=True, repr=False)
class GroundReactions(Displayed):
    """Ground reactions on the feet at the marker frames."""

    wrench: Array
    """(nf, 2, 6) [force N; moment N·m about the laboratory origin] on the right and left foot; 0
    where none.
    """
    valid: BoolArray
    """(nf,) whole body: each foot is wholly on plates of its own or in the air, by its motion
    alone, too, and a plate carries the body. Masses are fitted to these frames: no event that
    somebody set decides on them, and no centre of pressure, which would make a residual small by
    construction."""
    valid_legs: BoolArray
    """(nf, 2) right, left: that foot is on the ground wholly on plates of its own, with the centre
    of pressure under it, or in the air."""
    loaded: BoolArray
    """(nf, 2) a plate carries the foot."""
    resting: BoolArray
    """(nf, 2) the foot is down, judged by its motion."""
    notes: tuple[str, ...]
    """What was found and assumed."""
    steps: tuple[tuple[str, int, slice], ...] = ()
    """Each loading of a plate that a foot was given: plate, foot (0 right, 1 left), frames."""
    findings: tuple[Finding, ...] = ()
    """What speaks against these ground reactions, and frames that they leave out; without the name
    of their trial.
    """
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
        """(nf,) of a coordinate or torque: `hip_flexion_r` as its leg, what belongs to no leg as
        the whole body.
        """
        side = leg_of(name)
        return self.valid_legs[:, SIDES.index(side)] if side else self.valid

    def without(self, legs: Sequence[str]) -> "GroundReactions":
        """The same with no valid frame of some legs (`r`, `l`), and so none of the whole body."""
        kept = np.array([side not in legs for side in SIDES])
        return replace(self, valid=self.valid & kept.all(), valid_legs=self.valid_legs & kept)


def leg_of(name: str) -> str:
    """`r` or `l` of a coordinate or torque of a leg; empty for pelvis, trunk and arms."""
    return coordinates.split_side(name)[1] if name.startswith(_OF_LEG) else ""


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

    `time`: (nf,) s of the marker frames. `cutoff`: Hz of the zero-lag low-pass filter on the
    wrenches; None: none. `ends`: s at the beginning and end of the trial that are not valid, as
    accelerations are not supported there. `assigned`: plate name -> "r", "l" or "none", from the
    study; the rest is found. `events`: of the file, for feet beside all plates; used where they
    agree with the plates.
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
        found, unfit = steps_on(plate, raw, time, feet, side)
        findings += unfit
        for step in found:
            wide = _widen(step.frames, raw[:, 1] > LOADED_N, time, cutoff)
            wrench[wide, step.foot] += np.nan_to_num(smooth[wide])
            loaded[step.frames, step.foot] = True
            how = "as the study says" if side else "by its centre of pressure"
            notes.append(f"{step.words}: {SIDE_WORDS[SIDES[step.foot]]} foot, {how}")
        steps += found
    resting = feet.resting
    floor, at_most = (on_the_floor(resting, loaded, time, told) for told in (events, ()))
    partly, beside = off_sole.beside_plates(steps, used, time, feet, loaded)
    shared, both = off_sole.shared_plates(steps, used, time, feet, at_most)
    off, unlike = off_sole.off_sole_frames(steps, time, feet)
    there = time[known] if known.any() else time
    inner = known & (time >= there[0] + ends) & (time <= there[-1] - ends)
    legs = inner[:, None] & ~floor & ~partly & ~shared[:, None]
    return GroundReactions(
        wrench=wrench,
        valid=legs.all(axis=1) & loaded.any(axis=1) & ~at_most.any(axis=1),
        valid_legs=legs & ~off,
        loaded=loaded,
        resting=resting,
        notes=tuple(notes),
        steps=tuple((step.plate.name, step.foot, step.frames) for step in steps),
        findings=(*findings, *beside, *both, *unlike),
    )


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


@with_one_blas_thread
def ground_reactions(
    model: SubjectModel,
    motion: Motion,
    recording: Recording,
    *,
    plates: Mapping[str, str] | None = None,
    cutoff_hz: float | Literal["matched"] | None = FORCE_HZ,
) -> GroundReactions:
    """Ground reactions on the feet of a tracked motion, from the force plates of its recording.

    `gaitcal.inverse_dynamics(model, motion, reactions.wrench)` takes them; its torques count where
    `reactions.valid_for(name)`: those of a leg by its own foot, others where `reactions.valid`.

    Parameters
    ----------
    model : the person's model, with the parameters that the motion was tracked with. motion : from
    `gaitcal.track`, all coordinates. recording : the one that was tracked, in the same axes. plates
    : plate name -> "r", "l" or "none"; the foot under the centre of pressure unless given.
    cutoff_hz : zero-lag low-pass filter of the forces, left out where a plate is sampled at twice
    that or less;
        "matched": that of the motion; None: no filter.

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
    return reactions_of_motion(model, model.parameters, motion, recording, plates or {}, hz)


def reactions_of_motion(
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    recording: Recording,
    plates: Mapping[str, str],
    hz: float | None,
) -> GroundReactions:
    """Ground reactions at the frames of a whole-body motion, filtered at `hz` (None: not), and what
    speaks against.
    """
    feet = foot_points(model, motion, parameters)
    ends = SPLINE_ENDS * float(np.ptp(motion.basis.knots)) / (motion.basis.nodes - DEGREE)
    if motion.smoothed_hz is not None:
        ends = max(ends, SMOOTHED_ENDS / motion.smoothed_hz)
    measured = ground_reactions_on_feet(
        recording.plates,
        motion.time,
        feet,
        cutoff=hz,
        ends=ends,
        assigned=plates,
        events=recording.events,
    )
    unseen = unseen_frames(motion)
    valid, legs = measured.valid.copy(), measured.valid_legs.copy()
    for segment, lost in unseen.items():
        valid &= ~lost
        legs[:, SIDES.index(segment[-1])] &= ~lost
    ends_left_out = f"the first and last {ends:.2f} s are not valid: ends of the splines"
    missing = _missing(measured.wrench, parameters, motion)
    seated = near(_seated(missing, thighs_lie(motion, parameters)), motion.time)
    valid, legs = valid & ~seated, legs & ~seated[:, None]
    contradictions = [*_seat(seated, motion.time), *_contradictions(missing, valid, motion.time)]
    return replace(
        measured,
        valid=valid,
        valid_legs=legs,
        seated=seated,
        notes=(*measured.notes, ends_left_out, _filter_words(recording, hz)),
        findings=(*measured.findings, *_unseen_findings(unseen, motion), *contradictions),
    )


def _filter_words(recording: Recording, hz: float | None) -> str:
    plain = [
        plate.name for plate in recording.plates if hz is not None and not is_filterable(plate, hz)
    ]
    if hz is None or len(plain) == len(recording.plates):
        return "forces not filtered" + (
            "" if hz is None else f": sampled at twice {hz:.4g} Hz or less"
        )
    but = f"; not those of plate {', '.join(plain)}, sampled at twice that or less" if plain else ""
    return f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order){but}"


def _missing(wrench: Array, parameters: Parameters, motion: Motion) -> Array:
    """(nf,) body weights that the plates carry less than the motion asks for."""
    residual = inverse_dynamics.Dynamics(parameters).residual_force(
        motion.q, motion.velocity, motion.acceleration, wrench
    )[:, 1]
    out: Array = residual / (parameters.mass * GRAVITY)
    return out


def thighs_lie(motion: Motion, parameters: Parameters) -> BoolArray:
    """(nf,) frames in which both thighs lean further than those of anybody who stands or walks."""
    axes, _ = kinematics.body_poses(parameters, motion.q)
    upright = [axes[f"thigh_{side}"][1, 1] for side in SIDES]
    return np.asarray(np.max(upright, axis=0) < np.cos(np.deg2rad(SITTING_DEG)))


def _seated(missing: Array, lying: BoolArray) -> BoolArray:
    """(nf,) frames in which a seat bears what the plates lack, more than while the person is off
    it, from before the thighs lie until after they do: little, so far behind the feet, is much of a
    moment. It bears much at some time.
    """
    usual = float(np.median(missing[~lying])) if not lying.all() else 0.0
    out = np.zeros_like(lying)
    for run in find_runs(missing > min(usual, SEAT)):
        out[run] = (lying[run] & (missing[run] > SEAT)).any() and missing[run].max() > CONTRADICTION
    return out


def _seat(seated: BoolArray, time: Array) -> list[Finding]:
    """That a seat bears part of the body, and when."""
    found = (
        f"{format_spans(time, find_runs(seated))}: both thighs lie, and the plates under the feet carry less "
        "than the "
    )
    found += "body weighs; where the seat pushes is not known, so that torques are not valid then"
    cause, note = "a seat bears part of the body", Severity.INFO
    seat = Finding(severity=note, topic="forces", cause=cause, found=found, code=Code.SEATED)
    return [seat] if seated.any() else []


def _contradictions(missing: Array, valid: BoolArray, time: Array) -> list[Finding]:
    """Valid frames whose vertical force is far from what the body's acceleration asks for; they
    stay valid.

    To leave them out would make every residual look small by construction.
    """
    gap = np.abs(missing)
    apart = np.zeros_like(valid)
    for run in find_runs(valid & (gap > CONTRADICTION), 2):
        apart[run] = measure_duration(time, run) >= CONTRADICTION_S
    if not apart.any():
        return []
    most = 100 * float(gap[apart].max())
    return [
        Finding(
            severity=Severity.WARNING,
            topic="forces",
            cause=CONTRADICTED,
            found=f"{format_spans(time, find_runs(apart), most=len(apart))}: it differs by up to {most:.0f} % "
            "of body weight",
            cure="is a foot partly off its plate, a contact not measured, or mass_kg wrong?",
            weight=most / (100 * CONTRADICTION),
            code=Code.FORCES_CONTRADICT,
        )
    ]


def has_feet(model: SubjectModel) -> bool:
    """Whether the model knows where heels and toes are."""
    return {f"{end}_{side}" for end in ("heel", "toe") for side in SIDES} <= set(model.landmarks)


def foot_points(model: SubjectModel, motion: Motion, parameters: Parameters) -> FootPoints:
    """Heel and toe of both feet over a whole-body motion."""
    axes, origins = kinematics.body_poses(parameters, motion.q)
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
    ground = belts(*(np.concatenate([of["heel"], of["toe"]], axis=1) for of in (points, velocity)))
    speed = {end: np.linalg.norm(v - ground, axis=2) for end, v in velocity.items()}
    # the feet of who jumps stand still at the top, and rest on nothing
    falls = [
        np.gradient(v[:, :, 1], motion.time, axis=0) < -FALLING * GRAVITY for v in velocity.values()
    ]
    speed = {
        end: np.where(np.all(falls, axis=0), np.maximum(s, RESTING), s) for end, s in speed.items()
    }
    return FootPoints(
        heel=points["heel"],
        toe=points["toe"],
        tip=measurement_errors.foot_tip(points["heel"], points["toe"], model.subject.height),
        heel_speed=speed["heel"],
        toe_speed=speed["toe"],
        width=FOOT_BREADTH * model.subject.height,
        ground=ground,
    )


def unseen_frames(motion: Motion) -> dict[str, BoolArray]:
    """Leg segment -> (nf,) frames in which none of its markers with weight is seen; segments always
    seen left out.
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


def _unseen_findings(frames: Mapping[str, BoolArray], motion: Motion) -> list[Finding]:
    """What to say of `unseen_frames`: one line for the segments that are lost in the same frames."""
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
            found = f"{format_spans(motion.time, find_runs(lost))}: {int(lost.sum())} frames are not valid"
            found += " for this leg" if leg else ""
        findings.append(
            Finding(
                severity=Severity.WARNING if whole else Severity.INFO,
                topic="markers",
                cause=f"no marker of {', '.join(segments)} with weight is seen",
                found=found,
                cure="label them, or leave the trial out"
                if whole
                else "fill short gaps when labelling",
                leg=leg,
                code=Code.UNSEEN_SEGMENT,
            )
        )
    return findings
