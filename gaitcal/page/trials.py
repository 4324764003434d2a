"""Tables about trials: what was recorded, how each segment and marker is met, which phases the calibration had."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np

from gaitcal.calibration.joint_phases import Phase
from gaitcal.figures.fit import RmsErrors, leg_fit, segment_fits, trial_fit
from gaitcal.gait.words import joint_words, role_words, segment_words
from gaitcal.motion.motion import MarkerErrors
from gaitcal.person.result import Calibration, TrialResult

LITTLE_WEIGHT = 0.5
"""Part of the largest weight."""
NO_CHANGE = 5e-5
"""m, half of what the page shows."""
WORST = 6
"""Markers shown at once; the rest is folded away."""


@dataclass(frozen=True)
class TrialFacts:
    """One recording of the study."""

    name: str
    role: str
    file: str
    seconds: float
    frames: int
    rate: float
    markers: int
    seen: float
    """% of all marker samples that were seen."""
    plates: int
    valid_frames: int | None
    """Frames in which every foot on the ground is on a plate; None without plates."""


def trial_facts(calibration: Calibration) -> tuple[TrialFacts, ...]:
    """All recordings, the static one too."""
    valid = {t.name: int(t.loads.reactions.valid.sum()) for t in calibration.trials if t.loads}
    facts = []
    for trial in calibration.study.trials:
        r = trial.recording
        seen = np.isfinite(r.markers).all(axis=2)
        facts.append(
            TrialFacts(
                trial.name,
                role_words(trial.role, trial.joint),
                file_name(r.source),
                float(r.time[-1] - r.time[0]),
                len(r.time),
                r.rate,
                len(r.labels),
                100.0 * float(seen.mean()) if seen.size else 0.0,
                len(r.plates),
                valid.get(trial.name),
            )
        )
    return tuple(facts)


def file_name(source: str) -> str:
    """The name alone: a folder's name may say who the person is."""
    return PureWindowsPath(PurePosixPath(source).name).name or source


@dataclass(frozen=True)
class MarkerFit:
    """How one marker is met, mm."""

    label: str
    segment: str
    weight: float
    nominal: float | None
    """RMS."""
    calibrated: float | None
    """RMS."""
    floor: float | None
    largest: float | None
    """Largest distance with the calibrated model."""


@dataclass(frozen=True)
class TrialFit:
    """How one trial is met."""

    name: str
    role: str
    joint: str | None
    """The joint of an isolated trial."""
    whole: RmsErrors
    legs: RmsErrors
    """Pelvis and legs alone."""
    final: RmsErrors | None
    """With the model at the end of the whole calibration, where later phases changed the fit of this trial."""
    segments: tuple[RmsErrors, ...]
    few: str
    """Segments with fewer than three markers, in words; empty where there are none."""
    markers: tuple[MarkerFit, ...]
    """Largest error first, those with little weight last."""
    largest: float | None
    """mm, largest distance of any marker with the calibrated model."""
    largest_marker: str
    largest_before: float | None
    """mm."""

    @property
    def worst(self) -> tuple[MarkerFit, ...]:
        """The markers with the largest errors, those with little weight last."""
        return self.markers[:WORST]


def trial_fits(calibration: Calibration) -> tuple[TrialFit, ...]:
    """Of every moving trial."""
    return tuple(_trial_fit(trial) for trial in calibration.trials)


def _trial_fit(trial: TrialResult) -> TrialFit:
    after, before = trial.calibrated.errors.largest(), trial.nominal.errors.largest()
    return TrialFit(
        trial.name,
        role_words(trial.role, trial.joint),
        trial.joint,
        trial_fit(trial),
        leg_fit(trial),
        _final_fit(trial),
        tuple(segment_fits(trial)),
        _few(trial),
        _markers(trial),
        1e3 * after[0] if after else None,
        after[1] if after else "",
        1e3 * before[0] if before else None,
    )


def _few(trial: TrialResult) -> str:
    few = [fit.label for fit in segment_fits(trial) if not fit.rigid]
    return " and ".join(", ".join(few).rsplit(", ", 1))


def _final_fit(trial: TrialResult) -> RmsErrors | None:
    own, final = trial.calibrated.errors.rms(), trial.final.errors.rms()
    if own is None or final is None or abs(final - own) < NO_CHANGE:
        return None
    return replace(trial_fit(trial), calibrated=1e3 * final)


def _markers(trial: TrialResult) -> tuple[MarkerFit, ...]:
    after = trial.calibrated.errors
    before, floor = _rms_by_label(trial.nominal.errors), _rms_by_label(trial.floor)
    now = _rms_by_label(after)
    heaviest = float(after.weight.max(initial=0.0))
    rows = []
    for k, label in enumerate(after.labels):
        column = after.distance[:, k]
        largest = 1e3 * float(np.nanmax(column)) if np.isfinite(column).any() else None
        weight, segment = float(after.weight[k]), segment_words(after.segments[k])
        rows.append(MarkerFit(label, segment, weight, before.get(label), now.get(label), floor.get(label), largest))
    return tuple(sorted(rows, key=lambda m: (m.weight <= LITTLE_WEIGHT * heaviest, -(m.calibrated or 0.0))))


def _rms_by_label(errors: MarkerErrors) -> dict[str, float]:
    return {
        label: 1e3 * float(np.sqrt(np.nanmean(column**2)))
        for label, column in zip(errors.labels, errors.distance.T, strict=True)
        if np.isfinite(column).any()
    }


def phase_words(phase: Phase) -> str:
    """`joint:hip_r` -> `right hip, from its own trials`."""
    if phase.name.startswith("joint:"):
        return f"{joint_words(phase.name.removeprefix('joint:'))}, from its own trials"
    known = {
        "gait": "legs, from walking",
        "all joints": "all joints, over all trials at once",
        "inertial": "masses, mass centres and moments of inertia",
        "joint_step": "joint and inertial parameters together",
        "joint step": "joint and inertial parameters together",
    }
    return known.get(phase.name, phase.name)
