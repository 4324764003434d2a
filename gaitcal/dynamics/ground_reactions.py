"""Ground reactions of a trial: filtered as the settings say, assigned to the feet of the tracked motion.

Where a leg segment shows no marker its motion is a guess of the splines: no torque of that leg follows from it, and
these frames are not valid for it, nor for the whole body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import FOOT_BREADTH, FootPoints, ground_velocity
from gaitcal.dynamics.ground_contact import SPLINE_ENDS, GroundReactions, ground_reactions_on_feet
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics
from gaitcal.dynamics.plate_errors import foot_tip
from gaitcal.errors import InputError
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import filterable
from gaitcal.io.intervals import runs, spans
from gaitcal.io.recording import Recording
from gaitcal.model.chain import chain_of, forward, segment_poses
from gaitcal.model.linkage import COORDINATES, LEG_SEGMENTS, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.motion.spline import DEGREE
from gaitcal.runtime import with_one_blas_thread

FORCE_HZ = 50.0
"""Filter of the plates unless told otherwise. RMS errors of leg torques on synthetic walks whose truth is known, true
model, mean of three seeds, N·m (50 Hz, filtered like the motion, not filtered): impacts that shake the whole body
2.16, 5.06, 2.64; the same under skin movement 3.46, 10.19, 3.78; impacts of the feet 3.83, 4.25, 4.10; no impacts
1.52, 2.09, 1.66.
"""
SMOOTHED_ENDS = 0.5
"""Oscillations at f at either end of a smoothed motion whose accelerations lean on one side only; not valid."""
PELVIS_UP = COORDINATES.index("pelvis_ty")
CONTRADICTION = 0.25
"""Of body weight: vertical residuals above this are told, and left in; subject01's largest is 0.11."""
CONTRADICTED = "the plates' vertical force is not what the motion asks for"
CONTRADICTION_S = 0.05
"""s that they must last: the impact of a heel, over in 10 to 20 ms (Whittle 1999), is more than a motion can show."""


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
    model : the person's model, with the parameters that the motion was tracked with.
    motion : from `gaitcal.track`, all coordinates.
    recording : the one that was tracked, in the same axes.
    plates : plate name -> "r", "l" or "none"; the foot under the centre of pressure unless given.
    cutoff_hz : zero-lag low-pass filter of the forces, left out where a plate is sampled at twice that or less;
        "matched": that of the motion; None: no filter.

    Raises
    ------
    InputError
        The motion is of a part of the body only, or the recording has no plates or none of a name in `plates`.
    """
    if motion.coordinates != COORDINATES:
        raise InputError(
            f"ground reactions need a motion of the whole body, with all {len(COORDINATES)} coordinates",
            field="motion",
            code=Code.ARGUMENT,
        )
    known = [plate.name for plate in recording.plates]
    if not known:
        raise InputError("found no force plates", source=recording.source, field="plates", code=Code.ARGUMENT)
    for name in plates or {}:
        if name not in known:
            raise InputError(
                f"found '{name}'; allowed: {', '.join(known)}",
                source=recording.source,
                field="plates",
                code=Code.ARGUMENT,
            )
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
    """Ground reactions at the frames of a whole-body motion, filtered at `hz` (None: not), and what speaks against."""
    feet = foot_points(model, motion, parameters)
    ends = SPLINE_ENDS * float(np.ptp(motion.basis.knots)) / (motion.basis.nodes - DEGREE)
    if motion.smoothed_hz is not None:
        ends = max(ends, SMOOTHED_ENDS / motion.smoothed_hz)
    measured = ground_reactions_on_feet(
        recording.plates, motion.time, feet, cutoff=hz, ends=ends, assigned=plates, events=recording.events
    )
    unseen = unseen_frames(motion)
    valid, legs = measured.valid.copy(), measured.valid_legs.copy()
    for segment, lost in unseen.items():
        valid &= ~lost
        legs[:, SIDES.index(segment[-1])] &= ~lost
    filtered = _filter_words(recording, hz)
    ends_left_out = f"the first and last {ends:.2f} s are not valid: ends of the splines"
    contradictions = _contradictions(measured.wrench, valid, parameters, motion)
    return replace(
        measured,
        valid=valid,
        valid_legs=legs,
        notes=(*measured.notes, ends_left_out, filtered),
        findings=(*measured.findings, *unseen_findings(unseen, motion), *contradictions),
    )


def _filter_words(recording: Recording, hz: float | None) -> str:
    """How the forces were filtered."""
    plain = [plate.name for plate in recording.plates if hz is not None and not filterable(plate, hz)]
    if hz is None or len(plain) == len(recording.plates):
        why = "" if hz is None else f": sampled at twice {hz:.4g} Hz or less"
        return f"forces not filtered{why}"
    but = f"; not those of plate {', '.join(plain)}, sampled at twice that or less" if plain else ""
    return f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order){but}"


def _contradictions(wrench: Array, valid: BoolArray, parameters: Parameters, motion: Motion) -> list[Finding]:
    """Valid frames whose vertical force is far from what the body's acceleration asks for; they stay valid.

    To leave them out would make every residual look small by construction.
    """
    none = np.zeros_like(wrench)
    needed = Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, none)[:, PELVIS_UP]
    gap = np.abs(wrench[:, :, 1].sum(axis=1) - needed) / (parameters.mass * GRAVITY)
    apart, time = np.zeros_like(valid), motion.time
    for run in runs(valid & (gap > CONTRADICTION), 2):
        apart[run] = time[run.stop - 1] - time[run.start] >= CONTRADICTION_S
    if not apart.any():
        return []
    where = spans(time, runs(apart), most=len(apart))
    most = 100 * float(gap[apart].max())
    return [
        Finding(
            severity=Severity.WARNING,
            topic="forces",
            where="",
            cause=CONTRADICTED,
            found=f"{where}: it differs by up to {most:.0f} % of body weight",
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
    chain = chain_of()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, motion.q))
    points = {}
    for end in ("heel", "toe"):
        both = []
        for foot in FEET:
            segment = chain.segments.index(foot)
            local = model.landmarks[f"{end}_{foot[-1]}"][1]
            both.append(np.einsum("j,jif->fi", local, axes[segment]) + origins[segment].T)
        points[end] = np.stack(both, axis=1)
    velocity = {end: np.gradient(p, motion.time, axis=0) for end, p in points.items()}
    ground = ground_velocity(*(np.concatenate([of["heel"], of["toe"]], axis=1) for of in (points, velocity)))
    speed = {end: np.linalg.norm(v - ground, axis=2) for end, v in velocity.items()}
    return FootPoints(
        heel=points["heel"],
        toe=points["toe"],
        tip=foot_tip(points["heel"], points["toe"], model.subject.height),
        heel_speed=speed["heel"],
        toe_speed=speed["toe"],
        width=FOOT_BREADTH * model.subject.height,
        ground=ground,
    )


def unseen_frames(motion: Motion) -> dict[str, BoolArray]:
    """Leg segment -> (nf,) frames in which none of its markers with weight is seen; segments always seen left out."""
    errors = motion.errors
    names = np.array(errors.segments, dtype=str)
    out: dict[str, BoolArray] = {}
    for segment in LEG_SEGMENTS:
        weighted = (names == segment) & (errors.weight > 0)
        seen = np.isfinite(errors.distance[:, weighted]).any(axis=1)
        if not seen.all():
            out[segment] = np.asarray(~seen)
    return out


def unseen_findings(frames: Mapping[str, BoolArray], motion: Motion) -> list[Finding]:
    """What to say of `unseen_frames`: one line for the segments that are lost in the same frames."""
    lost_alike: dict[bytes, list[str]] = {}
    for segment, lost in frames.items():
        lost_alike.setdefault(lost.tobytes(), []).append(segment)
    findings = []
    for segments in lost_alike.values():
        lost, names = frames[segments[0]], ", ".join(segments)
        sides = {segment[-1] for segment in segments}
        leg = sides.pop() if len(sides) == 1 else ""
        of_leg = " of this leg" if leg else ""
        severity, found, cure = Severity.WARNING, f"no torque{of_leg} is valid", "label them, or leave the trial out"
        if not lost.all():
            severity, cure = Severity.INFO, "fill short gaps when labelling"
            found = f"{spans(motion.time, runs(lost))}: {int(lost.sum())} frames are not valid"
            found += " for this leg" if leg else ""
        findings.append(
            Finding(
                severity=severity,
                topic="markers",
                where="",
                cause=f"no marker of {names} with weight is seen",
                found=found,
                cure=cure,
                leg=leg,
                code=Code.UNSEEN_SEGMENT,
            )
        )
    return findings
