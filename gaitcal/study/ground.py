"""Ground reactions of a trial: filtered as the settings say, assigned to the feet of the tracked motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.ground_contact import (
    SPLINE_ENDS,
    FootPoints,
    GroundReactions,
    ground_reactions_on_feet,
    ground_velocity,
)
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics
from gaitcal.dynamics.plate_outline import foot_tip
from gaitcal.errors import InputError
from gaitcal.model.build import GRAVITY
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import forward, segment_poses
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.motion.spline import DEGREE
from gaitcal.motion.trial_data import cutoff
from gaitcal.recording.recording import Recording
from gaitcal.settings import CalibrationSettings
from gaitcal.study.person import StudyTrial
from gaitcal.study.prepare import PreparedTrial
from gaitcal.study.unseen import unseen_frames, unseen_warnings

CONTRADICTION = 0.25
"""Of body weight: vertical residuals above this are told, and left in; subject01's largest is 0.11."""


def ground_reactions(
    model: SubjectModel,
    motion: Motion,
    recording: Recording,
    *,
    plates: Mapping[str, str] | None = None,
    cutoff_hz: float | Literal["matched"] | None = "matched",
) -> GroundReactions:
    """Ground reactions on the feet of a tracked motion, from the force plates of its recording.

    `gaitcal.inverse_dynamics(model, motion, found.wrench)` takes them; its torques count where `found.valid`.

    Parameters
    ----------
    model : the person's model, with the parameters that the motion was tracked with.
    motion : from `gaitcal.track`, all 27 coordinates.
    recording : the one that was tracked, in the same axes.
    plates : plate name -> "r", "l" or "none"; the foot under the centre of pressure unless given.
    cutoff_hz : zero-lag low-pass filter of the forces; "matched": that of the motion's splines; None: no filter.

    Raises
    ------
    InputError
        The motion is of a part of the body only, or the recording has no plates or none of a name in `plates`.
    """
    if motion.coordinates != COORDINATES:
        raise InputError("ground reactions need a motion of the whole body, with all 27 coordinates", field="motion")
    known = [plate.name for plate in recording.plates]
    if not known:
        raise InputError("found no force plates", source=recording.source, field="plates")
    for name in plates or {}:
        if name not in known:
            raise InputError(f"found '{name}'; allowed: {', '.join(known)}", source=recording.source, field="plates")
    hz = cutoff(motion.time, motion.basis.nodes) if cutoff_hz == "matched" else cutoff_hz
    return _on_feet(model, model.parameters, motion, recording, plates or {}, hz)


def measured_reactions(
    trial: PreparedTrial, model: SubjectModel, parameters: Parameters, motion: Motion, settings: CalibrationSettings
) -> GroundReactions:
    """Ground reactions on the feet at the frames of a whole-body motion."""
    hz = force_cutoff(trial.trial, motion, settings)
    return _on_feet(model, parameters, motion, trial.recording, trial.trial.plates, hz)


def _on_feet(
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    recording: Recording,
    plates: Mapping[str, str],
    hz: float | None,
) -> GroundReactions:
    feet = foot_points(model, motion, parameters)
    knots = motion.basis.knots
    ends = SPLINE_ENDS * float(np.ptp(knots)) / (motion.basis.nodes - DEGREE)
    found = ground_reactions_on_feet(recording.plates, motion.time, feet, cutoff=hz, ends=ends, assigned=dict(plates))
    found = replace(found, notes=(*found.notes, f"the first and last {ends:.2f} s are not valid: ends of the splines"))
    how = "forces not filtered" if hz is None else f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order)"
    for lost in unseen_frames(motion).values():
        found = replace(found, valid=found.valid & ~lost)
    warnings = (*found.warnings, *unseen_warnings(motion), *_contradictions(found, parameters, motion))
    return replace(found, notes=(*found.notes, how), warnings=warnings)


def _contradictions(found: GroundReactions, parameters: Parameters, motion: Motion) -> list[str]:
    """Valid frames whose vertical force is far from what the body's acceleration asks for; they stay valid.

    To leave them out would make every residual look small by construction.
    """
    none = np.zeros_like(found.wrench)
    needed = Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, none).residual_force[:, 1]
    gap = np.abs(found.wrench[:, :, 1].sum(axis=1) - needed) / (parameters.mass * GRAVITY)
    bad = found.valid & (gap > CONTRADICTION)
    if not bad.any():
        return []
    spans = ", ".join(f"{motion.time[s.start]:.2f}-{motion.time[s.stop - 1]:.2f}" for s in _runs(bad))
    most = 100 * float(gap[bad].max())
    return [
        f"{spans} s: the plates' vertical force differs by up to {most:.0f} % of body weight from what the motion asks "
        "for; is a foot partly off its plate, a contact not measured, or the mass wrong?"
    ]


def _runs(marked: NDArray[np.bool_]) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def force_cutoff(trial: StudyTrial, motion: Motion, settings: CalibrationSettings) -> float | None:
    """Hz of the force filter of a trial; None for none."""
    chosen = settings.force_filter_hz if trial.filter_hz is None else trial.filter_hz
    if chosen == "none":
        return None
    return cutoff(motion.time, motion.basis.nodes) if chosen == "matched" else float(chosen)


def foot_points(model: SubjectModel, motion: Motion, parameters: Parameters) -> FootPoints:
    """Heel and toe of both feet over a whole-body motion."""
    chain = Chain()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, motion.q))
    points = {}
    for end in ("heel", "toe"):
        both = []
        for foot in FEET:
            at = chain.segments.index(foot)
            local = model.landmarks[f"{end}_{foot[-1]}"][1]
            both.append(np.einsum("j,jif->fi", local, axes[at]) + origins[at].T)
        points[end] = np.stack(both, axis=1)
    velocity = {end: np.gradient(p, motion.time, axis=0) for end, p in points.items()}
    ground = ground_velocity(*(np.concatenate([of["heel"], of["toe"]], axis=1) for of in (points, velocity)))
    speed = {end: np.linalg.norm(v - ground, axis=2) for end, v in velocity.items()}
    tip = foot_tip(points["heel"], points["toe"], model.subject.height)
    return FootPoints(points["heel"], points["toe"], tip, speed["heel"], speed["toe"])
