"""Tables about trials: what was recorded, how each segment and marker is met, which phases the calibration had."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np

from gaitcal.calibration.joint_phases import Phase
from gaitcal.gait.words import joint_words, listed, role_words, segment_words
from gaitcal.motion.motion import MarkerErrors
from gaitcal.session.marker_fit import RmsErrors, leg_fit, segment_fits, trial_fit
from gaitcal.session.result import Calibration, TrialResult

LITTLE_WEIGHT = 0.5
"""Part of the largest weight."""
NO_CHANGE = 5e-5
"""m, half of what the page shows."""
WORST = 6
"""Markers shown at once; the rest is folded away."""


@dataclass(frozen=True, kw_only=True)
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


def trial_facts(calibration: Calibration) -> tuple[TrialFacts, ...]:
    """All recordings, the static one too."""
    facts = []
    for trial in calibration.study.trials:
        recording = trial.recording
        seen = np.isfinite(recording.markers).all(axis=2)
        facts.append(
            TrialFacts(
                name=trial.name,
                role=role_words(trial.role, trial.joint),
                file=file_name(recording.source),
                seconds=float(recording.time[-1] - recording.time[0]),
                frames=len(recording.time),
                rate=recording.rate,
                markers=len(recording.labels),
                seen=100.0 * float(seen.mean()) if seen.size else 0.0,
                plates=len(recording.plates),
            )
        )
    return tuple(facts)


def file_name(source: str) -> str:
    """The name alone: a folder's name may say who the person is."""
    return PureWindowsPath(PurePosixPath(source).name).name or source


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
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

    @property
    def worst(self) -> tuple[MarkerFit, ...]:
        """The markers with the largest errors, those with little weight last."""
        return self.markers[:WORST]


def trial_fits(calibration: Calibration) -> tuple[TrialFit, ...]:
    """Of every moving trial."""
    return tuple(fit_of(trial) for trial in calibration.trials)


def fit_of(trial: TrialResult) -> TrialFit:
    """Of one moving trial."""
    largest, segments = trial.calibrated.errors.largest(), tuple(segment_fits(trial))
    return TrialFit(
        name=trial.name,
        role=role_words(trial.role, trial.joint),
        joint=trial.joint,
        whole=trial_fit(trial),
        legs=leg_fit(trial),
        final=_final_fit(trial),
        segments=segments,
        few=listed([fit.label for fit in segments if not fit.rigid]),
        markers=_markers(trial),
        largest=1e3 * largest[0] if largest else None,
        largest_marker=largest[1] if largest else "",
    )


def _final_fit(trial: TrialResult) -> RmsErrors | None:
    calibrated, final = trial.calibrated.errors.rms(), trial.final.errors.rms()
    if calibrated is None or final is None or abs(final - calibrated) < NO_CHANGE:
        return None
    return replace(trial_fit(trial), calibrated=1e3 * final)


def _markers(trial: TrialResult) -> tuple[MarkerFit, ...]:
    errors = trial.calibrated.errors
    nominal, calibrated, floor = map(_rms_by_label, (trial.nominal.errors, errors, trial.floor))
    heaviest = float(errors.weight.max(initial=0.0))
    rows = [
        MarkerFit(
            label=label,
            segment=segment_words(errors.segments[k]),
            weight=float(errors.weight[k]),
            nominal=nominal.get(label),
            calibrated=calibrated.get(label),
            floor=floor.get(label),
            largest=1e3 * float(np.nanmax(errors.distance[:, k])) if label in calibrated else None,
        )
        for k, label in enumerate(errors.labels)
    ]
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
    }
    return known.get(phase.name, phase.name)
