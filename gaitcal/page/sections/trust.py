"""Preset Trust: what speaks for and against the numbers.

Verdict and reasons are data of the sheet itself; here is what they rest on.

Tables about trials: what was recorded, how each segment and marker is met, which phases the calibration had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np

from gaitcal.calibration.joint_phases import Phase
from gaitcal.dynamics.expected_residual import HeldResidual
from gaitcal.gait.moments import (
    MomentNumbers,
    capitalised,
    coordinate_title,
    joint_words,
    listed,
    role_words,
    segment_words,
)
from gaitcal.model.coordinates import split_side
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import MarkerErrors
from gaitcal.page.sections.blocks import (
    MISSING,
    Block,
    Cell,
    cell,
    curves,
    fold,
    heading,
    intervals,
    named,
    number,
    number_rounded,
    table,
    text,
)
from gaitcal.page.sections.error_bars import error_bar_blocks
from gaitcal.page.sections.summary import GaitNumbers
from gaitcal.session.parameter_words import ENOUGH_MOTION_DEG, Row, joint_groups, range_of_motion
from gaitcal.session.result import Calibration, TrialResult
from gaitcal.session.trial_result import RmsErrors, leg_fit, segment_fits, trial_fit

NOT_CONVERGED = (
    "Not converged: at least one phase of the calibration stopped before it reached its tolerance; see the table of "
    "phases in the preset Provenance. Do not use these numbers before that is settled."
)
JUDGEMENTS = (
    "Trustworthy: nothing speaks against the numbers beyond their error bars. Doubtful: they may be wrong by more than "
    "that, for the reasons given. Refused: not to be used; no torque of what is refused counts as valid, and no error "
    "bar is given. What is wrong with one leg concerns that leg alone, what is wrong with the static trial or an "
    "isolated one concerns every walk."
)
RESIDUALS = (
    "The measured ground forces should be all that moves the body. The force and moment that the model would still "
    "need at its pelvis to follow the measured motion are the pelvis residuals: they collect the errors of motion, "
    "masses and force plates. The limit of their RMS follows from these errors, from what the plates hold above the "
    "bandwidth of the motion, and from what walks without a fault leave: 1 of 1000 such walks is beyond it, and a walk "
    "that is, is doubtful. Hicks et al. (2015) ask of simulations, whose motion is changed until it agrees, for peaks "
    "below 5 % of the peak net external force, and 1 % of the height of the mass centre times that force; few walks as "
    "measured have that, and nothing is judged by it."
)


def trust_blocks(calibration: Calibration) -> list[Block]:
    """Of the whole result."""
    out = [text("Every phase converged.") if calibration.converged else text(NOT_CONVERGED, "bad")]
    if not calibration.phases:
        out = []
    out.append(fold("What the judgements mean", [text(JUDGEMENTS)]))
    return [*out, *_determined(calibration)]


def _determined(calibration: Calibration) -> list[Block]:
    """How well the trials show each joint."""
    groups = joint_groups(calibration)
    out = [heading("What these trials determine")]
    if not groups:
        return [*out, text("Joint parameters were not calibrated. What was assumed: preset Provenance.")]
    rows = [_joint(calibration, rows) for group in groups for rows in (group.right, group.left) if rows]
    head: list[Cell] = ["Joint", "Moved", "Fitted", "Not determined", "At a bound", "Largest SE, mm", "deg"]
    caption = (
        "Parameters of each joint, how far it moved in the trial that moves it most, and the largest standard error of "
        f"those that were fitted. About {number(ENOUGH_MOTION_DEG, 0)} deg of motion are needed."
    )
    where = "Which they are, and every value with its error: preset Joints. What was assumed: preset Provenance."
    return [*out, table(head, rows, caption=caption), text(where, "soft")]


def _joint(calibration: Calibration, rows: Sequence[Row]) -> list[Cell]:
    joint = rows[0].name.split(".")[0]
    unseen, at_bound = (sum(row.status == status for row in rows) for status in ("unidentifiable", "at bound"))
    moved = range_of_motion(calibration, joint)
    little = moved is not None and moved < ENOUGH_MOTION_DEG
    errors = [
        max((row.error for row in rows if row.unit == unit and row.error is not None), default=None)
        for unit in ("mm", "deg")
    ]
    return [
        cell(capitalised(joint_words(joint)), side=rows[0].side),
        MISSING if moved is None else cell(f"{number(moved, 0)}°", tone="look" if little else ""),
        str(len(rows) - unseen),
        cell(unseen, tone="look") if unseen else "0",
        cell(at_bound, tone="look") if at_bound else "0",
        *(number(error) for error in errors),
    ]


def trial_trust_blocks(model: SubjectModel, walk: GaitNumbers) -> list[Block]:
    """Of one walk: what makes the error bars, pelvis residuals, and what calibration changed."""
    return [*error_bar_blocks(walk, model.subject.mass), *_residuals(walk), *_changes(walk)]


def _residuals(walk: GaitNumbers) -> list[Block]:
    limits = walk.limits
    if limits is None:
        return []
    held = walk.expected
    rows: list[list[Cell]] = [
        [
            cell(stage.name),
            _held(stage.rms_force, held.force if held and stage is walk.stages[-1] else None),
            number(stage.peak_force, 0),
            _held(stage.rms_moment, held.moment if held and stage is walk.stages[-1] else None),
            number(stage.peak_moment),
        ]
        for stage in walk.stages
    ]
    below: list[list[Cell]] = []
    if held is not None:
        below.append(["expected of its errors", number(held.force.expected), "", number(held.moment.expected), ""])
        below.append(["limit", number(held.force.limit), "", number(held.moment.limit), ""])
    below.append(["asked of simulations", "", number(limits.force, 0), "", number(limits.moment)])
    head: list[Cell] = ["Model", "Force, N: RMS", "peak", "Moment, N·m: RMS", "peak"]
    rests = (
        "RMS over valid frames and the three components, peaks of the magnitude. What is asked of simulations rests on "
        f"a peak force of {number(limits.peak_force, 0)} N and a mass centre {number(limits.centre_height, 2)} m high."
    )
    return [
        heading(f"Do motion and ground forces agree? Trial {named(walk.trial.name)}"),
        text(RESIDUALS),
        curves(
            ["residual_force", "residual_moment"],
            {"residual_force": round(limits.force, 2), "residual_moment": round(limits.moment, 3)},
        ),
        table(head, [*rows, *below], total=range(len(rows), len(rows) + len(below))),
        text(rests, "soft"),
    ]


def _held(value: float, held: HeldResidual | None) -> Cell:
    """A residual, and whether it is within its limit, in words as well."""
    if held is None:
        return number(value)
    return cell(f"{'within' if held.within else 'above'}: {number(value)}", tone="good" if held.within else "look")


def _changes(walk: GaitNumbers) -> list[Block]:
    if not walk.numbers:
        return []
    out = [
        heading(f"What calibration changed, trial {named(walk.trial.name)}"),
        text(
            "RMS difference over the valid frames between the moments of the nominal and of the calibrated model. "
            "Where it is small against the effect you study, calibration did not matter for it.",
            "soft",
        ),
        intervals("%BW·H", [_change(n) for n in walk.numbers]),
    ]
    rows = [
        [cell(coordinate_title(n.name)), number(n.change_bwh, 2), number(n.change, 3), number(n.change_of_peak, 0)]
        for n in walk.numbers
    ]
    return [*out, table(["RMS change", "%BW·H", "N·m/kg", "% of peak"], rows, fold="All changes as numbers")]


def _change(n: MomentNumbers) -> dict[str, object]:
    base, side = split_side(n.name)
    return {
        "label": coordinate_title(base),
        "side": side,
        "nominal": 0.0,
        "fitted": number_rounded(n.change_bwh),
        "se": None,
        "truth": None,
    }


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
