"""Body mass against the ground reactions of a walk, whatever their gain.

Over a stretch in which every foot on the ground is on a plate, from ta to tb, the vertical force changes the body's
momentum: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The pelvis stands for the mass centre, so that the velocities
are a little wrong; the longer the stretch, the less that matters.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.ground_contact import UNDER_FOOT, near
from gaitcal.model.build import GRAVITY
from gaitcal.recording import resample_wrench
from gaitcal.study.checks.contacts import Feet, overhang, steps
from gaitcal.study.checks.evidence import TrialEvidence, runs, spans
from gaitcal.study.checks.finding import Finding, info, warning

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SHORTEST_S = 0.5
"""About a step: over less, the pelvis is no measure of the mass centre."""
DIFFERENCE = 0.05
"""Of the mass, beside what the velocities may be wrong by."""
PELVIS_M_S = 0.4
"""By which the change of the pelvis' velocity may differ from that of the mass centre: 8 % of the mass over 0.5 s, as
`pig_c3d` differs over its single step, 2 % over two strides."""
VELOCITY_S = 0.1
"""Stretch over which the velocity at either end is fitted."""


def carried_mass(trial: TrialEvidence) -> Iterator[Finding]:
    """The mass that the plates of a gait trial carry, against the subject's."""
    if trial.trial.role != "gait" or trial.pelvis is None or len(trial.recording.time) < 3:
        return
    feet = Feet(trial)
    if not feet.seen.any():
        return
    time = feet.time
    found = [
        (run, mass)
        for run in runs(_measured(trial, feet), 3)
        if time[run.stop - 1] - time[run.start] >= SHORTEST_S and (mass := _mass(trial, time, run)) is not None
    ]
    if not found:
        return
    lengths = [time[run.stop - 1] - time[run.start] for run, _ in found]
    mass, told = float(np.average([m for _, m in found], weights=lengths)), trial.subject.mass
    words = f"while every foot is on a plate ({spans(time, [run for run, _ in found])}) the plates carry {mass:.1f} kg"
    words += f" on average; subject.mass_kg is {told:g}"
    if abs(mass / told - 1.0) > DIFFERENCE + PELVIS_M_S / (GRAVITY * float(np.sum(lengths))):
        cure = "correct mass_kg, or the gain and offset of the plates: joint torques are wrong by the same share"
        yield warning("body mass", trial.name, words, cure, trial.source)
    else:
        yield info("body mass", trial.name, words)


def _measured(trial: TrialEvidence, feet: Feet) -> BoolArray:
    """(nf,) where some foot is loaded and no foot stands beside a plate or partly so."""
    loaded = np.zeros((len(feet.time), 2), dtype=bool)
    doubtful = np.zeros(len(feet.time), dtype=bool)
    for step in steps(trial, feet):
        if step.distance < UNDER_FOOT:
            loaded[step.frames, step.foot] = True
        if step.distance >= UNDER_FOOT or any(overhang(trial, feet, step)):
            doubtful[step.frames] = True
    for foot in range(2):
        beside = feet.resting(foot) & ~near(loaded[:, foot], feet.time)
        doubtful |= near(beside, feet.time) | ~feet.seen[:, foot]
    out: BoolArray = loaded.any(axis=1) & ~doubtful
    return out


def _mass(trial: TrialEvidence, time: Array, run: slice) -> float | None:
    """kg; None where the pelvis is not seen at both ends."""
    force = sum(np.nan_to_num(resample_wrench(plate, time))[run, 1] for plate in trial.recording.plates)
    ends = [_velocity(trial, time, float(at)) for at in (time[run.start], time[run.stop - 1])]
    if ends[0] is None or ends[1] is None:
        return None
    length = float(time[run.stop - 1] - time[run.start])
    mean = float(np.trapezoid(force, time[run])) / length
    return mean / (GRAVITY + (ends[1] - ends[0]) / length)


def _velocity(trial: TrialEvidence, time: Array, at: float) -> float | None:
    """m/s, vertical, of the pelvis."""
    pelvis = trial.pelvis
    if pelvis is None:
        return None
    near = (np.abs(time - at) <= 0.5 * VELOCITY_S + 1e-9) & pelvis.determined
    if near.sum() < 3:
        return None
    return float(np.polyfit(time[near] - at, pelvis.origin[near, 1], 1)[0])
