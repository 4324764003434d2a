"""A sound synthetic study in memory, and ways to spoil one trial of it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gaitcal.errors import Finding, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.motion import gait_motion, isolated_motion, static_motion
from tests.synthetic_studies import made_plates, made_recording

Array = NDArray[np.float64]
Change = Callable[[Recording], Recording]

GROUND = np.array([-10.0, -10.0])
CORNERS = np.array([[10.0, 0.0, -10.0], [-10.0, 0.0, -10.0], [-10.0, 0.0, 10.0], [10.0, 0.0, 10.0]])
"""A plate as large as the room: every centre of pressure lies on it."""


@cache
def sound_study() -> Study:
    """Standing, walking over two plates, a moving knee: nothing to find."""
    walk = gait_motion()
    plates = made_plates(walk)
    recordings = {
        "static": made_recording(static_motion(), static=True),
        "walk": replace(made_recording(walk), plates=plates),
        "knee_r": made_recording(isolated_motion("knee_r")),
    }
    trials = (
        Trial(name="static", role=Role.STATIC, recording=recordings["static"]),
        Trial(name="walk", role=Role.GAIT, recording=recordings["walk"]),
        Trial(name="knee_r", role=Role.JOINT, joint="knee_r", recording=recordings["knee_r"]),
    )
    subject = Subject("synthetic", 69.4, 1.70, "male")
    return Study(
        subject=subject,
        marker_set=load_marker_set("published"),
        trials=trials,
        settings=CalibrationSettings(),
        weights={},
        inputs={},
    )


def with_trial(study: Study, name: str, change: Change) -> Study:
    """The study with one recording changed."""
    trials = tuple(replace(t, recording=change(t.recording)) if t.name == name else t for t in study.trials)
    return replace(study, trials=trials)


def findings(study: Study, topic: str, severity: Severity | None = None) -> list[Finding]:
    """What the checks find about a topic."""
    found = [f for f in check_study(study) if f.topic == topic]
    return [f for f in found if severity is None or f.severity is severity]


def moved(label: str, change: Callable[[Array], Array]) -> Change:
    """The trajectory (nf, 3) of one marker changed."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        at = recording.labels.index(label)
        markers[:, at] = change(markers[:, at].copy())
        return replace(recording, markers=markers)

    return spoil


def swapped(a: str, b: str, frames: slice = slice(None)) -> Change:
    """Two labels exchanged in some frames."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        i, j = recording.labels.index(a), recording.labels.index(b)
        markers[frames, i], markers[frames, j] = recording.markers[frames, j], recording.markers[frames, i]
        return replace(recording, markers=markers)

    return spoil


def put_into(a: str, b: str, frames: slice = slice(None)) -> Change:
    """The trajectory of `b` under the label `a` as well, in some frames."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        markers[frames, recording.labels.index(a)] = recording.markers[frames, recording.labels.index(b)]
        return replace(recording, markers=markers)

    return spoil


def taken(a: str, b: str, frames: slice) -> Change:
    """The label `a` in the place of `b`, which is not seen meanwhile."""
    return lambda r: moved(b, lambda x: put(x, frames, np.nan))(put_into(a, b, frames)(r))


def relabelled(old: str, new: str) -> Change:
    """One label spelt otherwise."""
    return lambda r: replace(r, labels=tuple(new if label == old else label for label in r.labels))


def plate(number: int, change: Callable[[ForcePlate], ForcePlate]) -> Change:
    """One force plate changed."""

    def spoil(recording: Recording) -> Recording:
        plates = tuple(change(p) if k == number else p for k, p in enumerate(recording.plates, start=1))
        return replace(recording, plates=plates)

    return spoil


def scaled(factor: float) -> Change:
    return lambda r: replace(r, markers=factor * r.markers)


def gone(frames: slice) -> Change:
    return moved("R.Thigh.Front", lambda x: put(x, frames, np.nan))


def put(x: np.ndarray, where: object, value: object) -> np.ndarray:
    x[where] = value
    return x


def held(x: np.ndarray) -> np.ndarray:
    x[60:100] = x[60]
    return x


def spiked(x: np.ndarray) -> np.ndarray:
    x[[40, 90, 140], 1] += 0.1
    return x


def later(seconds: float) -> Change:
    def spoil(recording: Recording) -> Recording:
        moved_ = tuple(_resampled(p, seconds) for p in recording.plates)
        return replace(recording, plates=moved_)

    return spoil


def _resampled(p: ForcePlate, seconds: float) -> ForcePlate:
    """The plate's signal `seconds` later on the same clock."""
    shift = round(seconds / float(p.time[1] - p.time[0]))
    return replace(
        p, force=np.roll(p.force, shift, 0), point=np.roll(p.point, shift, 0), moment=np.roll(p.moment, shift, 0)
    )


def slower(recording: Recording) -> Recording:
    return replace(recording, time=recording.time * 200.0)


def torn(recording: Recording) -> Recording:
    return replace(recording, time=recording.time + np.where(recording.time > 0.5, 0.2, 0.0), plates=())


def backwards(recording: Recording) -> Recording:
    return replace(recording, markers=recording.markers[::-1].copy(), plates=())


def lying(recording: Recording) -> Recording:
    return replace(recording, markers=recording.markers[:, :, [1, 0, 2]] * [1.0, -1.0, 1.0], plates=())


def mirrored(recording: Recording) -> Recording:
    order = [
        recording.labels.index(label[0].translate(str.maketrans("RL", "LR")) + label[1:])
        if label[:2] in ("R.", "L.") and "ASIS" not in label
        else i
        for i, label in enumerate(recording.labels)
    ]
    return replace(recording, markers=recording.markers[:, order])


def clipped(p: ForcePlate) -> ForcePlate:
    return replace(p, force=np.where(p.force > 600.0, 600.0, p.force))


def offset(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force + [0.0, 25.0, 0.0])


def half(p: ForcePlate) -> ForcePlate:
    return replace(p, force=0.4 * p.force, moment=0.4 * p.moment)


def pulling(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force * np.where(p.time > 0.4, -1.0, 1.0)[:, None])


def aslant(p: ForcePlate) -> ForcePlate:
    return replace(p, force=p.force[:, [1, 1, 2]])


def elsewhere(p: ForcePlate) -> ForcePlate:
    return replace(p, point=p.point + [0.0, 0.0, 0.8])


def sunk(p: ForcePlate) -> ForcePlate:
    return replace(p, point=p.point - [0.0, 0.4, 0.0])


def with_corners(x_end: float) -> Change:
    """Plate 1 ends at x_end m."""
    corners = np.column_stack([np.minimum(CORNERS[:, 0], x_end), CORNERS[:, 1:]])
    return plate(1, lambda p: replace(p, corners=corners))
