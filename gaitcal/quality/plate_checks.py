"""Force plates: what the reader found, sign, offset, saturation, corners, and what their forces do
on every walk.

A leg brakes when it touches down and drives when it leaves, and both legs push the body towards its
middle. Where whole steps say the opposite, a column of forces has the wrong sign. Where the centres
of pressure of both feet lie off their feet to the same side of the room, the plates lie elsewhere.

The free moment T about the vertical through the centre of pressure holds the foot against turning
inwards in the first half of stance and outwards in the second (Almosnino et al., BMC Sports Sci Med
Rehabil 1:19, 2009: 11 people, feet turned in, straight and out). With T along the vertical upwards,
s = 1 on the right foot and -1 on the left, t from 0 to 1 over a step and W H body weight times
height, each whole step says

    d = s (mean of T over LATE - mean of T over EARLY) / (W H)

which is positive. Its mean x over the steps of each leg, and then over the legs that have any, is
N(MEAN, v) with v = PERSON^2 + LEG^2 / legs, and N(-MEAN, v) where the sign is wrong. The evidence
for that is -2 MEAN x / v nats.

Mass: over a stretch in which every foot on the ground is on a plate, from ta to tb, the vertical
force changes the body's momentum: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The pelvis stands
for the mass centre, so that the velocities are a little wrong; the longer the stretch, the less
that matters.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.dynamics.foot_contact import mark_near
from gaitcal.dynamics.measurement_errors import MAX_OUTSIDE_SHARE, compute_share_outside
from gaitcal.errors import Code, Finding, listed
from gaitcal.io.c3d.plates import CONTRADICTED
from gaitcal.io.force_plate import (
    BODY_N,
    OUTSIDE_M,
    QUIET_N,
    STANCE_S,
    UNLOADED_N,
    find_empty_samples,
    resample_wrench,
)
from gaitcal.io.recording import (
    ForcePlate,
    find_runs,
    find_still_window,
    format_spans,
    measure_duration,
)
from gaitcal.model.subject_model import GRAVITY
from gaitcal.preprocess.plate_contacts import Feet, PlateContact
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.foot_on_plate import PLATES_ELSEWHERE, TOPIC, overhang

OFFSET_N = 15.0  # Reading of an empty plate that a file of forces should not have
UNKNOWN_OFFSET_N = 20.0  # What plates that were not zeroed read in real files
CLIPPED = 5  # Samples in a row at the very same largest value: an amplifier at its end
CLIPPED_N = 200.0
DEAD_N, DEAD_SAMPLES = 0.5, 20
"""A horizontal force that changes by less over so many loaded samples is no measured one: noise
alone changes more.
"""
# Horizontal over vertical force, median under load, above which axes are doubted; walking has 0.1
# to 0.2
ASLANT = 0.5
DRIVING = -0.1
"""Drift of the force along the walk from braking to driving, sum(F t) / sum(|F|) with t from -1 to
1 over the step: 0.36 to 0.63 in whole steps of real and synthetic walks; below this it is reversed.
"""
OUTWARD = 0.01
"""Mean sideways force, in body weights, above which legs push outwards: real and synthetic ones
push inwards, 0.03 to 0.06."""
BESIDE_M = 0.025
"""How far the centres of pressure of both feet must lie to one side; on real walks they lie 13 to
22 mm beside the line from heel to toe, to either side."""
LOADED_SHARE = 0.5  # Of body weight: a foot that carries as much lies flat
EARLY, LATE = (0.10, 0.40), (0.55, 0.95)
"""Of a step; impact and lifting off, whose centres of pressure are uncertain, are left out."""
MEAN, PERSON, LEG = 3.5e-3, 1.0e-3, 1.8e-3
"""Of body weight times height. Straight walks of eight recorded people, four of them children: 1.9
to 4.4 a person, 3.5 with SD 0.8; 1.3 to 6.1 a step. Turns: -1.5 to 12.8 a step, 1.9 to 6.8 in the
mean of both legs. Simulated: 0.6 and 2.1 on two people of OpenSim's, 7 to 9 where the body is made
to walk without a residual."""
# From which a wrong sign is told: one laboratory in 100 has one, and ten such warnings to a false
# one
ODDS = 1000.0
CARRIED = (0.9, 1.5)
"""Of body weight: the largest vertical force of a foot that carries the body alone, and does not
run.
"""
MASS_DIFFERENCE = 0.05
"""Of the mass, from which it is told; over strides, beside what the velocities may be wrong by; and
beside the unknown offsets of plates that are never empty."""
STANCE_SHARE = (
    0.55,
    1.25,
)  # Mean vertical force over a stance phase of walking, in body weights: about 0.8
PEAK = 3.0
SHORTEST_S = 0.5  # About a step: over less, the pelvis is no measure of the mass centre
PELVIS_M_S = 0.4
"""By which the change of the pelvis' velocity may differ from that of the mass centre: 8 % of the
mass over 0.5 s, as `pig_c3d` differs over its single step, 2 % over two strides."""
VELOCITY_S = 0.1  # Stretch over which the velocity at either end is fitted

_ALARMING = re.compile(rf"left out|never empty|outside its corners|no numbers|{CONTRADICTED}")


def told_on_reading(trial: TrialEvidence) -> Iterator[Finding]:
    """What the reader noted on plates: type, sign, corners, offset, samples without numbers."""
    for note in trial.recording.notes:
        if not re.match(r"Plate |\d+ force plate", note) or "holds the columns" in note:
            continue
        found = note.rstrip(".")
        standing = "never empty" in note and not trial.is_gait  # who squats steps off no plate
        if standing or not (_ALARMING.search(note) and trial.is_whole_body):
            yield trial.info("plates", found, code=Code.PLATE_DESCRIPTION)
            continue
        cure = (
            "check FORCE_PLATFORM in the file; forces of this plate are not to be trusted without"
        )
        if "never empty" in note:
            cure = (
                "record some seconds with nobody on the plate, or remove its offset before export"
            )
        cause = "a force plate is not described as it should be"
        yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_DESCRIPTION)


def signals(trial: TrialEvidence) -> Iterator[Finding]:
    """Sign, offset, saturation and direction of every plate's force."""
    for plate in trial.recording.plates:
        force = plate.force[np.isfinite(plate.force).all(axis=1)]
        if not len(force):
            continue
        up, name = force[:, 1], f"plate {plate.name}"
        if (pulled := int((up < -BODY_N).sum())) > 0:
            found = (
                f"{name}: pulls the body down with up to {-up.min():.0f} N in {pulled} samples; it "
                "can only push"
            )
            cure = "check the sign and the offset of its channels"
            yield trial.warning("plates", found, cure, cause=f"{name} pulls", code=Code.PLATE_PULLS)
        empty = np.abs(up) < UNLOADED_N
        empty &= np.abs(up - np.median(up[empty])) < QUIET_N if empty.any() else False
        if empty.mean() > 0.1 and abs(rest := float(np.median(up[empty]))) > OFFSET_N:
            found = f"{name}: reads {rest:.0f} N where nobody stands on it"
            cause, cure = (
                f"{name} is not at zero when empty",
                "remove the offset of the empty plate",
            )
            yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_OFFSET)
        yield from _clipped(trial, plate)
        loaded = up > BODY_N
        yield from _dead(trial, plate, force[loaded])
        if loaded.sum() > 10:
            ratio = float(np.median(np.hypot(force[loaded, 0], force[loaded, 2]) / up[loaded]))
            if ratio > ASLANT:
                found = f"{name}: its horizontal force is {ratio:.2f} times the vertical one"
                cause, cure = (
                    f"the axes of {name} are not those of the room",
                    "are its axes those of the file, y up?",
                )
                yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_AXES)


def _dead(trial: TrialEvidence, plate: ForcePlate, loaded: Array) -> Iterator[Finding]:
    """Horizontal components that never change while somebody walks on the plate, `loaded` (n, 3) N."""
    if not trial.is_gait or len(loaded) < DEAD_SAMPLES:
        return
    still = {
        name: loaded[0, axis]
        for axis, name in ((0, "Fx"), (2, "Fz"))
        if np.ptp(loaded[:, axis]) <= DEAD_N
    }
    if still:
        missing = " and ".join(still)
        found = f"plate {plate.name}: {missing} stays at {next(iter(still.values())):.0f} N in all "
        found += (
            f"{len(loaded)} samples under load; walking moves it by some 100 N (fore-aft) and 40 N "
            "(sideways)"
        )
        cure = (
            "look for the channel, its cable and its column in the file; without it leave the "
            "plate out of torques"
        )
        cause = f"a horizontal force of plate {plate.name} is missing: {missing} is constant"
        yield trial.warning("plates", found, cure, cause=cause, code=Code.DEAD_CHANNEL)


def _clipped(trial: TrialEvidence, plate: ForcePlate) -> Iterator[Finding]:
    """Components of the force that stay at their largest value."""
    for axis, name in enumerate("xyz"):
        size = np.abs(np.nan_to_num(plate.force[:, axis]))
        top = float(size.max())
        # Smooth data may rest at its peak for a sample or two, never for five.
        held = find_runs(size >= top * (1 - 1e-9), CLIPPED) if top >= CLIPPED_N else []
        if held:
            yield trial.warning(
                "plates",
                f"plate {plate.name}: F{name} stays at {top:.0f} N for "
                f"{sum(s.stop - s.start for s in held)} samples "
                f"({format_spans(plate.time, held)})",
                "choose a larger range of the amplifier; leave these frames out with time = "
                "[start, end]",
                cause=f"plate {plate.name} is saturated",
                code=Code.SATURATED_PLATE,
            )


def corners(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether centres of pressure lie on their plate."""
    for plate in trial.recording.plates:
        share, farthest = (
            (0.0, 0.0)
            if plate.corners is None
            else compute_share_outside(plate, plate.corners, BODY_N)
        )
        if share > MAX_OUTSIDE_SHARE:
            found = (
                f"plate {plate.name}: the centre of pressure of {100 * share:.0f} % of its load "
                "lies over "
            )
            found += f"{1e3 * OUTSIDE_M:.0f} mm outside its corners (up to {1e3 * farthest:.0f} mm)"
            cure = "check FORCE_PLATFORM:CORNERS, ORIGIN and CHANNEL"
            cause = f"the corners of plate {plate.name} do not hold its centre of pressure"
            yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_CORNERS)


def covered(trial: TrialEvidence) -> Iterator[Finding]:
    """How the clocks of markers and forces overlap."""
    time = trial.recording.time
    for plate in trial.recording.plates if trial.is_whole_body else ():
        if min(time[-1], plate.time[-1]) <= max(time[0], plate.time[0]):
            found = f"plate {plate.name}: forces from {plate.time[0]:g} to {plate.time[-1]:g} s, "
            found += f"markers from {time[0]:g} to {time[-1]:g} s"
            yield trial.error(
                "time", found, "give the forces of this very trial", code=Code.OTHER_TIMES
            )
            return


def _long_steps(trial: TrialEvidence) -> tuple[PlateContact, ...]:
    """Steps of a walk that are long enough and under a foot."""
    if trial.pelvis is None:
        return ()
    time = trial.recording.time
    return tuple(
        s
        for s in trial.plate_contacts
        if s.under_foot and measure_duration(time, s.frames) >= STANCE_S
    )


def _directions(trial: TrialEvidence) -> tuple[Array, Array]:
    """(2,) unit vectors in x and z: where the person walks, and to the right, which is behind who
    walks backwards.
    """
    forward = trial.walked / max(float(np.linalg.norm(trial.walked)), 1e-12)
    right = np.array([-forward[1], forward[0]])
    return forward, right if trial.facing is None or forward @ trial.facing > 0 else -right


def drifts(trial: TrialEvidence) -> list[float]:
    """Of every whole step, how far it brakes before it drives along the walk, -1 to 1."""
    (forward, _), time, out = _directions(trial), trial.recording.time, []
    for step in _long_steps(trial):
        if step.is_whole(time):
            along = (
                np.nan_to_num(resample_wrench(step.plate, time))[step.frames][:, [0, 2]] @ forward
            )
            out.append(
                float(along @ np.linspace(-1.0, 1.0, len(along)) / max(np.abs(along).sum(), 1e-9))
            )
    return out


def horizontal(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether legs brake before they drive, and both push inwards: one alone pushes outwards in a
    turn.
    """
    steps, time = _long_steps(trial), trial.recording.time
    if not steps:
        return
    _, right = _directions(trial)
    drift = drifts(trial)
    outward: dict[int, list[float]] = {}
    for step in steps:
        force = np.nan_to_num(resample_wrench(step.plate, time))[step.frames][:, [0, 2]]
        aside = float((force @ right).mean()) * (1 if step.foot == 0 else -1) / trial.subject.weight
        outward.setdefault(step.foot, []).append(aside)
    wrong = {}
    if drift and max(drift) < DRIVING:
        message = (
            f"along the walk they drive first and brake later (drift {np.mean(drift):.2f}, usual "
            "0.4 to 0.6)"
        )
        wrong["fore-aft"] = message
    pushes = [push for of_leg in outward.values() for push in of_leg]
    if len(outward) == 2 and min(pushes) > OUTWARD:
        message = (
            f"sideways both push outwards, {np.mean(pushes):.2f} body weights on average (usual "
            "-0.06 to -0.03)"
        )
        wrong["sideways"] = message
    if wrong:
        cause = f"the {next(iter(wrong))} force of all plates has the wrong sign"
        cure = "turn the sign of that column of the forces"
        if len(wrong) > 1:
            cause = "both horizontal forces of all plates have the wrong sign"
            cure += (
                "; where a note says that a plate was turned round: of the vertical column alone"
            )
        found = f"in {len(steps)} steps: {'; '.join(wrong.values())}"
        yield trial.warning("forces", found, cure, cause=cause, code=Code.FORCE_SIGN)


def beside_feet(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the centres of pressure of both feet lie off their feet to the same side of the room."""
    feet = trial.feet
    if feet is None:
        return
    shifts: tuple[list[float], list[float]] = ([], [])
    for step in _long_steps(trial):
        _, right = _directions(trial)
        flat = feet.visible[step.frames, step.foot] & (
            step.load > LOADED_SHARE * trial.subject.weight
        )
        if flat.sum() < 3:
            continue
        heel, toe = (
            path[step.frames, step.foot][flat][:, [0, 2]] for path in (feet.heel, feet.toe)
        )
        # x and z seen from above: z is to the right of x, so (-z, x) lies across the line, to its
        # right
        line = (toe - heel) / np.linalg.norm(toe - heel, axis=1, keepdims=True)
        across = np.stack([-line[:, 1], line[:, 0]], axis=1)
        away = np.sum((step.point[flat][:, [0, 2]] - heel) * across, axis=1)
        shifts[step.foot].append(float(np.mean(away * np.sign(across @ right))))
    every = np.array([*shifts[0], *shifts[1]])
    if all(shifts) and np.abs(every).min() > BESIDE_M and len(set(np.sign(every))) == 1:
        means = [1e3 * abs(float(np.mean(of_foot))) for of_foot in shifts]
        yield trial.warning(
            TOPIC,
            f"the centres of pressure lie to the {'right' if every[0] > 0 else 'left'} of the line "
            "heel-toe of both "
            f"feet: {means[0]:.0f} mm (right foot) and {means[1]:.0f} mm (left foot)",
            "check the positions of the plates in the room (corners), and the origin of the "
            "markers",
            cause=PLATES_ELSEWHERE,
            code=Code.PLATES_ELSEWHERE,
        )


def free_moment(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether free moments hold the feet against turning, or turn them on."""
    if trial.facing is None or trial.walked @ trial.facing <= 0:  # whoever walks backwards
        return
    of_leg: dict[int, list[float]] = {}
    for step in trial.plate_contacts:
        carried = float(step.load.max()) / trial.subject.weight
        if (
            step.is_whole(trial.recording.time)
            and step.under_foot
            and CARRIED[0] < carried < CARRIED[1]
        ):
            of_leg.setdefault(step.foot, []).append(_held(trial, step))
    if not of_leg:
        return
    mean = float(np.mean([np.mean(found) for found in of_leg.values()]))
    evidence = -2.0 * MEAN * mean / (PERSON**2 + LEG**2 / len(of_leg))
    if evidence < np.log(ODDS) or any(horizontal(trial)):
        # what turns horizontal forces round is told there, and may turn the moment round with them
        return
    yield trial.warning(
        "forces",
        f"in {sum(map(len, of_leg.values()))} whole steps the free moment turns the foot inwards "
        "first and outwards "
        f"later, by {-1e3 * mean:.1f} thousandths of body weight times height; of walking people "
        "it is the other way "
        f"round, by {1e3 * MEAN:.1f}",
        "turn the sign of the moment about the vertical, or look about which point and axis it is "
        "given",
        cause="the free moment of all plates has the wrong sign",
        code=Code.FREE_MOMENT,
    )


def _held(trial: TrialEvidence, step: PlateContact) -> float:
    """The d of one step."""
    wrench = np.nan_to_num(resample_wrench(step.plate, trial.recording.time))[step.frames]
    moment = (wrench[:, 3:] - cross(step.point, wrench[:, :3]))[:, 1]
    t = np.linspace(0.0, 1.0, len(moment))
    early, late = (moment[(t > low) & (t < high)].mean() for low, high in (EARLY, LATE))
    side = 1.0 if step.foot == 0 else -1.0
    return float(side * (late - early) / (trial.subject.weight * trial.subject.height))


def step_loads(trial: TrialEvidence) -> Iterator[Finding]:
    """Body weight against the mean and the largest force of whole steps."""
    if not trial.is_gait:
        return
    weight, parts = trial.subject.weight, _parts(trial)
    for plate in trial.recording.plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in find_runs(up > BODY_N, 2):
            if (
                measure_duration(plate.time, run) < STANCE_S
                or run.start == 0
                or run.stop == len(up)
            ):
                continue  # a knock, or a step that the recording cuts off
            begin, end = plate.time[run.start], plate.time[run.stop - 1]
            if any(plate is own and start < end and begin < stop for own, start, stop in parts):
                continue  # a part of the foot is elsewhere
            share, peak = float(up[run].mean()) / weight, float(up[run].max()) / weight
            if not (STANCE_SHARE[0] <= share <= STANCE_SHARE[1] and peak < PEAK):
                found = (
                    f"plate {plate.name}, {format_spans(plate.time, [run])}: mean {share:.2f} and peak "
                    f"{peak:.2f} body "
                )
                found += (
                    f"weights of {trial.subject.mass:g} kg; a step of walking has about 0.8 and 1.1"
                )
                cure = "check mass_kg, the gain of the plate, and whether the whole foot was on it"
                cause = f"steps on plate {plate.name} do not carry the body"
                yield trial.warning("body mass", found, cure, cause=cause, code=Code.STEP_LOAD)


def _parts(trial: TrialEvidence) -> list[tuple[ForcePlate, float, float]]:
    """Loadings, plate and s from when to when, of feet on two plates at once, or partly beside
    theirs.
    """
    found, time = trial.plate_contacts, trial.recording.time
    parts = [step for step in found if step.under_foot and any(overhang(trial, step))]
    for one, other in permutations(found, 2):
        same = one.foot == other.foot and one.plate is not other.plate
        if same and one.frames.start < other.frames.stop and other.frames.start < one.frames.stop:
            parts.append(one)
    return [(s.plate, float(time[s.frames.start]), float(time[s.frames.stop - 1])) for s in parts]


def body_mass(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Body mass against all that plates carry: told as wrong where a trial says so that no other
    one contradicts: all weigh nearer to what it weighs than to the mass, as a trial that weighs
    roughly says little for the mass.
    """
    weighings = [(t, *found) for t in trials if (found := _standing(t) or _walking(t)) is not None]
    off = [(carried / t.subject.mass - 1.0, allowed) for t, carried, allowed, _, _ in weighings]
    wrong = any(
        min(other / share for other, _ in off) > 0.5
        for share, allowed in off
        if abs(share) > allowed
    )
    for (t, _, _, message, cure), (share, allowed) in zip(weighings, off, strict=True):
        message += f"; subject.mass_kg is {t.subject.mass:g}"
        if wrong:
            cause = "mass_kg is not what the plates weigh"
            yield t.warning("body mass", message, cure, cause=cause, code=Code.BODY_MASS)
        else:
            others = listed([f"{c:.1f} kg in {o.name}" for o, c, *_ in weighings if o is not t])
            message += (
                f": too far off, but not in all trials ({others})" if abs(share) > allowed else ""
            )
            yield t.info("body mass", message, code=Code.BODY_MASS)


def _standing(trial: TrialEvidence) -> tuple[float, float, str, str] | None:
    """Kg under the standing person, by which share that may be off, in words, and the cure; None
    where not all is on plates.
    """
    if not trial.is_static or trial.model is None:
        return None
    window = find_still_window(trial.recording, trial.marker_set.labels)
    total, loaded = 0.0, list[ForcePlate]()
    for plate in trial.recording.plates:
        within = (
            (plate.time >= window.start)
            & (plate.time <= window.stop)
            & np.isfinite(plate.force[:, 1])
        )
        force = float(np.median(plate.force[within, 1])) if within.any() else 0.0
        total, loaded = total + force, [*loaded, *([plate] if force > BODY_N else [])]
    if total < 0.5 * trial.subject.weight:
        return None  # a foot stood beside the plates
    message = f"the plates carry {total:.0f} N = {total / GRAVITY:.1f} kg while standing"
    cure = "correct mass_kg, if both feet stood on plates: torques and inertia follow from it"
    return total / GRAVITY, MASS_DIFFERENCE + _offsets(loaded) / trial.subject.weight, message, cure


def _walking(trial: TrialEvidence) -> tuple[float, float, str, str] | None:
    """The same while every foot of a walking person is on a plate; None where that is for less than
    a step.
    """
    feet = trial.feet if trial.is_gait else None
    if feet is None or trial.pelvis is None:
        return None
    runs_on = [
        run
        for run in find_runs(_all_on_plates(trial, feet), 3)
        if measure_duration(feet.time, run) >= SHORTEST_S
    ]
    weighings = [
        (run, measure_duration(feet.time, run), kg)
        for run in runs_on
        if (kg := _mass(trial, run)) is not None
    ]
    if not weighings:
        return None
    stretches, lengths, masses = zip(*weighings, strict=True)
    carried = float(np.average(masses, weights=lengths))
    message = (
        f"while every foot is on a plate ({format_spans(feet.time, stretches)}) the plates carry "
        f"{carried:.1f} kg on average"
    )
    cure = (
        "correct mass_kg, or the gain and offset of the plates: joint torques are wrong by the "
        "same share"
    )
    allowed = MASS_DIFFERENCE + PELVIS_M_S / (GRAVITY * float(np.sum(lengths)))
    allowed += _offsets(trial.recording.plates) / trial.subject.weight
    return carried, allowed, message, cure


def _offsets(plates: Sequence[ForcePlate]) -> float:
    """N, by which the readings of all plates that were never empty may be off together."""
    unknown = [
        p
        for p in plates
        if not find_empty_samples(p.force[:, 1], (len(p.time) - 1) / float(np.ptp(p.time))).any()
    ]
    return UNKNOWN_OFFSET_N * float(np.sqrt(len(unknown)))


def _all_on_plates(trial: TrialEvidence, feet: Feet) -> BoolArray:
    """(nf,) where some foot is loaded and no foot stands beside a plate or partly so."""
    loaded = np.zeros((len(feet.time), 2), dtype=bool)
    doubtful = np.zeros(len(feet.time), dtype=bool)
    for step in trial.plate_contacts:
        if step.under_foot:
            loaded[step.frames, step.foot] = True
        if not step.under_foot or any(overhang(trial, step)):
            doubtful[step.frames] = True
    doubtful = mark_near(
        doubtful, feet.time
    )  # beside a plate a foot may bear before and after that plate is loaded
    for foot in range(2):
        beside = feet.resting[:, foot] & ~mark_near(loaded[:, foot], feet.time)
        doubtful |= mark_near(beside, feet.time) | ~feet.visible[:, foot]
    out: BoolArray = loaded.any(axis=1) & ~doubtful
    return out


def _mass(trial: TrialEvidence, run: slice) -> float | None:
    """Mass (kg) that the plates carry in the frames `run`; None where the pelvis is not seen at
    both ends.
    """
    time, pelvis, velocity = trial.recording.time, trial.pelvis, []
    for moment in (float(time[run.start]), float(time[run.stop - 1])):
        if pelvis is None:
            return None
        close = (np.abs(time - moment) <= 0.5 * VELOCITY_S + 1e-9) & pelvis.determined
        if close.sum() < 3:
            return None
        velocity.append(float(np.polyfit(time[close] - moment, pelvis.origin[close, 1], 1)[0]))
    force = sum(
        np.nan_to_num(resample_wrench(plate, time))[run, 1] for plate in trial.recording.plates
    )
    length = measure_duration(time, run)
    mean = float(np.trapezoid(force, time[run])) / length
    return mean / (GRAVITY + (velocity[1] - velocity[0]) / length)
