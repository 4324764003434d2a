"""Body mass against the ground reactions, standing, step by step, and over strides, whatever the gain of the plates.

Over a stretch in which every foot on the ground is on a plate, from ta to tb, the vertical force changes the body's
momentum: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The pelvis stands for the mass centre, so that the velocities
are a little wrong; the longer the stretch, the less that matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import near
from gaitcal.dynamics.plate_steps import UNDER_FOOT
from gaitcal.faults.contacts import Feet, feet_of, overhang, steps
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.io.filters import resample_wrench
from gaitcal.io.force_plate import BODY_N
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.io.recording import ForcePlate
from gaitcal.io.still import still_window
from gaitcal.model.build import GRAVITY

DIFFERENCE = 0.05
"""Of the mass, from which it is told; over strides, beside what the velocities may be wrong by."""
STANCE_SHARE = (0.55, 1.25)
"""Mean vertical force over a stance phase of walking, in body weights: about 0.8."""
PEAK = 3.0
STANCE_S = 0.3
"""Shorter loadings are no step."""
SHORTEST_S = 0.5
"""About a step: over less, the pelvis is no measure of the mass centre."""
PELVIS_M_S = 0.4
"""By which the change of the pelvis' velocity may differ from that of the mass centre: 8 % of the mass over 0.5 s, as
`pig_c3d` differs over its single step, 2 % over two strides."""
VELOCITY_S = 0.1
"""Stretch over which the velocity at either end is fitted."""


def standing(trial: TrialEvidence) -> Iterator[Finding]:
    """Body mass against the force under the standing person."""
    if not trial.is_static or trial.model is None or not trial.recording.plates:
        return
    window = still_window(trial.recording, trial.marker_set.labels)
    total = 0.0
    for plate in trial.recording.plates:
        within = (plate.time >= window.start) & (plate.time <= window.stop) & np.isfinite(plate.force[:, 1])
        total += float(np.median(plate.force[within, 1])) if within.any() else 0.0
    mass, carried = trial.subject.mass, total / GRAVITY
    words = f"the plates carry {total:.0f} N = {carried:.1f} kg while standing; subject.mass_kg is {mass:g}"
    if carried < 0.5 * mass:
        yield trial.info("body mass", f"{words}: a foot stood beside the plates", code=Code.BODY_MASS)
    elif abs(carried / mass - 1) > DIFFERENCE:
        cure = "correct mass_kg, if both feet stood on plates: torques and inertia follow from it"
        yield trial.warning("body mass", words, cure, cause="mass_kg is not what the plates weigh", code=Code.BODY_MASS)
    else:
        yield trial.info("body mass", words, code=Code.BODY_MASS)


def stepping(trial: TrialEvidence) -> Iterator[Finding]:
    """Body weight against the mean and the largest force of whole steps."""
    if not trial.is_gait:
        return
    weight = trial.subject.weight
    feet = feet_of(trial)
    together = _shared(trial, feet) if feet is not None else []
    for plate in trial.recording.plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in runs(up > BODY_N, 2):
            if duration(plate.time, run) < STANCE_S or run.start == 0 or run.stop == len(up):
                continue  # a knock, or a step that the recording cuts off
            begin, end = plate.time[run.start], plate.time[run.stop - 1]
            if any(plate is own and start < end and begin < stop for own, start, stop in together):
                continue  # a part of the foot is elsewhere
            share, peak = float(up[run].mean()) / weight, float(up[run].max()) / weight
            if STANCE_SHARE[0] <= share <= STANCE_SHARE[1] and peak < PEAK:
                continue
            yield trial.warning(
                "body mass",
                f"plate {plate.name}, {spans(plate.time, [run])}: mean {share:.2f} and peak {peak:.2f} body weights of "
                f"{trial.subject.mass:g} kg; a step of walking has about 0.8 and 1.1",
                "check mass_kg, the gain of the plate, and whether the whole foot was on it",
                cause=f"steps on plate {plate.name} do not carry the body",
                code=Code.STEP_LOAD,
            )


def _shared(trial: TrialEvidence, feet: Feet) -> list[tuple[ForcePlate, float, float]]:
    """Loadings, plate and s from when to when, of feet on two plates at once, or partly beside theirs."""
    found = steps(trial, feet)
    partly = [step for step in found if step.distance < UNDER_FOOT and any(overhang(trial, feet, step))]
    out = [(s.plate, float(feet.time[s.frames.start]), float(feet.time[s.frames.stop - 1])) for s in partly]
    for one, other in permutations(found, 2):
        same = one.foot == other.foot and one.plate is not other.plate
        if same and one.frames.start < other.frames.stop and other.frames.start < one.frames.stop:
            out.append((one.plate, float(feet.time[one.frames.start]), float(feet.time[one.frames.stop - 1])))
    return out


def carried_mass(trial: TrialEvidence) -> Iterator[Finding]:
    """The mass that the plates of a gait trial carry, against the subject's."""
    feet = feet_of(trial)
    if feet is None or trial.pelvis is None:
        return
    time, mass = feet.time, trial.subject.mass
    weighings = [
        (run, carried)
        for run in runs(_measured(trial, feet), 3)
        if duration(time, run) >= SHORTEST_S and (carried := _mass(trial, time, run)) is not None
    ]
    if not weighings:
        return
    lengths = [duration(time, run) for run, _ in weighings]
    carried = float(np.average([m for _, m in weighings], weights=lengths))
    words = f"while every foot is on a plate ({spans(time, [run for run, _ in weighings])}) the plates carry "
    words += f"{carried:.1f} kg on average; subject.mass_kg is {mass:g}"
    if abs(carried / mass - 1.0) > DIFFERENCE + PELVIS_M_S / (GRAVITY * float(np.sum(lengths))):
        cure = "correct mass_kg, or the gain and offset of the plates: joint torques are wrong by the same share"
        yield trial.warning("body mass", words, cure, cause="mass_kg is not what the plates weigh", code=Code.BODY_MASS)
    else:
        yield trial.info("body mass", words, code=Code.BODY_MASS)


def _measured(trial: TrialEvidence, feet: Feet) -> BoolArray:
    """(nf,) where some foot is loaded and no foot stands beside a plate or partly so."""
    loaded = np.zeros((len(feet.time), 2), dtype=bool)
    doubtful = np.zeros(len(feet.time), dtype=bool)
    for step in steps(trial, feet):
        if step.distance < UNDER_FOOT:
            loaded[step.frames, step.foot] = True
        if step.distance >= UNDER_FOOT or any(overhang(trial, feet, step)):
            doubtful[step.frames] = True
    doubtful = near(doubtful, feet.time)  # beside a plate a foot may bear before and after that plate is loaded
    for foot in range(2):
        beside = feet.resting(foot) & ~near(loaded[:, foot], feet.time)
        doubtful |= near(beside, feet.time) | ~feet.seen[:, foot]
    out: BoolArray = loaded.any(axis=1) & ~doubtful
    return out


def _mass(trial: TrialEvidence, time: Array, run: slice) -> float | None:
    """Mass (kg) that the plates carry in the frames `run`; None where the pelvis is not seen at both ends."""
    force = sum(np.nan_to_num(resample_wrench(plate, time))[run, 1] for plate in trial.recording.plates)
    before, after = (_velocity(trial, time, float(time[frame])) for frame in (run.start, run.stop - 1))
    if before is None or after is None:
        return None
    length = duration(time, run)
    mean = float(np.trapezoid(force, time[run])) / length
    return mean / (GRAVITY + (after - before) / length)


def _velocity(trial: TrialEvidence, time: Array, moment: float) -> float | None:
    """m/s, vertical, of the pelvis at the time `moment` (s); None where it is not seen."""
    pelvis = trial.pelvis
    if pelvis is None:
        return None
    near = (np.abs(time - moment) <= 0.5 * VELOCITY_S + 1e-9) & pelvis.determined
    if near.sum() < 3:
        return None
    return float(np.polyfit(time[near] - moment, pelvis.origin[near, 1], 1)[0])
