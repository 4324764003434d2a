"""Force plates: what the reader found, sign, offset, saturation, corners, and body weight."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.finding import Finding, info, warning
from gaitcal.dynamics.plate_outline import OUTSIDE_SHARE, share_outside
from gaitcal.model.build import GRAVITY
from gaitcal.recording import still_window
from gaitcal.recording.force_plate import BODY_N, OUTSIDE_M, QUIET_N, UNLOADED_N
from gaitcal.recording.intervals import runs, spans
from gaitcal.recording.recording import ForcePlate
from gaitcal.study.study import Role

Array = NDArray[np.float64]

OFFSET_N = 15.0
"""Reading of an empty plate that a file of forces should not have."""
CLIPPED = 5
"""Samples in a row at the very same largest value: an amplifier at its end."""
CLIPPED_N = 200.0
ASLANT = 0.5
"""Horizontal over vertical force, median under load, above which axes are doubted; walking has 0.1 to 0.2."""
MASS = 0.05
"""Difference of body mass and static force that is told."""
STANCE_SHARE = (0.55, 1.25)
"""Mean vertical force over a stance phase of walking, in body weights: about 0.8."""
PEAK = 3.0
STANCE_S = 0.3

_ALARMING = re.compile(r"left out|never empty|outside its corners|no numbers")


def told_on_reading(trial: TrialEvidence) -> Iterator[Finding]:
    """What the reader noted on plates: type, sign, corners, offset, samples without numbers."""
    for note in trial.recording.notes:
        if not re.match(r"Plate |\d+ force plate", note) or "holds the columns" in note:
            continue
        if _ALARMING.search(note) and trial.trial.role is Role.GAIT:
            cure = "check FORCE_PLATFORM in the file; forces of this plate are not to be trusted without"
            if "never empty" in note:
                cure = "record some seconds with nobody on the plate, or remove its offset before export"
            yield warning("plates", trial.name, note.rstrip("."), cure, trial.source)
        else:
            yield info("plates", trial.name, note.rstrip("."))


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
            yield warning("plates", trial.name, found, cure, trial.source)
        empty = np.abs(up) < UNLOADED_N
        empty &= np.abs(up - np.median(up[empty])) < QUIET_N if empty.any() else False
        if empty.mean() > 0.1 and abs(rest := float(np.median(up[empty]))) > OFFSET_N:
            found = f"{name}: reads {rest:.0f} N where nobody stands on it"
            yield warning("plates", trial.name, found, "remove the offset of the empty plate", trial.source)
        yield from _clipped(trial, plate)
        loaded = up > BODY_N
        if loaded.sum() > 10:
            ratio = float(np.median(np.hypot(force[loaded, 0], force[loaded, 2]) / up[loaded]))
            if ratio > ASLANT:
                found = f"{name}: its horizontal force is {ratio:.2f} times the vertical one"
                yield warning("plates", trial.name, found, "are its axes those of the file, y up?", trial.source)


def _clipped(trial: TrialEvidence, plate: ForcePlate) -> Iterator[Finding]:
    for axis, name in enumerate("xyz"):
        values = plate.force[:, axis]
        size = np.abs(np.nan_to_num(values))
        if (top := float(size.max())) < CLIPPED_N:
            continue
        held = runs(size >= top * (1 - 1e-9), CLIPPED)
        # Smooth data may rest at its peak for a sample or two, never for five.
        if held:
            yield warning(
                "plates",
                trial.name,
                f"plate {plate.name}: F{name} stays at {top:.0f} N for {sum(s.stop - s.start for s in held)} samples "
                f"({spans(plate.time, held)}): saturated",
                "choose a larger range of the amplifier; leave these frames out with time = [start, end]",
                trial.source,
            )


def corners(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether centres of pressure lie on their plate."""
    for plate in trial.recording.plates:
        if plate.corners is None:
            continue
        share, farthest = share_outside(plate, plate.corners, BODY_N)
        if share > OUTSIDE_SHARE:
            yield warning(
                "plates",
                trial.name,
                f"plate {plate.name}: the centre of pressure of {100 * share:.0f} % of its load lies over "
                f"{1e3 * OUTSIDE_M:.0f} mm outside its corners (up to {1e3 * farthest:.0f} mm)",
                "check FORCE_PLATFORM:CORNERS, ORIGIN and CHANNEL",
                trial.source,
            )


def body_mass(trial: TrialEvidence) -> Iterator[Finding]:
    """Body mass against the force under the standing, or the mean force under the walking person."""
    if trial.is_static:
        yield from _standing(trial)
    elif trial.trial.role is Role.GAIT:
        yield from _walking(trial)


def _standing(trial: TrialEvidence) -> Iterator[Finding]:
    if trial.model is None or not trial.recording.plates:
        return
    window = still_window(trial.recording, trial.marker_set.labels)
    total = 0.0
    for plate in trial.recording.plates:
        within = (plate.time >= window.start) & (plate.time <= window.stop) & np.isfinite(plate.force[:, 1])
        total += float(np.median(plate.force[within, 1])) if within.any() else 0.0
    mass, found = trial.subject.mass, total / GRAVITY
    told = f"the plates carry {total:.0f} N = {found:.1f} kg while standing; subject.mass_kg is {mass:g}"
    if found < 0.5 * mass:
        yield info("body mass", trial.name, f"{told}: a foot stood beside the plates")
    elif abs(found / mass - 1) > MASS:
        cure = "correct mass_kg, if both feet stood on plates: torques and inertia follow from it"
        yield warning("body mass", trial.name, told, cure, trial.source)
    else:
        yield info("body mass", trial.name, told)


def _walking(trial: TrialEvidence) -> Iterator[Finding]:
    weight = trial.subject.weight
    for plate in trial.recording.plates:
        up = np.nan_to_num(plate.force[:, 1])
        for run in runs(up > BODY_N, 2):
            if plate.time[run.stop - 1] - plate.time[run.start] < STANCE_S or run.start == 0 or run.stop == len(up):
                continue  # a knock, or a step that the recording cuts off
            share, peak = float(up[run].mean()) / weight, float(up[run].max()) / weight
            if STANCE_SHARE[0] <= share <= STANCE_SHARE[1] and peak < PEAK:
                continue
            yield warning(
                "body mass",
                trial.name,
                f"plate {plate.name}, {spans(plate.time, [run])}: mean {share:.2f} and peak {peak:.2f} body weights of "
                f"{trial.subject.mass:g} kg; a step of walking has about 0.8 and 1.1",
                "check mass_kg, the gain of the plate, and whether the whole foot was on it",
                trial.source,
            )
