"""How near the truth foot strikes and offs are that the motion alone tells: against force plates,
and file's events.

    events STUDY.toml...

Every study is one laboratory. Its gait trials are tracked with the nominal model. The truth is
where the vertical force under a foot passes 20 N, on a plate that holds the heel at the strike and
the toes at the off; and what the file's own events say. Told for each study, in ms: mean and
standard deviation of motion less truth, how many, and how many of the truth's events the motion
missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal import Study
from gaitcal.analysis.prepared_trials import compute_trial_reactions, prepare_trial
from gaitcal.arrays import Array
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_reactions import compute_foot_points
from gaitcal.dynamics.plate_outline import compute_distance_outside, has_known_outline
from gaitcal.gait.events import find_motion_events, find_plate_events
from gaitcal.io.force_plate import LOADED_N
from gaitcal.io.labels import FootEvent, FootMoment, select_event_times
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import SIDES
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.study.study_trial import Role
from gaitcal.tracking.motion import track_motion

SHARED = ()
OWN = {
    "study": {
        "type": Path,
        "nargs": "+",
        "metavar": "STUDY",
        "help": "a study file with gait trials",
    }
}
SAME = 0.2
"""s within which an event of the motion means one of the truth."""
WITHIN_M = 0.03
"""m by which heel or toes must lie inside the plate."""
AFTER_STRIKE, BEFORE_OFF = 0.02, 0.1
"""s: when heel and toes are looked at."""
SHORTEST, LONGEST = 0.4, 1.5
"""s of a whole contact; a shorter or longer one is a part of it, or two."""


@dataclass(frozen=True)
class Walk:
    time: Array
    """(nf,) s."""
    feet: FootPoints
    plates: Sequence[FootEvent]
    file: Sequence[FootEvent]


def events_of(walk: Walk) -> list[FootEvent]:
    """As gaitcal finds them: the slower end of the foot comes to rest, and leaves."""
    return find_motion_events(walk.time, np.minimum(walk.feet.heel_speed, walk.feet.toe_speed))


def walks_of(study: Study) -> list[Walk]:
    model, out = build_nominal_model(study), []
    for trial in (t for t in study.moving if t.role is Role.GAIT):
        ready = prepare_trial(trial, model, study.settings)
        motion = track_motion(ready.whole_body_problem, model.parameters)
        feet, recording = compute_foot_points(model, motion, model.parameters), ready.recording
        plates: list[FootEvent] = []
        if recording.plates:
            loaded = compute_trial_reactions(
                ready, model, model.parameters, motion, study.settings
            ).loaded
            plates = whole_contacts(
                find_plate_events(motion.time, loaded, recording.plates), feet, recording
            )
        out.append(Walk(motion.time, feet, plates, recording.events))
    return out


def whole_contacts(
    events: Sequence[FootEvent], feet: FootPoints, recording: Recording
) -> list[FootEvent]:
    """Those at which the end of the foot that meets or leaves the ground is well within a plate."""
    kept = []
    outlined = [p for p in recording.plates if has_known_outline(p, LOADED_N)]
    for event in events:
        foot, strike = SIDES.index(event.side), event.moment is FootMoment.STRIKE
        other = select_event_times(
            events, event.side, FootMoment.OFF if strike else FootMoment.STRIKE
        )
        lengths = [abs(t - event.time) for t in other if (t > event.time) == strike]
        if lengths and not SHORTEST < min(lengths) < LONGEST:
            continue
        points = (feet.heel if strike else feet.toe)[:, foot]
        at = event.time + (AFTER_STRIKE if strike else -BEFORE_OFF)
        place = np.array([[np.interp(at, recording.time, points[:, k]) for k in range(3)]])
        if (
            not recording.plates
            or len(outlined) < len(recording.plates)
            or compute_distance_outside(outlined, place)[0] < -WITHIN_M
        ):
            kept.append(event)
    return kept


def differences(
    found: Sequence[FootEvent], truth: Sequence[FootEvent], moment: FootMoment, time: Array
) -> list[float]:
    """Seconds of found less true; NaN where the motion has none. Within `SAME` of the trial's ends
    none is asked.
    """
    out = []
    for event in truth:
        if event.moment is moment and time[0] + SAME < event.time < time[-1] - SAME:
            near = [
                t - event.time
                for t in select_event_times(found, event.side, moment)
                if abs(t - event.time) < SAME
            ]
            out.append(min(near, key=abs) if near else np.nan)
    return out


def all_differences(walks: Sequence[Walk], moment: FootMoment, by: str = "plates") -> Array:
    """(n,) s over all walks; `by` is `plates` or `file`."""
    return np.array(
        [d for w in walks for d in differences(events_of(w), getattr(w, by), moment, w.time)]
    )


def told(found: Array) -> str:
    """Mean, standard deviation, number, missed: `-3 ± 8 ms (12, 1 missed)`."""
    seen = found[np.isfinite(found)]
    missed = f", {len(found) - len(seen)} missed" if len(seen) < len(found) else ""
    return (
        f"{1e3 * seen.mean():4.0f} ±{1e3 * seen.std():3.0f} ({len(seen)}{missed})"
        if len(seen)
        else "-"
    )


def lines(labs: dict[str, list[Walk]]) -> Iterator[str]:
    yield (
        "events of the motion less those of force plates and of the file, ms: mean ± deviation "
        "(number)"
    )
    for moment in FootMoment:
        for name, walks in labs.items():
            cells = (
                f"{by:>9} {told(all_differences(walks, moment, by)):24}"
                for by in ("plates", "file")
            )
            yield f"{name:12}{moment.value:13}" + "".join(cells).rstrip()


def run(chosen: argparse.Namespace) -> dict[str, list[Walk]]:
    studies = [Study.load(path) for path in chosen.study]
    labs = {study.subject.name: walks_of(study) for study in studies}
    print("\n".join(lines(labs)))
    return labs
