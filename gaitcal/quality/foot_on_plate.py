"""Feet on plates: which foot, whether wholly on it, under the centre of pressure, and loaded when
it touches down.

Which frames a centre of pressure is outside of its foot is told by `dynamics/off_sole.py`, as for
the tracked motion, whose torques do not count there. A fault that puts soles, plates or clocks in
disorder is told by its own check, and what it does here is not told again (`_explained`).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact
from gaitcal.dynamics.measurement_errors import has_known_outline
from gaitcal.dynamics.off_sole import (
    MAX_BESIDE_SHARE,
    PressurePosition,
    describe_divided_force,
    detect_common_centre,
    find_divided_frames,
    locate_pressures,
)
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import BODY_N, find_covered_frames
from gaitcal.io.recording import find_runs, format_spans, measure_duration
from gaitcal.model.linkage import SIDES
from gaitcal.preprocess.plate_contacts import Feet, PlateContact
from gaitcal.preprocess.trial_evidence import TrialEvidence

TOPIC = "plate to foot"
PLATES_ELSEWHERE = "the plates, or the markers, are not where the file has them"
DISORDERS_PRESSURE = ("units", "axes", "sides", "exchanged", "time", "forces")
"""Topics of warnings and errors about what puts centres of pressure off their feet by itself."""
FEET = ("right", "left")
FLOOR_M = (-0.03, 0.15)  # Height of a resting heel or toe marker above the centre of pressure
LATE_S = 0.08  # Difference between the clocks of markers and forces that is told
TOLD_SHARE, TOLD_S = 0.02, 0.03
"""Share of the impulse of a plate under a foot, and s, that must lie outside to be told: landing
and lifting off are over in 10 to 20 ms (Whittle 1999), and bear less than that share where clocks
differ by a few frames."""
ALIKE = 0.7  # Cosine between directions that are told as one
# Cosine with the line of the foot above which a place is behind or in front of it, and not beside
# it
ENDWAYS = 0.7
# Of the load outside of a foot: that much while it moves is a matter of clocks, not of places
IN_AIR = 0.5


def contacts(trial: TrialEvidence) -> Iterator[Finding]:
    """Everything about feet on plates in a gait trial."""
    feet, plates = trial.feet, trial.recording.plates
    if not trial.is_gait or not plates:
        return
    most = max(float(np.nan_to_num(plate.force[:, 1]).max()) for plate in plates)
    steps = trial.plate_contacts
    if not steps and (feet is not None or most < BODY_N):
        yield _no_step(trial, feet, most)
    if feet is None:
        return
    for step in steps:
        far = step.distance > foot_contact.UNDER_FOOT_M
        # a total force that was divided, told in `outside_sole`, may be far from both feet
        if not (
            far and any(detect_common_centre(step, other, len(feet.time)).any() for other in steps)
        ):
            yield from _which_foot(trial, step)
    on_feet = [step for step in steps if step.under_foot]
    for step in on_feet:
        yield from _height(trial, feet, step)
    partly = [finding for step in on_feet for finding in overhang(trial, step)]
    # where another step of the trial lies on its plate the plates are where the file has them: a
    # fact of this step
    yield from (
        partly
        if len(partly) == len(on_feet)
        else (replace(f, severity=Severity.INFO) for f in partly)
    )
    yield from _clocks(trial, feet, on_feet)


def _words(trial: TrialEvidence, step: PlateContact) -> str:
    return f"plate {step.plate.name}, {format_spans(trial.recording.time, [step.frames])}"


def _which_foot(trial: TrialEvidence, step: PlateContact) -> Iterator[Finding]:
    """Whether the foot that the study names stands on the plate; if it names none, whether any
    does, and which.
    """
    name, side = _words(trial, step), trial.trial.plates.get(step.plate.name)
    mm, foot = 1e3 * step.distance, FEET[step.foot]
    if side == "none":
        return
    if (
        side is not None
        and step.foot != SIDES.index(side)
        and step.other_distance > foot_contact.UNDER_FOOT_M
        and step.under_foot
    ):
        yield trial.error(
            TOPIC,
            f"{name}: the study gives it to the {FEET[SIDES.index(side)]} foot, "
            f"{1e3 * step.other_distance:.0f} mm off the "
            f"centre of pressure (the {foot} foot: {mm:.0f} mm)",
            f'write plates = {{ {step.plate.name} = "{SIDES[step.foot]}" }}, or leave it out to '
            "have it found",
            code=Code.WRONG_FOOT,
        )
    elif step.distance > foot_contact.UNDER_FOOT_M and np.isinf(step.other_distance):
        found = f"{name}: the centre of pressure is {mm:.0f} mm from the {foot} foot; "
        found += f"the {FEET[1 - step.foot]} foot, whose step it may be, shows no heel and toe then"
        yield trial.info(TOPIC, found, code=Code.UNDER_NO_FOOT)
    elif step.distance > foot_contact.UNDER_FOOT_M:
        yield trial.warning(
            TOPIC,
            f"{name}: the centre of pressure is {mm:.0f} mm from the {foot} and "
            f"{1e3 * step.other_distance:.0f} mm from the other foot; allowed: "
            f"{1e3 * foot_contact.UNDER_FOOT_M:.0f} mm",
            "check the position of the plate (corners), the axes of the forces, and that they "
            "belong to this trial",
            code=Code.UNDER_NO_FOOT,
        )
    else:
        found = (
            f"{name}: {foot} foot, whose line heel-toe passes the centre of pressure at {mm:.0f} mm"
        )
        yield trial.info(TOPIC, found, code=Code.FOOT_OF_PLATE)


def _height(trial: TrialEvidence, feet: Feet, step: PlateContact) -> Iterator[Finding]:
    """Whether the centre of pressure lies at the height of the resting foot's soles."""
    down = feet.resting[step.frames, step.foot]
    if not down.any():
        return
    lowest = np.fmin(feet.heel[step.frames, step.foot, 1], feet.toe[step.frames, step.foot, 1])[
        down
    ]
    above = float(np.nanmedian(lowest)) - float(np.median(step.point[:, 1]))
    if not FLOOR_M[0] <= above <= FLOOR_M[1]:
        yield trial.warning(
            "plates",
            f"plate {step.plate.name}: its surface lies {1e3 * above:.0f} mm below the lower of "
            "heel and toe marker; "
            f"allowed: {1e3 * FLOOR_M[0]:.0f} to {1e3 * FLOOR_M[1]:.0f} mm",
            "check the height of the plate's corners, or the origin of the markers",
            code=Code.PLATE_HEIGHT,
        )


def _no_step(trial: TrialEvidence, feet: Feet | None, most: float) -> Finding:
    """No plate is loaded: a fault where a foot stands on one, or where a foot is never seen or
    outlines are missing; else the walk has missed them. `most`: N.
    """
    found, severity = f"no plate is stepped on: at most {most:.0f} N", Severity.INFO
    outlined = [plate for plate in trial.recording.plates if plate.corners is not None]
    if (
        feet is None
        or not feet.visible.any(axis=0).all()
        or len(outlined) < len(trial.recording.plates)
    ):
        severity = Severity.WARNING
    for foot, name in enumerate(FEET):
        if feet is None or not feet.visible[:, foot].any():
            continue
        sole = foot_contact.build_sole(feet.build_points(trial.subject.height), foot, slice(None))
        on_plate = (
            sole.sum_half_shares(sole.find_cells_off_plates(outlined)).max(axis=1)
            <= MAX_BESIDE_SHARE
        )
        stands = sole.resting.all(axis=1) & on_plate & feet.visible[:, foot]
        if long := [
            run
            for run in find_runs(stands, 2)
            if measure_duration(feet.time, run) > foot_contact.MIN_LOADING_S
        ]:
            found += f", though the {name} foot stands on them ({format_spans(feet.time, long)})"
            severity = Severity.WARNING
    cure = (
        "no stance will have torques, only the swing; are these the forces of this trial, and were "
        "the plates on?"
    )
    return trial.make_finding(severity, "plates", found, cure, code=Code.NO_STEP_ON_PLATE)


def overhang(trial: TrialEvidence, step: PlateContact) -> Iterator[Finding]:
    """A step whose foot rests partly beside its plate, and beside every other: plates that touch
    are one surface.
    """
    feet = trial.feet
    if feet is None or step.plate.corners is None:
        return
    surface = [
        plate
        for plate in trial.recording.plates
        if plate is step.plate or has_known_outline(plate, BODY_N)
    ]
    sole = foot_contact.build_sole(feet.build_points(trial.subject.height), step.foot, step.frames)
    still = sole.resting.any(axis=1) & feet.visible[step.frames, step.foot]
    if still.sum() < 3:
        return
    beside = sole.find_cells_off_plates(surface) & sole.resting
    if float(np.median(sole.sum_half_shares(beside)[still].max(axis=1))) > MAX_BESIDE_SHARE:
        share = float(sole.sum_share(beside)[still].max())
        yield trial.warning(
            TOPIC,
            f"{_words(trial, step)}: the {FEET[step.foot]} foot rests partly beside it "
            f"({100 * share:.0f} % of the "
            "sole)",
            "the plate misses a part of the force, and no torque of this leg counts meanwhile; are "
            "its corners right?",
            leg=SIDES[step.foot],
            code=Code.FOOT_BESIDE_PLATE,
        )


def _clocks(trial: TrialEvidence, feet: Feet, steps: Sequence[PlateContact]) -> Iterator[Finding]:
    """Touch-down and lift-off by force against those by motion."""
    late: list[float] = []
    for step in steps:
        loaded, frames = step.frames, len(feet.time)
        down = find_runs(feet.resting[:, step.foot])
        common = [min(run.stop, loaded.stop) - max(run.start, loaded.start) for run in down]
        if max(common, default=0) <= 0:
            continue
        start, stop = (run := down[int(np.argmax(common))]).start, run.stop
        inner = find_covered_frames([step.plate], feet.time)
        if start > 0 and loaded.start > inner.start:
            late.append(float(feet.time[loaded.start] - feet.time[start]))
        if stop < frames and loaded.stop < inner.stop:
            late.append(float(feet.time[loaded.stop - 1] - feet.time[stop - 1]))
    shift = float(np.mean(late)) if len(late) >= 2 else 0.0
    if abs(shift) > LATE_S and all(value * shift > 0 for value in late):
        yield trial.warning(
            "time",
            f"feet touch down and lift off {abs(shift):.2f} s {'later' if shift > 0 else 'sooner'} "
            "by force than by "
            "motion",
            "the clocks of markers and forces differ: correct the time column of one of the files",
            code=Code.CLOCKS_DIFFER,
        )


@dataclass(frozen=True, kw_only=True)
class _Outside:
    """What a plate reports outside of a foot, in all its loadings by that foot."""

    plate: str
    foot: int
    words: str  # Plate and foot, when, how far and where, and how much of the load it is
    moving: float  # Of the load in these frames: while the foot is in the air by its motion
    # (2,) x and z of the laboratory, unit: the mean way outwards, weighed by load and distance
    shift: Array
    impulse: float  # Share of the loadings' impulse


def outside_sole(trial: TrialEvidence, others: Sequence[Finding]) -> Iterator[Finding]:
    """Loaded frames of all plates whose centre of pressure is outside of the soles that may press
    on the plate.

    `others`: what the other checks found in this trial.
    """
    feet = trial.feet
    if feet is None:
        return
    sides = trial.trial.plates
    made = [step for step in trial.plate_contacts if sides.get(step.plate.name) != "none"]
    named = {plate: SIDES.index(side) for plate, side in sides.items() if side in SIDES}
    loadings = [replace(step, foot=named.get(step.plate.name, step.foot)) for step in made]
    places = locate_pressures(loadings, feet.build_points(trial.subject.height), feet.time)
    outside = np.zeros((len(loadings), len(feet.time)), dtype=bool)
    for frames, one, place, step in zip(outside, loadings, places, made, strict=True):
        # what is further away is told by `contacts`
        frames[one.frames] = place.outside & (
            (step.distance if one.foot == step.foot else step.other_distance)
            < foot_contact.UNDER_FOOT_M
        )
    divided = np.zeros_like(outside)
    for i, k in combinations(range(len(loadings)), 2):
        divided[[i, k]] |= find_divided_frames(
            loadings[i], loadings[k], (places[i], places[k]), len(feet.time)
        )
    if divided.any():
        yield _divided(trial, loadings, places, divided)
    made_up = {
        one.plate.name for one, frames in zip(loadings, divided, strict=True) if frames.any()
    }
    found = []
    for plate, foot in dict.fromkeys(
        (x.plate.name, x.foot) for x in loadings if x.plate.name not in made_up
    ):
        of_pair = [
            i for i, one in enumerate(loadings) if (one.plate.name, one.foot) == (plate, foot)
        ]
        off = _outside(feet, [(loadings[i], places[i], outside[i]) for i in of_pair])
        if off is not None and not _explained(trial, off, others):
            found.append(off)
    if found:
        yield from _told(trial, found)


def _outside(
    feet: Feet, parts: Sequence[tuple[foot_contact.Loading, PressurePosition, BoolArray]]
) -> _Outside | None:
    """What the loadings of one plate by one foot have outside, in (nf,) frames each; None where it
    is too little.
    """
    plate, foot = parts[0][0].plate.name, parts[0][0].foot
    chosen = np.concatenate([off[one.frames] for one, _, off in parts])
    loaded = np.concatenate([one.load for one, *_ in parts])
    away = np.concatenate([place.distance for _, place, _ in parts])[chosen]
    impulse = float(loaded[chosen].sum() / loaded.sum())
    if impulse < TOLD_SHARE or chosen.sum() * float(np.median(np.diff(feet.time))) < TOLD_S:
        return None
    way = np.concatenate([place.direction for _, place, _ in parts])[chosen]
    line = np.concatenate(
        [(feet.toe - feet.heel)[one.frames, foot][:, [0, 2]] for one, *_ in parts]
    )[chosen]
    line = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-9)
    right = np.column_stack([-line[:, 1], line[:, 0]])
    down = foot_contact.mark_near(feet.resting[:, foot], feet.time)
    in_air = np.concatenate([~down[one.frames] for one, *_ in parts])[chosen]
    weights = loaded[chosen]
    along, across = (
        float(np.average(np.sum(way * axis, axis=1), weights=weights)) for axis in (line, right)
    )
    where = f"beside the foot, to its {'right' if across > 0 else 'left'}"
    if abs(along / max(float(np.linalg.norm([along, across])), 1e-9)) > ENDWAYS:
        where = "in front of the toes" if along > 0 else "behind the heel"
    frames = np.any([off for *_, off in parts], axis=0)
    shift = np.average(away[:, None] * way, axis=0, weights=weights)
    return _Outside(
        plate=plate,
        foot=foot,
        words=f"plate {plate}, {FEET[foot]} foot, {format_spans(feet.time, find_runs(frames))}: "
        f"{1e3 * np.median(away):.0f} mm (at "
        f"most {1e3 * away.max():.0f} mm) {where}, in {100 * float(chosen.mean()):.0f} % of the "
        "loaded frames "
        f"({100 * impulse:.0f} % of the impulse)",
        moving=float(np.average(in_air, weights=weights)),
        shift=shift / np.linalg.norm(shift),
        impulse=impulse,
    )


def _told(trial: TrialEvidence, found: Sequence[_Outside]) -> Iterator[Finding]:
    """One finding where feet are in the air meanwhile, one where all plates are off in one
    direction of the room, else one a plate and foot.
    """
    message = "; ".join(off.words for off in found)
    shifts = np.array([off.shift for off in found])
    if np.average([off.moving for off in found], weights=[off.impulse for off in found]) > IN_AIR:
        yield trial.warning(
            TOPIC,
            message,
            "compare the clocks of markers and forces (time columns, first frames); no torque of a "
            "leg counts in these "
            "frames",
            cause="plates are loaded while the foot that stood on them is in the air",
            weight=2.0,
            code=Code.LOADED_IN_AIR,
        )
    elif len({off.plate for off in found}) > 1 and (shifts @ shifts.T).min() > ALIKE:
        yield trial.warning(
            TOPIC,
            message,
            "check the positions of the plates in the room (corners), and the origin of the "
            "markers; no torque of a "
            "leg counts in these frames",
            cause=PLATES_ELSEWHERE,
            weight=2.0,
            code=Code.PLATES_ELSEWHERE,
        )
    else:
        for off in found:
            yield trial.warning(
                TOPIC,
                off.words,
                "check the place of this plate (corners, origin of its moments), whether something "
                "else stood on it, "
                "and the heel and toe markers; no torque of this leg counts in these frames",
                cause=f"the centre of pressure of plate {off.plate} leaves the {FEET[off.foot]} "
                "foot",
                leg=SIDES[off.foot],
                weight=2.0,
                code=Code.PRESSURE_LEAVES_FOOT,
            )


def _divided(
    trial: TrialEvidence,
    loadings: Sequence[foot_contact.Loading],
    places: Sequence[PressurePosition],
    divided: BoolArray,
) -> Finding:
    """Two plates with one centre of pressure, (loadings, nf) frames."""
    shared = [
        (one, p, own) for one, p, own in zip(loadings, places, divided, strict=True) if own.any()
    ]
    away = 1e3 * np.concatenate([p.distance[own[one.frames] & p.outside] for one, p, own in shared])
    how_far = (
        f": {np.median(away):.0f} mm (at most {away.max():.0f} mm) outside of the foot"
        if len(away)
        else ""
    )
    both: BoolArray = np.asarray(divided.any(axis=0))
    share = divided.sum() / sum(len(one.load) for one, *_ in shared)
    found = (
        f"{format_spans(trial.recording.time, find_runs(both))}{how_far}, in {100 * share:.0f} % of the loaded "
        "frames"
    )
    cure = (
        "export what each plate or belt measured by itself; no torque of either leg counts in "
        "these frames"
    )
    cause = describe_divided_force(list(dict.fromkeys(one.plate.name for one, *_ in shared)))
    return trial.warning(TOPIC, found, cure, cause=cause, weight=3.0, code=Code.DIVIDED_FORCE)


def _explained(trial: TrialEvidence, off: _Outside, others: Sequence[Finding]) -> bool:
    """Whether another warning or error of the trial says why the centre of pressure is not under
    the foot.
    """
    blaming = [f for f in others if f.severity is not Severity.INFO]
    if any(f.topic in DISORDERS_PRESSURE or f.cause == PLATES_ELSEWHERE for f in blaming):
        return True
    plate = re.compile(rf"\bplate {re.escape(off.plate)}(?!\w)", re.IGNORECASE)
    if any(plate.search(f.evidence) for f in blaming if f.topic in (TOPIC, "plates")):
        return True
    ends = [f"{end}_{SIDES[off.foot]}" for end in ("heel", "toe")]
    labels = [label for end in ends for label in trial.marker_set.landmarks.get(end, ())]
    return any(f"'{label}'" in f.evidence for f in blaming for label in labels)
