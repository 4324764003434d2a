"""Check force plates: reader notes, sign, offset, saturation, corners, and forces of every walk.

A leg brakes after touch-down and drives before lift-off, and both legs push the body medially. If
whole steps show the opposite, a column of forces has the wrong sign. If the centres of pressure of
both feet are off the feet to the same side of the room, the plates are displaced.

The free moment T about the vertical through the centre of pressure holds the foot against internal
rotation in the first half of stance and external rotation in the second (Almosnino et al., BMC
Sports Sci Med Rehabil 1:19, 2009: 11 people, feet turned in, straight and out). With T along the
upward vertical, s = 1 on the right foot and -1 on the left, t from 0 to 1 over a step and W H body
weight times height, each whole step gives

    d = s (mean of T over LATE - mean of T over EARLY) / (W H)

which is positive. Its mean x over the steps of each leg, and then over the legs with steps, is
N(USUAL_MEAN, v) with v = PERSON_SD^2 + LEG_SD^2 / legs, and N(-USUAL_MEAN, v) if the sign is wrong.
The evidence for a wrong sign is -2 USUAL_MEAN x / v nats.

Mass: while every foot on the ground is on a plate, from ta to tb, the vertical force changes the
momentum of the body: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The velocity of the pelvis
replaces that of the mass centre; its error matters less over longer intervals.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.dynamics.foot_contact import mark_near
from gaitcal.dynamics.plate_outline import MAX_OUTSIDE_SHARE, compute_share_outside
from gaitcal.errors import Code, Finding, join_names
from gaitcal.io.c3d.plates import DECLARED_UNIT_TEXT
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
from gaitcal.quality.foot_on_plate import PLATES_ELSEWHERE, TOPIC, check_overhang

OFFSET_N = 15.0  # Reading of an empty plate from which it is reported
UNKNOWN_OFFSET_N = 20.0  # Reading of empty plates that were not zeroed, in real files
CLIPPED = 5  # Consecutive samples at the same largest value: an amplifier at its limit
CLIPPED_N = 200.0  # Least force that counts as saturated
# A horizontal force that changes by less over so many loaded samples is not measured: noise alone
# changes more
DEAD_N = 0.5
DEAD_SAMPLES = 20
# Median ratio of horizontal to vertical force under load from which axes are doubted; walking has
# 0.1 to 0.2
MAX_HORIZONTAL_RATIO = 0.5
DRIVING = -0.1
"""Drift of the force along the walk from braking to driving, sum(F t) / sum(|F|) with t from -1 to
1 over the step: 0.36 to 0.63 in whole steps of real and synthetic walks; below this it is reversed.
"""
OUTWARD = 0.01
"""Mean sideways force, in body weights, above which legs push outwards: real and synthetic ones
push inwards, 0.03 to 0.06."""
BESIDE_M = 0.025
"""Least distance of the centres of pressure of both feet to one side; on real walks they are 13 to
22 mm beside the line from heel to toe, on either side."""
LOADED_SHARE = 0.5  # Of body weight: a foot that carries as much is flat
# Parts of a step; impact and lift-off, whose centres of pressure are uncertain, are left out
EARLY = (0.10, 0.40)
LATE = (0.55, 0.95)
USUAL_MEAN = 3.5e-3  # Usual d, of body weight times height
PERSON_SD = 1.0e-3  # Its standard deviation between people
LEG_SD = 1.8e-3
"""Its standard deviation between legs of a person. Straight walks of eight recorded people, four
of them children: 1.9 to 4.4 thousandths a person, 3.5 with SD 0.8; 1.3 to 6.1 a step. Turns: -1.5
to 12.8 a step, 1.9 to 6.8 in the mean of both legs. Simulated: 0.6 and 2.1 on two people of
OpenSim's, 7 to 9 where the body is made to walk without a residual."""
# Odds from which a wrong sign is reported: one laboratory in 100 has one, and at most one warning
# in ten is to be false
WRONG_SIGN_ODDS = 1000.0
CARRIED = (0.9, 1.5)
"""Largest vertical force, in body weights, of a foot that carries the body alone in walking."""
MASS_DIFFERENCE = 0.05
"""Difference from the given mass, as a share, from which it is reported; errors of the velocities,
and of the unknown offsets of plates that are never empty, are added."""
# Mean vertical force over a stance phase of walking, in body weights: about 0.8
STANCE_SHARE = (0.55, 1.25)
PEAK = 3.0  # Largest vertical force of a step, body weights
SHORTEST_S = 0.5  # About a step: over less, the pelvis does not represent the mass centre
PELVIS_M_S = 0.4
"""Error of the change of the pelvis' velocity, relative to the mass centre: 8 % of the mass over
0.5 s, as `pig_c3d` differs over its single step, 2 % over two strides."""
VELOCITY_S = 0.1  # Time over which the velocity at either end is fitted

_ALARMING = re.compile(rf"left out|never empty|outside its corners|no numbers|{DECLARED_UNIT_TEXT}")


def report_reader_notes(trial: TrialEvidence) -> Iterator[Finding]:
    """Report the reader's notes on plates: type, sign, corners, offset, samples without numbers.

    Yields a warning if forces may be wrong; otherwise notes.
    """
    for note in trial.recording.notes:
        if not re.match(r"Plate |\d+ force plate", note) or "holds the columns" in note:
            continue
        found = note.rstrip(".")
        # in a squat, the person never steps off the plate
        standing = "never empty" in note and not trial.is_gait
        if standing or not (_ALARMING.search(note) and trial.is_whole_body):
            yield trial.info("plates", found, code=Code.PLATE_DESCRIPTION)
            continue
        cure = "check FORCE_PLATFORM in the file: forces of this plate may be wrong"
        if "never empty" in note:
            cure = "record some seconds with the plate empty, or remove its offset before export"
        cause = "the description of a force plate is incomplete or contradictory"
        yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_DESCRIPTION)


def check_signals(trial: TrialEvidence) -> Iterator[Finding]:
    """Check sign, offset, saturation, constant channels and direction of every plate's force.

    Yields warnings, plate by plate.
    """
    for plate in trial.recording.plates:
        force = plate.force[np.isfinite(plate.force).all(axis=1)]
        if not len(force):
            continue
        up, name = force[:, 1], f"plate {plate.name}"
        pulled = int((up < -BODY_N).sum())
        if pulled > 0:
            found = (
                f"{name}: downward force on the body of up to {-up.min():.0f} N in {pulled} "
                "samples; a plate can only push upward"
            )
            cure = "check the sign and the offset of its channels"
            cause = f"the vertical force of {name} points down"
            yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_PULLS)
        # samples near the median of low readings, without the rise and fall of steps
        empty = np.abs(up) < UNLOADED_N
        empty &= np.abs(up - np.median(up[empty])) < QUIET_N if empty.any() else False
        offset = float(np.median(up[empty])) if empty.mean() > 0.1 else 0.0
        if abs(offset) > OFFSET_N:
            found = f"{name}: reads {offset:.0f} N while it is empty"
            cause = f"{name} does not read zero when it is empty"
            cure = "subtract the reading of the empty plate"
            yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_OFFSET)
        yield from _check_saturation(trial, plate)
        loaded = up > BODY_N
        yield from _check_constant_channels(trial, plate, force[loaded])
        if loaded.sum() > 10:
            ratio = float(np.median(np.hypot(force[loaded, 0], force[loaded, 2]) / up[loaded]))
            if ratio > MAX_HORIZONTAL_RATIO:
                found = f"{name}: its horizontal force is {ratio:.2f} times the vertical one"
                cause = f"the axes of {name} are not those of the room"
                cure = "check that its axes are those of the file, y up"
                yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_AXES)


def _check_constant_channels(
    trial: TrialEvidence, plate: ForcePlate, loaded: Array
) -> Iterator[Finding]:
    """Report horizontal forces that never change while a person walks on the plate, (n, 3) N."""
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
            f"{len(loaded)} samples under load; in walking it varies by some 100 N (fore-aft) and "
            "40 N (sideways)"
        )
        cure = (
            "check the channel, its cable and its column in the file; if it is lost, leave the "
            "plate out of torques"
        )
        cause = f"a horizontal force of plate {plate.name} is missing: {missing} is constant"
        yield trial.warning("plates", found, cure, cause=cause, code=Code.DEAD_CHANNEL)


def _check_saturation(trial: TrialEvidence, plate: ForcePlate) -> Iterator[Finding]:
    """Report components of the force that stay at their largest value."""
    for axis, name in enumerate("xyz"):
        size = np.abs(np.nan_to_num(plate.force[:, axis]))
        top = float(size.max())
        # smooth data may stay at their peak for a sample or two, never for five
        held = find_runs(size >= top * (1 - 1e-9), CLIPPED) if top >= CLIPPED_N else []
        if held:
            yield trial.warning(
                "plates",
                f"plate {plate.name}: F{name} stays at {top:.0f} N for "
                f"{sum(s.stop - s.start for s in held)} samples "
                f"({format_spans(plate.time, held)})",
                "use a larger range of the amplifier; leave these frames out with time = "
                "[start, end]",
                cause=f"plate {plate.name} is saturated",
                code=Code.SATURATED_PLATE,
            )


def check_corners(trial: TrialEvidence) -> Iterator[Finding]:
    """Report plates with centres of pressure outside their corners.

    Yields: at most one warning a plate.
    """
    for plate in trial.recording.plates:
        share, farthest = (
            (0.0, 0.0)
            if plate.corners is None
            else compute_share_outside(plate, plate.corners, BODY_N)
        )
        if share > MAX_OUTSIDE_SHARE:
            found = (
                f"plate {plate.name}: the centre of pressure of {100 * share:.0f} % of its load is "
                f"more than {1e3 * OUTSIDE_M:.0f} mm outside its corners (up to "
                f"{1e3 * farthest:.0f} mm)"
            )
            cure = "check FORCE_PLATFORM:CORNERS, ORIGIN and CHANNEL"
            cause = f"the centre of pressure of plate {plate.name} is outside its corners"
            yield trial.warning("plates", found, cure, cause=cause, code=Code.PLATE_CORNERS)


def check_time_overlap(trial: TrialEvidence) -> Iterator[Finding]:
    """Report plates whose times do not overlap with those of the markers.

    `trial`: a whole-body trial; others are not checked. Yields one error, or nothing.
    """
    time = trial.recording.time
    for plate in trial.recording.plates if trial.is_whole_body else ():
        if min(time[-1], plate.time[-1]) <= max(time[0], plate.time[0]):
            found = f"plate {plate.name}: forces from {plate.time[0]:g} to {plate.time[-1]:g} s, "
            found += f"markers from {time[0]:g} to {time[-1]:g} s"
            yield trial.error("time", found, "use the forces of this trial", code=Code.OTHER_TIMES)
            return


def _select_long_steps(trial: TrialEvidence) -> tuple[PlateContact, ...]:
    """Select steps of a walk that are long enough and under a foot."""
    if trial.pelvis is None:
        return ()
    time = trial.recording.time
    return tuple(
        s
        for s in trial.plate_contacts
        if s.under_foot and measure_duration(time, s.frames) >= STANCE_S
    )


def _compute_directions(trial: TrialEvidence) -> tuple[Array, Array]:
    """Compute unit vectors (2,) in x and z: walking direction, and the person's right.

    The right is that of the body, also in backward walking.
    """
    forward = trial.walked / max(float(np.linalg.norm(trial.walked)), 1e-12)
    right = np.array([-forward[1], forward[0]])
    return forward, right if trial.facing is None or forward @ trial.facing > 0 else -right


def compute_drifts(trial: TrialEvidence) -> list[float]:
    """Compute how far each whole step changes from braking to driving.

    Parameters
    ----------
    trial
        A gait trial.

    Returns
    -------
    list of float
        sum(F t) / sum(|F|) of the force F along the walk, t from -1 to 1 over the step.
    """
    (forward, _), time, out = _compute_directions(trial), trial.recording.time, []
    for step in _select_long_steps(trial):
        if step.is_whole(time):
            along = (
                np.nan_to_num(resample_wrench(step.plate, time))[step.frames][:, [0, 2]] @ forward
            )
            out.append(
                float(along @ np.linspace(-1.0, 1.0, len(along)) / max(np.abs(along).sum(), 1e-9))
            )
    return out


def check_horizontal_signs(trial: TrialEvidence) -> Iterator[Finding]:
    """Report horizontal forces of the wrong sign.

    Signs are driving before braking, and both legs pushing outward. In a turn one leg alone pushes
    outward.

    Yields one warning, or nothing.
    """
    steps, time = _select_long_steps(trial), trial.recording.time
    if not steps:
        return
    _, right = _compute_directions(trial)
    drift = compute_drifts(trial)
    outward: dict[int, list[float]] = {}
    for step in steps:
        force = np.nan_to_num(resample_wrench(step.plate, time))[step.frames][:, [0, 2]]
        # positive: outward, in body weights
        aside = float((force @ right).mean()) * (1 if step.foot == 0 else -1) / trial.subject.weight
        outward.setdefault(step.foot, []).append(aside)
    wrong = {}
    if drift and max(drift) < DRIVING:
        message = (
            f"the fore-aft force drives before it brakes (drift {np.mean(drift):.2f}, usual: 0.4 "
            "to 0.6)"
        )
        wrong["fore-aft"] = message
    pushes = [push for of_leg in outward.values() for push in of_leg]
    if len(outward) == 2 and min(pushes) > OUTWARD:
        message = (
            f"the sideways force of both legs points outward, {np.mean(pushes):.2f} body weights "
            "on average (usual: -0.06 to -0.03)"
        )
        wrong["sideways"] = message
    if wrong:
        cause = f"the {next(iter(wrong))} force of all plates has the wrong sign"
        cure = "change the sign of that column of the forces"
        if len(wrong) > 1:
            cause = "both horizontal forces of all plates have the wrong sign"
            cure += "; if a note reports that a plate was reversed: of the vertical column alone"
        found = f"in {len(steps)} steps: {'; '.join(wrong.values())}"
        yield trial.warning("forces", found, cure, cause=cause, code=Code.FORCE_SIGN)


def check_pressure_beside_feet(trial: TrialEvidence) -> Iterator[Finding]:
    """Report centres of pressure of both feet that are off the feet to the same side of the room.

    Yields one warning, or nothing.
    """
    feet = trial.feet
    if feet is None:
        return
    shifts: tuple[list[float], list[float]] = ([], [])
    for step in _select_long_steps(trial):
        _, right = _compute_directions(trial)
        flat = feet.visible[step.frames, step.foot] & (
            step.load > LOADED_SHARE * trial.subject.weight
        )
        if flat.sum() < 3:
            continue
        heel, toe = (
            path[step.frames, step.foot][flat][:, [0, 2]] for path in (feet.heel, feet.toe)
        )
        # viewed from above, z is to the right of x, so (-z, x) is across the line, to its right
        line = (toe - heel) / np.linalg.norm(toe - heel, axis=1, keepdims=True)
        across = np.stack([-line[:, 1], line[:, 0]], axis=1)
        away = np.sum((step.point[flat][:, [0, 2]] - heel) * across, axis=1)
        shifts[step.foot].append(float(np.mean(away * np.sign(across @ right))))
    every = np.array([*shifts[0], *shifts[1]])
    if all(shifts) and np.abs(every).min() > BESIDE_M and len(set(np.sign(every))) == 1:
        means = [1e3 * abs(float(np.mean(of_foot))) for of_foot in shifts]
        yield trial.warning(
            TOPIC,
            f"the centres of pressure are to the {'right' if every[0] > 0 else 'left'} of the line "
            f"heel-toe of both feet: {means[0]:.0f} mm (right foot) and {means[1]:.0f} mm (left "
            "foot)",
            "check the corners of the plates and the origin of the markers",
            cause=PLATES_ELSEWHERE,
            code=Code.PLATES_ELSEWHERE,
        )


def check_free_moment_sign(trial: TrialEvidence) -> Iterator[Finding]:
    """Report a free moment of the wrong sign, by the sequence of internal and external rotation.

    Yields one warning, or nothing.
    """
    if trial.facing is None or trial.walked @ trial.facing <= 0:  # backward walking
        return
    of_leg: dict[int, list[float]] = {}
    for step in trial.plate_contacts:
        carried = float(step.load.max()) / trial.subject.weight
        if (
            step.is_whole(trial.recording.time)
            and step.under_foot
            and CARRIED[0] < carried < CARRIED[1]
        ):
            of_leg.setdefault(step.foot, []).append(_measure_free_moment(trial, step))
    if not of_leg:
        return
    # the mean of each leg counts alike, however many steps it has
    mean = float(np.mean([np.mean(found) for found in of_leg.values()]))
    evidence = -2.0 * USUAL_MEAN * mean / (PERSON_SD**2 + LEG_SD**2 / len(of_leg))
    if evidence < np.log(WRONG_SIGN_ODDS) or any(check_horizontal_signs(trial)):
        # a reversal of horizontal forces is reported there, and may reverse the moment as well
        return
    yield trial.warning(
        "forces",
        f"in {sum(map(len, of_leg.values()))} whole steps the free moment rotates the foot first "
        f"inward and then outward, by {-1e3 * mean:.1f} thousandths of body weight times height; "
        f"usual: first outward and then inward, by {1e3 * USUAL_MEAN:.1f}",
        "change the sign of the moment about the vertical, or check its reference point and axis",
        cause="the free moment of all plates has the wrong sign",
        code=Code.FREE_MOMENT,
    )


def _measure_free_moment(trial: TrialEvidence, step: PlateContact) -> float:
    """Measure the change d of the free moment over one step, positive as in walking people."""
    wrench = np.nan_to_num(resample_wrench(step.plate, trial.recording.time))[step.frames]
    moment = (wrench[:, 3:] - cross(step.point, wrench[:, :3]))[:, 1]
    t = np.linspace(0.0, 1.0, len(moment))
    early, late = (moment[(t > low) & (t < high)].mean() for low, high in (EARLY, LATE))
    side = 1.0 if step.foot == 0 else -1.0
    return float(side * (late - early) / (trial.subject.weight * trial.subject.height))


def check_step_loads(trial: TrialEvidence) -> Iterator[Finding]:
    """Compare the mean and the largest vertical force of whole steps with body weight.

    Yields one warning for each step out of range.
    """
    if not trial.is_gait:
        return
    weight, parts = trial.subject.weight, _list_partial_loadings(trial)
    for plate in trial.recording.plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in find_runs(up > BODY_N, 2):
            if (
                measure_duration(plate.time, run) < STANCE_S
                or run.start == 0
                or run.stop == len(up)
            ):
                continue  # a knock, or a step cut off by the recording
            begin, end = plate.time[run.start], plate.time[run.stop - 1]
            partial = (p is plate and start < end and begin < stop for p, start, stop in parts)
            if any(partial):
                continue  # a part of the foot is beside this plate
            share, peak = float(up[run].mean()) / weight, float(up[run].max()) / weight
            if not (STANCE_SHARE[0] <= share <= STANCE_SHARE[1] and peak < PEAK):
                found = (
                    f"plate {plate.name}, {format_spans(plate.time, [run])}: mean {share:.2f} and "
                    f"peak {peak:.2f} body weights of {trial.subject.mass:g} kg; usual in walking: "
                    "0.8 and 1.1"
                )
                cure = "check mass_kg, the gain of the plate, and whether the whole foot was on it"
                cause = f"forces of steps on plate {plate.name} do not match body weight"
                yield trial.warning("body mass", found, cure, cause=cause, code=Code.STEP_LOAD)


def _list_partial_loadings(trial: TrialEvidence) -> list[tuple[ForcePlate, float, float]]:
    """List plate, start and end (s) of loadings by a foot partly beside or on a second plate."""
    found, time = trial.plate_contacts, trial.recording.time
    parts = [step for step in found if step.under_foot and any(check_overhang(trial, step))]
    for one, other in permutations(found, 2):
        same = one.foot == other.foot and one.plate is not other.plate
        if same and one.frames.start < other.frames.stop and other.frames.start < one.frames.stop:
            parts.append(one)
    return [(s.plate, float(time[s.frames.start]), float(time[s.frames.stop - 1])) for s in parts]


def check_body_mass(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Compare the given body mass with the force on all plates.

    It is wrong if one trial differs by more than its error and no other contradicts it: all others
    are nearer to that trial's mass than to the given one, as a trial with a large error hardly
    supports the given mass.

    Parameters
    ----------
    trials
        All trials of the study, or one.

    Yields
    ------
    Finding
        A warning or a note for each trial with a measured mass.
    """
    measured = [(t, _weigh_standing(t) or _weigh_walking(t)) for t in trials]
    weighings = [(t, *found) for t, found in measured if found is not None]
    off = [(carried / t.subject.mass - 1.0, allowed) for t, carried, allowed, _, _ in weighings]
    # the given mass is wrong if a trial is far off and all others are nearer to that trial
    wrong = False
    for share, allowed in off:
        if abs(share) > allowed:
            wrong |= min(other / share for other, _ in off) > 0.5
    for (t, _, _, message, cure), (share, allowed) in zip(weighings, off, strict=True):
        message += f"; subject.mass_kg is {t.subject.mass:g}"
        if wrong:
            cause = "mass_kg differs from the mass measured by the plates"
            yield t.warning("body mass", message, cure, cause=cause, code=Code.BODY_MASS)
        else:
            others = join_names([f"{c:.1f} kg in {o.name}" for o, c, *_ in weighings if o is not t])
            message += (
                f": too different, but not in all trials ({others})" if abs(share) > allowed else ""
            )
            yield t.info("body mass", message, code=Code.BODY_MASS)


def _weigh_standing(trial: TrialEvidence) -> tuple[float, float, str, str] | None:
    """Weigh a standing person: kg, its relative error, description and remedy.

    Returns None if a foot is beside the plates.
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
        return None  # a foot is beside the plates
    message = f"the plates carry {total:.0f} N = {total / GRAVITY:.1f} kg while standing"
    cure = "correct mass_kg, if both feet stood on plates: torques and inertia follow from it"
    return (
        total / GRAVITY,
        MASS_DIFFERENCE + _estimate_offsets(loaded) / trial.subject.weight,
        message,
        cure,
    )


def _weigh_walking(trial: TrialEvidence) -> tuple[float, float, str, str] | None:
    """Weigh a walking person: kg, relative error, description and remedy.

    Returns None if every foot is on a plate for less than a step.
    """
    feet = trial.feet if trial.is_gait else None
    if feet is None or trial.pelvis is None:
        return None
    runs_on = [
        run
        for run in find_runs(_mark_fully_on_plates(trial, feet), 3)
        if measure_duration(feet.time, run) >= SHORTEST_S
    ]
    runs, masses = [], []
    for run in runs_on:
        mass = _estimate_mass(trial, run)
        if mass is not None:
            runs.append(run)
            masses.append(mass)
    if not runs:
        return None
    lengths = [measure_duration(feet.time, run) for run in runs]
    carried = float(np.average(masses, weights=lengths))
    message = (
        f"while every foot is on a plate ({format_spans(feet.time, runs)}) the plates carry "
        f"{carried:.1f} kg on average"
    )
    cure = (
        "correct mass_kg, or the gain and offset of the plates: joint torques are wrong by the "
        "same factor"
    )
    allowed = MASS_DIFFERENCE + PELVIS_M_S / (GRAVITY * float(np.sum(lengths)))
    allowed += _estimate_offsets(trial.recording.plates) / trial.subject.weight
    return carried, allowed, message, cure


def _estimate_offsets(plates: Sequence[ForcePlate]) -> float:
    """Estimate the joint offset (N) of all plates that were never empty."""
    unknown = [
        p
        for p in plates
        if not find_empty_samples(p.force[:, 1], (len(p.time) - 1) / float(np.ptp(p.time))).any()
    ]
    return UNKNOWN_OFFSET_N * float(np.sqrt(len(unknown)))


def _mark_fully_on_plates(trial: TrialEvidence, feet: Feet) -> BoolArray:
    """Mark frames (nf,) in which a foot is loaded and no foot is beside a plate or partly so."""
    loaded = np.zeros((len(feet.time), 2), dtype=bool)
    doubtful = np.zeros(len(feet.time), dtype=bool)
    for step in trial.plate_contacts:
        if step.under_foot:
            loaded[step.frames, step.foot] = True
        if not step.under_foot or any(check_overhang(trial, step)):
            doubtful[step.frames] = True
    # a foot beside a plate may carry load before and after that plate is loaded
    doubtful = mark_near(doubtful, feet.time)
    for foot in range(2):
        beside = feet.resting[:, foot] & ~mark_near(loaded[:, foot], feet.time)
        doubtful |= mark_near(beside, feet.time) | ~feet.visible[:, foot]
    out: BoolArray = loaded.any(axis=1) & ~doubtful
    return out


def _estimate_mass(trial: TrialEvidence, run: slice) -> float | None:
    """Estimate the mass (kg) on the plates in frames `run`; None without a pelvis at both ends."""
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
    # mean force = m (g + change of velocity / duration)
    mean = float(np.trapezoid(force, time[run])) / length
    return mean / (GRAVITY + (velocity[1] - velocity[0]) / length)
