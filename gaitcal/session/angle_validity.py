"""In which frames the angle of a coordinate may be used: where markers show the segments that it is between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import BoolArray
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.model.linkage import JOINT_OF_CHILD, JOINTS, LOWER_BODY, Joint, coordinates_before, segment_kind
from gaitcal.session.result import TrialResult


def _shown_by(joint: Joint) -> tuple[str, ...]:
    """The nearest segments on either side of a joint that carry markers, but for the pelvis, whose frame they make."""
    ends = [joint.parent, joint.child]
    while not segment_kind(ends[0]).markers:
        ends[0] = JOINT_OF_CHILD[ends[0]].parent
    while not segment_kind(ends[1]).markers:
        ends[1] = next(j.child for j in JOINTS if j.parent == ends[1])
    return tuple(segment for segment in ends if segment != "pelvis")


SHOWN_BY = {name: _shown_by(JOINT_OF_CHILD[s]) for s in LOWER_BODY[1:] for name in coordinates_before([s])}
"""Coordinate of a leg -> segments of which some marker must be seen where the angle is to count."""


def angle_counts(trial: TrialResult, name: str, unseen: Mapping[str, BoolArray]) -> BoolArray:
    """(nf,) where an angle may be used: not refused, and between segments that some marker shows.

    `unseen`: of `dynamics.ground_reactions.unseen_frames`.
    """
    side = leg_of(name)
    refused = side in trial.refused_legs if side else bool(trial.refused_legs)
    out = np.full(len(trial.body.time), not refused)
    for segment in SHOWN_BY.get(name, ()):
        out &= ~unseen.get(segment, np.zeros(len(out), dtype=bool))
    return out
