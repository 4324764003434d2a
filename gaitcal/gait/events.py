"""When the feet of a trial meet and leave the ground, each moment with its source.

The file's own events come first, where they fit (`gait/event_clock.py`); where it has none, the moments at which a
plate becomes loaded or unloaded; away from plates the motion (`gait/swing.py`). What the motion alone tells is moved by
the median difference to the events that are known better, so that all of a foot mean the same.

A plate that becomes loaded while the foot is long down, or unloaded long before the foot leaves, was entered or left
by a foot that rolls over its edge: that is no event of the foot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions, foot_points, has_feet
from gaitcal.findings import Finding
from gaitcal.gait.cycles import FootEvents, steady
from gaitcal.gait.event_clock import SAME_EVENT, checked_events, order_findings
from gaitcal.gait.gait_event import EventSource, GaitEvent
from gaitcal.gait.swing import OFF, STRIKE, swing_events
from gaitcal.io.force_plate import LOADED_N
from gaitcal.io.intervals import runs
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion

SIDES = ("r", "l")
PLATE_AGREES = 0.1
"""s between a plate's loading and the motion's strike: more, and the foot came onto the plate otherwise."""
UNSEEN = 0.2
"""s at either end of a trial, where the swing before a strike or after an off is not in the recording."""


@dataclass(frozen=True)
class TrialEvents:
    """The events of one trial, and what speaks against those of its file."""

    events: tuple[GaitEvent, ...] = ()
    """In order of time."""
    findings: tuple[Finding, ...] = ()
    """Without the name of the trial."""

    def of(self, side: str) -> FootEvents:
        """Strikes and offs of one foot."""
        strikes = [e for e in self.events if e.side == side and e.moment is FootMoment.STRIKE]
        offs = [e.time for e in self.events if e.side == side and e.moment is FootMoment.OFF]
        return FootEvents(np.array([e.time for e in strikes]), np.array(offs), tuple(e.source for e in strikes))


def trial_events(
    model: SubjectModel, motion: Motion, reactions: GroundReactions | None, recording: Recording
) -> TrialEvents:
    """Foot strikes and offs of a whole-body motion, each with its source.

    Parameters
    ----------
    model : its heel and toe landmarks are needed for events of the motion; without them there are none.
    reactions : None without force plates.
    recording : of the same trial; its file's events, and its plates, which tell the moment between frames.
    """
    time = motion.time
    by_motion = _by_motion(model, motion)
    by_plates = [] if reactions is None else plate_events(time, reactions.loaded, recording.plates)
    return joined_events(time, recording.events, by_plates, by_motion)


def joined_events(
    time: Array, file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> TrialEvents:
    """The events of three sources as one list; `time` (nf,) s of the trial's frames."""
    plates = _steps(plates, motion, time)
    used, findings = checked_events(file, plates, motion, time)
    events: list[GaitEvent] = []
    for side in SIDES:
        for moment in FootMoment:
            known = [GaitEvent(moment, side, t, EventSource.FILE) for t in times_of(used, side, moment)]
            known += _further(known, times_of(plates, side, moment), EventSource.PLATES, moment, side)
            alone = times_of(motion, side, moment)
            shift = _median_difference([e.time for e in known], alone)
            alone = [t + shift for t in alone if time[0] <= t + shift <= time[-1]]
            events += known + _further(known, alone, EventSource.MOTION, moment, side)
    joined = TrialEvents(tuple(sorted(events, key=lambda e: e.time)), findings)
    return replace(joined, findings=(*findings, *order_findings({side: joined.of(side) for side in SIDES})))


def times_of(events: Sequence[FootEvent], side: str, moment: FootMoment) -> list[float]:
    """Times (s) of the events of one kind."""
    return [e.time for e in events if e.side == side and e.moment is moment]


def _further(
    known: list[GaitEvent], times: Sequence[float], source: EventSource, moment: FootMoment, side: str
) -> list[GaitEvent]:
    """Events at those `times` that no known event means."""
    new = [t for t in times if all(abs(t - e.time) >= SAME_EVENT for e in known)]
    return [GaitEvent(moment, side, t, source) for t in new]


def _median_difference(known: Sequence[float], other: Sequence[float]) -> float:
    """Time (s) by which known events come after the others' of the same step; 0 where none is known."""
    pairs = [min((k - t for k in known), key=abs) for t in other] if known else []
    near = [d for d in pairs if abs(d) < SAME_EVENT]
    return float(np.median(near)) if near else 0.0


def _by_motion(model: SubjectModel, motion: Motion) -> list[FootEvent]:
    if not has_feet(model):
        return []
    feet = foot_points(model, motion, model.parameters)
    return motion_events(motion.time, np.minimum(feet.heel_speed, feet.toe_speed))


def motion_events(time: Array, slower: Array, strike: float = STRIKE, off: float = OFF) -> list[FootEvent]:
    """Events of both feet from the speed (nf, 2) m/s of the slower end of each: order right, left."""
    events = []
    for foot, side in enumerate(SIDES):
        strikes, offs = swing_events(time, slower[:, foot], strike, off)
        events += [FootEvent(FootMoment.STRIKE, side, t) for t in strikes.tolist()]
        events += [FootEvent(FootMoment.OFF, side, t) for t in offs.tolist()]
    return events


def plate_events(time: Array, loaded: BoolArray, plates: Sequence[ForcePlate]) -> list[FootEvent]:
    """Where the plates under a foot become loaded and unloaded; `loaded` (nf, 2)."""
    events = []
    for foot, side in enumerate(SIDES):
        for run in runs(steady(time, loaded[:, foot])):
            if run.start > 0:
                moment = _passing(plates, float(time[run.start - 1]), float(time[run.start]), rising=True)
                events.append(FootEvent(FootMoment.STRIKE, side, moment))
            if run.stop < len(time):
                moment = _passing(plates, float(time[run.stop - 1]), float(time[run.stop]), rising=False)
                events.append(FootEvent(FootMoment.OFF, side, moment))
    return events


def _passing(plates: Sequence[ForcePlate], begin: float, end: float, *, rising: bool) -> float:
    """When a plate's vertical force passes `LOADED_N` between two frames; the loaded frame where no sample tells."""
    for plate in plates:
        near = (plate.time >= begin - 1e-9) & (plate.time <= end + 1e-9)
        pressed = np.nan_to_num(plate.force[near, 1]) > LOADED_N
        if len(pressed) > 1 and pressed[0] != pressed[-1] and bool(pressed[-1]) is rising:
            return float(plate.time[near][np.flatnonzero(pressed)[0 if rising else -1]])
    return end if rising else begin


def _steps(plates: Sequence[FootEvent], motion: Sequence[FootEvent], time: Array) -> list[FootEvent]:
    """Events of plates that are events of the foot: the motion has the same, or shows nothing of that foot there."""
    kept = []
    for event in plates:
        of_foot = times_of(motion, event.side, event.moment)
        unseen = not of_foot or event.time < time[0] + UNSEEN or event.time > time[-1] - UNSEEN
        if unseen or min(abs(t - event.time) for t in of_foot) <= PLATE_AGREES:
            kept.append(event)
    return kept
