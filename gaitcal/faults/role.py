"""Does a trial show what its role says: standing still, walking where the pelvis faces, one joint that moves alone?

Which joint of which side moves in an isolated trial: the one that turns most about its own mean posture.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.io.still import LAG_S, RESTLESS_M_S, STILL_M_S, still_window
from gaitcal.model.linkage import ISOLATED_JOINTS

FEWEST_FRAMES, SHORTEST_S = 3, LAG_S
"""Of a static trial: speed is told over that time."""
RESTLESS = 0.5
"""Share of the speed of a still window above which the stillest one is doubted: 1 to 7 mm/s in clean static trials."""
ALONG_DEG = 50.0
"""Angle between facing and going above which the person does not walk forwards."""
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


def length(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the static trial is long enough to tell that anybody stands still; one that is not is taken as it is."""
    time = trial.recording.time
    if not trial.is_static or (len(time) >= FEWEST_FRAMES and time[-1] - time[0] >= SHORTEST_S):
        return
    yield trial.warning(
        "still window",
        f"found {len(time)} frames over {time[-1] - time[0]:.3g} s, all of them used; at least {FEWEST_FRAMES} frames "
        f"over {SHORTEST_S:g} s tell standing still from moving",
        "make sure that the person stands still there, or give a longer part of the recording",
        cause="the static trial is too short to tell whether the person stands still",
        code=Code.SHORT_STATIC,
    )


def stillness(trial: TrialEvidence) -> Iterator[Finding]:
    """How still the person stood."""
    if not trial.is_static or trial.model is None or any(length(trial)):
        return
    try:
        window = still_window(trial.recording, trial.marker_set.labels)
    except InputError:
        return  # told as what keeps the nominal model from being made
    words = f"stillest window {window.start:.2f}-{window.stop:.2f} s, markers move at {1e3 * window.speed:.0f} mm/s RMS"
    words += f" and stray by {1e3 * window.scatter:.1f} mm RMS from their means"
    if window.speed <= RESTLESS * STILL_M_S:
        yield trial.info("still window", words, code=Code.STILLNESS)
        return
    yield trial.warning(
        "still window",
        f"{words}; most people stand within 10 mm/s, more than {1e3 * RESTLESS_M_S:.0f} are refused",
        "let the person stand still for some seconds; segment frames come from this posture",
        weight=window.speed / STILL_M_S,
        code=Code.STILLNESS,
    )


def heading(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person goes where the pelvis faces, and is not carried along sideways."""
    if trial.facing is None or not trial.is_gait:
        return
    length = float(np.linalg.norm(trial.way))
    if trial.on_the_spot:
        found = f"the body moves {length:.2f} m (treadmill?): x is where the pelvis faces"
        yield trial.info("heading", found, code=Code.ON_THE_SPOT)
        return
    cosine = float(trial.facing @ trial.way) / max(float(np.linalg.norm(trial.facing)) * length, 1e-12)
    angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle > ALONG_DEG:
        yield trial.warning(
            "heading",
            f"the pelvis faces {angle:.0f} deg away from the {length:.2f} m that the body moves",
            "if the person did not walk backwards or turn, the pelvis markers are exchanged (front and back, or sides)",
            code=Code.HEADING,
        )


def one_joint_alone(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body stays where it is, and the other leg still, while one joint moves."""
    declared = trial.trial.joint
    if not trial.is_isolated or declared is None:
        return
    signs = []
    if trial.pelvis is not None:
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
    turns = {joint: link.rms for joint, link in trial.links.items()} if trial.is_isolated else {}
    if len(turns) < 2 or declared is None:
        return
    joint = max(turns, key=turns.__getitem__)
    most, own = turns[joint], turns.get(declared)
    if joint == declared or most < MOVES_RAD or (own is not None and most < LEAD * own):
        return
    turned = "is not seen" if own is None else f"turns by {np.rad2deg(own):.0f} deg RMS"
    others = [j for j in ISOLATED_JOINTS if j in turns and j not in (joint, declared)]
    rest = max((np.rad2deg(turns[j]) for j in others), default=0.0)
    yield trial.error(
        "joint",
        f"it turns by {np.rad2deg(most):.0f} deg RMS about its mean posture, {declared} {turned}, the others by at "
        f"most {rest:.0f} deg",
        f'write joint = "{joint}", name the file of {declared}, or exchange the labels of right and left',
        cause=f"the trial is declared for {declared}, but this looks like {joint}",
        weight=most / max(own or 0.0, MOVES_RAD),
        code=Code.OTHER_JOINT,
    )
