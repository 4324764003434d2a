"""Body mass against the ground reactions, standing, step by step, and over strides, whatever the gain of the plates.

Over a stretch in which every foot on the ground is on a plate, from ta to tb, the vertical force changes the body's
momentum: mean force = m (g + (v_b - v_a) / (t_b - t_a)). The pelvis stands for the mass centre, so that the velocities
are a little wrong; the longer the stretch, the less that matters.

The size of the body in a trial against the static trial, from the sizes of all clusters together.

Skin and gaps change the size of one cluster by some per cent; the median of seven says more than any of them.

Lengths: the unit of the file, the scale of a trial against the static one, height against the markers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import UNDER_FOOT, near
from gaitcal.faults.contacts import Feet, feet_of, overhang, steps
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.io.force_plate import BODY_N, resample_wrench
from gaitcal.io.intervals import duration, runs, spans
from gaitcal.io.recording import ForcePlate
from gaitcal.io.still import still_window
from gaitcal.model.subject_model import GRAVITY

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


SCALE = (0.983, 1.011)
"""Median size of the clusters of a trial against the static trial: those of 20 people, all their
clean trials together, lie between 0.985 and 1.002."""
FEWEST_CLUSTERS = 6
MOST_MARGIN = 0.006
"""By which the scatter of the clusters' sizes about their median widens the limits, at most: two standard errors of it.
Halves of a clean walk with Plug-in Gait markers, two to four a segment, have a median of 0.980."""
CERTAIN = 0.012
"""Beyond these limits by so much it is another body or another calibration of the cameras."""


def scale_of(trial: TrialEvidence) -> float | None:
    """Median size of the trial's clusters; None with too few."""
    ratios = [cluster.size_ratio for cluster in trial.clusters.values()]
    return float(np.median(ratios)) if len(ratios) >= FEWEST_CLUSTERS else None


def margin_of(trial: TrialEvidence) -> float:
    """By how much the median size of the trial's clusters is uncertain, as they scatter about it: twice
    1.25 (1.48 median |r - median r|) / sqrt(n), the standard error of a median of n.
    """
    ratios = np.array([cluster.size_ratio for cluster in trial.clusters.values()])
    scatter = 1.48 * float(np.median(np.abs(ratios - np.median(ratios))))
    return min(MOST_MARGIN, 2.5 * scatter / float(np.sqrt(len(ratios))))


def odd_scale(trial: TrialEvidence) -> float | None:
    """The scale of a trial where it is not that of the static trial; scatter alone enlarges a cluster a little."""
    scale = scale_of(trial)
    if scale is None:
        return None
    margin = margin_of(trial)
    swollen = float(np.median([c.swelling for c in trial.clusters.values()]))
    return scale if not SCALE[0] - margin <= scale <= SCALE[1] + margin + swollen else None


def rescaled(trial: TrialEvidence) -> TrialEvidence:
    """The trial in the size of the static one, where it has another: what else is wrong can be seen then."""
    scale = odd_scale(trial)
    if scale is None:
        return trial
    recording = replace(trial.recording, markers=trial.recording.markers / scale)
    return replace(trial, trial=replace(trial.trial, recording=recording))


def body_scale(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether all trials show a body of one size."""
    scales = {t.name: (t, scale) for t in trials if not t.is_static and (scale := scale_of(t)) is not None}
    odd = [(t, scale) for t, scale in scales.values() if odd_scale(t) is not None]
    if not odd:
        return
    away = [max(SCALE[0] - scale, scale - SCALE[1]) for _, scale in odd]
    weight = 1.0 + max(away) / (1.0 - SCALE[0])
    sizes = ", ".join(f"{t.name} {scale:.3f}" for t, scale in odd)
    clusters = f"the clusters of all segments are {sizes} times as large as in the static trial (median); allowed: "
    clusters += f"{SCALE[0]:g} to {SCALE[1]:g}"
    if len(odd) == len(scales):
        static = next((t for t in trials if t.is_static), odd[0][0])
        tell = static.error if max(away) > CERTAIN else static.warning
        yield tell(
            "body size",
            clusters,
            "use the static trial of this person and session, with the calibration of the cameras of the other trials",
            cause="the static trial shows a body of another size than "
            + ("the moving trial" if len(odd) == 1 else "all moving trials"),
            weight=weight,
            code=Code.BODY_SIZE,
        )
        return
    for t, scale in odd:
        tell = t.error if max(SCALE[0] - scale, scale - SCALE[1]) > CERTAIN else t.warning
        yield tell(
            "body size",
            clusters,
            "use the trial of this person, exported with the calibration of the cameras of the others",
            cause="the trial shows a body of another size than the others",
            weight=weight,
            code=Code.BODY_SIZE,
        )


SIZE = (0.05, 4.0)
"""Size of the cloud of markers, in body heights, outside which the unit of length must be wrong. One shank with its
foot measures 0.3."""
LENGTHS_SCALE = (0.8, 1.25)
"""Lengths within segments against those of the static trial: outside, unit or camera calibration must be wrong."""
SCALE_DOUBTED = 0.04
"""Departure of the same ratio from one that skin movement does not explain."""
HIP_HEIGHT = (0.48, 0.58)
"""Height of the ASIS above the lateral malleoli, in body heights; five grown people stand between 0.516 and 0.539."""
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 39.4}


def size(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the cloud of markers has the size of a body."""
    height, found = trial.subject.height, cloud_size(trial)
    if found is None or SIZE[0] * height < found < SIZE[1] * height:
        return
    likely = next((name for name, unit in UNITS.items() if 0.15 * height < found / unit < 2.5 * height), None)
    if likely:
        cure = f"it would be {found / UNITS[likely]:.3g} m if the numbers were {likely}: declare their unit"
        if likely == "millimetres":
            cure = f"it would be {found / 1e3:.3g} m if the numbers were mm: declare mm, or divide by 1000"
    else:
        cure = "check the unit of length that the file declares"
    allowed = f"{SIZE[0] * height:.2g} to {SIZE[1] * height:.2g} m"
    yield trial.error("units", f"the markers span {found:.4g} m; allowed: {allowed}", cure, code=Code.UNIT_OF_LENGTH)


def cloud_size(trial: TrialEvidence) -> float | None:
    """m, diagonal of the box around the markers of the set, median over frames; None where too few are seen."""
    columns = [trial.place[m] for m in trial.marker_set.labels if m in trial.place]
    frames = np.flatnonzero(trial.seen[:, columns].sum(axis=1) >= 3)
    if not len(frames):
        return None
    some = frames[:: max(1, len(frames) // 200)]
    x = trial.recording.markers[some][:, columns]
    box = np.nanmax(x, axis=1) - np.nanmin(x, axis=1)
    return float(np.median(np.linalg.norm(box, axis=1)))


def scale(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether lengths within segments are those of the static trial."""
    if trial.is_static:
        return
    ratios = np.array(list(_ratios(trial)))
    if not len(ratios):
        return
    ratio = float(np.median(ratios))
    words = f"lengths between markers of one segment are {ratio:.3g} times those of the static trial"
    if not LENGTHS_SCALE[0] <= ratio <= LENGTHS_SCALE[1]:
        cure = "check the unit of length of both files, and that both show the same person"
        if 500 < ratio < 2000:
            cure = "the numbers are mm where the static trial has m: declare mm, or divide by 1000"
        yield trial.error("units", words, cure, code=Code.UNIT_OF_LENGTH)
    elif abs(ratio - 1) > SCALE_DOUBTED and len(ratios) >= 6:
        cure = "were the cameras calibrated anew, or markers put on again, between the two?"
        yield trial.warning("units", words, cure, code=Code.OTHER_SCALE)


def _ratios(trial: TrialEvidence) -> Iterator[float]:
    """Median distance of every pair of markers with weight in a segment, over that in the static posture."""
    for labels, local in trial.templates.values():
        for i, a in enumerate(labels):
            for j in range(i):
                length = float(np.linalg.norm(local[i] - local[j]))
                if length < 0.03 or not trial.weight(a) or not trial.weight(labels[j]):
                    continue
                apart = trial.path(a) - trial.path(labels[j])
                distance = np.linalg.norm(apart, axis=1)
                distance = distance[np.isfinite(distance)]
                if len(distance):
                    yield float(np.median(distance)) / length


def hip_height(trial: TrialEvidence) -> float | None:
    """m, median height of the ASIS above the lateral malleoli."""
    paths = [trial.landmark(f"{name}_{side}") for name in ("asis", "ankle_lat") for side in "rl"]
    if any(path is None for path in paths):
        return None
    up = np.array([path[:, 1] for path in paths if path is not None])
    difference = 0.5 * (up[0] + up[1] - up[2] - up[3])
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if len(difference) else None
