"""What a reader asks first of walks and of the whole result: three lines on top, preset Clinician.

Of complete strides: which have moments throughout, on which plate, and in words why others have
not. A frame of a leg does not count where its foot is down without a plate of its own, or on one
that does not carry the whole of it (`dynamics/ground_reactions.py`). Of a stride that has such
frames the kind that takes most of them is told.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
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
from gaitcal.gait import cycles, normal_bands
from gaitcal.gait.moments import (
    SIDE_WORDS,
    MomentNumbers,
    counted,
    explained,
    listed,
    moment_numbers,
)
from gaitcal.gait.peaks import ADDUCTION_PEAK, PeakMean
from gaitcal.gait.profile_score import BOTH, Score, score_title
from gaitcal.gait.strides import Layout, layout, strides_of, turns
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import Judgement
from gaitcal.report.page.plain_data import (
    Block,
    cell,
    fold,
    heading,
    named,
    number,
    table,
    text,
    visible,
    words_column,
)

REFUSED = "the verdict refuses this leg"
NO_PLATES = "no force plates"
BESIDE = "foot beside the plate"
PART = "part of the stance beside the plate"
SEATED = "on a seat"
NOT_WHOLLY = "foot not wholly on a plate of its own"
ENDS = "at the end of the recording"
UNSEEN = "markers do not show the leg"
# s: frames this near to an end of a trial are lost with the ends of its splines and filters
NEAR_END = 0.3


@dataclass(frozen=True, kw_only=True)
class StrideUse:
    """One complete stride."""

    side: str
    number: int
    plate: str  # Names of the plates that carry the foot in it; empty: none
    whole: bool  # Moments of the leg are valid throughout
    turns: bool  # It turns, and takes no part in means
    reason: str  # Why it is not whole; empty where it is
    repeats: bool = False  # It is no stride, but a repetition of another activity


def stride_uses(trial: TrialResult) -> tuple[StrideUse, ...]:
    """Of every complete stride, right ones first; none of an isolated trial."""
    if trial.joint is not None:
        return ()
    bent = {(s.side, s.number) for s in trial.strides if turns(s.turn)}
    out = []
    for foot, side in enumerate(SIDES):
        for count, cycle in enumerate(strides_of(trial.events)[side], start=1):
            plate, reason = _use(trial, foot, side, cycle)
            turning = (side, count) in bent
            out.append(
                StrideUse(
                    side=side,
                    number=count,
                    plate=plate,
                    whole=not reason,
                    turns=turning,
                    reason=reason,
                    repeats=bool(trial.events.repeats),
                )
            )
    return tuple(out)


def usable_words(uses: Iterable[StrideUse]) -> str:
    """`Usable for moments: 1 of 4 right, 2 of 4 left strides; others: foot beside the plate.`"""
    if not (uses := tuple(uses)):
        return "No complete stride."
    of_sides = {side: [use for use in uses if use.side == side] for side in SIDES}
    counts = (
        f"{sum(u.whole for u in of)} of {len(of)} {SIDE_WORDS[side]}"
        for side, of in of_sides.items()
    )
    reasons = reason_words(uses)
    words = {
        use.repeats: "repetitions" if use.repeats else "strides"
        for use in sorted(uses, key=lambda u: u.repeats)
    }
    what = " and ".join(words.values())
    return (
        f"Usable for moments: {', '.join(counts)} "
        f"{what}{f'; others: {reasons}' if reasons else ''}."
    )


def reason_words(uses: Iterable[StrideUse]) -> str:
    """Why strides are not whole, the most frequent reason first; empty where all are."""
    return listed(
        [reason for reason, _ in Counter(use.reason for use in uses if not use.whole).most_common()]
    )


def _use(trial: TrialResult, foot: int, side: str, cycle: cycles.GaitCycle) -> tuple[str, str]:
    """Plates and reason of one stride."""
    if trial.loads is None:
        return "", NO_PLATES
    time, found = trial.body.time, trial.loads.reactions
    inside = (time >= cycle.start) & (time <= cycle.stop)
    stance = inside & (time < (cycle.toe_off or cycle.stop))
    plates = dict.fromkeys(
        name for name, of, frames in found.steps if of == foot and stance[frames].any()
    )
    words = ", ".join(plates)
    lost = inside & ~found.valid_legs[:, foot]
    if side in trial.refused_legs:
        return words, REFUSED
    if not lost.any():
        return words, ""
    loaded, resting = found.loaded[:, foot], found.resting[:, foot]
    near_end = (time < time[0] + NEAR_END) | (time > time[-1] - NEAR_END)
    if trial.events.repeats and not (lost & ~near_end).any():
        return words, ENDS
    beside = PART if (loaded & stance).any() else BESIDE
    seated = lost & (np.False_ if found.seated is None else found.seated)
    kinds = {
        SEATED: seated,
        beside: lost & resting & ~loaded & ~seated,
        NOT_WHOLLY: lost & loaded & ~seated,
    }
    rest = lost & ~loaded & ~resting & ~seated
    kinds |= {ENDS: rest & near_end, UNSEEN: rest & ~near_end}
    return words, max(kinds, key=lambda kind: int(np.count_nonzero(kinds[kind])))


KNEE_ADDUCTION = "knee_adduction"
"""The moment that is told in full; external adduction is the opposite of the internal moment."""
GOOD_RATIO = 1.4
"""Marker error over what each joint by itself reaches: up to this it is told to be good. What is
larger is not judged here: an amber or red line is a reason of the verdict."""
TONES = {Judgement.TRUSTWORTHY: "good", Judgement.DOUBTFUL: "look", Judgement.REFUSED: "poor"}
TONE_ORDER = ("plain", "good", "look", "poor")
NO_FORCES = "No joint moments and powers: this trial has no force plates."
NO_FOOT = "No joint moments: in no frame is a foot on the ground wholly on force plates of its own."
NO_ERRORS = (
    "No standard errors of the moments were computed for this result; curves of moments have no "
    "bands."
)
HOW_TO_READ = (
    "0 to 100 % of the gait cycle go from a foot strike to the next strike of the same foot, for "
    "each foot by "
    "itself. Moments are internal, those of muscles and ligaments, unless the switch says "
    "external; the axes "
    "of the curves say what is positive. %BW·H is percent of body weight times body height. The "
    "switches do "
    "not change the files.",
    "Bands about curves are ±1 standard error. A mean over strides has a band of one standard "
    "deviation, "
    "which holds measurement errors as well.",
)
Line = dict[str, str]  # `tone`: `good`, `look`, `poor` or `plain`; `text`


@dataclass(frozen=True, kw_only=True)
class GaitNumbers:
    """Of one whole-body trial; without valid torques nothing but its layout."""

    trial: TrialResult
    layout: Layout
    numbers: tuple[MomentNumbers, ...] = ()
    stages: tuple[ResidualMagnitudes, ...] = ()
    """Pelvis residuals with each model; empty where no frame of the whole body is valid."""
    limits: ResidualLimits | None = None  # What is asked of simulations; given where `stages` are
    expected: ExpectedResidual | None = (
        None  # Of the last of `stages`; None where its errors are not known
    )


def gait_numbers(model: SubjectModel, trial: TrialResult) -> GaitNumbers | None:
    """The numbers of a walk; None of an isolated trial."""
    if trial.joint is not None:
        return None
    loads = trial.loads
    drawn = layout(trial.body, loads.reactions if loads else None, trial.events)
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
        numbers=moment_numbers(model, drawn, loads.final, loads.nominal, loads.errors),
        stages=loads.residuals,
        limits=limits,
        expected=loads.expected,
    )


def walks_of(model: SubjectModel, trials: Sequence[TrialResult]) -> tuple[GaitNumbers, ...]:
    """The numbers of every walk."""
    return tuple(walk for trial in trials if (walk := gait_numbers(model, trial)) is not None)


def _worst_fit(trials: Sequence[TrialResult]) -> tuple[trial_result.RmsErrors, TrialResult] | None:
    """Of the walk, or other trial, that is met worst against what its joints, or rigid segments,
    could reach.
    """
    whole = [t for t in trials if t.joint is None] or list(trials)
    fits = [(fit, t) for t in whole if (fit := trial_result.leg_fit(t)).calibrated is not None]
    return max(fits, key=lambda pair: _ratio(pair[0]) or 0.0) if fits else None


def _ratio(fit: trial_result.RmsErrors) -> float | None:
    """Over the joint floor, as three markers a segment make a low rigid floor whatever the joints."""
    return fit.ratio if fit.joint_ratio is None else fit.joint_ratio


def _largest_residual(walks: Sequence[GaitNumbers]) -> GaitNumbers | None:
    """The walk whose residual is largest against its limit."""
    found = [walk for walk in walks if walk.stages]
    return (
        max(found, key=lambda w: 0.0 if w.expected is None else w.expected.share) if found else None
    )


def top_lines(calibration: Calibration, peaks: Sequence[PeakMean]) -> list[Line]:
    """The three lines at the top of the page: can it be believed, does it fit, and what of the
    moments counts.

    `peaks`: of the straight strides (`gait/peaks.py`), moments in N·m.
    """
    model, trials = calibration.model, calibration.trials
    return [_believed(calibration), *further_lines(model, trials, peaks)]


def further_lines(
    model: SubjectModel, trials: Sequence[TrialResult], peaks: Sequence[PeakMean]
) -> list[Line]:
    """How these trials agree with the model, and what of their moments counts: below the line of
    the verdict.
    """
    walks = walks_of(model, trials)
    return [_agreement(trials, walks), _counting(model.subject.mass, walks, peaks)]


def _believed(calibration: Calibration) -> Line:
    verdict = calibration.verdict
    tone, words = TONES[verdict.judgement], f"{verdict.judgement.value.capitalize()}"
    if verdict.reasons:
        worst, rest = verdict.reasons[0], len(verdict.reasons) - 1
        where = f" ({', '.join(named(trial) for trial in worst.trials)})" if worst.trials else ""
        words += f": {explained(worst.cause)}{where}" + (
            f", and {counted(rest, 'other reason')}" if rest else ""
        )
    words += f". {verdict.sentence}"
    if not calibration.converged:
        tone, words = (
            "poor",
            f"Not converged: do not use these numbers before that is settled. {words}",
        )
    return {"tone": tone, "text": visible(words)}


WIDE_LIMITS: Final = "; limits are wide, as no marker tells how trunk and arms move"


def _agreement(trials: Sequence[TrialResult], walks: Sequence[GaitNumbers]) -> Line:
    """How near the model is to the markers of these trials, and to the forces of these walks."""
    tones, words = [], []
    if (worst := _worst_fit(trials)) is not None:
        fit, trial = worst
        ratio, floor = _ratio(fit), fit.floor if fit.joint_ratio is None else fit.joint_floor
        tones.append("good" if ratio is not None and ratio <= GOOD_RATIO else "plain")
        best = "" if ratio is None else f" (best possible {number(floor)})"
        of = "" if trial.joint is None else f" of trial {named(trial.name)}"
        words.append(f"Marker fit{of} {number(fit.calibrated)} mm{best}.")
    if (walk := _largest_residual(walks)) is not None:
        last, held = walk.stages[-1], walk.expected
        force, moment, tone, judged = (
            f"{number(last.rms_force)} N RMS",
            f"{number(last.rms_moment)} N·m",
            "plain",
            "",
        )
        if held is not None:
            force += f" (limit {number(held.force.limit)})"
            moment += f" (limit {number(held.moment.limit)})"
            tone, judged = ("good", "") if held.within else ("look", ": too high")
            judged += WIDE_LIMITS if fit_findings.is_trunk_unmeasured(walk.trial.body) else ""
        tones.append(tone)
        words.append(f"Unexplained force at the pelvis: {force}, moment {moment}{judged}.")
    if not words:
        return {"tone": "plain", "text": "Nothing was fitted: this study has no moving trial."}
    return {"tone": max(tones, key=TONE_ORDER.index), "text": visible(" ".join(words))}


def _counting(mass: float, walks: Sequence[GaitNumbers], peaks: Sequence[PeakMean]) -> Line:
    """Strides with valid moments, and the peak knee adduction moment of each leg. `mass`: kg."""
    if not walks:
        return {"tone": "plain", "text": "No walk: joint parameters alone."}
    loaded = [walk for walk in walks if walk.numbers]
    if not loaded:
        plates = any(walk.trial.loads is not None for walk in walks)
        why = (
            "no foot is wholly on a force plate of its own"
            if plates
            else "there are no force plates"
        )
        return {"tone": "plain", "text": f"Angles alone count, no moments: {why}."}
    words = usable_words([use for walk in loaded for use in stride_uses(walk.trial)])
    if both := ", ".join(_peak(peak, mass) for peak in peaks if peak.peak is ADDUCTION_PEAK):
        words += (
            " External knee adduction moment, N·m/kg, first peak, mean ± standard error over all "
            "straight strides: "
            f"{both}."
        )
    known = any(
        walk.trial.loads is not None and walk.trial.loads.errors is not None for walk in loaded
    )
    if not known:
        words += " No standard errors are known."
    return {"tone": "plain", "text": words}


def _peak(peak: PeakMean, mass: float) -> str:
    """`right 0.42 ± 0.03 (4 of 5 strides)`."""
    error = f" ± {number(peak.se / mass, 2)}" if np.isfinite(peak.se) else ""
    of = f"{peak.n} of {counted(peak.strides, 'stride')}"
    return f"{SIDE_WORDS[peak.side]} {number(-peak.mean / mass, 2)}{error} ({of})"


def clinician_blocks(
    calibration: Calibration, norm: normal_bands.Norm, scores: Sequence[Score] = ()
) -> list[Block]:
    """Of the whole result: how to read curves and steps, and from whom the bands are."""
    if all(trial.joint is not None for trial in calibration.trials):
        return []
    walked = any(
        trial.joint is None and trial.activity == cycles.WALKING for trial in calibration.trials
    )
    bands = (
        f"Bands with dotted edges are healthy people, mean ± 1 SD: {norm.words}. "
        if norm.words
        else ""
    )
    return [
        *([text(words, "soft")] if walked and (words := bands + norm.remark) else []),
        *([_profile(scores)] if scores else []),
        fold("How to read curves and steps", [text(words) for words in HOW_TO_READ]),
    ]


def _profile(scores: Sequence[Score]) -> Block:
    """Movement Analysis Profile and Gait Profile Score of both sides, beside healthy people's."""

    def told(score: Score | None) -> str:
        if score is None:
            return ""
        return number(score.score) + (
            f" ± {number(score.error)}" if np.isfinite(score.error) else ""
        )

    rows = []
    for variable in dict.fromkeys(s.variable for s in scores):
        of = {s.side: s for s in scores if s.variable == variable}
        numbers = [cell(told(of.get(side))) for side in (*SIDES, BOTH)]
        one = next(iter(of.values()))
        rows.append([cell(score_title(one)), *numbers, cell(number(one.norm))])
    head = [
        words_column(""),
        *(cell(words, unit="deg") for words in ("right", "left", "both", "norm")),
    ]
    caption = (
        "Gait Profile Score: RMS distance from healthy people's mean (Baker 2009), ± standard "
        "error; norm: theirs"
    )
    return table(head, rows, caption=caption, total=[len(rows) - 1])


def trial_clinician_blocks(walk: GaitNumbers) -> list[Block]:
    """Of one walk: what tells its foot events, and why moments do not count."""
    events, loads = walk.trial.events.events, walk.trial.loads
    out = [heading(f"Trial {named(walk.trial.name)}")]
    seen = (
        f"Foot events: {cycles.source_words([e.source for e in events])}."
        if events
        else "No foot events."
    )
    repeats = walk.trial.events.repeats
    phases = ", ".join(dict.fromkeys(name for repeat in repeats for name, _ in repeat.parts))
    found = f"{counted(len(repeats), 'repetition')}, by the height of the pelvis; phases: {phases}."
    out.append(text(found if repeats else seen))
    if without := [SIDE_WORDS[side] for side in SIDES if not strides_of(walk.trial.events)[side]]:
        out.append(text(f"No complete stride of the {listed(without)} foot."))
    if walk.trial.refused_legs:
        legs = listed([SIDE_WORDS[side] for side in walk.trial.refused_legs])
        out.append(
            text(
                f"Refused: {legs}; no moment and no error bar of it counts. See the verdict.", "bad"
            )
        )
    if loads is None:
        return [*out, text(NO_FORCES, "soft")]
    if not loads.reactions.has_torques:
        return [*out, text(NO_FOOT, "warning")]
    if loads.errors is None:
        out.append(text(NO_ERRORS, "soft"))
    return out
