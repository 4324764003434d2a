"""The four questions that a reader has first, answered in plain words from the numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.gait.moments import moment_of
from gaitcal.gait.words import coordinate_title, counted
from gaitcal.page.sections.gait_numbers import GaitNumbers
from gaitcal.session.marker_fit import RmsErrors, leg_fit, trial_fit
from gaitcal.session.parameter_words import counts, counts_sentence
from gaitcal.session.result import Calibration
from gaitcal.session.unmeasured import is_trunk_unmeasured, unmeasured_words

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
