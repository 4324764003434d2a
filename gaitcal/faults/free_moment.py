"""Whether the free moments of the plates have the sign that those of walking people have.

The moment T about the vertical through the centre of pressure holds the foot against turning inwards in the first half
of stance and outwards in the second (Almosnino et al., BMC Sports Sci Med Rehabil 1:19, 2009: 11 people, feet turned
in, straight and out). With T along the vertical upwards, s = 1 on the right foot and -1 on the left, t from 0 to 1
over a step and W H body weight times height, each whole step says

    d = s (mean of T over LATE - mean of T over EARLY) / (W H)

which is positive. Its mean x over the steps of each leg, and then over the legs that have any, is N(MEAN, v) with
v = PERSON^2 + LEG^2 / legs, and N(-MEAN, v) where the sign is wrong. The evidence for that is -2 MEAN x / v nats.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import cross
from gaitcal.codes import Code
from gaitcal.dynamics.plate_steps import UNDER_FOOT
from gaitcal.faults.contacts import Step, feet_of, steps
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.plates import horizontal
from gaitcal.findings import Finding
from gaitcal.io.axes import PROGRESSION_M, net_progression
from gaitcal.io.filters import resample_wrench

EARLY, LATE = (0.10, 0.40), (0.55, 0.95)
"""Of a step; impact and lifting off, whose centres of pressure are uncertain, are left out."""
MEAN, PERSON, LEG = 3.5e-3, 1.0e-3, 1.8e-3
"""Of body weight times height. Straight walks of eight recorded people, four of them children: 1.9 to 4.4 a person,
3.5 with SD 0.8; 1.3 to 6.1 a step. Turns: -1.5 to 12.8 a step, 1.9 to 6.8 in the mean of both legs. Simulated: 0.6
and 2.1 on two people of OpenSim's, 7 to 9 where the body is made to walk without a residual."""
ODDS = 1000.0
"""From which a wrong sign is told: one laboratory in 100 has one, and ten such warnings to a false one."""
CARRIED = (0.9, 1.5)
"""Of body weight: the largest vertical force of a foot that carries the body alone, and does not run."""


def free_moment(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether free moments hold the feet against turning, or turn them on."""
    feet = feet_of(trial)
    if feet is None or not trial.recording.plates or not _forwards(trial):
        return
    of_leg: dict[int, list[float]] = {}
    for step in steps(trial, feet):
        whole = step.frames.start > 0 and step.frames.stop < len(feet.time)
        carried = float(step.load.max()) / trial.subject.weight
        if whole and step.distance < UNDER_FOOT and CARRIED[0] < carried < CARRIED[1]:
            of_leg.setdefault(step.foot, []).append(_held(trial, step))
    if not of_leg:
        return
    mean = float(np.mean([np.mean(found) for found in of_leg.values()]))
    evidence = -2.0 * MEAN * mean / (PERSON**2 + LEG**2 / len(of_leg))
    if evidence < np.log(ODDS) or next(horizontal(trial), None) is not None:
        return  # what turns horizontal forces round is told there, and may turn the moment round with them
    yield trial.warning(
        "forces",
        f"in {sum(map(len, of_leg.values()))} whole steps the free moment turns the foot inwards first and outwards "
        f"later, by {-1e3 * mean:.1f} thousandths of body weight times height; of walking people it is the other way "
        f"round, by {1e3 * MEAN:.1f}",
        "turn the sign of the moment about the vertical, or look about which point and axis it is given",
        cause="the free moment of all plates has the wrong sign",
        code=Code.FREE_MOMENT,
    )


def _held(trial: TrialEvidence, step: Step) -> float:
    """D of one step."""
    wrench = np.nan_to_num(resample_wrench(step.plate, trial.recording.time))[step.frames]
    moment = (wrench[:, 3:] - cross(step.point, wrench[:, :3]))[:, 1]
    t = np.linspace(0.0, 1.0, len(moment))
    early, late = (moment[(t > low) & (t < high)].mean() for low, high in (EARLY, LATE))
    side = 1.0 if step.foot == 0 else -1.0
    return float(side * (late - early) / (trial.subject.weight * trial.subject.height))


def _forwards(trial: TrialEvidence) -> bool:
    """Whether the body goes where the pelvis faces, or nowhere, as on a treadmill."""
    if trial.pelvis is None or not trial.pelvis.determined.any():
        return False
    way = net_progression(trial.recording)[[0, 2]]
    faces = trial.pelvis.rotation[trial.pelvis.determined][:, [0, 2], 0].mean(axis=0)
    return bool(way @ faces > 0) or float(np.linalg.norm(way)) < PROGRESSION_M
