"""Walks: foot events where we say, and strides of recorded people with what others
measure of them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np

from gaitcal.analysis.prepared_trials import prepare_trial
from gaitcal.dynamics.ground_reactions import (
    compute_foot_points,
    find_unobserved_frames,
    ground_reactions,
)
from gaitcal.gait.events import find_trial_events
from gaitcal.gait.spatiotemporal import Stride, measure_strides
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.tracking.motion import track_motion
from scripts.validation.recordings import study_of_person

PEOPLE = {"multi": "labs_c3d/multi", "HC030A": "children/HC030A", "HC031A": "children/HC031A"}
"""Of `scripts/validation/recordings.toml` -> folder."""
SIDES = ("Right", "Left")


def recorded_strides(data: Path) -> dict[str, tuple[tuple[Stride, ...], Path]]:
    """`HC030A/turn` -> its strides, tracked with the nominal model, and its file."""
    out = {}
    for person, folder in PEOPLE.items():
        study = study_of_person(person)
        model = build_nominal_model(study)
        for trial in study.trials:
            if trial is not study.static:
                prepared = prepare_trial(trial, model, study.settings)
                motion = track_motion(prepared.whole_body_problem, model.parameters)
                reactions = ground_reactions(model, motion, prepared.recording)
                events = find_trial_events(model, motion, reactions, prepared.recording)
                feet = compute_foot_points(model, motion, model.parameters)
                strides = measure_strides(events, motion.time, feet, find_unobserved_frames(motion))
                out[f"{person}/{trial.name}"] = strides, data / folder / f"{trial.name}.c3d"
    return out


def event_times(file: ezc3d.c3d, side: str, label: str) -> list[float]:
    """Times (s) of this event of a foot in the file."""
    event = file["parameters"]["EVENT"]
    rows = zip(
        event["CONTEXTS"]["value"],
        event["LABELS"]["value"],
        event["TIMES"]["value"][1],
        strict=True,
    )
    return sorted(
        float(t) for context, name, t in rows if (context.strip(), name.strip()) == (side, label)
    )


def vendor_figures(path: Path) -> dict[tuple[str, str], float]:
    """(side, name) -> what the laboratory's own program wrote into the file (ANALYSIS); empty where
    nothing.
    """
    group = ezc3d.c3d(str(path))["parameters"]["ANALYSIS"]
    if "NAMES" not in group:
        return {}
    columns = [group[name]["value"] for name in ("CONTEXTS", "NAMES", "VALUES")]
    return {
        (side[0].lower(), name): float(value) for side, name, value in zip(*columns, strict=True)
    }


def hand_count(path: Path) -> dict[str, list[dict[str, float]]]:
    """Side -> measures of each whole stride, from the file's events and heel markers alone."""
    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    labels = [label.strip() for label in point["LABELS"]["value"]]
    rate, first = point["RATE"]["value"][0], file["header"]["points"]["first_frame"]
    strikes, offs = (
        {s: event_times(file, s, label) for s in SIDES} for label in ("Foot Strike", "Foot Off")
    )

    def heel(side: str, when: float) -> np.ndarray:
        track = 1e-3 * file["data"]["points"][:2, labels.index(f"{side[0]}HEE")]
        return np.array(
            [np.interp(when * rate - first, np.arange(track.shape[1]), axis) for axis in track]
        )

    out: dict[str, list[dict[str, float]]] = {}
    for side, other in (SIDES, SIDES[::-1]):
        for begin, end in itertools.pairwise(strikes[side]):
            stride = heel(side, end) - heel(side, begin)
            counted = {
                "stride_time": end - begin,
                "cadence": 120.0 / (end - begin),
                "stride_length": float(np.hypot(*stride)),
                "speed": float(np.hypot(*stride)) / (end - begin),
            }
            if inside := [t for t in offs[side] if begin < t < end]:
                counted |= {"stance": inside[0] - begin, "swing": end - inside[0]}
            if between := [t for t in strikes[other] if begin < t < end]:
                step = heel(side, end) - heel(other, between[0])
                counted["step_time"] = end - between[0]
                counted["step_length"] = float(step @ stride / np.hypot(*stride))
                rightwards = float(step[0] * stride[1] - step[1] * stride[0]) / float(
                    np.hypot(*stride)
                )  # z is up
                counted["step_width"] = rightwards if side == "Right" else -rightwards
            out.setdefault(side[0].lower(), []).append(counted)
    return out


def vendor_strides(path: Path) -> list[tuple[dict[str, tuple[np.ndarray, ...]], float]]:
    """Of each stride of both feet the program's own curves (angles deg, powers W/kg; no errors) and
    toe-off, %.
    """
    file = ezc3d.c3d(str(path))
    point, points = file["parameters"]["POINT"], file["data"]["points"]
    labels = [label.split(":")[-1].strip() for label in point["LABELS"]["value"]]
    rate, first, none = (
        point["RATE"]["value"][0],
        file["header"]["points"]["first_frame"],
        np.full(101, np.nan),
    )
    out = []
    for side in SIDES:
        for begin, end in itertools.pairwise(event_times(file, side, "Foot Strike")):
            frames, curves = np.linspace(begin, end, 101) * rate - first, {}
            for joint in ("Hip", "Knee", "Ankle"):
                angle = "hip_flexion" if joint == "Hip" else f"{joint.lower()}_angle"
                for name, label, axis in (
                    (angle, "Angles", 0),
                    (f"{joint.lower()}_power", "Power", 2),
                ):
                    track = points[axis, labels.index(f"{side[0]}{joint}{label}")]
                    track = np.where(
                        np.abs(track) < 1e-12, np.nan, track
                    )  # Plug-in Gait writes 0 where it has none
                    laid = np.interp(
                        frames, np.arange(len(track)), track, left=np.nan, right=np.nan
                    )
                    curves[name] = (laid, none, none)
            off = next(t for t in event_times(file, side, "Foot Off") if begin < t < end)
            out.append((curves, 100.0 * (off - begin) / (end - begin)))
    return out


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
            events += [
                FootEvent(FootMoment.STRIKE, side, strike),
                FootEvent(FootMoment.OFF, side, strike + STANCE),
            ]
    return sorted((e for e in events if begin <= e.time <= end), key=lambda e: e.time)


def moved(
    events: Sequence[FootEvent], offset: float, jitter: float = 0.0, seed: int = 0
) -> list[FootEvent]:
    """The same, later by `offset` and by as much at random as `jitter` (s), by three times that at
    most.
    """
    noise = (
        np.random.default_rng(seed).normal(0.0, jitter, len(events))
        if jitter
        else np.zeros(len(events))
    )
    noise = np.clip(noise, -3.0 * jitter, 3.0 * jitter)
    return [replace(e, time=e.time + offset + float(n)) for e, n in zip(events, noise, strict=True)]


def exchanged(events: Sequence[FootEvent]) -> list[FootEvent]:
    """The same with the sides exchanged."""
    return [replace(e, side={"r": "l", "l": "r"}[e.side]) for e in events]
