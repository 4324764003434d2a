"""In which frames the angle of a coordinate may be used: where markers show the segments that it is between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import BoolArray
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.person.result import TrialResult

SHOWN_BY = {"hip": ("thigh",), "knee": ("thigh", "shank"), "ankle": ("shank", "foot"), "subtalar": ("shank", "foot")}
"""First word of a coordinate of a leg -> segments of which some marker must be seen where the angle is to count."""


def angle_counts(trial: TrialResult, name: str, unseen: Mapping[str, BoolArray]) -> BoolArray:
    """(nf,) where an angle may be used: not refused, and between segments that some marker shows.

    `unseen`: of `dynamics.ground_reactions.unseen_frames`.
    """
    side = leg_of(name)
    refused = side in trial.refused_legs if side else bool(trial.refused_legs)
    out = np.full(len(trial.body.time), not refused)
    for part in SHOWN_BY[name.partition("_")[0]] if side else ():
        out &= ~unseen.get(f"{part}_{side}", np.zeros(len(out), dtype=bool))
    return out
