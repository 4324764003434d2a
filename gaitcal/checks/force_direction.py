"""Horizontal forces and centres of pressure of a walk against what every walk does.

A leg brakes when it touches down and drives when it leaves, and both legs push the body towards its middle. Where whole
steps say the opposite, a column of forces has the wrong sign. Where the centres of pressure of both feet lie off their
feet to the same side of the room, the plates lie elsewhere.

Body mass against the ground reactions of a walk, whatever their gain.

Over a stretch in which every foot on the ground is on a plate, from ta to tb, the vertical force changes the body's
momentum: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The pelvis stands for the mass centre, so that the velocities
are a little wrong; the longer the stretch, the less that matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.checks.contacts import Feet, Step, overhang, steps
from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.finding import Finding, info, warning
from gaitcal.dynamics.ground_contact import UNDER_FOOT, near
from gaitcal.model.build import GRAVITY
from gaitcal.recording import resample_wrench
from gaitcal.recording.axes import PROGRESSION_M, net_progression
from gaitcal.recording.intervals import runs, spans
from gaitcal.study.study import Role

Array = NDArray[np.float64]

STANCE_S = 0.3
"""Shorter loadings are no step."""
DRIVING = -0.1
"""Drift of the force along the walk from braking to driving, sum(F t) / sum(|F|) with t from -1 to 1 over the step:
0.36 to 0.63 in whole steps of real and synthetic walks; below this it is reversed."""
OUTWARD = 0.01
"""Mean sideways force, in body weights, above which legs push outwards: real and synthetic ones push inwards, 0.03 to
0.06."""
BESIDE_M = 0.025
"""How far the centres of pressure of both feet must lie to one side; on real walks they lie 13 to 22 mm beside the line
from heel to toe, to either side."""
LOADED_SHARE = 0.5
"""Of body weight: a foot that carries as much lies flat."""


def horizontal(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether legs brake before they drive, and push inwards."""
    walk = _walk(trial)
    if walk is None:
        return
    drift, outward = [], []
    for step in walk.steps:
        force = np.nan_to_num(resample_wrench(step.plate, walk.feet.time))[step.frames][:, [0, 2]]
        along = force @ walk.forward
        if step.frames.start > 0 and step.frames.stop < len(walk.feet.time):
            drift.append(float(along @ np.linspace(-1.0, 1.0, len(along)) / max(np.abs(along).sum(), 1e-9)))
        outward.append(float((force @ walk.right).mean()) * (1 if step.foot == 0 else -1) / trial.subject.weight)
    told = []
    if drift and max(drift) < DRIVING:
        told.append(f"along the walk they drive first and brake later (drift {np.mean(drift):.2f}, usual 0.4 to 0.6)")
    if min(outward) > OUTWARD:
        told.append(
            f"sideways they push outwards, {np.mean(outward):.2f} body weights on average (usual -0.06 to -0.03)"
        )
    if told:
        cure = "check the sign of the horizontal columns of the forces"
        if len(told) > 1:
            cure += "; where a note says that a plate was turned round: of the vertical column alone"
        yield warning(
            "plates",
            trial.name,
            f"horizontal forces of {len(walk.steps)} steps seem reversed: {'; '.join(told)}",
            cure,
            trial.source,
        )


def beside_feet(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the centres of pressure of both feet lie off their feet to the same side of the room."""
    walk = _walk(trial)
    if walk is None:
        return
    feet, shifts = walk.feet, dict[int, list[float]]({0: [], 1: []})
    for step in walk.steps:
        flat = feet.seen[step.frames, step.foot] & (step.load > LOADED_SHARE * trial.subject.weight)
        if flat.sum() < 3:
            continue
        heel, toe = (path[step.frames, step.foot][flat][:, [0, 2]] for path in (feet.heel, feet.toe))
        line = (toe - heel) / np.linalg.norm(toe - heel, axis=1, keepdims=True)
        across = np.stack([-line[:, 1], line[:, 0]], axis=1)
        away = np.sum((step.point[flat][:, [0, 2]] - heel) * across, axis=1)
        shifts[step.foot].append(float(np.mean(away * np.sign(across @ walk.right))))
    if not shifts[0] or not shifts[1]:
        return
    every = np.array([*shifts[0], *shifts[1]])
    if np.abs(every).min() > BESIDE_M and len(set(np.sign(every))) == 1:
        means = [1e3 * float(np.mean(shifts[foot])) for foot in (0, 1)]
        yield warning(
            "plate to foot",
            trial.name,
            f"the centres of pressure lie to the {'right' if every[0] > 0 else 'left'} of the line heel-toe of both "
            f"feet: {abs(means[0]):.0f} mm (right foot) and {abs(means[1]):.0f} mm (left foot)",
            "check the positions of the plates in the room (corners), and the origin of the markers",
            trial.source,
        )


@dataclass(frozen=True)
class _Walk:
    """A gait trial with steps that are long enough and under a foot."""

    feet: Feet
    steps: tuple[Step, ...]
    forward: Array
    """(2,) unit vector in x and z."""

    @property
    def right(self) -> Array:
        """(2,) unit vector in x and z."""
        return np.array([-self.forward[1], self.forward[0]])


def _walk(trial: TrialEvidence) -> _Walk | None:
    """None where there are no such steps."""
    if trial.trial.role is not Role.GAIT or trial.pelvis is None or len(trial.recording.time) < 3:
        return None
    feet = Feet(trial)
    if not feet.seen.any():
        return None
    long = tuple(
        step
        for step in steps(trial, feet)
        if step.distance < UNDER_FOOT and feet.time[step.frames.stop - 1] - feet.time[step.frames.start] >= STANCE_S
    )
    return _Walk(feet, long, _forward(trial)) if long else None


def _forward(trial: TrialEvidence) -> Array:
    """(2,) unit vector in x and z: the way the body goes, or where the pelvis faces on a treadmill."""
    way = net_progression(trial.recording)[[0, 2]]
    if np.linalg.norm(way) < PROGRESSION_M and trial.pelvis is not None:
        way = trial.pelvis.rotation[trial.pelvis.determined][:, [0, 2], 0].mean(axis=0)
    out: Array = way / max(float(np.linalg.norm(way)), 1e-12)
    return out


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
    if trial.trial.role is not Role.GAIT or trial.pelvis is None or len(trial.recording.time) < 3:
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
