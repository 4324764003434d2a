"""How somebody stands in a static trial: bent, on one leg, sitting, on the forefeet. Arms play no part.

With the joint centres of the nominal model (hips by Bell) and the body axes of `plan.py`: the knee bends by the angle
between thigh and shank in the thigh's sagittal plane, and the thigh leans by its angle to the vertical.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.plan import body_axes
from gaitcal.findings import Finding, Severity
from gaitcal.model.ankle_zero import AnkleZero, standing_ankles
from gaitcal.model.hip_centre import HipCentre
from gaitcal.model.knee_and_ankle import SIDE_WORDS, JointWidths
from gaitcal.model.landmark_names import REQUIRED
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import lower_body

BENT_DEG = 30.0
"""Of a knee: in clean static trials of grown people and children it bends by -7 to 11 degrees; 20 more is a posture."""
UNEVEN_DEG, UNEVEN_M = 18.0, 0.045
"""Difference between the knees, and between the heights of the heels, from which somebody stands on one leg; up to 7
degrees and 5 mm in clean trials."""
SITTING_DEG = 60.0
"""Lean of the thighs from the vertical; standing: up to 10 degrees, crouching children up to 40."""


@dataclass(frozen=True, kw_only=True)
class StandingLegs:
    """How the legs of a standing person are bent."""

    knees: tuple[float, float]
    """Degrees of flexion, right and left."""
    thighs: tuple[float, float]
    """Degrees by which the thighs lean from the vertical."""
    heels: float
    """m, height of the right heel above the left one."""

    @property
    def bent(self) -> bool:
        """Whether a knee bends further than people stand."""
        return max(self.knees) > BENT_DEG

    @property
    def uneven(self) -> bool:
        """Whether the legs do different things."""
        return abs(self.knees[0] - self.knees[1]) > UNEVEN_DEG or abs(self.heels) > UNEVEN_M

    @property
    def sitting(self) -> bool:
        """Whether both thighs lie."""
        return min(self.thighs) > SITTING_DEG


def standing_legs(p: Mapping[str, Array], height: float) -> StandingLegs | None:
    """The stance that landmarks p ((3,) m each, y up) of a person of this height (m) show; None where some lack."""
    axes = body_axes(p)
    if axes is None or any(name not in p for name in REQUIRED):
        return None
    body = lower_body(StaticPosture("", {}, p, {}), height, HipCentre.BELL)
    knees, thighs = [], []
    for side in SIDES:
        thigh, shank = body.frames[f"thigh_{side}"].rotation, body.frames[f"shank_{side}"].rotation
        up = thigh.T @ shank[:, 1]
        knees.append(float(np.rad2deg(np.arctan2(up[0], up[1]))))
        thighs.append(float(np.rad2deg(np.arccos(np.clip(thigh[1, 1], -1.0, 1.0)))))
    heels = float(p["heel_r"][1] - p["heel_l"][1])
    return StandingLegs(knees=(knees[0], knees[1]), thighs=(thighs[0], thighs[1]), heels=heels)


def standing_flat(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the feet of a static trial stand as the zero of the ankle angles was taken from them."""
    p, rule = trial.posture, AnkleZero(trial.settings.ankle_rule)
    makes_model = trial.rebuilding is not None
    if p is None or not makes_model or rule is not AnkleZero.AUTO or any(name not in p for name in REQUIRED):
        return
    posture = StaticPosture(trial.source, {}, p, {})
    legs = lower_body(posture, trial.subject.height, HipCentre.HARRINGTON, widths=JointWidths.of(trial.subject))
    doubts = standing_ankles(posture, legs, trial.recording.facts.static_plantarflexion, rule).doubts
    if doubts:
        yield trial.finding(
            Severity.WARNING,
            "posture",
            "; ".join(f"{SIDE_WORDS[side]} foot: {why}" for side, why in doubts.items()),
            "look at the feet in that trial and say it under [calibration]: ankle_zero = 'sole' if they stand flat, "
            "'file' or 'markers' if the heels are off the floor",
            cause="the feet may not stand flat in the static trial, from which ankle angles are counted",
            leg="" if len(doubts) == 2 else next(iter(doubts)),
            code=Code.FEET_NOT_FLAT,
        )


def standing_straight(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person of a static trial stands on both straight legs."""
    if trial.posture is None:
        return
    found = standing_legs(trial.posture, trial.subject.height)
    if found is None:
        return
    knees = f"knees bent by {found.knees[0]:.0f} deg (right) and {found.knees[1]:.0f} deg (left)"
    words = f"{knees}, thighs leaning by {found.thighs[0]:.0f} and {found.thighs[1]:.0f} deg"
    if found.sitting:
        yield trial.finding(
            Severity.ERROR,
            "posture",
            f"{words}; standing people lean by less than {SITTING_DEG:.0f}",
            "name the recording in which the person stands",
            cause="the person sits in the static trial",
            weight=5.0,
            code=Code.SITTING,
        )
    elif found.uneven:
        yield trial.finding(
            Severity.WARNING,
            "posture",
            f"{knees}, right heel {1e3 * found.heels:+.0f} mm above the left one",
            "choose the part in which both feet stand with time = [start, end], or record standing again; nothing to "
            "do if the person cannot stand otherwise",
            cause="the person stands unevenly in the static trial",
            code=Code.UNEVEN_STANCE,
        )
    elif found.bent:
        yield trial.finding(
            Severity.WARNING,
            "posture",
            f"{words}; most people stand within 10 deg",
            "record it again if the person can stand straighter; nothing to do if not: only the skin lies a little "
            "otherwise than over straight legs",
            cause="the person stands with bent knees in the static trial",
            code=Code.BENT_KNEES,
        )
