"""Check feet on force plates: which foot, wholly on the plate, pressure under it, synchronised.

`dynamics/off_sole.py` finds the frames in which a centre of pressure is outside its foot; torques
are invalid there, in the tracked motion as well. A fault of soles, plates or synchronisation has a
check of its own; its consequences are not reported again (`_is_explained`).
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeAlias

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact
from gaitcal.dynamics.off_sole import (
    MAX_OFF_PLATE_SHARE,
    PressurePosition,
    describe_divided_force,
    detect_common_centre,
    find_divided_frames,
    locate_pressures,
)
from gaitcal.dynamics.plate_outline import has_known_outline
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import BODY_N, find_covered_frames
from gaitcal.io.recording import find_runs, format_spans, measure_duration
from gaitcal.model.linkage import SIDES
from gaitcal.preprocess.plate_contacts import Feet, PlateContact
from gaitcal.preprocess.trial_evidence import TrialEvidence

TOPIC = "plate to foot"
PLATES_ELSEWHERE = "the positions of plates and markers do not match"
DISORDERS_PRESSURE = ("units", "axes", "sides", "swapped labels", "time", "forces")
"""Topics of warnings and errors whose causes displace centres of pressure from the feet."""
FEET = ("right", "left")
FLOOR_M = (-0.03, 0.15)  # Height of a resting heel or toe marker above the centre of pressure
TIME_OFFSET_S = 0.08  # Time offset between markers and forces from which it is reported
REPORTED_SHARE, REPORTED_S = 0.02, 0.03
"""Share of a plate's impulse under a foot, and time (s), outside the sole from which it is
reported: landing and lifting off take 10 to 20 ms (Whittle 1999), and carry less than that share
where the synchronisation is off by a few frames."""
ONE_DIRECTION = 0.7  # Cosine above which directions count as the same
# Cosine with the line heel-toe above which a point is behind or in front of the foot, not beside it
ALONG_FOOT = 0.7
# Share of the load outside a foot that acts while the foot moves: more is a time offset
IN_AIR_SHARE = 0.5


_Part: TypeAlias = tuple[foot_contact.Loading, PressurePosition, BoolArray]
"""A loading, its centres of pressure, and the frames (nf,) in which these are outside."""


def check_contacts(trial: TrialEvidence) -> Iterator[Finding]:
    """Check which foot is on each plate, plate heights, feet beside plates and the time offset.

    Parameters
    ----------
    trial
        A trial; only gait trials with plates are checked.

    Yields
    ------
    Finding
        Of loaded plates, their feet and their synchronisation.
    """
    feet, plates = trial.feet, trial.recording.plates
    if not trial.is_gait or not plates:
        return
    most = max(float(np.nan_to_num(plate.force[:, 1]).max()) for plate in plates)
    steps = trial.plate_contacts
    if not steps and (feet is not None or most < BODY_N):
        yield _report_no_step(trial, feet, most)
    if feet is None:
        return
    for step in steps:
        far = step.distance > foot_contact.UNDER_FOOT_M
        # a divided total force, see `check_pressure_outside_sole`, may be far from both feet
        if not (
            far and any(detect_common_centre(step, other, len(feet.time)).any() for other in steps)
        ):
            yield from _check_foot(trial, step)
    on_feet = [step for step in steps if step.under_foot]
    for step in on_feet:
        yield from _check_plate_height(trial, feet, step)
    partly = [finding for step in on_feet for finding in check_overhang(trial, step)]
    # if another step of the trial is wholly on its plate, the plate positions are right: a note
    yield from (
        partly
        if len(partly) == len(on_feet)
        else (replace(f, severity=Severity.INFO) for f in partly)
    )
    yield from _check_synchronisation(trial, feet, on_feet)


def _describe_step(trial: TrialEvidence, step: PlateContact) -> str:
    """Name the plate of a step and its time."""
    return f"plate {step.plate.name}, {format_spans(trial.recording.time, [step.frames])}"


def _check_foot(trial: TrialEvidence, step: PlateContact) -> Iterator[Finding]:
    """Check that the foot given in the study is on the plate; without one, report which one is."""
    name, side = _describe_step(trial, step), trial.trial.plates.get(step.plate.name)
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
            f"{name}: the study assigns it to the {FEET[SIDES.index(side)]} foot, "
            f"{1e3 * step.other_distance:.0f} mm from the centre of pressure (the {foot} foot: "
            f"{mm:.0f} mm)",
            f'set plates = {{ {step.plate.name} = "{SIDES[step.foot]}" }}, or remove the entry to '
            "have the foot detected",
            code=Code.WRONG_FOOT,
        )
    elif step.distance > foot_contact.UNDER_FOOT_M and np.isinf(step.other_distance):
        found = f"{name}: the centre of pressure is {mm:.0f} mm from the {foot} foot; "
        found += f"heel and toe of the {FEET[1 - step.foot]} foot are not visible at that time"
        yield trial.info(TOPIC, found, code=Code.UNDER_NO_FOOT)
    elif step.distance > foot_contact.UNDER_FOOT_M:
        yield trial.warning(
            TOPIC,
            f"{name}: the centre of pressure is {mm:.0f} mm from the {foot} and "
            f"{1e3 * step.other_distance:.0f} mm from the other foot; allowed: "
            f"{1e3 * foot_contact.UNDER_FOOT_M:.0f} mm",
            "check the corners of the plate, the axes of the forces, and that the forces belong to "
            "this trial",
            code=Code.UNDER_NO_FOOT,
        )
    else:
        found = f"{name}: {foot} foot, its line heel-toe {mm:.0f} mm from the centre of pressure"
        yield trial.info(TOPIC, found, code=Code.FOOT_OF_PLATE)


def _check_plate_height(trial: TrialEvidence, feet: Feet, step: PlateContact) -> Iterator[Finding]:
    """Check that the centre of pressure is at the height of the resting foot's sole."""
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
            f"plate {step.plate.name}: its surface is {1e3 * above:.0f} mm below the lower of the "
            "heel and toe markers; "
            f"allowed: {1e3 * FLOOR_M[0]:.0f} to {1e3 * FLOOR_M[1]:.0f} mm",
            "check the height of the plate's corners, or the origin of the markers",
            code=Code.PLATE_HEIGHT,
        )


def _report_no_step(trial: TrialEvidence, feet: Feet | None, most: float) -> Finding:
    """Report that no plate is loaded (at most `most` N).

    A warning if a foot stands on a plate, if a foot is never visible or if corners are missing;
    otherwise a note: the person walked beside the plates.
    """
    found, severity = f"no plate is loaded: at most {most:.0f} N", Severity.INFO
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
            <= MAX_OFF_PLATE_SHARE
        )
        stands = sole.resting.all(axis=1) & on_plate & feet.visible[:, foot]
        runs = find_runs(stands, 2)
        long = [r for r in runs if measure_duration(feet.time, r) > foot_contact.MIN_LOADING_S]
        if long:
            found += f", though the {name} foot stands on them ({format_spans(feet.time, long)})"
            severity = Severity.WARNING
    cure = (
        "torques exist in swing only; check that the forces belong to this trial and that the "
        "plates were switched on"
    )
    return trial.make_finding(severity, "plates", found, cure, code=Code.NO_STEP_ON_PLATE)


def check_overhang(trial: TrialEvidence, step: PlateContact) -> Iterator[Finding]:
    """Report a step whose foot rests partly beside its plate and beside every other plate.

    Plates that touch each other are one surface.

    `step`: a loading of a plate by a foot of this trial. Yields one warning, or nothing.
    """
    feet = trial.feet
    if feet is None or step.plate.corners is None:
        return
    surface = []
    for plate in trial.recording.plates:
        if plate is step.plate or has_known_outline(plate, BODY_N):
            surface.append(plate)
    sole = foot_contact.build_sole(feet.build_points(trial.subject.height), step.foot, step.frames)
    still = sole.resting.any(axis=1) & feet.visible[step.frames, step.foot]
    if still.sum() < 3:
        return
    beside = sole.find_cells_off_plates(surface) & sole.resting
    if float(np.median(sole.sum_half_shares(beside)[still].max(axis=1))) > MAX_OFF_PLATE_SHARE:
        share = float(sole.sum_share(beside)[still].max())
        yield trial.warning(
            TOPIC,
            f"{_describe_step(trial, step)}: the {FEET[step.foot]} foot rests partly beside it "
            f"({100 * share:.0f} % of the sole)",
            "torques of this leg are invalid meanwhile, as the plate measures a part of the force "
            "only; check its corners",
            leg=SIDES[step.foot],
            code=Code.FOOT_BESIDE_PLATE,
        )


def _check_synchronisation(
    trial: TrialEvidence, feet: Feet, steps: Sequence[PlateContact]
) -> Iterator[Finding]:
    """Compare touch-down and lift-off by force with those by motion."""
    late: list[float] = []
    for step in steps:
        loaded, frames = step.frames, len(feet.time)
        down = find_runs(feet.resting[:, step.foot])
        common = [min(run.stop, loaded.stop) - max(run.start, loaded.start) for run in down]
        if max(common, default=0) <= 0:
            continue
        contact = down[int(np.argmax(common))]
        start, stop = contact.start, contact.stop
        # an event at an end of either recording has no time
        inner = find_covered_frames([step.plate], feet.time)
        if start > 0 and loaded.start > inner.start:
            late.append(float(feet.time[loaded.start] - feet.time[start]))
        if stop < frames and loaded.stop < inner.stop:
            late.append(float(feet.time[loaded.stop - 1] - feet.time[stop - 1]))
    shift = float(np.mean(late)) if len(late) >= 2 else 0.0
    if abs(shift) > TIME_OFFSET_S and all(value * shift > 0 for value in late):
        yield trial.warning(
            "time",
            f"feet touch down and lift off {abs(shift):.2f} s "
            f"{'later' if shift > 0 else 'earlier'} by force than by motion",
            "markers and forces are not synchronised: correct the time column of one of the files",
            code=Code.CLOCKS_DIFFER,
        )


@dataclass(frozen=True, kw_only=True)
class _PressureOutside:
    """Centres of pressure of one plate outside one foot, in all its loadings by that foot."""

    plate: str
    foot: int
    description: str  # Plate and foot, time, distance, direction, share of the load
    in_air: float  # Share of the load in these frames that acts while the foot is in the air
    # (2,) x and z of the laboratory: unit mean direction outwards, weighted by load and distance
    direction: Array
    impulse: float  # Share of the loadings' impulse


def check_pressure_outside_sole(
    trial: TrialEvidence, others: Sequence[Finding]
) -> Iterator[Finding]:
    """Report loaded frames whose centre of pressure is outside the soles that may load the plate.

    Parameters
    ----------
    trial
        The trial.
    others
        Findings of the other checks of this trial; faults that they explain are not reported again.

    Yields
    ------
    Finding
        Warnings: divided forces, plates loaded by a foot in the air, displaced plates, or single
        plates whose centre of pressure leaves the foot.
    """
    feet = trial.feet
    if feet is None:
        return
    sides = trial.trial.plates
    made = [step for step in trial.plate_contacts if sides.get(step.plate.name) != "none"]
    named = {plate: SIDES.index(side) for plate, side in sides.items() if side in SIDES}
    loadings = [replace(step, foot=named.get(step.plate.name, step.foot)) for step in made]
    pressures = locate_pressures(loadings, feet.build_points(trial.subject.height), feet.time)
    outside = np.zeros((len(loadings), len(feet.time)), dtype=bool)
    for frames, one, pressure, step in zip(outside, loadings, pressures, made, strict=True):
        # larger distances are reported by `check_contacts`
        distance = step.distance if one.foot == step.foot else step.other_distance
        frames[one.frames] = pressure.outside & (distance < foot_contact.UNDER_FOOT_M)
    divided = np.zeros_like(outside)
    for i, k in combinations(range(len(loadings)), 2):
        divided[[i, k]] |= find_divided_frames(
            loadings[i], loadings[k], (pressures[i], pressures[k]), len(feet.time)
        )
    if divided.any():
        yield _report_divided_force(trial, loadings, pressures, divided)
    # plates with a divided force have no centre of pressure to check
    parts: dict[tuple[str, int], list[_Part]] = defaultdict(list)
    with_divided = {one.plate.name for one, d in zip(loadings, divided, strict=True) if d.any()}
    for part in zip(loadings, pressures, outside, strict=True):
        if part[0].plate.name not in with_divided:
            parts[part[0].plate.name, part[0].foot].append(part)
    summaries = [_summarise_outside(feet, of_pair) for of_pair in parts.values()]
    found = [s for s in summaries if s is not None and not _is_explained(trial, s, others)]
    if found:
        yield from _report_outside(trial, found)


def _summarise_outside(feet: Feet, parts: Sequence[_Part]) -> _PressureOutside | None:
    """Summarise frames (nf,) outside the foot of one plate's loadings; None if they are too few."""
    plate, foot = parts[0][0].plate.name, parts[0][0].foot
    chosen = np.concatenate([off[one.frames] for one, _, off in parts])
    loaded = np.concatenate([one.load for one, *_ in parts])
    away = np.concatenate([pressure.distance for _, pressure, _ in parts])[chosen]
    impulse = float(loaded[chosen].sum() / loaded.sum())
    # impact and lift-off are short and carry little
    if impulse < REPORTED_SHARE or chosen.sum() * float(np.median(np.diff(feet.time))) < REPORTED_S:
        return None
    direction = np.concatenate([pressure.direction for _, pressure, _ in parts])[chosen]
    line = np.concatenate(
        [(feet.toe - feet.heel)[one.frames, foot][:, [0, 2]] for one, *_ in parts]
    )[chosen]
    # unit vectors along the foot and to its right, viewed from above
    line = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-9)
    right = np.column_stack([-line[:, 1], line[:, 0]])
    # load while the foot moves suggests a time offset rather than a displaced plate
    down = foot_contact.mark_near(feet.resting[:, foot], feet.time)
    in_air = np.concatenate([~down[one.frames] for one, *_ in parts])[chosen]
    weights = loaded[chosen]
    along, across = (
        float(np.average(np.sum(direction * axis, axis=1), weights=weights))
        for axis in (line, right)
    )
    where = f"beside the foot, to its {'right' if across > 0 else 'left'}"
    if abs(along / max(float(np.linalg.norm([along, across])), 1e-9)) > ALONG_FOOT:
        where = "in front of the toes" if along > 0 else "behind the heel"
    frames = np.any([off for *_, off in parts], axis=0)
    mean = np.average(away[:, None] * direction, axis=0, weights=weights)
    return _PressureOutside(
        plate=plate,
        foot=foot,
        description=f"plate {plate}, {FEET[foot]} foot, "
        f"{format_spans(feet.time, find_runs(frames))}: {1e3 * np.median(away):.0f} mm (at "
        f"most {1e3 * away.max():.0f} mm) {where}, in {100 * float(chosen.mean()):.0f} % of the "
        f"loaded frames ({100 * impulse:.0f} % of the impulse)",
        in_air=float(np.average(in_air, weights=weights)),
        direction=mean / np.linalg.norm(mean),
        impulse=impulse,
    )


def _report_outside(trial: TrialEvidence, found: Sequence[_PressureOutside]) -> Iterator[Finding]:
    """Report one common cause, or each plate and foot.

    Common causes are feet in the air, and plates that are all displaced in one direction.
    """
    message = "; ".join(off.description for off in found)
    directions = np.array([off.direction for off in found])
    in_air = np.average([off.in_air for off in found], weights=[off.impulse for off in found])
    if in_air > IN_AIR_SHARE:
        yield trial.warning(
            TOPIC,
            message,
            "check the synchronisation of markers and forces (time columns, first frames); torques "
            "of the legs are invalid in these frames",
            cause="plates are loaded while the foot that stood on them is in the air",
            weight=2.0,
            code=Code.LOADED_IN_AIR,
        )
    elif (
        len({off.plate for off in found}) > 1 and (directions @ directions.T).min() > ONE_DIRECTION
    ):
        yield trial.warning(
            TOPIC,
            message,
            "check the corners of the plates and the origin of the markers; torques of the legs "
            "are invalid in these frames",
            cause=PLATES_ELSEWHERE,
            weight=2.0,
            code=Code.PLATES_ELSEWHERE,
        )
    else:
        for off in found:
            yield trial.warning(
                TOPIC,
                off.description,
                "check the corners and the origin of this plate, whether anything else loaded it, "
                "and the heel and toe markers; torques of this leg are invalid in these frames",
                cause=f"the centre of pressure of plate {off.plate} leaves the {FEET[off.foot]} "
                "foot",
                leg=SIDES[off.foot],
                weight=2.0,
                code=Code.PRESSURE_LEAVES_FOOT,
            )


def _report_divided_force(
    trial: TrialEvidence,
    loadings: Sequence[foot_contact.Loading],
    pressures: Sequence[PressurePosition],
    divided: BoolArray,
) -> Finding:
    """Report plates that share one centre of pressure in frames (loadings, nf)."""
    shared = [
        (one, p, d) for one, p, d in zip(loadings, pressures, divided, strict=True) if d.any()
    ]
    away = 1e3 * np.concatenate([p.distance[d[one.frames] & p.outside] for one, p, d in shared])
    how_far = (
        f": {np.median(away):.0f} mm (at most {away.max():.0f} mm) outside the foot"
        if len(away)
        else ""
    )
    both: BoolArray = np.asarray(divided.any(axis=0))
    share = divided.sum() / sum(len(one.load) for one, *_ in shared)
    found = (
        f"{format_spans(trial.recording.time, find_runs(both))}{how_far}, in {100 * share:.0f} % "
        "of the loaded frames"
    )
    cure = (
        "export the forces of each plate or belt separately; torques of both legs are invalid in "
        "these frames"
    )
    cause = describe_divided_force(list(dict.fromkeys(one.plate.name for one, *_ in shared)))
    return trial.warning(TOPIC, found, cure, cause=cause, weight=3.0, code=Code.DIVIDED_FORCE)


def _is_explained(trial: TrialEvidence, off: _PressureOutside, others: Sequence[Finding]) -> bool:
    """Return whether another warning or error explains why the pressure is not under the foot."""
    blaming = [f for f in others if f.severity is not Severity.INFO]
    if any(f.topic in DISORDERS_PRESSURE or f.cause == PLATES_ELSEWHERE for f in blaming):
        return True
    # a finding on this plate, or on the heel and toe markers, explains it as well
    plate = re.compile(rf"\bplate {re.escape(off.plate)}(?!\w)", re.IGNORECASE)
    if any(plate.search(f.evidence) for f in blaming if f.topic in (TOPIC, "plates")):
        return True
    ends = [f"{end}_{SIDES[off.foot]}" for end in ("heel", "toe")]
    labels = [label for end in ends for label in trial.marker_set.landmarks.get(end, ())]
    return any(f"'{label}'" in f.evidence for f in blaming for label in labels)
