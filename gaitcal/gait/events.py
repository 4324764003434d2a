"""Foot events of a trial, each with its source, and repetitions of activities that are no gait.

Sources in order of precedence: the file's events, where they agree with forces and motion
(`gait/event_checks.py`); times at which a force plate becomes loaded or unloaded; the motion of the
feet. Events of the motion are shifted by their median difference to the better-known ones, so that
all events of a foot have one meaning. A plate that becomes loaded long after the foot has come
down, or unloaded long before it leaves, was entered or left by a rolling foot: no event of the
foot.

By motion alone, with the speeds of heel and toe against the ground (of a treadmill, its belt),

    s(t) = min(|v_heel|, |v_toe|)
    a swing is a peak p of s;  off: s rises through OFF p before it;
    strike: s falls through STRIKE p after it.

The speed of heel and toe is from Ghoussayni, Stevens, Durham & Ewins (Gait & Posture 2004),
thresholds relative to speed are from Bruening & Ridge (Gait & Posture 2014), who took the walking
speed. Both hold for any direction of walking, in turns, and where a foot lands on its toes. Where
the heel is furthest in front of the pelvis (Zeni, Richards & Higginson 2008) it still moves with
the pelvis, 20 to 60 ms before the contact. The thresholds are at the median of laboratories of the
time at which vertical forces pass 20 N (`python -m scripts.validation events STUDY`). A foot that
drags slides before and after its contact: its strike comes late, its off early.

An activity in which the feet strike in turn has strides. In any other one, the repetitions are
those of the pelvis between two rests: with its height h(t) and rate h'(t),

    still        |h'| < `STILL` of its largest value, or h' changes sign
    rest         still, and h within `NEAR` of the range of h from the first still frame
    repetition   from a rest to the next, with h beyond `FAR` of the range in between.

So one squat is from standing to standing, one sit-to-stand from sitting to sitting where the person
sits first, one jump from standing to standing. A movement that ends elsewhere (standing up once, a
drop from a box) is one repetition, from the first rest to the last level of the pelvis. A pelvis
that keeps its height has no repetition.

A repetition consists of flight and of phases on the ground. Each stretch on the ground is split at
its lowest or highest h, where that is beyond both its ends by more than `NEAR` of the range:

    lowering, rising   h falls, rises     (squat: descent, ascent; sit-to-stand: rising, lowering)
    push-off           h rises, and flight follows
    flight             h'' < -`FALLING` g; from the last off to the first strike, where known
    landing            h falls after flight
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_reactions import GroundReactions, compute_foot_points, has_feet
from gaitcal.errors import Finding
from gaitcal.gait.cycles import EventSource, FootEvents, GaitCycle, GaitEvent, remove_flicker
from gaitcal.gait.event_checks import (
    SAME_EVENT,
    check_corrected_events,
    check_event_order,
    check_file_events,
)
from gaitcal.io.force_plate import LOADED_N, find_covered_frames
from gaitcal.io.labels import FootEvent, FootMoment, select_event_times
from gaitcal.io.recording import ForcePlate, Recording, find_runs
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.tracking.motion import Motion

PLATE_AGREES = 0.1
"""s between the loading of a plate and the strike of the motion: with more, the foot did not come
down on the plate.
"""
UNRECORDED_SWING_S = 0.2
"""s at both ends of a trial, where the swing before a strike or after an off is not recorded."""
STRIKE: Final = 0.10
"""Threshold of a strike, relative to the peak of the swing."""
OFF: Final = 0.25
"""Threshold of an off, relative to the peak of the swing."""
SLOWEST_SWING: Final = 0.25
"""m/s: a foot that is never faster does not swing."""
SMALLEST_SWING: Final = 0.12
"""Of the trial's fastest swing: a lower peak is a shuffle on the spot."""
DIP: Final = 0.7
"""Of the peak, decrease of speed on both sides of a swing: less is a dip within one swing."""
LEAST_TRAVEL: Final = 0.1
"""m, path of the slower end of the foot in a swing, as far as it is recorded: less is no step."""


@dataclass(frozen=True)
class GaitEvents:
    """Events of one trial, and findings on those of its file."""

    events: tuple[GaitEvent, ...] = ()
    """In order of time."""
    findings: tuple[Finding, ...] = ()
    """Without the name of the trial."""
    repeats: tuple[GaitCycle, ...] = ()
    """Repetitions of an activity that is no gait, instead of strides."""

    def select_foot(self, side: str) -> FootEvents:
        """Select strikes and offs of one foot.

        Parameters
        ----------
        side : {"r", "l"}
            Foot.

        Returns
        -------
        FootEvents
        """
        strikes = [e for e in self.events if e.side == side and e.moment is FootMoment.STRIKE]
        times = np.array([e.time for e in strikes])
        offs = np.array(select_event_times(self.events, side, FootMoment.OFF))
        return FootEvents(times, offs, tuple(e.source for e in strikes))


def find_trial_events(
    model: SubjectModel, motion: Motion, reactions: GroundReactions | None, recording: Recording
) -> GaitEvents:
    """Find foot strikes and offs of a whole-body motion, each with its source.

    Parameters
    ----------
    model : SubjectModel
        Without heel and toe landmarks there are no events of the motion.
    motion : Motion
        Motion of the whole body.
    reactions : GroundReactions or None
        Forces under the feet; None without force plates.
    recording : Recording
        Recording of the trial: events of its file, and plates with their samples.

    Returns
    -------
    GaitEvents
    """
    by_motion: list[FootEvent] = []
    if has_feet(model):
        feet = compute_foot_points(model, motion, model.parameters)
        by_motion = find_motion_events(motion.time, np.minimum(feet.heel_speed, feet.toe_speed))
    by_plates: list[FootEvent] = []
    if reactions is not None:
        by_plates = find_plate_events(motion.time, reactions.loaded, recording.plates)
    if recording.corrected:
        confirmed = _select_confirmed_plate_events(by_plates, by_motion, motion.time)
        return use_corrected_events(motion.time, recording.events, [*confirmed, *by_motion])
    return combine_events(motion.time, recording.events, by_plates, by_motion)


def find_activity_events(motion: Motion, found: GaitEvents) -> GaitEvents:
    """Find the events of any activity: strides, or else repetitions of the pelvis.

    Parameters
    ----------
    motion : Motion
        Motion of the whole body.
    found : GaitEvents
        Events of its feet.

    Returns
    -------
    GaitEvents
        `found` where the feet strike in turn, else repetitions only.
    """
    feet = [found.select_foot(side) for side in SIDES]
    if is_alternating(*feet):
        return found
    return GaitEvents(
        repeats=find_repetitions(
            motion.time, motion.q[:, motion.coordinates.index("pelvis_ty")], feet
        )
    )


def use_corrected_events(
    time: Array, events: Sequence[FootEvent], shown: Sequence[FootEvent]
) -> GaitEvents:
    """Use the events that a person corrected, inside the trial, and report differences.

    `time`: (nf,) s, frames of the trial. `shown`: events of plates and motion, to compare with.
    """
    inside = [e for e in events if time[0] - 1e-3 <= e.time <= time[-1] + 1e-3]
    found = GaitEvents(
        tuple(GaitEvent(e.moment, e.side, e.time, EventSource.PERSON) for e in inside)
    )
    orders = check_event_order({side: found.select_foot(side) for side in SIDES})
    return replace(found, findings=(*check_corrected_events(inside, shown, time), *orders))


def combine_events(
    time: Array, file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> GaitEvents:
    """Combine the events of file, plates and motion, each from the best source.

    `time`: (nf,) s, frames of the trial. Returns: in order of time, with findings on the file's
    events and on missing ones.
    """
    plates = _select_confirmed_plate_events(plates, motion, time)
    used, findings = check_file_events(file, plates, motion, time)
    events: list[GaitEvent] = []
    for side in SIDES:
        for moment in FootMoment:
            known = [
                GaitEvent(moment, side, t, EventSource.FILE)
                for t in select_event_times(used, side, moment)
            ]
            by_plates = select_event_times(plates, side, moment)
            known += _select_further_events(known, by_plates, EventSource.PLATES, moment, side)
            # Events of the motion get the meaning of the better-known ones.
            times = select_event_times(motion, side, moment)
            shift = _compute_median_difference([e.time for e in known], times)
            times = [t + shift for t in times if time[0] <= t + shift <= time[-1]]
            events += known + _select_further_events(known, times, EventSource.MOTION, moment, side)
    combined = GaitEvents(tuple(sorted(events, key=lambda e: e.time)), findings)
    order = check_event_order({side: combined.select_foot(side) for side in SIDES})
    return replace(combined, findings=(*findings, *order))


def _select_confirmed_plate_events(
    plates: Sequence[FootEvent], motion: Sequence[FootEvent], time: Array
) -> list[FootEvent]:
    """Select plate events that the motion confirms, or cannot show."""

    def is_confirmed(event: FootEvent) -> bool:
        times = select_event_times(motion, event.side, event.moment)
        if (
            not times
            or event.time < time[0] + UNRECORDED_SWING_S
            or event.time > time[-1] - UNRECORDED_SWING_S
        ):
            return True
        return min(abs(t - event.time) for t in times) <= PLATE_AGREES

    return [event for event in plates if is_confirmed(event)]


def _select_further_events(
    known: list[GaitEvent],
    times: Sequence[float],
    source: EventSource,
    moment: FootMoment,
    side: str,
) -> list[GaitEvent]:
    """Make events at those times that are no event known already."""
    out = []
    for time in times:
        if not any(abs(time - e.time) < SAME_EVENT for e in known):
            out.append(GaitEvent(moment, side, time, source))
    return out


def _compute_median_difference(known: Sequence[float], other: Sequence[float]) -> float:
    """Compute the median delay (s) of known events after those of another source; 0 without any."""
    if not known:
        return 0.0
    delays = []
    for time in other:
        nearest = min(known, key=lambda k: abs(k - time))
        if abs(nearest - time) < SAME_EVENT:
            delays.append(nearest - time)
    return float(np.median(delays)) if delays else 0.0


def find_motion_events(time: Array, slower: Array) -> list[FootEvent]:
    """Find strikes and offs of both feet by motion alone.

    `time`: (nf,) s. `slower`: (nf, 2) m/s, speed of the slower end of each foot against the ground;
    right, left.
    """
    events = []
    for foot, side in enumerate(SIDES):
        strikes, offs = find_swing_events(time, slower[:, foot])
        events += [FootEvent(FootMoment.STRIKE, side, t) for t in strikes.tolist()]
        events += [FootEvent(FootMoment.OFF, side, t) for t in offs.tolist()]
    return events


def find_plate_events(
    time: Array, loaded: BoolArray, plates: Sequence[ForcePlate]
) -> list[FootEvent]:
    """Find the times at which the plates under each foot become loaded and unloaded.

    `time`: (nf,) s, frames of the trial. `loaded`: (nf, 2) whether a foot loads plates; right,
    left. `plates`: plates, whose samples give the time between two frames.
    """
    events = []
    inner = find_covered_frames(plates, time) if plates else slice(0, len(time))
    for foot, side in enumerate(SIDES):
        for run in find_runs(remove_flicker(time, loaded[:, foot])):
            # A contact with which the record of the plates begins or ends is no event.
            if run.start > inner.start:
                frames = float(time[run.start - 1]), float(time[run.start])
                strike = _find_threshold_time(plates, *frames, rising=True)
                events.append(FootEvent(FootMoment.STRIKE, side, strike))
            if run.stop < inner.stop:
                frames = float(time[run.stop - 1]), float(time[run.stop])
                off = _find_threshold_time(plates, *frames, rising=False)
                events.append(FootEvent(FootMoment.OFF, side, off))
    return events


def _find_threshold_time(
    plates: Sequence[ForcePlate], begin: float, end: float, *, rising: bool
) -> float:
    """Find when a vertical force passes `LOADED_N` between two frames.

    Without such samples it is the time of the loaded frame.
    """
    for plate in plates:
        near = (plate.time >= begin - 1e-9) & (plate.time <= end + 1e-9)
        pressed = np.nan_to_num(plate.force[near, 1]) > LOADED_N
        if len(pressed) > 1 and pressed[0] != pressed[-1] and bool(pressed[-1]) is rising:
            return float(plate.time[near][np.flatnonzero(pressed)[0 if rising else -1]])
    return end if rising else begin


def find_swing_events(time: Array, slower: Array) -> tuple[Array, Array]:
    """Find strikes and offs of one foot, interpolated between frames.

    `time`: (nf,) s. `slower`: (nf,) m/s, speed of heel or toe against the ground, whichever is
    slower. Returns: s, strikes and offs, increasing.
    """
    if len(time) < 3 or not np.isfinite(slower).all():
        return np.array([]), np.array([])
    padded = np.concatenate([[0.0], slower, [0.0]])
    least = max(SLOWEST_SWING, SMALLEST_SWING * float(slower.max()))
    peaks = [int(k) - 1 for k in _find_peaks(padded, least) if _is_separate_peak(padded, int(k))]
    inner = [float(slower[k]) for k in peaks if 0 < k < len(time) - 1]
    strikes, offs = [], []
    for k in peaks:
        peak = float(slower[k])
        # A swing that the trial cuts may have its peak outside: use the median of the other ones.
        if k in (0, len(time) - 1) and inner:
            peak = max(peak, float(np.median(inner)))
        begin = _find_slow_frame(slower, k, OFF * peak, -1)
        end = _find_slow_frame(slower, k, STRIKE * peak, 1)
        path = slower[(begin or 0) : (len(time) if end is None else end + 1)]
        if float(path.sum()) * float(np.median(np.diff(time))) < LEAST_TRAVEL:
            continue
        if end is not None:
            strikes.append(_interpolate_crossing(time, slower, end - 1, STRIKE * peak))
        if begin is not None:
            offs.append(_interpolate_crossing(time, slower, begin, OFF * peak))
    return np.unique(strikes), np.unique(offs)


def _find_peaks(values: Array, least: float) -> Array:
    """Find samples above `least` that are higher than their neighbours; of a plateau the middle.

    Same as `scipy.signal.find_peaks`, whose package takes half a second to load.
    """
    # First and last sample of each stretch of equal values; most have one sample.
    changes = np.flatnonzero(np.diff(values))
    starts = np.concatenate([[0], changes + 1])
    ends = np.concatenate([changes, [len(values) - 1]])
    height = values[starts]
    top = np.zeros(len(height), dtype=bool)
    top[1:-1] = (height[1:-1] > height[:-2]) & (height[1:-1] > height[2:])
    return ((starts + ends) // 2)[top & (height >= least)]


def _is_separate_peak(speed: Array, peak: int) -> bool:
    """Check that the speed falls by `DIP` on both sides before it reaches a higher peak.

    Of equal peaks the first counts.
    """

    def find_first(marked: BoolArray) -> int:
        return int(np.argmax(marked)) if marked.any() else len(marked)

    low, before, after = (1.0 - DIP) * speed[peak], speed[:peak][::-1], speed[peak + 1 :]
    separate_before = find_first(before < low) < find_first(before >= speed[peak])
    separate_after = find_first(after < low) < find_first(after > speed[peak])
    return separate_before and separate_after


def _find_slow_frame(speed: Array, start: int, threshold: float, step: int) -> int | None:
    """Find the next frame, forwards or backwards, below the threshold; None without one."""
    slow = np.flatnonzero((speed[start:] if step > 0 else speed[start::-1]) < threshold)
    return start + step * int(slow[0]) if len(slow) and slow[0] else None


def _interpolate_crossing(time: Array, speed: Array, before: int, threshold: float) -> float:
    """Interpolate when the speed passes the threshold after the frame `before`."""
    a, b = float(speed[before]), float(speed[before + 1])
    part = 0.0 if a == b else float(np.clip((threshold - a) / (b - a), 0.0, 1.0))
    return float(time[before] + part * (time[before + 1] - time[before]))


STILL = 0.05
"""Of the fastest rate: a slower pelvis is still."""
NEAR, FAR = 0.1, 0.5
"""Of the range of heights: distance from the rest of a pelvis at rest, and in a repetition."""
FALLING = 0.8
"""Of gravity, downward acceleration of the pelvis in flight."""
LEAST_RANGE_M = 0.05
"""m, vertical range of the pelvis in walking: less is no squat, rise or jump."""
CROUCH_M = 0.12
"""m, by which the pelvis goes down and up between two events of the feet: less than 0.1 in walking
and running.
"""
SHORTEST_FLIGHT_S = 0.1
"""s of fall: a hop of 12 mm."""
TOGETHER_S = 0.1
"""s, largest difference between the fall of the pelvis and the events of the feet in a jump, and
between the strikes of both feet; steps of sprinters last 0.2 s.
"""


def is_alternating(right: FootEvents, left: FootEvents) -> bool:
    """Check whether the feet strike and leave in turn, as in walking, climbing or running.

    In a jump both feet strike and leave together; one strike may be late in sliding markers, so the
    median difference counts.
    """
    if not len(right.strikes) or not len(left.strikes):
        return False
    # Time from each event to the nearest one of the same kind of the other foot.
    nearest: list[float] = []
    for a, b in ((right.strikes, left.strikes), (right.toe_offs, left.toe_offs)):
        if len(a) and len(b):
            differences = np.abs(a[:, None] - b)
            nearest += [*differences.min(axis=0), *differences.min(axis=1)]
    return float(np.median(nearest)) > TOGETHER_S


def find_repetitions(
    time: Array, height: Array, feet: Sequence[FootEvents] = ()
) -> tuple[GaitCycle, ...]:
    """Find the repetitions of a trial with their phases, in order of time.

    `time`, `height`: (nf,) s; m, height of the pelvis. `feet`: events of both feet, which limit
    flights.
    """
    reach = float(np.ptp(height))
    if reach < LEAST_RANGE_M:
        return ()
    rate = np.gradient(height, time)
    falls = np.gradient(rate, time) < -FALLING * GRAVITY
    # A movement that reverses at once may have no slow frame: a change of sign counts as well.
    reverses = np.append(rate[1:] * rate[:-1] < 0.0, False)
    slow = np.abs(rate) < STILL * np.abs(rate).max()
    still = np.flatnonzero((slow | reverses) & ~falls)
    if not len(still):
        return ()
    away = np.abs(height - height[still[0]])
    rests = np.zeros(len(time), dtype=bool)
    rests[still] = away[still] < NEAR * reach
    spans = [
        (run.start - 1, run.stop) for run in find_runs(~rests) if away[run].max() > FAR * reach
    ]
    inner = [(first, last) for first, last in spans if first >= 0 and last < len(time)]
    # A movement that ends elsewhere is one repetition, to where the pelvis comes to stay.
    if not inner and spans and 0 <= spans[0][0] < still[-1]:
        last_level = find_runs(np.abs(height - height[still[-1]]) < NEAR * reach)[-1]
        inner = [(spans[0][0], last_level.start)]
    flights = list(_find_flights(time, falls, feet))
    out = []
    for first, last in inner:
        ends = float(time[first]), float(time[last])
        phases = tuple(_split_phases(time, height, ends, flights, NEAR * reach))
        out.append(GaitCycle(*ends, None, parts=phases))
    return tuple(out)


def find_crouches(
    time: Array, height: Array, feet: Sequence[FootEvents]
) -> list[tuple[float, float]]:
    """Find where the pelvis goes down and up further than in any step, among steps.

    Parameters
    ----------
    time, height : (nf,) Array
        s; m, height of the pelvis.
    feet : sequence of FootEvents
        Events of both feet.

    Returns
    -------
    list of tuple
        s, times of the events before and after each crouch.
    """
    moments = [float(time[0]), float(time[-1])]
    for foot in feet:
        moments += [*foot.strikes, *foot.toe_offs]
    out = []
    for start, stop in pairwise(sorted(moments)):
        inner = height[(time >= start) & (time <= stop)]
        if len(inner) and min(inner[0], inner[-1]) - inner.min() > CROUCH_M:
            out.append((start, stop))
    return out


def _find_flights(
    time: Array, falls: BoolArray, feet: Sequence[FootEvents]
) -> Iterator[tuple[float, float]]:
    """Find take-off and landing (s) of each flight."""
    for run in find_runs(falls):
        begin, end = float(time[run.start]), float(time[run.stop - 1])
        if end - begin < SHORTEST_FLIGHT_S:
            continue
        # The last off and the first strike of the feet, where they are known.
        offs, strikes = list[float](), list[float]()
        for foot in feet:
            offs += [t for t in foot.toe_offs.tolist() if abs(t - begin) < TOGETHER_S]
            strikes += [t for t in foot.strikes.tolist() if abs(t - end) < TOGETHER_S]
        yield max(offs, default=begin), min(strikes, default=end)


def _split_phases(
    time: Array,
    height: Array,
    ends: tuple[float, float],
    flights: Sequence[tuple[float, float]],
    least: float,
) -> Iterator[tuple[str, float]]:
    """Yield name and end (s) of each phase between the `ends` of a repetition.

    `least`: m, smallest depth of a turning point at which a stretch on the ground is split.
    """
    moments = [ends[0]]
    for takeoff, landing in flights:
        if ends[0] < takeoff and landing < ends[1]:
            moments += [takeoff, landing]
    moments.append(ends[1])
    # Stretches on the ground and flights alternate.
    for k, (start, stop) in enumerate(pairwise(moments)):
        if k % 2:
            yield "flight", stop
            continue
        frames = np.flatnonzero((time >= start) & (time <= stop))
        h = height[frames]
        # Split at the highest or lowest height, if it is far enough from both ends.
        over, under = h.max() - max(h[0], h[-1]), min(h[0], h[-1]) - h.min()
        middle = []
        if max(over, under) > least:
            middle = [int(h.argmax() if over > under else h.argmin())]
        for a, b in pairwise([0, *middle, len(h) - 1]):
            is_last = b == len(h) - 1
            rising = "push-off" if is_last and k < len(moments) - 2 else "rising"
            lowering = "landing" if a == 0 and k else "lowering"
            yield rising if h[b] > h[a] else lowering, stop if is_last else float(time[frames[b]])
