"""Ground reactions of a trial: filtered as the settings say, assigned to the feet of the tracked motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.ground_contact import SPLINE_ENDS, FootPoints, GroundReactions, ground_reactions_on_feet
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics
from gaitcal.model.build import GRAVITY
from gaitcal.model.chain import Chain
from gaitcal.model.kinematics import forward, segment_poses
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.motion.spline import DEGREE
from gaitcal.motion.trial_data import cutoff
from gaitcal.settings import CalibrationSettings
from gaitcal.study.person import StudyTrial
from gaitcal.study.prepare import PreparedTrial

IMPLAUSIBLE = 0.20
"""Of body weight: filtering, skin movement and the mass model leave less than half of that in sound trials."""


def measured_reactions(
    trial: PreparedTrial, model: SubjectModel, parameters: Parameters, motion: Motion, settings: CalibrationSettings
) -> GroundReactions:
    """Ground reactions on the feet at the frames of a whole-body motion."""
    hz = force_cutoff(trial.trial, motion, settings)
    feet = foot_points(model, motion, parameters)
    knots = motion.basis.knots
    ends = SPLINE_ENDS * float(np.ptp(knots)) / (motion.basis.nodes - DEGREE)
    found = ground_reactions_on_feet(
        trial.recording.plates, motion.time, feet, cutoff=hz, ends=ends, assigned=dict(trial.trial.plates)
    )
    found = replace(found, notes=(*found.notes, f"the first and last {ends:.2f} s are not valid: ends of the splines"))
    found = _drop_implausible(found, parameters, motion)
    how = "forces not filtered" if hz is None else f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order)"
    return replace(found, notes=(*found.notes, how))


def _drop_implausible(found: GroundReactions, parameters: Parameters, motion: Motion) -> GroundReactions:
    """Frames whose vertical force is far from what the body's acceleration asks for are not valid.

    A foot that hangs over its plate's edge loads the plate only in part; no marker shows it, the sum of forces does.
    """
    none = np.zeros_like(found.wrench)
    needed = Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, none).residual_force[:, 1]
    gap = np.abs(found.wrench[:, :, 1].sum(axis=1) - needed) / (parameters.mass * GRAVITY)
    bad = found.valid & (gap > IMPLAUSIBLE)
    if not bad.any():
        return found
    spans = ", ".join(f"{motion.time[s.start]:.2f}-{motion.time[s.stop - 1]:.2f}" for s in _runs(bad))
    note = (
        f"{spans} s: the plates' vertical force differs by more than {100 * IMPLAUSIBLE:.0f} % of body weight from "
        "what the motion asks for; not valid (a foot partly off its plate, or an unmeasured contact?)"
    )
    return replace(found, valid=found.valid & ~bad, notes=(*found.notes, note))


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
    speed = {k: np.linalg.norm(np.gradient(p, motion.time, axis=0), axis=2) for k, p in points.items()}
    return FootPoints(points["heel"], points["toe"], speed["heel"], speed["toe"])
