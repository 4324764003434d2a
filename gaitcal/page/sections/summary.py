"""The four questions that a reader has first, answered in plain words from the numbers.

Preset Clinician: what the curves are, which of them count, and from whom the bands are.

What forces and motion of one walk say in numbers: peaks, changes, pelvis residuals and their limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.dynamics.expected_residual import ExpectedResidual, ResidualLimits, ResidualMagnitudes, residual_limits
from gaitcal.gait.cycles import GaitCycle, source_words
from gaitcal.gait.moments import SIDE_WORDS, MomentNumbers, coordinate_title, counted, listed, moment_numbers, moment_of
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.strides import TURNING, Layout, layout, strides_of
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.sections.blocks import Block, fold, heading, named, number, text
from gaitcal.session.parameter_words import counts, counts_sentence
from gaitcal.session.result import Calibration, TrialResult
from gaitcal.session.trial_result import RmsErrors, leg_fit, trial_fit
from gaitcal.session.warnings import is_trunk_unmeasured, unmeasured_words


@dataclass(frozen=True, kw_only=True)
class GaitNumbers:
    """Of one whole-body trial; without valid torques nothing but its layout."""

    trial: TrialResult
    layout: Layout
    numbers: tuple[MomentNumbers, ...] = ()
    stages: tuple[ResidualMagnitudes, ...] = ()
    """Pelvis residuals with each model; empty where no frame of the whole body is valid."""
    limits: ResidualLimits | None = None
    """What is asked of simulations; given where `stages` are."""
    expected: ExpectedResidual | None = None
    """Of the last of `stages`; None where its errors are not known."""

    def valid_frames(self, side: str = "") -> int:
        """Frames in which the torques of a leg (`r`, `l`) are valid, or those of the whole body (nothing)."""
        return int(self.layout.valid_for(side).sum())


def gait_numbers(model: SubjectModel, trial: TrialResult) -> GaitNumbers | None:
    """The numbers of a walk; None of an isolated trial."""
    if trial.joint is not None:
        return None
    loads = trial.loads
    drawn = layout(trial.body, loads.reactions if loads else None, trial.events)
    if loads is None or not loads.reactions.has_torques:
        return GaitNumbers(trial=trial, layout=drawn)
    stages = loads.residuals
    return GaitNumbers(
        trial=trial,
        layout=drawn,
        numbers=moment_numbers(model, drawn, loads.final, loads.nominal, loads.errors),
        stages=stages,
        limits=residual_limits(model.parameters, trial.body.q, loads.reactions, trial.recording.plates)
        if stages
        else None,
        expected=loads.expected,
    )


GOOD_RATIO, FAIR_RATIO = 1.4, 2.0
"""Marker error over what each joint by itself reaches."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One question and its answer."""

    question: str
    value: str
    """The one number, with its unit."""
    text: str
    tone: str
    """`good`, `look`, `poor` or `plain`: also written out, colour is never alone."""
    verdict: str = ""
    trial: str = ""
    """The trial that the number is of; data, not markup."""


def answers(calibration: Calibration, gait: tuple[GaitNumbers, ...]) -> tuple[Answer, ...]:
    """Does it fit, did it matter, do motion and forces agree, what was fitted; those that this result can answer."""
    possible = (_fit(calibration), _change(calibration, gait), _residual(calibration, gait), _parameters(calibration))
    return tuple(answer for answer in possible if answer is not None)


def _fit(calibration: Calibration) -> Answer | None:
    trials = [t for t in calibration.trials if t.joint is None] or list(calibration.trials)
    fits = [(fit, t) for t in trials if (fit := leg_fit(t)).calibrated is not None]
    if not fits:
        return None
    fit, trial = max(fits, key=lambda pair: _ratio(pair[0]) or 0.0)
    whole, where = trial_fit(trial), "of pelvis and legs" if trial.joint is None else "of this joint's segments"
    tone, verdict, meaning = _judge(fit)
    before = "" if fit.nominal is None else f" Before calibration it was {fit.nominal:.1f} mm."
    floor = ""
    if fit.floor is not None and (ratio := _ratio(fit)) is not None:
        floor = f" No model of rigid segments can come below {fit.floor:.1f} mm"
        floor += f", each joint by itself reaches {fit.joint_floor:.1f} mm" if fit.joint_floor is not None else ""
        floor += f"; this is {ratio:.2f} times that. "
    others = ""
    if whole.calibrated is not None and fit.calibrated is not None and whole.calibrated > fit.calibrated + 0.05:
        others = f" With trunk and arms, whose joints are not calibrated: {whole.calibrated:.1f} mm."
    return Answer(
        question="Does the model follow the markers?",
        value=f"{fit.calibrated:.1f} mm",
        text=f"RMS distance between measured and model markers {where}.{before}{floor}{meaning}{others}",
        tone=tone,
        verdict=verdict,
        trial=trial.name,
    )


def _ratio(fit: RmsErrors) -> float | None:
    """Over the joint floor, as three markers a segment make a low rigid floor whatever the joints."""
    return fit.ratio if fit.joint_ratio is None else fit.joint_ratio


def _judge(fit: RmsErrors) -> tuple[str, str, str]:
    """Tone, verdict, and a sentence."""
    worse = fit.nominal is not None and fit.calibrated is not None and fit.calibrated > 1.02 * fit.nominal
    if worse:
        return "poor", "worse than before", "Calibration made this fit worse: look at the trials and the warnings."
    if (ratio := _ratio(fit)) is None:
        return "plain", "", ""
    if ratio <= GOOD_RATIO:
        return "good", "good", "Together the joints explain nearly all that each could explain alone."
    if ratio <= FAIR_RATIO:
        return "look", "fair", "Some error is left that other joint positions, or better markers, could explain."
    return "poor", "poor", "Much error is left that the joints do not explain: look at the segments below."


def _change(calibration: Calibration, gait: tuple[GaitNumbers, ...]) -> Answer | None:
    views = [view for view in gait if view.numbers]
    if not views:
        return None
    view, most = max(((v, n) for v in views for n in v.numbers), key=lambda pair: pair[1].change_bwh)
    text = (
        f"Largest RMS change of a joint moment: {coordinate_title(most.name).lower()}, {most.change:.3f} N·m/kg or "
        f"{most.change_of_peak:.0f} % of its peak."
    )
    loads = view.trial.loads
    if loads is not None and loads.errors is not None:
        error = moment_of(loads.errors, most.name)[loads.reactions.valid_for(most.name)]
        typical = 100.0 * float(np.median(error[np.isfinite(error)])) / calibration.model.subject.bwh
        text += f" The standard error of this moment is {typical:.2f} % of body weight × height (median)."
    return Answer(
        question="Did calibration change the joint moments?",
        value=f"{most.change_bwh:.2f} %BW·H",
        text=text,
        tone="plain",
        trial=view.trial.name,
    )


def _residual(calibration: Calibration, gait: tuple[GaitNumbers, ...]) -> Answer | None:
    views = [view for view in gait if view.stages]
    if not views:
        return None
    view = max(views, key=lambda v: 0.0 if v.expected is None else v.expected.share)
    first, last, held = view.stages[0], view.stages[-1], view.expected
    tone, judged, meaning = "plain", "", "No standard errors are known to hold it against."
    if held is not None:
        tone, judged = ("good", "within its errors") if held.within else ("look", "beyond its errors")
        meaning = (
            f"Its errors let expect {held.force.expected:.1f} N and {held.moment.expected:.1f} N·m, and more than "
            f"{held.force.limit:.1f} N or {held.moment.limit:.1f} N·m in 1 walk of 1000."
        )
    body = view.trial.body
    if is_trunk_unmeasured(body):
        meaning += (
            f" Markers do not determine {unmeasured_words(body, calibration.nominal.nominal)}: how it moves is the "
            "first cause, no inertial parameter was fitted against it, and the moments of the legs do not depend on it."
        )
    return Answer(
        question="Do motion and ground forces agree?",
        value=f"{last.rms_force:.1f} N and {last.rms_moment:.1f} N·m",
        text=f"RMS force and moment at the pelvis that nothing explains, before calibration {first.rms_force:.1f} N "
        f"and {first.rms_moment:.1f} N·m. {meaning}",
        tone=tone,
        verdict=judged,
        trial=view.trial.name,
    )


def _parameters(calibration: Calibration) -> Answer:
    blind = len(calibration.unidentifiable)
    text = counts_sentence(calibration)
    if blind:
        text += f" {counted(blind, 'joint parameter')} could not be determined; see the preset Joints."
    return Answer(
        question="What was calibrated?",
        value=counted(sum(counts(calibration)), "parameter"),
        text=text,
        tone="look" if blind else "plain",
        verdict=f"{blind} not determined" if blind else "",
    )


NO_FORCES = "No joint moments and powers: this trial has no force plates."
NO_FOOT = "No joint moments: in no frame is a foot on the ground wholly on force plates of its own."
NO_ERRORS = "No standard errors of the moments were computed for this result; curves of moments have no bands."
MOST_SPANS = 6
"""Strides whose times are told one by one."""


def clinician_blocks(calibration: Calibration, normal: Bands | None) -> list[Block]:
    """Of the whole result: how to read curves and steps."""
    walks = [trial for trial in calibration.trials if trial.joint is None]
    if not walks:
        return []
    out = []
    sources = tuple(dict.fromkeys(band.source for band in (normal or {}).values() if band.source))
    if sources:
        out.append(text(f"Bands with dotted edges are healthy people, mean ± 1 SD: {'; '.join(sources)}.", "soft"))
    told = [
        text(
            "0 to 100 % of the gait cycle go from a foot strike to the next strike of the same foot, for each foot by "
            "itself. Moments are internal, those of muscles and ligaments, unless the switch says external; the axes "
            "of the curves say what is positive. %BW·H is percent of body weight times body height. The switches do "
            "not change the files."
        ),
        text(
            "Bands about curves are ±1 standard error. A mean over strides has a band of one standard deviation, "
            "which holds measurement errors as well."
        ),
        text(
            f"Steps and phases are mean ± SD over all strides of all walks, each counting the same, also those of "
            "which a recording shows a part; n strides. Strides that turn by more than "
            f"{number(TURNING, 0)} deg are left out, and legs that are refused, with steps and supports beside them. "
            "Lengths are between heels at strikes along the line of the stride, the width across it; the step is the "
            "one that ends with the named foot. Symmetry: 100 (right − left) / mean of both; the width is one of both "
            "feet."
        ),
    ]
    return [*out, fold("How to read curves and steps", told)]


def trial_clinician_blocks(walk: GaitNumbers) -> list[Block]:
    """Of one walk: its strides, and where its moments count."""
    out = [heading(f"Trial {named(walk.trial.name)}"), text(_strides(walk))]
    loads = walk.trial.loads
    if walk.trial.refused_legs:
        legs = listed([SIDE_WORDS[side] for side in walk.trial.refused_legs])
        out.append(text(f"Refused: {legs}; no moment and no error bar of it counts. See the verdict.", "bad"))
    if loads is None:
        return [*out, text(NO_FORCES, "soft")]
    if not loads.reactions.has_torques:
        return [*out, text(NO_FOOT, "warning")]
    out.append(text(_validity(walk)))
    if loads.errors is None:
        out.append(text(NO_ERRORS, "soft"))
    return out


def _strides(walk: GaitNumbers) -> str:
    """Which strides there are, and who told when feet met the ground."""
    events = walk.trial.events
    own = {side: _cycles(walk, side) for side in SIDES}
    start = float(walk.layout.time[0])
    told = []
    for side, cycles in own.items():
        if not cycles:
            told.append(f"no complete stride of the {SIDE_WORDS[side]} foot")
            continue
        spans = [f"{c.start - start:.2f} to {c.stop - start:.2f} s" for c in cycles[:MOST_SPANS]]
        more = f" and {len(cycles) - MOST_SPANS} more" if len(cycles) > MOST_SPANS else ""
        told.append(f"{counted(len(cycles), f'{SIDE_WORDS[side]} stride')} ({', '.join(spans)}{more})")
    words = f"This recording holds {told[0]}, and {told[1]}."
    sources = source_words([event.source for event in events.events])
    return f"{words} Foot events: {sources}." if events.events else words


def _cycles(walk: GaitNumbers, side: str) -> tuple[GaitCycle, ...]:
    return strides_of(walk.trial.events)[side]


def _validity(walk: GaitNumbers) -> str:
    frames = [number(walk.valid_frames(side), 0) for side in ("r", "l", "")]
    words = (
        f"Of {number(len(walk.layout.time), 0)} frames, moments are valid in {frames[0]} of the right leg, {frames[1]} "
        f"of the left leg and {frames[2]} of pelvis, trunk and arms: those of a leg where its own foot is wholly on "
        "plates or in the air, the others where both feet are, away from the ends of the trial."
    )
    complete = {side: complete_strides(walk, side) for side in SIDES}
    if not any(total for _, total in complete.values()):
        return words
    told = [f"{valid} of {total} {SIDE_WORDS[side]}" for side, (valid, total) in complete.items()]
    return f"{words} Strides that are valid throughout: {told[0]}, {told[1]}."


def complete_strides(walk: GaitNumbers, side: str) -> tuple[int, int]:
    """How many strides of a leg have valid moments throughout, and how many there are."""
    time, valid, cycles = walk.layout.time, walk.layout.valid_for(side), _cycles(walk, side)
    inside = [valid[(time >= c.start) & (time <= c.stop)] for c in cycles]
    return sum(bool(frames.size and frames.all()) for frames in inside), len(cycles)
