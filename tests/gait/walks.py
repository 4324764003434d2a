"""The events of a made-up walk: both feet, half a stride apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaitcal.io.labels import FootEvent, FootMoment

STRIDE, STANCE = 1.1, 0.66
"""s."""
TIME = np.arange(2.0, 6.0, 0.01)
"""s, of its frames: the recording was cut out of a longer one."""


def walk(begin: float = 2.0, end: float = 6.0, step: float = 0.53) -> list[FootEvent]:
    """All events from `begin` to `end` (s); the left foot strikes `step` (s) after the right."""
    events = []
    for stride in range(-2, 10):
        for side, first in (("r", 2.2), ("l", 2.2 + step)):
            strike = first + stride * STRIDE
            events += [FootEvent(FootMoment.STRIKE, side, strike), FootEvent(FootMoment.OFF, side, strike + STANCE)]
    return sorted((e for e in events if begin <= e.time <= end), key=lambda e: e.time)


def moved(events: Sequence[FootEvent], offset: float, jitter: float = 0.0, seed: int = 0) -> list[FootEvent]:
    """The same, later by `offset` and by as much at random as `jitter` (s), by three times that at most."""
    noise = np.random.default_rng(seed).normal(0.0, jitter, len(events)) if jitter else np.zeros(len(events))
    noise = np.clip(noise, -3.0 * jitter, 3.0 * jitter)
    return [replace(e, time=e.time + offset + float(n)) for e, n in zip(events, noise, strict=True)]


def exchanged(events: Sequence[FootEvent]) -> list[FootEvent]:
    """The same with the sides exchanged."""
    return [replace(e, side={"r": "l", "l": "r"}[e.side]) for e in events]
