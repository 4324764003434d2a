"""What a tracked trial says against itself: residuals with structure, and what no body can do."""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import BoolArray
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.faults.bounds import impossible, large_changes
from gaitcal.faults.marker_structure import TrackedMarkers, marker_findings
from gaitcal.findings import Finding
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import Motion
from gaitcal.motion.trial_problem import TrialProblem


def trial_findings(
    problem: TrialProblem,
    parameters: Parameters,
    motion: Motion,
    nominal: Motion,
    weight: float,
    moments: Moments | None,
    reactions: GroundReactions | None,
) -> tuple[Finding, ...]:
    """Findings on one trial whose whole body was tracked with the final `parameters`.

    Parameters
    ----------
    problem, motion : the whole body.
    nominal : the motion with the nominal model, of the whole body or a part.
    weight : of the body, N.
    moments, reactions : final generalised forces, and where they mean something; None without force plates.
    """
    valid, legs = (None, None) if reactions is None else (reactions.valid, reactions.valid_legs)
    markers = marker_findings(tracked_markers(problem, parameters, motion))
    return (*markers, *impossible(motion, weight, moments, valid, legs), *large_changes(nominal, motion, valid))


def tracked_markers(problem: TrialProblem, parameters: Parameters, motion: Motion) -> TrackedMarkers:
    """Measured markers beside the model's."""
    measured = problem.data.measured.transpose(2, 0, 1)
    seen: BoolArray = np.any(measured != 0.0, axis=2)
    return TrackedMarkers(
        name=motion.name,
        time=motion.time,
        labels=problem.labels,
        segments=motion.errors.segments,
        weight=motion.errors.weight,
        measured=np.where(seen[:, :, None], measured, np.nan),
        model=problem.positions(motion.nodes, problem.constants(parameters)).transpose(2, 0, 1),
    )
