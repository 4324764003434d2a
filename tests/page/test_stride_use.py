"""Which strides count, on which plate, and why others do not: every reason from the frames that make it."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.gait.strides import strides_of
from gaitcal.page.summary import (
    BESIDE,
    ENDS,
    NO_PLATES,
    NOT_WHOLLY,
    PART,
    REFUSED,
    SEATED,
    UNSEEN,
    stride_uses,
    usable_words,
)  # fmt: skip
from gaitcal.session.result import TrialResult
from tests.fake_result import fake_calibration


@pytest.fixture(scope="module")
def walk() -> TrialResult:
    """Two right strides and one left, every frame of both legs valid, each foot on a plate of its own."""
    trial = next(t for t in fake_calibration().trials if t.joint is None)
    assert trial.loads is not None
    reactions = trial.loads.reactions
    frames = len(trial.body.time)
    steps = (("1", 0, slice(0, frames)), ("2", 1, slice(0, frames)))
    whole = np.ones((frames, 2), dtype=bool)
    return replace(trial, loads=replace(trial.loads, reactions=replace(reactions, steps=steps, valid_legs=whole)))


def spoilt(walk: TrialResult, *, loaded: bool, resting: bool, plate: bool = True) -> TrialResult:
    """The first right stride with frames in its stance that do not count."""
    assert walk.loads is not None
    time, cycle = walk.body.time, strides_of(walk.events)["r"][0]
    bad = (time >= cycle.start + 0.1) & (time < cycle.start + 0.2)
    reactions = walk.loads.reactions
    arrays = {name: getattr(reactions, name).copy() for name in ("valid_legs", "loaded", "resting")}
    arrays["valid_legs"][bad, 0] = False
    arrays["loaded"][bad, 0], arrays["resting"][bad, 0] = loaded, resting
    if not plate:
        arrays["loaded"][:, 0] = False
    moved = replace(reactions, **arrays, steps=reactions.steps if plate else reactions.steps[1:])
    return replace(walk, loads=replace(walk.loads, reactions=moved))


def first(trial: TrialResult) -> tuple[str, bool, str]:
    use = stride_uses(trial)[0]
    assert (use.side, use.number) == ("r", 1)
    return use.plate, use.whole, use.reason


def test_a_stride_of_valid_frames_is_whole(walk: TrialResult) -> None:
    assert [(u.side, u.plate, u.whole, u.reason) for u in stride_uses(walk)] == [
        ("r", "1", True, ""), ("r", "1", True, ""), ("l", "2", True, ""),
    ]  # fmt: skip
    assert usable_words(stride_uses(walk)) == "Usable for moments: 2 of 2 right, 1 of 1 left strides."


def test_every_reason_has_its_frames(walk: TrialResult) -> None:
    near_begin = strides_of(walk.events)["r"][0].start + 0.15 - walk.body.time[0] < 0.3
    air = spoilt(walk, loaded=False, resting=False)
    assert first(spoilt(walk, loaded=True, resting=True)) == ("1", False, NOT_WHOLLY)
    sits = spoilt(walk, loaded=True, resting=True)
    seat = replace(sits.loads.reactions, seated=~sits.loads.reactions.valid_legs[:, 0])
    assert first(replace(sits, loads=replace(sits.loads, reactions=seat))) == ("1", False, SEATED)
    assert first(spoilt(walk, loaded=False, resting=True)) == ("1", False, PART)
    assert first(spoilt(walk, loaded=False, resting=True, plate=False)) == ("", False, BESIDE)
    assert first(air) == ("1", False, ENDS if near_begin else UNSEEN)
    assert first(replace(walk, loads=None)) == ("", False, NO_PLATES)
    assert first(replace(walk, refused_legs=("r",))) == ("1", False, REFUSED)
    assert all(use.whole for use in stride_uses(air)[1:]), "the other strides stay"
    told = usable_words(stride_uses(spoilt(walk, loaded=True, resting=True)))
    mixed = [replace(use, repeats=use.number == 2) for use in stride_uses(walk)]
    assert usable_words(mixed) == "Usable for moments: 2 of 2 right, 1 of 1 left strides and repetitions."
    assert told == f"Usable for moments: 1 of 2 right, 1 of 1 left strides; others: {NOT_WHOLLY}."
