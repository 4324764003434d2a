"""Which joint of which side moves in an isolated trial: the one that turns most about its own mean posture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.model.linkage import ISOLATED_JOINTS

LEAD = 1.25
"""How many times the declared joint another one must turn. In 38 isolated trials (20 real, 18 synthetic) the declared
one led the next by 1.7 times at least."""
TRAVEL_M, STAYS_M = 0.8, 0.3
"""How far the pelvis goes in a walk, and how far in isolated trials at most."""
STEPS_RAD = np.deg2rad(12.0)
"""RMS turn of hip and knee of the other leg, both, from which it walks: 17 and 22 deg in walks; in isolated trials of
a hip, the knee of the leg that stands turns by 7 and 11 deg at most."""
MOVES_RAD = np.deg2rad(4.0)
"""RMS turn below which no joint is said to move: the smallest isolated trial reaches 14 deg."""


def moving_joint(trial: TrialEvidence) -> tuple[str, float] | None:
    """The joint that turns most, and its RMS turn (rad); None where fewer than two joints are seen."""
    turns = {joint: link.rms for joint, link in trial.links.items()}
    if len(turns) < 2:
        return None
    joint = max(turns, key=turns.__getitem__)
    return joint, turns[joint]


def one_joint_alone(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body stays where it is, and the other leg still, while one joint moves."""
    declared = trial.trial.joint
    if not trial.is_isolated or declared is None:
        return
    signs = []
    if trial.pelvis is not None and trial.pelvis.determined.any():
        places = trial.pelvis.origin[trial.pelvis.determined][:, [0, 2]]
        travel = float(np.linalg.norm(places[-1] - places[0]))
        if travel > TRAVEL_M:
            signs.append(f"the pelvis goes {travel:.2f} m (in trials of one joint up to {STAYS_M:.1f} m)")
    other = "l" if declared.endswith("r") else "r"
    turns = [trial.links[f"{joint}_{other}"].rms for joint in ("hip", "knee") if f"{joint}_{other}" in trial.links]
    if len(turns) == 2 and min(turns) > STEPS_RAD:
        hip, knee = np.rad2deg(turns)
        signs.append(f"hip and knee of the other leg turn by {hip:.0f} and {knee:.0f} deg RMS")
    if signs:
        yield trial.warning(
            "role",
            " and ".join(signs),
            'write role = "gait", or name the file of the isolated trial',
            cause=f"the trial is declared for {declared} alone, but this looks like a walk",
            weight=5.0,
            code=Code.LOOKS_LIKE_WALK,
        )


def declared_joint(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the joint that moves is the one for which the trial is declared."""
    declared = trial.trial.joint
    found = moving_joint(trial) if trial.is_isolated else None
    if found is None or declared is None or found[0] == declared or found[1] < MOVES_RAD:
        return
    joint, rms = found
    own = trial.links.get(declared)
    if own is not None and rms < LEAD * own.rms:
        return
    turned = "is not seen" if own is None else f"turns by {np.rad2deg(own.rms):.0f} deg RMS"
    others = [j for j in ISOLATED_JOINTS if j in trial.links and j not in (joint, declared)]
    rest = max((np.rad2deg(trial.links[j].rms) for j in others), default=0.0)
    yield trial.error(
        "joint",
        f"it turns by {np.rad2deg(rms):.0f} deg RMS about its mean posture, {declared} {turned}, the others by at most "
        f"{rest:.0f} deg",
        f'write joint = "{joint}", name the file of {declared}, or exchange the labels of right and left',
        cause=f"the trial is declared for {declared}, but this looks like {joint}",
        weight=rms / max(own.rms, MOVES_RAD) if own else rms / MOVES_RAD,
        code=Code.OTHER_JOINT,
    )
