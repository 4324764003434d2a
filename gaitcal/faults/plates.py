"""Force plates: what the reader found, sign, offset, saturation, corners, and what their forces do on every walk.

A leg brakes when it touches down and drives when it leaves, and both legs push the body towards its middle. Where whole
steps say the opposite, a column of forces has the wrong sign. Where the centres of pressure of both feet lie off their
feet to the same side of the room, the plates lie elsewhere.

Whether the free moments of the plates have the sign that those of walking people have.

The moment T about the vertical through the centre of pressure holds the foot against turning inwards in the first half
of stance and outwards in the second (Almosnino et al., BMC Sports Sci Med Rehabil 1:19, 2009: 11 people, feet turned
in, straight and out). With T along the vertical upwards, s = 1 on the right foot and -1 on the left, t from 0 to 1
over a step and W H body weight times height, each whole step says

    d = s (mean of T over LATE - mean of T over EARLY) / (W H)

which is positive. Its mean x over the steps of each leg, and then over the legs that have any, is N(MEAN, v) with
v = PERSON^2 + LEG^2 / legs, and N(-MEAN, v) where the sign is wrong. The evidence for that is -2 MEAN x / v nats.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import UNDER_FOOT
from gaitcal.dynamics.plate_errors import OUTSIDE_SHARE, share_outside
from gaitcal.faults.contacts import Feet, Step, feet_of, steps
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.io.axes import PROGRESSION_M, net_progression
from gaitcal.io.force_plate import BODY_N, OUTSIDE_M, QUIET_N, UNLOADED_N, resample_wrench
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.io.recording import ForcePlate

OFFSET_N = 15.0
"""Reading of an empty plate that a file of forces should not have."""
CLIPPED = 5
"""Samples in a row at the very same largest value: an amplifier at its end."""
CLIPPED_N = 200.0
DEAD_N, DEAD_SAMPLES = 0.5, 20
"""A horizontal force that changes by less over so many loaded samples is no measured one: noise alone changes more."""
ASLANT = 0.5
"""Horizontal over vertical force, median under load, above which axes are doubted; walking has 0.1 to 0.2."""
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
PLATES_ELSEWHERE = "the plates, or the markers, are not where the file has them"
LOADED_SHARE = 0.5
"""Of body weight: a foot that carries as much lies flat."""

_ALARMING = re.compile(r"left out|never empty|outside its corners|no numbers")


def told_on_reading(trial: TrialEvidence) -> Iterator[Finding]:
    """What the reader noted on plates: type, sign, corners, offset, samples without numbers."""
    for note in trial.recording.notes:
        if not re.match(r"Plate |\d+ force plate", note) or "holds the columns" in note:
            continue
        if _ALARMING.search(note) and trial.is_gait:
            cure = "check FORCE_PLATFORM in the file; forces of this plate are not to be trusted without"
            if "never empty" in note:
                cure = "record some seconds with nobody on the plate, or remove its offset before export"
            yield trial.warning(
                "plates",
                note.rstrip("."),
                cure,
                cause="a force plate is not described as it should be",
                code=Code.PLATE_DESCRIPTION,
            )
        else:
            yield trial.info("plates", note.rstrip("."), code=Code.PLATE_DESCRIPTION)


def signals(trial: TrialEvidence) -> Iterator[Finding]:
    """Sign, offset, saturation and direction of every plate's force."""
    for plate in trial.recording.plates:
        force = plate.force[np.isfinite(plate.force).all(axis=1)]
        if not len(force):
            continue
        up = force[:, 1]
        name = f"plate {plate.name}"
        if (pulled := int((up < -BODY_N).sum())) > 0:
            found = f"{name}: pulls the body down with up to {-up.min():.0f} N in {pulled} samples; it can only push"
            cure = "check the sign and the offset of its channels"
            yield trial.warning("plates", found, cure, cause=f"{name} pulls", code=Code.PLATE_PULLS)
        empty = np.abs(up) < UNLOADED_N
        empty &= np.abs(up - np.median(up[empty])) < QUIET_N if empty.any() else False
        if empty.mean() > 0.1 and abs(rest := float(np.median(up[empty]))) > OFFSET_N:
            found = f"{name}: reads {rest:.0f} N where nobody stands on it"
            cure = "remove the offset of the empty plate"
            yield trial.warning(
                "plates", found, cure, cause=f"{name} is not at zero when empty", code=Code.PLATE_OFFSET
            )
        yield from _clipped(trial, plate)
        loaded = up > BODY_N
        yield from _dead(trial, plate, force[loaded])
        if loaded.sum() > 10:
            ratio = float(np.median(np.hypot(force[loaded, 0], force[loaded, 2]) / up[loaded]))
            if ratio > ASLANT:
                found = f"{name}: its horizontal force is {ratio:.2f} times the vertical one"
                cure = "are its axes those of the file, y up?"
                yield trial.warning(
                    "plates", found, cure, cause=f"the axes of {name} are not those of the room", code=Code.PLATE_AXES
                )


def _dead(trial: TrialEvidence, plate: ForcePlate, loaded: Array) -> Iterator[Finding]:
    """Horizontal components that never change while somebody walks on the plate, `loaded` (n, 3) N."""
    if not trial.is_gait or len(loaded) < DEAD_SAMPLES:
        return
    still = [name for axis, name in ((0, "x"), (2, "z")) if np.ptp(loaded[:, axis]) <= DEAD_N]
    if still:
        missing = " and ".join(f"F{name}" for name in still)
        yield trial.warning(
            "plates",
            f"plate {plate.name}: {missing} stays at {loaded[0, 0 if still[0] == 'x' else 2]:.0f} N in all "
            f"{len(loaded)} samples under load; walking moves it by some 100 N (fore-aft) and 40 N (sideways)",
            "look for the channel, its cable and its column in the file; without it leave the plate out of torques",
            cause=f"a horizontal force of plate {plate.name} is missing: {missing} is constant",
            code=Code.DEAD_CHANNEL,
        )


def _clipped(trial: TrialEvidence, plate: ForcePlate) -> Iterator[Finding]:
    """Components of the force that stay at their largest value."""
    for axis, name in enumerate("xyz"):
        values = plate.force[:, axis]
        size = np.abs(np.nan_to_num(values))
        if (top := float(size.max())) < CLIPPED_N:
            continue
        held = runs(size >= top * (1 - 1e-9), CLIPPED)
        # Smooth data may rest at its peak for a sample or two, never for five.
        if held:
            yield trial.warning(
                "plates",
                f"plate {plate.name}: F{name} stays at {top:.0f} N for {sum(s.stop - s.start for s in held)} samples "
                f"({spans(plate.time, held)})",
                "choose a larger range of the amplifier; leave these frames out with time = [start, end]",
                cause=f"plate {plate.name} is saturated",
                code=Code.SATURATED_PLATE,
            )


def corners(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether centres of pressure lie on their plate."""
    for plate in trial.recording.plates:
        if plate.corners is None:
            continue
        share, farthest = share_outside(plate, plate.corners, BODY_N)
        if share > OUTSIDE_SHARE:
            yield trial.warning(
                "plates",
                f"plate {plate.name}: the centre of pressure of {100 * share:.0f} % of its load lies over "
                f"{1e3 * OUTSIDE_M:.0f} mm outside its corners (up to {1e3 * farthest:.0f} mm)",
                "check FORCE_PLATFORM:CORNERS, ORIGIN and CHANNEL",
                cause=f"the corners of plate {plate.name} do not hold its centre of pressure",
                code=Code.PLATE_CORNERS,
            )


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
    wrong, which = [], []
    if drift and max(drift) < DRIVING:
        wrong.append(f"along the walk they drive first and brake later (drift {np.mean(drift):.2f}, usual 0.4 to 0.6)")
        which.append("fore-aft")
    if min(outward) > OUTWARD:
        which.append("sideways")
        wrong.append(
            f"sideways they push outwards, {np.mean(outward):.2f} body weights on average (usual -0.06 to -0.03)"
        )
    if wrong:
        cause = f"the {which[0]} force of all plates has the wrong sign"
        cure = "turn the sign of that column of the forces"
        if len(wrong) > 1:
            cause = "both horizontal forces of all plates have the wrong sign"
            cure += "; where a note says that a plate was turned round: of the vertical column alone"
        found = f"in {len(walk.steps)} steps: {'; '.join(wrong)}"
        yield trial.warning("forces", found, cure, cause=cause, code=Code.FORCE_SIGN)


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
        # x and z seen from above: z is to the right of x, so (-z, x) lies across the line, to its right
        line = (toe - heel) / np.linalg.norm(toe - heel, axis=1, keepdims=True)
        across = np.stack([-line[:, 1], line[:, 0]], axis=1)
        away = np.sum((step.point[flat][:, [0, 2]] - heel) * across, axis=1)
        shifts[step.foot].append(float(np.mean(away * np.sign(across @ walk.right))))
    if not shifts[0] or not shifts[1]:
        return
    every = np.array([*shifts[0], *shifts[1]])
    if np.abs(every).min() > BESIDE_M and len(set(np.sign(every))) == 1:
        means = [1e3 * float(np.mean(shifts[foot])) for foot in (0, 1)]
        yield trial.warning(
            "plate to foot",
            f"the centres of pressure lie to the {'right' if every[0] > 0 else 'left'} of the line heel-toe of both "
            f"feet: {abs(means[0]):.0f} mm (right foot) and {abs(means[1]):.0f} mm (left foot)",
            "check the positions of the plates in the room (corners), and the origin of the markers",
            cause=PLATES_ELSEWHERE,
            code=Code.PLATES_ELSEWHERE,
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
    feet = feet_of(trial)
    if feet is None or trial.pelvis is None:
        return None
    long = tuple(
        step
        for step in steps(trial, feet)
        if step.distance < UNDER_FOOT and duration(feet.time, step.frames) >= STANCE_S
    )
    return _Walk(feet, long, _forward(trial)) if long else None


def _forward(trial: TrialEvidence) -> Array:
    """(2,) unit vector in x and z: the way the body goes, or where the pelvis faces on a treadmill."""
    way = net_progression(trial.recording)[[0, 2]]
    if np.linalg.norm(way) < PROGRESSION_M and trial.pelvis is not None:
        way = trial.pelvis.rotation[trial.pelvis.determined][:, [0, 2], 0].mean(axis=0)
    out: Array = way / max(float(np.linalg.norm(way)), 1e-12)
    return out


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
