"""What a file says beside its samples, as comment lines of a CSV table, so that a converted C3D file says it still.

    #: mass = 66.5                                 kg, m, rad, as in `metadata.Facts`; without name and doubts
    #: knee_width = {"r": 0.105, "l": 0.107}       values as JSON writes them
    #: event = [1.23, "r", "foot strike"]          s

Computed points are columns of the table itself: `computed:RKNE_x`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.recording.labels import axes_points
from gaitcal.recording.metadata import ComputedPoints, Facts, FootEvent, FootMoment
from gaitcal.recording.recording import Recording

MARK: Final = "#: "
COMPUTED: Final = "computed:"
EVENT: Final = "event"
_NAMES: Final = tuple(f.name for f in fields(Facts) if f.name not in ("name", "doubtful"))
_MOMENTS: Final = {moment.value: moment for moment in FootMoment}


def told_lines(recording: Recording) -> list[str]:
    """Comment lines that `told_by` reads back to the same numbers."""
    told = {name: getattr(recording.facts, name) for name in _NAMES}
    lines = [f"{MARK}{name} = {json.dumps(value)}" for name, value in told.items() if value not in (None, {})]
    events = ([e.time, e.side, e.moment.value] for e in recording.events)
    return lines + [f"{MARK}{EVENT} = {json.dumps(event)}" for event in events]


def told_by(lines: Iterable[str], path: Path) -> tuple[Facts, tuple[FootEvent, ...]]:
    """Facts and events of the comment lines before a table; InputError for one that says neither."""
    facts: dict[str, Any] = {}
    events: list[FootEvent] = []
    for line in lines:
        if not line.startswith(MARK):
            continue
        try:
            name, _, text = line.removeprefix(MARK).partition(" = ")
            value = json.loads(text)
            if name == EVENT:
                time, side, moment = value
                events.append(FootEvent(_MOMENTS[moment], {"r": "r", "l": "l"}[side], _number(time)))
            else:
                facts[name] = _checked(name, value)
        except (ValueError, TypeError, KeyError, RecursionError):
            allowed = ", ".join((*_NAMES, EVENT))
            raise InputError(
                f"found '{line[:60]}'; allowed after '#:': {allowed}", source=path, code=Code.FILE_FORMAT
            ) from None
    return Facts(**facts), tuple(sorted(events, key=lambda e: e.time))


def computed_kept(computed: ComputedPoints | None) -> tuple[str, ...]:
    """Labels of the computed points that a table takes: all but the four of each segment's axes."""
    if computed is None:
        return ()
    left_out = axes_points(computed.labels)
    return tuple(label for label in computed.labels if label not in left_out)


def _checked(name: str, value: Any) -> Any:
    """A fact of the right kind; ValueError or KeyError else."""
    if name not in _NAMES:
        raise KeyError(name)
    if name == "marker_set":
        return str(value)
    if name == "is_static":
        return bool(value)
    if isinstance(value, dict):
        if not set(value) <= {"r", "l"}:
            raise ValueError(name)
        return {side: _number(number) for side, number in value.items()}
    return _number(value)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(value)
    return float(value)
