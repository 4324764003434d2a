"""Preset Clinician: three lines on top of the page, and how to read the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gaitcal.analysis import fit_findings, trial_result
from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.dynamics.expected_residual import (
    ExpectedResidual,
    ResidualLimits,
    ResidualMagnitudes,
    compute_residual_limits,
)
from gaitcal.gait import cycles
from gaitcal.gait.moments import (
    SIDE_WORDS,
    MomentSummary,
    explain_parameters,
    format_count,
    format_list,
    summarise_moments,
)
from gaitcal.gait.peaks import ADDUCTION_PEAK, PeakMean
from gaitcal.gait.profile_score import BOTH, Score, make_score_title
from gaitcal.gait.strides import Layout, list_strides, make_layout
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import Judgement
from gaitcal.report.page.plain_data import (
    Block,
    fold_blocks,
    format_name,
    format_number,
    make_cell,
    make_heading,
    make_table,
    make_text,
    make_text_column,
    replace_control_characters,
)
from gaitcal.results.normal_curves import NormTables
from gaitcal.results.stride_tables import StrideTables
from gaitcal.results.stride_uses import summarise_usable_strides

KNEE_ADDUCTION = "knee_adduction"
"""The moment reported in full; external adduction is the opposite of the internal moment."""
GOOD_RATIO = 1.4
"""Marker error divided by the joint floor: up to this ratio the fit is called good. Larger ratios
are not assessed here: an amber or red line is a reason of the verdict."""
TONES = {Judgement.TRUSTWORTHY: "good", Judgement.DOUBTFUL: "look", Judgement.REFUSED: "poor"}
TONE_ORDER = ("plain", "good", "look", "poor")
NO_FORCES = "No joint moments and powers: this trial has no force plates."
NO_FOOT = "No joint moments: in no frame is a foot wholly on force plates that carry no other foot."
NO_ERRORS = (
    "No standard errors of the moments were computed for this result; curves of moments have no "
    "bands."
)
HOW_TO_READ = (
    "The gait cycle of each foot runs from a foot strike (0 %) to the next strike of that foot "
    "(100 %). Moments "
    "are internal, those of muscles and ligaments, unless the switch is set to external. Labels at "
    "the axes of the "
    "curves give the positive direction. %BW·H is percent of body weight times body height. The "
    "switches do not change the files.",
    "Bands about curves are ±1 standard error. A mean over strides has a band of one standard "
    "deviation, which includes measurement errors.",
)
Line = dict[str, str]  # `tone`: `good`, `look`, `poor` or `plain`; `text`


@dataclass(frozen=True, kw_only=True)
class GaitNumbers:
    """Numbers of one whole-body trial; only its layout without valid torques."""

    trial: TrialResult
    layout: Layout
    numbers: tuple[MomentSummary, ...] = ()
    stages: tuple[ResidualMagnitudes, ...] = ()
    """Pelvis residuals with each model; empty where no frame of the whole body is valid."""
    limits: ResidualLimits | None = None  # Requirements of simulations; given where `stages` are
    expected: ExpectedResidual | None = (
        None  # Of the last of `stages`; None where its errors are not known
    )


def compute_gait_numbers(model: SubjectModel, trial: TrialResult) -> GaitNumbers | None:
    """Compute the numbers of a walk; None for a functional trial."""
    if trial.joint is not None:
        return None
    loads = trial.loads
    drawn = make_layout(trial.body, loads.reactions if loads else None, trial.events)
    if loads is None or not loads.reactions.has_torques:
        return GaitNumbers(trial=trial, layout=drawn)
    limits = None
    if loads.residuals:
        limits = compute_residual_limits(
            model.parameters, trial.body.q, loads.reactions, trial.recording.plates
        )
    return GaitNumbers(
        trial=trial,
        layout=drawn,
        numbers=summarise_moments(model, drawn, loads.final, loads.nominal, loads.errors),
        stages=loads.residuals,
        limits=limits,
        expected=loads.expected,
    )


def _collect_walks(model: SubjectModel, trials: Sequence[TrialResult]) -> tuple[GaitNumbers, ...]:
    """Collect the numbers of every walk."""
    return tuple(
        walk for trial in trials if (walk := compute_gait_numbers(model, trial)) is not None
    )


def _find_worst_fit(
    trials: Sequence[TrialResult],
) -> tuple[trial_result.RmsErrors, TrialResult] | None:
    """Find the trial with the largest marker error relative to its floor; walks first."""
    whole = [t for t in trials if t.joint is None] or list(trials)
    fits = [
        (fit, t) for t in whole if (fit := trial_result.summarise_leg_fit(t)).calibrated is not None
    ]
    return max(fits, key=lambda pair: _compute_ratio(pair[0]) or 0.0) if fits else None


def _compute_ratio(fit: trial_result.RmsErrors) -> float | None:
    """Compute the ratio to the joint floor; three markers a segment give a low rigid floor."""
    return fit.ratio if fit.joint_ratio is None else fit.joint_ratio


def _find_largest_residual(walks: Sequence[GaitNumbers]) -> GaitNumbers | None:
    """Find the walk with the largest residual relative to its limit."""
    found = [walk for walk in walks if walk.stages]
    return (
        max(found, key=lambda w: 0.0 if w.expected is None else w.expected.share) if found else None
    )


def build_top_lines(calibration: Calibration, tables: StrideTables) -> list[Line]:
    """Build the three lines on top of the page: verdict, agreement, valid moments."""
    model, trials = calibration.model, calibration.trials
    return [_describe_verdict(calibration), *build_further_lines(model, trials, tables)]


def build_further_lines(
    model: SubjectModel, trials: Sequence[TrialResult], tables: StrideTables
) -> list[Line]:
    """Build the lines on agreement and valid moments of further trials."""
    walks = _collect_walks(model, trials)
    return [_describe_agreement(trials, walks), _describe_valid_moments(walks, tables)]


def _describe_verdict(calibration: Calibration) -> Line:
    verdict = calibration.verdict
    tone, text = TONES[verdict.judgement], f"{verdict.judgement.value.capitalize()}"
    if verdict.reasons:
        worst, others = verdict.reasons[0], len(verdict.reasons) - 1
        where = (
            f" ({', '.join(format_name(trial) for trial in worst.trials)})" if worst.trials else ""
        )
        text += f": {explain_parameters(worst.cause)}{where}" + (
            f", and {format_count(others, 'other reason')}" if others else ""
        )
    text += f". {verdict.sentence}"
    if not calibration.converged:
        tone, text = ("poor", f"Not converged: do not use these numbers. {text}")
    return {"tone": tone, "text": replace_control_characters(text)}


WIDE_LIMITS: Final = "; limits are wide, as trunk and arms have no markers"


def _describe_agreement(trials: Sequence[TrialResult], walks: Sequence[GaitNumbers]) -> Line:
    """Describe the agreement of the model with markers and ground forces."""
    tones, sentences = [], []
    if (worst := _find_worst_fit(trials)) is not None:
        fit, trial = worst
        # The floor is the least marker error that joints, or rigid segments, allow.
        ratio, floor = (
            _compute_ratio(fit),
            fit.floor if fit.joint_ratio is None else fit.joint_floor,
        )
        tones.append("good" if ratio is not None and ratio <= GOOD_RATIO else "plain")
        best = "" if ratio is None else f" (best possible {format_number(floor)})"
        of_trial = "" if trial.joint is None else f" of trial {format_name(trial.name)}"
        sentences.append(f"Marker fit{of_trial} {format_number(fit.calibrated)} mm{best}.")
    if (walk := _find_largest_residual(walks)) is not None:
        last, held = walk.stages[-1], walk.expected
        force, moment, tone, judged = (
            f"{format_number(last.rms_force)} N RMS",
            f"{format_number(last.rms_moment)} N·m",
            "plain",
            "",
        )
        # The limit is the residual that known errors explain at most.
        if held is not None:
            force += f" (limit {format_number(held.force.limit)})"
            moment += f" (limit {format_number(held.moment.limit)})"
            tone, judged = ("good", "") if held.within else ("look", ": too high")
            judged += WIDE_LIMITS if fit_findings.is_trunk_unmeasured(walk.trial.body) else ""
        tones.append(tone)
        sentences.append(f"Residual force at the pelvis: {force}, moment {moment}{judged}.")
    if not sentences:
        return {"tone": "plain", "text": "Nothing was fitted: this study has no moving trial."}
    return {
        "tone": max(tones, key=TONE_ORDER.index),
        "text": replace_control_characters(" ".join(sentences)),
    }


def _describe_valid_moments(walks: Sequence[GaitNumbers], tables: StrideTables) -> Line:
    """Describe strides with valid moments, and the peak knee adduction moments."""
    if not walks:
        return {"tone": "plain", "text": "No walk: joint parameters only."}
    loaded = [walk for walk in walks if walk.numbers]
    if not loaded:
        plates = any(walk.trial.loads is not None for walk in walks)
        why = (
            "no foot is wholly on force plates that carry no other foot"
            if plates
            else "there are no force plates"
        )
        return {"tone": "plain", "text": f"Angles only, no moments: {why}."}
    text = summarise_usable_strides(
        [use for walk in loaded for use in tables.get_uses(walk.trial.name)]
    )
    # The moment that clinics ask for most often; others are in the curves.
    found = [peak for peak in tables.peaks if peak.peak is ADDUCTION_PEAK]
    if both := ", ".join(_format_peak(peak, tables.subject.mass) for peak in found):
        text += (
            " External knee adduction moment, N·m/kg, first peak, mean ± standard error over all "
            "straight strides: "
            f"{both}."
        )
    known = any(
        walk.trial.loads is not None and walk.trial.loads.errors is not None for walk in loaded
    )
    if not known:
        text += " No standard errors are known."
    return {"tone": "plain", "text": text}


def _format_peak(peak: PeakMean, mass: float) -> str:
    """Format a peak: `right 0.42 ± 0.03 (4 of 5 strides)`."""
    error = f" ± {format_number(peak.se / mass, 2)}" if np.isfinite(peak.se) else ""
    count = f"{peak.n} of {format_count(peak.strides, 'stride')}"
    return f"{SIDE_WORDS[peak.side]} {format_number(-peak.mean / mass, 2)}{error} ({count})"


def build_clinician_blocks(
    calibration: Calibration, norm: NormTables, scores: Sequence[Score] = ()
) -> list[Block]:
    """Build the blocks of the whole result: how to read the page, normative data, scores."""
    if all(trial.joint is not None for trial in calibration.trials):
        return []
    walked = any(
        trial.joint is None and trial.activity == cycles.WALKING for trial in calibration.trials
    )
    bands = (
        f"Bands with dotted edges are healthy people, mean ± 1 SD: {norm.label}. "
        if norm.label
        else ""
    )
    out: list[Block] = []
    explanation = bands + norm.remark
    if walked and explanation:
        out.append(make_text(explanation, "soft"))
    if scores:
        out.append(_build_profile(scores))
    how_to_read = [make_text(paragraph) for paragraph in HOW_TO_READ]
    return [*out, fold_blocks("How to read curves and steps", how_to_read)]


def _build_profile(scores: Sequence[Score]) -> Block:
    """Build the Movement Analysis Profile and Gait Profile Scores with normative values."""

    def format_score(score: Score | None) -> str:
        if score is None:
            return ""
        return format_number(score.score) + (
            f" ± {format_number(score.error)}" if np.isfinite(score.error) else ""
        )

    rows = []
    for variable in dict.fromkeys(s.variable for s in scores):
        by_side = {s.side: s for s in scores if s.variable == variable}
        numbers = [make_cell(format_score(by_side.get(side))) for side in (*SIDES, BOTH)]
        one = next(iter(by_side.values()))
        rows.append(
            [make_cell(make_score_title(one)), *numbers, make_cell(format_number(one.norm))]
        )
    head = [
        make_text_column(""),
        *(make_cell(title, unit="deg") for title in ("right", "left", "both", "norm")),
    ]
    caption = (
        "Gait Profile Score: RMS distance from healthy people's mean (Baker 2009), ± standard "
        "error; norm: theirs"
    )
    return make_table(head, rows, caption=caption, total=[len(rows) - 1])


def build_trial_clinician_blocks(walk: GaitNumbers) -> list[Block]:
    """Build the blocks of one walk: sources of its foot events, and why moments are not valid."""
    events, loads = walk.trial.events.events, walk.trial.loads
    out = [make_heading(f"Trial {format_name(walk.trial.name)}")]
    event_text = (
        f"Foot events: {cycles.describe_sources([e.source for e in events])}."
        if events
        else "No foot events."
    )
    repeats = walk.trial.events.repeats
    phases = ", ".join(dict.fromkeys(name for repeat in repeats for name, _ in repeat.parts))
    repeat_text = (
        f"{format_count(len(repeats), 'repetition')}, by the height of the pelvis; "
        f"phases: {phases}."
    )
    out.append(make_text(repeat_text if repeats else event_text))
    if missing := [SIDE_WORDS[side] for side in SIDES if not list_strides(walk.trial.events)[side]]:
        out.append(make_text(f"No complete stride of the {format_list(missing)} foot."))
    if walk.trial.refused_legs:
        legs = format_list([SIDE_WORDS[side] for side in walk.trial.refused_legs])
        out.append(
            make_text(
                f"Refused: {legs}; no moment and no error bar of it counts. See the verdict.", "bad"
            )
        )
    if loads is None:
        return [*out, make_text(NO_FORCES, "soft")]
    if not loads.reactions.has_torques:
        return [*out, make_text(NO_FOOT, "warning")]
    if loads.errors is None:
        out.append(make_text(NO_ERRORS, "soft"))
    return out
