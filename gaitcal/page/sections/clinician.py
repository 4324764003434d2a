"""Preset Clinician: what the curves are, which of them count, and from whom the bands are."""

from __future__ import annotations

from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.gait_event import source_words
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.progression import TURNING
from gaitcal.gait.strides import strides_of
from gaitcal.gait.words import SIDE_WORDS, counted, listed
from gaitcal.model.linkage import SIDES
from gaitcal.page.sections.blocks import Block, fold, heading, named, number, text
from gaitcal.page.sections.gait_numbers import GaitNumbers
from gaitcal.session.result import Calibration

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
